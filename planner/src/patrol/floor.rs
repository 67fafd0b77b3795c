//! The floor as a grid: where the vehicle fits, what can be swept from there, and ways between places.

use super::PatrolError;
use crate::fence::Zone;
use core::cmp::Reverse;
use std::collections::BinaryHeap;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, In, Map};

/// Distances to walls beyond this do not matter, m.
const CLEARANCE_MAX_M: f64 = 1.0;
/// What a metre too near to a wall costs more than one in the open.
const NARROW_COST: f64 = 1.5;

/// Ways to the eight neighbours: column, row, length in cells.
const NEIGHBOURS: [(i64, i64, f64); 8] = [
    (1, 0, 1.0),
    (-1, 0, 1.0),
    (0, 1, 1.0),
    (0, -1, 1.0),
    (1, 1, core::f64::consts::SQRT_2),
    (1, -1, core::f64::consts::SQRT_2),
    (-1, 1, core::f64::consts::SQRT_2),
    (-1, -1, core::f64::consts::SQRT_2),
];

/// A cell by its index: row times width plus column.
pub type CellIndex = u32;

/// Share of the margin that is kept where a corner of a room is looked into.
const SPUR: f64 = 0.5;

/// The plan as the patrol sees it.
#[derive(Clone, Debug)]
pub struct Floor {
    width: usize,
    height: usize,
    cell_m: f64,
    origin: [f64; 2],
    /// Distance to the nearest wall's face, m; negative where the vehicle's centre may not be.
    clearance_m: Vec<f32>,
    is_free: Vec<bool>,
    /// The centre fits here and a way leads here from the start.
    fits: Vec<bool>,
    /// It fits with the margin too.
    is_roomy: Vec<bool>,
    /// It fits with the margin, or into a corner of a room with some of it, or there is no room for the margin nearby: the middle of a
    /// narrow passage.
    is_lane: Vec<bool>,
    start: CellIndex,
    /// Cells of a disc of half a swath, each with the cells between it and the centre.
    disc: Vec<Ray>,
}

#[derive(Clone, Debug)]
struct Ray {
    to: (i64, i64),
    between: Vec<(i64, i64)>,
}

impl Floor {
    /// The floor that a vehicle of `radius_m` reaches from `start`, with `margin_m` more to be kept from walls where there is
    /// room; `reach_m` is how far it sweeps to each side. Zones of the plan are not entered.
    ///
    /// # Errors
    /// [`PatrolError`] if it fits nowhere or not at the start.
    pub fn new(
        plan: &FloorPlan,
        start: In<Map>,
        radius_m: f64,
        margin_m: f64,
        reach_m: f64,
    ) -> Result<Self, PatrolError> {
        let field = plan.distance_field(CLEARANCE_MAX_M);
        let half_cell = 0.5 * plan.resolution_m();
        let zones: Vec<Zone> = plan.no_fly.iter().map(|z| Zone::keep_out(z)).collect();
        let n = plan.width() * plan.height();
        let mut floor = Self {
            width: plan.width(),
            height: plan.height(),
            cell_m: plan.resolution_m(),
            origin: plan.origin(),
            clearance_m: vec![-1.0; n],
            is_free: plan.cells().iter().map(|c| *c == Cell::Free).collect(),
            fits: vec![false; n],
            is_roomy: vec![false; n],
            is_lane: vec![false; n],
            start: 0,
            disc: Vec::new(),
        };
        for i in 0..n {
            if !floor.is_free[i] {
                continue;
            }
            let p = floor.centre(i as u32);
            let mut clearance = field.at(p) - half_cell;
            for zone in &zones {
                clearance = clearance.min(zone.room_m([p.x(), p.y()]));
            }
            floor.clearance_m[i] = clearance.max(-1.0) as f32;
        }
        let fits = |floor: &Self, i: usize| f64::from(floor.clearance_m[i]) >= radius_m;
        if !(0..n).any(|i| fits(&floor, i)) {
            return Err(PatrolError::NoFreeCell { radius_m });
        }
        let lost = PatrolError::Start {
            x_m: start.x(),
            y_m: start.y(),
        };
        let Some(at) = floor.index(start).filter(|i| fits(&floor, *i as usize)) else {
            return Err(lost);
        };
        floor.start = at;
        let mut stack = vec![at];
        floor.fits[at as usize] = true;
        while let Some(i) = stack.pop() {
            let (c, r) = floor.split(i);
            for (dc, dr, _) in &NEIGHBOURS[..4] {
                if let Some(next) = floor.at(c + dc, r + dr)
                    && !floor.fits[next as usize]
                    && fits(&floor, next as usize)
                {
                    floor.fits[next as usize] = true;
                    stack.push(next);
                }
            }
        }
        for i in 0..n {
            floor.is_roomy[i] =
                floor.fits[i] && f64::from(floor.clearance_m[i]) >= radius_m + margin_m;
        }
        let near = (2.0 * margin_m / floor.cell_m) as i64;
        for i in 0..n {
            let (c, r) = floor.split(i as u32);
            let mut around = (-near..=near).flat_map(|dr| (-near..=near).map(move |dc| (dc, dr)));
            let is_room_near = around.any(|(dc, dr)| {
                let cell = floor.at(c + dc, r + dr);
                cell.is_some_and(|j| floor.is_roomy[j as usize])
            });
            let is_spur = f64::from(floor.clearance_m[i]) >= radius_m + SPUR * margin_m;
            floor.is_lane[i] = floor.is_roomy[i] || floor.fits[i] && (is_spur || !is_room_near);
        }
        floor.disc = disc(reach_m / floor.cell_m);
        Ok(floor)
    }

    /// Cells.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.width * self.height
    }

    /// A floor always has a cell.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Side of a cell, m.
    #[must_use]
    pub const fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Where the vehicle starts.
    #[must_use]
    pub const fn start(&self) -> CellIndex {
        self.start
    }

    /// The vehicle fits and gets there.
    #[must_use]
    pub fn fits(&self, i: CellIndex) -> bool {
        self.fits[i as usize]
    }

    /// It fits with the margin.
    #[must_use]
    pub fn is_roomy(&self, i: CellIndex) -> bool {
        self.is_roomy[i as usize]
    }

    /// A lane may lead here: it fits with the margin, into a corner with a part of it, or there is no room for the margin nearby.
    #[must_use]
    pub fn is_lane(&self, i: CellIndex) -> bool {
        self.is_lane[i as usize]
    }

    /// Distance to the nearest wall, m; negative where its centre may not be.
    #[must_use]
    pub fn clearance_m(&self, i: CellIndex) -> f64 {
        f64::from(self.clearance_m[i as usize])
    }

    /// The cell at a column and row.
    #[must_use]
    pub fn at(&self, column: i64, row: i64) -> Option<CellIndex> {
        let inside = column >= 0
            && row >= 0
            && (column as usize) < self.width
            && (row as usize) < self.height;
        inside.then(|| (row as usize * self.width + column as usize) as u32)
    }

    /// Column and row.
    #[must_use]
    pub const fn split(&self, i: CellIndex) -> (i64, i64) {
        let i = i as usize;
        ((i % self.width) as i64, (i / self.width) as i64)
    }

    /// Columns and rows.
    #[must_use]
    pub const fn size(&self) -> (i64, i64) {
        (self.width as i64, self.height as i64)
    }

    /// The cell at a point.
    #[must_use]
    pub fn index(&self, p: In<Map>) -> Option<CellIndex> {
        if !p.is_finite() {
            return None;
        }
        self.at(
            libm::floor((p.x() - self.origin[0]) / self.cell_m) as i64,
            libm::floor((p.y() - self.origin[1]) / self.cell_m) as i64,
        )
    }

    /// Its centre.
    #[must_use]
    pub fn centre(&self, i: CellIndex) -> In<Map> {
        let (c, r) = self.split(i);
        In::new(
            self.origin[0] + (c as f64 + 0.5) * self.cell_m,
            self.origin[1] + (r as f64 + 0.5) * self.cell_m,
            0.0,
        )
    }

    /// The nearest cell where the vehicle fits, within a distance; walls in between are not minded.
    #[must_use]
    pub fn nearest_fit(&self, p: In<Map>, within_m: f64) -> Option<CellIndex> {
        let (c0, r0) = self.split(self.index(p)?);
        let n = libm::ceil(within_m / self.cell_m) as i64;
        let mut best: Option<(i64, CellIndex)> = None;
        for dr in -n..=n {
            for dc in -n..=n {
                let d = dr * dr + dc * dc;
                if d <= n * n
                    && let Some(i) = self.at(c0 + dc, r0 + dr)
                    && self.fits(i)
                    && best.is_none_or(|(b, _)| d < b)
                {
                    best = Some((d, i));
                }
            }
        }
        best.map(|(_, i)| i)
    }

    /// Calls `see` with every free cell that is swept from here: within reach and not behind a wall.
    pub fn swept_from(&self, i: CellIndex, mut see: impl FnMut(CellIndex)) {
        let (c, r) = self.split(i);
        let free = |dc: i64, dr: i64| {
            self.at(c + dc, r + dr)
                .filter(|j| self.is_free[*j as usize])
        };
        for ray in &self.disc {
            if let Some(j) = free(ray.to.0, ray.to.1)
                && ray.between.iter().all(|(dc, dr)| free(*dc, *dr).is_some())
            {
                see(j);
            }
        }
    }

    /// Everything that can be swept at all: the free floor within reach of a place where the vehicle fits.
    #[must_use]
    pub fn sweepable(&self) -> Vec<bool> {
        let mut out = vec![false; self.len()];
        for i in 0..self.len() as u32 {
            if self.fits(i) {
                self.swept_from(i, |j| out[j as usize] = true);
            }
        }
        out
    }

    /// Calls `visit` with the cells on a straight line, both ends included.
    pub fn line(&self, a: CellIndex, b: CellIndex, mut visit: impl FnMut(CellIndex)) {
        let ((c0, r0), (c1, r1)) = (self.split(a), self.split(b));
        let n = (2 * (c1 - c0).abs().max((r1 - r0).abs())).max(1);
        let mut last = None;
        for k in 0..=n {
            let t = k as f64 / n as f64;
            let c = libm::round(c0 as f64 + t * (c1 - c0) as f64) as i64;
            let r = libm::round(r0 as f64 + t * (r1 - r0) as f64) as i64;
            let at = self.at(c, r);
            if at != last
                && let Some(i) = at
            {
                visit(i);
            }
            last = at;
        }
    }

    /// True if the vehicle can fly straight, with at least this clearance all the way.
    #[must_use]
    pub fn is_straight(&self, a: CellIndex, b: CellIndex, clearance_m: f64) -> bool {
        let mut open = true;
        self.line(a, b, |i| {
            open &= self.fits(i) && self.clearance_m(i) >= clearance_m;
        });
        open
    }

    /// Shortest distances from a cell to all others the vehicle gets to, m, until `enough` says so (it sees each cell once,
    /// nearest first).
    pub fn spread(
        &self,
        from: CellIndex,
        reach: &mut Reach,
        mut enough: impl FnMut(CellIndex, f64) -> bool,
    ) {
        reach.begin(self.len());
        reach.touch(from, 0.0, from);
        while let Some(Reverse((key, i))) = reach.open.pop() {
            let so_far = f64::from(f32::from_bits(key));
            if so_far > f64::from(reach.cost[i as usize]) {
                continue;
            }
            if enough(i, so_far) {
                return;
            }
            let (c, r) = self.split(i);
            for (dc, dr, length) in NEIGHBOURS {
                let Some(next) = self.at(c + dc, r + dr).filter(|j| self.fits(*j)) else {
                    continue;
                };
                if dc != 0 && dr != 0 {
                    let open = |c, r| self.at(c, r).is_some_and(|j| self.fits(j));
                    if !(open(c + dc, r) && open(c, r + dr)) {
                        continue;
                    }
                }
                let dear = if self.is_roomy(next) {
                    1.0
                } else {
                    NARROW_COST
                };
                reach.touch(next, so_far + length * self.cell_m * dear, i);
            }
        }
    }

    /// The way between two cells, corners only, both ends included; none if there is none.
    #[must_use]
    pub fn way(&self, from: CellIndex, to: CellIndex, reach: &mut Reach) -> Option<Vec<CellIndex>> {
        let mut found = false;
        self.spread(from, reach, |i, _| {
            found = i == to;
            found
        });
        found.then(|| self.pulled(&reach.path(to)))
    }

    /// Straightens a way of cells: each corner goes as far as it is straight without coming nearer to walls than the way did.
    fn pulled(&self, cells: &[CellIndex]) -> Vec<CellIndex> {
        let mut out = vec![cells[0]];
        let mut i = 0;
        while i + 1 < cells.len() {
            let mut best = i + 1;
            let mut least_m = self
                .clearance_m(cells[i])
                .min(self.clearance_m(cells[i + 1]));
            for (j, cell) in cells.iter().enumerate().skip(i + 2) {
                least_m = least_m.min(self.clearance_m(*cell));
                let keep_m = if self.is_roomy(cells[i]) && self.is_roomy(*cell) {
                    least_m.min(CLEARANCE_MAX_M)
                } else {
                    least_m
                };
                if self.is_straight(cells[i], *cell, keep_m.min(0.4)) {
                    best = j;
                }
                if j > i + 400 {
                    break;
                }
            }
            out.push(cells[best]);
            i = best;
        }
        out
    }
}

/// Work space of [`Floor::spread`].
#[derive(Clone, Debug, Default)]
pub struct Reach {
    cost: Vec<f32>,
    parent: Vec<CellIndex>,
    touched: Vec<CellIndex>,
    open: BinaryHeap<Reverse<(u32, CellIndex)>>,
}

impl Reach {
    fn begin(&mut self, cells: usize) {
        if self.cost.len() == cells {
            for i in self.touched.drain(..) {
                self.cost[i as usize] = f32::INFINITY;
            }
        } else {
            self.cost = vec![f32::INFINITY; cells];
            self.parent = vec![0; cells];
            self.touched.clear();
        }
        self.open.clear();
    }

    fn touch(&mut self, i: CellIndex, cost: f64, parent: CellIndex) {
        let cost = cost as f32;
        let best = &mut self.cost[i as usize];
        if cost < *best {
            if best.is_infinite() {
                self.touched.push(i);
            }
            *best = cost;
            self.parent[i as usize] = parent;
            // Positive floats order as their bits do.
            self.open.push(Reverse((cost.to_bits(), i)));
        }
    }

    /// Cost of the way to a cell in the last search, m; infinite if it was not reached.
    #[must_use]
    pub fn cost_m(&self, i: CellIndex) -> f64 {
        f64::from(self.cost[i as usize])
    }

    /// Cells from the start of the last search to one it reached.
    #[must_use]
    pub fn path(&self, to: CellIndex) -> Vec<CellIndex> {
        let mut out = vec![to];
        let mut at = to;
        while self.parent[at as usize] != at {
            at = self.parent[at as usize];
            out.push(at);
        }
        out.reverse();
        out
    }
}

/// Cells within a radius (in cells), each with those on the line to it.
fn disc(radius: f64) -> Vec<Ray> {
    let n = libm::floor(radius + 1e-9) as i64;
    let mut out = Vec::new();
    for dr in -n..=n {
        for dc in -n..=n {
            if ((dc * dc + dr * dr) as f64) > radius * radius + 1e-9 {
                continue;
            }
            let steps = 2 * dc.abs().max(dr.abs());
            let mut between: Vec<(i64, i64)> = (1..steps)
                .map(|k| {
                    let t = k as f64 / steps as f64;
                    (
                        libm::round(t * dc as f64) as i64,
                        libm::round(t * dr as f64) as i64,
                    )
                })
                .filter(|p| *p != (0, 0) && *p != (dc, dr))
                .collect();
            between.dedup();
            out.push(Ray {
                to: (dc, dr),
                between,
            });
        }
    }
    out
}
