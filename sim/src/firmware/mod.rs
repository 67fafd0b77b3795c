//! The wire between a physics simulator and a real firmware in place of the fake one.
//!
//! | Module | Firmware | Told by |
//! | --- | --- | --- |
//! | [`betaflight`] | Betaflight's simulator build, as a child process | datagrams with the state, datagrams with motors |
//! | [`inav`] | INAV, its simulator build or a board on the bench | MSP_SIMULATOR and MSP_MOTOR on any of its MSP ports |

pub mod betaflight;
pub mod inav;

use vehicle::{Frd, In, Ned, Rot};

/// Standard atmosphere at sea level, Pa.
const SEA_LEVEL_PA: f64 = 101_325.0;

/// What the sensors of a flight controller feel. Not the truth: biases, noise and a heading without compass are in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Felt {
    /// Angular rate, rad/s.
    pub rates_radps: In<Frd>,
    /// Specific force, m/s2; at rest (0, 0, -9.81).
    pub specific_force_mps2: In<Frd>,
    /// Attitude as an estimator of the controller would have it.
    pub attitude: Rot<Frd, Ned>,
    /// Barometric altitude above the floor, m.
    pub altitude_m: f64,
}

/// International standard atmosphere (ISO 2533), troposphere.
pub(crate) fn pressure_pa(altitude_m: f64) -> f64 {
    SEA_LEVEL_PA * libm::pow(1.0 - altitude_m / 44_330.77, 5.255_88)
}
