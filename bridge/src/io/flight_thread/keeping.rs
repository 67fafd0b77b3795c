//! The thread that says the last word while the flight thread is held up.

use super::wake_up;
use crate::autopilot::io::FcBytes;
use crate::autopilot::keeper::Keeper;
use crate::io::clock::Clock;
use crate::io::realtime::Realtime;
use crate::io::timer::AbsoluteTimer;
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::OwnedFd;
use std::io;
use std::sync::{Arc, Mutex};
use std::thread;
use vehicle::Timestamp;

/// What flight thread and keeper share. The keeper holds the lock for a write that never blocks, the flight thread for a copy.
pub(super) struct Kept {
    shared: Mutex<(Keeper, Option<OwnedFd>)>,
    wake: OwnedFd,
}

impl Kept {
    pub(super) fn new() -> rustix::io::Result<Self> {
        Ok(Self {
            shared: Mutex::new((Keeper::default(), None)),
            wake: eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC)?,
        })
    }

    pub(super) fn set_line(&self, line: Option<OwnedFd>) {
        if let Ok(mut shared) = self.shared.lock() {
            *shared = (Keeper::default(), line);
        }
    }

    pub(super) fn refresh(&self, now: Timestamp, standby: Option<&FcBytes>) {
        if let Ok(mut shared) = self.shared.try_lock() {
            let was_idle = shared.0.deadline().is_none();
            shared.0.refresh(now, standby);
            // It sleeps until its deadline, which only moves away; only from no deadline at all must it be woken.
            if was_idle && standby.is_some() {
                wake_up(&self.wake);
            }
        }
    }
}

/// Stands in while the flight thread is held up: see [`Keeper`].
pub(super) fn keeper_thread(kept: Arc<Kept>, clock: Clock) -> io::Result<()> {
    let mut timer = AbsoluteTimer::new()?;
    thread::Builder::new()
        .name("keeper".to_owned())
        .spawn(move || {
            let _ = Realtime::enter();
            // The flight thread holds the other end for as long as it lives; a program that ends takes this thread with it.
            loop {
                let deadline = match kept.shared.lock() {
                    Ok(mut shared) => {
                        let (keeper, line) = &mut *shared;
                        if let (Some(frame), Some(line)) = (keeper.poll(clock.now()), line) {
                            let _ = rustix::io::write(line, frame);
                        }
                        keeper.deadline()
                    }
                    Err(_) => return,
                };
                if let Some(at) = deadline {
                    timer.set(&clock, at);
                }
                timer.wait(&kept.wake, None);
            }
        })?;
    Ok(())
}
