//! State feedback to four motor speeds: `w = w_sp + Kp (x_sp - x)`, uQuad's equation 1.4.
//!
//! For craft that are commanded in motor speeds; a Betaflight-class controller is flown by [`crate::controller`].
//!
//! State order: x y z (m), psi phi theta (rad), vqx vqy vqz (m/s, body), wqx wqy wqz (rad/s); names and signs are uQuad's: x forward, y left, z
//! up, psi right side down, phi nose down, theta counter-clockwise. Motors: 0 front, 1 left, 2 rear, 3 right.
//!
//! ```
//! use control::proportional::{ErrorLimits, Gains, proportional};
//! let gains = Gains::from_pattern(&Gains::K_PROP_PPTZ);
//! let mut x = [0.0; 12];
//! x[2] = -1.0; // a metre too low
//! let w = proportional(&gains, &ErrorLimits::default(), &[0.0; 12], &x);
//! assert!(w.iter().all(|w| (w - 8.8129775).abs() < 1e-12), "all motors faster");
//! ```

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};
use vehicle::angle::wrap_pi;

/// States of the full set.
pub const STATES: usize = 12;
/// Index of theta, the one error that is an angle over more than a turn.
const THETA: usize = 5;
/// Columns of an 8-state gain file: z, psi, phi, theta, vqz, wqx, wqy, wqz.
pub(crate) const REDUCED: [usize; 8] = [2, 3, 4, 5, 8, 9, 10, 11];

/// Numbers of a gain file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GainError {
    /// Not as many numbers as the matrix has.
    #[error("{got} numbers, {rows} x {columns} = {} are needed", rows * columns)]
    Size {
        /// How many there are.
        got: usize,
        /// Rows of the matrix.
        rows: usize,
        /// Columns of the matrix.
        columns: usize,
    },
    /// A word that is no finite number.
    #[error("row {row}, column {column}: `{word}` is not a number")]
    NotANumber {
        /// Row, from 1.
        row: usize,
        /// Column, from 1.
        column: usize,
        /// The word.
        word: String,
    },
}

/// Reads a matrix of `R` x `C` from text, by rows, in free layout.
///
/// # Errors
///
/// When a word is no number, or when there are not exactly `R * C`.
pub fn parse_matrix<const R: usize, const C: usize>(
    text: &str,
) -> Result<SMatrix<f64, R, C>, GainError> {
    let mut numbers = Vec::with_capacity(R * C);
    for word in text.split_ascii_whitespace() {
        let number = word.parse().ok().filter(|v: &f64| v.is_finite());
        numbers.push(number.ok_or_else(|| GainError::NotANumber {
            row: numbers.len() / C + 1,
            column: numbers.len() % C + 1,
            word: word.chars().take(40).collect(),
        })?);
    }
    if numbers.len() != R * C {
        return Err(GainError::Size {
            got: numbers.len(),
            rows: R,
            columns: C,
        });
    }
    Ok(SMatrix::from_row_slice(&numbers))
}

/// Magnitudes of a symmetric hover gain; the signs follow from where the motors are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoverGains {
    /// Height, (rad/s)/m: + on all motors.
    pub z: f64,
    /// psi and phi, (rad/s)/rad: (0, +, 0, -) and (-, 0, +, 0).
    pub tilt: f64,
    /// theta, (rad/s)/rad: (-, +, -, +).
    pub theta: f64,
    /// vqz, (rad/s)/(m/s): + on all motors.
    pub climb: f64,
    /// wqx and wqy, (rad/s)/(rad/s), signs of psi and phi.
    pub tilt_rate: f64,
    /// wqz, (rad/s)/(rad/s), signs of theta.
    pub theta_rate: f64,
}

/// Proportional gains: motors by states, (rad/s) per unit of the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Motors by states.
    pub matrix: SMatrix<f64, 4, STATES>,
}

impl Gains {
    /// The gains the thesis names: `K_prop_pptz`.
    pub const K_PROP_PPTZ: HoverGains = HoverGains {
        z: 8.812_977_5,
        tilt: 22.542_652,
        theta: 50.539_897,
        climb: 16.827_34,
        tilt_rate: 8.409_865_8,
        theta_rate: 23.500_497,
    };

    /// The law of the recorded run of March 2012, fitted to the recording (residual below 1e-12 rad/s).
    pub const MARCH_2012: HoverGains = HoverGains {
        z: 5.0,
        tilt: core::f64::consts::FRAC_1_SQRT_2,
        theta: 0.0,
        climb: 12.922_541_580_659_6,
        tilt_rate: 1.717_082_66,
        theta_rate: -0.5,
    };

    /// A symmetric hover gain on the full set; x, y and their velocities are left alone.
    #[must_use]
    pub fn from_pattern(h: &HoverGains) -> Self {
        let psi = [0.0, 1.0, 0.0, -1.0];
        let phi = [-1.0, 0.0, 1.0, 0.0];
        let theta = [-1.0, 1.0, -1.0, 1.0];
        let columns = [
            (2, [1.0; 4], h.z),
            (3, psi, h.tilt),
            (4, phi, h.tilt),
            (THETA, theta, h.theta),
            (8, [1.0; 4], h.climb),
            (9, psi, h.tilt_rate),
            (10, phi, h.tilt_rate),
            (11, theta, h.theta_rate),
        ];
        let mut matrix = SMatrix::<f64, 4, STATES>::zeros();
        for (column, signs, gain) in columns {
            matrix.set_column(column, &(SVector::from(signs) * gain));
        }
        Self { matrix }
    }

    /// Reads a file of 4 x 12 numbers, or of 4 x 8 for the reduced set (z, psi, phi, theta, vqz, wqx, wqy, wqz).
    ///
    /// # Errors
    ///
    /// When it is neither.
    pub fn parse(text: &str) -> Result<Self, GainError> {
        if text.split_ascii_whitespace().count() == 4 * REDUCED.len() {
            let reduced = parse_matrix::<4, 8>(text)?;
            let mut matrix = SMatrix::<f64, 4, STATES>::zeros();
            for (from, to) in REDUCED.into_iter().enumerate() {
                matrix.set_column(to, &reduced.column(from));
            }
            return Ok(Self { matrix });
        }
        Ok(Self {
            matrix: parse_matrix(text)?,
        })
    }
}

/// Largest errors that are acted upon.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorLimits {
    /// x and y, m.
    pub horizontal_m: f64,
    /// z, m.
    pub vertical_m: f64,
    /// theta, rad.
    pub theta_rad: f64,
}

impl Default for ErrorLimits {
    /// The final program.
    fn default() -> Self {
        Self {
            horizontal_m: 18.0,
            vertical_m: 4.0,
            theta_rad: 1.05,
        }
    }
}

impl ErrorLimits {
    /// Set point less state, limited; theta the short way round. What is no number is no error.
    #[must_use]
    pub fn error(&self, setpoint: &[f64; STATES], state: &[f64; STATES]) -> SVector<f64, STATES> {
        SVector::from_fn(|i, _| {
            let e = setpoint[i] - state[i];
            if !e.is_finite() {
                return 0.0;
            }
            match i {
                0 | 1 => e.clamp(-self.horizontal_m, self.horizontal_m),
                2 => e.clamp(-self.vertical_m, self.vertical_m),
                THETA => wrap_pi(e).clamp(-self.theta_rad, self.theta_rad),
                _ => e,
            }
        })
    }
}

/// Change of the four motor speeds, rad/s, to be added to those of the set point.
#[must_use]
pub fn proportional(
    gains: &Gains,
    limits: &ErrorLimits,
    setpoint: &[f64; STATES],
    state: &[f64; STATES],
) -> [f64; 4] {
    (gains.matrix * limits.error(setpoint, state)).into()
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    fn act(state: [f64; STATES]) -> [f64; 4] {
        let gains = Gains::from_pattern(&Gains::K_PROP_PPTZ);
        proportional(&gains, &ErrorLimits::default(), &[0.0; STATES], &state)
    }

    fn signs(index: usize) -> [i8; 4] {
        let mut state = [0.0; STATES];
        state[index] = -0.1;
        act(state).map(|w| if w > 0.0 { 1 } else { -i8::from(w < 0.0) })
    }

    #[test]
    fn every_column_has_the_signs_of_the_motors_places() {
        let table = [
            (2, [1, 1, 1, 1]),
            (8, [1, 1, 1, 1]),
            (3, [0, 1, 0, -1]),
            (9, [0, 1, 0, -1]),
            (4, [-1, 0, 1, 0]),
            (10, [-1, 0, 1, 0]),
            (5, [-1, 1, -1, 1]),
            (11, [-1, 1, -1, 1]),
            (0, [0; 4]),
            (1, [0; 4]),
            (6, [0; 4]),
            (7, [0; 4]),
        ];
        for (index, expected) in table {
            assert_eq!(signs(index), expected, "state {index}");
        }
    }

    #[test]
    fn no_error_no_action_and_far_errors_are_limited() {
        assert_eq!(act([0.0; STATES]), [0.0; 4]);
        let mut low = [0.0; STATES];
        low[2] = -100.0;
        assert!((act(low)[0] - 4.0 * 8.812_977_5).abs() < 1e-9);
        let mut turned = [0.0; STATES];
        turned[5] = 2.0 * core::f64::consts::PI - 0.1;
        assert!(
            (act(turned)[1] - 0.1 * 50.539_897).abs() < 1e-9,
            "the short way"
        );
        let mut nan = [0.0; STATES];
        nan[3] = f64::NAN;
        assert_eq!(act(nan), [0.0; 4]);
    }

    #[test]
    fn a_file_of_the_wrong_size_is_refused_with_the_expected_one() {
        let numbers = |n: usize| "1.5 ".repeat(n);
        assert!(Gains::parse(&numbers(48)).is_ok());
        let error = Gains::parse(&numbers(47)).unwrap_err();
        assert_eq!(error.to_string(), "47 numbers, 4 x 12 = 48 are needed");
        let error = Gains::parse(&numbers(48).replacen("1.5", "nan", 1)).unwrap_err();
        assert_eq!(error.to_string(), "row 1, column 1: `nan` is not a number");
    }

    #[test]
    fn an_eight_state_file_fills_its_columns_only() {
        let text: String = (0..32).map(|i| format!("{} ", i % 8 + 1)).collect();
        let gains = Gains::parse(&text).unwrap();
        let row: Vec<f64> = gains.matrix.row(3).iter().copied().collect();
        assert_eq!(
            row,
            [0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 0.0, 0.0, 5.0, 6.0, 7.0, 8.0]
        );
    }
}
