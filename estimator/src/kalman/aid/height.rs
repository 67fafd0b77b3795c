//! Distance to the surface below, along body down: height over the cosine of the tilt.

use super::{Observation, attitude_row, cos_tilt_derivative};
use crate::kalman::{Nominal, POSITION};

/// Steeper than this cosine (20 deg) the beam looks past the vehicle's own footprint.
pub const MIN_COS_TILT: f64 = 0.94;

/// Range along body down, m, over a surface `ground_m` above home's floor.
#[must_use]
pub fn observe(state: &Nominal, ground_m: f64) -> Observation {
    let cos_tilt = state.cos_tilt().max(0.1);
    let range = (-state.position.z - ground_m) / cos_tilt;
    let mut row = attitude_row(cos_tilt_derivative(state) * (-range / cos_tilt));
    row[POSITION + 2] = -1.0 / cos_tilt;
    Observation::new(range, row)
}
