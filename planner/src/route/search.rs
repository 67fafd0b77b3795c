//! A* over the cells, and the way back from the goal, shortened by line of sight.

use super::grid::{NEIGHBOURS, ring_cells};
use super::{Path, RouteError, Router};
use core::cmp::Ordering;
use vehicle::{In, Map};

/// A start or goal inside the margin is moved to free floor within this distance, m.
const SNAP_M: f64 = 1.2;
/// A straight shortcut may cost this much more than the way it replaces.
const SHORTCUT_SLACK: f64 = 1.01;

#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub(super) total: f32,
    pub(super) so_far: f32,
    pub(super) cell: u32,
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

impl Router {
    pub(super) fn search(&mut self, from: In<Map>, to: In<Map>) -> Result<Path, RouteError> {
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

    pub(super) fn reach_cell(&mut self, cell: u32, parent: u32, so_far: f32, rest: f32) {
        let i = cell as usize;
        (self.stamp[i], self.best[i], self.parent[i]) = (self.search, so_far, parent);
        self.open.push(Node {
            total: so_far + rest,
            so_far,
            cell,
        });
    }

    /// True if no wall lies between two points, whatever the margins.
    pub(super) fn is_open_floor(&self, a: In<Map>, b: In<Map>) -> bool {
        let length = libm::hypot(b.x() - a.x(), b.y() - a.y());
        let steps = libm::ceil(length / (0.5 * self.grid.cell_m)).max(1.0);
        (1..=steps as usize).all(|k| {
            let t = k as f64 / steps;
            self.clearance_m(a + (b - a) * t).is_some()
        })
    }

    /// The nearest cell that may be crossed, not through a wall.
    pub(super) fn snapped(&self, p: In<Map>) -> Option<u32> {
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
    pub(super) fn shortened(
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

    pub(super) fn shortcut(&self, i: usize, j: usize) -> bool {
        let along = self.path_cost[j] - self.path_cost[i];
        let straight = self.line_cost(
            self.grid.centre(self.cells[i]),
            self.grid.centre(self.cells[j]),
            f32::INFINITY,
        );
        straight <= along * SHORTCUT_SLACK
    }
}
