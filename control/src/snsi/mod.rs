//! SNSI's control: an incremental PID family on stick channels, and controllers with priorities.
//!
//! | Module | Does |
//! | --- | --- |
//! | [`pid`] | its PID as it is written, and in the velocity form it is meant to be |
//! | [`priorities`] | who may write which channel: the highest priority that is available, each cycle anew |
//! | [`law`] | the family over an angle-mode controller: `control.variant = "snsi"` |
//!
//! As published, the PID adds `kP err + kI sum + kD prev` to its last output: the proportional term integrates, and nothing damps. Flown on height that
//! is three integrators in a row; its author saw it: reached in 5 of 10 flights, never held. [`pid::Pid`] keeps that arithmetic for comparison
//! ([`pid::Form::Published`]); [`law`] flies the velocity form with a true derivative.

pub mod law;
pub mod pid;
pub mod priorities;

pub use law::SnsiLaw;
pub use pid::{Form, Pid, PidConfig};
pub use priorities::{Claim, Priorities, Warning};
