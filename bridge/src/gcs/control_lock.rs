//! Who may fly: one ground station at a time, if any station has asked for that.
//!
//! MAVLink's operator control (development dialect): MAV_CMD_REQUEST_OPERATOR_CONTROL (32100) takes and gives up control,
//! CONTROL_STATUS (512) tells who has it, once a second and on change, from the first request on. As long as nobody has
//! asked, every station may fly, as always; from then until the owner gives control up or falls silent only he may.
//!
//! | Event | Result |
//! | --- | --- |
//! | nobody in control, somebody asks | granted |
//! | an owner who allows takeover | granted at once |
//! | an owner who does not | FAILED; he is asked (the command is forwarded to him) for [`ASK`]; giving up or allowing grants it to who asked |
//! | the owner's heartbeat is silent for [`SILENT`], or his link is gone | nobody in control, sticks centred |
//! | [`Intent::Stop`] from anybody | carried out, the lock stays |
//! | [`Intent::Fly`] from anybody else | MAV_RESULT_NOT_IN_CONTROL, for plans MAV_MISSION_DENIED; sticks and set points are dropped |
//!
//! An owner is a system id *on a link*: the same number from somewhere else is somebody else.

use super::intent::{self, Intent};
use super::{Destination, LinkId, Outbox, Peer};
use crate::autopilot::door::{ManualInput, Request, Severity};
use core::time::Duration;
use mavlink_dialect::command::{cmd, result};
use mavlink_dialect::standard::{self, CONTROL_STATUS_DATA, GcsControlStatusFlags};
use mavlink_dialect::{Message, raw};
use vehicle::{Pace, Timestamp};

/// An owner this silent has lost control.
pub const SILENT: Duration = Duration::from_secs(3);
/// Time that an owner has to answer who wants control.
pub const ASK: Duration = Duration::from_secs(10);
/// MAV_MISSION_DENIED.
const MISSION_DENIED: u8 = 14;
/// Time between two texts about refused frames.
const TEXT_PERIOD: Duration = Duration::from_secs(5);

/// Who has control, for the shell and its pages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Control {
    /// Link and system id of the owner.
    pub owner: Option<(LinkId, u8)>,
    /// Number of this ownership: grows with each change, so that a command of an earlier one can be told.
    pub lease: u64,
    /// He lets anybody take over.
    pub is_open: bool,
    /// System id of who asks him for control.
    pub asking: Option<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Owner {
    peer: Peer,
    heard: Timestamp,
    allows_takeover: bool,
    asked: Option<(Peer, Timestamp)>,
}

/// The lock.
#[derive(Debug)]
pub struct ControlLock {
    owner: Option<Owner>,
    lease: u64,
    /// Somebody has asked for control since the start.
    is_used: bool,
    beat: Pace,
    is_news: bool,
    told_at: Option<Timestamp>,
    refused: u64,
}

impl Default for ControlLock {
    fn default() -> Self {
        Self::new()
    }
}

impl ControlLock {
    /// Nobody in control.
    #[must_use]
    pub fn new() -> Self {
        Self {
            owner: None,
            lease: 0,
            is_used: false,
            beat: Pace::hz(1.0),
            is_news: false,
            told_at: None,
            refused: 0,
        }
    }

    /// Who has control.
    #[must_use]
    pub fn control(&self) -> Control {
        Control {
            owner: self.owner.map(|o| (o.peer.link, o.peer.address.system)),
            lease: self.lease,
            is_open: self.owner.is_some_and(|o| o.allows_takeover),
            asking: self
                .owner
                .and_then(|o| o.asked)
                .map(|(by, _)| by.address.system),
        }
    }

    /// Frames refused so far.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// True if a message may be served; else its sender has been told. Requests for control are served here.
    pub fn admits(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        out: &mut Outbox,
    ) -> bool {
        if let Message::Raw(raw::MavMessage::HEARTBEAT(_)) = message {
            self.heard(now, from);
        }
        if let Message::Raw(raw::MavMessage::COMMAND_LONG(m)) = message
            && m.command == cmd::REQUEST_OPERATOR_CONTROL
        {
            let result = self.asked(now, from, m, out);
            acknowledge(from, m.command, result, out);
            return false;
        }
        let Some(owner) = &self.owner else {
            return true;
        };
        if is_same(owner.peer, from) || intent::of(message) != Intent::Fly {
            return true;
        }
        self.refused += 1;
        let command = match message {
            Message::Raw(raw::MavMessage::COMMAND_LONG(m)) => Some(m.command),
            Message::Raw(raw::MavMessage::COMMAND_INT(m)) => Some(m.command),
            _ => None,
        };
        if let Some(command) = command {
            acknowledge(from, command, result::NOT_IN_CONTROL, out);
        }
        if let Some(kind) = mission_kind(message) {
            let ack = raw::MISSION_ACK_DATA {
                target_system: from.address.system,
                target_component: from.address.component,
                mavtype: MISSION_DENIED,
                mission_type: kind,
                ..Default::default()
            };
            out.send_raw(
                Destination::Link(from.link),
                raw::MavMessage::MISSION_ACK(ack),
            );
        }
        if self.told_at.is_none_or(|at| now.since(at) >= TEXT_PERIOD) {
            self.told_at = Some(now);
            let text = format!(
                "System {} refused: system {} has control",
                from.address.system, owner.peer.address.system
            );
            out.text(Severity::Notice, text);
        }
        false
    }

    /// Silent owners lose control; CONTROL_STATUS when it is due.
    pub fn tick(&mut self, now: Timestamp, out: &mut Outbox) {
        if let Some(owner) = &mut self.owner {
            if now.since(owner.heard) >= SILENT {
                self.free(out);
            } else if owner.asked.is_some_and(|(_, at)| now.since(at) >= ASK) {
                owner.asked = None;
                self.is_news = true;
            }
        }
        if self.is_used && (self.beat.is_due(now) || self.is_news) {
            self.is_news = false;
            out.send(Destination::All, self.status());
        }
    }

    /// A link is gone, and with it who was in control there.
    pub fn link_down(&mut self, link: LinkId, out: &mut Outbox) {
        match &mut self.owner {
            Some(owner) if owner.peer.link == link => self.free(out),
            Some(owner) if owner.asked.is_some_and(|(by, _)| by.link == link) => owner.asked = None,
            _ => {}
        }
    }

    fn heard(&mut self, now: Timestamp, from: Peer) {
        if let Some(owner) = &mut self.owner
            && is_same(owner.peer, from)
        {
            owner.heard = now;
        }
    }

    /// A request for control, or the end of it. Returns the MAV_RESULT.
    fn asked(
        &mut self,
        now: Timestamp,
        from: Peer,
        m: &raw::COMMAND_LONG_DATA,
        out: &mut Outbox,
    ) -> u8 {
        let is = |p: f32, code: f32| (p - code).abs() < 0.5;
        let wants = is(m.param1, 1.0);
        if !wants && !is(m.param1, 0.0) {
            return result::DENIED;
        }
        let allows_takeover = is(m.param2, 1.0);
        self.is_used = true;
        let Some(owner) = &mut self.owner else {
            if wants {
                self.grant(now, from, allows_takeover);
            }
            return result::ACCEPTED;
        };
        if is_same(owner.peer, from) {
            owner.heard = now;
            let next = owner.asked;
            match (wants, next) {
                // Who asked gets it without a moment in which anybody else could.
                (false, Some((by, _))) => self.grant(now, by, false),
                (true, Some((by, _))) if allows_takeover => self.grant(now, by, false),
                (false, None) => self.free(out),
                (true, _) => {
                    owner.allows_takeover = allows_takeover;
                    self.is_news = true;
                }
            }
            return result::ACCEPTED;
        }
        if !wants {
            return result::ACCEPTED;
        }
        if owner.allows_takeover {
            let before = owner.peer.address.system;
            self.grant(now, from, allows_takeover);
            out.text(
                Severity::Notice,
                format!(
                    "System {} took control from system {before}",
                    from.address.system
                ),
            );
            return result::ACCEPTED;
        }
        if owner.asked.is_none_or(|(by, _)| is_same(by, from)) {
            owner.asked = Some((from, now));
            let to = owner.peer;
            self.is_news = true;
            let forwarded = raw::COMMAND_LONG_DATA {
                target_system: to.address.system,
                target_component: to.address.component,
                param4: f32::from(from.address.system),
                ..m.clone()
            };
            out.send_raw(
                Destination::Link(to.link),
                raw::MavMessage::COMMAND_LONG(forwarded),
            );
        }
        result::FAILED
    }

    fn grant(&mut self, now: Timestamp, to: Peer, allows_takeover: bool) {
        self.owner = Some(Owner {
            peer: to,
            heard: now,
            allows_takeover,
            asked: None,
        });
        self.lease += 1;
        self.is_news = true;
    }

    /// Nobody is in control, and nobody's sticks are deflected.
    fn free(&mut self, out: &mut Outbox) {
        if let Some(owner) = self.owner.take() {
            self.lease += 1;
            self.is_news = true;
            let centred = ManualInput {
                forward: Some(0.0),
                right: Some(0.0),
                yaw: Some(0.0),
                throttle: Some(0.5),
            };
            out.ask(owner.peer, Request::Manual(centred));
        }
    }

    fn status(&self) -> standard::MavMessage {
        let mut flags = GcsControlStatusFlags::GCS_CONTROL_STATUS_FLAGS_SYSTEM_MANAGER;
        if self.owner.is_none_or(|o| o.allows_takeover) {
            flags |= GcsControlStatusFlags::GCS_CONTROL_STATUS_FLAGS_TAKEOVER_ALLOWED;
        }
        standard::MavMessage::CONTROL_STATUS(CONTROL_STATUS_DATA {
            flags,
            gcs_main: self.owner.map_or(0, |o| o.peer.address.system),
            gcs_secondary: [0; 10],
        })
    }
}

/// Which plan a message would change.
const fn mission_kind(message: &Message) -> Option<u8> {
    use raw::MavMessage as M;
    match message {
        Message::Raw(M::MISSION_COUNT(m)) => Some(m.mission_type),
        Message::Raw(M::MISSION_CLEAR_ALL(m)) => Some(m.mission_type),
        Message::Raw(M::MISSION_ITEM_INT(m)) => Some(m.mission_type),
        _ => None,
    }
}

fn is_same(a: Peer, b: Peer) -> bool {
    a.link == b.link && a.address.system == b.address.system
}

fn acknowledge(to: Peer, command: u16, result: u8, out: &mut Outbox) {
    let ack = raw::COMMAND_ACK_DATA {
        command,
        result,
        progress: 0,
        result_param2: 0,
        target_system: to.address.system,
        target_component: to.address.component,
    };
    out.send_raw(
        Destination::Link(to.link),
        raw::MavMessage::COMMAND_ACK(ack),
    );
}

#[cfg(test)]
mod tests;
