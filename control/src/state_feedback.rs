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

impl StateFeedback {
    /// Motor speeds, rad/s: as the law asks, and the same [`within`] what motors do. While they are at their limit nothing is integrated: an error that more speed
    /// would have mended is none that the integrals shall remember.
    pub fn act_within(
        &mut self,
        setpoint: &StateSetpoint,
        state: &[f64; STATES],
        dt_s: f64,
        range: (f64, f64),
    ) -> ([f64; 4], [f64; 4]) {
        let now = self.act(setpoint, state, 0.0);
        let fits = now.iter().all(|w| (range.0..=range.1).contains(w));
        let wanted = if fits {
            self.act(setpoint, state, dt_s)
        } else {
            now
        };
        (wanted, within(wanted, range))
    }
}

/// Speed that is kept for tilting when all motors shall turn as fast as they can, rad/s.
const TILT_RESERVE_RADPS: f64 = 12.0;

/// Motor speeds within what motors do, rad/s (slowest, fastest), lift before tilt: where one would turn too fast or too slowly, the
/// differences between them shrink and their mean stays. Cutting off each by itself (uQuad's program) takes lift from a craft
/// that tilts hard with little speed left above its hover: it sinks.
#[must_use]
pub fn within(speeds_radps: [f64; 4], (slowest, fastest): (f64, f64)) -> [f64; 4] {
    let mean = speeds_radps.iter().sum::<f64>() * 0.25;
    let off = speeds_radps.map(|w| w - mean);
    let most = off.iter().copied().fold(0.0, f64::max);
    let least = off.iter().copied().fold(0.0, f64::min);
    let upper = fastest - most.min(TILT_RESERVE_RADPS);
    let lower = slowest - least.max(-TILT_RESERVE_RADPS);
    // A range narrower than both reserves: its middle.
    let mean = if lower <= upper {
        mean.clamp(lower, upper)
    } else {
        0.5 * (slowest + fastest)
    };
    let fits = |room: f64, off: f64| if off > room { room / off } else { 1.0 };
    let share = fits(fastest - mean, most).min(fits(mean - slowest, -least));
    // Clamped for rounding, and for what is no number.
    off.map(|o| (mean + share * o).clamp(slowest, fastest))
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use crate::integral::COLUMNS_OF_PPTZ;
    use nalgebra::SMatrix;
    use proptest::prelude::*;

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

    proptest! {
        #[test]
        fn speeds_within_their_range_stay_as_they_are_and_others_keep_their_mean(
            w in proptest::array::uniform4(0.0..600.0f64), mean in 160.0..340.0f64,
        ) {
            let range = (105.0, 368.16);
            let shifted = w.map(|v| v - w.iter().sum::<f64>() / 4.0 + mean);
            let out = within(shifted, range);
            prop_assert!(out.iter().all(|v| (range.0..=range.1).contains(v)));
            if shifted.iter().all(|v| (range.0..=range.1).contains(v)) {
                prop_assert!(out.iter().zip(shifted).all(|(a, b)| (a - b).abs() < 1e-9));
            }
            prop_assert!((out.iter().sum::<f64>() / 4.0 - mean).abs() < 1e-9, "{out:?}");
            // The craft tilts the way it was told, less.
            for i in 0..4 {
                prop_assert!((out[i] - mean) * (shifted[i] - mean) >= -1e-9);
            }
        }
    }

    #[test]
    fn nothing_is_integrated_while_the_motors_give_all_they_have() {
        let mut low = [0.0; STATES];
        low[2] = -1.0;
        let mut law = law();
        law.act_within(&HOVER, &low, 0.01, (105.0, 315.0));
        assert_eq!(law.act(&HOVER, &[0.0; STATES], 0.0), [312.498; 4]);
        law.act_within(&HOVER, &low, 0.01, (105.0, 368.0));
        assert!(law.act(&HOVER, &[0.0; STATES], 0.0)[0] > 312.5);
    }

    #[test]
    fn at_full_climb_it_can_still_be_tilted() {
        let out = within([420.0, 460.0, 420.0, 380.0], (105.0, 368.16));
        assert!(out[1] > out[3] + 10.0 && out[0] == out[2], "{out:?}");
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
