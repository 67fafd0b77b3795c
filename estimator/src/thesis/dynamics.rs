//! Equations of motion (one Euler step) and their analytic Jacobian.
//!
//! uQuad's program differs from the physics in four places, each a switch of [`Equations`]:
//!
//! | Where | Program | Physics |
//! | --- | --- | --- |
//! | x row, factor of vqy sin theta | cos phi | cos psi |
//! | z row, factor of vqz | cos^2 psi | cos phi cos psi |
//! | yaw drag | March 2012: motors 0, 2 push theta up; final: down | down: the control law's sign pattern raises theta with motors 1, 3 |
//! | gyroscopic torque of the rotors | + wqy G on x, + wqx G on y | - wqy G on x, + wqx G on y: a gyroscopic torque does no work |

use super::{ANGLES, BIAS, POSITION, RATES, STATES, Square, State, VELOCITY};
use vehicle::UquadAirframe;
use vehicle::uquad::GRAVITY_MPS2;

/// Below this |cos phi| the angles' rates are those at 89 degrees: the equations are singular at 90.
const MIN_COS_PHI: f64 = 0.017;

/// Which misprints are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Equations {
    /// x row with cos phi instead of cos psi.
    pub has_legacy_x: bool,
    /// z row with cos^2 psi instead of cos phi cos psi.
    pub has_legacy_z: bool,
    /// Motors 0 and 2 push theta up.
    pub has_legacy_yaw: bool,
    /// Gyroscopic torque with two equal signs.
    pub has_legacy_gyroscope: bool,
}

impl Equations {
    /// The physics.
    pub const CORRECTED: Self = Self {
        has_legacy_x: false,
        has_legacy_z: false,
        has_legacy_yaw: false,
        has_legacy_gyroscope: false,
    };
    /// The final program.
    pub const FINAL: Self = Self {
        has_legacy_x: true,
        has_legacy_z: true,
        has_legacy_yaw: false,
        has_legacy_gyroscope: true,
    };
    /// The recorded run of March 2012.
    pub const MARCH_2012: Self = Self {
        has_legacy_yaw: true,
        ..Self::FINAL
    };
}

/// What the state and the motors say about this step.
struct Trig {
    sin: [f64; 3],
    cos: [f64; 3],
    /// cos phi kept away from zero.
    safe_cos_phi: f64,
}

impl Trig {
    fn of(state: &State) -> Self {
        let angle = |i: usize| state[ANGLES + i];
        let cos = [0, 1, 2].map(|i| libm::cos(angle(i)));
        Self {
            sin: [0, 1, 2].map(|i| libm::sin(angle(i))),
            cos,
            safe_cos_phi: cos[1].abs().max(MIN_COS_PHI).copysign(cos[1]),
        }
    }
}

/// The state one step later, and the specific force of the rotors (m/s2) that explains the accelerometer's z.
#[must_use]
pub fn step(
    state: &State,
    speeds_radps: &[f64; 4],
    dt_s: f64,
    craft: &UquadAirframe,
    equations: Equations,
) -> (State, f64) {
    let t = Trig::of(state);
    let ([s_psi, s_phi, s_th], [c_psi, c_phi, c_th]) = (t.sin, t.cos);
    let t_phi = s_phi / t.safe_cos_phi;
    let [vx, vy, vz] = [0, 1, 2].map(|i| state[VELOCITY + i]);
    let [wx, wy, wz] = [0, 1, 2].map(|i| state[RATES + i]);
    let [bx, by, bz] = [0, 1, 2].map(|i| state[BIAS + i]);
    let thrust = speeds_radps.map(|w| craft.thrust_n(w));
    let drag = speeds_radps.map(|w| craft.drag_nm(w));
    let lift = thrust.iter().sum::<f64>() / craft.mass_kg;
    let spin = rotor_momentum(speeds_radps, craft);
    let g = GRAVITY_MPS2;
    let (ixy, iz) = (craft.inertia_xy, craft.inertia_z);

    let across = if equations.has_legacy_x { c_phi } else { c_psi };
    let upright = if equations.has_legacy_z { c_psi } else { c_phi };
    let spin_x = if equations.has_legacy_gyroscope {
        spin
    } else {
        -spin
    };
    let yaw_sign = if equations.has_legacy_yaw { 1.0 } else { -1.0 };

    let rate = State::from([
        vx * c_phi * c_th
            + vy * (c_th * s_phi * s_psi - across * s_th)
            + vz * (s_psi * s_th + c_psi * c_th * s_phi),
        vx * c_phi * s_th
            + vy * (s_th * s_phi * s_psi + c_psi * c_th)
            + vz * (c_psi * s_th * s_phi - c_th * s_psi),
        -vx * s_phi + vy * c_phi * s_psi + vz * c_psi * upright,
        wx + wz * t_phi * c_psi + wy * t_phi * s_psi,
        wy * c_psi - wz * s_psi,
        (wz * c_psi + wy * s_psi) / t.safe_cos_phi,
        vy * wz - vz * wy + g * s_phi + bx,
        vz * wx - vx * wz - g * c_phi * s_psi + by,
        vx * wy - vy * wx - g * c_phi * c_psi + lift + bz,
        (wy * wz * (ixy - iz) + wy * spin_x + craft.arm_m * (thrust[1] - thrust[3])) / ixy,
        (wx * wz * (iz - ixy) + wx * spin + craft.arm_m * (thrust[2] - thrust[0])) / ixy,
        yaw_sign * (drag[0] - drag[1] + drag[2] - drag[3]) / iz,
        0.0,
        0.0,
        0.0,
    ]);
    (state + rate * dt_s, lift)
}

/// Angular momentum of the rotors about z, kg m2/s.
fn rotor_momentum(speeds: &[f64; 4], craft: &UquadAirframe) -> f64 {
    craft.rotor_inertia * (speeds[0] - speeds[1] + speeds[2] - speeds[3])
}

/// Jacobian of [`step`] with respect to the state.
#[must_use]
pub fn jacobian(
    state: &State,
    speeds_radps: &[f64; 4],
    dt_s: f64,
    craft: &UquadAirframe,
    equations: Equations,
) -> Square {
    let t = Trig::of(state);
    let ([s_psi, s_phi, s_th], [c_psi, c_phi, c_th]) = (t.sin, t.cos);
    let t_phi = s_phi / t.safe_cos_phi;
    let sec_phi = 1.0 / t.safe_cos_phi;
    let [vx, vy, vz] = [0, 1, 2].map(|i| state[VELOCITY + i]);
    let [wx, wy, wz] = [0, 1, 2].map(|i| state[RATES + i]);
    let spin = rotor_momentum(speeds_radps, craft);
    let g = GRAVITY_MPS2;
    let (ixy, iz) = (craft.inertia_xy, craft.inertia_z);
    const X: usize = POSITION;
    const Y: usize = POSITION + 1;
    const Z: usize = POSITION + 2;
    const PSI: usize = ANGLES;
    const PHI: usize = ANGLES + 1;
    const TH: usize = ANGLES + 2;
    const VX: usize = VELOCITY;
    const VY: usize = VELOCITY + 1;
    const VZ: usize = VELOCITY + 2;
    const WX: usize = RATES;
    const WY: usize = RATES + 1;
    const WZ: usize = RATES + 2;

    // `across` and `upright` as in `step`, with their derivatives.
    let (across, across_psi, across_phi) = if equations.has_legacy_x {
        (c_phi, 0.0, -s_phi)
    } else {
        (c_psi, -s_psi, 0.0)
    };
    let (up, up_psi, up_phi) = if equations.has_legacy_z {
        (c_psi * c_psi, -2.0 * c_psi * s_psi, 0.0)
    } else {
        (c_phi * c_psi, -c_phi * s_psi, -s_phi * c_psi)
    };
    let spin_x = if equations.has_legacy_gyroscope {
        spin
    } else {
        -spin
    };

    let mut f = Square::zeros();
    f[(X, PSI)] = vy * (c_th * s_phi * c_psi - across_psi * s_th)
        + vz * (c_psi * s_th - s_psi * c_th * s_phi);
    f[(X, PHI)] = -vx * s_phi * c_th
        + vy * (c_th * c_phi * s_psi - across_phi * s_th)
        + vz * c_psi * c_th * c_phi;
    f[(X, TH)] = -vx * c_phi * s_th - vy * (s_th * s_phi * s_psi + across * c_th)
        + vz * (s_psi * c_th - c_psi * s_th * s_phi);
    f[(X, VX)] = c_phi * c_th;
    f[(X, VY)] = c_th * s_phi * s_psi - across * s_th;
    f[(X, VZ)] = s_psi * s_th + c_psi * c_th * s_phi;

    f[(Y, PSI)] =
        vy * (s_th * s_phi * c_psi - s_psi * c_th) - vz * (s_psi * s_th * s_phi + c_th * c_psi);
    f[(Y, PHI)] = -vx * s_phi * s_th + vy * s_th * c_phi * s_psi + vz * c_psi * s_th * c_phi;
    f[(Y, TH)] = vx * c_phi * c_th
        + vy * (c_th * s_phi * s_psi - c_psi * s_th)
        + vz * (c_psi * c_th * s_phi + s_th * s_psi);
    f[(Y, VX)] = c_phi * s_th;
    f[(Y, VY)] = s_th * s_phi * s_psi + c_psi * c_th;
    f[(Y, VZ)] = c_psi * s_th * s_phi - c_th * s_psi;

    f[(Z, PSI)] = vy * c_phi * c_psi + vz * up_psi;
    f[(Z, PHI)] = -vx * c_phi - vy * s_phi * s_psi + vz * up_phi;
    f[(Z, VX)] = -s_phi;
    f[(Z, VY)] = c_phi * s_psi;
    f[(Z, VZ)] = up;

    f[(PSI, PSI)] = t_phi * (wy * c_psi - wz * s_psi);
    f[(PSI, PHI)] = (wz * c_psi + wy * s_psi) * sec_phi * sec_phi;
    f[(PSI, WX)] = 1.0;
    f[(PSI, WY)] = t_phi * s_psi;
    f[(PSI, WZ)] = t_phi * c_psi;
    f[(PHI, PSI)] = -wy * s_psi - wz * c_psi;
    f[(PHI, WY)] = c_psi;
    f[(PHI, WZ)] = -s_psi;
    f[(TH, PSI)] = (wy * c_psi - wz * s_psi) * sec_phi;
    f[(TH, PHI)] = (wz * c_psi + wy * s_psi) * t_phi * sec_phi;
    f[(TH, WY)] = s_psi * sec_phi;
    f[(TH, WZ)] = c_psi * sec_phi;

    f[(VX, PHI)] = g * c_phi;
    f[(VX, VY)] = wz;
    f[(VX, VZ)] = -wy;
    f[(VX, WY)] = -vz;
    f[(VX, WZ)] = vy;
    f[(VY, PSI)] = -g * c_phi * c_psi;
    f[(VY, PHI)] = g * s_phi * s_psi;
    f[(VY, VX)] = -wz;
    f[(VY, VZ)] = wx;
    f[(VY, WX)] = vz;
    f[(VY, WZ)] = -vx;
    f[(VZ, PSI)] = g * c_phi * s_psi;
    f[(VZ, PHI)] = g * s_phi * c_psi;
    f[(VZ, VX)] = wy;
    f[(VZ, VY)] = -wx;
    f[(VZ, WX)] = -vy;
    f[(VZ, WY)] = vx;
    for i in 0..3 {
        f[(VELOCITY + i, BIAS + i)] = 1.0;
    }

    f[(WX, WY)] = (wz * (ixy - iz) + spin_x) / ixy;
    f[(WX, WZ)] = wy * (ixy - iz) / ixy;
    f[(WY, WX)] = (wz * (iz - ixy) + spin) / ixy;
    f[(WY, WZ)] = wx * (iz - ixy) / ixy;

    f *= dt_s;
    for i in 0..STATES {
        f[(i, i)] += 1.0;
    }
    f
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SPEEDS: [f64; 4] = [300.0, 310.0, 320.0, 333.0];

    fn numeric(state: &State, equations: Equations) -> Square {
        let craft = UquadAirframe::default();
        let mut f = Square::zeros();
        for j in 0..STATES {
            let h = 1e-6 * state[j].abs().max(1.0);
            let (mut low, mut high) = (*state, *state);
            low[j] -= h;
            high[j] += h;
            let difference = step(&high, &SPEEDS, 0.01, &craft, equations).0
                - step(&low, &SPEEDS, 0.01, &craft, equations).0;
            f.set_column(j, &(difference / (high[j] - low[j])));
        }
        f
    }

    proptest! {
        #[test]
        fn the_jacobian_is_that_of_the_step(
            x in proptest::collection::vec(-1.2..1.2f64, STATES),
            velocity in proptest::collection::vec(-5.0..5.0f64, 3),
        ) {
            let mut state = State::from_column_slice(&x);
            state.fixed_rows_mut::<3>(VELOCITY).copy_from_slice(&velocity);
            for equations in [Equations::CORRECTED, Equations::FINAL, Equations::MARCH_2012] {
                let analytic = jacobian(&state, &SPEEDS, 0.01, &UquadAirframe::default(), equations);
                let numeric = numeric(&state, equations);
                prop_assert!((analytic - numeric).amax() < 1e-7, "{equations:?}: {}", analytic - numeric);
            }
        }

        #[test]
        fn corrected_position_rows_are_a_rotation_of_the_body_velocity(
            angles in proptest::collection::vec(-1.2..1.2f64, 3),
        ) {
            let mut state = State::zeros();
            state.fixed_rows_mut::<3>(ANGLES).copy_from_slice(&angles);
            let speed = |v: [f64; 3]| {
                let mut s = state;
                s.fixed_rows_mut::<3>(VELOCITY).copy_from_slice(&v);
                let moved = step(&s, &SPEEDS, 1.0, &UquadAirframe::default(), Equations::CORRECTED).0;
                moved.fixed_rows::<3>(POSITION).into_owned()
            };
            let columns = [speed([1.0, 0.0, 0.0]), speed([0.0, 1.0, 0.0]), speed([0.0, 0.0, 1.0])];
            let r = nalgebra::Matrix3::from_columns(&columns);
            prop_assert!((r * r.transpose() - nalgebra::Matrix3::identity()).amax() < 1e-12);
            prop_assert!((r.determinant() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn rotors_do_no_work_on_the_body_by_turning() {
        let craft = UquadAirframe::default();
        let mut state = State::zeros();
        state[RATES] = 0.7;
        state[RATES + 1] = -0.4;
        let work = |equations| {
            // Without rates the same speeds give the same torques but the gyroscopic one.
            let turning = step(&state, &SPEEDS, 1.0, &craft, equations).0 - state;
            let still = step(&State::zeros(), &SPEEDS, 1.0, &craft, equations).0;
            (0..3)
                .map(|i| (turning[RATES + i] - still[RATES + i]) * state[RATES + i])
                .sum::<f64>()
        };
        assert!(work(Equations::CORRECTED).abs() < 1e-15);
        assert!(work(Equations::FINAL).abs() > 1e-6);
    }

    #[test]
    fn each_motor_turns_the_craft_as_its_place_says() {
        let craft = UquadAirframe::default();
        let hover = craft.hover_speed_radps();
        let turned = |motor: usize| {
            let mut speeds = [hover; 4];
            speeds[motor] += 10.0;
            let s = step(&State::zeros(), &speeds, 1.0, &craft, Equations::CORRECTED).0;
            [s[RATES], s[RATES + 1], s[RATES + 2]]
                .map(|w| if w.abs() < 1e-9 { 0.0 } else { w.signum() })
        };
        assert_eq!(turned(0), [0.0, -1.0, -1.0], "front: nose up, clockwise");
        assert_eq!(
            turned(1),
            [1.0, 0.0, 1.0],
            "left: right side down, counter-clockwise"
        );
        assert_eq!(turned(2), [0.0, 1.0, -1.0], "rear: nose down, clockwise");
        assert_eq!(
            turned(3),
            [-1.0, 0.0, 1.0],
            "right: left side down, counter-clockwise"
        );
    }

    #[test]
    fn a_level_hover_stays_where_it_is() {
        let craft = UquadAirframe::default();
        let speeds = [craft.hover_speed_radps(); 4];
        let (next, lift) = step(&State::zeros(), &speeds, 0.01, &craft, Equations::CORRECTED);
        assert!(next.amax() < 1e-12 && (lift - GRAVITY_MPS2).abs() < 1e-9);
    }

    #[test]
    fn the_nose_straight_up_stays_finite() {
        let mut state = State::from_element(1.0);
        state[ANGLES + 1] = -core::f64::consts::FRAC_PI_2;
        let craft = UquadAirframe::default();
        let next = step(&state, &SPEEDS, 0.01, &craft, Equations::CORRECTED).0;
        let f = jacobian(&state, &SPEEDS, 0.01, &craft, Equations::CORRECTED);
        assert!(next.amax() < 100.0 && f.amax() < 1e3);
    }
}
