use super::*;
use crate::mcl::random::Random;

/// A sensor that is turned and shaken on known paths, 250 Hz.
struct Bench {
    k: u64,
    attitude: UnitQuaternion<f64>,
    random: Random,
    hard_iron: Vector3<f64>,
}

const DT: f64 = 0.004;
/// North 16, up -41: middle Europe, uT.
const FIELD: [f64; 3] = [0.0, 16.0, -41.0];

impl Bench {
    fn new() -> Self {
        Self {
            k: 0,
            attitude: UnitQuaternion::from_euler_angles(0.2, -0.3, 1.2),
            random: Random::new(7),
            hard_iron: Vector3::zeros(),
        }
    }

    fn noise(&mut self, std: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| {
            let u = (self.random.bits() >> 11) as f64 / (1u64 << 53) as f64;
            (u - 0.5) * 12f64.sqrt() * std
        })
    }

    /// The next sample with this rate (sensor frame) and acceleration (earth frame) since the last.
    fn next(&mut self, rate: Vector3<f64>, acceleration: Vector3<f64>) -> MargSample {
        self.k += 1;
        self.attitude *= UnitQuaternion::from_scaled_axis(rate * DT);
        let to_sensor = self.attitude.inverse();
        MargSample {
            at: Timestamp::from_us(4000 * self.k),
            gyro_radps: rate + Vector3::new(0.003, -0.004, 0.005) + self.noise(0.002),
            accel_mps2: to_sensor * (acceleration + Vector3::z() * 9.81) + self.noise(0.03),
            mag: Some(to_sensor * Vector3::from(FIELD) + self.hard_iron + self.noise(0.5)),
        }
    }

    fn turning(&self) -> Vector3<f64> {
        let t = self.k as f64 * DT;
        Vector3::new(
            libm::sin(0.7 * t),
            libm::cos(0.9 * t),
            0.8 * libm::sin(0.31 * t),
        ) * 1.5
    }

    fn shaking(&self) -> Vector3<f64> {
        let t = self.k as f64 * DT;
        Vector3::new(libm::sin(9.0 * t), libm::cos(7.0 * t), libm::sin(5.0 * t)) * 4.0
    }

    fn error(&self, estimator: &AttitudeEstimator) -> score::AttitudeError {
        score::AttitudeError::between(&estimator.imu_to_enu(), &self.attitude)
    }

    fn rest_then_move(&mut self, estimator: &mut AttitudeEstimator, rest_s: f64, move_s: f64) {
        for _ in 0..(rest_s / DT) as u32 {
            estimator.update(&self.next(Vector3::zeros(), Vector3::zeros()));
        }
        for _ in 0..(move_s / DT) as u32 {
            estimator.update(&self.next(self.turning(), self.shaking()));
        }
    }
}

fn estimator() -> AttitudeEstimator {
    AttitudeEstimator::new(AttitudeParams {
        sensor_delay_s: 0.0,
        mag_delay_s: 0.0,
        ..AttitudeParams::default()
    })
}

fn is_finite(e: &AttitudeEstimator) -> bool {
    e.imu_to_enu().coords.iter().all(|c| c.is_finite())
        && e.gyro_bias_radps().iter().all(|c| c.is_finite())
        && e.hard_iron().iter().all(|c| c.is_finite())
        && e.status().tilt_std_rad.is_finite()
        && e.status().heading_std_rad.is_none_or(f64::is_finite)
}

#[test]
fn rest_teaches_the_gyro_bias() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    bench.rest_then_move(&mut e, 10.0, 0.0);
    assert!(e.status().is_at_rest);
    let error = e.gyro_bias_radps() - Vector3::new(0.003, -0.004, 0.005);
    assert!(error.norm() < 5e-4, "{error}");
}

#[test]
fn shaking_with_half_a_g_does_not_tilt_the_attitude() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    bench.rest_then_move(&mut e, 5.0, 60.0);
    assert!(!e.status().is_at_rest);
    let error = bench.error(&e);
    assert!(
        error.inclination_rad < 0.01 && error.total_rad < 0.02,
        "{error:?}"
    );
}

#[test]
fn a_phone_beside_the_sensor_is_told_from_north_by_turning() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    bench.hard_iron = Vector3::new(4.0, -3.0, 2.0);
    bench.rest_then_move(&mut e, 5.0, 0.0);
    let at_first = bench.error(&e).heading_rad;
    bench.rest_then_move(&mut e, 0.0, 90.0);
    let later = bench.error(&e).heading_rad;
    assert!(at_first > 0.1 && later < 0.04, "{at_first} {later}");
    assert!(
        (e.hard_iron() - bench.hard_iron).norm() < 1.0,
        "{}",
        e.hard_iron()
    );
}

#[test]
fn a_magnet_that_comes_and_goes_is_noticed_and_heading_stays() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    bench.rest_then_move(&mut e, 5.0, 30.0);
    for hard_iron in [Vector3::new(30.0, 20.0, -10.0), Vector3::zeros()] {
        bench.hard_iron = hard_iron;
        bench.rest_then_move(&mut e, 0.0, 0.2);
        assert!(e.status().is_field_disturbed);
        bench.rest_then_move(&mut e, 0.0, 30.0);
        let error = bench.error(&e);
        assert!(error.heading_rad < 0.06, "{error:?}");
    }
    assert!(!e.status().is_field_disturbed);
}

#[test]
fn a_late_magnetometer_is_found_out() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    let mut late = std::collections::VecDeque::new();
    for k in 0..20_000 {
        let turning = if k < 1000 {
            Vector3::zeros()
        } else {
            bench.turning() * 3.0
        };
        let mut sample = bench.next(turning, Vector3::zeros());
        late.push_back(sample.mag);
        // Five samples, 20 ms.
        sample.mag = if late.len() > 5 {
            late.pop_front().flatten()
        } else {
            None
        };
        e.update(&sample);
    }
    assert!(
        (e.mag_delay_s() - 0.020).abs() < 0.004,
        "{}",
        e.mag_delay_s()
    );
    assert!(bench.error(&e).heading_rad < 0.03);
}

#[test]
fn without_a_magnetometer_tilt_is_as_good() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    for k in 0..10_000 {
        let turning = if k < 1000 {
            Vector3::zeros()
        } else {
            bench.turning()
        };
        let sample = bench.next(turning, bench.shaking());
        e.update(&MargSample {
            mag: None,
            ..sample
        });
    }
    assert_eq!(e.status().heading_std_rad, None);
    assert!(bench.error(&e).inclination_rad < 0.02);
}

#[test]
fn upside_down_to_the_last_bit_is_an_attitude() {
    let mut e = estimator();
    let sample = MargSample {
        at: Timestamp::from_ms(1),
        gyro_radps: Vector3::zeros(),
        accel_mps2: Vector3::new(0.0, 0.0, -9.81),
        mag: None,
    };
    assert!(e.update(&sample));
    assert!((e.imu_to_enu() * Vector3::z()).z < -0.999);
}

#[test]
fn what_is_not_a_number_not_new_or_beyond_any_sensor_is_refused() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    bench.rest_then_move(&mut e, 5.0, 5.0);
    let before = e.imu_to_enu();
    let good = bench.next(bench.turning(), Vector3::zeros());
    let refused = e.status().refused;
    for (gyro, accel) in [
        (f64::NAN, 0.0),
        (0.0, f64::NAN),
        (f64::INFINITY, 0.0),
        (1e3, 0.0),
        (0.0, 1e9),
    ] {
        assert!(!e.update(&MargSample {
            gyro_radps: good.gyro_radps.add_scalar(gyro),
            accel_mps2: good.accel_mps2.add_scalar(accel),
            ..good
        }));
    }
    assert!(!e.update(&MargSample {
        at: Timestamp::from_us(4000 * (bench.k - 1)),
        ..good
    }));
    assert!(!e.update(&MargSample {
        at: Timestamp::ZERO,
        ..good
    }));
    assert_eq!(e.status().refused, refused + 7);
    assert_eq!(e.imu_to_enu(), before);
    // A broken magnetometer costs the heading's correction, nothing else.
    let broken = Some(Vector3::new(f64::NAN, f64::INFINITY, 1e300));
    assert!(e.update(&MargSample {
        mag: broken,
        ..good
    }));
    assert!(is_finite(&e));
}

#[test]
fn a_second_without_samples_is_doubt_and_then_recovery() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    bench.rest_then_move(&mut e, 5.0, 20.0);
    let sure = e.status().tilt_std_rad;
    for _ in 0..250 {
        bench.next(bench.turning(), bench.shaking());
    }
    bench.rest_then_move(&mut e, 0.0, 0.01);
    assert_eq!(e.status().gaps, 1);
    assert!(e.status().tilt_std_rad > 20.0 * sure);
    bench.rest_then_move(&mut e, 0.0, 60.0);
    let error = bench.error(&e);
    assert!(
        error.inclination_rad < 0.02 && error.heading_rad < 0.1,
        "{error:?}"
    );
}

#[test]
fn a_sensor_that_repeats_itself_is_dead_until_it_changes() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    bench.rest_then_move(&mut e, 5.0, 5.0);
    let stuck = bench.next(Vector3::zeros(), Vector3::zeros());
    for k in 0..500 {
        let at = Timestamp::from_us(4000 * (bench.k + k));
        e.update(&MargSample { at, ..stuck });
    }
    assert!(e.status().is_stuck && !e.status().is_at_rest);
    bench.k += 500;
    bench.rest_then_move(&mut e, 10.0, 10.0);
    assert!(!e.status().is_stuck);
    assert!(bench.error(&e).inclination_rad < 0.02);
}

#[test]
fn a_clipped_gyro_is_doubted_and_forgiven() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    bench.rest_then_move(&mut e, 5.0, 5.0);
    for _ in 0..50 {
        let mut sample = bench.next(Vector3::new(0.0, 45.0, 0.0), Vector3::zeros());
        let range = AttitudeParams::default().gyro_range_radps;
        sample.gyro_radps.y = sample.gyro_radps.y.clamp(-range, range);
        e.update(&sample);
    }
    assert!(e.status().saturated >= 50);
    assert!(e.status().tilt_std_rad > 0.1);
    bench.rest_then_move(&mut e, 5.0, 20.0);
    let error = bench.error(&e);
    assert!(
        error.inclination_rad < 0.03 && error.heading_rad < 0.15,
        "{error:?}"
    );
}

#[test]
fn random_samples_never_break_the_state() {
    let (mut bench, mut e) = (Bench::new(), estimator());
    let mut at_us = 0;
    for _ in 0..20_000 {
        at_us += bench.random.bits() % 5000;
        let wild = 10f64.powi((bench.random.bits() % 8) as i32 - 3);
        let (gyro_radps, accel_mps2) = (bench.noise(wild), bench.noise(10.0 * wild));
        let mag = Some(bench.noise(wild * wild * wild));
        let at = Timestamp::from_us(at_us);
        e.update(&MargSample {
            at,
            gyro_radps,
            accel_mps2,
            mag,
        });
        assert!(is_finite(&e));
    }
    assert!(e.status().accepted > 1000 && e.status().refused > 1000);
}
