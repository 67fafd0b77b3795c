//! On the way: a point ahead on the route, VFH+ towards it, a speed from which stopping is possible.

use super::{
    Activity, Goal, HOVER_M, Navigator, Progress, SURE_WEIGHT, Steering, SteeringState, distance,
    nearest_on, stand, xy,
};
use crate::vfh::steering::{Pull, direction, stopping_speed};
use nalgebra::Vector2;
use vehicle::angle::shortest_turn;
use vehicle::{Heading, In, Map, NavState, Setpoint, Timestamp};

/// Legs longer than this are flown nose first, m.
const NOSE_FIRST_M: f64 = 0.5;
/// Progress that counts, m.
const PROGRESS_M: f64 = 0.2;
/// Slowest travel: less is standing, m/s.
const CREEP_MPS: f64 = 0.12;
/// Hull slack of the corridor ahead that must be free: less than the enlargement of the histogram, or every door jamb
/// passed would brake.
const CORRIDOR_SLACK_M: f64 = 0.05;

impl Navigator {
    pub(super) fn travel(
        &mut self,
        now: Timestamp,
        nav: &NavState,
        here: In<Map>,
        goal: &Goal,
    ) -> Steering {
        let direct_m = (nav.position - goal.position).norm_xy();
        let last_leg = self.leg + 1 >= self.path.len();
        if direct_m < HOVER_M && last_leg {
            self.activity = Activity::Hover;
            if direct_m < NOSE_FIRST_M && goal.heading.is_none() {
                self.kept_yaw_rad = nav.yaw_rad();
            }
            self.path.clear();
            return self.hover(now, nav, here, goal);
        }
        let (ahead, left_m) = self.look_ahead(here);
        self.watch_progress(now, nav, goal, left_m);

        if let Some(place) = self.step_aside(now, nav, here, xy(ahead)) {
            return self.evading(now, nav, here, goal, place, left_m);
        }

        let to = xy(ahead) - xy(here);
        let target_rad = libm::atan2(to.y, to.x);
        let velocity = xy(self.anchor.vector_to_map(nav.velocity));
        let moving = velocity.norm() > 0.15;
        let pull = Pull {
            target_rad,
            motion_rad: moving.then(|| libm::atan2(velocity.y, velocity.x)),
            previous_rad: self.previous_rad,
        };
        let enlarged = self.radius_m + self.vfh.safety_m;
        self.histogram
            .update(self.surroundings.points(), to.norm() + enlarged);
        let chosen = if self.vfh.enabled {
            direction(&self.vfh, self.histogram.blocked(), &pull)
        } else {
            Some(target_rad)
        };
        self.previous_rad = chosen;
        let nose = self.anchor.yaw_to_ned(chosen.unwrap_or(target_rad));
        let heading = if left_m > NOSE_FIRST_M {
            nose
        } else {
            goal.heading.unwrap_or(nose)
        };
        let Some(chosen) = chosen else {
            let mut s = stand(nav, goal.position.z(), nose, left_m);
            s.state = SteeringState::Blocked;
            return s;
        };
        let unit = Vector2::new(libm::cos(chosen), libm::sin(chosen));
        let speed = self.speed(now, goal, unit, &pull, left_m);
        let bent = shortest_turn(chosen, target_rad).abs() > 10_f64.to_radians();
        Steering {
            setpoint: Setpoint::Velocity {
                velocity: self.world_vector(unit * speed),
                down_m: Some(goal.position.z()),
                heading: Heading::Yaw(heading),
            },
            distance_left_m: left_m,
            arrived: false,
            state: if bent {
                SteeringState::Avoiding
            } else {
                SteeringState::Clear
            },
        }
    }

    /// The speed in a direction: from which the vehicle stops in time, slower where it cannot see, at bends, near the goal.
    fn speed(
        &self,
        now: Timestamp,
        goal: &Goal,
        unit: Vector2<f64>,
        pull: &Pull,
        left_m: f64,
    ) -> f64 {
        let mut speed = goal.speed_mps.unwrap_or(self.params.cruise_mps).max(0.05);
        // The last piece as fast as the position controller would, so that handing over is not felt.
        speed = speed.min((1.2 * left_m).max(CREEP_MPS));
        let chosen_rad = libm::atan2(unit.y, unit.x);
        if let Some(motion) = pull.motion_rad {
            let turn = shortest_turn(motion, chosen_rad).abs();
            speed *= (1.0 - turn / core::f64::consts::PI).max(0.3);
        }
        if !self.vfh.enabled {
            return speed;
        }
        if !self.coverage.knows(now, self.anchor.yaw_to_ned(chosen_rad)) {
            speed = speed.min(self.vfh.blind_mps);
        }
        let corridor = self.radius_m + CORRIDOR_SLACK_M;
        let free = self.surroundings.free_m(unit, corridor, SURE_WEIGHT);
        let stopping = stopping_speed(&self.vfh, free);
        let creep = if free > 0.1 { CREEP_MPS } else { 0.0 };
        speed.min(stopping.max(creep))
    }

    /// The point on the route to steer for, and the way left, m.
    fn look_ahead(&mut self, here: In<Map>) -> (In<Map>, f64) {
        let goal = match self.path.last() {
            Some(g) => *g,
            None => return (here, 0.0),
        };
        // Advance past corners whose next leg can be flown to directly.
        while self.leg + 1 < self.path.len() {
            let corner = self.path[self.leg];
            let next = self.path[self.leg + 1];
            let on_next = nearest_on(corner, next, here);
            let passed = distance(here, corner) < 0.15
                || (distance(on_next, corner) > 0.05
                    && self.router.sees(here, on_next)
                    && distance(here, on_next) < distance(here, corner));
            if !passed {
                break;
            }
            self.leg += 1;
        }
        let from = self.path[self.leg.saturating_sub(1)];
        let corner = self.path[self.leg.min(self.path.len() - 1)];
        let mut on_leg = nearest_on(from, corner, here);
        let mut left_m = distance(here, on_leg) + distance(on_leg, corner);
        for k in self.leg + 1..self.path.len() {
            left_m += distance(self.path[k - 1], self.path[k]);
        }
        // Walk along the route, as far as the look-ahead reaches and the straight line to the point stays free.
        let mut budget = (self.params.look_ahead_m - distance(here, on_leg)).max(0.3);
        let mut ahead = on_leg;
        let mut k = self.leg;
        while budget > 0.0 && k < self.path.len() {
            let corner = self.path[k];
            let piece = distance(on_leg, corner);
            let step = piece.min(budget).min(0.1);
            let next = if piece <= 1e-6 {
                corner
            } else {
                on_leg + (corner - on_leg) * (step / piece)
            };
            if distance(ahead, here) > 0.3 && !self.router.sees(here, next) {
                break;
            }
            (on_leg, ahead) = (next, next);
            budget -= step;
            if piece <= step + 1e-9 {
                k += 1;
            }
        }
        if distance(ahead, here) < 0.05 {
            ahead = goal;
        }
        (ahead, left_m)
    }

    /// Plans anew when the way left does not shrink.
    fn watch_progress(&mut self, now: Timestamp, nav: &NavState, goal: &Goal, left_m: f64) {
        let since = *self.progress.since.get_or_insert(now);
        if self.progress.best_left_m <= 0.0 || left_m < self.progress.best_left_m - PROGRESS_M {
            (self.progress.best_left_m, self.progress.since) = (left_m.max(1e-3), Some(now));
        } else if now.seconds_since(since) > self.params.stuck_s {
            tracing::info!(left_m, "no progress: planning anew with what was seen");
            if let Ok(path) = self.search(goal.position, nav) {
                self.follow(path);
            }
            self.histogram.clear();
            self.previous_rad = None;
            self.progress = Progress {
                best_left_m: 0.0,
                since: Some(now),
            };
        }
    }
}
