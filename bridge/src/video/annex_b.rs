//! H.264 as a byte stream (ITU-T H.264 annex B): bytes to NAL units, NAL units to access units, one of which is a picture.
//!
//! ```text
//! 00 00 01 | 67 sps | 00 00 01 | 68 pps | 00 00 00 01 | 65 slice of an IDR picture | 00 00 01 | 41 slice ...
//! ```
//!
//! | Type (low 5 bits of the first byte) | Is |
//! | --- | --- |
//! | 1 | slice of a picture that needs earlier ones |
//! | 5 | slice of an IDR picture: decoding can begin here |
//! | 6, 7, 8, 9 | SEI, SPS, PPS, access unit delimiter: what follows a slice begins the next picture |

use std::sync::Arc;

/// A NAL unit larger than this is no camera's: it is thrown away.
pub const LARGEST_NAL: usize = 2 << 20;
/// NAL units of one picture at most.
const MOST_NALS: usize = 256;
/// Before every NAL unit that we write.
const START: [u8; 4] = [0, 0, 0, 1];

const IDR: u8 = 5;
const SPS: u8 = 7;
const PPS: u8 = 8;

/// Type of a NAL unit.
#[must_use]
pub fn kind(nal: &[u8]) -> u8 {
    nal.first().map_or(0, |b| b & 0x1F)
}

/// One coded picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessUnit {
    /// Its NAL units as they came, each after a start code of four bytes.
    pub annex_b: Arc<[u8]>,
    /// Decoding can begin with it: an IDR picture, parameter sets before it.
    pub is_key: bool,
}

impl AccessUnit {
    /// Its NAL units.
    pub fn nals(&self) -> impl Iterator<Item = &[u8]> {
        nals(&self.annex_b)
    }
}

/// The NAL units of a complete byte stream.
pub fn nals(stream: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = after_start(stream);
    core::iter::from_fn(move || {
        let here = rest?;
        let (nal, next) = match start_code(here) {
            Some((at, end)) => (&here[..at], Some(&here[end..])),
            None => (here, None),
        };
        rest = next;
        Some(trimmed(nal))
    })
    .filter(|nal| !nal.is_empty())
}

fn after_start(stream: &[u8]) -> Option<&[u8]> {
    start_code(stream).map(|(_, end)| &stream[end..])
}

/// The first `00 00 01`: where it begins and ends.
fn start_code(bytes: &[u8]) -> Option<(usize, usize)> {
    let at = bytes.windows(3).position(|w| w == [0, 0, 1])?;
    Some((at, at + 3))
}

/// Zeros before the next start code are not the unit's.
fn trimmed(nal: &[u8]) -> &[u8] {
    let end = nal.iter().rposition(|b| *b != 0).map_or(0, |i| i + 1);
    &nal[..end]
}

/// Bytes in pieces of any size to pictures.
///
/// A picture is complete when the next one begins: a live source is one picture late for that. Rubbish before the first start
/// code, units too large and pictures before the first key picture are dropped and counted.
#[derive(Clone, Debug, Default)]
pub struct Assembler {
    buffer: Vec<u8>,
    /// How far `buffer` was searched.
    searched: usize,
    is_in_nal: bool,
    unit: Vec<u8>,
    nals: usize,
    has_slice: bool,
    is_idr: bool,
    has_sets: bool,
    sps: Vec<u8>,
    pps: Vec<u8>,
    has_begun: bool,
    /// Things dropped.
    pub dropped: u64,
}

impl Assembler {
    /// Takes bytes; hands over the pictures they complete.
    pub fn push(&mut self, bytes: &[u8], out: &mut impl FnMut(AccessUnit)) {
        self.buffer.extend_from_slice(bytes);
        loop {
            let from = self.searched.saturating_sub(2);
            let Some((at, end)) = start_code(&self.buffer[from..]) else {
                self.searched = self.buffer.len();
                break;
            };
            let (at, end) = (from + at, from + end);
            let rest = self.buffer.split_off(end);
            let mut nal = std::mem::replace(&mut self.buffer, rest);
            self.searched = 0;
            nal.truncate(at);
            if std::mem::replace(&mut self.is_in_nal, true) {
                self.nal(trimmed(&nal), out);
            }
        }
        if self.buffer.len() > LARGEST_NAL {
            self.buffer.clear();
            self.searched = 0;
            self.is_in_nal = false;
            self.dropped += 1;
        }
    }

    /// The stream is over: what is there is complete.
    pub fn finish(&mut self, out: &mut impl FnMut(AccessUnit)) {
        let nal = std::mem::take(&mut self.buffer);
        self.searched = 0;
        if std::mem::take(&mut self.is_in_nal) {
            self.nal(trimmed(&nal), out);
        }
        self.complete(out);
    }

    /// Takes one NAL unit, as RTP delivers them.
    pub fn nal(&mut self, nal: &[u8], out: &mut impl FnMut(AccessUnit)) {
        let Some(first) = nal.first() else { return };
        // The forbidden bit, or a type that does not exist in a stream of bytes.
        if first & 0x80 != 0 || !(1..24).contains(&kind(nal)) || nal.len() > LARGEST_NAL {
            self.dropped += 1;
            return;
        }
        let is_slice = matches!(kind(nal), 1..=5);
        // first_mb_in_slice is zero exactly if the next bit is one (Exp-Golomb).
        let is_first = nal.get(1).is_some_and(|b| b & 0x80 != 0);
        if self.has_slice && (!is_slice || is_first) && !matches!(kind(nal), 10..=13) {
            self.complete(out);
        }
        match kind(nal) {
            SPS => self.sps = nal.to_vec(),
            PPS => self.pps = nal.to_vec(),
            _ => {}
        }
        self.has_slice |= is_slice;
        if kind(nal) == IDR && !self.is_idr {
            self.is_idr = true;
            // Who joins here needs the parameter sets, also of a camera that sends them only once.
            if !self.has_sets && !self.sps.is_empty() && !self.pps.is_empty() {
                let (sps, pps) = (self.sps.clone(), self.pps.clone());
                self.append(&sps);
                self.append(&pps);
                self.has_sets = true;
            }
        }
        self.has_sets |= kind(nal) == SPS;
        self.append(nal);
    }

    /// The picture under way is complete, as the marker of RTP says.
    pub fn complete(&mut self, out: &mut impl FnMut(AccessUnit)) {
        let bytes = std::mem::take(&mut self.unit);
        let (has_slice, is_idr) = (self.has_slice, self.is_idr);
        let (nals, has_sets) = (self.nals, self.has_sets);
        (self.has_slice, self.is_idr, self.has_sets, self.nals) = (false, false, false, 0);
        if !has_slice {
            // Parameter sets alone wait for their picture.
            if !bytes.is_empty() {
                self.unit = bytes;
                (self.has_sets, self.nals) = (has_sets, nals);
            }
            return;
        }
        let is_key = is_idr && has_sets;
        self.has_begun |= is_key;
        if !self.has_begun || nals > MOST_NALS {
            self.dropped += 1;
            return;
        }
        out(AccessUnit {
            annex_b: bytes.into(),
            is_key,
        });
    }

    /// Something was lost: nothing can be shown before the next key picture.
    pub fn lost(&mut self) {
        self.unit.clear();
        (self.has_slice, self.is_idr, self.has_sets, self.nals) = (false, false, false, 0);
        self.has_begun = false;
        self.dropped += 1;
    }

    fn append(&mut self, nal: &[u8]) {
        self.nals += 1;
        if self.nals <= MOST_NALS && self.unit.len() + nal.len() <= LARGEST_NAL {
            self.unit.extend_from_slice(&START);
            self.unit.extend_from_slice(nal);
        } else {
            // Never complete any more: dropped as a whole.
            self.nals = MOST_NALS + 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stream(nals: &[&[u8]]) -> Vec<u8> {
        nals.iter().flat_map(|n| [&START[..], n].concat()).collect()
    }

    fn assemble(pieces: &[&[u8]]) -> Vec<AccessUnit> {
        let (mut a, mut out) = (Assembler::default(), Vec::new());
        for piece in pieces {
            a.push(piece, &mut |u| out.push(u));
        }
        a.finish(&mut |u| out.push(u));
        out
    }

    const SPS_: &[u8] = &[0x67, 1, 2];
    const PPS_: &[u8] = &[0x68, 3];
    const IDR_: &[u8] = &[0x65, 0x88, 9, 9];
    const P: &[u8] = &[0x41, 0x9A, 7];
    const P_SECOND_SLICE: &[u8] = &[0x41, 0x1A, 8];

    #[test]
    fn a_picture_is_its_slices_and_the_sets_before_it() {
        let all = stream(&[SPS_, PPS_, IDR_, P, P_SECOND_SLICE, P]);
        let units = assemble(&[&all]);
        assert_eq!(units.len(), 3);
        assert_eq!(units[0].annex_b[..], stream(&[SPS_, PPS_, IDR_]));
        assert!(units[0].is_key);
        assert_eq!(units[1].annex_b[..], stream(&[P, P_SECOND_SLICE]));
        assert!(!units[1].is_key && !units[2].is_key);
    }

    #[test]
    fn sets_sent_once_are_put_before_every_idr_picture() {
        let units = assemble(&[&stream(&[SPS_, PPS_, IDR_, P, IDR_])]);
        assert_eq!(units[2].annex_b[..], stream(&[SPS_, PPS_, IDR_]));
        assert!(units[2].is_key);
    }

    #[test]
    fn nothing_is_shown_before_the_first_key_picture_or_after_a_loss() {
        let units = assemble(&[b"rubbish", &stream(&[P, IDR_, SPS_, PPS_, IDR_, P])]);
        assert_eq!(units.len(), 2);
        let (mut a, mut out) = (Assembler::default(), 0);
        for (nal, shown) in [(SPS_, 0), (PPS_, 0), (IDR_, 0), (P, 1)] {
            a.nal(nal, &mut |_| out += 1);
            assert_eq!(out, shown);
        }
        a.lost();
        for nal in [P, P] {
            a.nal(nal, &mut |_| out += 1);
        }
        assert_eq!(out, 1);
    }

    #[test]
    fn a_stream_without_start_codes_takes_no_memory() {
        let mut a = Assembler::default();
        for _ in 0..40 {
            a.push(&vec![7; LARGEST_NAL / 8], &mut |_| panic!("a picture"));
            assert!(a.buffer.len() <= LARGEST_NAL + LARGEST_NAL / 8);
        }
        assert!(a.dropped > 0);
    }

    proptest! {
        #[test]
        fn pieces_make_no_difference(cuts in prop::collection::vec(1usize..9, 1..40)) {
            let all = stream(&[SPS_, PPS_, IDR_, P, P_SECOND_SLICE, P, IDR_, P]);
            let mut pieces = Vec::new();
            let mut rest = &all[..];
            for cut in cuts.iter().cycle() {
                let (piece, next) = rest.split_at((*cut).min(rest.len()));
                pieces.push(piece);
                rest = next;
                if rest.is_empty() {
                    break;
                }
            }
            prop_assert_eq!(assemble(&pieces), assemble(&[&all]));
        }

        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(prop_oneof![Just(0u8), Just(1u8), any::<u8>()], 0..600)) {
            for unit in assemble(&[&bytes]) {
                prop_assert!(unit.nals().count() > 0);
            }
            let _ = nals(&bytes).count();
        }
    }
}
