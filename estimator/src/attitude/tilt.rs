//! Tilt: velocity, attitude against a level frame of arbitrary heading, and the biases.
//!
//! Error state: velocity (0..3, m/s, level frame), attitude (3..6, rad, sensor frame, right error), accelerometer bias (6..9),
//! gyro bias (9..12).

use super::rest::Rest;
use super::{AttitudeParams, MargSample};
use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

const STATES: usize = 12;
const VELOCITY: usize = 0;
const ATTITUDE: usize = 3;
const ACCEL_BIAS: usize = 6;
const GYRO_BIAS: usize = 9;

/// Aids come at this spacing, s.
const AID_S: f64 = 0.07;
/// Velocity at rest, m/s, and for how long its error is alike, s.
const REST_VELOCITY_STD_MPS: f64 = 0.01;
const REST_CORRELATION_S: f64 = 0.2;
/// First tilt from one accelerometer sample, rad.
const FIRST_TILT_STD_RAD: f64 = 0.05;
/// What may pass unseen in a gap beside the last known rate: rate, rad/s, and acceleration, m/s2.
const UNSEEN_RATE_RADPS: f64 = 1.0;
const UNSEEN_ACCEL_MPS2: f64 = 10.0;

type ErrorVector = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;

/// The tilt filter.
#[derive(Clone, Debug)]
pub(super) struct Tilt {
    velocity: Vector3<f64>,
    attitude: UnitQuaternion<f64>,
    accel_bias: Vector3<f64>,
    gyro_bias: Vector3<f64>,
    rate: Vector3<f64>,
    covariance: Covariance,
    since_aid_s: f64,
}

impl Tilt {
    /// Begins level with one accelerometer sample (not zero).
    pub(super) fn new(accel: &Vector3<f64>, p: &AttitudeParams) -> Self {
        let attitude = UnitQuaternion::rotation_between(accel, &Vector3::z())
            // Exactly upside down any half turn about a level axis will do.
            .unwrap_or_else(|| {
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI)
            });
        let mut covariance = Covariance::zeros();
        for i in 0..3 {
            let mut set = |at: usize, std: f64| covariance[(at + i, at + i)] = std * std;
            set(VELOCITY, p.velocity_std_mps);
            set(ATTITUDE, FIRST_TILT_STD_RAD);
            set(ACCEL_BIAS, p.accel_bias_std_mps2);
            set(GYRO_BIAS, p.gyro_bias_std_radps);
        }
        Self {
            velocity: Vector3::zeros(),
            attitude,
            accel_bias: Vector3::zeros(),
            gyro_bias: Vector3::zeros(),
            rate: Vector3::zeros(),
            covariance,
            since_aid_s: 0.0,
        }
    }

    pub(super) const fn imu_to_level(&self) -> UnitQuaternion<f64> {
        self.attitude
    }

    pub(super) const fn gyro_bias(&self) -> Vector3<f64> {
        self.gyro_bias
    }

    /// Rate without bias at the last sample, rad/s, sensor frame.
    pub(super) const fn rate_radps(&self) -> Vector3<f64> {
        self.rate
    }

    /// One standard deviation of the tilt, rad: the two directions that are not heading.
    pub(super) fn std_rad(&self) -> f64 {
        let block = self.covariance.fixed_view::<3, 3>(ATTITUDE, ATTITUDE);
        let up = self.attitude.inverse() * Vector3::z();
        let level = block.trace() - (up.transpose() * block * up).x;
        (0.5 * level).max(0.0).sqrt()
    }

    pub(super) fn is_finite(&self) -> bool {
        let finite = |v: &Vector3<f64>| v.iter().all(|c| c.is_finite());
        finite(&self.velocity)
            && finite(&self.accel_bias)
            && finite(&self.gyro_bias)
            && self.attitude.coords.iter().all(|c| c.is_finite())
            && self.covariance.iter().all(|c| c.is_finite())
    }

    /// One trapezoid between two samples.
    pub(super) fn predict(
        &mut self,
        sample: &MargSample,
        previous: &MargSample,
        dt: f64,
        p: &AttitudeParams,
    ) {
        self.rate = sample.gyro_radps - self.gyro_bias;
        let rate = (sample.gyro_radps + previous.gyro_radps) * 0.5 - self.gyro_bias;
        let force = (sample.accel_mps2 + previous.accel_mps2) * 0.5 - self.accel_bias;
        let turn = rate * dt;
        let middle = self.attitude * UnitQuaternion::from_scaled_axis(turn * 0.5);
        self.velocity += (middle * force - Vector3::z() * p.gravity_mps2) * dt;
        self.attitude *= UnitQuaternion::from_scaled_axis(turn);
        self.attitude.renormalize();

        let r = middle.to_rotation_matrix().into_inner();
        let mut phi = Covariance::identity();
        let mut set = |row: usize, column: usize, block: Matrix3<f64>| {
            phi.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        set(VELOCITY, ATTITUDE, r * force.cross_matrix() * -dt);
        set(VELOCITY, ACCEL_BIAS, r * -dt);
        let back = UnitQuaternion::from_scaled_axis(-turn);
        set(ATTITUDE, ATTITUDE, back.to_rotation_matrix().into_inner());
        set(ATTITUDE, GYRO_BIAS, Matrix3::identity() * -dt);
        self.covariance = phi * self.covariance * phi.transpose();

        let beyond = p.accel_noise_share * (sample.accel_mps2.norm() - p.gravity_mps2);
        let accel_q = p.accel_noise * p.accel_noise + beyond * beyond;
        let share = p.gyro_noise_share * p.gyro_noise_share;
        for i in 0..3 {
            // Half for the scale of this axis, half for its alignment with the others.
            let scale = share * (0.5 * rate[i] * rate[i] + rate.norm_squared() / 6.0);
            self.add_noise(VELOCITY + i, accel_q * dt);
            self.add_noise(ATTITUDE + i, (p.gyro_noise * p.gyro_noise + scale) * dt);
            self.add_noise(ACCEL_BIAS + i, p.accel_bias_walk * p.accel_bias_walk * dt);
            self.add_noise(GYRO_BIAS + i, p.gyro_bias_walk * p.gyro_bias_walk * dt);
        }
    }

    /// What is known beside the samples: velocity stays small; at rest it is zero and the gyro reads its bias.
    pub(super) fn aid(&mut self, rest: &Rest, dt: f64, p: &AttitudeParams) {
        self.since_aid_s += dt;
        if self.since_aid_s < AID_S {
            return;
        }
        let (std, correlation_s) = if rest.is_at_rest() {
            (REST_VELOCITY_STD_MPS, REST_CORRELATION_S)
        } else {
            (p.velocity_std_mps, p.velocity_correlation_s)
        };
        // Neighbouring aids share their error: more of them do not know more.
        let sharing = |correlation_s: f64| (correlation_s / self.since_aid_s).max(1.0);
        let velocity_r = std * std * sharing(correlation_s);
        let rate_r = p.rest_gyro_std_radps * p.rest_gyro_std_radps * sharing(rest.mean_s());
        for i in 0..3 {
            self.correct(VELOCITY + i, -self.velocity[i], velocity_r);
        }
        if rest.is_at_rest() {
            for i in 0..3 {
                let innovation = rest.gyro_mean()[i] - self.gyro_bias[i];
                self.correct(GYRO_BIAS + i, innovation, rate_r);
            }
        }
        self.since_aid_s = 0.0;
        let p = &mut self.covariance;
        *p = (*p + p.transpose()) * 0.5;
        for i in 0..STATES {
            p[(i, i)] = p[(i, i)].max(1e-14);
        }
    }

    /// Without samples: attitude and velocity are held, their doubt grows. Returns how far it may have turned, rad.
    pub(super) fn coast(&mut self, dt: f64) -> f64 {
        let dt = dt.min(10.0);
        // What turned before the gap went on turning.
        let turn_rad = (UNSEEN_RATE_RADPS + self.rate.norm()) * dt;
        self.rate = Vector3::zeros();
        self.doubt(turn_rad, UNSEEN_ACCEL_MPS2 * dt);
        turn_rad
    }

    /// A clipped sample hides as much again as it shows.
    pub(super) fn doubt_saturated(&mut self, dt: f64) {
        self.doubt(10.0 * UNSEEN_RATE_RADPS * dt, 10.0 * UNSEEN_ACCEL_MPS2 * dt);
    }

    fn doubt(&mut self, turn_rad: f64, speed_mps: f64) {
        let turn = turn_rad.min(1.0);
        let speed = speed_mps.min(20.0);
        for i in 0..3 {
            self.add_noise(ATTITUDE + i, turn * turn);
            self.add_noise(VELOCITY + i, speed * speed);
        }
    }

    fn add_noise(&mut self, i: usize, variance: f64) {
        self.covariance[(i, i)] += variance;
    }

    /// Measures one component of the state.
    fn correct(&mut self, index: usize, innovation: f64, r: f64) {
        let ph: ErrorVector = self.covariance.column(index).into_owned();
        let s = ph[index] + r;
        let gain = ph / s;
        self.covariance -= gain * ph.transpose();
        let error = gain * innovation;
        let part = |first: usize| error.fixed_rows::<3>(first).into_owned();
        self.velocity += part(VELOCITY);
        self.attitude *= UnitQuaternion::from_scaled_axis(part(ATTITUDE));
        self.accel_bias += part(ACCEL_BIAS);
        self.gyro_bias += part(GYRO_BIAS);
    }
}
