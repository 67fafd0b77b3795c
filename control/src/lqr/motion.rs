//! Equations of motion of a craft with four fixed rotors, and their linearisation.
//!
//! States (12): x y z (m, world, z up), psi phi theta (rad: about x, y, z, turned in the order z y x), vqx vqy vqz (m/s, body, x forward, y
//! left, z up), wqx wqy wqz (rad/s, body). Inputs (4): speeds of the motors front, left, rear, right, rad/s.
//!
//! ```text
//! p'  = R v
//! (psi, phi, theta)' = E(psi, phi) w
//! v'  = (0, 0, sum T / m) - R^T (0, 0, g) - w x v
//! w'  = J^-1 (tau - w x J w - w x (0, 0, h)),   h = Jr (w0 - w1 + w2 - w3)
//! tau = (L (T1 - T3), L (T2 - T0), -(D0 - D1 + D2 - D3)) - c m g (cos phi sin psi, sin phi, 0)
//! ```
//!
//! The last term is the thesis's: the centre of mass hangs c below the rotors, and the weight is taken to right the craft. It is used to find gains only
//! ([`Motion::gravity_arm_m`], 0.07 m); the thesis's filter and its simulation do without. Its program writes the Jacobian out and
//! slips in five entries; here it is the derivative of these equations.

use super::dual::{Dual, Real};
use nalgebra::{SMatrix, SVector};
use vehicle::UquadAirframe;
use vehicle::uquad::GRAVITY_MPS2;

/// The twelve states.
pub type State = SVector<f64, 12>;
/// The four motor speeds, rad/s.
pub type Inputs = SVector<f64, 4>;
/// Derivative by the states.
pub type StateMatrix = SMatrix<f64, 12, 12>;
/// Derivative by the inputs.
pub type InputMatrix = SMatrix<f64, 12, 4>;

/// How the craft moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Mass, inertia, thrust and drag.
    pub craft: UquadAirframe,
    /// How far the centre of mass hangs below the rotors for the righting moment, m; 0 = no such moment.
    pub gravity_arm_m: f64,
}

impl Motion {
    /// The craft and the linearisation of the thesis.
    #[must_use]
    pub fn uquad() -> Self {
        Self {
            craft: UquadAirframe::default(),
            gravity_arm_m: 0.07,
        }
    }

    /// Without the righting moment.
    #[must_use]
    pub const fn of(craft: UquadAirframe) -> Self {
        Self {
            craft,
            gravity_arm_m: 0.0,
        }
    }

    /// Derivative of the state with time. Singular at |phi| = 90 degrees.
    #[must_use]
    pub fn derivative(&self, state: &State, inputs: &Inputs) -> State {
        State::from(self.flow((*state).into(), (*inputs).into()))
    }

    /// Derivatives of [`derivative`](Self::derivative) by the states and by the inputs, exact.
    #[must_use]
    pub fn jacobians(&self, state: &State, inputs: &Inputs) -> (StateMatrix, InputMatrix) {
        let along = |direction: usize| {
            let dual = |value: f64, index: usize| Dual {
                value,
                slope: if index == direction { 1.0 } else { 0.0 },
            };
            let x = core::array::from_fn(|i| dual(state[i], i));
            let u = core::array::from_fn(|i| dual(inputs[i], 12 + i));
            State::from(self.flow(x, u).map(|d| d.slope))
        };
        let mut a = StateMatrix::zeros();
        let mut b = InputMatrix::zeros();
        (0..12).for_each(|i| a.set_column(i, &along(i)));
        (0..4).for_each(|i| b.set_column(i, &along(12 + i)));
        (a, b)
    }

    fn flow<T: Real>(&self, x: [T; 12], u: [T; 4]) -> [T; 12] {
        let [_, _, _, psi, phi, theta, vx, vy, vz, wx, wy, wz] = x;
        let c = &self.craft;
        let (g, m) = (GRAVITY_MPS2, c.mass_kg);
        let (s1, c1) = psi.sin_cos();
        let (s2, c2) = phi.sin_cos();
        let (s3, c3) = theta.sin_cos();
        let polynomial = |(square, linear): (f64, f64), w: T| w * w * square + w * linear;
        let [t0, t1, t2, t3] = u.map(|w| polynomial(c.thrust, w));
        let [d0, d1, d2, d3] = u.map(|w| polynomial(c.drag, w));
        let h = (u[0] - u[1] + u[2] - u[3]) * c.rotor_inertia;
        let righting = self.gravity_arm_m * m * g;
        let (jxy, jz) = (c.inertia_xy, c.inertia_z);
        [
            c3 * c2 * vx + (c3 * s2 * s1 - s3 * c1) * vy + (c3 * s2 * c1 + s3 * s1) * vz,
            s3 * c2 * vx + (s3 * s2 * s1 + c3 * c1) * vy + (s3 * s2 * c1 - c3 * s1) * vz,
            c2 * s1 * vy + c2 * c1 * vz - s2 * vx,
            wx + (s1 * wy + c1 * wz) * s2 / c2,
            c1 * wy - s1 * wz,
            (s1 * wy + c1 * wz) / c2,
            vy * wz - vz * wy + s2 * g,
            vz * wx - vx * wz - c2 * s1 * g,
            vx * wy - vy * wx - c2 * c1 * g + (t0 + t1 + t2 + t3) / m,
            ((t1 - t3) * c.arm_m - c2 * s1 * righting - wy * wz * (jz - jxy) - wy * h) / jxy,
            ((t2 - t0) * c.arm_m - s2 * righting + wx * wz * (jz - jxy) + wx * h) / jxy,
            -(d0 - d1 + d2 - d3) / jz,
        ]
    }
}
