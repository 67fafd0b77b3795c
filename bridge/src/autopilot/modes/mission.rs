//! Mission: fly the stored plan item by item.

use super::climb::Climb;
use super::descent::Descent;
use super::homeward::Homeward;
use super::{Air, Cockpit, Wish, refusal_of};
use crate::autopilot::door::{Event, Notice};
use crate::autopilot::mode::{Because, Mode};
use planner::mission::{Leg, Mission};
use planner::navigator::Goal;

/// How the current leg is being flown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MissionMode {
    leg: Option<Leg>,
    flight: LegFlight,
    /// Speed set by DO_CHANGE_SPEED outside the plan, m/s.
    cruise_mps: Option<f64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum LegFlight {
    #[default]
    Navigator,
    Climb(Climb),
    Descent(Descent),
    Homeward(Homeward),
}

impl MissionMode {
    /// The estimate jumped.
    pub fn relocalized(&mut self) {
        self.leg = None;
    }

    /// One tick.
    pub fn step(
        &mut self,
        c: &mut Cockpit<'_>,
        mission: &mut Mission,
        cruise_mps: Option<f64>,
        touched_down: bool,
    ) -> Wish {
        self.cruise_mps = cruise_mps;
        if !c.nav.health.position && c.air == Air::Flying {
            let down_m = c.clamped_down_m(c.nav.position.z());
            return Wish::Fly(c.stand_still(down_m, vehicle::Heading::Rate(0.0)));
        }
        let is_down = c.air == Air::Ground || touched_down;
        let step = mission.step(c.now, c.nav, is_down);
        for seq in &step.reached {
            let _ = c.events.try_push(Event::ItemReached(*seq));
        }
        if step.finished {
            c.notice(Notice::MissionFinished);
            return if is_down && c.air != Air::Ground {
                Wish::Disarm
            } else {
                Wish::Switch(Mode::Hold, Because::Finished)
            };
        }
        if self.leg != Some(step.leg) {
            self.leg = Some(step.leg);
            self.begin(c, step.seq, &step.leg);
        }
        // Whatever the leg, a vehicle on the floor has to leave it first.
        if c.air != Air::Flying && !matches!(self.flight, LegFlight::Climb(_)) {
            let height_m = match step.leg {
                Leg::Goto(goal) => c.home.z() - goal.position.z(),
                Leg::Hold | Leg::Land { .. } | Leg::Return => return Wish::Rest,
                Leg::Takeoff { height_m, .. } => height_m,
            };
            self.flight = LegFlight::Climb(Climb::to(height_m));
        }
        self.fly(c, &step.leg, touched_down)
    }

    fn begin(&mut self, c: &mut Cockpit<'_>, seq: u16, leg: &Leg) {
        self.flight = match leg {
            Leg::Takeoff { height_m, .. } if c.air != Air::Flying => {
                LegFlight::Climb(Climb::to(*height_m))
            }
            Leg::Takeoff { height_m, yaw_rad } => {
                let position = c
                    .stopping_point()
                    .with_z(c.clamped_down_m(c.home.z() - height_m));
                c.navigator.hold(position, *yaw_rad, c.nav);
                LegFlight::Navigator
            }
            Leg::Goto(goal) => {
                self.goto(c, seq, goal);
                LegFlight::Navigator
            }
            Leg::Hold => {
                let here = c.stopping_point();
                c.navigator.hold(here, None, c.nav);
                LegFlight::Navigator
            }
            Leg::Land {
                position: Some(place),
                yaw_rad,
            } => LegFlight::Descent(Descent::at(*place, *yaw_rad)),
            Leg::Land { position: None, .. } => LegFlight::Descent(Descent::here()),
            Leg::Return => LegFlight::Homeward(Homeward::default()),
        };
    }

    fn goto(&self, c: &mut Cockpit<'_>, seq: u16, goal: &Goal) {
        let position = goal.position.with_z(c.clamped_down_m(goal.position.z()));
        let goal = Goal {
            position,
            speed_mps: goal.speed_mps.or(self.cruise_mps),
            ..*goal
        };
        if let Err(e) = c.navigator.set_goal(goal, c.nav) {
            c.notice(Notice::ItemRefused {
                seq,
                why: refusal_of(&e),
            });
            let here = c.stopping_point();
            c.navigator.hold(here, None, c.nav);
        }
    }

    fn fly(&mut self, c: &mut Cockpit<'_>, leg: &Leg, touched_down: bool) -> Wish {
        match &mut self.flight {
            LegFlight::Climb(climb) => match climb.step(c) {
                Wish::Switch(..) => {
                    let climb_end = climb.end();
                    // Up: go on with the leg itself.
                    self.flight = LegFlight::Navigator;
                    match leg {
                        Leg::Goto(goal) => self.goto(c, 0, goal),
                        _ => {
                            let end = climb_end.map_or(c.nav.position, |end| end.position);
                            c.navigator.hold(end, None, c.nav);
                        }
                    }
                    Wish::Fly(c.navigator.step(c.now, c.nav).setpoint)
                }
                wish => wish,
            },
            LegFlight::Descent(descent) => descent.step(c, touched_down),
            LegFlight::Homeward(homeward) => homeward.step(c, touched_down),
            LegFlight::Navigator => Wish::Fly(c.navigator.step(c.now, c.nav).setpoint),
        }
    }
}
