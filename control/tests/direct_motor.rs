//! Optimal gains fly the simulator's direct-motor airframe, which has what their model leaves out: motor lag (40 ms), drag, another mass, gusts.

#![allow(
    clippy::disallowed_methods,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use control::integral::{IntegralAction, Integrated, Thresholds};
use control::lqr::{Motion, Trim, Weights, design, trim::Circle};
use control::proportional::ErrorLimits;
use control::state_feedback::{StateFeedback, StateSetpoint};
use nalgebra::Vector3;
use sim::MotorCraft;
use vehicle::UquadAirframe;

/// Idle speed and what the driver accepts.
const SPEEDS_RADPS: (f64, f64) = (105.0, 368.16);

fn law_at(trim: &Trim, scale: f64) -> StateFeedback {
    let motion = Motion::of(UquadAirframe::default());
    let design = design::twelve_and_integrals(&motion, trim, &Weights::indoor()).unwrap();
    let mut gains = design.gains;
    gains.matrix *= scale;
    let indoor = Thresholds::INDOOR_HORIZONTAL;
    let (integral_gains, columns) = design.integral.unwrap();
    let integral = Some(IntegralAction::new(integral_gains * scale, columns)).map(|i| {
        i.with_thresholds(Integrated::X, indoor)
            .with_thresholds(Integrated::Y, indoor)
    });
    StateFeedback {
        gains,
        limits: ErrorLimits::default(),
        integral,
    }
}

fn hover_at(position: [f64; 3], theta: f64) -> StateSetpoint {
    let mut state = [0.0; 12];
    state[..3].copy_from_slice(&position);
    state[5] = theta;
    StateSetpoint {
        state,
        speeds_radps: [UquadAirframe::default().hover_speed_radps(); 4],
    }
}

/// Flies for some seconds, 100 Hz; `each` sees the truth after every sample.
fn fly(
    craft: &mut MotorCraft,
    law: &mut StateFeedback,
    seconds: f64,
    mut setpoint: impl FnMut(f64) -> StateSetpoint,
    mut each: impl FnMut(f64, &MotorCraft),
) {
    for sample in 0..(seconds * 100.0) as u32 {
        let t = f64::from(sample) * 0.01;
        let (_, limited) =
            law.act_within(&setpoint(t), &craft.motion().states(), 0.01, SPEEDS_RADPS);
        (0..10).for_each(|_| craft.step(limited));
        each(t + 0.01, craft);
    }
}

/// Time after which it stays within 5 cm of (1, 0, 1), and the largest x.
fn step_response(mass: f64, gust: f64, scale: f64, theta: f64) -> (f64, f64) {
    let heavy = UquadAirframe {
        mass_kg: 1.7 * mass,
        ..UquadAirframe::default()
    };
    let mut craft = MotorCraft::hovering(heavy, Vector3::new(0.0, 0.0, 1.0), theta);
    let nominal = UquadAirframe::default();
    let mut law = law_at(&Trim::hover(&nominal, theta), scale);
    // It has found its weight and the wind before the step.
    craft.push(Vector3::new(0.0, gust, 0.0));
    fly(
        &mut craft,
        &mut law,
        20.0,
        |_| hover_at([0.0, 0.0, 1.0], theta),
        |_, _| {},
    );
    let (mut settled, mut most) = (0.0, 0.0_f64);
    let goal = Vector3::new(1.0, 0.0, 1.0);
    fly(
        &mut craft,
        &mut law,
        10.0,
        |_| hover_at([1.0, 0.0, 1.0], theta),
        |t, craft| {
            let p = craft.motion().position_m;
            most = most.max(p.x);
            if (p - goal).norm() > 0.05 {
                settled = t;
            }
        },
    );
    (settled, most)
}

#[test]
fn a_step_of_one_metre_settles_in_three_seconds() {
    println!("FIGURES");
    for theta in [0.0, 1.3] {
        let (settled, most) = step_response(1.0, 0.0, 1.0, theta);
        println!(
            "1 m step, theta {theta}: within 5 cm after {settled:.2} s (bar 3), x at most {most:.3} m"
        );
        assert!(settled < 3.0, "{settled}");
    }
    println!("END");
}

#[test]
fn another_mass_and_a_gust_are_flown() {
    println!("FIGURES");
    for (mass, gust) in [(0.8, 0.0), (1.2, 0.0), (1.0, 0.5), (1.2, -0.5)] {
        let (settled, most) = step_response(mass, gust, 1.0, 0.0);
        println!(
            "mass x {mass}, gust {gust} N: within 5 cm after {settled:.2} s, x at most {most:.3} m"
        );
        // The heavy one has 7 % of speed left above its hover: it sinks while it tilts.
        assert!(settled < 3.0, "mass {mass}, gust {gust}: {settled}");
    }
    println!("END");
}

#[test]
fn gains_half_and_twice_as_large_still_settle_so_the_margin_is_6_db() {
    println!("FIGURES");
    for scale in [0.5, 2.0] {
        let (settled, _) = step_response(1.0, 0.0, scale, 0.0);
        println!("gains x {scale}: within 5 cm after {settled:.2} s");
        assert!(settled < 9.0, "gains x {scale}: {settled}");
    }
    println!("END");
}

#[test]
fn a_circle_at_one_metre_a_second_is_tracked_within_ten_centimetres() {
    let motion = Motion::of(UquadAirframe::default());
    let circle = Circle {
        speed_mps: 1.0,
        rate_radps: 0.5,
        bearing_rad: 0.0,
    };
    let start = Trim::circle(&motion, &circle, 0.0).unwrap();
    // Gains are made again each tenth of a radian, as a job beside the loop would.
    let mut law = law_at(&start, 1.0);
    let mut craft = MotorCraft::hovering(motion.craft, Vector3::new(0.0, 0.0, 1.0), 0.0);
    let (cx, cy) = circle.centre_m(0.0, 0.0, 0.0);
    assert!(
        cx.abs() < 1e-12 && (cy - 2.0).abs() < 1e-12 && (circle.radius_m() - 2.0).abs() < 1e-12
    );
    let mut worst = 0.0_f64;
    for sample in 0..4000 {
        let t = f64::from(sample) * 0.01;
        let theta = 0.5 * t;
        let trim = Trim::circle(&motion, &circle, theta).unwrap();
        if sample % 20 == 0 {
            law.gains = law_at(&trim, 1.0).gains;
        }
        let mut state: [f64; 12] = trim.state.into();
        state[0] = 2.0 * theta.sin();
        state[1] = 2.0 - 2.0 * theta.cos();
        state[2] = 1.0;
        let setpoint = StateSetpoint {
            state,
            speeds_radps: trim.inputs.into(),
        };
        let (_, limited) = law.act_within(&setpoint, &craft.motion().states(), 0.01, SPEEDS_RADPS);
        (0..10).for_each(|_| craft.step(limited));
        let p = craft.motion().position_m;
        let now = theta + 0.005;
        let off = p - Vector3::new(2.0 * now.sin(), 2.0 - 2.0 * now.cos(), 1.0);
        // The first five seconds it catches up from standing.
        if t > 5.0 {
            worst = worst.max(off.norm());
        }
    }
    println!("FIGURES\ncircle 1 m/s, 0.5 rad/s: at most {worst:.3} m off (bar 0.10)\nEND");
    assert!(worst < 0.10, "{worst}");
}

/// State of the loop as it is flown: 12 states, 4 integrals, 4 lagging motors, 4 speeds that wait for a sample.
const LOOP: usize = 24;

/// The closed loop over one sample with all gains scaled.
fn loop_matrix(scale: f64) -> nalgebra::SMatrix<f64, LOOP, LOOP> {
    type M<const R: usize, const C: usize> = nalgebra::SMatrix<f64, R, C>;
    const MOTOR_LAG_S: f64 = 0.040;
    let motion = Motion::of(UquadAirframe::default());
    let hover = Trim::hover(&motion.craft, 0.0);
    let design = design::twelve_and_integrals(&motion, &hover, &Weights::indoor()).unwrap();
    let (a, b) = motion.jacobians(&hover.state, &hover.inputs);
    let (integral_gains, columns) = design.integral.unwrap();
    let mut ac = M::<20, 20>::zeros();
    ac.fixed_view_mut::<12, 12>(0, 0).copy_from(&a);
    ac.fixed_view_mut::<12, 4>(0, 16).copy_from(&b);
    for (i, variable) in columns.into_iter().enumerate() {
        ac[(12 + i, variable.state())] = 1.0;
    }
    let mut bc = M::<20, 4>::zeros();
    for i in 0..4 {
        ac[(16 + i, 16 + i)] = -1.0 / MOTOR_LAG_S;
        bc[(16 + i, i)] = 1.0 / MOTOR_LAG_S;
    }
    let (phi, gamma) = control::lqr::zero_order_hold(&ac, &bc, 0.01);
    let mut k = M::<4, 20>::zeros();
    k.fixed_view_mut::<4, 12>(0, 0)
        .copy_from(&design.gains.matrix);
    k.fixed_view_mut::<4, 4>(0, 12).copy_from(&integral_gains);
    let mut m = M::<LOOP, LOOP>::zeros();
    m.fixed_view_mut::<20, 20>(0, 0).copy_from(&phi);
    // Commands computed from a frame act from the next one on.
    m.fixed_view_mut::<20, 4>(0, 20).copy_from(&gamma);
    m.fixed_view_mut::<4, 20>(20, 0).copy_from(&(-k * scale));
    m
}

/// All eigenvalues inside the unit circle: its powers vanish.
fn is_stable(scale: f64) -> bool {
    let mut power = loop_matrix(scale);
    for _ in 0..16 {
        power *= power;
        if power.amax() > 1e12 || power.amax().is_nan() {
            return false;
        }
    }
    power.amax() < 1e-3
}

#[test]
fn the_gain_margin_computed_with_motor_lag_and_a_sample_of_delay_is_six_decibels() {
    assert!(is_stable(1.0));
    let (mut up, mut down) = (1.0, 1.0);
    while up < 100.0 && is_stable(up) {
        up *= 1.02;
    }
    while down > 0.01 && is_stable(down) {
        down /= 1.02;
    }
    let db = |x: f64| 20.0 * x.log10();
    println!(
        "FIGURES\ngain margin of uQuad's loop, all gains together, 40 ms motor lag and 10 ms of delay: {:+.1} dB and {:+.1} dB (bar 6)\nEND",
        db(down),
        db(up)
    );
    assert!(db(up) >= 6.0 && db(down) <= -6.0, "{down} {up}");
}
