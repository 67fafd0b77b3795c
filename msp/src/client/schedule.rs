//! What is asked how often, and whose turn it is.
//!
//! The turn goes to whoever is due and has the highest score: how many of its own intervals it is
//! late, plus a bonus by priority. So a fast request goes before a slow one while there is room for
//! both, and when there is not, all of them slow down in proportion and none starves.

use crate::command;
use crate::firmware::{Firmware, Identity};
use arrayvec::ArrayVec;

/// One request to repeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Poll {
    /// Command number; its request has no payload.
    pub command: u16,
    /// Time between requests in microseconds, at least 1000.
    pub interval_us: u32,
    /// Who goes first.
    pub priority: Priority,
}

/// Who goes first when several requests are due.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Priority {
    /// Can wait.
    Slow,
    /// Safety of the link: status.
    Normal,
    /// The control loop lives on it. Goes into one MULTIPLE_MSP frame with its like where that
    /// exists.
    Fast,
}

/// Most requests in a schedule.
pub const MAX_POLLS: usize = 16;

/// What is asked how often.
pub type Schedule = ArrayVec<Poll, MAX_POLLS>;

/// A schedule for a controller that serves 100 requests a second (the default of Betaflight and
/// INAV), of which 30 to 40 are RC. With MULTIPLE_MSP: attitude, IMU and altitude together 40 Hz;
/// without: attitude 25 Hz, IMU and altitude 15 Hz. Status 5 Hz, battery 2 Hz.
#[must_use]
pub fn default_schedule(identity: &Identity) -> Schedule {
    let poll = |command, rate_hz: u32, priority| Poll {
        command,
        interval_us: 1_000_000 / rate_hz,
        priority,
    };
    let (attitude_hz, imu_hz) = if identity.has_multiple_msp {
        (40, 40)
    } else {
        (25, 15)
    };
    let battery = match identity.firmware {
        Firmware::Betaflight => command::BATTERY_STATE,
        Firmware::Inav => command::INAV_ANALOG,
        Firmware::Cleanflight | Firmware::MultiWii | Firmware::Other(_) => command::ANALOG,
    };
    Schedule::from_iter([
        poll(command::ATTITUDE, attitude_hz, Priority::Fast),
        poll(command::RAW_IMU, imu_hz, Priority::Fast),
        poll(command::ALTITUDE, imu_hz, Priority::Fast),
        poll(identity.status_command(), 5, Priority::Normal),
        poll(battery, 2, Priority::Slow),
    ])
}

/// The schedule at work.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns {
    entries: ArrayVec<Entry, MAX_POLLS>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    poll: Poll,
    due_us: u64,
    /// When it was last sent.
    sent_us: u64,
    in_flight: bool,
    /// The controller does not answer it inside a batch.
    single: Penalty,
    /// The controller refuses it.
    refused: Penalty,
}

/// Something the controller did not do. It is not asked for it again for a while, each time longer; but
/// it is asked again, since one garbled reply or another client's refusal must not blind a vehicle for the
/// rest of its flight.
#[derive(Clone, Copy, Debug, Default)]
struct Penalty {
    until_us: u64,
    times: u8,
}

impl Penalty {
    /// First and longest pause of a refusal, and of a batch: asking in vain costs nothing at the last rate.
    const REFUSED_US: [u64; 2] = [1_000_000, 4_000_000];
    const SINGLE_US: [u64; 2] = [4_000_000, 16_000_000];

    fn extend(&mut self, now_us: u64, [first_us, longest_us]: [u64; 2]) {
        self.until_us = now_us + (first_us << self.times).min(longest_us);
        self.times = (self.times + 1).min(8);
    }
}

/// Commands of one request: one, or the members of a batch.
pub(super) type Members = ArrayVec<u16, MAX_POLLS>;

/// Someone whose turn it may be.
#[derive(Clone, Debug)]
pub(super) struct Turn {
    pub(super) members: Members,
    pub(super) score: u64,
    /// Late by a whole interval or more.
    pub(super) is_overdue: bool,
}

/// Points of one interval of lateness.
const INTERVAL_POINTS: u64 = 16;

/// Score of something due since `due_us` that wants to be served every `interval_us`; `None` when
/// it is not due.
pub(super) fn score(now_us: u64, due_us: u64, interval_us: u64, priority: Priority) -> Option<u64> {
    let late_us = now_us.checked_sub(due_us)?;
    let bonus = match priority {
        Priority::Slow => 0,
        Priority::Normal => INTERVAL_POINTS,
        Priority::Fast => 2 * INTERVAL_POINTS,
    };
    Some((late_us.saturating_mul(INTERVAL_POINTS) / interval_us).saturating_add(bonus))
}

impl Turns {
    pub(super) fn new(schedule: &Schedule, now_us: u64) -> Self {
        let entry = |poll: &Poll| Entry {
            poll: Poll {
                interval_us: poll.interval_us.max(1000),
                ..*poll
            },
            due_us: now_us,
            sent_us: 0,
            in_flight: false,
            single: Penalty {
                until_us: if poll.command > 254 { u64::MAX } else { 0 },
                times: 0,
            },
            refused: Penalty::default(),
        };
        Self {
            entries: schedule.iter().map(entry).collect(),
        }
    }

    /// What to do with a slot nobody asked for: the fast request that has waited longest, measured in its
    /// own intervals, unless it was sent less than `pause_us` ago. So spare slots raise all fast rates in
    /// proportion. One that is in flight may go again: on a line longer than a slot several must be.
    pub(super) fn fill(&self, now_us: u64, pause_us: u64, batches: bool) -> Option<Turn> {
        // Millionths of an interval.
        let waited = |entry: &Entry| {
            let waited_us = now_us.saturating_sub(entry.sent_us);
            waited_us.saturating_mul(1_000_000) / u64::from(entry.poll.interval_us)
        };
        let first = self
            .entries
            .iter()
            .filter(|entry| entry.may_fill(now_us) && now_us >= entry.sent_us + pause_us)
            // The first of equals, as in `next`.
            .rev()
            .max_by_key(|entry| waited(entry))?;
        let rides = |entry: &Entry| entry.may_fill(now_us) && waited(entry) >= waited(first) / 2;
        Some(Turn {
            members: self.batch(first, now_us, batches, rides),
            score: 0,
            is_overdue: false,
        })
    }

    /// When [`Self::fill`] has something to send.
    pub(super) fn next_fill_us(&self, pause_us: u64) -> Option<u64> {
        let fast = |entry: &&Entry| entry.poll.priority == Priority::Fast;
        self.entries
            .iter()
            .filter(fast)
            .map(|entry| (entry.sent_us + pause_us).max(entry.refused.until_us))
            .min()
    }

    /// The most urgent request; `batches` says whether requests of fast priority may go together.
    pub(super) fn next(&self, now_us: u64, batches: bool) -> Option<Turn> {
        let mut best: Option<(u64, &Entry)> = None;
        let idle = |entry: &&Entry| entry.is_idle() && now_us >= entry.refused.until_us;
        for entry in self.entries.iter().filter(idle) {
            let score = entry.score(now_us);
            if score.is_some_and(|score| best.is_none_or(|(most, _)| score > most)) {
                best = score.map(|score| (score, entry));
            }
        }
        let (score, first) = best?;
        let is_overdue = now_us - first.due_us >= u64::from(first.poll.interval_us);
        // Whoever is due within half an interval rides along: together they cost one turn.
        let rides = |entry: &Entry| {
            entry.is_idle() && entry.due_us <= now_us + u64::from(entry.poll.interval_us / 2)
        };
        Some(Turn {
            members: self.batch(first, now_us, batches, rides),
            score,
            is_overdue,
        })
    }

    /// `first` and who may go with it.
    fn batch(
        &self,
        first: &Entry,
        now_us: u64,
        batches: bool,
        rides: impl Fn(&Entry) -> bool,
    ) -> Members {
        let mut members = Members::from_iter([first.poll.command]);
        if batches && first.is_batchable(now_us) {
            let others = self.entries.iter().filter(|entry| {
                entry.is_batchable(now_us)
                    && now_us >= entry.refused.until_us
                    && entry.poll.command != first.poll.command
                    && rides(entry)
            });
            members.extend(others.map(|entry| entry.poll.command).take(MAX_POLLS - 1));
        }
        members
    }

    /// When somebody becomes due.
    pub(super) fn next_due_us(&self) -> Option<u64> {
        self.entries
            .iter()
            .filter(|entry| entry.is_idle())
            .map(|entry| entry.due_us.max(entry.refused.until_us))
            .min()
    }

    pub(super) fn on_sent(&mut self, now_us: u64, members: &[u16]) {
        for entry in self.members(members) {
            let interval_us = u64::from(entry.poll.interval_us);
            entry.in_flight = true;
            // A little late: keep the grid. Very late: do not catch up with a burst.
            let on_grid = now_us < entry.due_us + interval_us;
            let from_us = if on_grid { entry.due_us } else { now_us };
            // Early, with a spare slot: the interval begins now.
            entry.due_us = from_us.min(now_us) + interval_us;
            entry.sent_us = now_us;
        }
    }

    pub(super) fn on_answered(&mut self, members: &[u16]) {
        for entry in self.members(members) {
            entry.in_flight = false;
            entry.refused.times = 0;
            if members.len() > 1 {
                entry.single.times = 0;
            }
        }
    }

    /// Not answered: ask again as soon as possible.
    pub(super) fn on_timeout(&mut self, now_us: u64, members: &[u16]) {
        for entry in self.members(members) {
            entry.in_flight = false;
            entry.due_us = entry.due_us.min(now_us);
        }
    }

    /// Whether it is news that they are refused.
    pub(super) fn on_refused(&mut self, now_us: u64, members: &[u16]) -> bool {
        let mut is_new = false;
        for entry in self.members(members) {
            entry.in_flight = false;
            is_new |= entry.refused.times == 0;
            entry.refused.extend(now_us, Penalty::REFUSED_US);
        }
        is_new
    }

    /// The controller left them out of the reply to a batch, or refused the batch.
    pub(super) fn on_left_out(&mut self, now_us: u64, members: &[u16]) {
        for entry in self.members(members) {
            entry.in_flight = false;
            entry.single.extend(now_us, Penalty::SINGLE_US);
        }
    }

    /// Forgets what is in flight.
    pub(super) fn reset(&mut self) {
        self.entries
            .iter_mut()
            .for_each(|entry| entry.in_flight = false);
    }

    /// Requests per second the schedule asks for, a batch counted once.
    pub(super) fn demand_hz(&self, batches: bool) -> f64 {
        let asked = || self.entries.iter().filter(|entry| entry.refused.times == 0);
        let rate_hz = |entry: &Entry| 1e6 / f64::from(entry.poll.interval_us);
        let in_batch = |entry: &&Entry| {
            batches && entry.poll.priority == Priority::Fast && entry.single.times == 0
        };
        let together_hz = asked().filter(in_batch).map(rate_hz).fold(0.0, f64::max);
        let alone_hz: f64 = asked().filter(|entry| !in_batch(entry)).map(rate_hz).sum();
        together_hz + alone_hz
    }

    fn members<'a>(&'a mut self, members: &'a [u16]) -> impl Iterator<Item = &'a mut Entry> {
        self.entries
            .iter_mut()
            .filter(|entry| members.contains(&entry.poll.command))
    }
}

impl Entry {
    const fn is_idle(&self) -> bool {
        !self.in_flight
    }

    fn may_fill(&self, now_us: u64) -> bool {
        now_us >= self.refused.until_us && self.poll.priority == Priority::Fast
    }

    fn is_batchable(&self, now_us: u64) -> bool {
        self.poll.priority == Priority::Fast && now_us >= self.single.until_us
    }

    fn score(&self, now_us: u64) -> Option<u64> {
        score(
            now_us,
            self.due_us,
            self.poll.interval_us.into(),
            self.poll.priority,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FAST: Poll = Poll {
        command: command::ATTITUDE,
        interval_us: 25_000,
        priority: Priority::Fast,
    };
    const SLOW: Poll = Poll {
        command: command::ANALOG,
        interval_us: 500_000,
        priority: Priority::Slow,
    };

    /// Serves one request every `service_us` for ten seconds and counts how often each command had
    /// its turn.
    fn serve(polls: &[Poll], service_us: u64) -> Vec<usize> {
        let mut turns = Turns::new(&polls.iter().copied().collect(), 0);
        let mut served = vec![0; polls.len()];
        for now_us in (0..10_000_000).step_by(usize::try_from(service_us).unwrap()) {
            let Some(turn) = turns.next(now_us, false) else {
                continue;
            };
            turns.on_sent(now_us, &turn.members);
            turns.on_answered(&turn.members);
            let index = polls
                .iter()
                .position(|poll| poll.command == turn.members[0]);
            served[index.unwrap()] += 1;
        }
        served
    }

    #[test]
    fn with_room_everybody_gets_the_asked_rate() {
        assert_eq!(serve(&[FAST, SLOW], 1_000), [400, 20]);
    }

    #[test]
    fn without_room_everybody_slows_down_and_nobody_starves() {
        // 42 requests a second wanted, 10 served.
        let served = serve(&[FAST, SLOW], 100_000);
        assert_eq!(served.iter().sum::<usize>(), 100);
        assert!(served[1] >= 3 && served[0] >= 80, "{served:?}");
    }

    #[test]
    fn of_two_that_are_due_the_faster_class_goes_first() {
        let turns = Turns::new(&Schedule::from_iter([SLOW, FAST]), 0);
        assert_eq!(
            turns.next(0, false).unwrap().members.as_slice(),
            [FAST.command]
        );
    }

    #[test]
    fn fast_requests_that_are_due_together_go_together() {
        let imu = Poll {
            command: command::RAW_IMU,
            ..FAST
        };
        let mut turns = Turns::new(&Schedule::from_iter([FAST, imu, SLOW]), 0);
        let turn = turns.next(0, true).unwrap();
        assert_eq!(
            turn.members.as_slice(),
            [command::ATTITUDE, command::RAW_IMU]
        );
        turns.on_sent(0, &turn.members);
        assert_eq!(
            turns.next(0, true).unwrap().members.as_slice(),
            [command::ANALOG]
        );
        assert!((turns.demand_hz(true) - 42.0).abs() < 1e-9);
        assert!((turns.demand_hz(false) - 82.0).abs() < 1e-9);
    }

    #[test]
    fn a_refused_request_rests_ever_longer_and_one_left_out_of_a_batch_goes_alone() {
        let imu = Poll {
            command: command::RAW_IMU,
            ..FAST
        };
        let mut turns = Turns::new(&Schedule::from_iter([FAST, imu]), 0);
        turns.on_left_out(0, &[command::ATTITUDE]);
        assert_eq!(turns.next(0, true).unwrap().members.len(), 1);
        let both = [command::ATTITUDE, command::RAW_IMU];
        assert!(turns.on_refused(0, &both));
        assert!(turns.next(999_999, true).is_none());
        assert_eq!(turns.next_due_us(), Some(1_000_000));
        assert!(turns.next(1_000_000, true).is_some());
        assert!(!turns.on_refused(1_000_000, &both), "no news");
        assert_eq!(turns.next_due_us(), Some(3_000_000));
        turns.on_answered(&both);
        assert!(turns.on_refused(4_000_000, &both));
    }

    #[test]
    fn a_long_pause_is_not_caught_up_with_a_burst() {
        let mut turns = Turns::new(&Schedule::from_iter([FAST]), 0);
        let turn = turns.next(10_000_000, false).unwrap();
        assert!(turn.is_overdue);
        turns.on_sent(10_000_000, &turn.members);
        turns.on_answered(&turn.members);
        assert!(turns.next(10_024_999, false).is_none());
        assert!(turns.next(10_025_000, false).is_some());
    }
}
