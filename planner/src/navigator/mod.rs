//! Goal and state to set point: the route's look-ahead point, VFH+ towards it, hovering with care at the end.
//!
//! ```text
//!            goal set               within 0.4 m of the goal
//!   Idle ---------------> Travel --------------------------> Hover
//!     |                   ^    ^                               |
//!     | hold              |    +-- pushed 1 m away, nobody near+
//!     +-------------------|-----------------------------> Hover
//!                         +-- no progress: route anew with what was seen
//! ```
//!
//! In both, somebody coming close makes the vehicle step aside ([`crate::evade`]) and come back.

mod limiter;
mod sight;

use crate::coverage::Coverage;
use crate::evade::{Evader, Scene, velocity_to};
use crate::params::PlannerParams;
use crate::route::{MAX_CORNERS, Path, RouteError, Router};
use crate::tracks::Tracker;
use crate::vfh::config::VfhParams;
use crate::vfh::grid::{CertaintyGrid, OBSTACLE};
use crate::vfh::histogram::Histogram;
use crate::vfh::steering::{Pull, direction, stopping_speed};
use crate::vfh::surroundings::{Disc, Surroundings, WallRaster};
use crate::vfh::{SECTORS, middle_of, sector_of};
use arrayvec::ArrayVec;
use core::f64::consts::TAU;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vehicle::angle::{shortest_turn, wrap_pi};
use vehicle::floor_plan::DistanceField;
use vehicle::{FloorPlan, Heading, In, Map, MapAnchor, NavState, Ned, Setpoint, Timestamp};

/// Within this distance of the goal the position controller takes over, m.
const HOVER_M: f64 = 0.4;
/// A hovering vehicle pushed farther away than this travels back, m.
const TRAVEL_AGAIN_M: f64 = 1.0;
/// Legs longer than this are flown nose first, m.
const NOSE_FIRST_M: f64 = 0.5;
/// Progress that counts, m.
const PROGRESS_M: f64 = 0.2;
/// Slowest travel: less is standing, m/s.
const CREEP_MPS: f64 = 0.12;
/// Speed of evasion, m/s.
const EVADE_MPS: f64 = 1.2;
/// Evasion is thought over this often, s.
const EVADE_PERIOD_S: f64 = 0.08;
/// Obstacles weaker than this do not stop anything: a certainty of 6 of 15.
const SURE_WEIGHT: f64 = 0.16;
/// Hull slack of the corridor ahead that must be free: less than the enlargement of the histogram, or every door jamb
/// passed would brake.
const CORRIDOR_SLACK_M: f64 = 0.05;
/// Whoever is new is looked at this long, to learn whether they walk, s.
const NEW_S: f64 = 1.5;
/// Where somebody will be when the nose has turned.
const LOOK_LEAD: core::time::Duration = core::time::Duration::from_millis(300);
/// People nearer than this are kept in sight, m.
const LOOK_M: f64 = 3.5;
/// Most cells added to one search.
const SEEN_MAX: usize = 1024;
/// How far around seen obstacles are added to a search, m.
const SEEN_RADIUS_M: f64 = 6.0;

/// Where to go.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// Where, m.
    pub position: In<Ned>,
    /// Heading there, clockwise from north, rad; none keeps the nose on the way and then where it points.
    pub heading: Option<f64>,
    /// Speed on the way, m/s; none takes MPC_XY_CRUISE.
    pub speed_mps: Option<f64>,
}

/// How the way looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SteeringState {
    /// Free ahead, or hovering.
    #[default]
    Clear,
    /// Bent around an obstacle.
    Avoiding,
    /// Stepping aside for somebody.
    Evading,
    /// No free direction, no way, or the place on the plan is not known: standing.
    Blocked,
}

/// What a step gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steering {
    /// For the arbiter, then control.
    pub setpoint: Setpoint,
    /// Way left to the goal, m.
    pub distance_left_m: f64,
    /// Within the acceptance radius of the goal, hovering.
    pub arrived: bool,
    /// How the way looks.
    pub state: SteeringState,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Activity {
    Idle,
    Travel,
    Hover,
}

/// Flies to goals and holds there.
#[derive(Clone, Debug)]
pub struct Navigator {
    anchor: MapAnchor,
    radius_m: f64,
    params: PlannerParams,
    vfh: VfhParams,
    router: Router,
    walls: WallRaster,
    wall_distance: DistanceField,
    grid: CertaintyGrid,
    coverage: Coverage,
    tracker: Tracker,
    recent: sight::RecentReturns,
    surroundings: Surroundings,
    histogram: Histogram,
    evader: Evader,
    evade_place: Option<Vector2<f64>>,
    evade_next: Timestamp,
    activity: Activity,
    goal: Option<Goal>,
    path: Path,
    /// Corner of the path that the vehicle is flying to.
    leg: usize,
    previous_rad: Option<f64>,
    /// Heading kept while none is asked for, rad.
    kept_yaw_rad: f64,
    progress: Progress,
    reset_counter: u8,
    seen: Vec<In<Map>>,
    sectors: [f32; SECTORS],
    route_ned: ArrayVec<In<Ned>, MAX_CORNERS>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Progress {
    best_left_m: f64,
    since: Option<Timestamp>,
}

impl Navigator {
    /// For a vehicle of this radius on this plan.
    #[must_use]
    pub fn new(
        plan: Arc<FloorPlan>,
        anchor: MapAnchor,
        radius_m: f64,
        params: PlannerParams,
        vfh: VfhParams,
    ) -> Self {
        let size_m = [
            plan.width() as f64 * plan.resolution_m(),
            plan.height() as f64 * plan.resolution_m(),
        ];
        Self {
            anchor,
            radius_m,
            router: Router::new(Arc::clone(&plan), radius_m, &params),
            walls: WallRaster::new(&plan),
            wall_distance: plan.distance_field(0.6),
            grid: CertaintyGrid::new(plan.origin(), size_m, &vfh),
            coverage: Coverage::default(),
            tracker: Tracker::default(),
            recent: sight::RecentReturns::default(),
            surroundings: Surroundings::default(),
            histogram: Histogram::new(&vfh, radius_m),
            evader: Evader::default(),
            evade_place: None,
            evade_next: Timestamp::ZERO,
            activity: Activity::Idle,
            goal: None,
            path: Path::new(),
            leg: 0,
            previous_rad: None,
            kept_yaw_rad: 0.0,
            progress: Progress::default(),
            reset_counter: 0,
            seen: Vec::with_capacity(SEEN_MAX),
            sectors: [f32::INFINITY; SECTORS],
            route_ned: ArrayVec::new(),
            params,
            vfh,
        }
    }

    /// Takes over new tuning. Rebuilds tables (about a millisecond): for set-up and the ground, not for every tick.
    pub fn set_params(&mut self, params: PlannerParams, vfh: VfhParams) {
        self.router.set_params(&params);
        self.grid.set_params(&vfh);
        self.histogram = Histogram::new(&vfh, self.radius_m);
        (self.params, self.vfh) = (params, vfh);
    }

    /// Flies to a place, then hovers there. A place less than 0.4 m away is only hovered at.
    ///
    /// # Errors
    /// [`RouteError`] says why not; the old goal stays.
    pub fn set_goal(&mut self, goal: Goal, nav: &NavState) -> Result<(), RouteError> {
        if !goal.position.is_finite() || goal.heading.is_some_and(|h| !h.is_finite()) {
            return Err(RouteError::NotFinite);
        }
        let near = (goal.position - nav.position).norm_xy() < HOVER_M;
        if !near {
            let path = self.search(goal.position, nav)?;
            self.follow(path);
        }
        self.begin(
            goal,
            nav,
            if near {
                Activity::Hover
            } else {
                Activity::Travel
            },
        );
        Ok(())
    }

    /// Hovers at a place without a way: where the vehicle is, or close to it. Never refused.
    pub fn hold(&mut self, position: In<Ned>, heading: Option<f64>, nav: &NavState) {
        let position = if position.is_finite() {
            position
        } else {
            nav.position
        };
        let goal = Goal {
            position,
            heading: heading.filter(|h| h.is_finite()),
            speed_mps: None,
        };
        self.begin(goal, nav, Activity::Hover);
    }

    /// Forgets the goal.
    pub fn clear(&mut self) {
        (self.goal, self.activity) = (None, Activity::Idle);
        self.path.clear();
        self.route_ned.clear();
    }

    /// The goal.
    #[must_use]
    pub const fn goal(&self) -> Option<Goal> {
        self.goal
    }

    /// Corners of the way, for the ground.
    #[must_use]
    pub fn route(&self) -> &[In<Ned>] {
        &self.route_ned
    }

    /// Distance to the nearest obstacle, seen or on the plan, per sector of 5 degrees clockwise from north, m from the
    /// vehicle's centre; infinite beyond the window. As of the last step.
    #[must_use]
    pub const fn sectors(&self) -> &[f32; SECTORS] {
        &self.sectors
    }

    /// The router, for checking plans against the same walls.
    pub const fn router_mut(&mut self) -> &mut Router {
        &mut self.router
    }

    /// People around, for the console.
    #[must_use]
    pub const fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    fn begin(&mut self, goal: Goal, nav: &NavState, activity: Activity) {
        if activity == Activity::Hover {
            self.path.clear();
            self.route_ned.clear();
        }
        (self.goal, self.activity) = (Some(goal), activity);
        self.kept_yaw_rad = goal.heading.unwrap_or_else(|| nav.yaw_rad());
        (self.previous_rad, self.progress) = (None, Progress::default());
        (self.evader, self.evade_place) = (Evader::default(), None);
        self.histogram.clear();
    }

    /// Searches with everything that was seen and is still believed.
    fn search(&mut self, to: In<Ned>, nav: &NavState) -> Result<Path, RouteError> {
        let (from, to) = (self.anchor.to_map(nav.position), self.anchor.to_map(to));
        let seen = &mut self.seen;
        seen.clear();
        self.grid
            .around(from, SEEN_RADIUS_M, nav.at, |p, certainty| {
                if certainty >= OBSTACLE && seen.len() < SEEN_MAX {
                    seen.push(p);
                }
            });
        match self.router.find(from, to, &self.seen) {
            // What was seen may have gone since: better to go and look than to refuse.
            Err(RouteError::NoWay) if !self.seen.is_empty() => self.router.find(from, to, &[]),
            found => found,
        }
    }

    fn follow(&mut self, path: Path) {
        self.route_ned.clear();
        self.route_ned
            .extend(path.iter().map(|p| self.anchor.to_ned(*p)));
        (self.path, self.leg) = (path, 1);
    }

    /// What to do now.
    pub fn step(&mut self, now: Timestamp, nav: &NavState) -> Steering {
        let Some(goal) = self.goal else {
            return stand(nav, nav.position.z(), self.kept_yaw_rad, f64::INFINITY);
        };
        let known = nav.health.position && nav.position.is_finite() && nav.velocity.is_finite();
        if !known {
            return stand(nav, goal.position.z(), nav.yaw_rad(), f64::INFINITY);
        }
        self.follow_relocalisation(nav);
        let here = self.anchor.to_map(nav.position);
        self.look_around(now, here, nav);
        match self.activity {
            Activity::Travel => self.travel(now, nav, here, &goal),
            Activity::Hover | Activity::Idle => self.hover(now, nav, here, &goal),
        }
    }

    /// A jump of the published pose makes everything seen before meaningless and the way begin elsewhere.
    fn follow_relocalisation(&mut self, nav: &NavState) {
        if nav.localization.reset_counter == self.reset_counter {
            return;
        }
        self.reset_counter = nav.localization.reset_counter;
        self.grid.clear();
        self.tracker.clear();
        self.recent.clear();
        self.histogram.clear();
        if let (Activity::Travel, Some(goal)) = (self.activity, self.goal)
            && let Ok(path) = self.search(goal.position, nav)
        {
            self.follow(path);
        }
    }

    /// Collects the obstacles around.
    fn look_around(&mut self, now: Timestamp, here: In<Map>, nav: &NavState) {
        let walls = nav.health.position.then_some(&self.walls);
        let person_radius_m = self.params.person_radius_m;
        let discs = self
            .tracker
            .tracks()
            .iter()
            .filter(|t| t.is_confirmed())
            .map(|t| {
                let p = t.position_at(now);
                Disc {
                    centre: In::new(p.x, p.y, 0.0),
                    radius_m: person_radius_m,
                }
            });
        self.surroundings
            .collect(now, here, self.vfh.window_m, walls, &self.grid, discs);
        self.surroundings.nearest_by_sector(&mut self.sectors);
        // Plan sectors run counter-clockwise from plan x, the ground's clockwise from north.
        let plan_sectors = self.sectors;
        for (k, out) in self.sectors.iter_mut().enumerate() {
            *out = plan_sectors[sector_of(self.anchor.yaw_to_map(middle_of(k)))];
        }
    }

    fn hover(&mut self, now: Timestamp, nav: &NavState, here: In<Map>, goal: &Goal) -> Steering {
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
        // Somebody new or walking is kept in sight; else the nose swings through the gaps.
        let heading = match self.turn_to_somebody(now, nav, here) {
            Some(turn) => wrap_pi(nav.yaw_rad() + turn),
            None => wrap_pi(self.kept_yaw_rad + self.swing(now)),
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

    /// The nose's swing while hovering, rad: only for a ring with gaps.
    fn swing(&self, now: Timestamp) -> f64 {
        if !self.params.evade || !self.coverage.has_gaps(now) {
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
            .filter(|t| t.has_walked() || t.is_newer_than(now, NEW_S))
            .map(|t| t.position_at(now + LOOK_LEAD) - xy(here))
            .filter(|d| d.norm() < LOOK_M)
            .min_by(|a, b| a.norm().total_cmp(&b.norm()))?;
        let bearing = self.anchor.yaw_to_ned(libm::atan2(nearest.y, nearest.x)) - nav.yaw_rad();
        // The heading loop is slow at small errors, people are not.
        Some((2.0 * self.coverage.turn_to_see(now, bearing)).clamp(-1.0, 1.0))
    }

    /// The place to step aside to, thought over every few steps.
    fn step_aside(
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
    fn evading(
        &mut self,
        now: Timestamp,
        nav: &NavState,
        here: In<Map>,
        goal: &Goal,
        place: Vector2<f64>,
        left_m: f64,
    ) -> Steering {
        let v = velocity_to(place, xy(here), EVADE_MPS);
        let velocity = self.world_vector(v);
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

    fn travel(&mut self, now: Timestamp, nav: &NavState, here: In<Map>, goal: &Goal) -> Steering {
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
        let speed = self.speed(now, nav, goal, unit, &pull, left_m);
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
        nav: &NavState,
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
        let bearing = self.anchor.yaw_to_ned(chosen_rad) - nav.yaw_rad();
        if !self.coverage.sees(now, bearing) {
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

    /// A horizontal vector of the plan in the world.
    fn world_vector(&self, v: Vector2<f64>) -> In<Ned> {
        let zero = self.anchor.to_ned(In::zero());
        (self.anchor.to_ned(In::new(v.x, v.y, 0.0)) - zero).with_z(0.0)
    }
}

/// Stay where you are.
fn stand(nav: &NavState, down_m: f64, yaw_rad: f64, left_m: f64) -> Steering {
    let down = if down_m.is_finite() {
        down_m
    } else {
        nav.position.z()
    };
    Steering {
        setpoint: Setpoint::Velocity {
            velocity: In::zero(),
            down_m: down.is_finite().then_some(down),
            heading: if yaw_rad.is_finite() {
                Heading::Yaw(yaw_rad)
            } else {
                Heading::Rate(0.0)
            },
        },
        distance_left_m: left_m,
        arrived: false,
        state: SteeringState::Blocked,
    }
}

fn xy<F>(p: In<F>) -> Vector2<f64> {
    Vector2::new(p.x(), p.y())
}

fn distance(a: In<Map>, b: In<Map>) -> f64 {
    libm::hypot(a.x() - b.x(), a.y() - b.y())
}

/// The point of a segment nearest to p.
fn nearest_on(a: In<Map>, b: In<Map>, p: In<Map>) -> In<Map> {
    let (ab, ap) = (xy(b - a), xy(p - a));
    let length = ab.norm_squared();
    let t = if length > 1e-12 {
        (ap.dot(&ab) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (a + (b - a) * t).with_z(0.0)
}
