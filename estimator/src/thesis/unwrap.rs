//! Yaw without jumps: the measured angle is moved by whole turns to the one nearest the estimate.

use core::f64::consts::{PI, TAU};

/// The same direction as `measured_rad`, less than half a turn from `estimate_rad`. Only yaw needs it.
///
/// The estimate is therefore continuous and may leave (-pi, pi].
#[must_use]
pub fn unwrap_theta(measured_rad: f64, estimate_rad: f64) -> f64 {
    let difference = measured_rad - estimate_rad;
    if difference.abs() < PI {
        return measured_rad;
    }
    measured_rad - TAU * libm::trunc((difference + PI.copysign(difference)) / TAU)
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn half_a_turn_and_more_is_taken_off_in_whole_turns() {
        assert_eq!(unwrap_theta(3.0, 2.0), 3.0);
        assert!((unwrap_theta(-3.1, 3.1) - (TAU - 3.1)).abs() < 1e-12);
        assert!((unwrap_theta(0.1, 6.0 * PI) - (6.0 * PI + 0.1)).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn the_direction_stays_and_the_estimate_is_near(m in -10.0..10.0f64, e in -50.0..50.0f64) {
            let u = unwrap_theta(m, e);
            prop_assert!((u - e).abs() <= PI + 1e-9);
            prop_assert!((libm::cos(u - m) - 1.0).abs() < 1e-9);
        }
    }
}
