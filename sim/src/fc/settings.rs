//! The settings that a configurator reads and writes over MSP: what runs, what the eeprom holds, and what only a restart
//! brings into force.
//!
//! | | |
//! | --- | --- |
//! | SET_... | changes what runs; kept only by EEPROM_WRITE |
//! | EEPROM_WRITE | refused while armed; the controller is deaf for 0.3 s |
//! | REBOOT | what was not written is gone; the kind of receiver is chosen anew |
//!
//! As delivered a controller has a serial receiver and no mode switches. [`Delivery::ReadyToFly`] is what a provisioning
//! tool leaves: RC by MSP, ARM on Aux1 from 1700 us, ANGLE always.

use super::FcConfig;
use super::manner::{ReceiverChoice, Table};
use super::receiver::{RXFAIL_CHANNELS, WithoutSignal};
use arrayvec::ArrayVec;
use msp::LongText;
use msp::firmware::box_id;
use msp::message::{FailsafeConfig, FeatureConfig, ModeRange, RxConfig, RxMap};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Slots of MSP_MODE_RANGES at most.
const MOST_SLOTS: usize = 40;
/// INAV's kind of receiver.
const RECEIVER_TYPE_SERIAL: u8 = 1;
const RECEIVER_TYPE_MSP: u8 = 2;
/// Anti-gravity, on in every Betaflight as delivered.
const ANTI_GRAVITY: u32 = 1 << 28;
const RX_SERIAL: u32 = 1 << 3;
/// Among roll, pitch, yaw, throttle, Aux1 ...
const THROTTLE: usize = 3;

/// In which state the controller's settings are at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Delivery {
    /// RC by MSP, arm and angle switches set.
    #[default]
    ReadyToFly,
    /// The same, and the throttle holds while no signal comes, until failsafe stage 2: as `kestrel fc provision` leaves it.
    Provisioned,
    /// The pilot's radio is the receiver; the override box is on Aux4 from 1700 us.
    BesideRadio,
    /// As it leaves the shop: a serial receiver, no mode switches.
    Factory,
}

impl Delivery {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::ReadyToFly,
        Self::Provisioned,
        Self::BesideRadio,
        Self::Factory,
    ];

    /// The name on the command line and in configuration files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ReadyToFly => "ready-to-fly",
            Self::Provisioned => "provisioned",
            Self::BesideRadio => "beside-radio",
            Self::Factory => "factory",
        }
    }
}

impl fmt::Display for Delivery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Delivery {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|delivery| delivery.name() == s);
        found.ok_or_else(|| format!("one of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// Where sticks come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    Msp,
    Radio,
}

/// One set of settings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Settings {
    pub(super) name: LongText,
    pub(super) features: u32,
    pub(super) mode_ranges: ArrayVec<ModeRange, MOST_SLOTS>,
    /// Roll, Pitch, Yaw, Throttle: their places in SET_RAW_RC.
    pub(super) rc_order: [usize; 4],
    pub(super) rx: RxConfig,
    pub(super) failsafe: FailsafeConfig,
    /// What each channel does without a signal.
    pub(super) without_signal: [WithoutSignal; RXFAIL_CHANNELS],
    /// Commands that the serial task handles a second.
    pub(super) serial_rate_hz: u32,
    /// Channels that MSP may take beside a radio.
    pub(super) override_mask: u32,
}

impl Settings {
    pub(super) fn new(table: &Table, config: &FcConfig) -> Self {
        let delivery = config.delivery;
        let rx_by_msp = matches!(delivery, Delivery::ReadyToFly | Delivery::Provisioned);
        let mut mode_ranges: ArrayVec<ModeRange, MOST_SLOTS> = (0..table.mode_slots)
            .map(|_| ModeRange::default())
            .collect();
        if delivery != Delivery::Factory {
            mode_ranges[0] = ModeRange::from_us(box_id::ARM, 0, 1700, 2100);
            mode_ranges[1] = ModeRange::from_us(box_id::ANGLE, 1, 900, 2100);
        }
        if delivery == Delivery::BesideRadio && table.has_box(box_id::MSP_OVERRIDE) {
            mode_ranges[2] = ModeRange::from_us(box_id::MSP_OVERRIDE, 3, 1700, 2100);
        }
        let rules = &table.receiver;
        let receiver_feature = match (rules.chosen_by, rx_by_msp) {
            (ReceiverChoice::Feature, true) => FeatureConfig::RX_MSP,
            (ReceiverChoice::Feature, false) => RX_SERIAL,
            (ReceiverChoice::ReceiverType | ReceiverChoice::None, _) => 0,
        };
        let mut rx = RxConfig {
            serial_provider: 0,
            max_check_us: 1900,
            mid_rc_us: 1500,
            min_check_us: rules.min_check_us,
            spektrum_sat_bind: 0,
            rx_min_us: 885,
            rx_max_us: 2115,
            rest: core::iter::repeat_n(0, rules.rest[0]).collect(),
        };
        if rules.chosen_by == ReceiverChoice::ReceiverType {
            rx.set_receiver_type(if rx_by_msp {
                RECEIVER_TYPE_MSP
            } else {
                RECEIVER_TYPE_SERIAL
            });
        }
        let (delay_ds, landing_time, throttle_us, procedure) = rules.failsafe;
        Self {
            without_signal: core::array::from_fn(|channel| {
                if delivery == Delivery::Provisioned && channel == THROTTLE {
                    WithoutSignal::Hold
                } else {
                    WithoutSignal::as_delivered(channel)
                }
            }),
            serial_rate_hz: config.serial_rate_hz,
            override_mask: match delivery {
                Delivery::Factory => 0,
                Delivery::ReadyToFly | Delivery::Provisioned | Delivery::BesideRadio => {
                    config.override_mask
                }
            },
            name: LongText::new("kestrel-sim"),
            features: receiver_feature | ANTI_GRAVITY,
            mode_ranges,
            rc_order: table.wire.rc_order,
            rx,
            failsafe: FailsafeConfig {
                delay_ds,
                landing_time,
                throttle_us,
                switch_mode: 0,
                throttle_low_delay_ds: 100,
                procedure,
                rest: core::iter::repeat_n(0, rules.rest[1]).collect(),
            },
        }
    }

    /// Where sticks come from once it has started with these settings.
    pub(super) fn source(&self, table: &Table) -> Source {
        let by_msp = match table.receiver.chosen_by {
            ReceiverChoice::Feature => self.features & FeatureConfig::RX_MSP != 0,
            ReceiverChoice::ReceiverType => self.rx.receiver_type() == Some(RECEIVER_TYPE_MSP),
            ReceiverChoice::None => false,
        };
        if by_msp { Source::Msp } else { Source::Radio }
    }

    /// RX_MAP as it is told.
    pub(super) fn rx_map(&self, entries: usize) -> RxMap {
        let mut map = RxMap::identity();
        for (entry, position) in map.map.iter_mut().zip(self.rc_order) {
            *entry = position as u8;
        }
        map.map.truncate(entries);
        map
    }

    /// Takes an RX_MAP; false if it is none.
    pub(super) fn set_rx_map(&mut self, map: &RxMap) -> bool {
        let mut order = [0; 4];
        for (place, position) in order.iter_mut().zip(&map.map) {
            *place = usize::from(*position);
        }
        let mut sorted = order;
        sorted.sort_unstable();
        let is_order = sorted == [0, 1, 2, 3] && map.map.len() >= 4;
        if is_order {
            self.rc_order = order;
        }
        is_order
    }
}
