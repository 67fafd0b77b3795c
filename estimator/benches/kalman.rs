//! What the error-state filter costs: `cargo bench -p estimator --bench kalman`. One line of JSON a figure, best and median of
//! many rounds, allocations counted. The nine scalars of the performance note: position, velocity and attitude error.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a measuring program prints its figures and fails where it stands"
)]

use core::hint::black_box;
use estimator::attitude::{AttitudeEstimator, AttitudeParams, MargSample};
use estimator::kalman::{
    ATTITUDE, Aid, Covariance, ErrorVector, Filter, InitialStd, Nominal, Observation, POSITION,
    ProcessNoise, Quality, VELOCITY, aid,
};
use nalgebra::Vector3;
use std::time::Instant;
use vehicle::{ImuSample, In, Timestamp};

const ROUNDS: usize = 400;
const CALLS: u64 = 200;

fn filter() -> Filter {
    let mut filter = Filter::new(ProcessNoise::default());
    let std = InitialStd {
        position_m: 0.1,
        height_m: 0.1,
        velocity_mps: 0.1,
        tilt_rad: 0.05,
        yaw_rad: 0.1,
    };
    filter.start(Timestamp::ZERO, Nominal::default(), std);
    filter
}

/// A vehicle that shakes on the spot.
fn imu(k: u64) -> ImuSample {
    let t = k as f64;
    ImuSample {
        at: Timestamp::from_us(k * 5000),
        accel_mps2: In::new(0.3 * libm::sin(2.9 * t), 0.2 * libm::cos(1.3 * t), -9.80665),
        gyro_radps: In::new(
            0.2 * libm::cos(1.9 * t),
            0.1 * libm::sin(t),
            0.3 * libm::sin(2.1 * t),
        ),
        mag: None,
    }
}

/// The nine scalars: (aid, observation). Their rows do not depend on the state, so that the filter's own work is measured; what
/// is predicted is filled in by [`predicted`].
fn nine(x: &Nominal) -> [(Aid, Observation); 9] {
    let unit = |index: usize, predicted: f64| {
        let mut row = ErrorVector::zeros();
        row[index] = 1.0;
        Observation::new(predicted, row)
    };
    let v = aid::velocity::observe(x);
    [
        (Aid::PoseLong, unit(POSITION, x.position.x)),
        (Aid::PoseCross, unit(POSITION + 1, x.position.y)),
        (Aid::Height, unit(POSITION + 2, x.position.z)),
        (Aid::VelocityNorth, v[0]),
        (Aid::VelocityEast, v[1]),
        (Aid::VelocityDown, v[2]),
        (Aid::Roll, unit(ATTITUDE, 0.0)),
        (Aid::Pitch, unit(ATTITUDE + 1, 0.0)),
        (Aid::PoseYaw, unit(ATTITUDE + 2, 0.0)),
    ]
}

/// What the scalar `i` of [`nine`] is in a state.
fn predicted(x: &Nominal, i: usize) -> f64 {
    match i {
        0..3 => x.position[i],
        3..6 => x.velocity[i - 3],
        _ => 2.0 * x.attitude.imag()[i - 6],
    }
}

/// Times `call` and counts what it allocates; `per` is the number of things done in a call.
fn figure(name: &str, mut call: impl FnMut(u64)) -> f64 {
    let mut rounds = Vec::with_capacity(ROUNDS);
    let mut k = 0;
    for _ in 0..ROUNDS {
        let begin = Instant::now();
        for _ in 0..CALLS {
            k += 1;
            call(k);
        }
        rounds.push(begin.elapsed().as_secs_f64() * 1e9 / CALLS as f64);
    }
    let allocations = allocation_counter::measure(|| {
        for _ in 0..CALLS {
            k += 1;
            call(k);
        }
    });
    rounds.sort_by(f64::total_cmp);
    println!(
        "{{\"bench\":\"{name}\",\"best_ns\":{:.0},\"median_ns\":{:.0},\"allocations\":{}}}",
        rounds[0],
        rounds[ROUNDS / 2],
        allocations.count_total
    );
    assert_eq!(allocations.count_total, 0, "{name} allocates");
    rounds[0]
}

fn main() {
    let mut f = filter();
    let mut samples: Vec<ImuSample> = Vec::new();
    for k in 0..4096 {
        samples.push(imu(k));
    }
    let sample = |k: u64| ImuSample {
        at: Timestamp::from_us(k * 5000),
        ..samples[(k % 4096) as usize]
    };
    let q = Quality::white(0.05);
    let noise = |k: u64, i: usize| 0.01 * (((k * 7 + i as u64 * 3) % 11) as f64 - 5.0) / 5.0;

    figure("ekf/predict", |k| {
        f.predict(black_box(&sample(k)));
    });
    let mut all = nine(&Nominal::default());
    let mut f = filter();
    figure("ekf/update1", |k| {
        // Growth by hand would cost; a wide measurement leaves the covariance where it is.
        let (a, o) = &mut all[3];
        o.predicted = predicted(f.state(), 3);
        let measured = noise(k, 0);
        let at = Timestamp::from_us(k * 5000);
        black_box(f.fuse(*a, at, black_box(o), measured, Quality::white(50.0)));
    });
    let mut f = filter();
    figure("ekf/update9", |k| {
        let at = Timestamp::from_us(k * 5000);
        for (i, (a, o)) in all.iter_mut().enumerate() {
            o.predicted = predicted(f.state(), i);
            let measured = noise(k, i);
            black_box(f.fuse(*a, at, black_box(o), measured, Quality::white(50.0)));
        }
    });
    let mut f = filter();
    let whole = figure("ekf/predict+update9", |k| {
        let sample = sample(k);
        f.predict(black_box(&sample));
        for (i, (a, o)) in all.iter_mut().enumerate() {
            o.predicted = predicted(f.state(), i);
            let measured = noise(k, i);
            black_box(f.fuse(*a, sample.at, black_box(o), measured, q));
        }
    });
    assert!(f.state().is_finite());
    assert!(f.std_of(VELOCITY).norm() < 1.0 && f.state().velocity.norm() < 1.0);

    // How fast this machine is: the dense product takes 698 ns on the performance note's reference host.
    let phi = Covariance::from_fn(|i, j| {
        if i == j {
            1.0
        } else {
            1e-3 / (1 + i + j) as f64
        }
    });
    let q = Covariance::identity() * 1e-6;
    let mut p = f.covariance();
    figure("reference/dense predict 15x15", |_| {
        p = black_box(phi) * p * black_box(phi).transpose() * 0.99 + q;
    });
    black_box(p);

    let mut attitude = AttitudeEstimator::new(AttitudeParams::default());
    figure("attitude/update", |k| {
        let s = sample(k);
        attitude.update(black_box(&MargSample {
            at: s.at,
            gyro_radps: *s.gyro_radps.vector(),
            accel_mps2: -s.accel_mps2.vector(),
            mag: Some(Vector3::new(0.0, 16.0, -41.0)),
        }));
    });
    println!(
        "{{\"bar\":\"ekf predict + 9 scalar updates\",\"limit_ns\":600,\"best_ns\":{whole:.0},\"held\":{}}}",
        whole <= 600.0
    );
}
