//! Arming, stopping, and what becomes of it when the aircraft stops its motors by itself.

use super::UquadFlight;
use super::io::UquadOutput;
use crate::autopilot::door::{Event, Notice, Outcome, Refusal};
use crate::autopilot::modes::Air;
use crate::uquad::aircraft::{Off, Phase};
use vehicle::Timestamp;

impl UquadFlight {
    pub(super) fn is_armed(&self) -> bool {
        matches!(
            self.phase(),
            Phase::Starting { .. } | Phase::Idling | Phase::RampingUp { .. } | Phase::Running
        )
    }

    /// Told once when the aircraft has stopped its motors by itself.
    pub(super) fn watch_phase(&mut self, now: Timestamp) {
        self.aircraft.rest();
        if let (Phase::Off(why), Some(_)) = (self.phase(), self.armed_at) {
            if why != Off::Asked {
                self.emit(UquadOutput::Event(Event::Notice(Notice::MotorsOff(why))));
            }
            self.grounded(now);
        }
    }

    pub(super) fn disarm(&mut self, now: Timestamp) {
        if self.is_armed() {
            self.aircraft.stop(now);
            self.grounded(now);
        }
    }

    pub(super) fn grounded(&mut self, now: Timestamp) {
        self.armed_at = None;
        (self.touched_down, self.touched_s) = (false, 0.0);
        self.emit(UquadOutput::Event(Event::Armed(false)));
        self.set_air(Air::Ground);
        self.with_cockpit(now, 0.0, |arbiter, c| arbiter.disarmed(c));
    }

    pub(super) fn set_air(&mut self, air: Air) {
        self.air = air;
        let landed = self.arbiter.landed_state(air);
        self.emit(UquadOutput::Event(Event::Landed(landed)));
    }

    /// Why an arm would be refused now.
    pub(super) fn objection(&self) -> Option<Refusal> {
        if self.shutting_down {
            return Some(Refusal::ShuttingDown);
        }
        match self.phase() {
            Phase::Calibrating => return Some(Refusal::NoAttitude),
            Phase::Off(Off::Asked) => return Some(Refusal::ArmingUnderWay),
            Phase::Off(why) => return Some(Refusal::MotorsOff(why)),
            _ => {}
        }
        let has_ring = self.ring.is_some();
        if has_ring && !self.snapshot.rangers_alive {
            return Some(Refusal::NoRangers);
        }
        (has_ring && !self.nav.health.position).then_some(Refusal::NotLocalized)
    }

    pub(super) fn arm(&mut self, now: Timestamp) -> Result<Outcome, Refusal> {
        if self.is_armed() {
            return Ok(Outcome::Accepted);
        }
        if let Some(why) = self.objection() {
            return Err(why);
        }
        self.aircraft.arm(now);
        self.armed_at = Some(now);
        self.latency.clear();
        self.emit(UquadOutput::Event(Event::Armed(true)));
        Ok(Outcome::Accepted)
    }
}
