//! The way on the floor plan: A* on the inflated plan, kept away from walls by cost, shortened by line of sight.
//!
//! A cell may be crossed if it is known free floor and its distance d to the nearest wall is at least r, the vehicle's
//! radius plus a margin. Crossing costs its length times `1 + w exp(-3 (d - r))`, so doors are passed in the middle and
//! rooms away from the walls. Obstacles that were seen but are not on the plan can be added for one search.

use crate::fence::{Fence, Zone};
use crate::params::PlannerParams;
use arrayvec::ArrayVec;
use core::cmp::Ordering;
use std::collections::BinaryHeap;
use std::sync::Arc;
use thiserror::Error;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, In, Map, MapAnchor};

/// Most corners of a way.
pub const MAX_CORNERS: usize = 128;
/// Cells of the search are not finer than this, m.
const CELL_MIN_M: f64 = 0.05;
/// A start or goal inside the margin is moved to free floor within this distance, m.
const SNAP_M: f64 = 1.2;
/// A straight shortcut may cost this much more than the way it replaces.
const SHORTCUT_SLACK: f64 = 1.01;
/// Room between hull and seen obstacles below which a place is tight, and below which it is closed, m.
const SEEN_TIGHT_M: f64 = 0.1;
const SEEN_CLOSED_M: f64 = 0.02;
/// Cost per metre of a tight place: a gap that looks too narrow from afar is gone to and looked at, but only when the way
/// round is some metres longer.
const TIGHT_COST: f32 = 15.0;
/// Seen obstacles make a cell dearer this far beyond the margin, m.
const SEEN_SOFT_M: f64 = 0.3;
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

    /// Measures the ways from a place to everywhere the vehicle fits, without margins: some milliseconds on a large plan.
    pub fn measure_from(&mut self, place: In<Map>) {
        self.measured_m.fill(f32::INFINITY);
        self.open.clear();
        let Some(start) = self.grid.index(place) else {
            return;
        };
        let reach_m = self.radius_m as f32;
        self.measured_m[start as usize] = 0.0;
        self.open.push(Node {
            total: 0.0,
            so_far: 0.0,
            cell: start,
        });
        while let Some(node) = self.open.pop() {
            if node.so_far > self.measured_m[node.cell as usize] {
                continue;
            }
            let (c, r) = self.grid.split(node.cell);
            for (dc, dr) in NEIGHBOURS {
                let Some(next) = self.grid.at(c + dc, r + dr) else {
                    continue;
                };
                let i = next as usize;
                if self.clearance_m[i].min(self.room_m[i]) < reach_m {
                    continue;
                }
                let length = if dc != 0 && dr != 0 {
                    core::f32::consts::SQRT_2
                } else {
                    1.0
                };
                let so_far = node.so_far + length * self.grid.cell_m as f32;
                if so_far < self.measured_m[i] {
                    self.measured_m[i] = so_far;
                    self.open.push(Node {
                        total: so_far,
                        so_far,
                        cell: next,
                    });
                }
            }
        }
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

    /// Lays the costs for a margin beyond the radius.
    fn keep_off(&mut self, margin_m: f64) {
        let reach = self.radius_m + margin_m;
        self.reach_m = reach;
        let weight = self.clearance_weight;
        let is_fence_off = self.is_fence_off;
        let distances = self.clearance_m.iter().zip(&self.room_m);
        for (cost, (clearance, room)) in self.cost.iter_mut().zip(distances) {
            let d = f64::from(if is_fence_off {
                *clearance
            } else {
                clearance.min(*room)
            });
            *cost = if d >= reach {
                (1.0 + weight * libm::exp(-3.0 * (d - reach))) as f32
            } else {
                f32::INFINITY
            };
        }
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

    /// The straight line between two places of which one lies within the margin of a wall: whoever flies there, as a sweep along
    /// a wall does, means that line. None if something is nearer to it than the hull needs.
    fn straight(&mut self, from: In<Map>, to: In<Map>, obstacles: &[In<Map>]) -> Option<Path> {
        let keep_m = self.radius_m + SEEN_TIGHT_M - 0.5 * self.grid.cell_m;
        let is_close = |p: In<Map>| self.clearance_m(p).is_some_and(|d| d < self.reach_m);
        if self.is_fence_off || !(is_close(from) || is_close(to)) {
            return None;
        }
        let length = libm::hypot(to.x() - from.x(), to.y() - from.y());
        let steps = libm::ceil(length / (0.5 * self.grid.cell_m)).max(1.0);
        // The vehicle is not quite on the line when it begins.
        let begin_m = 0.25;
        let is_open = (1..=steps as usize).all(|k| {
            let t = k as f64 / steps;
            let p = from + (to - from) * t;
            let clear_m = self.clearance_m(p).unwrap_or(-1.0);
            let is_clear = clear_m >= keep_m || (t * length < begin_m && clear_m >= self.radius_m);
            let far = |o: &In<Map>| libm::hypot(o.x() - p.x(), o.y() - p.y()) > keep_m;
            is_clear && obstacles.iter().all(far)
        });
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

    /// Lays the costs of obstacles: what is closed, what is tight, and beyond that as beside a wall.
    fn lay_seen(&mut self, obstacles: &[In<Map>], from: In<Map>) {
        for i in self.seen_cells.drain(..) {
            (self.seen_cost[i as usize], self.seen_m2[i as usize]) = (0.0, f32::INFINITY);
        }
        let soft_m = self.reach_m + SEEN_SOFT_M;
        let n = libm::ceil(soft_m / self.grid.cell_m) as i64;
        // A vehicle next to an obstacle must be able to leave it.
        let mut nearest_m = f64::INFINITY;
        for o in obstacles {
            nearest_m = nearest_m.min(libm::hypot(o.x() - from.x(), o.y() - from.y()));
            let (c0, r0) = self.grid.column_row(*o);
            for r in r0 - n..=r0 + n {
                for c in c0 - n..=c0 + n {
                    let Some(i) = self.grid.at(c, r) else {
                        continue;
                    };
                    let centre = self.grid.centre(i);
                    let (dx, dy) = (centre.x() - o.x(), centre.y() - o.y());
                    let d2 = (dx * dx + dy * dy) as f32;
                    let nearest = &mut self.seen_m2[i as usize];
                    if d2 < *nearest {
                        if nearest.is_infinite() {
                            self.seen_cells.push(i);
                        }
                        *nearest = d2;
                    }
                }
            }
        }
        let closed_m = (self.radius_m + SEEN_CLOSED_M).min(nearest_m - self.grid.cell_m);
        let tight_m = self.radius_m + SEEN_TIGHT_M;
        for i in &self.seen_cells {
            let d = f64::from(self.seen_m2[*i as usize]).sqrt();
            self.seen_cost[*i as usize] = if d < closed_m {
                f32::INFINITY
            } else if d < tight_m {
                TIGHT_COST
            } else {
                (1.0 + self.clearance_weight * libm::exp(-3.0 * (d - self.reach_m))) as f32
            };
        }
    }

    /// Cost per metre of a cell.
    fn cost_of(&self, i: u32) -> f32 {
        self.cost[i as usize].max(self.seen_cost[i as usize])
    }

    fn passable(&self, i: u32) -> bool {
        self.cost_of(i).is_finite()
    }

    fn search(&mut self, from: In<Map>, to: In<Map>) -> Result<Path, RouteError> {
        let start = self.snapped(from).ok_or(RouteError::OutsidePlan)?;
        let goal = self.snapped(to).ok_or(RouteError::NoWay)?;
        self.search = self.search.wrapping_add(1);
        self.open.clear();
        let (goal_c, goal_r) = self.grid.split(goal);
        let cell_m = self.grid.cell_m as f32;
        let rest = |c: i64, r: i64| {
            let (dc, dr) = ((c - goal_c) as f32, (r - goal_r) as f32);
            (dc * dc + dr * dr).sqrt() * cell_m
        };
        self.reach_cell(start, start, 0.0, 0.0);
        while let Some(node) = self.open.pop() {
            if node.cell == goal {
                return self.shortened(from, start, goal, to);
            }
            if node.so_far > self.best[node.cell as usize] {
                continue;
            }
            let (c, r) = self.grid.split(node.cell);
            for (dc, dr) in NEIGHBOURS {
                let Some(next) = self.grid.at(c + dc, r + dr) else {
                    continue;
                };
                if !self.passable(next) {
                    continue;
                }
                let diagonal = dc != 0 && dr != 0;
                let free = |c: i64, r: i64| self.grid.at(c, r).is_some_and(|i| self.passable(i));
                if diagonal && !(free(c + dc, r) && free(c, r + dr)) {
                    continue;
                }
                let length = if diagonal {
                    core::f32::consts::SQRT_2
                } else {
                    1.0
                } * cell_m;
                let per_m = 0.5 * (self.cost_of(node.cell) + self.cost_of(next));
                let so_far = node.so_far + length * per_m;
                let seen = self.stamp[next as usize] == self.search;
                if !seen || so_far < self.best[next as usize] {
                    self.reach_cell(next, node.cell, so_far, rest(c + dc, r + dr));
                }
            }
        }
        Err(RouteError::NoWay)
    }

    fn reach_cell(&mut self, cell: u32, parent: u32, so_far: f32, rest: f32) {
        let i = cell as usize;
        (self.stamp[i], self.best[i], self.parent[i]) = (self.search, so_far, parent);
        self.open.push(Node {
            total: so_far + rest,
            so_far,
            cell,
        });
    }

    /// True if no wall lies between two points, whatever the margins.
    fn is_open_floor(&self, a: In<Map>, b: In<Map>) -> bool {
        let length = libm::hypot(b.x() - a.x(), b.y() - a.y());
        let steps = libm::ceil(length / (0.5 * self.grid.cell_m)).max(1.0);
        (1..=steps as usize).all(|k| {
            let t = k as f64 / steps;
            self.clearance_m(a + (b - a) * t).is_some()
        })
    }

    /// The nearest cell that may be crossed, not through a wall.
    fn snapped(&self, p: In<Map>) -> Option<u32> {
        let (c0, r0) = self.grid.column_row(p);
        let rings = libm::ceil(SNAP_M / self.grid.cell_m) as i64;
        let mut best: Option<(f64, u32)> = None;
        for ring in 0..=rings {
            for (c, r) in ring_cells(c0, r0, ring) {
                let Some(i) = self.grid.at(c, r).filter(|i| self.passable(*i)) else {
                    continue;
                };
                let centre = self.grid.centre(i);
                let d = libm::hypot(centre.x() - p.x(), centre.y() - p.y());
                if best.is_none_or(|(b, _)| d < b) && self.is_open_floor(p, centre) {
                    best = Some((d, i));
                }
            }
            // A later ring can be nearer only up to the diagonal of this one.
            if best.is_some_and(|(d, _)| d < ring as f64 * self.grid.cell_m) {
                break;
            }
        }
        best.map(|(_, i)| i)
    }

    /// Walks back from the goal, then takes every straight line that does not cost more than the way it replaces.
    fn shortened(
        &mut self,
        from: In<Map>,
        start: u32,
        goal: u32,
        to: In<Map>,
    ) -> Result<Path, RouteError> {
        self.cells.clear();
        self.path_cost.clear();
        let mut at = goal;
        loop {
            self.cells.push(at);
            if at == start {
                break;
            }
            at = self.parent[at as usize];
        }
        self.cells.reverse();
        self.path_cost
            .extend(self.cells.iter().map(|c| f64::from(self.best[*c as usize])));

        let mut path = Path::new();
        path.push(from);
        if self.grid.index(from) != Some(start) {
            path.push(self.grid.centre(start));
        }
        let last = self.cells.len() - 1;
        let mut i = 0;
        while i < last {
            let mut j = i + 1;
            // Farthest by doubling, then by halving: not the optimum, but close to it in a few line checks.
            let mut step = 1;
            while j + step <= last && self.shortcut(i, j + step) {
                j += step;
                step *= 2;
            }
            while step >= 1 {
                if j + step <= last && self.shortcut(i, j + step) {
                    j += step;
                }
                step /= 2;
            }
            i = j;
            if i < last && path.try_push(self.grid.centre(self.cells[i])).is_err() {
                return Err(RouteError::NoWay);
            }
        }
        if self.grid.index(to) != Some(goal) {
            // The goal is inside a margin: its free neighbour comes first.
            path.try_push(self.grid.centre(goal))
                .map_err(|_| RouteError::NoWay)?;
        }
        path.try_push(to.with_z(0.0))
            .map_err(|_| RouteError::NoWay)?;
        Ok(path)
    }

    fn shortcut(&self, i: usize, j: usize) -> bool {
        let along = self.path_cost[j] - self.path_cost[i];
        let straight = self.line_cost(
            self.grid.centre(self.cells[i]),
            self.grid.centre(self.cells[j]),
            f32::INFINITY,
        );
        straight <= along * SHORTCUT_SLACK
    }

    /// Cost of flying straight; infinite if a cell on the line may not be crossed or costs too much.
    fn line_cost(&self, a: In<Map>, b: In<Map>, below: f32) -> f64 {
        let length = libm::hypot(b.x() - a.x(), b.y() - a.y());
        let steps = libm::ceil(length / (0.5 * self.grid.cell_m)).max(1.0);
        let mut sum = 0.0;
        for k in 0..=steps as usize {
            let t = k as f64 / steps;
            let p = In::new(
                a.x() + t * (b.x() - a.x()),
                a.y() + t * (b.y() - a.y()),
                0.0,
            );
            match self.grid.index(p) {
                Some(i) if self.cost_of(i) < below => {
                    let end = if k == 0 || k == steps as usize {
                        0.5
                    } else {
                        1.0
                    };
                    sum += end * f64::from(self.cost_of(i));
                }
                _ => return f64::INFINITY,
            }
        }
        sum * length / steps
    }
}

const NEIGHBOURS: [(i64, i64); 8] = [
    (1, 0),
    (-1, 0),
    (0, 1),
    (0, -1),
    (1, 1),
    (1, -1),
    (-1, 1),
    (-1, -1),
];

/// The cells at Chebyshev distance `ring` from a cell.
fn ring_cells(c0: i64, r0: i64, ring: i64) -> impl Iterator<Item = (i64, i64)> {
    (-ring..=ring).flat_map(move |dr| {
        let step = if dr.abs() == ring {
            1
        } else {
            (2 * ring).max(1)
        };
        (-ring..=ring)
            .step_by(step as usize)
            .map(move |dc| (c0 + dc, r0 + dr))
    })
}

#[derive(Clone, Copy, Debug)]
struct Grid {
    width: usize,
    height: usize,
    cell_m: f64,
    origin: [f64; 2],
}

impl Grid {
    const fn len(&self) -> usize {
        self.width * self.height
    }

    fn column_row(&self, p: In<Map>) -> (i64, i64) {
        (
            libm::floor((p.x() - self.origin[0]) / self.cell_m) as i64,
            libm::floor((p.y() - self.origin[1]) / self.cell_m) as i64,
        )
    }

    fn at(&self, column: i64, row: i64) -> Option<u32> {
        let inside = column >= 0
            && row >= 0
            && (column as usize) < self.width
            && (row as usize) < self.height;
        inside.then(|| (row as usize * self.width + column as usize) as u32)
    }

    fn index(&self, p: In<Map>) -> Option<u32> {
        let (c, r) = self.column_row(p);
        self.at(c, r)
    }

    const fn split(&self, i: u32) -> (i64, i64) {
        let i = i as usize;
        ((i % self.width) as i64, (i / self.width) as i64)
    }

    fn centre(&self, i: u32) -> In<Map> {
        let (c, r) = self.split(i);
        In::new(
            self.origin[0] + (c as f64 + 0.5) * self.cell_m,
            self.origin[1] + (r as f64 + 0.5) * self.cell_m,
            0.0,
        )
    }
}

#[derive(Clone, Copy, Debug)]
struct Node {
    total: f32,
    so_far: f32,
    cell: u32,
}

impl Ord for Node {
    /// Smallest total first; ties by cell, so that a search is the same everywhere.
    fn cmp(&self, o: &Self) -> Ordering {
        o.total
            .total_cmp(&self.total)
            .then_with(|| o.cell.cmp(&self.cell))
    }
}
impl PartialOrd for Node {
    fn partial_cmp(&self, o: &Self) -> Option<Ordering> {
        Some(self.cmp(o))
    }
}
impl PartialEq for Node {
    fn eq(&self, o: &Self) -> bool {
        self.cmp(o) == Ordering::Equal
    }
}
impl Eq for Node {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A plan from letters of 0.3 m: `#` wall, `?` unknown.
    fn plan(picture: &str) -> Arc<FloorPlan> {
        let rows: Vec<&str> = picture
            .lines()
            .map(str::trim)
            .filter(|l| !l.is_empty())
            .collect();
        let mut cells = Vec::new();
        for row in rows.iter().rev() {
            for _ in 0..6 {
                for letter in row.bytes() {
                    let cell = match letter {
                        b'#' => Cell::Occupied,
                        b'?' => Cell::Unknown,
                        _ => Cell::Free,
                    };
                    cells.extend([cell; 6]);
                }
            }
        }
        Arc::new(FloorPlan::from_cells(rows[0].len() * 6, 0.05, [0.0, 0.0], cells).unwrap())
    }

    /// Two rooms with a door of 0.9 m, a closet without one, unknown ground outside.
    const ROOMS: &str = "
        ????????????????????????
        ?#####################??
        ?#........#......#...#??
        ?#........#......#...#??
        ?#........#......#####??
        ?#...................#??
        ?#...................#??
        ?#...................#??
        ?#........#..........#??
        ?#........#..........#??
        ?#####################??";

    fn place(column: f64, row_from_below: f64) -> In<Map> {
        In::new((column + 0.5) * 0.3, (row_from_below + 0.5) * 0.3, 0.0)
    }

    fn router() -> Router {
        Router::new(plan(ROOMS), 0.16, &PlannerParams::default())
    }

    fn length(path: &Path) -> f64 {
        path.windows(2).map(|w| (w[1] - w[0]).norm_xy()).sum()
    }

    #[test]
    fn a_door_of_90_centimetres_is_passed_in_the_middle() {
        let path = router()
            .find(place(3.0, 7.0), place(15.0, 7.0), &[])
            .unwrap();
        // The door is the column of x = 3.0 .. 3.3, open from y = 0.9 to 1.8.
        let at_door = path.windows(2).find_map(|w| {
            let (a, b) = (w[0], w[1]);
            let spans = a.x() <= 3.15 && b.x() >= 3.15 && b.x() > a.x();
            spans.then(|| a.y() + (b.y() - a.y()) * (3.15 - a.x()) / (b.x() - a.x()))
        });
        let y = at_door.unwrap();
        assert!((y - 1.35).abs() < 0.12, "passes at {y}: {path:?}");
        assert!(path.len() < 12, "{} corners", path.len());
    }

    #[test]
    fn each_impossible_place_has_its_reason() {
        let mut r = router();
        let from = place(3.0, 7.0);
        let mut ask = |to: In<Map>| r.find(from, to, &[]);
        assert_eq!(
            ask(place(19.0, 8.0)),
            Err(RouteError::NoWay),
            "the closet has no door"
        );
        assert_eq!(ask(place(23.0, 5.0)), Err(RouteError::OutsidePlan));
        assert_eq!(ask(place(-9.0, 5.0)), Err(RouteError::OutsidePlan));
        assert_eq!(ask(In::new(f64::NAN, 0.0, 0.0)), Err(RouteError::NotFinite));
        assert!(matches!(
            ask(place(1.0, 5.0)),
            Err(RouteError::InWall { .. })
        ));
        let beside = In::new(0.6 + 0.1, 1.5, 0.0);
        assert!(
            matches!(ask(beside), Err(RouteError::InWall { clearance_m, .. }) if clearance_m > 0.05)
        );
    }

    #[test]
    fn a_start_inside_the_margin_is_led_out() {
        let start = In::new(0.6 + 0.08, 1.5, 0.0);
        let path = router().find(start, place(5.0, 4.0), &[]).unwrap();
        assert_eq!(path[0], start);
        let clear = router().clearance_m(path[1]).unwrap();
        assert!(clear >= 0.28 - 1e-6, "{clear}");
    }

    #[test]
    fn an_obstacle_in_the_door_leaves_no_way() {
        let mut r = router();
        let (from, to) = (place(3.0, 7.0), place(15.0, 7.0));
        let plug = [In::new(3.15, 1.2, 0.0), In::new(3.15, 1.5, 0.0)];
        assert_eq!(r.find(from, to, &plug), Err(RouteError::NoWay));
        assert!(
            r.find(from, to, &[]).is_ok(),
            "it is forgotten after the search"
        );
    }

    #[test]
    fn in_an_open_room_the_way_is_nearly_straight() {
        let (a, b) = (place(4.0, 3.0), place(7.0, 6.0));
        let path = router().find(a, b, &[]).unwrap();
        assert!(length(&path) < 1.02 * (b - a).norm_xy(), "{path:?}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn a_way_never_comes_nearer_to_a_wall_than_radius_and_margin(
            a in (2u32..20, 1u32..9), b in (2u32..20, 1u32..9),
        ) {
            let plan = plan(ROOMS);
            let mut r = Router::new(Arc::clone(&plan), 0.16, &PlannerParams::default());
            let (from, to) = (place(f64::from(a.0), f64::from(a.1)), place(f64::from(b.0), f64::from(b.1)));
            prop_assume!(r.clearance_m(from).is_some_and(|d| d > 0.28) && r.clearance_m(to).is_some_and(|d| d > 0.28));
            if let Ok(path) = r.find(from, to, &[]) {
                prop_assert_eq!((path[0], path[path.len() - 1]), (from, to));
                // Measured against the outline of the walls, not the raster the search used.
                let walls = plan.wall_segments();
                for w in path.windows(2) {
                    for k in 0..=20 {
                        let p = w[0] + (w[1] - w[0]) * (f64::from(k) / 20.0);
                        let nearest = walls.iter().map(|s| {
                            let (a, b) = (In::new(s.a[0], s.a[1], 0.0), In::<Map>::new(s.b[0], s.b[1], 0.0));
                            let t = ((p - a).dot(&(b - a)) / (b - a).dot(&(b - a))).clamp(0.0, 1.0);
                            (p - (a + (b - a) * t)).norm_xy()
                        }).fold(f64::INFINITY, f64::min);
                        // Cells are crossed up to their corners.
                        prop_assert!(nearest > 0.28 - 0.05, "{nearest} at {p:?}");
                    }
                }
            }
        }
    }
}
