//! Obstacle points around the vehicle: the faces of the plan's walls, certain cells of the grid, the
//! last echoes, people.
//!
//! Collected once per step; the histogram, the free distance ahead, the limiter of manual flight and the console's picture
//! are all computed from this one list.

use super::grid::{CELL_M, CERTAINTY_MAX, CertaintyGrid};
use super::{SECTORS, sector_of};
use nalgebra::Vector2;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, In, Map, Timestamp};

/// Most points kept; a window full of walls has a few hundred.
const POINTS_MAX: usize = 2048;
/// Wall cells are not finer than this, m.
const WALL_CELL_MIN_M: f64 = 0.05;
/// A single echo: strong enough to brake for, too weak to steer by alone.
const ECHO_WEIGHT: f64 = 0.17;
/// Points on a person's outline.
const OUTLINE: usize = 12;

/// One obstacle point relative to the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// From the vehicle's centre, plan axes, m.
    pub offset: Vector2<f64>,
    /// Its length, m.
    pub distance_m: f64,
    /// Certainty squared times size, 1 for a certain cell of 0.1 m.
    pub weight: f64,
}

/// The faces of the plan's walls as a raster.
#[derive(Clone, Debug, PartialEq)]
pub struct WallRaster {
    width: usize,
    height: usize,
    cell_m: f64,
    origin: [f64; 2],
    is_face: Vec<bool>,
}

impl WallRaster {
    /// From a plan: occupied cells with at least one neighbour that is not.
    #[must_use]
    pub fn new(plan: &FloorPlan) -> Self {
        let coarse = libm::ceil(WALL_CELL_MIN_M / plan.resolution_m() - 1e-9).max(1.0) as usize;
        let (width, height) = (
            plan.width().div_ceil(coarse),
            plan.height().div_ceil(coarse),
        );
        let mut is_face = vec![false; width * height];
        for row in 0..plan.height() {
            for column in 0..plan.width() {
                let (c, r) = (column as i64, row as i64);
                let solid = |c: i64, r: i64| plan.cell(c, r) == Cell::Occupied;
                let open = |c: i64, r: i64| plan.cell(c, r) == Cell::Free;
                let beside = open(c - 1, r) || open(c + 1, r) || open(c, r - 1) || open(c, r + 1);
                if solid(c, r) && beside {
                    is_face[row / coarse * width + column / coarse] = true;
                }
            }
        }
        Self {
            width,
            height,
            cell_m: plan.resolution_m() * coarse as f64,
            origin: plan.origin(),
            is_face,
        }
    }

    fn around(&self, centre: In<Map>, half_side_m: f64, mut see: impl FnMut(Vector2<f64>)) {
        let cell = |v: f64, o: f64| libm::floor((v - o) / self.cell_m);
        let low = |v: f64, o: f64| cell(v - half_side_m, o).max(0.0) as usize;
        let high = |v: f64, o: f64, n: usize| {
            (cell(v + half_side_m, o) + 1.0).clamp(0.0, n as f64) as usize
        };
        let (c0, c1) = (
            low(centre.x(), self.origin[0]),
            high(centre.x(), self.origin[0], self.width),
        );
        for row in low(centre.y(), self.origin[1])..high(centre.y(), self.origin[1], self.height) {
            if c0 >= c1 {
                break;
            }
            let line = &self.is_face[row * self.width + c0..row * self.width + c1];
            for (i, _) in line.iter().enumerate().filter(|(_, face)| **face) {
                see(Vector2::new(
                    self.origin[0] + ((c0 + i) as f64 + 0.5) * self.cell_m - centre.x(),
                    self.origin[1] + (row as f64 + 0.5) * self.cell_m - centre.y(),
                ));
            }
        }
    }
}

/// A round obstacle that moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Centre on the plan.
    pub centre: In<Map>,
    /// Radius, m.
    pub radius_m: f64,
}

/// The obstacle points of one moment.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// Cells of the grid first, then everything else.
    points: Vec<Obstacle>,
    cells: usize,
    centre: In<Map>,
    window_m: f64,
}

impl Default for Surroundings {
    fn default() -> Self {
        Self {
            points: Vec::with_capacity(POINTS_MAX),
            cells: 0,
            centre: In::zero(),
            window_m: 0.0,
        }
    }
}

impl Surroundings {
    /// Begins anew around a place; what is farther than `window_m` is left out.
    pub fn begin(&mut self, centre: In<Map>, window_m: f64) {
        self.points.clear();
        self.cells = 0;
        (self.centre, self.window_m) = (centre, window_m);
    }

    /// Adds the faces of the plan's walls: only while the place on the plan is known.
    pub fn add_walls(&mut self, walls: &WallRaster) {
        let weight = walls.cell_m / CELL_M;
        let (centre, window_m) = (self.centre, self.window_m);
        walls.around(centre, window_m, |offset| self.push(offset, weight));
    }

    /// Adds the cells of the certainty grid: first of all.
    pub fn add_cells(&mut self, grid: &CertaintyGrid, now: Timestamp) {
        let (centre, window_m) = (self.centre, self.window_m);
        grid.around(centre, window_m, now, |p, certainty| {
            let share = f64::from(certainty) / f64::from(CERTAINTY_MAX);
            self.add(p, share * share);
        });
        self.cells = self.points.len();
    }

    /// The points that are no cells of the grid.
    #[must_use]
    pub fn others(&self) -> &[Obstacle] {
        &self.points[self.cells..]
    }

    /// Adds a point of a border that nobody may cross: as good as a wall.
    pub fn add_border(&mut self, p: In<Map>) {
        self.add(p, 1.0);
    }

    /// Adds a single echo.
    pub fn add_echo(&mut self, p: In<Map>) {
        self.add(p, ECHO_WEIGHT);
    }

    /// Adds the outline of somebody.
    pub fn add_disc(&mut self, disc: Disc) {
        for k in 0..OUTLINE {
            let a = core::f64::consts::TAU * k as f64 / OUTLINE as f64;
            let edge = In::new(libm::cos(a), libm::sin(a), 0.0) * disc.radius_m;
            self.add(disc.centre + edge, 1.0);
        }
    }

    fn add(&mut self, p: In<Map>, weight: f64) {
        let offset = Vector2::new(p.x() - self.centre.x(), p.y() - self.centre.y());
        self.push(offset, weight);
    }

    fn push(&mut self, offset: Vector2<f64>, weight: f64) {
        let distance_m = offset.norm();
        if distance_m <= self.window_m && self.points.len() < POINTS_MAX {
            self.points.push(Obstacle {
                offset,
                distance_m,
                weight,
            });
        }
    }

    /// The points.
    #[must_use]
    pub fn points(&self) -> &[Obstacle] {
        &self.points
    }

    /// How far a disc of this radius can move in a direction (unit vector) before it touches a point that is surer than
    /// `weight_min`; the window's size if none is in the way. Points already touched count only when moving closer.
    #[must_use]
    pub fn free_m(&self, direction: Vector2<f64>, radius_m: f64, weight_min: f64) -> f64 {
        let mut free = self.window_m;
        for o in &self.points {
            let along = o.offset.dot(&direction);
            let aside = o.offset.perp(&direction);
            if along > 0.0 && aside.abs() < radius_m && o.weight >= weight_min {
                let contact = along - libm::sqrt(radius_m * radius_m - aside * aside);
                free = free.min(contact.max(0.0));
            }
        }
        free
    }

    /// Distance to the nearest point, m; infinite without any.
    #[must_use]
    pub fn nearest_m(&self, weight_min: f64) -> f64 {
        self.points
            .iter()
            .filter(|o| o.weight >= weight_min)
            .fold(f64::INFINITY, |d, o| d.min(o.distance_m))
    }

    /// Nearest point per sector, m.
    pub fn nearest_by_sector(&self, out: &mut [f32; SECTORS]) {
        out.fill(f32::INFINITY);
        for o in &self.points {
            let k = sector_of(libm::atan2(o.offset.y, o.offset.x));
            out[k] = out[k].min(o.distance_m as f32);
        }
    }
}
