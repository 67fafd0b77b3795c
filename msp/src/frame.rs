//! Frames: delimiters, lengths, checksums.
//!
//! | form | bytes | checksum |
//! | --- | --- | --- |
//! | v1 | `$ M dir len:u8 cmd:u8 payload ck` | XOR of everything after dir |
//! | v1 jumbo | `$ M dir 255 cmd:u8 len:u16 payload ck` | XOR of everything after dir |
//! | v2 | `$ X dir flag:u8 cmd:u16 len:u16 payload crc` | CRC-8/DVB-S2 of everything after dir |
//! | v2 over v1 | a v1 frame with cmd 255 whose payload is `flag cmd:u16 len:u16 payload crc` | CRC-8 inside, XOR outside |
//!
//! `dir` is `<` to the flight controller, `>` from it, `!` from it with an error (unknown, bad
//! argument, refused; the payload is empty). Integers are little endian. Jumbo is v1 for payloads
//! of 255 bytes and more: [`encode`] chooses it by itself and a decoded one counts as
//! [`Framing::V1`]. The controller answers in the framing of the request.
//!
//! [`Decoder`] takes bytes in pieces of any size and yields the frames in them:
//!
//! ```
//! use msp::frame::{Accept, Decoder};
//! let mut decoder = Decoder::new(Accept::Requests);
//! for piece in [&b"noise $M<"[..], &[0, 1, 1], b"$M<\x00\x6c\x6c"] {
//!     let mut input = piece;
//!     while let Some(frame) = decoder.decode(&mut input) {
//!         assert!(frame.command == 1 || frame.command == 108);
//!     }
//! }
//! assert_eq!((decoder.counters().frames, decoder.counters().noise_bytes), (2, 6));
//! ```

mod decoder;

pub use decoder::{Accept, Counters, Decoder, Resync};

/// Longest payload a [`Decoder`] accepts unless told otherwise: a data-flash read of 4096 bytes
/// with its head, rounded up.
pub const MAX_PAYLOAD: usize = 4352;

/// Bytes that v2 adds inside a v1 payload: flag, command, length, CRC.
const INNER_OVERHEAD: usize = 6;

/// Form of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Framing {
    /// `$M`, commands below 255.
    #[default]
    V1,
    /// `$X`.
    V2,
    /// v2 inside a v1 frame with command 255.
    V2OverV1,
}

/// Where a frame goes and whether it says no.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// `!`: from the flight controller, the request was not understood or is refused.
    Error,
    /// `>`: from the flight controller.
    Reply,
    /// `<`: to the flight controller.
    Request,
}

impl Direction {
    const fn byte(self) -> u8 {
        match self {
            Self::Error => b'!',
            Self::Reply => b'>',
            Self::Request => b'<',
        }
    }

    const fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            b'!' => Some(Self::Error),
            b'>' => Some(Self::Reply),
            b'<' => Some(Self::Request),
            _ => None,
        }
    }
}

/// One well-formed frame, borrowed from the decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Form.
    pub framing: Framing,
    /// Direction.
    pub direction: Direction,
    /// v2 flag byte, 0 in v1. Bit 0: no reply wanted (INAV only).
    pub flag: u8,
    /// Command number ([`crate::command`]).
    pub command: u16,
    /// Payload.
    pub payload: &'a [u8],
}

impl Frame<'_> {
    /// Appends the frame to `out`.
    ///
    /// # Errors
    /// [`EncodeError`] when command or payload do not fit the framing.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        let Ok(length) = u16::try_from(self.payload.len() + INNER_OVERHEAD) else {
            return Err(EncodeError::PayloadTooLong {
                command: self.command,
                length: self.payload.len(),
            });
        };
        match self.framing {
            Framing::V1 => {
                let command = u8::try_from(self.command)
                    .ok()
                    .filter(|&command| command != u8::MAX);
                let command = command.ok_or(EncodeError::NeedsV2 {
                    command: self.command,
                })?;
                self.v1(command, length - 6, out, |out| {
                    out.extend_from_slice(self.payload)
                });
            }
            Framing::V2 => {
                out.extend_from_slice(&[b'$', b'X', self.direction.byte()]);
                self.v2_body(out);
            }
            Framing::V2OverV1 => self.v1(u8::MAX, length, out, |out| self.v2_body(out)),
        }
        Ok(())
    }

    fn v1(&self, command: u8, length: u16, out: &mut Vec<u8>, payload: impl FnOnce(&mut Vec<u8>)) {
        out.extend_from_slice(&[b'$', b'M', self.direction.byte()]);
        let summed = out.len();
        match u8::try_from(length) {
            Ok(short) if short != u8::MAX => out.extend_from_slice(&[short, command]),
            _ => {
                out.extend_from_slice(&[u8::MAX, command]);
                out.extend_from_slice(&length.to_le_bytes());
            }
        }
        payload(out);
        let checksum = xor(&out[summed..]);
        out.push(checksum);
    }

    fn v2_body(&self, out: &mut Vec<u8>) {
        let summed = out.len();
        out.push(self.flag);
        out.extend_from_slice(&self.command.to_le_bytes());
        // Fits: `encode` has checked it.
        out.extend_from_slice(
            &u16::try_from(self.payload.len())
                .unwrap_or(u16::MAX)
                .to_le_bytes(),
        );
        out.extend_from_slice(self.payload);
        let checksum = crc8_dvb_s2(&out[summed..]);
        out.push(checksum);
    }
}

/// Appends a frame with flag 0 to `out`.
///
/// # Errors
/// [`EncodeError`] when command or payload do not fit the framing; `out` is unchanged then.
pub fn encode(
    framing: Framing,
    direction: Direction,
    command: u16,
    payload: &[u8],
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    Frame {
        framing,
        direction,
        flag: 0,
        command,
        payload,
    }
    .encode(out)
}

/// Why something cannot be put into a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// v1 has one byte for the command, and 255 is taken.
    #[error("{name} ({command}) is above 254: use v2 framing", name = crate::command::name(*.command))]
    NeedsV2 {
        /// Command number.
        command: u16,
    },
    /// Length fields have 16 bits.
    #[error("a payload of {length} bytes for {name} ({command}) is longer than 65529", name = crate::command::name(*.command))]
    PayloadTooLong {
        /// Command number.
        command: u16,
        /// Bytes of payload.
        length: usize,
    },
}

/// Eight bytes at a time: half of parsing a v1 frame is this sum.
#[inline]
fn xor(bytes: &[u8]) -> u8 {
    let (words, rest) = bytes.as_chunks::<8>();
    let sum = words
        .iter()
        .fold(0, |sum, word| sum ^ u64::from_le_bytes(*word));
    let sum = match bytes.last_chunk::<8>() {
        // The last word again, without the bytes that are in the sum already.
        Some(last) if !rest.is_empty() => {
            sum ^ (u64::from_le_bytes(*last) >> (64 - 8 * rest.len()))
        }
        _ => rest.iter().fold(sum, |sum, byte| sum ^ u64::from(*byte)),
    };
    let sum = sum ^ (sum >> 32);
    let sum = sum ^ (sum >> 16);
    (sum ^ (sum >> 8)).to_le_bytes()[0]
}

/// CRC-8/DVB-S2: polynomial 0xD5, initial value 0, not reflected.
///
/// Four bytes a step ("slicing"): the table lookups of a step do not wait for each other.
#[inline]
#[must_use]
pub fn crc8_dvb_s2(bytes: &[u8]) -> u8 {
    let (steps, rest) = bytes.as_chunks::<4>();
    let crc = steps.iter().fold(0, |crc, [a, b, c, d]| {
        CRC_TABLES[3][usize::from(crc ^ a)]
            ^ CRC_TABLES[2][usize::from(*b)]
            ^ CRC_TABLES[1][usize::from(*c)]
            ^ CRC_TABLES[0][usize::from(*d)]
    });
    rest.iter()
        .fold(crc, |crc, byte| CRC_TABLES[0][usize::from(crc ^ byte)])
}

/// Table k holds the CRC of each byte followed by k zero bytes.
static CRC_TABLES: [[u8; 256]; 4] = {
    let mut tables = [[0; 256]; 4];
    let mut index = 0;
    while index < 256 {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "index < 256; `try_from` is not const"
        )]
        let mut crc = index as u8;
        let mut table = 0;
        while table < 4 {
            let mut bit = 0;
            while bit < 8 {
                crc = if crc & 0x80 == 0 {
                    crc << 1
                } else {
                    (crc << 1) ^ 0xd5
                };
                bit += 1;
            }
            tables[table][index] = crc;
            table += 1;
        }
        index += 1;
    }
    tables
};
