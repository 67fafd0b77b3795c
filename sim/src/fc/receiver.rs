//! The receiver side of Betaflight: sticks that come by MSP, and what happens when they stop.
//!
//! | Silence | What happens (measured on Betaflight 4.6) |
//! | --- | --- |
//! | 0.15 s | RX_FAILSAFE is flagged, the last sticks hold |
//! | 0.30 s | sticks centred, throttle at the bottom: motors idle; switches hold |
//! | 1.5 s | stage 2, procedure DROP: disarm |

use core::time::Duration;
use vehicle::Timestamp;

/// Channels of Betaflight.
pub(super) const CHANNELS: usize = 18;
/// A frame gap longer than this flags the receiver.
const FLAG_AFTER: Duration = Duration::from_millis(150);
/// Sticks hold this long.
const HOLD: Duration = Duration::from_millis(300);
/// Failsafe stage 2 begins.
const STAGE_TWO_AFTER: Duration = Duration::from_millis(1500);
/// Frames must come without a gap this long before the flag goes (`failsafe_recovery_delay` 5): so a steady 6 Hz never clears it.
const RECOVERY: Duration = Duration::from_millis(500);
/// Pulses outside are invalid (`rx_min_usec`, `rx_max_usec`).
const VALID_US: core::ops::RangeInclusive<u16> = 885..=2115;
/// Throttle without a signal.
const NO_SIGNAL_THROTTLE_US: u16 = 885;
/// Receiver map AETR: where Roll, Pitch, Yaw, Throttle stand in a SET_RAW_RC.
pub(super) const AETR: [usize; 4] = [0, 1, 3, 2];

/// Pulse widths in Roll, Pitch, Yaw, Throttle, Aux1... order with their freshness.
#[derive(Clone, Debug)]
pub(super) struct Receiver {
    channels_us: [u16; CHANNELS],
    last_frame: Option<Timestamp>,
    /// Beginning of the present run of frames without a gap.
    steady_since: Timestamp,
    /// The flag has been up and frames have not yet been steady for long enough.
    recovering: bool,
}

impl Receiver {
    pub(super) const fn new() -> Self {
        let mut channels_us = [1500; CHANNELS];
        channels_us[3] = NO_SIGNAL_THROTTLE_US;
        Self {
            channels_us,
            last_frame: None,
            steady_since: Timestamp::ZERO,
            recovering: false,
        }
    }

    /// A SET_RAW_RC in receiver map order. An empty one counts as a frame, as in the firmware.
    pub(super) fn take(&mut self, now: Timestamp, wire_us: &[u16]) {
        let gap = self.last_frame.map(|last| now.since(last));
        if gap.is_none_or(|gap| gap > FLAG_AFTER) {
            self.steady_since = now;
            self.recovering = gap.is_some();
        }
        self.last_frame = Some(now);
        for (channel, value) in self.channels_us.iter_mut().enumerate() {
            let position = AETR.get(channel).copied().unwrap_or(channel);
            match wire_us.get(position) {
                Some(us) if VALID_US.contains(us) => *value = *us,
                // Not sent or invalid: sticks centre, throttle drops, switches hold.
                _ if channel == 3 => *value = NO_SIGNAL_THROTTLE_US,
                _ if channel < 3 => *value = 1500,
                _ => {}
            }
        }
    }

    /// Called often: lets old sticks go.
    pub(super) fn age(&mut self, now: Timestamp) {
        if self.silence(now) > HOLD {
            self.channels_us[..4].copy_from_slice(&[1500, 1500, 1500, NO_SIGNAL_THROTTLE_US]);
        }
    }

    fn silence(&self, now: Timestamp) -> Duration {
        self.last_frame
            .map_or(Duration::MAX, |last| now.since(last))
    }

    /// False while RX_FAILSAFE is flagged.
    pub(super) fn is_ok(&self, now: Timestamp) -> bool {
        let steady = now.since(self.steady_since) >= RECOVERY || !self.recovering;
        self.silence(now) <= FLAG_AFTER && steady
    }

    /// Failsafe stage 2.
    pub(super) fn is_lost(&self, now: Timestamp) -> bool {
        self.silence(now) > STAGE_TWO_AFTER
    }

    /// Roll, Pitch, Yaw, Throttle, Aux1...
    pub(super) const fn channels_us(&self) -> &[u16; CHANNELS] {
        &self.channels_us
    }

    /// Roll right, pitch **nose down**, yaw clockwise in -1..=1; throttle 0..=1 above 1050 us.
    pub(super) fn sticks(&self) -> [f64; 4] {
        let [roll, pitch, yaw, throttle] = [0, 1, 2, 3].map(|i| f64::from(self.channels_us[i]));
        let centred = |us: f64| ((us - 1500.0) / 500.0).clamp(-1.0, 1.0);
        let lift = ((throttle - f64::from(super::MIN_CHECK_US)) / 950.0).clamp(0.0, 1.0);
        [centred(roll), centred(pitch), centred(yaw), lift]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: [u16; 5] = [1600, 1400, 1300, 1550, 2000];

    fn ms(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    #[test]
    fn channels_are_sorted_from_aetr_and_those_not_sent_keep_or_centre() {
        let mut rx = Receiver::new();
        rx.take(ms(0), &FRAME);
        assert_eq!(rx.channels_us()[..6], [1600, 1400, 1550, 1300, 2000, 1500]);
        rx.take(ms(10), &[1600, 0, 3000]);
        assert_eq!(rx.channels_us()[..5], [1600, 1500, 1500, 885, 2000]);
    }

    #[test]
    fn silence_flags_then_drops_throttle_then_is_lost() {
        let mut rx = Receiver::new();
        assert!(!rx.is_ok(ms(0)), "never heard");
        rx.take(ms(1000), &FRAME);
        assert!(rx.is_ok(ms(1150)) && !rx.is_ok(ms(1151)));
        rx.age(ms(1300));
        assert_eq!(rx.channels_us()[3], 1300, "holds for 0.30 s");
        rx.age(ms(1301));
        assert_eq!(rx.channels_us()[..5], [1500, 1500, 1500, 885, 2000]);
        assert!(!rx.is_lost(ms(2500)) && rx.is_lost(ms(2501)));
    }

    #[test]
    fn eight_hertz_keep_the_link_and_six_never_do() {
        for (period, ok) in [(125, true), (166, false)] {
            let mut rx = Receiver::new();
            let always = (0..40).fold(true, |all, i| {
                rx.take(ms(i * period), &FRAME);
                all & (i == 0 || rx.is_ok(ms(i * period)))
            });
            assert_eq!(always, ok, "{period} ms");
        }
    }

    #[test]
    fn after_a_gap_frames_must_be_steady_for_half_a_second() {
        let mut rx = Receiver::new();
        rx.take(ms(0), &FRAME);
        for t in (400..2000).step_by(20) {
            rx.take(ms(t), &FRAME);
            assert_eq!(rx.is_ok(ms(t)), t >= 900, "{t}");
        }
    }
}
