//! Items of the wire as a plan to fly: degrees to radians, frames to NED about home.

use super::super::Context;
use super::super::place::Place;
use mavlink_dialect::command::cmd;
use mavlink_dialect::mission_item::{Action, Frame, ItemFault, MissionItem, Point};
use planner::mission::{Plan, PlanItem, Turn};
use vehicle::angle::wrap_pi;
use vehicle::{In, Ned};

/// A first waypoint in frame GLOBAL this near to home is the home item of ArduPilot-style files, not a place to fly to.
const HOME_ITEM_M: f64 = 1.0;

/// The plan of a complete list.
///
/// # Errors
/// The item that cannot be flown, and why.
pub(super) fn plan(items: &[MissionItem], ctx: &Context<'_>) -> Result<Plan, (u16, ItemFault)> {
    let mut plan = Plan {
        items: Vec::with_capacity(items.len()),
    };
    for (item, seq) in items.iter().zip(0..) {
        let flown = plan_item(item, ctx).map_err(|fault| (seq, fault))?;
        if matches!(flown, PlanItem::Jump { to, .. } if usize::from(to) >= items.len()) {
            return Err((seq, ItemFault::Param(1)));
        }
        let is_home = seq == 0 && items.len() > 1 && is_home_item(item, &flown, ctx.snapshot.home);
        plan.items
            .push(if is_home { PlanItem::Skip } else { flown });
    }
    Ok(plan)
}

/// One item; also the check of each item as it arrives.
///
/// # Errors
/// Why it cannot be flown.
pub(super) fn plan_item(item: &MissionItem, ctx: &Context<'_>) -> Result<PlanItem, ItemFault> {
    let place = |at: &Point| Place::from_point(at, ctx).ok_or(ItemFault::Frame(item.frame));
    let position = |at: &Point| place(at)?.whole().ok_or(ItemFault::Frame(item.frame));
    let optional = |at: Option<Point>| at.map(|at| position(&at)).transpose();
    Ok(match item.action()? {
        Action::Waypoint {
            at,
            hold_s,
            acceptance_m,
            yaw_deg,
        } => PlanItem::Waypoint {
            position: position(&at)?,
            yaw_rad: yaw_deg.map(radians),
            hold_s: f64::from(hold_s),
            acceptance_m: f64::from(acceptance_m),
        },
        Action::Takeoff { at, yaw_deg } => PlanItem::Takeoff {
            height_m: -place(&at)?.down_m.ok_or(ItemFault::Param(7))?,
            yaw_rad: yaw_deg.map(radians),
        },
        Action::Land { at, yaw_deg } => {
            // Down to the floor whatever the altitude says.
            let at = at.map(|at| Point {
                z_m: at.z_m.or(Some(0.0)),
                ..at
            });
            PlanItem::Land {
                position: optional(at)?,
                yaw_rad: yaw_deg.map(radians),
            }
        }
        Action::Return => PlanItem::Return,
        Action::Loiter {
            at,
            seconds: Some(seconds),
            yaw_deg,
        } => PlanItem::LoiterTime {
            position: optional(at)?,
            yaw_rad: yaw_deg.map(radians),
            seconds: f64::from(seconds),
        },
        Action::Loiter {
            at,
            seconds: None,
            yaw_deg,
        } => PlanItem::LoiterUnlimited {
            position: optional(at)?,
            yaw_rad: yaw_deg.map(radians),
        },
        Action::Delay(seconds) => PlanItem::Delay {
            seconds: f64::from(seconds),
        },
        Action::ConditionDelay(seconds) => PlanItem::ConditionDelay {
            seconds: f64::from(seconds),
        },
        Action::Yaw {
            deg,
            is_relative,
            direction,
        } => PlanItem::ConditionYaw {
            yaw_rad: if is_relative {
                f64::from(deg).to_radians()
            } else {
                radians(deg)
            },
            relative: is_relative,
            turn: match direction {
                1 => Turn::Right,
                -1 => Turn::Left,
                _ => Turn::Shortest,
            },
        },
        Action::Speed(speed) => PlanItem::ChangeSpeed {
            speed_mps: f64::from(speed),
        },
        Action::Jump { to, count } => PlanItem::Jump { to, count },
        Action::Ignored => PlanItem::Skip,
    })
}

fn is_home_item(item: &MissionItem, flown: &PlanItem, home: In<Ned>) -> bool {
    let is_amsl = Frame::from_wire(item.frame) == Some(Frame::Global);
    match flown {
        PlanItem::Waypoint { position, .. } if item.command == cmd::NAV_WAYPOINT && is_amsl => {
            (*position - home).norm() < HOME_ITEM_M
        }
        _ => false,
    }
}

fn radians(deg: f32) -> f64 {
    wrap_pi(f64::from(deg).to_radians())
}
