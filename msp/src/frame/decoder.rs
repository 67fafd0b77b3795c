//! Finding frames in a stream of bytes.

use super::{Direction, Frame, Framing, INNER_OVERHEAD, MAX_PAYLOAD, crc8_dvb_s2, xor};
use std::ops::Range;

/// Bytes around the payload of the longest form, v2 over jumbo v1.
const MAX_OVERHEAD: usize = 14;

/// Which directions a decoder lets through; the rest is counted and dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Accept {
    /// Everything, for listening in.
    #[default]
    Any,
    /// `>` and `!`: our side. Own requests echoed by a one-wire line are dropped.
    Replies,
    /// `<`: the flight controller's side.
    Requests,
}

impl Accept {
    const fn lets(self, direction: Direction) -> bool {
        match self {
            Self::Any => true,
            Self::Replies => matches!(direction, Direction::Reply | Direction::Error),
            Self::Requests => matches!(direction, Direction::Request),
        }
    }
}

/// Where a decoder goes on after a frame with a wrong checksum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Resync {
    /// Right after the `$` of the bad frame: good frames swallowed by a garbled length are found
    /// again.
    #[default]
    Rescan,
    /// After the bad frame, as firmware does.
    Skip,
}

/// What a decoder has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Well-formed frames let through.
    pub frames: u64,
    /// Frames with a wrong checksum or CRC.
    pub checksum: u64,
    /// Frames that announce more payload than the limit.
    pub oversize: u64,
    /// v1 frames with command 255 whose inside is no v2 frame.
    pub malformed: u64,
    /// Frames given up by [`Decoder::resync`] because their end never came.
    pub truncated: u64,
    /// Well-formed frames of a direction that is not accepted.
    pub wrong_direction: u64,
    /// Bytes skipped outside frames, the insides of bad frames among them.
    pub noise_bytes: u64,
}

impl Counters {
    /// Frames lost to line errors: all kinds of bad frame, without wrong directions and noise.
    #[must_use]
    pub const fn bad_frames(&self) -> u64 {
        self.checksum + self.oversize + self.malformed + self.truncated
    }
}

/// Finds frames in a stream of bytes that comes in pieces of any size. Bounded memory, no
/// allocation after construction, no panic.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: Box<[u8]>,
    /// Bytes received and not yet used up.
    held: Range<usize>,
    max_payload: usize,
    accept: Accept,
    resync: Resync,
    counters: Counters,
}

/// What stands at the beginning of the held bytes.
enum Head {
    /// Not a frame: drop one byte.
    Noise,
    /// The start of a frame; more bytes are needed.
    Partial,
    /// Not a frame after all; whole length of what was announced.
    Bad(Fault, usize),
    /// A whole, well-formed frame.
    Whole(Located),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Fault {
    Checksum,
    Malformed,
    Oversize,
}

/// A frame as positions relative to its `$`.
struct Located {
    framing: Framing,
    direction: Direction,
    flag: u8,
    command: u16,
    payload: Range<usize>,
    length: usize,
}

impl Decoder {
    /// A decoder for payloads up to [`MAX_PAYLOAD`] that finds frames inside bad frames.
    #[must_use]
    pub fn new(accept: Accept) -> Self {
        Self::with_limits(accept, Resync::Rescan, MAX_PAYLOAD)
    }

    /// A decoder with its own limit and way to resynchronise. A lower limit recovers faster from a
    /// garbled length; flight controllers take 192 bytes and skip bad frames.
    #[must_use]
    pub fn with_limits(accept: Accept, resync: Resync, max_payload: usize) -> Self {
        let buffer = vec![0; max_payload + MAX_OVERHEAD].into_boxed_slice();
        Self {
            buffer,
            held: 0..0,
            max_payload,
            accept,
            resync,
            counters: Counters::default(),
        }
    }

    /// Takes bytes from the front of `input` until a frame is complete or `input` is empty. Call
    /// until `None`.
    pub fn decode(&mut self, input: &mut &[u8]) -> Option<Frame<'_>> {
        let located = loop {
            match self.head() {
                Some(Head::Whole(located)) => {
                    let frame_start = self.held.start;
                    self.held.start += located.length;
                    if self.accept.lets(located.direction) {
                        self.counters.frames += 1;
                        break Located {
                            payload: located.payload.start + frame_start
                                ..located.payload.end + frame_start,
                            ..located
                        };
                    }
                    self.counters.wrong_direction += 1;
                }
                Some(Head::Bad(fault, length)) => {
                    match fault {
                        Fault::Checksum => self.counters.checksum += 1,
                        Fault::Malformed => self.counters.malformed += 1,
                        Fault::Oversize => self.counters.oversize += 1,
                    }
                    let whole_is_here = fault != Fault::Oversize;
                    self.held.start += if self.resync == Resync::Skip && whole_is_here {
                        length
                    } else {
                        1
                    };
                }
                Some(Head::Noise) => self.skip_noise(),
                Some(Head::Partial) | None => {
                    if input.is_empty() {
                        return None;
                    }
                    self.take(input);
                }
            }
        };
        let Located {
            framing,
            direction,
            flag,
            command,
            payload,
            ..
        } = located;
        Some(Frame {
            framing,
            direction,
            flag,
            command,
            payload: &self.buffer[payload],
        })
    }

    /// Gives up the frame that has begun and not ended, if any, and looks for frames in what
    /// followed its `$`. For a line that has gone quiet in the middle of a frame: the protocol
    /// itself has no time-out there. Call [`Self::decode`] with empty input after it.
    pub fn resync(&mut self) {
        if self.has_partial() {
            self.counters.truncated += 1;
            self.held.start += 1;
        }
    }

    /// Forgets the bytes held and keeps the counters: for a line that was reopened.
    pub fn clear(&mut self) {
        self.held = 0..0;
    }

    /// Whether a frame has begun and not ended.
    #[must_use]
    pub fn has_partial(&self) -> bool {
        !self.held.is_empty()
    }

    /// What has been seen since construction.
    #[must_use]
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    fn take(&mut self, input: &mut &[u8]) {
        if self.held.end == self.buffer.len() || self.held.is_empty() {
            self.buffer.copy_within(self.held.clone(), 0);
            self.held = 0..self.held.len();
        }
        let room = &mut self.buffer[self.held.end..];
        let (taken, rest) = input.split_at(room.len().min(input.len()));
        room[..taken.len()].copy_from_slice(taken);
        self.held.end += taken.len();
        *input = rest;
    }

    fn skip_noise(&mut self) {
        let held = &self.buffer[self.held.clone()];
        // The first byte is known to begin no frame, even when it is `$`.
        let noise = held
            .iter()
            .skip(1)
            .position(|&byte| byte == b'$')
            .map_or(held.len(), |position| position + 1);
        self.held.start += noise;
        self.counters.noise_bytes += noise as u64;
    }

    fn head(&self) -> Option<Head> {
        let bytes = &self.buffer[self.held.clone()];
        match bytes {
            [] => None,
            [b'$'] => Some(Head::Partial),
            [b'$', b'M' | b'X'] => Some(Head::Partial),
            [b'$', version @ (b'M' | b'X'), direction, ..] => {
                Some(match Direction::from_byte(*direction) {
                    None => Head::Noise,
                    Some(direction) if *version == b'M' => self.v1(direction, bytes),
                    Some(direction) => self.v2(direction, bytes),
                })
            }
            _ => Some(Head::Noise),
        }
    }

    fn v1(&self, direction: Direction, bytes: &[u8]) -> Head {
        let (command, announced, start) = match *bytes {
            [_, _, _, u8::MAX, command, low, high, ..] => {
                (command, usize::from(u16::from_le_bytes([low, high])), 7)
            }
            [_, _, _, length, command, ..] if length != u8::MAX => {
                (command, usize::from(length), 5)
            }
            _ => return Head::Partial,
        };
        let encapsulates = command == u8::MAX;
        let limit = self.max_payload + if encapsulates { INNER_OVERHEAD } else { 0 };
        let end = start + announced;
        if announced > limit {
            return Head::Bad(Fault::Oversize, end + 1);
        }
        let Some(&checksum) = bytes.get(end) else {
            return Head::Partial;
        };
        if checksum != xor(&bytes[3..end]) {
            return Head::Bad(Fault::Checksum, end + 1);
        }
        if !encapsulates {
            let command = command.into();
            return Head::Whole(Located {
                framing: Framing::V1,
                direction,
                flag: 0,
                command,
                payload: start..end,
                length: end + 1,
            });
        }
        let inner = &bytes[start..end];
        let [flag, command_low, command_high, low, high, .., crc] = *inner else {
            return Head::Bad(Fault::Malformed, end + 1);
        };
        if usize::from(u16::from_le_bytes([low, high])) != inner.len() - INNER_OVERHEAD {
            return Head::Bad(Fault::Malformed, end + 1);
        }
        if crc != crc8_dvb_s2(&inner[..inner.len() - 1]) {
            return Head::Bad(Fault::Checksum, end + 1);
        }
        let command = u16::from_le_bytes([command_low, command_high]);
        Head::Whole(Located {
            framing: Framing::V2OverV1,
            direction,
            flag,
            command,
            payload: start + 5..end - 1,
            length: end + 1,
        })
    }

    fn v2(&self, direction: Direction, bytes: &[u8]) -> Head {
        let [_, _, _, flag, command_low, command_high, low, high, ..] = *bytes else {
            return Head::Partial;
        };
        let announced = usize::from(u16::from_le_bytes([low, high]));
        let end = 8 + announced;
        if announced > self.max_payload {
            return Head::Bad(Fault::Oversize, end + 1);
        }
        let Some(&crc) = bytes.get(end) else {
            return Head::Partial;
        };
        if crc != crc8_dvb_s2(&bytes[3..end]) {
            return Head::Bad(Fault::Checksum, end + 1);
        }
        let command = u16::from_le_bytes([command_low, command_high]);
        Head::Whole(Located {
            framing: Framing::V2,
            direction,
            flag,
            command,
            payload: 8..end,
            length: end + 1,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEVEL: &[u8] = b"$M>\x06\x6c\x00\x00\x00\x00\x00\x00\x6a";

    /// Commands of the frames in `bytes`.
    fn commands(decoder: &mut Decoder, mut bytes: &[u8]) -> Vec<u16> {
        let mut commands = Vec::new();
        while let Some(frame) = decoder.decode(&mut bytes) {
            commands.push(frame.command);
        }
        commands
    }

    #[test]
    fn a_wrong_checksum_costs_one_frame() {
        let mut decoder = Decoder::new(Accept::Replies);
        let mut bad = LEVEL.to_vec();
        bad[6] ^= 1;
        assert_eq!(commands(&mut decoder, &[&bad, LEVEL].concat()), [108]);
        assert_eq!(
            (decoder.counters().checksum, decoder.counters().bad_frames()),
            (1, 1)
        );
    }

    #[test]
    fn a_frame_swallowed_by_a_cut_one_is_found_by_rescanning_and_lost_by_skipping() {
        let cut = &LEVEL[..8];
        let line = [cut, LEVEL, LEVEL].concat();
        assert_eq!(
            commands(&mut Decoder::new(Accept::Replies), &line),
            [108, 108]
        );
        let mut as_firmware = Decoder::with_limits(Accept::Replies, Resync::Skip, 192);
        assert_eq!(commands(&mut as_firmware, &line), [108]);
    }

    #[test]
    fn a_length_that_never_comes_is_given_up_on_demand() {
        let mut decoder = Decoder::new(Accept::Replies);
        assert_eq!(
            commands(&mut decoder, &[b"$M>\xf0\x6c", LEVEL].concat()),
            [0; 0]
        );
        assert!(decoder.has_partial());
        decoder.resync();
        assert_eq!(commands(&mut decoder, &[]), [108]);
        assert_eq!(decoder.counters().truncated, 1);
        decoder.resync();
        assert_eq!(decoder.counters().truncated, 1, "nothing was begun");
    }

    #[test]
    fn own_requests_echoed_by_a_one_wire_line_are_counted_and_dropped() {
        let mut decoder = Decoder::new(Accept::Replies);
        assert_eq!(
            commands(&mut decoder, &[b"$M<\x00\x6c\x6c", LEVEL].concat()),
            [108]
        );
        assert_eq!(decoder.counters().wrong_direction, 1);
        assert_eq!(decoder.counters().bad_frames(), 0);
    }

    #[test]
    fn an_impossible_length_is_not_waited_for() {
        let mut decoder = Decoder::new(Accept::Replies);
        let line = [
            b"$X>\x00\x6c\x00\xff\xff",
            LEVEL,
            b"$M>\xff\x6c\xff\xff",
            LEVEL,
        ]
        .concat();
        assert_eq!(commands(&mut decoder, &line), [108, 108]);
        assert_eq!(decoder.counters().oversize, 2);
    }

    #[test]
    fn v2_inside_v1_with_lengths_that_disagree_is_malformed() {
        let mut decoder = Decoder::new(Accept::Replies);
        // Inner length 1 where 0 bytes follow; the outer checksum is right.
        let mut line = b"$M>\x06\xff\x00\x6c\x00\x01\x00\x00".to_vec();
        line.push(xor(&line[3..]));
        assert_eq!(commands(&mut decoder, &[&line, LEVEL].concat()), [108]);
        assert_eq!(decoder.counters().malformed, 1);
    }

    #[test]
    fn noise_is_skipped_and_counted() {
        let mut decoder = Decoder::new(Accept::Replies);
        assert_eq!(
            commands(&mut decoder, &[b"\x00\xff$$Mgarbage", LEVEL].concat()),
            [108]
        );
        assert_eq!(decoder.counters().noise_bytes, 12);
        assert_eq!(decoder.counters().bad_frames(), 0);
    }
}
