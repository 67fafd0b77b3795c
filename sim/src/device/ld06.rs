//! LD06: packets of 12 points, unasked, at 230400 baud.
//!
//! `54 2C`, speed (degrees/s), angle of the first point (0.01 degrees), 12 times distance (mm) and intensity, angle of the last point,
//! milliseconds (from 0 again at 30000), CRC-8 with polynomial 0x4D. LD06 development manual.

use super::{LaserMount, Point, Turntable};
use crate::noise::Noise;
use crate::sensor::View;
use vehicle::Timestamp;

const POINTS_HZ: f64 = 4500.0;
const TURNS_HZ: f64 = 10.0;
const MAX_M: f64 = 12.0;
const POINTS: usize = 12;

/// The lidar.
#[derive(Clone, Debug)]
pub(crate) struct Ld06 {
    table: Turntable,
    points: Vec<Point>,
}

impl Ld06 {
    pub(super) fn new(mount: LaserMount, noise: Noise) -> Self {
        Self {
            table: Turntable::new(mount, POINTS_HZ, TURNS_HZ, MAX_M, noise),
            points: Vec::with_capacity(POINTS),
        }
    }

    pub(super) fn step(&mut self, now: Timestamp, view: &View<'_>, out: &mut Vec<u8>) {
        let points = &mut self.points;
        self.table.turn(now, view, |at, point| {
            points.push(point);
            if points.len() == POINTS {
                packet(at, points, out);
                points.clear();
            }
        });
    }
}

/// One packet.
fn packet(at: Timestamp, points: &[Point], out: &mut Vec<u8>) {
    let from = out.len();
    let angle = |p: &Point| (libm::round(p.angle_deg * 100.0) as u16 % 36_000).to_le_bytes();
    out.extend([0x54, 0x2C]);
    out.extend(((TURNS_HZ * 360.0) as u16).to_le_bytes());
    out.extend(angle(&points[0]));
    for point in points {
        let mm = point.distance_m.map_or(0, |m| libm::round(m * 1e3) as u16);
        out.extend(mm.to_le_bytes());
        out.push(if mm > 0 { 200 } else { 0 });
    }
    out.extend(angle(&points[POINTS - 1]));
    out.extend(((at.us() / 1000 % 30_000) as u16).to_le_bytes());
    let mut crc = 0u8;
    for byte in &out[from..] {
        crc ^= byte;
        for _ in 0..8 {
            crc = if crc & 0x80 == 0 {
                crc << 1
            } else {
                (crc << 1) ^ 0x4D
            };
        }
    }
    out.push(crc);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the manual, made from what it means.
    #[test]
    fn the_manuals_example_has_its_checksum() {
        let head = [
            0x54u8, 0x2C, 0x68, 0x08, 0xAB, 0x7E, 0xE0, 0x00, 0xE4, 0xDC, 0x00, 0xE2, 0xD9, 0x00,
            0xE5, 0xD5, 0x00, 0xE3, 0xD3, 0x00, 0xE4, 0xD0, 0x00, 0xE9, 0xCD, 0x00, 0xE4, 0xCA,
            0x00, 0xE2, 0xC7, 0x00, 0xE9, 0xC5, 0x00, 0xE5, 0xC2, 0x00, 0xE5, 0xC0, 0x00, 0xE5,
            0xBE, 0x82, 0x3A, 0x1A,
        ];
        let crc = head.iter().fold(0u8, |crc, byte| {
            (0..8).fold(crc ^ byte, |c, _| {
                if c & 0x80 == 0 {
                    c << 1
                } else {
                    (c << 1) ^ 0x4D
                }
            })
        });
        assert_eq!(crc, 0x50);
        let points = [Point {
            angle_deg: 324.27,
            distance_m: Some(0.224),
        }; POINTS];
        let mut out = Vec::new();
        packet(Timestamp::from_ms(6714), &points, &mut out);
        assert_eq!(
            (out.len(), &out[4..8], &out[44..46]),
            (47, &head[4..8], &head[44..46])
        );
    }
}
