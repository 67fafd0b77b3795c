//! What a metre costs: walls, borders, and obstacles that were seen.

use super::{Router, SEEN_TIGHT_M, TIGHT_COST};
use vehicle::{In, Map};

const SEEN_CLOSED_M: f64 = 0.02;
/// Seen obstacles make a cell dearer this far beyond the margin, m.
const SEEN_SOFT_M: f64 = 0.3;

impl Router {
    /// Lays the costs for a margin beyond the radius.
    pub(super) fn keep_off(&mut self, margin_m: f64) {
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

    /// Lays the costs of obstacles: what is closed, what is tight, and beyond that as beside a wall.
    pub(super) fn lay_seen(&mut self, obstacles: &[In<Map>], from: In<Map>) {
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
    pub(super) fn cost_of(&self, i: u32) -> f32 {
        self.cost[i as usize].max(self.seen_cost[i as usize])
    }

    pub(super) fn passable(&self, i: u32) -> bool {
        self.cost_of(i).is_finite()
    }

    /// Cost of flying straight; infinite if a cell on the line may not be crossed or costs too much.
    pub(super) fn line_cost(&self, a: In<Map>, b: In<Map>, below: f32) -> f64 {
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
