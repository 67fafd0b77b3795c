//! H.264 in RTP (RFC 6184, packetization mode 1): pictures to packets and back.
//!
//! | Byte | Header (RFC 3550) |
//! | --- | --- |
//! | 0 | 0x80: version 2 |
//! | 1 | marker (last packet of a picture) and payload type |
//! | 2..4 | sequence number |
//! | 4..8 | time of the picture, 90 kHz |
//! | 8..12 | source |
//!
//! | Payload | Is |
//! | --- | --- |
//! | type 1..=23 | one NAL unit |
//! | type 24, STAP-A | several small ones, each after its size (taken, never sent) |
//! | type 28, FU-A | a piece of a large one: indicator, then S E 0 type |

use super::annex_b::{AccessUnit, Assembler, LARGEST_NAL};

/// Ticks of RTP's clock a second, for video.
pub const CLOCK_HZ: u32 = 90_000;
/// Payload type that ground stations expect.
pub const PAYLOAD_TYPE: u8 = 96;
/// Largest packet: below what any path carries, with IP, UDP and SRTP around it.
const PACKET: usize = 1200;
const HEADER: usize = 12;
const STAP_A: u8 = 24;
const FU_A: u8 = 28;

/// Pictures to packets of one stream.
#[derive(Clone, Debug)]
pub struct Packetizer {
    ssrc: u32,
    seq: u16,
}

impl Packetizer {
    /// A stream; `ssrc` tells it from others, the sequence begins at `seq`.
    #[must_use]
    pub const fn new(ssrc: u32, seq: u16) -> Self {
        Self { ssrc, seq }
    }

    /// The packets of a picture, in order. `time`: 90 kHz.
    pub fn packets(&mut self, unit: &AccessUnit, time: u32, out: &mut impl FnMut(&[u8])) {
        let mut nals = unit.nals().peekable();
        let mut packet = Vec::with_capacity(PACKET);
        while let Some(nal) = nals.next() {
            let is_last = nals.peek().is_none();
            if HEADER + nal.len() <= PACKET {
                self.begin(&mut packet, time, is_last);
                packet.extend_from_slice(nal);
                out(&packet);
                continue;
            }
            let (head, body) = (nal[0], &nal[1..]);
            let pieces = body.chunks(PACKET - HEADER - 2);
            let count = pieces.len();
            for (i, piece) in pieces.enumerate() {
                let is_end = i + 1 == count;
                self.begin(&mut packet, time, is_last && is_end);
                packet.push(head & 0xE0 | FU_A);
                packet.push(u8::from(i == 0) << 7 | u8::from(is_end) << 6 | head & 0x1F);
                packet.extend_from_slice(piece);
                out(&packet);
            }
        }
    }

    fn begin(&mut self, packet: &mut Vec<u8>, time: u32, marker: bool) {
        packet.clear();
        packet.extend([0x80, u8::from(marker) << 7 | PAYLOAD_TYPE]);
        packet.extend(self.seq.to_be_bytes());
        packet.extend(time.to_be_bytes());
        packet.extend(self.ssrc.to_be_bytes());
        self.seq = self.seq.wrapping_add(1);
    }
}

/// Packets to pictures of one stream.
#[derive(Clone, Debug, Default)]
pub struct Depacketizer {
    assembler: Assembler,
    last: Option<(u16, u32)>,
    fragment: Vec<u8>,
    /// Packets that are none, or of another kind.
    pub strange: u64,
}

impl Depacketizer {
    /// Takes a packet; hands over the picture it completes. After a gap in the sequence nothing comes before the next key picture.
    pub fn push(&mut self, packet: &[u8], out: &mut impl FnMut(AccessUnit)) {
        let Some((seq, time, marker, payload)) = parse(packet) else {
            self.strange += 1;
            return;
        };
        if let Some((last, last_time)) = self.last {
            let step = seq.wrapping_sub(last);
            // Late or twice: it is not waited for.
            if step == 0 || step > 0x8000 {
                self.strange += 1;
                return;
            }
            if step > 1 {
                self.fragment.clear();
                self.assembler.lost();
            } else if time != last_time {
                self.assembler.complete(out);
            }
        }
        self.last = Some((seq, time));
        match payload[0] & 0x1F {
            1..=23 => self.assembler.nal(payload, out),
            STAP_A => {
                let mut rest = &payload[1..];
                while let [a, b, more @ ..] = rest {
                    let n = usize::from(u16::from_be_bytes([*a, *b]));
                    if n > more.len() {
                        self.strange += 1;
                        break;
                    }
                    self.assembler.nal(&more[..n], out);
                    rest = &more[n..];
                }
            }
            FU_A if payload.len() > 2 => self.piece(payload, out),
            _ => self.strange += 1,
        }
        if marker {
            self.assembler.complete(out);
        }
    }

    /// A parameter set that is known from elsewhere.
    pub fn know(&mut self, set: &[u8], out: &mut impl FnMut(AccessUnit)) {
        self.assembler.nal(set, out);
    }

    fn piece(&mut self, payload: &[u8], out: &mut impl FnMut(AccessUnit)) {
        let (is_start, is_end) = (payload[1] & 0x80 != 0, payload[1] & 0x40 != 0);
        if is_start {
            self.fragment.clear();
            self.fragment.push(payload[0] & 0xE0 | payload[1] & 0x1F);
        }
        // The middle of something whose beginning was not seen.
        if self.fragment.is_empty() {
            return;
        }
        if self.fragment.len() + payload.len() > LARGEST_NAL {
            self.fragment.clear();
            self.assembler.lost();
            return;
        }
        self.fragment.extend_from_slice(&payload[2..]);
        if is_end {
            let nal = std::mem::take(&mut self.fragment);
            self.assembler.nal(&nal, out);
        }
    }
}

/// Sequence, time, marker, payload (never empty).
fn parse(packet: &[u8]) -> Option<(u16, u32, bool, &[u8])> {
    let [b0, b1, s0, s1, t0, t1, t2, t3, ..] = *packet else {
        return None;
    };
    let sources = usize::from(b0 & 0x0F);
    let mut begin = HEADER + 4 * sources;
    if b0 & 0x10 != 0 {
        let words = packet.get(begin + 2..begin + 4)?;
        begin += 4 + 4 * usize::from(u16::from_be_bytes([words[0], words[1]]));
    }
    let padding = if b0 & 0x20 == 0 {
        0
    } else {
        usize::from(*packet.last()?)
    };
    let end = packet.len().checked_sub(padding)?;
    let payload = packet.get(begin..end).filter(|p| !p.is_empty())?;
    let is_version_2 = b0 >> 6 == 2;
    is_version_2.then_some((
        u16::from_be_bytes([s0, s1]),
        u32::from_be_bytes([t0, t1, t2, t3]),
        b1 & 0x80 != 0,
        payload,
    ))
}

/// What a player needs to know to receive the stream at a port: save it as `video.sdp` and open it.
#[must_use]
pub fn sdp(host: &str, port: u16) -> String {
    let family = if host.contains(':') { "IP6" } else { "IP4" };
    format!(
        "v=0\r\no=- 0 0 IN {family} {host}\r\ns=Kestrel\r\nc=IN {family} {host}\r\nt=0 0\r\n\
         m=video {port} RTP/AVP {PAYLOAD_TYPE}\r\na=rtpmap:{PAYLOAD_TYPE} H264/{CLOCK_HZ}\r\n\
         a=fmtp:{PAYLOAD_TYPE} packetization-mode=1\r\na=recvonly\r\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unit(sizes: &[usize]) -> AccessUnit {
        let mut bytes = Vec::new();
        for (head, size) in [(0x67, 9), (0x68, 4)]
            .into_iter()
            .chain(sizes.iter().map(|s| (0x65, *s)))
        {
            bytes.extend([0, 0, 0, 1, head]);
            // The first slice begins the picture, the others go on.
            bytes.push(if bytes.len() < 31 { 0x88 } else { 0x18 });
            bytes.extend((0..size).map(|i| (i % 250) as u8 + 1));
        }
        AccessUnit {
            annex_b: bytes.into(),
            is_key: true,
        }
    }

    fn packets(unit: &AccessUnit) -> Vec<Vec<u8>> {
        let mut out = Vec::new();
        Packetizer::new(7, 65_534).packets(unit, 90_000, &mut |p| out.push(p.to_vec()));
        out
    }

    #[test]
    fn small_units_travel_whole_and_large_ones_in_pieces_and_only_the_last_packet_is_marked() {
        let all = packets(&unit(&[3000]));
        assert_eq!(all.len(), 5);
        assert!(all.iter().all(|p| p.len() <= PACKET));
        assert_eq!(all[2][12..14], [0x7C, 0x85], "first piece");
        assert_eq!(all[4][12..14], [0x7C, 0x45], "last piece");
        let marks: Vec<bool> = all.iter().map(|p| p[1] & 0x80 != 0).collect();
        assert_eq!(marks, [false, false, false, false, true]);
        // The sequence goes round at 65,535.
        assert_eq!(all[2][2..4], [0, 0]);
    }

    #[test]
    fn a_lost_packet_costs_the_picture_and_all_before_the_next_key() {
        let mut p = Packetizer::new(7, 0);
        let mut all = Vec::new();
        for time in 0..3 {
            p.packets(&unit(&[3000]), time, &mut |p| all.push(p.to_vec()));
        }
        all.remove(3);
        let (mut d, mut got) = (Depacketizer::default(), 0);
        for packet in &all {
            d.push(packet, &mut |_| got += 1);
        }
        assert_eq!(got, 2);
    }

    #[test]
    fn several_units_in_one_packet_are_taken() {
        let mut packet = vec![0x80, 0xE0, 0, 1, 0, 0, 0, 9, 0, 0, 0, 7, 0x78];
        for nal in [&[0x67, 1][..], &[0x68, 2], &[0x65, 0x88, 3]] {
            packet.extend((nal.len() as u16).to_be_bytes());
            packet.extend(nal);
        }
        let mut got = Vec::new();
        Depacketizer::default().push(&packet, &mut |u| got.push(u));
        assert_eq!(got.len(), 1);
        assert!(got[0].is_key);
        assert_eq!(got[0].nals().count(), 3);
    }

    #[test]
    fn the_session_names_port_and_payload() {
        assert!(sdp("127.0.0.1", 5600).contains("c=IN IP4 127.0.0.1\r\n"));
        assert!(sdp("::1", 5600).contains("m=video 5600 RTP/AVP 96\r\n"));
    }

    proptest! {
        #[test]
        fn what_was_packed_is_unpacked(sizes in prop::collection::vec(0usize..4000, 1..6)) {
            let sent = unit(&sizes);
            let (mut d, mut got) = (Depacketizer::default(), Vec::new());
            for packet in packets(&sent) {
                d.push(&packet, &mut |u| got.push(u));
            }
            prop_assert_eq!(got, vec![sent]);
        }

        #[test]
        fn any_packet_is_survived(all in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..20)) {
            let mut d = Depacketizer::default();
            for packet in all {
                d.push(&packet, &mut |_| {});
            }
        }
    }
}
