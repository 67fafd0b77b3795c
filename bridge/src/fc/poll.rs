//! What is asked of the flight controller, how often.
//!
//! Betaflight serves one message per run of its serial task, 100 a second by default, RC frames included. RC 40 Hz and
//! one batch of the fast group 40 Hz leave 20 slots for the rest (`msp-facts` section 2). INAV has no batch and no such
//! limit. The client measures the service rate and drops what does not fit, never RC.

use msp::client::Config;

/// The link configuration for flight.
#[must_use]
pub fn config() -> Config {
    Config::default()
}
