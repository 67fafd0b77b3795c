//! FILE_TRANSFER_PROTOCOL: no files are served yet, and every request is told so at once, so that clients fall back
//! instead of waiting.
//!
//! | Offset | Size | Field of the payload |
//! | --- | --- | --- |
//! | 0 | 2 | seq, the answer's is one more |
//! | 2 | 1 | session |
//! | 3 | 1 | opcode: 128 ACK, 129 NAK |
//! | 4 | 1 | size of data |
//! | 5 | 1 | request opcode, in answers |
//! | 6 | 1 | burst complete |
//! | 8 | 4 | offset |
//! | 12 | 239 | data; of a NAK the error code |
//!
//! Source: MAVLink guide, "File Transfer Protocol".

use super::{Destination, Outbox, Peer};
use mavlink_dialect::Message;
use mavlink_dialect::standard::{FILE_TRANSFER_PROTOCOL_DATA, MavMessage};

const ACK: u8 = 128;
const NAK: u8 = 129;
const INVALID_SESSION: u8 = 4;
const UNKNOWN_COMMAND: u8 = 7;
const FILE_NOT_FOUND: u8 = 10;

/// Answers a file request; anything else is left alone.
pub fn handle(from: Peer, message: &Message, out: &mut Outbox) {
    let Message::Standard(MavMessage::FILE_TRANSFER_PROTOCOL(m)) = message else {
        return;
    };
    let request = &m.payload;
    let opcode = request[3];
    let error = match opcode {
        // An answer: never answered.
        ACK | NAK => return,
        // None, TerminateSession, ResetSessions: there is no session, so they are done.
        0..=2 => None,
        // ListDirectory, OpenFileRO, CalcFileCRC32.
        3 | 4 | 14 => Some(FILE_NOT_FOUND),
        // ReadFile, BurstReadFile.
        5 | 15 => Some(INVALID_SESSION),
        _ => Some(UNKNOWN_COMMAND),
    };
    let mut payload = [0u8; 251];
    let sequence = u16::from_le_bytes([request[0], request[1]]).wrapping_add(1);
    payload[..2].copy_from_slice(&sequence.to_le_bytes());
    payload[2] = request[2];
    payload[3] = if error.is_some() { NAK } else { ACK };
    payload[5] = opcode;
    if let Some(code) = error {
        payload[4] = 1;
        payload[12] = code;
    }
    out.send(
        Destination::Link(from.link),
        MavMessage::FILE_TRANSFER_PROTOCOL(FILE_TRANSFER_PROTOCOL_DATA {
            target_network: 0,
            target_system: from.address.system,
            target_component: from.address.component,
            payload,
        }),
    );
}
