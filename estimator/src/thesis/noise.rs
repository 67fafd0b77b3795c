//! Process and observation noise: the program's diagonals, in SI squared.

use super::{ANGLES, BIAS, POSITION, RATES, STATES, VELOCITY};

/// Diagonals of Q and R.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Process noise per step, in state order.
    pub process: [f64; STATES],
    /// Observations without a position fix.
    pub without_fix: ObservationNoise,
    /// Observations with a position fix.
    pub with_fix: ObservationNoise,
    /// Follow the norms of gravity and field instead of the fixed angles' noise.
    pub is_dynamic: bool,
}

/// Diagonal of R.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservationNoise {
    /// psi and phi, rad2.
    pub tilt: f64,
    /// theta, rad2.
    pub theta: f64,
    /// Accelerometer, (m/s2)2.
    pub accel: f64,
    /// Gyro, (rad/s)2.
    pub gyro: f64,
    /// Barometric height, or x, y and z of a fix, m2.
    pub position: f64,
}

/// With dynamic covariance: psi and phi when the specific force is gravity, and when it is not.
const DYNAMIC_TILT: (f64, f64) = (1e2, 1e9);
/// With dynamic covariance: theta when the field is the Earth's, and when it is not.
const DYNAMIC_THETA: (f64, f64) = (1e5, 1e9);

impl Default for Noise {
    /// The final program, dynamic covariance on.
    fn default() -> Self {
        let mut process = [1.0; STATES];
        for i in 0..3 {
            process[POSITION + i] = 100.0;
            process[ANGLES + i] = 1.0;
            process[VELOCITY + i] = 100.0;
            process[RATES + i] = 10.0;
            process[BIAS + i] = 1.0;
        }
        Self {
            process,
            without_fix: ObservationNoise {
                tilt: 10.0,
                theta: 1000.0,
                accel: 1e4,
                gyro: 100.0,
                position: 1000.0,
            },
            with_fix: ObservationNoise {
                tilt: 1000.0,
                theta: 1000.0,
                accel: 1e4,
                gyro: 100.0,
                position: 100.0,
            },
            is_dynamic: true,
        }
    }
}

impl Noise {
    /// What sensors and model are worth, in SI (chosen): for flight. The program's figures let the accelerometer pull the estimated tilt to level
    /// within a tenth of a second, and an accelerometer in flight feels thrust alone: level, whatever the tilt.
    #[must_use]
    pub fn flight() -> Self {
        let mut process = [0.0; STATES];
        for i in 0..3 {
            process[POSITION + i] = 1e-6;
            process[ANGLES + i] = 1e-8;
            process[VELOCITY + i] = 1e-6;
            process[RATES + i] = 1e-2;
            process[BIAS + i] = 1e-7;
        }
        let without_fix = ObservationNoise {
            tilt: 0.1,
            theta: 1e-2,
            accel: 0.25,
            gyro: 4e-4,
            position: 0.1,
        };
        Self {
            process,
            without_fix,
            with_fix: ObservationNoise {
                position: 1e-3,
                ..without_fix
            },
            is_dynamic: false,
        }
    }

    /// The recorded run of March 2012: Q = 0.01 I, R = 1e4 I.
    #[must_use]
    pub const fn march_2012() -> Self {
        let r = ObservationNoise {
            tilt: 1e4,
            theta: 1e4,
            accel: 1e4,
            gyro: 1e4,
            position: 1e4,
        };
        Self {
            process: [0.01; STATES],
            without_fix: r,
            with_fix: r,
            is_dynamic: false,
        }
    }

    /// R for one step.
    #[must_use]
    pub const fn observation(
        &self,
        has_fix: bool,
        accel_is_good: bool,
        mag_is_good: bool,
    ) -> ObservationNoise {
        let fixed = if has_fix {
            self.with_fix
        } else {
            self.without_fix
        };
        if !self.is_dynamic {
            return fixed;
        }
        ObservationNoise {
            tilt: if accel_is_good {
                DYNAMIC_TILT.0
            } else {
                DYNAMIC_TILT.1
            },
            theta: if mag_is_good {
                DYNAMIC_THETA.0
            } else {
                DYNAMIC_THETA.1
            },
            ..fixed
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    #[test]
    fn a_bad_norm_takes_the_weight_from_its_own_angles_only() {
        let noise = Noise::default();
        let shaken = noise.observation(false, false, true);
        assert_eq!((shaken.tilt, shaken.theta), (1e9, 1e5));
        let magnet = noise.observation(true, true, false);
        assert_eq!(
            (magnet.tilt, magnet.theta, magnet.position),
            (1e2, 1e9, 100.0)
        );
        let fixed = Noise {
            is_dynamic: false,
            ..noise
        };
        assert_eq!(fixed.observation(false, false, false), noise.without_fix);
    }
}
