//! One message, standard or ours.

use crate::{raw, standard};
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, Message as _};
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
enum Known {
    Not,
    Raw(u8),
    Standard(u8),
}

/// Ids below this are looked up in a table; beyond there are few.
const TABLE_LEN: usize = 512;

/// Asked for every frame: 2 KiB once instead of two searches each time.
static TABLE: LazyLock<[Known; TABLE_LEN]> =
    LazyLock::new(|| core::array::from_fn(|id| search(id as u32)));

#[inline]
fn look_up(id: u32) -> Known {
    match TABLE.get(id as usize) {
        Some(known) => *known,
        None => search(id),
    }
}

fn search(id: u32) -> Known {
    // Both generated look-ups answer 0 for an unknown id; some known ids may have 0 too, so ask for existence.
    if raw::MavMessage::all_ids().binary_search(&id).is_ok() {
        Known::Raw(raw::MavMessage::extra_crc(id))
    } else if standard::MavMessage::all_ids().binary_search(&id).is_ok() {
        Known::Standard(standard::MavMessage::extra_crc(id))
    } else {
        Known::Not
    }
}

impl Message {
    /// CRC_EXTRA of an id, none if neither dialect knows it.
    #[must_use]
    pub fn crc_extra(id: u32) -> Option<u8> {
        match look_up(id) {
            Known::Raw(extra) | Known::Standard(extra) => Some(extra),
            Known::Not => None,
        }
    }

    /// Parses a payload whose checksum was right.
    ///
    /// # Errors
    /// The payload holds an enumeration value the dialect does not know, or the id is unknown.
    #[inline]
    pub fn parse(version: MavlinkVersion, id: u32, payload: &[u8]) -> Result<Self, ParserError> {
        match look_up(id) {
            Known::Raw(_) => raw::MavMessage::parse(version, id, payload).map(Self::Raw),
            Known::Standard(_) | Known::Not => {
                standard::MavMessage::parse(version, id, payload).map(Self::Standard)
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
