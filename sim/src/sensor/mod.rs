//! Sensors that measure the world, each with its documented faults.
//!
//! | Sensor | Class | Rate | Latency until delivered |
//! | --- | --- | --- | --- |
//! | `tof` | VL53L5CX, 8 columns | ring table | 30 ms |
//! | `sonar` | HC-SR04 | ring table | time of the echo; 38 ms without one |
//! | `laser` | LD06, RPLIDAR A1 | ring table | 10 ms |
//! | `down` | VL53L1X looking down | 40 Hz | 20 ms |
//! | `flow` | PMW3901 | 50 Hz | 15 ms |
//! | `imu`, `baro`, `mag` | on the flight controller | asked by MSP | serial task and wire |
//!
//! Every sample carries the time it was measured; it is handed over later, by its latency.

mod baro;
mod down;
mod flow;
mod imu;
mod laser;
mod mag;
mod ranger;
mod sonar;
mod tof;
mod view;

pub(crate) use baro::{BARO_STEP_S, Baro};
pub(crate) use down::DownRanger;
pub(crate) use flow::FlowCamera;
pub(crate) use imu::Imu;
pub(crate) use laser::read_ray;
pub(crate) use mag::{Mag, MagneticField};
pub(crate) use ranger::Ranger;
pub(crate) use view::View;

pub use down::{DOWN_HZ, DOWN_LATENCY};
pub use flow::{FLOW_HZ, FLOW_LATENCY};
pub use laser::LASER_LATENCY;
pub use mag::MAG_COUNTS_PER_GAUSS;
pub use sonar::SONAR_SILENCE;
pub use tof::TOF_LATENCY;
