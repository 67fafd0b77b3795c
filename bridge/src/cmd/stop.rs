//! Ctrl-C and SIGTERM: the first asks the vehicle to come down, the second ends at once.

use anyhow::{Context as _, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use tokio::signal::unix::{SignalKind, signal};

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
        let (mut interrupt, mut terminate) = {
            let _guard = runtime.enter();
            (
                signal(SignalKind::interrupt())?,
                signal(SignalKind::terminate())?,
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
