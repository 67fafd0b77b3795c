//! How the computer is, for the rows of the supervisor that look at it. Read once a second by the shell.

use super::clock::{monotonic_ns, utc_us};
use crate::autopilot::door::HostReport;
use std::path::Path;

/// The wall clock may wander this far from the steady one between two looks, us.
const JUMP_US: i64 = 1_000_000;
/// A jump is told for this many looks.
const TOLD_LOOKS: u32 = 10;
/// Raspberry Pi: bits of what holds it back now (under-voltage, frequency capped, throttled, soft temperature limit).
const HELD_BACK_NOW: u32 = 0xF;

/// Remembers what the last look saw.
#[derive(Debug, Default)]
pub struct HostWatch {
    /// UTC minus steady time, us.
    offset_us: Option<i64>,
    jump_told: u32,
    dropped: u64,
}

impl HostWatch {
    /// One look; `dropped` answers of the ground side so far.
    pub fn look(&mut self, disk_fails: bool, dropped: u64) -> HostReport {
        let offset_us = utc_us() as i64 - (monotonic_ns() / 1_000) as i64;
        let is_overloaded = dropped > self.dropped;
        self.dropped = dropped;
        HostReport {
            temperature_c: hottest_c(Path::new("/sys/class/thermal")),
            is_throttled: is_throttled(Path::new("/")),
            disk_fails,
            clock_jumped: self.clock(offset_us),
            is_overloaded,
        }
    }

    fn clock(&mut self, offset_us: i64) -> bool {
        let before = self.offset_us.replace(offset_us);
        if before.is_some_and(|b| (offset_us - b).abs() > JUMP_US) {
            self.jump_told = TOLD_LOOKS;
        }
        let told = self.jump_told > 0;
        self.jump_told = self.jump_told.saturating_sub(1);
        told
    }
}

/// Hottest thermal zone, degrees Celsius; none where the system tells none.
pub(super) fn hottest_c(zones: &Path) -> Option<f64> {
    let mut hottest = None;
    for zone in std::fs::read_dir(zones).ok()?.flatten() {
        let text = std::fs::read_to_string(zone.path().join("temp")).unwrap_or_default();
        if let Ok(milli_c) = text.trim().parse::<f64>() {
            let c = milli_c * 1e-3;
            hottest = Some(f64::max(hottest.unwrap_or(c), c));
        }
    }
    hottest
}

/// What the firmware of a Raspberry Pi says; others do not say.
pub(super) fn is_throttled(root: &Path) -> bool {
    let file = "sys/devices/platform/soc/soc:firmware/get_throttled";
    std::fs::read_to_string(root.join(file))
        .ok()
        .and_then(|text| u32::from_str_radix(text.trim().trim_start_matches("0x"), 16).ok())
        .is_some_and(|bits| bits & HELD_BACK_NOW != 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_of_the_wall_clock_is_told_for_a_while_and_drift_is_not() {
        let mut w = HostWatch::default();
        let told: Vec<bool> = [0, 100_000, 3_100_000]
            .into_iter()
            .chain([3_100_000; 12])
            .map(|offset| w.clock(offset))
            .collect();
        assert!(!told[0] && !told[1] && told[2] && told[11] && !told[12]);
    }

    #[test]
    fn the_hottest_zone_counts_and_no_zones_are_no_temperature() {
        let folder = std::env::temp_dir().join(format!("kestrel-zones-{}", std::process::id()));
        for (zone, text) in [("a", "41000\n"), ("b", "55500\n"), ("c", "none")] {
            std::fs::create_dir_all(folder.join(zone)).unwrap();
            std::fs::write(folder.join(zone).join("temp"), text).unwrap();
        }
        assert_eq!(hottest_c(&folder), Some(55.5));
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(hottest_c(&folder), None);
    }
}
