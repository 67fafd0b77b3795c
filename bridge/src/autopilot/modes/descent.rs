//! Landing: straight down where the vehicle is (or at a place it flies to first), then disarm.

use super::{Air, Cockpit, Wish};
use crate::autopilot::door::Notice;
use planner::navigator::Goal;
use vehicle::{Heading, In, Ned, Setpoint};

/// Horizontal distance at which the descent over a place begins, m.
const OVER_PLACE_M: f64 = 0.12;

/// A landing in progress.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Descent {
    place: Option<In<Ned>>,
    yaw_rad: Option<f64>,
    stage: Stage,
    down_s: f64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Stage {
    #[default]
    Begin,
    FlyThere,
    Sink {
        position: In<Ned>,
        yaw_rad: f64,
    },
}

impl Descent {
    /// Down here.
    #[must_use]
    pub fn here() -> Self {
        Self::default()
    }

    /// Down at a place, after flying there at the height the vehicle has.
    #[must_use]
    pub fn at(place: In<Ned>, yaw_rad: Option<f64>) -> Self {
        Self {
            place: Some(place),
            yaw_rad,
            ..Self::default()
        }
    }

    /// The estimate jumped: what was "here" is elsewhere now.
    pub const fn relocalized(&mut self) {
        if let (Stage::Sink { .. }, None) = (&self.stage, &self.place) {
            self.stage = Stage::Begin;
        }
    }

    /// One tick. `touched_down` is control's latch.
    pub fn step(&mut self, c: &mut Cockpit<'_>, touched_down: bool) -> Wish {
        if c.air != Air::Flying {
            return Wish::Disarm;
        }
        if let Stage::Begin = self.stage {
            self.stage = match self.place {
                Some(place) if c.nav.health.position => {
                    let position = place.with_z(c.clamped_down_m(c.nav.position.z()));
                    let goal = Goal {
                        position,
                        heading: self.yaw_rad,
                        speed_mps: None,
                    };
                    match c.navigator.set_goal(goal, c.nav) {
                        Ok(()) => Stage::FlyThere,
                        Err(_) => self.sink_here(c),
                    }
                }
                _ => self.sink_here(c),
            };
        }
        if let (Stage::FlyThere, Some(place)) = (self.stage, self.place) {
            let steering = c.navigator.step(c.now, c.nav);
            let off_m = (place - c.nav.position).norm_xy();
            if !(steering.arrived || off_m < OVER_PLACE_M && c.nav.velocity.norm_xy() < 0.2) {
                return Wish::Fly(steering.setpoint);
            }
            let yaw_rad = self.yaw_rad.unwrap_or_else(|| c.nav.yaw_rad());
            self.stage = Stage::Sink {
                position: place,
                yaw_rad,
            };
        }
        let Stage::Sink { position, yaw_rad } = self.stage else {
            return Wish::Rest;
        };
        if touched_down {
            if self.down_s == 0.0 {
                c.notice(Notice::Landed);
            }
            self.down_s += c.dt_s;
            if self.down_s > c.params.disarm_after_landing_s {
                return Wish::Disarm;
            }
        }
        Wish::Fly(Setpoint::Land {
            position,
            heading: Heading::Yaw(yaw_rad),
            descent_mps: c.params.descent_mps,
        })
    }

    fn sink_here(&self, c: &Cockpit<'_>) -> Stage {
        Stage::Sink {
            position: c.stopping_point(),
            yaw_rad: self.yaw_rad.unwrap_or_else(|| c.nav.yaw_rad()),
        }
    }
}
