//! The polar histogram of VFH+: obstacle density by direction, obstacles enlarged by the vehicle's size.
//!
//! A point at distance d with certainty c adds `c^2 (1 - (d / D)^2)` (Ulrich and Borenstein 1998, equation 2, with
//! a = 1 and b chosen so that the magnitude vanishes at the edge D of the window) to every sector within
//! `asin(r_rs / d)` of its direction (equation 4; r_rs = radius + safety). Directions, angles and magnitudes come from a
//! table over relative places, so a step costs no trigonometry.

use super::config::VfhParams;
use super::surroundings::Obstacle;
use super::{SECTOR_RAD, SECTORS};
use core::f64::consts::{FRAC_PI_2, TAU};

/// Raster of the table, m.
const STEP_M: f64 = 0.05;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Entry {
    /// First sector and number of sectors that a point there blocks.
    first: u8,
    count: u8,
    magnitude: f32,
}

/// Polar density and which sectors are blocked.
#[derive(Clone, Debug)]
pub struct Histogram {
    half: i64,
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
        let half = libm::ceil(params.window_m / STEP_M) as i64;
        let side = (2 * half + 1) as usize;
        let enlarged = radius_m + params.safety_m;
        let mut table = Vec::with_capacity(side * side);
        for row in -half..=half {
            for column in -half..=half {
                let (x, y) = (column as f64 * STEP_M, row as f64 * STEP_M);
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
        // Each obstacle adds to a run of sectors: +m where the run begins, -m behind it, summed up in one pass.
        let mut edges = [0.0f32; 2 * SECTORS + 1];
        for o in obstacles {
            if o.distance_m > cut_m {
                continue;
            }
            // Nearest place of the table.
            let column = o.offset.x * (1.0 / STEP_M) + self.half as f64 + 0.5;
            let row = o.offset.y * (1.0 / STEP_M) + self.half as f64 + 0.5;
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
        let mut running = 0.0f32;
        let mut unrolled = [0.0f32; 2 * SECTORS];
        for (sum, edge) in unrolled.iter_mut().zip(&edges) {
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
        Self {
            first: (wrapped as usize % SECTORS) as u8,
            count: (last - first + 1.0).clamp(0.0, SECTORS as f64) as u8,
            magnitude: (1.0 - share * share).max(0.0) as f32,
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
