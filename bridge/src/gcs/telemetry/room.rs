//! How much a link can carry, and how much slower telemetry goes there than asked for.
//!
//! | Says so | Telemetry |
//! | --- | --- |
//! | a budget in bytes a second (`?rate=`; a serial line has one by its speed) | stretched until what goes out keeps within it |
//! | RADIO_STATUS, buffer less than a third free | every interval twice as long, up to eight times |
//! | RADIO_STATUS, buffer four fifths free, or none for 10 s | twice as fast again |
//!
//! All intervals of a link stretch alike. Answers, texts and heartbeats are never held back.

use core::time::Duration;
use vehicle::Timestamp;

/// Below this share free, percent, the radio is behind.
const FULL: u8 = 33;
/// Above this it has caught up.
const FREE: u8 = 80;
/// Longest interval for the radio's sake, as a multiple.
const MAX_RADIO: f64 = 8.0;
/// Longest interval for the budget's sake.
const MAX_STRETCH: f64 = 100.0;
/// What the default streams come to, bytes a second: where the first second of a budget starts from.
const DEFAULT_LOAD: f64 = 6_500.0;
/// The load is looked at so often.
const LOOK: Duration = Duration::from_millis(500);
/// A radio that says nothing for so long is no radio any more.
const RADIO_SILENT: Duration = Duration::from_secs(10);

/// The room on one link.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room {
    budget: Option<f64>,
    stretch: f64,
    bytes: usize,
    since: Timestamp,
    radio: f64,
    radio_heard: Timestamp,
}

impl Room {
    pub(super) fn new(now: Timestamp, budget: Option<f64>) -> Self {
        Self {
            budget,
            stretch: budget.map_or(1.0, |b| (DEFAULT_LOAD / b.max(1.0)).clamp(1.0, MAX_STRETCH)),
            bytes: 0,
            since: now,
            radio: 1.0,
            radio_heard: now,
        }
    }

    /// Intervals are this many times as long as asked for.
    pub(super) fn stretch(&self) -> f64 {
        self.stretch * self.radio
    }

    pub(super) const fn sent(&mut self, bytes: usize) {
        self.bytes += bytes;
    }

    pub(super) fn radio_status(&mut self, now: Timestamp, free_percent: u8) {
        self.radio_heard = now;
        if free_percent < FULL {
            self.radio = (self.radio * 2.0).min(MAX_RADIO);
        } else if free_percent > FREE {
            self.radio = (self.radio / 2.0).max(1.0);
        }
    }

    pub(super) fn tick(&mut self, now: Timestamp) {
        if self.radio > 1.0 && now.since(self.radio_heard) >= RADIO_SILENT {
            self.radio /= 2.0;
            self.radio_heard = now;
        }
        let gone = now.since(self.since);
        if gone < LOOK {
            return;
        }
        if let Some(budget) = self.budget {
            let load = self.bytes as f64 / gone.as_secs_f64();
            // Half a step at a time: what is sent now and then (parameters, files) must not make telemetry jump.
            let wanted = self.stretch * (load / budget).clamp(0.5, 4.0);
            self.stretch = (0.5 * (self.stretch + wanted)).clamp(1.0, MAX_STRETCH);
        }
        self.bytes = 0;
        self.since = now;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_radio_halves_the_rate_and_an_empty_one_gives_it_back() {
        let mut room = Room::new(Timestamp::ZERO, None);
        let at = Timestamp::from_ms;
        room.radio_status(at(0), 10);
        assert!((room.stretch() - 2.0).abs() < 1e-9);
        for _ in 0..10 {
            room.radio_status(at(1_000), 10);
        }
        assert!((room.stretch() - 8.0).abs() < 1e-9);
        room.radio_status(at(2_000), 50);
        assert!((room.stretch() - 8.0).abs() < 1e-9);
        room.radio_status(at(3_000), 95);
        assert!((room.stretch() - 4.0).abs() < 1e-9);
        for s in 3..40 {
            room.tick(at(s * 1_000));
        }
        assert!(
            (room.stretch() - 1.0).abs() < 1e-9,
            "a radio that went away"
        );
    }

    #[test]
    fn a_budget_is_kept_within_seconds_and_given_back() {
        let mut room = Room::new(Timestamp::ZERO, Some(1_000.0));
        let mut asked = 13_000.0;
        let mut sent = 0.0;
        for i in 1..=2_000u64 {
            let bytes = asked / 100.0 / room.stretch();
            room.sent(bytes as usize);
            room.tick(Timestamp::from_ms(i * 10));
            if (1_000..1_900).contains(&i) {
                sent += bytes;
            }
            if i == 1_900 {
                asked = 500.0;
            }
        }
        assert!((sent / 9.0 - 1_000.0).abs() < 60.0, "{}", sent / 9.0);
        for i in 2_001..=6_000u64 {
            room.sent((asked / 100.0 / room.stretch()) as usize);
            room.tick(Timestamp::from_ms(i * 10));
        }
        assert!(room.stretch() < 1.05);
    }
}
