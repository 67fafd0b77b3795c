//! Stick deflections, the only thing that leaves towards the flight controller.

use serde::{Deserialize, Serialize};

/// Stick deflections; become RC microseconds and channel order only in `bridge/src/fc/rc_out.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sticks {
    /// Right +, -1..=1.
    pub roll: f64,
    /// Nose up +, -1..=1 (the opposite of the transmitter's forward).
    pub pitch: f64,
    /// Clockwise +, -1..=1.
    pub yaw: f64,
    /// 0..=1.
    pub throttle: f64,
}

impl Sticks {
    /// Centred, throttle at zero: what an idle vehicle gets.
    pub const IDLE: Self = Self {
        roll: 0.0,
        pitch: 0.0,
        yaw: 0.0,
        throttle: 0.0,
    };

    /// The same within range; NaN becomes neutral.
    #[must_use]
    pub fn clamped(self) -> Self {
        fn within(v: f64, low: f64, high: f64) -> f64 {
            if v.is_nan() { 0.0 } else { v.clamp(low, high) }
        }
        Self {
            roll: within(self.roll, -1.0, 1.0),
            pitch: within(self.pitch, -1.0, 1.0),
            yaw: within(self.yaw, -1.0, 1.0),
            throttle: within(self.throttle, 0.0, 1.0),
        }
    }
}

impl Default for Sticks {
    fn default() -> Self {
        Self::IDLE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_a_number_is_neutral() {
        let wild = Sticks {
            roll: f64::NAN,
            pitch: 7.0,
            yaw: f64::NEG_INFINITY,
            throttle: f64::NAN,
        };
        assert_eq!(
            wild.clamped(),
            Sticks {
                roll: 0.0,
                pitch: 1.0,
                yaw: -1.0,
                throttle: 0.0
            }
        );
    }
}
