//! Which law flies: optimal gains made for the craft, or gain files; and what of them is refused before a take-off.

use super::{UquadConfig, speed_range};
use control::integral::{Columns, IntegralAction, Integrated, Thresholds};
use control::lqr::{Design, LqrError, Motion, Trim, Weights, design};
use control::proportional::Gains;
use estimator::thesis::{Noise, StateSet};
use vehicle::UquadAirframe;

/// Gains to be made, outside of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DesignRequest {
    /// Mass, inertia, thrust and drag.
    pub craft: UquadAirframe,
    /// Which states.
    pub is_reduced: bool,
    /// Around which motion.
    pub trim: Trim,
    /// What is dear.
    pub weights: Weights,
}

/// Makes gains: under a millisecond, and it allocates. Not for the loop.
///
/// # Errors
/// See [`control::lqr::dare`].
pub fn make(request: &DesignRequest) -> Result<Design, LqrError> {
    let motion = Motion::of(request.craft);
    if request.is_reduced {
        design::eight(&motion, &request.trim, &request.weights)
    } else {
        design::twelve_and_integrals(&motion, &request.trim, &request.weights)
    }
}

/// What the user chose.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "one, at the start of the program"
)]
pub enum Law {
    /// LQR, with integrals where there is a position; made again as the nose turns.
    Optimal(Weights),
    /// Gain files: proportional, and integral with the order of its columns.
    Files {
        /// Text of 4 x 12 or 4 x 8 numbers.
        proportional: String,
        /// Text of 4 x 4 numbers, and what its columns are.
        integral: Option<(String, Columns)>,
    },
}

/// Why there is no law to fly with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LawError {
    /// The gain file.
    #[error("proportional gains: {0}")]
    Proportional(control::proportional::GainError),
    /// The gain file.
    #[error("integral gains: {0}")]
    Integral(control::proportional::GainError),
    /// The weights or the model.
    #[error("optimal gains: {0}")]
    Optimal(#[from] LqrError),
    /// Gains that do not hold the craft in the air.
    #[error(
        "these gains do not hold the craft at hover: without disturbance the largest error after {seconds} s is {factor:.1e} times that at the start"
    )]
    Unstable {
        /// Time flown, s.
        seconds: f64,
        /// Largest error over that of the start.
        factor: f64,
    },
}

/// A configuration for flight with the law, checked against the model of the craft.
///
/// # Errors
/// The rule that the law breaks; nothing takes off with it.
pub fn config(craft: UquadAirframe, states: StateSet, law: &Law) -> Result<UquadConfig, LawError> {
    let mut config = UquadConfig::corrected();
    config.filter.craft = craft;
    config.filter.noise = Noise::flight();
    config.filter.states = states;
    config.hover_radps = craft.hover_speed_radps();
    config.first_speeds_radps = config.hover_radps;
    config.speed_range_radps = speed_range(config.hover_radps);
    config.keeps_lift = true;
    match law {
        Law::Optimal(weights) => {
            let made = make(&DesignRequest {
                craft,
                is_reduced: states == StateSet::Reduced,
                trim: Trim::hover(&craft, 0.0),
                weights: *weights,
            })?;
            config.gains = made.gains;
            config.integral = made.integral_action().map(indoor);
        }
        Law::Files {
            proportional,
            integral,
        } => {
            config.gains = Gains::parse(proportional).map_err(LawError::Proportional)?;
            config.integral = match integral {
                Some((text, columns)) => Some(indoor(
                    IntegralAction::parse(text, *columns).map_err(LawError::Integral)?,
                )),
                None => None,
            };
        }
    }
    holds_hover(craft, &config)?;
    Ok(config)
}

fn indoor(action: IntegralAction) -> IntegralAction {
    let indoor = Thresholds::INDOOR_HORIZONTAL;
    action
        .with_thresholds(Integrated::X, indoor)
        .with_thresholds(Integrated::Y, indoor)
}

/// Seconds the model is flown.
const TRIAL_S: f64 = 20.0;

/// Flies the linear model from a small error of every state that the law acts on: an unstable law lets it grow.
fn holds_hover(craft: UquadAirframe, config: &UquadConfig) -> Result<(), LawError> {
    let motion = Motion::of(craft);
    let hover = Trim::hover(&craft, 0.0);
    let (a, b) = motion.jacobians(&hover.state, &hover.inputs);
    let (phi, gamma) = control::lqr::zero_order_hold(&a, &b, design::PERIOD_S);
    // Without gains for place and level speed those drift, as without a position source.
    let has_place = [0, 1, 6, 7]
        .iter()
        .any(|&i| config.gains.matrix.column(i).amax() > 0.0);
    let watched = |i: usize| has_place || !matches!(i, 0 | 1 | 6 | 7);
    let loop_matrix = phi - gamma * config.gains.matrix;
    let size = |x: &control::lqr::State| {
        (0..12)
            .filter(|&i| watched(i))
            .fold(0.0_f64, |m, i| m.max(x[i].abs()))
    };
    let mut worst = 0.0_f64;
    for i in (0..12).filter(|&i| watched(i)) {
        let mut x = control::lqr::State::zeros();
        x[i] = 1e-3;
        for _ in 0..(TRIAL_S / design::PERIOD_S) as u32 {
            x = loop_matrix * x;
        }
        let factor = size(&x) / 1e-3;
        // What is no number is not smaller.
        worst = if factor.is_finite() {
            worst.max(factor)
        } else {
            f64::INFINITY
        };
    }
    if worst > 1.0 {
        return Err(LawError::Unstable {
            seconds: TRIAL_S,
            factor: worst,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(proportional: &str) -> Law {
        Law::Files {
            proportional: proportional.to_owned(),
            integral: None,
        }
    }

    fn refused(law: &Law) -> String {
        config(UquadAirframe::default(), StateSet::Full, law)
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn gain_files_of_the_wrong_size_or_without_numbers_are_refused_by_name() {
        assert_eq!(
            refused(&files("1 2 3")),
            "proportional gains: 3 numbers, 4 x 12 = 48 are needed"
        );
        let nan = "0 ".repeat(47) + "nan";
        assert_eq!(
            refused(&files(&nan)),
            "proportional gains: row 4, column 12: `nan` is not a number"
        );
    }

    #[test]
    fn gains_that_let_it_fall_are_refused_and_those_of_the_thesis_are_not() {
        let none = "0 ".repeat(48);
        assert!(refused(&files(&none)).starts_with("these gains do not hold"));
        let against: String = "1 ".repeat(48);
        assert!(refused(&files(&against)).starts_with("these gains do not hold"));
        let gains = Gains::from_pattern(&Gains::K_PROP_PPTZ);
        let text: String = gains
            .matrix
            .transpose()
            .iter()
            .map(|v| format!("{v} "))
            .collect();
        let made = config(UquadAirframe::default(), StateSet::Reduced, &files(&text));
        assert!(made.is_ok(), "{made:?}");
    }

    #[test]
    fn weights_that_are_not_positive_are_refused() {
        let mut weights = Weights::indoor();
        weights.r[(0, 0)] = 0.0;
        assert!(refused(&Law::Optimal(weights)).contains("R is not symmetric and positive"));
        let mut weights = Weights::indoor();
        weights.q[(2, 2)] = -1.0;
        assert!(refused(&Law::Optimal(weights)).contains("Q is not symmetric and positive"));
    }
}
