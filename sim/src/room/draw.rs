//! The drawing board: solid shapes on the plan, doors cut into walls, and the raster made from them.

use super::{Door, Room};
use crate::geometry::{Point, inside_convex};
use crate::walls::Walls;
use core::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use vehicle::floor_plan::{Cell, Room as NamedPlace};
use vehicle::{FloorPlan, MapPose, Segment};

/// Cells of derived floor plans, m.
pub(super) const RESOLUTION_M: f64 = 0.05;
/// Outer walls, m.
const OUTER_M: f64 = 0.10;

/// A rectangular building being drawn; (0, 0) is its inner lower-left corner.
pub(super) struct Drawing {
    size_m: Point,
    home: MapPose,
    solids: Vec<Vec<Point>>,
    doors: Vec<Door>,
    places: Vec<NamedPlace>,
    /// Shapes that are walls; those drawn after them are furniture.
    walls: Option<usize>,
}

/// A straight wall along x or y: `from..to` along it, `low..high` across.
#[derive(Clone, Copy)]
pub(super) enum Wall {
    /// Along x.
    Across { x: [f64; 2], y: [f64; 2] },
    /// Along y.
    Up { x: [f64; 2], y: [f64; 2] },
}

impl Drawing {
    pub(super) fn new(size_m: Point, home: MapPose) -> Self {
        let [w, h] = size_m;
        let mut drawing = Self {
            size_m,
            home,
            solids: Vec::new(),
            doors: Vec::new(),
            places: Vec::new(),
            walls: None,
        };
        drawing.block([-OUTER_M, w + OUTER_M], [-OUTER_M, 0.0]);
        drawing.block([-OUTER_M, w + OUTER_M], [h, h + OUTER_M]);
        drawing.block([-OUTER_M, 0.0], [0.0, h]);
        drawing.block([w, w + OUTER_M], [0.0, h]);
        drawing
    }

    /// What is drawn from now on is furniture: the same to sensors, not to the eye.
    pub(super) fn furnish(&mut self) {
        self.walls = Some(self.solids.len());
    }

    /// A solid box.
    pub(super) fn block(&mut self, x: [f64; 2], y: [f64; 2]) {
        self.solid(&[[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]]);
    }

    /// A solid convex shape, corners counter-clockwise.
    pub(super) fn solid(&mut self, corners: &[Point]) {
        self.solids.push(corners.to_vec());
    }

    /// A box of `size_m` about `centre`, turned counter-clockwise.
    pub(super) fn turned_block(&mut self, centre: Point, size_m: Point, turn_deg: f64) {
        let (s, c) = libm::sincos(turn_deg.to_radians());
        let corner = |kx: f64, ky: f64| {
            let (x, y) = (0.5 * kx * size_m[0], 0.5 * ky * size_m[1]);
            [centre[0] + c * x - s * y, centre[1] + s * x + c * y]
        };
        self.solid(&[
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ]);
    }

    /// A round table as an octagon.
    pub(super) fn round(&mut self, centre: Point, radius_m: f64) {
        let corners: Vec<Point> = (0..8)
            .map(|i| {
                let (s, c) = libm::sincos((f64::from(i) + 0.5) * core::f64::consts::FRAC_PI_4);
                [centre[0] + radius_m * c, centre[1] + radius_m * s]
            })
            .collect();
        self.solid(&corners);
    }

    /// A wall with doors: name, where their centre is along the wall, width. Doors in order along the wall.
    pub(super) fn wall(&mut self, wall: Wall, doors: &[(&str, f64, f64)]) {
        let ([from, to], [low, high]) = match wall {
            Wall::Across { x, y } => (x, y),
            Wall::Up { x, y } => (y, x),
        };
        let mut start = from;
        for (name, centre, width_m) in doors {
            self.piece(wall, [start, centre - 0.5 * width_m], [low, high]);
            start = centre + 0.5 * width_m;
            let across = 0.5 * (low + high);
            let [x_m, y_m] = match wall {
                Wall::Across { .. } => [*centre, across],
                Wall::Up { .. } => [across, *centre],
            };
            self.doors.push(Door {
                name: (*name).to_owned(),
                x_m,
                y_m,
                width_m: *width_m,
            });
        }
        self.piece(wall, [start, to], [low, high]);
    }

    fn piece(&mut self, wall: Wall, along: [f64; 2], across: [f64; 2]) {
        match wall {
            Wall::Across { .. } => self.block(along, across),
            Wall::Up { .. } => self.block(across, along),
        }
    }

    /// A named free place.
    pub(super) fn place(&mut self, name: &str, x: f64, y: f64) {
        self.places.push(NamedPlace {
            name: name.to_owned(),
            x,
            y,
        });
    }

    /// Walls from the edges of the shapes, plan from the cells whose centre lies in one.
    pub(super) fn finish(self, name: &str) -> Room {
        let walls = &self.solids[..self.walls.unwrap_or(self.solids.len())];
        let walls_end = walls.iter().map(Vec::len).sum();
        let segments: Vec<Segment> = self
            .solids
            .iter()
            .flat_map(|corners| {
                let next = corners.iter().cycle().skip(1);
                corners
                    .iter()
                    .zip(next)
                    .map(|(a, b)| Segment { a: *a, b: *b })
            })
            .collect();
        Room {
            name: name.to_owned(),
            walls_end,
            furniture_end: segments.len(),
            walls: Walls::new(segments),
            opaque: None,
            plan: Arc::new(self.raster()),
            doors: self.doors,
        }
    }

    fn raster(&self) -> FloorPlan {
        let cells_along = |m: f64| libm::round((m + 2.0 * OUTER_M) / RESOLUTION_M) as usize;
        let (width, height) = (cells_along(self.size_m[0]), cells_along(self.size_m[1]));
        let mut cells = vec![Cell::Free; width * height];
        for solid in &self.solids {
            // The cells that its corners lie among.
            let among = |axis: usize, most: usize| {
                let cell = |corner: &[f64; 2]| (corner[axis] + OUTER_M) / RESOLUTION_M;
                let low = solid.iter().map(cell).fold(f64::INFINITY, f64::min);
                let high = solid.iter().map(cell).fold(0.0, f64::max);
                (low.max(0.0) as usize)..(high as usize + 1).min(most)
            };
            for row in among(1, height) {
                for column in among(0, width) {
                    let centre = [column, row].map(|i| (i as f64 + 0.5) * RESOLUTION_M - OUTER_M);
                    if inside_convex(centre, solid) {
                        cells[row * width + column] = Cell::Occupied;
                    }
                }
            }
        }
        let mut plan = FloorPlan::from_cells(width, RESOLUTION_M, [-OUTER_M, -OUTER_M], cells)
            .expect("the drawing has a positive size");
        plan.home = Some(self.home);
        plan.north_rad = FRAC_PI_2;
        plan.rooms.clone_from(&self.places);
        plan
    }
}
