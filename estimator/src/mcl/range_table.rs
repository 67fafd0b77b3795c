//! Expected ranges for every cell and direction of a plan, directions innermost: all beams of one pose are one row, one
//! or two cache lines. This is the fast way to a beam model (performance note 4).
//!
//! The ranges are exact for the centre of a cell and a whole number of 5-degree directions: a grid traversal (Amanatides
//! and Woo 1987) to the first cell that is occupied.

use super::random::wrap;
use core::f64::consts::TAU;
use vehicle::FloorPlan;
use vehicle::floor_plan::Cell;

/// Directions, every 5 degrees counter-clockwise from plan x.
pub const DIRECTIONS: usize = 72;
/// Code of "nothing within reach".
pub const NOTHING: u8 = 255;

/// Length of the free way from a plan point in a direction to the border of the first occupied cell, m; none within
/// `max_m`. A point inside a wall gives 0; outside of the plan everything is free.
#[must_use]
pub fn cast(plan: &FloorPlan, from: [f64; 2], direction_rad: f64, max_m: f64) -> Option<f64> {
    let r = plan.resolution_m();
    let [ox, oy] = plan.origin();
    let (u, v) = ((from[0] - ox) / r, (from[1] - oy) / r);
    if !(u.is_finite() && v.is_finite() && direction_rad.is_finite()) {
        return None;
    }
    let (dx, dy) = (libm::cos(direction_rad), libm::sin(direction_rad));
    let (mut column, mut row) = (libm::floor(u) as i64, libm::floor(v) as i64);
    // Way to the next border between columns and rows, and between two borders, in cells.
    let first = |at: f64, d: f64| {
        let whole = libm::floor(at);
        if d > 0.0 {
            (whole + 1.0 - at) / d
        } else if d < 0.0 {
            (whole - at) / d
        } else {
            f64::INFINITY
        }
    };
    let (mut to_column, mut to_row) = (first(u, dx), first(v, dy));
    let (per_column, per_row) = (1.0 / dx.abs(), 1.0 / dy.abs());
    let (step_c, step_r) = (dx.signum() as i64, dy.signum() as i64);
    let limit = max_m / r;
    let mut way = 0.0;
    while way <= limit {
        if plan.cell(column, row) == Cell::Occupied {
            return Some(way * r);
        }
        if to_column < to_row {
            way = to_column;
            to_column += per_column;
            column += step_c;
        } else {
            way = to_row;
            to_row += per_row;
            row += step_r;
        }
    }
    None
}

/// The table.
#[derive(Clone, Debug)]
pub struct RangeTable {
    width: usize,
    height: usize,
    inverse_cell: f32,
    origin: [f32; 2],
    step_m: f64,
    codes: Vec<u8>,
}

impl RangeTable {
    /// Casts from every free cell in all directions: a second for 20 x 20 m. 72 bytes a cell.
    #[must_use]
    pub fn new(plan: &FloorPlan, max_m: f64) -> Self {
        let (width, height) = (plan.width(), plan.height());
        let r = plan.resolution_m();
        let [ox, oy] = plan.origin();
        let step_m = max_m / f64::from(NOTHING - 1);
        let mut codes = vec![0u8; width * height * DIRECTIONS];
        for (i, codes) in codes.chunks_exact_mut(DIRECTIONS).enumerate() {
            let (column, row) = (i % width, i / width);
            if plan.cell(column as i64, row as i64) == Cell::Occupied {
                continue;
            }
            let centre = [ox + (column as f64 + 0.5) * r, oy + (row as f64 + 0.5) * r];
            for (k, code) in codes.iter_mut().enumerate() {
                let direction = k as f64 * TAU / DIRECTIONS as f64;
                *code = cast(plan, centre, direction, max_m)
                    .map_or(NOTHING, |d| (d / step_m + 0.5) as u8);
            }
        }
        Self {
            width,
            height,
            inverse_cell: (1.0 / r) as f32,
            origin: [ox as f32, oy as f32],
            step_m,
            codes,
        }
    }

    /// Metres a code stands for.
    #[must_use]
    pub const fn step_m(&self) -> f64 {
        self.step_m
    }

    /// Code of a measured range; [`NOTHING`] without return.
    #[must_use]
    pub fn code_of(&self, range_m: Option<f64>) -> u8 {
        range_m.map_or(NOTHING, |d| {
            (d / self.step_m + 0.5).clamp(0.0, f64::from(NOTHING - 1)) as u8
        })
    }

    /// Ranges from a plan point in all directions, as codes; points outside take the nearest cell.
    #[inline]
    #[must_use]
    pub fn row(&self, x: f32, y: f32) -> &[u8; DIRECTIONS] {
        let u = ((x - self.origin[0]) * self.inverse_cell) as u32 as usize;
        let v = ((y - self.origin[1]) * self.inverse_cell) as u32 as usize;
        let cell = v.min(self.height - 1).wrapping_mul(self.width) + u.min(self.width - 1);
        let (rows, _) = self.codes.as_chunks::<DIRECTIONS>();
        &rows[cell]
    }

    /// Code of the range from a plan point in a direction, rad.
    #[inline]
    #[must_use]
    pub fn code(&self, x: f32, y: f32, direction: f32) -> u8 {
        self.row(x, y)[index_of(wrap(direction) * PER_RAD)]
    }

    /// Codes of the ranges of many beams of one pose: bearings in 5-degree steps, each within half a turn.
    #[inline]
    pub fn codes(&self, x: f32, y: f32, yaw: f32, steps: &[f32], codes: &mut [u8]) {
        let row = self.row(x, y);
        let heading = wrap(yaw) * PER_RAD;
        for (code, step) in codes.iter_mut().zip(steps) {
            *code = row[index_of(heading + step)];
        }
    }

    /// Expected range, m; none if nothing is within reach.
    #[must_use]
    pub fn range_m(&self, x_m: f64, y_m: f64, direction_rad: f64) -> Option<f64> {
        let code = self.code(x_m as f32, y_m as f32, direction_rad as f32);
        (code != NOTHING).then(|| f64::from(code) * self.step_m)
    }
}

/// Directions per radian.
pub(crate) const PER_RAD: f32 = DIRECTIONS as f32 / core::f32::consts::TAU;

/// Index into a row of a direction counted in 5-degree steps, within a turn either way of zero.
#[inline]
pub(crate) fn index_of(steps: f32) -> usize {
    // Rounds without a library call: adding 1.5 * 2^23 leaves the nearest whole number in the lowest bits.
    const MAGIC: f32 = 12_582_912.0;
    const TURN: u32 = DIRECTIONS as u32;
    let whole = (steps + MAGIC).to_bits().wrapping_sub(MAGIC.to_bits());
    // Below zero a turn is added (what wrapped around is huge), above it one is taken off.
    let whole = whole.min(whole.wrapping_add(TURN));
    let whole = whole.min(whole.wrapping_sub(TURN));
    (if whole < TURN { whole } else { 0 }) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcl::random::Random;
    use proptest::prelude::*;

    /// 4 x 3 m, walls around, a block in the middle, 5 cm cells.
    fn room() -> FloorPlan {
        let (w, h) = (80, 60);
        let cells = (0..w * h)
            .map(|i| {
                let (c, r) = (i % w, i / w);
                let border = c == 0 || r == 0 || c == w - 1 || r == h - 1;
                let block = (36..48).contains(&c) && (24..36).contains(&r);
                if border || block {
                    Cell::Occupied
                } else {
                    Cell::Free
                }
            })
            .collect();
        FloorPlan::from_cells(w, 0.05, [-1.0, -1.0], cells).unwrap()
    }

    #[test]
    fn a_cast_along_an_axis_ends_at_the_wall_to_the_millimetre() {
        let plan = room();
        let d = cast(&plan, [0.0, 0.5], 0.0, 8.0).unwrap();
        assert!((d - 0.8).abs() < 1e-9, "{d}");
        let d = cast(&plan, [0.0, 0.5], core::f64::consts::PI, 8.0).unwrap();
        assert!((d - 0.95).abs() < 1e-9, "{d}");
        assert_eq!(cast(&plan, [0.0, 0.5], 0.0, 0.7), None);
        assert_eq!(cast(&plan, [-0.99, 0.5], 1.0, 8.0), Some(0.0));
        assert_eq!(cast(&plan, [f64::NAN, 0.5], 1.0, 8.0), None);
    }

    #[test]
    fn the_table_says_what_a_cast_from_the_centre_of_the_cell_says() {
        let plan = room();
        let table = RangeTable::new(&plan, 8.0);
        let mut random = Random::new(1);
        for _ in 0..2000 {
            let column = (f64::from(random.uniform()) * 78.0) as i64 + 1;
            let row = (f64::from(random.uniform()) * 58.0) as i64 + 1;
            if plan.cell(column, row) == Cell::Occupied {
                continue;
            }
            let k = (random.uniform() * 72.0) as usize % DIRECTIONS;
            let direction = k as f64 * TAU / 72.0;
            let centre = [
                -1.0 + (column as f64 + 0.5) * 0.05,
                -1.0 + (row as f64 + 0.5) * 0.05,
            ];
            let exact = cast(&plan, centre, direction, 8.0).unwrap();
            let told = table.range_m(centre[0], centre[1], direction).unwrap();
            assert!(
                (told - exact).abs() <= 0.51 * table.step_m(),
                "{told} {exact}"
            );
        }
    }

    proptest! {
        #[test]
        fn any_pose_has_a_row_and_any_direction_an_entry(x in -1e6..1e6f32, y in -1e6..1e6f32, turns in -3.0..3.0f32) {
            let table = RangeTable::new(&FloorPlan::from_cells(2, 1.0, [0.0, 0.0], vec![Cell::Free; 4]).unwrap(), 2.0);
            let _ = table.code(x, y, turns * core::f32::consts::TAU);
        }

        #[test]
        fn directions_a_turn_apart_are_the_same(k in 0u8..=72) {
            let steps = f32::from(k);
            prop_assert_eq!(index_of(steps), usize::from(k) % DIRECTIONS);
            prop_assert_eq!(index_of(steps - 72.0), usize::from(k) % DIRECTIONS);
        }
    }
}
