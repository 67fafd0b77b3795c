//! Barometric altitude. Its zero is where the flight controller armed and walks with the weather and the doors.
//!
//! The offset is kept beside the filter: while the down-range holds the height, the offset follows; when the range is
//! gone, the offset is held and the barometer holds the height, ever less surely.

use super::{Observation, unit_row};
use crate::kalman::{Nominal, POSITION};
use vehicle::Timestamp;

/// Walk of the offset, m/sqrt(s) (algorithms note 1.2).
const WALK_M: f64 = 0.02;
/// The offset follows with this time constant while the down-range speaks, s.
const FOLLOW_S: f64 = 5.0;

/// Altitude above the offset, up +, m.
#[must_use]
pub fn observe(state: &Nominal, offset_m: f64) -> Observation {
    Observation::new(-state.position.z + offset_m, unit_row(POSITION + 2, -1.0))
}

/// The wandering zero of the barometer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Offset {
    learned: Option<(Timestamp, f64)>,
    held_since: Option<Timestamp>,
}

impl Offset {
    /// The offset, m, once learned.
    #[must_use]
    pub fn value_m(&self) -> Option<f64> {
        self.learned.map(|(_, offset)| offset)
    }

    /// Follows the barometer while something better holds the height.
    pub fn follow(&mut self, at: Timestamp, altitude_m: f64, height_m: f64) {
        let now = altitude_m - height_m;
        let offset = match self.learned {
            Some((then, offset)) => {
                let dt = at.seconds_since(then).clamp(0.0, FOLLOW_S);
                offset + (now - offset) * dt / FOLLOW_S
            }
            None => now,
        };
        self.learned = Some((at, offset));
        self.held_since = None;
    }

    /// One standard deviation that the offset has wandered since it was last learned, m.
    #[must_use]
    pub fn doubt_m(&mut self, at: Timestamp) -> f64 {
        let since = *self.held_since.get_or_insert(at);
        WALK_M * at.seconds_since(since).max(0.0).sqrt()
    }
}
