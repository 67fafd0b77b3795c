//! RPLIDAR A1: silent until it is told to scan, then 5 bytes a point for ever, at 115200 baud.
//!
//! SLAMTEC interface protocol: stop `A5 25`, reset `A5 40`, health `A5 52`, scan `A5 20`.

use super::{LaserMount, Turntable};
use crate::noise::Noise;
use crate::sensor::View;
use vehicle::Timestamp;

const POINTS_HZ: f64 = 2000.0;
const TURNS_HZ: f64 = 5.5;
const MAX_M: f64 = 12.0;
const QUALITY: u8 = 15;

/// The lidar.
#[derive(Clone, Debug)]
pub(crate) struct Rplidar {
    table: Turntable,
    is_scanning: bool,
    last_deg: f64,
    heard: Vec<u8>,
    answer: Vec<u8>,
}

impl Rplidar {
    pub(super) fn new(mount: LaserMount, noise: Noise) -> Self {
        Self {
            table: Turntable::new(mount, POINTS_HZ, TURNS_HZ, MAX_M, noise),
            is_scanning: false,
            last_deg: 360.0,
            heard: Vec::new(),
            answer: Vec::new(),
        }
    }

    pub(super) fn write(&mut self, now: Timestamp, bytes: &[u8]) {
        for byte in bytes {
            self.heard.push(*byte);
            match self.heard[..] {
                [0xA5] => continue,
                [0xA5, 0x25] => self.is_scanning = false,
                [0xA5, 0x40] => {
                    self.is_scanning = false;
                    self.answer.extend(b"RP LIDAR System.\r\n");
                }
                [0xA5, 0x52] => self.answer.extend([0xA5, 0x5A, 3, 0, 0, 0, 6, 0, 0, 0]),
                [0xA5, 0x20] => {
                    self.answer.extend([0xA5, 0x5A, 5, 0, 0, 0x40, 0x81]);
                    self.is_scanning = true;
                    self.last_deg = 360.0;
                    self.table.skip_to(now);
                }
                _ => {}
            }
            self.heard.clear();
        }
    }

    pub(super) fn step(&mut self, now: Timestamp, view: &View<'_>, out: &mut Vec<u8>) {
        out.append(&mut self.answer);
        if !self.is_scanning {
            return;
        }
        let last_deg = &mut self.last_deg;
        self.table.turn(now, view, |_, point| {
            let is_first = point.angle_deg < *last_deg;
            *last_deg = point.angle_deg;
            let marks = if is_first { 0b01 } else { 0b10 };
            let quality = if point.distance_m.is_some() {
                QUALITY
            } else {
                0
            };
            out.push(quality << 2 | marks);
            let angle = (point.angle_deg * 64.0) as u16;
            out.extend((angle << 1 | 1).to_le_bytes());
            let quarters = point.distance_m.map_or(0, |m| libm::round(m * 4e3) as u16);
            out.extend(quarters.to_le_bytes());
        });
    }
}
