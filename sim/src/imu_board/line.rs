//! What goes out on the line: frames in both formats, the menu.

use super::bmp085::Constants;
use arrayvec::ArrayString;
use core::fmt::Write as _;

/// Longest text sent at once.
pub(super) const TEXT: usize = 224;

/// One sample of everything, in the units of the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Sample {
    pub(super) since_previous_us: u32,
    pub(super) accel: [i16; 3],
    pub(super) gyro: [i16; 3],
    pub(super) mag: [i16; 3],
    pub(super) temperature_ddeg: u16,
    pub(super) pressure_pa: u32,
}

impl Sample {
    /// Thirty bytes, little-endian, between a start byte and `Z`.
    pub(super) fn binary(&self, start: u8) -> [u8; 30] {
        let mut out = [0; 30];
        let mut at = 0;
        let mut put = |bytes: &[u8]| {
            out[at..at + bytes.len()].copy_from_slice(bytes);
            at += bytes.len();
        };
        put(&[start]);
        put(&self.since_previous_us.to_le_bytes());
        for axis in self.accel.iter().chain(&self.gyro).chain(&self.mag) {
            put(&axis.to_le_bytes());
        }
        put(&self.temperature_ddeg.to_le_bytes());
        put(&self.pressure_pa.to_le_bytes());
        put(b"Z");
        out
    }

    /// One line of text.
    pub(super) fn text(&self, start: u8) -> ArrayString<TEXT> {
        let mut out = ArrayString::new();
        // The longest line has 110 characters.
        let _ = write!(out, "{}\t{}", char::from(start), self.since_previous_us);
        for axis in self.accel.iter().chain(&self.gyro).chain(&self.mag) {
            let _ = write!(out, "\t{axis}");
        }
        let _ = write!(
            out,
            "\t{}\t{}\tZ\r\n",
            self.temperature_ddeg, self.pressure_pa
        );
        out
    }
}

/// What is switched on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Switches {
    pub(super) is_text: bool,
    pub(super) accel: bool,
    pub(super) gyro: bool,
    pub(super) mag: bool,
    pub(super) temperature: bool,
    pub(super) pressure: bool,
}

impl Default for Switches {
    fn default() -> Self {
        Self {
            is_text: false,
            accel: true,
            gyro: true,
            mag: true,
            temperature: true,
            pressure: true,
        }
    }
}

/// The menu. No start byte of a frame is followed by an end byte 29 further on.
pub(super) fn menu(s: &Switches) -> ArrayString<TEXT> {
    let on = |is_on: bool| if is_on { "on" } else { "off" };
    let mut out = ArrayString::new();
    let format = if s.is_text { "text" } else { "binary" };
    let _ = write!(
        out,
        "1 format {format}\r\n2 acc {}\r\n3 gyro {}\r\n4 compass {}\r\n5 temp {}\r\n6 pressure {}\r\n7 barometer\r\n! # run\r\n",
        on(s.accel),
        on(s.gyro),
        on(s.mag),
        on(s.temperature),
        on(s.pressure)
    );
    out
}

/// The barometer's constants.
pub(super) fn barometer(c: &Constants) -> ArrayString<TEXT> {
    let mut out = ArrayString::new();
    let _ = write!(
        out,
        "ac1 {} ac2 {} ac3 {} ac4 {} ac5 {} ac6 {} b1 {} b2 {} mb {} mc {} md {}\r\n",
        c.ac1, c.ac2, c.ac3, c.ac4, c.ac5, c.ac6, c.b1, c.b2, c.mb, c.mc, c.md
    );
    out
}
