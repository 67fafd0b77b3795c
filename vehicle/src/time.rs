//! Monotonic time in microseconds since boot, the resolution MAVLink's `time_usec` uses.

use core::ops::{Add, AddAssign, Sub};
use core::time::Duration;
use serde::{Deserialize, Serialize};

/// Microseconds since boot, monotonic. Cores are handed it; they never read a clock.
#[derive(
    Clone, Copy, Debug, Default, Eq, Hash, Ord, PartialEq, PartialOrd, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct Timestamp(u64);

impl Timestamp {
    /// Boot.
    pub const ZERO: Self = Self(0);

    /// From microseconds since boot.
    #[must_use]
    pub const fn from_us(us: u64) -> Self {
        Self(us)
    }

    /// From milliseconds since boot.
    #[must_use]
    pub const fn from_ms(ms: u64) -> Self {
        Self(ms * 1_000)
    }

    /// Microseconds since boot.
    #[must_use]
    pub const fn us(self) -> u64 {
        self.0
    }

    /// Milliseconds since boot, wrapping at 32 bits as MAVLink's `time_boot_ms` does.
    #[must_use]
    pub const fn boot_ms(self) -> u32 {
        (self.0 / 1_000) as u32
    }

    /// Seconds since boot.
    #[must_use]
    pub fn s(self) -> f64 {
        self.0 as f64 * 1e-6
    }

    /// Time since `earlier`; zero if `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Duration {
        Duration::from_micros(self.0.saturating_sub(earlier.0))
    }

    /// Seconds since `earlier`, negative if `earlier` is later.
    #[must_use]
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self.0 as i64).wrapping_sub(earlier.0 as i64) as f64 * 1e-6
    }
}

impl Add<Duration> for Timestamp {
    type Output = Self;
    fn add(self, d: Duration) -> Self {
        Self(self.0.saturating_add(d.as_micros() as u64))
    }
}

impl AddAssign<Duration> for Timestamp {
    fn add_assign(&mut self, d: Duration) {
        *self = *self + d;
    }
}

impl Sub<Duration> for Timestamp {
    type Output = Self;
    fn sub(self, d: Duration) -> Self {
        Self(self.0.saturating_sub(d.as_micros() as u64))
    }
}

/// A fixed rate: says when the next beat is due. Missed beats are skipped, never made up in a burst.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pace {
    period: Duration,
    next: Timestamp,
}

impl Pace {
    /// Beats every `period`, the first at `first`.
    #[must_use]
    pub const fn starting_at(first: Timestamp, period: Duration) -> Self {
        Self {
            period,
            next: first,
        }
    }

    /// Beats `hz` times a second from boot on. `hz` must be positive and finite.
    #[must_use]
    pub fn hz(hz: f64) -> Self {
        Self::starting_at(Timestamp::ZERO, Duration::from_micros((1e6 / hz) as u64))
    }

    /// True once per beat; call as often as you like.
    pub fn is_due(&mut self, now: Timestamp) -> bool {
        if now < self.next {
            return false;
        }
        self.next += self.period;
        if self.next <= now {
            // Late by a whole period or more: stay on the grid, drop what was missed.
            let period_us = (self.period.as_micros() as u64).max(1);
            let missed = now.since(self.next).as_micros() as u64 / period_us + 1;
            self.next += Duration::from_micros(missed * period_us);
        }
        true
    }

    /// When the next beat is due.
    #[must_use]
    pub const fn next(&self) -> Timestamp {
        self.next
    }

    /// Time between beats.
    #[must_use]
    pub const fn period(&self) -> Duration {
        self.period
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_pace_skips_what_it_missed() {
        let mut pace = Pace::starting_at(Timestamp::ZERO, Duration::from_millis(10));
        assert!(pace.is_due(Timestamp::from_ms(0)));
        assert!(!pace.is_due(Timestamp::from_ms(9)));
        assert!(pace.is_due(Timestamp::from_ms(35)));
        assert!(
            !pace.is_due(Timestamp::from_ms(36)),
            "no burst after a stall"
        );
        assert_eq!(pace.next(), Timestamp::from_ms(40));
    }

    #[test]
    fn seconds_since_is_signed() {
        let (a, b) = (Timestamp::from_ms(10), Timestamp::from_ms(30));
        assert!((b.seconds_since(a) - 0.02).abs() < 1e-12);
        assert!((a.seconds_since(b) + 0.02).abs() < 1e-12);
        assert_eq!(a.since(b), Duration::ZERO);
    }
}
