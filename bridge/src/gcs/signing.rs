//! Which links demand signatures, and the judgement of each frame that comes in there.
//!
//! | Link | Comes in | Goes out |
//! | --- | --- | --- |
//! | of an endpoint without a key | anything | unsigned |
//! | with a key | frames signed with it (`mavlink-dialect/src/signing.rs`); RADIO_STATUS, which radios cannot sign | signed |
//!
//! What is rejected is counted and told at most every [`TELL_AGAIN`]; it reaches no service and no list of peers. Keys come by
//! `?key=` only: SETUP_SIGNING is refused, so that nobody on the air can change them. The clock of the time stamps is kept
//! every [`KEEP_PERIOD`].

use super::{Context, Document, LinkId, Outbox};
use crate::autopilot::door::Severity;
use core::time::Duration;
use mavlink_dialect::codec::passed_on;
use mavlink_dialect::signing::{SigningKey, SigningState};
use mavlink_dialect::{Encoder, Frame, FrameBytes, Message};
use vehicle::Timestamp;

/// File of the clock.
pub const DOCUMENT: &str = "signing-clock.txt";
/// Time between two texts about rejected frames.
pub const TELL_AGAIN: Duration = Duration::from_secs(10);
/// Time between two documents.
pub const KEEP_PERIOD: Duration = Duration::from_secs(60);
const RADIO_STATUS: u32 = 109;
const SETUP_SIGNING: u32 = 256;

/// Keys of the endpoints, and what was seen.
#[derive(Debug, Default)]
pub struct LinkSigning {
    /// By number of the endpoint.
    keys: Vec<Option<SigningKey>>,
    state: SigningState,
    rejected: u64,
    told_at: Option<Timestamp>,
    kept_at: Option<Timestamp>,
}

impl LinkSigning {
    /// No link demands anything.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The clock of an earlier run.
    pub fn restore(&mut self, bytes: &[u8]) {
        let stored = core::str::from_utf8(bytes)
            .ok()
            .and_then(|t| t.trim().parse().ok());
        self.state = SigningState::new(stored.unwrap_or(0));
    }

    /// Keys by number of the endpoint.
    pub fn set_keys(&mut self, keys: Vec<Option<SigningKey>>) {
        self.keys = keys;
    }

    /// Frames rejected so far.
    #[must_use]
    pub const fn rejected(&self) -> u64 {
        self.rejected
    }

    /// True if a frame may be taken; `wire` are its bytes as they came.
    pub fn admits(
        &mut self,
        now: Timestamp,
        link: LinkId,
        frame: &Frame,
        wire: &[u8],
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> bool {
        let id = frame.message.id();
        let key = self
            .keys
            .get(usize::from(link.endpoint()))
            .and_then(Option::as_ref);
        if let Some(key) = key
            && id != RADIO_STATUS
        {
            self.state.set_utc(ctx.boot_utc_us + now.us());
            if let Err(why) = self.state.check(key, frame.from, wire) {
                self.rejected += 1;
                if self.told_at.is_none_or(|at| now.since(at) >= TELL_AGAIN) {
                    self.told_at = Some(now);
                    let text = format!("Frames of system {} ignored: {why}", frame.from.system);
                    out.text(Severity::Warning, text);
                }
                return false;
            }
        }
        if id == SETUP_SIGNING {
            let text = "SETUP_SIGNING refused: keys are given by ?key= of the link";
            out.text(Severity::Warning, text);
            return false;
        }
        true
    }

    /// A message as a frame of this link.
    pub fn encode(&mut self, link: LinkId, encoder: &mut Encoder, message: &Message) -> FrameBytes {
        let key = self
            .keys
            .get(usize::from(link.endpoint()))
            .and_then(Option::as_ref);
        match key {
            None => encoder.encode_message(message),
            // The number of the link among those of its endpoint; streams of two links never share stamps anyway.
            Some(key) => encoder.encode_signed(message, key, link.0 as u8, self.state.stamp()),
        }
    }

    /// A frame that came in elsewhere, as this link sends it; none if it cannot carry the signature.
    pub fn pass_on(&mut self, link: LinkId, wire: &[u8]) -> Option<FrameBytes> {
        let key = self
            .keys
            .get(usize::from(link.endpoint()))
            .and_then(Option::as_ref);
        let sign = key.map(|key| (key, link.0 as u8, self.state.stamp()));
        passed_on(wire, sign)
    }

    /// Keeps the clock when it is time.
    pub fn tick(&mut self, now: Timestamp, ctx: &Context<'_>, out: &mut Outbox) {
        let is_due = self.kept_at.is_none_or(|at| now.since(at) >= KEEP_PERIOD);
        if !is_due || self.keys.iter().all(Option::is_none) {
            return;
        }
        self.kept_at = Some(now);
        self.state.set_utc(ctx.boot_utc_us + now.us());
        out.documents.push_back(Document {
            name: DOCUMENT,
            bytes: format!("{}\n", self.state.clock()).into_bytes(),
        });
    }
}
