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

/// What stands at the beginning of some bytes.
enum Head {
    /// Not a frame: drop one byte.
    Noise,
    /// The start of a frame, which needs so many bytes at least, its `$` included.
    Partial(usize),
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

impl Located {
    fn frame<'a>(&self, bytes: &'a [u8]) -> Frame<'a> {
        Frame {
            framing: self.framing,
            direction: self.direction,
            flag: self.flag,
            command: self.command,
            payload: &bytes[self.payload.clone()],
        }
    }
}

/// Where the scan goes on.
enum Step {
    /// So many bytes further.
    Skip(usize),
    /// With the caller: here is a frame.
    Yield(Located),
    /// When there are so many bytes.
    Wait(usize),
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
    /// until `None`. A frame that lies in one piece in `input` is borrowed from there, one that came
    /// in several from the decoder.
    pub fn decode<'f, 's: 'f, 'i: 'f>(&'s mut self, input: &mut &'i [u8]) -> Option<Frame<'f>> {
        if self.held.is_empty()
            && let Some((frame, length)) = self.at_once(input)
        {
            *input = &input[length..];
            self.counters.frames += 1;
            return Some(frame);
        }
        let located = loop {
            if self.held.is_empty() {
                let bytes = *input;
                match self.step(bytes) {
                    Step::Skip(count) => *input = &bytes[count..],
                    Step::Yield(located) => {
                        *input = &bytes[located.length..];
                        return Some(located.frame(bytes));
                    }
                    Step::Wait(_) => {
                        self.take(input, bytes.len());
                        return None;
                    }
                }
                continue;
            }
            let held = self.held.clone();
            match self.step_held() {
                Step::Skip(count) => self.held.start += count,
                Step::Yield(located) => {
                    self.held.start += located.length;
                    break (held, located);
                }
                Step::Wait(_) if input.is_empty() => return None,
                // No more than this frame needs: what follows is read where it lies.
                Step::Wait(needed) => self.take(input, needed - held.len()),
            }
        };
        let (held, located) = located;
        Some(located.frame(&self.buffer[held]))
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

    /// The ordinary case, kept short because nearly every frame takes this way: `input` begins with a
    /// good v1 or v2 frame of an accepted direction. The frame and its length. Whatever is not
    /// ordinary is left to [`Head::of`].
    #[inline]
    fn at_once<'i>(&self, input: &'i [u8]) -> Option<(Frame<'i>, usize)> {
        let [b'$', version, direction, third, fourth, ..] = *input else {
            return None;
        };
        let direction = Direction::from_byte(direction).filter(|&way| self.accept.lets(way))?;
        let (framing, flag, command, place) = if version == b'M' {
            let place = 5..5 + usize::from(third);
            // A sum that includes the checksum itself is zero.
            if third == u8::MAX || fourth == u8::MAX || xor(input.get(3..=place.end)?) != 0 {
                return None;
            }
            (Framing::V1, 0, u16::from(fourth), place)
        } else {
            let &[fifth, low, high] = input.get(5..8)?.first_chunk()?;
            let place = 8..8 + usize::from(u16::from_le_bytes([low, high]));
            // So is a CRC.
            if version != b'X' || crc8_dvb_s2(input.get(3..=place.end)?) != 0 {
                return None;
            }
            (
                Framing::V2,
                third,
                u16::from_le_bytes([fourth, fifth]),
                place,
            )
        };
        if place.len() > self.max_payload {
            return None;
        }
        let length = place.end + 1;
        let frame = Frame {
            framing,
            direction,
            flag,
            command,
            payload: &input[place],
        };
        Some((frame, length))
    }

    /// Holds up to `wanted` bytes more.
    fn take(&mut self, input: &mut &[u8], wanted: usize) {
        let (taken, rest) = input.split_at(wanted.min(input.len()));
        if self.held.end + taken.len() > self.buffer.len() {
            self.buffer.copy_within(self.held.clone(), 0);
            self.held = 0..self.held.len();
        }
        let end = self.held.end + taken.len();
        self.buffer[self.held.end..end].copy_from_slice(taken);
        self.held.end = end;
        *input = rest;
    }

    fn step_held(&mut self) -> Step {
        let head = Head::of(&self.buffer[self.held.clone()], self.max_payload);
        let noise = matches!(head, Head::Noise).then(|| noise(&self.buffer[self.held.clone()]));
        self.judge(head, noise)
    }

    fn step(&mut self, bytes: &[u8]) -> Step {
        if bytes.is_empty() {
            return Step::Wait(1);
        }
        let head = Head::of(bytes, self.max_payload);
        let noise = matches!(head, Head::Noise).then(|| noise(bytes));
        self.judge(head, noise)
    }

    /// Counts what was found and says where to go on.
    fn judge(&mut self, head: Head, noise: Option<usize>) -> Step {
        match head {
            Head::Whole(located) if self.accept.lets(located.direction) => {
                self.counters.frames += 1;
                Step::Yield(located)
            }
            Head::Whole(located) => {
                self.counters.wrong_direction += 1;
                Step::Skip(located.length)
            }
            Head::Bad(fault, length) => {
                match fault {
                    Fault::Checksum => self.counters.checksum += 1,
                    Fault::Malformed => self.counters.malformed += 1,
                    Fault::Oversize => self.counters.oversize += 1,
                }
                let whole_is_here = fault != Fault::Oversize;
                Step::Skip(if self.resync == Resync::Skip && whole_is_here {
                    length
                } else {
                    1
                })
            }
            Head::Noise => {
                let count = noise.unwrap_or(1);
                self.counters.noise_bytes += count as u64;
                Step::Skip(count)
            }
            Head::Partial(needed) => Step::Wait(needed),
        }
    }
}

/// Bytes to drop. The first one is known to begin no frame, even when it is `$`.
fn noise(bytes: &[u8]) -> usize {
    let next = bytes.iter().skip(1).position(|&byte| byte == b'$');
    next.map_or(bytes.len(), |position| position + 1)
}

impl Head {
    #[inline]
    fn of(bytes: &[u8], max_payload: usize) -> Self {
        match *bytes {
            [b'$', version @ (b'M' | b'X'), direction, ..] => match Direction::from_byte(direction)
            {
                None => Self::Noise,
                Some(direction) if version == b'M' => Self::v1(direction, bytes, max_payload),
                Some(direction) => Self::v2(direction, bytes, max_payload),
            },
            [b'$'] | [b'$', b'M' | b'X'] => Self::Partial(3),
            _ => Self::Noise,
        }
    }

    #[inline]
    fn v1(direction: Direction, bytes: &[u8], max_payload: usize) -> Self {
        let (command, announced, start) = match *bytes {
            [_, _, _, length, command, ..] if length != u8::MAX => {
                (command, usize::from(length), 5)
            }
            [_, _, _, u8::MAX, command, low, high, ..] => {
                (command, usize::from(u16::from_le_bytes([low, high])), 7)
            }
            [_, _, _, u8::MAX, ..] => return Self::Partial(7),
            _ => return Self::Partial(5),
        };
        let encapsulates = command == u8::MAX;
        let limit = max_payload + if encapsulates { INNER_OVERHEAD } else { 0 };
        let end = start + announced;
        if announced > limit {
            return Self::Bad(Fault::Oversize, end + 1);
        }
        let Some(summed) = bytes.get(3..=end) else {
            return Self::Partial(end + 1);
        };
        // A sum that includes the checksum itself is zero.
        if xor(summed) != 0 {
            return Self::Bad(Fault::Checksum, end + 1);
        }
        if encapsulates {
            return Self::v2_over_v1(direction, bytes, start..end);
        }
        Self::Whole(Located {
            framing: Framing::V1,
            direction,
            flag: 0,
            command: command.into(),
            payload: start..end,
            length: end + 1,
        })
    }

    fn v2_over_v1(direction: Direction, bytes: &[u8], place: Range<usize>) -> Self {
        let length = place.end + 1;
        let inner = &bytes[place.clone()];
        let [flag, command_low, command_high, low, high, .., crc] = *inner else {
            return Self::Bad(Fault::Malformed, length);
        };
        if usize::from(u16::from_le_bytes([low, high])) != inner.len() - INNER_OVERHEAD {
            return Self::Bad(Fault::Malformed, length);
        }
        if crc != crc8_dvb_s2(&inner[..inner.len() - 1]) {
            return Self::Bad(Fault::Checksum, length);
        }
        Self::Whole(Located {
            framing: Framing::V2OverV1,
            direction,
            flag,
            command: u16::from_le_bytes([command_low, command_high]),
            payload: place.start + 5..place.end - 1,
            length,
        })
    }

    #[inline]
    fn v2(direction: Direction, bytes: &[u8], max_payload: usize) -> Self {
        let [_, _, _, flag, command_low, command_high, low, high, ..] = *bytes else {
            return Self::Partial(8);
        };
        let announced = usize::from(u16::from_le_bytes([low, high]));
        let end = 8 + announced;
        if announced > max_payload {
            return Self::Bad(Fault::Oversize, end + 1);
        }
        let Some(&crc) = bytes.get(end) else {
            return Self::Partial(end + 1);
        };
        if crc != crc8_dvb_s2(&bytes[3..end]) {
            return Self::Bad(Fault::Checksum, end + 1);
        }
        Self::Whole(Located {
            framing: Framing::V2,
            direction,
            flag,
            command: u16::from_le_bytes([command_low, command_high]),
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
