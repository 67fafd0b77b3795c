//! The particles: structure of arrays, allocated once.

use super::random::Random;
use super::random::{exp_below_zero, wrap};
use vehicle::MapPose;

/// Particles on the plan. Weights are logarithms until [`Particles::normalise`] makes them shares that sum to 1.
#[derive(Clone, Debug)]
pub struct Particles {
    /// Plan x, m.
    pub(crate) x: Vec<f32>,
    /// Plan y, m.
    pub(crate) y: Vec<f32>,
    /// Plan yaw, rad.
    pub(crate) yaw: Vec<f32>,
    /// Logarithm of the weight, up to a constant.
    pub(crate) log_weight: Vec<f32>,
    /// Log-likelihood of the readings weighed last.
    pub(crate) log_likelihood: Vec<f32>,
    /// Share, sum 1.
    pub(crate) weight: Vec<f32>,
    spare: [Vec<f32>; 3],
    capacity: usize,
}

impl Particles {
    /// Room for this many.
    #[must_use]
    pub fn with_capacity(capacity: usize) -> Self {
        let v = || Vec::with_capacity(capacity);
        Self {
            x: v(),
            y: v(),
            yaw: v(),
            log_weight: v(),
            log_likelihood: v(),
            weight: v(),
            spare: [v(), v(), v()],
            capacity,
        }
    }

    /// Number of particles.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.x.len()
    }

    /// True without particles.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Most particles there can be.
    #[must_use]
    pub const fn capacity(&self) -> usize {
        self.capacity
    }

    /// Poses and shares, for drawing.
    pub fn iter(&self) -> impl Iterator<Item = (MapPose, f32)> + '_ {
        (0..self.len()).map(|i| {
            (
                MapPose::new(
                    f64::from(self.x[i]),
                    f64::from(self.y[i]),
                    f64::from(self.yaw[i]),
                ),
                self.weight[i],
            )
        })
    }

    /// Removes all.
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.yaw.clear();
        self.log_weight.clear();
        self.log_likelihood.clear();
        self.weight.clear();
    }

    /// Adds one if there is room.
    pub fn push(&mut self, x: f32, y: f32, yaw: f32, share: f32) {
        if self.len() < self.capacity {
            self.x.push(x);
            self.y.push(y);
            self.yaw.push(wrap(yaw));
            self.log_weight.push(if share > 0.0 {
                libm::logf(share)
            } else {
                -80.0
            });
            self.log_likelihood.push(0.0);
            self.weight.push(share);
        }
    }

    /// Adds `count` around a pose that together weigh `share`.
    pub fn push_around(
        &mut self,
        pose: &MapPose,
        std_xy_m: f64,
        std_yaw_rad: f64,
        count: usize,
        share: f32,
        random: &mut Random,
    ) {
        let (sx, syaw) = (std_xy_m as f32, std_yaw_rad as f32);
        for _ in 0..count {
            let x = pose.x_m as f32 + sx * random.gaussian();
            let y = pose.y_m as f32 + sx * random.gaussian();
            let yaw = pose.yaw_rad as f32 + syaw * random.gaussian();
            self.push(x, y, yaw, share / count as f32);
        }
    }

    /// Adds a portion of the log-likelihood to the log weights.
    pub fn weigh(&mut self, portion: f32) {
        for (w, l) in self.log_weight.iter_mut().zip(&self.log_likelihood) {
            *w += portion * l;
        }
    }

    /// Effective sample size if `portion` of the log-likelihood were added.
    #[must_use]
    pub fn effective_after(&self, portion: f32) -> f64 {
        let values = || {
            self.log_weight
                .iter()
                .zip(&self.log_likelihood)
                .map(|(w, l)| w + portion * l)
        };
        let highest = values().fold(f32::NEG_INFINITY, f32::max);
        let (mut sum, mut squares) = (0.0f64, 0.0f64);
        for v in values() {
            let w = f64::from(exp_below_zero(v - highest));
            sum += w;
            squares += w * w;
        }
        if squares > 0.0 {
            sum * sum / squares
        } else {
            0.0
        }
    }

    /// Moves every particle by a draw from a normal distribution with this lower-triangular root of its covariance.
    pub fn jitter(&mut self, root: &[[f32; 3]; 3], random: &mut Random) {
        for i in 0..self.len() {
            let g = [random.gaussian(), random.gaussian(), random.gaussian()];
            self.x[i] += root[0][0] * g[0];
            self.y[i] += root[1][0] * g[0] + root[1][1] * g[1];
            let dyaw = root[2][0] * g[0] + root[2][1] * g[1] + root[2][2] * g[2];
            self.yaw[i] = wrap(self.yaw[i] + dyaw);
        }
    }

    /// Turns log weights into shares. Equal shares if nothing is left of them.
    pub fn normalise(&mut self) {
        let highest = highest_of(&self.log_weight);
        if !highest.is_finite() {
            self.equalise();
            return;
        }
        for (w, l) in self.weight.iter_mut().zip(&mut self.log_weight) {
            let below = *l - highest;
            *l = if below > -80.0 { below } else { -80.0 };
            *w = exp_below_zero(*l);
        }
        let inverse = (1.0 / sum_of(&self.weight)) as f32;
        for w in &mut self.weight {
            *w *= inverse;
        }
    }

    /// Gives all the same share.
    pub fn equalise(&mut self) {
        let share = 1.0 / self.len().max(1) as f32;
        self.weight.fill(share);
        self.log_weight.fill(0.0);
    }

    /// Effective sample size, 1 / sum of squared shares.
    #[must_use]
    pub fn effective(&self) -> f64 {
        let squares = squares_of(&self.weight);
        if squares > 0.0 { 1.0 / squares } else { 0.0 }
    }

    /// Systematic (low-variance) resampling to `count` particles of equal share (Thrun, Burgard, Fox 2005, table 4.4).
    pub fn resample(&mut self, count: usize, random: &mut Random) {
        let n = self.len();
        let count = count.clamp(1, self.capacity);
        if n == 0 {
            return;
        }
        for s in &mut self.spare {
            s.clear();
        }
        let step = 1.0 / count as f64;
        let mut pointer = f64::from(random.uniform()) * step;
        let mut reached = f64::from(self.weight[0]);
        let mut i = 0;
        for _ in 0..count {
            while pointer > reached && i + 1 < n {
                i += 1;
                reached += f64::from(self.weight[i]);
            }
            self.spare[0].push(self.x[i]);
            self.spare[1].push(self.y[i]);
            self.spare[2].push(self.yaw[i]);
            pointer += step;
        }
        let [x, y, yaw] = &mut self.spare;
        core::mem::swap(&mut self.x, x);
        core::mem::swap(&mut self.y, y);
        core::mem::swap(&mut self.yaw, yaw);
        self.weight.resize(count, 0.0);
        self.log_weight.resize(count, 0.0);
        self.log_likelihood.resize(count, 0.0);
        self.equalise();
    }
}

/// Values summed at once: sums of a block are f32 and vector instructions, blocks are summed in f64.
const BLOCK: usize = 64;
const LANES: usize = 8;

/// Largest value; NaN counts as nothing.
fn highest_of(values: &[f32]) -> f32 {
    let (eights, rest) = values.as_chunks::<LANES>();
    let mut highest = [f32::NEG_INFINITY; LANES];
    for eight in eights {
        for (h, v) in highest.iter_mut().zip(eight) {
            *h = if *v > *h { *v } else { *h };
        }
    }
    highest
        .iter()
        .chain(rest)
        .fold(f32::NEG_INFINITY, |h, v| if *v > h { *v } else { h })
}

fn fold_of(values: &[f32], term: impl Fn(f32) -> f32) -> f64 {
    let mut sum = 0.0;
    for block in values.chunks(BLOCK) {
        let (eights, rest) = block.as_chunks::<LANES>();
        let mut lanes = [0.0f32; LANES];
        for eight in eights {
            for (lane, v) in lanes.iter_mut().zip(eight) {
                *lane += term(*v);
            }
        }
        sum += f64::from(lanes.iter().sum::<f32>());
        sum += f64::from(rest.iter().map(|v| term(*v)).sum::<f32>());
    }
    sum
}

fn sum_of(values: &[f32]) -> f64 {
    fold_of(values, |v| v)
}

fn squares_of(values: &[f32]) -> f64 {
    fold_of(values, |v| v * v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn shares_sum_to_one_and_resampling_keeps_them_in_proportion(
            logs in proptest::collection::vec(prop_oneof![-300.0..10.0f32, Just(f32::NAN), Just(f32::NEG_INFINITY)], 1..200),
            count in 1usize..300, seed in any::<u64>(),
        ) {
            let mut p = Particles::with_capacity(300);
            for (i, l) in logs.iter().enumerate() {
                p.push(i as f32, 0.0, 0.0, 1.0);
                p.log_weight[i] = *l;
            }
            p.normalise();
            let sum: f32 = p.weight.iter().sum();
            prop_assert!((sum - 1.0).abs() < 1e-4, "sum {sum}");
            let before = p.weight.clone();
            p.resample(count, &mut Random::new(seed));
            prop_assert_eq!(p.len(), count);
            let sum: f32 = p.weight.iter().sum();
            prop_assert!((sum - 1.0).abs() < 1e-4);
            for (i, share) in before.iter().enumerate() {
                let copies = p.x.iter().filter(|x| (**x - i as f32).abs() < 0.5).count() as f32;
                prop_assert!((copies - share * count as f32).abs() < 1.01, "{copies} copies of share {share}");
            }
        }
    }
}
