//! Propagation with inertial samples: trapezoid over two neighbouring samples, mid-point attitude.
//!
//! Samples come at about 40 Hz over MSP, so the angle turned within one interval (0.05 rad in a fast yaw) is not small
//! against the noise: the specific force is turned with the attitude in the middle of the interval.

use super::covariance::{Growth, Symmetric, Transition};
use super::nominal::exp;
use super::{ATTITUDE, Covariance, Filter, POSITION, VELOCITY};
use nalgebra::Vector3;
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::{ImuSample, Timestamp};

/// Longer than this without an inertial sample is a gap: velocity is held and its uncertainty grows, s.
const GAP_S: f64 = 0.25;
/// A reading this much older than the filter is told by what waited, not by what is, s. No sensor of ours takes half as long.
const LATE_S: f64 = 0.15;
/// What the vehicle may do unseen in a gap: acceleration, m/s2, and angular rate, rad/s.
const GAP_ACCEL_MPS2: f64 = 2.0;
const GAP_RATE_RADPS: f64 = 0.3;
/// Share of the change between two samples that the trapezoid may be wrong by.
const TRAPEZOID_DOUBT: f64 = 0.5;
/// Swing squared that white noise stays below, in units of its variance per sample: twice chi-squared, three degrees of
/// freedom, 99.7 %.
const NOISE_SWING: f64 = 28.0;
/// Saturation of the sensors; beyond it a sample is nonsense: 32 g and 70 rad/s (4000 deg/s).
const MAX_ACCEL_MPS2: f64 = 320.0;
const MAX_RATE_RADPS: f64 = 70.0;

/// Spectral densities of the process noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessNoise {
    /// Accelerometer, m/s2/sqrt(Hz).
    pub accel: f64,
    /// Gyro, rad/s/sqrt(Hz).
    pub gyro: f64,
    /// Accelerometer bias walk, m/s3/sqrt(Hz).
    pub accel_bias: f64,
    /// Gyro bias walk, rad/s2/sqrt(Hz).
    pub gyro_bias: f64,
}

impl Default for ProcessNoise {
    fn default() -> Self {
        Self {
            accel: 0.2,
            gyro: 0.01,
            accel_bias: 2e-3,
            gyro_bias: 1e-4,
        }
    }
}

/// True if a sample can have come from a working sensor.
#[must_use]
pub(crate) fn is_plausible(imu: &ImuSample) -> bool {
    imu.accel_mps2.is_finite()
        && imu.gyro_radps.is_finite()
        && imu.accel_mps2.vector().norm_squared() < MAX_ACCEL_MPS2 * MAX_ACCEL_MPS2
        && imu.gyro_radps.vector().norm_squared() < MAX_RATE_RADPS * MAX_RATE_RADPS
}

impl Filter {
    /// Propagates to the time of an inertial sample. Samples that are not newer, not finite or beyond saturation are refused.
    pub fn predict(&mut self, imu: &ImuSample) -> bool {
        if !is_plausible(imu) || !self.is_running {
            return false;
        }
        let dt = imu.at.seconds_since(self.at);
        if dt <= 0.0 {
            return false;
        }
        let previous = self.last_imu.unwrap_or(*imu);
        if dt > GAP_S {
            self.coast(dt);
        } else {
            let accel = (previous.accel_mps2.vector() + imu.accel_mps2.vector()) * 0.5;
            let gyro = (previous.gyro_radps.vector() + imu.gyro_radps.vector()) * 0.5;
            let swing2 = (imu.accel_mps2 - previous.accel_mps2)
                .vector()
                .norm_squared();
            self.step(&accel, &gyro, swing2, dt);
        }
        self.last_imu = Some(*imu);
        self.at = imu.at;
        true
    }

    /// One trapezoid: mean specific force and rate over the interval; `swing2` is the square of the specific force's change in it.
    fn step(&mut self, accel: &Vector3<f64>, gyro: &Vector3<f64>, swing2: f64, dt: f64) {
        let x = &mut self.state;
        x.limit_biases();
        let force = accel - x.accel_bias;
        let turn = (gyro - x.gyro_bias) * dt;
        let half_turn = exp(&(turn * 0.5));
        let middle = x.attitude * half_turn;
        let rotation = middle.to_rotation_matrix().into_inner();
        let acceleration = rotation * force + Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        x.position += x.velocity * dt + acceleration * (0.5 * dt * dt);
        x.velocity += acceleration * dt;
        x.attitude = middle * half_turn;
        x.attitude.renormalize_fast();

        let force = rotation * force.cross_matrix();
        let turn = (half_turn * half_turn)
            .inverse()
            .to_rotation_matrix()
            .into_inner();
        let n = self.noise;
        // A knock between two samples may have lasted for all of the interval or for none of it. What white noise alone
        // makes of the difference of two samples is in the density already: counted twice, the filter would doubt itself.
        let by_noise = NOISE_SWING * n.accel * n.accel / dt;
        let knock = TRAPEZOID_DOUBT * TRAPEZOID_DOUBT * (swing2 - by_noise).max(0.0);
        let accel_q = n.accel * n.accel + knock * dt;
        let transition = Transition {
            dt,
            rotation,
            force,
            turn,
        };
        let growth = Growth {
            position: accel_q * dt * dt * dt / 3.0,
            position_velocity: accel_q * dt * dt * 0.5,
            velocity: accel_q * dt,
            attitude: n.gyro * n.gyro * dt,
            accel_bias: n.accel_bias * n.accel_bias * dt,
            gyro_bias: n.gyro_bias * n.gyro_bias * dt,
        };
        self.covariance.propagate(&transition, &growth);
    }

    /// Whether the filter is at another time than this, because of a gap of the inertial samples: not yet there, or past it already with
    /// the readings that waited still coming. Fused at once, the readings of a whole gap would look like one moment's, and their
    /// spread like a speed.
    #[must_use]
    pub fn is_elsewhere(&self, at: Timestamp) -> bool {
        self.last_imu
            .is_some_and(|imu| !(-LATE_S..=GAP_S).contains(&at.seconds_since(imu.at)))
    }

    /// Without inertial samples: constant velocity and attitude, with honest growth of doubt.
    fn coast(&mut self, dt: f64) {
        // A gap longer than a few seconds says nothing more: cap it, so that no number runs away.
        let dt = dt.min(10.0);
        self.state.position += self.state.velocity * dt;
        let mut phi = Covariance::identity();
        for i in 0..3 {
            phi[(POSITION + i, VELOCITY + i)] = dt;
        }
        self.settle();
        let mut p = phi * self.covariance.dense() * phi.transpose();
        let dv = GAP_ACCEL_MPS2 * dt;
        let turn = (GAP_RATE_RADPS * dt).min(1.0);
        for i in 0..3 {
            p[(POSITION + i, POSITION + i)] += 0.25 * dv * dv * dt * dt;
            p[(VELOCITY + i, VELOCITY + i)] += dv * dv;
            p[(ATTITUDE + i, ATTITUDE + i)] += turn * turn;
        }
        self.covariance = Symmetric::from_dense(&p);
    }
}
