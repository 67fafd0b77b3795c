//! How far it is from one place to everywhere: for the way home and the battery.

use super::Router;
use super::grid::NEIGHBOURS;
use super::search::Node;
use vehicle::{In, Map};

impl Router {
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
}
