//! LD06 (and LD19, STL-06P ...): 12 points a packet, sent by itself as soon as it has power.
//!
//! | Bytes | What |
//! | --- | --- |
//! | 0 | 0x54 |
//! | 1 | 0x2C: packet type 1, 12 points |
//! | 2-3 | speed, degrees/s |
//! | 4-5 | angle of the first point, 0.01 degrees, clockwise seen from above |
//! | 6-41 | 12 points: distance in mm (0 = no return), intensity |
//! | 42-43 | angle of the last point |
//! | 44-45 | milliseconds, from 0 again at 30000 |
//! | 46 | CRC-8, polynomial 0x4D, of all before |
//!
//! Little endian, 230400 baud. Source: LD06 development manual. Its own milliseconds tell a frozen unit: packets whose clock
//! stands still are not measurements.

use super::WireTime;
use super::circle::{Circle, Mount, Point};
use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::{RangerReading, Timestamp};

/// Baud of its line.
pub const BAUD: u32 = 230_400;
/// Bytes of a packet.
pub const PACKET: usize = 47;
/// What it can measure, m (data sheet: 0.02 to 12; nearer than 0.15 are propellers).
pub const RANGE_M: [f64; 2] = [0.15, 12.0];
/// Turns a second.
pub const RATE_HZ: f64 = 10.0;
const POINTS: usize = 12;
const HEAD: [u8; 2] = [0x54, 0x2C];
/// Degrees/s beyond which a packet is believed to be garbage with a lucky checksum: 2 to 20 turns a second.
const SPEEDS_DPS: core::ops::RangeInclusive<u16> = 720..=7200;
/// The clock may repeat for packets of the same millisecond, but not for more than this many.
const SAME_CLOCK: u32 = 4;

/// CRC-8 with polynomial 0x4D, most significant bit first, start 0.
#[must_use]
pub fn crc8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| {
            if crc & 0x80 == 0 {
                crc << 1
            } else {
                (crc << 1) ^ 0x4D
            }
        })
    })
}

/// What was seen on the line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Whole packets.
    pub packets: u64,
    /// Packets with a wrong checksum or an impossible speed.
    pub bad: u64,
    /// Packets whose clock stood still.
    pub frozen: u64,
}

/// The driver.
#[derive(Clone, Debug)]
pub struct Ld06 {
    circle: Circle,
    wire: WireTime,
    /// Points with a weaker echo are dust and sunlight.
    least_intensity: u8,
    packet: ArrayVec<u8, PACKET>,
    clock: Option<u16>,
    same_clock: u32,
    counters: Counters,
}

impl Ld06 {
    /// For a lidar whose first ranger has this index in the ring.
    #[must_use]
    pub fn new(mount: Mount, first_ranger: u8, baud: u32, least_intensity: u8) -> Self {
        Self {
            circle: Circle::new(mount, first_ranger),
            wire: WireTime::of_baud(baud),
            least_intensity,
            packet: ArrayVec::new(),
            clock: None,
            same_clock: 0,
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
            let _ = self.packet.try_push(*byte);
            self.align();
            if self.packet.is_full() {
                let complete = self.wire.complete(at, bytes.len() - 1 - i);
                if crc8(&self.packet[..PACKET - 1]) == self.packet[PACKET - 1] {
                    self.whole(complete, out);
                    self.packet.clear();
                } else {
                    self.counters.bad += 1;
                    // A head may begin inside.
                    self.packet.remove(0);
                    self.align();
                }
            }
        }
    }

    /// Drops what cannot be the beginning of a packet.
    fn align(&mut self) {
        let start = (0..self.packet.len())
            .find(|i| {
                let rest = &self.packet[*i..];
                let n = rest.len().min(HEAD.len());
                rest[..n] == HEAD[..n]
            })
            .unwrap_or(self.packet.len());
        self.packet.drain(..start);
    }

    fn whole(&mut self, complete: Timestamp, out: &mut impl FnMut(RangerReading)) {
        let word = |at: usize| u16::from_le_bytes([self.packet[at], self.packet[at + 1]]);
        let (speed_dps, first_cdeg, last_cdeg, clock) = (word(2), word(4), word(42), word(44));
        if !SPEEDS_DPS.contains(&speed_dps) || first_cdeg >= 36_000 || last_cdeg >= 36_000 {
            self.counters.bad += 1;
            return;
        }
        self.same_clock = match self.clock {
            Some(then) if then == clock => self.same_clock + 1,
            _ => 0,
        };
        self.clock = Some(clock);
        if self.same_clock >= SAME_CLOCK {
            self.counters.frozen += 1;
            return;
        }
        self.counters.packets += 1;
        let span_cdeg = (u32::from(last_cdeg) + 36_000 - u32::from(first_cdeg)) % 36_000;
        let span_deg = f64::from(span_cdeg) * 0.01;
        let step_deg = span_deg / (POINTS - 1) as f64;
        let step = Duration::from_secs_f64(step_deg / f64::from(speed_dps));
        let last_at = complete - self.wire.of(PACKET as u32);
        for i in 0..POINTS {
            let place = 6 + 3 * i;
            let mm = word(place);
            let is_return = mm > 0 && self.packet[place + 2] >= self.least_intensity;
            let point = Point {
                at: last_at - step * (POINTS - 1 - i) as u32,
                angle_rad: (f64::from(first_cdeg) * 0.01 + step_deg * i as f64).to_radians(),
                distance_mm: is_return.then_some(mm),
            };
            self.circle.add(&point, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The example of the maker's manual.
    const EXAMPLE: [u8; PACKET] = [
        0x54, 0x2C, 0x68, 0x08, 0xAB, 0x7E, 0xE0, 0x00, 0xE4, 0xDC, 0x00, 0xE2, 0xD9, 0x00, 0xE5,
        0xD5, 0x00, 0xE3, 0xD3, 0x00, 0xE4, 0xD0, 0x00, 0xE9, 0xCD, 0x00, 0xE4, 0xCA, 0x00, 0xE2,
        0xC7, 0x00, 0xE9, 0xC5, 0x00, 0xE5, 0xC2, 0x00, 0xE5, 0xC0, 0x00, 0xE5, 0xBE, 0x82, 0x3A,
        0x1A, 0x50,
    ];

    fn lidar() -> Ld06 {
        Ld06::new(Mount::new("l", RANGE_M, RATE_HZ), 0, BAUD, 0)
    }

    #[test]
    fn the_checksum_of_the_manuals_example_is_its_last_byte() {
        assert_eq!(crc8(&EXAMPLE[..PACKET - 1]), EXAMPLE[PACKET - 1]);
    }

    /// A turn of packets, 3600 degrees/s, as the manual describes them.
    fn turn(first_ms: u16, mm: u16) -> Vec<u8> {
        let mut out = Vec::new();
        for packet in 0..38u16 {
            let first_cdeg = packet * 960 % 36_000;
            let last_cdeg = (first_cdeg + 880) % 36_000;
            let mut p = vec![0x54, 0x2C];
            p.extend(3600u16.to_le_bytes());
            p.extend(first_cdeg.to_le_bytes());
            for _ in 0..12 {
                p.extend(mm.to_le_bytes());
                p.push(200);
            }
            p.extend(last_cdeg.to_le_bytes());
            p.extend(((first_ms + packet * 8 / 3) % 30_000).to_le_bytes());
            p.push(crc8(&p));
            out.extend(p);
        }
        out
    }

    #[test]
    fn two_turns_cut_anywhere_give_the_same_ring() {
        let bytes = [turn(0, 1500), turn(100, 1500)].concat();
        let whole = {
            let mut out = Vec::new();
            lidar().bytes(Timestamp::from_ms(1000), &bytes, &mut |r| {
                out.push((r.ranger, r.columns_mm))
            });
            out
        };
        assert!(
            whole.len() >= 19
                && whole
                    .iter()
                    .all(|(_, c)| c.iter().all(|mm| *mm == Some(1500)))
        );
        for size in [1, 7, 46, 47, 48, 100] {
            let (mut cut, mut l) = (Vec::new(), lidar());
            for chunk in bytes.chunks(size) {
                l.bytes(Timestamp::from_ms(1000), chunk, &mut |r| {
                    cut.push((r.ranger, r.columns_mm))
                });
            }
            assert_eq!(cut, whole, "chunks of {size}");
        }
    }

    #[test]
    fn a_point_is_as_old_as_its_place_in_the_chunk_says() {
        let bytes = turn(0, 1500);
        let mut out = Vec::new();
        lidar().bytes(Timestamp::from_ms(1000), &bytes, &mut |r| out.push(r.at));
        // 38 packets of 47 bytes at 230400 baud take 77.5 ms: the first part is that much older than the last.
        let span = out[out.len() - 1].since(out[0]);
        assert!((60..90).contains(&span.as_millis()), "{span:?}");
        assert!(out[out.len() - 1] < Timestamp::from_ms(1000));
    }

    #[test]
    fn a_flipped_bit_costs_its_packet_and_noise_before_it_nothing() {
        let mut bytes = vec![0x54, 0x2C, 0x54, 0x00, 0x54];
        bytes.extend(turn(0, 1500));
        bytes[5 + 47 * 3 + 9] ^= 4;
        let mut l = lidar();
        l.bytes(Timestamp::from_ms(1000), &bytes, &mut |_| {});
        // The head in the noise swallows nothing but itself.
        assert_eq!(
            l.counters(),
            Counters {
                packets: 37,
                bad: l.counters().bad,
                frozen: 0
            }
        );
        assert!((1..=3).contains(&l.counters().bad), "{:?}", l.counters());
    }

    #[test]
    fn a_unit_whose_clock_stands_still_falls_silent() {
        let mut l = lidar();
        let mut readings = 0;
        for _ in 0..100 {
            l.bytes(Timestamp::from_ms(1000), &EXAMPLE, &mut |_| readings += 1);
        }
        assert_eq!((l.counters().packets, readings), (4, 0));
        assert_eq!(l.counters().frozen, 96);
    }

    proptest! {
        #[test]
        fn no_bytes_panic_and_a_whole_turn_after_them_is_still_read(
            noise in proptest::collection::vec(prop_oneof![Just(0x54u8), Just(0x2Cu8), any::<u8>()], 0..300)
        ) {
            let mut l = lidar();
            l.bytes(Timestamp::from_ms(500), &noise, &mut |_| {});
            let before = l.counters().packets;
            l.bytes(Timestamp::from_ms(1000), &turn(0, 900), &mut |_| {});
            prop_assert!(l.counters().packets >= before + 37, "{:?}", l.counters());
        }
    }
}
