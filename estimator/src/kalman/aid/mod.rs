//! Observation models, one per file: what a sensor should read in a state, and how that changes with the state.
//!
//! | File | Measures |
//! | --- | --- |
//! | [`attitude`] | roll and pitch of the flight controller |
//! | [`yaw`] | yaw, from the plan or (odometry) the flight controller's heading |
//! | [`heading_increment`] | change of the flight controller's heading: tells the gyro bias, never the yaw |
//! | [`height`] | down-looking range with tilt |
//! | [`baro`] | barometric altitude with a wandering offset |
//! | [`flow`] | optical flow |
//! | [`position`] | horizontal position on the plan |
//! | [`velocity`] | velocity: zero on the ground, or borrowed |
//! | [`rate`] | angular rate on the ground |
//!
//! A new sensor is a new file here, a variant of [`Aid`](super::Aid) and a method of the estimator.

pub mod attitude;
pub mod baro;
pub mod flow;
pub mod heading_increment;
pub mod height;
pub mod position;
pub mod rate;
pub mod velocity;
pub mod yaw;

use super::{ATTITUDE, ErrorVector, Nominal};
use nalgebra::Vector3;

/// What one scalar measurement should be, and its row of the observation matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Predicted measurement.
    pub predicted: f64,
    /// Derivative of the measurement with respect to the error state.
    pub row: ErrorVector,
    /// True if the innovation wraps at pi.
    pub is_angle: bool,
}

impl Observation {
    pub(crate) fn new(predicted: f64, row: ErrorVector) -> Self {
        Self {
            predicted,
            row,
            is_angle: false,
        }
    }

    pub(crate) fn angle(predicted: f64, row: ErrorVector) -> Self {
        Self {
            predicted,
            row,
            is_angle: true,
        }
    }
}

/// A row with one entry.
pub(crate) fn unit_row(index: usize, value: f64) -> ErrorVector {
    let mut row = ErrorVector::zeros();
    row[index] = value;
    row
}

/// A row that only depends on the attitude error.
pub(crate) fn attitude_row(d: Vector3<f64>) -> ErrorVector {
    let mut row = ErrorVector::zeros();
    row.fixed_rows_mut::<3>(ATTITUDE).copy_from(&d);
    row
}

/// Derivative of the cosine of the tilt, `R33`, with respect to the attitude error.
pub(crate) fn cos_tilt_derivative(state: &Nominal) -> Vector3<f64> {
    let r = state.rotation();
    Vector3::new(-r[(2, 1)], r[(2, 0)], 0.0)
}
