//! Change of the flight controller's heading over a window of about two seconds.
//!
//! Without a compass the heading has an arbitrary zero and drifts, so its value says nothing about yaw on the plan. Its
//! change, compared with the gyro integrated over the same window, says how wrong the gyro bias is: the row touches the
//! bias only, so no yaw information is invented.

use super::Observation;
use crate::kalman::{ErrorVector, GYRO_BIAS, Nominal};
use nalgebra::Vector3;
use vehicle::Timestamp;
use vehicle::angle::wrap_pi;

/// Length of the window, s: quantisation of a whole degree is then worth 0.2 deg/s.
pub const WINDOW_S: f64 = 2.0;

/// The gyro integrated since a heading was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    began: Timestamp,
    heading_rad: f64,
    turned_rad: f64,
    bias_gain_s: Vector3<f64>,
}

impl Window {
    /// Begins with a heading of the flight controller.
    #[must_use]
    pub fn new(began: Timestamp, heading_rad: f64) -> Self {
        Self {
            began,
            heading_rad,
            turned_rad: 0.0,
            bias_gain_s: Vector3::zeros(),
        }
    }

    /// Adds the raw gyro reading over an interval, rad/s FRD.
    pub fn integrate(&mut self, state: &Nominal, gyro: &Vector3<f64>, dt: f64) {
        let to_yaw = super::yaw::observe(state);
        let to_yaw = to_yaw
            .row()
            .fixed_rows::<3>(crate::kalman::ATTITUDE)
            .into_owned();
        self.turned_rad += to_yaw.dot(gyro) * dt;
        self.bias_gain_s += to_yaw * dt;
    }

    /// Age, s.
    #[must_use]
    pub fn age_s(&self, now: Timestamp) -> f64 {
        now.seconds_since(self.began)
    }

    /// The heading's change as a measurement: (prediction, measured).
    #[must_use]
    pub fn observe(&self, state: &Nominal, heading_rad: f64) -> (Observation, f64) {
        let predicted = self.turned_rad - self.bias_gain_s.dot(&state.gyro_bias);
        let mut row = ErrorVector::zeros();
        row.fixed_rows_mut::<3>(GYRO_BIAS)
            .copy_from(&-self.bias_gain_s);
        (
            Observation::angle(predicted, row),
            wrap_pi(heading_rad - self.heading_rad),
        )
    }
}
