//! An absolute timer to wait for in `poll`, together with whatever else may come.

use super::clock::Clock;
use rustix::event::{PollFd, PollFlags};
use rustix::fd::{AsFd as _, OwnedFd};
use rustix::io;
use rustix::time::{
    Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, timerfd_create,
    timerfd_settime,
};
use vehicle::Timestamp;

/// A timer on CLOCK_MONOTONIC. Absolute: what a round of a loop takes never adds up.
#[derive(Debug)]
pub struct AbsoluteTimer {
    fd: OwnedFd,
    at: Option<Timestamp>,
}

impl AbsoluteTimer {
    /// Not set.
    ///
    /// # Errors
    /// No descriptor is left.
    pub fn new() -> io::Result<Self> {
        let fd = timerfd_create(
            TimerfdClockId::Monotonic,
            TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC,
        )?;
        Ok(Self { fd, at: None })
    }

    /// Rings when `clock` shows `at`, at once if that is past.
    pub fn set(&mut self, clock: &Clock, at: Timestamp) {
        if self.at == Some(at) {
            return;
        }
        self.at = Some(at);
        let at = Itimerspec {
            it_interval: Timespec::default(),
            it_value: clock.absolute(at),
        };
        // Fails only for times before the epoch or a closed descriptor.
        let _ = timerfd_settime(&self.fd, TimerfdTimerFlags::ABSTIME, &at);
    }

    /// For `poll`: readable once it has rung.
    #[must_use]
    pub fn poll_fd(&self) -> PollFd<'_> {
        PollFd::from_borrowed_fd(self.fd.as_fd(), PollFlags::IN)
    }

    /// Stops the ringing; set it again afterwards.
    pub fn quiet(&mut self) {
        self.at = None;
        let _ = io::read(&self.fd, &mut [0u8; 8]);
    }
}
