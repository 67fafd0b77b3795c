//! What is asked of the flight controller, how often.
//!
//! Betaflight serves one message per run of its serial task, 100 a second by default, RC frames included. RC 40 Hz and
//! one batch of the fast group 40 Hz leave 20 slots for the rest (`msp-facts` section 2). INAV has no batch and no such
//! limit. The client measures the service rate and drops what does not fit, never RC.

use crate::autopilot::params::AutopilotParams;
use msp::client::{Config, Poll, Priority, Schedule, default_schedule};
use msp::command;
use msp::firmware::{Firmware, Identity};

/// The link configuration for flight.
#[must_use]
pub fn config() -> Config {
    Config::default()
}

/// What is asked of this controller. Beside a live radio the receiver and the switches are asked for as often as it takes to
/// notice a pilot within 50 ms; where the controller takes batches they ride along.
#[must_use]
pub fn schedule(identity: &Identity, params: &AutopilotParams) -> Schedule {
    let has_radio = params.radio;
    let mut schedule = default_schedule(identity);
    let every = |command, rate_hz: u32, priority| Poll {
        command,
        interval_us: 1_000_000 / rate_hz,
        priority,
    };
    let asks = |schedule: &Schedule, wanted| schedule.iter().any(|p| p.command == wanted);
    // BATTERY_STATE has no signal strength.
    if asks(&schedule, command::BATTERY_STATE) && !asks(&schedule, command::ANALOG) {
        let _ = schedule.try_push(every(command::ANALOG, 1, Priority::Slow));
    }
    if has_radio {
        let status = identity.status_command();
        schedule.retain(|p| p.command != status);
        let _ = schedule.try_push(every(status, 20, Priority::Fast));
        let _ = schedule.try_push(every(command::RC, 20, Priority::Fast));
    }
    // Sensors of its own, where the user says it has them.
    if params.fc_range {
        let _ = schedule.try_push(every(command::SONAR_ALTITUDE, 15, Priority::Normal));
    }
    if params.fc_flow && identity.firmware == Firmware::Inav {
        let _ = schedule.try_push(every(command::INAV_OPTICAL_FLOW, 25, Priority::Normal));
    }
    if params.fc_gps {
        let _ = schedule.try_push(every(command::RAW_GPS, 5, Priority::Slow));
    }
    schedule
}
