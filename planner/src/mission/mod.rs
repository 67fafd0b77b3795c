//! Missions: a typed plan and the machine that flies it item by item.
//!
//! The executor decides, it does not fly: each step names the leg to fly now. Items are reached strictly in order and each
//! is reported once, those that only change something (speed, jumps, camera) included. Pausing keeps the place; after the
//! last item the mission is complete and starts again from item 0.
//!
//! | From | What happens | To |
//! | --- | --- | --- |
//! | Empty | a plan is loaded | Ready |
//! | Ready, Paused, Complete | `start(seq)` | Active at seq |
//! | Active | `pause` | Paused, same seq |
//! | Paused, Ready | `resume` | Active, same seq |
//! | Complete | `resume` | Active at 0 |
//! | Active | last item reached | Complete |

mod leg;
mod plan;
mod reached;

pub use plan::{Plan, PlanFault, PlanItem, PlanRefusal, Turn, check};

use crate::navigator::Goal;
use crate::params::PlannerParams;
use arrayvec::ArrayVec;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vehicle::{In, NavState, Ned, Timestamp};

/// Most items of a plan.
pub const MAX_ITEMS: usize = 1024;
/// Most items reached in one step; what is left comes with the next.
pub const MAX_REACHED: usize = 8;

/// What to fly now. Give a [`Leg::Goto`] to the navigator when it differs from the last one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Leg {
    /// Stay where you are.
    Hold,
    /// Climb from the floor.
    Takeoff {
        /// Height above home, m.
        height_m: f64,
        /// Heading, rad.
        yaw_rad: Option<f64>,
    },
    /// Fly to a place and stay there.
    Goto(Goal),
    /// Come down, there or here.
    Land {
        /// Where; none is here.
        position: Option<In<Ned>>,
        /// Heading, rad.
        yaw_rad: Option<f64>,
    },
    /// Fly home and land.
    Return,
}

/// Where the mission stands (MISSION_CURRENT.mission_state).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum MissionState {
    /// No plan.
    #[default]
    Empty,
    /// Loaded, not begun.
    Ready,
    /// Being flown.
    Active,
    /// Interrupted, goes on at the same item.
    Paused,
    /// Every item reached.
    Complete,
}

/// What a step gives.
#[derive(Clone, Debug, PartialEq)]
pub struct MissionStep {
    /// Fly this.
    pub leg: Leg,
    /// Items reached in this step, in order: one MISSION_ITEM_REACHED each.
    pub reached: ArrayVec<u16, MAX_REACHED>,
    /// Item being flown (MISSION_CURRENT.seq).
    pub seq: u16,
    /// True in the step that reached the last item.
    pub finished: bool,
}

/// Flies a plan item by item.
#[derive(Clone, Debug)]
pub struct Mission {
    params: PlannerParams,
    plan: Option<Arc<Plan>>,
    state: MissionState,
    seq: usize,
    /// The item has begun: what it needs to know from then.
    begun: Option<Begun>,
    /// Jumps made so far, by item.
    jumps: Vec<i32>,
    speed_mps: Option<f64>,
    /// Where to be while an item asks for no place.
    anchor_goal: Option<Goal>,
}

#[derive(Clone, Copy, Debug)]
struct Begun {
    leg: Leg,
    /// Set when the place (and heading) is reached and a time runs.
    waiting_since: Option<Timestamp>,
    /// Set when the place is reached: from then on a heading is waited for.
    there_since: Option<Timestamp>,
    at: Timestamp,
    /// Smallest distance so far to a place that is only passed, within its radius, m.
    passing_m: Option<f64>,
    /// A turn with a given way round: what is left of it, clockwise +, and the heading when that was counted, rad.
    turn_left: Option<(f64, f64)>,
    /// Touched the floor after having been off it: tells a landing from standing there before take-off.
    was_airborne: bool,
}

impl Mission {
    /// No plan yet.
    #[must_use]
    pub fn new(params: PlannerParams) -> Self {
        Self {
            params,
            plan: None,
            state: MissionState::Empty,
            seq: 0,
            begun: None,
            jumps: Vec::with_capacity(MAX_ITEMS),
            speed_mps: None,
            anchor_goal: None,
        }
    }

    /// Takes over new acceptance radii.
    pub fn set_params(&mut self, params: PlannerParams) {
        self.params = params;
    }

    /// Replaces the plan, not begun; gives the old one back to be freed elsewhere. Plans are [`check`]ed before.
    pub fn load(&mut self, plan: Option<Arc<Plan>>) -> Option<Arc<Plan>> {
        self.state = match &plan {
            Some(p) if !p.items.is_empty() => MissionState::Ready,
            _ => MissionState::Empty,
        };
        self.rewind(0);
        core::mem::replace(&mut self.plan, plan)
    }

    /// The plan.
    #[must_use]
    pub const fn plan(&self) -> Option<&Arc<Plan>> {
        self.plan.as_ref()
    }

    /// Where the mission stands.
    #[must_use]
    pub const fn state(&self) -> MissionState {
        self.state
    }

    /// Item being flown or to be flown next.
    #[must_use]
    pub const fn seq(&self) -> u16 {
        self.seq as u16
    }

    /// Begins at an item.
    ///
    /// # Errors
    /// [`PlanFault`] if there is no such item.
    pub fn start(&mut self, seq: u16) -> Result<(), PlanFault> {
        self.set_current(seq)?;
        self.state = MissionState::Active;
        Ok(())
    }

    /// Makes an item the current one, flying or not (MISSION_SET_CURRENT).
    ///
    /// # Errors
    /// [`PlanFault`] if there is no such item.
    pub fn set_current(&mut self, seq: u16) -> Result<(), PlanFault> {
        let items = self.plan.as_ref().map_or(0, |p| p.items.len());
        if items == 0 {
            return Err(PlanFault::Empty);
        }
        if usize::from(seq) >= items {
            return Err(PlanFault::NoSuchItem(seq));
        }
        if self.state == MissionState::Complete {
            self.state = MissionState::Ready;
        }
        if self.state == MissionState::Active || self.state == MissionState::Paused {
            // Jump counters keep counting: the mission goes on, elsewhere.
            (self.seq, self.begun) = (usize::from(seq), None);
        } else {
            self.rewind(usize::from(seq));
        }
        Ok(())
    }

    /// Interrupts; the place in the plan is kept, a waypoint's hold time begins again.
    pub fn pause(&mut self) {
        if self.state == MissionState::Active {
            (self.state, self.begun) = (MissionState::Paused, None);
        }
    }

    /// Goes on where it was; from item 0 if it was complete.
    ///
    /// # Errors
    /// [`PlanFault::Empty`] without a plan.
    pub fn resume(&mut self) -> Result<(), PlanFault> {
        match self.state {
            MissionState::Empty => Err(PlanFault::Empty),
            MissionState::Complete => self.start(0),
            MissionState::Ready | MissionState::Paused | MissionState::Active => {
                self.state = MissionState::Active;
                Ok(())
            }
        }
    }

    fn rewind(&mut self, seq: usize) {
        (self.seq, self.begun, self.speed_mps, self.anchor_goal) = (seq, None, None, None);
        self.jumps.clear();
        self.jumps.resize(MAX_ITEMS, 0);
    }

    /// What to fly now. `landed`: the vehicle stands on the floor with its thrust taken back.
    pub fn step(&mut self, now: Timestamp, nav: &NavState, landed: bool) -> MissionStep {
        let mut step = MissionStep {
            leg: Leg::Hold,
            reached: ArrayVec::new(),
            seq: self.seq(),
            finished: false,
        };
        let Some(plan) = self.plan.clone() else {
            return step;
        };
        if self.state != MissionState::Active {
            return step;
        }
        while let Some(item) = plan.items.get(self.seq) {
            let begun = match self.begun {
                Some(b) => b,
                None => {
                    let b = Begun {
                        leg: self.leg_of(item, nav),
                        waiting_since: None,
                        there_since: None,
                        passing_m: None,
                        at: now,
                        turn_left: self.turn_of(item, nav).map(|left| (left, nav.yaw_rad())),
                        was_airborne: !landed,
                    };
                    self.begun = Some(b);
                    b
                }
            };
            step.leg = self.led_round(now, begun, nav);
            step.seq = self.seq();
            if !self.is_reached(item, now, nav, landed) || step.reached.is_full() {
                return step;
            }
            step.reached.push(self.seq());
            if let Leg::Goto(goal) = begun.leg {
                self.anchor_goal = Some(goal);
            }
            self.begun = None;
            self.advance(item);
        }
        tracing::info!(items = plan.items.len(), "mission complete");
        self.state = MissionState::Complete;
        self.seq = plan.items.len() - 1;
        step.seq = self.seq();
        step.finished = true;
        step
    }

    fn advance(&mut self, item: &PlanItem) {
        match *item {
            PlanItem::Jump { to, count }
                if count < 0 || self.jumps.get(self.seq).is_some_and(|n| *n < count) =>
            {
                if let Some(n) = self.jumps.get_mut(self.seq) {
                    *n = n.saturating_add(1);
                }
                self.seq = usize::from(to);
            }
            PlanItem::ChangeSpeed { speed_mps } => {
                self.speed_mps = Some(speed_mps);
                self.seq += 1;
            }
            _ => self.seq += 1,
        }
    }
}

#[cfg(test)]
mod tests;
