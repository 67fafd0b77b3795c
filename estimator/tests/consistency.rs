//! Is the core filter as sure as it should be? Fifty simulated runs with independent noise: NEES and NIS (Yaakov Bar-Shalom, "Estimation
//! with Applications to Tracking and Navigation", 2001, 5.4).

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "test code outside of test functions"
)]

use estimator::kalman::{
    Aid, Filter, InitialStd, Nominal, Observation, ProcessNoise, Quality, STATES, aid,
};
use estimator::mcl::random::Random;
use nalgebra::{UnitQuaternion, Vector3};
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::{ImuSample, In, Timestamp};

const RUNS: u64 = 50;
const DURATION_S: f64 = 60.0;

/// Standard normal. The sum of four draws of [`Random::gaussian`] over two: its tails reach far enough.
fn normal(random: &mut Random) -> f64 {
    (0..4).map(|_| f64::from(random.gaussian())).sum::<f64>() * 0.5
}

fn normals(random: &mut Random, std: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(random) * std)
}

/// A flight through a room: loops of 2 m, turning nose, leaning to 12 degrees.
#[derive(Clone, Copy)]
struct Path {
    phase: f64,
}

impl Path {
    fn position(&self, t: f64) -> Vector3<f64> {
        let u = t + self.phase;
        Vector3::new(
            2.0 * libm::sin(0.31 * u),
            1.5 * libm::cos(0.43 * u),
            -1.2 - 0.4 * libm::sin(0.23 * u),
        )
    }

    fn attitude(&self, t: f64) -> UnitQuaternion<f64> {
        let u = t + self.phase;
        UnitQuaternion::from_euler_angles(
            0.2 * libm::sin(0.9 * u),
            0.2 * libm::cos(0.7 * u),
            1.5 * libm::sin(0.17 * u) + 0.1 * u,
        )
    }

    fn velocity(&self, t: f64) -> Vector3<f64> {
        let h = 1e-4;
        (self.position(t + h) - self.position(t - h)) / (2.0 * h)
    }

    fn acceleration(&self, t: f64) -> Vector3<f64> {
        let h = 1e-3;
        (self.position(t + h) - self.position(t) * 2.0 + self.position(t - h)) / (h * h)
    }

    fn rate(&self, t: f64) -> Vector3<f64> {
        let h = 1e-4;
        (self.attitude(t - h).inverse() * self.attitude(t + h)).scaled_axis() / (2.0 * h)
    }
}

/// A simulated aid: which, how often, how noisy.
struct Sensor {
    name: &'static str,
    aids: &'static [Aid],
    hz: u64,
    std: f64,
}

const SENSORS: [Sensor; 7] = [
    Sensor {
        name: "roll, pitch",
        aids: &[Aid::Roll, Aid::Pitch],
        hz: 20,
        std: 0.0175,
    },
    Sensor {
        name: "down-range",
        aids: &[Aid::Height],
        hz: 20,
        std: 0.04,
    },
    Sensor {
        name: "optical flow",
        aids: &[Aid::FlowX, Aid::FlowY],
        hz: 20,
        std: 0.1,
    },
    Sensor {
        name: "plan position",
        aids: &[Aid::PoseLong, Aid::PoseCross],
        hz: 5,
        std: 0.05,
    },
    Sensor {
        name: "plan yaw",
        aids: &[Aid::PoseYaw],
        hz: 5,
        std: 0.03,
    },
    Sensor {
        name: "barometer",
        aids: &[Aid::Baro],
        hz: 10,
        std: 0.3,
    },
    Sensor {
        name: "velocity",
        aids: &[Aid::VelocityNorth, Aid::VelocityEast, Aid::VelocityDown],
        hz: 5,
        std: 0.15,
    },
];

fn observation(aid: Aid, x: &Nominal, gyro: &Vector3<f64>) -> Option<Observation> {
    Some(match aid {
        Aid::Roll => aid::attitude::roll(x)?,
        Aid::Pitch => aid::attitude::pitch(x)?,
        Aid::Height => aid::height::observe(x, 0.0),
        Aid::FlowX => aid::flow::observe(x, gyro, 0.0)?[0],
        Aid::FlowY => aid::flow::observe(x, gyro, 0.0)?[1],
        Aid::PoseLong => aid::position::observe_along(x, [0.8, 0.6]),
        Aid::PoseCross => aid::position::observe_along(x, [-0.6, 0.8]),
        Aid::PoseYaw => aid::yaw::observe(x),
        Aid::Baro => aid::baro::observe(x, 0.0),
        Aid::VelocityNorth => aid::velocity::observe(x)[0],
        Aid::VelocityEast => aid::velocity::observe(x)[1],
        Aid::VelocityDown => aid::velocity::observe(x)[2],
        Aid::ExternalNorth | Aid::GnssNorth => aid::position::observe_along(x, [1.0, 0.0]),
        Aid::ExternalEast | Aid::GnssEast => aid::position::observe_along(x, [0.0, 1.0]),
        Aid::ExternalYaw => aid::yaw::observe(x),
        Aid::Heading
        | Aid::HeadingIncrement
        | Aid::Rate
        | Aid::ExternalForward
        | Aid::ExternalRight => return None,
    })
}

/// Sums over the runs.
struct Sums {
    /// NEES at each step.
    nees: Vec<f64>,
    /// NIS and count of each aid.
    nis: [(f64, u32); Aid::COUNT],
    refused: u32,
}

fn run(seed: u64, imu_hz: u64, sums: &mut Sums) {
    let mut random = Random::new(seed);
    let noise = ProcessNoise::default();
    let dt = 1.0 / imu_hz as f64;
    let path = Path {
        phase: 10.0 * normal(&mut random),
    };
    let std = InitialStd {
        position_m: 0.1,
        height_m: 0.05,
        velocity_mps: 0.1,
        tilt_rad: 0.03,
        yaw_rad: 0.06,
    };
    let mut truth = Nominal {
        position: path.position(0.0),
        velocity: path.velocity(0.0),
        attitude: path.attitude(0.0),
        accel_bias: Vector3::zeros(),
        gyro_bias: Vector3::zeros(),
    };
    // Where the filter believes to be: the truth, off by a draw from its own covariance.
    let mut filter = Filter::new(noise);
    filter.start(Timestamp::ZERO, truth, std);
    let p = filter.covariance();
    let error =
        nalgebra::SVector::<f64, STATES>::from_fn(|i, _| normal(&mut random) * p[(i, i)].sqrt());
    let mut begin = truth.plus(&error);
    truth.accel_bias = -begin.accel_bias;
    truth.gyro_bias = -begin.gyro_bias;
    begin.accel_bias = Vector3::zeros();
    begin.gyro_bias = Vector3::zeros();
    filter.start(Timestamp::ZERO, begin, std);

    for k in 0..=(DURATION_S * imu_hz as f64) as u64 {
        let t = k as f64 * dt;
        let at = Timestamp::from_us(k * 1_000_000 / imu_hz);
        truth.position = path.position(t);
        truth.velocity = path.velocity(t);
        truth.attitude = path.attitude(t);
        truth.accel_bias += normals(&mut random, noise.accel_bias * dt.sqrt());
        truth.gyro_bias += normals(&mut random, noise.gyro_bias * dt.sqrt());
        let force = truth.attitude.inverse() * (path.acceleration(t) - Vector3::z() * GRAVITY_MPS2);
        let rate = path.rate(t);
        let accel = force + truth.accel_bias + normals(&mut random, noise.accel / dt.sqrt());
        let gyro = rate + truth.gyro_bias + normals(&mut random, noise.gyro / dt.sqrt());
        filter.predict(&ImuSample {
            at,
            accel_mps2: In::from_vector(accel),
            gyro_radps: In::from_vector(gyro),
            mag: None,
        });
        for sensor in SENSORS.iter().filter(|s| k > 0 && k % (imu_hz / s.hz) == 0) {
            for aid in sensor.aids {
                // Flow that was turned back with the true rate: independent of the gyro's noise.
                let raw = rate + truth.gyro_bias;
                let Some(true_observation) = observation(*aid, &truth, &raw) else {
                    continue;
                };
                let Some(o) = observation(*aid, filter.state(), &raw) else {
                    continue;
                };
                let measured = true_observation.predicted + normal(&mut random) * sensor.std;
                if !filter.fuse(*aid, at, &o, measured, Quality::white(sensor.std)) {
                    sums.refused += 1;
                }
                let status = filter.status(*aid);
                let (sum, n) = &mut sums.nis[*aid as usize];
                *sum += status.normalised;
                *n += 1;
            }
        }
        if k > 0 && k % (imu_hz / 5) == 0 {
            let e = filter.state().error_to(&truth);
            let p = filter.covariance();
            let solved = p.cholesky().unwrap().solve(&e);
            let step = (k / (imu_hz / 5) - 1) as usize;
            if sums.nees.len() <= step {
                sums.nees.push(0.0);
            }
            sums.nees[step] += e.dot(&solved) / RUNS as f64;
        }
    }
}

/// Quantile of chi-squared over its degrees of freedom (Wilson and Hilferty 1931; exact to 1e-4 here).
fn chi_squared_over_n(n: f64, z: f64) -> f64 {
    (1.0 - 2.0 / (9.0 * n) + z * (2.0 / (9.0 * n)).sqrt()).powi(3)
}

fn campaign(imu_hz: u64) -> (f64, Vec<(&'static str, f64)>) {
    let mut sums = Sums {
        nees: Vec::new(),
        nis: [(0.0, 0); Aid::COUNT],
        refused: 0,
    };
    for seed in 1..=RUNS {
        run(seed, imu_hz, &mut sums);
    }
    let n = (STATES as u64 * RUNS) as f64;
    let [low, high] = [-1.96, 1.96].map(|z| STATES as f64 * chi_squared_over_n(n, z));
    let inside = sums
        .nees
        .iter()
        .filter(|e| (low..=high).contains(*e))
        .count();
    let share = inside as f64 / sums.nees.len() as f64;
    let mean = sums.nees.iter().sum::<f64>() / sums.nees.len() as f64;
    println!(
        "IMU {imu_hz} Hz: NEES mean {mean:.2} of {STATES}, in {low:.2}..{high:.2} at {:.1} % of {} steps; {} scalars refused",
        100.0 * share,
        sums.nees.len(),
        sums.refused
    );
    let thirds: Vec<String> = sums
        .nees
        .chunks(60)
        .map(|c| format!("{:.2}", c.iter().sum::<f64>() / c.len() as f64))
        .collect();
    println!("  NEES by 12 s: {}", thirds.join(" "));
    let nis: Vec<(&'static str, f64)> = SENSORS
        .iter()
        .map(|s| {
            let (sum, n) = s.aids.iter().fold((0.0, 0), |(sum, n), a| {
                let (s, k) = sums.nis[*a as usize];
                (sum + s, n + k)
            });
            (s.name, sum / f64::from(n))
        })
        .collect();
    for (name, value) in &nis {
        println!("  {name:<14} NIS {value:.3} of its dimension");
    }
    (share, nis)
}

#[test]
fn fifty_runs_of_a_minute_are_consistent_in_state_and_in_every_sensor() {
    println!(
        "FIGURES consistency of the core filter, {RUNS} runs of {DURATION_S} s, seeds 1..={RUNS}"
    );
    let all = [100, 40].map(campaign);
    println!("END");
    for (share, nis) in all {
        assert!(share >= 0.9, "NEES inside the band at {share} of the steps");
        for (name, value) in nis {
            assert!((0.8..=1.25).contains(&value), "NIS of {name}: {value}");
        }
    }
}
