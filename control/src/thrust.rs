//! Thrust to throttle stick, with the hover point learnt in flight.
//!
//! The firmware turns the throttle stick u into the motor command `c = idle + (1 - idle) u`, and the motors make thrust in
//! proportion to `c^n` (n = 2: thrust follows the square of the speed). Mass, battery and propellers only enter through one
//! number, the command that hovers; it starts from the airframe's figures and is then learnt.

use crate::params::ControlParams;
use vehicle::Airframe;
use vehicle::airframe::GRAVITY_MPS2;

/// The learnt hover command may not leave this range: beyond it the airframe's figures are wrong, not the battery.
const COMMAND_RANGE: (f64, f64) = (0.12, 0.9);

/// Motor command that carries the weight.
#[derive(Clone, Debug, PartialEq)]
pub struct HoverThrust {
    command: f64,
}

impl HoverThrust {
    /// From the airframe (or from `MPC_THR_HOVER`) for a mass in kg.
    #[must_use]
    pub fn new(p: &ControlParams, airframe: &Airframe, mass_kg: f64) -> Self {
        let command = if p.hover_throttle > 0.0 {
            p.motor_idle + (1.0 - p.motor_idle) * p.hover_throttle
        } else {
            let share = mass_kg * GRAVITY_MPS2 / airframe.max_thrust_n.max(1e-3);
            libm::pow(share.max(0.0), 1.0 / p.thrust_exponent)
        };
        Self {
            command: in_range(command),
        }
    }

    /// The weight turned out to be `ratio` times what was believed. Returns the ratio that was really taken (less at the
    /// ends of the allowed range).
    pub fn scale_weight(&mut self, p: &ControlParams, ratio: f64) -> f64 {
        if !(ratio.is_finite() && ratio > 0.0) {
            return 1.0;
        }
        let before = self.command;
        self.command = in_range(before * libm::pow(ratio, 1.0 / p.thrust_exponent));
        libm::pow(self.command / before, p.thrust_exponent)
    }

    /// Throttle stick for a lift in weights (1 hovers when level), 0..=`MPC_THR_MAX`.
    #[must_use]
    pub fn throttle_of_lift(&self, p: &ControlParams, lift: f64) -> f64 {
        let command = self.command * libm::pow(lift.max(0.0), 1.0 / p.thrust_exponent);
        stick(p, command)
    }

    /// Throttle stick for a share of the largest thrust.
    #[must_use]
    pub fn throttle_of_fraction(p: &ControlParams, fraction: f64) -> f64 {
        stick(
            p,
            libm::pow(fraction.clamp(0.0, 1.0), 1.0 / p.thrust_exponent),
        )
    }

    /// Share of the largest thrust that a throttle stick makes.
    #[must_use]
    pub fn fraction_of_throttle(p: &ControlParams, throttle: f64) -> f64 {
        let command = p.motor_idle + (1.0 - p.motor_idle) * throttle.clamp(0.0, 1.0);
        libm::pow(command, p.thrust_exponent)
    }

    /// Lift in weights that a throttle stick makes.
    #[must_use]
    pub fn lift_of_throttle(&self, p: &ControlParams, throttle: f64) -> f64 {
        let command = p.motor_idle + (1.0 - p.motor_idle) * throttle.clamp(0.0, 1.0);
        libm::pow(command / self.command, p.thrust_exponent)
    }
}

fn stick(p: &ControlParams, command: f64) -> f64 {
    ((command - p.motor_idle) / (1.0 - p.motor_idle)).clamp(0.0, p.throttle_max)
}

fn in_range(command: f64) -> f64 {
    if command.is_finite() {
        command.clamp(COMMAND_RANGE.0, COMMAND_RANGE.1)
    } else {
        COMMAND_RANGE.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    #[test]
    fn the_default_airframe_hovers_at_55_percent_of_the_stick() {
        // 0.6 kg * 9.80665 / 18 N = 0.3269; its root 0.5718; less 5.5 % idle: (0.5718 - 0.055) / 0.945 = 0.5468.
        let p = ControlParams::default();
        let h = HoverThrust::new(&p, &Airframe::default(), 0.6);
        assert_abs_diff_eq!(h.throttle_of_lift(&p, 1.0), 0.5468, epsilon = 1e-4);
        assert_abs_diff_eq!(
            HoverThrust::fraction_of_throttle(&p, h.throttle_of_lift(&p, 1.0)),
            0.3269,
            epsilon = 1e-4
        );
    }

    #[test]
    fn lift_and_throttle_are_inverse_and_more_weight_needs_more_throttle() {
        let p = ControlParams::default();
        let mut h = HoverThrust::new(&p, &Airframe::default(), 0.6);
        let u = h.throttle_of_lift(&p, 1.3);
        assert_abs_diff_eq!(h.lift_of_throttle(&p, u), 1.3, epsilon = 1e-9);
        h.scale_weight(&p, 1.2);
        assert_abs_diff_eq!(h.throttle_of_lift(&p, 1.3 / 1.2), u, epsilon = 1e-9);
    }
}
