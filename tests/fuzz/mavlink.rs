//! MAVLink frames and what they carry.

use crate::fuzz;
use mavlink_dialect::signing::{SigningKey, SigningState};
use mavlink_dialect::{Address, Decoder, Encoder, Message, crc};

/// Puts the right checksum under whatever looks like a frame of version 2: what was edited is to be understood.
pub(crate) fn healed(bytes: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let mut at = 0;
    while at + 12 <= out.len() {
        let body = at + 10 + usize::from(out[at + 1]);
        if out[at] != 0xFD || body + 2 > out.len() {
            at += 1;
            continue;
        }
        out[at + 2] &= 1;
        let id = u32::from_le_bytes([out[at + 7], out[at + 8], out[at + 9], 0]);
        if let Some(extra) = Message::crc_extra(id) {
            let sum = crc::of_frame(&out[at + 1..body], extra);
            out[body..body + 2].copy_from_slice(&sum.to_le_bytes());
        }
        at = body + 2;
    }
    out
}

fuzz!(
    /// Whatever the bytes and their pieces, the same frames are found; each is written again as it came, if it can be.
    mavlink_frames,
    |bytes: &[u8]| {
        for bytes in [bytes.to_vec(), healed(bytes)] {
            let mut whole = Vec::new();
            let mut decoder = Decoder::new();
            decoder.push(&bytes, |f| whole.push(f));
            decoder.end_of_datagram(|f| whole.push(f));
            assert_eq!(decoder.counters().frames, whole.len() as u64);
            let piece = 1 + bytes.first().map_or(0, |b| usize::from(b % 37));
            let mut pieces = 0;
            let mut decoder = Decoder::new();
            for chunk in bytes.chunks(piece) {
                decoder.push_wire(chunk, |view, message| {
                    assert_eq!(view.id, message.id());
                    pieces += 1;
                });
            }
            decoder.end_of_datagram_wire(|_, _| pieces += 1);
            // A foreign frame is stepped over by what follows it, which a piece may not show yet.
            if decoder.counters().unknown_id == 0 {
                assert_eq!(pieces, whole.len());
            }
            let us = Address {
                system: 1,
                component: 1,
            };
            for frame in &whole {
                let again = Encoder::new(us).encode_message(&frame.message);
                let mut back = Vec::new();
                Decoder::new().push(&again, |f| back.push(f.message));
                // NaN is not itself.
                assert_eq!(format!("{back:?}"), format!("{:?}", [&frame.message]));
                let _ = frame.message.target();
            }
        }
    }
);

fuzz!(
    /// No signature is right by chance, and nothing is taken twice.
    mavlink_signatures,
    |bytes: &[u8]| {
        let key = SigningKey::from_passphrase("fuzz");
        let mut state = SigningState::new(0);
        let from = Address {
            system: 7,
            component: 1,
        };
        if state.check(&key, from, bytes).is_ok() {
            assert!(state.check(&key, from, bytes).is_err());
        }
        let _ = mavlink_dialect::codec::passed_on(bytes, Some((&key, 1, 1)));
        let _ = mavlink_dialect::codec::passed_on(bytes, None);
    }
);
