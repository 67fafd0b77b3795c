//! Is the estimator as sure as it may be when the particles' poses aid it? Simulated minutes through a room, odometry, particles and both
//! filters as they fly. The particles' errors are no white noise, so the filter may doubt itself more than it need, never less.
//!
//! Twice: with the parameters that fly, which take sensors for two to three times as noisy as the simulated are (a frame shakes,
//! flow over bare floor wanders), and with those of the simulated sensors, where what is claimed must also not be far too wide.
//!
//! Ten runs of each ring; fifty with KESTREL_FULL=1.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "test code outside of test functions"
)]

mod support;

use estimator::kalman::{ATTITUDE, Covariance, ErrorVector, Nominal, POSITION, VELOCITY, aid};
use estimator::mcl::random::Random;
use estimator::{Estimator, EstimatorParams};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use std::sync::Arc;
use support::recordings::seeds;
use support::world::{Senses, Simulation, Truth, World};
use vehicle::{LocalizationState, MapPose, Timestamp};

const DURATION_S: f64 = 60.0;
/// Known start to settle in, s.
const SETTLE_S: f64 = 3.0;
/// Steps a second that are looked at.
const STEPS_HZ: f64 = 5.0;

/// A way through the room by the seed: hover, then round a centre, nose along the way or away from it.
fn way(seed: u64) -> impl Fn(f64) -> (Vector3<f64>, f64) {
    let mut random = Random::new(seed.wrapping_mul(7919) + 13);
    let mut between = |low: f64, high: f64| low + (high - low) * f64::from(random.uniform());
    let (radius, speed) = (between(0.6, 1.3), between(0.3, 0.9));
    let (begin, heading, nose) = (between(-3.1, 3.1), between(-3.1, 3.1), between(-1.0, 1.0));
    let side = if between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
    let (x, y, height) = (between(-0.2, 0.2), between(-0.2, 0.2), between(0.7, 1.4));
    move |t: f64| {
        let u = (t - 3.0).max(0.0);
        // Smooth start over 3 s.
        let s = if u < 3.0 {
            u * u * u * (1.0 - u / 6.0) / 9.0
        } else {
            u - 1.5
        };
        let a = begin + side * speed / radius * s;
        let sway = 0.1 * (libm::sin(0.7 * s) + libm::sin(1.9 * s));
        (
            Vector3::new(
                x + (radius + sway) * libm::cos(a),
                y + (radius - sway) * libm::sin(a),
                -height - sway,
            ),
            heading + nose * (a - begin) + 0.3 * libm::sin(0.4 * s),
        )
    }
}

/// Parts of the state that are looked at, and their dimension.
const PARTS: [(&str, f64); 5] = [
    ("position", 3.0),
    ("velocity", 3.0),
    ("attitude", 3.0),
    ("yaw", 1.0),
    ("all nine", 9.0),
];

/// Sums over the runs of one ring.
#[derive(Default)]
struct Sums {
    /// NEES of each part at each step.
    nees: Vec<[f64; PARTS.len()]>,
    within: u32,
    steps: u32,
    lost: u32,
}

fn nees<const N: usize>(error: &ErrorVector, p: &Covariance, first: usize) -> f64 {
    let e = error.fixed_rows::<N>(first).into_owned();
    let p = p.fixed_view::<N, N>(first, first).into_owned();
    e.dot(&p.cholesky().unwrap().solve(&e))
}

/// Parameters that say of the sensors what the simulation does to them, flow and gyro a fifth more: two integrals and a trapezoid
/// are no model of their own.
fn as_simulated() -> EstimatorParams {
    const PER_S: f64 = 38.5;
    const MARGIN: f64 = 1.2;
    EstimatorParams {
        accel_noise: MARGIN * 0.4 / PER_S.sqrt(),
        gyro_noise: MARGIN * 0.03 / PER_S.sqrt(),
        // Of quality 200.
        flow_std_radps: MARGIN * 0.06 / (1.0 + 55.0 / 128.0),
        range_std_m: MARGIN * 0.01,
        range_std_per_m: 0.0,
        ..EstimatorParams::default()
    }
}

fn fly(senses: &Senses, params: &EstimatorParams, seed: u64, sums: &mut Sums) {
    let world = World::room();
    let path = way(seed);
    let plan = Some(Arc::new(world.plan.clone()));
    let mut e = Estimator::new(params.clone(), plan, world.anchor, seed);
    let mut sim = Simulation::new(&world, &path, senses.clone(), seed);
    let start = sim.truth().map_pose(&world.anchor);
    let mut random = Random::new(seed + 1000);
    let mut off = || 0.08 * f64::from(random.gaussian());
    let told = MapPose::new(start.x_m + off(), start.y_m + off(), start.yaw_rad + off());
    e.start_at(Timestamp::ZERO, told, 0.10, 0.10);
    let mut step = 0;
    sim.fly(&mut e, DURATION_S, |_, e| {
        let at = e.navigation().at().s();
        if at < SETTLE_S + step as f64 / STEPS_HZ {
            return;
        }
        let truth = Truth::of(&path, at);
        let x = e.navigation().state();
        let truth = Nominal {
            position: truth.position,
            velocity: truth.velocity,
            attitude: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
                truth.rotation,
            )),
            ..*x
        };
        let error = x.error_to(&truth);
        let p = e.navigation().covariance();
        let yaw = *aid::yaw::observe(x).row();
        let values = [
            nees::<3>(&error, &p, POSITION),
            nees::<3>(&error, &p, VELOCITY),
            nees::<3>(&error, &p, ATTITUDE),
            yaw.dot(&error).powi(2) / yaw.dot(&(p * yaw)),
            nees::<9>(&error, &p, POSITION),
        ];
        if sums.nees.len() <= step {
            sums.nees.push([0.0; PARTS.len()]);
        }
        for (sum, value) in sums.nees[step].iter_mut().zip(values) {
            *sum += value;
        }
        let is_within = (0..3).all(|i| error[i].abs() <= 3.0 * p[(i, i)].sqrt());
        sums.within += u32::from(is_within);
        sums.steps += 1;
        sums.lost += u32::from(e.state().localization.state != LocalizationState::Localized);
        step += 1;
    });
}

/// Quantile of chi-squared over its degrees of freedom (Wilson and Hilferty 1931).
fn chi_squared_over_n(n: f64, z: f64) -> f64 {
    (1.0 - 2.0 / (9.0 * n) + z * (2.0 / (9.0 * n)).sqrt()).powi(3)
}

/// Flies every ring; mean NEES over its dimension of all nine states, by ring.
fn consistency(what: &str, params: &EstimatorParams) -> Vec<f64> {
    let runs = seeds(10, 50);
    println!(
        "FIGURES consistency with the particles in the loop, {what}, {runs} runs of {DURATION_S} s, seeds 1..={runs}\n {:<8} {:>9} {:>9} {:>14} {:>12}",
        "ring", "part", "NEES / n", "steps too sure", "worst step"
    );
    let mut means = Vec::new();
    for ring in ["tof32", "sonar8"] {
        let senses = Senses::good(ring);
        let mut sums = Sums::default();
        for seed in 1..=runs {
            fly(&senses, params, seed, &mut sums);
        }
        let within = 100.0 * f64::from(sums.within) / f64::from(sums.steps);
        let mut mean = 0.0;
        for (i, (part, n)) in PARTS.into_iter().enumerate() {
            let per_step: Vec<f64> = sums.nees.iter().map(|s| s[i] / (n * runs as f64)).collect();
            mean = per_step.iter().sum::<f64>() / per_step.len() as f64;
            let high = chi_squared_over_n(n * runs as f64, 1.96);
            let too_sure = per_step.iter().filter(|v| **v > high).count();
            let worst = per_step.iter().copied().fold(0.0, f64::max);
            println!(
                " {ring:<8} {part:>9} {mean:>9.3} {too_sure:>8} of {:>3} {worst:>12.2} (band to {high:.2})",
                per_step.len()
            );
            assert!(mean <= 1.0, "{ring}: {part} is over-confident: {mean}");
            // The band holds 95 %: by chance alone one step in forty is above it.
            assert!(
                40 * too_sure <= per_step.len(),
                "{ring}: {part} is over-confident at times"
            );
        }
        println!(
            " {ring}: position within 3 sigma at {within:.2} % of {} steps, {} not localized",
            sums.steps, sums.lost
        );
        assert!(within >= 97.0, "{ring}: within 3 sigma at {within} %");
        means.push(mean);
    }
    println!("END");
    means
}

#[test]
fn with_the_particles_in_the_loop_the_filter_is_never_over_confident() {
    consistency("parameters that fly", &EstimatorParams::default());
}

#[test]
fn told_how_good_the_sensors_are_it_is_neither_over_confident_nor_far_too_careful() {
    for mean in consistency("parameters as simulated", &as_simulated()) {
        assert!(mean >= 0.4, "far too careful: {mean}");
    }
}
