//! The discrete algebraic Riccati equation `P = A'PA - A'PB (R + B'PB)^-1 B'PA + Q` by structured doubling.
//!
//! Each round looks twice as far ahead, so 16 rounds see 65,536 samples; the fixed-point iteration of the thesis takes each of them. (Its own
//! model with integrals needs 13,491 rounds to its own bound and is still 0.011 off.)
//!
//! ```text
//! A(k+1) = A V A,  G(k+1) = G + A V G A',  H(k+1) = H + A' H V A,   V = (I + G H)^-1
//! A(0) = A,        G(0) = B R^-1 B',       H(0) = Q
//! ```
//!
//! H tends to P, G to the solution of the dual equation, and A to zero exactly when the closed loop is stable: that is the test for it.

use nalgebra::{Cholesky, Const, DimMin, SMatrix};

/// Rounds: 2^26 samples of 10 ms are a week. A loop that needs longer to settle is not controlled.
const MAX_ROUNDS: u32 = 26;
/// Change of P in one round, relative, at which the next (its square) is below rounding.
const SETTLED: f64 = 1e-12;
/// The closed loop after that many samples, relative to one sample.
const VANISHED: f64 = 1e-6;
/// Largest residual of the equation that is called a solution, relative.
const MAX_RESIDUAL: f64 = 1e-8;
/// Asymmetry and negative eigenvalues of Q up to this are rounding, relative.
const ROUNDING: f64 = 1e-10;

/// Why there are no gains.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LqrError {
    /// A number of the model or of the weights is none.
    #[error("{0} has an entry that is no finite number")]
    NotFinite(&'static str),
    /// R is not symmetric and positive definite.
    #[error(
        "R is not symmetric and positive definite: every motor needs a weight greater than zero"
    )]
    InputWeight,
    /// Q is not symmetric and positive semi-definite.
    #[error("Q is not symmetric and positive: no state may have a weight less than zero")]
    StateWeight,
    /// Part of the model is out of reach of the inputs, or nothing in Q sees it.
    #[error(
        "these motors cannot settle this model with these weights: a part of it is out of their reach, or no weight sees it"
    )]
    Unstabilizable,
    /// Found, but not to be trusted.
    #[error(
        "the Riccati equation is solved to {residual:.1e} only (1e-8 is needed): scale the model or the weights"
    )]
    IllConditioned {
        /// Residual of the equation over the size of its solution.
        residual: f64,
    },
}

/// The solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution<const N: usize, const M: usize> {
    /// Cost to go, N x N.
    pub p: SMatrix<f64, N, N>,
    /// Gains, `u = -K x`.
    pub k: SMatrix<f64, M, N>,
    /// Rounds of doubling that were needed.
    pub rounds: u32,
}

/// Gains that minimise the sum of `x'Qx + u'Ru` over `x(k+1) = A x + B u`.
///
/// # Errors
///
/// The rule that the model or the weights break.
pub fn dare<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    q: &SMatrix<f64, N, N>,
    r: &SMatrix<f64, M, M>,
) -> Result<Solution<N, M>, LqrError>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    finite("A", a)?;
    finite("B", b)?;
    finite("Q", q)?;
    finite("R", r)?;
    if !is_symmetric(q) || !is_positive_semidefinite(q) {
        return Err(LqrError::StateWeight);
    }
    let r_factor = is_symmetric(r)
        .then(|| Cholesky::new(*r))
        .flatten()
        .ok_or(LqrError::InputWeight)?;

    let (p, rounds) = double(a, &(b * r_factor.solve(&b.transpose())), q)?;
    let bp = b.transpose() * p;
    let k = Cholesky::new(r + bp * b)
        .ok_or(LqrError::Unstabilizable)?
        .solve(&(bp * a));
    let residual = (a.transpose() * (p * (a - b * k)) + q - p).norm() / p.norm();
    // False for NaN.
    if residual <= MAX_RESIDUAL {
        Ok(Solution { p, k, rounds })
    } else {
        Err(LqrError::IllConditioned { residual })
    }
}

fn double<const N: usize>(
    a: &SMatrix<f64, N, N>,
    g: &SMatrix<f64, N, N>,
    q: &SMatrix<f64, N, N>,
) -> Result<(SMatrix<f64, N, N>, u32), LqrError>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let (mut a, mut g, mut h) = (*a, *g, *q);
    let first = a.norm();
    for round in 1..=MAX_ROUNDS {
        let w = (SMatrix::<f64, N, N>::identity() + g * h).lu();
        let (Some(va), Some(vg)) = (w.solve(&a), w.solve(&g)) else {
            return Err(LqrError::Unstabilizable);
        };
        let at = a.transpose();
        let growth = symmetric(at * (h * va));
        g += symmetric(a * (vg * at));
        h += growth;
        a *= va;
        let (growth, size, ahead) = (growth.norm(), h.norm(), a.norm());
        if !(size.is_finite() && ahead.is_finite()) {
            return Err(LqrError::Unstabilizable);
        }
        if growth <= SETTLED * size && ahead <= VANISHED * first {
            return Ok((h, round));
        }
    }
    Err(LqrError::Unstabilizable)
}

fn finite<const R: usize, const C: usize>(
    name: &'static str,
    m: &SMatrix<f64, R, C>,
) -> Result<(), LqrError> {
    if m.iter().all(|v| v.is_finite()) {
        Ok(())
    } else {
        Err(LqrError::NotFinite(name))
    }
}

fn symmetric<const N: usize>(m: SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    (m + m.transpose()) * 0.5
}

fn is_symmetric<const N: usize>(m: &SMatrix<f64, N, N>) -> bool {
    (m - m.transpose()).amax() <= ROUNDING * m.amax()
}

fn is_positive_semidefinite<const N: usize>(m: &SMatrix<f64, N, N>) -> bool {
    // A little more than nothing on the diagonal makes zero eigenvalues positive, and leaves real negative ones negative.
    let floor = (ROUNDING * m.amax()).max(f64::MIN_POSITIVE);
    Cholesky::new(m + SMatrix::identity() * floor).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1, Matrix2, SVector, Vector2};

    fn double_integrator() -> (Matrix2<f64>, Vector2<f64>) {
        (Matrix2::new(1.0, 0.01, 0.0, 1.0), Vector2::new(5e-5, 0.01))
    }

    #[test]
    fn a_scalar_agrees_with_the_quadratic_formula() {
        // p = a^2 p r / (r + p) + q with b = 1: p^2 + p (r - a^2 r - q) - q r = 0.
        let (a, q, r) = (1.2, 2.0, 0.5);
        let s = dare(
            &Matrix1::new(a),
            &Matrix1::new(1.0),
            &Matrix1::new(q),
            &Matrix1::new(r),
        )
        .unwrap();
        let linear = r - a * a * r - q;
        let p = (-linear + libm::sqrt(linear * linear + 4.0 * q * r)) / 2.0;
        assert!((s.p[0] - p).abs() < 1e-14, "{} {p}", s.p[0]);
        assert!((s.k[0] - a * p / (r + p)).abs() < 1e-14);
    }

    #[test]
    fn weights_that_are_not_positive_are_named() {
        let (a, b) = double_integrator();
        let (q, r) = (Matrix2::identity(), Matrix1::new(1.0));
        for bad in [0.0, -1.0] {
            assert_eq!(
                dare(&a, &b, &q, &Matrix1::new(bad)),
                Err(LqrError::InputWeight)
            );
        }
        for bad in [
            Matrix2::new(1.0, 0.0, 0.0, -1e-3),
            Matrix2::new(1.0, 0.2, 0.1, 1.0),
            Matrix2::new(1.0, 2.0, 2.0, 1.0),
        ] {
            assert_eq!(dare(&a, &b, &bad, &r), Err(LqrError::StateWeight), "{bad}");
        }
        let only_position = Matrix2::new(1.0, 0.0, 0.0, 0.0);
        assert!(dare(&a, &b, &only_position, &r).is_ok(), "zero is allowed");
    }

    #[test]
    fn what_is_no_number_is_named() {
        let (a, b) = double_integrator();
        let (q, r) = (Matrix2::identity(), Matrix1::new(1.0));
        let nan = Matrix2::new(1.0, f64::NAN, 0.0, 1.0);
        assert_eq!(dare(&nan, &b, &q, &r), Err(LqrError::NotFinite("A")));
        let inf = Vector2::new(f64::INFINITY, 0.0);
        assert_eq!(dare(&a, &inf, &q, &r), Err(LqrError::NotFinite("B")));
        assert_eq!(dare(&a, &b, &nan, &r), Err(LqrError::NotFinite("Q")));
        let none = Matrix1::new(f64::NAN);
        assert_eq!(dare(&a, &b, &q, &none), Err(LqrError::NotFinite("R")));
    }

    #[test]
    fn what_the_inputs_do_not_reach_or_the_weights_do_not_see_is_refused() {
        let (a, b) = double_integrator();
        let r = Matrix1::new(1.0);
        let out_of_reach = Vector2::zeros();
        assert_eq!(
            dare(&a, &out_of_reach, &Matrix2::identity(), &r),
            Err(LqrError::Unstabilizable)
        );
        let growing = Matrix2::new(1.1, 0.0, 0.0, 0.9);
        let other = Vector2::new(0.0, 1.0);
        assert_eq!(
            dare(&growing, &other, &Matrix2::identity(), &r),
            Err(LqrError::Unstabilizable)
        );
        let unseen = Matrix2::new(0.0, 0.0, 0.0, 1.0);
        assert_eq!(dare(&a, &b, &unseen, &r), Err(LqrError::Unstabilizable));
    }

    #[test]
    fn a_huge_model_is_an_error_and_no_panic() {
        let a = Matrix2::repeat(1e200);
        let b: SVector<f64, 2> = SVector::repeat(1e-200);
        let error = dare(&a, &b, &Matrix2::identity(), &Matrix1::new(1.0)).unwrap_err();
        assert_eq!(error, LqrError::Unstabilizable);
    }
}
