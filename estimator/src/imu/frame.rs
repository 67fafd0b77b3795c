//! One frame of the board, in counts, and its 30 bytes.
//!
//! | Offset | Size | Field |
//! | --- | --- | --- |
//! | 0 | 1 | start byte `A`, or `C` in every other frame |
//! | 1 | 4 | time since the previous frame, us, u32 |
//! | 5 | 6 | accelerometer x y z, i16 |
//! | 11 | 6 | gyro x y z, i16 |
//! | 17 | 6 | magnetometer x y z, i16 |
//! | 23 | 2 | temperature, u16, 0.1 degC |
//! | 25 | 4 | pressure, u32, Pa |
//! | 29 | 1 | end byte `Z` |
//!
//! Little-endian, no checksum. uQuad's header says 29 bytes and keeps the time in 16 bits; its parser takes 30, and 16 bits overflow at
//! 65 ms, so both are kept whole here.

use nalgebra::Vector3;

/// Length of a binary frame.
pub const FRAME_LEN: usize = 30;
/// First byte of a frame.
pub const START: u8 = b'A';
/// First byte of every other frame, if the board alternates.
pub const ALTERNATE_START: u8 = b'C';
/// Last byte of a frame.
pub const END: u8 = b'Z';

/// True for both start bytes, which differ in one bit.
#[must_use]
pub const fn is_start(byte: u8) -> bool {
    byte | 0x02 == ALTERNATE_START
}

/// What the board sampled, in wire units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawFrame {
    /// Time since the previous frame, us.
    pub since_previous_us: u32,
    /// Accelerometer x y z, counts.
    pub accel: [i16; 3],
    /// Gyro x y z, counts.
    pub gyro: [i16; 3],
    /// Magnetometer x y z, counts.
    pub mag: [i16; 3],
    /// Temperature, 0.1 degC.
    pub temperature_ddeg: u16,
    /// Pressure, Pa.
    pub pressure_pa: u32,
}

impl RawFrame {
    /// Reads the fields of 30 bytes; the start and end bytes are the decoder's business.
    #[must_use]
    pub const fn parse(b: &[u8; FRAME_LEN]) -> Self {
        const fn axis(b: &[u8; FRAME_LEN], at: usize) -> i16 {
            i16::from_le_bytes([b[at], b[at + 1]])
        }
        const fn triple(b: &[u8; FRAME_LEN], at: usize) -> [i16; 3] {
            [axis(b, at), axis(b, at + 2), axis(b, at + 4)]
        }
        Self {
            since_previous_us: u32::from_le_bytes([b[1], b[2], b[3], b[4]]),
            accel: triple(b, 5),
            gyro: triple(b, 11),
            mag: triple(b, 17),
            temperature_ddeg: u16::from_le_bytes([b[23], b[24]]),
            pressure_pa: u32::from_le_bytes([b[25], b[26], b[27], b[28]]),
        }
    }

    /// The 30 bytes, beginning with `start`.
    #[must_use]
    pub fn emit(&self, start: u8) -> [u8; FRAME_LEN] {
        let mut out = [0; FRAME_LEN];
        out[0] = start;
        out[1..5].copy_from_slice(&self.since_previous_us.to_le_bytes());
        for (sensor, values) in [self.accel, self.gyro, self.mag].into_iter().enumerate() {
            for (axis, value) in values.into_iter().enumerate() {
                let at = 5 + 6 * sensor + 2 * axis;
                out[at..at + 2].copy_from_slice(&value.to_le_bytes());
            }
        }
        out[23..25].copy_from_slice(&self.temperature_ddeg.to_le_bytes());
        out[25..29].copy_from_slice(&self.pressure_pa.to_le_bytes());
        out[29] = END;
        out
    }

    /// True if temperature and pressure are what a BMP085 can send: at most 125 degC, and 30-110 kPa or 0 when it is switched off.
    /// With no checksum this is the only proof that 30 bytes between `A` and `Z` are a frame.
    #[must_use]
    pub const fn is_plausible(&self) -> bool {
        self.temperature_ddeg <= 1250
            && (self.pressure_pa == 0
                || (self.pressure_pa >= 30_000 && self.pressure_pa <= 110_000))
    }
}

/// The ten channels of a frame, or of several frames smoothed, still in wire units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Accelerometer, counts.
    pub accel: Vector3<f64>,
    /// Gyro, counts.
    pub gyro: Vector3<f64>,
    /// Magnetometer, counts.
    pub mag: Vector3<f64>,
    /// Temperature, 0.1 degC.
    pub temperature_ddeg: f64,
    /// Pressure, Pa.
    pub pressure_pa: f64,
}

impl Counts {
    /// Adds `weight` times another one.
    pub fn add_scaled(&mut self, other: &Self, weight: f64) {
        self.accel += other.accel * weight;
        self.gyro += other.gyro * weight;
        self.mag += other.mag * weight;
        self.temperature_ddeg += other.temperature_ddeg * weight;
        self.pressure_pa += other.pressure_pa * weight;
    }

    /// Every channel divided by `n`.
    #[must_use]
    pub fn divided(&self, n: f64) -> Self {
        Self {
            accel: self.accel / n,
            gyro: self.gyro / n,
            mag: self.mag / n,
            temperature_ddeg: self.temperature_ddeg / n,
            pressure_pa: self.pressure_pa / n,
        }
    }
}

impl From<&RawFrame> for Counts {
    fn from(f: &RawFrame) -> Self {
        let vector = |v: [i16; 3]| Vector3::from(v.map(f64::from));
        Self {
            accel: vector(f.accel),
            gyro: vector(f.gyro),
            mag: vector(f.mag),
            temperature_ddeg: f64::from(f.temperature_ddeg),
            pressure_pa: f64::from(f.pressure_pa),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_is_the_table_above() {
        let frame = RawFrame {
            since_previous_us: 0x0102_0304,
            accel: [1, -2, 300],
            gyro: [-1, 0, 1],
            mag: [-300, 2, 0x0506],
            temperature_ddeg: 250,
            pressure_pa: 101_202,
        };
        let bytes = frame.emit(START);
        assert_eq!(bytes[..7], [b'A', 4, 3, 2, 1, 1, 0]);
        assert_eq!(bytes[21..], [6, 5, 250, 0, 0x52, 0x8b, 1, 0, b'Z']);
        assert_eq!(RawFrame::parse(&bytes), frame);
    }
}
