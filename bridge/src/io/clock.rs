//! The only reader of the clock.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use vehicle::Timestamp;

/// Monotonic time since the program began, at a chosen speed.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Instant,
    speed: f64,
}

impl Clock {
    /// Starts now; `speed` seconds pass on it in each second.
    #[must_use]
    #[expect(
        clippy::disallowed_methods,
        reason = "this file is where the clock is read"
    )]
    pub fn start(speed: f64) -> Self {
        Self {
            start: Instant::now(),
            speed,
        }
    }

    /// Time on this clock.
    #[must_use]
    pub fn now(&self) -> Timestamp {
        Timestamp::from_us((self.start.elapsed().as_secs_f64() * self.speed * 1e6) as u64)
    }

    /// How long to wait, in real time, until this clock shows `at`.
    #[must_use]
    pub fn until(&self, at: Timestamp) -> Duration {
        Duration::from_secs_f64(at.seconds_since(self.now()).max(0.0) / self.speed)
    }
}

/// UTC now, microseconds since 1970.
#[must_use]
#[expect(
    clippy::disallowed_methods,
    reason = "this file is where the clock is read"
)]
pub fn utc_us() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |d| d.as_micros() as u64)
}

/// Waits. For work on the bench and for start-up, never for flight.
#[expect(
    clippy::disallowed_methods,
    reason = "this file is where time is waited for"
)]
pub fn sleep(time: Duration) {
    std::thread::sleep(time);
}

/// UTC at boot of virtual flights: 2026-01-01, so that two runs write the same bytes.
pub const VIRTUAL_BOOT_UTC_US: u64 = 1_767_225_600_000_000;
