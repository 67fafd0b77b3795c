//! The way on the floor plan: A* on the inflated plan, kept away from walls by cost, shortened by line of sight.
//!
//! A cell may be crossed if it is known free floor and its distance d to the nearest wall is at least r, the vehicle's
//! radius plus a margin. Crossing costs its length times `1 + w exp(-3 (d - r))`, so doors are passed in the middle and
//! rooms away from the walls. Obstacles that were seen but are not on the plan can be added for one search.

mod cost;
mod grid;
mod measure;
mod search;

use crate::fence::{Fence, Zone};
use crate::params::PlannerParams;
use arrayvec::ArrayVec;
use grid::Grid;
use search::Node;
use std::collections::BinaryHeap;
use std::sync::Arc;
use thiserror::Error;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, In, Map, MapAnchor};

/// Most corners of a way.
pub const MAX_CORNERS: usize = 128;
/// Cells of the search are not finer than this, m.
const CELL_MIN_M: f64 = 0.05;
/// Room between hull and seen obstacles below which a place is tight, and below which it is closed, m.
const SEEN_TIGHT_M: f64 = 0.1;
/// Room between hull and walls of the plan that a line drawn along them needs, m.
const DRAWN_TIGHT_M: f64 = 0.05;
/// What is seen may go on for this long unseen, m: a line is not drawn so near to it.
const SEEN_WHOLE_M: f64 = 1.0;
/// Cost per metre of a tight place: a gap that looks too narrow from afar is gone to and looked at, but only when the way
/// round is some metres longer.
const TIGHT_COST: f32 = 15.0;
/// Distances beyond this do not matter for the clearance cost, m.
const CLEARANCE_MAX_M: f64 = 2.0;

/// A way, start and goal included, on the plan.
pub type Path = ArrayVec<In<Map>, MAX_CORNERS>;

/// Why there is no way.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum RouteError {
    /// The coordinates are no numbers.
    #[error("the place has no finite coordinates")]
    NotFinite,
    /// The plan does not know that place.
    #[error("the place is outside the floor plan's free space")]
    OutsidePlan,
    /// Too close to a wall.
    #[error("the place is {clearance_m:.2} m from a wall; the vehicle needs {needed_m:.2} m")]
    InWall {
        /// Distance to the nearest wall, m.
        clearance_m: f64,
        /// Radius of the vehicle, m.
        needed_m: f64,
    },
    /// Outside the fence, in a no-fly zone, or with less room to their border than the vehicle needs.
    #[error("{}", outside(*.room_m))]
    OutsideFence {
        /// Room to the border, m; negative beyond it.
        room_m: f64,
    },
    /// Walls or obstacles in between.
    #[error("no way leads there on the floor plan")]
    NoWay,
}

fn outside(room_m: f64) -> String {
    if room_m < 0.0 {
        "the place is outside the fence or in a no-fly zone".to_owned()
    } else {
        format!("the place is {room_m:.2} m from the border of a fence or no-fly zone")
    }
}

/// Finds ways. All work space is allocated once; a search touches nothing else.
#[derive(Clone, Debug)]
pub struct Router {
    plan: Arc<FloorPlan>,
    grid: Grid,
    radius_m: f64,
    reach_m: f64,
    margin_m: f64,
    clearance_weight: f64,
    /// Costs are laid for half the margin.
    is_narrow: bool,
    /// Per cell: distance to the nearest wall, m; negative where the plan knows no free floor.
    clearance_m: Vec<f32>,
    /// Zones of the plan, on the plan.
    no_fly: Fence,
    /// Per cell: room to the border of the fence or of a no-fly zone, m; negative beyond it, infinite without one.
    room_m: Vec<f32>,
    /// Per cell: length of the way to the place last measured from, m.
    measured_m: Vec<f32>,
    /// The search under way began beyond a border: it may come back.
    is_fence_off: bool,
    /// Per cell: cost per metre; infinite where it may not be crossed.
    cost: Vec<f32>,
    /// Per cell: what the obstacles of the last search make of it, cost per metre; infinite where they block it. Kept until
    /// the next search: the way is followed by what it was found with.
    seen_cost: Vec<f32>,
    /// Squared distance to the nearest of them, m2.
    seen_m2: Vec<f32>,
    seen_cells: Vec<u32>,
    best: Vec<f32>,
    parent: Vec<u32>,
    /// Search in which a cell was last touched: saves clearing the arrays.
    stamp: Vec<u32>,
    search: u32,
    open: BinaryHeap<Node>,
    cells: Vec<u32>,
    path_cost: Vec<f64>,
}

impl Router {
    /// A router for a vehicle of this radius on this plan.
    #[must_use]
    pub fn new(plan: Arc<FloorPlan>, radius_m: f64, params: &PlannerParams) -> Self {
        let coarse = libm::ceil(CELL_MIN_M / plan.resolution_m() - 1e-9).max(1.0) as usize;
        let grid = Grid {
            width: plan.width().div_ceil(coarse),
            height: plan.height().div_ceil(coarse),
            cell_m: plan.resolution_m() * coarse as f64,
            origin: plan.origin(),
        };
        let field = plan.distance_field(CLEARANCE_MAX_M);
        let half_cell = 0.5 * plan.resolution_m();
        let clearance_m: Vec<f32> = (0..grid.len() as u32)
            .map(|i| {
                let p = grid.centre(i);
                if plan.at(p) == Cell::Free {
                    // Centre to centre less half a cell: to the wall's face.
                    (field.at(p) - half_cell) as f32
                } else {
                    -1.0
                }
            })
            .collect();
        let n = grid.len();
        let no_fly = Fence::new(plan.no_fly.iter().map(|z| Zone::keep_out(z)).collect());
        let mut router = Self {
            plan,
            no_fly,
            room_m: vec![f32::INFINITY; n],
            measured_m: vec![f32::INFINITY; n],
            is_fence_off: false,
            grid,
            radius_m,
            reach_m: 0.0,
            margin_m: 0.0,
            clearance_weight: 0.0,
            is_narrow: false,
            cost: vec![f32::INFINITY; n],
            clearance_m,
            seen_cost: vec![0.0; n],
            seen_m2: vec![f32::INFINITY; n],
            seen_cells: Vec::with_capacity(n),
            best: vec![0.0; n],
            parent: vec![0; n],
            stamp: vec![0; n],
            search: 0,
            open: BinaryHeap::with_capacity(4 * n),
            cells: Vec::with_capacity(n),
            path_cost: Vec::with_capacity(n),
        };
        router.set_fence(&Fence::default(), &MapAnchor::new(0.0, 0.0, 0.0));
        router.set_params(params);
        router
    }

    /// Takes over a fence in NED about home; `anchor` tells how the plan lies there. The plan's own no-fly zones stay.
    pub fn set_fence(&mut self, fence: &Fence, anchor: &MapAnchor) {
        let is_free = fence.is_empty() && self.no_fly.is_empty();
        for (room, i) in self.room_m.iter_mut().zip(0..) {
            *room = if is_free {
                f32::INFINITY
            } else {
                let p = self.grid.centre(i);
                let ned = anchor.to_ned(p);
                let drawn = fence.room_m([ned.x(), ned.y()]);
                drawn.min(self.no_fly.room_m([p.x(), p.y()])) as f32
            };
        }
        self.keep_off(self.margin_m);
        self.is_narrow = false;
    }

    /// Length of the way from the place last measured from, m; none where none leads.
    #[must_use]
    pub fn measured_m(&self, p: In<Map>) -> Option<f64> {
        let m = self.measured_m[self.grid.index(p)? as usize];
        m.is_finite().then_some(f64::from(m))
    }

    /// Room to the border of the fence or of a no-fly zone, m; infinite without one, negative beyond it.
    #[must_use]
    pub fn room_m(&self, p: In<Map>) -> f64 {
        self.grid
            .index(p)
            .map_or(f64::INFINITY, |i| f64::from(self.room_m[i as usize]))
    }

    /// Takes over margin and clearance weight.
    pub fn set_params(&mut self, params: &PlannerParams) {
        (self.margin_m, self.clearance_weight) = (params.margin_m, params.clearance_weight);
        self.keep_off(self.margin_m);
    }

    /// Distance from a point to the nearest wall's face or border, m; none where the plan knows no free floor.
    #[must_use]
    pub fn clearance_m(&self, p: In<Map>) -> Option<f64> {
        let i = self.grid.index(p)? as usize;
        let d = self.clearance_m[i];
        (d >= 0.0).then(|| f64::from(d.min(self.room_m[i]).max(0.0)))
    }

    /// Whether the vehicle can be at a place at all.
    ///
    /// # Errors
    /// [`RouteError`] says why not.
    pub fn check_place(&self, p: In<Map>) -> Result<(), RouteError> {
        if !p.is_finite() {
            return Err(RouteError::NotFinite);
        }
        let room_m = self.room_m(p);
        if room_m < self.radius_m {
            return Err(RouteError::OutsideFence { room_m });
        }
        match self.clearance_m(p) {
            None => match self.plan.at(p) {
                Cell::Occupied => Err(RouteError::InWall {
                    clearance_m: 0.0,
                    needed_m: self.radius_m,
                }),
                Cell::Free | Cell::Unknown => Err(RouteError::OutsidePlan),
            },
            Some(clearance_m) if clearance_m < self.radius_m => Err(RouteError::InWall {
                clearance_m,
                needed_m: self.radius_m,
            }),
            Some(_) => Ok(()),
        }
    }

    /// True if the vehicle can fly straight from one point to another within the route's margins.
    #[must_use]
    pub fn sees(&self, a: In<Map>, b: In<Map>) -> bool {
        self.line_cost(a, b, TIGHT_COST).is_finite()
    }

    /// The way from a place to another, around walls and around `obstacles` (points seen but not on the plan).
    ///
    /// A start inside a margin is led out of it by the shortest way; a goal inside a margin, but not in a wall, is the last
    /// point of the way. Where the full margin leaves no way (a narrow door), half of it is tried.
    ///
    /// # Errors
    /// [`RouteError`] says why there is none.
    pub fn find(
        &mut self,
        from: In<Map>,
        to: In<Map>,
        obstacles: &[In<Map>],
    ) -> Result<Path, RouteError> {
        if !from.is_finite() {
            return Err(RouteError::NotFinite);
        }
        self.check_place(to)?;
        // Whoever is beyond a border may come back over it.
        let is_beyond = self.room_m(from) < 0.0;
        if self.is_narrow || is_beyond != self.is_fence_off {
            self.is_fence_off = is_beyond;
            self.keep_off(self.margin_m);
            self.is_narrow = false;
        }
        if let Some(path) = self.straight(from, to, obstacles) {
            return Ok(path);
        }
        let found = self.find_around(from, to, obstacles);
        self.is_narrow = matches!(found, Err(RouteError::NoWay));
        if !self.is_narrow {
            return found;
        }
        // The narrow costs stay until the next search: the way is followed by what it was found with.
        self.keep_off(0.5 * self.margin_m);
        self.find_around(from, to, obstacles)
    }

    /// The straight line between two places, if it keeps the whole margin: whoever draws a line through free floor means that line,
    /// and not the middle of the room. Of two places of which one lies within the margin of a wall the hull's need is enough: whoever
    /// flies there, as a sweep along a wall does, means that line too. None if something is nearer to it.
    fn straight(&mut self, from: In<Map>, to: In<Map>, obstacles: &[In<Map>]) -> Option<Path> {
        let is_close = |p: In<Map>| self.clearance_m(p).is_some_and(|d| d < self.reach_m);
        let (keep_m, keep_seen_m) = if is_close(from) || is_close(to) {
            let half_cell_m = 0.5 * self.grid.cell_m;
            (
                self.radius_m + DRAWN_TIGHT_M - half_cell_m,
                self.radius_m + SEEN_TIGHT_M - half_cell_m,
            )
        } else {
            (self.reach_m, self.reach_m + SEEN_WHOLE_M)
        };
        let length = libm::hypot(to.x() - from.x(), to.y() - from.y());
        let steps = libm::ceil(length / (0.5 * self.grid.cell_m)).max(1.0);
        // The vehicle is not quite on the line when it begins.
        let begin_m = 0.25;
        let is_clear = |k: usize| {
            let t = k as f64 / steps;
            let clear_m = self.clearance_m(from + (to - from) * t).unwrap_or(-1.0);
            clear_m >= keep_m || (t * length < begin_m && clear_m >= self.radius_m)
        };
        let is_open = !self.is_fence_off
            && (1..=steps as usize).all(is_clear)
            && obstacles
                .iter()
                .all(|o| beside_m(from, to, *o) > keep_seen_m);
        is_open.then(|| {
            self.lay_seen(obstacles, from);
            let mut path = Path::new();
            path.extend([from, to.with_z(0.0)]);
            path
        })
    }

    fn find_around(
        &mut self,
        from: In<Map>,
        to: In<Map>,
        obstacles: &[In<Map>],
    ) -> Result<Path, RouteError> {
        self.lay_seen(obstacles, from);
        self.search(from, to)
    }
}

/// Distance of a point from a segment, level, m.
fn beside_m(a: In<Map>, b: In<Map>, p: In<Map>) -> f64 {
    let (way, off) = (b - a, p - a);
    let length2 = way.x() * way.x() + way.y() * way.y();
    let along = off.x() * way.x() + off.y() * way.y();
    let t = if length2 > 1e-12 {
        (along / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    libm::hypot(off.x() - t * way.x(), off.y() - t * way.y())
}

#[cfg(test)]
mod tests;
