//! How the filters start, and what is published.

use super::{Estimator, StartPlace, UNKNOWN_POSITION_M};
use crate::kalman::{InitialStd, Nominal, POSITION, VELOCITY};
use nalgebra::{UnitQuaternion, Vector3};
use vehicle::{ImuSample, In, Localization, LocalizationState, NavState, Rot, Timestamp};

/// Inertial samples may come this long without an attitude before the filters start from gravity alone, s.
const PATIENCE_S: f64 = 0.5;
/// Nobody knows the yaw: deviation of a uniform angle, rad.
const UNKNOWN_YAW_RAD: f64 = 1.81;

impl Estimator {
    pub(super) fn wait_for_attitude(&mut self, imu: &ImuSample) {
        if !crate::kalman::is_plausible(imu) {
            self.diagnostics.refused_samples += 1;
            return;
        }
        let first = *self.first_imu.get_or_insert(imu.at);
        let f = imu.accel_mps2;
        if imu.at.seconds_since(first) >= PATIENCE_S && f.norm() > 5.0 {
            let roll = libm::atan2(-f.y(), -f.z());
            let pitch = libm::atan2(f.x(), libm::hypot(f.y(), f.z()));
            self.start_filters(imu.at, roll, pitch, 0.0);
        }
    }

    pub(super) fn start_filters(&mut self, at: Timestamp, roll: f64, pitch: f64, heading: f64) {
        let std = InitialStd {
            position_m: 0.01,
            // Told to stand: on its legs. Not told: a restart in the air, the down-range decides.
            height_m: if self.is_landed { 0.05 } else { 3.0 },
            velocity_mps: 0.3,
            tilt_rad: 0.05,
            yaw_rad: 0.05,
        };
        let height = Vector3::new(0.0, 0.0, -self.params.landed_height_m);
        let nominal = Nominal {
            position: height,
            attitude: UnitQuaternion::from_euler_angles(roll, pitch, heading),
            ..Nominal::default()
        };
        self.odometry.start(at, nominal, std);
        let position_m = if self.locator.is_some() {
            UNKNOWN_POSITION_M
        } else {
            0.1
        };
        self.navigation
            .start(at, nominal, InitialStd { position_m, ..std });
        if let StartPlace::At {
            pose,
            std_m,
            std_rad,
        } = self.start
        {
            self.go_to(&pose, std_m, std_rad);
        }
    }

    pub(super) fn publish(&mut self, now: Timestamp) {
        let localization = self
            .locator
            .as_ref()
            .map_or_else(Localization::default, |l| *l.status());
        let health = self.fresh.health(now, localization.state, self.is_landed);
        self.state.localization = localization;
        self.state.health = health;
        if !self.navigation.is_running() {
            return;
        }
        let f = &self.navigation;
        let x = f.state();
        let accel = f
            .last_imu()
            .map_or_else(Vector3::zeros, |imu| *imu.accel_mps2.vector());
        let is_placed = localization.state == LocalizationState::Localized
            || self.fresh.has_external(now)
            || matches!(self.start, StartPlace::At { .. });
        let yaw_std = f.yaw_std_rad();
        let position_std = f.std_of(POSITION);
        self.state = NavState {
            at: f.at(),
            position: In::from_vector(x.position),
            velocity: In::from_vector(x.velocity),
            attitude: Rot::from_quaternion(x.attitude),
            rates_radps: In::from_vector(f.rates()),
            accel_mps2: In::from_vector(accel - x.accel_bias),
            gyro_bias_radps: In::from_vector(x.gyro_bias),
            accel_bias_mps2: In::from_vector(x.accel_bias),
            height_m: f.height_m(),
            position_std_m: position_std,
            velocity_std_mps: f.std_of(VELOCITY),
            yaw_std_rad: if is_placed {
                yaw_std
            } else {
                yaw_std.max(UNKNOWN_YAW_RAD)
            },
            health,
            localization,
        };
    }
}
