//! uQuad's list of set points, flown in place of a mission.

use super::UquadFlight;
use super::io::UquadOutput;
use crate::autopilot::door::{Event, Outcome, Refusal, Request};
use crate::autopilot::mode::Mode;
use crate::autopilot::modes::Air;
use crate::uquad::reference::{Goal, Turn};
use control::setpoint_list::{ListFollower, Reach, Wants};
use control::state_feedback::StateSetpoint;
use nalgebra::Vector3;
use vehicle::In;

/// Whoever asks for something else ends the list.
pub(super) const fn ends_list(request: &Request) -> bool {
    matches!(
        request,
        Request::SetMode(_)
            | Request::GoTo(_)
            | Request::Figure(_)
            | Request::Stop
            | Request::Key(_)
            | Request::Takeoff { .. }
            | Request::StartMission { .. }
    )
}

/// A place is approached; what moves is followed exactly.
pub(super) fn goal_of_entry(setpoint: &StateSetpoint) -> (Goal, Turn) {
    let s = &setpoint.state;
    if s[6..].iter().all(|v| v.abs() < 1e-9) {
        let goal = Goal::Place {
            position_m: Vector3::new(s[0], s[1], s[2]),
            speed_mps: None,
        };
        return (goal, Turn::To(s[5]));
    }
    (Goal::Exactly(*setpoint), Turn::To(s[5]))
}

impl UquadFlight {
    /// The set point of the list, if one is flown.
    pub(super) fn follow_list(&mut self, dt_s: f64, state: &[f64; 12]) -> Option<StateSetpoint> {
        if self.arbiter.mode().mode != Mode::Hold || self.air != Air::Flying {
            self.follower = None;
        }
        let wants = self.follower.as_mut()?.step(dt_s, state);
        Some(match wants {
            Wants::Fly(setpoint) => setpoint,
            Wants::Gains(setpoint, trim) => {
                match self.weights {
                    Some(_) => self.list_trim = Some(trim),
                    // Gains from files are those of every entry.
                    None => self.entry_reached(),
                }
                setpoint
            }
        })
    }

    pub(super) fn entry_reached(&mut self) {
        if let Some(follower) = &mut self.follower {
            let reached = follower.index() as u16;
            follower.gains_made();
            self.emit(UquadOutput::Event(Event::ItemReached(reached)));
        }
    }

    /// Flies the list instead of a mission that is not there.
    pub(super) fn start_list(&mut self) -> Result<Outcome, Refusal> {
        let Some(list) = &self.list else {
            return Err(Refusal::NoPlan);
        };
        if self.air != Air::Flying {
            return Err(Refusal::NotFlying);
        }
        let landed_m = self.airframe.landed_height_m;
        let places = list
            .entries()
            .iter()
            .flat_map(control::setpoint_list::Entry::outline)
            .map(|[x, y, z]| In::new(x, -y, -z - landed_m));
        self.navigator
            .check_places(places)
            .map_err(|e| crate::autopilot::modes::refusal_of(&e))?;
        let mut home = self.aircraft.filter().twelve();
        home[..3].copy_from_slice(self.reference.position_m().as_slice());
        let reach = Reach::default();
        self.follower = Some(ListFollower::new(list.clone(), self.craft, reach, home));
        Ok(Outcome::Accepted)
    }

    /// A list is meant: there is one, and no MAVLink mission.
    pub(super) fn means_list(&self, request: &Request) -> bool {
        let asks = matches!(
            request,
            Request::StartMission { .. } | Request::SetMode(Mode::Mission)
        );
        asks && self.list.is_some() && self.arbiter.mission_status().total == 0
    }
}
