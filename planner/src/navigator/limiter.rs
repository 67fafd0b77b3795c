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
/// What a tilt leads to is asked for this long ahead, s: about the answer of the vehicle; without a velocity longer.
const TILT_AHEAD_S: f64 = 0.4;
const TILT_BLIND_S: f64 = 1.0;

impl Navigator {
    /// The nearest allowed velocity: what leads into an obstacle faster than the vehicle could stop is taken away, what
    /// leads along it stays. Uses the plan's walls and everything seen; without a place on the plan the last returns, and for some
    /// seconds the walls around where it was.
    ///
    /// The hull stops `VFH_MANUAL_STOP` away from obstacles. The vertical part passes unchanged.
    pub fn protect(&mut self, now: Timestamp, nav: &NavState, desired: In<Ned>) -> In<Ned> {
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
        let stop_m = self.radius_m + self.vfh.manual_stop_m;
        if place_holds {
            v = self.held_back_by_all(v, stop_m);
        }
        // What is seen now is told from the plan only while the place is known; a wall is where it echoes, not where the estimate
        // puts it.
        let stop_m = if nav.health.position {
            stop_m - ECHO_NOISE_M
        } else {
            stop_m
        };
        for _ in 0..ROUNDS {
            for r in self.recent.fresh(now) {
                if nav.health.position && !self.recent.is_near_wall(r, stop_m + ECHO_AHEAD_M) {
                    continue;
                }
                let moved = nav.velocity * now.seconds_since(r.at).clamp(0.0, RECENT_S);
                let offset = if moved.is_finite() {
                    r.offset - moved
                } else {
                    r.offset
                };
                let on_plan = xy(self.anchor.vector_to_map(offset));
                v = self.held_back(v, on_plan, on_plan.norm(), stop_m);
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
        let allowed = self.protect(now, nav, leads_to.limited_xy(fastest));
        let braked = (allowed - velocity) * (1.0 / ahead_s);
        if (braked - asked).norm_xy() < 1e-6 {
            return asked;
        }
        braked.limited_xy(most_mps2).with_z(asked.z())
    }

    /// What remains of a velocity (plan axes) when the centre shall stop `stop_m` before every obstacle.
    pub(super) fn held_back_by_all(&self, mut v: Vector2<f64>, stop_m: f64) -> Vector2<f64> {
        for _ in 0..ROUNDS {
            let before = v;
            for o in self.surroundings.points() {
                if o.weight >= SURE_WEIGHT {
                    v = self.held_back(v, o.offset, o.distance_m, stop_m);
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
        stop_m: f64,
    ) -> Vector2<f64> {
        if distance_m < 1e-6 {
            return Vector2::zeros();
        }
        let towards = offset / distance_m;
        let room = distance_m - stop_m;
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
