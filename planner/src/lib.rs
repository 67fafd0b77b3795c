//! Where to fly next: missions, routes on the floor plan, obstacle avoidance, giving way to people.
//!
//! Two layers. The route ([`route`]) is searched on the plan when the goal changes or the way is blocked; every step a
//! point one metre ahead on it is steered for by VFH+ ([`vfh`]), which knows the plan's walls and what the rangers saw.
//! Near the goal the position controller takes over, and the vehicle gives way to people who come close ([`evade`]).
//! Pure state machines: no clock, no input or output; after construction nothing allocates.
//!
//! | Module | Does |
//! | --- | --- |
//! | [`mission`] | [`Plan`], [`Mission`]: items in order, pause and resume, [`mission::check`] |
//! | [`route`] | [`Router`]: A* on the inflated plan |
//! | [`navigator`] | [`Navigator`]: goal and state to [`vehicle::Setpoint`]; the limiter of manual flight |
//! | [`vfh`] | certainty grid, polar histogram, openings, steering |
//! | [`potential`] | potential fields, SNSI's first planner, selectable for comparison |
//! | [`trajectory`] | orbit, figure eight, curves of least jerk through way points |
//! | [`tracks`] | people: what moves and is not on the plan |
//! | [`evade`] | where to step aside |
//! | [`coverage`] | which directions the rangers look into |
//! | [`fence`] | where the vehicle may be |
//! | [`patrol`] | rounds over rooms and sweeps of the floor, made on the ground |
//! | [`params`] | [`PlannerParams`] |
//! | [`episode`] | a flight through obstacles nobody knows of: `kestrel eval avoid`, the BARN campaign |
//!
//! ```
//! use planner::{Goal, Navigator, PlannerParams, SteeringState, VfhParams};
//! use std::sync::Arc;
//! use vehicle::floor_plan::Cell;
//! use vehicle::{FloorPlan, In, NavHealth, NavState, Setpoint, Timestamp};
//!
//! // An empty room of 6 m by 4 m with walls of one cell; home is the plan's origin, north is up on paper.
//! let wall = |i: usize| [0, 119].contains(&(i % 120)) || [0, 79].contains(&(i / 120));
//! let cells = (0..120 * 80).map(|i| if wall(i) { Cell::Occupied } else { Cell::Free }).collect();
//! let plan = Arc::new(FloorPlan::from_cells(120, 0.05, [0.0, 0.0], cells)?);
//! let anchor = plan.anchor();
//! let mut navigator = Navigator::new(plan, anchor, 0.16, PlannerParams::default(), VfhParams::default());
//!
//! let health = NavHealth { attitude: true, height: true, velocity: true, position: true };
//! let nav = NavState { position: In::new(1.0, 1.0, -1.0), height_m: 1.0, health, ..NavState::default() };
//! let goal = Goal { position: In::new(2.0, 4.0, -1.0), heading: None, speed_mps: None };
//! navigator.set_goal(goal, &nav)?;
//! let steering = navigator.step(Timestamp::from_ms(20), &nav);
//! assert_eq!(steering.state, SteeringState::Clear);
//! assert!(matches!(steering.setpoint, Setpoint::Velocity { velocity, .. } if velocity.y() > 0.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! References: J. Borenstein and Y. Koren, "The vector field histogram", IEEE Trans. Robotics and Automation 7(3), 1991;
//! I. Ulrich and J. Borenstein, "VFH+: reliable obstacle avoidance for fast mobile robots", ICRA 1998; P. Hart, N. Nilsson
//! and B. Raphael, "A formal basis for the heuristic determination of minimum cost paths", 1968.

pub mod coverage;
pub mod episode;
pub mod evade;
pub mod fence;
pub mod mission;
pub mod navigator;
pub mod params;
pub mod patrol;
pub mod potential;
pub mod route;
pub mod tracks;
pub mod trajectory;
pub mod vfh;

pub use mission::{
    Leg, Mission, MissionState, MissionStep, Plan, PlanFault, PlanItem, PlanRefusal, Turn, check,
};
pub use navigator::{Goal, Navigator, Steering, SteeringState};
pub use params::PlannerParams;
pub use route::{RouteError, Router};
pub use vfh::{VfhParams, VfhVariant};
