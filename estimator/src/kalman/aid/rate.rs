//! On the ground nothing turns: the gyro reads its bias.

use super::{Observation, unit_row};
use crate::kalman::{GYRO_BIAS, Nominal};

/// What each gyro axis reads at rest, rad/s.
#[must_use]
pub fn observe(state: &Nominal) -> [Observation; 3] {
    [0, 1, 2].map(|i| Observation::new(state.gyro_bias[i], unit_row(GYRO_BIAS + i, 1.0)))
}
