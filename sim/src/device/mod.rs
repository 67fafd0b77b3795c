//! Sensors as devices with a line of their own: the bytes the real ones send, made from what the simulated ones measure.
//!
//! The twins of the drivers in `bridge/src/sensor/`, written from the makers' documents and not from the drivers.
//!
//! | Device | Its line |
//! | --- | --- |
//! | [`ld06`] | 12 points a packet, 4500 a second, unasked |
//! | [`rplidar`] | answers commands; 2000 points a second while it scans |
//! | [`tof_ring`] | frames of a microcontroller with four multizone sensors |
//! | [`msp_module`] | range finder and flow messages of MSP |
//! | [`hc_sr04`] | edges of an echo line after a trigger |

pub mod hc_sr04;
pub mod ld06;
pub mod msp_module;
pub mod rplidar;
pub mod tof_ring;

use crate::noise::Noise;
use crate::sensor::{View, read_ray};
use serde::{Deserialize, Serialize};
use vehicle::{Frd, In, Timestamp};

/// Where a turning laser sits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LaserMount {
    /// m from the body centre, forward right down.
    pub offset_m: [f64; 3],
    /// Where its zero looks, clockwise from body forward, degrees.
    pub yaw_deg: f64,
    /// Upside down: its angles run the other way round.
    pub is_upside_down: bool,
}

/// A lidar that a vehicle carries.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LaserConfig {
    /// LD06.
    Ld06(LaserMount),
    /// RPLIDAR A1.
    Rplidar(LaserMount),
}

/// One measured point of a lidar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Clockwise from its zero, degrees, 0..360.
    pub angle_deg: f64,
    /// m; none without a return.
    pub distance_m: Option<f64>,
}

/// A turning laser: points at their time.
#[derive(Clone, Debug)]
struct Turntable {
    mount: LaserMount,
    noise: Noise,
    points_hz: f64,
    turns_hz: f64,
    max_m: f64,
    measured: u64,
}

impl Turntable {
    fn new(mount: LaserMount, points_hz: f64, turns_hz: f64, max_m: f64, noise: Noise) -> Self {
        Self {
            mount,
            noise,
            points_hz,
            turns_hz,
            max_m,
            measured: 0,
        }
    }

    /// Measures what is due up to now.
    fn turn(&mut self, now: Timestamp, view: &View<'_>, mut out: impl FnMut(Timestamp, Point)) {
        loop {
            let at_s = self.measured as f64 / self.points_hz;
            if at_s > now.s() {
                return;
            }
            self.measured += 1;
            let angle_deg = (at_s * self.turns_hz * 360.0).rem_euclid(360.0);
            let sign = if self.mount.is_upside_down { -1.0 } else { 1.0 };
            let bearing = (sign * angle_deg + self.mount.yaw_deg).to_radians();
            let (s, c) = libm::sincos(bearing);
            let origin = view.point(In::<Frd>::from(self.mount.offset_m));
            let distance_m = read_ray(
                &mut self.noise,
                view,
                origin,
                In::new(c, s, 0.0),
                self.max_m,
            );
            out(
                Timestamp::from_us((at_s * 1e6) as u64),
                Point {
                    angle_deg,
                    distance_m,
                },
            );
        }
    }

    /// Forgets the time before now.
    fn skip_to(&mut self, now: Timestamp) {
        self.measured = libm::ceil(now.s() * self.points_hz) as u64;
    }
}

/// A lidar at work.
#[derive(Clone, Debug)]
pub(crate) enum Laser {
    Ld06(ld06::Ld06),
    Rplidar(rplidar::Rplidar),
}

impl Laser {
    pub(crate) fn new(config: LaserConfig, seed: u64, vehicle: usize, index: usize) -> Self {
        let noise = Noise::new(seed, vehicle, &format!("lidar {index}"));
        match config {
            LaserConfig::Ld06(mount) => Self::Ld06(ld06::Ld06::new(mount, noise)),
            LaserConfig::Rplidar(mount) => Self::Rplidar(rplidar::Rplidar::new(mount, noise)),
        }
    }

    /// Time passes: bytes that leave it now.
    pub(crate) fn step(&mut self, now: Timestamp, view: &View<'_>, out: &mut Vec<u8>) {
        match self {
            Self::Ld06(lidar) => lidar.step(now, view, out),
            Self::Rplidar(lidar) => lidar.step(now, view, out),
        }
    }

    /// Bytes for it.
    pub(crate) fn write(&mut self, now: Timestamp, bytes: &[u8]) {
        match self {
            Self::Ld06(_) => {} // It has no ears.
            Self::Rplidar(lidar) => lidar.write(now, bytes),
        }
    }
}
