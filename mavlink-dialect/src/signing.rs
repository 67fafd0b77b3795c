//! MAVLink 2 signing: who may speak on a link is who knows its key.
//!
//! A signed frame carries 13 bytes more: link id (u8), time stamp (u48, 10 us since 2015-01-01 UTC) and the first 6 bytes
//! of SHA-256 over key, frame, checksum, link id and time stamp. A frame is taken if
//!
//! - its signature is right, compared in constant time;
//! - its time stamp is larger than the last one of the same (system, component, link id), so that nothing is taken twice;
//! - the first one of such a stream is at most a minute behind our clock, so that nothing recorded earlier is.
//!
//! Our clock is the largest of system time, the stored time of an earlier run and every valid time stamp seen, and counts on
//! with each frame sent. Source: MAVLink guide, "Message Signing".
//!
//! ```
//! use mavlink_dialect::signing::{SigningKey, SigningState};
//! use mavlink_dialect::{Address, Decoder, Encoder, raw};
//! let key = SigningKey::from_passphrase("hangar 18");
//! let (mut sender, mut receiver) = (SigningState::new(0), SigningState::new(0));
//! let mut encoder = Encoder::new(Address { system: 255, component: 190 });
//! let beat = raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA::default()).into();
//! let bytes = encoder.encode_signed(&beat, &key, 1, sender.stamp());
//! let mut verdicts = Vec::new();
//! for _ in 0..2 {
//!     Decoder::new().push_wire(&bytes, |frame, _| verdicts.push(receiver.check(&key, frame.from, frame.wire).is_ok()));
//! }
//! assert_eq!(verdicts, [true, false], "once, and not again");
//! ```

use crate::Address;
use arrayvec::ArrayVec;
use sha2::{Digest, Sha256};
use std::fmt;
use subtle::ConstantTimeEq;
use thiserror::Error;

/// Bytes a signature adds to a frame.
pub const SIGNATURE_LEN: usize = 13;
/// Bytes of it that are the hash.
const TAG_LEN: usize = 6;
/// Largest time stamp that a clock may be set to (2059): beyond the last of 48 bits nobody could sign any more.
pub const MAX_STAMP: u64 = 1 << 47;
/// 2015-01-01 UTC, us since 1970.
const EPOCH_US: u64 = 1_420_070_400_000_000;
/// A new stream may be this far behind, 10 us.
const MAX_BEHIND: u64 = 6_000_000;
/// Streams remembered; the one with the oldest time stamp makes room.
const MAX_STREAMS: usize = 64;

/// A secret of 32 bytes. It prints as `***`.
#[derive(Clone, PartialEq, Eq)]
pub struct SigningKey([u8; 32]);

impl fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("***")
    }
}

impl SigningKey {
    /// A key as it is.
    #[must_use]
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// SHA-256 of a pass phrase, as MAVProxy and QGroundControl make keys.
    #[must_use]
    pub fn from_passphrase(text: &str) -> Self {
        Self(Sha256::digest(text.as_bytes()).into())
    }

    /// From 64 hexadecimal digits; none if it is anything else.
    #[must_use]
    pub fn from_hex(text: &str) -> Option<Self> {
        let text = text.trim().as_bytes();
        if text.len() != 64 {
            return None;
        }
        let digit = |b: u8| char::from(b).to_digit(16);
        let mut key = [0u8; 32];
        for (byte, pair) in key.iter_mut().zip(text.chunks_exact(2)) {
            // Two digits fit a byte.
            *byte = (digit(pair[0])? * 16 + digit(pair[1])?) as u8;
        }
        Some(Self(key))
    }

    /// As 64 hexadecimal digits.
    #[must_use]
    pub fn to_hex(&self) -> String {
        self.0.iter().map(|b| format!("{b:02x}")).collect()
    }

    /// The hash of a frame up to its time stamp.
    pub(crate) fn tag(&self, signed: &[u8]) -> [u8; TAG_LEN] {
        let hash = Sha256::new()
            .chain_update(self.0)
            .chain_update(signed)
            .finalize();
        core::array::from_fn(|i| hash[i])
    }
}

/// Why a frame is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Rejection {
    /// It carries no signature.
    #[error("not signed")]
    Unsigned,
    /// Signed with another key, or changed on the way.
    #[error("wrong signature")]
    WrongSignature,
    /// Its time stamp was used before, or lies too far back.
    #[error("old time stamp")]
    Old,
}

#[derive(Clone, Copy, Debug)]
struct Stream {
    from: Address,
    link_id: u8,
    last: u64,
}

/// Clock and streams. One for all links, so that what was heard on one cannot be said again on another.
#[derive(Clone, Debug, Default)]
pub struct SigningState {
    clock: u64,
    streams: ArrayVec<Stream, MAX_STREAMS>,
}

impl SigningState {
    /// A clock that is not behind the time stored by an earlier run (10 us; 0 none).
    #[must_use]
    pub fn new(stored: u64) -> Self {
        Self {
            clock: stored,
            streams: ArrayVec::new(),
        }
    }

    /// The system's time, UTC us; a clock that is ahead stays ahead.
    pub fn set_utc(&mut self, utc_us: u64) {
        self.clock = self.clock.max(utc_us.saturating_sub(EPOCH_US) / 10);
    }

    /// A time stamp that is known to have been used, 10 us; a clock that is ahead stays ahead.
    pub fn observe(&mut self, stamp: u64) {
        self.clock = self.clock.max(stamp.min(MAX_STAMP));
    }

    /// The clock, 10 us: what to store for the next run.
    #[must_use]
    pub const fn clock(&self) -> u64 {
        self.clock
    }

    /// The time stamp of the next frame to send.
    pub const fn stamp(&mut self) -> u64 {
        self.clock += 1;
        self.clock
    }

    /// Judges a frame by its bytes on the wire, checksum and signature included.
    ///
    /// # Errors
    /// Why it is not taken; nothing is remembered of it.
    pub fn check(&mut self, key: &SigningKey, from: Address, wire: &[u8]) -> Result<(), Rejection> {
        let is_signed = wire.first() == Some(&0xFD) && wire.get(2).is_some_and(|f| f & 1 == 1);
        let split = wire.len().checked_sub(SIGNATURE_LEN).filter(|_| is_signed);
        let Some((_, signature)) = split.map(|at| wire.split_at(at)) else {
            return Err(Rejection::Unsigned);
        };
        let (signed, tag) = wire.split_at(wire.len() - TAG_LEN);
        if !bool::from(key.tag(signed).ct_eq(tag)) {
            return Err(Rejection::WrongSignature);
        }
        let link_id = signature[0];
        let mut stamp = [0u8; 8];
        stamp[..6].copy_from_slice(&signature[1..7]);
        let stamp = u64::from_le_bytes(stamp);
        let is_it = |s: &&mut Stream| s.from == from && s.link_id == link_id;
        match self.streams.iter_mut().find(is_it) {
            Some(stream) if stamp <= stream.last => return Err(Rejection::Old),
            Some(stream) => stream.last = stamp,
            None if stamp.saturating_add(MAX_BEHIND) < self.clock => return Err(Rejection::Old),
            None => {
                if self.streams.is_full()
                    && let Some((oldest, _)) =
                        self.streams.iter().enumerate().min_by_key(|(_, s)| s.last)
                {
                    self.streams.remove(oldest);
                }
                self.streams.push(Stream {
                    from,
                    link_id,
                    last: stamp,
                });
            }
        }
        self.clock = self.clock.max(stamp);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Decoder, Encoder, Message, raw};

    const GCS: Address = Address {
        system: 255,
        component: 190,
    };

    fn signed(key: &SigningKey, link_id: u8, stamp: u64) -> Vec<u8> {
        let beat: Message = raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA {
            mavtype: 6,
            ..Default::default()
        })
        .into();
        Encoder::new(GCS)
            .encode_signed(&beat, key, link_id, stamp)
            .to_vec()
    }

    fn judge(
        state: &mut SigningState,
        key: &SigningKey,
        bytes: &[u8],
    ) -> Option<Result<(), Rejection>> {
        let mut verdict = None;
        Decoder::new().push_wire(bytes, |frame, _| {
            verdict = Some(state.check(key, frame.from, frame.wire));
        });
        verdict
    }

    #[test]
    fn pymavlink_signs_the_same_bytes() {
        // heartbeat_encode(6, 0, 0, 0, 0, 3), key 32 times 7, link id 3, pymavlink 2.4.50.
        let theirs = "fd09010000ffbe0000000000000006000000039b8903060504030201491d58a4dbd0";
        let ours = signed(&SigningKey::new([7; 32]), 3, 0x0102_0304_0506);
        let ours: String = ours.iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(ours, theirs);
    }

    #[test]
    fn what_is_unsigned_wrong_replayed_or_old_is_rejected() {
        let (key, other) = (
            SigningKey::from_passphrase("a"),
            SigningKey::from_passphrase("b"),
        );
        let mut state = SigningState::new(0);
        state.set_utc(EPOCH_US + 10 * 100_000_000);
        assert_eq!(state.clock(), 100_000_000);
        let first = signed(&key, 1, 100_000_000);
        assert_eq!(judge(&mut state, &key, &first), Some(Ok(())));
        assert_eq!(judge(&mut state, &key, &first), Some(Err(Rejection::Old)));
        let earlier = signed(&key, 1, 99_999_999);
        assert_eq!(judge(&mut state, &key, &earlier), Some(Err(Rejection::Old)));
        let foreign = signed(&other, 1, 200_000_000);
        assert_eq!(
            judge(&mut state, &key, &foreign),
            Some(Err(Rejection::WrongSignature))
        );
        assert_eq!(state.clock(), 100_000_000, "a wrong frame moves no clock");
        let stale = signed(&key, 2, 100_000_000 - MAX_BEHIND - 1);
        assert_eq!(judge(&mut state, &key, &stale), Some(Err(Rejection::Old)));
        let fresh_enough = signed(&key, 2, 100_000_000 - MAX_BEHIND);
        assert_eq!(judge(&mut state, &key, &fresh_enough), Some(Ok(())));
        let plain = Encoder::new(GCS).encode(&raw::HEARTBEAT_DATA::default());
        assert_eq!(
            judge(&mut state, &key, &plain),
            Some(Err(Rejection::Unsigned))
        );
        // After a restart with the stored clock, what was recorded before it is old.
        let later = signed(&key, 1, 100_000_050);
        assert_eq!(judge(&mut state, &key, &later), Some(Ok(())));
        let mut again = SigningState::new(state.clock() + MAX_BEHIND + 1);
        assert_eq!(judge(&mut again, &key, &later), Some(Err(Rejection::Old)));
    }

    #[test]
    fn every_changed_bit_is_noticed() {
        let key = SigningKey::from_passphrase("a");
        let good = signed(&key, 1, 5);
        for bit in 0..good.len() * 8 {
            let mut bytes = good.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let verdict = judge(&mut SigningState::new(0), &key, &bytes);
            assert_ne!(verdict, Some(Ok(())), "bit {bit}");
        }
    }

    #[test]
    fn a_key_is_written_and_read_and_never_printed() {
        let key = SigningKey::from_passphrase("secret");
        assert_eq!(
            SigningKey::from_hex(&format!("{}\n", key.to_hex())),
            Some(key.clone())
        );
        assert_eq!(format!("{key:?}"), "***");
        for bad in ["", "12", &"g".repeat(64), &"a".repeat(63)] {
            assert_eq!(SigningKey::from_hex(bad), None);
        }
    }

    #[test]
    fn many_streams_need_no_more_memory() {
        let key = SigningKey::from_passphrase("a");
        let mut state = SigningState::new(0);
        for link_id in 0..=255u8 {
            let bytes = signed(&key, link_id, 1_000 + u64::from(link_id));
            assert_eq!(judge(&mut state, &key, &bytes), Some(Ok(())));
        }
        assert_eq!(state.streams.len(), MAX_STREAMS);
    }
}
