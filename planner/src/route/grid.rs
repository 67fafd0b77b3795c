//! Cells of the search: a raster on the plan, not finer than its walls are known.

use vehicle::{In, Map};

pub(super) const NEIGHBOURS: [(i64, i64); 8] = [
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
pub(super) fn ring_cells(c0: i64, r0: i64, ring: i64) -> impl Iterator<Item = (i64, i64)> {
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
pub(super) struct Grid {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) cell_m: f64,
    pub(super) origin: [f64; 2],
}

impl Grid {
    pub(super) const fn len(&self) -> usize {
        self.width * self.height
    }

    pub(super) fn column_row(&self, p: In<Map>) -> (i64, i64) {
        (
            libm::floor((p.x() - self.origin[0]) / self.cell_m) as i64,
            libm::floor((p.y() - self.origin[1]) / self.cell_m) as i64,
        )
    }

    pub(super) fn at(&self, column: i64, row: i64) -> Option<u32> {
        let inside = column >= 0
            && row >= 0
            && (column as usize) < self.width
            && (row as usize) < self.height;
        inside.then(|| (row as usize * self.width + column as usize) as u32)
    }

    pub(super) fn index(&self, p: In<Map>) -> Option<u32> {
        let (c, r) = self.column_row(p);
        self.at(c, r)
    }

    pub(super) const fn split(&self, i: u32) -> (i64, i64) {
        let i = i as usize;
        ((i % self.width) as i64, (i / self.width) as i64)
    }

    pub(super) fn centre(&self, i: u32) -> In<Map> {
        let (c, r) = self.split(i);
        In::new(
            self.origin[0] + (c as f64 + 0.5) * self.cell_m,
            self.origin[1] + (r as f64 + 0.5) * self.cell_m,
            0.0,
        )
    }
}
