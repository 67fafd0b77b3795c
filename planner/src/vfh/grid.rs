//! The certainty grid: how sure the rangers are that a cell holds something the plan does not show.
//!
//! Fixed to the plan, cells of 0.1 m, certainty 0..=15 (Borenstein and Koren's histogramic in-motion mapping: a return adds
//! to its cell, the ray takes from the cells before it). Certainty halves with time, fast while a cell is fresh, slowly
//! once it is certain: a person's trail is gone in seconds, furniture is remembered. Decay is computed when a cell is read,
//! so nothing sweeps the grid.

use super::config::VfhParams;
use arrayvec::ArrayVec;
use core::ops::Range;
use vehicle::{In, Map, Timestamp};

/// Side of a cell, m.
pub const CELL_M: f64 = 0.1;
/// Largest certainty.
pub const CERTAINTY_MAX: u8 = 15;
/// From this certainty on a cell decays slowly.
const CERTAIN: u8 = 12;
/// Share of a new return in the mean place of its cell, and that place's unit, parts of a cell.
const NEW_SHARE: f64 = 0.25;
const MEAN_UNITS: f64 = 250.0;
const PARTS: i32 = 250;
/// Most changed cells remembered between two steps.
const CHANGED_MAX: usize = 96;
/// A cell counts as an obstacle for routes from this certainty on.
pub const OBSTACLE: u8 = 6;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct CellState {
    certainty: u8,
    /// Was certain once: forgets slowly.
    sure: bool,
    /// When it was last written, tenths of a second since boot.
    at_ds: u32,
    /// Mean of its returns, 1/250 of a cell from the middle: gaps are narrower than two cells.
    mean: [i8; 2],
}

/// A cell as the histogram's window counts it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CellView {
    /// 0 once it has decayed to nothing.
    pub(super) certainty: u8,
    /// Where the mean of its returns lies, half cells from the grid's corner, rounded down.
    pub(super) steps: [i32; 2],
    /// When it will have decayed further, tenths of a second since boot.
    pub(super) decays_ds: u32,
}

/// Certainty per cell of the plan's rectangle.
#[derive(Clone, Debug, PartialEq)]
pub struct CertaintyGrid {
    width: usize,
    height: usize,
    origin: [f64; 2],
    cells: Vec<CellState>,
    /// When a ray last ended in or crossed a cell, tenths of a second since boot; 0 never.
    looked_ds: Vec<u32>,
    /// Cells written since somebody asked last; full = ask for everything.
    changed: ArrayVec<u32, CHANGED_MAX>,
    fresh_ds: u32,
    sure_ds: u32,
    hit: u8,
    free: u8,
}

impl CertaintyGrid {
    /// An empty grid over a rectangle (lower-left corner and size, m).
    #[must_use]
    pub fn new(origin: [f64; 2], size_m: [f64; 2], params: &VfhParams) -> Self {
        let cells = |m: f64| libm::ceil(m / CELL_M).max(1.0) as usize;
        let (width, height) = (cells(size_m[0]), cells(size_m[1]));
        let mut grid = Self {
            width,
            height,
            origin,
            cells: vec![CellState::default(); width * height],
            looked_ds: vec![0; width * height],
            changed: ArrayVec::new(),
            fresh_ds: 0,
            sure_ds: 0,
            hit: 0,
            free: 0,
        };
        grid.set_params(params);
        grid
    }

    /// Takes over half-lives and increments.
    pub fn set_params(&mut self, p: &VfhParams) {
        (self.fresh_ds, self.sure_ds) = (
            (p.fresh_half_life_s * 10.0) as u32,
            (p.certain_half_life_s * 10.0) as u32,
        );
        (self.hit, self.free) = (p.hit.clamp(0, 15) as u8, p.free.clamp(0, 15) as u8);
    }

    /// Forgets everything (the pose has jumped).
    pub fn clear(&mut self) {
        self.cells.fill(CellState::default());
        self.looked_ds.fill(0);
        self.forget_changes(true);
    }

    fn forget_changes(&mut self, all_changed: bool) {
        self.changed.clear();
        while all_changed && self.changed.try_push(0).is_ok() {}
    }

    fn note_change(&mut self, i: usize) {
        // A full log says that anything may have changed.
        if self.changed.last() != Some(&(i as u32)) {
            let _ = self.changed.try_push(i as u32);
        }
    }

    /// Hands the cells written since the last call to `see` as column and row; false if there were too many to remember.
    pub(super) fn take_changes(&mut self, mut see: impl FnMut(&Self, usize, usize)) -> bool {
        let is_complete = !self.changed.is_full();
        if is_complete {
            let changed = core::mem::take(&mut self.changed);
            for i in &changed {
                let i = *i as usize;
                see(self, i % self.width, i / self.width);
            }
        }
        self.forget_changes(false);
        is_complete
    }

    /// Width and height, cells.
    pub(super) const fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// A place in 1/250 of a cell from the grid's corner.
    pub(super) fn in_parts(&self, p: In<Map>) -> [i32; 2] {
        let parts = |v: f64, o: f64| libm::rint((v - o) * (MEAN_UNITS / CELL_M)) as i32;
        [parts(p.x(), self.origin[0]), parts(p.y(), self.origin[1])]
    }

    /// A cell as it counts now; none if nothing is there.
    pub(super) fn cell(&self, column: usize, row: usize, now: Timestamp) -> Option<CellView> {
        let state = self.cells[row * self.width + column];
        (state.certainty > 0).then(|| self.view(state, column, row, tenths(now)))
    }

    /// Calls `see` with column and cell for every cell of a piece of a row that may hold something.
    pub(super) fn in_row(
        &self,
        row: usize,
        columns: Range<usize>,
        now: Timestamp,
        mut see: impl FnMut(usize, CellView),
    ) {
        let now_ds = tenths(now);
        let line = &self.cells[row * self.width..][columns.clone()];
        for (state, column) in line.iter().zip(columns) {
            if state.certainty > 0 {
                see(column, self.view(*state, column, row, now_ds));
            }
        }
    }

    fn view(&self, state: CellState, column: usize, row: usize, now_ds: u32) -> CellView {
        let s = self.decayed(state, now_ds);
        let half_life = if s.sure { self.sure_ds } else { self.fresh_ds }.max(1);
        let steps = |k: usize, mean: i8| 2 * k as i32 + 1 + i32::from(mean).div_euclid(PARTS / 2);
        CellView {
            certainty: s.certainty,
            steps: [steps(column, state.mean[0]), steps(row, state.mean[1])],
            decays_ds: s.at_ds.saturating_add(half_life),
        }
    }

    /// Certainty of the cell at a point, 0..=15.
    #[must_use]
    pub fn certainty(&self, p: In<Map>, now: Timestamp) -> u8 {
        self.index(p)
            .map_or(0, |i| self.decayed(self.cells[i], tenths(now)).certainty)
    }

    /// A return at a point.
    pub fn add_hit(&mut self, p: In<Map>, now: Timestamp) {
        let gain = self.hit;
        let Some(i) = self.index(p) else { return };
        let was_empty = self.decayed(self.cells[i], tenths(now)).certainty == 0;
        self.write(p, now, |c| (c + gain).min(CERTAINTY_MAX));
        let centre = self.centre(i % self.width, i / self.width);
        let share = if was_empty { 1.0 } else { NEW_SHARE };
        let toward = |mean: i8, off_m: f64| {
            let old = f64::from(mean);
            libm::rint(old + share * (off_m / CELL_M * MEAN_UNITS - old)) as i8
        };
        self.note_change(i);
        let mean = self.cells[i].mean;
        self.cells[i].mean = [
            toward(mean[0], p.x() - centre.x()),
            toward(mean[1], p.y() - centre.y()),
        ];
    }

    /// Everything between two points was open. The last cell is left alone: it holds the return, or nothing is known of it.
    pub fn add_free(&mut self, from: In<Map>, to: In<Map>, now: Timestamp) {
        let loss = self.free;
        let last = self.index(to);
        let length = libm::hypot(to.x() - from.x(), to.y() - from.y());
        // Half cells: no cell of the ray is left out by more than its corner.
        let steps = libm::floor(length / (0.5 * CELL_M)).min(400.0);
        let mut before = None;
        let now_ds = tenths(now);
        if let Some(i) = last {
            self.looked_ds[i] = now_ds;
        }
        for k in 0..steps as usize {
            let t = k as f64 / steps;
            let p = In::new(
                from.x() + t * (to.x() - from.x()),
                from.y() + t * (to.y() - from.y()),
                0.0,
            );
            let i = self.index(p);
            if i == before || i == last {
                continue;
            }
            before = i;
            if let Some(i) = i {
                self.looked_ds[i] = now_ds;
            }
            if i.is_some_and(|i| self.cells[i].certainty > 0) {
                self.write(p, now, |c| c.saturating_sub(loss));
            }
        }
    }

    /// Calls `see(place, certainty)` for every cell above zero within a square around a point; the place is the mean of the
    /// cell's returns.
    pub fn around(
        &self,
        centre: In<Map>,
        half_side_m: f64,
        now: Timestamp,
        mut see: impl FnMut(In<Map>, u8),
    ) {
        let ds = tenths(now);
        let cell = |v: f64, o: f64| libm::floor((v - o) / CELL_M);
        let low = |v: f64, o: f64| cell(v - half_side_m, o).max(0.0) as usize;
        let high = |v: f64, o: f64, n: usize| {
            (cell(v + half_side_m, o) + 1.0).clamp(0.0, n as f64) as usize
        };
        let columns = low(centre.x(), self.origin[0])..high(centre.x(), self.origin[0], self.width);
        for row in low(centre.y(), self.origin[1])..high(centre.y(), self.origin[1], self.height) {
            let line = &self.cells[row * self.width..(row + 1) * self.width];
            for column in columns.clone() {
                let state = line[column];
                if state.certainty > 0 {
                    let c = self.decayed(state, ds).certainty;
                    if c > 0 {
                        let [x, y] = state.mean.map(|m| f64::from(m) * (CELL_M / MEAN_UNITS));
                        let at =
                            |k: usize, axis: usize| self.origin[axis] + (k as f64 + 0.5) * CELL_M;
                        see(In::new(at(column, 0) + x, at(row, 1) + y, 0.0), c);
                    }
                }
            }
        }
    }

    /// The vehicle is here: nothing else is.
    pub fn stand_on(&mut self, here: In<Map>, radius_m: f64, now: Timestamp) {
        let now_ds = tenths(now);
        let n = libm::ceil(radius_m / CELL_M) as i32;
        for row in -n..=n {
            for column in -n..=n {
                let off = In::new(f64::from(column), f64::from(row), 0.0) * CELL_M;
                if off.norm_xy() <= radius_m
                    && let Some(i) = self.index(here + off)
                {
                    self.looked_ds[i] = now_ds;
                }
            }
        }
    }

    /// Where a disc that moves from a place along a direction (unit vector) first covers floor that nobody has looked at for
    /// `within_s`: how far it can move before, m, and the place. None if all is known for `reach_m`.
    #[must_use]
    pub fn first_unseen(
        &self,
        from: In<Map>,
        direction: [f64; 2],
        radius_m: f64,
        reach_m: f64,
        within_s: f64,
        now: Timestamp,
    ) -> Option<(f64, In<Map>)> {
        let oldest_ds = tenths(now).saturating_sub((within_s * 10.0) as u32).max(1);
        let [ux, uy] = direction;
        let half = |u: f64| 0.5 * u.abs() * reach_m + radius_m;
        let middle = [from.x() + 0.5 * ux * reach_m, from.y() + 0.5 * uy * reach_m];
        let range = |axis: usize, half_m: f64, n: usize| {
            let cell = |v: f64| libm::floor((v - self.origin[axis]) / CELL_M);
            let low = cell(middle[axis] - half_m).max(0.0) as usize;
            low..(cell(middle[axis] + half_m) + 1.0).clamp(0.0, n as f64) as usize
        };
        let columns = range(0, half(ux), self.width);
        let mut first: Option<(f64, In<Map>)> = None;
        for row in range(1, half(uy), self.height) {
            for column in columns.clone() {
                if self.looked_ds[row * self.width + column] >= oldest_ds {
                    continue;
                }
                let centre = self.centre(column, row);
                let (x, y) = (centre.x() - from.x(), centre.y() - from.y());
                let (along, aside) = (x * ux + y * uy, x * uy - y * ux);
                if aside.abs() >= radius_m || along <= 0.0 {
                    continue;
                }
                let free_m = along - (radius_m * radius_m - aside * aside).sqrt();
                // What the hull covers already is no news.
                let is_ahead = free_m > 0.0 && free_m < reach_m;
                if is_ahead && first.is_none_or(|(m, _)| free_m < m) {
                    first = Some((free_m, centre));
                }
            }
        }
        first
    }

    fn write(&mut self, p: In<Map>, now: Timestamp, change: impl FnOnce(u8) -> u8) {
        let Some(i) = self.index(p) else { return };
        self.note_change(i);
        let at_ds = tenths(now);
        let old = self.decayed(self.cells[i], at_ds);
        let certainty = change(old.certainty);
        self.cells[i] = CellState {
            certainty,
            sure: certainty > 0 && (old.sure || certainty >= CERTAIN),
            // A decay that has not halved yet keeps its start, else frequent writing would keep a cell for ever.
            at_ds: if certainty > old.certainty {
                at_ds
            } else {
                old.at_ds
            },
            mean: old.mean,
        };
    }

    fn decayed(&self, s: CellState, now_ds: u32) -> CellState {
        let half_life = if s.sure { self.sure_ds } else { self.fresh_ds }.max(1);
        let elapsed_ds = now_ds.saturating_sub(s.at_ds);
        if elapsed_ds < half_life {
            return s;
        }
        let halvings = elapsed_ds / half_life;
        let certainty = s.certainty.checked_shr(halvings).unwrap_or(0);
        CellState {
            certainty,
            sure: s.sure && certainty > 0,
            at_ds: s.at_ds + halvings * half_life,
            mean: s.mean,
        }
    }

    fn index(&self, p: In<Map>) -> Option<usize> {
        let c = libm::floor((p.x() - self.origin[0]) / CELL_M);
        let r = libm::floor((p.y() - self.origin[1]) / CELL_M);
        let inside = c >= 0.0 && r >= 0.0 && c < self.width as f64 && r < self.height as f64;
        inside.then(|| r as usize * self.width + c as usize)
    }

    fn centre(&self, column: usize, row: usize) -> In<Map> {
        In::new(
            self.origin[0] + (column as f64 + 0.5) * CELL_M,
            self.origin[1] + (row as f64 + 0.5) * CELL_M,
            0.0,
        )
    }
}

fn tenths(now: Timestamp) -> u32 {
    (now.us() / 100_000) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> CertaintyGrid {
        let params = VfhParams {
            fresh_half_life_s: 2.0,
            ..VfhParams::default()
        };
        CertaintyGrid::new([0.0, 0.0], [4.0, 4.0], &params)
    }

    const T0: Timestamp = Timestamp::from_ms(1_000);

    #[test]
    fn returns_add_three_and_rays_take_one() {
        let mut g = grid();
        let p = In::new(2.05, 2.05, 0.0);
        g.add_hit(p, T0);
        g.add_hit(p, T0);
        assert_eq!(g.certainty(p, T0), 6);
        g.add_free(In::new(0.05, 2.05, 0.0), In::new(3.55, 2.05, 0.0), T0);
        assert_eq!(g.certainty(p, T0), 5);
        g.add_free(In::new(0.05, 2.05, 0.0), p, T0);
        assert_eq!(
            g.certainty(p, T0),
            5,
            "the cell of the return is left alone"
        );
    }

    #[test]
    fn a_cell_remembers_where_in_it_the_returns_lie() {
        let mut g = grid();
        let p = In::new(2.01, 2.08, 0.0);
        for _ in 0..4 {
            g.add_hit(p, T0);
        }
        let mut places = Vec::new();
        g.around(p, 0.3, T0, |place, _| places.push(place));
        assert_eq!(places.len(), 1);
        assert!((places[0] - p).norm_xy() < 1e-3, "{places:?}");
    }

    #[test]
    fn a_fresh_cell_halves_in_two_seconds_and_a_certain_one_stays() {
        let mut g = grid();
        let (fresh, sure) = (In::new(1.0, 1.05, 0.0), In::new(3.0, 3.05, 0.0));
        for _ in 0..3 {
            g.add_hit(fresh, T0);
        }
        for _ in 0..5 {
            g.add_hit(sure, T0);
        }
        let later = Timestamp::from_ms(3_100);
        assert_eq!(
            (g.certainty(fresh, later), g.certainty(sure, later)),
            (4, 15)
        );
        assert_eq!(g.certainty(fresh, Timestamp::from_ms(12_000)), 0);
    }

    #[test]
    fn floor_nobody_looked_at_is_found_ahead_of_the_hull() {
        let mut g = grid();
        let here = In::new(1.05, 2.05, 0.0);
        g.stand_on(here, 0.2, T0);
        let ahead = |g: &CertaintyGrid, now| {
            g.first_unseen(here, [1.0, 0.0], 0.2, 1.5, 10.0, now)
                .map(|(m, _)| m)
        };
        assert!(ahead(&g, T0).is_some_and(|m| m < 0.15));
        for y in -3..=3 {
            let beside = In::new(0.0, f64::from(y) * 0.1, 0.0);
            g.add_free(here, here + In::new(1.0, 0.0, 0.0) + beside, T0);
            g.add_free(here + beside, here + In::new(1.0, 0.0, 0.0) + beside, T0);
        }
        let known_m = ahead(&g, T0).unwrap();
        assert!((0.7..1.1).contains(&known_m), "{known_m}");
        let later = Timestamp::from_ms(12_500);
        assert!(ahead(&g, later).is_some_and(|m| m < known_m), "forgotten");
    }

    #[test]
    fn what_is_outside_the_plan_is_ignored() {
        let mut g = grid();
        for p in [
            In::new(-1.0, 0.0, 0.0),
            In::new(f64::NAN, 1.0, 0.0),
            In::new(1e300, 1.0, 0.0),
        ] {
            g.add_hit(p, T0);
            g.add_free(In::new(1.0, 1.0, 0.0), p, T0);
            assert_eq!(g.certainty(p, T0), 0);
        }
    }
}
