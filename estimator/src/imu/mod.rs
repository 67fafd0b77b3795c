//! uQuad's inertial unit: from bytes on a serial line to metres, radians and flags.
//!
//! A Mongoose 9-degrees-of-freedom board (ADXL345, ITG3200, HMC5843, BMP085) sends one frame every 10 ms. Everything here is a
//! pure state machine: bytes and the time of their arrival go in, readings come out.
//!
//! ```text
//! bytes -> BinaryDecoder or AsciiDecoder -> FrameWatch -> FrameRing -> Fir -> Converter -> Reading
//! imu_raw log -> Replay ---------------------^                \-> StartUp (gyro null, p0, attitude)
//! ```
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`frame`] | one frame in counts, and its 30 bytes |
//! | [`binary`], [`ascii`] | the two formats as push decoders |
//! | [`command`] | what can be said to the board |
//! | [`replay`] | a recorded `imu_raw` log in place of the board |
//! | [`watch`] | frames that lie: duplicate stamps, stuck and saturated sensors, pressure spikes |
//! | [`period`] | measured sampling period, clamped and counted |
//! | [`ring`] | the last 32 frames; the newest is used, none is lost to the filter |
//! | [`fir`] | smoothing of the raw counts |
//! | [`calibration`] | the calibration file |
//! | [`convert`] | counts to SI |
//! | [`angles`] | Euler angles from gravity and field |
//! | [`barometer`] | pressure to height |
//! | [`norm`] | is this gravity, is this the Earth's field |
//! | [`startup`] | 512 still frames: gyro null, reference pressure, attitude |
//! | [`chain`] | [`ImuChain`]: the whole |
//!
//! # Frame and names
//!
//! Body x forward, y left, z up: a level board at rest reads +9.81 m/s2 on z. The names are uQuad's, not aviation's:
//!
//! | Name | About | Positive | Aviation (FRD, NED) |
//! | --- | --- | --- | --- |
//! | psi | x | right side down | roll = psi |
//! | phi | y | nose down | pitch = -phi |
//! | theta | z | counter-clockwise from above | yaw = -theta |
//!
//! # Two builds
//!
//! [`Build::Final`] is the arithmetic of the final program with its misprints corrected; [`Build::March2012`] is that of the recorded
//! run of 23 March 2012, for comparison with the recording to the last digit.
//!
//! Rosa, Paternain and others, "uQuad! Un quadrotor autonomo", Facultad de Ingenieria, Montevideo (2012), sections 1.2 and 1.3.

pub mod angles;
pub mod ascii;
pub mod barometer;
pub mod binary;
pub mod calibration;
pub mod chain;
pub mod command;
pub mod convert;
pub mod fir;
pub mod frame;
pub mod norm;
pub mod period;
pub mod replay;
pub mod ring;
pub mod startup;
pub mod watch;

pub use angles::Angles;
pub use calibration::{Calibration, CalibrationError};
pub use chain::{ChainConfig, ConfigError, ImuChain, ImuEvent, Reading, Smoothing};
pub use convert::{Converter, Measured};
pub use frame::{Counts, RawFrame};
pub use startup::{Reference, StartUp};
pub use watch::{FrameFault, Sensor};

/// Whose arithmetic is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Build {
    /// The final program of May 2012, corrected.
    #[default]
    Final,
    /// The program of the recorded run of 23 March 2012: gyro matrix in deg/s per count and no gyro null, `asin(ax / 9.81)`,
    /// `theta = atan2(v0, v1)` and no gimbal branch.
    March2012,
}

/// Acceleration of gravity of the uQuad program, m/s2.
pub const GRAVITY_MPS2: f64 = vehicle::uquad::GRAVITY_MPS2;
