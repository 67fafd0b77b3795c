//! Configuration that decides whether and how a controller flies by MSP. The `SET_` twins have the
//! layout of the reading message unless a struct of their own is given.

use super::messages;
use crate::wire::LongText;
use arrayvec::ArrayVec;

messages! {
    /// One slot: a switch position that activates a box. `start_step >= end_step` = slot unused.
    #[derive(Copy)]
    ModeRange = MODE_RANGES {
        /// Permanent id of the box ([`crate::firmware::box_id`]).
        permanent_id: u8,
        /// 0 = Aux1.
        aux: u8,
        /// Lower end in steps of 25 us above 900 us.
        start_step: u8,
        /// Upper end, exclusive.
        end_step: u8,
    }

    /// All slots, Betaflight 20, INAV 40.
    ModeRanges = MODE_RANGES {
        /// Used and unused slots, in order.
        slots: ArrayVec<ModeRange, 64>,
    }

    /// Sets one slot; an unknown box or slot is refused. Takes effect at once, is kept by
    /// `EEPROM_WRITE`.
    #[derive(Copy)]
    SetModeRange = SET_MODE_RANGE {
        /// Slot number.
        slot: u8,
        /// What to put there.
        range: ModeRange,
        /// Betaflight: 0 or, 1 and.
        logic: Option<u8>,
        /// Betaflight: box this one is linked to, 0 none.
        linked_to: Option<u8>,
    }

    /// Names of the boxes, in BOXIDS order.
    BoxNames = BOXNAMES {
        /// Names with `;` after each.
        text: LongText,
    }

    /// Permanent ids of the boxes: entry *i* is what bit *i* of the mode flags means. The list
    /// changes with the configuration: read it again after a change or a reboot.
    BoxIds = BOXIDS {
        /// Permanent ids.
        ids: ArrayVec<u8, 96>,
    }

    /// Features. Bits: 3 serial receiver, 7 GPS, 12 3D, **14 MSP receiver** (Betaflight,
    /// Cleanflight), 22 airmode.
    #[derive(Copy)]
    FeatureConfig = FEATURE_CONFIG {
        /// Feature bits.
        features: u32,
    }

    /// Mixer.
    #[derive(Copy)]
    MixerConfig = MIXER_CONFIG {
        /// 3 = quadcopter X.
        mixer_mode: u8,
        /// Betaflight: non-zero when the propellers turn the other way round.
        yaw_motors_reversed: Option<u8>,
    }

    /// Sensor hardware chosen, one number a sensor: accelerometer, barometer, magnetometer, then
    /// whatever the firmware has. The numbers are the firmware's own.
    SensorConfig = SENSOR_CONFIG {
        /// Hardware by sensor.
        hardware: ArrayVec<u8, 32>,
    }

    /// Throttle limits in microseconds.
    MotorConfig = MOTOR_CONFIG {
        /// Idle when armed (0 in newer Betaflight).
        min_throttle_us: u16,
        /// Full throttle.
        max_throttle_us: u16,
        /// Disarmed.
        min_command_us: u16,
        /// What follows, kept for writing back.
        rest: ArrayVec<u8, 32>,
    }

    /// Receiver thresholds and provider.
    RxConfig = RX_CONFIG {
        /// Serial receiver protocol.
        serial_provider: u8,
        /// Stick above this is high (1900).
        max_check_us: u16,
        /// Stick centre (1500).
        mid_rc_us: u16,
        /// Stick below this is low (Betaflight 1050, INAV 1100).
        min_check_us: u16,
        /// Spektrum bind pulses.
        spektrum_sat_bind: u8,
        /// Shortest valid pulse (885).
        rx_min_us: u16,
        /// Longest valid pulse (2115).
        rx_max_us: u16,
        /// What follows, kept for writing back.
        rest: ArrayVec<u8, 64>,
    }

    /// `map[stick]` = position of that stick in SET_RAW_RC; sticks Roll, Pitch, Yaw, Throttle, then
    /// Aux1... INAV sends 4 entries, Betaflight and Cleanflight 8.
    RxMap = RX_MAP {
        /// Positions, 0-based.
        map: ArrayVec<u8, 8>,
    }

    /// What the controller does when RC stops.
    FailsafeConfig = FAILSAFE_CONFIG {
        /// How long the last channels hold before the procedure begins, in 0.1 s.
        delay_ds: u8,
        /// How long the landing throttle is applied: Betaflight 4.x in 0.1 s, later and INAV as
        /// documented there.
        landing_time: u8,
        /// Throttle while landing.
        throttle_us: u16,
        /// What the failsafe switch does.
        switch_mode: u8,
        /// Throttle low this long before failsafe just disarms, in 0.1 s.
        throttle_low_delay_ds: u16,
        /// 0 land, 1 drop; Betaflight 2 rescue; INAV 2 return home, 3 nothing.
        procedure: u8,
        /// What INAV appends, kept for writing back.
        rest: ArrayVec<u8, 32>,
    }
}

impl ModeRange {
    /// A range from microseconds, rounded down to the 25 us grid and held inside 900..=2100.
    #[must_use]
    pub fn from_us(permanent_id: u8, aux: u8, start_us: u16, end_us: u16) -> Self {
        let step = |us: u16| u8::try_from((us.clamp(900, 2100) - 900) / 25).unwrap_or(48);
        Self {
            permanent_id,
            aux,
            start_step: step(start_us),
            end_step: step(end_us),
        }
    }

    /// Lower end in microseconds.
    #[must_use]
    pub fn start_us(&self) -> u16 {
        900 + 25 * u16::from(self.start_step)
    }

    /// Upper end in microseconds, exclusive.
    #[must_use]
    pub fn end_us(&self) -> u16 {
        900 + 25 * u16::from(self.end_step)
    }

    /// Whether the slot does anything.
    #[must_use]
    pub const fn is_used(&self) -> bool {
        self.start_step < self.end_step
    }

    /// Whether a pulse on the slot's channel lies in the range.
    #[must_use]
    pub fn contains(&self, channel_us: u16) -> bool {
        (self.start_us()..self.end_us()).contains(&channel_us)
    }
}

impl BoxNames {
    /// The names in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.text.as_str().split_terminator(';')
    }
}

impl BoxIds {
    /// Position of a box, which is its bit in the mode flags.
    #[must_use]
    pub fn index_of(&self, permanent_id: u8) -> Option<usize> {
        self.ids.iter().position(|&id| id == permanent_id)
    }
}

impl FeatureConfig {
    /// Feature bit of Betaflight and Cleanflight: the receiver is MSP.
    pub const RX_MSP: u32 = 1 << 14;

    /// Whether all bits of `mask` are on.
    #[must_use]
    pub const fn has(&self, mask: u32) -> bool {
        self.features & mask == mask
    }
}

impl RxConfig {
    /// Place of `receiver_type` in INAV's payload.
    const RECEIVER_TYPE: usize = 23;
    const HEAD: usize = 12;

    /// INAV: kind of receiver, 2 = MSP. Betaflight keeps something else there.
    #[must_use]
    pub fn receiver_type(&self) -> Option<u8> {
        self.rest.get(Self::RECEIVER_TYPE - Self::HEAD).copied()
    }

    /// INAV: changes the kind of receiver in a configuration that was read before.
    pub fn set_receiver_type(&mut self, receiver_type: u8) {
        if let Some(field) = self.rest.get_mut(Self::RECEIVER_TYPE - Self::HEAD) {
            *field = receiver_type;
        }
    }
}

impl RxMap {
    /// Roll, Pitch, Throttle, Yaw, Aux1...: the default of Betaflight, INAV and Cleanflight.
    #[must_use]
    pub fn aetr() -> Self {
        Self {
            map: ArrayVec::from([0, 1, 3, 2, 4, 5, 6, 7]),
        }
    }

    /// Roll, Pitch, Yaw, Throttle, Aux1...: MultiWii, which has no map.
    #[must_use]
    pub fn identity() -> Self {
        Self {
            map: ArrayVec::from([0, 1, 2, 3, 4, 5, 6, 7]),
        }
    }

    /// Whether every entry points to a position of its own inside the map.
    #[must_use]
    pub fn is_permutation(&self) -> bool {
        let wanted = (1_u32 << self.map.len()) - 1;
        let seen = self
            .map
            .iter()
            .filter(|&&position| position < 8)
            .fold(0_u32, |seen, &position| seen | 1 << position);
        self.map.len() >= 4 && seen == wanted
    }

    /// Sorts sticks and aux channels into wire order. `sticks_us` is Roll, Pitch, Yaw, Throttle; at
    /// most 34 channels in all.
    ///
    /// A map that is no permutation counts as AETR: sending yaw where throttle belongs must not
    /// happen by a garbled reply.
    #[must_use]
    pub fn arrange(
        &self,
        sticks_us: [u16; 4],
        aux_us: &[u16],
    ) -> ArrayVec<u16, { super::rc::MAX_CHANNELS }> {
        let default = Self::aetr();
        let map = if self.is_permutation() {
            &self.map
        } else {
            &default.map
        };
        let mut channels: ArrayVec<u16, { super::rc::MAX_CHANNELS }> = ArrayVec::new();
        let logical = || {
            sticks_us
                .iter()
                .chain(aux_us)
                .copied()
                .take(super::rc::MAX_CHANNELS)
        };
        channels.extend(logical());
        for (stick, us) in logical().enumerate().take(map.len()) {
            if let Some(channel) = channels.get_mut(usize::from(map[stick])) {
                *channel = us;
            }
        }
        channels
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Message;

    #[test]
    fn arm_switch_on_aux1_from_1700_up() {
        let range = ModeRange::from_us(0, 0, 1700, 2100);
        assert_eq!((range.start_step, range.end_step), (0x20, 0x30));
        assert!(
            range.is_used()
                && range.contains(1700)
                && range.contains(2099)
                && !range.contains(1699)
        );
        assert!(!ModeRange::default().is_used());
    }

    #[test]
    fn sticks_go_out_as_aetr_by_default_and_in_multiwii_order_without_a_map() {
        let sticks = [1501, 1502, 1503, 1004];
        assert_eq!(
            RxMap::aetr().arrange(sticks, &[1900]).as_slice(),
            [1501, 1502, 1004, 1503, 1900]
        );
        assert_eq!(
            RxMap::identity().arrange(sticks, &[]).as_slice(),
            [1501, 1502, 1503, 1004]
        );
    }

    #[test]
    fn taer_of_an_inav_with_four_entries_leaves_aux_in_place() {
        let taer = RxMap::parse(&[1, 2, 3, 0]).unwrap();
        assert_eq!(
            taer.arrange([1501, 1502, 1503, 1004], &[1, 2]).as_slice(),
            [1004, 1501, 1502, 1503, 1, 2]
        );
    }

    #[test]
    fn a_garbled_map_counts_as_aetr() {
        for garbled in [&[0, 0, 0, 0][..], &[], &[9, 1, 2, 3], &[0, 1, 2]] {
            let map = RxMap::parse(garbled).unwrap();
            assert_eq!(
                map.arrange([1, 2, 3, 4], &[]).as_slice(),
                [1, 2, 4, 3],
                "{garbled:?}"
            );
        }
    }

    #[test]
    fn receiver_type_of_inav_is_byte_23_of_the_payload() {
        let mut payload = vec![0; 24];
        payload[23] = 2;
        let mut config = RxConfig::parse(&payload).unwrap();
        assert_eq!(config.receiver_type(), Some(2));
        config.set_receiver_type(1);
        let mut out = Vec::new();
        config.emit(&mut out);
        assert_eq!((out.len(), out[23]), (24, 1));
    }
}
