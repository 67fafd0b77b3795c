//! Who we are and what we can do.

#![expect(
    deprecated,
    reason = "PROTOCOL_VERSION is on its way out, stations still ask for it"
)]

use super::status::standard_mode_enum;
use super::table::View;
use crate::autopilot::mode::Mode;
use crate::gcs::convert::mode_to_px4;
use crate::gcs::metadata;
use mavlink_dialect::standard::{
    AVAILABLE_MODES_DATA, COMPONENT_METADATA_DATA, MavMessage, MavModeProperty,
    PROTOCOL_VERSION_DATA,
};
use mavlink_dialect::{Message, raw};

/// MAV_PROTOCOL_CAPABILITY bits: what is built. Exactly one of the parameter encodings is named, bytewise.
pub const CAPABILITIES: u64 = MISSION_FLOAT
    | MISSION_INT
    | COMMAND_INT
    | PARAM_ENCODE_BYTEWISE
    | FTP
    | SET_ATTITUDE_TARGET
    | SET_POSITION_TARGET_LOCAL_NED
    | SET_POSITION_TARGET_GLOBAL_INT
    | FLIGHT_TERMINATION
    | MAVLINK2
    | MISSION_FENCE
    | MISSION_RALLY;
const MISSION_FLOAT: u64 = 0x1;
const MISSION_INT: u64 = 0x4;
const COMMAND_INT: u64 = 0x8;
const PARAM_ENCODE_BYTEWISE: u64 = 0x10;
const FTP: u64 = 0x20;
const SET_ATTITUDE_TARGET: u64 = 0x40;
const SET_POSITION_TARGET_LOCAL_NED: u64 = 0x80;
const SET_POSITION_TARGET_GLOBAL_INT: u64 = 0x100;
const FLIGHT_TERMINATION: u64 = 0x800;
const MAVLINK2: u64 = 0x2000;
const MISSION_FENCE: u64 = 0x4000;
const MISSION_RALLY: u64 = 0x8000;

/// The PX4 whose conventions we follow, 1.15.0; type 0 (development) keeps QGroundControl from offering an update.
pub const FLIGHT_SW_VERSION: u32 = 0x010F_0000;

/// "KESTREL" and the system id: not zero, and the same at each start.
const UID_PREFIX: [u8; 7] = *b"KESTREL";

pub(super) fn autopilot_version(v: &View<'_>, out: &mut Vec<Message>) {
    let mut uid = [0u8; 8];
    uid[..7].copy_from_slice(&UID_PREFIX);
    uid[7] = v.us.system;
    let mut uid2 = [0u8; 18];
    uid2[..8].copy_from_slice(&uid);
    out.push(
        raw::MavMessage::AUTOPILOT_VERSION(raw::AUTOPILOT_VERSION_DATA {
            capabilities: CAPABILITIES,
            flight_sw_version: FLIGHT_SW_VERSION,
            flight_custom_version: version_bytes(env!("CARGO_PKG_VERSION")),
            uid: u64::from_be_bytes(uid),
            uid2,
            ..Default::default()
        })
        .into(),
    );
}

/// QGroundControl prints bytes 2, 1, 0 as the custom version.
fn version_bytes(version: &str) -> [u8; 8] {
    let mut bytes = [0u8; 8];
    for (part, at) in version.split(['.', '-', '+']).zip([2, 1, 0]) {
        bytes[at] = part.parse().unwrap_or(0);
    }
    bytes
}

pub(super) fn protocol_version(_: &View<'_>, out: &mut Vec<Message>) {
    out.push(
        MavMessage::PROTOCOL_VERSION(PROTOCOL_VERSION_DATA {
            version: 200,
            min_version: 100,
            max_version: 200,
            ..PROTOCOL_VERSION_DATA::default()
        })
        .into(),
    );
}

pub(super) fn component_metadata(v: &View<'_>, out: &mut Vec<Message>) {
    out.push(
        MavMessage::COMPONENT_METADATA(COMPONENT_METADATA_DATA {
            time_boot_ms: v.now.boot_ms(),
            file_crc: metadata::general_crc(),
            uri: metadata::GENERAL_URI.into(),
        })
        .into(),
    );
}

/// All modes, one message each.
pub(super) fn available_modes(_: &View<'_>, out: &mut Vec<Message>) {
    for (index, mode) in (1u8..).zip(Mode::ALL) {
        let mut properties = MavModeProperty::empty();
        properties.set(
            MavModeProperty::MAV_MODE_PROPERTY_AUTO_MODE,
            !mode.is_stick_mode(),
        );
        properties.set(
            MavModeProperty::MAV_MODE_PROPERTY_ADVANCED,
            matches!(mode, Mode::Offboard | Mode::Stabilized),
        );
        out.push(
            MavMessage::AVAILABLE_MODES(AVAILABLE_MODES_DATA {
                number_modes: Mode::ALL.len() as u8,
                mode_index: index,
                standard_mode: standard_mode_enum(mode),
                custom_mode: mode_to_px4(mode).custom_mode(),
                properties,
                mode_name: mode.name().into(),
            })
            .into(),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capabilities_are_those_of_the_contract() {
        assert_eq!(CAPABILITIES, 0xE9FD);
    }

    #[test]
    fn the_custom_version_reads_backwards() {
        assert_eq!(version_bytes("1.22.3-rc4")[..4], [3, 22, 1, 0]);
    }
}
