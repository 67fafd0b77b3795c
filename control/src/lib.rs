//! From set point to sticks: the outer loops that fly a Betaflight-class controller in angle mode over MSP.
//!
//! The flight controller keeps the attitude; this crate closes position, velocity, height and heading around it through
//! RC sticks, against 20 to 60 ms of dead time and about 100 ms of attitude response. Pure state machines: no clock, no
//! input or output, nothing allocated.
//!
//! | Module | Does |
//! | --- | --- |
//! | [`controller`] | [`Controller`]: one step from [`vehicle::Setpoint`] to [`vehicle::Sticks`], degrading when the state does |
//! | [`reference`](mod@reference) | the curve on which a place is approached, limited in speed, acceleration and jerk |
//! | [`position`] | position P, velocity PID, acceleration and jerk limits, tilt |
//! | [`altitude`] | height P, climb PI |
//! | [`thrust`] | thrust to throttle, with the hover command learnt in flight |
//! | [`lateness`] | what is left of the gains when the loop runs late |
//! | [`heading`] | yaw P with rate limit |
//! | [`stick_curve`] | the inverse of the firmware's stick curves |
//! | [`takeoff_land`] | spool-up until lift-off, descent, touch-down |
//! | [`outer_lqr`] | LQR on the outer-loop model, dead time included: parameter `variant` |
//! | [`snsi`] | SNSI's PID family and its controllers with priorities: the same parameter |
//! | [`tuning`] | gains from a relay test, figures of a step: `kestrel tune` |
//! | [`params`] | [`ControlParams`] |
//! | [`state_feedback`] | uQuad's law, states to motor speeds: [`proportional`] gains and [`integral`] action |
//! | [`setpoint_list`] | uQuad's list of set points, 17 numbers a line |
//! | [`lqr`] | optimal gains for it: linearise, discretise, solve |
//!
//! ```
//! use control::{ControlParams, Controller, Phase};
//! use vehicle::{Airframe, Heading, In, NavHealth, NavState, Setpoint, Timestamp};
//!
//! let mut controller = Controller::new(ControlParams::default(), Airframe::default());
//! let healthy = NavHealth { attitude: true, height: true, velocity: true, position: true };
//! let nav = NavState { position: In::new(0.0, 0.0, -1.0), height_m: 1.0, health: healthy, ..NavState::default() };
//! let north = Setpoint::Hover { position: In::new(1.0, 0.0, -1.0), heading: Heading::Yaw(0.0) };
//! let mut out = controller.step(Timestamp::ZERO, 0.01, &nav, &north, Phase::Flying);
//! for i in 1..50 {
//!     out = controller.step(Timestamp::from_ms(10 * i), 0.01, &nav, &north, Phase::Flying);
//! }
//! assert!(out.sticks.pitch < 0.0, "to go north with the nose north, the nose goes down");
//! ```
//!
//! References: the cascade and its parameter names follow PX4's multicopter position control; stick curves are those of
//! Betaflight 4.5 (`ACTUAL` rates) and INAV.

pub mod altitude;
pub mod controller;
pub mod heading;
pub mod integral;
pub mod lateness;
pub mod lqr;
pub mod outer_lqr;
pub mod params;
pub mod position;
pub mod proportional;
pub mod reference;
pub mod setpoint_list;
pub mod snsi;
pub mod state_feedback;
pub mod stick_curve;
pub mod takeoff_land;
pub mod thrust;
pub mod tuning;

pub use controller::{ControlOutput, Controller, Hold, Phase};
pub use params::{ControlParams, CurveKind, Variant};
