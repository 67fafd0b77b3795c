//! States and motor speeds that keep up a steady motion: what gains are computed around, and what a set point asks for.

use super::motion::{Inputs, Motion, State};
use nalgebra::{SMatrix, SVector};
use vehicle::UquadAirframe;

/// Newton's rounds; five are enough from a start at hover.
const MAX_ROUNDS: u32 = 20;
/// Residual in SI units at which the motion is steady.
const STEADY: f64 = 1e-12;

/// A steady motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trim {
    /// Its state at one instant.
    pub state: State,
    /// Motor speeds that keep it up, rad/s.
    pub inputs: Inputs,
}

/// Why a motion cannot be kept up.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TrimError {
    /// A circle without turn or without speed, or no number.
    #[error(
        "a circle at {speed_mps} m/s and {rate_radps} rad/s: both must be numbers other than zero"
    )]
    NoCircle {
        /// As asked for.
        speed_mps: f64,
        /// As asked for.
        rate_radps: f64,
    },
    /// No attitude and no motor speeds do it.
    #[error("no attitude and motor speeds keep up {speed_mps} m/s turning at {rate_radps} rad/s")]
    NotSteady {
        /// As asked for.
        speed_mps: f64,
        /// As asked for.
        rate_radps: f64,
    },
}

/// A circle at constant height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Speed on the circle, m/s.
    pub speed_mps: f64,
    /// Rate of turn, rad/s, counter-clockwise positive.
    pub rate_radps: f64,
    /// Direction of flight seen from the body, rad, counter-clockwise from the nose: 0 flies nose first, the thesis's generator flies with the
    /// left side (its y, quarter of a turn) first.
    pub bearing_rad: f64,
}

impl Circle {
    /// Radius, m.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        (self.speed_mps / self.rate_radps).abs()
    }

    /// Centre (x, y), m, of the circle that passes through (x, y) with the nose at theta. (The thesis prints its y without the sign of the turn.)
    #[must_use]
    pub fn centre_m(&self, x_m: f64, y_m: f64, theta_rad: f64) -> (f64, f64) {
        let reach = self.speed_mps / self.rate_radps;
        let course = theta_rad + self.bearing_rad;
        (
            x_m - reach * libm::sin(course),
            y_m + reach * libm::cos(course),
        )
    }
}

impl Trim {
    /// Standing still in the air, nose at theta.
    #[must_use]
    pub fn hover(craft: &UquadAirframe, theta_rad: f64) -> Self {
        let mut state = State::zeros();
        state[5] = theta_rad;
        Self {
            state,
            inputs: Inputs::repeat(craft.hover_speed_radps()),
        }
    }

    /// Straight flight at a velocity in body axes, m/s, level: without drag of the air it takes no more than hover.
    #[must_use]
    pub fn straight(craft: &UquadAirframe, velocity_mps: [f64; 3], theta_rad: f64) -> Self {
        let mut trim = Self::hover(craft, theta_rad);
        trim.state
            .fixed_rows_mut::<3>(6)
            .copy_from_slice(&velocity_mps);
        trim
    }

    /// A circle: twelve equations (velocity in the world, turning of the three angles, no acceleration in the body) for psi, phi, six velocities and
    /// rates, and four speeds.
    ///
    /// # Errors
    ///
    /// When there is no such circle.
    pub fn circle(motion: &Motion, circle: &Circle, theta_rad: f64) -> Result<Self, TrimError> {
        let Circle {
            speed_mps,
            rate_radps,
            bearing_rad,
        } = *circle;
        let numbers = [speed_mps, rate_radps, bearing_rad, theta_rad];
        if !numbers.iter().all(|v| v.is_finite()) || speed_mps * rate_radps == 0.0 {
            return Err(TrimError::NoCircle {
                speed_mps,
                rate_radps,
            });
        }
        let course = theta_rad + bearing_rad;
        let mut wanted = State::zeros();
        wanted[0] = speed_mps * libm::cos(course);
        wanted[1] = speed_mps * libm::sin(course);
        wanted[5] = rate_radps;
        let mut trim = Self::hover(&motion.craft, theta_rad);
        trim.state[6] = speed_mps * libm::cos(bearing_rad);
        trim.state[7] = speed_mps * libm::sin(bearing_rad);
        trim.state[11] = rate_radps;
        for _ in 0..MAX_ROUNDS {
            let residual = motion.derivative(&trim.state, &trim.inputs) - wanted;
            if residual.amax() <= STEADY {
                return Ok(trim);
            }
            let Some(step) = trim.newton_step(motion, &residual) else {
                break;
            };
            trim.state[3] -= step[0];
            trim.state[4] -= step[1];
            for i in 0..6 {
                trim.state[6 + i] -= step[2 + i];
            }
            trim.inputs -= step.fixed_rows::<4>(8);
        }
        Err(TrimError::NotSteady {
            speed_mps,
            rate_radps,
        })
    }

    fn newton_step(&self, motion: &Motion, residual: &State) -> Option<SVector<f64, 12>> {
        let (a, b) = motion.jacobians(&self.state, &self.inputs);
        let mut by_unknown = SMatrix::<f64, 12, 12>::zeros();
        by_unknown
            .fixed_columns_mut::<2>(0)
            .copy_from(&a.fixed_columns::<2>(3));
        by_unknown
            .fixed_columns_mut::<6>(2)
            .copy_from(&a.fixed_columns::<6>(6));
        by_unknown.fixed_columns_mut::<4>(8).copy_from(&b);
        by_unknown.lu().solve(residual)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_PI_2;

    #[test]
    fn hover_and_straight_flight_do_not_accelerate() {
        let motion = Motion::of(UquadAirframe::default());
        let hover = Trim::hover(&motion.craft, 0.7);
        assert!(motion.derivative(&hover.state, &hover.inputs).amax() < 1e-12);
        let straight = Trim::straight(&motion.craft, [1.0, 0.0, 0.0], FRAC_PI_2);
        let rate = motion.derivative(&straight.state, &straight.inputs);
        assert!((rate[1] - 1.0).abs() < 1e-12 && rate.fixed_rows::<9>(3).amax() < 1e-12);
    }

    #[test]
    fn a_circle_leans_inwards_and_stays_on_it() {
        let motion = Motion::of(UquadAirframe::default());
        for (rate_radps, bearing_rad) in [(1.0, 0.0), (-1.0, 0.0), (0.5, FRAC_PI_2), (-0.5, 2.0)] {
            let circle = Circle {
                speed_mps: 1.0,
                rate_radps,
                bearing_rad,
            };
            let mut trim = Trim::circle(&motion, &circle, 0.3).unwrap();
            let lean = libm::hypot(trim.state[3], trim.state[4]);
            assert!(
                (lean - rate_radps.abs() / 9.81).abs() < 1e-3,
                "tan lean = V w / g: {lean}"
            );
            // Flown for a quarter of a turn by the trim's speeds alone.
            let (cx, cy) = circle.centre_m(0.0, 0.0, 0.3);
            let steps = (FRAC_PI_2 / rate_radps.abs() / 1e-4) as u32;
            for _ in 0..steps {
                let half = trim.state + motion.derivative(&trim.state, &trim.inputs) * 0.5e-4;
                trim.state += motion.derivative(&half, &trim.inputs) * 1e-4;
                let off = libm::hypot(trim.state[0] - cx, trim.state[1] - cy) - circle.radius_m();
                assert!(off.abs() < 1e-4, "{off}");
            }
        }
    }

    #[test]
    fn a_circle_that_is_none_is_refused_in_words() {
        let motion = Motion::uquad();
        let circle = |speed_mps, rate_radps| Circle {
            speed_mps,
            rate_radps,
            bearing_rad: 0.0,
        };
        for (speed, rate) in [(0.0, 1.0), (1.0, 0.0), (f64::NAN, 1.0)] {
            let refused = Trim::circle(&motion, &circle(speed, rate), 0.0);
            assert!(matches!(refused, Err(TrimError::NoCircle { .. })));
        }
        let refused = Trim::circle(&motion, &circle(1e9, 1e9), 0.0).unwrap_err();
        assert!(refused.to_string().contains("no attitude"), "{refused}");
    }
}
