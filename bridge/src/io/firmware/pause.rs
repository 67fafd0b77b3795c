//! Stops the firmware while nobody tells it how the body moves.
//!
//! When the machine takes the processor from this program for a tenth of a second, the firmware would go on integrating the
//! last state it heard and come back with wound-up loops: the body tumbles. A small thread, which is seldom denied the
//! processor, stops the firmware (SIGSTOP) when no state has gone out for [`STALE`], and the next state lets it go on.

use super::super::clock::{self, Clock};
use rustix::process::{Pid, Signal, kill_process_group};
use std::io;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;
use vehicle::Timestamp;

/// Without a state for this long, the firmware is stopped.
const STALE: Duration = Duration::from_millis(8);
/// The thread looks this often.
const LOOK: Duration = Duration::from_millis(3);

/// The switch that the thread and the line share.
#[derive(Debug)]
pub(super) struct Pause {
    clock: Clock,
    /// Process group of the firmware, 0 = none.
    group: AtomicI32,
    told_us: AtomicU64,
    is_stopped: AtomicBool,
    stops: AtomicU64,
}

impl Pause {
    /// Starts the thread; it ends with the last owner of the switch.
    pub(super) fn start() -> io::Result<Arc<Self>> {
        let pause = Arc::new(Self {
            clock: Clock::start(1.0),
            group: AtomicI32::new(0),
            told_us: AtomicU64::new(0),
            is_stopped: AtomicBool::new(false),
            stops: AtomicU64::new(0),
        });
        let watched: Weak<Self> = Arc::downgrade(&pause);
        std::thread::Builder::new()
            .name("pause".to_owned())
            .spawn(move || {
                while let Some(pause) = watched.upgrade() {
                    pause.look();
                    drop(pause);
                    clock::sleep(LOOK);
                }
            })?;
        Ok(pause)
    }

    /// A state goes out to the firmware of this process group: it may run.
    pub(super) fn told(&self, group: i32) {
        self.told_us.store(self.clock.now().us(), Ordering::SeqCst);
        self.group.store(group, Ordering::SeqCst);
        self.go_on();
    }

    /// How often it was stopped.
    pub(super) fn stops(&self) -> u64 {
        self.stops.load(Ordering::Relaxed)
    }

    fn look(&self) {
        let told = Timestamp::from_us(self.told_us.load(Ordering::SeqCst));
        let is_stale = self.clock.now().since(told) > STALE;
        let group = self.group.load(Ordering::SeqCst);
        if group == 0 || !is_stale || self.is_stopped.swap(true, Ordering::SeqCst) {
            return;
        }
        signal(group, Signal::STOP);
        self.stops.fetch_add(1, Ordering::Relaxed);
        // A state may have gone out between the look and the signal.
        if self.told_us.load(Ordering::SeqCst) != told.us() {
            self.go_on();
        }
    }

    fn go_on(&self) {
        if self.is_stopped.swap(false, Ordering::SeqCst) {
            signal(self.group.load(Ordering::SeqCst), Signal::CONT);
        }
    }
}

fn signal(group: i32, signal: Signal) {
    if let Some(group) = Pid::from_raw(group) {
        // It may just have ended.
        let _ = kill_process_group(group, signal);
    }
}
