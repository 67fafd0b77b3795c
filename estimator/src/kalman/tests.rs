//! The filter read as a specification.

use super::aid::{self, Observation};
use super::update::Quality;
use super::*;
use nalgebra::UnitQuaternion;
use proptest::prelude::*;
use vehicle::Timestamp;
use vehicle::airframe::GRAVITY_MPS2;

fn some_state(seed: f64) -> Nominal {
    let s = |k: f64| libm::sin(seed * k);
    Nominal {
        position: Vector3::new(s(1.1), s(2.3), -1.2 + 0.3 * s(3.7)),
        velocity: Vector3::new(s(4.9), s(5.3), 0.3 * s(6.1)),
        attitude: UnitQuaternion::from_euler_angles(0.4 * s(7.7), 0.4 * s(8.3), 3.0 * s(9.1)),
        accel_bias: Vector3::new(s(10.3), s(11.9), s(12.7)) * 0.1,
        gyro_bias: Vector3::new(s(13.1), s(14.3), s(15.7)) * 0.02,
    }
}

/// Compares a row with central differences of the model.
fn check_row(name: &str, state: &Nominal, model: impl Fn(&Nominal) -> Observation) {
    let eps = 1e-6;
    let row = *model(state).row();
    for i in 0..STATES {
        let mut e = ErrorVector::zeros();
        e[i] = eps;
        let (plus, minus) = (model(&state.plus(&e)), model(&state.plus(&-e)));
        let mut difference = plus.predicted - minus.predicted;
        if plus.is_angle() {
            difference = vehicle::angle::wrap_pi(difference);
        }
        let numeric = difference / (2.0 * eps);
        assert!(
            (numeric - row[i]).abs() < 1e-6 * (1.0 + numeric.abs()),
            "{name}: derivative {i} is {} but the model changes by {numeric}",
            row[i]
        );
    }
}

proptest! {
    #[test]
    fn every_row_equals_the_central_difference_of_its_model(seed in 0.1..50.0f64) {
        let state = some_state(seed);
        let gyro = Vector3::new(0.3, -0.2, 0.1);
        check_row("roll", &state, |s| aid::attitude::roll(s).unwrap());
        check_row("pitch", &state, |s| aid::attitude::pitch(s).unwrap());
        check_row("yaw", &state, aid::yaw::observe);
        check_row("height", &state, |s| aid::height::observe(s, 0.2));
        check_row("baro", &state, |s| aid::baro::observe(s, 0.4));
        let mut window = aid::heading_increment::Window::new(Timestamp::ZERO, 0.1);
        window.integrate(&state, &gyro, 0.5);
        check_row("heading increment", &state, |s| window.observe(s, 0.3).0);
        for i in 0..2 {
            check_row("flow", &state, |s| aid::flow::observe(s, &gyro, 0.1).unwrap()[i]);
        }
        check_row("position", &state, |s| aid::position::observe_along(s, [0.6, 0.8]));
        for i in 0..3 {
            check_row("velocity", &state, |s| aid::velocity::observe(s)[i]);
            check_row("rate", &state, |s| aid::rate::observe(s)[i]);
        }
    }

    #[test]
    fn the_covariance_stays_symmetric_and_positive_whatever_is_fused(
        seed in 0.1..50.0f64,
        steps in proptest::collection::vec((0usize..8, -1.0..1.0f64, 1e-3..1.0f64, 1_000u64..60_000), 1..200),
    ) {
        let mut filter = running(some_state(seed));
        let mut at = Timestamp::ZERO;
        for (which, measured, std, dt_us) in steps {
            at = Timestamp::from_us(at.us() + dt_us);
            filter.predict(&ImuSample {
                at,
                accel_mps2: In::new(measured, 0.5, -9.8),
                gyro_radps: In::new(0.1, measured, 0.5),
                mag: None,
            });
            let q = Quality::white(std);
            let s = *filter.state();
            let gyro = Vector3::new(0.1, 0.2, 0.3);
            match which {
                0 => { if let Some(o) = aid::attitude::roll(&s) { filter.fuse(Aid::Roll, at, &o, measured, q); } }
                1 => { if let Some(o) = aid::attitude::pitch(&s) { filter.fuse(Aid::Pitch, at, &o, measured, q); } }
                2 => { filter.fuse(Aid::PoseYaw, at, &aid::yaw::observe(&s), measured, q); }
                3 => { filter.fuse(Aid::Height, at, &aid::height::observe(&s, 0.0), 1.0 + measured, q); }
                4 => { if let Some([x, _]) = aid::flow::observe(&s, &gyro, 0.0) { filter.fuse(Aid::FlowX, at, &x, measured, q); } }
                5 => { filter.fuse(Aid::PoseLong, at, &aid::position::observe_along(&s, [0.8, -0.6]), measured * 5.0, q); }
                6 => { filter.relocate(measured, -measured, measured * 3.0, std, std); }
                _ => { filter.fuse(Aid::VelocityDown, at, &aid::velocity::observe(&s)[2], measured, q); }
            }
        }
        let p = filter.covariance();
        prop_assert!(filter.state().is_finite());
        for i in 0..STATES { for j in 0..STATES {
            prop_assert!((p[(i, j)] - p[(j, i)]).abs() <= f64::EPSILON, "not symmetric at {i}, {j}");
        }}
        let lowest = p.symmetric_eigenvalues().min();
        prop_assert!(lowest > -1e-9 * p.diagonal().max(), "eigenvalue {lowest}");
    }

    #[test]
    fn samples_that_are_not_numbers_are_refused_and_change_nothing(which in 0usize..6, bad in prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY), Just(1e9)]) {
        let mut filter = running(some_state(1.0));
        let before = *filter.state();
        let mut v = [0.0, 0.0, -9.8, 0.0, 0.0, 0.0];
        v[which] = bad;
        let used = filter.predict(&ImuSample {
            at: Timestamp::from_ms(25),
            accel_mps2: In::new(v[0], v[1], v[2]),
            gyro_radps: In::new(v[3], v[4], v[5]),
            mag: None,
        });
        prop_assert!(!used);
        if !bad.is_finite() {
            let o = aid::height::observe(&before, 0.0);
            prop_assert!(!filter.fuse(Aid::Height, Timestamp::from_ms(30), &o, bad, Quality::white(0.1)));
        }
        prop_assert_eq!(*filter.state(), before);
    }
}

fn running(state: Nominal) -> Filter {
    let mut filter = Filter::new(ProcessNoise::default());
    filter.start(
        Timestamp::ZERO,
        state,
        InitialStd {
            position_m: 0.1,
            height_m: 0.1,
            velocity_mps: 0.1,
            tilt_rad: 0.05,
            yaw_rad: 0.1,
        },
    );
    filter
}

fn at_rest(ms: u64) -> ImuSample {
    ImuSample {
        at: Timestamp::from_ms(ms),
        accel_mps2: In::new(0.0, 0.0, -GRAVITY_MPS2),
        gyro_radps: In::zero(),
        mag: None,
    }
}

#[test]
fn level_at_rest_stays_where_it_is() {
    let mut filter = running(Nominal::default());
    for k in 1..=400 {
        assert!(filter.predict(&at_rest(25 * k)));
    }
    assert!(filter.state().position.norm() < 1e-9);
    assert!(filter.state().velocity.norm() < 1e-9);
}

#[test]
fn a_steady_turn_at_forty_hertz_is_integrated_without_loss() {
    // On a circle of 1 m at 2 rad/s: 2 m/s forward, 4 m/s2 to the right; irregular spacing 20 - 30 ms.
    let mut filter = running(Nominal {
        velocity: Vector3::new(2.0, 0.0, 0.0),
        ..Nominal::default()
    });
    let mut us = 0;
    let imu = |us: u64| ImuSample {
        at: Timestamp::from_us(us),
        accel_mps2: In::new(0.0, 4.0, -GRAVITY_MPS2),
        gyro_radps: In::new(0.0, 0.0, 2.0),
        mag: None,
    };
    for k in 0..126 {
        us += 20_000 + (k * 7919) % 10_000;
        filter.predict(&imu(us));
    }
    let t = us as f64 * 1e-6;
    let truth = Vector3::new(libm::sin(2.0 * t), 1.0 - libm::cos(2.0 * t), 0.0);
    let error = (filter.state().position - truth).norm();
    assert!(error < 0.01, "position is off by {error} m after {t} s");
}

#[test]
fn after_a_second_without_samples_velocity_is_held_and_doubted() {
    let mut filter = running(Nominal {
        velocity: Vector3::new(1.0, 0.0, 0.0),
        ..Nominal::default()
    });
    filter.predict(&at_rest(25));
    let before = filter.std_of(VELOCITY).x();
    filter.predict(&at_rest(1025));
    assert!((filter.state().position.x - 1.025).abs() < 0.01);
    assert!(filter.std_of(VELOCITY).x() > before + 1.0);
    // Old and repeated samples change nothing.
    assert!(!filter.predict(&at_rest(1025)));
    assert!(!filter.predict(&at_rest(500)));
}

#[test]
fn in_hover_without_a_heading_source_yaw_doubt_only_grows() {
    let mut filter = running(Nominal {
        position: Vector3::new(0.0, 0.0, -1.0),
        ..Nominal::default()
    });
    let mut last = filter.yaw_std_rad();
    for k in 1..=2400 {
        let imu = at_rest(25 * k);
        filter.predict(&imu);
        let s = *filter.state();
        let q = Quality::white(0.02);
        filter.fuse(Aid::Roll, imu.at, &aid::attitude::roll(&s).unwrap(), 0.0, q);
        filter.fuse(
            Aid::Pitch,
            imu.at,
            &aid::attitude::pitch(&s).unwrap(),
            0.0,
            q,
        );
        filter.fuse(Aid::Height, imu.at, &aid::height::observe(&s, 0.0), 1.0, q);
        for (o, a) in aid::flow::observe(&s, &Vector3::zeros(), 0.0)
            .unwrap()
            .iter()
            .zip([Aid::FlowX, Aid::FlowY])
        {
            filter.fuse(a, imu.at, o, 0.0, q);
        }
        if k % 100 == 0 {
            let now = filter.yaw_std_rad();
            assert!(
                now >= last,
                "yaw std fell from {last} to {now} at sample {k}"
            );
            last = now;
        }
    }
}

#[test]
fn relocating_turns_velocity_with_the_heading_and_keeps_the_tilt() {
    let mut filter = running(Nominal {
        velocity: Vector3::new(1.0, 0.0, 0.2),
        attitude: UnitQuaternion::from_euler_angles(0.1, -0.05, 0.0),
        ..Nominal::default()
    });
    filter.relocate(3.0, 4.0, core::f64::consts::FRAC_PI_2, 0.1, 0.05);
    let s = filter.state();
    assert!((s.velocity - Vector3::new(0.0, 1.0, 0.2)).norm() < 1e-9);
    let (r, p, y) = s.roll_pitch_yaw();
    assert!((r - 0.1).abs() < 1e-9 && (p + 0.05).abs() < 1e-9);
    assert!((y - core::f64::consts::FRAC_PI_2).abs() < 1e-9);
    assert!((filter.yaw_std_rad() - 0.05).abs() < 0.005);
    assert!((filter.std_of(POSITION).x() - 0.1).abs() < 1e-9);
}
