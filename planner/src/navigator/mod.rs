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

mod classic;
mod foresight;
mod hover;
mod limiter;
mod sight;
mod travel;

use crate::coverage::Coverage;
use crate::evade::Evader;
use crate::fence::{Fence, Site, Zone};
use crate::params::PlannerParams;
use crate::route::{CLEARANCE_MAX_M, MAX_CORNERS, Path, RouteError, Router};
use crate::tracks::Tracker;
use crate::vfh::config::{VfhParams, VfhVariant};
use crate::vfh::grid::{CertaintyGrid, OBSTACLE};
use crate::vfh::histogram::{Histogram, Window};
use crate::vfh::surroundings::{Disc, Surroundings, WallRaster};
use crate::vfh::{SECTORS, middle_of, sector_of};
use arrayvec::ArrayVec;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vehicle::floor_plan::DistanceField;
use vehicle::{FloorPlan, Heading, In, Map, MapAnchor, NavState, Ned, Setpoint, Timestamp};

/// Within this distance of the goal the position controller takes over, m.
const HOVER_M: f64 = 0.4;
/// Obstacles weaker than this do not stop anything: a certainty of 6 of 15.
const SURE_WEIGHT: f64 = 0.16;
/// A place on the plan that is not confirmed any more holds for this long, s, carried on by the vehicle's velocity: flow drifts
/// some centimetres meanwhile.
const CARRIED_S: f64 = 10.0;
/// Most cells added to one search.
const SEEN_MAX: usize = 1024;
/// How far around seen obstacles are added to a search, m.
const SEEN_RADIUS_M: f64 = 6.0;

/// Points of borders kept for the avoidance, and how far apart they are at least, m.
const BORDER_MAX: usize = 4096;
const BORDER_STEP_M: f64 = 0.1;

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

/// What obstacle avoidance chose last, for people.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Avoidance {
    /// How the way looks.
    pub state: SteeringState,
    /// Direction chosen by the histogram, counter-clockwise from plan x, rad; none if nothing was to choose.
    pub chosen_rad: Option<f64>,
    /// Nearest obstacle in any direction, from the vehicle's centre, m; infinite beyond the window.
    pub nearest_m: f64,
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
    window: Window,
    /// Only for the thesis' variant.
    counts: Option<Box<classic::Counts>>,
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
    /// When the way was last looked over, and when it was last planned.
    looked_over: Timestamp,
    planned: Timestamp,
    reset_counter: u8,
    site: Arc<Site>,
    home: In<Ned>,
    /// Points of the fence's border, on the plan.
    border: Vec<In<Map>>,
    /// Points of the borders of the plan's no-fly zones.
    no_fly: Vec<In<Map>>,
    /// When the place on the plan was last known.
    placed: Option<Timestamp>,
    seen: Vec<In<Map>>,
    sectors: [f32; SECTORS],
    state: SteeringState,
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
        let zones = plan.no_fly.iter().map(|z| Zone::keep_out(z)).collect();
        let mut no_fly = Vec::new();
        outline(&Fence::new(zones), |p| {
            no_fly.push(In::new(p[0], p[1], 0.0))
        });
        let field = plan.distance_field(CLEARANCE_MAX_M);
        let mut router = Router::with_field(Arc::clone(&plan), &field, radius_m, &params);
        router.measure_from(anchor.to_map(In::zero()));
        Self {
            anchor,
            radius_m,
            router,
            walls: WallRaster::new(&plan),
            wall_distance: field.cut(0.6),
            grid: CertaintyGrid::new(plan.origin(), size_m, &vfh),
            coverage: Coverage::default(),
            tracker: Tracker::default(),
            recent: sight::RecentReturns::default(),
            surroundings: Surroundings::default(),
            histogram: Histogram::new(&vfh, radius_m),
            window: Window::new(vfh.window_m),
            counts: classic::Counts::for_variant(vfh.variant),
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
            looked_over: Timestamp::ZERO,
            planned: Timestamp::ZERO,
            reset_counter: 0,
            site: Arc::default(),
            home: In::zero(),
            border: Vec::with_capacity(BORDER_MAX),
            no_fly,
            placed: None,
            seen: Vec::with_capacity(SEEN_MAX),
            sectors: [f32::INFINITY; SECTORS],
            state: SteeringState::default(),
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
        self.window = Window::new(vfh.window_m);
        if vfh.variant != self.vfh.variant {
            self.counts = classic::Counts::for_variant(vfh.variant);
        }
        (self.params, self.vfh) = (params, vfh);
    }

    /// Takes over what a station drew; gives the old one back to be freed elsewhere. Goals and ways keep inside from now on;
    /// what is flown to already is not looked at again. Takes a millisecond or two, so not for every tick.
    pub fn set_site(&mut self, site: Arc<Site>) -> Arc<Site> {
        self.router.set_fence(&site.fence, &self.anchor);
        self.set_home(self.home);
        self.border.clear();
        let (border, anchor) = (&mut self.border, &self.anchor);
        outline(&site.fence, |p| {
            if border.len() < BORDER_MAX {
                border.push(anchor.to_map(In::new(p[0], p[1], 0.0)));
            }
        });
        core::mem::replace(&mut self.site, site)
    }

    /// True if the goal lies beyond the fence, or too near to its border to be one.
    #[must_use]
    pub fn is_goal_fenced_off(&self) -> bool {
        self.goal.is_some_and(|g| {
            let room_m = self.router.room_m(self.anchor.to_map(g.position));
            room_m < self.radius_m
        })
    }

    /// What a station drew.
    #[must_use]
    pub const fn site(&self) -> &Arc<Site> {
        &self.site
    }

    /// Home is elsewhere now: measures the ways to it, which takes some milliseconds.
    pub fn set_home(&mut self, home: In<Ned>) {
        self.home = home;
        self.router.measure_from(self.anchor.to_map(home));
    }

    /// Length of the way home on the plan, m, whatever was seen; none where none leads there or the place is not known.
    #[must_use]
    pub fn way_home_m(&self, nav: &NavState) -> Option<f64> {
        let known = nav.health.position && nav.position.is_finite();
        known
            .then(|| self.router.measured_m(self.anchor.to_map(nav.position)))
            .flatten()
    }

    /// Length of the way from here to a place, m; none if there is none.
    pub fn way_m(&mut self, to: In<Ned>, nav: &NavState) -> Option<f64> {
        let path = self.search(to, nav).ok()?;
        Some(path.windows(2).map(|w| distance(w[0], w[1])).sum())
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

    /// Whether the vehicle can be at all of these places, m.
    ///
    /// # Errors
    /// [`RouteError`] of the first where it cannot.
    pub fn check_places(&self, places: impl Iterator<Item = In<Ned>>) -> Result<(), RouteError> {
        for place in places {
            self.router.check_place(self.anchor.to_map(place))?;
        }
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

    /// Nowhere is gone to any more: somebody else says how fast to fly.
    pub const fn forget_goal(&mut self) {
        self.goal = None;
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

    /// What was chosen in the last step.
    #[must_use]
    pub fn avoidance(&self) -> Avoidance {
        Avoidance {
            state: self.state,
            chosen_rad: self.previous_rad,
            nearest_m: self
                .sectors
                .iter()
                .copied()
                .fold(f32::INFINITY, f32::min)
                .into(),
        }
    }

    /// The histogram of the last step on the way: sectors counter-clockwise from plan x, for the console.
    #[must_use]
    pub const fn histogram(&self) -> &Histogram {
        &self.histogram
    }

    /// Direction flown in, chosen by VFH: counter-clockwise from plan x, rad. None if none was free or nothing is flown to.
    #[must_use]
    pub const fn chosen_rad(&self) -> Option<f64> {
        self.previous_rad
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
        let is_remembered = self.vfh.variant == VfhVariant::Plus;
        let seen = &mut self.seen;
        seen.clear();
        self.grid
            .around(from, SEEN_RADIUS_M, nav.at, |p, certainty| {
                if is_remembered && certainty >= OBSTACLE && seen.len() < SEEN_MAX {
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
        let steering = self.steer(now, nav);
        self.state = steering.state;
        steering
    }

    fn steer(&mut self, now: Timestamp, nav: &NavState) -> Steering {
        let Some(goal) = self.goal else {
            return stand(nav, nav.position.z(), self.kept_yaw_rad, f64::INFINITY);
        };
        let known = nav.health.position && nav.position.is_finite() && nav.velocity.is_finite();
        if !known {
            return stand(nav, goal.position.z(), nav.yaw_rad(), f64::INFINITY);
        }
        self.follow_relocalisation(nav);
        let here = self.anchor.to_map(nav.position);
        self.placed = Some(now);
        self.look_around(now, here);
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
        self.placed = None;
        self.grid.clear();
        self.tracker.clear();
        self.recent.clear();
        self.histogram.clear();
        if let Some(counts) = &mut self.counts {
            counts.clear();
        }
        if let (Activity::Travel, Some(goal)) = (self.activity, self.goal)
            && let Ok(path) = self.search(goal.position, nav)
        {
            self.follow(path);
        }
    }

    /// True if the plan's walls are where the estimate says: the place is known, or was a moment ago and was carried on by
    /// velocity since.
    fn place_holds(&mut self, now: Timestamp, nav: &NavState) -> bool {
        if !nav.position.is_finite() {
            return false;
        }
        if nav.health.position {
            self.placed = Some(now);
            return true;
        }
        let is_carried = nav.health.velocity && nav.velocity.is_finite();
        is_carried
            && self
                .placed
                .is_some_and(|at| now.seconds_since(at) < CARRIED_S)
    }

    /// Collects the obstacles around; where the vehicle is on the plan must hold.
    fn look_around(&mut self, now: Timestamp, here: In<Map>) {
        self.grid.stand_on(here, self.radius_m, now);
        let around = &mut self.surroundings;
        around.begin(here, self.vfh.window_m);
        if self.router.room_m(here) > 0.0 {
            for p in &self.no_fly {
                around.add_border(*p);
            }
            if self.activity == Activity::Travel {
                for p in &self.border {
                    around.add_border(*p);
                }
            }
        }
        around.add_cells(&self.grid, now);
        around.add_walls(&self.walls);
        let believed = self.recent.fresh(now).filter(|r| r.is_supported);
        for echo in believed.filter_map(|r| r.unexplained) {
            around.add_echo(echo);
        }
        // Who does not give way to people takes them for what stands about: the grid has them.
        let people = self.tracker.tracks().iter().filter(|_| self.params.evade);
        for somebody in people.filter(|t| t.is_confirmed()) {
            let p = somebody.position_at(now);
            around.add_disc(Disc {
                centre: In::new(p.x, p.y, 0.0),
                radius_m: self.params.person_radius_m,
            });
        }
        self.surroundings.nearest_by_sector(&mut self.sectors);
        // Plan sectors run counter-clockwise from plan x, the ground's clockwise from north.
        let plan_sectors = self.sectors;
        for (k, out) in self.sectors.iter_mut().enumerate() {
            *out = plan_sectors[sector_of(self.anchor.yaw_to_map(middle_of(k)))];
        }
    }

    /// A horizontal vector of the plan in the world.
    fn world_vector(&self, v: Vector2<f64>) -> In<Ned> {
        let zero = self.anchor.to_ned(In::zero());
        (self.anchor.to_ned(In::new(v.x, v.y, 0.0)) - zero).with_z(0.0)
    }
}

/// Calls `see` with points of the borders of a fence; not where one zone to stay in goes over into another.
fn outline(fence: &Fence, mut see: impl FnMut([f64; 2])) {
    for zone in fence.zones() {
        zone.shape.outline(BORDER_STEP_M, |p| {
            if fence.room_m(p) < 0.5 * BORDER_STEP_M {
                see(p);
            }
        });
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
