//! The polar histogram of VFH+: obstacle density by direction, obstacles enlarged by the vehicle's size.
//!
//! A point at distance d with certainty c adds `c^2 (1 - (d / D)^2)` (Ulrich and Borenstein 1998, equation 2, with
//! a = 1 and b chosen so that the magnitude vanishes at the edge D of the window) to every sector within
//! `asin(r_rs / d)` of its direction (equation 4; r_rs = radius + safety). Directions, angles and magnitudes come from a
//! table over relative places, so a step costs no trigonometry.

use super::config::VfhParams;
use super::grid::{CELL_M, CellView, CertaintyGrid};
use super::surroundings::Obstacle;
use super::{SECTOR_RAD, SECTORS};
use core::f64::consts::{FRAC_PI_2, TAU};
use vehicle::{In, Map, Timestamp};

/// Raster of the table, m.
const STEP_M: f64 = 0.05;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Entry {
    /// First sector and number of sectors that a point there blocks.
    first: u8,
    count: u8,
    /// Distance in steps of the table, rounded down.
    steps: u16,
    magnitude: f32,
    /// The same for the window's whole numbers.
    whole: i32,
}

/// What the cells of the active window add, kept from step to step: built anew when the vehicle has moved on by a step of
/// the table, else changed by the cells that changed. Whole numbers, so that nothing creeps in.
#[derive(Clone, Debug)]
pub struct Window {
    edges: [i32; EDGES],
    /// Place in steps of the table, and the distance up to which obstacles count.
    centre: [i32; 2],
    cut_steps: u16,
    /// The lowest cell of the window, cells a side, and what each adds now.
    low: [i32; 2],
    side: usize,
    held: Vec<Held>,
    /// When the first of them decays, tenths of a second since boot.
    decays_ds: u32,
    is_built: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct Held {
    first: u8,
    behind: u8,
    amount: i32,
}

const EDGES: usize = 2 * SECTORS + 1;
/// Whole numbers of the window that make 1: a certain cell at the vehicle.
const WHOLE: i32 = 225 * 1024;
/// Parts of a cell in a step of the table: a cell is 250 parts, a step half a cell.
const PARTS_PER_STEP: i32 = 125;

/// Polar density and which sectors are blocked.
#[derive(Clone, Debug)]
pub struct Histogram {
    half: i32,
    side: usize,
    table: Vec<Entry>,
    density: [f32; SECTORS],
    blocked: [bool; SECTORS],
    high: f32,
    low: f32,
}

impl Histogram {
    /// Tables for a vehicle of this radius.
    #[must_use]
    pub fn new(params: &VfhParams, radius_m: f64) -> Self {
        let half = libm::ceil(params.window_m / STEP_M) as i32;
        let side = (2 * half + 1) as usize;
        let enlarged = radius_m + params.safety_m;
        let mut table = Vec::with_capacity(side * side);
        for row in -half..=half {
            for column in -half..=half {
                let (x, y) = (f64::from(column) * STEP_M, f64::from(row) * STEP_M);
                table.push(Entry::at(x, y, enlarged, params.window_m));
            }
        }
        Self {
            half,
            side,
            table,
            density: [0.0; SECTORS],
            blocked: [false; SECTORS],
            high: params.threshold as f32,
            low: (params.threshold * params.hysteresis) as f32,
        }
    }

    /// Counts the obstacles nearer than `cut_m` (what is behind the target does not matter) and updates which sectors are
    /// blocked: above the high threshold yes, below the low one no, in between as before.
    pub fn update(&mut self, obstacles: &[Obstacle], cut_m: f64) {
        let mut edges = [0.0f32; EDGES];
        self.scatter(&mut edges, obstacles, cut_m);
        self.settle(&edges);
    }

    /// The same with the cells of the window, brought up to date first; `others` are the obstacles that are no cells.
    pub fn update_over(
        &mut self,
        window: &mut Window,
        grid: &mut CertaintyGrid,
        here: In<Map>,
        now: Timestamp,
        others: &[Obstacle],
        cut_m: f64,
    ) {
        window.follow(self, grid, here, now, cut_m);
        let mut edges = window
            .edges
            .map(|whole| whole as f32 * (1.0 / WHOLE as f32));
        self.scatter(&mut edges, others, cut_m);
        self.settle(&edges);
    }

    /// Each obstacle adds to a run of sectors: +m where the run begins, -m behind it, summed up in one pass.
    fn scatter(&self, edges: &mut [f32; EDGES], obstacles: &[Obstacle], cut_m: f64) {
        for o in obstacles {
            if o.distance_m > cut_m {
                continue;
            }
            // Nearest place of the table.
            let column = o.offset.x * (1.0 / STEP_M) + f64::from(self.half) + 0.5;
            let row = o.offset.y * (1.0 / STEP_M) + f64::from(self.half) + 0.5;
            let side = self.side as f64;
            let inside = column >= 0.0 && row >= 0.0 && column < side && row < side;
            if !inside {
                continue;
            }
            let e = self.table[row as usize * self.side + column as usize];
            let m = e.magnitude * o.weight as f32;
            edges[usize::from(e.first)] += m;
            edges[usize::from(e.first) + usize::from(e.count)] -= m;
        }
    }

    fn settle(&mut self, edges: &[f32; EDGES]) {
        let mut running = 0.0f32;
        let mut unrolled = [0.0f32; 2 * SECTORS];
        for (sum, edge) in unrolled.iter_mut().zip(edges) {
            running += edge;
            *sum = running;
        }
        for k in 0..SECTORS {
            // Rounding of the running sum must not look like density.
            let d = (unrolled[k] + unrolled[k + SECTORS]).max(0.0);
            self.density[k] = d;
            if d > self.high {
                self.blocked[k] = true;
            } else if d < self.low {
                self.blocked[k] = false;
            }
        }
    }

    /// What a cell adds to the window around a place, in steps of the table.
    fn adds(&self, cell: &CellView, centre: [i32; 2], cut_steps: u16) -> Held {
        // From the middle of the step, to the nearest place: both halves of a step cancel.
        let place = |axis: usize| (cell.steps[axis] - centre[axis] + self.half) as usize;
        let (x, y) = (place(0), place(1));
        // A place before the table is a very large one.
        if x >= self.side || y >= self.side {
            return Held::default();
        }
        let e = &self.table[y * self.side + x];
        if e.steps > cut_steps {
            return Held::default();
        }
        Held {
            first: e.first,
            behind: e.first + e.count,
            amount: e.whole * i32::from(cell.certainty) * i32::from(cell.certainty),
        }
    }

    /// Forgets which sectors were blocked.
    pub fn clear(&mut self) {
        (self.density, self.blocked) = ([0.0; SECTORS], [false; SECTORS]);
    }

    /// Polar density, 1.
    #[must_use]
    pub const fn density(&self) -> &[f32; SECTORS] {
        &self.density
    }

    /// Blocked sectors (the binary histogram).
    #[must_use]
    pub const fn blocked(&self) -> &[bool; SECTORS] {
        &self.blocked
    }
}

impl Default for Window {
    fn default() -> Self {
        Self {
            edges: [0; EDGES],
            centre: [0; 2],
            cut_steps: 0,
            low: [0; 2],
            side: 0,
            held: Vec::new(),
            decays_ds: 0,
            is_built: false,
        }
    }
}

impl Window {
    /// For a window of this radius, m.
    #[must_use]
    pub fn new(window_m: f64) -> Self {
        let side = 2 * libm::ceil(window_m / CELL_M) as usize + 1;
        Self {
            side,
            held: vec![Held::default(); side * side],
            ..Self::default()
        }
    }

    fn follow(
        &mut self,
        tables: &Histogram,
        grid: &mut CertaintyGrid,
        here: In<Map>,
        now: Timestamp,
        cut_m: f64,
    ) {
        let parts = grid.in_parts(here);
        let centre = parts.map(|v| v.div_euclid(PARTS_PER_STEP));
        // Rounded up: rather an obstacle too many than one too few.
        let cut_steps = libm::ceil(cut_m / STEP_M).clamp(0.0, 1e4) as u16;
        let now_ds = (now.us() / 100_000) as u32;
        let mut stays = self.is_built
            && centre == self.centre
            && cut_steps == self.cut_steps
            && now_ds < self.decays_ds;
        if stays {
            stays = grid.take_changes(|grid, column, row| {
                self.take_cell(tables, grid, column, row, now);
            });
        }
        if !stays {
            grid.take_changes(|_, _, _| ());
            (self.centre, self.cut_steps) = (centre, cut_steps);
            self.build(tables, grid, parts, now);
        }
    }

    fn build(&mut self, tables: &Histogram, grid: &CertaintyGrid, parts: [i32; 2], now: Timestamp) {
        let mut edges = [0; EDGES];
        self.held.fill(Held::default());
        self.is_built = true;
        let half = (self.side / 2) as i32;
        self.low = parts.map(|v| v.div_euclid(2 * PARTS_PER_STEP) - half);
        let (low, size) = (self.low, grid.size());
        let range = |axis: usize| {
            let from = low[axis].clamp(0, size[axis] as i32);
            let to = (low[axis] + self.side as i32).clamp(0, size[axis] as i32);
            from as usize..to as usize
        };
        let (columns, rows) = (range(0), range(1));
        let mut decays_ds = u32::MAX;
        for row in rows {
            let begin = (row as i32 - low[1]) as usize * self.side;
            let held = &mut self.held[begin..begin + self.side];
            let (centre, cut_steps) = (self.centre, self.cut_steps);
            grid.in_row(row, columns.clone(), now, |column, cell| {
                decays_ds = decays_ds.min(cell.decays_ds);
                let new = tables.adds(&cell, centre, cut_steps);
                held[(column as i32 - low[0]) as usize] = new;
                edges[usize::from(new.first)] += new.amount;
                edges[usize::from(new.behind)] -= new.amount;
            });
        }
        (self.edges, self.decays_ds) = (edges, decays_ds);
    }

    /// Replaces what a cell adds by what it adds now.
    fn take_cell(
        &mut self,
        tables: &Histogram,
        grid: &CertaintyGrid,
        column: usize,
        row: usize,
        now: Timestamp,
    ) {
        let (c, r) = (column as i32 - self.low[0], row as i32 - self.low[1]);
        let side = self.side as i32;
        if !(0..side).contains(&c) || !(0..side).contains(&r) {
            return;
        }
        let new = grid
            .cell(column, row, now)
            .map_or_else(Held::default, |cell| {
                self.decays_ds = self.decays_ds.min(cell.decays_ds);
                tables.adds(&cell, self.centre, self.cut_steps)
            });
        let held = &mut self.held[r as usize * self.side + c as usize];
        let old = core::mem::replace(held, new);
        self.edges[usize::from(old.first)] -= old.amount;
        self.edges[usize::from(old.behind)] += old.amount;
        self.edges[usize::from(new.first)] += new.amount;
        self.edges[usize::from(new.behind)] -= new.amount;
    }
}

impl Entry {
    fn at(x: f64, y: f64, enlarged_m: f64, window_m: f64) -> Self {
        let d = libm::hypot(x, y);
        // Inside the enlarged radius every direction towards the obstacle is blocked.
        let half_angle = if d > enlarged_m {
            libm::asin(enlarged_m / d)
        } else {
            FRAC_PI_2
        };
        let direction = libm::atan2(y, x);
        let from = (direction - half_angle) / SECTOR_RAD;
        let to = (direction + half_angle) / SECTOR_RAD;
        // A sector is blocked if its middle is.
        let first = libm::ceil(from - 0.5);
        let last = libm::floor(to - 0.5);
        let wrapped = first - libm::floor(first * SECTOR_RAD / TAU + 1e-12) * SECTORS as f64;
        let share = d / window_m;
        let magnitude = (1.0 - share * share).max(0.0);
        Self {
            first: (wrapped as usize % SECTORS) as u8,
            count: (last - first + 1.0).clamp(0.0, SECTORS as f64) as u8,
            steps: libm::floor(d / STEP_M + 1e-9).min(1e4) as u16,
            magnitude: magnitude as f32,
            whole: libm::rint(magnitude * 1024.0) as i32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{middle_of, sector_of};
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    fn point(x: f64, y: f64) -> Obstacle {
        let offset = Vector2::new(x, y);
        Obstacle {
            offset,
            distance_m: offset.norm(),
            weight: 1.0,
        }
    }

    fn histogram() -> Histogram {
        Histogram::new(&VfhParams::default(), 0.16)
    }

    #[test]
    fn a_point_one_metre_ahead_blocks_15_degrees_to_both_sides() {
        // asin(0.26 / 1.0) = 15.07 degrees: sectors with middles from -12.5 to 12.5 degrees.
        let mut h = histogram();
        h.update(&[point(1.0, 0.0)], 10.0);
        let blocked: Vec<usize> = (0..SECTORS).filter(|k| h.blocked()[*k]).collect();
        assert_eq!(blocked, vec![0, 1, 2, 69, 70, 71]);
        // 1 - (1.0 / 1.6)^2 = 0.609.
        assert!((h.density()[0] - 0.609).abs() < 0.001);
    }

    #[test]
    fn what_lies_behind_the_target_does_not_block() {
        let mut h = histogram();
        h.update(&[point(1.0, 0.0)], 0.9);
        assert!(h.blocked().iter().all(|b| !b));
    }

    #[test]
    fn between_the_thresholds_a_sector_stays_as_it_was() {
        let mut h = histogram();
        let weak = Obstacle {
            weight: 0.25 / 0.609,
            ..point(1.0, 0.0)
        };
        h.update(&[weak], 10.0);
        assert!(!h.blocked()[0], "0.25 is below t_high = 0.3");
        h.update(&[point(1.0, 0.0)], 10.0);
        h.update(&[weak], 10.0);
        assert!(h.blocked()[0], "0.25 is above t_low = 0.21");
        h.update(&[], 10.0);
        assert!(!h.blocked()[0]);
    }

    #[test]
    fn a_window_kept_up_to_date_is_the_window_built_anew() {
        let params = VfhParams::default();
        let mut grid = CertaintyGrid::new([0.0, 0.0], [6.0, 6.0], &params);
        let (mut kept, mut h) = (Window::new(params.window_m), histogram());
        let mut seed = 7_u32;
        let mut random = |n: u32| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) % n
        };
        let mut incremental = 0;
        for step in 0..400_u32 {
            let now = Timestamp::from_ms(1_000 + u64::from(step) * 25);
            for _ in 0..random(6) {
                let p = [random(600), random(600)].map(|v| f64::from(v) * 0.01);
                grid.add_hit(In::new(p[0], p[1], 0.0), now);
                grid.add_free(In::new(3.0, 3.0, 0.0), In::new(p[1], p[0], 0.0), now);
            }
            let here = In::new(2.5 + 0.004 * f64::from(step), 3.0, 0.0);
            let before = kept.centre;
            h.update_over(&mut kept, &mut grid, here, now, &[], 1.3);
            incremental += u32::from(kept.centre == before);
            let (mut anew, mut other) = (Window::new(params.window_m), histogram());
            other.update_over(&mut anew, &mut grid, here, now, &[], 1.3);
            assert_eq!(kept.edges, anew.edges, "step {step}");
        }
        assert!(incremental > 300, "{incremental}");
    }

    proptest! {
        #[test]
        fn turning_the_world_by_a_quarter_turns_the_histogram_by_18_sectors(
            places in proptest::collection::vec((-1.5..1.5f64, -1.5..1.5f64), 1..40),
        ) {
            // Snapped to the table, where a quarter turn is exact; axis points sit on sector borders.
            let snap = |v: f64| libm::rint(v / STEP_M) * STEP_M + 0.0;
            // A point under the vehicle itself has no direction.
            let world: Vec<_> = places.iter().filter(|(x, y)| libm::hypot(*x, *y) > 0.1).map(|(x, y)| point(snap(*x), snap(*y))).collect();
            let turned: Vec<_> = world.iter().map(|o| point(-o.offset.y, o.offset.x)).collect();
            let (mut a, mut b) = (histogram(), histogram());
            a.update(&world, 10.0);
            b.update(&turned, 10.0);
            for k in 0..SECTORS {
                let (da, db) = (a.density()[k], b.density()[(k + 18) % SECTORS]);
                prop_assert!((da - db).abs() < 1e-3 * (1.0 + da), "sector {k}: {da} and {db}");
            }
        }

        #[test]
        fn the_direction_of_a_point_is_always_blocked(angle in 0.0..TAU, d in 0.05..1.3f64) {
            let mut h = histogram();
            h.update(&[point(d * libm::cos(angle), d * libm::sin(angle))], 10.0);
            let k = sector_of(angle);
            prop_assert!(h.blocked()[k], "{} degrees, sector {k}, middle {}", angle.to_degrees(), middle_of(k).to_degrees());
        }
    }
}
