//! MAVLink framing: a push decoder that resynchronises and counts, and an encoder.
//!
//! | Form | Bytes | Checksum |
//! | --- | --- | --- |
//! | v1 | `FE len seq sys comp id payload crc` | CRC-16/MCRF4XX over len..payload, then CRC_EXTRA of the id |
//! | v2 | `FD len incompat compat seq sys comp id:u24 payload crc [signature:13]` | the same |
//!
//! Source: MAVLink guide, "Packet Serialization" and "Message Signing".

use crate::message::{Known, Message};
use crate::signing::{SIGNATURE_LEN, SigningKey};
use crate::{Address, crc};
use arrayvec::ArrayVec;
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, MessageData};

const STX_V1: u8 = 0xFE;
const STX_V2: u8 = 0xFD;
const SIGNED: u8 = 0x01;
/// Bytes before the payload in version 2.
const HEADER_LEN: usize = 10;
/// Longest frame: v2, 255 bytes of payload, signed.
pub const MAX_FRAME_LEN: usize = 10 + 255 + 2 + SIGNATURE_LEN;

/// A frame on the wire.
pub type FrameBytes = ArrayVec<u8, MAX_FRAME_LEN>;

/// A frame whose checksum was right and whose payload was understood.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Who sent it.
    pub from: Address,
    /// Sequence number of the sender on this link.
    pub sequence: u8,
    /// True if it carried a signature (not checked here).
    pub is_signed: bool,
    /// What it says.
    pub message: Message,
}

/// What a decoder saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecodeCounters {
    /// Frames understood.
    pub frames: u64,
    /// Bytes outside any frame.
    pub noise_bytes: u64,
    /// Frames with a wrong checksum.
    pub bad_checksum: u64,
    /// Frames of an id neither dialect knows (their checksum cannot be judged).
    pub unknown_id: u64,
    /// Frames with flags we do not understand.
    pub unknown_flags: u64,
    /// Frames whose payload holds a value the dialect does not know.
    pub bad_payload: u64,
}

/// Push decoder for one byte stream. Feed it any chunks; after each, frames that were completed have been handed out.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    pending: ArrayVec<u8, { 2 * MAX_FRAME_LEN }>,
    counters: DecodeCounters,
}

/// A frame whose checksum was right, as it lies in the bytes that came; nothing of its payload has been looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameView<'a> {
    /// Who sent it.
    pub from: Address,
    /// Sequence number of the sender on this link.
    pub sequence: u8,
    /// True if it carried a signature (not checked here).
    pub is_signed: bool,
    /// Message id.
    pub id: u32,
    /// Payload, trailing zeros cut.
    pub payload: &'a [u8],
    /// The whole frame.
    pub wire: &'a [u8],
    version: MavlinkVersion,
    /// Looked up once for the checksum and the payload.
    known: Known,
}

impl FrameView<'_> {
    /// What it says.
    ///
    /// # Errors
    /// The payload holds an enumeration value the dialect does not know.
    #[inline]
    pub fn message(&self) -> Result<Message, ParserError> {
        Message::parse_known(self.known, self.version, self.id, self.payload)
    }

    /// The same with who said it, to be kept.
    #[must_use]
    pub fn frame(&self, message: Message) -> Frame {
        Frame {
            from: self.from,
            sequence: self.sequence,
            is_signed: self.is_signed,
            message,
        }
    }
}

enum Scan<'a> {
    /// More bytes are needed.
    Wait,
    /// This many leading bytes are of no use.
    Skip(usize),
    /// A frame.
    Frame(FrameView<'a>),
}

impl Decoder {
    /// A decoder without memory of earlier bytes.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// What was seen so far.
    #[must_use]
    pub const fn counters(&self) -> &DecodeCounters {
        &self.counters
    }

    /// Takes more bytes; calls `frame` for each frame they complete.
    pub fn push(&mut self, bytes: &[u8], mut frame: impl FnMut(Frame)) {
        let mut bad_payload = 0;
        self.push_views(bytes, |view| match view.message() {
            Ok(message) => frame(view.frame(message)),
            Err(_) => bad_payload += 1,
        });
        self.note_bad(bad_payload);
    }

    /// [`Decoder::push`] with each frame as it lies in the bytes (what [`crate::signing`] judges) beside what it says. Messages are
    /// larger than most frames: this way none is copied.
    pub fn push_wire(&mut self, bytes: &[u8], mut frame: impl FnMut(&FrameView<'_>, &Message)) {
        let mut bad_payload = 0;
        self.push_views(bytes, |view| open(&view, &mut bad_payload, &mut frame));
        self.note_bad(bad_payload);
    }

    fn note_bad(&mut self, bad_payload: u64) {
        self.counters.bad_payload += bad_payload;
        self.counters.frames -= bad_payload;
    }

    /// [`Decoder::push`] without looking at payloads: for whoever passes frames on, or wants few of them.
    pub fn push_views(&mut self, mut bytes: &[u8], mut frame: impl FnMut(FrameView<'_>)) {
        while !bytes.is_empty() {
            if self.pending.is_empty() {
                // Whole frames are read where they lie; only a last piece is kept.
                let used = take_frames(bytes, &mut self.counters, &mut frame);
                bytes = &bytes[used..];
            }
            let room = self.pending.remaining_capacity().min(bytes.len());
            let (now, later) = bytes.split_at(room);
            // Fits: `room` is at most the remaining capacity.
            let _ = self.pending.try_extend_from_slice(now);
            bytes = later;
            self.drain(&mut frame);
        }
    }

    /// Nothing more belongs to the bytes pushed so far: for datagrams, where a frame never continues in the next one.
    /// What looked like the start of a longer frame is given up, and frames inside it are found.
    pub fn end_of_datagram(&mut self, mut frame: impl FnMut(Frame)) {
        let mut bad_payload = 0;
        self.end_of_datagram_views(|view| match view.message() {
            Ok(message) => frame(view.frame(message)),
            Err(_) => bad_payload += 1,
        });
        self.note_bad(bad_payload);
    }

    /// [`Decoder::end_of_datagram`] in the manner of [`Decoder::push_wire`].
    pub fn end_of_datagram_wire(&mut self, mut frame: impl FnMut(&FrameView<'_>, &Message)) {
        let mut bad_payload = 0;
        self.end_of_datagram_views(|view| open(&view, &mut bad_payload, &mut frame));
        self.note_bad(bad_payload);
    }

    /// [`Decoder::end_of_datagram`] in the manner of [`Decoder::push_views`].
    pub fn end_of_datagram_views(&mut self, mut frame: impl FnMut(FrameView<'_>)) {
        while !self.pending.is_empty() {
            self.counters.noise_bytes += 1;
            self.pending.drain(..1);
            self.drain(&mut frame);
        }
    }

    fn drain(&mut self, frame: &mut impl FnMut(FrameView<'_>)) {
        let used = take_frames(&self.pending, &mut self.counters, frame);
        self.pending.drain(..used);
    }
}

/// Hands out the frames at the beginning of `bytes`; how many bytes are done with.
fn take_frames(
    bytes: &[u8],
    counters: &mut DecodeCounters,
    frame: &mut impl FnMut(FrameView<'_>),
) -> usize {
    let mut at = 0;
    loop {
        match scan(&bytes[at..], counters) {
            Scan::Wait => return at,
            Scan::Skip(n) => at += n,
            Scan::Frame(view) => {
                counters.frames += 1;
                at += view.wire.len();
                frame(view);
            }
        }
    }
}

/// Parses a frame and hands it out, or counts it.
#[inline]
fn open(
    view: &FrameView<'_>,
    bad_payload: &mut u64,
    frame: &mut impl FnMut(&FrameView<'_>, &Message),
) {
    match &view.message() {
        Ok(message) => frame(view, message),
        Err(_) => *bad_payload += 1,
    }
}

/// Inlined where it is used: a view that goes through memory costs as much as its checksum.
#[inline(always)]
fn scan<'a>(bytes: &'a [u8], counters: &mut DecodeCounters) -> Scan<'a> {
    let Some(&stx) = bytes.first() else {
        return Scan::Wait;
    };
    if stx != STX_V1 && stx != STX_V2 {
        let noise = bytes
            .iter()
            .position(|b| *b == STX_V1 || *b == STX_V2)
            .unwrap_or(bytes.len());
        counters.noise_bytes += noise as u64;
        return Scan::Skip(noise);
    }
    let (version, header_len) = if stx == STX_V1 {
        (MavlinkVersion::V1, 6)
    } else {
        (MavlinkVersion::V2, 10)
    };
    if bytes.len() < header_len {
        return Scan::Wait;
    }
    let payload_len = usize::from(bytes[1]);
    let (is_signed, flags_known) = match version {
        MavlinkVersion::V1 => (false, true),
        MavlinkVersion::V2 => (bytes[2] & SIGNED != 0, bytes[2] & !SIGNED == 0),
    };
    if !flags_known {
        counters.unknown_flags += 1;
        return Scan::Skip(1);
    }
    let body_len = header_len + payload_len;
    let frame_len = body_len + 2 + if is_signed { SIGNATURE_LEN } else { 0 };
    let (id, sequence, from) = match version {
        MavlinkVersion::V1 => (
            u32::from(bytes[5]),
            bytes[2],
            Address {
                system: bytes[3],
                component: bytes[4],
            },
        ),
        MavlinkVersion::V2 => (
            u32::from_le_bytes([bytes[7], bytes[8], bytes[9], 0]),
            bytes[4],
            Address {
                system: bytes[5],
                component: bytes[6],
            },
        ),
    };
    if bytes.len() < frame_len {
        return Scan::Wait;
    }
    let known = Known::of(id);
    let Some(extra) = known.crc_extra() else {
        // Without CRC_EXTRA nothing tells a foreign message from noise. Where the next frame (or nothing) follows, its
        // length is believed; else only the start byte is stepped over, so that a frame inside is still found.
        counters.unknown_id += 1;
        let is_followed_by_a_frame =
            matches!(bytes.get(frame_len), None | Some(&(STX_V1 | STX_V2)));
        return Scan::Skip(if is_followed_by_a_frame { frame_len } else { 1 });
    };
    let sum = crc::of_frame(&bytes[1..body_len], extra);
    if bytes[body_len..body_len + 2] != sum.to_le_bytes() {
        counters.bad_checksum += 1;
        return Scan::Skip(1);
    }
    Scan::Frame(FrameView {
        from,
        sequence,
        is_signed,
        id,
        payload: &bytes[header_len..body_len],
        wire: &bytes[..frame_len],
        version,
        known,
    })
}

/// Encoder of one component on one link: MAVLink 2, its own sequence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoder {
    from: Address,
    sequence: u8,
}

impl Encoder {
    /// An encoder that starts at sequence 0.
    #[must_use]
    pub const fn new(from: Address) -> Self {
        Self { from, sequence: 0 }
    }

    /// One message of a known type as a frame.
    pub fn encode<D: MessageData>(&mut self, message: &D) -> FrameBytes {
        self.frame(D::ID, D::EXTRA_CRC, 0, |payload| {
            message.ser(MavlinkVersion::V2, payload)
        })
    }

    /// One message as a frame.
    pub fn encode_message(&mut self, message: &Message) -> FrameBytes {
        let id = message.id();
        let extra = Message::crc_extra(id).unwrap_or(0);
        self.frame(id, extra, 0, |payload| message.write_payload(payload))
    }

    /// One message as a signed frame; `stamp` is from [`SigningState::stamp`](crate::signing::SigningState::stamp).
    pub fn encode_signed(
        &mut self,
        message: &Message,
        key: &SigningKey,
        link_id: u8,
        stamp: u64,
    ) -> FrameBytes {
        let id = message.id();
        let extra = Message::crc_extra(id).unwrap_or(0);
        let mut out = self.frame(id, extra, SIGNED, |payload| message.write_payload(payload));
        out.push(link_id);
        out.extend(stamp.to_le_bytes().into_iter().take(6));
        let tag = key.tag(&out);
        out.extend(tag);
        out
    }

    /// The payload is written where it goes out from.
    fn frame(
        &mut self,
        id: u32,
        crc_extra: u8,
        flags: u8,
        write: impl FnOnce(&mut [u8; 255]) -> usize,
    ) -> FrameBytes {
        let mut out = FrameBytes::from([0u8; MAX_FRAME_LEN]);
        let (header, rest) = out.split_at_mut(HEADER_LEN);
        let n = rest.first_chunk_mut::<255>().map_or(0, write);
        let [id0, id1, id2, _] = id.to_le_bytes();
        header.copy_from_slice(&[
            STX_V2,
            n as u8,
            flags,
            0,
            self.sequence,
            self.from.system,
            self.from.component,
            id0,
            id1,
            id2,
        ]);
        self.sequence = self.sequence.wrapping_add(1);
        let end = HEADER_LEN + n;
        let sum = crc::of_frame(&out[1..end], crc_extra);
        out[end..end + 2].copy_from_slice(&sum.to_le_bytes());
        out.truncate(end + 2);
        out
    }
}

/// A frame that came in on one link, to go out on another: the same sender, number and payload. A signature belongs to the link it came
/// by and is left behind; `sign` (key, link id, time stamp) makes the one of the new link. None if it cannot be: a frame of version 1
/// carries no signature.
#[must_use]
pub fn passed_on(wire: &[u8], sign: Option<(&SigningKey, u8, u64)>) -> Option<FrameBytes> {
    let is_v2 = wire.first() == Some(&STX_V2);
    let was_signed = is_v2 && wire.get(2)? & SIGNED != 0;
    let mut out = FrameBytes::new();
    if !was_signed && sign.is_none() {
        out.try_extend_from_slice(wire).ok()?;
        return Some(out);
    }
    if !is_v2 {
        return None;
    }
    let body = 10 + usize::from(*wire.get(1)?);
    out.try_extend_from_slice(wire.get(..body)?).ok()?;
    out[2] = if sign.is_some() { SIGNED } else { 0 };
    let id = u32::from_le_bytes([wire[7], wire[8], wire[9], 0]);
    let extra = Message::crc_extra(id)?;
    let sum = crc::of_frame(&out[1..], extra);
    out.extend(sum.to_le_bytes());
    if let Some((key, link_id, stamp)) = sign {
        out.push(link_id);
        out.extend(stamp.to_le_bytes().into_iter().take(6));
        let tag = key.tag(&out);
        out.extend(tag);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{raw, standard};
    use proptest::prelude::*;

    const US: Address = Address {
        system: 1,
        component: 1,
    };

    fn attitude(i: u32) -> standard::ATTITUDE_DATA {
        standard::ATTITUDE_DATA {
            time_boot_ms: i,
            roll: 0.25,
            yaw: -1.0,
            ..Default::default()
        }
    }

    fn decode(bytes: &[u8]) -> (Vec<Frame>, DecodeCounters) {
        let mut d = Decoder::new();
        let mut out = Vec::new();
        d.push(bytes, |f| out.push(f));
        (out, *d.counters())
    }

    #[test]
    fn one_byte_at_a_time_gives_the_same_frames() {
        let mut e = Encoder::new(US);
        let mut stream = vec![1, 2, 3];
        stream.extend(e.encode(&attitude(7)));
        let mut broken = e.encode(&attitude(8));
        broken[12] ^= 0x40;
        stream.extend(broken);
        stream.extend(e.encode(&raw::HEARTBEAT_DATA::default()));
        let (whole, counters) = decode(&stream);
        let mut d = Decoder::new();
        let mut single = Vec::new();
        for b in &stream {
            d.push(&[*b], |f| single.push(f));
        }
        assert_eq!(whole, single);
        assert_eq!(whole.iter().map(|f| f.sequence).collect::<Vec<_>>(), [0, 2]);
        assert_eq!(counters.bad_checksum, 1);
    }

    #[test]
    fn the_crate_and_our_encoder_write_the_same_bytes() {
        let header = mavlink::MavHeader {
            system_id: 1,
            component_id: 1,
            sequence: 0,
        };
        let mut theirs = Vec::new();
        let message = standard::MavMessage::ATTITUDE(attitude(99));
        mavlink::write_v2_msg(&mut theirs, header, &message).unwrap();
        assert_eq!(
            Encoder::new(US)
                .encode_message(&Message::Standard(message))
                .as_slice(),
            theirs.as_slice()
        );
    }

    #[test]
    fn a_frame_passed_on_keeps_all_but_its_signature() {
        let key = SigningKey::from_passphrase("hangar");
        let message = Message::Standard(standard::MavMessage::ATTITUDE(attitude(5)));
        let plain = Encoder::new(US).encode_message(&message);
        assert_eq!(passed_on(&plain, None).unwrap(), plain);
        let signed = Encoder::new(US).encode_signed(&message, &key, 3, 77);
        assert_eq!(passed_on(&signed, None).unwrap(), plain);
        assert_eq!(passed_on(&plain, Some((&key, 3, 77))).unwrap(), signed);
        let mut v1 = Vec::new();
        let header = mavlink::MavHeader::default();
        let beat = raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA::default());
        mavlink::write_v1_msg(&mut v1, header, &beat).unwrap();
        assert_eq!(passed_on(&v1, None).unwrap().as_slice(), v1.as_slice());
        assert_eq!(passed_on(&v1, Some((&key, 3, 77))), None);
        for n in 0..plain.len() {
            let _ = passed_on(&signed[..n], Some((&key, 1, 1)));
        }
    }

    #[test]
    fn version_1_frames_are_understood() {
        let header = mavlink::MavHeader {
            system_id: 255,
            component_id: 190,
            sequence: 4,
        };
        let mut bytes = Vec::new();
        let m = raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA {
            mavtype: 6,
            ..Default::default()
        });
        mavlink::write_v1_msg(&mut bytes, header, &m).unwrap();
        let (frames, _) = decode(&bytes);
        assert_eq!(
            frames[0].from,
            Address {
                system: 255,
                component: 190
            }
        );
    }

    #[test]
    fn a_frame_with_an_unknown_id_hides_no_later_frame() {
        let mut stream = vec![STX_V2, 4, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0xFE, 1, 2, 3, 4, 9, 9];
        stream.extend(Encoder::new(US).encode(&attitude(1)));
        let (frames, counters) = decode(&stream);
        assert_eq!((frames.len(), counters.unknown_id), (1, 1));
    }

    #[test]
    fn a_start_byte_in_noise_does_not_hide_the_rest_of_its_datagram() {
        let mut datagram = vec![STX_V2, 200, 0, 0, 0, 1, 1];
        datagram.extend(Encoder::new(US).encode(&attitude(1)));
        let mut d = Decoder::new();
        let mut got = 0;
        d.push(&datagram, |_| got += 1);
        d.end_of_datagram(|_| got += 1);
        assert_eq!(got, 1);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic_and_never_hide_what_follows(noise in proptest::collection::vec(any::<u8>(), 0..600)) {
            let mut stream = noise;
            // Longer than any frame the noise may pretend to begin.
            let mut e = Encoder::new(US);
            for i in 0..40 {
                stream.extend(e.encode(&attitude(i)));
            }
            let (frames, _) = decode(&stream);
            let last = frames.last().map(|f| f.message.clone());
            prop_assert_eq!(last, Some(Message::Standard(standard::MavMessage::ATTITUDE(attitude(39)))));
        }
    }
}
