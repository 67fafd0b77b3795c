use super::*;
use crate::imu::GRAVITY_MPS2;

const DT: f64 = 0.01;

fn filter(change: impl Fn(&mut ThesisConfig)) -> ThesisFilter {
    let mut config = ThesisConfig::default();
    change(&mut config);
    ThesisFilter::new(config).unwrap()
}

fn hover() -> [f64; 4] {
    [UquadAirframe::default().hover_speed_radps(); 4]
}

/// Level and at rest.
fn still() -> ThesisInput {
    ThesisInput {
        accel_mps2: Vector3::new(0.0, 0.0, GRAVITY_MPS2),
        accel_is_good: true,
        mag_is_good: true,
        ..ThesisInput::default()
    }
}

#[test]
fn a_craft_at_rest_stays_at_rest() {
    let mut f = filter(|_| {});
    for _ in 0..6000 {
        assert!(f.step(DT, &hover(), &still()).unwrap().is_empty());
    }
    assert!(f.state().amax() < 1e-9, "{}", f.state());
}

#[test]
fn yaw_is_continuous_over_three_turns() {
    let mut f = filter(|c| c.noise.is_dynamic = false);
    let rate = 1.0;
    let mut last = 0.0;
    let end = 6.0 * core::f64::consts::PI;
    let steps = (end / rate / DT) as usize;
    for k in 1..=steps {
        let truth = rate * DT * k as f64;
        let mut input = still();
        input.gyro_radps.z = rate;
        input.angles.theta_rad = wrap_pi(truth);
        f.step(DT, &hover(), &input).unwrap();
        let theta = f.state()[ANGLES + 2];
        assert!(
            (theta - last).abs() < 0.1,
            "jump at {truth}: {last} to {theta}"
        );
        last = theta;
    }
    assert!((last - end).abs() < 0.1, "{last}");
    assert!(
        f.roll_pitch_yaw()[2].abs() < 0.11,
        "whole turns are no turn"
    );
}

#[test]
fn a_constant_accelerometer_error_is_learnt_and_the_velocity_stays_bounded() {
    // The error tilts the measured gravity as well: phi = -asin(0.3 / g).
    let mut input = still();
    input.accel_mps2.x = 0.3;
    input.angles.phi_rad = -libm::asin(0.3 / input.accel_mps2.norm());
    let drift = |has_bias: bool| {
        let mut f = filter(|c| c.has_bias = has_bias);
        for _ in 0..6000 {
            f.step(DT, &hover(), &input).unwrap();
        }
        (f.bias_mps2().x, f.state()[VELOCITY].abs())
    };
    let (bias, velocity) = drift(true);
    assert!((bias - 0.3).abs() < 0.01, "{bias}");
    let (_, without) = drift(false);
    assert!(
        velocity < 1.0 && without > 10.0 * velocity,
        "{velocity} m/s, without bias {without} m/s"
    );
}

#[test]
fn a_magnet_near_for_five_seconds_hardly_turns_yaw_with_dynamic_covariance() {
    let moved = |is_dynamic: bool| {
        let mut f = filter(|c| c.noise.is_dynamic = is_dynamic);
        for k in 0..2500 {
            let is_near = (1500..2000).contains(&k);
            let mut input = still();
            input.angles.theta_rad = if is_near { 1.0 } else { 0.0 };
            input.mag_is_good = !is_near;
            f.step(DT, &hover(), &input).unwrap();
            if k == 1999 {
                return f.state()[ANGLES + 2];
            }
        }
        unreachable!()
    };
    let (with, without) = (moved(true), moved(false));
    println!(
        "yaw error after 5 s of a magnet that shows 57 deg: {:.2} deg with dynamic covariance, {:.2} deg without",
        with.to_degrees(),
        without.to_degrees()
    );
    assert!(with.abs() < 1_f64.to_radians(), "{with}");
    assert!(without > 0.5, "{without}");
}

#[test]
fn fixes_once_a_second_hold_the_position_that_drifts_without_them() {
    let error = |has_fix: bool| {
        let mut f = filter(|_| {});
        let mut worst = 0.0_f64;
        for k in 1..=6000 {
            let mut input = still();
            // A degree of tilt that is not there: 0.17 m/s2.
            input.angles.phi_rad = 0.017;
            input.fix = (has_fix && k % 100 == 0).then(Vector3::zeros);
            f.step(DT, &hover(), &input).unwrap();
            if k > 3000 {
                worst = worst.max(libm::hypot(f.state()[POSITION], f.state()[POSITION + 1]));
            }
        }
        worst
    };
    let (with, without) = (error(true), error(false));
    println!(
        "worst position error of the second half minute: {with:.2} m with a fix each second, {without:.0} m without"
    );
    assert!(with < 1.0 && without > 50.0, "{with} {without}");
}

#[test]
fn eight_states_leave_the_horizontal_ones_at_zero_and_refuse_a_fix() {
    let mut f = filter(|c| c.states = StateSet::Reduced);
    let mut input = still();
    input.angles = Angles {
        psi_rad: 0.1,
        phi_rad: -0.1,
        theta_rad: 0.5,
    };
    input.altitude_m = 1.0;
    for _ in 0..3000 {
        f.step(DT, &hover(), &input).unwrap();
    }
    let x = f.state();
    for i in [0, 1, 6, 7] {
        assert_eq!(x[i], 0.0);
        assert_eq!(f.covariance().row(i).amax(), 0.0);
    }
    assert!((x[2] - 1.0).abs() < 0.2 && (x[3] - 0.1).abs() < 0.01 && (x[5] - 0.5).abs() < 0.05);
    input.fix = Some(Vector3::zeros());
    assert_eq!(
        f.step(DT, &hover(), &input),
        Err(Refusal::FixNeedsTwelveStates)
    );
}

#[test]
fn channels_that_are_no_numbers_are_left_out_by_name() {
    let mut f = filter(|_| {});
    let nan = f64::NAN;
    let input = ThesisInput {
        accel_mps2: Vector3::new(0.0, nan, 9.8),
        gyro_radps: Vector3::new(0.0, 0.0, f64::INFINITY),
        angles: Angles {
            psi_rad: nan,
            ..Angles::default()
        },
        altitude_m: 1e300,
        fix: None,
        ..still()
    };
    let left_out = f.step(DT, &hover(), &input).unwrap();
    assert_eq!(
        left_out.as_slice(),
        [
            Channel::Angles,
            Channel::Accelerometer,
            Channel::Gyro,
            Channel::Altitude
        ]
    );
    let fix = ThesisInput {
        fix: Some(Vector3::repeat(nan)),
        ..still()
    };
    assert_eq!(
        f.step(DT, &hover(), &fix).unwrap().as_slice(),
        [Channel::Fix]
    );
    assert!(f.state().iter().all(|x| x.is_finite()));
}

#[test]
fn impossible_steps_change_nothing() {
    let mut f = filter(|_| {});
    f.step(DT, &hover(), &still()).unwrap();
    let before = *f.state();
    for dt in [0.0, -0.01, 1.5, f64::NAN] {
        assert_eq!(f.step(dt, &hover(), &still()), Err(Refusal::Period));
    }
    let speeds = [300.0, f64::NAN, 300.0, 300.0];
    assert_eq!(f.step(DT, &speeds, &still()), Err(Refusal::MotorSpeed));
    assert_eq!(*f.state(), before);
    let refused = ThesisFilter::new(ThesisConfig {
        craft: UquadAirframe {
            mass_kg: -1.0,
            ..UquadAirframe::default()
        },
        ..ThesisConfig::default()
    });
    assert!(refused.unwrap_err().to_string().contains("mass = -1"));
}

proptest::proptest! {
    #[test]
    fn anything_leaves_the_covariance_symmetric_and_positive(
        values in proptest::collection::vec(-1e4..1e4f64, 10..200),
        angle in -3.2..3.2f64,
    ) {
        let mut f = filter(|_| {});
        let mut next = values.iter().copied().cycle();
        let mut take = || next.next().unwrap();
        for k in 0..200 {
            let input = ThesisInput {
                accel_mps2: Vector3::new(take(), take(), take()) * 1e-2,
                gyro_radps: Vector3::new(take(), take(), take()) * 1e-3,
                angles: Angles { psi_rad: angle, phi_rad: take() * 1.5e-4, theta_rad: -angle },
                altitude_m: take(),
                accel_is_good: k % 3 == 0,
                mag_is_good: k % 2 == 0,
                fix: (k % 7 == 0).then(|| Vector3::repeat(take())),
            };
            f.step(DT, &[300.0, 310.0, 290.0, 305.0], &input).unwrap();
            let p = f.covariance();
            proptest::prop_assert!(f.state().iter().all(|x| x.is_finite()));
            proptest::prop_assert_eq!(*p, p.transpose());
            proptest::prop_assert!((0..STATES).all(|i| p[(i, i)] > 0.0));
            proptest::prop_assert!(p.cholesky().is_some());
        }
    }
}
