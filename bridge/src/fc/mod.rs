//! Towards the flight controller: what is asked and when, what the replies mean, how sticks become RC frames; how it is
//! set up on the bench.

pub mod conversation;
pub mod convert;
pub mod motor_test;
pub mod passthrough;
pub mod poll;
pub mod rc_out;
pub mod setup;
pub mod stock_curves;
