//! Angles in radians.

use core::f64::consts::{PI, TAU};

/// The same direction in (-pi, pi]. NaN stays NaN.
#[must_use]
pub fn wrap_pi(angle_rad: f64) -> f64 {
    let wrapped = angle_rad - TAU * libm::floor((angle_rad + PI) / TAU);
    if wrapped <= -PI {
        wrapped + TAU
    } else {
        wrapped
    }
}

/// The shorter way to turn from one direction to another, in (-pi, pi].
#[must_use]
pub fn shortest_turn(from_rad: f64, to_rad: f64) -> f64 {
    wrap_pi(to_rad - from_rad)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_short_way_from_170_to_minus_170_degrees_is_20_to_the_right() {
        let turn = shortest_turn(170_f64.to_radians(), (-170_f64).to_radians());
        assert!((turn - 20_f64.to_radians()).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn wrapping_keeps_the_direction(a in -1e3..1e3f64) {
            let w = wrap_pi(a);
            prop_assert!(w > -PI - 1e-12 && w <= PI + 1e-12);
            prop_assert!((libm::sin(w) - libm::sin(a)).abs() < 1e-9);
            prop_assert!((libm::cos(w) - libm::cos(a)).abs() < 1e-9);
        }
    }
}
