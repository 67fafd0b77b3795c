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

mod plan;

pub use plan::{Plan, PlanFault, PlanItem, PlanRefusal, Turn, check};

use crate::navigator::Goal;
use crate::params::PlannerParams;
use arrayvec::ArrayVec;
use core::f64::consts::TAU;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vehicle::angle::{shortest_turn, wrap_pi};
use vehicle::{In, NavState, Ned, Timestamp};

/// Most items of a plan.
pub const MAX_ITEMS: usize = 1024;
/// Most items reached in one step; what is left comes with the next.
pub const MAX_REACHED: usize = 8;
/// Speed below which a waypoint with a hold time counts as held, m/s.
const HOLD_SPEED_MPS: f64 = 0.4;

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

    /// How far round an item turns the way it names, clockwise +, rad; none if the shorter way will do.
    fn turn_of(&self, item: &PlanItem, nav: &NavState) -> Option<f64> {
        let PlanItem::ConditionYaw {
            yaw_rad,
            relative,
            turn,
        } = *item
        else {
            return None;
        };
        let left = match (relative, turn) {
            (true, Turn::Left) => -yaw_rad.abs(),
            (true, Turn::Right) => yaw_rad.abs(),
            (_, Turn::Shortest) => return None,
            (false, way) => {
                let right = (yaw_rad - nav.yaw_rad()).rem_euclid(TAU);
                let acceptance = self.params.yaw_acceptance_deg.to_radians();
                // There already: noise must not send it once round.
                if right < acceptance || right > TAU - acceptance {
                    return None;
                }
                match way {
                    Turn::Left => right - TAU,
                    _ => right,
                }
            }
        };
        Some(left)
    }

    /// The leg, its heading led at most a third of a turn ahead where the longer way round is asked for.
    fn led_round(&mut self, now: Timestamp, begun: Begun, nav: &NavState) -> Leg {
        const LEAD_RAD: f64 = 2.0;
        let (Some((left, counted)), Leg::Goto(goal)) = (begun.turn_left, begun.leg) else {
            return begun.leg;
        };
        let yaw = nav.yaw_rad();
        let left = left - shortest_turn(counted, yaw);
        if let Some(b) = &mut self.begun {
            b.turn_left = (left.abs() > LEAD_RAD).then_some((left, yaw));
            // The time it may take counts from where the shorter way is the right one.
            b.at = now;
        }
        if left.abs() <= LEAD_RAD {
            return begun.leg;
        }
        Leg::Goto(Goal {
            heading: Some(wrap_pi(yaw + LEAD_RAD.copysign(left))),
            ..goal
        })
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

    fn leg_of(&self, item: &PlanItem, nav: &NavState) -> Leg {
        let goal = |position: In<Ned>, heading: Option<f64>| {
            Leg::Goto(Goal {
                position,
                heading,
                speed_mps: self.speed_mps,
            })
        };
        // An item without a place stays at the last place asked for, so that small drifts do not add up.
        let here = || match self.anchor_goal {
            Some(g) => g,
            None => Goal {
                position: nav.position,
                heading: None,
                speed_mps: self.speed_mps,
            },
        };
        match *item {
            PlanItem::Takeoff { height_m, yaw_rad } => Leg::Takeoff { height_m, yaw_rad },
            PlanItem::Waypoint {
                position, yaw_rad, ..
            } => goal(position, yaw_rad),
            PlanItem::LoiterTime {
                position, yaw_rad, ..
            }
            | PlanItem::LoiterUnlimited { position, yaw_rad } => match position {
                Some(p) => goal(p, yaw_rad),
                None => {
                    let g = here();
                    goal(g.position, yaw_rad.or(g.heading))
                }
            },
            PlanItem::Land { position, yaw_rad } => Leg::Land { position, yaw_rad },
            PlanItem::Return => Leg::Return,
            PlanItem::ConditionYaw {
                yaw_rad,
                relative,
                turn,
            } => {
                let now_rad = nav.yaw_rad();
                let target = match (relative, turn) {
                    (false, _) => yaw_rad,
                    (true, Turn::Left) => now_rad - yaw_rad.abs(),
                    (true, Turn::Right) => now_rad + yaw_rad.abs(),
                    (true, Turn::Shortest) => now_rad + yaw_rad,
                };
                goal(here().position, Some(wrap_pi(target)))
            }
            PlanItem::Delay { .. } | PlanItem::ConditionDelay { .. } => {
                let g = here();
                goal(g.position, g.heading)
            }
            PlanItem::ChangeSpeed { .. } | PlanItem::Jump { .. } | PlanItem::Skip => {
                self.anchor_goal.map_or(Leg::Hold, Leg::Goto)
            }
        }
    }

    fn is_reached(
        &mut self,
        item: &PlanItem,
        now: Timestamp,
        nav: &NavState,
        landed: bool,
    ) -> bool {
        let p = &self.params;
        let Some(begun) = &mut self.begun else {
            return false;
        };
        begun.was_airborne |= !landed;
        let since_s = now.seconds_since(begun.at);
        let leg = begun.leg;
        let off_m = match leg {
            Leg::Goto(g) => (nav.position - g.position).norm_xy(),
            _ => 0.0,
        };
        let facing = |heading: Option<f64>| {
            heading.is_none_or(|h| {
                shortest_turn(nav.yaw_rad(), h).abs() < p.yaw_acceptance_deg.to_radians()
            })
        };
        let mut near = |acceptance_m: f64| {
            let Leg::Goto(g) = leg else { return true };
            let d = nav.position - g.position;
            if d.norm_xy() > acceptance_m || d.z().abs() > p.acceptance_alt_m {
                return false;
            }
            let there = *begun.there_since.get_or_insert(now);
            facing(g.heading) || now.seconds_since(there) > p.yaw_timeout_s
        };
        match *item {
            PlanItem::Takeoff { height_m, .. } => {
                !landed && (-nav.position.z() - height_m).abs() < p.acceptance_alt_m
            }
            PlanItem::Waypoint {
                hold_s,
                acceptance_m,
                ..
            } => {
                let radius = if acceptance_m > 0.0 {
                    acceptance_m.min(p.acceptance_max_m)
                } else {
                    p.acceptance_m
                };
                if hold_s <= 0.0 {
                    return near(radius) && is_passed(&mut begun.passing_m, off_m, radius);
                }
                if begun.waiting_since.is_none()
                    && near(radius)
                    && nav.velocity.norm_xy() < HOLD_SPEED_MPS
                {
                    begun.waiting_since = Some(now);
                }
                begun
                    .waiting_since
                    .is_some_and(|t| now.seconds_since(t) >= hold_s)
            }
            PlanItem::LoiterTime { seconds, .. } => {
                if begun.waiting_since.is_none() && near(p.acceptance_m) {
                    begun.waiting_since = Some(now);
                }
                begun
                    .waiting_since
                    .is_some_and(|t| now.seconds_since(t) >= seconds)
            }
            PlanItem::LoiterUnlimited { .. } => false,
            PlanItem::Land { .. } | PlanItem::Return => landed && begun.was_airborne,
            PlanItem::Delay { seconds } | PlanItem::ConditionDelay { seconds } => {
                since_s >= seconds
            }
            PlanItem::ConditionYaw { .. } => {
                begun.turn_left.is_none()
                    && match leg {
                        Leg::Goto(Goal { heading, .. }) => {
                            facing(heading) || since_s > p.yaw_timeout_s
                        }
                        _ => true,
                    }
            }
            PlanItem::ChangeSpeed { .. } | PlanItem::Jump { .. } | PlanItem::Skip => true,
        }
    }
}

/// A place inside its radius is passed when it is near, or no longer comes nearer: waiting for that costs a blink and halves
/// the distance at which corners are cut.
fn is_passed(nearest_m: &mut Option<f64>, off_m: f64, radius_m: f64) -> bool {
    /// Farther than the nearest by this much is going away, not the estimate's tremble, m.
    const AWAY_M: f64 = 0.015;
    let least_m = nearest_m.map_or(off_m, |m| m.min(off_m));
    *nearest_m = Some(least_m);
    off_m <= 0.5 * radius_m || off_m > least_m + AWAY_M
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use vehicle::{Frd, NavHealth, Rot};

    fn nav(x: f64, y: f64, height_m: f64) -> NavState {
        NavState {
            position: In::new(x, y, -height_m),
            height_m,
            health: NavHealth {
                attitude: true,
                height: true,
                velocity: true,
                position: true,
            },
            ..NavState::default()
        }
    }

    const fn waypoint(x: f64, y: f64, hold_s: f64) -> PlanItem {
        PlanItem::Waypoint {
            position: In::new(x, y, -1.0),
            yaw_rad: None,
            hold_s,
            acceptance_m: 0.0,
        }
    }

    fn mission(items: &[PlanItem]) -> Mission {
        let mut m = Mission::new(PlannerParams::default());
        m.load(Some(Arc::new(Plan {
            items: items.to_vec(),
        })));
        m.start(0).unwrap();
        m
    }

    /// Flies perfectly: jumps to whatever is asked for, a step every 100 ms. Returns the items reached and the time.
    fn fly(m: &mut Mission, steps: u64) -> (Vec<u16>, bool) {
        let (mut at, mut landed) = (nav(0.0, 0.0, 0.0), true);
        let mut reached = Vec::new();
        for i in 0..steps {
            let s = m.step(Timestamp::from_ms(100 * i), &at, landed);
            reached.extend(s.reached.iter().copied());
            if s.finished {
                return (reached, true);
            }
            match s.leg {
                Leg::Takeoff { height_m, .. } => {
                    (at, landed) = (nav(0.0, 0.0, height_m), false);
                }
                Leg::Goto(g) => {
                    at = nav(g.position.x(), g.position.y(), -g.position.z());
                    if let Some(h) = g.heading {
                        at.attitude = Rot::<Frd, Ned>::from_roll_pitch_yaw(0.0, 0.0, h);
                    }
                }
                Leg::Land { .. } | Leg::Return => (at, landed) = (nav(0.0, 0.0, 0.05), true),
                Leg::Hold => {}
            }
        }
        (reached, false)
    }

    #[test]
    fn every_item_is_reached_once_and_in_order_those_without_a_place_too() {
        let mut m = mission(&[
            PlanItem::Takeoff {
                height_m: 1.0,
                yaw_rad: None,
            },
            PlanItem::ChangeSpeed { speed_mps: 0.5 },
            waypoint(1.0, 0.0, 0.0),
            PlanItem::Skip,
            waypoint(1.0, 2.0, 1.0),
            PlanItem::Delay { seconds: 0.5 },
            PlanItem::ConditionYaw {
                yaw_rad: 1.0,
                relative: false,
                turn: Turn::Right,
            },
            PlanItem::LoiterTime {
                position: None,
                yaw_rad: None,
                seconds: 0.3,
            },
            PlanItem::Return,
        ]);
        assert_eq!(fly(&mut m, 200), ((0..9).collect(), true));
        assert_eq!((m.state(), m.seq()), (MissionState::Complete, 8));
    }

    #[test]
    fn a_turn_goes_the_way_round_it_names() {
        for (relative, turn, yaw_deg, degrees) in [
            (false, Turn::Right, -90.0, 270.0),
            (false, Turn::Left, -90.0, -90.0),
            (false, Turn::Left, 90.0, -270.0),
            (false, Turn::Right, 90.0, 90.0),
            (false, Turn::Shortest, -90.0, -90.0),
            (true, Turn::Right, 270.0, 270.0),
            (true, Turn::Left, 200.0, -200.0),
            (false, Turn::Right, -0.5, 0.0),
        ] {
            let mut m = mission(&[PlanItem::ConditionYaw {
                yaw_rad: f64::to_radians(yaw_deg),
                relative,
                turn,
            }]);
            let (mut yaw, mut turned) = (0.0f64, 0.0f64);
            for step in 0..400 {
                let here = NavState {
                    attitude: Rot::<Frd, Ned>::from_roll_pitch_yaw(0.0, 0.0, wrap_pi(yaw)),
                    ..nav(0.0, 0.0, 1.0)
                };
                let s = m.step(Timestamp::from_ms(step * 50), &here, false);
                if s.finished {
                    break;
                }
                let Leg::Goto(Goal {
                    heading: Some(heading),
                    ..
                }) = s.leg
                else {
                    panic!("{:?}", s.leg)
                };
                // A vehicle that turns the shorter way at 1 rad/s.
                let by = shortest_turn(yaw, heading).clamp(-0.05, 0.05);
                (yaw, turned) = (yaw + by, turned + by);
            }
            let off = (turned.to_degrees() - degrees).abs();
            assert!(
                off < 12.0,
                "{relative} {turn:?} {yaw_deg}: turned {:.0}",
                turned.to_degrees()
            );
        }
    }

    #[test]
    fn a_speed_item_changes_the_speed_of_what_follows() {
        let mut m = mission(&[
            PlanItem::ChangeSpeed { speed_mps: 0.4 },
            waypoint(3.0, 0.0, 0.0),
        ]);
        let s = m.step(Timestamp::ZERO, &nav(0.0, 0.0, 1.0), false);
        assert!(
            matches!(s.leg, Leg::Goto(Goal { speed_mps: Some(v), .. }) if (v - 0.4).abs() < 1e-12)
        );
        assert_eq!((s.reached.as_slice(), s.seq), (&[0u16][..], 1));
    }

    #[test]
    fn a_waypoint_is_reached_within_12_centimetres_and_its_hold_runs_from_there() {
        let mut m = mission(&[waypoint(1.0, 0.0, 2.0), waypoint(5.0, 0.0, 0.0)]);
        let mut reached = |ms: u64, x: f64| {
            m.step(Timestamp::from_ms(ms), &nav(x, 0.0, 1.0), false)
                .reached
                .to_vec()
        };
        assert!(reached(0, 0.85).is_empty());
        assert!(reached(5_000, 0.89).is_empty(), "2 s from here");
        assert!(reached(6_900, 1.0).is_empty());
        assert_eq!(reached(7_000, 1.0), [0]);
    }

    #[test]
    fn pausing_keeps_the_place_and_a_complete_mission_starts_again() {
        let mut m = mission(&[waypoint(0.0, 0.0, 0.0), waypoint(4.0, 0.0, 0.0)]);
        let here = nav(0.0, 0.0, 1.0);
        assert_eq!(
            m.step(Timestamp::ZERO, &here, false).reached.as_slice(),
            &[0]
        );
        m.pause();
        let s = m.step(Timestamp::from_ms(10), &here, false);
        assert_eq!(
            (s.leg, s.seq, m.state()),
            (Leg::Hold, 1, MissionState::Paused)
        );
        m.resume().unwrap();
        let s = m.step(Timestamp::from_ms(20), &nav(4.0, 0.05, 1.0), false);
        assert!(s.finished && s.reached.as_slice() == [1]);
        m.resume().unwrap();
        assert_eq!((m.seq(), m.state()), (0, MissionState::Active));
    }

    #[test]
    fn a_jump_of_two_flies_the_loop_three_times_and_one_for_ever_never_hangs() {
        let mut m = mission(&[
            waypoint(1.0, 0.0, 0.0),
            waypoint(2.0, 0.0, 0.0),
            PlanItem::Jump { to: 0, count: 2 },
        ]);
        assert_eq!(fly(&mut m, 100), (vec![0, 1, 2, 0, 1, 2, 0, 1, 2], true));
        let mut m = mission(&[PlanItem::Jump { to: 0, count: -1 }]);
        let s = m.step(Timestamp::ZERO, &nav(0.0, 0.0, 1.0), false);
        assert_eq!(s.reached.len(), MAX_REACHED);
    }

    #[test]
    fn standing_on_the_floor_before_take_off_is_not_a_landing() {
        let mut m = mission(&[PlanItem::Land {
            position: None,
            yaw_rad: None,
        }]);
        assert!(
            m.step(Timestamp::ZERO, &nav(0.0, 0.0, 0.05), true)
                .reached
                .is_empty()
        );
        assert!(
            m.step(Timestamp::from_ms(100), &nav(0.0, 0.0, 0.5), false)
                .reached
                .is_empty()
        );
        assert!(
            m.step(Timestamp::from_ms(200), &nav(0.0, 0.0, 0.05), true)
                .finished
        );
    }

    proptest! {
        #[test]
        fn whatever_is_done_the_sequence_stays_inside_the_plan(actions in proptest::collection::vec(0u8..8, 1..60)) {
            let items = [waypoint(0.0, 0.0, 0.0), PlanItem::Jump { to: 0, count: 1 }, waypoint(1.0, 0.0, 0.2), PlanItem::Return];
            let mut m = mission(&items);
            let mut t = 0;
            for a in actions {
                t += 100;
                match a {
                    0 => m.pause(),
                    1 => { let _ = m.resume(); }
                    2 => { let _ = m.start(u16::from(a) + 7); }
                    3 => { let _ = m.set_current(2); }
                    _ => {
                        let x = f64::from(a % 2);
                        let s = m.step(Timestamp::from_ms(t), &nav(x, 0.0, 1.0), a == 7);
                        prop_assert!(usize::from(s.seq) < items.len());
                        prop_assert!(!s.finished || m.state() == MissionState::Complete);
                    }
                }
                prop_assert!(usize::from(m.seq()) < items.len());
            }
        }
    }
}
