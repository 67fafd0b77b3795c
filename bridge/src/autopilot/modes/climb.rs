//! Take-off: spool up, climb straight, and where the place is not known yet, look for it.

use super::hold::Target;
use super::{Air, Cockpit, Wish};
use crate::autopilot::door::Notice;
use crate::autopilot::mode::{Because, Mode};
use vehicle::{Heading, In, Ned, Setpoint};

/// Within this of the height the climb is over, m.
const REACHED_M: f64 = 0.08;
/// Turn rate of the search: one turn in 9 s, 2.7 degrees between two scans at 15 Hz.
const SEARCH_TURN_RADPS: f64 = 0.7;

/// A climb in progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Climb {
    height_m: f64,
    start: Option<Start>,
    down_m: f64,
    goal_down_m: f64,
    search_s: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Start {
    position: In<Ned>,
    yaw_rad: f64,
}

impl Climb {
    /// To a height above the floor at home, m.
    #[must_use]
    pub const fn to(height_m: f64) -> Self {
        Self {
            height_m,
            start: None,
            down_m: 0.0,
            goal_down_m: 0.0,
            search_s: None,
        }
    }

    /// Duration of the search so far, s.
    #[must_use]
    pub const fn search_s(&self) -> Option<f64> {
        self.search_s
    }

    /// Where the climb ends: over its start, at its height.
    #[must_use]
    pub fn end(&self) -> Option<Target> {
        self.start.map(|s| Target {
            position: s.position.with_z(self.goal_down_m),
            yaw_rad: s.yaw_rad,
        })
    }

    /// The place under the vehicle is known anew: keep climbing from here.
    pub const fn relocalized(&mut self) {
        self.start = None;
    }

    /// One tick.
    pub fn step(&mut self, c: &mut Cockpit<'_>) -> Wish {
        let start = *self.start.get_or_insert_with(|| Start {
            position: c.nav.position,
            yaw_rad: c.nav.yaw_rad(),
        });
        let is_lost = !c.nav.health.position;
        let height_m = if is_lost {
            c.params.search_height_m
        } else {
            self.height_m
        };
        let goal_down_m = c.clamped_down_m(c.home.z() - height_m);
        self.goal_down_m = goal_down_m;

        if c.air != Air::Flying {
            self.down_m = c.nav.position.z();
            let up = In::new(0.0, 0.0, -c.params.climb_mps);
            let setpoint = if is_lost {
                Setpoint::Velocity {
                    velocity: up,
                    down_m: None,
                    heading: Heading::Yaw(start.yaw_rad),
                }
            } else {
                let position = start.position.with_z(self.down_m - 0.15);
                Setpoint::Hover {
                    position,
                    heading: Heading::Yaw(start.yaw_rad),
                }
            };
            return Wish::LiftOff(setpoint);
        }

        // The set point climbs at the climb speed and is never far ahead of the vehicle.
        let step_m = c.params.climb_mps * c.dt_s;
        self.down_m += (goal_down_m - self.down_m).clamp(-step_m, step_m);
        let there = (c.nav.position.z() - goal_down_m).abs() < REACHED_M;
        if !is_lost {
            self.search_s = None;
            if there {
                return Wish::Switch(Mode::Hold, Because::Finished);
            }
            let position = start.position.with_z(self.down_m);
            return Wish::Fly(Setpoint::Hover {
                position,
                heading: Heading::Yaw(start.yaw_rad),
            });
        }
        let heading = if there || self.search_s.is_some() {
            let so_far = self.search_s.unwrap_or_else(|| {
                c.notice(Notice::Searching);
                0.0
            });
            self.search_s = Some(so_far + c.dt_s);
            Heading::Rate(SEARCH_TURN_RADPS)
        } else {
            Heading::Rate(0.0)
        };
        Wish::Fly(c.stand_still(self.down_m, heading))
    }
}
