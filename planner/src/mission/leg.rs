//! What an item asks to be flown, and which way round it turns.

use super::{Begun, Leg, Mission, PlanItem, Turn};
use crate::navigator::Goal;
use core::f64::consts::TAU;
use vehicle::angle::{shortest_turn, wrap_pi};
use vehicle::{In, NavState, Ned, Timestamp};

impl Mission {
    /// How far round an item turns the way it names, clockwise +, rad; none if the shorter way will do.
    pub(super) fn turn_of(&self, item: &PlanItem, nav: &NavState) -> Option<f64> {
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
    pub(super) fn led_round(&mut self, now: Timestamp, begun: Begun, nav: &NavState) -> Leg {
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

    pub(super) fn leg_of(&self, item: &PlanItem, nav: &NavState) -> Leg {
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
}
