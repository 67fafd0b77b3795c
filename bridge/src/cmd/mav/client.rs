//! The connection: one link, frames in and out, commands with their answers.

use super::super::Usage;
use anyhow::{Result, anyhow, bail};
use bridge::gcs::LinkId;
use bridge::io::clock::{self, Clock};
use bridge::io::endpoint::{Endpoint, EndpointError, split_options};
use bridge::io::net::{LinkEvent, Links, Wanted};
use mavlink_dialect::command::result;
use mavlink_dialect::signing::{SigningKey, SigningState};
use mavlink_dialect::{Address, Decoder, Encoder, Frame, FrameView, Message, raw};
use std::collections::VecDeque;
use std::time::Duration;
use vehicle::Timestamp;

/// MAV_TYPE_GCS, and one that is none.
const TYPE_GCS: u8 = 6;
const TYPE_ONBOARD_CONTROLLER: u8 = 18;
/// A question without an answer is asked again.
const ASK_AGAIN: Duration = Duration::from_millis(500);
/// So often in all.
pub(super) const TRIES: u32 = 4;
/// A command that is under way has this long.
const FINAL_ANSWER: Duration = Duration::from_secs(15);

/// Nobody is there, or nobody answers: exit code 3.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct Silent(pub(super) String);

/// A client of one vehicle.
pub(super) struct Client {
    links: Links,
    link: Option<LinkId>,
    decoder: Decoder,
    encoder: Encoder,
    key: Option<SigningKey>,
    signing: SigningState,
    clock: Clock,
    next_beat: Timestamp,
    is_station: bool,
    frames: VecDeque<Frame>,
    /// The vehicle.
    pub(super) vehicle: Address,
    /// Us.
    pub(super) us: Address,
    text: String,
}

impl Client {
    /// Opens the link and waits for a vehicle.
    pub(super) fn connect(
        url: &str,
        system: u8,
        patience_s: f64,
        is_station: bool,
    ) -> Result<Self> {
        let wrong = |e: EndpointError| Usage(e.to_string());
        if !(0.1..=600.0).contains(&patience_s) {
            return Err(Usage("--patience: 0.1 to 600 s".to_owned()).into());
        }
        let (base, policy) = split_options(url).map_err(wrong)?;
        let endpoint: Endpoint = base.parse().map_err(wrong)?;
        let key = policy.key.clone();
        let links = Links::open(&[Wanted {
            endpoint,
            is_default: false,
            policy,
        }])
        .map_err(|e| anyhow!(e))?;
        let us = Address {
            system,
            component: 190,
        };
        let mut client = Self {
            links,
            link: None,
            decoder: Decoder::new(),
            encoder: Encoder::new(us),
            key,
            signing: SigningState::new(0),
            clock: Clock::start(1.0),
            next_beat: Timestamp::ZERO,
            is_station,
            frames: VecDeque::new(),
            vehicle: Address {
                system: 0,
                component: 1,
            },
            us,
            text: String::new(),
        };
        let until = client.now() + Duration::from_secs_f64(patience_s);
        while let Some(frame) = client.next(until) {
            if let Message::Raw(raw::MavMessage::HEARTBEAT(beat)) = &frame.message
                && frame.from.component == 1
                && beat.autopilot != 8
            {
                client.vehicle = frame.from;
                return Ok(client);
            }
        }
        Err(Silent(format!(
            "no vehicle at {base} within {patience_s} s (is Kestrel running? --to names another place)"
        ))
        .into())
    }

    pub(super) fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// In so many seconds.
    pub(super) fn within(&self, seconds: f64) -> Timestamp {
        self.now() + Duration::from_secs_f64(seconds)
    }

    /// The next frame before a time; texts of the vehicle are shown on the way.
    pub(super) fn next(&mut self, until: Timestamp) -> Option<Frame> {
        loop {
            if let Some(frame) = self.frames.pop_front() {
                self.show_text(&frame);
                return Some(frame);
            }
            let now = self.now();
            if now >= until {
                return None;
            }
            self.beat(now);
            let wait = self.clock.until(until.min(self.next_beat));
            let mut event = self.links.wait(wait.min(Duration::from_millis(50)));
            while let Some(e) = event {
                self.take(e);
                event = self.links.poll();
            }
        }
    }

    fn take(&mut self, event: LinkEvent) {
        match event {
            LinkEvent::Up(link) => {
                self.link = Some(link);
                // Whoever listens must hear us before they speak to us.
                self.next_beat = Timestamp::ZERO;
            }
            LinkEvent::Down(link) => self.link = self.link.filter(|l| *l != link),
            LinkEvent::Bytes {
                link,
                bytes,
                is_datagram,
            } => {
                self.link = Some(link);
                let (frames, key, signing) = (&mut self.frames, &self.key, &mut self.signing);
                signing.set_utc(clock::utc_us());
                let mut keep = |view: &FrameView<'_>, message: &Message| {
                    let is_good = key
                        .as_ref()
                        .is_none_or(|key| signing.check(key, view.from, view.wire).is_ok());
                    if is_good {
                        frames.push_back(view.frame(message.clone()));
                    }
                };
                self.decoder.push_wire(&bytes, &mut keep);
                if is_datagram {
                    self.decoder.end_of_datagram_wire(&mut keep);
                }
            }
        }
    }

    fn beat(&mut self, now: Timestamp) {
        if now < self.next_beat || self.link.is_none() {
            return;
        }
        self.next_beat = now + Duration::from_secs(1);
        self.send(raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA {
            mavtype: if self.is_station {
                TYPE_GCS
            } else {
                TYPE_ONBOARD_CONTROLLER
            },
            autopilot: 8,
            mavlink_version: 3,
            ..Default::default()
        }));
    }

    /// Sends a message.
    pub(super) fn send(&mut self, message: impl Into<Message>) {
        let Some(link) = self.link else { return };
        let message = message.into();
        let bytes = match &self.key {
            None => self.encoder.encode_message(&message),
            Some(key) => {
                self.signing.set_utc(clock::utc_us());
                self.encoder
                    .encode_signed(&message, key, 0, self.signing.stamp())
            }
        };
        self.links.send(link, bytes);
    }

    fn show_text(&mut self, frame: &Frame) {
        let Message::Raw(raw::MavMessage::STATUSTEXT(m)) = &frame.message else {
            return;
        };
        let piece = m.text.to_str().unwrap_or("").to_owned();
        let is_last = m.id == 0 || piece.len() < 50;
        self.text.push_str(&piece);
        if is_last {
            let text = core::mem::take(&mut self.text);
            if m.severity <= 4 {
                complain_softly(&text);
            }
        }
    }

    /// Asks until `answer` makes something of a frame of the vehicle.
    pub(super) fn ask<T>(
        &mut self,
        what: &str,
        question: impl Into<Message>,
        mut answer: impl FnMut(&Message) -> Option<T>,
    ) -> Result<T> {
        let question = question.into();
        for _ in 0..TRIES {
            self.send(question.clone());
            let until = self.now() + ASK_AGAIN;
            while let Some(frame) = self.next(until) {
                if frame.from == self.vehicle
                    && let Some(answer) = answer(&frame.message)
                {
                    return Ok(answer);
                }
            }
        }
        Err(Silent(format!("{what}: the vehicle does not answer")).into())
    }

    /// A command in its INT form, and its result; refusals are errors with the vehicle's reason above them.
    pub(super) fn command(&mut self, what: &str, command: raw::COMMAND_INT_DATA) -> Result<()> {
        let number = command.command;
        let command = raw::COMMAND_INT_DATA {
            target_system: self.vehicle.system,
            target_component: self.vehicle.component,
            ..command
        };
        let us = self.us;
        let ours = move |m: &Message| match m {
            Message::Raw(raw::MavMessage::COMMAND_ACK(ack))
                if ack.command == number && ack.target_system == us.system =>
            {
                Some(ack.result)
            }
            _ => None,
        };
        let mut result = self.ask(what, raw::MavMessage::COMMAND_INT(command), ours)?;
        let until = self.now() + FINAL_ANSWER;
        while result == result::IN_PROGRESS {
            let Some(frame) = self.next(until) else {
                return Err(Silent(format!("{what}: begun, but its end was not told")).into());
            };
            result = ours(&frame.message).unwrap_or(result);
        }
        if result == result::ACCEPTED {
            return Ok(());
        }
        // The reason comes as a text, just before or after.
        let until = self.within(0.3);
        while self.next(until).is_some() {}
        bail!("{what}: {}", result_name(result))
    }

    /// Waits until `is_done` says so of some message.
    pub(super) fn wait_until(
        &mut self,
        what: &str,
        seconds: f64,
        mut is_done: impl FnMut(&Message) -> bool,
    ) -> Result<()> {
        let until = self.within(seconds);
        while let Some(frame) = self.next(until) {
            if frame.from == self.vehicle && is_done(&frame.message) {
                return Ok(());
            }
        }
        bail!("{what}: not within {seconds} s")
    }
}

/// A text of the vehicle that is louder than a notice.
fn complain_softly(text: &str) {
    use std::io::Write as _;
    // A closed terminal is no reason to fail.
    let _ = writeln!(std::io::stderr(), "vehicle: {text}");
}

fn result_name(result: u8) -> String {
    let name = match result {
        1 => "refused for now",
        2 => "refused",
        3 => "not supported",
        4 => "failed",
        6 => "cancelled",
        10 => "another station is in control",
        _ => return format!("result {result}"),
    };
    name.to_owned()
}
