//! Who answers, and what differs between the firmwares, as facts in wire terms.
//!
//! | | Betaflight | INAV | Cleanflight 1.x | MultiWii 2.x |
//! | --- | --- | --- | --- | --- |
//! | variant | `BTFL` | `INAV` | `CLFL` | none: asked with IDENT |
//! | gyro counts per deg/s | 16.4 | 1 | 16.4 | 4.1 |
//! | accelerometer counts per g | 2048 usually | 512 | 512 or 256 | by board |
//! | order in SET_RAW_RC | RX_MAP | RX_MAP | RX_MAP | Roll, Pitch, Yaw, Throttle |
//! | MULTIPLE_MSP | API 1.43 | no | no | no |
//! | arming blockers | STATUS, STATUS_EX | INAV_STATUS | none | none |

mod arming;

pub use arming::{ArmingBlocker, arming_blockers};

use crate::message::{
    ApiVersion, BoardInfo, BoxIds, FcVariant, FcVersion, InavStatus, Reply, RxMap, Status,
};
use std::fmt;

/// Flight controller firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Firmware {
    /// Betaflight.
    Betaflight,
    /// Cleanflight.
    Cleanflight,
    /// INAV.
    Inav,
    /// MultiWii, or anything that knows neither API_VERSION nor FC_VARIANT.
    MultiWii,
    /// Another firmware that speaks MSP, with its four letters.
    Other([u8; 4]),
}

impl From<FcVariant> for Firmware {
    fn from(variant: FcVariant) -> Self {
        match &variant.variant {
            b"BTFL" => Self::Betaflight,
            b"CLFL" => Self::Cleanflight,
            b"INAV" => Self::Inav,
            _ => Self::Other(variant.variant),
        }
    }
}

impl Firmware {
    /// Counts of RAW_IMU per degree per second. INAV sends degrees per second; the others raw
    /// counts of a sensor with a range of 2000 deg/s (Betaflight measured: 30 deg/s reads 491),
    /// which MultiWii divides by four.
    #[must_use]
    pub const fn gyro_counts_per_dps(self) -> f64 {
        match self {
            Self::Inav => 1.0,
            Self::Betaflight | Self::Cleanflight | Self::Other(_) => 16.4,
            Self::MultiWii => 4.1,
        }
    }

    /// Counts of RAW_IMU per g where the firmware fixes them (INAV). Elsewhere they depend on
    /// sensor and range (Betaflight 2048 on usual boards, 1024, or 256 in its simulator): measure
    /// the norm at rest.
    #[must_use]
    pub const fn acc_counts_per_g(self) -> Option<f64> {
        match self {
            Self::Inav => Some(512.0),
            Self::Betaflight | Self::Cleanflight | Self::MultiWii | Self::Other(_) => None,
        }
    }

    /// Most channels SET_RAW_RC may carry: one more is refused.
    #[must_use]
    pub const fn max_rc_channels(self) -> usize {
        match self {
            Self::Inav => 34,
            Self::Betaflight | Self::Cleanflight | Self::Other(_) => 18,
            Self::MultiWii => 8,
        }
    }

    /// Whether MULTIPLE_MSP exists in this version.
    #[must_use]
    pub fn has_multiple_msp(self, api: ApiVersion) -> bool {
        matches!(self, Self::Betaflight) && (api.major, api.minor) >= (1, 43)
    }

    /// The line of the firmware's command line (then `save`) that lets it serve more requests a second.
    /// INAV and MultiWii have none.
    #[must_use]
    pub const fn faster_cli_line(self) -> Option<&'static str> {
        match self {
            Self::Betaflight => Some("set serial_update_rate_hz = 1000"),
            Self::Cleanflight | Self::Inav | Self::MultiWii | Self::Other(_) => None,
        }
    }

    /// Order of SET_RAW_RC when the controller has not told its own.
    #[must_use]
    pub fn default_rx_map(self) -> RxMap {
        match self {
            Self::MultiWii => RxMap::identity(),
            Self::Betaflight | Self::Cleanflight | Self::Inav | Self::Other(_) => RxMap::aetr(),
        }
    }
}

impl fmt::Display for Firmware {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Betaflight => f.write_str("Betaflight"),
            Self::Cleanflight => f.write_str("Cleanflight"),
            Self::Inav => f.write_str("INAV"),
            Self::MultiWii => f.write_str("MultiWii"),
            Self::Other(letters) => letters.escape_ascii().fmt(f),
        }
    }
}

/// Permanent ids of mode boxes: entries of BOXIDS and of the mode ranges.
pub mod box_id {
    /// Motors may turn.
    pub const ARM: u8 = 0;
    /// Self-level: sticks command angles.
    pub const ANGLE: u8 = 1;
    /// Self-level near the centre of the sticks only.
    pub const HORIZON: u8 = 2;
    /// Altitude hold: Betaflight from 2025.12, INAV "NAV ALTHOLD", MultiWii and Cleanflight "BARO".
    pub const ALTITUDE_HOLD: u8 = 3;
    /// Heading hold, "MAG".
    pub const HEADING_HOLD: u8 = 5;
    /// Position hold: Betaflight from 2025.12, INAV; MultiWii "GPS HOLD".
    pub const POSITION_HOLD: u8 = 11;
    /// Beeper.
    pub const BEEPER: u8 = 13;
    /// Failsafe is active.
    pub const FAILSAFE: u8 = 27;
    /// INAV: follow way-points of the ground station.
    pub const INAV_GCS_NAV: u8 = 31;
    /// INAV: hold the height over ground.
    pub const INAV_SURFACE: u8 = 33;
    /// Betaflight: second arming switch.
    pub const BETAFLIGHT_PREARM: u8 = 36;
    /// Betaflight: fly home. **INAV uses the number for MC BRAKING.**
    pub const BETAFLIGHT_GPS_RESCUE: u8 = 46;
    /// SET_RAW_RC overrides chosen channels of the real receiver.
    pub const MSP_OVERRIDE: u8 = 50;
    /// INAV: second arming switch.
    pub const INAV_PREARM: u8 = 51;
    /// Betaflight 2026: autopilot.
    pub const BETAFLIGHT_AUTOPILOT: u8 = 56;
}

/// Who answered, in full.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Firmware.
    pub firmware: Firmware,
    /// API version; 0.0 for MultiWii.
    pub api: ApiVersion,
    /// Firmware version.
    pub version: FcVersion,
    /// Board, when it was told.
    pub board: Option<BoardInfo>,
    /// Boxes in the order of the mode flags.
    pub box_ids: BoxIds,
    /// Order of the sticks in SET_RAW_RC.
    pub rx_map: RxMap,
    /// Whether several questions may go in one frame.
    pub has_multiple_msp: bool,
}

impl Identity {
    /// Whether the box with this permanent id is active according to a status reply; `None` when
    /// the controller has no such box or the reply is no status.
    #[must_use]
    pub fn is_box_active(&self, permanent_id: u8, status: &Reply) -> Option<bool> {
        let index = self.box_ids.index_of(permanent_id)?;
        match status {
            Reply::Status(status) => Some(status.mode_flag(index)),
            Reply::StatusEx(status) => Some(status.mode_flag(index)),
            Reply::InavStatus(status) => Some(status.mode_flag(index)),
            _ => None,
        }
    }

    /// What blocks arming according to a status reply, worst named first; empty = ready, or the
    /// firmware does not tell.
    pub fn arming_blockers(&self, status: &Reply) -> impl Iterator<Item = ArmingBlocker> + use<> {
        let (count, flags) = match status {
            Reply::Status(Status {
                tail: Some(tail), ..
            }) => (tail.arming_disable_count, tail.arming_disable),
            Reply::StatusEx(status) => status.betaflight().map_or((0, 0), |tail| {
                (tail.arming_disable_count, tail.arming_disable)
            }),
            Reply::InavStatus(InavStatus { arming_flags, .. }) => (32, *arming_flags),
            _ => (0, 0),
        };
        arming_blockers(self.firmware, count, flags)
    }

    /// Whether a status reply says that the controller has just started: boot grace of Betaflight,
    /// sensor calibration of INAV (both bit 9).
    #[must_use]
    pub fn is_starting(&self, status: &Reply) -> bool {
        const STARTING: u32 = 1 << 9;
        let flags = match status {
            Reply::Status(Status {
                tail: Some(tail), ..
            }) => tail.arming_disable,
            Reply::StatusEx(status) => status.betaflight().map_or(0, |tail| tail.arming_disable),
            Reply::InavStatus(status) => status.arming_flags,
            _ => 0,
        };
        flags & STARTING != 0
    }

    /// The command that carries mode flags and arming blockers in full: INAV_STATUS, STATUS_EX, or
    /// STATUS for MultiWii.
    #[must_use]
    pub const fn status_command(&self) -> u16 {
        use crate::command;
        match self.firmware {
            Firmware::Inav => command::INAV_STATUS,
            Firmware::MultiWii => command::STATUS,
            Firmware::Betaflight | Firmware::Cleanflight | Firmware::Other(_) => command::STATUS_EX,
        }
    }
}

/// As a pilot would name it: `Betaflight 4.6.0 (MSP 1.47) on SITL`.
impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} (MSP {})", self.firmware, self.version, self.api)?;
        let Some(board) = &self.board else {
            return Ok(());
        };
        match [&board.board_name, &board.target]
            .into_iter()
            .flatten()
            .find(|name| !name.as_str().is_empty())
        {
            Some(name) => write!(f, " on {name}"),
            None => write!(f, " on {}", board.board.escape_ascii()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{StatusEx, StatusHead};
    use crate::wire::ShortText;
    use arrayvec::ArrayVec;

    fn identity() -> Identity {
        Identity {
            firmware: Firmware::Betaflight,
            api: ApiVersion {
                protocol: 0,
                major: 1,
                minor: 47,
            },
            version: FcVersion {
                major: 4,
                minor: 6,
                patch: 0,
                text: None,
            },
            board: None,
            box_ids: BoxIds {
                ids: ArrayVec::from_iter([0, 1, 27]),
            },
            rx_map: RxMap::aetr(),
            has_multiple_msp: true,
        }
    }

    #[test]
    fn batches_exist_from_betaflight_api_1_43_on() {
        let api = |major, minor| ApiVersion {
            protocol: 0,
            major,
            minor,
        };
        assert!(Firmware::Betaflight.has_multiple_msp(api(1, 43)));
        assert!(!Firmware::Betaflight.has_multiple_msp(api(1, 42)));
        assert!(!Firmware::Inav.has_multiple_msp(api(2, 5)));
    }

    #[test]
    fn a_mode_flag_is_a_position_in_the_box_list_not_a_permanent_id() {
        let head = StatusHead {
            mode_flags: 0b100,
            ..StatusHead::default()
        };
        let status = Reply::Status(Status {
            head,
            ..Status::default()
        });
        assert_eq!(
            identity().is_box_active(box_id::FAILSAFE, &status),
            Some(true)
        );
        assert_eq!(identity().is_box_active(box_id::ARM, &status), Some(false));
        assert_eq!(identity().is_box_active(box_id::HORIZON, &status), None);
    }

    #[test]
    fn identity_reads_like_a_radio_call() {
        let mut identity = identity();
        assert_eq!(identity.to_string(), "Betaflight 4.6.0 (MSP 1.47)");
        identity.board = Some(BoardInfo {
            target: Some(ShortText::new("STM32F405")),
            ..BoardInfo::default()
        });
        assert_eq!(
            identity.to_string(),
            "Betaflight 4.6.0 (MSP 1.47) on STM32F405"
        );
        assert_eq!(
            Firmware::from(FcVariant { variant: *b"EMUF" }).to_string(),
            "EMUF"
        );
    }

    #[test]
    fn status_ex_is_unused_here_unless_it_is_betaflights() {
        let status = Reply::StatusEx(StatusEx::default());
        assert_eq!(identity().arming_blockers(&status).count(), 0);
    }
}
