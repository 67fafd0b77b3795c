//! The control loop's side: speeds in rad/s go out as messages of four bytes, each of which is acknowledged.
//!
//! | Rule | Source |
//! | --- | --- |
//! | speeds are limited before they are converted, and it is reported | thesis 1.2.7 |
//! | at most one message in 2 ms | its motor library |
//! | bytes in the order of the driver: motors 0, 2, 1, 3 | the same |
//! | no acknowledgement for 0.5 s: the driver is dead; stop is sent until it is acknowledged | chosen, below the second that is asked for |

use super::units::{IDLE_UNITS, Limited, SpeedRange, units};
use arrayvec::ArrayVec;
use std::time::Duration;
use vehicle::Timestamp;

/// Between two messages at least.
pub const SPACING: Duration = Duration::from_millis(2);
/// A driver that is silent for so long after a message is dead.
pub const ACK_TIMEOUT: Duration = Duration::from_millis(500);
/// Stop is said again so often until it is acknowledged.
const STOP_AGAIN: Duration = Duration::from_millis(10);

/// Front, left, rear, right as front, rear, left, right: the driver's order. Its own inverse.
#[must_use]
pub const fn driver_order<T: Copy>([front, left, rear, right]: [T; 4]) -> [T; 4] {
    [front, rear, left, right]
}

/// What became of a command.
#[derive(Clone, Debug, PartialEq)]
pub struct Commanded {
    /// Message for the driver; none within [`SPACING`] of the one before, or after a stop.
    pub message: Option<[u8; 4]>,
    /// Speeds after the limits, rad/s: what the filter believes.
    pub speeds_radps: [f64; 4],
    /// Speeds that were out of range.
    pub limited: ArrayVec<Limited, 4>,
}

/// Why the motors were stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// [`Commander::stop`].
    Asked,
    /// No acknowledgement for [`ACK_TIMEOUT`].
    DriverSilent,
}

/// The state machine. After each command or acknowledgement, and at [`deadline`](Self::deadline), call [`poll`](Self::poll) until none.
#[derive(Clone, Debug)]
pub struct Commander {
    range: SpeedRange,
    sent_at: Option<Timestamp>,
    /// Oldest message that nothing came back for.
    unanswered_since: Option<Timestamp>,
    next_ack: Option<u8>,
    lost_acks: u64,
    stop: Option<Stop>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Stop {
    reason: StopReason,
    /// When it is said again; none once acknowledged.
    again_at: Option<Timestamp>,
    is_sent: bool,
}

impl Commander {
    /// Speeds are kept within `range`.
    #[must_use]
    pub const fn new(range: SpeedRange) -> Self {
        Self {
            range,
            sent_at: None,
            unanswered_since: None,
            next_ack: None,
            lost_acks: 0,
            stop: None,
        }
    }

    /// Another range: the weight was changed.
    pub const fn set_range(&mut self, range: SpeedRange) {
        self.range = range;
    }

    /// Commands speeds, rad/s.
    pub fn command(&mut self, now: Timestamp, speeds_radps: [f64; 4]) -> Commanded {
        let mut limited = ArrayVec::new();
        let mut given = [0.0; 4];
        for (motor, asked) in speeds_radps.into_iter().enumerate() {
            let (speed, report) = self.range.limit(motor, asked);
            given[motor] = speed;
            limited.extend(report);
        }
        Commanded {
            message: self.send(now, given.map(units)),
            speeds_radps: given,
            limited,
        }
    }

    /// Starts the motors and leaves them idling.
    pub fn idle(&mut self, now: Timestamp) -> Option<[u8; 4]> {
        self.send(now, [IDLE_UNITS; 4])
    }

    /// Sends units as they are, for the bench. 0 stops.
    pub fn units(&mut self, now: Timestamp, units: [u8; 4]) -> Option<[u8; 4]> {
        self.send(now, units.map(|u| u.min(super::MAX_UNITS)))
    }

    /// Stops the motors; nothing else is sent until [`rearm`](Self::rearm).
    pub fn stop(&mut self, now: Timestamp) {
        self.begin_stop(now, StopReason::Asked);
    }

    /// Allows commands again after a stop.
    pub fn rearm(&mut self) {
        self.stop = None;
        self.unanswered_since = None;
    }

    /// Takes what the driver sent back.
    pub fn acknowledged(&mut self, reply: &[u8]) {
        let [b'A', b'C', b'K', counter] = *reply else {
            return;
        };
        if let Some(expected) = self.next_ack {
            self.lost_acks += u64::from(counter.wrapping_sub(expected));
        }
        self.next_ack = Some(counter.wrapping_add(1));
        self.unanswered_since = None;
        if let Some(stop) = self.stop.as_mut().filter(|s| s.is_sent) {
            stop.again_at = None;
        }
    }

    /// The next message that is due by itself: stop, again and again until it is acknowledged.
    pub fn poll(&mut self, now: Timestamp) -> Option<[u8; 4]> {
        if let Some(since) = self.unanswered_since
            && self.stop.is_none()
            && now >= since + ACK_TIMEOUT
        {
            self.begin_stop(now, StopReason::DriverSilent);
        }
        let stop = self.stop.as_mut()?;
        if now < stop.again_at? {
            return None;
        }
        stop.again_at = Some(now + STOP_AGAIN);
        stop.is_sent = true;
        self.sent_at = Some(now);
        Some([0; 4])
    }

    /// When to poll next.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        match &self.stop {
            Some(stop) => stop.again_at,
            None => self.unanswered_since.map(|t| t + ACK_TIMEOUT),
        }
    }

    /// Why the motors were stopped, if they were.
    #[must_use]
    pub fn stopped(&self) -> Option<StopReason> {
        self.stop.map(|s| s.reason)
    }

    /// True when a stop was sent and acknowledged.
    #[must_use]
    pub fn is_stop_acknowledged(&self) -> bool {
        self.stop.is_some_and(|s| s.again_at.is_none())
    }

    /// Acknowledgements that never came, by their counter.
    #[must_use]
    pub const fn lost_acks(&self) -> u64 {
        self.lost_acks
    }

    fn begin_stop(&mut self, now: Timestamp, reason: StopReason) {
        // A stop that runs keeps its reason.
        self.stop.get_or_insert(Stop {
            reason,
            again_at: Some(now),
            is_sent: false,
        });
    }

    fn send(&mut self, now: Timestamp, units: [u8; 4]) -> Option<[u8; 4]> {
        let is_too_soon = self.sent_at.is_some_and(|t| now < t + SPACING);
        if is_too_soon || self.stop.is_some() {
            return None;
        }
        self.sent_at = Some(now);
        self.unanswered_since.get_or_insert(now);
        Some(driver_order(units))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOVER: [f64; 4] = [312.498; 4];

    fn commander() -> Commander {
        Commander::new(SpeedRange::around(312.498))
    }

    fn ms(t: u64) -> Timestamp {
        Timestamp::from_ms(t)
    }

    #[test]
    fn a_command_of_1000_radps_is_limited_reported_and_never_sent() {
        let asked = [1000.0, 312.498, 0.0, f64::NAN];
        let done = commander().command(ms(0), asked);
        // Driver order: 0, 2, 1, 3; the slowest, 238 rad/s, are 114.
        assert_eq!(done.message, Some([220, 114, 167, 114]));
        let motors: Vec<usize> = done.limited.iter().map(|l| l.motor).collect();
        assert_eq!(motors, [0, 2, 3]);
        assert!((done.speeds_radps[0] - 368.16).abs() < 1e-12);
    }

    #[test]
    fn messages_keep_two_milliseconds_apart() {
        let mut c = commander();
        assert!(c.command(ms(10), HOVER).message.is_some());
        assert!(c.command(ms(11), HOVER).message.is_none());
        assert!(c.command(ms(12), HOVER).message.is_some());
    }

    #[test]
    fn a_missing_acknowledgement_stops_in_half_a_second() {
        let mut c = commander();
        let mut stopped_at = None;
        for t in (0..2000).step_by(10) {
            let sent = c.command(ms(t), HOVER).message.is_some();
            // The driver dies at 1 s.
            if t < 1000 {
                assert!(sent);
                c.acknowledged(&[b'A', b'C', b'K', (t / 10) as u8]);
            }
            if c.poll(ms(t)) == Some([0; 4]) {
                stopped_at.get_or_insert(t);
                assert!(!sent || t <= 1500, "after a stop nothing but stop is sent");
            }
        }
        assert_eq!(stopped_at, Some(1500));
        assert_eq!(c.stopped(), Some(StopReason::DriverSilent));
        assert!(!c.is_stop_acknowledged());
        assert_eq!(c.lost_acks(), 0);
    }

    #[test]
    fn stop_is_said_until_it_is_acknowledged() {
        let mut c = commander();
        c.command(ms(0), HOVER);
        c.stop(ms(1));
        assert_eq!(c.poll(ms(1)), Some([0; 4]));
        assert_eq!(c.poll(ms(5)), None);
        assert_eq!(c.poll(ms(11)), Some([0; 4]));
        c.acknowledged(b"NAK\0");
        assert!(!c.is_stop_acknowledged());
        c.acknowledged(b"ACK\x07");
        assert!(c.is_stop_acknowledged());
        assert_eq!((c.poll(ms(500)), c.deadline()), (None, None));
        assert!(c.command(ms(600), HOVER).message.is_none());
        c.rearm();
        assert!(c.command(ms(601), HOVER).message.is_some());
    }

    #[test]
    fn lost_acknowledgements_are_counted_by_their_counter() {
        let mut c = commander();
        for counter in [254, 255, 0, 3] {
            c.acknowledged(&[b'A', b'C', b'K', counter]);
        }
        assert_eq!(c.lost_acks(), 2);
    }
}
