//! Invented fixes for work without sky: once a second zeros, or x and y anywhere within 0.5 m and z within 1 m (uQuad's
//! fake GPS).

use core::time::Duration;
use vehicle::{GnssFix, In, Pace, Timestamp};

/// Half the width of what is invented, north and east, down, m.
pub const REACH_M: [f64; 2] = [0.5, 1.0];

/// The inventor.
#[derive(Clone, Debug)]
pub struct Fake {
    is_random: bool,
    state: u64,
    pace: Pace,
}

impl Fake {
    /// Zeros, or numbers that a seed gives.
    #[must_use]
    pub const fn new(is_random: bool, seed: u64) -> Self {
        Self {
            is_random,
            state: seed,
            pace: Pace::starting_at(Timestamp::ZERO, Duration::from_secs(1)),
        }
    }

    /// A fix once a second.
    pub fn poll(&mut self, now: Timestamp) -> Option<GnssFix> {
        if !self.pace.is_due(now) {
            return None;
        }
        let [level, down] = REACH_M;
        let position = if self.is_random {
            In::new(self.within(level), self.within(level), self.within(down))
        } else {
            In::zero()
        };
        Some(GnssFix {
            at: now,
            position,
            velocity: Some(In::zero()),
            std_m: [level, down],
            place_deg: [0.0; 2],
            altitude_m: -position.z(),
            satellites: 0,
        })
    }

    /// Evenly within +-reach (splitmix64).
    fn within(&mut self, reach: f64) -> f64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        let unit = (z >> 11) as f64 / (1u64 << 53) as f64;
        reach * (2.0 * unit - 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fixes(mut fake: Fake, seconds: u64) -> Vec<GnssFix> {
        (0..seconds * 100)
            .filter_map(|i| fake.poll(Timestamp::from_ms(10 * i)))
            .collect()
    }

    #[test]
    fn zeros_once_a_second() {
        let out = fixes(Fake::new(false, 1), 10);
        assert_eq!(out.len(), 10);
        assert!(out.iter().all(|f| f.position == In::zero()));
    }

    #[test]
    fn random_ones_fill_their_range_and_a_seed_repeats_them() {
        let out = fixes(Fake::new(true, 7), 2000);
        let widest =
            |axis: fn(&GnssFix) -> f64| out.iter().map(|f| axis(f).abs()).fold(0.0, f64::max);
        let (x, y, z) = (
            widest(|f| f.position.x()),
            widest(|f| f.position.y()),
            widest(|f| f.position.z()),
        );
        assert!(
            (0.49..=0.5).contains(&x) && (0.49..=0.5).contains(&y) && (0.98..=1.0).contains(&z),
            "{x} {y} {z}"
        );
        assert_eq!(out[..20], fixes(Fake::new(true, 7), 20)[..]);
    }
}
