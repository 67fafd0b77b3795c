//! Binary frames out of a byte stream with noise, cut frames and lost ones.
//!
//! A frame is believed when it begins with a start byte, ends with the end byte 29 bytes later and its temperature and pressure are
//! possible. When it is not, the search goes on at the next start byte *inside* what was already read, so that a cut frame never
//! takes the intact one behind it along. (uQuad's reader dropped the whole 30 bytes.)

use super::frame::{END, FRAME_LEN, RawFrame, is_start};
use arrayvec::ArrayVec;

/// Wrong start bytes that are no error while the board is still talking about its menu (uQuad: 60).
const SILENT_AT_START_UP: u32 = 60;

/// What a decoder has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderStats {
    /// Frames believed.
    pub frames: u32,
    /// Bytes that belonged to no frame, the silent ones at start-up not counted.
    pub noise_bytes: u32,
    /// Candidates that did not end with the end byte.
    pub wrong_ends: u32,
    /// Candidates with an impossible temperature or pressure.
    pub implausible: u32,
    /// Start bytes that did not alternate: at least one frame was lost.
    pub skipped: u32,
}

/// A frame and whether the alternation says that one before it is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// The frame.
    pub frame: RawFrame,
    /// The start byte was the same as that of the frame before.
    pub is_after_skipped: bool,
}

/// Push decoder of binary frames.
#[derive(Clone, Debug, Default)]
pub struct BinaryDecoder {
    buffer: ArrayVec<u8, FRAME_LEN>,
    expects_alternation: bool,
    last_start: Option<u8>,
    silent: u32,
    stats: DecoderStats,
}

impl BinaryDecoder {
    /// A decoder; with `expects_alternation` equal start bytes of neighbouring frames are reported as skipped frames (uQuad: off).
    #[must_use]
    pub fn new(expects_alternation: bool) -> Self {
        Self {
            expects_alternation,
            ..Self::default()
        }
    }

    /// What was seen so far.
    #[must_use]
    pub const fn stats(&self) -> &DecoderStats {
        &self.stats
    }

    /// Takes one byte; answers a frame when this byte completes one.
    pub fn push(&mut self, byte: u8) -> Option<Received> {
        self.buffer.push(byte);
        if self.buffer.len() < FRAME_LEN {
            if !is_start(self.buffer[0]) {
                self.resynchronise();
            }
            return None;
        }
        let bytes: [u8; FRAME_LEN] = self.buffer.as_slice().try_into().ok()?;
        let frame = RawFrame::parse(&bytes);
        if bytes[FRAME_LEN - 1] != END {
            self.stats.wrong_ends += 1;
            self.resynchronise();
            return None;
        }
        if !frame.is_plausible() {
            self.stats.implausible += 1;
            self.resynchronise();
            return None;
        }
        self.buffer.clear();
        self.stats.frames += 1;
        let is_after_skipped = self.expects_alternation && self.last_start == Some(bytes[0]);
        self.last_start = Some(bytes[0]);
        self.stats.skipped += u32::from(is_after_skipped);
        Some(Received {
            frame,
            is_after_skipped,
        })
    }

    /// Drops the first byte and everything up to the next start byte.
    fn resynchronise(&mut self) {
        let dropped = self
            .buffer
            .iter()
            .skip(1)
            .position(|&b| is_start(b))
            .map_or(self.buffer.len(), |at| at + 1);
        self.buffer.drain(..dropped);
        for _ in 0..dropped {
            if self.stats.frames == 0 && self.silent < SILENT_AT_START_UP {
                self.silent += 1;
            } else {
                self.stats.noise_bytes += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imu::frame::{ALTERNATE_START, START};
    use proptest::prelude::*;

    fn frame(k: u16) -> RawFrame {
        RawFrame {
            since_previous_us: 10_000,
            accel: [k as i16, -9, 207],
            gyro: [-15, -21, -17],
            mag: [-98, 130, 8],
            temperature_ddeg: 249,
            pressure_pa: 101_205,
        }
    }

    fn decode(decoder: &mut BinaryDecoder, bytes: &[u8]) -> Vec<RawFrame> {
        bytes
            .iter()
            .filter_map(|&b| decoder.push(b))
            .map(|r| r.frame)
            .collect()
    }

    #[test]
    fn only_intact_frames_come_out_of_noise_and_cut_frames() {
        let mut stream = Vec::new();
        let mut intact = Vec::new();
        for k in 0..100 {
            let bytes = frame(k).emit(START);
            match k % 5 {
                1 => stream.extend_from_slice(&bytes[..7 + usize::from(k) % 20]),
                2 => {
                    stream.extend_from_slice(b"A noise without end C\x00Z");
                    stream.extend_from_slice(&bytes);
                    intact.push(frame(k));
                }
                3 => {
                    stream.extend_from_slice(&bytes[..29]);
                    stream.push(b'Y');
                }
                _ => {
                    stream.extend_from_slice(&bytes);
                    intact.push(frame(k));
                }
            }
        }
        let mut decoder = BinaryDecoder::default();
        assert_eq!(decode(&mut decoder, &stream), intact);
        assert_eq!(decoder.stats().frames as usize, intact.len());
        assert!(decoder.stats().wrong_ends >= 20 && decoder.stats().noise_bytes > 0);
    }

    #[test]
    fn a_c_a_a_is_one_skipped_frame_when_alternation_is_on() {
        let starts = [START, ALTERNATE_START, START, START];
        let stream: Vec<u8> = starts.iter().flat_map(|&s| frame(1).emit(s)).collect();
        for (expects, skipped) in [(true, 1), (false, 0)] {
            let mut decoder = BinaryDecoder::new(expects);
            let flags: Vec<bool> = stream
                .iter()
                .filter_map(|&b| decoder.push(b))
                .map(|r| r.is_after_skipped)
                .collect();
            assert_eq!(flags, [false, false, false, expects]);
            assert_eq!(decoder.stats().skipped, skipped);
        }
    }

    #[test]
    fn sixty_wrong_bytes_at_start_up_are_silent_and_the_next_is_an_error() {
        let mut decoder = BinaryDecoder::default();
        decode(&mut decoder, &[b'#'; 60]);
        assert_eq!(decoder.stats().noise_bytes, 0);
        decode(&mut decoder, b"##");
        assert_eq!(decoder.stats().noise_bytes, 2);
    }

    #[test]
    fn a_pressure_no_barometer_sends_is_no_frame() {
        let mut wrong = frame(1);
        wrong.pressure_pa = 12;
        let mut decoder = BinaryDecoder::default();
        assert!(decode(&mut decoder, &wrong.emit(START)).is_empty());
        assert_eq!(decoder.stats().implausible, 1);
        assert_eq!(decode(&mut decoder, &frame(2).emit(START)), [frame(2)]);
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived_and_a_frame_behind_them_is_found(
            noise in proptest::collection::vec(any::<u8>(), 0..200),
            cut in 1usize..30,
        ) {
            let mut decoder = BinaryDecoder::new(true);
            decode(&mut decoder, &noise);
            // A cut frame may pair with the noise before it, two intact ones cannot both be lost.
            decode(&mut decoder, &frame(3).emit(START)[..cut]);
            let mut stream = frame(4).emit(ALTERNATE_START).to_vec();
            stream.extend(frame(5).emit(START));
            prop_assert!(decode(&mut decoder, &stream).contains(&frame(5)));
        }
    }
}
