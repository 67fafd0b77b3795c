//! HEARTBEAT: once a second, at once when mode or arming changes, and as the first frame on a new link.

use super::convert::{base_mode, mode_to_px4};
use super::params::Identity;
use super::{Context, Destination, LinkId, Outbox};
use crate::autopilot::door::{LandedState, Snapshot};
use crate::autopilot::mode::{Because, ModeState};
use core::time::Duration;
use mavlink_dialect::raw::{HEARTBEAT_DATA, MavMessage};
use vehicle::{ParamChoice, Timestamp};

/// Time between heartbeats.
pub const PERIOD: Duration = Duration::from_secs(1);
/// MAV_TYPE_QUADROTOR.
const TYPE_QUADROTOR: u8 = 2;
/// Version of the XML, as every implementation sends it.
const MAVLINK_VERSION: u8 = 3;

/// Beats on all links.
#[derive(Debug, Default)]
pub struct Heartbeat {
    next: Timestamp,
    said: Option<(ModeState, bool)>,
}

impl Heartbeat {
    /// The first beat is due at once.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Greets a new link: the autopilot's heartbeat is the first frame a client sees there.
    pub fn link_up(&self, link: LinkId, ctx: &Context<'_>, out: &mut Outbox) {
        out.send_raw(Destination::Link(link), heartbeat(ctx));
    }

    /// True if the next [`tick`](Self::tick) beats because it is time.
    #[must_use]
    pub fn is_due(&self, now: Timestamp) -> bool {
        now >= self.next
    }

    /// Beats if it is time or something that it tells has changed.
    pub fn tick(&mut self, now: Timestamp, ctx: &Context<'_>, out: &mut Outbox) {
        let says = (ctx.snapshot.mode, ctx.snapshot.is_armed);
        let is_due = now >= self.next;
        if is_due || self.said.is_some_and(|said| said != says) {
            out.send_raw(Destination::All, heartbeat(ctx));
        }
        self.said = Some(says);
        if is_due {
            self.next += PERIOD;
            if self.next <= now {
                self.next = now + PERIOD;
            }
        }
    }

    /// When the next beat is due.
    #[must_use]
    pub const fn deadline(&self) -> Timestamp {
        self.next
    }
}

/// The heartbeat of the autopilot component.
#[must_use]
pub fn heartbeat(ctx: &Context<'_>) -> MavMessage {
    let s = ctx.snapshot;
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: mode_to_px4(s.mode.mode).custom_mode(),
        mavtype: TYPE_QUADROTOR,
        autopilot: autopilot(ctx.settings.ground.identity),
        base_mode: base_mode(s.mode.mode, s.is_armed),
        system_status: system_status(s),
        mavlink_version: MAVLINK_VERSION,
    })
}

/// MAV_AUTOPILOT; the parameter's codes are MAVLink's.
fn autopilot(identity: Identity) -> u8 {
    identity.code() as u8
}

/// MAV_STATE: 3 standby, 4 active, 5 critical (a failsafe holds), 6 emergency (flying blind).
fn system_status(s: &Snapshot) -> u8 {
    let is_flying = s.landed != LandedState::OnGround;
    if !s.is_armed {
        3
    } else if s.mode.because == Because::EstimatorFailed || (is_flying && !s.fc.is_connected) {
        6
    } else if s.mode.because.is_failsafe() {
        5
    } else {
        4
    }
}
