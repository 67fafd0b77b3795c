//! Sensors of the companion computer: drivers as pure machines, and readings as samples for the estimator.
//!
//! A driver takes the bytes (or edges) of one device with the time they came, and hands out [`Sample`]s. It opens
//! nothing and reads no clock; [`crate::io::sensors`] does that. Its simulated twin is in `sim/src/device/`.
//!
//! | Module | Device |
//! | --- | --- |
//! | [`circle`] | what all turning lasers share: a circle of points as rangers of the ring |
//! | [`ld06`] | LD06 class lidars, serial |
//! | [`rplidar`] | RPLIDAR A1 class lidars, serial, standard scan |
//! | [`tof_ring`] | ring of multizone time-of-flight sensors behind a small microcontroller, serial |
//! | [`hc_sr04`] | ring of ultrasonic rangers on GPIO lines: who fires when, and what the edges say |
//! | [`msp_module`] | range finder and optical flow modules that speak MSP, serial |
//! | [`gps`] | gpsd, log, fake |
//! | [`ring`] | single readings become scans |
//! | [`stuck`] | a sensor that says the same for ever |
//! | [`suite`] | what a command line or configuration names, checked, as drivers and one ring |
//! | [`options`] | how a sensor is written: `ld06:///dev/ttyUSB0?yaw_deg=90` or a TOML table |

pub mod circle;
pub mod gps;
pub mod hc_sr04;
pub mod ld06;
pub mod msp_module;
pub mod options;
pub mod ring;
pub mod rplidar;
pub mod stuck;
pub mod suite;
pub mod tof_ring;

use core::time::Duration;
use serde::{Deserialize, Serialize};
use vehicle::{DownRange, ExternalPose, FlowSample, GnssFix, RangerReading, Timestamp};

/// What a driver hands out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Sample {
    /// A range finder of the ring.
    Ranger(RangerReading),
    /// The down-ranger.
    DownRange(DownRange),
    /// Optical flow.
    Flow(FlowSample),
    /// A satellite fix.
    Gnss(GnssFix),
    /// A pose from outside.
    Pose(ExternalPose),
}

/// When a byte was on the wire, told from when the chunk it came in was read.
///
/// A serial driver hands over what it has gathered for up to some milliseconds; the bytes before the last one are older
/// by the time the rest took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WireTime {
    byte: Duration,
}

impl WireTime {
    /// Of a serial line: 10 bits a byte.
    #[must_use]
    pub fn of_baud(baud: u32) -> Self {
        Self {
            byte: Duration::from_nanos(10_000_000_000 / u64::from(baud.max(1))),
        }
    }

    /// When a byte was complete that `after` others of its chunk followed.
    #[must_use]
    pub fn complete(&self, read_at: Timestamp, after: usize) -> Timestamp {
        read_at - self.byte * u32::try_from(after).unwrap_or(u32::MAX)
    }

    /// How long some bytes take.
    #[must_use]
    pub fn of(&self, bytes: u32) -> Duration {
        self.byte * bytes
    }
}
