//! The 251 bytes of FILE_TRANSFER_PROTOCOL.
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

/// Bytes of data in one payload.
pub(super) const DATA_LEN: usize = 239;

/// Opcodes.
pub(super) mod op {
    pub(in super::super) const NONE: u8 = 0;
    pub(in super::super) const TERMINATE_SESSION: u8 = 1;
    pub(in super::super) const RESET_SESSIONS: u8 = 2;
    pub(in super::super) const LIST_DIRECTORY: u8 = 3;
    pub(in super::super) const OPEN_READ: u8 = 4;
    pub(in super::super) const READ: u8 = 5;
    pub(in super::super) const CREATE: u8 = 6;
    pub(in super::super) const WRITE: u8 = 7;
    pub(in super::super) const REMOVE: u8 = 8;
    pub(in super::super) const CREATE_DIRECTORY: u8 = 9;
    pub(in super::super) const REMOVE_DIRECTORY: u8 = 10;
    pub(in super::super) const OPEN_WRITE: u8 = 11;
    pub(in super::super) const CALC_CRC: u8 = 14;
    pub(in super::super) const BURST_READ: u8 = 15;
    pub(in super::super) const ACK: u8 = 128;
    pub(in super::super) const NAK: u8 = 129;
}

/// Why a request is refused: the code in the data of a NAK.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Refusal {
    /// The disk says no.
    Fail = 1,
    /// `size` is larger than the data field, or too small for what is asked.
    InvalidDataSize = 3,
    /// No such session of this peer.
    InvalidSession = 4,
    /// Every session is taken.
    NoSessions = 5,
    /// Nothing more to read.
    EndOfFile = 6,
    /// An opcode we do not serve.
    UnknownCommand = 7,
    /// It is there already.
    Exists = 8,
    /// It may not be written, or not be read now.
    Protected = 9,
    /// There is no such file.
    NotFound = 10,
}

/// A request or an answer, taken apart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Payload {
    pub(super) seq: u16,
    pub(super) session: u8,
    pub(super) opcode: u8,
    pub(super) size: u8,
    pub(super) request: u8,
    pub(super) is_burst_complete: bool,
    pub(super) offset: u32,
    data: [u8; DATA_LEN],
}

impl Payload {
    /// From the wire.
    pub(super) fn read(bytes: &[u8; 251]) -> Self {
        let mut data = [0u8; DATA_LEN];
        data.copy_from_slice(&bytes[12..]);
        Self {
            seq: u16::from_le_bytes([bytes[0], bytes[1]]),
            session: bytes[2],
            opcode: bytes[3],
            size: bytes[4],
            request: bytes[5],
            is_burst_complete: bytes[6] != 0,
            offset: u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]),
            data,
        }
    }

    /// To the wire.
    pub(super) fn write(&self) -> [u8; 251] {
        let mut bytes = [0u8; 251];
        bytes[..2].copy_from_slice(&self.seq.to_le_bytes());
        bytes[2] = self.session;
        bytes[3] = self.opcode;
        bytes[4] = self.size;
        bytes[5] = self.request;
        bytes[6] = u8::from(self.is_burst_complete);
        bytes[8..12].copy_from_slice(&self.offset.to_le_bytes());
        bytes[12..].copy_from_slice(&self.data);
        bytes
    }

    /// The data, `size` bytes of it; none if `size` is more than fits.
    pub(super) fn data(&self) -> Option<&[u8]> {
        self.data.get(..usize::from(self.size))
    }

    /// ACK of this request with data, at most [`DATA_LEN`] bytes of it.
    pub(super) fn ack(&self, data: &[u8]) -> Self {
        let mut field = [0u8; DATA_LEN];
        let len = data.len().min(DATA_LEN);
        field[..len].copy_from_slice(&data[..len]);
        Self {
            seq: self.seq.wrapping_add(1),
            session: self.session,
            opcode: op::ACK,
            // At most 239.
            size: len as u8,
            request: self.opcode,
            is_burst_complete: false,
            offset: self.offset,
            data: field,
        }
    }

    /// NAK of this request.
    pub(super) fn nak(&self, why: Refusal) -> Self {
        Self {
            opcode: op::NAK,
            ..self.ack(&[why as u8])
        }
    }
}
