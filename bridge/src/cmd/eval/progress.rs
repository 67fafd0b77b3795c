//! A bar on the terminal while a log is worked through. Nothing in a pipe.

use std::io::{IsTerminal as _, Write as _, stderr};

/// Width of the bar, characters.
const WIDTH: usize = 32;

/// The bar.
#[derive(Debug)]
pub(super) struct Progress {
    is_shown: bool,
    last_percent: usize,
}

impl Progress {
    /// Shown on a terminal, unless quiet.
    pub(super) fn new(is_quiet: bool) -> Self {
        Self {
            is_shown: !is_quiet && stderr().is_terminal(),
            last_percent: usize::MAX,
        }
    }

    /// So much is done.
    pub(super) fn show(&mut self, done: usize, all: usize) {
        let percent = done * 100 / all.max(1);
        if self.is_shown && percent != self.last_percent {
            self.last_percent = percent;
            let mut out = stderr().lock();
            // A closed terminal is no reason to stop.
            let _ = write!(out, "\r\x1b[2K{} {percent:3} %", bar(percent));
            let _ = out.flush();
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(&mut self) {
        if self.is_shown {
            let _ = write!(stderr(), "\r\x1b[2K");
            self.is_shown = false;
        }
    }
}

fn bar(percent: usize) -> String {
    let full = percent.min(100) * WIDTH / 100;
    format!("[{}{}]", "#".repeat(full), "-".repeat(WIDTH - full))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_keeps_its_width() {
        for percent in [0, 1, 50, 99, 100, 250] {
            assert_eq!(bar(percent).len(), WIDTH + 2);
        }
        assert_eq!(bar(50).matches('#').count(), WIDTH / 2);
    }
}
