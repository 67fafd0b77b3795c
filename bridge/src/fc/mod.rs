//! Towards the flight controller: what is asked and when, what the replies mean, how sticks become RC frames.

pub mod convert;
pub mod poll;
pub mod rc_out;
pub mod stock_curves;
