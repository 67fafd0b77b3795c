//! Velocity: zero while the vehicle stands, or (odometry without flow) borrowed from navigation.

use super::{Observation, unit_row};
use crate::kalman::{Nominal, VELOCITY};

/// North, east and down, m/s.
#[must_use]
pub fn observe(state: &Nominal) -> [Observation; 3] {
    [0, 1, 2].map(|i| Observation::new(state.velocity[i], unit_row(VELOCITY + i, 1.0)))
}
