//! Sensor model: likelihood field by table.
//!
//! `p(z) = (1 - r) exp(-d^2 / 2 s^2) + r` with d the distance from the hit to the nearest wall (Thrun, Burgard, Fox 2005,
//! table 6.3). Deviation s and share r of random readings depend on the range, from 17 856 recorded time-of-flight
//! readings (depth error 0.01 - 0.04 m; short by more than 0.15 m: 0 % below 1 m, 10 % at 1 - 2 m, 8 - 16 % beyond).
//! The logarithm is tabulated for every distance code, so a reading costs two look-ups and an addition.

use super::beams::{Evidence, LevelBeam};
use super::field::{CODE_M, Field};
use super::particles::Particles;
use super::planar::{Axes, Planar};
use super::random::sin_cos;
use crate::EstimatorParams;
use arrayvec::ArrayVec;
use core::ops::Range;

/// Most readings one update uses; two full scans.
pub const MAX_READINGS: usize = 128;

/// Entries of all tables.
const TABLE: usize = 256 * Evidence::COUNT;

/// Weight of a particle whose place the plan calls a wall or unknown: exp(-6), not zero (algorithms note 2).
const OFF_PLAN: f32 = -6.0;
/// Probability of no return with a wall within a metre (recorded: 0.4 %; doubled for dark or slanted walls), against the
/// typical 10 % with none. Half of its logarithm is used: weak evidence.
const NO_RETURN_NEAR: f64 = 0.01;
const NO_RETURN_ELSEWHERE: f64 = 0.10;
/// A probe closer to a wall than this says that there is a wall, m.
const PROBE_M: f64 = 0.12;

/// How far readings end from the walls they mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadingNoise {
    /// Deviation of a near time-of-flight ray, m.
    pub ray_std_m: f64,
    /// Deviation of a near cone, m.
    pub cone_std_m: f64,
    /// Deviation of a laser beam, m.
    pub laser_std_m: f64,
    /// Share of readings that mean nothing.
    pub random_share: f64,
}

impl From<&EstimatorParams> for ReadingNoise {
    fn from(params: &EstimatorParams) -> Self {
        Self {
            ray_std_m: params.ray_std_m,
            cone_std_m: params.cone_std_m,
            laser_std_m: params.laser_std_m,
            random_share: params.random_share,
        }
    }
}

/// Log-likelihood tables.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorModel {
    tables: Vec<f32>,
}

/// The readings of one update, seen from the reference pose, in units of cells: structure of arrays, allocated once.
#[derive(Clone, Debug, Default)]
pub struct Readings {
    /// By kind, so that readings of one kind are looked up in one table.
    rays: [Rays; Evidence::COUNT],
    cones_x: Vec<[f32; 3]>,
    cones_y: Vec<[f32; 3]>,
    cones_table: Vec<u32>,
}

/// Rays of one kind.
#[derive(Clone, Debug, Default)]
struct Rays {
    x: Vec<f32>,
    y: Vec<f32>,
}

impl Readings {
    pub(crate) fn with_capacity() -> Self {
        Self {
            rays: core::array::from_fn(|_| Rays {
                x: Vec::with_capacity(MAX_READINGS),
                y: Vec::with_capacity(MAX_READINGS),
            }),
            cones_x: Vec::with_capacity(MAX_READINGS),
            cones_y: Vec::with_capacity(MAX_READINGS),
            cones_table: Vec::with_capacity(MAX_READINGS),
        }
    }

    pub(crate) fn clear(&mut self) {
        for rays in &mut self.rays {
            rays.x.clear();
            rays.y.clear();
        }
        self.cones_x.clear();
        self.cones_y.clear();
        self.cones_table.clear();
    }

    /// Adds a reading given in the axes of the reference pose; more than [`MAX_READINGS`] are dropped.
    pub(crate) fn push(&mut self, beam: &LevelBeam, field: &Field) {
        if self.len() >= MAX_READINGS {
            return;
        }
        let cells = |v: f64| (v / field.cell_m()) as f32;
        if beam.is_ray() {
            let rays = &mut self.rays[beam.evidence as usize];
            rays.x.push(cells(beam.points[0][0]));
            rays.y.push(cells(beam.points[0][1]));
        } else {
            self.cones_x.push(beam.points.map(|p| cells(p[0])));
            self.cones_y.push(beam.points.map(|p| cells(p[1])));
            self.cones_table.push(256 * beam.evidence as u32);
        }
    }

    /// Number of readings.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rays.iter().map(|r| r.x.len()).sum::<usize>() + self.cones_x.len()
    }

    /// True without any reading.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl SensorModel {
    /// Tables for a deviation of near rays; farther rays and cones are wider in proportion.
    #[must_use]
    pub fn new(noise: &ReadingNoise) -> Self {
        let ReadingNoise {
            ray_std_m,
            cone_std_m,
            laser_std_m,
            random_share,
        } = *noise;
        let mut tables = vec![0.0; TABLE];
        let mut fill = |evidence: Evidence, std_m: f64, random: f64, weight: f64| {
            for code in 0..256usize {
                let d = code as f64 * CODE_M / std_m;
                let p = (1.0 - random) * libm::exp(-0.5 * d * d) + random;
                tables[256 * evidence as usize + code] = (weight * libm::log(p)) as f32;
            }
        };
        fill(Evidence::RayNear, ray_std_m, random_share, 1.0);
        fill(
            Evidence::RayMiddle,
            1.2 * ray_std_m,
            2.0 * random_share,
            0.9,
        );
        fill(Evidence::RayFar, 1.5 * ray_std_m, 3.0 * random_share, 0.7);
        fill(Evidence::Laser, laser_std_m, random_share, 1.0);
        fill(Evidence::ConeNear, cone_std_m, 2.0 * random_share, 1.0);
        fill(Evidence::ConeFar, 1.5 * cone_std_m, 4.0 * random_share, 0.7);
        let near = 0.5 * libm::log(NO_RETURN_NEAR / NO_RETURN_ELSEWHERE);
        for code in 0..256usize {
            let is_wall = (code as f64) * CODE_M < PROBE_M;
            tables[256 * Evidence::Nothing as usize + code] =
                if is_wall { near as f32 } else { 0.0 };
        }
        Self { tables }
    }

    /// Computes the log-likelihood of the readings for each particle.
    pub(crate) fn weigh(&self, field: &Field, readings: &Readings, particles: &mut Particles) {
        let inverse = (1.0 / field.cell_m()) as f32;
        let [ox, oy] = field.origin().map(|o| o as f32);
        // All rays in a row, kind by kind, and the table of each kind: 256 entries, so a code needs no check.
        let (mut rays_x, mut rays_y) = ([0.0f32; MAX_READINGS], [0.0f32; MAX_READINGS]);
        let mut kinds: ArrayVec<(Range<usize>, &[f32; 256]), { Evidence::COUNT }> = ArrayVec::new();
        let mut rays = 0;
        let (tables, _) = self.tables.as_chunks::<256>();
        for (kind, table) in readings.rays.iter().zip(tables) {
            let range = rays..rays + kind.x.len();
            rays_x[range.clone()].copy_from_slice(&kind.x);
            rays_y[range.clone()].copy_from_slice(&kind.y);
            rays = range.end;
            if !range.is_empty() {
                kinds.push((range, table));
            }
        }
        let (rays_x, rays_y) = (&rays_x[..rays], &rays_y[..rays]);
        let mut cells = [0u32; MAX_READINGS];
        let cells = &mut cells[..rays];
        for i in 0..particles.len() {
            let (s, c) = sin_cos(particles.yaw[i]);
            let u = (particles.x[i] - ox) * inverse;
            let v = (particles.y[i] - oy) * inverse;
            // Two loops: the first is arithmetic only and becomes vector instructions, the second looks up.
            field.indices([u, v, c, s], (rays_x, rays_y), cells);
            let mut sums = [0.0f32; 4];
            for (range, table) in &kinds {
                let value = |cell: u32| table[usize::from(field.code_of(cell))];
                let (fours, rest) = cells[range.clone()].as_chunks::<4>();
                for four in fours {
                    for (sum, cell) in sums.iter_mut().zip(four) {
                        *sum += value(*cell);
                    }
                }
                for (sum, cell) in sums.iter_mut().zip(rest) {
                    *sum += value(*cell);
                }
            }
            let mut sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
            let cones = readings
                .cones_x
                .iter()
                .zip(&readings.cones_y)
                .zip(&readings.cones_table);
            for ((x, y), table) in cones {
                let mut nearest = 255u8;
                for k in 0..3 {
                    let code = field.code(u + c * x[k] - s * y[k], v + s * x[k] + c * y[k]);
                    nearest = nearest.min(code);
                }
                sum += self.tables[*table as usize + usize::from(nearest)];
            }
            let place = if field.is_open_at(u, v) {
                0.0
            } else {
                OFF_PLAN
            };
            particles.log_likelihood[i] = sum + place;
        }
    }

    /// Log-likelihood of one reading with this smallest distance code.
    #[inline]
    pub(crate) fn log(&self, evidence: Evidence, code: u8) -> f32 {
        self.tables[256 * evidence as usize + usize::from(code)]
    }
}

/// A return from open floor, with nothing of the plan before it, counts this much against a pose: somebody may stand there.
/// A return from behind a wall counts in full.
const SHORT_COUNTS: f64 = 0.3;

/// True if the beam ends on open floor and met no wall on its way there.
fn falls_short(field: &Field, axes: &Axes, beam: &LevelBeam) -> bool {
    let from = axes.outward([0.0, 0.0]);
    beam.candidates().iter().any(|p| {
        let to = axes.outward(*p);
        let length = libm::hypot(to[0] - from[0], to[1] - from[1]);
        field.is_open(to[0], to[1]) && field.free_way_m(from, to) > length - 0.1
    })
}

/// What the returns of a scan say about a pose, by weight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Returns that end within 0.15 m (cones 0.25 m) of a wall.
    pub at_walls: f64,
    /// Returns from open floor with nothing of the plan before them: something stands there that the plan does not show.
    pub short: f64,
    /// Returns that nothing can stand for: from behind a wall, or from no floor.
    pub contradicting: f64,
}

impl Agreement {
    /// Share of the returns that end at a wall: 0..=1; none without returns.
    #[must_use]
    pub fn fit(&self) -> Option<f64> {
        let all = self.at_walls + SHORT_COUNTS * self.short + self.contradicting;
        (all > 0.0).then(|| self.at_walls / all)
    }

    /// Shares of all returns that fall short, and that contradict: 0..=1; none without returns.
    #[must_use]
    pub fn shares(&self) -> Option<[f64; 2]> {
        let all = self.at_walls + self.short + self.contradicting;
        (all > 0.0).then(|| [self.short / all, self.contradicting / all])
    }
}

/// Compares the returns with the plan as seen from a pose.
#[must_use]
pub fn agreement(field: &Field, beams: &[LevelBeam], pose: &Planar) -> Agreement {
    let mut sums = Agreement::default();
    let axes = pose.axes();
    for beam in beams.iter().filter(|b| b.is_hit()) {
        let (limit, weight) = match beam.evidence {
            Evidence::RayNear | Evidence::Laser => (0.15, 1.0),
            Evidence::RayMiddle => (0.15, 0.8),
            Evidence::RayFar => (0.20, 0.5),
            Evidence::ConeNear => (0.25, 1.0),
            Evidence::ConeFar | Evidence::Nothing => (0.30, 0.5),
        };
        let nearest = beam
            .candidates()
            .iter()
            .map(|p| {
                let [x, y] = axes.outward(*p);
                field.distance_m(x, y)
            })
            .fold(f64::INFINITY, f64::min);
        let sum = if nearest < limit {
            &mut sums.at_walls
        } else if falls_short(field, &axes, beam) {
            &mut sums.short
        } else {
            &mut sums.contradicting
        };
        *sum += weight;
    }
    sums
}
