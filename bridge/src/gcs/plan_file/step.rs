//! The steps that a mission is made of, as items.

use super::super::convert::GeoAnchor;
use super::{NO_PLACE, RELATIVE};
use mavlink_dialect::command::cmd;
use mavlink_dialect::mission_item::MissionItem;
use vehicle::{In, Ned};

/// A step of a mission to be written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Climb, m above home.
    Takeoff(f64),
    /// Pass a place; stay, s.
    Waypoint(In<Ned>, f64),
    /// Fly on with another speed, m/s.
    Speed(f64),
    /// Continue at a step, so many times.
    Jump(usize, u32),
    /// Fly home and land.
    Return,
}

impl Step {
    /// The item a station would upload for it, without a number. A place is rounded to what the protocol carries (1.1 cm).
    #[must_use]
    pub fn item(&self, geo: &GeoAnchor) -> MissionItem {
        let at = |command, p: In<Ned>, up_m: f64, p1: f32| {
            let at = geo.to_global(p);
            MissionItem {
                frame: RELATIVE,
                command,
                autocontinue: 1,
                params: [p1, 0.0, 0.0, f32::NAN],
                x: at.lat_e7,
                y: at.lon_e7,
                z: up_m as f32,
                ..MissionItem::default()
            }
        };
        let act = |command, params| MissionItem {
            frame: NO_PLACE,
            command,
            autocontinue: 1,
            params,
            ..MissionItem::default()
        };
        match self {
            Self::Takeoff(up_m) => at(cmd::NAV_TAKEOFF, In::zero(), *up_m, 0.0),
            Self::Waypoint(p, hold_s) => at(cmd::NAV_WAYPOINT, *p, -p.z(), *hold_s as f32),
            Self::Speed(mps) => act(cmd::DO_CHANGE_SPEED, [1.0, *mps as f32, -1.0, 0.0]),
            Self::Jump(to, times) => act(cmd::DO_JUMP, [*to as f32, *times as f32, 0.0, 0.0]),
            Self::Return => act(cmd::NAV_RETURN_TO_LAUNCH, [0.0; 4]),
        }
    }
}
