//! Horizontal position on the plan, from Monte Carlo localization.

use super::Observation;
use crate::kalman::{ErrorVector, Nominal, POSITION};

/// Position along a horizontal direction, m: direction is a unit vector (north, east).
///
/// In a corridor the particles know one direction and not the other; measured along the axes of their covariance the
/// two scalars are independent.
#[must_use]
pub fn observe_along(state: &Nominal, direction: [f64; 2]) -> Observation {
    let mut row = ErrorVector::zeros();
    row[POSITION] = direction[0];
    row[POSITION + 1] = direction[1];
    Observation::new(
        direction[0] * state.position.x + direction[1] * state.position.y,
        row,
    )
}
