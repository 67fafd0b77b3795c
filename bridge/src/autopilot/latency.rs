//! How long things take: a histogram of fixed bins that never allocates, and its summary.
//!
//! Bins grow by an eighth of an octave's width (HdrHistogram's layout with 3 bits): a quantile is at most 12.5 % too high, never
//! too low, from 1 us to over a minute.

use core::time::Duration;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Bins per octave, as a power of two.
const SUB_BITS: u32 = 3;
const SUB: usize = 1 << SUB_BITS;
/// Octaves above the linear part.
const OCTAVES: usize = 24;
const BINS: usize = SUB * (OCTAVES + 1);

/// Counts of durations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Histogram {
    bins: [u32; BINS],
    count: u64,
    max_us: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            bins: [0; BINS],
            count: 0,
            max_us: 0,
        }
    }
}

impl Histogram {
    /// One more.
    pub fn record(&mut self, took: Duration) {
        let us = u64::try_from(took.as_micros()).unwrap_or(u64::MAX);
        let bin = &mut self.bins[bin_of(us)];
        *bin = bin.saturating_add(1);
        self.count += 1;
        self.max_us = self.max_us.max(us);
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// The duration that a share of all does not exceed, us; 0 without any.
    #[must_use]
    pub fn quantile_us(&self, share: f64) -> u64 {
        let wanted = (share.clamp(0.0, 1.0) * self.count as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            seen += u64::from(*count);
            if seen >= wanted {
                return last_of(bin).min(self.max_us);
            }
        }
        self.max_us
    }

    /// The figures people ask for.
    #[must_use]
    pub fn summary(&self) -> LatencySummary {
        LatencySummary {
            count: self.count,
            p50_us: self.quantile_us(0.5),
            p99_us: self.quantile_us(0.99),
            p999_us: self.quantile_us(0.999),
            max_us: self.max_us,
        }
    }
}

/// Quantiles of a [`Histogram`]; all zero while it is empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LatencySummary {
    /// How many.
    pub count: u64,
    /// Median, us.
    pub p50_us: u64,
    /// 99 % are not longer, us.
    pub p99_us: u64,
    /// 99.9 % are not longer, us.
    pub p999_us: u64,
    /// Longest, us.
    pub max_us: u64,
}

/// In milliseconds: `p50 2.6 p99 12.8 max 31.0 ms`.
impl fmt::Display for LatencySummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |us: u64| us as f64 * 1e-3;
        write!(
            f,
            "p50 {:.1} p99 {:.1} max {:.1} ms",
            ms(self.p50_us),
            ms(self.p99_us),
            ms(self.max_us)
        )
    }
}

const fn bin_of(us: u64) -> usize {
    if us < SUB as u64 {
        return us as usize;
    }
    let octave = us.ilog2() - SUB_BITS;
    let bin = (octave as usize + 1) * SUB + ((us >> octave) as usize & (SUB - 1));
    if bin < BINS { bin } else { BINS - 1 }
}

/// Longest duration of a bin, us.
const fn last_of(bin: usize) -> u64 {
    if bin < SUB {
        return bin as u64;
    }
    let octave = bin / SUB - 1;
    ((SUB + bin % SUB + 1) as u64) << octave
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(us: impl IntoIterator<Item = u64>) -> Histogram {
        let mut h = Histogram::default();
        for us in us {
            h.record(Duration::from_micros(us));
        }
        h
    }

    #[test]
    fn nothing_measured_is_zero_and_one_is_itself() {
        assert_eq!(of([]).summary(), LatencySummary::default());
        let one = of([2_600]).summary();
        assert_eq!((one.p50_us, one.p999_us, one.max_us), (2_600, 2_600, 2_600));
    }

    #[test]
    fn a_rare_long_one_shows_in_the_tail_only() {
        let s = of((0..990).map(|_| 100).chain((0..10).map(|_| 50_000))).summary();
        assert!(
            (100..=113).contains(&s.p50_us) && (100..=113).contains(&s.p99_us),
            "{s:?}"
        );
        assert_eq!((s.p999_us, s.max_us), (50_000, 50_000));
        assert_eq!(s.to_string(), format!("p50 0.1 p99 0.1 max 50.0 ms"));
    }

    #[test]
    fn ages_beyond_the_last_bin_are_kept_as_the_longest() {
        let h = of([u64::MAX / 2_000]);
        assert_eq!(h.summary().max_us, u64::MAX / 2_000);
    }

    proptest! {
        #[test]
        fn a_quantile_is_never_too_low_and_at_most_an_eighth_too_high(us in 0u64..60_000_000) {
            let bin = bin_of(us);
            prop_assert!(last_of(bin) >= us);
            prop_assert!(last_of(bin) as f64 <= us as f64 * 1.125 + 1.0);
        }
    }
}
