//! Time of flight looking down (VL53L1X class): distance to the floor along body down.
//!
//! | | Value |
//! | --- | --- |
//! | rate | 40 Hz |
//! | noise | 0.03 m + 0.01 of the distance, one standard deviation |
//! | longest | 4 m |
//! | none | at more than 25 degrees of tilt |

use crate::noise::Noise;
use crate::quad::Quad;
use core::time::Duration;
use vehicle::{DownRange, Pace, Timestamp};

/// Samples a second.
pub const DOWN_HZ: f64 = 40.0;
/// From the measurement to the sample in our hands.
pub const DOWN_LATENCY: Duration = Duration::from_millis(20);
const NOISE_M: f64 = 0.03;
const NOISE_PER_M: f64 = 0.01;
const MAX_M: f64 = 4.0;
/// Cosine of 25 degrees.
const MAX_TILT_COS: f64 = 0.906_307_787;

/// The sensor with its schedule.
#[derive(Clone, Debug)]
pub(crate) struct DownRanger {
    noise: Noise,
    pace: Pace,
}

impl DownRanger {
    pub(crate) fn new(seed: u64, vehicle: usize) -> Self {
        Self {
            noise: Noise::new(seed, vehicle, "down"),
            pace: Pace::hz(DOWN_HZ),
        }
    }

    pub(crate) fn is_due(&mut self, now: Timestamp) -> bool {
        self.pace.is_due(now)
    }

    pub(crate) fn measure(&mut self, now: Timestamp, quad: &Quad) -> DownRange {
        let cos = quad.tilt_cos();
        let true_m = quad.height_m() / cos;
        let error_m = self
            .noise
            .gauss(NOISE_M + NOISE_PER_M * true_m.abs().min(MAX_M));
        let reading_m = (true_m + error_m).max(0.0);
        DownRange {
            at: now,
            distance_m: (cos > MAX_TILT_COS && reading_m <= MAX_M).then_some(reading_m),
        }
    }
}
