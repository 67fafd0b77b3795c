//! The whole law: motor speeds = set point + proportional + integral (uQuad's equation 1.6).

use crate::integral::IntegralAction;
use crate::proportional::{ErrorLimits, Gains, STATES};

/// Where the craft shall be, and the speeds that hold it there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateSetpoint {
    /// Wanted states.
    pub state: [f64; STATES],
    /// Motor speeds that hold them, rad/s.
    pub speeds_radps: [f64; 4],
}

/// The law.
#[derive(Clone, Debug)]
pub struct StateFeedback {
    /// Proportional gains.
    pub gains: Gains,
    /// Largest errors that are acted upon.
    pub limits: ErrorLimits,
    /// Integral action, if any.
    pub integral: Option<IntegralAction>,
}

impl StateFeedback {
    /// Motor speeds, rad/s, not limited to what motors can do.
    pub fn act(&mut self, setpoint: &StateSetpoint, state: &[f64; STATES], dt_s: f64) -> [f64; 4] {
        let error = self.limits.error(&setpoint.state, state);
        let proportional = self.gains.matrix * error;
        let integral = self
            .integral
            .as_mut()
            .map_or([0.0; 4], |i| i.act(&error, dt_s));
        core::array::from_fn(|m| setpoint.speeds_radps[m] + proportional[m] + integral[m])
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use crate::integral::COLUMNS_OF_PPTZ;
    use nalgebra::SMatrix;

    fn law() -> StateFeedback {
        StateFeedback {
            gains: Gains::from_pattern(&Gains::K_PROP_PPTZ),
            limits: ErrorLimits::default(),
            integral: Some(IntegralAction::new(SMatrix::repeat(1.0), COLUMNS_OF_PPTZ)),
        }
    }

    const HOVER: StateSetpoint = StateSetpoint {
        state: [0.0; STATES],
        speeds_radps: [312.498; 4],
    };

    #[test]
    fn no_error_gives_exactly_the_speeds_of_the_set_point() {
        assert_eq!(law().act(&HOVER, &[0.0; STATES], 0.01), [312.498; 4]);
    }

    #[test]
    fn the_parts_add_up() {
        let mut state = [0.0; STATES];
        state[2] = -0.1;
        // 312.498 + 0.1 * 8.8129775 + 0.1 * 0.01 * 1
        let w = law().act(&HOVER, &state, 0.01);
        assert!((w[2] - (312.498 + 0.881_297_75 + 0.001)).abs() < 1e-12);
    }
}
