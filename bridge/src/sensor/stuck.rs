//! A ranger that says the same for ever is not measuring.
//!
//! Real sensors of many columns never repeat themselves to the millimetre: their noise is some millimetres in every
//! column. One that does for seconds has frozen (its bus hangs, its buffer is sent again and again) and is treated as
//! silent, so that the failsafe of silent rangers acts. A single sonar in whole centimetres may well repeat itself, and is
//! not judged.

use core::time::Duration;
use vehicle::{RangerReading, Timestamp};

/// The same for longer is frozen.
const FROZEN: Duration = Duration::from_secs(3);
/// Fewer valid columns may be equal by chance.
const LEAST_COLUMNS: usize = 4;

/// Watches one ranger.
#[derive(Clone, Debug, Default)]
pub struct Stuck {
    last: Option<RangerReading>,
    since: Timestamp,
}

impl Stuck {
    /// Takes a reading; true if the sensor has frozen.
    pub fn is_frozen(&mut self, reading: &RangerReading) -> bool {
        let valid = reading.columns_mm.iter().flatten().count();
        let is_same = self
            .last
            .as_ref()
            .is_some_and(|last| last.columns_mm == reading.columns_mm);
        if !is_same || valid < LEAST_COLUMNS {
            self.since = reading.at;
        }
        match &mut self.last {
            Some(last) => last.clone_from(reading),
            None => self.last = Some(reading.clone()),
        }
        reading.at.since(self.since) > FROZEN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(ms: u64, mm: [u16; 6]) -> RangerReading {
        RangerReading {
            at: Timestamp::from_ms(ms),
            ranger: 0,
            columns_mm: mm.iter().map(|mm| Some(*mm).filter(|mm| *mm > 0)).collect(),
        }
    }

    #[test]
    fn three_seconds_of_the_same_are_frozen_and_a_change_thaws() {
        let mut stuck = Stuck::default();
        let same = [1000, 1001, 1002, 1003, 1004, 1005];
        for ms in (0..=3000).step_by(100) {
            assert!(!stuck.is_frozen(&reading(ms, same)), "{ms}");
        }
        assert!(stuck.is_frozen(&reading(3100, same)));
        assert!(!stuck.is_frozen(&reading(3200, [1001; 6])));
        assert!(!stuck.is_frozen(&reading(6100, same)));
    }

    #[test]
    fn open_space_may_look_the_same_for_ever() {
        let mut stuck = Stuck::default();
        for ms in (0..60_000).step_by(100) {
            assert!(!stuck.is_frozen(&reading(ms, [1000, 0, 0, 0, 0, 1200])));
        }
    }
}
