//! Floor plans: an occupancy grid as every robotics tool writes it (ROS map_server YAML with a PGM or PNG image).
//!
//! Cell (0, 0) is the lower-left one; its lower-left corner is the YAML's `origin`. A plan may carry, in a `kestrel`
//! table that ROS tools ignore, where home is, which way north points, and the names of rooms:
//!
//! ```yaml
//! image: plan.pgm
//! resolution: 0.05
//! origin: [0.0, 0.0, 0.0]
//! negate: 0
//! occupied_thresh: 0.65
//! free_thresh: 0.196
//! kestrel:
//!   home: [2.0, 2.0, 0.0]
//!   north_deg: 90.0
//!   rooms: [{name: lab, x: 2.0, y: 2.0}]
//!   doors: [{name: lab-corridor, a: [3.6, 4.2], b: [4.5, 4.2]}]
//!   no_fly: [[[5.0, 0.0], [6.0, 0.0], [6.0, 1.0]]]
//! ```

pub mod check;
mod distance;
pub mod drawing;
mod load;
mod outline;

pub use distance::DistanceField;

use crate::{In, Map, MapAnchor, MapPose};
use core::f64::consts::FRAC_PI_2;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Largest image accepted, pixels.
pub const MAX_PIXELS: u64 = 64_000_000;

/// Cells accepted, m: finer is noise, coarser is no wall.
pub const RESOLUTION_M: core::ops::RangeInclusive<f64> = 0.005..=1.0;
/// Longest side of a plan, m: indoors.
pub const MAX_SIDE_M: f64 = 500.0;

/// What a cell of the plan is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum Cell {
    /// Known to be open floor.
    Free,
    /// Wall or furniture.
    Occupied,
    /// Not known.
    Unknown,
}

/// A straight piece of wall, metres on the plan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// One end.
    pub a: [f64; 2],
    /// The other end.
    pub b: [f64; 2],
}

/// A named place of the plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Room {
    /// Its name.
    pub name: String,
    /// A free point well inside, plan metres.
    pub x: f64,
    /// A free point well inside, plan metres.
    pub y: f64,
}

/// A named opening in a wall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Doorway {
    /// Its name.
    pub name: String,
    /// One jamb, plan metres.
    pub a: [f64; 2],
    /// The other jamb, plan metres.
    pub b: [f64; 2],
}

/// An occupancy grid with its place in the world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorPlan {
    width: usize,
    height: usize,
    resolution_m: f64,
    origin: [f64; 2],
    cells: Vec<Cell>,
    /// Take-off place and heading; the origin of local NED.
    pub home: Option<MapPose>,
    /// Plan direction of north, radians counter-clockwise from plan x.
    pub north_rad: f64,
    /// Named rooms.
    pub rooms: Vec<Room>,
    /// Named doors.
    pub doors: Vec<Doorway>,
    /// Polygons that are not flown over, corners in plan metres.
    pub no_fly: Vec<Vec<[f64; 2]>>,
}

/// Why a floor plan cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PlanError {
    /// Not YAML.
    #[error("the plan's YAML is broken: {0}")]
    Yaml(String),
    /// A key is missing or has a wrong value.
    #[error("the plan's YAML: `{key}` {what}")]
    Key {
        /// Key.
        key: &'static str,
        /// What is wrong with it.
        what: String,
    },
    /// The image could not be read.
    #[error("the plan's image cannot be decoded: {0} (PGM or PNG is needed)")]
    Image(String),
    /// The image is too large.
    #[error(
        "the plan's image has {pixels} pixels, at most {MAX_PIXELS} are accepted: use a coarser resolution"
    )]
    TooLarge {
        /// Pixels of the image.
        pixels: u64,
    },
    /// Nothing to fly in.
    #[error("the plan has no free cell: check `negate`, `occupied_thresh` and `free_thresh`")]
    NoFreeCell,
}

impl FloorPlan {
    /// A plan from cells in rows from the bottom up, `width` a row.
    ///
    /// # Errors
    /// [`PlanError`] if sizes do not fit each other or are not positive.
    pub fn from_cells(
        width: usize,
        resolution_m: f64,
        origin: [f64; 2],
        cells: Vec<Cell>,
    ) -> Result<Self, PlanError> {
        if !RESOLUTION_M.contains(&resolution_m) {
            return Err(PlanError::Key {
                key: "resolution",
                what: format!(
                    "{resolution_m} is outside {}..={} m per cell",
                    RESOLUTION_M.start(),
                    RESOLUTION_M.end()
                ),
            });
        }
        if width == 0 || cells.is_empty() || !cells.len().is_multiple_of(width) {
            return Err(PlanError::Image(format!(
                "{} cells do not make rows of {width}",
                cells.len()
            )));
        }
        if !origin.iter().all(|v| v.is_finite()) {
            return Err(PlanError::Key {
                key: "origin",
                what: "must be finite".to_owned(),
            });
        }
        let height = cells.len() / width;
        let side_m = width.max(height) as f64 * resolution_m;
        if side_m > MAX_SIDE_M {
            return Err(PlanError::Key {
                key: "resolution",
                what: format!(
                    "makes the plan {side_m:.0} m long; at most {MAX_SIDE_M} m are accepted"
                ),
            });
        }
        Ok(Self {
            width,
            height,
            resolution_m,
            origin,
            cells,
            home: None,
            north_rad: FRAC_PI_2,
            rooms: Vec::new(),
            doors: Vec::new(),
            no_fly: Vec::new(),
        })
    }

    /// Cells in a row.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Side of a cell, m.
    #[must_use]
    pub const fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// Plan coordinates of the lower-left corner, m.
    #[must_use]
    pub const fn origin(&self) -> [f64; 2] {
        self.origin
    }

    /// All cells, rows from the bottom up.
    #[must_use]
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// The cell in a column and row (from the lower left); outside the plan is [`Cell::Unknown`].
    #[must_use]
    pub fn cell(&self, column: i64, row: i64) -> Cell {
        match (usize::try_from(column), usize::try_from(row)) {
            (Ok(c), Ok(r)) if c < self.width && r < self.height => self.cells[r * self.width + c],
            _ => Cell::Unknown,
        }
    }

    /// Column and row of a point, possibly outside the plan.
    #[must_use]
    pub fn index_of(&self, p: In<Map>) -> (i64, i64) {
        (
            libm::floor((p.x() - self.origin[0]) / self.resolution_m) as i64,
            libm::floor((p.y() - self.origin[1]) / self.resolution_m) as i64,
        )
    }

    /// Centre of a cell, z = 0.
    #[must_use]
    pub fn centre_of(&self, column: i64, row: i64) -> In<Map> {
        In::new(
            self.origin[0] + (column as f64 + 0.5) * self.resolution_m,
            self.origin[1] + (row as f64 + 0.5) * self.resolution_m,
            0.0,
        )
    }

    /// The cell at a point.
    #[must_use]
    pub fn at(&self, p: In<Map>) -> Cell {
        let (column, row) = self.index_of(p);
        self.cell(column, row)
    }

    /// True if the plan knows open floor at the point.
    #[must_use]
    pub fn is_free(&self, p: In<Map>) -> bool {
        self.at(p) == Cell::Free
    }

    /// How the plan lies in the world: home (or the plan's origin) and north.
    #[must_use]
    pub fn anchor(&self) -> MapAnchor {
        let home = self.home.unwrap_or_default();
        MapAnchor::new(home.x_m, home.y_m, self.north_rad)
    }

    /// Exact distance from every cell centre to the nearest occupied cell, cut at `max_m`.
    #[must_use]
    pub fn distance_field(&self, max_m: f64) -> DistanceField {
        DistanceField::new(self, max_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cell_zero_is_the_lower_left_one() {
        let mut cells = vec![Cell::Free; 6];
        cells[0] = Cell::Occupied;
        let plan = FloorPlan::from_cells(3, 0.5, [-1.0, 2.0], cells).unwrap();
        assert_eq!(plan.at(In::new(-0.9, 2.1, 0.0)), Cell::Occupied);
        assert_eq!(plan.at(In::new(-0.4, 2.1, 0.0)), Cell::Free);
        assert_eq!(plan.at(In::new(-1.1, 2.1, 0.0)), Cell::Unknown, "outside");
        assert_eq!(plan.centre_of(2, 1), In::new(0.25, 2.75, 0.0));
    }
}
