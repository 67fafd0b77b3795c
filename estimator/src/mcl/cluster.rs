//! The pose that the particles mean: mean and covariance of the heaviest cluster.

use super::bins::Bins;
use super::particles::Particles;
use super::planar::Planar;
use super::random::wrap;

/// Particles within this of the mean belong to the cluster.
pub const RADIUS_M: f64 = 0.5;
/// Particles turned less than this against the mean belong to the cluster, rad.
pub const RADIUS_RAD: f64 = 0.6;
/// Bins for finding it, per metre and per radian (0.4 m, 0.4 rad).
const PER_M: f32 = 2.5;
const PER_RAD: f32 = 2.5;

/// Particles summed at once in f32, and side by side.
const BLOCK: usize = 128;
const LANES: usize = 8;

/// Particles that mean the same place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// Weighted mean on the plan; yaw is the circular mean.
    pub pose: Planar,
    /// Share of all weight, 0..=1.
    pub mass: f64,
    /// Covariance of x, y, yaw on the plan, m2, m rad, rad2.
    pub covariance: [[f64; 3]; 3],
}

/// The heaviest cluster. `hint` says where it was: a cluster there with more than half of all weight has no rival.
pub fn heaviest(particles: &Particles, hint: Option<&Planar>, bins: &mut Bins) -> Option<Cluster> {
    if let Some(there) = hint.and_then(|hint| around(particles, hint))
        && there.mass > 0.5
    {
        return around(particles, &there.pose);
    }
    bins.clear();
    for i in 0..particles.len() {
        let key = Bins::key(
            particles.x[i],
            particles.y[i],
            particles.yaw[i],
            PER_M,
            PER_RAD,
        );
        bins.add(key, particles.weight[i]);
    }
    let key = bins.heaviest()?;
    // A particle of that bin, then mean shift: the mean no longer knows about bin borders.
    let first = (0..particles.len()).find(|i| {
        Bins::key(
            particles.x[*i],
            particles.y[*i],
            particles.yaw[*i],
            PER_M,
            PER_RAD,
        ) == key
    })?;
    let mut seed = Planar::new(
        f64::from(particles.x[first]),
        f64::from(particles.y[first]),
        f64::from(particles.yaw[first]),
    );
    seed = around(particles, &seed)?.pose;
    around(particles, &seed)
}

/// The cluster around a pose; none if no weight is near.
#[must_use]
pub fn around(particles: &Particles, pose: &Planar) -> Option<Cluster> {
    let (cx, cy, cyaw) = (pose.x as f32, pose.y as f32, pose.yaw as f32);
    let (r2, turn) = ((RADIUS_M * RADIUS_M) as f32, RADIUS_RAD as f32);
    // Sums relative to the pose: no wrap, no loss of digits. Blocks are summed in f32 without branches, as vectors.
    let (mut mass, mut first, mut second) = (0.0f64, [0.0f64; 3], [0.0f64; 6]);
    let n = particles.len();
    for begin in (0..n).step_by(BLOCK) {
        let block = begin..(begin + BLOCK).min(n);
        let mut sums = [[0.0f32; LANES]; 10];
        let columns = [
            &particles.x[block.clone()],
            &particles.y[block.clone()],
            &particles.yaw[block.clone()],
            &particles.weight[block],
        ];
        let lanes = columns.map(|c| c.as_chunks::<LANES>());
        let [(x, x_rest), (y, y_rest), (yaw, yaw_rest), (w, w_rest)] = lanes;
        let mut add = |x: &[f32; LANES], y: &[f32; LANES], yaw: &[f32; LANES], w: &[f32; LANES]| {
            for k in 0..LANES {
                let (dx, dy) = (x[k] - cx, y[k] - cy);
                let dyaw = wrap(yaw[k] - cyaw);
                let is_near = (dx * dx + dy * dy <= r2) & (dyaw.abs() <= turn);
                let w = if is_near { w[k] } else { 0.0 };
                let (wx, wy, wt) = (w * dx, w * dy, w * dyaw);
                let terms = [
                    w,
                    wx,
                    wy,
                    wt,
                    wx * dx,
                    wx * dy,
                    wx * dyaw,
                    wy * dy,
                    wy * dyaw,
                    wt * dyaw,
                ];
                for (sum, term) in sums.iter_mut().zip(terms) {
                    sum[k] += term;
                }
            }
        };
        for (((x, y), yaw), w) in x.iter().zip(y).zip(yaw).zip(w) {
            add(x, y, yaw, w);
        }
        let padded = |rest: &[f32]| {
            let mut lanes = [0.0; LANES];
            lanes[..rest.len()].copy_from_slice(rest);
            lanes
        };
        add(
            &padded(x_rest),
            &padded(y_rest),
            &padded(yaw_rest),
            &padded(w_rest),
        );
        let total = |k: usize| f64::from(sums[k].iter().sum::<f32>());
        mass += total(0);
        for (i, f) in first.iter_mut().enumerate() {
            *f += total(1 + i);
        }
        for (i, s) in second.iter_mut().enumerate() {
            *s += total(4 + i);
        }
    }
    if mass.is_nan() || mass < 1e-9 {
        return None;
    }
    let mean = first.map(|s| s / mass);
    let c = |k: usize, i: usize, j: usize| second[k] / mass - mean[i] * mean[j];
    let (xx, xy, xt, yy, yt, tt) = (
        c(0, 0, 0),
        c(1, 0, 1),
        c(2, 0, 2),
        c(3, 1, 1),
        c(4, 1, 2),
        c(5, 2, 2),
    );
    Some(Cluster {
        pose: Planar::new(
            pose.x + mean[0],
            pose.y + mean[1],
            vehicle::angle::wrap_pi(pose.yaw + mean[2]),
        ),
        mass: mass.min(1.0),
        covariance: [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcl::random::Random;
    use core::f64::consts::PI;
    use vehicle::MapPose;

    #[test]
    fn the_heavier_of_two_clusters_is_found_with_its_mass_and_spread_across_the_wrap_of_yaw() {
        let mut p = Particles::with_capacity(2000);
        let mut random = Random::new(3);
        p.push_around(
            &MapPose::new(1.2, 2.0, PI - 0.01),
            0.1,
            0.1,
            1000,
            0.7,
            &mut random,
        );
        p.push_around(
            &MapPose::new(5.0, 2.0, 0.0),
            0.1,
            0.1,
            1000,
            0.3,
            &mut random,
        );
        let c = heaviest(&p, None, &mut Bins::new()).unwrap();
        assert!(
            c.pose
                .is_near(&Planar::new(1.2, 2.0, PI - 0.01), 0.02, 0.02),
            "{c:?}"
        );
        assert!((c.mass - 0.7).abs() < 0.01);
        assert!((c.covariance[0][0].sqrt() - 0.1).abs() < 0.01);
        assert!((c.covariance[2][2].sqrt() - 0.1).abs() < 0.01);
    }
}
