//! Hovering with care: hold the place, keep people in sight, step aside for them, come back.

use super::{Activity, Goal, Navigator, Steering, SteeringState, xy};
use crate::evade::{Scene, velocity_to};
use crate::vfh::grid::OBSTACLE;
use core::f64::consts::TAU;
use nalgebra::Vector2;
use vehicle::angle::wrap_pi;
use vehicle::{Heading, In, Map, NavState, Setpoint, Timestamp};

/// A hovering vehicle pushed farther away than this travels back, m.
const TRAVEL_AGAIN_M: f64 = 1.0;
/// Speed of evasion, m/s.
const EVADE_MPS: f64 = 1.2;
/// Evasion is thought over this often, s.
const EVADE_PERIOD_S: f64 = 0.08;
/// Whoever is new is looked at this long, to learn whether they walk, s.
const NEW_S: f64 = 1.5;
/// The nose looks around for this long after somebody was seen, s.
const LOOK_AFTER_S: f64 = 5.0;
/// Where somebody will be when the nose has turned.
const LOOK_LEAD: core::time::Duration = core::time::Duration::from_millis(300);
/// People nearer than this are kept in sight, m.
const LOOK_M: f64 = 3.5;

impl Navigator {
    pub(super) fn hover(
        &mut self,
        now: Timestamp,
        nav: &NavState,
        here: In<Map>,
        goal: &Goal,
    ) -> Steering {
        let target = self.anchor.to_map(goal.position);
        let left_m = (nav.position - goal.position).norm_xy();
        let aside = self.step_aside(now, nav, here, xy(target));
        if let Some(place) = aside {
            return self.evading(now, nav, here, goal, place, left_m);
        }
        if left_m > TRAVEL_AGAIN_M
            && let Ok(path) = self.search(goal.position, nav)
        {
            self.follow(path);
            self.activity = Activity::Travel;
            return self.travel(now, nav, here, goal);
        }
        if let Some(heading) = goal.heading {
            self.kept_yaw_rad = heading;
        }
        // Somebody new or walking is kept in sight; else, for a while, the nose swings through the gaps.
        let heading = match self.turn_to_somebody(now, nav, here) {
            Some(turn) => wrap_pi(nav.yaw_rad() + turn),
            None => wrap_pi(self.kept_yaw_rad + self.swing(now, goal.heading.is_some())),
        };
        let off = nav.position - goal.position;
        let arrived = off.norm_xy() <= self.params.acceptance_m
            && off.z().abs() <= self.params.acceptance_alt_m;
        Steering {
            setpoint: Setpoint::Hover {
                position: goal.position,
                heading: Heading::Yaw(heading),
            },
            distance_left_m: left_m,
            arrived,
            state: SteeringState::Clear,
        }
    }

    /// The nose's swing while hovering, rad: only for a ring with gaps. A heading that was asked for is kept, unless somebody
    /// was about lately.
    fn swing(&self, now: Timestamp, heading_is_asked: bool) -> f64 {
        let somebody_about = self
            .tracker
            .last_alarm()
            .is_some_and(|t| now.seconds_since(t) < LOOK_AFTER_S);
        let has_reason =
            (self.params.look_always && !heading_is_asked) || (self.params.evade && somebody_about);
        if !has_reason || !self.coverage.has_gaps(now) {
            return 0.0;
        }
        self.params.look_deg.to_radians() * libm::sin(TAU * now.s() / self.params.look_period_s)
    }

    /// The smallest turn (clockwise, rad) that keeps the nearest person in a ranger's sight; none without anybody.
    fn turn_to_somebody(&self, now: Timestamp, nav: &NavState, here: In<Map>) -> Option<f64> {
        if !self.params.evade || !self.coverage.has_gaps(now) {
            return None;
        }
        let nearest = self
            .tracker
            .tracks()
            .iter()
            .filter(|t| t.is_in_sight(now))
            .filter(|t| t.has_walked() || (t.is_confirmed() && t.is_newer_than(now, NEW_S)))
            .map(|t| t.position_at(now + LOOK_LEAD) - xy(here))
            .filter(|d| d.norm() < LOOK_M)
            .min_by(|a, b| a.norm().total_cmp(&b.norm()))?;
        let bearing = self.anchor.yaw_to_ned(libm::atan2(nearest.y, nearest.x)) - nav.yaw_rad();
        // The heading loop is slow at small errors, people are not.
        Some((2.0 * self.coverage.turn_to_see(now, bearing)).clamp(-1.0, 1.0))
    }

    /// The place to step aside to, thought over every few steps.
    pub(super) fn step_aside(
        &mut self,
        now: Timestamp,
        nav: &NavState,
        here: In<Map>,
        home: Vector2<f64>,
    ) -> Option<Vector2<f64>> {
        if !self.params.evade {
            return None;
        }
        if now < self.evade_next {
            return self.evade_place;
        }
        self.evade_next = now + core::time::Duration::from_micros((EVADE_PERIOD_S * 1e6) as u64);
        let both_radii = self.radius_m + self.params.person_radius_m;
        let velocity = self.anchor.vector_to_map(nav.velocity);
        let scene = Scene {
            now,
            position: xy(here),
            velocity: xy(velocity),
            home,
            tracks: self.tracker.tracks(),
            mind_standing: self.activity != Activity::Travel,
            keep_m: both_radii + self.params.evade_clearance_m,
            least_m: both_radii + 0.5 * self.params.evade_clearance_m,
            speed_mps: EVADE_MPS,
        };
        let clear_of = |p: Vector2<f64>| {
            self.router
                .clearance_m(In::new(p.x, p.y, 0.0))
                .unwrap_or(0.0)
        };
        let at_home = clear_of(xy(here));
        let wall_m = (self.radius_m + 0.1).min(at_home);
        let is_open = |from: Vector2<f64>, to: Vector2<f64>| {
            let way = to - from;
            let length = way.norm();
            let steps = libm::ceil(length / 0.1).max(1.0);
            let walls_allow =
                (1..=steps as usize).all(|k| clear_of(from + way * (k as f64 / steps)) >= wall_m);
            // People are dealt with by prediction; what else was seen must not be flown into.
            walls_allow && {
                let unit = way / length.max(1e-9);
                self.grid_free(now, from, unit, length)
            }
        };
        let mut evader = self.evader;
        let place = evader.choose(&scene, is_open);
        (self.evader, self.evade_place) = (evader, place);
        place
    }

    /// True if no certain cell lies on the way, except those near people (their own echoes).
    fn grid_free(
        &self,
        now: Timestamp,
        from: Vector2<f64>,
        unit: Vector2<f64>,
        length: f64,
    ) -> bool {
        let steps = libm::ceil(length / 0.1).max(1.0) as usize;
        let mut free = true;
        for k in 1..=steps {
            let p = from + unit * (length * k as f64 / steps as f64);
            self.grid.around(
                In::new(p.x, p.y, 0.0),
                self.radius_m,
                now,
                |c, certainty| {
                    if certainty >= OBSTACLE && !self.is_somebody(now, xy(c)) {
                        free = false;
                    }
                },
            );
        }
        free
    }

    fn is_somebody(&self, now: Timestamp, p: Vector2<f64>) -> bool {
        let reach = self.params.person_radius_m + 0.2;
        self.tracker
            .tracks()
            .iter()
            .any(|t| t.is_confirmed() && (t.position_at(now) - p).norm() < reach)
    }

    /// Flies to the place aside, a ranger turned to whoever is nearest.
    pub(super) fn evading(
        &mut self,
        now: Timestamp,
        nav: &NavState,
        here: In<Map>,
        goal: &Goal,
        place: Vector2<f64>,
        left_m: f64,
    ) -> Steering {
        let v = velocity_to(place, xy(here), EVADE_MPS);
        // Stepping aside must not end in a wall that is not on the plan.
        let velocity =
            self.world_vector(self.held_back_by_all(v, self.radius_m + self.vfh.safety_m));
        let turn = self.turn_to_somebody(now, nav, here).unwrap_or(0.0);
        Steering {
            setpoint: Setpoint::Velocity {
                velocity,
                down_m: Some(goal.position.z()),
                heading: Heading::Yaw(wrap_pi(nav.yaw_rad() + turn)),
            },
            distance_left_m: left_m,
            arrived: false,
            state: SteeringState::Evading,
        }
    }
}
