//! Plans on disk: QGroundControl's plan files (`.plan`, JSON) and way point files (`QGC WPL 110`), read and written as the items that
//! a station uploads.
//!
//! Source: QGroundControl developer guide, "Plan File Format" (version 1; mission version 2). Coordinates are degrees (metres in the local
//! frame), heights metres. Item ids (`doJumpId`) count from 1, a jump names the id of its target; on the wire items count from 0 and carry
//! no home item. What a file leaves out (`null`) is "not given" on the wire. Our key `kestrel` names rooms; stations leave it alone.
//!
//! | File | Has |
//! | --- | --- |
//! | `read.rs` | both kinds of text to items |
//! | `write.rs` | items to `.plan` |
//! | `step.rs` | the steps a mission is made of, as items |

mod read;
mod step;
mod write;

pub use self::step::Step;

use super::convert::GeoAnchor;
use mavlink_dialect::mission_item::{Frame, MissionItem};
use thiserror::Error;
use vehicle::{In, Ned};

/// MAV_FRAME_MISSION, MAV_FRAME_GLOBAL_RELATIVE_ALT.
const NO_PLACE: u8 = 2;
const RELATIVE: u8 = 3;

/// MAV_CMD of fence and rally points.
mod point {
    pub(super) const POLYGON_IN: u16 = 5001;
    pub(super) const POLYGON_OUT: u16 = 5002;
    pub(super) const CIRCLE_IN: u16 = 5003;
    pub(super) const CIRCLE_OUT: u16 = 5004;
    pub(super) const RALLY: u16 = 5100;
}

/// What a file holds. Each list is numbered from 0, as a station would upload it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanFile {
    /// Items to fly.
    pub mission: Vec<MissionItem>,
    /// Fence.
    pub fence: Vec<MissionItem>,
    /// Rally points.
    pub rally: Vec<MissionItem>,
    /// Rooms by name, NED about home.
    pub rooms: Vec<(String, In<Ned>)>,
    /// Where the plan was made for, degrees; none = where it begins.
    pub home: Option<[f64; 2]>,
    /// Speed that stations reckon with, m/s; none = 1.
    pub cruise_mps: Option<f64>,
}

/// Why a file cannot be read. Items count from 0, as in what the vehicle says of them; lines from 1.
#[derive(Debug, Error)]
pub enum PlanFileError {
    /// Not JSON.
    #[error("not a plan file: {0}")]
    Json(#[from] serde_json::Error),
    /// Something is missing or of another kind.
    #[error("not a plan file: {0}")]
    Shape(String),
    /// A pattern of which only QGroundControl knows the items.
    #[error("item {seq} is a {kind}: save the mission from QGroundControl as simple items")]
    Complex {
        /// Which.
        seq: usize,
        /// What it calls itself.
        kind: String,
    },
    /// A line of a way point file.
    #[error("line {0} is no way point (twelve numbers)")]
    Line(usize),
}

impl PlanFile {
    /// A file of either kind.
    ///
    /// # Errors
    /// [`PlanFileError`] names what is not understood.
    pub fn parse(text: &str) -> Result<Self, PlanFileError> {
        if text.trim_start().starts_with("QGC WPL") {
            read::way_points(text)
        } else {
            read::plan(text)
        }
    }

    /// A mission made of steps, with polygons to stay out of (NED about home).
    #[must_use]
    pub fn from_steps(steps: &[Step], no_fly: &[Vec<In<Ned>>], geo: &GeoAnchor) -> Self {
        let corners = no_fly.iter().flat_map(|zone| {
            zone.iter().map(|corner| {
                let at = geo.to_global(*corner);
                let at = [at.lat_e7, at.lon_e7];
                fence_point(point::POLYGON_OUT, zone.len() as f32, at, 0.0)
            })
        });
        Self {
            mission: numbered(steps.iter().map(|s| s.item(geo)).collect()),
            fence: numbered(corners.collect()),
            home: Some(geo.to_degrees(In::zero())),
            ..Self::default()
        }
    }
}

/// A point of the fence or a rally point; `at` in 1e-7 degrees.
fn fence_point(command: u16, param1: f32, [x, y]: [i32; 2], z: f32) -> MissionItem {
    MissionItem {
        frame: RELATIVE,
        command,
        autocontinue: 1,
        params: [param1, 0.0, 0.0, 0.0],
        x,
        y,
        z,
        ..MissionItem::default()
    }
}

fn numbered(mut items: Vec<MissionItem>) -> Vec<MissionItem> {
    for (seq, item) in (0..).zip(&mut items) {
        item.seq = seq;
        item.current = u8::from(seq == 0);
    }
    items
}

/// Units of the wire in one of the file: 1e-7 degrees, 1e-4 m in local frames.
fn scale(frame: u8) -> f64 {
    match Frame::from_wire(frame) {
        Some(Frame::Local) => 1e4,
        _ => 1e7,
    }
}

#[cfg(test)]
mod tests;
