//! The plan as data, and whether it can be flown.

use super::MAX_ITEMS;
use crate::route::{RouteError, Router};
use serde::{Deserialize, Serialize};
use thiserror::Error;
use vehicle::{In, MapAnchor, Ned};

/// A mission.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Items; the index is MISSION_ITEM_INT.seq.
    pub items: Vec<PlanItem>,
}

/// Which way round to turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Turn {
    /// The shorter way.
    Shortest,
    /// Clockwise.
    Right,
    /// Counter-clockwise.
    Left,
}

/// One item of a mission (MAV_CMD in brackets).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum PlanItem {
    /// Take off (22).
    Takeoff {
        /// Height above home, m.
        height_m: f64,
        /// Heading to turn to, rad.
        yaw_rad: Option<f64>,
    },
    /// Pass a place (16).
    Waypoint {
        /// Where, m.
        position: In<Ned>,
        /// Heading there; none keeps the nose on the way.
        yaw_rad: Option<f64>,
        /// Stay this long, s.
        hold_s: f64,
        /// Reached within this distance, m; 0 takes NAV_ACC_RAD.
        acceptance_m: f64,
    },
    /// Stay for a time (19).
    LoiterTime {
        /// Where; none is here.
        position: Option<In<Ned>>,
        /// Heading there, rad.
        yaw_rad: Option<f64>,
        /// How long, s.
        seconds: f64,
    },
    /// Stay until told otherwise (17).
    LoiterUnlimited {
        /// Where; none is here.
        position: Option<In<Ned>>,
        /// Heading there, rad.
        yaw_rad: Option<f64>,
    },
    /// Land (21).
    Land {
        /// Where; none is here.
        position: Option<In<Ned>>,
        /// Heading, rad.
        yaw_rad: Option<f64>,
    },
    /// Fly home and land (20).
    Return,
    /// Wait before the next item (93).
    Delay {
        /// How long, s.
        seconds: f64,
    },
    /// Wait before the next item that changes something (112).
    ConditionDelay {
        /// How long, s.
        seconds: f64,
    },
    /// Turn (115).
    ConditionYaw {
        /// Heading from north, or the angle to turn by when `relative`, rad.
        yaw_rad: f64,
        /// Counted from the heading when the item begins.
        relative: bool,
        /// Which way round.
        turn: Turn,
    },
    /// Fly on with another speed (178).
    ChangeSpeed {
        /// Speed, m/s.
        speed_mps: f64,
    },
    /// Continue at another item (177).
    Jump {
        /// Item to continue at.
        to: u16,
        /// How often; -1 for ever.
        count: i32,
    },
    /// Accepted, nothing to fly (region of interest, camera, gimbal).
    Skip,
}

/// Why a plan cannot be flown.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PlanFault {
    /// Nothing to fly.
    #[error("the plan has no items")]
    Empty,
    /// More than fits.
    #[error("the plan has {0} items, at most {MAX_ITEMS} are accepted")]
    TooLong(usize),
    /// No such item.
    #[error("there is no item {0}")]
    NoSuchItem(u16),
    /// A number is missing, negative or not finite.
    #[error("{0} is not a usable number")]
    Number(&'static str),
    /// Above the ceiling or below the floor.
    #[error("height {height_m:.2} m is outside 0.2..={ceiling_m:.2} m")]
    Height {
        /// Height asked for, m.
        height_m: f64,
        /// Largest allowed, m.
        ceiling_m: f64,
    },
    /// The place cannot be flown to.
    #[error(transparent)]
    Place(#[from] RouteError),
}

/// A plan refused, and the item that is why.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("item {seq}: {fault}")]
pub struct PlanRefusal {
    /// Item.
    pub seq: u16,
    /// What is wrong with it.
    pub fault: PlanFault,
}

/// Checks that every item of a plan can be flown: numbers, heights, and a way on the floor plan from each place to the
/// next, beginning at `start`. Takes a search per waypoint, so it belongs beside the flight loop, not in it.
///
/// # Errors
/// [`PlanRefusal`] names the first item that cannot be flown.
pub fn check(
    plan: &Plan,
    router: &mut Router,
    anchor: &MapAnchor,
    start: In<Ned>,
    ceiling_m: f64,
) -> Result<(), PlanRefusal> {
    let refuse = |seq: usize, fault: PlanFault| PlanRefusal {
        seq: seq as u16,
        fault,
    };
    if plan.items.is_empty() {
        return Err(refuse(0, PlanFault::Empty));
    }
    if plan.items.len() > MAX_ITEMS {
        return Err(refuse(MAX_ITEMS, PlanFault::TooLong(plan.items.len())));
    }
    let mut from = start;
    for (seq, item) in plan.items.iter().enumerate() {
        let fault = |f: PlanFault| refuse(seq, f);
        item.check_numbers(plan.items.len()).map_err(fault)?;
        if let Some(height_m) = item.height_m()
            && !(0.2..=ceiling_m).contains(&height_m)
        {
            return Err(fault(PlanFault::Height {
                height_m,
                ceiling_m,
            }));
        }
        if let Some(to) = item.place() {
            router
                .find(anchor.to_map(from), anchor.to_map(to), &[])
                .map_err(|e| fault(e.into()))?;
            from = to;
        } else if matches!(item, PlanItem::Return) {
            from = In::zero();
        }
    }
    Ok(())
}

impl PlanItem {
    /// Where the item is, if it is somewhere.
    #[must_use]
    pub const fn place(&self) -> Option<In<Ned>> {
        match self {
            Self::Waypoint { position, .. } => Some(*position),
            Self::LoiterTime { position, .. }
            | Self::LoiterUnlimited { position, .. }
            | Self::Land { position, .. } => *position,
            _ => None,
        }
    }

    fn height_m(&self) -> Option<f64> {
        match self {
            Self::Takeoff { height_m, .. } => Some(*height_m),
            Self::Land { .. } => None,
            _ => self.place().map(|p| -p.z()),
        }
    }

    fn check_numbers(&self, items: usize) -> Result<(), PlanFault> {
        let finite = |name: &'static str, v: f64| {
            if v.is_finite() {
                Ok(())
            } else {
                Err(PlanFault::Number(name))
            }
        };
        let positive = |name: &'static str, v: f64| {
            if v.is_finite() && v >= 0.0 {
                Ok(())
            } else {
                Err(PlanFault::Number(name))
            }
        };
        if let Some(p) = self.place()
            && !p.is_finite()
        {
            return Err(PlanFault::Number("the position"));
        }
        match *self {
            Self::Takeoff { height_m, yaw_rad } => {
                positive("the height", height_m)?;
                finite("the heading", yaw_rad.unwrap_or(0.0))
            }
            Self::Waypoint {
                yaw_rad,
                hold_s,
                acceptance_m,
                ..
            } => {
                finite("the heading", yaw_rad.unwrap_or(0.0))?;
                positive("the hold time", hold_s)?;
                positive("the acceptance radius", acceptance_m)
            }
            Self::LoiterTime {
                yaw_rad, seconds, ..
            } => {
                finite("the heading", yaw_rad.unwrap_or(0.0))?;
                positive("the time", seconds)
            }
            Self::LoiterUnlimited { yaw_rad, .. } | Self::Land { yaw_rad, .. } => {
                finite("the heading", yaw_rad.unwrap_or(0.0))
            }
            Self::Delay { seconds } | Self::ConditionDelay { seconds } => {
                positive("the time", seconds)
            }
            Self::ConditionYaw { yaw_rad, .. } => finite("the heading", yaw_rad),
            Self::ChangeSpeed { speed_mps } => {
                if speed_mps.is_finite() && speed_mps > 0.0 {
                    Ok(())
                } else {
                    Err(PlanFault::Number("the speed"))
                }
            }
            Self::Jump { to, count } => {
                if usize::from(to) >= items {
                    Err(PlanFault::NoSuchItem(to))
                } else if count < -1 {
                    Err(PlanFault::Number("the number of jumps"))
                } else {
                    Ok(())
                }
            }
            Self::Return | Self::Skip => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::PlannerParams;
    use std::sync::Arc;
    use vehicle::FloorPlan;
    use vehicle::floor_plan::Cell;

    const fn waypoint(x: f64, y: f64, hold_s: f64) -> PlanItem {
        PlanItem::Waypoint {
            position: In::new(x, y, -1.0),
            yaw_rad: None,
            hold_s,
            acceptance_m: 0.0,
        }
    }

    #[test]
    fn what_cannot_be_flown_is_refused_with_item_and_reason() {
        // 4 m by 4 m, home in the middle, north up.
        let wall = |i: usize| [0, 79].contains(&(i % 80)) || [0, 79].contains(&(i / 80));
        let cells = (0..6400)
            .map(|i| if wall(i) { Cell::Occupied } else { Cell::Free })
            .collect();
        let plan = Arc::new(FloorPlan::from_cells(80, 0.05, [-2.0, -2.0], cells).unwrap());
        let anchor = plan.anchor();
        let mut router = Router::new(plan, 0.16, &PlannerParams::default());
        let mut said = |items: &[PlanItem]| {
            let plan = Plan {
                items: items.to_vec(),
            };
            check(&plan, &mut router, &anchor, In::zero(), 2.5).map_err(|e| e.to_string())
        };
        let takeoff = PlanItem::Takeoff {
            height_m: 1.0,
            yaw_rad: None,
        };
        assert_eq!(said(&[takeoff, waypoint(1.0, 1.0, 0.0)]), Ok(()));
        assert_eq!(said(&[]).unwrap_err(), "item 0: the plan has no items");
        assert!(
            said(&[takeoff, waypoint(5.0, 0.0, 0.0)])
                .unwrap_err()
                .starts_with("item 1: the place is outside")
        );
        assert!(
            said(&[takeoff, waypoint(1.9, 0.0, 0.0)])
                .unwrap_err()
                .contains("from a wall")
        );
        let high = PlanItem::Takeoff {
            height_m: 9.0,
            yaw_rad: None,
        };
        assert_eq!(
            said(&[high]).unwrap_err(),
            "item 0: height 9.00 m is outside 0.2..=2.50 m"
        );
        assert_eq!(
            said(&[PlanItem::Jump { to: 7, count: 1 }]).unwrap_err(),
            "item 0: there is no item 7"
        );
        assert_eq!(
            said(&[waypoint(f64::NAN, 0.0, 0.0)]).unwrap_err(),
            "item 0: the position is not a usable number"
        );
    }
}
