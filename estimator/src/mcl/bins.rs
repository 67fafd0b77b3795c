//! Counting particles by place: a small open-addressing table, allocated once, emptied by counting epochs.

/// Places in the table; a power of two, at least twice the particles it is used with.
const SLOTS: usize = 16_384;

/// Weights by (x, y, yaw) bin.
#[derive(Clone, Debug)]
pub struct Bins {
    keys: Vec<u64>,
    epochs: Vec<u32>,
    weights: Vec<f32>,
    epoch: u32,
    used: usize,
    heaviest: Option<(usize, u64)>,
}

impl Bins {
    /// An empty table.
    #[must_use]
    pub fn new() -> Self {
        Self {
            keys: vec![0; SLOTS],
            epochs: vec![0; SLOTS],
            weights: vec![0.0; SLOTS],
            epoch: 0,
            used: 0,
            heaviest: None,
        }
    }

    /// Empties it.
    pub fn clear(&mut self) {
        if self.epoch == u32::MAX {
            self.epochs.fill(0);
            self.epoch = 0;
        }
        self.epoch += 1;
        self.used = 0;
        self.heaviest = None;
    }

    /// Bin of a pose.
    #[inline]
    #[must_use]
    pub fn key(x: f32, y: f32, yaw: f32, per_m: f32, per_rad: f32) -> u64 {
        // Floor without a library call: truncation, less one where it went up.
        let bin = |v: f32| {
            let whole = v as i32;
            let floor = whole.wrapping_sub(i32::from((whole as f32) > v));
            u64::from(floor as u32 & 0xF_FFFF)
        };
        bin(x * per_m) | bin(y * per_m) << 20 | bin(yaw * per_rad) << 40
    }

    /// Adds a weight to a bin. A full table takes no new bins.
    pub fn add(&mut self, key: u64, weight: f32) {
        let mut slot = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 50) as usize & (SLOTS - 1);
        loop {
            if self.epochs[slot] != self.epoch {
                if self.used >= SLOTS / 2 {
                    return;
                }
                self.epochs[slot] = self.epoch;
                self.keys[slot] = key;
                self.weights[slot] = 0.0;
                self.used += 1;
                break;
            }
            if self.keys[slot] == key {
                break;
            }
            slot = (slot + 1) & (SLOTS - 1);
        }
        self.weights[slot] += weight;
        let is_heaviest = self
            .heaviest
            .is_none_or(|(s, _)| self.weights[slot] > self.weights[s]);
        if is_heaviest {
            self.heaviest = Some((slot, key));
        }
    }

    /// Number of bins in use.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.used
    }

    /// The heaviest bin.
    #[must_use]
    pub fn heaviest(&self) -> Option<u64> {
        self.heaviest.map(|(_, key)| key)
    }
}

impl Default for Bins {
    fn default() -> Self {
        Self::new()
    }
}

/// Particles needed so that the sampled distribution over `bins` occupied bins is within `error` of the true one with
/// probability 99 % (KLD sampling, Fox 2003, equation 7; z = 2.33).
#[must_use]
pub fn kld_size(bins: usize, error: f64) -> usize {
    if bins < 2 {
        return 0;
    }
    let k = bins as f64 - 1.0;
    let a = 2.0 / (9.0 * k);
    let b = 1.0 - a + libm::sqrt(a) * 2.33;
    (k / (2.0 * error) * b * b * b) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_places_need_more_particles() {
        assert!(kld_size(1, 0.05) == 0);
        // Chi-squared quantile with 9 degrees of freedom at 99 %: 21.67; / (2 * 0.05).
        assert!((kld_size(10, 0.05) as i64 - 216).abs() <= 2);
        assert!(kld_size(100, 0.05) > 1000);
    }

    #[test]
    fn the_heaviest_bin_is_the_sum_of_its_weights() {
        let mut bins = Bins::new();
        for round in 0..3 {
            bins.clear();
            for i in 0..1000 {
                bins.add(Bins::key(i as f32, 0.0, 0.0, 1.0, 1.0), 0.5);
            }
            let here = Bins::key(-7.5, 2.0, 1.0, 1.0, 1.0);
            bins.add(here, 0.3);
            bins.add(here, 0.3);
            assert_eq!(
                (bins.count(), bins.heaviest()),
                (1001, Some(here)),
                "round {round}"
            );
        }
    }
}
