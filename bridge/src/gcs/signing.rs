//! Which links demand signatures, and the judgement of each frame that comes in there.
//!
//! | Link | Comes in | Goes out |
//! | --- | --- | --- |
//! | of an endpoint with `?key=` | frames signed with it (`mavlink-dialect/src/signing.rs`); RADIO_STATUS, which radios cannot sign | signed |
//! | any other, and SETUP_SIGNING has given a key: from another machine, serial | the same with that key | signed |
//! | the same from this machine | anything: who speaks here holds the files too | signed |
//! | any other | anything | unsigned |
//!
//! SETUP_SIGNING is taken from this machine, or on a serial line that is no radio (no RADIO_STATUS was heard there), from an engineer,
//! disarmed; anywhere else it is refused with the reason, so that nobody on the air can change a key. All zeros take the key away. It is
//! kept as [`KEY_DOCUMENT`] and holds for the next start too.
//!
//! What is rejected is counted and told at most every [`TELL_AGAIN`]; it reaches no service and no list of peers. The clock of the time
//! stamps is kept every [`KEEP_PERIOD`].

use super::access::{LinkPolicy, Role};
use super::{Context, Document, LinkId, MAX_LINKS, Outbox, Peer};
use crate::autopilot::door::Severity;
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::codec::passed_on;
use mavlink_dialect::signing::{MAX_STAMP, SigningKey, SigningState};
use mavlink_dialect::standard::SETUP_SIGNING_DATA;
use mavlink_dialect::{Encoder, FrameBytes, Message};
use vehicle::Timestamp;

/// File of the clock.
pub const DOCUMENT: &str = "signing-clock.txt";
/// File of the key that SETUP_SIGNING gave, 64 hexadecimal digits; empty for none.
pub const KEY_DOCUMENT: &str = "signing.key";
/// Time between two texts about rejected frames.
pub const TELL_AGAIN: Duration = Duration::from_secs(10);
/// Time between two documents.
pub const KEEP_PERIOD: Duration = Duration::from_secs(60);
const RADIO_STATUS: u32 = 109;

/// What is known of an endpoint.
#[derive(Debug)]
struct Endpoint {
    key: Option<SigningKey>,
    is_serial: bool,
}

/// Keys of the endpoints, and what was seen.
#[derive(Debug, Default)]
pub struct LinkSigning {
    /// By number.
    endpoints: Vec<Endpoint>,
    /// By SETUP_SIGNING, for every endpoint without a key of its own.
    given: Option<SigningKey>,
    /// Links on which a radio spoke.
    radios: ArrayVec<LinkId, MAX_LINKS>,
    state: SigningState,
    rejected: u64,
    told_at: Option<Timestamp>,
    kept_at: Option<Timestamp>,
}

/// A key and whether frames must be signed with it.
struct Demand<'a> {
    key: &'a SigningKey,
    is_strict: bool,
}

impl LinkSigning {
    /// No link demands anything.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Clock and key of an earlier run; any other document is left alone.
    pub fn restore(&mut self, document: &Document) {
        let text = core::str::from_utf8(&document.bytes).unwrap_or_default();
        match document.name {
            DOCUMENT => self.state.observe(text.trim().parse().unwrap_or(0)),
            KEY_DOCUMENT => self.given = SigningKey::from_hex(text),
            _ => {}
        }
    }

    /// Endpoints by number.
    pub fn set_endpoints(&mut self, policies: &[LinkPolicy]) {
        let endpoint = |p: &LinkPolicy| Endpoint {
            key: p.key.clone(),
            is_serial: p.url.starts_with("serial:"),
        };
        self.endpoints = policies.iter().map(endpoint).collect();
    }

    /// True if SETUP_SIGNING has given a key.
    #[must_use]
    pub const fn has_given_key(&self) -> bool {
        self.given.is_some()
    }

    /// Forgets what was heard on a link.
    pub fn link_down(&mut self, link: LinkId) {
        self.radios.retain(|l| *l != link);
    }

    fn demand(&self, link: LinkId) -> Option<Demand<'_>> {
        let endpoint = self.endpoints.get(usize::from(link.endpoint()));
        if let Some(key) = endpoint.and_then(|e| e.key.as_ref()) {
            return Some(Demand {
                key,
                is_strict: true,
            });
        }
        // Links that joined without an endpoint are pages of the console, which has a gate of its own.
        let (key, endpoint) = (self.given.as_ref()?, endpoint?);
        Some(Demand {
            key,
            is_strict: link.is_remote() || endpoint.is_serial,
        })
    }

    /// Frames rejected so far.
    #[must_use]
    pub const fn rejected(&self) -> u64 {
        self.rejected
    }

    /// True if a frame of this message id may be taken; `wire` are its bytes as they came.
    pub fn admits(
        &mut self,
        now: Timestamp,
        from: Peer,
        id: u32,
        wire: &[u8],
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> bool {
        if id == RADIO_STATUS {
            if !self.radios.contains(&from.link) {
                let _ = self.radios.try_push(from.link);
            }
            return true;
        }
        let Some(Demand {
            key,
            is_strict: true,
        }) = self.demand(from.link)
        else {
            return true;
        };
        let key = key.clone();
        self.state.set_utc(ctx.boot_utc_us + now.us());
        let Err(why) = self.state.check(&key, from.address, wire) else {
            return true;
        };
        self.rejected += 1;
        if self.told_at.is_none_or(|at| now.since(at) >= TELL_AGAIN) {
            self.told_at = Some(now);
            let text = format!("Frames of system {} ignored: {why}", from.address.system);
            out.text(Severity::Warning, text);
        }
        false
    }

    /// Takes SETUP_SIGNING, whose sender's role is `ctx.role`, or says why not.
    pub fn set_up(
        &mut self,
        now: Timestamp,
        from: Peer,
        m: &SETUP_SIGNING_DATA,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let why = if from.link.is_remote() {
            Some("only from this machine or over USB; from elsewhere start with ?key= of the link")
        } else if self.radios.contains(&from.link) {
            Some("not over a radio; start with ?key= of the link")
        } else if ctx.role < Role::Engineer {
            Some("an engineer's")
        } else if ctx.snapshot.is_armed {
            Some("disarm first")
        } else if m.initial_timestamp > MAX_STAMP {
            Some("its time stamp lies decades ahead")
        } else {
            None
        };
        if let Some(why) = why {
            return out.text(Severity::Warning, format!("SETUP_SIGNING refused: {why}"));
        }
        self.given = (m.secret_key != [0; 32]).then(|| SigningKey::new(m.secret_key));
        let text = if self.given.is_some() {
            self.state.set_utc(ctx.boot_utc_us + now.us());
            self.state.observe(m.initial_timestamp);
            "Signing key stored: other machines and serial lines must sign from now on"
        } else {
            "Signing key removed: links are as they were started"
        };
        out.text(Severity::Notice, text);
        let hex = self.given.as_ref().map(|key| key.to_hex() + "\n");
        out.documents.push_back(Document {
            name: KEY_DOCUMENT,
            bytes: hex.unwrap_or_default().into_bytes(),
        });
        self.kept_at = None;
    }

    /// A message as a frame of this link.
    pub fn encode(&mut self, link: LinkId, encoder: &mut Encoder, message: &Message) -> FrameBytes {
        let key = self.demand(link).map(|d| d.key.clone());
        match key {
            None => encoder.encode_message(message),
            // The number of the link among those of its endpoint; streams of two links never share stamps anyway.
            Some(key) => encoder.encode_signed(message, &key, link.0 as u8, self.state.stamp()),
        }
    }

    /// A frame that came in elsewhere, as this link sends it; none if it cannot carry the signature.
    pub fn pass_on(&mut self, link: LinkId, wire: &[u8]) -> Option<FrameBytes> {
        let key = self.demand(link).map(|d| d.key.clone());
        let sign = key
            .as_ref()
            .map(|key| (key, link.0 as u8, self.state.stamp()));
        passed_on(wire, sign)
    }

    /// Keeps the clock when it is time.
    pub fn tick(&mut self, now: Timestamp, ctx: &Context<'_>, out: &mut Outbox) {
        let is_due = self.kept_at.is_none_or(|at| now.since(at) >= KEEP_PERIOD);
        let signs = self.given.is_some() || self.endpoints.iter().any(|e| e.key.is_some());
        if !is_due || !signs {
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
