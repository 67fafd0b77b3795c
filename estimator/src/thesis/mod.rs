//! uQuad's own filter: 12 states and 3 accelerometer biases in Euler angles, for comparison and for craft that know their motor speeds.
//!
//! The production filter is [`crate::kalman`]. This one is singular with the nose straight up or down, and the covariance of Euler angles is
//! not that of a rotation; it is kept because it is the thesis, because a recorded run proves it to the last digit, and because
//! it predicts thrust from motor speeds, which nothing else here does.
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`dynamics`] | the equations of motion, their Jacobian, and which misprints are kept |
//! | [`noise`] | Q and R, fixed and following the norms |
//! | [`unwrap`] | yaw without jumps |
//! | [`filter`] | [`ThesisFilter`] |
//!
//! State order of every 15-vector: position x y z (m, world: x north, y west, z up), angles psi phi theta (rad, see [`crate::imu`]),
//! velocity vqx vqy vqz (m/s, body: forward, left, up), rates wqx wqy wqz (rad/s, body), accelerometer bias bax bay baz (m/s2, body).
//!
//! Rosa, Paternain and others, "uQuad! Un quadrotor autonomo", Facultad de Ingenieria, Montevideo (2012), section 1.2.4.

pub mod dynamics;
pub mod filter;
pub mod noise;
pub mod unwrap;

pub use dynamics::Equations;
pub use filter::{
    Channel, LeftOut, Refusal, StateSet, ThesisConfig, ThesisError, ThesisFilter, ThesisInput,
};
pub use noise::Noise;
pub use vehicle::UquadAirframe;

use nalgebra::{SMatrix, SVector};

/// Size of the state with biases.
pub const STATES: usize = 15;
/// First index of the position.
pub const POSITION: usize = 0;
/// First index of the angles psi, phi, theta.
pub const ANGLES: usize = 3;
/// First index of the body velocity.
pub const VELOCITY: usize = 6;
/// First index of the body rates.
pub const RATES: usize = 9;
/// First index of the accelerometer bias.
pub const BIAS: usize = 12;

/// State vector.
pub type State = SVector<f64, STATES>;
/// Covariance or Jacobian.
pub type Square = SMatrix<f64, STATES, STATES>;
