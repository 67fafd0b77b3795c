//! A recorded `imu_raw` log in place of the board.
//!
//! Fourteen columns: host seconds, host microseconds, time since the previous frame (us), accelerometer, gyro, magnetometer (counts, x y z each),
//! temperature (0.1 degC), pressure (Pa). Frames are due by the board's own time: the host's has bursts, because the
//! frames of the first second waited in a buffer.

use super::ascii::{self, AsciiError};
use super::frame::RawFrame;
use arrayvec::ArrayVec;
use core::fmt;
use core::time::Duration;
use vehicle::Timestamp;

/// Columns of the log.
const COLUMNS: usize = 14;

/// One row of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogRow {
    /// Host time, us since the Unix epoch.
    pub host_us: u64,
    /// The frame.
    pub frame: RawFrame,
}

/// Why a row of a log is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogError {
    /// Not fourteen columns.
    Columns {
        /// How many there are.
        got: usize,
    },
    /// Host time that is no number.
    HostTime,
    /// A field of the frame.
    Frame(AsciiError),
    /// Host time runs backwards.
    OutOfOrder,
    /// The same host time and the same frame as the row before.
    Duplicate,
}

impl fmt::Display for LogError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Columns { got } => write!(f, "{got} columns, imu_raw has {COLUMNS}"),
            Self::HostTime => f.write_str("host time is not a number"),
            Self::Frame(e) => e.fmt(f),
            Self::OutOfOrder => f.write_str("host time runs backwards"),
            Self::Duplicate => f.write_str("the same row twice"),
        }
    }
}

impl core::error::Error for LogError {}

impl LogRow {
    /// Reads one line.
    ///
    /// # Errors
    ///
    /// The reason, when it is no row of the log.
    pub fn parse(line: &str) -> Result<Self, LogError> {
        let mut words: ArrayVec<&str, COLUMNS> = ArrayVec::new();
        let mut got = 0;
        for word in line.split_ascii_whitespace() {
            got += 1;
            let _ = words.try_push(word);
        }
        if got != COLUMNS {
            return Err(LogError::Columns { got });
        }
        let number = |i: usize| words[i].parse::<u32>().map_err(|_| LogError::HostTime);
        Ok(Self {
            host_us: u64::from(number(0)?) * 1_000_000 + u64::from(number(1)?),
            frame: ascii::from_numbers(&words[2..]).map_err(LogError::Frame)?,
        })
    }

    /// Checks the row against the one before it.
    ///
    /// # Errors
    ///
    /// When it is the same or older.
    pub fn follows(&self, before: &Self) -> Result<(), LogError> {
        if self.host_us < before.host_us {
            return Err(LogError::OutOfOrder);
        }
        if self == before {
            return Err(LogError::Duplicate);
        }
        Ok(())
    }
}

impl fmt::Display for LogRow {
    /// The line as uQuad's logger writes it, without the end of line.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let f = &self.frame;
        write!(
            out,
            "{}\t{}\t{}",
            self.host_us / 1_000_000,
            self.host_us % 1_000_000,
            f.since_previous_us
        )?;
        for value in f.accel.iter().chain(&f.gyro).chain(&f.mag) {
            write!(out, "\t{value}")?;
        }
        write!(out, "\t{}\t{}", f.temperature_ddeg, f.pressure_pa)
    }
}

/// How fast a log is replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Speed {
    /// Frames are due as soon as they are asked for.
    #[default]
    AsFastAsPossible,
    /// Frames are due when the board would have sent them.
    RealTime,
}

/// Hands out the frames of a log. The same frames with the same stamps at both speeds.
#[derive(Clone, Debug)]
pub struct Replay {
    frames: Vec<RawFrame>,
    next: usize,
    speed: Speed,
    due: Timestamp,
}

impl Replay {
    /// Replays from `start`: the first frame is due then.
    #[must_use]
    pub const fn new(frames: Vec<RawFrame>, speed: Speed, start: Timestamp) -> Self {
        Self {
            frames,
            next: 0,
            speed,
            due: start,
        }
    }

    /// The next frame with the time the board sent it, if it is due. Ask until `None`.
    pub fn poll(&mut self, now: Timestamp) -> Option<(Timestamp, RawFrame)> {
        let frame = *self.frames.get(self.next)?;
        if self.speed == Speed::RealTime && now < self.due {
            return None;
        }
        let at = self.due;
        self.next += 1;
        if let Some(following) = self.frames.get(self.next) {
            self.due += Duration::from_micros(u64::from(following.since_previous_us));
        }
        Some((at, frame))
    }

    /// When the next frame is due; none at the end.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        let is_over = self.next >= self.frames.len();
        (!is_over).then_some(match self.speed {
            Speed::AsFastAsPossible => Timestamp::ZERO,
            Speed::RealTime => self.due,
        })
    }

    /// Frames handed out and frames in all.
    #[must_use]
    pub const fn progress(&self) -> (usize, usize) {
        (self.next, self.frames.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str =
        "1332529997\t753009\t14320\t13\t-9\t207\t-15\t-21\t-17\t-98\t130\t8\t249\t101205";

    #[test]
    fn a_row_is_read_and_written_alike() {
        let row = LogRow::parse(LINE).unwrap();
        assert_eq!(row.host_us, 1_332_529_997_753_009);
        assert_eq!(row.frame.gyro, [-15, -21, -17]);
        assert_eq!(row.to_string(), LINE);
    }

    #[test]
    fn rows_that_are_none_have_a_reason() {
        let cut = &LINE[..LINE.len() - 7];
        assert_eq!(LogRow::parse(cut), Err(LogError::Columns { got: 13 }));
        let text = LINE.replace("-21", "NaN");
        assert_eq!(
            LogRow::parse(&text),
            Err(LogError::Frame(AsciiError::Number { name: "gy" }))
        );
        let row = LogRow::parse(LINE).unwrap();
        let older = LogRow { host_us: 1, ..row };
        assert_eq!(older.follows(&row), Err(LogError::OutOfOrder));
        assert_eq!(row.follows(&row), Err(LogError::Duplicate));
        assert_eq!(row.follows(&older), Ok(()));
    }

    #[test]
    fn both_speeds_give_the_same_frames_with_the_same_stamps() {
        let frames: Vec<RawFrame> = (0..5)
            .map(|k| RawFrame {
                since_previous_us: 10_000 + k,
                ..RawFrame::default()
            })
            .collect();
        let start = Timestamp::from_ms(7);
        let mut fast = Replay::new(frames.clone(), Speed::AsFastAsPossible, start);
        let at_once: Vec<_> = core::iter::from_fn(|| fast.poll(start)).collect();
        let mut real = Replay::new(frames, Speed::RealTime, start);
        let mut in_time = Vec::new();
        while let Some(now) = real.deadline() {
            assert_eq!(real.poll(now - Duration::from_micros(1)), None);
            in_time.extend(real.poll(now));
        }
        assert_eq!(at_once.len(), 5);
        assert_eq!(at_once, in_time);
        assert_eq!(in_time[4].0.us(), 7_000 + 4 * 10_000 + 10);
    }
}
