//! The particle filter: move, weigh, estimate, resample.

use super::beams::LevelBeam;
use super::bins::{Bins, kld_size};
use super::cluster::{self, Cluster};
use super::drift::Drift;
use super::field::Field;
use super::motion::MotionNoise;
use super::particles::Particles;
use super::planar::Planar;
use super::random::Random;
use super::sensor::{Readings, SensorModel};
use crate::EstimatorParams;
use std::sync::Arc;
use vehicle::MapPose;

/// Bins for the size of the set: 0.1 m and 10 degrees.
const KLD_PER_M: f32 = 10.0;
const KLD_PER_RAD: f32 = 5.73;
/// Particles lighter than this share of the average do not count as a place.
const KLD_LIGHT: f32 = 0.1;

/// The size of the set is looked at when it is resampled, and every so many updates.
const SIZE_EVERY: u32 = 4;
/// Bins of place on a side of the square around the cluster where counting needs no hashing; yaw is a bit of the word.
const WINDOW: usize = 32;
/// No resampling on scans that are mostly old news ...
const RESAMPLE_NEWS: f64 = 0.2;
/// ... unless the effective share of the set falls below this: particles walk with odometry's noise in hover too, and weights that
/// only ever multiply end on a single one of them.
const STARVING: f64 = 0.3;
/// Evidence that would leave a smaller effective share of the set than this is taken in stages ...
const STARVED: f64 = 0.1;
/// ... of which each leaves this share ...
const STAGE_KEEPS: f64 = 0.5;
/// ... at most this many ...
const STAGES: usize = 6;
/// ... and spreads the copies by this part of the cluster's deviation.
const STAGE_JITTER: f64 = 0.25;

/// Particles lie so wide around the places that a search has found, m and rad.
pub(super) const SEEDED_STD_M: f64 = 0.06;
/// See [`SEEDED_STD_M`].
pub(super) const SEEDED_STD_RAD: f64 = 0.05;

/// What one update did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Updated {
    /// The heaviest cluster.
    pub heaviest: Cluster,
    /// Effective sample size before resampling.
    pub effective: f64,
}

/// Monte Carlo localization on one plan.
#[derive(Clone, Debug)]
pub struct ParticleFilter {
    field: Arc<Field>,
    sensor: SensorModel,
    noise: MotionNoise,
    drift: Drift,
    particles: Particles,
    bins: Bins,
    readings: Readings,
    random: Random,
    /// Where the heaviest cluster was.
    heaviest: Option<Planar>,
    /// Updates since the size of the set was looked at.
    unsized_for: u32,
    window: Box<[u64; WINDOW * WINDOW]>,
    smallest: usize,
    effective_beams: f64,
    kld_error: f64,
    resample_below: f64,
}

impl ParticleFilter {
    /// A filter without particles.
    #[must_use]
    pub fn new(params: &EstimatorParams, field: Arc<Field>, seed: u64) -> Self {
        let largest = params.particles_max.max(1) as usize;
        Self {
            field,
            sensor: SensorModel::new(&params.into()),
            noise: MotionNoise {
                position_per_m: params.motion_per_m,
                ..MotionNoise::default()
            },
            drift: Drift::default(),
            particles: Particles::with_capacity(largest),
            bins: Bins::new(),
            readings: Readings::with_capacity(),
            random: Random::new(seed),
            heaviest: None,
            unsized_for: 0,
            window: Box::new([0; WINDOW * WINDOW]),
            smallest: (params.particles_min.max(1) as usize).min(largest),
            effective_beams: params.effective_beams,
            kld_error: params.kld_error,
            resample_below: params.resample_below,
        }
    }

    /// The particles.
    #[must_use]
    pub const fn particles(&self) -> &Particles {
        &self.particles
    }

    /// The plan's table.
    #[must_use]
    pub const fn field(&self) -> &Arc<Field> {
        &self.field
    }

    /// What is known about odometry's errors.
    #[must_use]
    pub const fn drift(&self) -> &Drift {
        &self.drift
    }

    /// Tells whether the ranges confirm a place, and where odometry is there: what drift is learned from.
    pub fn learn(&mut self, confirmed: Option<&Cluster>, odometry: &Planar) {
        match confirmed {
            Some(cluster) => self.drift.confirmed(cluster, odometry),
            None => self.drift.interrupt(),
        }
    }

    /// Removes all particles.
    pub fn clear(&mut self) {
        self.particles.clear();
    }

    /// All particles around one pose.
    pub fn start_around(&mut self, pose: &MapPose, std_xy_m: f64, std_yaw_rad: f64) {
        self.particles.clear();
        let count = self.particles.capacity();
        self.particles
            .push_around(pose, std_xy_m, std_yaw_rad, count, 1.0, &mut self.random);
        self.particles.normalise();
    }

    /// Puts `portion` of all weight on particles around the given poses, by their shares; the rest stays where it is.
    pub fn start_at_peaks(
        &mut self,
        peaks: impl Iterator<Item = (MapPose, f64)> + Clone,
        portion: f64,
    ) {
        let sum: f64 = peaks.clone().map(|(_, share)| share).sum();
        if sum.is_nan() || sum <= 0.0 {
            return;
        }
        let capacity = self.particles.capacity();
        let kept = if portion < 1.0 && !self.particles.is_empty() {
            let kept = ((1.0 - portion) * capacity as f64) as usize;
            self.particles.resample(kept.max(1), &mut self.random);
            for (w, l) in self
                .particles
                .weight
                .iter_mut()
                .zip(&mut self.particles.log_weight)
            {
                *w *= (1.0 - portion) as f32;
                *l = libm::logf(w.max(1e-30));
            }
            self.particles.len()
        } else {
            self.particles.clear();
            0
        };
        let room = capacity - kept;
        let count = peaks.clone().count().max(1);
        for (pose, share) in peaks {
            let share = share / sum;
            // Half by share, half evenly: a doubtful place keeps enough particles to be judged.
            let n = ((0.5 * share + 0.5 / count as f64) * room as f64) as usize;
            self.particles.push_around(
                &pose,
                SEEDED_STD_M,
                SEEDED_STD_RAD,
                n.max(1),
                (share * portion) as f32,
                &mut self.random,
            );
        }
        self.particles.normalise();
    }

    /// One update: moves by an odometry step (noise scaled by `noise_scale`), weighs with readings given in the axes of
    /// the pose after the step. `news` (0..=1) says how much of the scan is new: a vehicle standing still sees the same
    /// walls with the same errors, which is little further evidence, and then resamples only before the set starves.
    pub fn update(
        &mut self,
        step: &Planar,
        noise_scale: f64,
        beams: &[LevelBeam],
        news: f64,
    ) -> Option<Updated> {
        if self.particles.is_empty() || !step.is_finite() {
            return None;
        }
        let noise = MotionNoise {
            position_per_m: self.noise.position_per_m * noise_scale,
            position_m: self.noise.position_m * noise_scale,
            ..self.noise
        };
        let noise = self.drift.widened(&noise);
        self.drift.moved(step, self.noise.std_of(step));
        let step = &self.drift.corrected(step);
        noise.apply(step, &mut self.particles, &mut self.random);
        self.readings.clear();
        for beam in beams {
            self.readings.push(beam, &self.field);
        }
        if !self.readings.is_empty() {
            let n = self.readings.len() as f64;
            let scale = (self.effective_beams / n).min(1.0) * news.clamp(0.0, 1.0);
            self.weigh(scale as f32, news > RESAMPLE_NEWS);
        }
        let hint = self.heaviest.map(|pose| pose.then(step));
        let heaviest = cluster::heaviest(&self.particles, hint.as_ref(), &mut self.bins)?;
        self.heaviest = Some(heaviest.pose);
        let effective = self.particles.effective();
        let n = self.particles.len();
        let is_poor = effective < self.resample_below * n as f64;
        self.unsized_for += 1;
        let may_shrink = n > self.smallest && self.unsized_for >= SIZE_EVERY;
        let is_starving = effective < STARVING * n as f64;
        let may_resample = news > RESAMPLE_NEWS && (is_poor || may_shrink);
        if !self.readings.is_empty() && (is_starving || may_resample) {
            self.unsized_for = 0;
            let wanted = self.wanted(&heaviest.pose);
            if is_poor || n > wanted + wanted / 2 {
                self.particles.resample(wanted, &mut self.random);
            }
        }
        Some(Updated {
            heaviest,
            effective,
        })
    }

    /// Weighs with the readings. If that would leave next to nothing of the set (after a long step the particles are
    /// far wider than what the readings say), it is done in stages: as much evidence as half of the set survives, resample,
    /// spread the copies a little, and so on (regularised and annealed particle filter: Musso, Oudjane, Le Gland 2001;
    /// Deutscher, Blake, Reid 2000).
    fn weigh(&mut self, scale: f32, may_resample: bool) {
        let mut rest = scale;
        for stage in 0..STAGES {
            self.sensor
                .weigh(&self.field, &self.readings, &mut self.particles);
            // All at once, as nearly always is right; taken back if that leaves too little.
            self.particles.weigh(rest);
            self.particles.normalise();
            let n = self.particles.len();
            if !may_resample
                || stage + 1 == STAGES
                || self.particles.effective() >= STARVED * n as f64
            {
                return;
            }
            self.particles.weigh(-rest);
            let portion = self.bearable(rest);
            self.particles.weigh(portion);
            self.particles.normalise();
            rest -= portion;
            let Some(heaviest) = cluster::heaviest(&self.particles, None, &mut self.bins) else {
                return;
            };
            self.particles.resample(n, &mut self.random);
            let root = root_of(&heaviest.covariance, STAGE_JITTER);
            self.particles.jitter(&root, &mut self.random);
        }
    }

    /// How much of the evidence the set can take at once.
    fn bearable(&self, rest: f32) -> f32 {
        let n = self.particles.len() as f64;
        let (mut low, mut high) = (0.0, rest);
        for _ in 0..8 {
            let middle = 0.5 * (low + high);
            if self.particles.effective_after(middle) >= STAGE_KEEPS * n {
                low = middle;
            } else {
                high = middle;
            }
        }
        low.max(0.02 * rest)
    }

    /// Size of the set by KLD sampling.
    fn wanted(&mut self, around: &Planar) -> usize {
        self.bins.clear();
        self.window.fill(0);
        let half = WINDOW as f32 / (2.0 * KLD_PER_M);
        let (x0, y0) = (around.x as f32 - half, around.y as f32 - half);
        let light = KLD_LIGHT / self.particles.len() as f32;
        let p = &self.particles;
        for (((x, y), yaw), weight) in p.x.iter().zip(&p.y).zip(&p.yaw).zip(&p.weight) {
            if *weight <= light {
                continue;
            }
            let (u, v) = ((x - x0) * KLD_PER_M, (y - y0) * KLD_PER_M);
            let limit = WINDOW as f32;
            if u >= 0.0 && v >= 0.0 && u < limit && v < limit {
                // 36 bins of yaw: half a turn below zero is bin 0.
                let bit = ((yaw + core::f32::consts::PI) * KLD_PER_RAD) as u32 & 63;
                self.window[(v as usize & 31) * WINDOW + (u as usize & 31)] |= 1 << bit;
            } else {
                self.bins
                    .add(Bins::key(*x, *y, *yaw, KLD_PER_M, KLD_PER_RAD), 0.0);
            }
        }
        let near: u32 = self.window.iter().map(|w| w.count_ones()).sum();
        kld_size(self.bins.count() + near as usize, self.kld_error)
            .clamp(self.smallest, self.particles.capacity())
    }
}

/// Lower-triangular root of a covariance (Cholesky), scaled; zero rows where it is not positive.
fn root_of(covariance: &[[f64; 3]; 3], scale: f64) -> [[f32; 3]; 3] {
    let mut root = [[0.0f64; 3]; 3];
    for i in 0..3 {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| root[i][k] * root[j][k]).sum();
            let rest = covariance[i][j] - known;
            root[i][j] = if i == j {
                libm::sqrt(rest.max(0.0))
            } else if root[j][j] > 1e-12 {
                rest / root[j][j]
            } else {
                0.0
            };
        }
    }
    root.map(|row| row.map(|v| (v * scale) as f32))
}
