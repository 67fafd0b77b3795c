//! When the tick is due: on the arrival of a fresh attitude, or when none comes in time.
//!
//! A tick between two replies would steer by a sample up to a period old. So the beat follows the replies as long as they come at about
//! its own rate, waits a little for one that is expected, and keeps its own clock when none come.

use core::time::Duration;
use vehicle::Timestamp;

/// The beat of the flight loop.
#[derive(Clone, Debug)]
pub struct Beat {
    period: Duration,
    last: Option<Timestamp>,
    sample: Option<Timestamp>,
    /// Usual time between samples, us; 0 = not known.
    interval_us: u64,
    start: Timestamp,
}

impl Beat {
    /// Due at once, then about every `period`.
    #[must_use]
    pub const fn new(start: Timestamp, period: Duration) -> Self {
        Self {
            period,
            last: None,
            sample: None,
            interval_us: 0,
            start,
        }
    }

    /// Time between beats.
    #[must_use]
    pub const fn period(&self) -> Duration {
        self.period
    }

    /// True once per beat; `sample_came` with a fresh attitude. A late beat is not made up for.
    pub fn is_due(&mut self, now: Timestamp, sample_came: bool) -> bool {
        if sample_came {
            self.take_sample(now);
        }
        let is_due = now >= self.deadline()
            || sample_came
                && self
                    .last
                    .is_some_and(|last| now.since(last) >= self.period * 3 / 4);
        if is_due {
            self.last = Some(now);
        }
        is_due
    }

    /// When it is due although nothing comes.
    #[must_use]
    pub fn deadline(&self) -> Timestamp {
        let Some(last) = self.last else {
            return self.start;
        };
        let follows = self
            .sample
            .is_some_and(|at| last.since(at) <= self.period * 2);
        if !follows {
            return last + self.period;
        }
        let usual = last + self.period * 5 / 4;
        let latest = last + self.period * 2;
        // One that comes a little late is worth waiting for.
        match self.expected() {
            Some(at) if at + self.period / 2 > usual && at <= latest => {
                (at + self.period / 4).max(usual).min(latest)
            }
            _ => usual,
        }
    }

    fn take_sample(&mut self, now: Timestamp) {
        let gap_us = self.sample.map_or(0, |at| now.since(at).as_micros() as u64);
        // A pause is no interval.
        if gap_us > 0 && gap_us < 4 * self.period.as_micros() as u64 {
            self.interval_us = match self.interval_us {
                0 => gap_us,
                usual => (3 * usual + gap_us) / 4,
            };
        }
        self.sample = Some(now);
    }

    fn expected(&self) -> Option<Timestamp> {
        let at = self.sample?;
        (self.interval_us > 0).then(|| at + Duration::from_micros(self.interval_us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_MS: u64 = 25;

    /// Times of beats, ms, when attitudes come at these times.
    fn beats(samples_ms: impl Iterator<Item = u64>, until_ms: u64) -> Vec<u64> {
        let samples: Vec<u64> = samples_ms.take_while(|t| *t < until_ms).collect();
        let mut beat = Beat::new(Timestamp::ZERO, Duration::from_millis(PERIOD_MS));
        (0..until_ms)
            .filter(|ms| beat.is_due(Timestamp::from_ms(*ms), samples.contains(ms)))
            .collect()
    }

    #[test]
    fn replies_at_its_own_rate_are_answered_as_they_come_even_when_they_jitter() {
        // A controller that serves every 10 ms answers a request of 40 Hz after 20 and 30 ms in turn.
        let samples = [7, 27, 57, 77, 107, 127, 157];
        assert_eq!(beats(samples.into_iter(), 170)[1..], samples[1..]);
    }

    #[test]
    fn without_replies_it_keeps_its_own_rate() {
        assert_eq!(beats(std::iter::empty(), 101), [0, 25, 50, 75, 100]);
    }

    #[test]
    fn faster_replies_do_not_make_it_much_faster_and_slower_ones_not_much_slower() {
        let n = |every: u64| beats((3..).step_by(every as usize), 2_000).len();
        assert!((80..=108).contains(&n(10)), "{}", n(10));
        assert!((49..=52).contains(&n(40)), "{}", n(40));
        assert!((59..=62).contains(&n(33)), "{}", n(33));
    }

    #[test]
    fn slower_replies_are_waited_for_so_that_each_command_is_fresh() {
        let beats = beats((3..).step_by(40), 2_000);
        let fresh = beats.iter().filter(|t| *t % 40 == 3).count();
        assert!(fresh + 3 >= beats.len(), "{beats:?}");
    }

    #[test]
    fn replies_that_stop_are_waited_for_two_periods_at_most() {
        let beats = beats((3..400).step_by(40), 2_000);
        let longest = beats.windows(2).map(|w| w[1] - w[0]).max();
        assert!(longest <= Some(50), "{beats:?}");
    }

    #[test]
    fn a_long_stall_is_one_late_beat_not_a_burst() {
        let mut beat = Beat::new(Timestamp::ZERO, Duration::from_millis(PERIOD_MS));
        assert!(beat.is_due(Timestamp::ZERO, true));
        assert!(beat.is_due(Timestamp::from_ms(600), true));
        assert!(!beat.is_due(Timestamp::from_ms(601), true));
        assert!(!beat.is_due(Timestamp::from_ms(610), false));
    }
}
