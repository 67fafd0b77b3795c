//! RPLIDAR A1 (and A2, A3 in the same mode): standard scan, asked for by us.
//!
//! | We say | It says |
//! | --- | --- |
//! | `A5 25` stop | nothing; 10 ms later it listens again |
//! | `A5 52` health | `A5 5A 03 00 00 00 06`, then status (0 good, 1 warning, 2 error) and a 16-bit code |
//! | `A5 40` reset | a greeting in text, after a second |
//! | `A5 20` scan | `A5 5A 05 00 00 40 81`, then a point in 5 bytes for ever |
//!
//! A point: bit 0 of byte 0 is set for the first of a turn, bit 1 is its opposite, the rest is quality; bit 0 of byte 1 is
//! always set, the other 15 bits of bytes 1 and 2 are the angle in 1/64 degree, clockwise seen from above; bytes 3 and 4 are the
//! distance in 1/4 mm, 0 without a return. There is no checksum: after a break points count only when four in a row have
//! their fixed bits right. Source: SLAMTEC interface protocol and application notes, A1 series.
//!
//! The motor of the A1's USB adapter runs while DTR is low; `io/sensors.rs` sees to that.

use super::WireTime;
use super::circle::{Circle, Mount, Point};
use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::{RangerReading, Timestamp};

/// Baud of the A1's line (A2M7, A3: 256000).
pub const BAUD: u32 = 115_200;
/// What it can measure, m.
pub const RANGE_M: [f64; 2] = [0.15, 12.0];
/// Turns a second.
pub const RATE_HZ: f64 = 5.5;
const STOP: [u8; 2] = [0xA5, 0x25];
const HEALTH: [u8; 2] = [0xA5, 0x52];
const RESET: [u8; 2] = [0xA5, 0x40];
const SCAN: [u8; 2] = [0xA5, 0x20];
const HEALTH_FOLLOWS: [u8; 7] = [0xA5, 0x5A, 0x03, 0, 0, 0, 0x06];
const SCAN_FOLLOWS: [u8; 7] = [0xA5, 0x5A, 0x05, 0, 0, 0x40, 0x81];
/// Points in a row with their fixed bits right before they count.
const TRUSTED: u32 = 4;
/// Between stop and the next word.
const PAUSE: Duration = Duration::from_millis(20);
/// An answer that has not come after this does not come.
const PATIENCE: Duration = Duration::from_millis(1500);
/// A reset takes this long.
const RESTING: Duration = Duration::from_millis(2000);

/// Where the conversation is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Nothing was said yet.
    New,
    /// Stop was said.
    Stopping,
    /// Health was asked for.
    Asking,
    /// The answer's three bytes come.
    Health,
    /// Reset was said.
    Resetting,
    /// Scan was said.
    Starting,
    /// Points come.
    Scanning,
}

/// What was seen on the line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Points with their fixed bits right.
    pub points: u64,
    /// Bytes skipped to find the next point.
    pub skipped: u64,
    /// Times the conversation was begun anew.
    pub restarts: u64,
    /// Code of the last error it told, 0 none.
    pub error: u16,
}

/// The driver.
#[derive(Clone, Debug)]
pub struct Rplidar {
    circle: Circle,
    wire: WireTime,
    phase: Phase,
    since: Timestamp,
    /// When a point came last.
    heard: Timestamp,
    buffer: ArrayVec<u8, 7>,
    trusted: u32,
    counters: Counters,
}

impl Rplidar {
    /// For a lidar whose first ranger has this index in the ring.
    #[must_use]
    pub fn new(mount: Mount, first_ranger: u8, baud: u32) -> Self {
        Self {
            circle: Circle::new(mount, first_ranger),
            wire: WireTime::of_baud(baud),
            phase: Phase::New,
            since: Timestamp::ZERO,
            heard: Timestamp::ZERO,
            buffer: ArrayVec::new(),
            trusted: 0,
            counters: Counters::default(),
        }
    }

    /// What was seen on the line.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// The line was opened (again): the conversation begins anew.
    pub fn opened(&mut self, now: Timestamp) {
        self.enter(now, Phase::New);
    }

    fn enter(&mut self, now: Timestamp, phase: Phase) {
        self.phase = phase;
        self.since = now;
        self.buffer.clear();
        self.trusted = 0;
    }

    /// What is to be said now, if anything. Call again after some 10 ms, however often.
    pub fn poll(&mut self, now: Timestamp) -> Option<[u8; 2]> {
        let waited = now.since(self.since);
        let (phase, word) = match self.phase {
            Phase::New => (Phase::Stopping, STOP),
            Phase::Stopping if waited >= PAUSE => (Phase::Asking, HEALTH),
            Phase::Resetting if waited >= RESTING => (Phase::Asking, HEALTH),
            Phase::Asking | Phase::Health | Phase::Starting if waited >= PATIENCE => {
                self.counters.restarts += 1;
                (Phase::Stopping, STOP)
            }
            Phase::Scanning if now.since(self.heard) >= PATIENCE => {
                self.counters.restarts += 1;
                (Phase::Stopping, STOP)
            }
            _ => return None,
        };
        self.enter(now, phase);
        Some(word)
    }

    /// Takes bytes that were read at a time; tells what is to be said in answer.
    pub fn bytes(
        &mut self,
        at: Timestamp,
        bytes: &[u8],
        out: &mut impl FnMut(RangerReading),
    ) -> Option<[u8; 2]> {
        let mut answer = None;
        for (i, byte) in bytes.iter().enumerate() {
            if self.buffer.is_full() {
                self.buffer.remove(0);
            }
            self.buffer.push(*byte);
            match self.phase {
                Phase::New | Phase::Stopping | Phase::Resetting => self.buffer.clear(),
                Phase::Asking if self.buffer[..] == HEALTH_FOLLOWS => {
                    self.enter(at, Phase::Health);
                }
                Phase::Health if self.buffer.len() == 3 => {
                    let is_well = self.buffer[0] < 2;
                    self.counters.error = u16::from_le_bytes([self.buffer[1], self.buffer[2]]);
                    let (phase, word) = if is_well {
                        (Phase::Starting, SCAN)
                    } else {
                        (Phase::Resetting, RESET)
                    };
                    self.enter(at, phase);
                    answer = Some(word);
                }
                Phase::Starting if self.buffer[..] == SCAN_FOLLOWS => {
                    self.enter(at, Phase::Scanning);
                    self.heard = at;
                }
                Phase::Scanning => {
                    let complete = self.wire.complete(at, bytes.len() - 1 - i);
                    self.point(complete, out);
                }
                Phase::Asking | Phase::Health | Phase::Starting => {}
            }
        }
        answer
    }

    fn point(&mut self, complete: Timestamp, out: &mut impl FnMut(RangerReading)) {
        let is_marked = |b: &[u8]| {
            b.first().is_none_or(|b| (b ^ (b >> 1)) & 1 == 1) && b.get(1).is_none_or(|b| b & 1 == 1)
        };
        while !is_marked(&self.buffer) {
            self.buffer.remove(0);
            self.counters.skipped += 1;
            self.trusted = 0;
        }
        let [_, b1, b2, b3, b4] = self.buffer[..] else {
            return;
        };
        self.buffer.clear();
        self.counters.points += 1;
        self.trusted = self.trusted.saturating_add(1);
        if self.trusted < TRUSTED {
            return;
        }
        self.heard = complete;
        let angle_64th = u16::from_le_bytes([b1, b2]) >> 1;
        let quarter_mm = u16::from_le_bytes([b3, b4]);
        let point = Point {
            at: complete - self.wire.of(5),
            angle_rad: (f64::from(angle_64th) / 64.0).to_radians(),
            distance_mm: (quarter_mm > 0).then_some((quarter_mm + 2) / 4),
        };
        self.circle.add(&point, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    fn lidar() -> Rplidar {
        Rplidar::new(Mount::new("l", RANGE_M, RATE_HZ), 0, BAUD)
    }

    fn node(is_first: bool, deg: f64, mm: u16) -> [u8; 5] {
        let s = u8::from(is_first);
        let angle = ((deg * 64.0) as u16) << 1 | 1;
        let [a0, a1] = angle.to_le_bytes();
        let [d0, d1] = (mm * 4).to_le_bytes();
        [47 << 2 | (1 - s) << 1 | s, a0, a1, d0, d1]
    }

    fn turns(n: u32, mm: u16) -> Vec<u8> {
        (0..360 * n)
            .flat_map(|i| node(i % 360 == 0, f64::from(i % 360), mm))
            .collect()
    }

    fn to_scanning(l: &mut Rplidar) {
        assert_eq!(l.poll(at(0)), Some(STOP));
        assert_eq!(l.poll(at(10)), None);
        assert_eq!(l.poll(at(20)), Some(HEALTH));
        let mut healthy = HEALTH_FOLLOWS.to_vec();
        healthy.extend([0, 0, 0]);
        assert_eq!(l.bytes(at(25), &healthy, &mut |_| {}), Some(SCAN));
        assert_eq!(l.bytes(at(30), &SCAN_FOLLOWS, &mut |_| {}), None);
        assert_eq!(l.phase, Phase::Scanning);
    }

    #[test]
    fn stopped_asked_started_it_scans() {
        let mut l = lidar();
        to_scanning(&mut l);
        let mut out = Vec::new();
        for chunk in turns(2, 1234).chunks(64) {
            l.bytes(at(100), chunk, &mut |r| out.push(r));
        }
        assert!(out.len() >= 18, "{}", out.len());
        // The first part lacks the points it was not yet trusted for.
        assert!(
            out.iter()
                .all(|r| r.columns_mm.iter().all(|c| *c == Some(1234)))
        );
        assert_eq!(l.counters().skipped, 0);
    }

    #[test]
    fn an_error_is_reset_and_asked_again() {
        let mut l = lidar();
        l.poll(at(0));
        l.poll(at(20));
        let mut ill = HEALTH_FOLLOWS.to_vec();
        ill.extend([2, 0x34, 0x12]);
        assert_eq!(l.bytes(at(25), &ill, &mut |_| {}), Some(RESET));
        assert_eq!(l.counters().error, 0x1234);
        assert_eq!(l.poll(at(1000)), None);
        assert_eq!(l.poll(at(2030)), Some(HEALTH));
    }

    #[test]
    fn whoever_is_silent_is_stopped_and_asked_again_for_ever() {
        let mut l = lidar();
        let mut said = Vec::new();
        for ms in (0..6000).step_by(10) {
            said.extend(l.poll(at(ms)));
        }
        assert_eq!(
            said,
            [STOP, HEALTH, STOP, HEALTH, STOP, HEALTH, STOP, HEALTH]
        );
        let mut l = lidar();
        to_scanning(&mut l);
        l.bytes(at(100), &turns(1, 1000), &mut |_| {});
        assert_eq!(l.poll(at(1500)), None);
        assert_eq!(l.poll(at(1700)), Some(STOP));
        assert_eq!(l.counters().restarts, 1);
    }

    #[test]
    fn a_lost_byte_costs_some_points_and_no_wrong_length() {
        let mut bytes = turns(3, 1234);
        bytes.remove(1777);
        let mut l = lidar();
        to_scanning(&mut l);
        let mut wrong = 0;
        for chunk in bytes.chunks(50) {
            l.bytes(at(100), chunk, &mut |r| {
                wrong += r.columns_mm.iter().filter(|c| **c != Some(1234)).count();
            });
        }
        assert_eq!(wrong, 0);
        assert!(l.counters().points > 1070, "{:?}", l.counters());
    }

    proptest! {
        #[test]
        fn no_bytes_at_any_time_panic(
            script in proptest::collection::vec((proptest::collection::vec(any::<u8>(), 0..40), 0u64..900), 0..40)
        ) {
            let mut l = lidar();
            let mut now = at(0);
            for (bytes, ms) in script {
                now += Duration::from_millis(ms);
                l.poll(now);
                l.bytes(now, &bytes, &mut |_| {});
            }
        }
    }
}
