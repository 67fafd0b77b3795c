//! People who walk through the room: obstacles that no floor plan shows.

use crate::geometry::{Point, distance};
use core::time::Duration;
use serde::{Deserialize, Serialize};
use vehicle::Timestamp;

/// Radius of a person seen from above, m.
pub const PERSON_RADIUS_M: f64 = 0.25;
/// Height of a person, m.
pub const PERSON_HEIGHT_M: f64 = 1.75;

/// A person on a fixed path: stands at the first way point, sets off after `start`, walks at a steady speed.
///
/// To let somebody pass a hover point at a distance, put two way points on a line at that distance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walker {
    /// Way points, plan metres.
    pub path: Vec<[f64; 2]>,
    /// m/s.
    pub speed_mps: f64,
    /// How long they wait before setting off.
    #[serde(default)]
    pub start: Duration,
    /// What they do at the end of the path.
    #[serde(default)]
    pub then: Then,
}

/// What a person does at the end of the path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Then {
    /// Walk back and forth for ever.
    Return,
    /// Stay there.
    #[default]
    Stay,
}

impl Walker {
    /// Where the person is.
    #[must_use]
    pub fn at(&self, now: Timestamp) -> [f64; 2] {
        let Some(first) = self.path.first() else {
            return [0.0, 0.0];
        };
        let start_s = now.s() - self.start.as_secs_f64();
        let mut walked_m = start_s.max(0.0) * self.speed_mps;
        if self.then == Then::Return {
            let length_m = self.length_m();
            if length_m > 0.0 {
                let lap_m = walked_m % (2.0 * length_m);
                walked_m = lap_m.min(2.0 * length_m - lap_m);
            }
        }
        let mut here = *first;
        for next in &self.path[1..] {
            let leg_m = distance(here, *next);
            if walked_m < leg_m {
                let u = walked_m / leg_m;
                return [0, 1].map(|axis| here[axis] + u * (next[axis] - here[axis]));
            }
            walked_m -= leg_m;
            here = *next;
        }
        here
    }

    /// True if every number can be walked.
    pub(crate) fn is_valid(&self) -> bool {
        !self.path.is_empty()
            && self.path.iter().flatten().all(|v| v.is_finite())
            && self.speed_mps.is_finite()
            && self.speed_mps >= 0.0
    }

    fn length_m(&self) -> f64 {
        let legs = self.path.windows(2);
        legs.map(|leg: &[Point]| distance(leg[0], leg[1])).sum()
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    fn walker(then: Then) -> Walker {
        Walker {
            path: vec![[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]],
            speed_mps: 1.0,
            start: Duration::from_secs(1),
            then,
        }
    }

    #[test]
    fn waits_walks_round_the_corner_and_stays() {
        let at = |tenths: u64| walker(Then::Stay).at(Timestamp::from_ms(tenths * 100));
        assert_eq!(at(5), [0.0, 0.0]);
        assert_eq!(at(20), [1.0, 0.0]);
        assert_eq!(at(35), [2.0, 0.5]);
        assert_eq!(at(99), [2.0, 1.0]);
    }

    #[test]
    fn walks_back_and_forth() {
        let at = |s: u64| walker(Then::Return).at(Timestamp::from_ms(s * 1000));
        assert_eq!(at(4), [2.0, 1.0]);
        assert_eq!(at(6), [1.0, 0.0]);
        assert_eq!(at(7), [0.0, 0.0]);
        assert_eq!(at(8), [1.0, 0.0]);
    }
}
