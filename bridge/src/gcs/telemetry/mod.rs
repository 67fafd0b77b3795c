//! What the vehicle says unasked, as one table: message, default rate, builder.
//!
//! Each link has its own rates (MAV_CMD_SET_MESSAGE_INTERVAL); beats stay on a fixed grid and are skipped, never made up
//! in a burst. A builder that knows nothing sends nothing: without a localized vehicle there is no LOCAL_POSITION_NED.
//! Messages that tell a change (landed state, mode, mission, home) also go out at once when it happens.
//!
//! | File | Messages |
//! | --- | --- |
//! | `pose` | attitude, position, velocity, estimator |
//! | `ranges` | DISTANCE_SENSOR, OBSTACLE_DISTANCE, optical flow |
//! | `status` | system, battery, modes, mission, clock |
//! | `group` | the groups of REQUEST_DATA_STREAM |
//! | `room` | what a link can carry: its budget, its radio |
//! | `identity` | AUTOPILOT_VERSION, AVAILABLE_MODES, PROTOCOL_VERSION |
//! | `target` | what control follows |
//! | `own` | the messages of `kestrel.xml` |
//!
//! Rates and builders are in `table`.

mod group;
mod identity;
mod own;
mod pose;
mod ranges;
mod room;
mod status;
mod table;
mod target;

pub use identity::{CAPABILITIES, FLIGHT_SW_VERSION};

use self::room::Room;
use self::table::{
    AVAILABLE_MODES, CURRENT_MODE, EXTENDED_SYS_STATE, HEARTBEAT, HOME_POSITION, MISSION_CURRENT,
    TABLE, View, index_of,
};
use super::command::Streams;
use super::convert::GeoAnchor;
use super::fence::FenceState;
use super::{Context, Destination, LinkId, MAX_LINKS, Outbox, Outgoing, Peer, Speaker, heartbeat};
use crate::autopilot::door::{LandedState, MissionStatus, Snapshot};
use crate::autopilot::mode::ModeState;
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::Message;
use mavlink_dialect::command::result;
use vehicle::{In, Ned, Timestamp};

/// Shortest interval that may be asked for, us (500 Hz).
pub const MIN_INTERVAL_US: i32 = 2_000;
/// REQUEST_DATA_STREAM makes nothing faster than this, us (50 Hz).
const FASTEST_GROUP_US: i32 = 20_000;
/// Time between two CURRENT_MODE for a station that knows standard modes, us.
const CURRENT_MODE_PERIOD_US: i32 = 2_000_000;
/// First beats of a new link are spread, so that not everything goes out in one millisecond.
const STAGGER_US: u64 = 7_000;

/// One message on one link.
#[derive(Clone, Copy, Debug)]
struct Stream {
    /// 0 = off.
    period_us: u32,
    next: Timestamp,
    /// Send at the next tick whatever the clock says.
    is_urgent: bool,
}

impl Stream {
    /// True if it is time; then the next beat is set, on the grid, skipping what was missed.
    fn take_beat(&mut self, now: Timestamp, stretch: f64) -> bool {
        let is_urgent = core::mem::take(&mut self.is_urgent);
        if self.period_us == 0 || now < self.next {
            return is_urgent;
        }
        let period = (f64::from(self.period_us) * stretch) as u64;
        let beats = now.since(self.next).as_micros() as u64 / period + 1;
        self.next += Duration::from_micros(beats * period);
        true
    }
}

#[derive(Debug)]
struct LinkStreams {
    link: LinkId,
    room: Room,
    streams: [Stream; TABLE.len()],
}

/// Versions of the stored plans, for MISSION_CURRENT; 0 = none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlanIds {
    /// Mission.
    pub mission: u32,
    /// Fence.
    pub fence: u32,
    /// Rally points.
    pub rally: u32,
}

/// When the vehicle armed, took off and landed last.
#[derive(Clone, Copy, Debug, Default)]
struct Flights {
    armed_at: Option<Timestamp>,
    took_off_at: Option<Timestamp>,
    landed_at: Option<Timestamp>,
    count: u64,
}

/// What is told at once when it changes.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Told {
    mode: ModeState,
    is_armed: bool,
    landed: LandedState,
    mission: MissionStatus,
    plan_ids: PlanIds,
    home: In<Ned>,
    home_yaw_rad: f64,
}

/// Why an interval was not set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IntervalRefusal {
    /// We never send this message.
    Unknown,
    /// Below [`MIN_INTERVAL_US`].
    OutOfRange,
    /// HEARTBEAT: its rate tells that we live.
    Fixed,
}

impl IntervalRefusal {
    /// MAV_RESULT.
    #[must_use]
    pub const fn result(self) -> u8 {
        match self {
            Self::Unknown => result::UNSUPPORTED,
            Self::OutOfRange | Self::Fixed => result::DENIED,
        }
    }
}

/// Why a message was not sent on request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestRefusal {
    /// We never send this message.
    Unknown,
    /// What it would say is not known now.
    NotNow,
    /// AVAILABLE_MODES has no such index.
    NoSuchIndex,
}

impl RequestRefusal {
    /// MAV_RESULT.
    #[must_use]
    pub const fn result(self) -> u8 {
        match self {
            Self::Unknown => result::UNSUPPORTED,
            Self::NotNow => result::TEMPORARILY_REJECTED,
            Self::NoSuchIndex => result::DENIED,
        }
    }
}

/// All streams on all links.
#[derive(Debug, Default)]
pub struct Telemetry {
    links: ArrayVec<Box<LinkStreams>, MAX_LINKS>,
    /// Nothing is due before.
    next_due: Timestamp,
    flights: Flights,
    plan_ids: PlanIds,
    fence: FenceState,
    told: Option<Told>,
    /// Kept between ticks for its capacity.
    built: Vec<Message>,
}

impl Telemetry {
    /// No links yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            built: Vec::with_capacity(16),
            ..Self::default()
        }
    }

    /// Starts the default streams on a new link, within a budget of bytes a second if one is given; false if there are too many
    /// links.
    pub fn link_up(&mut self, now: Timestamp, link: LinkId, budget: Option<f64>) -> bool {
        if self.links.is_full() || self.links.iter().any(|l| l.link == link) {
            return false;
        }
        let mut index = 0;
        let streams = core::array::from_fn(|i| {
            index += 1;
            Stream {
                period_us: TABLE[i].period_us,
                next: now + Duration::from_micros(index * STAGGER_US),
                is_urgent: false,
            }
        });
        self.links.push(Box::new(LinkStreams {
            link,
            room: Room::new(now, budget),
            streams,
        }));
        self.next_due = now;
        true
    }

    /// Forgets a link and its rates.
    pub fn link_down(&mut self, link: LinkId) {
        self.links.retain(|l| l.link != link);
    }

    /// Versions of the stored plans.
    pub fn set_plan_ids(&mut self, plan_ids: PlanIds) {
        self.plan_ids = plan_ids;
    }

    /// Where the vehicle is to the fence.
    pub const fn set_fence(&mut self, fence: FenceState) {
        self.fence = fence;
    }

    /// Looks at a new snapshot for what is told at once, and keeps the times of flights.
    pub fn observe(&mut self, now: Timestamp, s: &Snapshot) {
        let is = Told {
            mode: s.mode,
            is_armed: s.is_armed,
            landed: s.landed,
            mission: s.mission,
            plan_ids: self.plan_ids,
            home: s.home,
            home_yaw_rad: s.home_yaw_rad,
        };
        let Some(was) = self.told.replace(is) else {
            return;
        };
        if was == is {
            return;
        }
        if was.landed != is.landed {
            self.tell_now(now, EXTENDED_SYS_STATE);
        }
        if was.mode != is.mode {
            self.tell_now(now, CURRENT_MODE);
        }
        if was.mission != is.mission || was.plan_ids != is.plan_ids {
            self.tell_now(now, MISSION_CURRENT);
        }
        if was.home != is.home || (was.home_yaw_rad - is.home_yaw_rad).abs() > 1e-9 {
            self.tell_now(now, HOME_POSITION);
        }
        if !was.is_armed && is.is_armed {
            self.flights.armed_at = Some(now);
        }
        match (
            was.landed == LandedState::OnGround,
            is.landed == LandedState::OnGround,
        ) {
            (true, false) => {
                self.flights.took_off_at = Some(now);
                self.flights.landed_at = None;
                self.flights.count += 1;
            }
            (false, true) => self.flights.landed_at = Some(now),
            _ => {}
        }
    }

    /// Sends what is due.
    pub fn tick(&mut self, now: Timestamp, ctx: &Context<'_>, out: &mut Outbox) {
        if now < self.next_due {
            return;
        }
        for link in &mut self.links {
            link.room.tick(now);
        }
        let mut next_due = now + Duration::from_secs(3_600);
        let mut built = core::mem::take(&mut self.built);
        for (i, row) in TABLE.iter().enumerate() {
            built.clear();
            let mut is_built = false;
            for at in 0..self.links.len() {
                let stretch = self.links[at].room.stretch();
                let stream = &mut self.links[at].streams[i];
                let is_beat = stream.take_beat(now, stretch);
                if stream.period_us != 0 {
                    next_due = next_due.min(stream.next);
                }
                if !is_beat {
                    continue;
                }
                if !is_built {
                    is_built = true;
                    (row.build)(&self.view(now, ctx), &mut built);
                }
                let to = Destination::Link(self.links[at].link);
                out.messages.extend(built.iter().map(|message| Outgoing {
                    to,
                    from: Speaker::Autopilot,
                    message: message.clone(),
                }));
            }
        }
        self.built = built;
        self.next_due = next_due;
    }

    /// When [`Telemetry::tick`] has something to do.
    #[must_use]
    pub const fn deadline(&self) -> Timestamp {
        self.next_due
    }

    /// MAV_CMD_SET_MESSAGE_INTERVAL on one link: 0 = default, -1 = off, else microseconds.
    ///
    /// # Errors
    /// [`IntervalRefusal`]; the rate stays.
    pub fn set_interval(
        &mut self,
        now: Timestamp,
        link: LinkId,
        id: u32,
        interval_us: i32,
    ) -> Result<(), IntervalRefusal> {
        if id == HEARTBEAT {
            let is_default =
                interval_us == 0 || i64::from(interval_us) == heartbeat::PERIOD.as_micros() as i64;
            return if is_default {
                Ok(())
            } else {
                Err(IntervalRefusal::Fixed)
            };
        }
        let i = index_of(id).ok_or(IntervalRefusal::Unknown)?;
        let period_us = match interval_us {
            -1 => 0,
            0 => TABLE[i].period_us,
            MIN_INTERVAL_US.. => interval_us.unsigned_abs(),
            _ => return Err(IntervalRefusal::OutOfRange),
        };
        if let Some(l) = self.links.iter_mut().find(|l| l.link == link) {
            l.streams[i] = Stream {
                period_us,
                next: now,
                is_urgent: false,
            };
            self.next_due = now;
        }
        Ok(())
    }

    /// MESSAGE_INTERVAL.interval_us on one link: -1 = off, 0 = never sent, else microseconds.
    #[must_use]
    pub fn interval(&self, link: LinkId, id: u32) -> i32 {
        if id == HEARTBEAT {
            return heartbeat::PERIOD.as_micros() as i32;
        }
        let Some(i) = index_of(id) else { return 0 };
        match self
            .links
            .iter()
            .find(|l| l.link == link)
            .map_or(0, |l| l.streams[i].period_us)
        {
            0 => -1,
            us => i32::try_from(us).unwrap_or(i32::MAX),
        }
    }

    /// MAV_CMD_REQUEST_MESSAGE: sends a message once. `param2` is the index for AVAILABLE_MODES (0 = all), else unused.
    ///
    /// # Errors
    /// [`RequestRefusal`]; nothing was sent.
    pub fn request(
        &self,
        now: Timestamp,
        to: Destination,
        id: u32,
        param2: f32,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> Result<(), RequestRefusal> {
        if id == HEARTBEAT {
            out.send_raw(to, heartbeat::heartbeat(ctx));
            return Ok(());
        }
        let i = index_of(id).ok_or(RequestRefusal::Unknown)?;
        let mut built = Vec::new();
        (TABLE[i].build)(&self.view(now, ctx), &mut built);
        // NaN means "not given": all.
        if id == AVAILABLE_MODES && param2.is_finite() && param2 >= 0.5 {
            let wanted = libm::roundf(param2) as usize - 1;
            let one = built
                .into_iter()
                .nth(wanted)
                .ok_or(RequestRefusal::NoSuchIndex)?;
            built = vec![one];
        }
        if built.is_empty() {
            return Err(RequestRefusal::NotNow);
        }
        out.messages
            .extend(built.into_iter().map(|message| Outgoing {
                to,
                from: Speaker::Autopilot,
                message,
            }));
        Ok(())
    }

    /// RADIO_STATUS on a link: how full the radio's buffer is.
    pub fn radio_status(&mut self, now: Timestamp, link: LinkId, free_percent: u8) {
        if let Some(l) = self.links.iter_mut().find(|l| l.link == link) {
            l.room.radio_status(now, free_percent);
        }
    }

    /// So many bytes went out on a link.
    pub fn sent(&mut self, link: LinkId, bytes: usize) {
        if let Some(l) = self.links.iter_mut().find(|l| l.link == link) {
            l.room.sent(bytes);
        }
    }

    /// REQUEST_DATA_STREAM on one link: all messages of a group at a rate, or off.
    pub fn request_stream(&mut self, now: Timestamp, link: LinkId, group: u8, hz: Option<u16>) {
        for id in group::members(group) {
            let interval_us = match hz {
                None => -1,
                Some(0) => 0,
                Some(hz) => (1_000_000 / i32::from(hz)).max(FASTEST_GROUP_US),
            };
            // Known ids, allowed intervals.
            let _ = self.set_interval(now, link, id, interval_us);
        }
    }

    /// Home was set, perhaps where it already was: tells it again.
    pub fn tell_home(&mut self, now: Timestamp) {
        self.tell_now(now, HOME_POSITION);
    }

    /// Sends a message at the next tick on every link that has not switched it off.
    fn tell_now(&mut self, now: Timestamp, id: u32) {
        let Some(i) = index_of(id) else { return };
        for l in &mut self.links {
            l.streams[i].is_urgent = l.streams[i].period_us != 0;
        }
        self.next_due = now;
    }

    fn view<'a>(&'a self, now: Timestamp, ctx: &Context<'a>) -> View<'a> {
        View {
            now,
            snapshot: ctx.snapshot,
            settings: ctx.settings,
            geo: GeoAnchor::from_params(&ctx.settings.ground),
            us: ctx.us,
            boot_utc_us: ctx.boot_utc_us,
            flights: &self.flights,
            plan_ids: self.plan_ids,
            fence: self.fence,
        }
    }
}

impl Streams for Telemetry {
    fn set_interval(&mut self, now: Timestamp, link: LinkId, id: u32, interval_us: i32) -> u8 {
        match Self::set_interval(self, now, link, id, interval_us) {
            Ok(()) => result::ACCEPTED,
            Err(refusal) => refusal.result(),
        }
    }

    fn interval_us(&self, link: LinkId, id: u32) -> i32 {
        self.interval(link, id)
    }

    fn request(
        &mut self,
        now: Timestamp,
        from: Peer,
        id: u32,
        param2: f32,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> u8 {
        if id == AVAILABLE_MODES && self.interval(from.link, CURRENT_MODE) == -1 {
            // Known id, allowed interval.
            let _ = Self::set_interval(self, now, from.link, CURRENT_MODE, CURRENT_MODE_PERIOD_US);
        }
        match Self::request(self, now, Destination::All, id, param2, ctx, out) {
            Ok(()) => result::ACCEPTED,
            Err(refusal) => refusal.result(),
        }
    }
}
