//! Yaw: of the plan pose in the navigation filter, of the flight controller's heading in the odometry filter.

use super::attitude::MIN_COS_PITCH;
use super::{Observation, attitude_row};
use crate::kalman::Nominal;
use nalgebra::Vector3;

/// Yaw, rad. Near the zenith the row is limited.
#[must_use]
pub fn observe(state: &Nominal) -> Observation {
    let (roll, pitch, yaw) = state.roll_pitch_yaw();
    let cos_pitch = libm::cos(pitch).max(MIN_COS_PITCH);
    let d = Vector3::new(0.0, libm::sin(roll), libm::cos(roll)) / cos_pitch;
    Observation::angle(yaw, attitude_row(d))
}
