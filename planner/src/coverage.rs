//! Which directions the rangers look into: a ring with gaps is blind there, so the vehicle flies slowly into them, turns
//! to look, and swings its nose while somebody is about.
//!
//! Kept twice: by body bearing, to know the ring's gaps, and by world bearing, because a direction looked into before the
//! nose turned is still known a moment later.

use crate::vfh::{SECTOR_RAD, SECTORS, middle_of, sector_of};
use vehicle::Timestamp;
use vehicle::angle::shortest_turn;

/// A sector counts as looked into for this long after a beam, s (sonars fire at 4 Hz, a slow ring at 3 Hz).
const FRESH_S: f64 = 0.8;
/// A direction of the world counts as looked into for this long, s: at 0.7 m/s what was there is then still ahead.
const KNOWN_S: f64 = 1.2;
/// Share of a new pause in their mean.
const PERIOD_SHARE: f64 = 0.05;
/// A person is kept at least this far inside a looked-into run of sectors.
const INSIDE_SECTORS: usize = 3;

/// Sectors of the body (clockwise from forward) and when each was last looked into.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    seen_at: [Option<Timestamp>; SECTORS],
    /// The same by sectors of the world, clockwise from north.
    known_at: [Option<Timestamp>; SECTORS],
    /// Longest pause between two looks of a ranger that still looks, s; fades.
    period_s: f64,
}

impl Default for Coverage {
    fn default() -> Self {
        Self {
            seen_at: [None; SECTORS],
            known_at: [None; SECTORS],
            period_s: 0.0,
        }
    }
}

impl Coverage {
    /// A beam has looked along a body bearing (clockwise from forward, rad), half a cone to each side, while the nose
    /// pointed to `yaw_rad` (clockwise from north).
    pub fn mark(&mut self, at: Timestamp, bearing_rad: f64, half_cone_rad: f64, yaw_rad: f64) {
        let reach = half_cone_rad + 0.5 * SECTOR_RAD;
        let pause_s = self.seen_at[sector_of(bearing_rad)].map_or(0.0, |t| at.seconds_since(t));
        if pause_s > 0.0 && pause_s < FRESH_S {
            self.period_s += PERIOD_SHARE * (pause_s - self.period_s);
        }
        mark_sectors(&mut self.seen_at, at, bearing_rad, reach);
        mark_sectors(&mut self.known_at, at, bearing_rad + yaw_rad, reach);
    }

    /// Mean pause between two looks of the same ranger, s.
    #[must_use]
    pub const fn period_s(&self) -> f64 {
        self.period_s
    }

    /// True if the whole cone around a direction of the world (clockwise from north, half an angle to each side, rad) has
    /// been looked into lately.
    #[must_use]
    pub fn knows_cone(&self, now: Timestamp, direction_rad: f64, half_rad: f64) -> bool {
        let n = libm::ceil(half_rad / SECTOR_RAD) as i32;
        (-n..=n).all(|k| {
            self.knows(
                now,
                direction_rad + half_rad * f64::from(k) / f64::from(n.max(1)),
            )
        })
    }

    /// True if the rangers look into the whole cone around the nose without turning.
    #[must_use]
    pub fn covers_nose(&self, now: Timestamp, half_rad: f64) -> bool {
        let n = libm::floor(half_rad / SECTOR_RAD) as i32;
        (-n..=n).all(|k| {
            self.fresh(
                now,
                sector_of((f64::from(k) + 0.5 * f64::from(k.signum())) * SECTOR_RAD),
            )
        })
    }

    /// True if a direction of the world (clockwise from north, rad) has been looked into lately, whatever the nose did since.
    #[must_use]
    pub fn knows(&self, now: Timestamp, direction_rad: f64) -> bool {
        [-0.5, 0.5].iter().all(|k| {
            let seen = self.known_at[sector_of(direction_rad + k * SECTOR_RAD)];
            seen.is_some_and(|t| now.seconds_since(t) < KNOWN_S)
        })
    }

    /// True if a body bearing has been looked into lately.
    #[must_use]
    pub fn sees(&self, now: Timestamp, bearing_rad: f64) -> bool {
        self.fresh(now, sector_of(bearing_rad + 0.5 * SECTOR_RAD))
            && self.fresh(now, sector_of(bearing_rad - 0.5 * SECTOR_RAD))
    }

    /// True if no ranger looks within an angle (rad) of a body bearing: a side without rangers, not a gap between two.
    #[must_use]
    pub fn is_blind_side(&self, now: Timestamp, bearing_rad: f64, half_rad: f64) -> bool {
        let n = libm::floor(half_rad / SECTOR_RAD) as i32;
        (-n..=n).all(|k| !self.fresh(now, sector_of(bearing_rad + f64::from(k) * SECTOR_RAD)))
    }

    /// True if the ring looks somewhere but not everywhere: turning shows more.
    #[must_use]
    pub fn has_gaps(&self, now: Timestamp) -> bool {
        let seen = (0..SECTORS).filter(|k| self.fresh(now, *k)).count();
        seen > 0 && seen < SECTORS
    }

    /// The smallest turn (clockwise +, rad) that brings a body bearing well inside a looked-into run of sectors; zero if
    /// none does.
    #[must_use]
    pub fn turn_to_see(&self, now: Timestamp, bearing_rad: f64) -> f64 {
        let wanted = sector_of(bearing_rad) as i64;
        let inside = INSIDE_SECTORS as i64;
        let good = |k: i64| {
            (k - inside..=k + inside)
                .all(|j| self.fresh(now, j.rem_euclid(SECTORS as i64) as usize))
        };
        for d in 0..=(SECTORS as i64) / 2 {
            // Turning clockwise by d sectors moves the bearing d sectors counter-clockwise in the body.
            if good(wanted - d) {
                return d as f64 * SECTOR_RAD;
            }
            if good(wanted + d) {
                return -(d as f64) * SECTOR_RAD;
            }
        }
        0.0
    }

    fn fresh(&self, now: Timestamp, sector: usize) -> bool {
        self.seen_at[sector].is_some_and(|t| now.seconds_since(t) < FRESH_S)
    }
}

fn mark_sectors(
    sectors: &mut [Option<Timestamp>; SECTORS],
    at: Timestamp,
    bearing_rad: f64,
    reach_rad: f64,
) {
    let around = libm::ceil(reach_rad / SECTOR_RAD) as i64;
    let centre = sector_of(bearing_rad) as i64;
    for d in -around..=around {
        let k = (centre + d).rem_euclid(SECTORS as i64) as usize;
        if shortest_turn(middle_of(k), bearing_rad).abs() <= reach_rad {
            sectors[k] = Some(at);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::{FRAC_PI_2, FRAC_PI_4};
    use vehicle::{RangerReading, RingConfig};

    fn four_sensors() -> Coverage {
        let ring = RingConfig::built_in("tof32").unwrap();
        let mut c = Coverage::default();
        for r in &ring.rangers {
            let reading = RangerReading {
                at: Timestamp::ZERO,
                ranger: 0,
                columns_mm: [None; 8].into_iter().collect(),
            };
            for b in r.beams(&reading) {
                c.mark(Timestamp::ZERO, b.bearing_rad, b.half_cone_rad, 0.0);
            }
        }
        c
    }

    #[test]
    fn four_sensors_of_45_degrees_see_ahead_but_not_diagonally() {
        let c = four_sensors();
        assert!(c.sees(Timestamp::ZERO, 0.0) && c.sees(Timestamp::ZERO, -FRAC_PI_2));
        assert!(!c.sees(Timestamp::ZERO, FRAC_PI_4) && c.has_gaps(Timestamp::ZERO));
        assert!(
            !c.sees(Timestamp::from_ms(900), 0.0),
            "old looks do not count"
        );
    }

    #[test]
    fn a_gap_between_two_rangers_is_no_blind_side_but_the_rear_of_snsi6_is() {
        let half = 30_f64.to_radians();
        assert!(!four_sensors().is_blind_side(Timestamp::ZERO, FRAC_PI_4, half));
        let ring = RingConfig::built_in("snsi6").unwrap();
        let mut c = Coverage::default();
        for r in ring.rangers.iter().filter(|r| r.elevation_deg.abs() < 1.0) {
            c.mark(
                Timestamp::ZERO,
                r.bearing_deg.to_radians(),
                r.half_cone_deg.to_radians(),
                0.0,
            );
        }
        assert!(c.is_blind_side(Timestamp::ZERO, core::f64::consts::PI, half));
        assert!(!c.is_blind_side(Timestamp::ZERO, 1.1, half));
    }

    #[test]
    fn somebody_in_a_gap_is_looked_at_by_the_smallest_turn() {
        let c = four_sensors();
        let turn = c.turn_to_see(Timestamp::ZERO, 35_f64.to_radians());
        assert!(
            (turn.to_degrees() - 30.0).abs() < 1e-9,
            "{}",
            turn.to_degrees()
        );
        assert!(c.turn_to_see(Timestamp::ZERO, 0.03).abs() < 1e-9);
        let turn = c.turn_to_see(Timestamp::ZERO, 55_f64.to_radians());
        assert!(turn < 0.0, "the sensor on the right is nearer");
    }

    #[test]
    fn a_direction_looked_into_before_the_nose_turned_is_known_for_a_second() {
        let c = four_sensors();
        assert!(c.knows(Timestamp::from_ms(1_000), 0.1) && !c.knows(Timestamp::ZERO, FRAC_PI_4));
        assert!(!c.knows(Timestamp::from_ms(1_300), 0.1));
    }
}
