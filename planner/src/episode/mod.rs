//! One flight through a field of round obstacles that the planner knows nothing about: what `kestrel eval avoid` and the
//! campaign on the BARN courses fly.
//!
//! The pilot is the production [`Navigator`] on a plan without a single wall, told only where it is and what the rangers
//! read; the world, the rangers' faults and the vehicle's inertia are here, and nothing of them reaches the planner.
//!
//! | Module | Does |
//! | --- | --- |
//! | [`course`] | the obstacles: rays, cones, contact |
//! | [`rangers`] | what the sensors make of them: rate, latency, faults |
//! | [`standard`] | courses that every method is asked about: door, corridor, dead end ... |
//! | [`craft`] | how the vehicle answers a velocity: dead time, lag, at most 3 m/s2 |
//!
//! ```
//! use planner::episode::{Course, Episode, Sensor};
//!
//! let course = Course::from_csv("x_m,y_m,radius_m\n2.0,0.05,0.3\n")?;
//! let episode = Episode::new([0.0, 0.0, 0.0], [5.0, 0.0], Sensor::Laser270);
//! let flown = episode.fly(&course, |_| ());
//! assert!(flown.success && flown.min_clearance_m > 0.0);
//! # Ok::<(), planner::episode::CourseError>(())
//! ```
//!
//! Reference: D. Perille, A. Truong, X. Xiao, P. Stone, "Benchmarking metric ground navigation", SSRR 2020 (course, clock,
//! success within one metre of the goal in 100 s).

pub mod course;
pub mod craft;
mod noise;
pub mod rangers;
pub mod standard;

pub use course::{Course, CourseError};
pub use rangers::Sensor;

use crate::{Goal, Navigator, PlannerParams, VfhParams};
use craft::Craft;
use rangers::Ring;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, Frd, In, MapAnchor, NavHealth, NavState, Ned, Rot, Timestamp};

/// Period of the planner, s: as in flight.
pub const STEP_S: f64 = 0.02;
/// The goal counts as reached within this distance, m.
pub const REACHED_M: f64 = 1.0;
/// The clock starts this far from the start, m.
const CLOCK_STARTS_M: f64 = 0.1;
/// The empty plan reaches so far beyond start and goal, m.
const PLAN_MARGIN_M: f64 = 6.0;
const PLAN_CELL_M: f64 = 0.05;
/// Height of the flight, m.
const HEIGHT_M: f64 = 1.0;

/// What is to be flown, and with what.
#[derive(Clone, Debug)]
pub struct Episode {
    /// Where it starts, m, and the heading there, rad counter-clockwise from x.
    pub start: [f64; 3],
    /// Where it goes, m.
    pub goal: [f64; 2],
    /// The rangers.
    pub sensor: Sensor,
    /// Radius of the vehicle, m.
    pub radius_m: f64,
    /// Largest speed, m/s.
    pub vmax_mps: f64,
    /// Seed of the rangers' noise.
    pub seed: u64,
    /// Given up after this time, s.
    pub limit_s: f64,
    /// Missions, routes.
    pub params: PlannerParams,
    /// Obstacle avoidance.
    pub vfh: VfhParams,
}

/// Where the vehicle is at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time since the start, s.
    pub t_s: f64,
    /// Place, m.
    pub x_m: f64,
    /// Place, m.
    pub y_m: f64,
    /// Heading, rad counter-clockwise from x.
    pub yaw_rad: f64,
    /// Hull to the nearest obstacle, m; infinite without any.
    pub clearance_m: f64,
}

/// How a flight went.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flown {
    /// The goal was reached in time without touching anything.
    pub success: bool,
    /// The hull touched an obstacle.
    pub collided: bool,
    /// Neither in time.
    pub timeout: bool,
    /// From 0.1 m after the start to the end, s.
    pub time_s: f64,
    /// Length of the way, m.
    pub path_m: f64,
    /// Smallest distance from hull to obstacle, m; negative when touching.
    pub min_clearance_m: f64,
}

impl Flown {
    /// The benchmark's score of a flight on a course whose reference path is `reference_m` long:
    /// `T_opt / clip(T, low T_opt, high T_opt)` with `T_opt` at 2 m/s, 0 without success.
    #[must_use]
    pub fn score(&self, reference_m: f64, low: f64, high: f64) -> f64 {
        if !self.success {
            return 0.0;
        }
        let optimum_s = reference_m / 2.0;
        optimum_s / self.time_s.clamp(low * optimum_s, high * optimum_s)
    }
}

impl Episode {
    /// With the benchmark's vehicle: 0.20 m, 2 m/s, 100 s, seed 1. Nobody walks on these courses, so nobody is given way to.
    #[must_use]
    pub fn new(start: [f64; 3], goal: [f64; 2], sensor: Sensor) -> Self {
        Self {
            start,
            goal,
            sensor,
            radius_m: 0.2,
            vmax_mps: 2.0,
            seed: 1,
            limit_s: 100.0,
            params: PlannerParams {
                evade: false,
                ..PlannerParams::default()
            },
            vfh: VfhParams::default(),
        }
    }

    /// A plan that shows nothing, around start and goal.
    fn empty_plan(&self) -> Option<Arc<FloorPlan>> {
        let low = |i: usize| self.start[i].min(self.goal[i]) - PLAN_MARGIN_M;
        let high = |i: usize| self.start[i].max(self.goal[i]) + PLAN_MARGIN_M;
        let cells = |i: usize| libm::ceil((high(i) - low(i)) / PLAN_CELL_M).clamp(1.0, 4000.0);
        let (width, height) = (cells(0) as usize, cells(1) as usize);
        let free = vec![Cell::Free; width * height];
        let plan = FloorPlan::from_cells(width, PLAN_CELL_M, [low(0), low(1)], free);
        plan.ok().map(Arc::new)
    }

    /// Flies it. `each` sees every moment, the first and the last included.
    ///
    /// Start and goal that are no numbers or farther apart than a plan can be (200 m) end at once, without success.
    pub fn fly(&self, course: &Course, mut each: impl FnMut(&Moment)) -> Flown {
        let refused = Flown {
            success: false,
            collided: false,
            timeout: true,
            time_s: 0.0,
            path_m: 0.0,
            min_clearance_m: f64::INFINITY,
        };
        let finite = self.start.iter().chain(&self.goal).all(|v| v.is_finite());
        let Some(plan) = self.empty_plan().filter(|_| finite) else {
            return refused;
        };
        // North is up on paper.
        let north_rad = core::f64::consts::FRAC_PI_2;
        let anchor = MapAnchor::new(self.start[0], self.start[1], north_rad);
        let mut navigator = Navigator::new(
            plan,
            anchor,
            self.radius_m,
            self.params.clone(),
            self.vfh.clone(),
        );
        let mut craft = Craft::at(self.start);
        let mut ring = Ring::new(self.sensor, self.seed);
        let goal = Goal {
            position: anchor.to_ned(In::new(self.goal[0], self.goal[1], HEIGHT_M)),
            heading: None,
            speed_mps: Some(self.vmax_mps),
        };
        let mut flown = refused;
        let mut clock_from_s = None;
        let steps = libm::ceil((self.limit_s + 5.0) / STEP_S) as u64;
        for k in 0..steps {
            let t_s = k as f64 * STEP_S;
            let clearance_m = course.clearance_m(craft.place()) - self.radius_m;
            each(&Moment {
                t_s,
                x_m: craft.place()[0],
                y_m: craft.place()[1],
                yaw_rad: craft.yaw_rad(),
                clearance_m,
            });
            flown.min_clearance_m = flown.min_clearance_m.min(clearance_m);
            if clock_from_s.is_none() && away(craft.place(), self.start) >= CLOCK_STARTS_M {
                clock_from_s = Some(t_s);
            }
            flown.time_s = clock_from_s.map_or(0.0, |from| t_s - from);
            flown.collided = clearance_m <= 0.0;
            flown.success = !flown.collided && away(craft.place(), self.goal) <= REACHED_M;
            let waited_s = t_s - clock_from_s.unwrap_or(0.0);
            flown.timeout = !flown.collided && !flown.success && waited_s >= self.limit_s;
            if flown.collided || flown.success || flown.timeout {
                break;
            }
            // A second passes before the first step: nothing begins at the epoch.
            let now = Timestamp::from_us(1_000_000 + libm::round(t_s * 1e6) as u64);
            let nav = state(&craft, &anchor, now);
            for scan in ring.scans(course, &craft, now) {
                navigator.observe(scan, &nav);
            }
            if k == 0 && navigator.set_goal(goal, &nav).is_err() {
                return refused;
            }
            let steering = navigator.step(now, &nav);
            let before = craft.place();
            craft.step(&steering.setpoint, &anchor, STEP_S);
            flown.path_m += away(before, craft.place());
        }
        flown
    }
}

fn away<const N: usize>(p: [f64; 2], q: [f64; N]) -> f64 {
    libm::hypot(p[0] - q[0], p[1] - q[1])
}

/// What the estimator says: on these courses the truth, as the benchmark gives odometry.
fn state(craft: &Craft, anchor: &MapAnchor, now: Timestamp) -> NavState {
    let [x, y] = craft.place();
    let [vx, vy] = craft.velocity();
    let zero = anchor.to_ned(In::zero());
    NavState {
        at: now,
        position: anchor.to_ned(In::new(x, y, HEIGHT_M)),
        velocity: (anchor.to_ned(In::new(vx, vy, 0.0)) - zero).with_z(0.0),
        attitude: Rot::<Frd, Ned>::from_roll_pitch_yaw(
            0.0,
            0.0,
            anchor.yaw_to_ned(craft.yaw_rad()),
        ),
        position_std_m: In::new(0.02, 0.02, 0.02),
        height_m: HEIGHT_M,
        rates_radps: In::new(0.0, 0.0, -craft.yaw_rate_radps()),
        health: NavHealth {
            attitude: true,
            height: true,
            velocity: true,
            position: true,
        },
        ..NavState::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_course_is_flown_straight_with_every_sensor() {
        let course = Course::from_csv("x_m,y_m,radius_m\n").unwrap();
        for sensor in Sensor::ALL {
            let flown = Episode::new([-2.0, 3.0, 1.57], [-2.0, 13.0], sensor).fly(&course, |_| ());
            assert!(flown.success, "{sensor:?}: {flown:?}");
            assert!((8.5..9.6).contains(&flown.path_m), "{sensor:?}: {flown:?}");
        }
    }

    #[test]
    fn the_same_seed_is_the_same_flight() {
        let course = Course::from_csv("x_m,y_m,radius_m\n2,0.1,0.2\n3,-0.6,0.1\n").unwrap();
        let mut episode = Episode::new([0.0; 3], [6.0, 0.0], Sensor::Tof32);
        let first = episode.fly(&course, |_| ());
        assert_eq!(first, episode.fly(&course, |_| ()));
        episode.seed = 2;
        assert_ne!(first, episode.fly(&course, |_| ()));
    }

    #[test]
    fn a_closed_ring_is_a_timeout_and_no_contact() {
        let ring = (0..48).map(|k| {
            let a = core::f64::consts::TAU * f64::from(k) / 48.0;
            format!("{},{},0.1\n", 1.5 * libm::cos(a), 1.5 * libm::sin(a))
        });
        let csv: String = core::iter::once("x_m,y_m,radius_m\n".to_owned())
            .chain(ring)
            .collect();
        let mut episode = Episode::new([0.0; 3], [6.0, 0.0], Sensor::Laser270);
        episode.limit_s = 20.0;
        let flown = episode.fly(&Course::from_csv(&csv).unwrap(), |_| ());
        assert!(flown.timeout && !flown.collided, "{flown:?}");
    }

    #[test]
    fn the_score_is_half_for_one_metre_a_second_and_nothing_for_a_contact() {
        let flown = Flown {
            success: true,
            collided: false,
            timeout: false,
            time_s: 10.0,
            path_m: 10.0,
            min_clearance_m: 0.1,
        };
        assert!((flown.score(10.0, 2.0, 8.0) - 0.5).abs() < 1e-12);
        assert!((flown.score(10.0, 4.0, 8.0) - 0.25).abs() < 1e-12);
        let crashed = Flown {
            success: false,
            ..flown
        };
        assert!(crashed.score(10.0, 2.0, 8.0) == 0.0);
    }
}
