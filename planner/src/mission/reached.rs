//! When an item is done.

use super::{Leg, Mission, PlanItem};
use crate::navigator::Goal;
use vehicle::angle::shortest_turn;
use vehicle::{NavState, Timestamp};

/// Speed below which a waypoint with a hold time counts as held, m/s.
const HOLD_SPEED_MPS: f64 = 0.4;

/// A place inside its radius is passed when it is near, or no longer comes nearer: waiting for that costs a blink and halves
/// the distance at which corners are cut.
pub(super) fn is_passed(nearest_m: &mut Option<f64>, off_m: f64, radius_m: f64) -> bool {
    /// Farther than the nearest by this much is going away, not the estimate's tremble, m.
    const AWAY_M: f64 = 0.015;
    let least_m = nearest_m.map_or(off_m, |m| m.min(off_m));
    *nearest_m = Some(least_m);
    off_m <= 0.5 * radius_m || off_m > least_m + AWAY_M
}

impl Mission {
    pub(super) fn is_reached(
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
