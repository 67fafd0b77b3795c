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

/// No resampling on scans that are mostly old news.
const RESAMPLE_NEWS: f64 = 0.2;
/// Evidence that would leave a smaller effective share of the set than this is taken in stages ...
const STARVED: f64 = 0.1;
/// ... of which each leaves this share ...
const STAGE_KEEPS: f64 = 0.5;
/// ... at most this many ...
const STAGES: usize = 6;
/// ... and spreads the copies by this part of the cluster's deviation.
const STAGE_JITTER: f64 = 0.25;

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
                0.06,
                0.05,
                n.max(1),
                (share * portion) as f32,
                &mut self.random,
            );
        }
        self.particles.normalise();
    }

    /// One update: moves by an odometry step (noise scaled by `noise_scale`), weighs with readings given in the axes of
    /// the pose after the step. `news` (0..=1) says how much of the scan is new: a vehicle standing still sees the same
    /// walls with the same errors, which is no further evidence, and then never resamples.
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
        let heaviest = cluster::heaviest(&self.particles, &mut self.bins)?;
        let effective = self.particles.effective();
        let n = self.particles.len();
        let wanted = self.wanted();
        let is_poor = effective < self.resample_below * n as f64;
        let is_oversized = n > wanted + wanted / 2;
        if !self.readings.is_empty() && (is_poor || is_oversized) && news > RESAMPLE_NEWS {
            self.particles.resample(wanted, &mut self.random);
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
        let n = self.particles.len();
        let mut rest = scale;
        for stage in 0..STAGES {
            self.sensor
                .weigh(&self.field, &self.readings, &mut self.particles);
            let portion = if may_resample && stage + 1 < STAGES {
                self.bearable(rest)
            } else {
                rest
            };
            self.particles.weigh(portion);
            self.particles.normalise();
            rest -= portion;
            if rest <= 0.0 {
                return;
            }
            let Some(heaviest) = cluster::heaviest(&self.particles, &mut self.bins) else {
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
        if self.particles.effective_after(rest) >= STARVED * n {
            return rest;
        }
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

    fn wanted(&mut self) -> usize {
        self.bins.clear();
        let light = KLD_LIGHT / self.particles.len() as f32;
        for i in 0..self.particles.len() {
            if self.particles.weight[i] > light {
                let (x, y, yaw) = (
                    self.particles.x[i],
                    self.particles.y[i],
                    self.particles.yaw[i],
                );
                self.bins
                    .add(Bins::key(x, y, yaw, KLD_PER_M, KLD_PER_RAD), 0.0);
            }
        }
        kld_size(self.bins.count(), self.kld_error).clamp(self.smallest, self.particles.capacity())
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
