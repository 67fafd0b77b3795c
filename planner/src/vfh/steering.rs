//! The direction that costs least, and the speed from which stopping is possible.

use super::SECTORS;
use super::config::VfhParams;
use super::valley::candidates;
use vehicle::angle::shortest_turn;

/// What pulls the choice of direction, rad counter-clockwise from plan x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pull {
    /// Where the target is.
    pub target_rad: f64,
    /// Where the vehicle is moving; none at rest.
    pub motion_rad: Option<f64>,
    /// What was chosen last; none at the beginning.
    pub previous_rad: Option<f64>,
}

/// The cheapest free direction: `g = m1 |c - target| + m2 |c - motion| + m3 |c - previous|` (Ulrich and Borenstein 1998,
/// equation 14), none if every sector is blocked.
#[must_use]
pub fn direction(p: &VfhParams, blocked: &[bool; SECTORS], pull: &Pull) -> Option<f64> {
    let turn = |a: f64, b: Option<f64>| b.map_or(0.0, |b| shortest_turn(a, b).abs());
    let mut best: Option<(f64, f64)> = None;
    for c in candidates(blocked, pull.target_rad, p.wide_sectors as usize) {
        let cost = p.cost_target * turn(c, Some(pull.target_rad))
            + p.cost_motion * turn(c, pull.motion_rad)
            + p.cost_previous * turn(c, pull.previous_rad);
        if best.is_none_or(|(b, _)| cost < b) {
            best = Some((cost, c));
        }
    }
    best.map(|(_, c)| c)
}

/// Looks of a ranger that may pass before something new is braked for: it has just looked, and misses once.
const LOOKS: f64 = 2.5;

/// Time from something new to the first braking, s, with rangers of this period.
#[must_use]
pub const fn reaction_s(latency_s: f64, period_s: f64) -> f64 {
    latency_s + LOOKS * period_s
}

/// Largest speed, m/s, from which the vehicle stops within `free_m` although it brakes only after the latency.
#[must_use]
pub fn stopping_speed(brake_mps2: f64, latency_s: f64, free_m: f64) -> f64 {
    let (a, t) = (brake_mps2, latency_s);
    // v t + v^2 / 2a = free, solved for v.
    (libm::sqrt(a * a * t * t + 2.0 * a * free_m.max(0.0)) - a * t).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn from_the_allowed_speed_it_stops_in_time(free in 0.0..5.0f64) {
            let p = VfhParams::default();
            let v = stopping_speed(p.brake_mps2, p.latency_s, free);
            let needed = v * p.latency_s + v * v / (2.0 * p.brake_mps2);
            prop_assert!(needed <= free + 1e-9 && needed >= free - 1e-9);
        }
    }

    #[test]
    fn of_two_equal_ways_round_the_one_already_taken_is_kept() {
        let p = VfhParams::default();
        let mut blocked = [false; SECTORS];
        blocked[66..].fill(true);
        blocked[..6].fill(true);
        let pull = |previous_rad| Pull {
            target_rad: 0.0,
            motion_rad: None,
            previous_rad,
        };
        let left = direction(&p, &blocked, &pull(Some(0.8))).unwrap();
        let right = direction(&p, &blocked, &pull(Some(-0.8))).unwrap();
        assert!(shortest_turn(0.0, left) > 0.0 && shortest_turn(0.0, right) < 0.0);
    }

    #[test]
    fn all_blocked_is_no_direction() {
        let pull = Pull {
            target_rad: 0.0,
            motion_rad: None,
            previous_rad: None,
        };
        assert_eq!(
            direction(&VfhParams::default(), &[true; SECTORS], &pull),
            None
        );
    }
}
