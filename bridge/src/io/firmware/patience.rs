//! Whether the world may go on while the firmware has not answered.

use std::time::Duration;
use vehicle::Timestamp;

/// States without an answer after which the world waits. At a state a millisecond it answers nine of ten.
const UNANSWERED: u32 = 4;
/// Longest time for which it waits: a firmware that is dead must not stop the world.
const LONGEST: Duration = Duration::from_millis(250);

/// Counts states and answers, in time of the wall clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Patience {
    unanswered: u32,
    heard: Timestamp,
    told: Timestamp,
    longest_silence: Duration,
    longest_gap: Duration,
}

impl Patience {
    /// A state went out.
    pub(super) fn told(&mut self, now: Timestamp) {
        self.unanswered = self.unanswered.saturating_add(1);
        if self.told > Timestamp::ZERO {
            self.longest_gap = self.longest_gap.max(now.since(self.told));
        }
        self.told = now;
    }

    /// Motor commands came.
    pub(super) fn heard(&mut self, now: Timestamp) {
        self.unanswered = 0;
        if self.heard > Timestamp::ZERO {
            self.longest_silence = self.longest_silence.max(now.since(self.heard));
        }
        self.heard = now;
    }

    /// Longest times without a state from us and without motor commands from the firmware, since the last call.
    pub(super) fn take_longest(&mut self) -> (Duration, Duration) {
        let longest = (self.longest_gap, self.longest_silence);
        (self.longest_gap, self.longest_silence) = (Duration::ZERO, Duration::ZERO);
        longest
    }

    /// Whether the world should wait.
    pub(super) fn waits(&self, now: Timestamp) -> bool {
        self.unanswered >= UNANSWERED && now.since(self.heard) <= LONGEST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    #[test]
    fn a_firmware_that_answers_most_states_is_never_waited_for() {
        let mut patience = Patience::default();
        for t in 1..1000 {
            patience.told(ms(t));
            if t % 3 != 0 {
                patience.heard(ms(t));
            }
            assert!(!patience.waits(ms(t)));
        }
    }

    #[test]
    fn one_without_a_processor_is_waited_for_until_it_answers() {
        let mut patience = Patience::default();
        patience.heard(ms(1000));
        for _ in 0..4 {
            patience.told(ms(1004));
        }
        assert!(patience.waits(ms(1004)) && patience.waits(ms(1250)));
        patience.heard(ms(1120));
        assert!(!patience.waits(ms(1121)));
    }

    #[test]
    fn a_dead_one_stops_the_world_for_a_quarter_of_a_second_only() {
        let mut patience = Patience::default();
        patience.heard(ms(1000));
        for t in 1001..3000 {
            patience.told(ms(t));
            assert_eq!(patience.waits(ms(t)), (1004..=1250).contains(&t), "{t}");
        }
    }
}
