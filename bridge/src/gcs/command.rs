//! Commands: COMMAND_LONG, COMMAND_INT, COMMAND_CANCEL and the older SET_MODE, each answered by COMMAND_ACK.
//!
//! What each command does is the table in `command/table.rs`; here is what all have in common.
//!
//! | Rule | |
//! | --- | --- |
//! | target of the ACK | the station that asked |
//! | asked of the vehicle | the ACK follows its answer; IN_PROGRESS if that takes more than 80 ms, FAILED after 10 s |
//! | refused | the reason also goes out as STATUSTEXT |
//! | the same command again while it runs | IN_PROGRESS, not carried out twice |
//! | the same command again with a counted `confirmation` within 3 s of its answer | the answer again |
//! | a command we do not know | UNSUPPORTED at once |
//! | COMMAND_CANCEL of an arm that runs | disarmed, CANCELLED; nothing else runs long enough |
//! | more than 32 commands at once | TEMPORARILY_REJECTED |

mod table;
pub(super) use self::table::{label, mode_of};
#[cfg(test)]
mod tests;

use self::table::Verdict;
use super::access::Role;
use super::convert::{mode_from_px4, result_of_refusal};
use super::{Context, Destination, LinkId, Outbox, Peer};
use crate::autopilot::door::{Answer, Outcome, Refusal, Request, RequestId, Severity};
use crate::autopilot::mode::Mode;
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::command::{Command, cmd, result};
use mavlink_dialect::mode::{FLAG_CUSTOM, Px4Mode};
use mavlink_dialect::{Message, raw};
use vehicle::Timestamp;

/// Commands remembered, running or answered.
const CAPACITY: usize = 32;
/// A station may wait this long for the first answer (the ground contract promises 100 ms).
const IN_PROGRESS_AFTER: Duration = Duration::from_millis(80);
/// The vehicle may take this long for the last one.
const GIVE_UP: Duration = Duration::from_secs(10);
/// A repeat this long after the answer is a repeat: MAVSDK asks three times half a second apart.
const REPEAT_WINDOW: Duration = Duration::from_secs(3);
/// COMMAND_ACK.progress: not known.
const PROGRESS_UNKNOWN: u8 = u8::MAX;

/// What we send at a rate or on request, as commands need it; telemetry is one.
pub trait Streams {
    /// MAV_CMD_SET_MESSAGE_INTERVAL on one link, us: 0 = the default, -1 = off. Returns a MAV_RESULT.
    fn set_interval(&mut self, now: Timestamp, link: LinkId, id: u32, interval_us: i32) -> u8;
    /// MAV_CMD_GET_MESSAGE_INTERVAL on one link, us: -1 = off, 0 = never sent.
    fn interval_us(&self, link: LinkId, id: u32) -> i32;
    /// MAV_CMD_REQUEST_MESSAGE: sends it once. `param2` means what the message says. Returns a MAV_RESULT.
    fn request(
        &mut self,
        now: Timestamp,
        from: Peer,
        id: u32,
        param2: f32,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> u8;
}

/// The command service.
#[derive(Debug, Default)]
pub struct CommandService {
    entries: ArrayVec<Entry, CAPACITY>,
    /// SET_MODE under way, which has no ACK: a refusal becomes a text.
    set_mode: Option<RequestId>,
}

/// A command asked of the vehicle.
#[derive(Debug)]
struct Entry {
    client: Peer,
    command: Command,
    state: State,
}

#[derive(Debug)]
enum State {
    Running {
        request: RequestId,
        since: Timestamp,
        is_told: bool,
    },
    Answered {
        result: u8,
        at: Timestamp,
    },
}

impl CommandService {
    /// Nothing asked yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a message for us.
    pub fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        ctx: &Context<'_>,
        streams: &mut dyn Streams,
        out: &mut Outbox,
    ) {
        use raw::MavMessage as M;
        match message {
            Message::Raw(M::COMMAND_LONG(m)) => {
                self.command(now, from, Command::from_long(m), ctx, streams, out)
            }
            Message::Raw(M::COMMAND_INT(m)) => {
                self.command(now, from, Command::from_int(m), ctx, streams, out)
            }
            Message::Raw(M::COMMAND_CANCEL(m)) => self.cancel(from, m.command, out),
            Message::Raw(M::SET_MODE(m)) => self.set_mode(from, m, ctx, out),
            _ => {}
        }
    }

    /// Takes the time: who waits is told, what is over is forgotten.
    pub fn tick(&mut self, now: Timestamp, _ctx: &Context<'_>, out: &mut Outbox) {
        for entry in &mut self.entries {
            if let State::Running { since, is_told, .. } = &mut entry.state {
                if now.since(*since) >= GIVE_UP {
                    out.text(
                        Severity::Error,
                        format!("{}: the vehicle does not answer", label(&entry.command)),
                    );
                    ack(entry.client, entry.command.number, result::FAILED, out);
                    entry.state = State::Answered {
                        result: result::FAILED,
                        at: now,
                    };
                } else if !*is_told && now.since(*since) >= IN_PROGRESS_AFTER {
                    *is_told = true;
                    ack(entry.client, entry.command.number, result::IN_PROGRESS, out);
                }
            }
        }
        self.entries.retain(
            |e| !matches!(e.state, State::Answered { at, .. } if now.since(at) >= REPEAT_WINDOW),
        );
    }

    /// Takes the vehicle's answer; true if it was to one of our requests.
    pub fn answer(
        &mut self,
        now: Timestamp,
        answer: &Answer,
        _ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> bool {
        if self.set_mode == Some(answer.id) {
            self.set_mode = None;
            if let Outcome::Refused(why) = answer.outcome {
                out.text(Severity::Warning, format!("Mode refused: {why}"));
            }
            return true;
        }
        let is_it = |e: &&mut Entry| matches!(e.state, State::Running { request, .. } if request == answer.id);
        let Some(entry) = self.entries.iter_mut().find(is_it) else {
            return false;
        };
        let mut param2 = 0;
        let result = match &answer.outcome {
            Outcome::Accepted | Outcome::KeyTaken(_) => result::ACCEPTED,
            Outcome::Refused(why) => {
                out.text(
                    Severity::Warning,
                    format!("{} refused: {why}", label(&entry.command)),
                );
                if let Refusal::FcBlocks(blocks) = why {
                    param2 = blocks.flags.cast_signed();
                }
                result_of_refusal(why)
            }
        };
        ack_with(entry.client, entry.command.number, result, param2, out);
        entry.state = State::Answered { result, at: now };
        true
    }

    fn command(
        &mut self,
        now: Timestamp,
        from: Peer,
        command: Command,
        ctx: &Context<'_>,
        streams: &mut dyn Streams,
        out: &mut Outbox,
    ) {
        if let Some(result) = self.earlier_result(now, from, &command) {
            return ack(from, command.number, result, out);
        }
        let result = match table::verdict(now, from, &command, ctx, streams, out) {
            Verdict::Done(result) => result,
            Verdict::Refused(result, why) => {
                out.text(
                    Severity::Warning,
                    format!("{} refused: {why}", label(&command)),
                );
                result
            }
            Verdict::Ask(request) => {
                if !self.make_room() {
                    return ack(from, command.number, result::TEMPORARILY_REJECTED, out);
                }
                let request = out.ask(from, request);
                let state = State::Running {
                    request,
                    since: now,
                    is_told: false,
                };
                self.entries.push(Entry {
                    client: from,
                    command,
                    state,
                });
                return;
            }
        };
        ack(from, command.number, result, out);
    }

    /// The result for a command that is a repeat; none if it is a new one.
    fn earlier_result(&self, now: Timestamp, from: Peer, command: &Command) -> Option<u8> {
        let is_counted = command.confirmation > 0;
        let same = |e: &&Entry| e.client.address == from.address && e.command.is_repeat_of(command);
        // The newest: keys may be typed twice for good.
        match self.entries.iter().rev().find(same)?.state {
            State::Running { .. } if is_counted || command.number != cmd::USER_1 => {
                Some(result::IN_PROGRESS)
            }
            State::Answered { result, at } if is_counted && now.since(at) < REPEAT_WINDOW => {
                Some(result)
            }
            State::Running { .. } | State::Answered { .. } => None,
        }
    }

    /// Forgets the oldest answered command if none fits; false if all are running.
    fn make_room(&mut self) -> bool {
        if self.entries.is_full()
            && let Some(oldest) = self
                .entries
                .iter()
                .position(|e| matches!(e.state, State::Answered { .. }))
        {
            self.entries.remove(oldest);
        }
        !self.entries.is_full()
    }

    fn cancel(&mut self, from: Peer, number: u16, out: &mut Outbox) {
        let is_it = |e: &Entry| {
            let is_running = matches!(e.state, State::Running { .. });
            e.client.address == from.address
                && e.command.number == number
                && is_running
                && table::is_arm(&e.command)
        };
        if let Some(at) = self.entries.iter().position(is_it) {
            self.entries.remove(at);
            out.ask(from, Request::Disarm { force: false });
            ack(from, number, result::CANCELLED, out);
        }
    }

    fn set_mode(
        &mut self,
        from: Peer,
        m: &raw::SET_MODE_DATA,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let mode = if m.base_mode & FLAG_CUSTOM != 0 {
            mode_from_px4(Px4Mode::from_custom_mode(m.custom_mode))
        } else {
            None
        };
        match mode {
            Some(Mode::Hold) if ctx.role < Role::Pilot => {
                self.set_mode = Some(out.ask(from, Request::Stop));
            }
            Some(mode) => self.set_mode = Some(out.ask(from, table::mode_request(mode))),
            None => out.text(
                Severity::Warning,
                format!("Mode refused: {:#x} is not flown", m.custom_mode),
            ),
        }
    }
}

pub(super) fn ack(client: Peer, command: u16, result: u8, out: &mut Outbox) {
    ack_with(client, command, result, 0, out);
}

/// With `result_param2`: the blocking flags of the flight controller, as its firmware numbers them.
fn ack_with(client: Peer, command: u16, result: u8, result_param2: i32, out: &mut Outbox) {
    let ack = raw::COMMAND_ACK_DATA {
        command,
        result,
        progress: if result == result::IN_PROGRESS {
            PROGRESS_UNKNOWN
        } else {
            0
        },
        result_param2,
        target_system: client.address.system,
        target_component: client.address.component,
    };
    out.send_raw(Destination::All, raw::MavMessage::COMMAND_ACK(ack));
}
