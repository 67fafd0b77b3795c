//! The ground half of the autopilot: links, router, every MAVLink service, parameters.

use super::door::{Answer, Asked, Event, Request, Severity, Snapshot};
use crate::gcs::command::CommandService;
use crate::gcs::disk::{DiskJob, DiskReply, Ticket};
use crate::gcs::fence::FenceWatch;
use crate::gcs::ftp::FtpService;
use crate::gcs::keys::KeyConsole;
use crate::gcs::log_transfer::LogService;
use crate::gcs::manual::ManualService;
use crate::gcs::mission::MissionService;
use crate::gcs::out_queue::{Class, OutQueue};
use crate::gcs::params::ParamService;
use crate::gcs::router::{PeerStats, Router, RouterCounters, Verdict};
use crate::gcs::sensor_feed::SensorFeed;
use crate::gcs::setpoint::SetpointService;
use crate::gcs::signing::{self, LinkSigning};
use crate::gcs::telemetry::Telemetry;
use crate::gcs::text::{TextService, Told};
use crate::gcs::{Context, Destination, Document, LinkId, MAX_LINKS, Outbox, Outgoing, Peer};
use crate::gcs::{heartbeat::Heartbeat, origin, time_sync};
use crate::sensor::suite::MavlinkFeed;
use crate::settings::Settings;
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::signing::SigningKey;
use mavlink_dialect::{Address, DecodeCounters, Decoder, Encoder, Frame, FrameBytes, Message};
use std::collections::VecDeque;
use std::sync::Arc;
use vehicle::{Airframe, FloorPlan, MapAnchor, Timestamp};

/// Time between ticks of services with slow timers (mission re-requests, stale key lines).
const SERVICE_PERIOD: Duration = Duration::from_millis(20);
/// Most requests that wait for the vehicle.
const MAX_REQUESTS: usize = 4096;

/// What the ground side is built from.
#[derive(Clone, Debug)]
pub struct GroundConfig {
    /// Our address: system id of MAV_SYS_ID, component 1 (autopilot).
    pub us: Address,
    /// All parameters.
    pub settings: Settings,
    /// How the plan lies in the world.
    pub anchor: MapAnchor,
    /// The floor plan, to check places of missions.
    pub plan: Arc<FloorPlan>,
    /// Size of the vehicle, for the same.
    pub airframe: Airframe,
    /// UTC at boot, us; 0 unknown.
    pub boot_utc_us: u64,
    /// What an earlier run had kept: mission, fence, rally points.
    pub documents: Vec<Document>,
}

/// What the ground side wants done.
#[derive(Clone, Debug, PartialEq)]
pub enum GroundOutput {
    /// Keep a document on disk.
    Keep(Document),
    /// Do something on the disk; [`Ground::disk`] takes the answer.
    Disk(Ticket, DiskJob),
    /// Ask the vehicle.
    Request(Asked),
    /// Send one frame on a link.
    Send {
        /// Where to.
        link: LinkId,
        /// The frame.
        bytes: FrameBytes,
    },
}

/// One link.
#[derive(Debug)]
struct Link {
    id: LinkId,
    decoder: Decoder,
    encoder: Encoder,
    sent: u64,
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
    /// Frames on signed links whose signature was missing, wrong or used before.
    pub rejected_signatures: u64,
}

/// Everything that speaks MAVLink, as one pure machine.
///
/// After each input ([`Ground::link_up`], [`receive`](Ground::receive), [`answer`](Ground::answer),
/// [`event`](Ground::event), [`snapshot`](Ground::snapshot), [`tick`](Ground::tick)) call [`Ground::poll`] until it
/// returns none; call [`Ground::tick`] at [`Ground::deadline`]. Frames are numbered when they leave `poll`, per link.
#[derive(Debug)]
pub struct Ground {
    us: Address,
    settings: Settings,
    anchor: MapAnchor,
    boot_utc_us: u64,
    snapshot: Snapshot,

    links: ArrayVec<Link, MAX_LINKS>,
    router: Router,
    heartbeat: Heartbeat,
    telemetry: Telemetry,
    text: TextService,
    params: ParamService,
    mission: MissionService,
    command: CommandService,
    manual: ManualService,
    setpoint: SetpointService,
    sensors: SensorFeed,
    keys: KeyConsole,
    signing: LinkSigning,
    fence: FenceWatch,
    ftp: FtpService,
    logs: LogService,
    next_service: Timestamp,

    out: Outbox,
    queue: OutQueue,
    requests: VecDeque<Asked>,
    documents: VecDeque<Document>,
    jobs: VecDeque<(Ticket, DiskJob)>,
    /// A message for all links and the next one it goes to.
    sending: Option<(Outgoing, usize)>,
    dropped_requests: u64,
    stray_bytes: u64,
}

/// What services may look at, borrowed field by field so that the services stay free.
macro_rules! context {
    ($ground:ident) => {
        Context {
            snapshot: &$ground.snapshot,
            settings: &$ground.settings,
            anchor: $ground.anchor,
            us: $ground.us,
            boot_utc_us: $ground.boot_utc_us,
        }
    };
}

impl Ground {
    /// A ground side without links.
    #[must_use]
    pub fn new(config: GroundConfig) -> Self {
        let GroundConfig {
            us,
            settings,
            anchor,
            plan,
            airframe,
            boot_utc_us,
            documents,
        } = config;
        let places = planner::Router::new(plan, airframe.radius_m, &settings.planner);
        let mut ground = Self {
            us,
            anchor,
            boot_utc_us,
            snapshot: Snapshot::default(),
            links: ArrayVec::new(),
            router: Router::new(us),
            heartbeat: Heartbeat::new(),
            telemetry: Telemetry::new(),
            text: TextService::new(),
            params: ParamService::new(),
            mission: MissionService::new(Some(places)),
            command: CommandService::new(),
            manual: ManualService::new(),
            setpoint: SetpointService::new(),
            sensors: SensorFeed::new(),
            keys: KeyConsole::new(),
            signing: LinkSigning::new(),
            fence: FenceWatch::new(),
            ftp: FtpService::new(),
            logs: LogService::new(),
            next_service: Timestamp::ZERO,
            out: Outbox::default(),
            queue: OutQueue::new(),
            requests: VecDeque::new(),
            documents: VecDeque::new(),
            jobs: VecDeque::new(),
            sending: None,
            dropped_requests: 0,
            stray_bytes: 0,
            settings,
        };
        for document in &documents {
            if document.name == signing::DOCUMENT {
                ground.signing.restore(&document.bytes);
            }
            let ctx = context!(ground);
            ground
                .mission
                .restore_document(Timestamp::ZERO, document, &ctx, &mut ground.out);
        }
        ground.drain(Timestamp::ZERO, Class::Answer);
        ground
    }

    /// Keys that the links of each endpoint are signed with, by number of the endpoint ([`LinkId::of`]); none = unsigned.
    pub fn set_keys(&mut self, keys: Vec<Option<SigningKey>>) {
        self.signing.set_keys(keys);
    }

    /// Takes messages of sensors from now on.
    pub fn listen_to_sensors(&mut self, feed: MavlinkFeed) {
        self.sensors.listen_to(feed);
    }

    /// A link came up: it is greeted with a heartbeat and gets telemetry. False if there are too many.
    pub fn link_up(&mut self, now: Timestamp, link: LinkId) -> bool {
        if self.links.is_full() || !self.telemetry.link_up(now, link) {
            return false;
        }
        self.links.push(Link {
            id: link,
            decoder: Decoder::new(),
            encoder: Encoder::new(self.us),
            sent: 0,
        });
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
        self.queue.forget(link);
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
        decoder.push_wire(bytes, |frame, wire| self.take(now, link, &frame, wire));
        if is_datagram {
            decoder.end_of_datagram_wire(|frame, wire| self.take(now, link, &frame, wire));
        }
        self.links[at].decoder = decoder;
    }

    /// The vehicle answered a request.
    pub fn answer(&mut self, now: Timestamp, answer: &Answer) {
        let ctx = context!(self);
        let _ = self.mission.answer(now, answer, &ctx, &mut self.out)
            || self.command.answer(now, answer, &ctx, &mut self.out)
            || self.keys.answer(now, answer, &ctx, &mut self.out);
        self.drain(now, Class::Answer);
    }

    /// The disk answered a job.
    pub fn disk(&mut self, now: Timestamp, ticket: Ticket, reply: &DiskReply) {
        let _ = self.ftp.disk(now, ticket, reply, &mut self.out)
            || self.logs.disk(now, ticket, reply, &mut self.out);
        self.drain(now, Class::Answer);
    }

    /// Something happened to the vehicle.
    pub fn event(&mut self, now: Timestamp, event: &Event) {
        match event {
            Event::Armed(is_armed) => self
                .out
                .text(Severity::Info, if *is_armed { "Armed" } else { "Disarmed" }),
            Event::HomeSet => self.telemetry.tell_home(now),
            Event::Marker(at) => self
                .out
                .text(Severity::Info, format!("Marker at {:.1} s", at.s())),
            Event::Notice(notice) => self.out.text(notice.severity(), notice.to_string()),
            // Modes and landing show in heartbeats; an item reached is the mission service's; a retired plan ends here.
            Event::ItemReached(_) | Event::Landed(_) | Event::Mode(_) | Event::PlanRetired(_) => {}
        }
        self.mission.event(event, &mut self.out);
        self.drain(now, Class::Answer);
    }

    /// The vehicle as it is now. What has changed is told at once.
    pub fn snapshot(&mut self, now: Timestamp, snapshot: &Snapshot) {
        self.telemetry.observe(now, snapshot);
        self.snapshot.clone_from(snapshot);
        let (items, id) = (self.mission.fence_items(), self.mission.plan_ids().fence);
        self.fence
            .look(now, items, id, &context!(self), &mut self.out);
        self.beat(now);
    }

    /// Does what is due.
    pub fn tick(&mut self, now: Timestamp) {
        self.beat(now);
        self.params.tick(now, &context!(self), &mut self.out);
        self.ftp.tick(now, &mut self.out);
        self.logs.tick(now, &context!(self), &mut self.out);
        self.drain(now, Class::Answer);
        if now >= self.next_service {
            self.next_service = now + SERVICE_PERIOD;
            let ctx = context!(self);
            self.mission.tick(now, &ctx, &mut self.out);
            self.command.tick(now, &ctx, &mut self.out);
            self.keys.tick(now, &ctx, &mut self.out);
            self.signing.tick(now, &ctx, &mut self.out);
            self.telemetry.set_plan_ids(self.mission.plan_ids());
            self.drain(now, Class::Answer);
        }
    }

    /// When [`Ground::tick`] has something to do.
    #[must_use]
    pub fn deadline(&self) -> Timestamp {
        let deadline = self
            .next_service
            .min(self.heartbeat.deadline())
            .min(self.telemetry.deadline());
        [
            self.params.deadline(),
            self.ftp.deadline(),
            self.logs.deadline(),
        ]
        .into_iter()
        .flatten()
        .fold(deadline, Timestamp::min)
    }

    /// The next thing to do; requests to the vehicle first.
    pub fn poll(&mut self) -> Option<GroundOutput> {
        if let Some(asked) = self.requests.pop_front() {
            return Some(GroundOutput::Request(asked));
        }
        while let Some((outgoing, at)) = self
            .sending
            .take()
            .or_else(|| self.queue.pop().map(|o| (o, 0)))
        {
            let at = match outgoing.to {
                Destination::All => at,
                Destination::Link(link) => self
                    .links
                    .iter()
                    .position(|l| l.id == link)
                    .unwrap_or(usize::MAX),
            };
            let Some(link) = self.links.get_mut(at) else {
                continue;
            };
            link.sent += 1;
            let send = GroundOutput::Send {
                link: link.id,
                bytes: self
                    .signing
                    .encode(link.id, &mut link.encoder, &outgoing.message),
            };
            if outgoing.to == Destination::All {
                self.sending = Some((outgoing, at + 1));
            }
            return Some(send);
        }
        if let Some((ticket, job)) = self.jobs.pop_front() {
            return Some(GroundOutput::Disk(ticket, job));
        }
        self.documents.pop_front().map(GroundOutput::Keep)
    }

    /// All parameters as they are now.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.settings
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
            rejected_signatures: self.signing.rejected(),
        }
    }

    /// The last texts told to the pilots, oldest first.
    pub fn texts(&self) -> impl DoubleEndedIterator<Item = &Told> {
        self.text.told()
    }

    /// Tells a text to every pilot.
    pub fn say(&mut self, now: Timestamp, severity: Severity, text: impl Into<String>) {
        self.out.text(severity, text);
        self.drain(now, Class::Answer);
    }

    /// One frame of a link.
    fn take(&mut self, now: Timestamp, link: LinkId, frame: &Frame, wire: &[u8]) {
        let ctx = context!(self);
        if !self
            .signing
            .admits(now, link, frame, wire, &ctx, &mut self.out)
        {
            return self.drain(now, Class::Answer);
        }
        if self.router.judge(now, link, frame) != Verdict::ForUs {
            return;
        }
        let from = Peer {
            link,
            address: frame.from,
        };
        if self.router.is_news_of_ground_station(now, &frame.message) {
            self.out.ask(from, Request::GroundHeartbeat);
        }
        self.serve(now, from, &frame.message);
        self.drain(now, Class::Answer);
    }

    /// Offers a message to every service; each takes the ids it serves.
    fn serve(&mut self, now: Timestamp, from: Peer, message: &Message) {
        let ctx = context!(self);
        let out = &mut self.out;
        self.command
            .handle(now, from, message, &ctx, &mut self.telemetry, out);
        self.manual.handle(now, from, message, &ctx, out);
        self.setpoint.handle(now, from, message, &ctx, out);
        self.sensors.handle(now, from, message, out);
        self.mission.handle(now, from, message, &ctx, out);
        self.params.handle(now, from, message, &ctx, out);
        self.keys.handle(now, from, message, &ctx, out);
        origin::handle(now, from, message, &ctx, out);
        time_sync::handle(now, from, message, out);
        self.ftp.handle(now, from, message, &ctx, out);
        self.logs.handle(now, from, message, &ctx, out);
        self.telemetry.set_plan_ids(self.mission.plan_ids());
    }

    /// Heartbeat and telemetry that are due.
    fn beat(&mut self, now: Timestamp) {
        self.heartbeat.tick(now, &context!(self), &mut self.out);
        self.drain(now, Class::Answer);
        self.telemetry.tick(now, &context!(self), &mut self.out);
        self.drain(now, Class::Telemetry);
    }

    /// Moves what services produced into the bounded queues; parameters take effect on the way.
    fn drain(&mut self, now: Timestamp, class: Class) {
        while let Some(asked) = self.out.requests.pop_front() {
            self.pass_on(asked);
        }
        while let Some((severity, text)) = self.out.texts.pop_front() {
            for frame in self.text.say(now, severity, &text) {
                self.out.send_raw(Destination::All, frame);
            }
        }
        let has_links = !self.links.is_empty();
        for outgoing in self.out.messages.drain(..).filter(|_| has_links) {
            self.queue.push(class, outgoing);
        }
        // Bounded by the services, which wait for the answers.
        self.jobs.append(&mut self.out.jobs);
        while let Some(document) = self.out.documents.pop_front() {
            // Only the newest state of a file matters.
            match self.documents.iter_mut().find(|d| d.name == document.name) {
                Some(waiting) => *waiting = document,
                None => self.documents.push_back(document),
            }
        }
    }

    fn pass_on(&mut self, mut asked: Asked) {
        if let Request::SetParam { index, value } = &mut asked.request {
            match ParamService::apply(
                &mut self.settings,
                usize::from(*index),
                *value,
                &mut self.out,
            ) {
                Ok(applied) => *value = applied,
                Err(refusal) => {
                    self.out.text(Severity::Warning, refusal.to_string());
                    return;
                }
            }
        }
        if self.requests.len() >= MAX_REQUESTS {
            self.dropped_requests += 1;
            // The next sample of a stream says it again; anything else was meant once.
            match self.requests.iter().position(|a| is_stream(&a.request)) {
                Some(at) => drop(self.requests.remove(at)),
                None => return,
            }
        }
        self.requests.push_back(asked);
    }
}

const fn is_stream(request: &Request) -> bool {
    matches!(
        request,
        Request::GroundHeartbeat
            | Request::Manual(_)
            | Request::Offboard(_)
            | Request::RcOverride(_)
            | Request::Sensed(_)
    )
}

#[cfg(test)]
mod tests;
