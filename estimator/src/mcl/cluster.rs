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

/// The heaviest cluster.
pub fn heaviest(particles: &Particles, bins: &mut Bins) -> Option<Cluster> {
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
    // Sums relative to the pose: no wrap, no loss of digits.
    let (mut mass, mut first, mut second) = (0.0f64, [0.0f64; 3], [0.0f64; 6]);
    for i in 0..particles.len() {
        let (dx, dy) = (particles.x[i] - cx, particles.y[i] - cy);
        if dx * dx + dy * dy > r2 {
            continue;
        }
        let dyaw = wrap(particles.yaw[i] - cyaw);
        if dyaw.abs() > turn {
            continue;
        }
        let w = f64::from(particles.weight[i]);
        let (dx, dy, dyaw) = (f64::from(dx), f64::from(dy), f64::from(dyaw));
        mass += w;
        for (sum, v) in first.iter_mut().zip([dx, dy, dyaw]) {
            *sum += w * v;
        }
        let products = [dx * dx, dx * dy, dx * dyaw, dy * dy, dy * dyaw, dyaw * dyaw];
        for (sum, v) in second.iter_mut().zip(products) {
            *sum += w * v;
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
        let c = heaviest(&p, &mut Bins::new()).unwrap();
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
