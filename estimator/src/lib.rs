//! Where the vehicle is: an error-state Kalman filter and Monte Carlo localization on a floor plan.
//!
//! Sans-IO: samples go in with their time stamps, [`NavState`](vehicle::NavState) comes out; no clock, no thread, no
//! file, no random number but from the given seed. After construction nothing allocates; the global search runs outside
//! the loop, as a pure function.
//!
//! ```text
//!  ImuSample ------+--> odometry filter --steps--> particles --pose on the plan--+
//!  AttitudeSample -+         (never sees the map)      ^                         v
//!  DownRange, Baro-+                               RangeScan             navigation filter --> NavState
//!  FlowSample -----+-------------------------------------------------------------^
//! ```
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`Estimator`] | the whole: inputs, both filters, localization, health |
//! | [`attitude`] | attitude of a 9-axis sensor alone, without a flight controller or a map |
//! | [`kalman`] | the error-state Kalman filter; one observation model per file in [`kalman::aid`] |
//! | [`mcl`] | Monte Carlo localization, global search, when to believe them |
//! | [`imu`] | uQuad's inertial unit: bytes to metres and radians |
//! | [`thesis`] | uQuad's own filter, selectable, proven on its recording |
//! | [`utm`] | latitude and longitude to metres |
//! | [`EstimatorParams`] | every tunable |
//! | [`Diagnostics`] | what was seen and refused |
//!
//! The world is NED about home, the body FRD. Particles, steps and beams inside [`mcl`] are in the plan's way of drawing:
//! x forward or right, y left or up, yaw counter-clockwise ([`mcl::Planar`]); [`vehicle::MapAnchor`] is the only bridge.
//!
//! ```
//! use estimator::{Estimator, EstimatorParams};
//! use std::sync::Arc;
//! use vehicle::floor_plan::Cell;
//! use vehicle::{AttitudeSample, FloorPlan, ImuSample, In, MapPose, Timestamp};
//!
//! // A room of 2 x 2 m.
//! let cells = (0..40 * 40)
//!     .map(|i| if [0, 39].contains(&(i % 40)) || [0, 39].contains(&(i / 40)) { Cell::Occupied } else { Cell::Free })
//!     .collect();
//! let plan = Arc::new(FloorPlan::from_cells(40, 0.05, [0.0, 0.0], cells).unwrap());
//! let anchor = plan.anchor();
//! let mut estimator = Estimator::new(EstimatorParams::default(), Some(plan), anchor, 42);
//! estimator.set_landed(true);
//! estimator.start_at(Timestamp::ZERO, MapPose::new(1.0, 0.5, 0.0), 0.05, 0.05);
//! for k in 1..=40 {
//!     let at = Timestamp::from_ms(25 * k);
//!     estimator.attitude(&AttitudeSample { at, roll_rad: 0.0, pitch_rad: 0.0, heading_rad: 0.3 });
//!     estimator.imu(&ImuSample { at, accel_mps2: In::new(0.0, 0.0, -9.80665), gyro_radps: In::zero(), mag: None });
//!     estimator.update(at);
//! }
//! let state = estimator.state();
//! assert!(state.health.attitude && !state.health.position, "no ranger has spoken yet");
//! // Plan x is east, plan y is north here, and plan yaw 0 looks east.
//! assert!((state.position.y() - 1.0).abs() < 0.01 && (state.position.x() - 0.5).abs() < 0.01);
//! assert!((state.yaw_rad() - std::f64::consts::FRAC_PI_2).abs() < 0.01);
//! ```
//!
//! Joan Sola, "Quaternion kinematics for the error-state Kalman filter" (2017). Sebastian Thrun, Wolfram Burgard, Dieter
//! Fox, "Probabilistic Robotics" (2005).

pub mod attitude;
mod diagnostics;
mod estimator;
mod freshness;
pub mod imu;
pub mod kalman;
pub mod mcl;
mod params;
pub mod thesis;
mod trail;
pub mod utm;

pub use diagnostics::Diagnostics;
pub use estimator::{Estimator, OdometryPose};
pub use mcl::search::{SearchRequest, SearchResult, search};
pub use params::{EstimatorParams, MclVariant};
