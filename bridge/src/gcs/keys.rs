//! The key console: text lines on SERIAL_CONTROL device SHELL, as QGroundControl's MAVLink Console, MAVProxy's `nsh` and
//! MAVSDK's shell speak it. It flies; it is never a shell of the operating system.
//!
//! | On the wire | Rule |
//! | --- | --- |
//! | bytes | kept per sender until ENTER, which is `\r`, `\n` or the pair; a half line is dropped after 10 s |
//! | `count` | at most 70; 0 is a poll: it brings out what is waiting and nothing else |
//! | flags | REPLY set: not for us. All replies at once whatever RESPOND and MULTI say: MAVSDK 4.1.0 asks with RESPOND alone and expects all |
//! | EXCLUSIVE, BLOCKING | ignored: each sender has a console of its own |
//! | replies | device 10, flag REPLY, at most 70 bytes, to the sender, plain ASCII, ending in the prompt |
//! | other devices | silence |
//!
//! A line is a word (`help` lists them), or letters of the key table taken one by one. Keys count while manual mode is on
//! (`m`); the reply to each repeats the set point.
//!
//! ```text
//! kestrel> m
//! m: manual mode on: roll +0.000 nose-down +0.000 yaw +1.571 rad, x +1.00 y +2.00 height 1.00 m, mass 1.700 kg
//! kestrel> jj
//! j: roll +0.045 nose-down +0.000 yaw +1.571 rad, x +1.00 y +2.00 height 1.00 m, mass 1.700 kg
//! j: roll +0.090 nose-down +0.000 yaw +1.571 rad, x +1.00 y +2.00 height 1.00 m, mass 1.700 kg
//! ```

mod line;
mod report;
#[cfg(test)]
mod tests;

pub(super) use self::line::key;

use self::line::{HELP, Line, Typed, Word};
use super::access::Role;
use super::{Context, Destination, Outbox, Peer};
use crate::autopilot::door::{Answer, Key, Outcome, Refusal, Request, RequestId};
use crate::autopilot::mode::Mode;
use crate::settings::Origin;
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::{Address, Message, raw};
use std::collections::VecDeque;
use vehicle::Timestamp;

/// SERIAL_CONTROL_DEV_SHELL.
const SHELL: u8 = 10;
/// SERIAL_CONTROL_FLAG: this is a reply.
const REPLY: u8 = 1;

/// Payload of one SERIAL_CONTROL, bytes.
const CHUNK: usize = 70;
/// Longest line.
const MAX_LINE: usize = 256;
/// Consoles at once; one more takes the place of the one silent longest.
const MAX_CONSOLES: usize = 8;
/// Most requests of one console without an answer.
const MAX_PENDING: usize = 2 * line::MAX_KEYS;
/// Output kept for a console that does not poll; what is older is lost.
const MAX_OUTPUT: usize = 8192;
/// A half line older than this is dropped.
const STALE: Duration = Duration::from_secs(10);
/// A request without an answer is given up.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// Time within which the answer to a key is newer than the snapshot.
const SNAPSHOT_LAG: Duration = Duration::from_millis(200);

const PROMPT: &str = "kestrel> ";

/// All consoles.
#[derive(Debug, Default)]
pub struct KeyConsole {
    consoles: ArrayVec<Console, MAX_CONSOLES>,
    /// Manual mode as the last answer to a key said.
    manual: Option<(bool, Timestamp)>,
}

/// The console of one sender.
#[derive(Debug)]
struct Console {
    peer: Peer,
    heard_at: Timestamp,
    line: ArrayVec<u8, MAX_LINE>,
    is_too_long: bool,
    /// The last byte was `\r`: a `\n` now belongs to it.
    was_return: bool,
    output: VecDeque<u8>,
    pending: ArrayVec<Pending, MAX_PENDING>,
    /// The refusal printed last for the line under way: a line of keys refused for one reason says it once.
    refusal: Option<Refusal>,
}

#[derive(Debug)]
struct Pending {
    id: RequestId,
    label: Label,
    since: Timestamp,
}

/// What a request was, for the reply to its answer.
#[derive(Clone, Debug, PartialEq)]
enum Label {
    Key(Typed),
    Word(&'static str),
    Param(String),
}

impl KeyConsole {
    /// No console open.
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
        out: &mut Outbox,
    ) {
        let Message::Raw(raw::MavMessage::SERIAL_CONTROL(m)) = message else {
            return;
        };
        if m.device != SHELL || m.flags & REPLY != 0 {
            return;
        }
        let bytes = &m.data[..usize::from(m.count).min(CHUNK)];
        let is_manual = self.is_manual(now, ctx);
        let Some(console) = self.console(now, from, !bytes.is_empty()) else {
            return;
        };
        console.drop_stale_line(now);
        console.peer = from;
        console.heard_at = now;
        console.push(now, bytes, is_manual, ctx, out);
        console.flush(out);
    }

    /// Takes the time: half lines grow stale, requests are given up.
    pub fn tick(&mut self, now: Timestamp, _ctx: &Context<'_>, out: &mut Outbox) {
        for console in &mut self.consoles {
            console.drop_stale_line(now);
            let before = console.pending.len();
            console
                .pending
                .retain(|p| now.since(p.since) < ANSWER_TIMEOUT);
            if console.pending.len() < before {
                console.print("no answer\n");
                console.prompt_if_done();
                console.flush(out);
            }
        }
    }

    /// Takes the vehicle's answer; true if it was to a console's request.
    pub fn answer(
        &mut self,
        now: Timestamp,
        answer: &Answer,
        _ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> bool {
        if let Outcome::KeyTaken(setpoint) = answer.outcome {
            self.manual = Some((setpoint.is_manual, now));
        }
        for console in &mut self.consoles {
            if let Some(at) = console.pending.iter().position(|p| p.id == answer.id) {
                let Pending { label, .. } = console.pending.remove(at);
                console.report(&label, &answer.outcome);
                console.prompt_if_done();
                console.flush(out);
                return true;
            }
        }
        false
    }

    /// Keys may count. While a toggle is under way they may: only the vehicle knows.
    fn is_manual(&self, now: Timestamp, ctx: &Context<'_>) -> bool {
        if self.consoles.iter().any(Console::is_toggling) {
            return true;
        }
        match self.manual {
            Some((is_manual, at)) if now.since(at) < SNAPSHOT_LAG => is_manual,
            _ => ctx.snapshot.is_key_mode,
        }
    }

    /// The sender's console; opened if need be and `open` says so.
    fn console(&mut self, now: Timestamp, peer: Peer, open: bool) -> Option<&mut Console> {
        let at = match self
            .consoles
            .iter()
            .position(|c| c.peer.address == peer.address)
        {
            Some(at) => at,
            None if open => {
                if self.consoles.is_full() {
                    let oldest = self
                        .consoles
                        .iter()
                        .enumerate()
                        .min_by_key(|(_, c)| c.heard_at)
                        .map_or(0, |(i, _)| i);
                    self.consoles.remove(oldest);
                }
                self.consoles.push(Console::new(now, peer));
                self.consoles.len() - 1
            }
            None => return None,
        };
        self.consoles.get_mut(at)
    }
}

impl Console {
    fn new(now: Timestamp, peer: Peer) -> Self {
        Self {
            peer,
            heard_at: now,
            line: ArrayVec::new(),
            is_too_long: false,
            was_return: false,
            output: VecDeque::new(),
            pending: ArrayVec::new(),
            refusal: None,
        }
    }

    fn is_toggling(&self) -> bool {
        self.pending
            .iter()
            .any(|p| matches!(p.label, Label::Key((_, Key::ToggleManual))))
    }

    fn drop_stale_line(&mut self, now: Timestamp) {
        if !self.line.is_empty() && now.since(self.heard_at) >= STALE {
            self.line.clear();
            self.is_too_long = false;
        }
    }

    fn push(
        &mut self,
        now: Timestamp,
        bytes: &[u8],
        is_manual: bool,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        for byte in bytes {
            match byte {
                b'\n' if self.was_return => self.was_return = false,
                b'\r' | b'\n' => {
                    self.was_return = *byte == b'\r';
                    self.enter(now, is_manual, ctx, out);
                }
                byte => {
                    self.was_return = false;
                    self.is_too_long |= self.line.try_push(*byte).is_err();
                }
            }
        }
    }

    /// ENTER: carries out the line.
    fn enter(&mut self, now: Timestamp, is_manual: bool, ctx: &Context<'_>, out: &mut Outbox) {
        let is_manual = is_manual || self.is_toggling();
        let line = core::mem::take(&mut self.line);
        self.refusal = None;
        if core::mem::take(&mut self.is_too_long) {
            self.print(&format!(
                "line longer than {MAX_LINE} bytes: nothing done\n"
            ));
        } else {
            match Line::parse(&line) {
                Line::Word(word) => self.word(now, word, ctx, out),
                Line::Keys(keys) => self.keys(now, &keys, is_manual, out),
                Line::Usage(usage) => self.print(&format!("usage: {usage}\n")),
                Line::Unknown(letter) if is_manual => {
                    self.print(&format!(
                        "`{}` is no key: nothing done\n",
                        letter.escape_default()
                    ));
                }
                Line::Unknown(_) => {
                    let line = String::from_utf8_lossy(&line);
                    self.print(&format!(
                        "unknown command `{}`: try help\n",
                        line.trim().escape_default()
                    ));
                }
            }
        }
        self.prompt_if_done();
    }

    fn keys(&mut self, now: Timestamp, keys: &[Typed], is_manual: bool, out: &mut Outbox) {
        // Once `m` is in the line only the vehicle knows what the keys behind it find.
        let mut may_count = is_manual;
        for typed in keys {
            match typed.1 {
                Key::ToggleManual => may_count = true,
                Key::Escape | Key::Marker => {}
                _ if may_count => {}
                _ => {
                    let why = Refusal::KeyModeOff;
                    self.print(&format!("{}: ignored: {why}\n", typed.0));
                    return;
                }
            }
            self.ask(now, Label::Key(*typed), Request::Key(typed.1), out);
        }
    }

    fn word(&mut self, now: Timestamp, word: Word, ctx: &Context<'_>, out: &mut Outbox) {
        let (label, request) = match word {
            Word::Help => return self.print(HELP),
            Word::Status => return self.print(&report::status(ctx.snapshot)),
            Word::ParamGet(name) => return self.print(&report::param(ctx.settings, &name)),
            Word::ParamSet(..) if ctx.role < Role::Engineer => {
                return self
                    .print("param set: this link's role is pilot, parameters need engineer\n");
            }
            Word::ParamSet(name, value) => return self.set_param(now, &name, &value, ctx, out),
            Word::Arm => ("arm", Request::Arm { force: false }),
            Word::Disarm => ("disarm", Request::Disarm { force: false }),
            Word::Takeoff(height) => {
                let ceiling_m = ctx.settings.autopilot.ceiling_m;
                (
                    "takeoff",
                    Request::Takeoff {
                        height_m: height.map(|h| h.clamp(0.3, ceiling_m)),
                    },
                )
            }
            Word::Land => ("land", Request::SetMode(Mode::Land)),
            Word::Hold => ("hold", Request::SetMode(Mode::Hold)),
            Word::Return => ("return", Request::SetMode(Mode::Return)),
        };
        self.ask(now, Label::Word(label), request, out);
    }

    fn set_param(
        &mut self,
        now: Timestamp,
        name: &str,
        value: &str,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        // On a copy: the settings change when the request passes on its way to the vehicle, like every PARAM_SET.
        let mut settings = ctx.settings.clone();
        if let Err(why) = settings.set_text(name, value, Origin::Mavlink) {
            return self.print(&format!("{why}\n"));
        }
        let is_it = |r: &crate::settings::Row<'_>| {
            r.meta.id.eq_ignore_ascii_case(name) || format!("{}.{}", r.section, r.meta.key) == name
        };
        if let Some(row) = settings.rows().find(is_it) {
            let label = Label::Param(format!("{} = {}", row.meta.id, row.value));
            self.ask(
                now,
                label,
                Request::SetParam {
                    index: row.index as u16,
                    value: row.value,
                },
                out,
            );
        }
    }

    fn ask(&mut self, now: Timestamp, label: Label, request: Request, out: &mut Outbox) {
        if self.pending.is_full() {
            return self.print("too many requests at once: nothing done\n");
        }
        let id = out.ask(self.peer, request);
        self.pending.push(Pending {
            id,
            label,
            since: now,
        });
    }

    /// The reply to an answer.
    fn report(&mut self, label: &Label, outcome: &Outcome) {
        let name = match label {
            Label::Key(('\u{1B}', _)) => "ESC".to_owned(),
            Label::Key(('\r', _)) => "ENTER".to_owned(),
            Label::Key((letter, _)) => letter.to_string(),
            Label::Word(word) => (*word).to_owned(),
            Label::Param(param) => param.clone(),
        };
        match outcome {
            Outcome::Refused(why) => {
                if self.refusal.replace(*why) != Some(*why) {
                    self.print(&format!("{name}: refused: {why}\n"));
                }
            }
            Outcome::Accepted => match label {
                Label::Key((_, Key::Marker)) => self.print("marker\n"),
                Label::Param(_) => self.print(&format!("{name}\n")),
                Label::Key(_) | Label::Word(_) => self.print(&format!("{name}: ok\n")),
            },
            Outcome::KeyTaken(setpoint) => {
                let text = report::setpoint(setpoint);
                match label {
                    Label::Key((_, Key::ToggleManual)) if setpoint.is_manual => {
                        self.print(&format!("{name}: manual mode on: {text}\n"));
                    }
                    Label::Key((_, Key::ToggleManual)) => {
                        self.print(&format!("{name}: manual mode off\n"))
                    }
                    Label::Key((_, Key::Marker)) => self.print(&format!("marker: {text}\n")),
                    _ => self.print(&format!("{name}: {text}\n")),
                }
            }
        }
    }

    fn prompt_if_done(&mut self) {
        if self.pending.is_empty() {
            self.print(PROMPT);
        }
    }

    fn print(&mut self, text: &str) {
        self.output.extend(
            text.chars()
                .map(|c| if c.is_ascii() { c as u8 } else { b'?' }),
        );
        let excess = self.output.len().saturating_sub(MAX_OUTPUT);
        self.output.drain(..excess);
    }

    fn flush(&mut self, out: &mut Outbox) {
        while !self.output.is_empty() {
            let count = self.output.len().min(CHUNK);
            let bytes: ArrayVec<u8, CHUNK> = self.output.drain(..count).collect();
            send_chunk(self.peer, SHELL, &bytes, out);
        }
    }
}

/// A line to a sender that has no console, because it may not type.
pub(super) fn reply(to: Peer, device: u8, text: &str, out: &mut Outbox) {
    if device == SHELL {
        for bytes in text.as_bytes().chunks(CHUNK) {
            send_chunk(to, device, bytes, out);
        }
    }
}

/// To the sender's link only: other consoles would print what they did not ask.
fn send_chunk(to: Peer, device: u8, bytes: &[u8], out: &mut Outbox) {
    let mut data = [0; CHUNK];
    data[..bytes.len()].copy_from_slice(bytes);
    let Address { system, component } = to.address;
    let reply = raw::SERIAL_CONTROL_DATA {
        device,
        flags: REPLY,
        count: bytes.len() as u8,
        data,
        target_system: system,
        target_component: component,
        ..Default::default()
    };
    out.send_raw(
        Destination::Link(to.link),
        raw::MavMessage::SERIAL_CONTROL(reply),
    );
}
