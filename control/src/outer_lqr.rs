//! LQR on the outer-loop model: place and height over an angle-mode controller, an alternative to the cascade (`control.variant = "lqr"`).
//!
//! One axis at a time, because the firmware keeps the attitude and the axes decouple:
//!
//! ```text
//! q' = e            integral of the error, near the goal only
//! p' = v
//! v' = a
//! a' = (u(t - dead time) - a) / lag
//! ```
//!
//! The dead time is two samples of the RC stream: commands that are on their way are states, known because we sent them. Gains come from the same Riccati
//! solver as uQuad's. Without a delay in the model the same weights would leave less than 6 dB.

use crate::lqr::riccati::{LqrError, dare};
use crate::lqr::zero_order_hold;
use nalgebra::{SMatrix, SVector};

/// States: integral, place error, velocity, acceleration, the last two commands (the older first).
const N: usize = 6;
/// Period of the design, s: the RC stream.
pub const PERIOD_S: f64 = 0.025;
/// The error of place is limited: farther away the vehicle is under way, m.
pub(crate) const REACH_M: f64 = 0.8;
/// Beyond this nothing is integrated, m.
const NEAR_M: f64 = 0.25;
/// Most that the integral may stand for, m/s2.
const INTEGRAL_MPS2: f64 = 1.5;

/// What an axis is like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisModel {
    /// From command to acceleration, first order, s.
    pub lag_s: f64,
    /// Weights of integral, place, velocity.
    pub weights: [f64; 3],
    /// Weight of the command.
    pub effort: f64,
}

impl AxisModel {
    /// Level: tilt follows within about 100 ms.
    pub const LEVEL: Self = Self {
        lag_s: 0.10,
        weights: [0.15, 2.2, 1.2],
        effort: 0.4,
    };
    /// Height: thrust follows within about 50 ms.
    pub const HEIGHT: Self = Self {
        lag_s: 0.05,
        weights: [1.0, 4.0, 2.0],
        effort: 0.3,
    };
}

/// Gains of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisGains {
    k: SVector<f64, N>,
}

impl AxisGains {
    /// Makes them.
    ///
    /// # Errors
    /// See [`dare`].
    pub fn new(model: &AxisModel) -> Result<Self, LqrError> {
        let (phi, gamma, q) = discrete(model);
        let r = SMatrix::<f64, 1, 1>::new(model.effort);
        let k = dare(&phi, &gamma, &q, &r)?.k;
        Ok(Self { k: k.transpose() })
    }

    /// Gain margins (lower, upper) as factors of the loop gain at which the closed loop is no longer stable, and the largest extra dead time, in
    /// samples, that it bears: by the eigenvalues of the model.
    #[must_use]
    pub fn margins(&self, model: &AxisModel) -> (f64, f64, u32) {
        let (phi, gamma, _) = discrete(model);
        let is_stable = |scale: f64| settles(&(phi - gamma * self.k.transpose() * scale));
        let mut up = 1.0;
        while up < 100.0 && is_stable(up) {
            up *= 1.02;
        }
        let mut down = 1.0;
        while down > 0.01 && is_stable(down) {
            down /= 1.02;
        }
        let mut extra = 0;
        while extra < 40 && self.bears(model, extra + 1) {
            extra += 1;
        }
        (down, up, extra)
    }

    /// Flies the model with more dead time than the law knows.
    fn bears(&self, model: &AxisModel, extra: u32) -> bool {
        let (phi, gamma, _) = discrete(model);
        let mut x = SVector::<f64, N>::zeros();
        x[1] = 1.0;
        let mut waiting = std::collections::VecDeque::from(vec![0.0; extra as usize]);
        let mut sent = [0.0; 2];
        let mut size = 0.0_f64;
        for n in 0..4000 {
            let mut seen = x;
            (seen[4], seen[5]) = (sent[0], sent[1]);
            let u = -self.k.dot(&seen);
            sent = [sent[1], u];
            waiting.push_back(u);
            let arrives = waiting.pop_front().unwrap_or(0.0);
            x = phi * x + gamma * arrives;
            if n > 3800 {
                size = size.max(x.amax());
            }
        }
        size.is_finite() && size < 0.05
    }
}

fn discrete(model: &AxisModel) -> (SMatrix<f64, N, N>, SMatrix<f64, N, 1>, SMatrix<f64, N, N>) {
    let mut a = SMatrix::<f64, 4, 4>::zeros();
    a[(0, 1)] = 1.0;
    a[(1, 2)] = 1.0;
    a[(2, 3)] = 1.0;
    a[(3, 3)] = -1.0 / model.lag_s;
    let mut b = SMatrix::<f64, 4, 1>::zeros();
    b[(3, 0)] = 1.0 / model.lag_s;
    let (phi4, gamma4) = zero_order_hold(&a, &b, PERIOD_S);
    let mut phi = SMatrix::<f64, N, N>::zeros();
    phi.fixed_view_mut::<4, 4>(0, 0).copy_from(&phi4);
    // The older command acts now, the newer one takes its place, u joins.
    phi.fixed_view_mut::<4, 1>(0, 4).copy_from(&gamma4);
    phi[(4, 5)] = 1.0;
    let mut gamma = SMatrix::<f64, N, 1>::zeros();
    gamma[(5, 0)] = 1.0;
    let mut q = SMatrix::<f64, N, N>::zeros();
    for (i, weight) in model.weights.into_iter().enumerate() {
        q[(i, i)] = weight;
    }
    // What is on its way costs nothing by itself; a little keeps the problem well posed.
    q[(3, 3)] = 1e-3;
    (phi, gamma, q)
}

/// All eigenvalues inside the unit circle: powers vanish.
fn settles(m: &SMatrix<f64, N, N>) -> bool {
    let mut power = *m;
    for _ in 0..14 {
        power *= power;
        if !power.amax().is_finite() || power.amax() > 1e12 {
            return false;
        }
    }
    power.amax() < 1e-3
}

/// One axis in flight.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisLaw {
    gains: AxisGains,
    integral: f64,
    sent: [f64; 2],
}

impl AxisLaw {
    /// At rest.
    #[must_use]
    pub const fn new(gains: AxisGains) -> Self {
        Self {
            gains,
            integral: 0.0,
            sent: [0.0; 2],
        }
    }

    /// From an acceleration that is flown already, m/s2.
    pub fn reset(&mut self, accel_mps2: f64) {
        let accel = if accel_mps2.is_finite() {
            accel_mps2
        } else {
            0.0
        };
        self.integral = 0.0;
        self.sent = [accel; 2];
    }

    /// Acceleration to ask for, m/s2: `error_m` is place less goal (zero where only velocity is asked for), velocity less that of the goal,
    /// acceleration now; limited to `most`.
    pub fn step(
        &mut self,
        dt_s: f64,
        error_m: Option<f64>,
        velocity_mps: f64,
        accel_mps2: f64,
        most_mps2: f64,
    ) -> f64 {
        let k = &self.gains.k;
        let error = error_m.unwrap_or(0.0).clamp(-REACH_M, REACH_M);
        let mut x = SVector::<f64, N>::zeros();
        x[0] = self.integral;
        x[1] = error;
        x[2] = velocity_mps;
        x[3] = accel_mps2.clamp(-most_mps2, most_mps2);
        (x[4], x[5]) = (self.sent[0], self.sent[1]);
        let raw = -k.dot(&x);
        let u = if raw.is_finite() {
            raw.clamp(-most_mps2, most_mps2)
        } else {
            0.0
        };
        let is_free = (raw - u).abs() < 1e-9;
        if is_free && error_m.is_some_and(|e| e.abs() < NEAR_M) {
            let most = INTEGRAL_MPS2 / k[0].abs().max(1e-6);
            self.integral = (self.integral + error * dt_s).clamp(-most, most);
        }
        self.sent = [self.sent[1], u];
        u
    }

    /// What the integral stands for, m/s2, and moves a part of it elsewhere (the hover throttle).
    pub fn give(&mut self, share: f64) -> f64 {
        let part = -self.gains.k[0] * self.integral * share;
        self.integral *= 1.0 - share;
        part
    }
}

/// Three axes.
#[derive(Clone, Debug, PartialEq)]
pub struct OuterLqr {
    /// North and east.
    pub level: [AxisLaw; 2],
    /// Up.
    pub height: AxisLaw,
}

impl OuterLqr {
    /// Makes the gains.
    ///
    /// # Errors
    /// See [`dare`].
    pub fn new() -> Result<Self, LqrError> {
        let level = AxisLaw::new(AxisGains::new(&AxisModel::LEVEL)?);
        Ok(Self {
            level: [level.clone(), level],
            height: AxisLaw::new(AxisGains::new(&AxisModel::HEIGHT)?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[allow(clippy::print_stdout, reason = "figures")]
    fn the_margins_are_six_decibels_and_eighty_milliseconds() {
        println!("FIGURES");
        for (name, model) in [("level", AxisModel::LEVEL), ("height", AxisModel::HEIGHT)] {
            let gains = AxisGains::new(&model).unwrap();
            let (down, up, extra) = gains.margins(&model);
            let db = |x: f64| 20.0 * libm::log10(x);
            println!(
                "outer LQR, {name}: K {:.3?}, gain margin {:+.1} and {:+.1} dB, {} ms of dead time more",
                gains.k.as_slice(),
                db(down),
                db(up),
                extra * 25
            );
            assert!(db(up) >= 6.0 && db(down) <= -6.0, "{name}: {down} {up}");
            assert!(extra >= 3, "{name}: {extra}");
        }
        println!("END");
    }

    #[test]
    fn a_step_of_a_metre_overshoots_less_than_a_tenth_and_settles_in_three_seconds() {
        let gains = AxisGains::new(&AxisModel::LEVEL).unwrap();
        let (phi, gamma, _) = discrete(&AxisModel::LEVEL);
        let mut law = AxisLaw::new(gains);
        let mut x = SVector::<f64, N>::zeros();
        x[1] = -1.0;
        let (mut most, mut settled) = (-1.0_f64, 0.0);
        for n in 0..400 {
            let u = law.step(PERIOD_S, Some(x[1]), x[2], x[3], 2.2);
            x = phi * x + gamma * u;
            most = most.max(x[1]);
            if x[1].abs() > 0.05 {
                settled = f64::from(n) * PERIOD_S;
            }
        }
        assert!(most < 0.10 && settled < 3.0, "{most} {settled}");
    }
}
