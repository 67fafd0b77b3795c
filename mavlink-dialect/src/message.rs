//! One message, standard or ours.

use crate::{raw, standard};
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, Message as _, MessageData as _};
use std::sync::LazyLock;

/// A parsed message. Ids that `kestrel.xml` declares parse as [`Message::Raw`], everything else as standard.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// Raw twin or message of our own.
    Raw(raw::MavMessage),
    /// Standard dialect.
    Standard(standard::MavMessage),
}

/// Which dialect declares an id, with its CRC_EXTRA.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Known {
    Not,
    Raw(u8),
    Standard(u8),
}

/// Ids below this are looked up in a table; beyond there are few.
const TABLE_LEN: usize = 512;

/// Asked for every frame: 1 KiB once instead of two searches each time.
static TABLE: LazyLock<[Known; TABLE_LEN]> =
    LazyLock::new(|| core::array::from_fn(|id| Known::search(id as u32)));

impl Known {
    #[inline]
    pub(crate) fn of(id: u32) -> Self {
        match TABLE.get(id as usize) {
            Some(known) => *known,
            None => Self::search(id),
        }
    }

    #[inline]
    pub(crate) const fn crc_extra(self) -> Option<u8> {
        match self {
            Self::Raw(extra) | Self::Standard(extra) => Some(extra),
            Self::Not => None,
        }
    }

    fn search(id: u32) -> Self {
        // Both generated look-ups answer 0 for an unknown id; some known ids may have 0 too, so ask for existence.
        if raw::MavMessage::all_ids().binary_search(&id).is_ok() {
            Self::Raw(raw::MavMessage::extra_crc(id))
        } else if standard::MavMessage::all_ids().binary_search(&id).is_ok() {
            Self::Standard(standard::MavMessage::extra_crc(id))
        } else {
            Self::Not
        }
    }
}

/// What comes in streams, parsed where it is wanted: an enumeration that holds any message is 280 bytes, and copying one costs as much as
/// parsing what is in it.
macro_rules! streams {
    ($($name:ident $data:ident),* $(,)?) => {
        #[inline]
        fn parse_stream(
            version: MavlinkVersion,
            id: u32,
            payload: &[u8],
        ) -> Option<Result<Message, ParserError>> {
            Some(match id {
                $(standard::$data::ID => match standard::$data::deser(version, payload) {
                    Ok(data) => Ok(Message::Standard(standard::MavMessage::$name(data))),
                    Err(why) => Err(why),
                },)*
                _ => return None,
            })
        }
    };
}

streams! {
    SYS_STATUS SYS_STATUS_DATA,
    SYSTEM_TIME SYSTEM_TIME_DATA,
    PARAM_VALUE PARAM_VALUE_DATA,
    ATTITUDE ATTITUDE_DATA,
    ATTITUDE_QUATERNION ATTITUDE_QUATERNION_DATA,
    LOCAL_POSITION_NED LOCAL_POSITION_NED_DATA,
    GLOBAL_POSITION_INT GLOBAL_POSITION_INT_DATA,
    RC_CHANNELS RC_CHANNELS_DATA,
    RC_CHANNELS_OVERRIDE RC_CHANNELS_OVERRIDE_DATA,
    VFR_HUD VFR_HUD_DATA,
    ATTITUDE_TARGET ATTITUDE_TARGET_DATA,
    POSITION_TARGET_LOCAL_NED POSITION_TARGET_LOCAL_NED_DATA,
    VISION_POSITION_ESTIMATE VISION_POSITION_ESTIMATE_DATA,
    HIGHRES_IMU HIGHRES_IMU_DATA,
    OPTICAL_FLOW_RAD OPTICAL_FLOW_RAD_DATA,
    FILE_TRANSFER_PROTOCOL FILE_TRANSFER_PROTOCOL_DATA,
    TIMESYNC TIMESYNC_DATA,
    LOG_DATA LOG_DATA_DATA,
    DISTANCE_SENSOR DISTANCE_SENSOR_DATA,
    ALTITUDE ALTITUDE_DATA,
    BATTERY_STATUS BATTERY_STATUS_DATA,
    ESTIMATOR_STATUS ESTIMATOR_STATUS_DATA,
    OBSTACLE_DISTANCE OBSTACLE_DISTANCE_DATA,
    ODOMETRY ODOMETRY_DATA,
}

impl Message {
    /// CRC_EXTRA of an id, none if neither dialect knows it.
    #[must_use]
    pub fn crc_extra(id: u32) -> Option<u8> {
        Known::of(id).crc_extra()
    }

    /// Parses a payload whose checksum was right.
    ///
    /// # Errors
    /// The payload holds an enumeration value the dialect does not know, or the id is unknown.
    #[inline]
    pub fn parse(version: MavlinkVersion, id: u32, payload: &[u8]) -> Result<Self, ParserError> {
        Self::parse_known(Known::of(id), version, id, payload)
    }

    #[inline]
    pub(crate) fn parse_known(
        known: Known,
        version: MavlinkVersion,
        id: u32,
        payload: &[u8],
    ) -> Result<Self, ParserError> {
        match known {
            Known::Raw(_) => raw::MavMessage::parse(version, id, payload).map(Self::Raw),
            Known::Standard(_) | Known::Not => {
                parse_stream(version, id, payload).unwrap_or_else(|| {
                    standard::MavMessage::parse(version, id, payload).map(Self::Standard)
                })
            }
        }
    }

    /// Message id.
    #[must_use]
    pub fn id(&self) -> u32 {
        match self {
            Self::Raw(m) => m.message_id(),
            Self::Standard(m) => m.message_id(),
        }
    }

    /// Message name, as the protocol spells it.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Raw(m) => m.message_name(),
            Self::Standard(m) => m.message_name(),
        }
    }

    /// (target system, target component), 0 where the message names none.
    #[must_use]
    pub fn target(&self) -> (u8, u8) {
        let (system, component) = match self {
            Self::Raw(m) => (m.target_system_id(), m.target_component_id()),
            Self::Standard(m) => (m.target_system_id(), m.target_component_id()),
        };
        (system.unwrap_or(0), component.unwrap_or(0))
    }

    /// Writes the payload as MAVLink 2 (trailing zeros cut); returns its length. `out` holds at least 255 bytes.
    pub fn write_payload(&self, out: &mut [u8; 255]) -> usize {
        match self {
            Self::Raw(m) => m.ser(MavlinkVersion::V2, out),
            Self::Standard(m) => m.ser(MavlinkVersion::V2, out),
        }
    }
}

impl From<raw::MavMessage> for Message {
    fn from(m: raw::MavMessage) -> Self {
        Self::Raw(m)
    }
}

impl From<standard::MavMessage> for Message {
    fn from(m: standard::MavMessage) -> Self {
        Self::Standard(m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_raw_twin_is_the_standard_message_on_the_wire() {
        let standard_ids = standard::MavMessage::all_ids();
        for id in raw::MavMessage::all_ids()
            .iter()
            .filter(|id| standard_ids.contains(id))
        {
            assert_eq!(
                raw::MavMessage::extra_crc(*id),
                standard::MavMessage::extra_crc(*id),
                "CRC_EXTRA of message {id}"
            );
            let name = |m: Option<&'static str>| m.unwrap_or("none");
            assert_eq!(
                name(raw::MavMessage::default_message_from_id(*id).map(|m| m.message_name())),
                name(standard::MavMessage::default_message_from_id(*id).map(|m| m.message_name())),
            );
        }
    }

    #[test]
    fn ids_are_sorted_so_that_they_can_be_searched() {
        assert!(raw::MavMessage::all_ids().is_sorted());
        assert!(standard::MavMessage::all_ids().is_sorted());
    }

    #[test]
    fn an_unknown_command_parses_and_can_be_answered() {
        let odd = raw::COMMAND_LONG_DATA {
            command: 65_000,
            target_system: 1,
            ..Default::default()
        };
        let mut payload = [0u8; 255];
        let n =
            Message::Raw(raw::MavMessage::COMMAND_LONG(odd.clone())).write_payload(&mut payload);
        let back = Message::parse(MavlinkVersion::V2, 76, &payload[..n]).unwrap();
        assert_eq!(back, Message::Raw(raw::MavMessage::COMMAND_LONG(odd)));
        assert_eq!(back.target(), (1, 0));
    }
}
