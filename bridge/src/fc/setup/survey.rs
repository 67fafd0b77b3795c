//! What a controller is and how it is set.

use crate::fc::conversation::{AskError, Controller, read};
use msp::firmware::{ArmingBlocker, Firmware, box_id};
use msp::message::{
    ApiVersion, BoardInfo, BoxIds, FcVariant, FcVersion, FeatureConfig, Ident, ModeRange,
    ModeRanges, Reply, RxConfig, RxMap, Uid,
};
use msp::{Identity, Message as _, command};
use std::collections::BTreeMap;

/// MSP_RXFAIL_CONFIG: what each channel does without a receiver (mode u8, value u16 in us).
pub const RXFAIL_CONFIG: u16 = 77;
/// Sets one channel of it: channel u8, mode u8, value u16.
pub const SET_RXFAIL_CONFIG: u16 = 78;

/// Messages that hold every setting that may be touched, by firmware.
#[must_use]
pub const fn touched(firmware: Firmware) -> &'static [u16] {
    match firmware {
        Firmware::Betaflight => &[command::FEATURE_CONFIG, command::MODE_RANGES, RXFAIL_CONFIG],
        Firmware::Cleanflight => &[command::FEATURE_CONFIG, command::MODE_RANGES],
        Firmware::Inav => &[command::RX_CONFIG, command::MODE_RANGES],
        Firmware::MultiWii | Firmware::Other(_) => &[],
    }
}

/// A controller as it was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Survey {
    /// Who it is.
    pub identity: Identity,
    /// Serial number of its processor, when it tells.
    pub uid: Option<Vec<u8>>,
    /// Motors are under way.
    pub is_armed: bool,
    /// What blocks arming now.
    pub blockers: Vec<ArmingBlocker>,
    /// Its scheduler runs.
    pub cycle_us: u16,
    /// It has an accelerometer.
    pub has_accelerometer: bool,
    /// Payloads of [`touched`] messages, as they came.
    pub settings: BTreeMap<u16, Vec<u8>>,
}

impl Survey {
    /// Reads everything.
    ///
    /// # Errors
    /// [`AskError`]: silent, or a question that it must know was refused.
    pub fn take(controller: &mut dyn Controller) -> Result<Self, AskError> {
        let identity = identify(controller)?;
        let uid = optional(controller.ask(Uid::COMMAND, &[]))?;
        let status_command = identity.status_command();
        let status = Reply::parse(status_command, &controller.ask(status_command, &[])?)?;
        let (cycle_us, sensors) = match &status {
            Reply::Status(s) => (s.head.cycle_time_us, s.head.sensors),
            Reply::StatusEx(s) => (s.head.cycle_time_us, s.head.sensors),
            Reply::InavStatus(s) => (s.cycle_time_us, s.sensors),
            _ => (0, 0),
        };
        let mut settings = BTreeMap::new();
        for &message in touched(identity.firmware) {
            if let Some(payload) = optional(controller.ask(message, &[]))? {
                settings.insert(message, payload);
            }
        }
        Ok(Self {
            uid,
            is_armed: identity
                .is_box_active(box_id::ARM, &status)
                .unwrap_or(false),
            blockers: identity.arming_blockers(&status).collect(),
            cycle_us,
            has_accelerometer: sensors & 1 != 0,
            settings,
            identity,
        })
    }

    /// Feature bits.
    #[must_use]
    pub fn features(&self) -> Option<FeatureConfig> {
        FeatureConfig::parse(self.settings.get(&command::FEATURE_CONFIG)?).ok()
    }

    /// Slots of the mode switches.
    #[must_use]
    pub fn mode_ranges(&self) -> Vec<ModeRange> {
        self.settings
            .get(&command::MODE_RANGES)
            .and_then(|payload| ModeRanges::parse(payload).ok())
            .map(|ranges| ranges.slots.to_vec())
            .unwrap_or_default()
    }

    /// Receiver, INAV.
    #[must_use]
    pub fn rx_config(&self) -> Option<RxConfig> {
        RxConfig::parse(self.settings.get(&command::RX_CONFIG)?).ok()
    }

    /// What a channel (roll, pitch, yaw, throttle, Aux1 ...) does without a receiver: mode, value in us.
    #[must_use]
    pub fn rx_fail(&self, channel: usize) -> Option<(u8, u16)> {
        let entry = self
            .settings
            .get(&RXFAIL_CONFIG)?
            .get(3 * channel..3 * channel + 3)?;
        Some((entry[0], u16::from_le_bytes([entry[1], entry[2]])))
    }
}

/// Who answers.
///
/// # Errors
/// [`AskError`]: silent.
pub fn identify(controller: &mut dyn Controller) -> Result<Identity, AskError> {
    let api: ApiVersion = match read(controller) {
        Err(e @ (AskError::Refused(_) | AskError::Silent(_))) => {
            return identify_multiwii(controller).map_err(|_| e);
        }
        answer => answer?,
    };
    let firmware = Firmware::from(read::<FcVariant>(controller)?);
    let version: FcVersion = read(controller)?;
    let board = optional(read::<BoardInfo>(controller))?;
    let box_ids: BoxIds = read(controller)?;
    let rx_map = optional(read::<RxMap>(controller))?;
    Ok(Identity {
        firmware,
        api,
        version,
        board,
        box_ids,
        rx_map: rx_map.unwrap_or_else(|| firmware.default_rx_map()),
        has_multiple_msp: firmware.has_multiple_msp(api),
    })
}

/// One that knows no API_VERSION: it is asked as MultiWii was.
fn identify_multiwii(controller: &mut dyn Controller) -> Result<Identity, AskError> {
    let ident: Ident = read(controller)?;
    let firmware = Firmware::MultiWii;
    Ok(Identity {
        firmware,
        api: ApiVersion {
            protocol: 0,
            major: 0,
            minor: 0,
        },
        version: FcVersion {
            major: ident.version / 100,
            minor: ident.version % 100,
            patch: 0,
            text: None,
        },
        board: None,
        box_ids: read(controller)?,
        rx_map: firmware.default_rx_map(),
        has_multiple_msp: false,
    })
}

/// A refusal means that the firmware has no such thing.
fn optional<T>(answer: Result<T, AskError>) -> Result<Option<T>, AskError> {
    match answer {
        Ok(value) => Ok(Some(value)),
        Err(AskError::Refused(_)) => Ok(None),
        Err(e) => Err(e),
    }
}
