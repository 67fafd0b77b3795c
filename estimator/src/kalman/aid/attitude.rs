//! Roll and pitch of the flight controller's own attitude filter.
//!
//! Over MSP they are quantised to 0.1 deg and lean with the vehicle's acceleration, so they are worth about a degree.

use super::{Observation, attitude_row};
use crate::kalman::Nominal;
use nalgebra::Vector3;

/// Closer to the zenith than this cosine of pitch, roll and yaw have no meaning.
pub(crate) const MIN_COS_PITCH: f64 = 0.2;

/// Roll, rad. None near the zenith.
#[must_use]
pub fn roll(state: &Nominal) -> Option<Observation> {
    let (roll, pitch, _) = state.roll_pitch_yaw();
    if libm::cos(pitch) < MIN_COS_PITCH {
        return None;
    }
    let tan = libm::tan(pitch);
    let d = Vector3::new(1.0, libm::sin(roll) * tan, libm::cos(roll) * tan);
    Some(Observation::angle(roll, attitude_row(d)))
}

/// Pitch, rad. None near the zenith.
#[must_use]
pub fn pitch(state: &Nominal) -> Option<Observation> {
    let (roll, pitch, _) = state.roll_pitch_yaw();
    if libm::cos(pitch) < MIN_COS_PITCH {
        return None;
    }
    let d = Vector3::new(0.0, libm::cos(roll), -libm::sin(roll));
    Some(Observation::angle(pitch, attitude_row(d)))
}
