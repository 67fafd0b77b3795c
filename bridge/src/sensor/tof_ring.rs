//! A ring of multizone time-of-flight sensors (VL53L5CX class) behind a small microcontroller on a serial line.
//!
//! The sensors themselves need a firmware image of their maker at every start, which is not ours to give away; a
//! microcontroller with the maker's library reads them and sends what they measured in this frame (docs/sensors.md has the
//! program):
//!
//! | Bytes | What |
//! | --- | --- |
//! | 0-1 | `K` `R` |
//! | 2 | what follows: 1 = depths of columns, left-most seen from the sensor first; 2 = 64 zones of an 8 x 8 sensor, row by row |
//! | 3 | n, number of values: 1..=8 or 64 |
//! | 4 | number of the sensor, from 0 |
//! | 5 | count of its firings |
//! | 6-7 | age of the measurement when this frame begins to leave, 0.1 ms |
//! | 8.. | n depths along the sensor's axis, mm, 0xFFFF = no valid return |
//! | 8+2n.. | CRC-16/CCITT-FALSE of bytes 2 to 7+2n |
//!
//! Little endian. Of 64 zones a column is the nearer of its two middle rows: the others look at floor and ceiling. A count
//! that stands still is a frozen sensor: its frames are not measurements.

use super::WireTime;
use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::sample::MAX_COLUMNS;
use vehicle::{RangerReading, Timestamp};

/// Baud of its line.
pub const BAUD: u32 = 460_800;
/// Bytes of the longest frame.
const LONGEST: usize = HEAD + 2 * 64 + 2;
const HEAD: usize = 8;
const NONE: u16 = 0xFFFF;
/// Sensors of a ring.
const SENSORS: usize = 16;
/// A count may come twice (a frame sent again), not more often.
const SAME_COUNT: u8 = 2;

/// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF.
#[must_use]
pub fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc: u16, _| {
            if crc & 0x8000 == 0 {
                crc << 1
            } else {
                (crc << 1) ^ 0x1021
            }
        })
    })
}

/// What was seen on the line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Whole frames.
    pub frames: u64,
    /// Frames with a wrong checksum.
    pub bad: u64,
    /// Frames of sensors that the ring does not have, or whose count stood still.
    pub refused: u64,
}

/// The driver.
#[derive(Clone, Debug)]
pub struct TofRing {
    wire: WireTime,
    first_ranger: u8,
    /// Columns of each sensor of the ring.
    columns: ArrayVec<u8, SENSORS>,
    counts: [Option<(u8, u8)>; SENSORS],
    frame: ArrayVec<u8, LONGEST>,
    counters: Counters,
}

impl TofRing {
    /// For sensors that are the rangers from this index on, with their columns.
    #[must_use]
    pub fn new(first_ranger: u8, columns: &[u8], baud: u32) -> Self {
        Self {
            wire: WireTime::of_baud(baud),
            first_ranger,
            columns: columns.iter().copied().take(SENSORS).collect(),
            counts: [None; SENSORS],
            frame: ArrayVec::new(),
            counters: Counters::default(),
        }
    }

    /// What was seen on the line.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Takes bytes that were read at a time.
    pub fn bytes(&mut self, at: Timestamp, bytes: &[u8], out: &mut impl FnMut(RangerReading)) {
        for (i, byte) in bytes.iter().enumerate() {
            self.frame.push(*byte);
            // A wrong frame gives its bytes back: a whole one may be among them.
            loop {
                self.align();
                let Some(length) = self.length().filter(|n| self.frame.len() >= *n) else {
                    break;
                };
                let (body, crc) = self.frame[2..length].split_at(length - 4);
                if crc16(body).to_le_bytes() == *crc {
                    let after = bytes.len() - 1 - i + (self.frame.len() - length);
                    self.whole(self.wire.complete(at, after), length, out);
                    self.frame.drain(..length);
                } else {
                    self.counters.bad += 1;
                    self.frame.remove(0);
                }
            }
        }
    }

    /// Bytes of the frame that has begun, when its head tells.
    fn length(&self) -> Option<usize> {
        let n = *self.frame.get(3)?;
        Some(HEAD + 2 * usize::from(n) + 2)
    }

    fn align(&mut self) {
        let is_head = |b: &[u8]| {
            let fits = match (b.get(2), b.get(3)) {
                (Some(1), Some(n)) => (1..=MAX_COLUMNS as u8).contains(n),
                (Some(2), Some(n)) => *n == 64,
                (Some(1 | 2) | None, None) => true,
                _ => false,
            };
            b.first().is_none_or(|b| *b == b'K') && b.get(1).is_none_or(|b| *b == b'R') && fits
        };
        let start = (0..self.frame.len())
            .find(|i| is_head(&self.frame[*i..]))
            .unwrap_or(self.frame.len());
        self.frame.drain(..start);
    }

    fn whole(&mut self, complete: Timestamp, length: usize, out: &mut impl FnMut(RangerReading)) {
        self.counters.frames += 1;
        let (kind, sensor, count) = (self.frame[2], usize::from(self.frame[4]), self.frame[5]);
        let age = Duration::from_micros(
            100 * u64::from(u16::from_le_bytes([self.frame[6], self.frame[7]])),
        );
        let mut values = self.frame[HEAD..length - 2]
            .chunks_exact(2)
            .map(|b| Some(u16::from_le_bytes([b[0], b[1]])).filter(|mm| *mm != NONE && *mm > 0));
        let columns_mm: ArrayVec<Option<u16>, MAX_COLUMNS> = if kind == 1 {
            values.collect()
        } else {
            let mut zones = [None; 64];
            zones.iter_mut().for_each(|z| *z = values.next().flatten());
            (0..MAX_COLUMNS)
                .map(|c| zones[24 + c].into_iter().chain(zones[32 + c]).min())
                .collect()
        };
        let Some(slot) = self.counts.get_mut(sensor) else {
            self.counters.refused += 1;
            return;
        };
        let repeats = match *slot {
            Some((last, repeats)) if last == count => repeats.saturating_add(1),
            _ => 0,
        };
        *slot = Some((count, repeats));
        if repeats >= SAME_COUNT || self.columns.get(sensor) != Some(&(columns_mm.len() as u8)) {
            self.counters.refused += 1;
            return;
        }
        out(RangerReading {
            at: complete - self.wire.of(length as u32) - age,
            ranger: self.first_ranger + sensor as u8,
            columns_mm,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(kind: u8, sensor: u8, count: u8, age: u16, values: &[u16]) -> Vec<u8> {
        let mut f = vec![b'K', b'R', kind, values.len() as u8, sensor, count];
        f.extend(age.to_le_bytes());
        f.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        let crc = crc16(&f[2..]);
        f.extend(crc.to_le_bytes());
        f
    }

    fn ring() -> TofRing {
        TofRing::new(2, &[8; 4], BAUD)
    }

    fn read(ring: &mut TofRing, bytes: &[u8]) -> Vec<RangerReading> {
        let mut out = Vec::new();
        ring.bytes(Timestamp::from_ms(1000), bytes, &mut |r| out.push(r));
        out
    }

    #[test]
    fn the_checksum_is_the_one_everybody_has() {
        assert_eq!(crc16(b"123456789"), 0x29B1);
    }

    #[test]
    fn a_golden_frame_gives_its_columns_and_its_time() {
        let golden = [
            b'K', b'R', 1, 8, 3, 7, 100, 0, 0xE8, 3, 0xFF, 0xFF, 0xE8, 3, 0xE8, 3, 0xE8, 3, 0xE8,
            3, 0xE8, 3, 0xD0, 7, 0xFF, 0x6F,
        ];
        let mut expected = [Some(1000); 8];
        (expected[1], expected[7]) = (None, Some(2000));
        let made = frame(
            1,
            3,
            7,
            100,
            &[1000, NONE, 1000, 1000, 1000, 1000, 1000, 2000],
        );
        assert_eq!(made, golden);
        let out = read(&mut ring(), &made);
        assert_eq!(out[0].ranger, 5);
        assert_eq!(out[0].columns_mm[..], expected);
        // 26 bytes at 460800 baud are 0.56 ms, and 10 ms of age.
        let age = Timestamp::from_ms(1000).since(out[0].at);
        assert!((10_500..10_600).contains(&age.as_micros()), "{age:?}");
    }

    #[test]
    fn of_64_zones_the_two_middle_rows_count() {
        let mut zones = [500u16; 64];
        for c in 0..8 {
            zones[24 + c] = 2000 + c as u16;
            zones[32 + c] = 1900;
        }
        zones[32] = NONE;
        let out = read(&mut ring(), &frame(2, 0, 1, 0, &zones));
        assert_eq!(out[0].columns_mm[..2], [Some(2000), Some(1900)]);
    }

    #[test]
    fn a_sensor_that_does_not_count_on_is_frozen_and_an_unknown_one_is_nobody() {
        let mut ring = ring();
        let still = frame(1, 0, 9, 0, &[1000; 8]);
        let n: usize = (0..20).map(|_| read(&mut ring, &still).len()).sum();
        assert_eq!(n, 2);
        assert!(read(&mut ring, &frame(1, 4, 0, 0, &[1000; 8])).is_empty());
        assert!(read(&mut ring, &frame(1, 1, 0, 0, &[1000; 4])).is_empty());
        assert_eq!(ring.counters().refused, 18 + 2);
        assert_eq!(read(&mut ring, &frame(1, 0, 10, 0, &[1000; 8])).len(), 1);
    }

    proptest! {
        #[test]
        fn any_noise_between_frames_costs_no_frame(
            noise in proptest::collection::vec(proptest::collection::vec(
                prop_oneof![Just(b'K'), Just(b'R'), Just(1u8), Just(2u8), Just(8u8), any::<u8>()], 0..40), 5),
            size in 1usize..60,
        ) {
            let mut bytes = Vec::new();
            for (i, noise) in noise.iter().enumerate() {
                bytes.extend(noise);
                bytes.extend(frame(1, 0, i as u8, 0, &[1000 + i as u16; 8]));
            }
            // What was taken for a head waits for its end.
            bytes.extend([0; LONGEST]);
            let mut ring = ring();
            let mut out = Vec::new();
            for chunk in bytes.chunks(size) {
                out.extend(read(&mut ring, chunk));
            }
            let first: Vec<_> = out.iter().map(|r| r.columns_mm[0]).collect();
            for i in 0..5 {
                prop_assert!(first.contains(&Some(1000 + i)), "{first:?}");
            }
        }
    }
}
