//! Requests through the door.

use super::UquadFlight;
use super::io::UquadOutput;
use super::list::ends_list;
use crate::autopilot::door::{Answer, Asked, Event, Key, Outcome, Refusal, Request};
use crate::autopilot::mode::{Because, Mode};
use crate::autopilot::modes::Air;
use crate::settings::Origin;
use vehicle::{In, Ned, Timestamp};

impl UquadFlight {
    pub(super) fn asked(&mut self, now: Timestamp, asked: &Asked) {
        let outcome = match &asked.request {
            Request::Arm { .. } => self.arm(now),
            Request::Disarm { force } => self.ask_disarm(now, *force),
            Request::Key(Key::Escape) if self.air == Air::Ground => self.ask_disarm(now, false),
            Request::SetParam { index, value } => {
                let changed = self
                    .settings
                    .set(usize::from(*index), *value, Origin::Mavlink);
                self.navigator
                    .set_params(self.settings.planner.clone(), self.settings.vfh.clone());
                self.arbiter
                    .mission_mut()
                    .set_params(self.settings.planner.clone());
                changed
                    .map(|_| Outcome::Accepted)
                    .map_err(|_| Refusal::BadNumber)
            }
            Request::SetHome(place) => self.set_home(*place),
            Request::GroundHeartbeat => {
                self.ground_heard = Some(now);
                Ok(Outcome::Accepted)
            }
            Request::ShutDown => {
                self.shutting_down = true;
                if self.air == Air::Ground {
                    self.ask_disarm(now, true)
                } else {
                    self.with_cockpit(now, 0.0, |arbiter, c| {
                        arbiter.enter(c, Mode::Land, Because::ShuttingDown)
                    });
                    Ok(Outcome::Accepted)
                }
            }
            request if self.needs_a_place(request) => Err(Refusal::NotLocalized),
            request if self.means_list(request) => self.start_list(),
            request => {
                if ends_list(request) {
                    self.follower = None;
                }
                let is_armed = self.is_armed();
                self.with_cockpit(now, 0.0, |arbiter, c| arbiter.request(c, asked, is_armed))
            }
        };
        let outcome = outcome.unwrap_or_else(Outcome::Refused);
        self.emit(UquadOutput::Answer(Answer {
            id: asked.id,
            station: asked.station,
            outcome,
        }));
    }

    /// Without a position source nothing flies anywhere.
    pub(super) fn needs_a_place(&self, request: &Request) -> bool {
        self.ring.is_none()
            && match request {
                Request::GoTo(to) => to.north_m.is_some() || to.east_m.is_some(),
                Request::StartMission { .. } | Request::Offboard(_) | Request::Figure(_) => true,
                Request::SetMode(mode) => matches!(
                    mode,
                    Mode::Mission | Mode::Return | Mode::Offboard | Mode::Position
                ),
                Request::Key(key) => matches!(key, Key::NudgeForward(_) | Key::NudgeRight(_)),
                _ => false,
            }
    }

    pub(super) fn ask_disarm(&mut self, now: Timestamp, force: bool) -> Result<Outcome, Refusal> {
        if self.air == Air::Flying && !force {
            return Err(Refusal::Flying);
        }
        self.disarm(now);
        Ok(Outcome::Accepted)
    }

    pub(super) fn set_home(&mut self, place: Option<In<Ned>>) -> Result<Outcome, Refusal> {
        self.home = match place {
            Some(p) if p.is_finite() => p,
            Some(_) => return Err(Refusal::BadNumber),
            None if self.nav.health.position => self.nav.position.with_z(0.0),
            None => return Err(Refusal::NotLocalized),
        };
        self.home_yaw_rad = self.nav.yaw_rad();
        self.emit(UquadOutput::Event(Event::HomeSet));
        Ok(Outcome::Accepted)
    }
}
