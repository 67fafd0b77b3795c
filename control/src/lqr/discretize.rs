//! Zero-order hold: the exact motion of `x' = A x + B u` over one period in which `u` stands still.

use nalgebra::SMatrix;

/// Largest |A| T that the series takes; beyond, the period is halved until it fits, and the steps are joined again.
const SERIES_REACH: f64 = 0.5;
/// 0.5^18 / 18! is below 1e-21.
const TERMS: u32 = 18;
/// Beyond this many halvings the model is not one of anything sampled.
const MAX_HALVINGS: u32 = 40;

/// `(phi, gamma)` of `x(k+1) = phi x(k) + gamma u(k)`: `phi = exp(A T)`, `gamma = (integral of exp(A t) from 0 to T) B`.
///
/// What is not finite stays so; [`crate::lqr::dare`] refuses it.
#[must_use]
pub fn zero_order_hold<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    period_s: f64,
) -> (SMatrix<f64, N, N>, SMatrix<f64, N, M>) {
    let mut step_s = period_s;
    let mut halvings = 0;
    while a.norm() * step_s > SERIES_REACH && halvings < MAX_HALVINGS {
        step_s /= 2.0;
        halvings += 1;
    }
    let identity = SMatrix::<f64, N, N>::identity();
    // phi = sum (A T)^k / k!, integral = T sum (A T)^k / (k + 1)!.
    let (mut phi, mut integral) = (identity, identity);
    let mut power = identity;
    for k in 1..=TERMS {
        power = power * a * (step_s / f64::from(k));
        phi += power;
        integral += power / f64::from(k + 1);
    }
    integral *= step_s;
    for _ in 0..halvings {
        integral += phi * integral;
        phi = phi * phi;
    }
    (phi, integral * b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn a_double_integrator_moves_by_half_t_squared() {
        let a = Matrix2::new(0.0, 1.0, 0.0, 0.0);
        let (phi, gamma) = zero_order_hold(&a, &Vector2::new(0.0, 1.0), 0.01);
        assert!((phi - Matrix2::new(1.0, 0.01, 0.0, 1.0)).norm() < 1e-16);
        assert!((gamma - Vector2::new(0.5e-4, 0.01)).norm() < 1e-16);
    }

    #[test]
    fn long_periods_turn_as_far_as_short_ones() {
        // A turn at 3 rad/s: exp(A T) is a rotation, whatever T.
        let a = Matrix2::new(0.0, -3.0, 3.0, 0.0);
        let (phi, gamma) = zero_order_hold(&a, &Vector2::new(1.0, 0.0), 4.0);
        let (s, c) = (libm::sin(12.0), libm::cos(12.0));
        assert!((phi - Matrix2::new(c, -s, s, c)).norm() < 1e-12);
        assert!((gamma - Vector2::new(s, 1.0 - c) / 3.0).norm() < 1e-12);
    }
}
