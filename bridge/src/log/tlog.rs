//! The `.tlog`: MAVLink frames as ordinary stations keep them.
//!
//! | Bytes | Holds |
//! | --- | --- |
//! | 8 | UTC, us since 1970, big endian |
//! | n | the frame as on the wire |
//!
//! Sent frames are written once, though each link gets its own copy. Signatures are cut off and SETUP_SIGNING is left out: a log
//! that is handed on must carry no key and nothing to play back.

use crate::gcs::{LinkId, MAX_LINKS};
use arrayvec::ArrayVec;
use mavlink_dialect::{Decoder, FrameBytes, crc};

/// Start byte of a v2 frame.
const STX_V2: u8 = 0xFD;
/// Flag of a signed frame.
const SIGNED: u8 = 0x01;
/// Bytes of a signature.
const SIGNATURE_LEN: usize = 13;
/// Bytes before the payload of a v2 frame.
const HEAD_LEN: usize = 10;
/// SETUP_SIGNING.
const SETUP_SIGNING: u32 = 256;

/// Makes the bytes of a `.tlog`.
#[derive(Debug, Default)]
pub struct TlogEncoder {
    /// Of the links that are heard, the one heard last at the end. A link that is gone is forgotten when others need its place.
    decoders: ArrayVec<(LinkId, Decoder), MAX_LINKS>,
    /// The frame sent last, and on which link: the same on another link is a copy.
    last: Option<(LinkId, FrameBytes)>,
    frames: u64,
}

impl TlogEncoder {
    /// Frames written so far.
    #[must_use]
    pub const fn frames(&self) -> u64 {
        self.frames
    }

    /// A frame went out.
    pub fn sent(&mut self, utc_us: u64, link: LinkId, frame: &FrameBytes, out: &mut Vec<u8>) {
        let is_copy = self
            .last
            .as_ref()
            .is_some_and(|(on, last)| *on != link && says_the_same(last, frame));
        if !is_copy {
            self.last = Some((link, frame.clone()));
            self.write(utc_us, frame, out);
        }
    }

    /// Bytes came in on a link.
    pub fn received(
        &mut self,
        utc_us: u64,
        link: LinkId,
        bytes: &[u8],
        is_datagram: bool,
        out: &mut Vec<u8>,
    ) {
        let known = self.decoders.iter().position(|(id, _)| *id == link);
        let mut decoder = match known {
            Some(at) => self.decoders.remove(at).1,
            None => Decoder::default(),
        };
        decoder.push_views(bytes, |frame| self.write(utc_us, frame.wire, out));
        if is_datagram {
            decoder.end_of_datagram_views(|frame| self.write(utc_us, frame.wire, out));
        }
        if self.decoders.is_full() {
            self.decoders.remove(0);
        }
        self.decoders.push((link, decoder));
    }

    fn write(&mut self, utc_us: u64, frame: &[u8], out: &mut Vec<u8>) {
        if id(frame) == Some(SETUP_SIGNING) {
            return;
        }
        self.frames += 1;
        out.extend_from_slice(&utc_us.to_be_bytes());
        match unsigned(frame) {
            Some(plain) => out.extend_from_slice(&plain),
            None => out.extend_from_slice(frame),
        }
    }
}

/// The frames of a `.tlog` with their times, up to where it is torn.
pub fn frames(bytes: &[u8]) -> impl Iterator<Item = (u64, &[u8])> {
    let mut rest = bytes;
    core::iter::from_fn(move || {
        let (time, after) = rest.split_first_chunk::<8>()?;
        let len = match (after.first()?, usize::from(*after.get(1)?)) {
            (&STX_V2, n) if after.get(2)? & SIGNED != 0 => HEAD_LEN + n + 2 + SIGNATURE_LEN,
            (&STX_V2, n) => HEAD_LEN + n + 2,
            (0xFE, n) => 6 + n + 2,
            _ => return None,
        };
        let frame = after.get(..len)?;
        rest = &after[len..];
        Some((u64::from_be_bytes(*time), frame))
    })
}

/// Message id of a v2 frame.
fn id(frame: &[u8]) -> Option<u32> {
    match frame {
        [STX_V2, _, _, _, _, _, _, a, b, c, ..] => Some(u32::from_le_bytes([*a, *b, *c, 0])),
        _ => None,
    }
}

/// Two frames that differ in nothing but sequence, checksum and signature.
fn says_the_same(a: &[u8], b: &[u8]) -> bool {
    let said = |frame: &[u8]| -> Option<(usize, usize)> {
        (frame.first() == Some(&STX_V2)).then_some((5, HEAD_LEN + usize::from(*frame.get(1)?)))
    };
    match (said(a), said(b)) {
        (Some((from, to)), Some(other)) if other == (from, to) => {
            a.get(from..to) == b.get(from..to)
        }
        _ => false,
    }
}

/// A signed frame without its signature; none if it has none.
fn unsigned(frame: &[u8]) -> Option<Vec<u8>> {
    if frame.first() != Some(&STX_V2) || frame.get(2)? & SIGNED == 0 {
        return None;
    }
    let extra = mavlink_dialect::Message::crc_extra(id(frame)?)?;
    let end = HEAD_LEN + usize::from(*frame.get(1)?);
    let mut plain = frame.get(..end)?.to_vec();
    plain[2] &= !SIGNED;
    let sum = crc::update(crc::update(crc::INIT, &plain[1..]), &[extra]);
    plain.extend_from_slice(&sum.to_le_bytes());
    Some(plain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_dialect::signing::SigningKey;
    use mavlink_dialect::standard::{HEARTBEAT_DATA, MavMessage, SETUP_SIGNING_DATA};
    use mavlink_dialect::{Address, Encoder, Message};

    fn encoder() -> Encoder {
        Encoder::new(Address {
            system: 1,
            component: 1,
        })
    }

    fn heartbeat(encoder: &mut Encoder) -> FrameBytes {
        encoder.encode(&HEARTBEAT_DATA::default())
    }

    #[test]
    fn a_copy_on_another_link_is_written_once_and_the_next_message_again() {
        let (mut a, mut b) = (encoder(), encoder());
        let mut log = TlogEncoder::default();
        let mut out = Vec::new();
        heartbeat(&mut b);
        for at in [1, 2] {
            log.sent(at, LinkId(0), &heartbeat(&mut a), &mut out);
            log.sent(at, LinkId(1), &heartbeat(&mut b), &mut out);
        }
        assert_eq!(frames(&out).map(|(t, _)| t).collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn however_many_links_come_and_go_no_more_are_kept_than_can_be() {
        let (mut tlog, mut out) = (TlogEncoder::default(), Vec::new());
        for n in 0..1_000 {
            tlog.received(n.into(), LinkId(n), &[STX_V2], false, &mut out);
        }
        assert_eq!(tlog.decoders.len(), MAX_LINKS);
        // Who is still heard is still there.
        assert!(tlog.decoders.iter().any(|(id, _)| *id == LinkId(999)));
    }

    #[test]
    fn frames_come_back_as_they_came_and_a_torn_end_ends_them() {
        let mut log = TlogEncoder::default();
        let mut out = Vec::new();
        let frame = heartbeat(&mut encoder());
        // In two pieces, with noise before.
        log.received(5, LinkId(3), &[1, 2, 3], false, &mut out);
        log.received(6, LinkId(3), &frame[..4], false, &mut out);
        log.received(7, LinkId(3), &frame[4..], false, &mut out);
        log.received(8, LinkId(3), &frame, true, &mut out);
        assert_eq!(log.frames(), 2);
        let back: Vec<_> = frames(&out).collect();
        assert_eq!(back, [(7, &frame[..]), (8, &frame[..])]);
        assert_eq!(frames(&out[..out.len() - 1]).count(), 1);
        assert_eq!(frames(b"no log at all").count(), 0);
    }

    #[test]
    fn a_log_carries_neither_keys_nor_signatures() {
        let key = SigningKey::new([7; 32]);
        let mut encoder = encoder();
        let beat = Message::Standard(MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
        let signed = encoder.encode_signed(&beat, &key, 1, 123_456);
        let setup = encoder.encode(&SETUP_SIGNING_DATA {
            secret_key: [0xA5; 32],
            ..Default::default()
        });
        let mut log = TlogEncoder::default();
        let mut out = Vec::new();
        log.sent(1, LinkId(0), &signed, &mut out);
        log.sent(2, LinkId(0), &setup, &mut out);
        log.received(3, LinkId(0), &setup, true, &mut out);
        let back: Vec<_> = frames(&out).collect();
        assert_eq!(back.len(), 1);
        assert!(!out.windows(8).any(|w| w == [0xA5; 8]));
        let mut decoder = Decoder::new();
        let mut heard = Vec::new();
        decoder.push(back[0].1, |f| heard.push((f.is_signed, f.message.id())));
        assert_eq!(heard, [(false, beat.id())]);
    }
}
