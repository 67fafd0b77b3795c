//! The vocabulary every Kestrel crate shares: time, frames, samples, state, set points, sticks, floor plan, parameters.
//!
//! This crate is a leaf. It holds words, not behaviour: nothing here estimates, plans, controls or does input and output.
//!
//! | Module | Defines |
//! | --- | --- |
//! | [`time`] | [`Timestamp`], [`Pace`] |
//! | [`frames`] | [`In`], [`Rot`], the frames [`Ned`], [`Frd`], [`Map`], [`Odom`], and [`MapAnchor`] between plan and world |
//! | [`angle`] | [`wrap_pi`](angle::wrap_pi), [`shortest_turn`](angle::shortest_turn) |
//! | [`sample`] | what sensors deliver: [`ImuSample`], [`RangeScan`], [`FlowSample`] ... |
//! | [`ring`] | the ring of range finders as a table: [`RingConfig`] |
//! | [`state`] | what the estimator knows: [`NavState`] |
//! | [`setpoint`], [`sticks`] | what the vehicle shall do: [`Setpoint`], [`Sticks`] |
//! | [`airframe`], [`uquad`] | mass, size, thrust: [`Airframe`], [`UquadAirframe`] |
//! | [`floor_plan`] | walls: [`FloorPlan`] |
//! | [`param`] | the [`params!`] table |
//!
//! SI units, `f64`, radians. The world is NED about home, the body FRD, the plan [`Map`].
//!
//! ```
//! use vehicle::{Frd, In, Ned, Rot};
//! // Yaw 90 degrees turns body forward into East.
//! let frd_to_ned = Rot::<Frd, Ned>::from_roll_pitch_yaw(0.0, 0.0, std::f64::consts::FRAC_PI_2);
//! let east: In<Ned> = frd_to_ned * In::<Frd>::new(1.0, 0.0, 0.0);
//! assert!((east.y() - 1.0).abs() < 1e-12);
//! ```

pub mod airframe;
pub mod angle;
pub mod floor_plan;
pub mod frames;
pub mod param;
pub mod ring;
pub mod sample;
pub mod setpoint;
pub mod state;
pub mod sticks;
pub mod time;
pub mod uquad;

pub use airframe::Airframe;
pub use floor_plan::{FloorPlan, PlanError, Segment};
pub use frames::{Frd, In, Map, MapAnchor, MapPose, Ned, Odom, Rot};
pub use param::{ParamChoice, ParamError, ParamKind, ParamMeta, ParamSet, ParamValue};
pub use ring::{RangerConfig, RangerKind, RingConfig, RingError};
pub use sample::{
    AttitudeSample, BaroSample, BatterySample, Beam, DownRange, ExternalFrame, ExternalPose,
    FlowSample, GnssFix, ImuSample, RangeScan, RangerReading,
};
pub use setpoint::{Heading, Setpoint};
pub use state::{Localization, LocalizationState, NavHealth, NavState};
pub use sticks::Sticks;
pub use time::{Pace, Timestamp};
pub use uquad::UquadAirframe;
