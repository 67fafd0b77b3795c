//! What makes a thread punctual, as far as the system allows: a real-time scheduling class, locked memory, no timer slack.
//!
//! Late wake-ups of a 1 kHz loop on a loaded machine fall from tens of milliseconds to tens of microseconds by
//! SCHED_FIFO. Pages are locked when they are first touched (MCL_ONFAULT): resident memory does not grow for nothing.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, capabilities, set_current_timer_slack};
use std::fmt;
use std::num::NonZeroU64;
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// Priority of the flight thread among real-time threads, 1..=99: below the kernel's own interrupt threads (50).
const PRIORITY: u8 = 45;
/// Wake-ups may be this late on purpose, ns; the default of 50 us is for laptops.
const TIMER_SLACK_NS: NonZeroU64 = NonZeroU64::MIN;

/// What was granted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Realtime {
    /// SCHED_FIFO.
    pub is_fifo: bool,
    /// Memory stays resident once touched.
    pub is_locked: bool,
}

impl Realtime {
    /// Asks for everything, for the calling thread (memory: for the process). What is refused is left as it was.
    #[must_use]
    pub fn enter() -> Self {
        let _ = set_current_timer_slack(Some(TIMER_SLACK_NS));
        Self {
            is_fifo: enter_fifo(),
            is_locked: lock_memory(),
        }
    }

    /// True if nothing was refused.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        self.is_fifo && self.is_locked
    }
}

/// One warning: what is missing and how to allow it.
impl fmt::Display for Realtime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let missing = match (self.is_fifo, self.is_locked) {
            (true, true) => return write!(f, "flight thread: SCHED_FIFO, memory locked"),
            (false, true) => "real-time scheduling",
            (true, false) => "locked memory",
            (false, false) => "real-time scheduling and locked memory",
        };
        write!(
            f,
            "warning: {missing} not allowed, the flight thread may be late under load: allow it with \
             `sudo setcap cap_sys_nice,cap_ipc_lock+ep` on this program, or LimitRTPRIO=50 and LimitMEMLOCK=infinity in its service"
        )
    }
}

fn enter_fifo() -> bool {
    let Ok(priority) = ThreadPriorityValue::try_from(PRIORITY) else {
        return false;
    };
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(priority),
        policy,
    )
    .is_ok()
}

fn lock_memory() -> bool {
    // Within a finite limit the lock would succeed now and make a later allocation fail in flight.
    let is_unlimited = getrlimit(Resource::Memlock).current.is_none();
    let may_exceed =
        capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    (is_unlimited || may_exceed)
        && mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_warning_names_what_is_missing_and_what_to_do() {
        let text = |is_fifo, is_locked| Realtime { is_fifo, is_locked }.to_string();
        assert!(text(false, true).starts_with("warning: real-time scheduling not"));
        assert!(text(true, false).contains("LimitMEMLOCK"));
        assert!(!text(true, true).contains("warning"));
    }
}
