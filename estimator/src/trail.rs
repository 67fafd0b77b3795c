//! The last second of odometry: where the vehicle was when a scan was taken.

use crate::mcl::Planar;
use arrayvec::ArrayVec;
use vehicle::Timestamp;
use vehicle::angle::wrap_pi;

/// Entries kept.
const LENGTH: usize = 80;
/// Faster inertial samples are thinned to this spacing, s: 80 entries are then at least a second.
const SPACING_S: f64 = 0.0125;
/// How far beyond the newest entry a stamp may lie, s (velocity is held).
const AHEAD_S: f64 = 0.06;

/// Odometry at a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Footprint {
    /// When.
    pub(crate) at: Timestamp,
    /// Level pose.
    pub(crate) pose: Planar,
    /// Roll, rad.
    pub(crate) roll_rad: f64,
    /// Pitch, rad.
    pub(crate) pitch_rad: f64,
    /// Height above what is below, m.
    pub(crate) height_m: f64,
}

/// Ring of [`Footprint`]s.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trail {
    ring: ArrayVec<Footprint, LENGTH>,
    next: usize,
}

impl Trail {
    /// Adds the newest.
    pub(crate) fn push(&mut self, footprint: Footprint) {
        if let Some(last) = self.newest()
            && footprint.at.seconds_since(last.at) < SPACING_S
        {
            return;
        }
        if self.ring.try_push(footprint).is_err() {
            self.ring[self.next] = footprint;
            self.next = (self.next + 1) % LENGTH;
        }
    }

    /// Entry by age, 0 = newest.
    fn back(&self, age: usize) -> Option<&Footprint> {
        let n = self.ring.len();
        (age < n).then(|| &self.ring[(self.next + n - 1 - age) % n])
    }

    /// The newest entry.
    #[must_use]
    pub(crate) fn newest(&self) -> Option<&Footprint> {
        self.back(0)
    }

    /// Odometry at a stamp, interpolated; none if it is older than the ring or too far ahead.
    #[must_use]
    pub(crate) fn at(&self, stamp: Timestamp) -> Option<Footprint> {
        let newest = self.newest()?;
        if stamp.seconds_since(newest.at) > AHEAD_S {
            return None;
        }
        let Some(second) = self.back(1) else {
            return (stamp >= newest.at).then_some(*newest);
        };
        if stamp >= newest.at {
            return Some(between(second, newest, stamp));
        }
        let mut later = newest;
        for age in 1..self.ring.len() {
            let earlier = self.back(age)?;
            if earlier.at <= stamp {
                return Some(between(earlier, later, stamp));
            }
            later = earlier;
        }
        None
    }
}

fn between(a: &Footprint, b: &Footprint, stamp: Timestamp) -> Footprint {
    let span = b.at.seconds_since(a.at);
    // After a gap the two say nothing about the velocity: do not extrapolate from them.
    let k = if span > 0.0 && span < 0.25 {
        stamp.seconds_since(a.at) / span
    } else if stamp >= b.at {
        1.0
    } else {
        (stamp.seconds_since(a.at) / span.max(1e-6)).min(1.0)
    };
    let mix = |x: f64, y: f64| x + k * (y - x);
    let turn = |x: f64, y: f64| wrap_pi(x + k * wrap_pi(y - x));
    Footprint {
        at: stamp,
        pose: Planar::new(
            mix(a.pose.x, b.pose.x),
            mix(a.pose.y, b.pose.y),
            turn(a.pose.yaw, b.pose.yaw),
        ),
        roll_rad: turn(a.roll_rad, b.roll_rad),
        pitch_rad: turn(a.pitch_rad, b.pitch_rad),
        height_m: mix(a.height_m, b.height_m),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walk(entries: u64) -> Trail {
        let mut trail = Trail::default();
        for k in 0..entries {
            trail.push(Footprint {
                at: Timestamp::from_ms(25 * k),
                pose: Planar::new(0.01 * k as f64, 0.0, 3.1 + 0.02 * k as f64),
                ..Footprint::default()
            });
        }
        trail
    }

    #[test]
    fn between_two_samples_the_pose_is_interpolated_across_the_wrap_of_yaw() {
        let p = walk(200).at(Timestamp::from_us(4_962_500)).unwrap();
        assert!((p.pose.x - 1.985).abs() < 1e-9);
        assert!(wrap_pi(p.pose.yaw - 3.1 - 0.02 * 198.5).abs() < 1e-9);
    }

    #[test]
    fn a_little_ahead_is_extrapolated_and_far_ahead_or_forgotten_is_refused() {
        let trail = walk(200);
        assert!((trail.at(Timestamp::from_ms(4_975 + 25)).unwrap().pose.x - 2.0).abs() < 1e-9);
        assert!(trail.at(Timestamp::from_ms(6_000)).is_none());
        assert!(trail.at(Timestamp::from_ms(1_000)).is_none());
        assert!(trail.at(Timestamp::from_ms(4_000)).is_some());
        assert!(Trail::default().at(Timestamp::ZERO).is_none());
    }
}
