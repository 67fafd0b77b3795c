//! Flight modes, one file each. A mode looks at the [`Cockpit`] each tick and says what to fly or what comes next.
//!
//! To add one: a variant of [`Mode`], a file here, its arm in [`Arbiter::step`](super::arbiter::Arbiter),
//! its wire code in `gcs/convert.rs`.

pub mod climb;
pub mod descent;
pub mod figure;
pub mod hold;
pub mod homeward;
pub mod keys;
pub mod mission;
pub mod offboard;
pub mod sticks;

use super::door::{Event, Notice, Refusal};
use super::mode::{Because, Mode};
use super::params::AutopilotParams;
use arrayvec::ArrayVec;
use planner::navigator::Navigator;
use planner::route::RouteError;
use vehicle::{Airframe, Heading, In, NavState, Ned, Setpoint, Timestamp};

/// On the floor, leaving it, or flying.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Air {
    /// On the floor.
    #[default]
    Ground,
    /// Throttle rising, still on the floor.
    SpoolUp,
    /// Off the floor.
    Flying,
}

/// What a mode sees and may use.
pub struct Cockpit<'a> {
    /// Now.
    pub now: Timestamp,
    /// Since the last tick, s.
    pub dt_s: f64,
    /// The estimate.
    pub nav: &'a NavState,
    /// On the floor or not.
    pub air: Air,
    /// Routes and avoidance.
    pub navigator: &'a mut Navigator,
    /// Parameters.
    pub params: &'a AutopilotParams,
    /// The aircraft.
    pub airframe: &'a Airframe,
    /// Home, m.
    pub home: In<Ned>,
    /// Heading at home, rad.
    pub home_yaw_rad: f64,
    /// What happened.
    pub events: &'a mut ArrayVec<Event, 32>,
}

impl Cockpit<'_> {
    /// Tells the pilot.
    pub fn notice(&mut self, notice: Notice) {
        // Full only if one tick had more to say than a pilot can read.
        let _ = self.events.try_push(Event::Notice(notice));
    }

    /// Where the vehicle comes to rest if it brakes now, m.
    #[must_use]
    pub fn stopping_point(&self) -> In<Ned> {
        // v^2 / 2a at 1.5 m/s2, and the dead time of the link.
        let v = self.nav.velocity;
        let reach_s = v.norm_xy() / 3.0 + 0.15;
        let p = self.nav.position + In::new(v.x() * reach_s, v.y() * reach_s, 0.0);
        p.with_z(self.clamped_down_m(self.nav.position.z()))
    }

    /// NED down between a safe height above the floor at home and the ceiling, m.
    #[must_use]
    pub fn clamped_down_m(&self, down_m: f64) -> f64 {
        down_m.clamp(-self.params.ceiling_m, -MIN_HEIGHT_M)
    }

    /// Hover without a place: ground speed zero by flow and rangers, this height.
    #[must_use]
    pub fn stand_still(&mut self, down_m: f64, heading: Heading) -> Setpoint {
        let velocity = self.navigator.protect(self.now, self.nav, In::zero());
        Setpoint::Velocity {
            velocity,
            down_m: Some(down_m),
            heading,
        }
    }
}

/// Lowest set point in flight, above the floor at home, m.
pub const MIN_HEIGHT_M: f64 = 0.3;

/// What a mode wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wish {
    /// Follow this.
    Fly(Setpoint),
    /// Leave the floor with this set point.
    LiftOff(Setpoint),
    /// Stay on the floor, motors idle.
    Rest,
    /// This mode is over.
    Switch(Mode, Because),
    /// Touched down: stop the motors.
    Disarm,
}

/// Why a goal was refused, in the door's words.
#[must_use]
pub const fn refusal_of(e: &RouteError) -> Refusal {
    match e {
        RouteError::NoWay => Refusal::NoRoute,
        RouteError::NotFinite => Refusal::BadNumber,
        RouteError::OutsideFence { .. } => Refusal::OutsideFence,
        _ => Refusal::PlaceBlocked,
    }
}
