//! Sticks as RC microseconds in the controller's channel order. The only place that knows RC microseconds.

use crate::autopilot::supervisor::Cleared;
use arrayvec::ArrayVec;
use msp::message::RxMap;
use vehicle::Sticks;

/// Channels as sent.
pub type Channels = ArrayVec<u16, 34>;

/// Aux1 low and high: the arm switch.
const ARM_US: [u16; 2] = [1000, 2000];
/// Aux2: angle mode, always on.
const ANGLE_US: u16 = 2000;
/// Aux3: altitude hold of the firmware, always off (Kestrel holds the height itself).
const ALTITUDE_HOLD_US: u16 = 1000;
/// Aux4: unused, low.
const UNUSED_US: u16 = 1000;

/// Roll, pitch, yaw, throttle in microseconds; RC pitch is nose DOWN +, the opposite of [`Sticks`].
#[must_use]
pub fn stick_us(sticks: Sticks) -> [u16; 4] {
    let s = sticks.clamped();
    let centred = |v: f64| (1500.0 + 500.0 * v).round() as u16;
    [
        centred(s.roll),
        centred(-s.pitch),
        centred(s.yaw),
        (1000.0 + 1000.0 * s.throttle).round() as u16,
    ]
}

/// Sticks that a receiver shows in roll, pitch, yaw, throttle order; the inverse of [`stick_us`]. None if a channel is missing or no
/// pulse (below 885 us).
#[must_use]
pub fn sticks_of_rc(channels_us: &[u16]) -> Option<Sticks> {
    let &[roll, pitch, yaw, throttle, ..] = channels_us else {
        return None;
    };
    if [roll, pitch, yaw, throttle].iter().any(|us| *us < 885) {
        return None;
    }
    let centred = |us: u16| (f64::from(us) - 1500.0) / 500.0;
    let sticks = Sticks {
        roll: centred(roll),
        pitch: -centred(pitch),
        yaw: centred(yaw),
        throttle: (f64::from(throttle) - 1000.0) / 1000.0,
    };
    Some(sticks.clamped())
}

/// Aux1 to Aux4 as they are always sent: what the switches of a controller must be set for.
#[must_use]
pub fn aux_us(arm: bool) -> [u16; 4] {
    [
        ARM_US[usize::from(arm)],
        ANGLE_US,
        ALTITUDE_HOLD_US,
        UNUSED_US,
    ]
}

/// Channels in the order the controller expects, and in roll, pitch, yaw, throttle, aux order for telemetry.
#[must_use]
pub fn channels(sticks: &Cleared<Sticks>, arm: bool, map: &RxMap) -> (Channels, ArrayVec<u16, 18>) {
    let us = stick_us(*sticks.get());
    let aux = aux_us(arm);
    (map.arrange(us, &aux), us.into_iter().chain(aux).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::supervisor::Supervisor;
    use proptest::prelude::*;

    #[test]
    fn forward_flight_needs_pitch_above_centre() {
        // Nose down is negative in our sticks and above 1500 on the wire.
        assert_eq!(
            stick_us(Sticks {
                roll: 0.0,
                pitch: -0.2,
                yaw: 0.0,
                throttle: 0.0
            }),
            [1500, 1600, 1500, 1000]
        );
        assert_eq!(
            stick_us(Sticks {
                roll: 0.2,
                pitch: 0.0,
                yaw: 1.0,
                throttle: 0.5
            }),
            [1600, 1500, 2000, 1500]
        );
    }

    proptest! {
        #[test]
        fn no_stick_leaves_1000_to_2000(r in any::<f64>(), p in any::<f64>(), y in any::<f64>(), t in any::<f64>()) {
            let us = stick_us(Sticks { roll: r, pitch: p, yaw: y, throttle: t });
            prop_assert!(us.iter().all(|v| (1000..=2000).contains(v)), "{us:?}");
        }

        #[test]
        fn through_any_receiver_map_every_channel_stays_in_1000_to_2000_and_none_is_lost(
            r in any::<f64>(), p in any::<f64>(), y in any::<f64>(), t in any::<f64>(), arm in any::<bool>(), blind in any::<bool>(),
            map in Just([0u8, 1, 2, 3, 4, 5, 6, 7]).prop_shuffle()
        ) {
            let wanted = Sticks { roll: r, pitch: p, yaw: y, throttle: t };
            let cleared = Supervisor::default().clear(wanted, true, !blind, 0.5);
            let map = RxMap { map: map.into_iter().collect() };
            let (wire, telemetry) = channels(&cleared, arm, &map);
            prop_assert!(wire.iter().chain(&telemetry).all(|v| (1000..=2000).contains(v)), "{wire:?}");
            for (channel, position) in map.map.iter().enumerate() {
                prop_assert_eq!(wire[usize::from(*position)], telemetry[channel]);
            }
        }

        #[test]
        fn a_pilots_sticks_repeated_are_the_same_pulses(us in prop::array::uniform4(1000u16..=2000)) {
            prop_assert_eq!(stick_us(sticks_of_rc(&us).unwrap()), us);
        }
    }
}
