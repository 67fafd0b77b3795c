//! Inertial sensors of the flight controller.
//!
//! | | At rest | Motors at hover |
//! | --- | --- | --- |
//! | accelerometer noise per sample | 0.03 m/s2 | 0.45 m/s2 |
//! | gyro noise per sample | 0.0015 rad/s | 0.015 rad/s |
//!
//! In flight 0.08 m/s2/sqrt(Hz) and 0.003 rad/s/sqrt(Hz) over the 25 Hz of the controller's filter: frame-mounted MEMS near
//! propellers. Biases are what is left after the controller's own calibration: 0.08 m/s2 and 0.002 rad/s per axis.

use crate::noise::Noise;
use vehicle::{Frd, In};

const ACCEL_REST_MPS2: f64 = 0.03;
const ACCEL_HOVER_MPS2: f64 = 0.45;
const GYRO_REST_RADPS: f64 = 0.0015;
const GYRO_HOVER_RADPS: f64 = 0.015;
const ACCEL_BIAS_MPS2: f64 = 0.08;
const GYRO_BIAS_RADPS: f64 = 0.002;
/// Low-pass of the accelerometer (`acc_lpf_hz` 25), s.
const ACCEL_LAG_S: f64 = 1.0 / (core::f64::consts::TAU * 25.0);
/// Mean motor speed in hover, where the noise above holds.
const HOVER_SPEED: f64 = 0.57;

/// Accelerometer and gyro with bias and noise.
#[derive(Clone, Debug)]
pub(crate) struct Imu {
    noise: Noise,
    accel_bias: In<Frd>,
    gyro_bias: In<Frd>,
    accel: In<Frd>,
}

impl Imu {
    pub(crate) fn new(seed: u64, vehicle: usize) -> Self {
        let mut noise = Noise::new(seed, vehicle, "imu");
        Self {
            accel_bias: triple(&mut noise, ACCEL_BIAS_MPS2),
            gyro_bias: triple(&mut noise, GYRO_BIAS_RADPS),
            accel: In::new(0.0, 0.0, -vehicle::airframe::GRAVITY_MPS2),
            noise,
        }
    }

    /// Every millisecond: the true specific force.
    pub(crate) fn feel(&mut self, specific_force: In<Frd>) {
        let k = crate::quad::STEP_S / (ACCEL_LAG_S + crate::quad::STEP_S);
        self.accel += (specific_force - self.accel) * k;
    }

    /// A reading: specific force (m/s2) and rate (rad/s). `motor_speed` is the mean of the motors, 0..=1.
    pub(crate) fn read(&mut self, rates: In<Frd>, motor_speed: f64) -> (In<Frd>, In<Frd>) {
        let shake = (motor_speed / HOVER_SPEED) * (motor_speed / HOVER_SPEED);
        let accel_sigma = ACCEL_REST_MPS2 + (ACCEL_HOVER_MPS2 - ACCEL_REST_MPS2) * shake;
        let gyro_sigma = GYRO_REST_RADPS + (GYRO_HOVER_RADPS - GYRO_REST_RADPS) * shake;
        let accel = self.accel + self.accel_bias + triple(&mut self.noise, accel_sigma);
        let gyro = rates + self.gyro_bias + triple(&mut self.noise, gyro_sigma);
        (accel, gyro)
    }
}

fn triple(noise: &mut Noise, sigma: f64) -> In<Frd> {
    In::new(noise.gauss(sigma), noise.gauss(sigma), noise.gauss(sigma))
}
