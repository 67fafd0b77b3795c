//! How the link is doing: counters, round-trip time, service rate.

use super::depth::Depth;
use crate::frame::Counters;

/// Counters and averages since construction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Frames sent, RC among them.
    pub sent: u64,
    /// RC frames sent.
    pub rc_sent: u64,
    /// RC values replaced by newer ones before they could be sent.
    pub rc_replaced: u64,
    /// RC values dropped because they became too old before they could be sent.
    pub rc_expired: u64,
    /// Frames received that answer a request, refusals among them.
    pub replies: u64,
    /// Replies that were refusals.
    pub refused: u64,
    /// Frames received that answer nothing outstanding: late, or meant for an earlier client.
    pub stale_replies: u64,
    /// Replies whose payload did not fit their command.
    pub malformed: u64,
    /// Requests not answered in time.
    pub timeouts: u64,
    /// Frames with wrong checksum, impossible length or missing end.
    pub bad_frames: u64,
    /// Bytes received outside frames.
    pub noise_bytes: u64,
    /// Every kind of bad frame by itself.
    pub line: Counters,
    /// How often the controller was identified.
    pub identifications: u64,
    /// How often it fell silent.
    pub losses: u64,
    /// How often it started anew, asked to or not.
    pub restarts: u64,
    /// How often its control loop stood still.
    pub stalls: u64,
    /// How often its configuration was found changed.
    pub changes: u64,
    /// Events dropped, oldest first, because nobody polled them.
    pub events_dropped: u64,
    /// Request to reply in microseconds, moving average over about 8 replies.
    pub rtt_us: f64,
    /// Longest time from request to reply in microseconds.
    pub rtt_max_us: u64,
    /// Replies per second now, moving average over about a second.
    pub reply_rate_hz: f64,
    /// Replies per second the controller manages while it is given no pause, moving average over
    /// about 16 replies.
    pub service_rate_hz: f64,
    /// Requests kept outstanding to achieve that.
    pub depth: usize,
}

/// What the averages need to remember.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Averages {
    /// Last reply, as long as the controller was given the next request at once.
    busy_since_us: Option<u64>,
    /// Moving average of the time per reply of a busy controller; 0 = none yet.
    service_us: f64,
    window_start_us: u64,
    window_replies: u32,
    pub(super) depth: Depth,
}

const RATE_WINDOW_US: u64 = 500_000;

impl Averages {
    /// A reply came at `now_us` to a request sent at `sent_us`; at most `max_depth` requests may be
    /// kept outstanding.
    pub(super) fn on_reply(
        &mut self,
        statistics: &mut Statistics,
        now_us: u64,
        sent_us: u64,
        max_depth: usize,
    ) {
        let rtt_us = now_us.saturating_sub(sent_us);
        statistics.rtt_max_us = statistics.rtt_max_us.max(rtt_us);
        statistics.rtt_us = blend(statistics.rtt_us, rtt_us as f64, 1.0 / 8.0);
        if let Some(previous_us) = self.busy_since_us {
            let took_us = now_us.saturating_sub(previous_us);
            self.service_us = blend(self.service_us, took_us as f64, 1.0 / 16.0);
            self.depth.on_reply(now_us, took_us, max_depth);
        }
        self.busy_since_us = Some(now_us);
        statistics.depth = self.depth.now();
        let busy_us = if self.service_us > 0.0 {
            self.service_us
        } else {
            statistics.rtt_us
        };
        statistics.service_rate_hz = if busy_us > 0.0 { 1e6 / busy_us } else { 0.0 };
        self.window_replies += 1;
    }

    /// The controller has nothing to do, or did not answer: the time to the next reply says nothing
    /// about the service rate.
    pub(super) fn on_pause(&mut self) {
        self.busy_since_us = None;
        self.depth.forget();
    }

    /// Closes the window of the reply rate when it is over.
    pub(super) fn tick(&mut self, statistics: &mut Statistics, now_us: u64) {
        let elapsed_us = now_us.saturating_sub(self.window_start_us);
        if elapsed_us < RATE_WINDOW_US {
            return;
        }
        let rate_hz = f64::from(self.window_replies) * 1e6 / elapsed_us as f64;
        statistics.reply_rate_hz = blend(statistics.reply_rate_hz, rate_hz, 0.5);
        self.window_start_us = now_us;
        self.window_replies = 0;
    }
}

/// Exponentially weighted moving average that starts at the first value.
pub(super) fn blend(average: f64, value: f64, weight: f64) -> f64 {
    if average > 0.0 {
        average + weight * (value - average)
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn service_rate_is_the_pace_of_a_busy_controller_not_the_round_trip() {
        let (mut averages, mut statistics) = (Averages::default(), Statistics::default());
        // Two outstanding, one served every 10 ms: each waits 20 ms.
        for reply in 2..100_u64 {
            averages.on_reply(&mut statistics, reply * 10_000, (reply - 2) * 10_000, 1);
        }
        assert!(
            (statistics.service_rate_hz - 100.0).abs() < 0.1,
            "{statistics:?}"
        );
        assert!((statistics.rtt_us - 20_000.0).abs() < 1.0);
    }

    #[test]
    fn idle_time_between_requests_does_not_count() {
        let (mut averages, mut statistics) = (Averages::default(), Statistics::default());
        for second in 1..10_u64 {
            averages.on_reply(
                &mut statistics,
                second * 1_000_000,
                second * 1_000_000 - 4_000,
                1,
            );
            averages.on_pause();
        }
        assert!(
            (statistics.service_rate_hz - 250.0).abs() < 0.1,
            "{statistics:?}"
        );
    }
}
