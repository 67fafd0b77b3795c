//! The receiver side: sticks by MSP and by the pilot's radio, which of them counts, and what happens when they stop.
//!
//! | Silence | What happens (Betaflight; the other manners have the same steps at other times) |
//! | --- | --- |
//! | 0.15 s | RX_FAILSAFE is flagged, the last sticks hold |
//! | 0.30 s | sticks centred, throttle at the bottom: motors idle; switches hold |
//! | 1.5 s | stage 2, procedure DROP: disarm |

use super::manner::{Override, ReceiverRules};
use super::settings::Source;
use core::time::Duration;
use serde::{Deserialize, Serialize};
use vehicle::Timestamp;

/// Channels that any manner has.
pub(super) const CHANNELS: usize = 34;
/// Pulses outside are invalid (`rx_min_usec`, `rx_max_usec`).
const VALID_US: core::ops::RangeInclusive<u16> = 885..=2115;
/// Throttle without a signal.
const NO_SIGNAL_THROTTLE_US: u16 = 885;
/// Sticks without a signal.
const NO_SIGNAL_US: [u16; 4] = [1500, 1500, 1500, NO_SIGNAL_THROTTLE_US];
/// Receiver map AETR: where Roll, Pitch, Yaw, Throttle stand in a SET_RAW_RC.
pub(super) const AETR: [usize; 4] = [0, 1, 3, 2];
/// MultiWii's order.
pub(super) const RPYT: [usize; 4] = [0, 1, 2, 3];

/// Channels of RXFAIL_CONFIG.
pub(super) const RXFAIL_CHANNELS: usize = 18;

/// What a channel does once its signal has been away for the hold time (`rxfail`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WithoutSignal {
    /// Sticks centre, throttle drops. Channels beyond the sticks hold instead.
    Auto,
    /// Keeps the last value.
    Hold,
    /// Takes this value, us.
    Set(u16),
}

impl WithoutSignal {
    /// Sticks `Auto`, switches `Hold`.
    pub(super) const fn as_delivered(channel: usize) -> Self {
        if channel < 4 { Self::Auto } else { Self::Hold }
    }

    /// Three bytes of RXFAIL_CONFIG.
    pub(super) fn emit(self, channel: usize, out: &mut Vec<u8>) {
        let (mode, us) = match self {
            Self::Auto if channel == 3 => (0, NO_SIGNAL_THROTTLE_US),
            Self::Auto => (0, 1500),
            Self::Hold => (1, 1500),
            Self::Set(us) => (2, us),
        };
        out.push(mode);
        out.extend_from_slice(&us.to_le_bytes());
    }

    /// From mode and value; none if the firmware refuses them.
    pub(super) fn parse(mode: u8, us: u16) -> Option<Self> {
        match mode {
            0 => Some(Self::Auto),
            1 => Some(Self::Hold),
            2 if (750..=2250).contains(&us) => Some(Self::Set(us)),
            _ => None,
        }
    }
}

/// What the pilot's transmitter sends: pulse widths, us.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Radio {
    /// Roll (right), pitch (nose **down**), yaw (clockwise), throttle.
    pub sticks_us: [u16; 4],
    /// Aux1 to Aux8.
    pub aux_us: [u16; 8],
}

impl Default for Radio {
    /// Sticks centred, throttle and all switches down.
    fn default() -> Self {
        Self {
            sticks_us: [1500, 1500, 1500, 1000],
            aux_us: [1000; 8],
        }
    }
}

/// One way that sticks come: pulse widths in Roll, Pitch, Yaw, Throttle, Aux1... order with their freshness.
#[derive(Clone, Debug)]
struct Feed {
    channels_us: [u16; CHANNELS],
    /// Channels that the last frame held validly, bit i = channel i.
    valid: u64,
    last_frame: Option<Timestamp>,
    /// Beginning of the present run of frames without a gap.
    steady_since: Timestamp,
    /// The flag has been up and frames have not yet been steady for long enough.
    recovering: bool,
}

impl Feed {
    const fn new() -> Self {
        let mut channels_us = [1500; CHANNELS];
        channels_us[3] = NO_SIGNAL_THROTTLE_US;
        Self {
            channels_us,
            valid: 0,
            last_frame: None,
            steady_since: Timestamp::ZERO,
            recovering: false,
        }
    }

    fn take(
        &mut self,
        now: Timestamp,
        rules: &ReceiverRules,
        value: impl Fn(usize) -> Option<u16>,
    ) {
        let gap = self.last_frame.map(|last| now.since(last));
        if gap.is_none_or(|gap| gap > rules.flag_after) {
            self.steady_since = now;
            self.recovering = gap.is_some();
        }
        self.last_frame = Some(now);
        self.valid = 0;
        for (channel, us) in self.channels_us.iter_mut().enumerate() {
            match value(channel) {
                Some(new) if VALID_US.contains(&new) => {
                    *us = new;
                    self.valid |= 1 << channel;
                }
                // Not sent or invalid: sticks centre, throttle drops, switches hold.
                _ => *us = NO_SIGNAL_US.get(channel).copied().unwrap_or(*us),
            }
        }
    }

    fn silence(&self, now: Timestamp) -> Duration {
        self.last_frame
            .map_or(Duration::MAX, |last| now.since(last))
    }

    /// With old sticks let go.
    fn channels_us(
        &self,
        now: Timestamp,
        hold: Duration,
        then: &[WithoutSignal; RXFAIL_CHANNELS],
    ) -> [u16; CHANNELS] {
        let mut channels_us = self.channels_us;
        if self.silence(now) > hold {
            for (channel, (us, then)) in channels_us.iter_mut().zip(then).enumerate() {
                match then {
                    WithoutSignal::Auto => *us = NO_SIGNAL_US.get(channel).copied().unwrap_or(*us),
                    WithoutSignal::Hold => {}
                    WithoutSignal::Set(value) => *us = *value,
                }
            }
        }
        channels_us
    }

    fn is_ok(&self, now: Timestamp, rules: &ReceiverRules) -> bool {
        let steady = now.since(self.steady_since) >= rules.recovery || !self.recovering;
        self.silence(now) <= rules.flag_after && steady
    }
}

/// How the two ways are mixed now.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mixing<'a> {
    /// Channels that MSP may override, bit i = channel i.
    pub(super) mask: u32,
    /// The override box is on.
    pub(super) box_on: bool,
    /// The channel that selects it.
    pub(super) switch: Option<usize>,
    /// What each channel does without a signal.
    pub(super) without_signal: &'a [WithoutSignal; RXFAIL_CHANNELS],
}

/// Both ways, and what comes out of them.
#[derive(Clone, Debug)]
pub(super) struct Receiver {
    rules: &'static ReceiverRules,
    beside_radio: Override,
    source: Source,
    msp: Feed,
    radio: Feed,
    channels_us: [u16; CHANNELS],
}

impl Receiver {
    pub(super) const fn new(
        rules: &'static ReceiverRules,
        beside_radio: Override,
        source: Source,
    ) -> Self {
        let msp = Feed::new();
        Self {
            rules,
            beside_radio,
            source,
            channels_us: msp.channels_us,
            msp,
            radio: Feed::new(),
        }
    }

    /// A SET_RAW_RC; `order` says where the sticks stand in it. An empty one counts as a frame, as in the firmware.
    pub(super) fn take(&mut self, now: Timestamp, wire_us: &[u16], order: [usize; 4]) {
        let place = |channel: usize| order.get(channel).copied().unwrap_or(channel);
        self.msp.take(now, self.rules, |channel| {
            wire_us.get(place(channel)).copied()
        });
    }

    /// A frame of the pilot's radio.
    pub(super) fn hear(&mut self, now: Timestamp, radio: &Radio) {
        self.radio.take(now, self.rules, |channel| {
            let aux = || radio.aux_us.get(channel - 4);
            radio.sticks_us.get(channel).or_else(aux).copied()
        });
    }

    /// Called often: lets old sticks go and mixes the two ways.
    pub(super) fn update(&mut self, now: Timestamp, rules: &Mixing<'_>) {
        let main = match self.source {
            Source::Msp => &self.msp,
            Source::Radio => &self.radio,
        };
        self.channels_us = main.channels_us(now, self.rules.hold, rules.without_signal);
        if self.source == Source::Msp {
            return;
        }
        let (mask, fresh_for) = match self.beside_radio {
            Override::ByBox {
                fresh_for,
                keeps_switch,
            } if rules.box_on => {
                let kept = rules.switch.filter(|i| keeps_switch && *i < 32);
                (rules.mask & !kept.map_or(0, |i| 1 << i), fresh_for)
            }
            // What it did not send stays the pilot's.
            Override::Always { fresh_for } => (self.msp.valid as u32, Some(fresh_for)),
            Override::ByBox { .. } | Override::Never => return,
        };
        let silence = self.msp.silence(now);
        if silence > fresh_for.unwrap_or(Duration::MAX) || silence == Duration::MAX {
            return;
        }
        for (i, us) in self.channels_us.iter_mut().enumerate().take(32) {
            if mask & (1 << i) != 0 {
                *us = self.msp.channels_us[i];
            }
        }
    }

    fn is_overridden(&self, now: Timestamp) -> bool {
        matches!(self.beside_radio, Override::Always { fresh_for } if self.msp.silence(now) <= fresh_for)
    }

    /// False while RX_FAILSAFE is flagged.
    pub(super) fn is_ok(&self, now: Timestamp) -> bool {
        match self.source {
            Source::Msp => self.msp.is_ok(now, self.rules),
            Source::Radio => self.radio.is_ok(now, self.rules) || self.is_overridden(now),
        }
    }

    /// Failsafe stage 2; `delay` from the failsafe configuration.
    pub(super) fn is_lost(&self, now: Timestamp, delay: Duration) -> bool {
        let limit = delay + self.rules.stage_two_extra;
        match self.source {
            Source::Msp => self.msp.silence(now) > limit,
            Source::Radio => self.radio.silence(now) > limit && !self.is_overridden(now),
        }
    }

    /// Roll, Pitch, Yaw, Throttle, Aux1...
    pub(super) const fn channels_us(&self) -> &[u16; CHANNELS] {
        &self.channels_us
    }

    /// Whether the pilot's radio, where there should be one, is heard.
    pub(super) fn signal(&self, now: Timestamp) -> bool {
        self.source == Source::Msp || self.radio.silence(now) <= self.rules.flag_after
    }

    /// Roll right, pitch **nose down**, yaw clockwise in -1..=1; throttle 0..=1 above the low check.
    pub(super) fn sticks(&self, min_check_us: u16) -> [f64; 4] {
        let [roll, pitch, yaw, throttle] = [0, 1, 2, 3].map(|i| f64::from(self.channels_us[i]));
        let centred = |us: f64| ((us - 1500.0) / 500.0).clamp(-1.0, 1.0);
        let low = f64::from(min_check_us);
        let lift = ((throttle - low) / (2000.0 - low).max(1.0)).clamp(0.0, 1.0);
        [centred(roll), centred(pitch), centred(yaw), lift]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fc::manner::Manner;

    const FRAME: [u16; 5] = [1600, 1400, 1300, 1550, 2000];
    const DELAY: Duration = Duration::from_millis(1500);

    fn ms(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    fn mixing(mask: u32, box_on: bool, switch: Option<usize>) -> Mixing<'static> {
        static AS_DELIVERED: [WithoutSignal; RXFAIL_CHANNELS] = {
            let mut all = [WithoutSignal::Hold; RXFAIL_CHANNELS];
            let mut i = 0;
            while i < 4 {
                all[i] = WithoutSignal::Auto;
                i += 1;
            }
            all
        };
        Mixing {
            mask,
            box_on,
            switch,
            without_signal: &AS_DELIVERED,
        }
    }

    fn receiver(manner: Manner, source: Source) -> Receiver {
        let table = manner.table();
        Receiver::new(&table.receiver, table.beside_radio, source)
    }

    fn by_msp() -> Receiver {
        receiver(Manner::Betaflight46, Source::Msp)
    }

    #[test]
    fn channels_are_sorted_from_aetr_and_those_not_sent_keep_or_centre() {
        let mut rx = by_msp();
        rx.take(ms(0), &FRAME, AETR);
        rx.update(ms(0), &mixing(0, false, None));
        assert_eq!(rx.channels_us()[..6], [1600, 1400, 1550, 1300, 2000, 1500]);
        rx.take(ms(10), &[1600, 0, 3000], AETR);
        rx.update(ms(10), &mixing(0, false, None));
        assert_eq!(rx.channels_us()[..5], [1600, 1500, 1500, 885, 2000]);
    }

    #[test]
    fn silence_flags_then_drops_throttle_then_is_lost() {
        let mut rx = by_msp();
        assert!(!rx.is_ok(ms(0)), "never heard");
        rx.take(ms(1000), &FRAME, AETR);
        assert!(rx.is_ok(ms(1150)) && !rx.is_ok(ms(1151)));
        rx.update(ms(1300), &mixing(0, false, None));
        assert_eq!(rx.channels_us()[3], 1300, "holds for 0.30 s");
        rx.update(ms(1301), &mixing(0, false, None));
        assert_eq!(rx.channels_us()[..5], [1500, 1500, 1500, 885, 2000]);
        assert!(!rx.is_lost(ms(2500), DELAY) && rx.is_lost(ms(2501), DELAY));
    }

    #[test]
    fn eight_hertz_keep_the_link_and_six_never_do() {
        for (period, ok) in [(125, true), (166, false)] {
            let mut rx = by_msp();
            let always = (0..40).fold(true, |all, i| {
                rx.take(ms(i * period), &FRAME, AETR);
                all & (i == 0 || rx.is_ok(ms(i * period)))
            });
            assert_eq!(always, ok, "{period} ms");
        }
    }

    #[test]
    fn after_a_gap_frames_must_be_steady_for_half_a_second() {
        let mut rx = by_msp();
        rx.take(ms(0), &FRAME, AETR);
        for t in (400..2000).step_by(20) {
            rx.take(ms(t), &FRAME, AETR);
            assert_eq!(rx.is_ok(ms(t)), t >= 900, "{t}");
        }
    }

    /// Roll and Aux1 after `silence` of MSP, with the radio alive at 1200 and the box on.
    fn beside(manner: Manner, mask: u32, silence_ms: u64, box_on: bool) -> (u16, u16) {
        let mut rx = receiver(manner, Source::Radio);
        rx.take(ms(1000), &FRAME, AETR);
        let now = ms(1000 + silence_ms);
        let radio = Radio {
            sticks_us: [1200; 4],
            aux_us: [1200; 8],
        };
        rx.hear(now, &radio);
        rx.update(now, &mixing(mask, box_on, Some(4)));
        (rx.channels_us()[0], rx.channels_us()[4])
    }

    #[test]
    fn override_takes_only_the_channels_of_the_mask_and_only_with_the_box_on() {
        use Manner::{Betaflight46, BetaflightNew, Cleanflight, Inav, MultiWii};
        assert_eq!(beside(Betaflight46, 0b1111, 0, true), (1600, 1200));
        assert_eq!(beside(Betaflight46, 0b1111, 0, false), (1200, 1200));
        assert_eq!(beside(Betaflight46, 0b1_1111, 0, true), (1600, 2000));
        // INAV keeps the channel of the switch with the pilot.
        assert_eq!(beside(Inav, 0b1_1111, 0, true), (1600, 1200));
        assert_eq!(beside(Cleanflight, 0b1111, 0, true), (1200, 1200));
        assert_eq!(beside(MultiWii, 0, 0, false), (1600, 2000));
        // Stale sticks: the old firmware keeps them as long as the box is on.
        for (manner, held_ms) in [(BetaflightNew, 300), (Inav, 700), (MultiWii, 1000)] {
            assert_eq!(beside(manner, 0b1111, held_ms, true).0, 1600, "{manner}");
            assert_eq!(
                beside(manner, 0b1111, held_ms + 1, true).0,
                1200,
                "{manner}"
            );
        }
        assert_eq!(beside(Betaflight46, 0b1111, 60_000, true).0, 1600);
    }

    #[test]
    fn without_a_radio_only_multiwii_flies_by_override() {
        for manner in Manner::ALL {
            let mut rx = receiver(manner, Source::Radio);
            rx.take(ms(0), &FRAME, AETR);
            assert_eq!(rx.is_ok(ms(10)), manner == Manner::MultiWii, "{manner}");
        }
    }
}
