//! What is said to uQuad's inertial unit, and when: `!` after its port was opened, `#` while nothing comes from it, `$` at the end.
//!
//! A board that somebody left in its menu, or that started anew, runs again by `#`; one that runs is not disturbed by it.

use core::time::Duration;
use estimator::imu::command::{ImuCommand, RESET_MS};
use vehicle::Timestamp;

/// Without a frame for so long it is asked to run. Half of what stops the motors.
const SILENCE: Duration = Duration::from_millis(500);
/// It is asked again after this.
const AGAIN: Duration = Duration::from_secs(1);

/// The words of one open line.
#[derive(Clone, Copy, Debug)]
pub struct BoardWords {
    opened_at: Timestamp,
    is_told_to_run: bool,
    /// The last frame, or the last word.
    quiet_since: Timestamp,
    wait: Duration,
}

impl BoardWords {
    /// Of a line that was opened now: the board resets by that and listens a while later.
    #[must_use]
    pub const fn opened(now: Timestamp) -> Self {
        Self {
            opened_at: now,
            is_told_to_run: false,
            quiet_since: now,
            wait: SILENCE,
        }
    }

    /// Something came.
    pub const fn heard(&mut self, now: Timestamp) {
        (self.quiet_since, self.wait) = (now, SILENCE);
    }

    /// What is to be said now, if anything.
    pub fn poll(&mut self, now: Timestamp) -> Option<ImuCommand> {
        if !self.is_told_to_run {
            if now.since(self.opened_at) < Duration::from_millis(RESET_MS) {
                return None;
            }
            self.is_told_to_run = true;
            self.heard(now);
            return Some(ImuCommand::RunDefault);
        }
        if now.since(self.quiet_since) < self.wait {
            return None;
        }
        (self.quiet_since, self.wait) = (now, AGAIN);
        Some(ImuCommand::LeaveMenu)
    }

    /// The last word: it shall not fill a port that nobody reads.
    #[must_use]
    pub const fn end() -> ImuCommand {
        ImuCommand::Stop
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_us(ms * 1000)
    }

    #[test]
    fn the_board_is_told_to_run_after_its_reset_to_resume_in_silence_and_to_stop_at_the_end() {
        let mut words = BoardWords::opened(at(0));
        let mut said = Vec::new();
        for ms in 0..6000 {
            // Frames from 0.4 s to 2 s, then somebody opens its menu, then they come again.
            if ((400..2000).contains(&ms) || ms >= 4000) && ms % 10 == 0 {
                words.heard(at(ms));
            }
            said.extend(words.poll(at(ms)).map(|w| (ms, w.bytes())));
        }
        assert_eq!(said, [(350, *b"!\n"), (2490, *b"#\n"), (3490, *b"#\n")]);
        assert_eq!(BoardWords::end().bytes(), *b"$\n");
    }
}
