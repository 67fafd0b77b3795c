//! Scans of the last seconds as one: what a global search looks at.
//!
//! Readings are kept in odometry axes, thinned so that a wall seen a hundred times is one reading with much support. A
//! false return lies somewhere else each time: it has no company, and later beams pass through it. Thinning alone would make
//! such loners the majority, so every kept reading counts by how often it was seen, and loners are left out.

use super::beams::LevelBeam;
use super::planar::Planar;
use arrayvec::ArrayVec;
use vehicle::Timestamp;

/// Most readings a search looks at.
pub const MAX_STACK: usize = 384;
/// Support beyond this adds nothing: the wall is there.
pub const FULL_SUPPORT: u8 = 8;
/// Readings closer together than this are one, m.
const THIN_M: f64 = 0.07;
/// Odometry drifts: readings taken this far back along the way are dropped, m ...
const MAX_WAY_M: f64 = 4.0;
/// ... and in hover too, by 0.1 m in this time, s: a little more than one turn of the search flight.
const MAX_AGE_S: f64 = 10.0;
/// A ray that goes on for more than this beyond a kept hit, passing it within this, has seen through it, m.
const BEYOND_M: f64 = 0.15;
const ASIDE_M: f64 = 0.03;
/// Rays with less than this share of the usual support are loners.
const LONER: f64 = 0.34;

/// A reading that stands for all that ended at the same place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supported {
    /// The newest of them.
    pub beam: LevelBeam,
    /// How often it was seen, 1..=[`FULL_SUPPORT`]. Cones have it in full from the beginning: while the vehicle turns,
    /// the middle of a cone comes by another place each time.
    pub support: u8,
}

#[derive(Clone, Copy, Debug)]
struct Kept {
    reading: Supported,
    at: Timestamp,
    way_m: f64,
}

/// How things were at the last search.
#[derive(Clone, Copy, Debug)]
struct Searched {
    at: Timestamp,
    pose: Planar,
    swept_rad: f64,
    scans: u32,
}

/// The readings, in odometry axes.
#[derive(Clone, Debug, Default)]
pub struct Stack {
    kept: ArrayVec<Kept, MAX_STACK>,
    scans: u32,
    way_m: f64,
    swept_rad: f64,
    last: Option<(Timestamp, Planar)>,
    searched: Option<Searched>,
}

impl Stack {
    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Adds the readings of one update, given in odometry axes, taken at an odometry pose.
    pub fn add(&mut self, at: Timestamp, pose: &Planar, beams: &[LevelBeam]) {
        if let Some((_, last)) = self.last {
            let step = last.step_to(pose);
            self.way_m += step.length();
            self.swept_rad += step.yaw.abs();
        }
        self.last = Some((at, *pose));
        self.scans = self.scans.saturating_add(1);
        let way_m = self.way_m;
        self.kept
            .retain(|k| way_m - k.way_m <= MAX_WAY_M && at.seconds_since(k.at) <= MAX_AGE_S);
        for beam in beams.iter().filter(|b| b.is_hit()) {
            if beam.is_ray() {
                self.see_through(beam);
            }
            self.keep(at, beam);
        }
        self.kept.retain(|k| k.reading.support > 0);
    }

    /// Takes support from hits that a ray passes through: false returns, and people who have walked on.
    fn see_through(&mut self, ray: &LevelBeam) {
        let [ox, oy] = ray.origin;
        let (dx, dy) = (ray.points[1][0] - ox, ray.points[1][1] - oy);
        let length = libm::hypot(dx, dy);
        if length <= BEYOND_M {
            return;
        }
        let (ux, uy) = (dx / length, dy / length);
        for k in self.kept.iter_mut().filter(|k| k.reading.beam.is_ray()) {
            let [x, y] = k.reading.beam.points[1];
            let along = (x - ox) * ux + (y - oy) * uy;
            let aside = (x - ox) * uy - (y - oy) * ux;
            if along > 0.0 && along < length - BEYOND_M && aside.abs() < ASIDE_M {
                k.reading.support = k.reading.support.saturating_sub(1);
            }
        }
    }

    fn keep(&mut self, at: Timestamp, beam: &LevelBeam) {
        let [x, y] = beam.points[1];
        let same = self.kept.iter_mut().find(|k| {
            let [kx, ky] = k.reading.beam.points[1];
            k.reading.beam.is_ray() == beam.is_ray()
                && (kx - x).abs() < THIN_M
                && (ky - y).abs() < THIN_M
        });
        let support = match &same {
            _ if !beam.is_ray() => FULL_SUPPORT,
            Some(same) => (same.reading.support + 1).min(FULL_SUPPORT),
            None => 1,
        };
        let kept = Kept {
            reading: Supported {
                beam: *beam,
                support,
            },
            at,
            way_m: self.way_m,
        };
        if let Some(same) = same {
            // The newer one drifted less, seen from now.
            *same = kept;
        } else if self.kept.try_push(kept).is_err() {
            // The least supported makes room, of these the oldest.
            let least = self
                .kept
                .iter_mut()
                .min_by_key(|k| (k.reading.support, k.at));
            if let Some(least) = least {
                *least = kept;
            }
        }
    }

    /// Number of readings.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.kept.len()
    }

    /// True without readings.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.kept.len() == 0
    }

    /// How far the vehicle has turned since the stack was cleared, rad.
    #[must_use]
    pub const fn swept_rad(&self) -> f64 {
        self.swept_rad
    }

    /// True when the stack holds enough that was not there at the last search.
    #[must_use]
    pub fn is_ripe(&self) -> bool {
        let Some((at, pose)) = self.last else {
            return false;
        };
        if self.kept.len() < 12 || self.scans < 10 {
            return false;
        }
        match self.searched {
            // Wait for half a turn of a quadrant at least, or for three seconds if nobody turns.
            None => self.swept_rad > 1.6 || self.way_m > 0.5 || self.scans >= 45,
            Some(then) => {
                // As the crow flies: hovering is a long way to nowhere.
                let moved = then.pose.distance(&pose);
                let turned = self.swept_rad - then.swept_rad;
                let seconds = at.seconds_since(then.at);
                self.scans >= then.scans + 5
                    && (turned > 1.6
                        || moved > 0.5
                        || (seconds > 3.0 && (turned > 0.5 || moved > 0.3)))
            }
        }
    }

    /// The readings in the axes of the last pose without loners, that pose, and a mark that they have been searched.
    pub fn take(&mut self) -> Option<(ArrayVec<Supported, MAX_STACK>, Planar)> {
        let (at, pose) = self.last?;
        self.searched = Some(Searched {
            at,
            pose,
            swept_rad: self.swept_rad,
            scans: self.scans,
        });
        let axes = pose.axes();
        let least = LONER * self.usual_support();
        let readings = self
            .kept
            .iter()
            .filter(|k| f64::from(k.reading.support) >= least)
            .map(|k| Supported {
                beam: k.reading.beam.inward(&axes),
                ..k.reading
            })
            .collect();
        Some((readings, pose))
    }

    /// Mean support that a ray taken at random finds where it ends.
    fn usual_support(&self) -> f64 {
        let (mut sum, mut squares) = (0.0, 0.0);
        for k in self.kept.iter().filter(|k| k.reading.beam.is_ray()) {
            let support = f64::from(k.reading.support);
            sum += support;
            squares += support * support;
        }
        if sum > 0.0 { squares / sum } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcl::beams::Evidence;

    fn ray(origin: [f64; 2], hit: [f64; 2]) -> LevelBeam {
        LevelBeam {
            points: [hit; 3],
            origin,
            evidence: Evidence::RayFar,
        }
    }

    fn supports(stack: &mut Stack) -> Vec<([f64; 2], u8)> {
        let (readings, _) = stack.take().unwrap();
        readings
            .iter()
            .map(|r| (r.beam.points[0], r.support))
            .collect()
    }

    const HERE: Planar = Planar::new(0.0, 0.0, 0.0);

    #[test]
    fn a_wall_gains_support_and_a_return_seen_once_is_left_out() {
        let mut stack = Stack::default();
        for k in 0..20 {
            let at = Timestamp::from_ms(66 * k);
            stack.add(at, &HERE, &[ray([0.0, 0.0], [2.0, 0.0])]);
        }
        let at = Timestamp::from_ms(1400);
        stack.add(at, &HERE, &[ray([0.0, 0.0], [1.5, 0.5])]);
        assert_eq!(supports(&mut stack), [([2.0, 0.0], FULL_SUPPORT)]);
    }

    #[test]
    fn what_later_beams_pass_through_was_never_there() {
        let mut stack = Stack::default();
        let (short, wall) = (ray([0.0, 0.0], [1.2, 0.0]), ray([0.0, 0.0], [2.0, 0.01]));
        for k in 0..3 {
            stack.add(Timestamp::from_ms(66 * k), &HERE, &[short]);
        }
        assert_eq!(supports(&mut stack), [([1.2, 0.0], 3)]);
        for k in 3..6 {
            stack.add(Timestamp::from_ms(66 * k), &HERE, &[wall]);
        }
        assert_eq!(supports(&mut stack), [([2.0, 0.01], 3)]);
    }

    #[test]
    fn a_beam_past_the_edge_of_a_wall_takes_nothing_from_it() {
        let mut stack = Stack::default();
        let edge = ray([0.0, 0.0], [1.0, 0.1]);
        stack.add(Timestamp::ZERO, &HERE, &[edge]);
        for k in 1..10 {
            let past = ray([0.0, 0.0], [3.0, 0.0]);
            stack.add(Timestamp::from_ms(66 * k), &HERE, &[past]);
        }
        assert_eq!(stack.len(), 2);
    }

    #[test]
    fn odometry_drifts_so_readings_are_forgotten() {
        let mut stack = Stack::default();
        stack.add(Timestamp::ZERO, &HERE, &[ray([0.0, 0.0], [1.0, 0.1])]);
        stack.add(Timestamp::from_ms(9_900), &HERE, &[]);
        assert_eq!(stack.len(), 1);
        stack.add(Timestamp::from_ms(10_100), &HERE, &[]);
        assert!(stack.is_empty());
    }

    #[test]
    fn swaying_on_the_spot_is_no_new_view_and_a_quarter_turn_is() {
        let mut stack = Stack::default();
        let mut ms = 0;
        let mut see = |stack: &mut Stack, pose: &Planar| {
            ms += 66;
            let walls: Vec<_> = (0..20)
                .map(|k| ray([0.0, 0.0], [2.0, 0.2 * f64::from(k)]))
                .collect();
            stack.add(Timestamp::from_ms(ms), pose, &walls);
        };
        for _ in 0..46 {
            see(&mut stack, &HERE);
        }
        assert!(stack.is_ripe());
        assert!(stack.take().is_some());
        for k in 0..200 {
            let sway = Planar::new(0.04 * f64::from(k % 2), 0.0, 0.0);
            see(&mut stack, &sway);
            assert!(!stack.is_ripe());
        }
        for k in 0..40 {
            see(&mut stack, &Planar::new(0.0, 0.0, 0.05 * f64::from(k)));
        }
        assert!(stack.is_ripe());
    }
}
