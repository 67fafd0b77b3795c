//! Is the sensor at rest, and is it alive?

use super::{AttitudeParams, MargSample};
use nalgebra::Vector3;

/// Time constant of the means that a sample is compared with, s.
const MEAN_S: f64 = 0.5;
/// So long a living sensor never repeats all six numbers to the last bit, s.
pub(super) const STUCK_S: f64 = 0.5;

/// Means of gyro and accelerometer, and for how long nothing left them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rest {
    gyro_mean: Vector3<f64>,
    accel_mean: Vector3<f64>,
    /// Time over which the means were gathered, s.
    gathered_s: f64,
    calm_s: f64,
    repeated_s: f64,
    is_calm_long_enough: bool,
}

impl Rest {
    pub(super) const fn new() -> Self {
        Self {
            gyro_mean: Vector3::new(0.0, 0.0, 0.0),
            accel_mean: Vector3::new(0.0, 0.0, 0.0),
            gathered_s: 0.0,
            calm_s: 0.0,
            repeated_s: 0.0,
            is_calm_long_enough: false,
        }
    }

    /// After a gap nobody knows what happened.
    pub(super) const fn restart(&mut self) {
        *self = Self::new();
    }

    pub(super) fn sense(&mut self, sample: &MargSample, previous: &MargSample, p: &AttitudeParams) {
        let dt = sample.at.seconds_since(previous.at);
        let is_same =
            sample.gyro_radps == previous.gyro_radps && sample.accel_mps2 == previous.accel_mps2;
        self.repeated_s = if is_same { self.repeated_s + dt } else { 0.0 };
        if self.gathered_s <= 0.0 {
            self.gyro_mean = sample.gyro_radps;
            self.accel_mean = sample.accel_mps2;
        }
        self.gathered_s += dt;
        let share = 1.0 - libm::exp(-dt / MEAN_S);
        self.gyro_mean += (sample.gyro_radps - self.gyro_mean) * share;
        self.accel_mean += (sample.accel_mps2 - self.accel_mean) * share;
        let is_calm = (sample.gyro_radps - self.gyro_mean).norm() < p.rest_gyro_radps
            && self.gyro_mean.norm() < p.rest_bias_radps
            && (sample.accel_mps2 - self.accel_mean).norm() < p.rest_accel_mps2;
        self.calm_s = if is_calm { self.calm_s + dt } else { 0.0 };
        self.is_calm_long_enough = self.calm_s > p.rest_after_s;
    }

    pub(super) const fn is_at_rest(&self) -> bool {
        self.is_calm_long_enough
    }

    pub(super) fn is_stuck(&self) -> bool {
        self.repeated_s >= STUCK_S
    }

    /// Mean of the gyro over the last half second, rad/s.
    pub(super) const fn gyro_mean(&self) -> &Vector3<f64> {
        &self.gyro_mean
    }

    /// For how long neighbouring means are alike, s.
    pub(super) const fn mean_s(&self) -> f64 {
        MEAN_S
    }
}
