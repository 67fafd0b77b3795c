//! Payloads by pattern, for commands without a struct and for scripts: `"3h"` is three signed
//! 16-bit numbers.
//!
//! | letter | field | letter | field |
//! | --- | --- | --- | --- |
//! | `b` | i8 | `B` | u8 |
//! | `h` | i16 | `H` | u16 |
//! | `i` | i32 | `I` | u32 |
//! | `q` | i64 | `x` | one byte, skipped (written as 0) |
//!
//! A number before a letter repeats it, `*` repeats it to the end of the payload; a leading `<` and
//! spaces are allowed. The letters are those of Python's `struct`, so patterns of other MSP programs
//! can be used as they stand. Typed structs ([`crate::message`]) remain the better door: they know
//! units, firmware differences and fields that may be absent.
//!
//! The six messages of the SNSI thesis (García 2017, table in section 3.3) in its own manner:
//!
//! ```
//! use msp::frame::{Accept, Decoder};
//! use msp::{command, pattern};
//! let mut decoder = Decoder::new(Accept::Replies);
//! let mut line = b"$M>\x06\x6c\x85\xff\x2d\x00\x0e\x01\x32".as_slice();
//! let frame = decoder.decode(&mut line).expect("one frame");
//! let values = pattern::reply(&frame, command::ATTITUDE, "3h")?;
//! assert_eq!(values.as_slice(), [-123, 45, 270]);
//! assert_eq!(pattern::of(command::ATTITUDE), Some("3h"));
//! # Ok::<(), pattern::PatternError>(())
//! ```

use crate::command;
use crate::frame::{Direction, Frame};
use arrayvec::ArrayVec;

/// Most values of one payload.
pub const MAX_VALUES: usize = 128;

/// Values of a payload, in order.
pub type Values = ArrayVec<i64, MAX_VALUES>;

/// Why a payload does not fit a pattern.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PatternError {
    /// The pattern has a letter that is none, or a count without a letter.
    #[error("pattern {pattern:?}: {found:?} is none of b B h H i I q x")]
    Letter {
        /// The pattern.
        pattern: String,
        /// What stands there; `None` = its end.
        found: Option<char>,
    },
    /// The frame answers another command.
    #[error("{} ({command}) was answered, {} ({wanted}) was asked", command::name(*.command), command::name(*.wanted))]
    OtherCommand {
        /// Command of the frame.
        command: u16,
        /// Command that was asked.
        wanted: u16,
    },
    /// A value does not fit its field.
    #[error("{value} does not fit `{letter}`")]
    OutOfRange {
        /// The value.
        value: i64,
        /// The field.
        letter: char,
    },
    /// The controller said no.
    #[error("the flight controller refused {} ({command})", command::name(*.command))]
    Refused {
        /// Command number.
        command: u16,
    },
    /// The payload ends inside a field.
    #[error("pattern {pattern:?} needs more than {got} bytes")]
    TooShort {
        /// The pattern.
        pattern: String,
        /// Bytes present.
        got: usize,
    },
    /// More values than [`MAX_VALUES`], or values left over when the pattern has ended.
    #[error("pattern {pattern:?} and {count} values do not go together")]
    Count {
        /// The pattern.
        pattern: String,
        /// How many values there are.
        count: usize,
    },
}

/// The pattern of a message of the SNSI table, `None` for other commands. ANALOG and MOTOR are as in
/// that table; newer firmware appends to ANALOG, which a pattern ignores.
#[must_use]
pub const fn of(command: u16) -> Option<&'static str> {
    Some(match command {
        command::MOTOR | command::SET_MOTOR => "8H",
        command::RC | command::SET_RAW_RC => "*H",
        command::ATTITUDE => "3h",
        command::ANALOG => "B2Hh",
        _ => return None,
    })
}

/// Reads a frame that must answer `wanted`.
///
/// # Errors
/// [`PatternError`] when the frame answers something else, is a refusal, or does not fit the pattern.
pub fn reply(frame: &Frame<'_>, wanted: u16, pattern: &str) -> Result<Values, PatternError> {
    if frame.command != wanted {
        return Err(PatternError::OtherCommand {
            command: frame.command,
            wanted,
        });
    }
    if frame.direction == Direction::Error {
        return Err(PatternError::Refused { command: wanted });
    }
    read(pattern, frame.payload)
}

/// Reads a payload. Bytes after the last field are ignored, since firmware appends freely.
///
/// # Errors
/// [`PatternError`] when the pattern is none or the payload ends inside it.
pub fn read(pattern: &str, payload: &[u8]) -> Result<Values, PatternError> {
    let mut values = Values::new();
    let mut rest = payload;
    for group in groups(pattern) {
        let (repeat, field) = group?;
        let mut left = match repeat {
            Repeat::Times(times) => times,
            Repeat::ToTheEnd => rest.len().div_ceil(field.size()),
        };
        while left > 0 {
            let too_short = || PatternError::TooShort {
                pattern: pattern.to_owned(),
                got: payload.len(),
            };
            let (bytes, after) = rest.split_at_checked(field.size()).ok_or_else(too_short)?;
            rest = after;
            left -= 1;
            let Some(value) = field.value(bytes) else {
                continue;
            };
            values.try_push(value).map_err(|_| PatternError::Count {
                pattern: pattern.to_owned(),
                count: MAX_VALUES + 1,
            })?;
        }
    }
    Ok(values)
}

/// Appends a payload to `out`.
///
/// # Errors
/// [`PatternError`] when the pattern is none, a value does not fit its field, or there are too many or
/// too few; `out` is unchanged then.
pub fn write(pattern: &str, values: &[i64], out: &mut Vec<u8>) -> Result<(), PatternError> {
    let start = out.len();
    let written = append(pattern, values, out);
    if written.is_err() {
        out.truncate(start);
    }
    written
}

fn append(pattern: &str, values: &[i64], out: &mut Vec<u8>) -> Result<(), PatternError> {
    let count = || PatternError::Count {
        pattern: pattern.to_owned(),
        count: values.len(),
    };
    let mut rest = values.iter();
    for group in groups(pattern) {
        let (repeat, field) = group?;
        let times = match repeat {
            Repeat::Times(times) => times,
            Repeat::ToTheEnd => rest.len(),
        };
        for _ in 0..times.min(MAX_VALUES + 1) {
            let value = match field {
                Field::Skip => 0,
                _ => *rest.next().ok_or_else(count)?,
            };
            if !field.holds(value) {
                return Err(PatternError::OutOfRange {
                    value,
                    letter: field.letter(),
                });
            }
            out.extend_from_slice(&value.to_le_bytes()[..field.size()]);
        }
    }
    if rest.len() > 0 { Err(count()) } else { Ok(()) }
}

#[derive(Clone, Copy)]
enum Repeat {
    Times(usize),
    ToTheEnd,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Field {
    Signed(usize),
    Skip,
    Unsigned(usize),
}

impl Field {
    const fn from_letter(letter: char) -> Option<Self> {
        Some(match letter {
            'b' => Self::Signed(1),
            'h' => Self::Signed(2),
            'i' | 'l' => Self::Signed(4),
            'q' => Self::Signed(8),
            'B' => Self::Unsigned(1),
            'H' => Self::Unsigned(2),
            'I' | 'L' => Self::Unsigned(4),
            'x' => Self::Skip,
            _ => return None,
        })
    }

    const fn letter(self) -> char {
        match self {
            Self::Signed(1) => 'b',
            Self::Signed(2) => 'h',
            Self::Signed(4) => 'i',
            Self::Signed(_) => 'q',
            Self::Unsigned(1) => 'B',
            Self::Unsigned(2) => 'H',
            Self::Unsigned(_) => 'I',
            Self::Skip => 'x',
        }
    }

    const fn size(self) -> usize {
        match self {
            Self::Signed(size) | Self::Unsigned(size) => size,
            Self::Skip => 1,
        }
    }

    fn holds(self, value: i64) -> bool {
        match self {
            Self::Signed(8) => true,
            Self::Signed(size) => {
                let limit = 1_i64 << (8 * size - 1);
                (-limit..limit).contains(&value)
            }
            Self::Unsigned(size) => (0..1_i64 << (8 * size)).contains(&value),
            Self::Skip => true,
        }
    }

    fn value(self, bytes: &[u8]) -> Option<i64> {
        let mut wide = [0; 8];
        wide[..bytes.len()].copy_from_slice(bytes);
        let value = i64::from_le_bytes(wide);
        match self {
            Self::Signed(size) => {
                let unused = 64 - 8 * size;
                Some(value << unused >> unused)
            }
            Self::Unsigned(_) => Some(value),
            Self::Skip => None,
        }
    }
}

/// Repeat and field of each part of a pattern.
fn groups(pattern: &str) -> impl Iterator<Item = Result<(Repeat, Field), PatternError>> {
    let mut letters = pattern.chars().filter(|letter| *letter != ' ').peekable();
    letters.next_if_eq(&'<');
    let mut is_over = false;
    std::iter::from_fn(move || {
        if is_over || letters.peek().is_none() {
            return None;
        }
        let repeat = if letters.next_if_eq(&'*').is_some() {
            Repeat::ToTheEnd
        } else {
            let mut times: Option<usize> = None;
            while let Some(digit) = letters.peek().and_then(|letter| letter.to_digit(10)) {
                letters.next();
                let before = times.unwrap_or(0).saturating_mul(10);
                times = Some(before.saturating_add(usize::try_from(digit).unwrap_or(0)));
            }
            Repeat::Times(times.unwrap_or(1))
        };
        let found = letters.next();
        let field = found.and_then(Field::from_letter);
        is_over = field.is_none();
        Some(
            field
                .map(|field| (repeat, field))
                .ok_or_else(|| PatternError::Letter {
                    pattern: pattern.to_owned(),
                    found,
                }),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Accept, Decoder, Framing, encode};
    use crate::message::{Analog, Attitude, Message, Motor, Rc};

    /// Payload of each message of the SNSI table, by its struct.
    fn table() -> Vec<(u16, Vec<u8>)> {
        let emit = |emit: &dyn Fn(&mut Vec<u8>)| {
            let mut payload = Vec::new();
            emit(&mut payload);
            payload
        };
        let rc = Rc {
            channels_us: (1500..1518).collect(),
        };
        let motor = Motor {
            motors_us: [1000, 1100, 1200, 1300, 0, 0, 0, 2000],
        };
        let attitude = Attitude {
            roll_ddeg: -1800,
            pitch_ddeg: 900,
            yaw_deg: 359,
        };
        let analog = Analog {
            vbat_dv: 126,
            drawn_mah: 2200,
            rssi: 1023,
            current_ca: -5,
            vbat_cv: Some(1261),
        };
        vec![
            (command::MOTOR, emit(&|out| motor.emit(out))),
            (command::RC, emit(&|out| rc.emit(out))),
            (command::ATTITUDE, emit(&|out| attitude.emit(out))),
            (command::ANALOG, emit(&|out| analog.emit(out))),
            (command::SET_RAW_RC, emit(&|out| rc.emit(out))),
            (command::SET_MOTOR, emit(&|out| motor.emit(out))),
        ]
    }

    #[test]
    fn all_six_messages_of_the_table_by_pattern_are_those_by_struct() {
        for (number, payload) in table() {
            let values = read(of(number).unwrap(), &payload).unwrap();
            let mut again = Vec::new();
            write(of(number).unwrap(), &values, &mut again).unwrap();
            assert!(payload.starts_with(&again), "{number}: {again:?}");
        }
        let (_, attitude) = &table()[2];
        assert_eq!(read("3h", attitude).unwrap().as_slice(), [-1800, 900, 359]);
        let (_, analog) = &table()[3];
        assert_eq!(
            read("B2HhH", analog).unwrap().as_slice(),
            [126, 2200, 1023, -5, 1261]
        );
    }

    #[test]
    fn a_wrong_checksum_a_wrong_command_and_a_short_frame_are_errors_and_the_next_frame_is_read() {
        let (mut good, mut other, mut short) = (Vec::new(), Vec::new(), Vec::new());
        for (out, number, payload) in [
            (&mut good, command::ATTITUDE, &[1, 0, 2, 0, 3, 0][..]),
            (&mut other, command::ALTITUDE, &[1, 0, 2, 0, 3, 0]),
            (&mut short, command::ATTITUDE, &[1, 0, 2]),
        ] {
            encode(Framing::V1, Direction::Reply, number, payload, out).unwrap();
        }
        let mut corrupted = good.clone();
        *corrupted.last_mut().unwrap() ^= 1;
        let line = [&corrupted[..], &other, &short, &good].concat();
        let (mut decoder, mut input) = (Decoder::new(Accept::Replies), line.as_slice());
        let mut got = Vec::new();
        while let Some(frame) = decoder.decode(&mut input) {
            got.push(reply(&frame, command::ATTITUDE, "3h"));
        }
        assert_eq!(decoder.counters().checksum, 1);
        assert!(matches!(
            got[0],
            Err(PatternError::OtherCommand {
                command: 109,
                wanted: 108
            })
        ));
        assert!(matches!(got[1], Err(PatternError::TooShort { got: 3, .. })));
        assert_eq!(got[2].as_ref().unwrap().as_slice(), [1, 2, 3]);
    }

    #[test]
    fn counts_skips_and_the_end_of_the_payload() {
        let bytes = [1, 2, 3, 4, 0xff, 0xff, 0xff, 0xff];
        assert_eq!(read("<2B x b i", &bytes).unwrap().as_slice(), [1, 2, 4, -1]);
        assert_eq!(
            read("*H", &bytes).unwrap().as_slice(),
            [513, 1027, 65535, 65535]
        );
        assert_eq!(read("0B", &bytes).unwrap().len(), 0);
        assert!(read("*H", &bytes[..3]).is_err());
    }

    #[test]
    fn what_does_not_fit_is_an_error_and_writes_nothing() {
        let mut out = vec![9];
        assert_eq!(
            write("B", &[256], &mut out).unwrap_err().to_string(),
            "256 does not fit `B`"
        );
        assert!(write("2B", &[1], &mut out).is_err());
        assert!(write("B", &[1, 2], &mut out).is_err());
        assert_eq!(
            read("3z", &[]).unwrap_err().to_string(),
            "pattern \"3z\": Some('z') is none of b B h H i I q x"
        );
        assert!(read("3", &[]).is_err() && read("999999999999999999999B", &[1]).is_err());
        assert_eq!(out, [9]);
    }
}
