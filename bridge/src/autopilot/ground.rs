//! The ground half of the autopilot: links, router, every MAVLink service, parameters.

use super::door::{Answer, Asked, Event, Request, Severity, Snapshot};
use crate::gcs::access::{self, Access, LinkPolicy, Role};
use crate::gcs::camera::{self, Camera, VideoStream};
use crate::gcs::command::CommandService;
use crate::gcs::disk::{DiskJob, DiskReply, Ticket};
use crate::gcs::fence::FenceWatch;
use crate::gcs::ftp::FtpService;
use crate::gcs::keys::KeyConsole;
use crate::gcs::log_transfer::LogService;
use crate::gcs::manual::ManualService;
use crate::gcs::mission::{MissionService, Walls};
use crate::gcs::operator::{Control, OperatorControl};
use crate::gcs::out_queue::{Class, OutQueue};
use crate::gcs::params::ParamService;
use crate::gcs::patrol::PatrolReport;
use crate::gcs::router::{Router, Verdict};
use crate::gcs::sensor_feed::SensorFeed;
use crate::gcs::setpoint::SetpointService;
use crate::gcs::signing::LinkSigning;
use crate::gcs::telemetry::Telemetry;
use crate::gcs::text::{TextService, Told};
use crate::gcs::{
    Context, Destination, Document, LinkId, MAX_LINKS, Outbox, Outgoing, Peer, Speaker,
};
use crate::gcs::{heartbeat::Heartbeat, origin, time_sync};
use crate::log::summary::FlightBook;
use crate::sensor::suite::MavlinkFeed;
use crate::settings::Settings;
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::command::result;
use mavlink_dialect::standard::MavMessage;
use mavlink_dialect::{Address, FrameBytes, FrameView, Message, raw};
use std::collections::VecDeque;
use std::sync::Arc;
use vehicle::{Airframe, FloorPlan, In, MapAnchor, Ned, Timestamp};

/// What services may look at, borrowed field by field so that the services stay free.
macro_rules! context {
    ($ground:ident) => {
        Context {
            snapshot: &$ground.snapshot,
            settings: &$ground.settings,
            anchor: $ground.anchor,
            us: $ground.us,
            role: Role::Engineer,
            boot_utc_us: $ground.boot_utc_us,
        }
    };
}

mod links;
#[cfg(test)]
mod tests;

pub use links::{GroundCounters, LinkStats};

/// Time between ticks of services with slow timers (mission re-requests, stale key lines).
const SERVICE_PERIOD: Duration = Duration::from_millis(20);
/// Most requests that wait for the vehicle.
const MAX_REQUESTS: usize = 4096;
/// On a link the camera is silent for so long: the first heartbeats a client hears are the vehicle's.
const CAMERA_AFTER: Duration = Duration::from_secs(3);
const RADIO_STATUS: u32 = 109;
const SETUP_SIGNING: u32 = 256;

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

    links: ArrayVec<links::Link, MAX_LINKS>,
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
    access: Access,
    control: OperatorControl,
    camera: Camera,
    signing: LinkSigning,
    fence: FenceWatch,
    book: FlightBook,
    patrol: PatrolReport,
    /// Named rooms of the plan, NED about home.
    rooms: Vec<(String, In<Ned>)>,
    ftp: FtpService,
    logs: LogService,
    next_service: Timestamp,

    out: Outbox,
    queue: OutQueue,
    requests: VecDeque<Asked>,
    documents: VecDeque<Document>,
    jobs: VecDeque<(Ticket, DiskJob)>,
    /// Frames of others on their way from link to link.
    passing: VecDeque<(LinkId, FrameBytes)>,
    dropped_passing: u64,
    /// The shell passes frames of components on to the stations.
    shell_routes: bool,
    /// A message for all links and the next one it goes to.
    sending: Option<(Outgoing, usize)>,
    dropped_requests: u64,
    stray_bytes: u64,
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
        let rooms = plan
            .rooms
            .iter()
            .map(|r| (r.name.clone(), anchor.to_ned(In::new(r.x, r.y, 0.0))))
            .collect();
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
            mission: MissionService::new(Some(Walls::new(plan, airframe.radius_m))),
            command: CommandService::new(),
            manual: ManualService::new(),
            setpoint: SetpointService::new(),
            sensors: SensorFeed::new(),
            keys: KeyConsole::new(),
            access: Access::default(),
            control: OperatorControl::new(),
            camera: Camera::default(),
            signing: LinkSigning::new(),
            fence: FenceWatch::new(),
            book: FlightBook::default(),
            patrol: PatrolReport::new(),
            rooms,
            ftp: FtpService::new(),
            logs: LogService::new(),
            next_service: Timestamp::ZERO,
            out: Outbox::default(),
            queue: OutQueue::new(),
            requests: VecDeque::new(),
            documents: VecDeque::new(),
            jobs: VecDeque::new(),
            passing: VecDeque::new(),
            dropped_passing: 0,
            shell_routes: false,
            sending: None,
            dropped_requests: 0,
            stray_bytes: 0,
            settings,
        };
        for document in &documents {
            ground.signing.restore(document);
            let ctx = context!(ground);
            ground
                .mission
                .restore_document(Timestamp::ZERO, document, &ctx, &mut ground.out);
        }
        ground.access.set_signed(ground.signing.has_given_key());
        ground.drain(Timestamp::ZERO, Class::Answer);
        ground
    }

    /// Role, key, budget and routing of the links of each endpoint, by number of the endpoint ([`LinkId::of`]).
    pub fn set_policies(&mut self, policies: Vec<LinkPolicy>) {
        self.signing.set_endpoints(&policies);
        self.access = Access::new(policies);
        self.access.set_signed(self.signing.has_given_key());
    }

    /// True if SETUP_SIGNING has given a key.
    #[must_use]
    pub const fn has_given_key(&self) -> bool {
        self.signing.has_given_key()
    }

    /// The shell passes frames of components behind us on to the stations itself: only their way back is ours.
    pub const fn set_shell_routes(&mut self, does: bool) {
        self.shell_routes = does;
    }

    /// A picture is to be had there: a camera component says so.
    pub fn set_video(&mut self, stream: Option<VideoStream>) {
        self.router
            .set_camera(stream.as_ref().map(|_| camera::COMPONENT));
        self.camera = Camera::new(stream);
    }

    /// Takes messages of sensors from now on.
    pub fn listen_to_sensors(&mut self, feed: MavlinkFeed) {
        self.sensors.listen_to(feed);
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
            Event::ItemReached(_)
            | Event::Landed(_)
            | Event::Mode(_)
            | Event::PlanRetired(_)
            | Event::SiteRetired(_) => {}
        }
        self.mission.event(event, &mut self.out);
        let ctx = context!(self);
        self.patrol.event(now, event, &ctx, &mut self.out);
        self.drain(now, Class::Answer);
    }

    /// The vehicle as it is now. What has changed is told at once.
    pub fn snapshot(&mut self, now: Timestamp, snapshot: &Snapshot) {
        self.telemetry.observe(now, snapshot);
        self.snapshot.clone_from(snapshot);
        let ids = self.mission.plan_ids();
        let fence = (self.mission.fence_items(), ids.fence);
        let rally = (self.mission.rally_items(), ids.rally);
        let ctx = context!(self);
        self.fence.tell(fence, rally, &ctx, &mut self.out);
        self.fence.look(now, &ctx, &mut self.out);
        self.telemetry.set_fence(self.fence.state());
        self.patrol
            .learn(ids.mission, self.mission.items(), &self.rooms, &ctx);
        self.patrol.look(&ctx);
        if let Some(flight) = self.book.look(snapshot) {
            self.out.text(Severity::Info, flight.to_string());
        }
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
            self.control.tick(now, &ctx, &mut self.out);
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
        if let Some((link, bytes)) = self.passing.pop_front() {
            self.telemetry.sent(link, bytes.len());
            return Some(GroundOutput::Send { link, bytes });
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
            let encoder = match outgoing.from {
                Speaker::Autopilot => &mut link.encoder,
                Speaker::Camera => &mut link.camera,
            };
            let bytes = self.signing.encode(link.id, encoder, &outgoing.message);
            self.telemetry.sent(link.id, bytes.len());
            let send = GroundOutput::Send {
                link: link.id,
                bytes,
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

    /// Which station has control.
    #[must_use]
    pub fn control(&self) -> Control {
        self.control.control()
    }

    /// The last texts told to the pilots, oldest first.
    pub fn texts(&self) -> impl DoubleEndedIterator<Item = &Told> {
        self.text.told()
    }

    /// Those told since `seen`, which moves on.
    pub fn texts_since(&self, seen: &mut u64) -> impl Iterator<Item = &Told> {
        self.text.since(seen)
    }

    /// Tells a text to every pilot.
    pub fn say(&mut self, now: Timestamp, severity: Severity, text: impl Into<String>) {
        self.out.text(severity, text);
        self.drain(now, Class::Answer);
    }

    /// One frame of a link.
    fn take(&mut self, now: Timestamp, link: LinkId, frame: &FrameView<'_>, message: &Message) {
        let ctx = context!(self);
        let from = Peer {
            link,
            address: frame.from,
        };
        if !self
            .signing
            .admits(now, from, frame.id, frame.wire, &ctx, &mut self.out)
        {
            return self.drain(now, Class::Answer);
        }
        let verdict = self.router.judge(now, from, frame.sequence, message);
        if self.access.routes() && verdict != Verdict::Echo {
            self.pass_frame_on(link, message, frame.wire);
        }
        if !matches!(verdict, Verdict::ForUs | Verdict::ForCamera) {
            return;
        }
        let role = self.access.role(link);
        let ctx = Context {
            role,
            ..context!(self)
        };
        let out = &mut self.out;
        if let Message::Standard(MavMessage::SETUP_SIGNING(m)) = message {
            self.signing.set_up(now, from, m, &ctx, out);
            self.access.set_signed(self.signing.has_given_key());
            return self.drain(now, Class::Answer);
        }
        if self.camera.is_there() {
            let by_name = verdict == Verdict::ForCamera;
            self.camera.handle(now, from, message, by_name, &ctx, out);
        }
        if verdict == Verdict::ForCamera {
            return self.drain(now, Class::Answer);
        }
        let Some(needs) = access::needs(message).filter(|_| !self.sensors.ignores(message)) else {
            return self.drain(now, Class::Answer);
        };
        if role < needs {
            access::deny(&self.access, from, message, &ctx, out);
        } else if self.control.handle(now, from, message, out) {
            // Answered.
        } else if needs > Role::Viewer && !self.control.admits(from, &ctx) {
            let why = self.control.reason();
            access::refuse(from, message, result::NOT_IN_CONTROL, &why, &ctx, out);
        } else {
            if self.control.counts_as_presence(from, &ctx)
                && self.router.is_news_of_ground_station(now, message)
            {
                self.out.ask(from, Request::GroundHeartbeat);
            }
            self.serve(now, from, role, message);
        }
        self.drain(now, Class::Answer);
    }

    /// Offers a message to every service; each takes the ids it serves.
    fn serve(&mut self, now: Timestamp, from: Peer, role: Role, message: &Message) {
        let ctx = Context {
            role,
            ..context!(self)
        };
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
        match message {
            Message::Standard(MavMessage::RADIO_STATUS(m)) => {
                self.telemetry.radio_status(now, from.link, m.txbuf);
            }
            Message::Raw(raw::MavMessage::REQUEST_DATA_STREAM(m)) => {
                let hz = (m.start_stop != 0).then_some(m.req_message_rate);
                self.telemetry
                    .request_stream(now, from.link, m.req_stream_id, hz);
            }
            _ => {}
        }
        self.telemetry.set_plan_ids(self.mission.plan_ids());
    }

    /// Heartbeat and telemetry that are due.
    fn beat(&mut self, now: Timestamp) {
        if self.heartbeat.is_due(now) && self.camera.beats() {
            for link in &self.links {
                if now.since(link.up_at) >= CAMERA_AFTER {
                    let beat = Camera::heartbeat().into();
                    self.out
                        .send_as(Speaker::Camera, Destination::Link(link.id), beat);
                }
            }
        }
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
