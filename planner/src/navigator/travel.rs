//! On the way: a point ahead on the route, VFH+ towards it, a speed from which stopping is possible.

use super::{
    Activity, Goal, HOVER_M, Navigator, Progress, SURE_WEIGHT, Steering, SteeringState, distance,
    nearest_on, stand, xy,
};
use crate::vfh::config::VfhVariant;
use crate::vfh::grid::OBSTACLE;
use crate::vfh::steering::{Pull, direction, reaction_s, stopping_speed};
use core::f64::consts::TAU;
use nalgebra::Vector2;
use vehicle::angle::{shortest_turn, wrap_pi};
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

/// Free space beside the hull on a straight way to the point ahead, m.
const STRAIGHT_SLACK_M: f64 = 0.08;
/// The way steered for passes a corner of the route no farther off than this, m: what is drawn is flown.
const CUT_M: f64 = 0.08;
/// Floor counts as known for this long after somebody looked at it, s; it is asked for over this way, m, for the hull and
/// this much beside it, m.
const SEEN_FOR_S: f64 = 10.0;
const UNSEEN_REACH_M: f64 = 1.6;
const UNSEEN_SLACK_M: f64 = 0.02;
/// Into what stays unseen, m/s.
const UNSEEN_CREEP_MPS: f64 = 0.1;
/// A bearing this far from every ranger's sight lies on a blind side, rad: gaps between rangers are narrower.
const BLIND_SIDE_RAD: f64 = 0.524;
/// Unseen floor nearer than this is looked at, m, by rangers with a shorter period than this, s.
const LOOK_WITHIN_M: f64 = 0.7;
const LOOK_PERIOD_S: f64 = 0.15;
/// Where the next turn can lead: what the nose swings for, rad.
const SIDES_RAD: f64 = 1.0;
/// Speed of a ring that must swing for that where nothing is mapped, m/s. (200 courses with the multizone ring: 1 contact at 0.4,
/// 3 of 100 at 0.5, 10 of 100 at 0.7.)
const GAPS_MPS: f64 = 0.4;
/// Speed beside an obstacle that is touched, m/s, and what each metre away from it adds, 1/s.
const BESIDE_MPS: f64 = 0.35;
const BESIDE_PER_S: f64 = 3.0;
/// The way is looked over so often, s, and so far, m, for obstacles nearer to the hull than this, m.
const LOOK_OVER_S: f64 = 0.1;
const LOOK_OVER_M: f64 = 5.0;
const WAY_ROOM_M: f64 = 0.06;
/// With something to plan around the way is planned anew after this time, and never sooner than after this, s.
const PLAN_AGAIN_S: f64 = 1.0;
const PLAN_PAUSE_S: f64 = 0.2;
/// No wall of the plan within this distance, or something seen within that, m: unmapped ground.
const MAPPED_M: f64 = 1.9;
const SEEN_NEAR_M: f64 = 3.0;
/// Swing of the nose on the way, rad, and its period, s: the heading loop follows two thirds of it.
const SWING_RAD: f64 = 0.6;
const SWING_S: f64 = 3.0;

/// Floor on the way that nobody has looked at.
#[derive(Clone, Copy, Debug)]
struct Unseen {
    /// How far the vehicle can fly before it covers it, m.
    free_m: f64,
    place: In<Map>,
}

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
        let is_classic = self.vfh.enabled && self.vfh.variant != VfhVariant::Plus;
        if !is_classic {
            self.look_over_way(now, nav, here, goal);
        }
        let (ahead, left_m) = self.look_ahead(here);
        if !is_classic {
            self.watch_progress(now, nav, goal, left_m);
        }

        if let Some(place) = self.step_aside(now, nav, here, xy(ahead)) {
            return self.evading(now, nav, here, goal, place, left_m);
        }
        if is_classic {
            return self.travel_classically(nav, here, goal, left_m);
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
        self.histogram.update_over(
            &mut self.window,
            &mut self.grid,
            here,
            now,
            self.surroundings.others(),
            to.norm() + enlarged,
        );
        // Sectors of five degrees close gaps that the hull still fits through: what can be flown to straight is. Not among
        // people, who do not stay where they are.
        let straight_m = self.surroundings.free_m(
            to / to.norm().max(1e-6),
            self.radius_m + STRAIGHT_SLACK_M,
            SURE_WEIGHT,
        );
        let is_straight = straight_m >= to.norm() && !self.is_somebody_about();
        let chosen = if self.vfh.enabled && !is_straight {
            direction(&self.vfh, self.histogram.blocked(), &pull)
        } else {
            Some(target_rad)
        };
        self.previous_rad = chosen;
        let nose = self.anchor.yaw_to_ned(chosen.unwrap_or(target_rad));
        let unseen = chosen.and_then(|way_rad| self.unseen_on(now, here, way_rad));
        let heading = if left_m > NOSE_FIRST_M {
            let look = unseen.filter(|u| u.free_m < LOOK_WITHIN_M);
            let turn = look.and_then(|u| self.turn_to_look(now, nav, here, u.place));
            wrap_pi(turn.map_or_else(
                || nose + self.swing_on_the_way(now, here),
                |turn| nav.yaw_rad() + turn,
            ))
        } else {
            goal.heading.unwrap_or(nose)
        };
        let Some(chosen) = chosen else {
            self.plan_anew(now, nav, goal);
            let mut s = stand(nav, goal.position.z(), heading, left_m);
            s.state = SteeringState::Blocked;
            return s;
        };
        let unit = Vector2::new(libm::cos(chosen), libm::sin(chosen));
        let mut speed = self.speed(now, here, goal, unit, &pull, left_m);
        if let Some(unseen) = unseen {
            speed = speed.min(self.speed_towards(&unseen));
        }
        if self.must_turn_first(now, nav, chosen) {
            speed = 0.0;
        }
        let flown = if self.vfh.enabled && !self.is_somebody_about() {
            self.foreseen(velocity, unit * speed)
        } else {
            unit * speed
        };
        let bent = shortest_turn(chosen, target_rad).abs() > 10_f64.to_radians();
        Steering {
            setpoint: Setpoint::Velocity {
                velocity: self.world_vector(flown),
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
        here: In<Map>,
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
        let ned = self.anchor.yaw_to_ned(chosen_rad);
        let is_known = self.coverage.knows(now, ned) || self.is_unmapped(now, here);
        if self.is_unmapped(now, here) && !self.coverage.covers_nose(now, SIDES_RAD) {
            speed = speed.min(GAPS_MPS);
        }
        if !is_known {
            speed = speed.min(self.vfh.blind_mps);
        }
        let corridor = self.radius_m + CORRIDOR_SLACK_M;
        let free = self.surroundings.free_m(unit, corridor, SURE_WEIGHT);
        let latency_s = reaction_s(self.vfh.latency_s, self.coverage.period_s());
        let stopping = stopping_speed(self.vfh.brake_mps2, latency_s, free);
        // Beside obstacles slower: the hull is not steered to the centimetre.
        let beside_m = self.surroundings.nearest_m(SURE_WEIGHT) - self.radius_m;
        speed = speed.min(BESIDE_MPS + BESIDE_PER_S * beside_m.max(0.0));
        let creep = if free > 0.1 { CREEP_MPS } else { 0.0 };
        speed.min(stopping.max(creep))
    }

    /// The first floor on a direction that the hull would cover and nobody has looked at; only where the plan does not tell.
    fn unseen_on(&self, now: Timestamp, here: In<Map>, way_rad: f64) -> Option<Unseen> {
        if !self.vfh.enabled || !self.is_unmapped(now, here) {
            return None;
        }
        let (s, c) = libm::sincos(way_rad);
        let hull_m = self.radius_m + UNSEEN_SLACK_M;
        self.grid
            .first_unseen(here, [c, s], hull_m, UNSEEN_REACH_M, SEEN_FOR_S, now)
            .map(|(free_m, place)| Unseen { free_m, place })
    }

    /// True if the way leads to a side without any ranger, that was not looked into a moment ago either: the nose turns first.
    fn must_turn_first(&self, now: Timestamp, nav: &NavState, way_rad: f64) -> bool {
        let way_ned = self.anchor.yaw_to_ned(way_rad);
        self.vfh.enabled
            && self.coverage.has_gaps(now)
            && self
                .coverage
                .is_blind_side(now, way_ned - nav.yaw_rad(), BLIND_SIDE_RAD)
            && !self.coverage.knows(now, way_ned)
    }

    /// The speed from which the vehicle stops before the unseen; very slowly into it, for what stays in a shadow.
    fn speed_towards(&self, unseen: &Unseen) -> f64 {
        let latency_s = reaction_s(self.vfh.latency_s, self.coverage.period_s());
        stopping_speed(self.vfh.brake_mps2, latency_s, unseen.free_m).max(UNSEEN_CREEP_MPS)
    }

    /// The turn (clockwise, rad) that brings a place into a ranger's sight.
    fn turn_to_look(
        &self,
        now: Timestamp,
        nav: &NavState,
        here: In<Map>,
        place: In<Map>,
    ) -> Option<f64> {
        // Slow rangers would be past it before they have looked.
        if !self.coverage.has_gaps(now) || self.coverage.period_s() > LOOK_PERIOD_S {
            return None;
        }
        let to = xy(place) - xy(here);
        let bearing = self.anchor.yaw_to_ned(libm::atan2(to.y, to.x)) - nav.yaw_rad();
        Some(self.coverage.turn_to_see(now, bearing))
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
        // Around what the plan does not show the way is only a guess.
        let is_drawn = self.seen.is_empty();
        while budget > 0.0 && k < self.path.len() {
            let corner = self.path[k];
            let piece = distance(on_leg, corner);
            let step = piece.min(budget).min(0.1);
            let next = if piece <= 1e-6 {
                corner
            } else {
                on_leg + (corner - on_leg) * (step / piece)
            };
            let cuts =
                |corner: &In<Map>| distance(nearest_on(here, next, *corner), *corner) > CUT_M;
            let is_cut = is_drawn && self.path[self.leg.min(k)..k].iter().any(cuts);
            if distance(ahead, here) > 0.3 && (is_cut || !self.router.sees(here, next)) {
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

    fn is_somebody_about(&self) -> bool {
        self.params.evade && self.tracker.tracks().iter().any(|t| t.is_confirmed())
    }

    /// True where the plan shows nothing nearby, or something was seen that it does not show: what else is there can only
    /// be seen.
    fn is_unmapped(&self, now: Timestamp, here: In<Map>) -> bool {
        if self.is_somebody_about() {
            return false;
        }
        let mut any = self.router.clearance_m(here).is_none_or(|m| m > MAPPED_M);
        self.grid.around(here, SEEN_NEAR_M, now, |_, certainty| {
            any |= certainty >= OBSTACLE
        });
        any
    }

    /// The nose's swing on the way, rad: for a ring that does not see all that the next turn can lead into.
    fn swing_on_the_way(&self, now: Timestamp, here: In<Map>) -> f64 {
        let is_useful = !self.coverage.covers_nose(now, SIDES_RAD) && self.coverage.has_gaps(now);
        if !is_useful || !self.is_unmapped(now, here) {
            return 0.0;
        }
        SWING_RAD * libm::sin(TAU * now.s() / SWING_S)
    }

    /// Plans anew when something that was seen since blocks the way, and now and then when there is something to plan around.
    fn look_over_way(&mut self, now: Timestamp, nav: &NavState, here: In<Map>, goal: &Goal) {
        // People are given way to and walk on: no way is planned around them.
        if now.seconds_since(self.looked_over) < LOOK_OVER_S || self.is_somebody_about() {
            return;
        }
        self.looked_over = now;
        let planned_s = now.seconds_since(self.planned);
        if self.is_blocked(now, here) || (planned_s > PLAN_AGAIN_S && self.has_seen(now, here)) {
            self.plan_anew(now, nav, goal);
        }
    }

    fn plan_anew(&mut self, now: Timestamp, nav: &NavState, goal: &Goal) {
        if now.seconds_since(self.planned) < PLAN_PAUSE_S {
            return;
        }
        self.planned = now;
        if let Ok(path) = self.search(goal.position, nav) {
            self.follow(path);
        }
    }

    fn has_seen(&self, now: Timestamp, here: In<Map>) -> bool {
        let mut any = false;
        self.grid.around(here, LOOK_OVER_M, now, |_, certainty| {
            any |= certainty >= OBSTACLE
        });
        any
    }

    /// True if something certain lies on the next metres of the way.
    fn is_blocked(&self, now: Timestamp, here: In<Map>) -> bool {
        let keep_m = self.radius_m + WAY_ROOM_M;
        let mut from = here.with_z(0.0);
        let mut budget_m = LOOK_OVER_M;
        for corner in self.path.iter().skip(self.leg) {
            let length = distance(from, *corner);
            let steps = libm::ceil(length.min(budget_m) / 0.1);
            for k in 0..=steps as usize {
                let p = from + (*corner - from) * (0.1 * k as f64 / length.max(1e-6)).min(1.0);
                let mut is_free = true;
                self.grid.around(p, keep_m, now, |o, certainty| {
                    is_free &= certainty < OBSTACLE
                        || distance(o, p) >= keep_m
                        || distance(o, here) < keep_m;
                });
                if !is_free {
                    return true;
                }
            }
            budget_m -= length;
            if budget_m <= 0.0 {
                break;
            }
            from = *corner;
        }
        false
    }

    /// Plans anew when the way left does not shrink.
    fn watch_progress(&mut self, now: Timestamp, nav: &NavState, goal: &Goal, left_m: f64) {
        let since = *self.progress.since.get_or_insert(now);
        if self.progress.best_left_m <= 0.0 || left_m < self.progress.best_left_m - PROGRESS_M {
            (self.progress.best_left_m, self.progress.since) = (left_m.max(1e-3), Some(now));
        } else if now.seconds_since(since) > self.params.stuck_s {
            tracing::info!(left_m, "no progress: planning anew with what was seen");
            self.planned = now;
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
