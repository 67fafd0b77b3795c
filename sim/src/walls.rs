//! Fixed walls and furniture as segments, with a uniform grid so that a ray or a collision test looks at few of them.

use crate::geometry::{self, Point};
use vehicle::Segment;

/// Side of a grid cell, m: a few walls per cell in furnished rooms.
const CELL_M: f64 = 0.5;
/// Cells of the grid at most; larger plans get larger cells.
const MAX_CELLS: f64 = 250_000.0;

/// Segments with the grid over them.
#[derive(Clone, Debug)]
pub(crate) struct Walls {
    segments: Vec<Segment>,
    origin: Point,
    cell_m: f64,
    columns: usize,
    rows: usize,
    /// `members[starts[c]..starts[c + 1]]` are the segments that touch cell `c`.
    starts: Vec<u32>,
    members: Vec<u32>,
}

/// Where a ray ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WallHit {
    /// Along the ray, m.
    pub(crate) distance_m: f64,
    /// Index of the segment.
    pub(crate) segment: u32,
}

impl Walls {
    pub(crate) fn new(segments: Vec<Segment>) -> Self {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for p in segments.iter().flat_map(|s| [s.a, s.b]) {
            for axis in 0..2 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        if segments.is_empty() {
            (low, high) = ([0.0; 2], [0.0; 2]);
        }
        // A small odd margin keeps walls off the cell borders.
        let origin = [low[0] - 0.013, low[1] - 0.013];
        let (w, h) = (high[0] - origin[0] + 0.01, high[1] - origin[1] + 0.01);
        let cell_m = CELL_M.max(libm::sqrt(w * h / MAX_CELLS));
        let columns = libm::ceil(w / cell_m).max(1.0) as usize;
        let rows = libm::ceil(h / cell_m).max(1.0) as usize;
        let mut walls = Self {
            segments,
            origin,
            cell_m,
            columns,
            rows,
            starts: Vec::new(),
            members: Vec::new(),
        };
        walls.sort_into_cells();
        walls
    }

    /// These and more.
    pub(crate) fn with(&self, more: &[Segment]) -> Self {
        Self::new(self.segments.iter().chain(more).copied().collect())
    }

    fn sort_into_cells(&mut self) {
        let mut cells = vec![Vec::new(); self.columns * self.rows];
        let reach_m = self.cell_m * 0.708;
        for (i, s) in (0u32..).zip(&self.segments) {
            let (c0, r0) = self.cell_of([s.a[0].min(s.b[0]), s.a[1].min(s.b[1])]);
            let (c1, r1) = self.cell_of([s.a[0].max(s.b[0]), s.a[1].max(s.b[1])]);
            for row in r0..=r1 {
                for column in c0..=c1 {
                    let centre = [
                        self.origin[0] + (column as f64 + 0.5) * self.cell_m,
                        self.origin[1] + (row as f64 + 0.5) * self.cell_m,
                    ];
                    let nearest = geometry::nearest_on_segment(centre, s);
                    if geometry::distance(centre, nearest) <= reach_m {
                        cells[row * self.columns + column].push(i);
                    }
                }
            }
        }
        self.starts = Vec::with_capacity(cells.len() + 1);
        self.starts.push(0);
        for cell in &cells {
            self.members.extend_from_slice(cell);
            self.starts.push(self.members.len() as u32);
        }
    }

    pub(crate) fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// The cell of a point, the nearest one for a point outside.
    fn cell_of(&self, p: Point) -> (usize, usize) {
        let index = |axis: usize, n: usize| {
            let i = libm::floor((p[axis] - self.origin[axis]) / self.cell_m);
            i.clamp(0.0, (n - 1) as f64) as usize
        };
        (index(0, self.columns), index(1, self.rows))
    }

    fn members(&self, column: usize, row: usize) -> &[u32] {
        let cell = row * self.columns + column;
        &self.members[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// First wall along a ray of unit direction, at most `max_m` away.
    pub(crate) fn cast(&self, origin: Point, direction: Point, max_m: f64) -> Option<WallHit> {
        let (enter_m, leave_m) = self.clip(origin, direction)?;
        if enter_m > max_m {
            return None;
        }
        let start = [
            origin[0] + direction[0] * enter_m,
            origin[1] + direction[1] * enter_m,
        ];
        let (mut column, mut row) = self.cell_of(start);
        // Amanatides and Woo 1987: step from cell to cell along the ray.
        let mut next_m = [f64::INFINITY; 2];
        let mut step_m = [f64::INFINITY; 2];
        for (axis, cell) in [column, row].into_iter().enumerate() {
            if direction[axis] != 0.0 {
                let ahead = cell as f64 + if direction[axis] > 0.0 { 1.0 } else { 0.0 };
                let border = self.origin[axis] + ahead * self.cell_m;
                next_m[axis] = (border - origin[axis]) / direction[axis];
                step_m[axis] = (self.cell_m / direction[axis]).abs();
            }
        }
        let limit_m = leave_m.min(max_m);
        let mut best: Option<WallHit> = None;
        loop {
            for &i in self.members(column, row) {
                let hit = geometry::ray_segment(origin, direction, &self.segments[i as usize]);
                if let Some(distance_m) = hit
                    && distance_m <= best.map_or(max_m, |b| b.distance_m)
                {
                    best = Some(WallHit {
                        distance_m,
                        segment: i,
                    });
                }
            }
            let axis = usize::from(next_m[1] < next_m[0]);
            let border_m = next_m[axis];
            if best.is_some_and(|b| b.distance_m <= border_m) || border_m > limit_m {
                return best;
            }
            next_m[axis] += step_m[axis];
            let (index, n) = if axis == 0 {
                (&mut column, self.columns)
            } else {
                (&mut row, self.rows)
            };
            if direction[axis] > 0.0 {
                *index += 1;
                if *index == n {
                    return best;
                }
            } else if *index == 0 {
                return best;
            } else {
                *index -= 1;
            }
        }
    }

    /// Where a ray enters and leaves the grid, m.
    fn clip(&self, origin: Point, direction: Point) -> Option<(f64, f64)> {
        let size = [
            self.columns as f64 * self.cell_m,
            self.rows as f64 * self.cell_m,
        ];
        let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
        for axis in 0..2 {
            let (low, high) = (self.origin[axis], self.origin[axis] + size[axis]);
            if direction[axis] == 0.0 {
                if !(low..=high).contains(&origin[axis]) {
                    return None;
                }
            } else {
                let a = (low - origin[axis]) / direction[axis];
                let b = (high - origin[axis]) / direction[axis];
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
        }
        (enter <= leave).then_some((enter, leave))
    }

    /// The nearest point of any wall within `reach_m` of `p`, with its distance.
    pub(crate) fn nearest(&self, p: Point, reach_m: f64) -> Option<(f64, Point)> {
        let (c0, r0) = self.cell_of([p[0] - reach_m, p[1] - reach_m]);
        let (c1, r1) = self.cell_of([p[0] + reach_m, p[1] + reach_m]);
        let mut best: Option<(f64, Point)> = None;
        for row in r0..=r1 {
            for column in c0..=c1 {
                for &i in self.members(column, row) {
                    let q = geometry::nearest_on_segment(p, &self.segments[i as usize]);
                    let d = geometry::distance(p, q);
                    if d <= best.map_or(reach_m, |b| b.0) {
                        best = Some((d, q));
                    }
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn scattered() -> Walls {
        let mut segments = Vec::new();
        for i in 0..60_u32 {
            let (x, y) = (
                f64::from(i * 7 % 53) * 0.21,
                f64::from(i * 11 % 47) * 0.17 - 3.0,
            );
            let (dx, dy) = (
                f64::from(i % 5) * 0.6 - 1.2,
                f64::from(i % 7) * 0.45 - 1.35 + 0.01,
            );
            segments.push(Segment {
                a: [x, y],
                b: [x + dx, y + dy],
            });
        }
        Walls::new(segments)
    }

    #[test]
    fn no_walls_stop_no_ray() {
        assert_eq!(
            Walls::new(Vec::new()).cast([0.0, 0.0], [1.0, 0.0], 10.0),
            None
        );
    }

    proptest! {
        #[test]
        fn the_grid_finds_what_trying_every_wall_finds(x in -2.0..14.0f64, y in -6.0..8.0f64, angle in 0.0..6.3f64) {
            let walls = scattered();
            let direction = [libm::cos(angle), libm::sin(angle)];
            let slow = walls
                .segments()
                .iter()
                .filter_map(|s| geometry::ray_segment([x, y], direction, s))
                .filter(|d| *d <= 5.0)
                .min_by(f64::total_cmp);
            let fast = walls.cast([x, y], direction, 5.0).map(|h| h.distance_m);
            prop_assert_eq!(slow.is_some(), fast.is_some());
            if let (Some(a), Some(b)) = (slow, fast) {
                prop_assert!((a - b).abs() < 1e-9);
            }
        }

        #[test]
        fn the_nearest_wall_is_the_nearest_of_all(x in -2.0..14.0f64, y in -6.0..8.0f64) {
            let walls = scattered();
            let slow = walls
                .segments()
                .iter()
                .map(|s| geometry::distance([x, y], geometry::nearest_on_segment([x, y], s)))
                .filter(|d| *d <= 0.8)
                .min_by(f64::total_cmp);
            let fast = walls.nearest([x, y], 0.8).map(|n| n.0);
            prop_assert_eq!(slow, fast);
        }
    }
}
