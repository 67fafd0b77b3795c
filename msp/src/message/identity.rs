//! Who is there: API version, firmware, board, build.

use super::messages;
use crate::wire::{LongText, ShortText};
use arrayvec::ArrayVec;
use std::fmt;

messages! {
    /// API version: what the controller's MSP dialect contains (Betaflight 1.47, 1.49; INAV 2.5;
    /// Cleanflight 1.19).
    #[derive(Copy, PartialOrd, Ord)]
    ApiVersion = API_VERSION {
        /// Protocol version, 0 in all known firmware.
        protocol: u8,
        /// Major number: 1 Betaflight and Cleanflight, 2 INAV.
        major: u8,
        /// Minor number.
        minor: u8,
    }

    /// Four letters naming the firmware: `BTFL`, `INAV`, `CLFL`...
    #[derive(Copy)]
    FcVariant = FC_VARIANT {
        /// ASCII, no terminator.
        #[serde(serialize_with = "crate::wire::characters")]
        variant: [u8; 4],
    }

    /// Version of the firmware. From 2025 on Betaflight counts years: 26.12.0 is 2026.12.0.
    FcVersion = FC_VERSION {
        /// Major number, or the year less 2000.
        major: u8,
        /// Minor number, or the month.
        minor: u8,
        /// Patch number.
        patch: u8,
        /// Newer Betaflight: the version as text, `2026.12.0-alpha`.
        text: Option<ShortText>,
    }

    /// Board and target. INAV ends after `target`, Cleanflight 1.x after `hardware_revision`.
    BoardInfo = BOARD_INFO {
        /// Board identifier, ASCII.
        #[serde(serialize_with = "crate::wire::characters")]
        board: [u8; 4],
        /// Hardware revision of the board.
        hardware_revision: u16,
        /// On-screen display chip.
        osd_type: Option<u8>,
        /// Capability bits (VCP, soft serial...).
        capabilities: Option<u8>,
        /// Build target.
        target: Option<ShortText>,
        /// Betaflight: board name.
        board_name: Option<ShortText>,
        /// Betaflight: manufacturer id.
        manufacturer: Option<ShortText>,
        /// Betaflight: signature.
        #[serde(serialize_with = "crate::wire::hexadecimal")]
        signature: Option<[u8; 32]>,
        /// Betaflight: processor type.
        mcu_type: Option<u8>,
        /// Betaflight: configuration state.
        config_state: Option<u8>,
        /// Betaflight: gyro sample rate in Hz.
        gyro_rate_hz: Option<u16>,
        /// Betaflight: bit 0 accelerometer not calibrated, bit 1 no motor protocol.
        config_problems: Option<u32>,
        /// Betaflight: number of SPI devices.
        spi_devices: Option<u8>,
        /// Betaflight: number of I2C devices.
        i2c_devices: Option<u8>,
    }

    /// When and from what the firmware was built.
    BuildInfo = BUILD_INFO {
        /// Date as the C compiler writes it, `Nov 22 2026`.
        #[serde(serialize_with = "crate::wire::characters")]
        date: [u8; 11],
        /// Time, `04:31:33`.
        #[serde(serialize_with = "crate::wire::characters")]
        time: [u8; 8],
        /// Revision, at least seven characters; some builds append bytes that are not text.
        #[serde(serialize_with = "crate::wire::characters")]
        revision: ArrayVec<u8, 64>,
    }

    /// Identity in MultiWii and Cleanflight 1.x; Betaflight and INAV refuse it.
    #[derive(Copy)]
    Ident = IDENT {
        /// Firmware version times 100.
        version: u8,
        /// Airframe: 3 is a quadcopter X.
        multitype: u8,
        /// Version of the protocol.
        msp_version: u8,
        /// Capability bits.
        capability: u32,
    }

    /// Craft name.
    Name = NAME {
        /// The name, may be empty.
        name: LongText,
    }

    /// Serial number of the processor.
    #[derive(Copy)]
    Uid = UID {
        /// 96 bits.
        uid: [u32; 3],
    }
}

impl fmt::Display for ApiVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}

impl fmt::Display for FcVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.text {
            Some(text) => text.fmt(f),
            // Versions with a year in them begin with 2025 and no firmware counts majors that far.
            None if self.major >= 25 => write!(
                f,
                "{}.{}.{}",
                2000 + u16::from(self.major),
                self.minor,
                self.patch
            ),
            None => write!(f, "{}.{}.{}", self.major, self.minor, self.patch),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Message;

    #[test]
    fn calendar_versions_are_shown_as_years() {
        assert_eq!(FcVersion::parse(&[4, 6, 0]).unwrap().to_string(), "4.6.0");
        assert_eq!(
            FcVersion::parse(&[26, 12, 0]).unwrap().to_string(),
            "2026.12.0"
        );
        assert_eq!(
            FcVersion::parse(b"\x1a\x0c\x00\x0f2026.12.0-alpha")
                .unwrap()
                .to_string(),
            "2026.12.0-alpha"
        );
    }

    #[test]
    fn short_board_info_of_old_cleanflight_is_complete_without_a_target() {
        let info = BoardInfo::parse(b"SRF3\x01\x00").unwrap();
        assert_eq!(
            (&info.board, info.hardware_revision, info.target),
            (b"SRF3", 1, None)
        );
    }
}
