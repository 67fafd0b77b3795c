//! What the estimator knows.

use crate::{Frd, In, MapPose, Ned, Rot, Timestamp};
use serde::{Deserialize, Serialize};

/// The navigation state that everything above the estimator uses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NavState {
    /// When it is true, our clock.
    pub at: Timestamp,
    /// m about home.
    pub position: In<Ned>,
    /// m/s.
    pub velocity: In<Ned>,
    /// Attitude with the fused plan yaw.
    pub attitude: Rot<Frd, Ned>,
    /// Bias-free angular rate, rad/s.
    pub rates_radps: In<Frd>,
    /// Bias-free specific force, m/s2.
    pub accel_mps2: In<Frd>,
    /// Gyro bias, rad/s.
    pub gyro_bias_radps: In<Frd>,
    /// Accelerometer bias, m/s2.
    pub accel_bias_mps2: In<Frd>,
    /// Height above what is below, m, positive up.
    pub height_m: f64,
    /// One standard deviation of position, m (NED).
    pub position_std_m: In<Ned>,
    /// One standard deviation of velocity, m/s (NED).
    pub velocity_std_mps: In<Ned>,
    /// One standard deviation of yaw, rad.
    pub yaw_std_rad: f64,
    /// Which parts can be trusted.
    pub health: NavHealth,
    /// What localization says.
    pub localization: Localization,
}

impl NavState {
    /// Heading, clockwise from north, rad.
    #[must_use]
    pub fn yaw_rad(&self) -> f64 {
        self.attitude.yaw()
    }
}

impl Default for NavState {
    fn default() -> Self {
        Self {
            at: Timestamp::ZERO,
            position: In::zero(),
            velocity: In::zero(),
            attitude: Rot::identity(),
            rates_radps: In::zero(),
            accel_mps2: In::new(0.0, 0.0, -9.80665),
            gyro_bias_radps: In::zero(),
            accel_bias_mps2: In::zero(),
            height_m: 0.0,
            position_std_m: In::new(1.0, 1.0, 1.0),
            velocity_std_mps: In::new(1.0, 1.0, 1.0),
            yaw_std_rad: 1.0,
            health: NavHealth::default(),
            localization: Localization::default(),
        }
    }
}

/// Which parts of the state can be flown on now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NavHealth {
    /// Roll, pitch and rates: the flight controller speaks.
    pub attitude: bool,
    /// Height: the down-ranger or the barometer speaks.
    pub height: bool,
    /// Horizontal velocity: flow or localization holds it.
    pub velocity: bool,
    /// Horizontal position and yaw on the plan.
    pub position: bool,
}

/// How sure localization is of its place on the plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum LocalizationState {
    /// No ranger has spoken, or no plan.
    #[default]
    Off,
    /// Looking for the place.
    Searching,
    /// On a place that the ranges confirm.
    Localized,
    /// Was localized, ranges no longer confirm it.
    Lost,
}

/// The figures of Monte Carlo localization.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Localization {
    /// How sure.
    pub state: LocalizationState,
    /// Pose of the heaviest cluster on the plan, if any.
    pub pose: Option<MapPose>,
    /// Weight share of the heaviest cluster, 0..=1.
    pub mass: f64,
    /// Effective sample size, 1 / sum of squared weights.
    pub effective_particles: f64,
    /// Number of particles.
    pub particles: u32,
    /// Counts every jump of the published pose that is not motion (relocalisation); MAVLink ODOMETRY.reset_counter.
    pub reset_counter: u8,
    /// How well the last scan fits the plan at the pose, 0..=1.
    pub fit: f64,
}
