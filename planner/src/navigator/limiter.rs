//! The limiter of manual and off-board velocities: slides along walls, stops before them.

use super::sight::RECENT_S;
use super::{Navigator, SURE_WEIGHT, xy};
use crate::vfh::steering::{reaction_s, stopping_speed};
use nalgebra::Vector2;
use vehicle::{In, NavState, Ned, Timestamp};

/// Rounds of taking away what leads into obstacles; corners need two, noise a third.
const ROUNDS: usize = 4;
/// Fastest retreat from an obstacle that is too close, m/s.
const RETREAT_MPS: f64 = 0.25;
/// The last piece is approached exponentially, at a rate well below the velocity loop's own, 1/s.
const APPROACH_PER_S: f64 = 1.1;
/// Too close by less than this is left alone, m: no trembling in doors.
const LEFT_ALONE_M: f64 = 0.03;
/// Echoes of walls count when they are nearer than the distance at which the hull stops and this, m.
const ECHO_AHEAD_M: f64 = 0.4;
/// The nearest of many echoes is so much nearer than the wall, m.
const ECHO_NOISE_M: f64 = 0.08;
/// A vehicle brakes so much later than a velocity is asked of its loops, and of its tilt, s.
const VELOCITY_LAG_S: f64 = 0.15;
const TILT_LAG_S: f64 = 0.35;
/// Between two sides the hull keeps at least this from each, m, where the way ahead is open for so far, m.
const PASSAGE_SIDE_M: f64 = 0.1;
const PASSAGE_AHEAD_M: f64 = 0.8;
/// ... and the sides are seen so far ahead and behind, m.
const PASSAGE_LONG_M: f64 = 0.6;
/// What a tilt leads to is asked for this long ahead, s: about the answer of the vehicle; without a velocity longer.
const TILT_AHEAD_S: f64 = 0.4;
const TILT_BLIND_S: f64 = 1.0;

/// How near manual flight may come to what.
#[derive(Clone, Copy, Debug)]
struct Distance {
    /// Centre to obstacle, m.
    stop_m: f64,
    /// The same beside a passage that is flown through, and its direction (plan axes).
    passage: Option<(f64, Vector2<f64>)>,
    /// What is flown until braking begins (plan axes), m.
    lead: Vector2<f64>,
}

impl Distance {
    /// Free way in the direction of an obstacle before it is too near, m.
    fn room_m(&self, offset: Vector2<f64>, distance_m: f64) -> f64 {
        let stop_m = match self.passage {
            Some((side_m, unit)) if offset.perp(&unit).abs() >= side_m - 0.02 => side_m,
            _ => self.stop_m,
        };
        distance_m - stop_m - (self.lead.dot(&offset) / distance_m).max(0.0)
    }
}

impl Navigator {
    /// The nearest allowed velocity: what leads into an obstacle faster than the vehicle could stop is taken away, what
    /// leads along it stays. Uses the plan's walls and everything seen; without a place on the plan the last returns, and for some
    /// seconds the walls around where it was.
    ///
    /// The hull stops `VFH_MANUAL_STOP` away from obstacles; through a door or passage that leaves less it is led in the middle. The
    /// vertical part passes unchanged.
    pub fn protect(&mut self, now: Timestamp, nav: &NavState, desired: In<Ned>) -> In<Ned> {
        self.protect_late(now, nav, desired, VELOCITY_LAG_S)
    }

    /// [`Self::protect`] for a vehicle that answers so much later, s.
    fn protect_late(
        &mut self,
        now: Timestamp,
        nav: &NavState,
        desired: In<Ned>,
        late_s: f64,
    ) -> In<Ned> {
        if !self.vfh.enabled || !desired.is_finite() {
            return if desired.is_finite() {
                desired
            } else {
                In::zero()
            };
        }
        self.follow_relocalisation(nav);
        let place_holds = self.place_holds(now, nav);
        if place_holds {
            let here = self.anchor.to_map(nav.position);
            self.look_around(now, here);
        }
        let mut v = xy(self.anchor.vector_to_map(desired));
        v = self.not_faster_than_seen(now, v, desired);
        let lead = if nav.health.velocity && nav.velocity.is_finite() {
            xy(self.anchor.vector_to_map(nav.velocity)) * late_s
        } else {
            Vector2::zeros()
        };
        let stop_m = self.radius_m + self.vfh.manual_stop_m;
        let passage = if place_holds {
            self.passage(v, stop_m)
        } else {
            None
        };
        let mut keep = Distance {
            stop_m,
            passage,
            lead,
        };
        if place_holds {
            v = self.kept_off_all(v, &keep);
        }
        // What is seen now is told from the plan only while the place is known; a wall is where it echoes, not where the estimate
        // puts it.
        if nav.health.position {
            keep.stop_m -= ECHO_NOISE_M;
        }
        for _ in 0..ROUNDS {
            for r in self.recent.fresh(now) {
                if nav.health.position && !self.recent.is_near_wall(r, keep.stop_m + ECHO_AHEAD_M) {
                    continue;
                }
                let moved = nav.velocity * now.seconds_since(r.at).clamp(0.0, RECENT_S);
                let offset = if moved.is_finite() {
                    r.offset - moved
                } else {
                    r.offset
                };
                let on_plan = xy(self.anchor.vector_to_map(offset));
                v = self.held_back(v, on_plan, on_plan.norm(), &keep);
            }
        }
        self.world_vector(v).with_z(desired.z())
    }

    /// The nearest allowed acceleration (world, m/s2) for a pilot who tilts the vehicle directly: what it leads to within a
    /// moment is held to [`protect`](Self::protect), and nothing is flown faster than it could stop within what is watched.
    /// Braking takes at most `most_mps2`. Without a velocity it is asked what the tilt alone would lead to in a second.
    pub fn protect_acceleration(
        &mut self,
        now: Timestamp,
        nav: &NavState,
        asked: In<Ned>,
        most_mps2: f64,
    ) -> In<Ned> {
        if !self.vfh.enabled || !asked.is_finite() {
            return asked;
        }
        let velocity_known = nav.health.velocity && nav.velocity.is_finite();
        let (velocity, ahead_s) = if velocity_known {
            (nav.velocity.with_z(0.0), TILT_AHEAD_S)
        } else {
            (In::zero(), TILT_BLIND_S)
        };
        let leads_to = velocity + asked.with_z(0.0) * ahead_s;
        let latency_s = reaction_s(self.vfh.latency_s, self.coverage.period_s());
        let watched_m = self.vfh.window_m - self.radius_m - self.vfh.manual_stop_m;
        let fastest = stopping_speed(self.vfh.brake_mps2, latency_s, watched_m);
        let asked_for = leads_to.limited_xy(fastest);
        let allowed = self.protect_late(now, nav, asked_for, TILT_LAG_S);
        let braked = (allowed - velocity) * (1.0 / ahead_s);
        if (braked - asked).norm_xy() < 1e-6 {
            return asked;
        }
        braked.limited_xy(most_mps2).with_z(asked.z())
    }

    /// What remains of a velocity (plan axes) when the centre shall stop `stop_m` before every obstacle.
    pub(super) fn held_back_by_all(&self, v: Vector2<f64>, stop_m: f64) -> Vector2<f64> {
        let keep = Distance {
            stop_m,
            passage: None,
            lead: Vector2::zeros(),
        };
        self.kept_off_all(v, &keep)
    }

    fn kept_off_all(&self, mut v: Vector2<f64>, keep: &Distance) -> Vector2<f64> {
        for _ in 0..ROUNDS {
            let before = v;
            for o in self.surroundings.points() {
                if o.weight >= SURE_WEIGHT {
                    v = self.held_back(v, o.offset, o.distance_m, keep);
                }
            }
            if (v - before).norm() < 1e-6 {
                break;
            }
        }
        v
    }

    fn held_back(
        &self,
        v: Vector2<f64>,
        offset: Vector2<f64>,
        distance_m: f64,
        keep: &Distance,
    ) -> Vector2<f64> {
        if distance_m < 1e-6 {
            return Vector2::zeros();
        }
        let towards = offset / distance_m;
        let room = keep.room_m(offset, distance_m);
        let allowed = if room >= 0.0 {
            stopping_speed(self.vfh.brake_mps2, self.vfh.latency_s, room).min(APPROACH_PER_S * room)
        } else {
            (room + LEFT_ALONE_M).clamp(-RETREAT_MPS, 0.0)
        };
        let closing = v.dot(&towards);
        if closing > allowed {
            v - towards * (closing - allowed)
        } else {
            v
        }
    }

    /// A passage that the pilot flies through, narrower than twice the distance kept otherwise: the distance from the centre to its
    /// sides, m, and its direction. None without both sides, or where something stands in it.
    fn passage(&self, v: Vector2<f64>, stop_m: f64) -> Option<(f64, Vector2<f64>)> {
        let unit = v.try_normalize(1e-3)?;
        let least_m = self.radius_m + PASSAGE_SIDE_M;
        let mut sides_m = [f64::INFINITY; 2];
        for o in self.surroundings.points() {
            let aside = o.offset.perp(&unit);
            let is_beside = o.offset.dot(&unit).abs() < PASSAGE_LONG_M && aside.abs() >= least_m;
            if is_beside && o.weight >= SURE_WEIGHT {
                let side = &mut sides_m[usize::from(aside > 0.0)];
                *side = side.min(aside.abs());
            }
        }
        let half_m = 0.5 * (sides_m[0] + sides_m[1]);
        let is_open = half_m < stop_m
            && self.surroundings.free_m(unit, least_m, SURE_WEIGHT) >= PASSAGE_AHEAD_M;
        is_open.then_some((least_m, unit))
    }

    /// Into a gap of the ring only slowly.
    fn not_faster_than_seen(
        &self,
        now: Timestamp,
        v: Vector2<f64>,
        desired: In<Ned>,
    ) -> Vector2<f64> {
        let speed = v.norm();
        let direction = libm::atan2(desired.y(), desired.x());
        if speed > self.vfh.blind_mps && !self.coverage.knows(now, direction) {
            v * (self.vfh.blind_mps / speed)
        } else {
            v
        }
    }
}
