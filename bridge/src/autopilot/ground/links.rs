//! The links of [`Ground`]: up, down, what comes in, what is passed on between them, what is counted.

use super::{Ground, RADIO_STATUS, SETUP_SIGNING};
use crate::autopilot::door::Severity;
use crate::gcs::access::{self, Role};
use crate::gcs::camera;
use crate::gcs::out_queue::Class;
use crate::gcs::router::{PeerStats, RouterCounters};
use crate::gcs::{Context, Destination, LinkId};
use mavlink_dialect::{Address, DecodeCounters, Decoder, Encoder, Message};
use vehicle::Timestamp;

/// Most frames of others that wait to be passed on.
const MAX_PASSING: usize = 4096;

/// One link.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) id: LinkId,
    pub(super) decoder: Decoder,
    pub(super) encoder: Encoder,
    pub(super) camera: Encoder,
    pub(super) up_at: Timestamp,
    pub(super) sent: u64,
}

/// What was seen on one link.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkStats {
    /// Which.
    pub link: LinkId,
    /// Frames sent.
    pub sent: u64,
    /// Frames and noise received.
    pub received: DecodeCounters,
    /// Stations heard there.
    pub peers: Vec<PeerStats>,
}

/// What was dropped, and where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GroundCounters {
    /// Frames by verdict.
    pub router: RouterCounters,
    /// Answers that did not fit the queue.
    pub dropped_answers: u64,
    /// Telemetry messages that made room for newer ones.
    pub dropped_telemetry: u64,
    /// Requests that did not fit the queue.
    pub dropped_requests: u64,
    /// Texts not sent: repeats and floods.
    pub suppressed_texts: u64,
    /// Bytes on links that could not come up.
    pub stray_bytes: u64,
    /// Frames of others that were not passed on because too many waited.
    pub dropped_passing: u64,
    /// Frames on signed links whose signature was missing, wrong or used before.
    pub rejected_signatures: u64,
}

impl Ground {
    /// A link came up: it is greeted with a heartbeat and gets telemetry. False if there are too many.
    pub fn link_up(&mut self, now: Timestamp, link: LinkId) -> bool {
        let budget = self.access.policy(link).and_then(|p| p.rate_bytes_per_s);
        if self.links.is_full() || !self.telemetry.link_up(now, link, budget) {
            return false;
        }
        self.links.push(Link {
            id: link,
            decoder: Decoder::new(),
            encoder: Encoder::new(self.us),
            camera: Encoder::new(Address {
                component: camera::COMPONENT,
                ..self.us
            }),
            up_at: now,
            sent: 0,
        });
        if self.access.is_near(link) {
            self.params.near_link_up(link);
        }
        self.heartbeat.link_up(link, &context!(self), &mut self.out);
        for frame in self.text.frames(
            Severity::Info,
            concat!("Kestrel ", env!("CARGO_PKG_VERSION")),
        ) {
            self.out.send_raw(Destination::Link(link), frame);
        }
        self.drain(now, Class::Answer);
        true
    }

    /// A link is gone.
    pub fn link_down(&mut self, link: LinkId) {
        self.links.retain(|l| l.id != link);
        self.telemetry.link_down(link);
        self.params.link_down(link);
        self.ftp.link_down(link);
        self.logs.link_down(link);
        self.router.link_down(link);
        self.signing.link_down(link);
        self.queue.forget(link);
        self.control.link_down(link);
        while let Some(asked) = self.out.requests.pop_front() {
            self.pass_on(asked);
        }
    }

    /// Bytes came in on a link (a new one comes up by them); of a datagram a frame never continues in the next one.
    pub fn receive(&mut self, now: Timestamp, link: LinkId, bytes: &[u8], is_datagram: bool) {
        let place = |ground: &Self| ground.links.iter().position(|l| l.id == link);
        if place(self).is_none() {
            self.link_up(now, link);
        }
        let Some(at) = place(self) else {
            self.stray_bytes += bytes.len() as u64;
            return;
        };
        let mut decoder = core::mem::take(&mut self.links[at].decoder);
        decoder.push_wire(bytes, |frame, message| {
            self.take(now, link, frame, message);
        });
        if is_datagram {
            decoder.end_of_datagram_wire(|frame, message| {
                self.take(now, link, frame, message);
            });
        }
        self.links[at].decoder = decoder;
    }

    /// What was seen on each link.
    pub fn link_stats(&self) -> impl Iterator<Item = LinkStats> {
        self.links.iter().map(|l| LinkStats {
            link: l.id,
            sent: l.sent,
            received: *l.decoder.counters(),
            peers: self
                .router
                .peers()
                .filter(|p| p.peer.link == l.id)
                .copied()
                .collect(),
        })
    }

    /// What was dropped, and where.
    #[must_use]
    pub const fn counters(&self) -> GroundCounters {
        let (dropped_answers, dropped_telemetry) = self.queue.dropped();
        GroundCounters {
            router: *self.router.counters(),
            dropped_answers,
            dropped_telemetry,
            dropped_requests: self.dropped_requests,
            suppressed_texts: self.text.suppressed(),
            stray_bytes: self.stray_bytes,
            dropped_passing: self.dropped_passing,
            rejected_signatures: self.signing.rejected(),
        }
    }

    /// A frame of a component behind us to the stations, one of a station to the component it names. What is addressed to nobody in
    /// particular goes to all of the other kind.
    pub(super) fn pass_frame_on(&mut self, link: LinkId, message: &Message, wire: &[u8]) {
        let is_behind = self.access.is_routed(link);
        // What we do not know may move what is behind us; what comes from there is telemetry.
        let unknown = if is_behind { Role::Viewer } else { Role::Pilot };
        if matches!(message.id(), RADIO_STATUS | SETUP_SIGNING)
            || self.access.role(link) < access::needs(message).unwrap_or(unknown)
        {
            return;
        }
        if is_behind
            && self.shell_routes
            && !self.signing.has_given_key()
            && self.access.role(link) == Role::Engineer
        {
            return;
        }
        let target = message.target();
        for at in 0..self.links.len() {
            let to = self.links[at].id;
            let is_between = is_behind || self.access.is_routed(to);
            if to == link || !is_between || !self.router.is_there(to, target) {
                continue;
            }
            if self.passing.len() >= MAX_PASSING {
                self.dropped_passing += 1;
            } else if let Some(bytes) = self.signing.pass_on(to, wire) {
                self.passing.push_back((to, bytes));
            }
        }
    }
}
