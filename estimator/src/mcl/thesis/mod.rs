//! The localization of the SNSI thesis, selectable as `MCL_VARIANT = 1` to compare with: particles on a uniform grid,
//! distances to wall segments, product of Gaussians, resampling to a quarter, the likeliest particle as the pose.
//!
//! What its code got wrong is put right, each with its reason:
//!
//! | Thesis | Here |
//! | --- | --- |
//! | the getter of the sensor noise returns the turn noise | three separate values |
//! | the best index of the resampled list is looked up in the full one | the best particle itself |
//! | walls from the map were never computed | outline of the occupied cells |
//! | (0, 0) where a ray meets nothing | the ray's full length |
//! | product of bare Gaussians: one wild reading kills all | each mixed with a small uniform share |
//! | only forward motion | the step is a turn into its direction, a way, and the rest of the turn |
//! | one particle per cell and heading, whatever the plan | so many cells apart that at most [`MAX_START`] start |

pub mod geometry;

use super::beams::LevelBeam;
use super::bins::Bins;
use super::cluster;
use super::field::Field;
use super::locator::Fix;
use super::particles::Particles;
use super::planar::Planar;
use super::random::{Random, wrap};
use core::f64::consts::{PI, TAU};
use std::sync::Arc;
use vehicle::floor_plan::{Cell, Segment};
use vehicle::{FloorPlan, Localization, LocalizationState, MapPose, Timestamp};

/// Headings of the uniform start.
pub const HEADINGS: usize = 12;
/// Most particles at the start.
pub const MAX_START: usize = 60_000;
/// Resampling keeps this share of the population ...
const KEEPS: f64 = 0.25;
/// ... but not fewer than this, and this many around a told start.
const FEWEST: usize = 1_000;
/// Share of readings that mean nothing, spread over the length of a ray.
const RANDOM_SHARE: f64 = 0.05;
/// Readings of one update: more are thinned evenly.
const MAX_READINGS: usize = 32;
/// A way shorter than this has no direction, m.
const NO_WAY_M: f64 = 0.005;
/// An update is due after this way or turn, m and rad, or with this many readings.
const DUE_M: f64 = 0.10;
const DUE_RAD: f64 = 0.10;
/// Claimed from this share of particles near the estimate.
const CLAIM_MASS: f64 = 0.8;

/// Noise of motion and sensors (standard deviations); 0.02 each in the thesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThesisNoise {
    /// Of the turn in a step, rad.
    pub turn_rad: f64,
    /// Of the way in a step, m.
    pub forward_m: f64,
    /// Of a distance, m.
    pub sense_m: f64,
}

impl ThesisNoise {
    /// As in the thesis.
    pub const AS_WRITTEN: Self = Self {
        turn_rad: 0.02,
        forward_m: 0.02,
        sense_m: 0.02,
    };
    /// As recorded flights need it: hops of a metre, panels drawn as 5 cm cells.
    pub const AS_RECORDED: Self = Self {
        turn_rad: 0.06,
        forward_m: 0.12,
        sense_m: 0.15,
    };
}

/// Headings of the uniform start: `linspace(-pi + pi / n, pi, n)`.
pub fn headings(n: usize) -> impl Iterator<Item = f64> {
    let first = -PI + PI / n.max(1) as f64;
    let step = (PI - first) / (n.max(2) - 1) as f64;
    (0..n).map(move |k| first + k as f64 * step)
}

/// One pose per free cell (every `stride`-th in both directions) and heading.
#[must_use]
pub fn uniform_start(plan: &FloorPlan, stride: usize, n: usize) -> Vec<MapPose> {
    let stride = stride.max(1);
    let [ox, oy] = plan.origin();
    let r = plan.resolution_m();
    let mut poses = Vec::new();
    for row in (0..plan.height()).step_by(stride) {
        for column in (0..plan.width()).step_by(stride) {
            if plan.cell(column as i64, row as i64) != Cell::Free {
                continue;
            }
            let (x, y) = (ox + (column as f64 + 0.5) * r, oy + (row as f64 + 0.5) * r);
            poses.extend(headings(n).map(|yaw| MapPose::new(x, y, yaw)));
        }
    }
    poses
}

/// Probability density of a distance, mixed with a uniform share over `length` metres.
fn density(measured: f64, predicted: f64, std: f64, length: f64) -> f64 {
    let z = (measured - predicted) / std;
    let gauss = libm::exp(-0.5 * z * z) / (std * libm::sqrt(TAU));
    (1.0 - RANDOM_SHARE) * gauss + RANDOM_SHARE / length
}

/// The thesis filter with the same doors as [`Locator`](super::Locator).
#[derive(Clone, Debug)]
pub struct ThesisLocator {
    field: Arc<Field>,
    walls: Vec<Segment>,
    start: Vec<MapPose>,
    bounds: [[f32; 2]; 2],
    length_m: f64,
    noise: ThesisNoise,
    particles: Particles,
    cumulative: Vec<f64>,
    drawn: [Vec<f32>; 3],
    bins: Bins,
    random: Random,
    pending: Vec<[f64; 2]>,
    newest: Option<(Timestamp, Planar)>,
    updated: Option<(Timestamp, Planar)>,
    status: Localization,
    covariance: [[f64; 3]; 3],
}

impl ThesisLocator {
    /// A filter on a plan, without particles.
    #[must_use]
    pub fn new(noise: ThesisNoise, plan: &FloorPlan, seed: u64) -> Self {
        let mut stride = 1;
        let mut start = uniform_start(plan, stride, HEADINGS);
        while start.len() > MAX_START {
            stride += 1;
            start = uniform_start(plan, stride, HEADINGS);
        }
        let [ox, oy] = plan.origin();
        let r = plan.resolution_m();
        let (w, h) = (plan.width() as f64 * r, plan.height() as f64 * r);
        let capacity = start.len().max(FEWEST);
        let room = || Vec::with_capacity(capacity);
        Self {
            field: Arc::new(Field::new(plan)),
            walls: plan.wall_segments(),
            start,
            bounds: [[ox as f32, oy as f32], [(ox + w) as f32, (oy + h) as f32]],
            length_m: libm::hypot(w, h),
            noise,
            particles: Particles::with_capacity(capacity),
            cumulative: Vec::with_capacity(capacity),
            drawn: [room(), room(), room()],
            bins: Bins::new(),
            random: Random::new(seed),
            pending: Vec::with_capacity(4 * MAX_READINGS),
            newest: None,
            updated: None,
            status: Localization::default(),
            covariance: [[0.0; 3]; 3],
        }
    }

    /// Particles around a told pose.
    pub fn start_at(&mut self, pose: MapPose, std_xy_m: f64, std_yaw_rad: f64) {
        self.forget();
        self.particles
            .push_around(&pose, std_xy_m, std_yaw_rad, FEWEST, 1.0, &mut self.random);
        self.particles.equalise();
        self.status.pose = Some(pose);
    }

    /// One particle per free cell and heading.
    pub fn start_unknown(&mut self) {
        self.forget();
        for pose in &self.start {
            let (x, y, yaw) = (pose.x_m as f32, pose.y_m as f32, pose.yaw_rad as f32);
            self.particles.push(x, y, yaw, 1.0);
        }
        self.particles.equalise();
    }

    fn forget(&mut self) {
        self.particles.clear();
        self.pending.clear();
        self.updated = None;
        self.status = Localization {
            state: LocalizationState::Searching,
            reset_counter: self.status.reset_counter,
            ..Localization::default()
        };
    }

    /// What is known.
    #[must_use]
    pub const fn status(&self) -> &Localization {
        &self.status
    }

    /// Covariance of the cluster around the pose: x, y, yaw, m2, m rad, rad2.
    #[must_use]
    pub const fn covariance(&self) -> [[f64; 3]; 3] {
        self.covariance
    }

    /// Odometry pose of the last update.
    #[must_use]
    pub fn updated_at(&self) -> Option<Planar> {
        self.updated.map(|(_, odometry)| odometry)
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

    /// Adds readings about the body, taken at an odometry pose.
    pub fn add(&mut self, at: Timestamp, odometry: &Planar, beams: &[LevelBeam]) {
        if !odometry.is_finite() {
            return;
        }
        if self.newest.is_none_or(|(t, _)| at >= t) {
            self.newest = Some((at, *odometry));
        }
        let axes = odometry.axes();
        for beam in beams.iter().filter(|b| b.is_hit()) {
            if self.pending.len() < self.pending.capacity() {
                self.pending.push(axes.outward(beam.points[1]));
            }
        }
    }

    /// Moves, weighs and resamples if the vehicle has moved on.
    pub fn update(&mut self) -> Option<Fix> {
        let (at, odometry) = self.newest?;
        let step = self
            .updated
            .map_or_else(Planar::default, |(_, last)| last.step_to(&odometry));
        let moved = step.length() >= DUE_M || step.yaw.abs() >= DUE_RAD || self.updated.is_none();
        if self.pending.is_empty() || !moved || self.particles.is_empty() {
            return None;
        }
        self.updated = Some((at, odometry));
        self.go(&step);
        self.weigh(&odometry);
        self.pending.clear();
        let best = self.resample()?;
        let near = cluster::around(&self.particles, &best)?;
        self.covariance = near.covariance;
        self.status.mass = near.mass;
        self.status.pose = Some(best.into());
        self.status.particles = self.particles.len() as u32;
        self.status.fit = near.mass;
        let was = self.status.state == LocalizationState::Localized;
        let is_claimed = near.mass > CLAIM_MASS;
        self.status.state = match (is_claimed, was) {
            (true, _) => LocalizationState::Localized,
            (false, true) => LocalizationState::Lost,
            (false, false) => self.status.state,
        };
        let is_jump = is_claimed && !was;
        if is_jump {
            self.status.reset_counter = self.status.reset_counter.wrapping_add(1);
        }
        is_claimed.then_some(Fix {
            at,
            pose: best.into(),
            odometry,
            covariance: near.covariance,
            is_jump,
            news: 1.0,
        })
    }

    fn go(&mut self, step: &Planar) {
        let way = step.length();
        let first = if way > NO_WAY_M {
            libm::atan2(step.y, step.x)
        } else {
            0.0
        };
        let rest = (step.yaw - first) as f32;
        let (turn, forward) = (self.noise.turn_rad as f32, self.noise.forward_m as f32);
        let p = &mut self.particles;
        for i in 0..p.len() {
            let theta = p.yaw[i] + first as f32 + turn * self.random.gaussian();
            let rho = way as f32 + forward * self.random.gaussian();
            let (s, c) = (libm::sinf(theta), libm::cosf(theta));
            p.x[i] = (p.x[i] + rho * c).clamp(self.bounds[0][0], self.bounds[1][0]);
            p.y[i] = (p.y[i] + rho * s).clamp(self.bounds[0][1], self.bounds[1][1]);
            p.yaw[i] = wrap(theta + rest);
        }
    }

    fn weigh(&mut self, odometry: &Planar) {
        let axes = odometry.axes();
        let every = self.pending.len().div_ceil(MAX_READINGS).max(1);
        let mut readings = [[0.0; 2]; MAX_READINGS];
        let mut n = 0;
        for point in self.pending.iter().step_by(every) {
            let [x, y] = axes.inward(*point);
            readings[n] = [libm::hypot(x, y), libm::atan2(y, x)];
            n += 1;
        }
        let p = &mut self.particles;
        for i in 0..p.len() {
            let at = [f64::from(p.x[i]), f64::from(p.y[i])];
            let mut sum = 0.0;
            for [measured, bearing] in &readings[..n] {
                let direction = f64::from(p.yaw[i]) + bearing;
                let end = [
                    at[0] + self.length_m * libm::cos(direction),
                    at[1] + self.length_m * libm::sin(direction),
                ];
                let predicted = geometry::nearest(at, end, &self.walls)
                    .map_or(self.length_m, |(_, hit)| geometry::distance(at, hit));
                let p = density(*measured, predicted, self.noise.sense_m, self.length_m);
                sum += libm::log(p);
            }
            p.log_weight[i] = sum as f32;
        }
        p.normalise();
        self.status.effective_particles = p.effective();
    }

    /// Draws with replacement; the likeliest of those drawn is the pose.
    fn resample(&mut self) -> Option<Planar> {
        let p = &mut self.particles;
        let n = p.len();
        let count = ((n as f64 * KEEPS) as usize).clamp(FEWEST, p.capacity());
        self.cumulative.clear();
        let mut sum = 0.0;
        for w in &p.weight {
            sum += f64::from(*w);
            self.cumulative.push(sum);
        }
        for column in &mut self.drawn {
            column.clear();
        }
        let mut best: Option<(f32, usize)> = None;
        for _ in 0..count {
            let u = f64::from(self.random.uniform()) * sum;
            let i = self.cumulative.partition_point(|c| *c < u).min(n - 1);
            for (column, from) in self.drawn.iter_mut().zip([&p.x, &p.y, &p.yaw]) {
                column.push(from[i]);
            }
            if best.is_none_or(|(w, _)| p.weight[i] > w) {
                best = Some((p.weight[i], i));
            }
        }
        let (_, i) = best?;
        let pose = Planar::new(f64::from(p.x[i]), f64::from(p.y[i]), f64::from(p.yaw[i]));
        p.clear();
        let [x, y, yaw] = &self.drawn;
        for ((x, y), yaw) in x.iter().zip(y).zip(yaw) {
            p.push(*x, *y, *yaw, 1.0);
        }
        p.equalise();
        // The heaviest bin is looked at so that a pose nobody shares is not taken for one that many do.
        cluster::heaviest(p, Some(&pose), &mut self.bins).map(|_| pose)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_a_10_by_10_identity_map_has_90_free_cells_times_headings() {
        let cells = (0..100)
            .map(|i| {
                if i % 10 == i / 10 {
                    Cell::Occupied
                } else {
                    Cell::Free
                }
            })
            .collect();
        let plan = FloorPlan::from_cells(10, 1.0, [0.0, 0.0], cells).unwrap();
        assert_eq!(uniform_start(&plan, 1, 1).len(), 90);
        assert_eq!(uniform_start(&plan, 1, HEADINGS).len(), 90 * 12);
    }

    #[test]
    fn golden_headings_are_linspace_from_minus_pi_plus_pi_over_n_to_pi() {
        let h: Vec<f64> = headings(12).collect();
        assert!((h[0] - (-PI + PI / 12.0)).abs() < 1e-12 && (h[11] - PI).abs() < 1e-12);
        let step = h[1] - h[0];
        assert!(h.windows(2).all(|w| (w[1] - w[0] - step).abs() < 1e-12));
    }

    #[test]
    fn golden_gaussian_of_the_thesis_with_a_uniform_floor() {
        // 1 / sqrt(2 pi 0.02^2) at the mean.
        let peak = density(1.0, 1.0, 0.02, 10.0);
        assert!((peak - (0.95 * 19.947_114_020 + 0.005)).abs() < 1e-6);
        assert!((density(1.0, 5.0, 0.02, 10.0) - 0.005).abs() < 1e-12);
    }

    #[test]
    fn two_poses_weigh_as_the_densities_of_what_each_should_read_and_all_together_one() {
        // A square of 3 m inside walls: their faces are at 0.5 and 3.5 m.
        let cells = (0..64)
            .map(|i| {
                let is_wall = [i % 8, i / 8].iter().any(|c| *c == 0 || *c == 7);
                if is_wall { Cell::Occupied } else { Cell::Free }
            })
            .collect();
        let plan = FloorPlan::from_cells(8, 0.5, [0.0, 0.0], cells).unwrap();
        let noise = ThesisNoise {
            sense_m: 0.1,
            ..ThesisNoise::AS_WRITTEN
        };
        let mut filter = ThesisLocator::new(noise, &plan, 1);
        for x in [3.0, 2.9] {
            filter.particles.push(x, 2.0, 0.0, 1.0);
        }
        filter.pending.push([0.52, 0.0]);
        filter.weigh(&Planar::default());
        let [near, far] = [0, 1].map(|i| f64::from(filter.particles.weight[i]));
        let length = filter.length_m;
        let ratio = density(0.52, 0.5, 0.1, length) / density(0.52, 0.6, 0.1, length);
        assert!((near / far - ratio).abs() < 1e-4 * ratio, "{near} {far}");
        assert!((near + far - 1.0).abs() < 1e-6);
    }
}
