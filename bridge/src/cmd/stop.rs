//! Ctrl-C, SIGTERM and SIGHUP (the terminal is gone): the first asks the vehicle to come down, the second ends at once.

use anyhow::{Context as _, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// Its number on every Unix.
const SIGHUP: u32 = 1;

/// How often the user asked to stop.
#[derive(Clone, Debug)]
pub(crate) struct Stop(Arc<AtomicU32>);

impl Stop {
    /// Listens from now on, on a small thread of its own.
    pub(crate) fn listen() -> Result<Self> {
        let stop = Self(Arc::new(AtomicU32::new(0)));
        let count = Arc::clone(&stop.0);
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .context("signals")?;
        let hears_hangup = !is_ignored(SIGHUP);
        let (mut interrupt, mut terminate, mut hangup) = {
            let _guard = runtime.enter();
            (
                signal(SignalKind::interrupt())?,
                signal(SignalKind::terminate())?,
                hears_hangup
                    .then(|| signal(SignalKind::hangup()))
                    .transpose()?,
            )
        };
        std::thread::Builder::new()
            .name("signals".to_owned())
            .spawn(move || {
                runtime.block_on(async move {
                    loop {
                        tokio::select! {
                            _ = interrupt.recv() => {}
                            _ = terminate.recv() => {}
                            _ = hung_up(&mut hangup) => {}
                        }
                        count.fetch_add(1, Ordering::Relaxed);
                    }
                });
            })
            .context("cannot start the signal thread")?;
        Ok(stop)
    }

    /// How often so far.
    pub(crate) fn count(&self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }
}

async fn hung_up(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => {
            signal.recv().await;
        }
        None => std::future::pending().await,
    }
}

/// Whether this program was told to live on without a terminal, as `nohup` does.
fn is_ignored(signal: u32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    ignores(&status, signal)
}

/// `SigIgn` of /proc/PID/status: a bit for each signal, the first for signal 1.
fn ignores(status: &str, signal: u32) -> bool {
    status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_under_nohup_is_known_by_its_signal_mask() {
        let status = |mask: &str| format!("Name:\tkestrel\nSigIgn:\t{mask}\nSigCgt:\t0\n");
        assert!(ignores(&status("0000000000001001"), SIGHUP));
        assert!(!ignores(&status("0000000000001000"), SIGHUP));
        assert!(!ignores("", SIGHUP));
    }
}
