//! The firmwares that the flight controller can pretend to be, as rows of one table: whatever differs between them is a
//! field here, and the rest of the module asks the table.
//!
//! | | `bf-old` | `bf-4.6` | `bf-new` | `inav` | `cleanflight` | `multiwii` |
//! | --- | --- | --- | --- | --- | --- | --- |
//! | version, MSP API | 4.4.3, 1.45 | 4.6.0, 1.47 | 2026.12.0, 1.49 | 9.0.0, 2.5 | 1.13.0, 1.19 | 2.40, none |
//! | arming blockers told | 26 bits | 29 bits | 30 bits | INAV_STATUS | no | no |
//! | gyro counts per deg/s | 16.4 | 16.4 | 16.4 | 1 | 16.4 | 4.1 |
//! | accelerometer counts per g | 2048 | 2048 | 2048 | 512 | 512 | 512 |
//! | order in SET_RAW_RC | map, AETR | map, AETR | map, AETR | map of 4, AETR | map, AETR | Roll Pitch Yaw Throttle |
//! | MULTIPLE_MSP, unknown id | ends early | ends early | refused | - | - | - |
//! | mode switches | MODE_RANGES, 20 | 20 | 20 | 40 | 20 | BOX |
//! | silence flagged / sticks dropped / stage 2 | 0.15 / 0.3 / 1.5 s | same | same | 0.2 / 0.8 / 0.8 s | 0.1 / 0.3 / 1.0 s | 1.0 s |
//! | override beside a radio | box 50 | box 50 | box 50, 0.3 s | box 50, 0.7 s | - | always, 1 s |
//! | angle at full stick | 60 | 60 | 60 | 30 | 50 | 50 degrees |
//!
//! Betaflight and INAV are measured, Cleanflight and MultiWii read in their sources; what is a guess says so beside the
//! value.

mod rows;

pub(super) use rows::{MULTIWII_BOX, MULTIWII_SET_BOX, RXFAIL_CONFIG, SET_RXFAIL_CONFIG};

use core::time::Duration;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Which firmware the flight controller pretends to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Manner {
    /// Betaflight 4.4.3, MSP API 1.45: what aircraft in the field carry.
    #[serde(rename = "bf-old")]
    BetaflightOld,
    /// Betaflight 4.6.0, MSP API 1.47.
    #[default]
    #[serde(rename = "bf-4.6")]
    Betaflight46,
    /// Betaflight 2026.12.0, MSP API 1.49.
    #[serde(rename = "bf-new")]
    BetaflightNew,
    /// INAV 9.0.0, MSP API 2.5.
    #[serde(rename = "inav")]
    Inav,
    /// Cleanflight 1.13.0, MSP API 1.19.
    #[serde(rename = "cleanflight")]
    Cleanflight,
    /// MultiWii 2.4.
    #[serde(rename = "multiwii")]
    MultiWii,
}

impl Manner {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::BetaflightOld,
        Self::Betaflight46,
        Self::BetaflightNew,
        Self::Inav,
        Self::Cleanflight,
        Self::MultiWii,
    ];

    /// The name on the command line and in configuration files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::BetaflightOld => "bf-old",
            Self::Betaflight46 => "bf-4.6",
            Self::BetaflightNew => "bf-new",
            Self::Inav => "inav",
            Self::Cleanflight => "cleanflight",
            Self::MultiWii => "multiwii",
        }
    }

    pub(super) const fn table(self) -> &'static Table {
        match self {
            Self::BetaflightOld => &rows::BETAFLIGHT_OLD,
            Self::Betaflight46 => &rows::BETAFLIGHT_46,
            Self::BetaflightNew => &rows::BETAFLIGHT_NEW,
            Self::Inav => &rows::INAV,
            Self::Cleanflight => &rows::CLEANFLIGHT,
            Self::MultiWii => &rows::MULTIWII,
        }
    }
}

impl fmt::Display for Manner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Manner {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|manner| manner.name() == s);
        found.ok_or_else(|| format!("one of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// Everything that differs.
#[derive(Debug)]
pub(super) struct Table {
    pub(super) identity: Identity,
    /// Questions it answers.
    pub(super) questions: &'static [u16],
    /// Orders it knows.
    pub(super) orders: &'static [u16],
    /// Boxes in the order of the mode flags: permanent id and name.
    pub(super) boxes: &'static [(u8, &'static str)],
    /// Slots of MODE_RANGES; MultiWii has BOX instead and keeps its switches in as many.
    pub(super) mode_slots: usize,
    pub(super) wire: WireRules,
    pub(super) status: StatusKind,
    pub(super) batch: Batch,
    pub(super) arming: ArmingRules,
    pub(super) receiver: ReceiverRules,
    pub(super) beside_radio: Override,
    pub(super) sticks: StickRules,
}

/// Who it says it is.
#[derive(Debug)]
pub(super) struct Identity {
    /// None: it knows neither API_VERSION nor FC_VARIANT.
    pub(super) variant: Option<[u8; 4]>,
    pub(super) api: (u8, u8),
    pub(super) version: (u8, u8, u8),
    /// Appended to FC_VERSION.
    pub(super) version_text: Option<&'static str>,
    pub(super) board: Board,
}

/// How far BOARD_INFO goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Board {
    /// Ends after hardware revision and OSD type.
    Short,
    /// Ends after the target.
    Target,
    /// Board, manufacturer, signature and so on.
    Full,
}

/// Units and lengths on the wire.
#[derive(Debug)]
pub(super) struct WireRules {
    pub(super) acc_counts_per_g: f64,
    pub(super) gyro_counts_per_dps: f64,
    /// Channels that MSP_RC tells.
    pub(super) told_channels: usize,
    /// Channels that SET_RAW_RC may carry.
    pub(super) most_channels: usize,
    /// Entries of RX_MAP; 0 = the order is fixed.
    pub(super) rx_map_len: usize,
    /// Where Roll, Pitch, Yaw, Throttle stand in SET_RAW_RC unless changed.
    pub(super) rc_order: [usize; 4],
    /// ALTITUDE ends with the barometer's altitude.
    pub(super) altitude_has_baro: bool,
    /// ANALOG ends with the voltage in 0.01 V.
    pub(super) analog_has_centivolts: bool,
    /// ATTITUDE tells the heading as -180..=180 instead of 0..=359.
    pub(super) heading_is_signed: bool,
}

/// Layout of the status messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StatusKind {
    /// Long, with arming blockers. Fields that came with an API version.
    Betaflight {
        has_temperature: bool,
        has_battery_profiles: bool,
    },
    /// 11 bytes, INAV_STATUS has the rest.
    Inav,
    /// 11 bytes; STATUS_EX adds the load.
    Cleanflight,
    /// 11 bytes.
    MultiWii,
}

/// MULTIPLE_MSP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Batch {
    Unknown,
    /// The list ends at a question it does not know.
    EndsEarly,
    /// A question it does not know refuses the whole.
    Refused,
}

/// Arming.
#[derive(Debug)]
pub(super) struct ArmingRules {
    /// Not before this long after start.
    pub(super) settle: Duration,
    /// Throttle up when the switch rises latches (Betaflight, INAV); otherwise it waits for the throttle.
    pub(super) throttle_latches: bool,
    /// Causes ([`super::arming::cause`]) and the bits that tell them.
    pub(super) told: &'static [(u32, u32)],
    /// Number of bits, for STATUS.
    pub(super) count: u8,
    /// INAV tells being armed, and having been, in the same word.
    pub(super) armed_bit: u32,
    pub(super) was_armed_bit: u32,
    /// Boxes that must be off.
    pub(super) blocking_boxes: &'static [(u8, u32)],
}

/// Loss of RC frames.
#[derive(Debug)]
pub(super) struct ReceiverRules {
    /// A frame gap longer than this flags the receiver.
    pub(super) flag_after: Duration,
    /// Sticks hold this long.
    pub(super) hold: Duration,
    /// Frames must come without a gap this long before the flag goes: so a steady 6 Hz never clears Betaflight's.
    pub(super) recovery: Duration,
    /// Failsafe stage 2 begins this long after the delay of the failsafe configuration.
    pub(super) stage_two_extra: Duration,
    /// Throttle below counts as low, us.
    pub(super) min_check_us: u16,
    /// Factory FAILSAFE_CONFIG: delay 0.1 s, landing time, throttle us, procedure (0 land, 1 drop).
    pub(super) failsafe: (u8, u8, u16, u8),
    /// Bytes that RX_CONFIG and FAILSAFE_CONFIG have beyond the common ones.
    pub(super) rest: [usize; 2],
    /// How the kind of receiver is chosen.
    pub(super) chosen_by: ReceiverChoice,
}

/// What says whether SET_RAW_RC is the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReceiverChoice {
    /// Feature bit 14, looked at when it starts.
    Feature,
    /// Byte 23 of RX_CONFIG = 2, looked at when it starts.
    ReceiverType,
    /// Nothing: there is always a radio, and SET_RAW_RC speaks over it.
    None,
}

/// SET_RAW_RC beside a real receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Override {
    Never,
    /// While box 50 is on, for the channels of the mask.
    ByBox {
        /// It ends this long after the last frame; none: the last values stay.
        fresh_for: Option<Duration>,
        /// The channel that carries the switch is never overridden.
        keeps_switch: bool,
    },
    /// Every valid value, for this long.
    Always {
        fresh_for: Duration,
    },
}

/// What sticks mean.
#[derive(Debug)]
pub(super) struct StickRules {
    pub(super) angle: AngleCurve,
    pub(super) yaw: YawCurve,
    /// Motor output when armed with the throttle at the bottom, and at the top.
    pub(super) motors: [f64; 2],
}

/// Stick to angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum AngleCurve {
    /// Share of the ACTUAL rate curve, times the limit.
    Actual { limit_deg: f64 },
    /// `gain x (1 - expo + expo x^2)`, cut off at the limit.
    Expo {
        gain_deg: f64,
        expo: f64,
        limit_deg: f64,
    },
}

/// Stick to yaw rate (and to roll and pitch rate without ANGLE).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum YawCurve {
    /// ACTUAL rates without expo: 70 deg/s at the centre, 670 at the end.
    Actual,
    /// `full x (1 - expo + expo x^2)`.
    Expo { full_dps: f64, expo: f64 },
}

impl Table {
    /// Whether the box has a place in BOXIDS.
    pub(super) fn has_box(&self, permanent_id: u8) -> bool {
        self.boxes.iter().any(|(id, _)| *id == permanent_id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_others_are_answered_with_the_list() {
        for manner in Manner::ALL {
            assert_eq!(manner.name().parse(), Ok(manner));
        }
        let said = "ardupilot".parse::<Manner>().unwrap_err();
        assert!(said.contains("bf-old, bf-4.6, bf-new, inav"), "{said}");
    }

    #[test]
    fn the_arm_switch_is_the_last_bit_of_every_betaflight() {
        for manner in [
            Manner::BetaflightOld,
            Manner::Betaflight46,
            Manner::BetaflightNew,
        ] {
            let rules = &manner.table().arming;
            let highest = rules.told.iter().map(|(_, bit)| *bit).max().unwrap();
            assert_eq!(highest, 1 << (rules.count - 1), "{manner}");
        }
    }

    #[test]
    fn whatever_a_manner_flies_with_has_a_box_and_a_place_in_set_raw_rc() {
        for manner in Manner::ALL {
            let table = manner.table();
            assert!(
                table.has_box(msp::firmware::box_id::ARM) && table.has_box(1),
                "{manner}"
            );
            assert!(table.wire.most_channels <= super::super::receiver::CHANNELS);
            assert!(table.wire.told_channels <= super::super::receiver::CHANNELS);
            assert!(
                table.boxes.len() <= 32,
                "{manner}: the head of STATUS has 32 flags"
            );
        }
    }
}
