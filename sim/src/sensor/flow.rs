//! Optical flow (PMW3901 class) with the axes and signs of [`FlowSample`].
//!
//! | | Value | Source |
//! | --- | --- | --- |
//! | rate | 50 Hz | |
//! | noise | 0.1 rad/s per sample and axis | optical flow row of the estimator's table |
//! | scale | 4 % off for a whole flight (one standard deviation) | grows over bare floor |
//! | wander | 0.02 rad/s, forgotten within 4 s | texture of the floor; makes the drift below |
//! | quality | about 110; below 20 under 0.08 m, where the lens cannot focus | |
//! | bad frames | 0.5 %, quality 0 | |
//!
//! Together they give the odometry drift of the recorded flights: 0.2 - 1.0 m at most over 7 - 16 m.

use crate::noise::{Noise, Wander};
use crate::quad::Quad;
use core::time::Duration;
use vehicle::{FlowSample, Pace, Timestamp};

/// Samples a second.
pub const FLOW_HZ: f64 = 50.0;
/// From the middle of the exposure to the sample in our hands.
pub const FLOW_LATENCY: Duration = Duration::from_millis(15);
const NOISE_RADPS: f64 = 0.1;
const SCALE_SIGMA: f64 = 0.04;
/// Slow error of each axis, rad/s, and how long it lasts, s.
const WANDER: (f64, f64) = (0.02, 4.0);
const FOCUS_M: f64 = 0.08;
const BAD_FRAMES: f64 = 0.005;
/// The chip counts to this rate, rad/s.
const MAX_RADPS: f64 = 7.4;

/// The camera with its schedule.
#[derive(Clone, Debug)]
pub(crate) struct FlowCamera {
    noise: Noise,
    pace: Pace,
    scale: f64,
    wander: [Wander; 2],
}

impl FlowCamera {
    pub(crate) fn new(seed: u64, vehicle: usize) -> Self {
        let mut noise = Noise::new(seed, vehicle, "flow");
        let (sigma, memory_s) = WANDER;
        let wander = [(); 2].map(|()| Wander::new(&mut noise, sigma, memory_s, 1.0 / FLOW_HZ));
        Self {
            wander,
            scale: 1.0
                + noise
                    .gauss(SCALE_SIGMA)
                    .clamp(-3.0 * SCALE_SIGMA, 3.0 * SCALE_SIGMA),
            pace: Pace::hz(FLOW_HZ),
            noise,
        }
    }

    pub(crate) fn is_due(&mut self, now: Timestamp) -> bool {
        self.pace.is_due(now)
    }

    pub(crate) fn measure(&mut self, now: Timestamp, quad: &Quad) -> FlowSample {
        let velocity = quad.attitude().inverse() * quad.velocity();
        let rates = quad.rates();
        // Sideways or upside down there is no floor to look at: far away, no flow.
        let cos = quad.tilt_cos();
        let distance_m = quad.height_m().max(0.01) / cos.max(0.1);
        let x = rates.x() - velocity.y() / distance_m;
        let y = rates.y() + velocity.x() / distance_m;
        let [nx, ny] = [0, 1]
            .map(|axis| self.wander[axis].step(&mut self.noise) + self.noise.gauss(NOISE_RADPS));
        let (bad, grain) = (self.noise.chance(BAD_FRAMES), self.noise.unit());
        let quality = if bad || cos < 0.5 {
            0.0
        } else if distance_m < FOCUS_M {
            15.0 * grain
        } else {
            90.0 + 40.0 * grain
        };
        FlowSample {
            at: now,
            x_radps: (self.scale * x + nx).clamp(-MAX_RADPS, MAX_RADPS),
            y_radps: (self.scale * y + ny).clamp(-MAX_RADPS, MAX_RADPS),
            quality: quality as u8,
        }
    }
}
