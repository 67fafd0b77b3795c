//! Text frames: `A <us> ax ay az gx gy gz mx my mz temp press Z`, tabs between, CR LF at the end.
//!
//! For people at a terminal: at 115200 baud a line takes most of the 10 ms between two frames.

use super::frame::RawFrame;
use arrayvec::{ArrayString, ArrayVec};
use core::fmt::Write as _;

/// Longest line: two letters, twelve numbers of at most 11 characters, as many tabs, CR LF.
const LINE_LEN: usize = 160;
/// Numbers of a line.
const NUMBERS: usize = 12;
/// Their names, for complaints.
const NAMES: [&str; NUMBERS] = [
    "time",
    "ax",
    "ay",
    "az",
    "gx",
    "gy",
    "gz",
    "mx",
    "my",
    "mz",
    "temperature",
    "pressure",
];

/// Why a line is no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AsciiError {
    /// The line does not begin with `A` or `C`, or does not end with `Z`.
    NotAFrame,
    /// Too few or too many numbers.
    Count {
        /// How many there are.
        got: usize,
    },
    /// A number that is none, or beyond the range of its field.
    Number {
        /// The field.
        name: &'static str,
    },
    /// The line is longer than any frame.
    TooLong,
    /// Temperature or pressure that the sensor cannot send.
    Implausible,
}

impl core::fmt::Display for AsciiError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotAFrame => f.write_str("not a frame: it must begin with A and end with Z"),
            Self::Count { got } => write!(f, "{got} numbers, a frame has {NUMBERS}"),
            Self::Number { name } => write!(f, "{name} is not a number of its range"),
            Self::TooLong => f.write_str("the line is longer than any frame"),
            Self::Implausible => f.write_str("impossible temperature or pressure"),
        }
    }
}

impl core::error::Error for AsciiError {}

/// Reads one line, without its end.
///
/// # Errors
///
/// The reason, when the line is no frame.
pub fn parse_line(line: &str) -> Result<RawFrame, AsciiError> {
    let mut words = line.split_ascii_whitespace();
    if !matches!(words.next(), Some("A" | "C")) {
        return Err(AsciiError::NotAFrame);
    }
    let mut numbers: ArrayVec<&str, NUMBERS> = ArrayVec::new();
    let mut has_ended = false;
    let mut got = 0;
    for word in words {
        if has_ended {
            return Err(AsciiError::NotAFrame);
        }
        if word == "Z" {
            has_ended = true;
        } else {
            got += 1;
            let _ = numbers.try_push(word);
        }
    }
    if !has_ended {
        return Err(AsciiError::NotAFrame);
    }
    if got != NUMBERS {
        return Err(AsciiError::Count { got });
    }
    from_numbers(&numbers)
}

/// A frame from its twelve numbers as text, in the order of the line (also that of the `imu_raw` log).
pub(super) fn from_numbers(words: &[&str]) -> Result<RawFrame, AsciiError> {
    fn number<T: core::str::FromStr>(words: &[&str], i: usize) -> Result<T, AsciiError> {
        words
            .get(i)
            .and_then(|w| w.parse().ok())
            .ok_or(AsciiError::Number { name: NAMES[i] })
    }
    let triple = |i: usize| -> Result<[i16; 3], AsciiError> {
        Ok([
            number(words, i)?,
            number(words, i + 1)?,
            number(words, i + 2)?,
        ])
    };
    let frame = RawFrame {
        since_previous_us: number(words, 0)?,
        accel: triple(1)?,
        gyro: triple(4)?,
        mag: triple(7)?,
        temperature_ddeg: number(words, 10)?,
        pressure_pa: number(words, 11)?,
    };
    if frame.is_plausible() {
        Ok(frame)
    } else {
        Err(AsciiError::Implausible)
    }
}

/// The line of a frame, with CR LF.
#[must_use]
pub fn format_line(frame: &RawFrame) -> ArrayString<LINE_LEN> {
    let mut out = ArrayString::new();
    let f = frame;
    let (a, g, m) = (f.accel, f.gyro, f.mag);
    // The capacity holds the longest numbers of every field.
    let _ = write!(
        out,
        "A\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\tZ\r\n",
        f.since_previous_us,
        a[0],
        a[1],
        a[2],
        g[0],
        g[1],
        g[2],
        m[0],
        m[1],
        m[2],
        f.temperature_ddeg,
        f.pressure_pa,
    );
    out
}

/// Push decoder of text frames.
#[derive(Clone, Debug, Default)]
pub struct AsciiDecoder {
    line: ArrayString<LINE_LEN>,
    is_too_long: bool,
}

impl AsciiDecoder {
    /// Takes one byte; answers at the end of a line that is not empty.
    pub fn push(&mut self, byte: u8) -> Option<Result<RawFrame, AsciiError>> {
        if byte != b'\n' && byte != b'\r' {
            // What is not ASCII belongs to no frame; a blank in its place keeps the neighbours apart.
            let c = if byte.is_ascii() {
                char::from(byte)
            } else {
                '?'
            };
            self.is_too_long |= self.line.try_push(c).is_err();
            return None;
        }
        if self.line.is_empty() {
            return None;
        }
        let answer = if self.is_too_long {
            Err(AsciiError::TooLong)
        } else {
            parse_line(&self.line)
        };
        self.line.clear();
        self.is_too_long = false;
        Some(answer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LINE: &str = "A\t10000\t12\t-11\t205\t-22\t-31\t-14\t-94\t129\t7\t250\t101202\tZ";

    #[test]
    fn a_line_gives_the_same_values_as_thirty_bytes() {
        let frame = parse_line(LINE).unwrap();
        assert_eq!(frame.accel, [12, -11, 205]);
        assert_eq!(frame.pressure_pa, 101_202);
        assert_eq!(RawFrame::parse(&frame.emit(b'A')), frame);
        assert_eq!(format_line(&frame).trim_end(), LINE);
    }

    #[test]
    fn every_wrong_line_has_its_reason() {
        let cases = [
            (LINE.replace("\tZ", ""), AsciiError::NotAFrame),
            (LINE.replace('A', "B"), AsciiError::NotAFrame),
            (LINE.replace("\t250", ""), AsciiError::Count { got: 11 }),
            (LINE.replace("Z", "1\tZ"), AsciiError::Count { got: 13 }),
            (
                LINE.replace("-31", "NaN"),
                AsciiError::Number { name: "gy" },
            ),
            (
                LINE.replace("205", "99999"),
                AsciiError::Number { name: "az" },
            ),
            (LINE.replace("101202", "7"), AsciiError::Implausible),
        ];
        for (line, reason) in cases {
            assert_eq!(parse_line(&line), Err(reason), "{line}");
        }
    }

    #[test]
    fn the_widest_numbers_fit_a_line() {
        let widest = RawFrame {
            since_previous_us: u32::MAX,
            accel: [i16::MIN; 3],
            gyro: [i16::MIN; 3],
            mag: [i16::MIN; 3],
            temperature_ddeg: 1250,
            pressure_pa: 110_000,
        };
        assert_eq!(parse_line(format_line(&widest).trim_end()), Ok(widest));
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(noise in proptest::collection::vec(any::<u8>(), 0..600)) {
            let mut decoder = AsciiDecoder::default();
            for b in noise {
                let _ = decoder.push(b);
            }
            let _ = decoder.push(b'\n');
            let mut last = None;
            for b in LINE.bytes().chain(*b"\r\n") {
                last = last.or(decoder.push(b));
            }
            prop_assert_eq!(last, Some(parse_line(LINE)));
        }
    }
}
