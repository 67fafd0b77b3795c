//! Who keeps the vehicle level while the flight loop is held up.
//!
//! Betaflight idles the motors 0.30 s after the last RC frame: a loop that is held for longer drops the vehicle. So each RC
//! frame in flight leaves a standby frame with the keeper (sticks level, a throttle that sinks slowly), and the keeper sends
//! it when the loop is late. It runs on a thread of its own, knows nothing, and stops after a while: a program that does not come back
//! must let the flight controller fail safe.

use super::io::FcBytes;
use core::time::Duration;
use vehicle::Timestamp;

/// Silence of the flight loop before the keeper speaks: well before the receiver's 0.15 s.
const LATE: Duration = Duration::from_millis(100);
/// Its own pace.
const EVERY: Duration = Duration::from_millis(40);
/// It gives up this long after the last frame of the flight loop.
const LONGEST: Duration = Duration::from_millis(1_500);

/// The state machine.
#[derive(Clone, Debug, Default)]
pub struct Keeper {
    standby: Option<FcBytes>,
    refreshed: Timestamp,
    next: Timestamp,
    sent: u64,
}

impl Keeper {
    /// The flight loop runs, and this is what keeps the vehicle level without it; none on the floor.
    pub fn refresh(&mut self, now: Timestamp, standby: Option<&FcBytes>) {
        self.standby = standby.cloned();
        self.refreshed = now;
        self.next = now + LATE;
    }

    /// A frame to send now, if the flight loop is late.
    pub fn poll(&mut self, now: Timestamp) -> Option<&FcBytes> {
        let standby = self.standby.as_ref()?;
        if now < self.next || now.since(self.refreshed) > LONGEST {
            return None;
        }
        self.next = now + EVERY;
        self.sent += 1;
        Some(standby)
    }

    /// When to poll.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        let is_over = self.next.since(self.refreshed) > LONGEST;
        (self.standby.is_some() && !is_over).then_some(self.next)
    }

    /// Frames sent so far.
    #[must_use]
    pub const fn sent(&self) -> u64 {
        self.sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(keeper: &mut Keeper, until_ms: u64) -> Vec<u64> {
        (0..until_ms)
            .filter(|ms| keeper.poll(Timestamp::from_ms(*ms)).is_some())
            .collect()
    }

    fn frame() -> FcBytes {
        [1, 2, 3].into_iter().collect()
    }

    #[test]
    fn a_loop_that_runs_is_never_spoken_over() {
        let mut keeper = Keeper::default();
        for ms in 0..1_000 {
            if ms % 25 == 0 {
                keeper.refresh(Timestamp::from_ms(ms), Some(&frame()));
            }
            assert!(keeper.poll(Timestamp::from_ms(ms)).is_none());
        }
    }

    #[test]
    fn a_held_loop_is_stood_in_for_from_a_tenth_of_a_second_on_and_not_for_ever() {
        let mut keeper = Keeper::default();
        keeper.refresh(Timestamp::ZERO, Some(&frame()));
        let times = times(&mut keeper, 5_000);
        assert_eq!(times[..3], [100, 140, 180]);
        assert_eq!(*times.last().unwrap(), 1_500);
        assert_eq!(keeper.deadline(), None);
    }

    #[test]
    fn on_the_floor_it_is_silent() {
        let mut keeper = Keeper::default();
        keeper.refresh(Timestamp::ZERO, None);
        assert!(times(&mut keeper, 2_000).is_empty());
        assert_eq!(keeper.deadline(), None);
    }
}
