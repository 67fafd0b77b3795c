//! Who is in control: CONTROL_STATUS and MAV_CMD_REQUEST_OPERATOR_CONTROL.
//!
//! | `CTRL_POLICY` | Who may command |
//! | --- | --- |
//! | open | every pilot, as long as nobody has asked for control; then the station that has it, STOP aside |
//! | exclusive | the station in control, which must be asked for; others get NOT_IN_CONTROL, STOP aside |
//!
//! | Happens | Then |
//! | --- | --- |
//! | control is asked for, nobody has it | granted |
//! | another has it and allows takeover | granted, the owner is told |
//! | another has it | FAILED, the request is passed on to the owner; allowed or released within parameter 3 (3 to 60 s, 10 if not given) it is granted then |
//! | the owner gives it back | free |
//! | the owner's heartbeat is silent for 3 s | free; in exclusive the ground-loss failsafe runs even if others watch |
//! | the owner's link is gone | the same |
//!
//! An owner is a system id *on a link*: the same number from somewhere else is somebody else. When control gets free the sticks are
//! centred.
//!
//! Parameters of the command: 1 action (0 release, 1 request), 2 takeover allowed (0 ask me, 1 always), 3 time to answer, s, 4 system
//! of the station (0 = the sender; another is refused: nobody asks for somebody else).
//! CONTROL_STATUS goes out once a second while somebody is in control or the policy is exclusive, at each change, and on request.

#[cfg(test)]
mod tests;

use super::{Context, Destination, LinkId, Outbox, Peer, command as commands};
use crate::autopilot::door::{ManualInput, Request, Severity};
use core::time::Duration;
use mavlink_dialect::command::{Command, cmd, result};
use mavlink_dialect::standard::{CONTROL_STATUS_DATA, GcsControlStatusFlags, MavMessage};
use mavlink_dialect::{Message, raw};
use vehicle::Timestamp;

vehicle::param_choice! {
    /// Who may command the vehicle.
    pub enum ControlPolicy {
        /// Every station of role pilot.
        Open = 0, "open";
        /// The station that asked for control.
        Exclusive = 1, "exclusive";
    }
}

/// An owner silent for longer is gone.
pub const OWNER_SILENT: Duration = Duration::from_secs(3);
/// Time between two CONTROL_STATUS.
const PERIOD: Duration = Duration::from_secs(1);
const CONTROL_STATUS: i32 = 512;
/// Time an owner has to answer, unless the request says another.
const ANSWER_S: f32 = 10.0;

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

/// The station in control.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Owner {
    peer: Peer,
    heard: Timestamp,
    allows_takeover: bool,
    /// Its link is down.
    is_gone: bool,
}

/// A station that waits for the owner's word.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Waiting {
    peer: Peer,
    allows_takeover: bool,
    until: Timestamp,
}

/// Keeps who is in control.
#[derive(Debug, Default)]
pub struct OperatorControl {
    owner: Option<Owner>,
    waiting: Option<Waiting>,
    lease: u64,
    /// The owner fell silent while armed: nobody else's heartbeat makes up for it.
    is_bereft: bool,
    next_status: Timestamp,
}

impl OperatorControl {
    /// Nobody is in control.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// System in control, 0 if none is.
    #[must_use]
    pub fn main_system(&self) -> u8 {
        self.owner.map_or(0, |o| o.peer.address.system)
    }

    /// Who has control.
    #[must_use]
    pub fn control(&self) -> Control {
        Control {
            owner: self.owner.map(|o| (o.peer.link, o.peer.address.system)),
            lease: self.lease,
            is_open: self.owner.is_some_and(|o| o.allows_takeover),
            asking: self.waiting.map(|w| w.peer.address.system),
        }
    }

    /// True if a station may command now.
    #[must_use]
    pub fn admits(&self, from: Peer, ctx: &Context<'_>) -> bool {
        match self.owner {
            Some(_) => self.has(from),
            None => is_open(ctx),
        }
    }

    fn has(&self, station: Peer) -> bool {
        self.owner.is_some_and(|o| is_same(o.peer, station))
    }

    /// Why a station may not.
    #[must_use]
    pub fn reason(&self) -> String {
        match self.main_system() {
            0 => "nobody is in control (CTRL_POLICY exclusive): ask for it".to_owned(),
            owner => format!("system {owner} is in control: ask for it"),
        }
    }

    /// True if a ground station's heartbeat counts as "the ground is there".
    #[must_use]
    pub fn counts_as_presence(&self, from: Peer, ctx: &Context<'_>) -> bool {
        match self.owner {
            _ if is_open(ctx) => true,
            Some(owner) => is_same(owner.peer, from),
            None => !self.is_bereft,
        }
    }

    /// CONTROL_STATUS as it is now.
    #[must_use]
    pub fn status(&self) -> MavMessage {
        let mut flags = GcsControlStatusFlags::GCS_CONTROL_STATUS_FLAGS_SYSTEM_MANAGER;
        flags.set(
            GcsControlStatusFlags::GCS_CONTROL_STATUS_FLAGS_TAKEOVER_ALLOWED,
            self.owner.is_none_or(|o| o.allows_takeover),
        );
        MavMessage::CONTROL_STATUS(CONTROL_STATUS_DATA {
            flags,
            gcs_main: self.main_system(),
            gcs_secondary: [0; 10],
        })
    }

    /// A message of a station that may fly; true if it was a request for control, which is answered here.
    pub fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        out: &mut Outbox,
    ) -> bool {
        let command = match message {
            Message::Raw(raw::MavMessage::COMMAND_LONG(m)) => Command::from_long(m),
            Message::Raw(raw::MavMessage::COMMAND_INT(m)) => Command::from_int(m),
            Message::Raw(raw::MavMessage::HEARTBEAT(_)) => {
                if let Some(owner) = self.owner.as_mut().filter(|o| is_same(o.peer, from)) {
                    owner.heard = now;
                }
                return false;
            }
            _ => return false,
        };
        if command.number == cmd::REQUEST_MESSAGE && command.whole(1) == Some(CONTROL_STATUS) {
            commands::ack(from, command.number, result::ACCEPTED, out);
            out.send(Destination::All, self.status());
            return true;
        }
        if command.number != cmd::REQUEST_OPERATOR_CONTROL {
            return false;
        }
        let before = self.owner;
        let result = self.asked(now, from, &command, out);
        commands::ack(from, command.number, result, out);
        if before != self.owner {
            self.tell(now, out);
        }
        true
    }

    fn asked(&mut self, now: Timestamp, from: Peer, c: &Command, out: &mut Outbox) -> u8 {
        let system = c.whole(4).unwrap_or(0);
        if system != 0 && system != i32::from(from.address.system) {
            return result::DENIED;
        }
        let allows_takeover = c.whole(2) == Some(1);
        match (c.whole(1), self.owner) {
            (Some(0), Some(owner)) if is_same(owner.peer, from) => {
                // Who waits gets it without a moment in which anybody else could.
                self.free(out);
                self.grant_waiting(now, out);
                result::ACCEPTED
            }
            // Giving back what one does not have changes nothing.
            (Some(0), _) => result::ACCEPTED,
            (Some(1), Some(owner)) if is_same(owner.peer, from) => {
                self.owner = Some(Owner {
                    heard: now,
                    allows_takeover,
                    ..owner
                });
                if allows_takeover {
                    self.grant_waiting(now, out);
                }
                result::ACCEPTED
            }
            (Some(1), Some(owner)) if !owner.allows_takeover => {
                let time_s = c.param(3).filter(|t| *t > 0.0).unwrap_or(ANSWER_S);
                self.waiting = Some(Waiting {
                    peer: from,
                    allows_takeover,
                    until: now + Duration::from_secs_f32(time_s.clamp(3.0, 60.0)),
                });
                self.pass_on(owner, from, c, out);
                result::FAILED
            }
            (Some(1), owner) => {
                self.take(now, from, allows_takeover);
                if let Some(owner) = owner {
                    out.text(
                        Severity::Warning,
                        format!(
                            "System {} took control from system {}",
                            from.address.system, owner.peer.address.system
                        ),
                    );
                }
                result::ACCEPTED
            }
            _ => result::DENIED,
        }
    }

    /// Lets the owner decide.
    fn pass_on(&self, owner: Owner, from: Peer, c: &Command, out: &mut Outbox) {
        let request = raw::COMMAND_LONG_DATA {
            target_system: owner.peer.address.system,
            target_component: owner.peer.address.component,
            command: cmd::REQUEST_OPERATOR_CONTROL,
            param1: 1.0,
            param2: c.params[1],
            param3: c.params[2],
            param4: f32::from(from.address.system),
            ..Default::default()
        };
        out.send_raw(Destination::All, raw::MavMessage::COMMAND_LONG(request));
        out.text(
            Severity::Warning,
            format!(
                "System {} asks system {} for control",
                from.address.system, owner.peer.address.system
            ),
        );
    }

    fn take(&mut self, now: Timestamp, peer: Peer, allows_takeover: bool) {
        self.is_bereft = false;
        self.lease += 1;
        self.owner = Some(Owner {
            peer,
            heard: now,
            allows_takeover,
            is_gone: false,
        });
        self.waiting = self.waiting.filter(|w| !is_same(w.peer, peer));
    }

    /// Nobody is in control, and nobody's sticks are deflected.
    fn free(&mut self, out: &mut Outbox) {
        if let Some(owner) = self.owner.take() {
            self.lease += 1;
            let centred = ManualInput {
                forward: Some(0.0),
                right: Some(0.0),
                yaw: Some(0.0),
                throttle: Some(0.5),
            };
            out.ask(owner.peer, Request::Manual(centred));
        }
    }

    /// A link is gone, and with it who waited for control there; who had it loses it with the next tick.
    pub fn link_down(&mut self, link: LinkId) {
        self.waiting = self.waiting.filter(|w| w.peer.link != link);
        if let Some(owner) = self.owner.as_mut().filter(|o| o.peer.link == link) {
            owner.is_gone = true;
        }
    }

    fn lose(&mut self, now: Timestamp, owner: Owner, ctx: &Context<'_>, out: &mut Outbox) {
        self.free(out);
        self.is_bereft = ctx.snapshot.is_armed && !is_open(ctx);
        let system = owner.peer.address.system;
        out.text(
            Severity::Warning,
            format!("System {system} lost: control is free"),
        );
        self.grant_waiting(now, out);
        self.tell(now, out);
    }

    fn grant_waiting(&mut self, now: Timestamp, out: &mut Outbox) {
        if let Some(waiting) = self.waiting.take().filter(|w| now < w.until) {
            self.take(now, waiting.peer, waiting.allows_takeover);
            out.text(
                Severity::Notice,
                format!("System {} is in control", waiting.peer.address.system),
            );
        }
    }

    /// Takes the time: who is silent loses control, the status is told.
    pub fn tick(&mut self, now: Timestamp, ctx: &Context<'_>, out: &mut Outbox) {
        self.waiting = self.waiting.filter(|w| now < w.until);
        self.is_bereft &= ctx.snapshot.is_armed;
        if let Some(owner) = self.owner
            && (owner.is_gone || now.since(owner.heard) >= OWNER_SILENT)
        {
            self.lose(now, owner, ctx, out);
        } else if now >= self.next_status && (self.owner.is_some() || !is_open(ctx)) {
            self.tell(now, out);
        }
    }

    fn tell(&mut self, now: Timestamp, out: &mut Outbox) {
        self.next_status = now + PERIOD;
        out.send(Destination::All, self.status());
    }
}

fn is_same(a: Peer, b: Peer) -> bool {
    a.link == b.link && a.address.system == b.address.system
}

fn is_open(ctx: &Context<'_>) -> bool {
    ctx.settings.ground.control_policy == ControlPolicy::Open
}
