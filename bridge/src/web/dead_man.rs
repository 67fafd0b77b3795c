//! Sticks of a page that has stopped sending them are centred, whatever became of the page.

use super::envelope::STICKS_AGE;
use vehicle::Timestamp;

/// Watches the sticks of one socket.
#[derive(Clone, Copy, Debug, Default)]
pub struct DeadMan {
    /// When deflected sticks came last; none if they are centred.
    held: Option<Timestamp>,
}

impl DeadMan {
    /// Sticks came.
    pub const fn sticks(&mut self, now: Timestamp, is_deflected: bool) {
        self.held = if is_deflected { Some(now) } else { None };
    }

    /// True once when held sticks must be centred because nothing came for [`STICKS_AGE`].
    pub fn must_centre(&mut self, now: Timestamp) -> bool {
        let is_due = self.held.is_some_and(|at| now.since(at) >= STICKS_AGE);
        if is_due {
            self.held = None;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_sticks_that_fall_silent_are_centred_once_after_250_ms() {
        let mut dead_man = DeadMan::default();
        dead_man.sticks(Timestamp::from_ms(1_000), true);
        assert!(!dead_man.must_centre(Timestamp::from_ms(1_249)));
        assert!(dead_man.must_centre(Timestamp::from_ms(1_250)));
        assert!(!dead_man.must_centre(Timestamp::from_ms(2_000)));
    }

    #[test]
    fn sticks_let_go_of_need_nothing() {
        let mut dead_man = DeadMan::default();
        dead_man.sticks(Timestamp::from_ms(0), true);
        dead_man.sticks(Timestamp::from_ms(20), false);
        assert!(!dead_man.must_centre(Timestamp::from_ms(9_000)));
    }
}
