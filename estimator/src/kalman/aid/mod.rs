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
    row: ErrorVector,
    /// One bit for each number of the row that is not zero.
    support: u16,
    is_angle: bool,
}

impl Observation {
    /// A measurement with its derivative with respect to the error state.
    #[must_use]
    pub fn new(predicted: f64, row: ErrorVector) -> Self {
        let bits = row.iter().enumerate();
        Self {
            predicted,
            row,
            support: bits.fold(0, |bits, (i, h)| bits | u16::from(*h != 0.0) << i),
            is_angle: false,
        }
    }

    /// The same for an angle: the innovation wraps at pi.
    #[must_use]
    pub fn angle(predicted: f64, row: ErrorVector) -> Self {
        Self {
            is_angle: true,
            ..Self::new(predicted, row)
        }
    }

    /// Derivative of the measurement with respect to the error state.
    #[must_use]
    pub const fn row(&self) -> &ErrorVector {
        &self.row
    }

    /// One bit for each number of the row that is not zero.
    pub(super) const fn support(&self) -> u16 {
        self.support
    }

    /// True if the innovation wraps at pi.
    #[must_use]
    pub const fn is_angle(&self) -> bool {
        self.is_angle
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
