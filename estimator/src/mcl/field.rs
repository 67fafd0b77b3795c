//! The plan as Monte Carlo localization reads it: distance to the nearest wall, one byte a cell.
//!
//! The exact distance transform of the plan is interpolated to half its cell, so that a 5 cm plan does not cost 2 cm of
//! accuracy, and kept in steps of 5 mm up to 1.27 m: 12 x 9 m are 170 kB and stay in the second-level cache.

use super::planar::Planar;
use vehicle::FloorPlan;
use vehicle::floor_plan::Cell;

/// Metres a distance code stands for.
pub const CODE_M: f64 = 0.005;
/// Farthest distance that can be told, m.
pub const FAR_M: f64 = 255.0 * CODE_M;
/// Cells of this many metres or more in all are not refined: the table would no longer fit any cache.
const MAX_REFINED_CELLS: usize = 4_000_000;
/// Largest column or row that [`whole`] can tell apart.
const LARGEST: usize = (1 << 22) - 1;
/// Half the side of the square over which [`Field::nearest_around`] takes the minimum, m.
pub(crate) const AROUND_M: f64 = 0.15;

/// Distances to walls, and where a vehicle can be.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    width: usize,
    height: usize,
    cell_m: f64,
    origin: [f64; 2],
    codes: Vec<u8>,
    /// Minimum of `codes` over a square of +-[`AROUND_M`]: an upper bound for every pose in the square.
    around: Vec<u8>,
    open: Vec<bool>,
    open_area_m2: f64,
    last_column: f32,
    last_row: f32,
}

impl Field {
    /// Builds the table. Takes milliseconds: do it at start.
    #[must_use]
    pub fn new(plan: &FloorPlan) -> Self {
        let surface = surfaces(plan);
        let distances = surface.as_ref().unwrap_or(plan).distance_field(FAR_M);
        let (pw, ph) = (plan.width(), plan.height());
        let factor = if pw * ph <= MAX_REFINED_CELLS { 2 } else { 1 };
        // A border of "far" cells: whatever lies outside clamps to it.
        let (width, height) = (pw * factor + 2, ph * factor + 2);
        let cell_m = plan.resolution_m() / factor as f64;
        let origin = plan.origin().map(|o| o - cell_m);
        let mut codes = vec![255u8; width * height];
        let mut open = vec![false; width * height];
        let d = distances.distances_m();
        let mut open_cells = 0usize;
        for row in 1..height - 1 {
            for column in 1..width - 1 {
                // Position in units of plan cells, relative to the centre of cell 0.
                let u = ((column as f64 - 0.5) / factor as f64 - 0.5).clamp(0.0, pw as f64 - 1.0);
                let v = ((row as f64 - 0.5) / factor as f64 - 0.5).clamp(0.0, ph as f64 - 1.0);
                let (c0, r0) = (u as usize, v as usize);
                let (c1, r1) = ((c0 + 1).min(pw - 1), (r0 + 1).min(ph - 1));
                let (fu, fv) = (u - c0 as f64, v - r0 as f64);
                let at = |c: usize, r: usize| f64::from(d[r * pw + c]);
                let distance = (1.0 - fv) * ((1.0 - fu) * at(c0, r0) + fu * at(c1, r0))
                    + fv * ((1.0 - fu) * at(c0, r1) + fu * at(c1, r1));
                let i = row * width + column;
                codes[i] = (distance / CODE_M + 0.5).min(255.0) as u8;
                let cell = plan.cell(((column - 1) / factor) as i64, ((row - 1) / factor) as i64);
                open[i] = cell == Cell::Free;
                open_cells += usize::from(open[i]);
            }
        }
        let radius = (AROUND_M / cell_m + 0.999) as usize;
        let around = square_minimum(&codes, width, radius);
        Self {
            width,
            height,
            cell_m,
            origin,
            codes,
            around,
            open,
            open_area_m2: open_cells as f64 * cell_m * cell_m,
            last_column: (width - 1).min(LARGEST) as f32,
            last_row: (height - 1).min(LARGEST) as f32,
        }
    }

    /// Cells in a row, border included.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Rows, border included.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Side of a cell, m.
    #[must_use]
    pub const fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Plan coordinates of the lower-left corner, m.
    #[must_use]
    pub const fn origin(&self) -> [f64; 2] {
        self.origin
    }

    /// Area the plan calls free, m2.
    #[must_use]
    pub const fn open_area_m2(&self) -> f64 {
        self.open_area_m2
    }

    /// Mean and covariance of the uniform distribution over open floor and all headings: what is known at an unknown start.
    #[must_use]
    pub fn anywhere(&self) -> (Planar, [[f64; 3]; 3]) {
        let (mut n, mut sum, mut squares) = (0.0, [0.0; 2], [0.0; 3]);
        for (i, _) in self.open.iter().enumerate().filter(|(_, open)| **open) {
            let (u, v) = ((i % self.width) as f64, (i / self.width) as f64);
            n += 1.0;
            sum = [sum[0] + u, sum[1] + v];
            squares = [squares[0] + u * u, squares[1] + u * v, squares[2] + v * v];
        }
        let n = f64::max(n, 1.0);
        let mean = sum.map(|s| s / n);
        let m2 = self.cell_m * self.cell_m;
        let xx = (squares[0] / n - mean[0] * mean[0]) * m2;
        let xy = (squares[1] / n - mean[0] * mean[1]) * m2;
        let yy = (squares[2] / n - mean[1] * mean[1]) * m2;
        // A circle's worth of headings: variance pi^2 / 3.
        let tt = core::f64::consts::PI * core::f64::consts::PI / 3.0;
        let at = |axis: usize| self.origin[axis] + (mean[axis] + 0.5) * self.cell_m;
        (
            Planar::new(at(0), at(1), 0.0),
            [[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, tt]],
        )
    }

    /// Distance to the nearest wall, m, at most [`FAR_M`].
    #[must_use]
    pub fn distance_m(&self, x_m: f64, y_m: f64) -> f64 {
        let (u, v) = self.to_cells(x_m, y_m);
        f64::from(self.code(u, v)) * CODE_M
    }

    /// True where the plan knows open floor.
    #[must_use]
    pub fn is_open(&self, x_m: f64, y_m: f64) -> bool {
        let (u, v) = self.to_cells(x_m, y_m);
        self.is_open_at(u, v)
    }

    /// A plan point in units of cells.
    pub(crate) fn to_cells(&self, x_m: f64, y_m: f64) -> (f32, f32) {
        (
            ((x_m - self.origin[0]) / self.cell_m) as f32,
            ((y_m - self.origin[1]) / self.cell_m) as f32,
        )
    }

    /// Index of the cell at a point in units of cells; whatever lies outside (or is NaN) clamps to the border.
    #[inline]
    pub(crate) fn index(&self, u: f32, v: f32) -> u32 {
        // Both factors are below 2^22 and the product is a valid index: wrapping spares an overflow check per reading.
        whole(v, self.last_row)
            .wrapping_mul(self.width as u32)
            .wrapping_add(whole(u, self.last_column))
    }

    /// Indices of the cells of many points given in the axes of a place: (u, v) in cells, its yaw as cosine and sine. Written
    /// for vector instructions; a table small enough counts its cells in f32, because whole numbers multiply slowly there.
    #[inline]
    pub(crate) fn indices(
        &self,
        [u, v, c, s]: [f32; 4],
        points: (&[f32], &[f32]),
        indices: &mut [u32],
    ) {
        let turned = indices.iter_mut().zip(points.0).zip(points.1);
        if self.codes.len() <= LARGEST {
            let width = self.width as f32;
            // Half a cell less once, instead of at every point.
            let (u, v) = (u - 0.5, v - 0.5);
            for ((index, x), y) in turned {
                let column = limited(u + c * x - s * y, self.last_column) + MAGIC;
                let row = (limited(v + s * x + c * y, self.last_row) + MAGIC) - MAGIC;
                // Whole numbers and MAGIC, exact in f32.
                *index = (row * width + column).to_bits() & LARGEST as u32;
            }
        } else {
            for ((index, x), y) in turned {
                *index = self.index(u + c * x - s * y, v + s * x + c * y);
            }
        }
    }

    /// Distance code of a cell.
    #[inline]
    pub(crate) fn code_of(&self, index: u32) -> u8 {
        self.codes[index as usize]
    }

    /// Distance code at a point in units of cells.
    #[inline]
    pub(crate) fn code(&self, u: f32, v: f32) -> u8 {
        self.codes[self.index(u, v) as usize]
    }

    /// Smallest distance code within +-[`AROUND_M`] of a point in units of cells.
    #[inline]
    pub(crate) fn nearest_around(&self, u: f32, v: f32) -> u8 {
        self.around[self.index(u, v) as usize]
    }

    #[inline]
    pub(crate) fn is_open_at(&self, u: f32, v: f32) -> bool {
        self.open[self.index(u, v) as usize]
    }

    /// Length of the free way from one plan point towards another, m, at most their distance: sphere marching.
    #[must_use]
    pub fn free_way_m(&self, from: [f64; 2], to: [f64; 2]) -> f64 {
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length = libm::hypot(dx, dy);
        if length <= 0.0 || !length.is_finite() {
            return 0.0;
        }
        let mut s = 0.0;
        while s < length {
            let d = self.distance_m(from[0] + dx / length * s, from[1] + dy / length * s);
            if d < self.cell_m {
                return s;
            }
            s += (d - 0.5 * self.cell_m).max(0.8 * self.cell_m);
        }
        length
    }
}

/// The whole part of `v` limited to 0..=`last` (below 2^22), without a conversion instruction, so that loops over readings
/// become vector instructions: adding 1.5 * 2^23 leaves the nearest whole number in the lowest bits.
#[inline]
fn whole(v: f32, last: f32) -> u32 {
    (limited(v - 0.5, last) + MAGIC).to_bits() & LARGEST as u32
}

/// Within 0..=`last`; NaN becomes 0.
#[inline]
fn limited(v: f32, last: f32) -> f32 {
    let v = if v > 0.0 { v } else { 0.0 };
    if v < last { v } else { last }
}

/// Added to a number below 2^22 it leaves the nearest whole one in the lowest bits: 1.5 * 2^23.
const MAGIC: f32 = 12_582_912.0;

/// The plan without the inside of thick walls: a hit deep inside a wall must not look like a hit on its surface.
/// None if no wall is thick.
fn surfaces(plan: &FloorPlan) -> Option<FloorPlan> {
    let inside = |c: i64, r: i64| {
        plan.cell(c, r) == Cell::Occupied
            && (-1..=1).all(|dr| {
                (-1..=1).all(|dc| {
                    let (c, r) = (c + dc, r + dr);
                    let outside =
                        c < 0 || r < 0 || c >= plan.width() as i64 || r >= plan.height() as i64;
                    outside || plan.cell(c, r) == Cell::Occupied
                })
            })
    };
    let mut cells = plan.cells().to_vec();
    let mut any = false;
    for (i, cell) in cells.iter_mut().enumerate() {
        if inside((i % plan.width()) as i64, (i / plan.width()) as i64) {
            *cell = Cell::Unknown;
            any = true;
        }
    }
    any.then(|| FloorPlan::from_cells(plan.width(), plan.resolution_m(), plan.origin(), cells).ok())
        .flatten()
        .filter(|p| p.cells().contains(&Cell::Occupied))
}

fn square_minimum(values: &[u8], width: usize, radius: usize) -> Vec<u8> {
    let height = values.len() / width;
    let mut rows = vec![255u8; values.len()];
    for r in 0..height {
        for c in 0..width {
            let (from, to) = (c.saturating_sub(radius), (c + radius).min(width - 1));
            rows[r * width + c] = values[r * width + from..=r * width + to]
                .iter()
                .copied()
                .min()
                .unwrap_or(255);
        }
    }
    let mut out = vec![255u8; values.len()];
    for r in 0..height {
        let (from, to) = (r.saturating_sub(radius), (r + radius).min(height - 1));
        for source in from..=to {
            for c in 0..width {
                let v = rows[source * width + c];
                let o = &mut out[r * width + c];
                *o = (*o).min(v);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 4 x 3 m with a wall around and a block in the middle, 0.1 m cells.
    fn room() -> FloorPlan {
        let (w, h) = (40, 30);
        let cells = (0..w * h)
            .map(|i| {
                let (c, r) = (i % w, i / w);
                let border = c == 0 || r == 0 || c == w - 1 || r == h - 1;
                let block = (18..24).contains(&c) && (12..18).contains(&r);
                if border || block {
                    Cell::Occupied
                } else {
                    Cell::Free
                }
            })
            .collect();
        FloorPlan::from_cells(w, 0.1, [0.0, 0.0], cells).unwrap()
    }

    #[test]
    fn distances_are_interpolated_between_cell_centres() {
        let field = Field::new(&room());
        // Centre line of the left wall is x = 0.05.
        for x in [0.3, 0.425, 0.55, 0.9] {
            let d = field.distance_m(x, 0.95);
            assert!((d - (x - 0.05)).abs() < 0.03, "{x}: {d}");
        }
        assert!(field.is_open(1.0, 1.0) && !field.is_open(0.05, 1.0) && !field.is_open(-5.0, 1.0));
    }

    #[test]
    fn the_inside_of_a_thick_wall_is_far_from_its_surface() {
        let field = Field::new(&room());
        assert!(
            field.distance_m(2.1, 1.5) > 0.15,
            "{}",
            field.distance_m(2.1, 1.5)
        );
        assert!(field.distance_m(1.85, 1.5) < 0.03);
    }

    #[test]
    fn anywhere_is_the_middle_of_the_open_floor_with_all_the_doubt_of_it() {
        let (mean, covariance) = Field::new(&room()).anywhere();
        // The block in the middle is 0.1 m off in x.
        assert!(
            mean.is_near(&Planar::new(2.0, 1.5, 0.0), 0.02, 0.01),
            "{mean:?}"
        );
        // Uniform over 3.8 m: 1.097 m across.
        assert!(
            (covariance[0][0].sqrt() - 1.12).abs() < 0.05,
            "{covariance:?}"
        );
    }

    #[test]
    fn outside_the_plan_everything_is_far() {
        let field = Field::new(&room());
        for (x, y) in [(-3.0, 1.0), (99.0, 1.0), (1.0, -99.0), (f64::NAN, 1.0)] {
            assert!(field.distance_m(x, y) > 1.2);
        }
    }

    #[test]
    fn the_free_way_ends_at_the_wall() {
        let field = Field::new(&room());
        let way = field.free_way_m([1.0, 1.5], [3.0, 1.5]);
        assert!((way - 0.85).abs() < 0.1, "{way}");
        assert!((field.free_way_m([0.5, 0.5], [1.0, 0.5]) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn the_square_minimum_bounds_every_cell_in_the_square() {
        let field = Field::new(&room());
        let n = (AROUND_M / field.cell_m()) as i64;
        for (u, v) in [(10, 10), (35, 22), (60, 40), (0, 0)] {
            let bound = field.nearest_around(u as f32, v as f32);
            for du in -n..=n {
                for dv in -n..=n {
                    assert!(bound <= field.code((u + du) as f32, (v + dv) as f32));
                }
            }
        }
    }
}
