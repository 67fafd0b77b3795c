//! Stand-alone attitude from gyro, accelerometer and magnetometer: no map, no flight controller, no position.
//!
//! Three parts that do not disturb each other:
//!
//! ```text
//!  gyro, accelerometer --> tilt (12-state Kalman filter) --attitude with an arbitrary heading--+--> attitude in ENU
//!          |                  ^ velocity stays small                                           |
//!          +--> rest ---------+ velocity and rate are zero                                     v
//!  magnetometer ------------------------------------------------------> field (7-state Kalman filter) --heading
//! ```
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`AttitudeEstimator`] | the whole: samples in, quaternion out, what was refused |
//! | [`AttitudeParams`] | every tunable, with its unit |
//! | `rest` | is the sensor at rest, is it alive |
//! | `tilt` | velocity, attitude and biases; the accelerometer never turns the attitude directly |
//! | [`score`] | errors against a reference, as the BROAD benchmark counts them |
//! | `field` | earth's field seen in the drifting level frame, hard iron and the magnetometer's delay |
//!
//! **Why velocity.** The usual correction compares the direction of the accelerometer with gravity, and every acceleration of
//! the vehicle tilts it. Here the specific force is integrated to a velocity in the earth frame, and what is measured is that
//! this velocity stays small: a tilt error makes it run away at 0.17 m/s2 per degree, a shake does not. The low-pass in an
//! almost inertial frame that the best published filters use is the same idea with a fixed window; here the window follows
//! from the noise.
//!
//! **Why a field filter.** In the level frame of the tilt filter a magnetometer reads
//! `m = E + R b + delay * (w x E)`: the earth's field, which turns slowly as heading drifts, hard iron fixed to the sensor,
//! and the effect of a sample that is some milliseconds old. This is linear in all seven unknowns, so that a phone beside the
//! sensor is told from north by turning, without a calibration dance. A reading whose strength or dip does not fit
//! is trusted less by what it does not fit, and opens the hard iron to be learned again. Heading never touches the tilt.
//!
//! ```
//! use estimator::attitude::{AttitudeEstimator, AttitudeParams, MargSample};
//! use nalgebra::Vector3;
//! use vehicle::Timestamp;
//!
//! let mut attitude = AttitudeEstimator::new(AttitudeParams::default());
//! for k in 0..1000 {
//!     attitude.update(&MargSample {
//!         at: Timestamp::from_ms(4 * k),
//!         gyro_radps: Vector3::zeros(),
//!         accel_mps2: Vector3::new(0.0, 0.0, 9.81 + 1e-3 * (k % 7) as f64), // up at rest
//!         mag: Some(Vector3::new(0.0, 16.0, -41.0)), // y looks north
//!     });
//! }
//! let (roll, pitch, yaw) = attitude.imu_to_enu().euler_angles();
//! assert!(roll.abs() < 1e-3 && pitch.abs() < 1e-3 && yaw.abs() < 1e-3);
//! assert!(attitude.status().is_at_rest);
//! ```
//!
//! Daniel Laidig, Thomas Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
//! rejection" (2023): the low-pass in an almost inertial frame, rest detection. Joan Sola, "Quaternion kinematics for the
//! error-state Kalman filter" (2017).

mod field;
mod params;
mod rest;
pub mod score;
mod tilt;

pub use params::AttitudeParams;

use field::Field;
use nalgebra::{UnitQuaternion, Vector3};
use rest::Rest;
use tilt::Tilt;
use vehicle::Timestamp;

/// Longer than this without a sample is a gap: nothing is integrated over it, doubt grows, s.
const GAP_S: f64 = 0.1;

/// One sample of a 9-axis sensor, all three in the same right-handed frame of the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MargSample {
    /// When it was taken.
    pub at: Timestamp,
    /// Angular rate, rad/s.
    pub gyro_radps: Vector3<f64>,
    /// Specific force, m/s2: +g along up at rest.
    pub accel_mps2: Vector3<f64>,
    /// Magnetic field in any unit; none if there is no fresh one.
    pub mag: Option<Vector3<f64>>,
}

/// What the estimator thinks of its inputs and of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AttitudeStatus {
    /// Samples used.
    pub accepted: u64,
    /// Samples refused: not finite, beyond any sensor, or not newer than the one before.
    pub refused: u64,
    /// Samples that clipped at the range of the sensor; used, with doubt.
    pub saturated: u64,
    /// Gaps of more than 0.1 s.
    pub gaps: u64,
    /// Nothing turns and nothing shakes.
    pub is_at_rest: bool,
    /// Gyro and accelerometer repeat themselves to the last bit: the sensor is dead, its samples are refused.
    pub is_stuck: bool,
    /// The field does not fit in strength or dip: heading lives on the gyro.
    pub is_field_disturbed: bool,
    /// One standard deviation of roll and pitch, rad.
    pub tilt_std_rad: f64,
    /// One standard deviation of heading, rad; none before the first field.
    pub heading_std_rad: Option<f64>,
}

/// Attitude of a 9-axis sensor against east, north and up (magnetic north).
///
/// Feed samples in the order of their stamps with [`AttitudeEstimator::update`]; the answer is there at once. Never panics,
/// never allocates; the state stays finite whatever comes in.
#[derive(Clone, Debug)]
pub struct AttitudeEstimator {
    params: AttitudeParams,
    rest: Rest,
    tilt: Option<Tilt>,
    field: Field,
    last: Option<MargSample>,
    status: AttitudeStatus,
}

impl AttitudeEstimator {
    /// Waits for its first sample.
    #[must_use]
    pub const fn new(params: AttitudeParams) -> Self {
        Self {
            params,
            rest: Rest::new(),
            tilt: None,
            field: Field::new(),
            last: None,
            status: AttitudeStatus {
                accepted: 0,
                refused: 0,
                saturated: 0,
                gaps: 0,
                is_at_rest: false,
                is_stuck: false,
                is_field_disturbed: false,
                tilt_std_rad: core::f64::consts::PI,
                heading_std_rad: None,
            },
        }
    }

    /// Takes a sample; true if it was used.
    pub fn update(&mut self, sample: &MargSample) -> bool {
        let is_plausible = sample
            .gyro_radps
            .iter()
            .all(|w| w.abs() < 2.0 * self.params.gyro_range_radps)
            && sample
                .accel_mps2
                .iter()
                .all(|a| a.abs() < 2.0 * self.params.accel_range_mps2);
        // A comparison with NaN is false: what is not finite is refused here too.
        if !is_plausible || self.last.is_some_and(|last| sample.at <= last.at) {
            self.status.refused += 1;
            return false;
        }
        let Some(previous) = self.last else {
            return self.begin(sample);
        };
        self.rest.sense(sample, &previous, &self.params);
        let was_stuck = self.status.is_stuck;
        self.status.is_stuck = self.rest.is_stuck();
        self.status.is_at_rest = self.rest.is_at_rest() && !self.status.is_stuck;
        if self.status.is_stuck {
            if !was_stuck && let Some(tilt) = &mut self.tilt {
                // Until now the dead sensor was believed.
                let turn_rad = tilt.coast(rest::STUCK_S);
                self.field.coast(turn_rad);
            }
            // Time is not taken over: when the sensor lives again, what passed is a gap.
            self.status.refused += 1;
            return false;
        }
        self.last = Some(*sample);
        let Some(tilt) = &mut self.tilt else {
            return false;
        };
        let dt = sample.at.seconds_since(previous.at);
        if dt > GAP_S {
            self.status.gaps += 1;
            let turn_rad = tilt.coast(dt);
            self.field.coast(turn_rad);
            self.rest.restart();
            return true;
        }
        let is_saturated = sample.gyro_radps.amax() >= 0.998 * self.params.gyro_range_radps
            || sample.accel_mps2.amax() >= 0.998 * self.params.accel_range_mps2;
        if is_saturated {
            self.status.saturated += 1;
            tilt.doubt_saturated(dt);
            self.field.doubt_saturated(dt);
        }
        tilt.predict(sample, &previous, dt, &self.params);
        tilt.aid(&self.rest, dt, &self.params);
        if !tilt.is_finite() {
            // Unreachable with plausible samples; a fresh start is better than no attitude at all.
            self.tilt = None;
            self.field = Field::new();
            return self.begin(sample);
        }
        self.field
            .observe(tilt, sample.mag.as_ref(), dt, &self.params);
        self.status.accepted += 1;
        self.status.tilt_std_rad = tilt.std_rad();
        self.status.heading_std_rad = self.field.heading_std_rad();
        self.status.is_field_disturbed = self.field.is_disturbed(&self.params);
        true
    }

    fn begin(&mut self, sample: &MargSample) -> bool {
        // In free fall there is no up to begin with.
        if sample.accel_mps2.norm() < 0.5 * self.params.gravity_mps2 {
            self.status.refused += 1;
            return false;
        }
        self.tilt = Some(Tilt::new(&sample.accel_mps2, &self.params));
        self.last = Some(*sample);
        self.status.accepted += 1;
        true
    }

    /// Sensor frame to east, north, up, now: turned ahead by the sensor's own delay. Identity before the first sample.
    #[must_use]
    pub fn imu_to_enu(&self) -> UnitQuaternion<f64> {
        let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.field.heading_rad());
        self.imu_to_level()
            .map_or_else(UnitQuaternion::identity, |q| heading * q)
    }

    /// Sensor frame to a level frame (z up) whose heading is arbitrary and drifts slowly, now: attitude without a magnetometer.
    #[must_use]
    pub fn imu_to_level(&self) -> Option<UnitQuaternion<f64>> {
        let tilt = self.tilt.as_ref()?;
        let ahead = tilt.rate_radps() * self.params.sensor_delay_s;
        Some(tilt.imu_to_level() * UnitQuaternion::from_scaled_axis(ahead))
    }

    /// Gyro bias, rad/s, sensor frame.
    #[must_use]
    pub fn gyro_bias_radps(&self) -> Vector3<f64> {
        self.tilt
            .as_ref()
            .map_or_else(Vector3::zeros, Tilt::gyro_bias)
    }

    /// Hard iron: field that turns with the sensor, in the unit of the magnetometer, sensor frame.
    #[must_use]
    pub fn hard_iron(&self) -> Vector3<f64> {
        self.field.hard_iron()
    }

    /// How much older the magnetometer's samples are than the gyro's, s.
    #[must_use]
    pub fn mag_delay_s(&self) -> f64 {
        self.field.delay_s()
    }

    /// What the estimator thinks of its inputs and of itself.
    #[must_use]
    pub const fn status(&self) -> &AttitudeStatus {
        &self.status
    }
}

#[cfg(test)]
mod tests;
