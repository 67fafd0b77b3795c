//! What a message wants of the vehicle, as the console's pages are judged by: the roles of [`access`] in other words,
//! with STOP apart because nobody is refused it.
//!
//! | Intent | Messages |
//! | --- | --- |
//! | [`Watch`](Intent::Watch) | what a viewer may: telemetry, plans, logs, heartbeats, time; who is in control |
//! | [`Stop`](Intent::Stop) | DO_PAUSE_CONTINUE 0, NAV_LOITER_UNLIM, mode Hold |
//! | [`Fly`](Intent::Fly) | what needs a pilot |
//! | [`Configure`](Intent::Configure) | what needs an engineer: parameters, files, calibration, restart, origin |

use super::access::{self, Role};
use mavlink_dialect::command::cmd;
use mavlink_dialect::{Message, raw};

/// What a message wants of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Intent {
    /// Changes nothing.
    Watch,
    /// Hold.
    Stop,
    /// Moves the vehicle or what it will do.
    Fly,
    /// Changes how the vehicle is set up.
    Configure,
}

/// Judges a message.
#[must_use]
pub fn of(message: &Message) -> Intent {
    let number = command(message);
    match access::needs(message) {
        // Who asks for control does not have it yet.
        _ if number == Some(cmd::REQUEST_OPERATOR_CONTROL) => Intent::Watch,
        Some(Role::Viewer) if is_mode_change(message, number) => Intent::Stop,
        Some(Role::Viewer) | None => Intent::Watch,
        Some(Role::Pilot) => Intent::Fly,
        Some(Role::Engineer) => Intent::Configure,
    }
}

const fn command(message: &Message) -> Option<u16> {
    match message {
        Message::Raw(raw::MavMessage::COMMAND_LONG(m)) => Some(m.command),
        Message::Raw(raw::MavMessage::COMMAND_INT(m)) => Some(m.command),
        _ => None,
    }
}

const fn is_mode_change(message: &Message, number: Option<u16>) -> bool {
    matches!(message, Message::Raw(raw::MavMessage::SET_MODE(_)))
        || matches!(
            number,
            Some(
                cmd::DO_PAUSE_CONTINUE
                    | cmd::NAV_LOITER_UNLIM
                    | cmd::DO_SET_MODE
                    | cmd::DO_SET_STANDARD_MODE
            )
        )
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_dialect::standard;

    fn long(command: u16, param1: f32) -> Message {
        Message::Raw(raw::MavMessage::COMMAND_LONG(raw::COMMAND_LONG_DATA {
            command,
            param1,
            ..Default::default()
        }))
    }

    #[test]
    fn pausing_stops_and_continuing_flies() {
        assert_eq!(of(&long(cmd::DO_PAUSE_CONTINUE, 0.0)), Intent::Stop);
        assert_eq!(of(&long(cmd::DO_PAUSE_CONTINUE, 1.0)), Intent::Fly);
        assert_eq!(of(&long(cmd::DO_PAUSE_CONTINUE, f32::NAN)), Intent::Fly);
    }

    #[test]
    fn arming_and_cutting_the_motors_fly_and_what_nobody_knows_does_nothing() {
        assert_eq!(of(&long(cmd::COMPONENT_ARM_DISARM, 1.0)), Intent::Fly);
        assert_eq!(of(&long(cmd::DO_FLIGHTTERMINATION, 1.0)), Intent::Fly);
        assert_eq!(of(&long(54_321, 0.0)), Intent::Watch);
    }

    #[test]
    fn control_may_be_asked_for_by_who_does_not_have_it() {
        let request = long(cmd::REQUEST_OPERATOR_CONTROL, 1.0);
        assert_eq!(of(&request), Intent::Watch);
    }

    #[test]
    fn sticks_and_set_points_fly() {
        let sticks = raw::MavMessage::MANUAL_CONTROL(raw::MANUAL_CONTROL_DATA::default());
        assert_eq!(of(&Message::Raw(sticks)), Intent::Fly);
        let rc = standard::MavMessage::RC_CHANNELS_OVERRIDE(Default::default());
        assert_eq!(of(&Message::Standard(rc)), Intent::Fly);
    }
}
