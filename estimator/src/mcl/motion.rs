//! Motion model of a vehicle that can move in any horizontal direction.

use super::particles::Particles;
use super::planar::Planar;
use super::random::{Random, sin_cos, wrap};

/// Noise of one odometry step with length L and turn W: position `a1 L + a2 |W| + a0`, yaw `a3 |W| + a4 L + a5`
/// (the omnidirectional form of Thrun, Burgard, Fox 2005, table 5.6).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionNoise {
    /// a1, position per metre, m/m.
    pub position_per_m: f64,
    /// a2, position per turn, m/rad.
    pub position_per_rad: f64,
    /// a0, position per step, m.
    pub position_m: f64,
    /// a3, yaw per turn, rad/rad.
    pub yaw_per_rad: f64,
    /// a4, yaw per metre, rad/m.
    pub yaw_per_m: f64,
    /// a5, yaw per step, rad.
    pub yaw_rad: f64,
}

/// Particles moved at once.
const BLOCK: usize = 64;

impl Default for MotionNoise {
    fn default() -> Self {
        Self {
            position_per_m: 0.08,
            position_per_rad: 0.02,
            position_m: 0.008,
            yaw_per_rad: 0.05,
            yaw_per_m: 0.03,
            yaw_rad: 0.006,
        }
    }
}

impl MotionNoise {
    /// Standard deviations (m, rad) of a step.
    #[must_use]
    pub fn std_of(&self, step: &Planar) -> (f64, f64) {
        let (l, w) = (step.length(), step.yaw.abs());
        (
            self.position_per_m * l + self.position_per_rad * w + self.position_m,
            self.yaw_per_rad * w + self.yaw_per_m * l + self.yaw_rad,
        )
    }

    /// Moves every particle by the step (in the body's axes) with its own noise.
    pub fn apply(&self, step: &Planar, particles: &mut Particles, random: &mut Random) {
        let (std_xy, std_yaw) = self.std_of(step);
        let (std_xy, std_yaw) = (std_xy as f32, std_yaw as f32);
        let (dx, dy, dyaw) = (step.x as f32, step.y as f32, step.yaw as f32);
        let n = particles.len();
        let mut turns = [(0.0f32, 1.0f32); BLOCK];
        for begin in (0..n).step_by(BLOCK) {
            let block = begin..(begin + BLOCK).min(n);
            let x = &mut particles.x[block.clone()];
            let y = &mut particles.y[block.clone()];
            let yaw = &mut particles.yaw[block];
            // Arithmetic only, so vector instructions; the random numbers depend on each other.
            for (turn, yaw) in turns.iter_mut().zip(&*yaw) {
                *turn = sin_cos(*yaw);
            }
            for (((x, y), yaw), (s, c)) in x.iter_mut().zip(y).zip(&mut *yaw).zip(&turns) {
                let forward = dx + std_xy * random.gaussian();
                let left = dy + std_xy * random.gaussian();
                *x += c * forward - s * left;
                *y += s * forward + c * left;
                *yaw = wrap(*yaw + dyaw + std_yaw * random.gaussian());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::MapPose;

    /// Particles of one pose after one step.
    fn after(noise: &MotionNoise, step: &Planar) -> Particles {
        const COUNT: usize = 20_000;
        let mut random = Random::new(9);
        let mut particles = Particles::with_capacity(COUNT);
        let start = MapPose::new(2.0, 1.0, 0.5);
        particles.push_around(&start, 0.0, 0.0, COUNT, 1.0, &mut random);
        noise.apply(step, &mut particles, &mut random);
        particles
    }

    #[test]
    fn without_noise_every_particle_goes_the_very_step() {
        let none = MotionNoise {
            position_per_m: 0.0,
            position_per_rad: 0.0,
            position_m: 0.0,
            yaw_per_rad: 0.0,
            yaw_per_m: 0.0,
            yaw_rad: 0.0,
        };
        let step = Planar::new(0.4, -0.1, 0.2);
        let there = Planar::new(2.0, 1.0, 0.5).then(&step);
        for (pose, _) in after(&none, &step).iter() {
            assert!(there.is_near(&pose.into(), 2e-6, 2e-6), "{pose:?}");
        }
    }

    #[test]
    fn the_mean_goes_the_step_and_the_spread_is_the_noise_of_the_model() {
        let noise = MotionNoise::default();
        let step = Planar::new(0.4, -0.1, 0.2);
        let (std_m, std_rad) = noise.std_of(&step);
        // 0.08 L + 0.02 W + 0.008 and 0.05 W + 0.03 L + 0.006 of L = 0.4123 m, W = 0.2 rad.
        assert!((std_m - 0.044_985).abs() < 1e-5 && (std_rad - 0.028_369).abs() < 1e-5);
        let particles = after(&noise, &step);
        let there = Planar::new(2.0, 1.0, 0.5).then(&step);
        let n = particles.len() as f64;
        let errors: Vec<[f64; 3]> = particles
            .iter()
            .map(|(p, _)| [p.x_m - there.x, p.y_m - there.y, p.yaw_rad - there.yaw])
            .collect();
        for (axis, std) in [std_m, std_m, std_rad].into_iter().enumerate() {
            let mean = errors.iter().map(|e| e[axis]).sum::<f64>() / n;
            let square = errors.iter().map(|e| e[axis] * e[axis]).sum::<f64>() / n;
            // Four standard deviations of a mean, and of a spread, of so many.
            assert!(
                mean.abs() < 4.0 * std / n.sqrt(),
                "axis {axis}: mean {mean}"
            );
            let spread = square.sqrt();
            assert!(
                (spread / std - 1.0).abs() < 4.0 / (2.0 * n).sqrt(),
                "axis {axis}: {spread}"
            );
        }
    }
}
