//! What a message wants of the vehicle: the one list by which roles and the control lock judge.
//!
//! | Intent | Messages |
//! | --- | --- |
//! | [`Watch`](Intent::Watch) | requests for telemetry, parameters, plans, logs; heartbeats; time; who is in control |
//! | [`Stop`](Intent::Stop) | DO_PAUSE_CONTINUE 0, NAV_LOITER_UNLIM, NAV_LAND: nobody is refused these |
//! | [`Configure`](Intent::Configure) | parameters, files, calibration, restart, origin |
//! | [`Fly`](Intent::Fly) | everything else: what is not known to be harmless flies |

use mavlink_dialect::command::cmd;
use mavlink_dialect::{Message, raw, standard};

/// What a message wants of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Intent {
    /// Changes nothing.
    Watch,
    /// Hold, or come down here.
    Stop,
    /// Moves the vehicle or what it will do.
    Fly,
    /// Changes how the vehicle is set up.
    Configure,
}

/// Judges a message.
#[must_use]
pub fn of(message: &Message) -> Intent {
    use raw::MavMessage as R;
    use standard::MavMessage as S;
    match message {
        Message::Raw(R::COMMAND_LONG(m)) => of_command(m.command, m.param1),
        Message::Raw(R::COMMAND_INT(m)) => of_command(m.command, m.param1),
        Message::Raw(
            R::HEARTBEAT(_)
            | R::COMMAND_ACK(_)
            | R::STATUSTEXT(_)
            | R::MISSION_REQUEST(_)
            | R::MISSION_REQUEST_INT(_)
            | R::MISSION_REQUEST_LIST(_)
            | R::MISSION_REQUEST_PARTIAL_LIST(_)
            | R::MISSION_ACK(_),
        )
        | Message::Standard(
            S::HEARTBEAT(_)
            | S::LOG_REQUEST_DATA(_)
            | S::LOG_REQUEST_END(_)
            | S::LOG_REQUEST_LIST(_)
            | S::PARAM_REQUEST_LIST(_)
            | S::PARAM_REQUEST_READ(_)
            | S::SYSTEM_TIME(_)
            | S::TIMESYNC(_),
        ) => Intent::Watch,
        Message::Raw(R::PARAM_SET(_))
        | Message::Standard(S::FILE_TRANSFER_PROTOCOL(_) | S::LOG_ERASE(_) | S::SETUP_SIGNING(_)) => {
            Intent::Configure
        }
        Message::Standard(m) if is_origin(m) => Intent::Configure,
        Message::Standard(m) if is_ping(m) => Intent::Watch,
        _ => Intent::Fly,
    }
}

#[expect(
    deprecated,
    reason = "MAV_CMD_DO_SET_GLOBAL_ORIGIN takes its place, stations still send the message"
)]
const fn is_origin(m: &standard::MavMessage) -> bool {
    matches!(m, standard::MavMessage::SET_GPS_GLOBAL_ORIGIN(_))
}

#[expect(
    deprecated,
    reason = "TIMESYNC takes its place, stations still send it"
)]
const fn is_ping(m: &standard::MavMessage) -> bool {
    matches!(m, standard::MavMessage::PING(_))
}

fn of_command(number: u16, param1: f32) -> Intent {
    match number {
        cmd::NAV_LAND | cmd::NAV_LOITER_UNLIM => Intent::Stop,
        cmd::DO_PAUSE_CONTINUE if param1.abs() < 0.5 => Intent::Stop,
        cmd::GET_HOME_POSITION
        | cmd::GET_MESSAGE_INTERVAL
        | cmd::REQUEST_AUTOPILOT_CAPABILITIES
        | cmd::REQUEST_MESSAGE
        | cmd::REQUEST_OPERATOR_CONTROL
        | cmd::REQUEST_PROTOCOL_VERSION
        | cmd::RUN_PREARM_CHECKS
        | cmd::SET_MESSAGE_INTERVAL => Intent::Watch,
        cmd::ACTUATOR_TEST
        | cmd::DO_MOTOR_TEST
        | cmd::DO_SET_GLOBAL_ORIGIN
        | cmd::PREFLIGHT_CALIBRATION
        | cmd::PREFLIGHT_REBOOT_SHUTDOWN
        | cmd::PREFLIGHT_STORAGE => Intent::Configure,
        _ => Intent::Fly,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn what_nobody_has_heard_of_counts_as_flying() {
        assert_eq!(of(&long(54_321, 0.0)), Intent::Fly);
        assert_eq!(of(&long(cmd::COMPONENT_ARM_DISARM, 1.0)), Intent::Fly);
        assert_eq!(of(&long(cmd::DO_FLIGHTTERMINATION, 1.0)), Intent::Fly);
    }

    #[test]
    fn sticks_and_set_points_fly() {
        let sticks = raw::MavMessage::MANUAL_CONTROL(raw::MANUAL_CONTROL_DATA::default());
        assert_eq!(of(&Message::Raw(sticks)), Intent::Fly);
        let rc = standard::MavMessage::RC_CHANNELS_OVERRIDE(Default::default());
        assert_eq!(of(&Message::Standard(rc)), Intent::Fly);
    }
}
