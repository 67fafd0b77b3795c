//! Error-state Kalman filter: position, velocity, attitude and the biases of the inertial sensors.
//!
//! State order of every 15-vector and 15x15 matrix: position (0..3, m, NED), velocity (3..6, m/s, NED), attitude error
//! (6..9, rad, body frame, right error: `q_true = q * Exp(error)`), accelerometer bias (9..12, m/s2, FRD), gyro bias
//! (12..15, rad/s, FRD). Joan Sola, "Quaternion kinematics for the error-state Kalman filter" (2017), with g = (0, 0, +9.80665).
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`nominal`] | the nominal state and its boxplus |
//! | `predict` | propagation with inertial samples |
//! | `update` | scalar measurement updates, covariance kept symmetric and positive |
//! | `covariance` | sparse, symmetric arithmetic of the covariance |
//! | [`gate`] | innovation gates that widen after a second of rejection |
//! | [`aid`] | one observation model per file |
//! | `ground` | the floor under the vehicle: steps are tables, not jumps |

pub mod aid;
mod covariance;
pub mod gate;
mod ground;
pub mod nominal;
mod predict;
mod update;

pub use aid::Observation;
pub use gate::{Aid, AidStatus};
pub use ground::Ground;
pub use nominal::Nominal;
pub use predict::ProcessNoise;
pub(crate) use predict::is_plausible;
pub use update::Quality;

use core::f64::consts::PI;
use covariance::Symmetric;
use gate::Gate;
use nalgebra::{SMatrix, SVector, Vector3};
use vehicle::{ImuSample, In, Ned, Timestamp};

/// Size of the error state.
pub const STATES: usize = 15;
/// First index of position.
pub const POSITION: usize = 0;
/// First index of velocity.
pub const VELOCITY: usize = 3;
/// First index of the attitude error.
pub const ATTITUDE: usize = 6;
/// First index of the accelerometer bias.
pub const ACCEL_BIAS: usize = 9;
/// First index of the gyro bias.
pub const GYRO_BIAS: usize = 12;

/// Error-state vector, or one row of an observation matrix.
pub type ErrorVector = SVector<f64, STATES>;
/// Covariance of the error state, SI squared.
pub type Covariance = SMatrix<f64, STATES, STATES>;

/// One standard deviation of each part of the state when a filter starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InitialStd {
    /// Horizontal position, m.
    pub position_m: f64,
    /// Height, m.
    pub height_m: f64,
    /// Velocity, m/s.
    pub velocity_mps: f64,
    /// Roll and pitch, rad.
    pub tilt_rad: f64,
    /// Yaw, rad.
    pub yaw_rad: f64,
}

/// The filter. It is run twice: as navigation with every aid, and as odometry without any aid from the map.
#[derive(Clone, Debug)]
pub struct Filter {
    state: Nominal,
    covariance: Symmetric,
    /// Corrections of the attitude, halved, that the covariance has not turned with yet.
    turned: Vector3<f64>,
    at: Timestamp,
    last_imu: Option<ImuSample>,
    noise: ProcessNoise,
    gates: [Gate; Aid::COUNT],
    /// The floor under the vehicle.
    pub ground: Ground,
    is_running: bool,
}

impl Filter {
    /// A filter that waits for [`Filter::start`].
    #[must_use]
    pub fn new(noise: ProcessNoise) -> Self {
        Self {
            state: Nominal::default(),
            covariance: Symmetric::diagonal(&ErrorVector::repeat(1.0)),
            turned: Vector3::zeros(),
            at: Timestamp::ZERO,
            last_imu: None,
            noise,
            gates: [Gate::default(); Aid::COUNT],
            ground: Ground::default(),
            is_running: false,
        }
    }

    /// Starts (or starts again) from a state; biases keep their estimates.
    pub fn start(&mut self, at: Timestamp, state: Nominal, std: InitialStd) {
        self.state = state;
        self.at = at;
        let mut std_of = ErrorVector::zeros();
        for i in 0..2 {
            std_of[POSITION + i] = std.position_m;
            std_of[ATTITUDE + i] = std.tilt_rad;
        }
        std_of[POSITION + 2] = std.height_m;
        std_of[ATTITUDE + 2] = std.yaw_rad;
        for i in 0..3 {
            std_of[VELOCITY + i] = std.velocity_mps;
            // Algorithms note 1.1: 0.3 m/s2 and 0.02 rad/s before any learning.
            std_of[ACCEL_BIAS + i] = 0.3;
            std_of[GYRO_BIAS + i] = 0.02;
        }
        self.covariance = Symmetric::diagonal(&std_of.component_mul(&std_of));
        self.turned = Vector3::zeros();
        self.is_running = true;
    }

    /// True after [`Filter::start`].
    #[must_use]
    pub const fn is_running(&self) -> bool {
        self.is_running
    }

    /// The estimate.
    #[must_use]
    pub const fn state(&self) -> &Nominal {
        &self.state
    }

    /// Covariance of the error state.
    #[must_use]
    pub fn covariance(&self) -> Covariance {
        self.covariance.dense()
    }

    /// Time the estimate holds for: the last inertial sample.
    #[must_use]
    pub const fn at(&self) -> Timestamp {
        self.at
    }

    /// The last inertial sample used.
    #[must_use]
    pub const fn last_imu(&self) -> Option<&ImuSample> {
        self.last_imu.as_ref()
    }

    /// Bias-free angular rate at the last inertial sample, rad/s FRD.
    #[must_use]
    pub fn rates(&self) -> Vector3<f64> {
        self.last_imu.map_or_else(Vector3::zeros, |imu| {
            imu.gyro_radps.vector() - self.state.gyro_bias
        })
    }

    /// Height above what is below, m.
    #[must_use]
    pub fn height_m(&self) -> f64 {
        -self.state.position.z - self.ground.height_m()
    }

    /// One standard deviation of three neighbouring components.
    #[must_use]
    pub fn std_of(&self, first: usize) -> In<Ned> {
        let s = |i: usize| self.covariance.variance(first + i).max(0.0).sqrt();
        In::new(s(0), s(1), s(2))
    }

    /// One standard deviation of yaw, rad; at most a half turn, which says nothing. Nose straight up or down there is no yaw.
    #[must_use]
    pub fn yaw_std_rad(&self) -> f64 {
        let o = aid::yaw::observe(&self.state);
        let (_, variance) = self.covariance.times(o.row(), o.support());
        if variance.is_finite() {
            variance.max(0.0).sqrt().min(PI)
        } else {
            PI
        }
    }

    /// What the gate of an aid has seen.
    #[must_use]
    pub fn status(&self, aid: Aid) -> AidStatus {
        self.gates[aid as usize].status()
    }

    /// How long an aid has been refused without a break, s; silence is no refusal. Ends after a second, when the filter gives in.
    #[must_use]
    pub fn refused_s(&self, aid: Aid) -> f64 {
        self.gates[aid as usize].refused_s()
    }

    /// Puts the vehicle at another place and heading: velocity and attitude turn with the heading, height stays.
    pub fn relocate(&mut self, north_m: f64, east_m: f64, yaw_rad: f64, std_m: f64, std_yaw: f64) {
        let turn = vehicle::angle::wrap_pi(yaw_rad - self.state.yaw());
        let about_down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
        self.state.position.x = north_m;
        self.state.position.y = east_m;
        self.state.velocity = about_down * self.state.velocity;
        self.state.attitude = about_down * self.state.attitude;
        // NED errors turn with the vehicle; body errors do not.
        self.settle();
        let mut covariance = self.covariance.dense();
        let rotation = about_down.to_rotation_matrix().into_inner();
        let mut g = Covariance::identity();
        g.fixed_view_mut::<3, 3>(VELOCITY, VELOCITY)
            .copy_from(&rotation);
        covariance = g * covariance * g.transpose();
        for i in [POSITION, POSITION + 1] {
            covariance.row_mut(i).fill(0.0);
            covariance.column_mut(i).fill(0.0);
            covariance[(i, i)] = std_m * std_m;
        }
        // Yaw: forget what was known about the rotation around down, then put the new variance there.
        let down_in_body = self.state.attitude.inverse() * Vector3::z();
        let keep = nalgebra::Matrix3::identity() - down_in_body * down_in_body.transpose();
        let mut g = Covariance::identity();
        g.fixed_view_mut::<3, 3>(ATTITUDE, ATTITUDE)
            .copy_from(&keep);
        covariance = g * covariance * g.transpose();
        let yaw_part = down_in_body * down_in_body.transpose() * (std_yaw * std_yaw);
        let mut block = covariance.fixed_view_mut::<3, 3>(ATTITUDE, ATTITUDE);
        block += yaw_part;
        self.covariance = Symmetric::from_dense(&covariance);
        for aid in [Aid::PoseLong, Aid::PoseCross, Aid::PoseYaw] {
            self.gates[aid as usize].reset();
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
