//! Beam mixture model by table: what a range says about a place when walls are in the way.
//!
//! `p(z | z*) = hit N(z; z*, s) + short l exp(-l z) / (1 - exp(-l z*)) [z < z*] + nothing [no return] + random / max`
//! (Thrun, Burgard, Fox 2005, equation 6.12). The logarithm of every pair of codes is one byte, in steps of
//! [`STEP_NATS`]; bytes of a particle are summed as integers. Unlike the likelihood field it does not see through walls.

use super::particles::Particles;
use super::random::wrap;
use super::range_table::{NOTHING, PER_RAD, RangeTable, index_of};
use core::f64::consts::TAU;

/// Natural logarithm that one unit of a table byte takes away.
pub const STEP_NATS: f32 = 1.0 / 16.0;
/// Most beams of one update.
const MAX_BEAMS: usize = 256;

/// Shares and widths of the mixture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mixture {
    /// Share of returns from the wall.
    pub hit: f64,
    /// Share of returns from somebody before it.
    pub short: f64,
    /// Share of beams without return.
    pub nothing: f64,
    /// Share of returns from nowhere.
    pub random: f64,
    /// Deviation of a return from the wall, m.
    pub std_m: f64,
    /// Decay of short returns, 1/m.
    pub short_per_m: f64,
}

impl Default for Mixture {
    fn default() -> Self {
        Self {
            hit: 0.85,
            short: 0.06,
            nothing: 0.04,
            random: 0.05,
            std_m: 0.10,
            short_per_m: 1.0,
        }
    }
}

impl Mixture {
    /// Probability of a code (`None`: no return) of width `step_m`, given the expected one.
    fn of(&self, measured: Option<f64>, expected: Option<f64>, step_m: f64, max_m: f64) -> f64 {
        let Some(z) = measured else {
            // Where no wall is within reach, no return is what a hit would be.
            return self.nothing + if expected.is_none() { self.hit } else { 0.0 };
        };
        let reach = expected.unwrap_or(max_m);
        let mut density = self.random / max_m;
        if expected.is_some() {
            let d = (z - reach) / self.std_m;
            density += self.hit * libm::exp(-0.5 * d * d) / (self.std_m * libm::sqrt(TAU));
        }
        if z < reach {
            let l = self.short_per_m;
            density += self.short * l * libm::exp(-l * z) / (1.0 - libm::exp(-l * reach));
        }
        density * step_m
    }
}

/// Logarithms by measured and expected code.
#[derive(Clone, Debug)]
pub struct BeamModel {
    tables: Vec<[u8; 256]>,
}

/// The beams of one update, ready for lookup. Allocated once.
#[derive(Clone, Debug)]
pub struct Beams {
    steps: Vec<f32>,
    codes: Vec<u8>,
}

impl Default for Beams {
    fn default() -> Self {
        Self {
            steps: Vec::with_capacity(MAX_BEAMS),
            codes: Vec::with_capacity(MAX_BEAMS),
        }
    }
}

impl Beams {
    /// Replaces the beams: bearing counter-clockwise from the body's forward, rad, and range, m.
    pub fn set(&mut self, table: &RangeTable, beams: impl Iterator<Item = (f64, Option<f64>)>) {
        self.steps.clear();
        self.codes.clear();
        for (bearing, range_m) in beams.take(MAX_BEAMS) {
            if bearing.is_finite() && range_m.is_none_or(f64::is_finite) {
                self.steps.push(wrap(bearing as f32) * PER_RAD);
                self.codes.push(table.code_of(range_m));
            }
        }
    }
}

impl BeamModel {
    /// The tables for ranges as `table` counts them.
    #[must_use]
    pub fn new(mixture: &Mixture, table: &RangeTable) -> Self {
        let step_m = table.step_m();
        let max_m = step_m * f64::from(NOTHING - 1);
        let range = |code: usize| (code != usize::from(NOTHING)).then_some(code as f64 * step_m);
        let tables = (0..256)
            .map(|measured| {
                let log = |expected: usize| {
                    libm::log(mixture.of(range(measured), range(expected), step_m, max_m))
                };
                let best = (0..256).map(log).fold(f64::NEG_INFINITY, f64::max);
                core::array::from_fn(|expected| {
                    ((best - log(expected)) / f64::from(STEP_NATS) + 0.5).clamp(0.0, 255.0) as u8
                })
            })
            .collect();
        Self { tables }
    }

    /// Computes the log-likelihood of the beams for each particle, up to a constant.
    pub fn weigh(&self, table: &RangeTable, beams: &Beams, particles: &mut Particles) {
        let mut rows = [&self.tables[0]; MAX_BEAMS];
        let n = beams.codes.len().min(MAX_BEAMS);
        for (row, code) in rows.iter_mut().zip(&beams.codes) {
            *row = &self.tables[usize::from(*code)];
        }
        let (rows, steps) = (&rows[..n], &beams.steps[..n]);
        for i in 0..particles.len() {
            let expected = table.row(particles.x[i], particles.y[i]);
            let heading = particles.yaw[i] * PER_RAD;
            let mut cost = 0u32;
            for (row, step) in rows.iter().zip(steps) {
                // Both are within half a turn: the sum is within one.
                let code = expected[index_of(heading + step)];
                cost = cost.wrapping_add(u32::from(row[usize::from(code)]));
            }
            particles.log_likelihood[i] = -(cost as f32) * STEP_NATS;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcl::random::Random;
    use vehicle::floor_plan::Cell;
    use vehicle::{FloorPlan, MapPose};

    /// Two rooms of 2 x 2 m, the right one with a column of cells more: ranges tell them apart, walls hide one from the other.
    fn rooms() -> FloorPlan {
        let (w, h) = (90, 40);
        let cells = (0..w * h)
            .map(|i| {
                let (c, r) = (i % w, i / w);
                if c == 0 || r == 0 || c == w - 1 || r == h - 1 || c == 40 {
                    Cell::Occupied
                } else {
                    Cell::Free
                }
            })
            .collect();
        FloorPlan::from_cells(w, 0.05, [0.0, 0.0], cells).unwrap()
    }

    #[test]
    fn the_particle_at_the_true_place_weighs_most() {
        let plan = rooms();
        let table = RangeTable::new(&plan, 4.0);
        let model = BeamModel::new(&Mixture::default(), &table);
        let truth = MapPose::new(1.225, 0.825, 0.0);
        let mut beams = Beams::default();
        beams.set(
            &table,
            (0..8).map(|k| {
                let bearing = f64::from(k) * TAU / 8.0;
                let from = [truth.x_m, truth.y_m];
                (
                    bearing,
                    super::super::range_table::cast(&plan, from, bearing, 4.0),
                )
            }),
        );
        let mut p = Particles::with_capacity(500);
        p.push(1.225, 0.825, 0.0, 1.0);
        let mut random = Random::new(9);
        for _ in 0..400 {
            let (x, y) = (4.5 * random.uniform(), 2.0 * random.uniform());
            p.push(x, y, 6.2 * random.uniform() - 3.1, 1.0);
        }
        model.weigh(&table, &beams, &mut p);
        let best = p.log_likelihood[0];
        for i in 1..p.len() {
            let far = libm::hypotf(p.x[i] - 1.225, p.y[i] - 0.825) > 0.3;
            assert!(!far || p.log_likelihood[i] < best, "{i}");
        }
    }

    #[test]
    fn the_mixture_is_a_probability() {
        let (step, max) = (0.02, 4.0);
        let m = Mixture::default();
        for expected in [Some(0.5), Some(2.0), Some(3.5), None] {
            let returns: f64 = (0..200)
                .map(|k| m.of(Some((f64::from(k) + 0.5) * step), expected, step, max))
                .sum();
            let sum = returns + m.of(None, expected, step, max);
            let limit = if expected.is_none() { 0.07 } else { 0.02 };
            assert!((sum - 1.0).abs() < limit, "{expected:?}: {sum}");
        }
    }
}
