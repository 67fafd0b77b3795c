//! The controller's line, lent to a configurator and given back.

use super::wake_up;
use crate::io::line::Line;
use rustix::fd::OwnedFd;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Who may have the line for a while: a configurator.
#[derive(Debug)]
pub struct Borrower {
    want: SyncSender<()>,
    given: Receiver<Option<Line>>,
    back: SyncSender<Option<Line>>,
    wake: Arc<OwnedFd>,
}

impl Borrower {
    /// The line; none while the controller is armed or absent. Until it is given back `Flight` has no controller.
    #[must_use]
    pub fn borrow(&self) -> Option<Line> {
        self.want.send(()).ok()?;
        wake_up(&self.wake);
        self.given.recv().ok().flatten()
    }

    /// Gives it back; none if it was lost, then it is opened again.
    pub fn give_back(&self, line: Option<Line>) {
        let _ = self.back.send(line);
        wake_up(&self.wake);
    }
}

/// The flight thread's end of [`Borrower`].
pub(super) struct Lender {
    pub(super) wanted: Receiver<()>,
    pub(super) give: SyncSender<Option<Line>>,
    pub(super) back: Receiver<Option<Line>>,
}

pub(super) fn lending(wake: &Arc<OwnedFd>) -> (Lender, Borrower) {
    let (want, wanted) = sync_channel(1);
    let (give, given) = sync_channel(1);
    let (back, comes_back) = sync_channel(1);
    let lender = Lender {
        wanted,
        give,
        back: comes_back,
    };
    let borrower = Borrower {
        want,
        given,
        back,
        wake: Arc::clone(wake),
    };
    (lender, borrower)
}
