//! An absolute timer to wait for in `poll`, together with whatever else may come.

use super::clock::Clock;
use super::line::Line;
use rustix::event::{PollFd, PollFlags, poll};
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

    /// Sleeps until it rings, somebody writes to `wake`, or the line has something to give or to take. The first two are seen to.
    pub fn wait(&mut self, wake: &OwnedFd, line: Option<&Line>) {
        let mut fds = [
            PollFd::new(wake, PollFlags::IN),
            PollFd::new(&self.fd, PollFlags::IN),
            PollFd::from_borrowed_fd(wake.as_fd(), PollFlags::empty()),
        ];
        if let Some(line) = line {
            fds[2] = PollFd::from_borrowed_fd(line.as_fd(), line.interest());
        }
        let _ = poll(&mut fds, None);
        let [woken, rang, _] = fds.map(|fd| fd.revents().contains(PollFlags::IN));
        if woken {
            let _ = io::read(wake, &mut [0u8; 8]);
        }
        if rang {
            self.quiet();
        }
    }

    /// Sleeps until it rings.
    pub fn wait_alone(&mut self) {
        let _ = poll(&mut [PollFd::new(&self.fd, PollFlags::IN)], None);
        self.quiet();
    }

    /// Stops the ringing; set it again afterwards.
    fn quiet(&mut self) {
        self.at = None;
        let _ = io::read(&self.fd, &mut [0u8; 8]);
    }
}
