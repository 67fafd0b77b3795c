//! Heading: P to yaw rate, with limits of rate and of its change.

use crate::params::ControlParams;
use vehicle::Heading;
use vehicle::angle::{shortest_turn, wrap_pi};

/// Turns a heading set point into a yaw rate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeadingLoop {
    rate_radps: f64,
    /// While turning by rate: the heading reached, so that a following hold does not jump.
    target_rad: f64,
}

impl HeadingLoop {
    /// Starts from a heading at rest.
    pub fn reset(&mut self, yaw_rad: f64) {
        *self = Self {
            rate_radps: 0.0,
            target_rad: yaw_rad,
        };
    }

    /// Yaw rate to ask for, clockwise, rad/s.
    pub fn step(&mut self, p: &ControlParams, dt_s: f64, yaw_rad: f64, heading: Heading) -> f64 {
        let max = p.yaw_rate_max_deg.to_radians();
        let wanted = match heading {
            Heading::Yaw(yaw_sp) if yaw_sp.is_finite() && yaw_rad.is_finite() => {
                self.target_rad = wrap_pi(yaw_sp);
                p.yaw_p * shortest_turn(yaw_rad, yaw_sp)
            }
            Heading::Rate(rate) if rate.is_finite() => {
                self.target_rad = yaw_rad;
                rate
            }
            Heading::Yaw(_) | Heading::Rate(_) => 0.0,
        }
        .clamp(-max, max);
        let step = p.yaw_acc_max_deg.to_radians() * dt_s;
        self.rate_radps += (wanted - self.rate_radps).clamp(-step, step);
        self.rate_radps
    }

    /// Heading being held or passed, rad.
    #[must_use]
    pub const fn target_rad(&self) -> f64 {
        self.target_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settled(yaw_rad: f64, heading: Heading) -> f64 {
        let p = ControlParams::default();
        let mut h = HeadingLoop::default();
        (0..200).fold(0.0, |_, _| h.step(&p, 0.01, yaw_rad, heading))
    }

    #[test]
    fn it_turns_the_short_way_across_south() {
        let from = 170_f64.to_radians();
        assert!(settled(from, Heading::Yaw(-170_f64.to_radians())) > 0.0);
    }

    #[test]
    fn it_never_turns_faster_than_allowed() {
        let max = ControlParams::default().yaw_rate_max_deg.to_radians();
        assert!(settled(0.0, Heading::Yaw(3.0)) <= max + 1e-12);
        assert!(settled(0.0, Heading::Rate(-50.0)) >= -max - 1e-12);
    }

    #[test]
    fn a_heading_that_is_no_number_turns_nothing() {
        assert!(settled(0.0, Heading::Yaw(f64::NAN)).abs() < 1e-12);
        assert!(settled(f64::NAN, Heading::Yaw(1.0)).abs() < 1e-12);
    }
}
