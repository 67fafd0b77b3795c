//! One page's WebSocket: a MAVLink station with an envelope around what it sends, and the compact telemetry.
//!
//! The shell passes frames on, or does not; it makes none of its own but one: centred sticks when a page that held them has
//! fallen silent.

use super::aboard::Aboard;
use super::console::{Server, SocketPlace};
use super::dead_man::DeadMan;
use super::envelope::{COMMAND_AGE, Envelopes, Fault, STICKS_AGE};
use super::gate::{Arrival, Caller, problem};
use super::picture::Picture;
use super::role::Role;
use super::topics;
use super::witness::{Witness, words};
use crate::gcs::intent::{self, Intent};
use crate::gcs::operator::Control;
use crate::io::net::Joined;
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message as Ws, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::Response;
use mavlink_dialect::command::cmd;
use mavlink_dialect::{Address, Decoder, Encoder, Frame, FrameBytes, Message, raw};
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use vehicle::{Pace, Timestamp};

/// Largest message of a page.
const MESSAGE: usize = 4096;
/// What may wait for a page that does not read.
const UNREAD: usize = 256 * 1024;
/// A page that takes longer than this to read is disconnected.
const PATIENCE: Duration = Duration::from_secs(5);
/// A page says something every second; silent for this long it is gone.
const SILENT: Duration = Duration::from_secs(10);
/// How often released sticks are looked for.
const LOOK: Duration = Duration::from_millis(25);
/// Pictures between two looks at particles and histogram.
const SELDOM: u32 = 4;
/// MAVLink component of a ground station's page.
const COMPONENT: u8 = 190;

/// What became of a frame: the byte in an acknowledgement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Verdict {
    Passed = 0,
    Malformed = 1,
    OutOfOrder = 2,
    Old = 3,
    NotYourLease = 4,
    NotYourRole = 5,
    NotYourNumber = 6,
}

pub(super) async fn open(
    State(server): State<Arc<Server>>,
    Extension(arrival): Extension<Arrival>,
    Extension(caller): Extension<Caller>,
    Extension(aboard): Extension<Arc<Aboard>>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Response {
    let Ok(upgrade) = upgrade else {
        return problem(StatusCode::UPGRADE_REQUIRED, "this is a WebSocket");
    };
    let Some(place) = server.take_socket() else {
        return problem(StatusCode::SERVICE_UNAVAILABLE, "too many pages are open");
    };
    upgrade
        .max_message_size(MESSAGE)
        .max_frame_size(MESSAGE)
        .max_write_buffer_size(UNREAD)
        .on_upgrade(move |ws| serve(ws, server, aboard, arrival, caller, place))
}

async fn serve(
    mut ws: WebSocket,
    server: Arc<Server>,
    aboard: Arc<Aboard>,
    arrival: Arrival,
    caller: Caller,
    place: SocketPlace,
) {
    let _place = place;
    let Some((joined, frames)) = aboard.joint.join().await else {
        return;
    };
    let address = Address {
        system: caller.session.system,
        component: COMPONENT,
    };
    let now = server.clock.now();
    let mut page = Page {
        envelopes: Envelopes::default(),
        dead_man: DeadMan::default(),
        decoder: Decoder::new(),
        encoder: Encoder::new(address),
        address,
        control: Control::default(),
        heard: now,
        acks: Pace::hz(10.0),
        refusals: Pace::hz(5.0),
        joined,
        witness: Witness::new(Arc::clone(&server), arrival, caller, aboard.label()),
        server: Arc::clone(&server),
        aboard,
    };
    let why = page.run(&mut ws, frames).await;
    page.witness.manual_ends();
    // A lost page lets go of the sticks; the lock sees its link go.
    if page.dead_man.must_centre(server.clock.now() + STICKS_AGE) {
        page.centre();
    }
    page.joined.leave().await;
    let close = Ws::Close(Some(CloseFrame {
        code: why.0,
        reason: why.1.into(),
    }));
    let _ = tokio::time::timeout(Duration::from_secs(1), ws.send(close)).await;
}

/// Why a socket ends: WebSocket code and words.
type Why = (u16, &'static str);
const GONE: Why = (1000, "");
const OVER: Why = (4001, "the session is over");
const SLOW: Why = (4002, "this page does not keep up");
const MUTE: Why = (4003, "nothing was heard from this page");

struct Page {
    envelopes: Envelopes,
    dead_man: DeadMan,
    decoder: Decoder,
    encoder: Encoder,
    address: Address,
    /// Who had control in the last picture.
    control: Control,
    heard: Timestamp,
    acks: Pace,
    refusals: Pace,
    joined: Joined,
    witness: Witness,
    server: Arc<Server>,
    aboard: Arc<Aboard>,
}

impl Page {
    async fn run(&mut self, ws: &mut WebSocket, mut frames: mpsc::Receiver<FrameBytes>) -> Why {
        let mut feed = self.aboard.feed.clone();
        let mut look = tokio::time::interval(LOOK);
        look.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut checks = Pace::hz(2.0);
        let mut shown = Shown::default();
        if let Err(why) = send(ws, Ws::text(self.greeting())).await {
            return why;
        }
        loop {
            let sent = tokio::select! {
                biased;
                got = ws.recv() => match got {
                    Some(Ok(Ws::Binary(bytes))) => {
                        self.heard = self.server.clock.now();
                        self.take(ws, &bytes).await
                    }
                    Some(Ok(Ws::Text(text))) => {
                        self.heard = self.server.clock.now();
                        if text.as_str() == r#"{"touch":true}"# {
                            self.server.touch(self.witness.caller.id);
                        }
                        Ok(())
                    }
                    Some(Ok(Ws::Ping(_) | Ws::Pong(_))) => Ok(()),
                    Some(Err(e)) => {
                        if e.to_string().contains("too long") {
                            self.witness.intrusion("a message larger than 4 kB");
                        }
                        Err(GONE)
                    }
                    Some(Ok(Ws::Close(_))) | None => Err(GONE),
                },
                _ = look.tick() => self.look(&mut checks),
                frame = frames.recv() => match frame {
                    Some(first) => {
                        let mut out = topics::begin(topics::MAVLINK, self.server.clock.now());
                        out.extend_from_slice(&first);
                        // What is there already goes along.
                        while out.len() < MESSAGE && let Ok(next) = frames.try_recv() {
                            out.extend_from_slice(&next);
                        }
                        send(ws, Ws::binary(out)).await
                    }
                    None => Err(GONE),
                },
                changed = feed.changed() => match changed {
                    Ok(()) => {
                        let picture = Arc::clone(&feed.borrow_and_update());
                        self.show(ws, &picture, &mut shown).await
                    }
                    Err(_) => Err(GONE),
                },
            };
            if let Err(why) = sent {
                return why;
            }
        }
    }

    fn greeting(&self) -> String {
        let modes: Vec<_> = topics::MODES.iter().map(|m| m.name()).collect();
        let reasons: Vec<_> = topics::REASONS.iter().map(|r| r.words()).collect();
        json!({
            "hello": {
                "system": self.address.system,
                "component": self.address.component,
                "vehicle": { "system": self.aboard.us.system, "component": self.aboard.us.component },
                "state": topics::STATE_FIELDS,
                "modes": modes,
                "reasons": reasons,
            }
        })
        .to_string()
    }

    /// What passes by itself.
    fn look(&mut self, checks: &mut Pace) -> Result<(), Why> {
        let now = self.server.clock.now();
        if self.dead_man.must_centre(now) {
            self.centre();
        }
        self.witness.look(now);
        if checks.is_due(now) {
            if self.server.session(self.witness.caller.id).is_none() {
                return Err(OVER);
            }
            if now.since(self.heard) >= SILENT {
                return Err(MUTE);
            }
        }
        Ok(())
    }

    async fn show(
        &mut self,
        ws: &mut WebSocket,
        p: &Picture,
        shown: &mut Shown,
    ) -> Result<(), Why> {
        self.control = p.control;
        shown.count = shown.count.wrapping_add(1);
        let anchor = self.aboard.anchor;
        send(ws, Ws::binary(topics::state(p, &anchor))).await?;
        if let Some(scan) = topics::scan(p) {
            send(ws, Ws::binary(scan)).await?;
        }
        if shown.count % SELDOM == 1 {
            send(ws, Ws::binary(topics::particles(p))).await?;
            send(ws, Ws::binary(topics::histogram(p))).await?;
            send(ws, Ws::binary(topics::route(p, &anchor))).await?;
            send(ws, Ws::binary(topics::people(p))).await?;
        }
        let control = self.described(p.control);
        if shown.control.as_deref() != Some(control.as_str()) {
            send(ws, Ws::text(control.clone())).await?;
            shown.control = Some(control);
        }
        let blocked = p.snapshot.arm_blocked_by.map(|why| why.to_string());
        if shown.blocked.as_ref() != Some(&blocked) {
            send(ws, Ws::text(json!({ "blocked": blocked }).to_string())).await?;
            shown.blocked = Some(blocked);
        }
        Ok(())
    }

    fn described(&self, control: Control) -> String {
        let owner = control.owner.map(|(link, system)| {
            let is_you = link == self.joined.link;
            json!({
                "system": system,
                "name": self.server.name_of(system),
                "you": is_you,
                "lease": if is_you { Some(control.lease) } else { None },
                "open": control.is_open,
            })
        });
        let asking = control
            .asking
            .map(|s| json!({ "system": s, "name": self.server.name_of(s) }));
        json!({ "control": { "owner": owner, "asking": asking } }).to_string()
    }

    /// One message of the page.
    async fn take(&mut self, ws: &mut WebSocket, bytes: &[u8]) -> Result<(), Why> {
        let now = self.server.clock.now();
        let opened = self.envelopes.open(now, bytes);
        let (header, fault) = match &opened {
            Ok(o) => ((o.seq, o.t_client_ms), None),
            Err(fault) => ((0, 0.0), Some(*fault)),
        };
        let frames = match (&opened, fault) {
            (Ok(o), _) => o.frames,
            // A stop is a stop, whatever is wrong around it.
            (Err(_), Some(Fault::OutOfOrder)) => &bytes[super::envelope::HEADER..],
            _ => &[],
        };
        let mut taken: Vec<(Frame, Vec<u8>)> = Vec::new();
        let mut decoder = std::mem::take(&mut self.decoder);
        decoder.push_wire(frames, |frame, wire| taken.push((frame, wire.to_vec())));
        decoder.end_of_datagram_wire(|frame, wire| taken.push((frame, wire.to_vec())));
        self.decoder = decoder;
        let mut passed = Vec::with_capacity(frames.len());
        let mut verdict = match fault {
            Some(Fault::Malformed) => Verdict::Malformed,
            Some(Fault::OutOfOrder) => Verdict::OutOfOrder,
            None if taken.is_empty() && !frames.is_empty() => Verdict::Malformed,
            None => Verdict::Passed,
        };
        for (frame, wire) in &taken {
            let age = opened.as_ref().map(|o| (o.age, o.lease));
            match self.judge(frame, age.ok()) {
                Verdict::Passed => {
                    self.note(now, &frame.message);
                    passed.extend_from_slice(wire);
                }
                refused => verdict = refused,
            }
        }
        if !passed.is_empty() {
            self.joined.frames(passed);
        }
        let is_due = match verdict {
            Verdict::Passed => self.acks.is_due(now),
            _ => self.refusals.is_due(now),
        };
        if is_due {
            let ack = topics::ack(self.server.clock.now(), header.0, header.1, verdict as u8);
            send(ws, Ws::binary(ack)).await?;
        }
        Ok(())
    }

    /// May a frame pass? `envelope`: age and lease of its message, none if that was faulty.
    fn judge(&mut self, frame: &Frame, envelope: Option<(Duration, u64)>) -> Verdict {
        if frame.from.system != self.address.system {
            self.witness
                .intrusion(&format!("a frame of system {}", frame.from.system));
            return Verdict::NotYourNumber;
        }
        let message = &frame.message;
        let intent = intent::of(message);
        if intent == Intent::Stop {
            return Verdict::Passed;
        }
        let Some((age, lease)) = envelope else {
            return Verdict::OutOfOrder;
        };
        let role = self.witness.caller.session.role;
        let wants_control = matches!(message, Message::Raw(raw::MavMessage::COMMAND_LONG(m)) if m.command == cmd::REQUEST_OPERATOR_CONTROL);
        if !role.may(intent) || (wants_control && role < Role::Pilot) {
            self.witness.intrusion(&format!(
                "{} needs another role than {role}",
                words(message)
            ));
            return Verdict::NotYourRole;
        }
        if intent == Intent::Watch {
            return Verdict::Passed;
        }
        let limit = match message {
            Message::Raw(raw::MavMessage::MANUAL_CONTROL(_)) => STICKS_AGE,
            _ => COMMAND_AGE,
        };
        if age > limit {
            return Verdict::Old;
        }
        let mine = Some((self.joined.link, self.address.system));
        if intent == Intent::Fly && (self.control.owner != mine || self.control.lease != lease) {
            return Verdict::NotYourLease;
        }
        Verdict::Passed
    }

    /// Remembers what was asked of the vehicle, and by whom.
    fn note(&mut self, now: Timestamp, message: &Message) {
        if let Message::Raw(raw::MavMessage::MANUAL_CONTROL(m)) = message {
            let is_deflected = [m.x, m.y, m.r, m.z.saturating_sub(500)]
                .iter()
                .any(|v| v.unsigned_abs() > 50);
            self.dead_man.sticks(now, is_deflected);
        }
        self.witness.passed(now, message);
    }

    /// Centred sticks in the page's name.
    fn centre(&mut self) {
        let centred = raw::MANUAL_CONTROL_DATA {
            target: self.aboard.us.system,
            z: 500,
            ..Default::default()
        };
        self.joined.frames(self.encoder.encode(&centred).to_vec());
    }
}

/// What a page was sent last.
#[derive(Default)]
struct Shown {
    count: u32,
    control: Option<String>,
    blocked: Option<Option<String>>,
}

async fn send(ws: &mut WebSocket, message: Ws) -> Result<(), Why> {
    match tokio::time::timeout(PATIENCE, ws.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(GONE),
        Err(_) => Err(SLOW),
    }
}
