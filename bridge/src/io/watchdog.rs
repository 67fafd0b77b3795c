//! systemd's watchdog (`Type=notify`, `WatchdogSec`): whoever stands still is started again, but never out of the air.
//!
//! | Stands still | Then |
//! | --- | --- |
//! | the flight thread | no sign of life: by then the keeper has fallen silent and the flight controller's own failsafe acts |
//! | the ground loop, on the floor | no sign of life |
//! | the ground loop, motors running | signs of life go on: flight does not need it, a restart would end the flight |
//!
//! Without systemd (`NOTIFY_SOCKET` is not set) nothing happens.

use super::clock;
use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// What the loops show of themselves.
#[derive(Debug, Default)]
pub struct Pulse {
    flight: AtomicU64,
    ground: AtomicU64,
    is_armed: AtomicBool,
}

impl Pulse {
    /// The flight thread went round once.
    pub fn flight(&self, is_armed: bool) {
        self.flight.fetch_add(1, Ordering::Relaxed);
        self.is_armed.store(is_armed, Ordering::Relaxed);
    }

    /// The ground loop went round once.
    pub fn ground(&self) {
        self.ground.fetch_add(1, Ordering::Relaxed);
    }
}

/// What was seen last.
#[derive(Debug, Default)]
struct Seen {
    flight: u64,
    ground: u64,
}

impl Seen {
    /// True if what must move has moved since the last look.
    fn is_well(&mut self, pulse: &Pulse) -> bool {
        let flight = pulse.flight.load(Ordering::Relaxed);
        let ground = pulse.ground.load(Ordering::Relaxed);
        let (flew, talked) = (flight != self.flight, ground != self.ground);
        *self = Self { flight, ground };
        flew && (talked || pulse.is_armed.load(Ordering::Relaxed))
    }
}

/// Tells systemd that the program is ready, and from then on that it lives. True if somebody listens.
///
/// # Errors
/// The socket of the environment cannot be used, or no thread is left.
pub fn start(pulse: Arc<Pulse>) -> io::Result<bool> {
    let Some(name) = std::env::var_os("NOTIFY_SOCKET") else {
        return Ok(false);
    };
    let address = address(&name)?;
    let socket = UnixDatagram::unbound()?;
    socket.send_to_addr(b"READY=1", &address)?;
    let limit_us = std::env::var("WATCHDOG_USEC").ok();
    let Some(limit_us) = limit_us.and_then(|us| us.parse::<u64>().ok()) else {
        return Ok(true);
    };
    let pause = Duration::from_micros(limit_us / 4);
    thread::Builder::new()
        .name("watchdog".to_owned())
        .spawn(move || {
            let mut seen = Seen::default();
            loop {
                clock::sleep(pause);
                if seen.is_well(&pulse) {
                    // A full queue is systemd's trouble, and it reads again soon.
                    let _ = socket.send_to_addr(b"WATCHDOG=1", &address);
                }
            }
        })?;
    Ok(true)
}

/// A path, or a name without one that begins with `@`.
fn address(name: &OsStr) -> io::Result<SocketAddr> {
    match name.as_bytes().strip_prefix(b"@") {
        Some(abstract_name) => SocketAddr::from_abstract_name(abstract_name),
        None => SocketAddr::from_pathname(name),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_thread_that_stands_still_is_not_well_and_a_ground_loop_only_on_the_floor() {
        let pulse = Pulse::default();
        let mut seen = Seen::default();
        let mut look = |flight: bool, ground: bool, is_armed: bool| {
            if flight {
                pulse.flight(is_armed);
            }
            if ground {
                pulse.ground();
            }
            seen.is_well(&pulse)
        };
        assert!(look(true, true, false));
        assert!(!look(true, false, false), "on the floor");
        assert!(look(true, false, true), "in the air");
        assert!(!look(false, true, true));
        assert!(look(true, true, true));
    }

    #[test]
    fn both_kinds_of_socket_names_are_understood() {
        let plain = address(OsStr::new("/run/systemd/notify")).unwrap();
        assert_eq!(
            plain.as_pathname().unwrap().to_str(),
            Some("/run/systemd/notify")
        );
        let hidden = address(OsStr::new("@kestrel-test")).unwrap();
        assert_eq!(hidden.as_abstract_name(), Some(b"kestrel-test".as_slice()));
    }
}
