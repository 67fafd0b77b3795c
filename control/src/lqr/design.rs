//! Gains around a trim.
//!
//! | Function | States | Integrals |
//! | --- | --- | --- |
//! | [`twelve`] | all | - |
//! | [`eight`] | z, angles, vqz, rates (no position source) | - |
//! | [`twelve_and_integrals`] | all | x, y, z, theta |
//! | [`eight_and_integrals`] | the eight | psi, phi, z, theta |
//!
//! Angles cannot be integrated beside horizontal velocity: the integral of psi is vqy but for a factor, so no input moves one without the
//! other, and the model with all sixteen is refused. That is why the thesis zeroes columns, and why the set with psi and phi has eight states here.
//!
//! A gain holds for the heading it was made for (x and y are the world's): make it again, or turn the error into the body's axes.

use super::discretize::zero_order_hold;
use super::motion::Motion;
use super::riccati::{LqrError, dare};
use super::trim::Trim;
use crate::integral::{COLUMNS_OF_PPZT, COLUMNS_OF_XYZT, Columns, IntegralAction};
use crate::proportional::{GainError, Gains, REDUCED, parse_matrix};
use nalgebra::{Const, DimMin, SMatrix};

/// Period the gains are made for, s.
pub const PERIOD_S: f64 = 0.01;

/// Weights: `sum of x'Qx + u'Ru`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Of the twelve states and then of the four integrals (in the order of the set), 16 x 16.
    pub q: SMatrix<f64, 16, 16>,
    /// Of the four motor speeds.
    pub r: SMatrix<f64, 4, 4>,
}

impl Weights {
    /// Diagonal weights.
    #[must_use]
    pub fn diagonal(states: [f64; 12], integrals: [f64; 4], inputs: f64) -> Self {
        let mut q = SMatrix::zeros();
        for (i, weight) in states.into_iter().chain(integrals).enumerate() {
            q[(i, i)] = weight;
        }
        Self {
            q,
            r: SMatrix::identity() * inputs,
        }
    }

    /// The thesis's `lqr-Q.txt` and `lqr-R.txt`: 1000 on the angles, 1 on the rest, 0.1 on the motors. (Its Matlab model has 0.01 there.)
    #[must_use]
    pub fn uquad() -> Self {
        let mut states = [1.0; 12];
        states[3..6].fill(1e3);
        Self::diagonal(states, [1.0; 4], 0.1)
    }

    /// Tighter, for rooms (chosen; the weights of the reference vectors): a metre of error is worth 100 rad/s of one motor.
    #[must_use]
    pub fn indoor() -> Self {
        let states = [
            10.0, 10.0, 20.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 0.1, 0.1, 0.1,
        ];
        Self::diagonal(states, [2.0, 2.0, 4.0, 0.5], 0.001)
    }

    /// Reads Q (16 x 16) and R (4 x 4), text by rows in free layout.
    ///
    /// # Errors
    ///
    /// When one has another size, or a word that is no number.
    pub fn parse(q: &str, r: &str) -> Result<Self, GainError> {
        Ok(Self {
            q: parse_matrix(q)?,
            r: parse_matrix(r)?,
        })
    }
}

/// Gains ready to fly in [`crate::state_feedback::StateFeedback`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Design {
    /// Proportional gains; columns of states that are left out are zero.
    pub gains: Gains,
    /// Integral gains and what their columns are, with a set that has integrals.
    pub integral: Option<(SMatrix<f64, 4, 4>, Columns)>,
    /// Where they hold.
    pub trim: Trim,
}

impl Design {
    /// The integrals, at zero.
    #[must_use]
    pub fn integral_action(&self) -> Option<IntegralAction> {
        self.integral
            .map(|(gains, columns)| IntegralAction::new(gains, columns))
    }
}

const ALL: [usize; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];

/// LQR on all states.
///
/// # Errors
///
/// See [`dare`].
pub fn twelve(motion: &Motion, trim: &Trim, weights: &Weights) -> Result<Design, LqrError> {
    solve::<12, 12>(motion, trim, weights, &ALL, None)
}

/// LQR without position and horizontal velocity.
///
/// # Errors
///
/// See [`dare`].
pub fn eight(motion: &Motion, trim: &Trim, weights: &Weights) -> Result<Design, LqrError> {
    solve::<8, 8>(motion, trim, weights, &REDUCED, None)
}

/// LQR on all states and the integrals of x, y, z, theta.
///
/// # Errors
///
/// See [`dare`].
pub fn twelve_and_integrals(
    motion: &Motion,
    trim: &Trim,
    weights: &Weights,
) -> Result<Design, LqrError> {
    solve::<12, 16>(motion, trim, weights, &ALL, Some(COLUMNS_OF_XYZT))
}

/// LQR on the eight states and the integrals of psi, phi, z, theta.
///
/// # Errors
///
/// See [`dare`].
pub fn eight_and_integrals(
    motion: &Motion,
    trim: &Trim,
    weights: &Weights,
) -> Result<Design, LqrError> {
    solve::<8, 12>(motion, trim, weights, &REDUCED, Some(COLUMNS_OF_PPZT))
}

/// The model with `S` states out of twelve and `N - S` (none or four) integrals, discrete, and its weights.
fn solve<const S: usize, const N: usize>(
    motion: &Motion,
    trim: &Trim,
    weights: &Weights,
    states: &[usize; S],
    integrals: Option<Columns>,
) -> Result<Design, LqrError>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let (full_a, full_b) = motion.jacobians(&trim.state, &trim.inputs);
    let mut a = SMatrix::<f64, N, N>::zeros();
    let mut b = SMatrix::<f64, N, 4>::zeros();
    for (i, &from) in states.iter().enumerate() {
        for (j, &by) in states.iter().enumerate() {
            a[(i, j)] = full_a[(from, by)];
        }
        b.set_row(i, &full_b.row(from));
    }
    for (i, variable) in integrals.into_iter().flatten().enumerate() {
        if let Some(j) = states.iter().position(|&s| s == variable.state()) {
            a[(S + i, j)] = 1.0;
        }
    }
    let weighed = |i: usize| states.get(i).copied().unwrap_or(12 + i - S);
    let q = SMatrix::<f64, N, N>::from_fn(|i, j| weights.q[(weighed(i), weighed(j))]);
    let (phi, gamma) = zero_order_hold(&a, &b, PERIOD_S);
    let k = dare(&phi, &gamma, &q, &weights.r)?.k;

    let mut matrix = SMatrix::<f64, 4, 12>::zeros();
    for (i, &to) in states.iter().enumerate() {
        matrix.set_column(to, &k.column(i));
    }
    let integral = integrals.map(|columns| {
        let gains = SMatrix::<f64, 4, 4>::from_fn(|motor, i| k[(motor, S + i)]);
        (gains, columns)
    });
    Ok(Design {
        gains: Gains { matrix },
        integral,
        trim: *trim,
    })
}

/// A matrix with the twelve states and any four integrals: what the thesis's program would solve. For the test that it cannot be.
#[cfg(test)]
pub(crate) fn sixteen(
    motion: &Motion,
    trim: &Trim,
    weights: &Weights,
    columns: Columns,
) -> Result<Design, LqrError> {
    solve::<12, 16>(motion, trim, weights, &ALL, Some(columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hover() -> (Motion, Trim, Weights) {
        let motion = Motion::uquad();
        (motion, Trim::hover(&motion.craft, 0.0), Weights::uquad())
    }

    fn assert_close(what: &str, got: f64, golden: f64) {
        assert!(
            (got - golden).abs() <= 6e-6,
            "{what}: {got}, golden {golden}"
        );
    }

    #[test]
    fn golden_gains_with_twelve_states_and_integrals_of_x_y_z_theta() {
        let (motion, trim, weights) = hover();
        let design = twelve_and_integrals(&motion, &trim, &weights).unwrap();
        let golden = [
            7.86594, 7.86594, 6.98336, 38.02816, 38.02816, 49.64708, 13.30705, 13.30705, 14.70915,
            10.96966, 10.96966, 23.11667,
        ];
        for (i, golden) in golden.into_iter().enumerate() {
            let column = design.gains.matrix.column(i);
            assert_close(&format!("state {i}"), column.amax(), golden);
        }
        let (gains, _) = design.integral.unwrap();
        for (i, golden) in [2.15098, 2.15098, 1.57355, 1.54703].into_iter().enumerate() {
            assert_close(&format!("integral {i}"), gains.column(i).amax(), golden);
        }
    }

    #[test]
    fn golden_gains_with_eight_states_and_integrals_of_psi_phi_z_theta() {
        let (motion, trim, weights) = hover();
        let design = eight_and_integrals(&motion, &trim, &weights).unwrap();
        let golden = [
            0.0, 0.0, 6.98336, 25.70423, 25.70423, 49.64708, 0.0, 0.0, 14.70915, 9.2436, 9.2436,
            23.11667,
        ];
        for (i, golden) in golden.into_iter().enumerate() {
            let column = design.gains.matrix.column(i);
            assert_close(&format!("state {i}"), column.amax(), golden);
        }
        let (gains, columns) = design.integral.unwrap();
        assert_eq!(columns, COLUMNS_OF_PPZT);
        for (i, golden) in [2.16435, 2.16435, 1.57355, 1.54703].into_iter().enumerate() {
            assert_close(&format!("integral {i}"), gains.column(i).amax(), golden);
        }
    }

    #[test]
    fn signs_are_those_of_the_motors_places() {
        let (motion, trim, weights) = hover();
        let k = twelve_and_integrals(&motion, &trim, &weights)
            .unwrap()
            .gains
            .matrix;
        let table = [
            (0, [-1, 0, 1, 0]),
            (1, [0, -1, 0, 1]),
            (2, [1, 1, 1, 1]),
            (3, [0, 1, 0, -1]),
            (4, [-1, 0, 1, 0]),
            (5, [-1, 1, -1, 1]),
        ];
        for (column, signs) in table {
            let got = k.column(column).map(|v| {
                if v.abs() < 1e-9 {
                    0
                } else if v > 0.0 {
                    1
                } else {
                    -1
                }
            });
            assert_eq!(<[i32; 4]>::from(got), signs, "state {column}");
        }
    }

    #[test]
    fn integrals_of_angles_beside_horizontal_velocity_are_refused_as_unstabilisable() {
        let (motion, trim, weights) = hover();
        let refused = sixteen(&motion, &trim, &weights, COLUMNS_OF_PPZT);
        assert_eq!(refused, Err(LqrError::Unstabilizable));
    }

    #[test]
    fn weights_of_the_wrong_size_or_sign_are_refused() {
        let (motion, trim, weights) = hover();
        assert!(Weights::parse(&"1 ".repeat(256), &"1 ".repeat(15)).is_err());
        assert!(Weights::parse(&"1 ".repeat(255), &"1 ".repeat(16)).is_err());
        let mut bad = weights;
        bad.r[(2, 2)] = -0.1;
        assert_eq!(twelve(&motion, &trim, &bad), Err(LqrError::InputWeight));
        let mut bad = weights;
        bad.q[(4, 4)] = -1.0;
        assert_eq!(eight(&motion, &trim, &bad), Err(LqrError::StateWeight));
    }
}
