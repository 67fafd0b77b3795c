//! Who may do what on which link: viewers read, pilots fly, engineers change what outlives a flight.
//!
//! | Link | Role, unless `?role=` says another |
//! | --- | --- |
//! | signed (`?key=`, or a key by SETUP_SIGNING) | engineer: who speaks there knows the secret |
//! | loopback, serial | engineer: who speaks there holds the machine |
//! | any other network address | viewer |
//!
//! | Role | Beyond the one before |
//! | --- | --- |
//! | viewer | telemetry, reading (parameters, plans, files, logs), intervals, clocks, and STOP |
//! | pilot | arming, modes, goals, plans, sticks, set points, keys; samples of sensors |
//! | engineer | parameters, origin, calibration, motor test, restart, erasing, writing files |
//!
//! STOP is DO_PAUSE_CONTINUE 0, LOITER_UNLIM, or mode Hold in each of its forms; again within 3 s it lands. It is never refused.
//!
//! Nothing refused falls into silence: a command gets COMMAND_ACK DENIED, a plan MISSION_ACK DENIED, a parameter its old value, a
//! file a NAK, a key line a line, and each a STATUSTEXT with the flag that grants it.

#![expect(deprecated, reason = "stations send what the protocol is done with")]

use super::convert::{mode_from_px4, mode_from_standard};
use super::{Context, Destination, LinkId, Outbox, Peer, command, params};
use crate::autopilot::door::Severity;
use crate::autopilot::mode::Mode;
use mavlink::Message as _;
use mavlink_dialect::command::{Command, cmd, result};
use mavlink_dialect::mission_item::mission_result;
use mavlink_dialect::mode::{FLAG_CUSTOM, Px4Mode};
use mavlink_dialect::signing::SigningKey;
use mavlink_dialect::standard::{self, FILE_TRANSFER_PROTOCOL_DATA};
use mavlink_dialect::{Message, raw};
use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;

/// What a link may do. A later one may all that an earlier one may.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Watches, and may press STOP.
    Viewer,
    /// Flies.
    Pilot,
    /// Changes what outlives a flight.
    #[default]
    Engineer,
}

impl Role {
    /// All, least first.
    pub const ALL: [Self; 3] = [Self::Viewer, Self::Pilot, Self::Engineer];

    /// As `?role=` spells it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Pilot => "pilot",
            Self::Engineer => "engineer",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Role {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|r| r.name() == text).ok_or(())
    }
}

/// What the links of one endpoint may do, and how they are to be treated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkPolicy {
    /// The URL without what follows here, for the words of a refusal.
    pub url: String,
    /// `?role=`.
    pub role: Option<Role>,
    /// `?key=`: frames there are signed with it, and only such are taken.
    pub key: Option<SigningKey>,
    /// `?rate=`: telemetry on each link keeps within so many bytes a second.
    pub rate_bytes_per_s: Option<f64>,
    /// `?route=on`: a camera or a second companion speaks there; its frames go to the stations and theirs to it.
    pub is_routed: bool,
}

/// Policies by number of the endpoint.
#[derive(Debug, Default)]
pub struct Access {
    policies: Vec<LinkPolicy>,
    /// Other machines must sign on every link ([`super::signing`]).
    is_signed: bool,
}

impl Access {
    /// Policies by number of the endpoint ([`LinkId::of`]).
    #[must_use]
    pub const fn new(policies: Vec<LinkPolicy>) -> Self {
        Self {
            policies,
            is_signed: false,
        }
    }

    /// SETUP_SIGNING has given a key, or taken it away.
    pub const fn set_signed(&mut self, is_signed: bool) {
        self.is_signed = is_signed;
    }

    /// What was said about the endpoint of a link.
    #[must_use]
    pub fn policy(&self, link: LinkId) -> Option<&LinkPolicy> {
        self.policies.get(usize::from(link.endpoint()))
    }

    /// What a link may do.
    #[must_use]
    pub fn role(&self, link: LinkId) -> Role {
        let policy = self.policy(link);
        match policy.and_then(|p| p.role) {
            Some(role) => role,
            None if link.is_remote()
                && !self.is_signed
                && policy.is_none_or(|p| p.key.is_none()) =>
            {
                Role::Viewer
            }
            None => Role::Engineer,
        }
    }

    /// True if a link is known not to leave this machine, and nothing says that it is slow.
    #[must_use]
    pub fn is_near(&self, link: LinkId) -> bool {
        let policy = self.policy(link);
        !link.is_remote() && policy.is_some_and(|p| p.rate_bytes_per_s.is_none())
    }

    /// True if a camera or a companion speaks there.
    #[must_use]
    pub fn is_routed(&self, link: LinkId) -> bool {
        self.policy(link).is_some_and(|p| p.is_routed)
    }

    /// True if any endpoint routes.
    #[must_use]
    pub fn routes(&self) -> bool {
        self.policies.iter().any(|p| p.is_routed)
    }

    /// How the role that is needed is given, in the words of the command line.
    #[must_use]
    pub fn advice(&self, link: LinkId, needs: Role) -> String {
        let policy = self.policy(link);
        let url = policy.map_or("URL", |p| p.url.as_str());
        let join = if url.contains('?') { '&' } else { '?' };
        let role = self.role(link);
        match policy.is_some_and(|p| p.key.is_some()) {
            true => format!(
                "this key's role is {role}; start with --mavlink '{url}{join}key=...&role={needs}'"
            ),
            false => format!(
                "role of this link is {role}; start with --mavlink '{url}{join}role={needs}', or sign it: `kestrel keys new {needs}.key`, --mavlink '{url}{join}key=file:{needs}.key'"
            ),
        }
    }
}

/// The role that a message needs; none for what no service takes. A message that is not named here reaches no service at all, so
/// that nothing new can act before somebody has said who may.
#[must_use]
pub fn needs(message: &Message) -> Option<Role> {
    use raw::MavMessage as R;
    use standard::MavMessage as S;
    match message {
        Message::Raw(m) => match m {
            R::COMMAND_LONG(m) => Some(command_needs(&Command::from_long(m))),
            R::COMMAND_INT(m) => Some(command_needs(&Command::from_int(m))),
            R::SET_MODE(m) => {
                let mode = (m.base_mode & FLAG_CUSTOM != 0)
                    .then(|| mode_from_px4(Px4Mode::from_custom_mode(m.custom_mode)));
                Some(stop_or_pilot(mode.flatten()))
            }
            R::SERIAL_CONTROL(m) if m.count == 0 => Some(Role::Viewer),
            R::SERIAL_CONTROL(_)
            | R::COMMAND_CANCEL(_)
            | R::MISSION_COUNT(_)
            | R::MISSION_ITEM(_)
            | R::MISSION_ITEM_INT(_)
            | R::MISSION_CLEAR_ALL(_)
            | R::MISSION_WRITE_PARTIAL_LIST(_)
            | R::MANUAL_CONTROL(_)
            | R::SET_ATTITUDE_TARGET(_)
            | R::SET_POSITION_TARGET_LOCAL_NED(_)
            | R::SET_POSITION_TARGET_GLOBAL_INT(_) => Some(Role::Pilot),
            R::PARAM_SET(_) => Some(Role::Engineer),
            R::HEARTBEAT(_)
            | R::COMMAND_ACK(_)
            | R::MISSION_ACK(_)
            | R::MISSION_REQUEST(_)
            | R::MISSION_REQUEST_INT(_)
            | R::MISSION_REQUEST_LIST(_)
            | R::MISSION_REQUEST_PARTIAL_LIST(_)
            | R::REQUEST_DATA_STREAM(_) => Some(Role::Viewer),
            // What we say ourselves; of others it is news for people.
            R::AUTOPILOT_VERSION(_)
            | R::STATUSTEXT(_)
            | R::KESTREL_AVOIDANCE(_)
            | R::KESTREL_CONTROL(_)
            | R::KESTREL_LOCALIZATION(_)
            | R::KESTREL_LOOP(_) => None,
        },
        Message::Standard(m) => match m {
            S::PARAM_REQUEST_LIST(_)
            | S::PARAM_REQUEST_READ(_)
            | S::LOG_REQUEST_LIST(_)
            | S::LOG_REQUEST_DATA(_)
            | S::LOG_REQUEST_END(_)
            | S::TIMESYNC(_)
            | S::PING(_)
            | S::RADIO_STATUS(_) => Some(Role::Viewer),
            // Samples of sensors move the estimate, and so the vehicle.
            S::DISTANCE_SENSOR(_)
            | S::OBSTACLE_DISTANCE(_)
            | S::OPTICAL_FLOW_RAD(_)
            | S::VISION_POSITION_ESTIMATE(_)
            | S::ODOMETRY(_)
            | S::MISSION_SET_CURRENT(_)
            | S::RC_CHANNELS_OVERRIDE(_)
            | S::SET_HOME_POSITION(_) => Some(Role::Pilot),
            S::SET_GPS_GLOBAL_ORIGIN(_) | S::LOG_ERASE(_) | S::SETUP_SIGNING(_) => {
                Some(Role::Engineer)
            }
            S::FILE_TRANSFER_PROTOCOL(m) => {
                // CreateFile 6 to RemoveDirectory 10, OpenFileWO 11, TruncateFile 12, Rename 13.
                Some(if (6..=13).contains(&m.payload[FTP_OPCODE]) {
                    Role::Engineer
                } else {
                    Role::Viewer
                })
            }
            _ => None,
        },
    }
}

/// True if some service takes messages of this id.
#[must_use]
pub fn is_served(id: u32) -> bool {
    /// None of ours is beyond.
    const IDS: usize = 512;
    static SERVED: LazyLock<[bool; IDS]> = LazyLock::new(|| {
        core::array::from_fn(|id| {
            let id = id as u32;
            let raw = raw::MavMessage::default_message_from_id(id).map(Message::Raw);
            let message = raw.or_else(|| {
                standard::MavMessage::default_message_from_id(id).map(Message::Standard)
            });
            message.is_some_and(|m| needs(&m).is_some())
        })
    });
    SERVED.get(id as usize).copied().unwrap_or(false)
}

const FTP_OPCODE: usize = 3;

fn stop_or_pilot(mode: Option<Mode>) -> Role {
    if mode == Some(Mode::Hold) {
        Role::Viewer
    } else {
        Role::Pilot
    }
}

fn command_needs(c: &Command) -> Role {
    match c.number {
        cmd::NAV_LOITER_UNLIM
        | cmd::SET_MESSAGE_INTERVAL
        | cmd::GET_MESSAGE_INTERVAL
        | cmd::REQUEST_MESSAGE
        | cmd::REQUEST_PROTOCOL_VERSION
        | cmd::REQUEST_AUTOPILOT_CAPABILITIES
        | cmd::GET_HOME_POSITION
        | cmd::RUN_PREARM_CHECKS
        | cmd::REQUEST_CAMERA_INFORMATION
        | cmd::REQUEST_CAMERA_SETTINGS
        | cmd::REQUEST_STORAGE_INFORMATION
        | cmd::REQUEST_CAMERA_CAPTURE_STATUS
        | cmd::REQUEST_VIDEO_STREAM_INFORMATION
        | cmd::REQUEST_VIDEO_STREAM_STATUS => Role::Viewer,
        cmd::DO_PAUSE_CONTINUE if c.whole(1) == Some(0) => Role::Viewer,
        cmd::DO_SET_MODE => stop_or_pilot(command::mode_of(c)),
        cmd::DO_SET_STANDARD_MODE => {
            let mode = c.whole(1).and_then(|m| u8::try_from(m).ok());
            stop_or_pilot(mode.and_then(mode_from_standard))
        }
        cmd::PREFLIGHT_CALIBRATION
        | cmd::PREFLIGHT_STORAGE
        | cmd::PREFLIGHT_REBOOT_SHUTDOWN
        | cmd::DO_MOTOR_TEST
        | cmd::ACTUATOR_TEST
        | cmd::DO_SET_GLOBAL_ORIGIN
        | cmd::INJECT_FAILURE => Role::Engineer,
        // What is not known is UNSUPPORTED for everybody.
        number if mavlink_dialect::command::name(number).is_none() => Role::Viewer,
        _ => Role::Pilot,
    }
}

/// Answers a message that is refused whole, in its own protocol, and says why to every pilot.
pub fn refuse(
    from: Peer,
    message: &Message,
    command_result: u8,
    why: &str,
    ctx: &Context<'_>,
    out: &mut Outbox,
) {
    use raw::MavMessage as R;
    use standard::MavMessage as S;
    let system = from.address.system;
    let say = |what: &str, out: &mut Outbox| {
        let text = format!("{what} of system {system} refused: {why}");
        out.text(Severity::Warning, text);
    };
    let command = |c: &Command, out: &mut Outbox| {
        command::ack(from, c.number, command_result, out);
        let label = command::label(c);
        out.text(
            Severity::Warning,
            format!("{label} of system {system} refused: {why}"),
        );
    };
    let plan = |mission_type: u8, out: &mut Outbox| {
        let ack = raw::MISSION_ACK_DATA {
            target_system: system,
            target_component: from.address.component,
            mavtype: mission_result::DENIED,
            mission_type,
            ..Default::default()
        };
        out.send_raw(Destination::All, R::MISSION_ACK(ack));
    };
    match message {
        Message::Raw(R::COMMAND_LONG(m)) => command(&Command::from_long(m), out),
        Message::Raw(R::COMMAND_INT(m)) => command(&Command::from_int(m), out),
        Message::Raw(R::COMMAND_CANCEL(m)) => {
            command::ack(from, m.command, command_result, out);
            say("Cancelling", out);
        }
        Message::Raw(R::MISSION_COUNT(m)) => {
            plan(m.mission_type, out);
            say("Plan", out);
        }
        Message::Raw(R::MISSION_CLEAR_ALL(m)) => {
            plan(m.mission_type, out);
            say("Plan", out);
        }
        Message::Raw(R::MISSION_WRITE_PARTIAL_LIST(m)) => {
            plan(m.mission_type, out);
            say("Plan", out);
        }
        // Nobody asked for this item: its MISSION_COUNT was refused.
        Message::Raw(R::MISSION_ITEM(_) | R::MISSION_ITEM_INT(_)) => {}
        Message::Raw(R::PARAM_SET(m)) => {
            params::echo(from, m, ctx, out);
            say("Parameter", out);
        }
        Message::Raw(R::SERIAL_CONTROL(m)) => {
            let text = format!("refused: {why}\n");
            super::keys::reply(from, m.device, &text, out);
        }
        Message::Standard(S::FILE_TRANSFER_PROTOCOL(m)) => {
            out.send(
                Destination::All,
                S::FILE_TRANSFER_PROTOCOL(file_protected(from, m)),
            );
            say("Writing a file", out);
        }
        other => say(other.name(), out),
    }
}

/// NAK FileProtected.
fn file_protected(from: Peer, m: &FILE_TRANSFER_PROTOCOL_DATA) -> FILE_TRANSFER_PROTOCOL_DATA {
    const NAK: u8 = 129;
    const FILE_PROTECTED: u8 = 9;
    let mut payload = [0u8; 251];
    let seq = u16::from_le_bytes([m.payload[0], m.payload[1]]).wrapping_add(1);
    payload[..2].copy_from_slice(&seq.to_le_bytes());
    payload[2] = m.payload[2];
    payload[FTP_OPCODE] = NAK;
    payload[4] = 1;
    payload[5] = m.payload[FTP_OPCODE];
    payload[12] = FILE_PROTECTED;
    FILE_TRANSFER_PROTOCOL_DATA {
        target_network: 0,
        target_system: from.address.system,
        target_component: from.address.component,
        payload,
    }
}

/// A role denies a message: its answer.
pub fn deny(access: &Access, from: Peer, message: &Message, ctx: &Context<'_>, out: &mut Outbox) {
    let why = access.advice(from.link, needs(message).unwrap_or_default());
    refuse(from, message, result::DENIED, &why, ctx, out);
}

#[cfg(test)]
mod tests {
    use super::super::bench::{Bench, station};
    use super::*;

    fn access() -> Access {
        let policy = |url: &str| LinkPolicy {
            url: url.to_owned(),
            ..Default::default()
        };
        Access::new(vec![
            policy("udpserver://0.0.0.0:14555"),
            LinkPolicy {
                key: Some(SigningKey::from_passphrase("x")),
                ..policy("udpserver://0.0.0.0:14556")
            },
            LinkPolicy {
                role: Some(Role::Viewer),
                ..policy("serial:///dev/ttyUSB0?baudrate=57600")
            },
        ])
    }

    fn long(command: u16, param1: f32) -> Message {
        raw::MavMessage::COMMAND_LONG(raw::COMMAND_LONG_DATA {
            command,
            param1,
            ..Default::default()
        })
        .into()
    }

    fn needs_of(message: &Message) -> Role {
        needs(message).unwrap()
    }

    #[test]
    fn who_holds_the_machine_or_the_key_may_all_and_others_watch() {
        let access = access();
        assert_eq!(access.role(LinkId::of(0, 1)), Role::Engineer);
        assert_eq!(access.role(LinkId::of(0, 1).remote()), Role::Viewer);
        assert_eq!(access.role(LinkId::of(1, 1).remote()), Role::Engineer);
        assert_eq!(access.role(LinkId::of(2, 1)), Role::Viewer);
        assert_eq!(LinkId::of(2, 7).remote().endpoint(), 2);
    }

    #[test]
    fn stop_in_every_form_needs_no_role() {
        assert_eq!(needs_of(&long(cmd::DO_PAUSE_CONTINUE, 0.0)), Role::Viewer);
        assert_eq!(needs_of(&long(cmd::DO_PAUSE_CONTINUE, 1.0)), Role::Pilot);
        assert_eq!(
            needs_of(&long(cmd::NAV_LOITER_UNLIM, f32::NAN)),
            Role::Viewer
        );
        let hold = raw::COMMAND_LONG_DATA {
            command: cmd::DO_SET_MODE,
            param1: 1.0,
            param2: 4.0,
            param3: 3.0,
            ..Default::default()
        };
        let land = raw::COMMAND_LONG_DATA {
            param3: 6.0,
            ..hold.clone()
        };
        assert_eq!(
            needs_of(&raw::MavMessage::COMMAND_LONG(hold).into()),
            Role::Viewer
        );
        assert_eq!(
            needs_of(&raw::MavMessage::COMMAND_LONG(land).into()),
            Role::Pilot
        );
        for (custom_mode, role) in [(4 << 16 | 3 << 24, Role::Viewer), (3 << 16, Role::Pilot)] {
            let m = raw::SET_MODE_DATA {
                base_mode: 1,
                custom_mode,
                ..Default::default()
            };
            assert_eq!(needs_of(&raw::MavMessage::SET_MODE(m).into()), role);
        }
    }

    #[test]
    fn what_outlives_a_flight_is_the_engineers_and_reading_everybodys() {
        assert_eq!(
            needs_of(&long(cmd::PREFLIGHT_CALIBRATION, 1.0)),
            Role::Engineer
        );
        assert_eq!(needs_of(&long(cmd::COMPONENT_ARM_DISARM, 1.0)), Role::Pilot);
        assert_eq!(needs_of(&long(cmd::REQUEST_MESSAGE, 148.0)), Role::Viewer);
        assert_eq!(needs_of(&long(60_000, 0.0)), Role::Viewer);
        let mut file = FILE_TRANSFER_PROTOCOL_DATA::default();
        file.payload[FTP_OPCODE] = 4;
        let message = |f: &FILE_TRANSFER_PROTOCOL_DATA| -> Message {
            standard::MavMessage::FILE_TRANSFER_PROTOCOL(f.clone()).into()
        };
        assert_eq!(needs_of(&message(&file)), Role::Viewer);
        file.payload[FTP_OPCODE] = 8;
        assert_eq!(needs_of(&message(&file)), Role::Engineer);
    }

    #[test]
    fn samples_of_sensors_need_a_pilot_and_what_nobody_takes_reaches_nobody() {
        let pose = standard::MavMessage::VISION_POSITION_ESTIMATE(Default::default());
        assert_eq!(needs(&pose.into()), Some(Role::Pilot));
        let theirs = standard::MavMessage::ATTITUDE(Default::default());
        assert_eq!(needs(&theirs.into()), None);
        assert!(is_served(0) && is_served(76) && is_served(110) && !is_served(30));
        let beyond = standard::MavMessage::all_ids()
            .iter()
            .filter(|id| **id >= 512);
        for id in beyond {
            let m = standard::MavMessage::default_message_from_id(*id).unwrap();
            assert_eq!(needs(&m.into()), None, "{id}");
        }
    }

    #[test]
    fn a_refusal_names_the_flag_and_the_key_that_grant_it() {
        let (access, bench, mut out) = (access(), Bench::default(), Outbox::default());
        let peer = Peer {
            link: LinkId::of(0, 1).remote(),
            ..station(245)
        };
        let arm = long(cmd::COMPONENT_ARM_DISARM, 1.0);
        deny(&access, peer, &arm, &bench.ctx(), &mut out);
        match out.sent_raw().as_slice() {
            [raw::MavMessage::COMMAND_ACK(ack)] => {
                assert_eq!((ack.result, ack.target_system), (result::DENIED, 245));
            }
            other => panic!("{other:?}"),
        }
        let said = out.said().pop().unwrap().1;
        assert!(said.starts_with("Arming of system 245 refused: "), "{said}");
        assert!(
            said.contains("--mavlink 'udpserver://0.0.0.0:14555?role=pilot'"),
            "{said}"
        );
        assert!(said.contains("kestrel keys new pilot.key"), "{said}");
        let serial = access.advice(LinkId::of(2, 1), Role::Engineer);
        assert!(
            serial.contains("'serial:///dev/ttyUSB0?baudrate=57600&role=engineer'"),
            "{serial}"
        );
    }
}
