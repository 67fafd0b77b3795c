//! SNSI's vector field histogram as the thesis has it (after Borenstein and Koren 1991), for comparison with [VFH+](super).
//!
//! A window of square cells around the vehicle counts readings, each in exactly one cell; counts become a polar histogram,
//! that is smoothed, cut at a threshold into valleys, and the valley nearest to the target gives turn and speed. Angles are
//! in degrees, clockwise, rows of the window run down: as the thesis prints them.
//!
//! | Step | Here |
//! | --- | --- |
//! | window of counts, one cell a reading | [`Window`] |
//! | magnitude `c^2 (a - b d)`, sectors of 5 degrees | [`Window::histogram`] |
//! | Hann window or the article's triangle | [`Smoothing`] |
//! | valleys, direct approach, wide and narrow | [`valleys`], [`heading_deg`] |
//! | turn and speed | [`decide`] |
//! | Moravec and Elfes' probabilistic cells | [`belief`] |

pub mod belief;

use super::SECTORS;
use arrayvec::ArrayVec;

/// Side of a cell, m.
pub const CELL_M: f64 = 0.05;
/// Magnitude of a reading at the vehicle.
pub const A: f64 = 5.0;
/// Valleys of more sectors are wide (s_max).
pub const WIDE: i32 = 15;
/// Angle of a sector, degrees.
pub const ALPHA_DEG: f64 = 5.0;
/// Fastest inclination, degrees, and the density at which it is slowest (h_m).
pub const SPEED_MAX_DEG: f64 = 8.0;
/// Density from which on the vehicle only creeps.
pub const DENSITY_MAX: f64 = 8.0;
/// Half-width of the ring of cells that a distance may fall into, cells.
const RING: f64 = 0.5;

/// Densities by sector, clockwise from the window's columns.
pub type Polar = [f64; SECTORS];

/// How the histogram is smoothed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Smoothing {
    /// The thesis: a Hann window of five points over its sum, `(0, 1/4, 1/2, 1/4, 0)`.
    Hann,
    /// The article, misprint mended: `1 / (2 l + 1)` times the triangle `l - |n| + 1`, l = 5.
    Article,
}

/// What lies beyond the last sector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// The first one again.
    Joined,
    /// Nothing, as SNSI's program has it: what is right behind the column axis does not reach over it.
    Open,
}

/// Bearing of a cell from the middle, degrees in (-180, 180], clockwise because rows run down.
#[must_use]
pub fn bearing_deg(rows_down: i32, columns_right: i32) -> f64 {
    libm::atan2(f64::from(rows_down), f64::from(columns_right)).to_degrees()
}

/// The window of counts.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    side: usize,
    counts: Vec<u16>,
    /// Cells by the distance they may stand for, in cells: `ring_cells[rings[d]..rings[d + 1]]`, each with its bearing.
    rings: Vec<usize>,
    ring_cells: Vec<(usize, f64)>,
    /// Sector and `a - b d` of every cell.
    places: Vec<(u8, f64)>,
}

impl Window {
    /// An empty window of `side` cells a side, an odd number (81 in the thesis, 141 in the program).
    #[must_use]
    pub fn new(side: usize) -> Self {
        let side = side | 1;
        let half = (side / 2) as i32;
        let b = A / side as f64;
        let cells =
            || (-half..=half).flat_map(|row| (-half..=half).map(move |column| (row, column)));
        let away = |(row, column)| libm::hypot(f64::from(row), f64::from(column));
        let places = cells()
            .map(|at| {
                let sector = sector_of_deg(bearing_deg(at.0, at.1));
                (sector as u8, A - b * away(at))
            })
            .collect();
        let (mut rings, mut ring_cells) = (vec![0], Vec::new());
        for ring in 0..=libm::ceil(away((half, half))) as usize {
            let on_ring = cells()
                .enumerate()
                .filter(|(_, at)| (away(*at) - ring as f64).abs() <= RING);
            ring_cells.extend(on_ring.map(|(i, at)| (i, bearing_deg(at.0, at.1))));
            rings.push(ring_cells.len());
        }
        Self {
            side,
            counts: vec![0; side * side],
            rings,
            ring_cells,
            places,
        }
    }

    /// Forgets all counts.
    pub fn clear(&mut self) {
        self.counts.fill(0);
    }

    /// The vehicle has moved by so many cells: the counts stay where they were on the floor, what leaves the window is
    /// forgotten.
    pub fn shift(&mut self, rows_down: i32, columns_right: i32) {
        let side = self.side as i32;
        if rows_down.abs() >= side || columns_right.abs() >= side {
            self.clear();
            return;
        }
        let step = (rows_down * side + columns_right) as isize;
        let n = self.counts.len() as isize;
        let column_of = |i: isize| (i % side as isize) as i32;
        let mut take = |i: isize| {
            // A cell whose old place lies outside, or in the next row, is new.
            let from = i + step;
            let is_old = (0..n).contains(&from) && column_of(from) == column_of(i) + columns_right;
            self.counts[i as usize] = if is_old {
                self.counts[from as usize]
            } else {
                0
            };
        };
        if step >= 0 {
            (0..n).for_each(&mut take);
        } else {
            (0..n).rev().for_each(&mut take);
        }
    }

    /// Count of the cell so many rows below and columns right of the middle.
    #[must_use]
    pub fn count(&self, rows_down: i32, columns_right: i32) -> u16 {
        self.index(rows_down, columns_right)
            .map_or(0, |i| self.counts[i])
    }

    fn index(&self, rows_down: i32, columns_right: i32) -> Option<usize> {
        let half = (self.side / 2) as i32;
        let inside = rows_down.abs() <= half && columns_right.abs() <= half;
        inside.then(|| ((rows_down + half) as usize) * self.side + (columns_right + half) as usize)
    }

    /// Counts a reading: one up in the cell on the beam's axis, nothing else; nothing beyond the window.
    pub fn add(&mut self, angle_deg: f64, distance_m: f64) {
        if !(angle_deg.is_finite() && distance_m.is_finite() && distance_m >= 0.0) {
            return;
        }
        let ring = libm::floor(distance_m / CELL_M);
        if ring >= (self.rings.len() - 1) as f64 {
            return;
        }
        let ring = ring as usize;
        let mut best: Option<(f64, usize)> = None;
        for (i, bearing) in &self.ring_cells[self.rings[ring]..self.rings[ring + 1]] {
            let off = wrapped_deg(bearing - angle_deg).abs();
            if best.is_none_or(|(b, _)| off < b) {
                best = Some((off, *i));
            }
        }
        if let Some((_, i)) = best {
            self.counts[i] = self.counts[i].saturating_add(1);
        }
    }

    /// Sums of `c^2 (a - b d)` by sector; b makes it vanish at a distance of `side` cells.
    #[must_use]
    pub fn histogram(&self) -> Polar {
        let mut h = [0.0; SECTORS];
        for (count, (sector, factor)) in self.counts.iter().zip(&self.places) {
            if *count > 0 {
                let c = f64::from(*count);
                h[usize::from(*sector)] += c * c * factor;
            }
        }
        h
    }
}

fn sector_of_deg(angle_deg: f64) -> usize {
    let turns = angle_deg / 360.0;
    let k = libm::floor((turns - libm::floor(turns)) * 360.0 / ALPHA_DEG) as usize;
    k % SECTORS
}

/// An angle in (-180, 180].
fn wrapped_deg(angle_deg: f64) -> f64 {
    let turned = angle_deg - 360.0 * libm::floor(angle_deg / 360.0);
    if turned > 180.0 {
        turned - 360.0
    } else {
        turned
    }
}

/// The histogram smoothed.
#[must_use]
pub fn smoothed(h: &Polar, how: Smoothing, ends: Ends) -> Polar {
    let weight = |n: i32| match how {
        Smoothing::Hann => match n.abs() {
            0 => 0.5,
            1 => 0.25,
            _ => 0.0,
        },
        Smoothing::Article => f64::from(5 - n.abs() + 1) / 11.0,
    };
    let mut out = [0.0; SECTORS];
    for (k, sum) in out.iter_mut().enumerate() {
        for n in -5..=5 {
            let at = k as i32 + n;
            let inside = (0..SECTORS as i32).contains(&at);
            if inside || ends == Ends::Joined {
                *sum += weight(n) * h[at.rem_euclid(SECTORS as i32) as usize];
            }
        }
    }
    out
}

/// Runs of sectors at most as dense as the threshold: first sector and the one behind the last. With joined ends a run
/// through zero ends beyond 72.
#[must_use]
pub fn valleys(h: &Polar, threshold: f64, ends: Ends) -> ArrayVec<(i32, i32), { SECTORS / 2 + 1 }> {
    let n = SECTORS as i32;
    let free = |k: i32| h[k.rem_euclid(n) as usize] <= threshold;
    let first = match ends {
        Ends::Open => 0,
        // Beginning behind a dense sector no valley is cut in two.
        Ends::Joined => (0..n).find(|k| !free(*k)).map_or(0, |k| k + 1),
    };
    let mut out = ArrayVec::new();
    let mut begun = None;
    for k in first..first + n {
        match (free(k), begun) {
            (true, None) => begun = Some(k),
            (false, Some(from)) => {
                let _ = out.try_push((from, k));
                begun = None;
            }
            _ => {}
        }
    }
    if let Some(from) = begun {
        let _ = out.try_push((from, first + n));
    }
    out
}

/// Where to fly, degrees: straight to the target if a valley holds it, else into the nearest valley, half of `WIDE` away
/// from its nearer border or through its middle. None without a valley.
#[must_use]
pub fn heading_deg(valleys: &[(i32, i32)], target_deg: f64) -> Option<f64> {
    let n = SECTORS as i32;
    let target = sector_of_deg(target_deg) as i32;
    let holds = |(from, to): (i32, i32)| (target - from).rem_euclid(n) < to - from;
    if valleys.iter().any(|v| holds(*v)) {
        return Some(target_deg);
    }
    let off = |border: i32| {
        let d = (border - target).rem_euclid(n);
        d.min(n - d)
    };
    let mut best: Option<(i32, f64)> = None;
    for (from, to) in valleys {
        let last = to - 1;
        // The far border lies away from the near one, into the valley; the program only ever added.
        for (near, into) in [(*from, 1), (last, -1)] {
            let width = to - from;
            let far = if width > WIDE {
                near + into * WIDE
            } else {
                near + into * (width - 1)
            };
            let heading = 0.5 * f64::from(near + far) * ALPHA_DEG;
            if best.is_none_or(|(b, _)| off(near) < b) {
                best = Some((off(near), heading));
            }
        }
    }
    best.map(|(_, heading)| heading)
}

/// What the thesis tells the controllers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decision {
    /// Turn, degrees in (-180, 180], clockwise.
    pub turn_deg: i32,
    /// Inclination forward, degrees.
    pub speed_deg: i32,
}

/// Bearing of a goal from a location (row, column), degrees in 0..360, as the program counts it.
#[must_use]
pub fn target_deg(location: [f64; 2], goal: [f64; 2]) -> f64 {
    let bearing = libm::atan2(goal[0] - location[0], goal[1] - location[1]).to_degrees() - 90.0;
    if bearing < 0.0 {
        bearing + 360.0
    } else {
        bearing
    }
}

/// Inclination at a density, degrees: full where nothing is, never less than one.
#[must_use]
pub fn speed_deg(density: f64) -> i32 {
    let share = 1.0 - density.clamp(0.0, DENSITY_MAX) / DENSITY_MAX;
    libm::round((SPEED_MAX_DEG * share).max(1.0)) as i32
}

/// Turn and speed towards a target, from the heading flown; none if every direction is dense.
#[must_use]
pub fn decide(
    h: &Polar,
    threshold: f64,
    target_deg: f64,
    nose_deg: f64,
    ends: Ends,
) -> Option<Decision> {
    let heading = heading_deg(&valleys(h, threshold, ends), target_deg)?;
    Some(Decision {
        turn_deg: libm::round(wrapped_deg(heading - nose_deg)) as i32,
        speed_deg: speed_deg(h[sector_of_deg(nose_deg)]),
    })
}

#[cfg(test)]
mod tests;
