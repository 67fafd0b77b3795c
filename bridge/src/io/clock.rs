//! The only reader of the clock.

use rustix::time::{ClockId, Timespec, clock_gettime};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use vehicle::Timestamp;

/// Monotonic time since the program began, at a chosen speed.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    /// CLOCK_MONOTONIC at the start, ns.
    start_ns: u64,
    speed: f64,
}

impl Clock {
    /// Starts now; `speed` seconds pass on it in each second.
    #[must_use]
    pub fn start(speed: f64) -> Self {
        Self {
            start_ns: monotonic_ns(),
            speed,
        }
    }

    /// Time on this clock.
    #[must_use]
    pub fn now(&self) -> Timestamp {
        let ns = monotonic_ns().saturating_sub(self.start_ns);
        Timestamp::from_us((ns as f64 * self.speed * 1e-3) as u64)
    }

    /// Time on this clock when CLOCK_MONOTONIC showed this, ns: of events the kernel stamps.
    #[must_use]
    pub fn at_monotonic_ns(&self, ns: u64) -> Timestamp {
        Timestamp::from_us((ns.saturating_sub(self.start_ns) as f64 * self.speed * 1e-3) as u64)
    }

    /// How long to wait, in real time, until this clock shows `at`.
    #[must_use]
    pub fn until(&self, at: Timestamp) -> Duration {
        Duration::from_secs_f64(at.seconds_since(self.now()).max(0.0) / self.speed)
    }

    /// When this clock shows `at`, as CLOCK_MONOTONIC: for absolute timers. Never zero, which would disarm them.
    #[must_use]
    pub fn absolute(&self, at: Timestamp) -> Timespec {
        let ns = self.start_ns + (at.us() as f64 * 1e3 / self.speed) as u64;
        Timespec {
            tv_sec: (ns / 1_000_000_000) as i64,
            tv_nsec: (ns % 1_000_000_000).max(1) as _,
        }
    }
}

/// CLOCK_MONOTONIC, ns since some start of its own.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let t = clock_gettime(ClockId::Monotonic);
    (t.tv_sec as u64) * 1_000_000_000 + t.tv_nsec as u64
}

/// Now, for libraries that are handed the time as an `Instant`.
#[must_use]
#[expect(
    clippy::disallowed_methods,
    reason = "this file is where the clock is read"
)]
pub fn instant() -> Instant {
    Instant::now()
}

/// Processor time of the calling thread, ns.
#[must_use]
pub fn thread_cpu_ns() -> u64 {
    let t = clock_gettime(ClockId::ThreadCPUTime);
    (t.tv_sec as u64) * 1_000_000_000 + t.tv_nsec as u64
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
