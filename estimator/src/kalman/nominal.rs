//! The nominal state: what the filter believes, with the attitude as a quaternion.

use super::{ACCEL_BIAS, ATTITUDE, ErrorVector, GYRO_BIAS, POSITION, VELOCITY};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Position, velocity, attitude, biases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nominal {
    /// m, NED (or Odom).
    pub position: Vector3<f64>,
    /// m/s, NED (or Odom).
    pub velocity: Vector3<f64>,
    /// FRD to NED (or Odom).
    pub attitude: UnitQuaternion<f64>,
    /// m/s2, FRD.
    pub accel_bias: Vector3<f64>,
    /// rad/s, FRD.
    pub gyro_bias: Vector3<f64>,
}

impl Default for Nominal {
    fn default() -> Self {
        Self {
            position: Vector3::zeros(),
            velocity: Vector3::zeros(),
            attitude: UnitQuaternion::identity(),
            accel_bias: Vector3::zeros(),
            gyro_bias: Vector3::zeros(),
        }
    }
}

/// Squared angle below which the series of [`exp`] is exact to rounding, rad2.
const SMALL_RAD2: f64 = 0.004;

/// No inertial sensor is worse than this; what says so is another sensor that lies.
const MAX_ACCEL_BIAS_MPS2: f64 = 5.0;
const MAX_GYRO_BIAS_RADPS: f64 = 0.5;

/// Rotation of a rotation vector, rad. The angles of one sample or one correction are small: their series needs no
/// trigonometric function and equals it to rounding.
#[inline]
#[must_use]
pub(crate) fn exp(turn: &Vector3<f64>) -> UnitQuaternion<f64> {
    let n2 = turn.norm_squared();
    if n2 >= SMALL_RAD2 || n2.is_nan() {
        return UnitQuaternion::from_scaled_axis(*turn);
    }
    let w = 1.0 - n2 * (0.125 - n2 * (1.0 / 384.0 - n2 * (1.0 / 46_080.0)));
    let s = 0.5 - n2 * (1.0 / 48.0 - n2 * (1.0 / 3840.0 - n2 * (1.0 / 645_120.0)));
    UnitQuaternion::new_unchecked(Quaternion::new(w, s * turn.x, s * turn.y, s * turn.z))
}

/// Each component within plus and minus a limit.
fn within(bias: Vector3<f64>, limit: f64) -> Vector3<f64> {
    bias.map(|b| b.clamp(-limit, limit))
}

impl Nominal {
    /// Adds an error-state vector (boxplus).
    #[must_use]
    pub fn plus(&self, error: &ErrorVector) -> Self {
        let part = |first: usize| error.fixed_rows::<3>(first).into_owned();
        let mut out = *self;
        out.add(
            &part(POSITION),
            &part(VELOCITY),
            &part(ATTITUDE),
            &part(ACCEL_BIAS),
            &part(GYRO_BIAS),
        );
        out.limit_biases();
        out
    }

    /// Adds an error, part by part.
    #[inline]
    pub(super) fn add(
        &mut self,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        turn: &Vector3<f64>,
        accel_bias: &Vector3<f64>,
        gyro_bias: &Vector3<f64>,
    ) {
        self.position += position;
        self.velocity += velocity;
        self.attitude *= exp(turn);
        self.accel_bias += accel_bias;
        self.gyro_bias += gyro_bias;
    }

    /// Biases that no sensor has are cut.
    #[inline]
    pub(super) fn limit_biases(&mut self) {
        self.accel_bias = within(self.accel_bias, MAX_ACCEL_BIAS_MPS2);
        self.gyro_bias = within(self.gyro_bias, MAX_GYRO_BIAS_RADPS);
    }

    /// The error-state vector that leads from here to `other` (boxminus).
    #[must_use]
    pub fn error_to(&self, other: &Self) -> ErrorVector {
        let mut e = ErrorVector::zeros();
        e.fixed_rows_mut::<3>(POSITION)
            .copy_from(&(other.position - self.position));
        e.fixed_rows_mut::<3>(VELOCITY)
            .copy_from(&(other.velocity - self.velocity));
        e.fixed_rows_mut::<3>(ATTITUDE)
            .copy_from(&(self.attitude.inverse() * other.attitude).scaled_axis());
        e.fixed_rows_mut::<3>(ACCEL_BIAS)
            .copy_from(&(other.accel_bias - self.accel_bias));
        e.fixed_rows_mut::<3>(GYRO_BIAS)
            .copy_from(&(other.gyro_bias - self.gyro_bias));
        e
    }

    /// Rotation matrix FRD to NED.
    #[must_use]
    pub fn rotation(&self) -> Matrix3<f64> {
        self.attitude.to_rotation_matrix().into_inner()
    }

    /// (roll, pitch, yaw), rad.
    #[must_use]
    pub fn roll_pitch_yaw(&self) -> (f64, f64, f64) {
        self.attitude.euler_angles()
    }

    /// Yaw, rad.
    #[must_use]
    pub fn yaw(&self) -> f64 {
        self.roll_pitch_yaw().2
    }

    /// Cosine of the tilt: third diagonal element of the rotation.
    #[must_use]
    pub fn cos_tilt(&self) -> f64 {
        (self.attitude * Vector3::z()).z
    }

    /// True if no component is NaN or infinite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let v = |v: &Vector3<f64>| v.iter().all(|c| c.is_finite());
        v(&self.position)
            && v(&self.velocity)
            && v(&self.accel_bias)
            && v(&self.gyro_bias)
            && self.attitude.coords.iter().all(|c| c.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_of_a_small_turn_equals_the_trigonometric_functions_to_rounding() {
        for k in 0..400 {
            let turn = Vector3::new(0.6, -0.48, 0.64) * (f64::from(k) * 3e-4);
            let (series, exact) = (exp(&turn), UnitQuaternion::from_scaled_axis(turn));
            assert!((series.coords - exact.coords).amax() < 4e-16, "{turn}");
        }
    }
}
