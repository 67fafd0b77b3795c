//! What tests of services stand on: a vehicle that is whatever the test says, stations, and what came out.

use super::{Context, LinkId, Outbox, Outgoing, Peer};
use crate::autopilot::door::{Answer, Asked, Outcome, Severity, Snapshot};
use crate::settings::Settings;
use mavlink_dialect::{Address, Message, raw};
use vehicle::MapAnchor;

/// Us.
pub(super) const US: Address = Address {
    system: 1,
    component: 1,
};

/// A station on a link of its own.
pub(super) const fn station(system: u8) -> Peer {
    Peer {
        link: LinkId(system as u32),
        address: Address {
            system,
            component: 190,
        },
    }
}

/// The vehicle as services see it; north is up on the plan and home its lower-left corner.
#[derive(Debug, Default)]
pub(super) struct Bench {
    pub(super) snapshot: Snapshot,
    pub(super) settings: Settings,
}

impl Bench {
    pub(super) fn ctx(&self) -> Context<'_> {
        Context {
            snapshot: &self.snapshot,
            settings: &self.settings,
            anchor: MapAnchor::new(0.0, 0.0, core::f64::consts::FRAC_PI_2),
            us: US,
            role: super::access::Role::Engineer,
            boot_utc_us: 0,
        }
    }
}

impl Outbox {
    /// Messages sent since the last call.
    pub(super) fn sent(&mut self) -> Vec<Message> {
        self.messages
            .drain(..)
            .map(|Outgoing { message, .. }| message)
            .collect()
    }

    /// Raw messages sent since the last call.
    pub(super) fn sent_raw(&mut self) -> Vec<raw::MavMessage> {
        let raw = |m| match m {
            Message::Raw(m) => Some(m),
            Message::Standard(_) => None,
        };
        self.sent().into_iter().filter_map(raw).collect()
    }

    /// Requests made since the last call.
    pub(super) fn asked(&mut self) -> Vec<Asked> {
        self.requests.drain(..).collect()
    }

    /// Texts since the last call.
    pub(super) fn said(&mut self) -> Vec<(Severity, String)> {
        self.texts.drain(..).collect()
    }
}

/// The vehicle's answer to a request.
pub(super) const fn answer(asked: &Asked, outcome: Outcome) -> Answer {
    Answer {
        id: asked.id,
        station: asked.station,
        outcome,
    }
}

/// A small generator (SplitMix64), seeded, for lossy links.
#[derive(Clone, Debug)]
pub(super) struct Dice(pub(super) u64);

impl Dice {
    /// Uniform in 0..1.
    pub(super) fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}
