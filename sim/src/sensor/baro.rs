//! Barometric altitude of the flight controller: noisy, late, and fooled by its own propellers near the floor.
//!
//! | | Value | Source |
//! | --- | --- | --- |
//! | noise of the altitude | 0.12 m, forgotten within 0.3 s | indoor recordings, 0.1 - 0.15 m |
//! | lag | 0.3 s | MSP_ALTITUDE against truth, Betaflight 4.6 |
//! | drift | 0.01 m per root second | doors, air conditioning |
//! | reads low near the floor | up to 0.3 m below 0.3 m height with the motors on | pressure under the propellers |

use crate::noise::{Noise, Wander};

const NOISE_M: f64 = 0.12;
const NOISE_MEMORY_S: f64 = 0.3;
const LAG_S: f64 = 0.3;
const CLIMB_LAG_S: f64 = 0.3;
const DRIFT_M: f64 = 0.01;
const FLOOR_PRESSURE_M: f64 = 0.3;
const FLOOR_PRESSURE_ENDS_M: f64 = 0.3;
/// Time between updates, s.
pub(crate) const BARO_STEP_S: f64 = 0.02;

/// Altitude and climb rate above the place of the last [`Baro::zero`].
#[derive(Clone, Debug)]
pub(crate) struct Baro {
    noise: Noise,
    jitter: Wander,
    drift_m: f64,
    felt_m: f64,
    altitude_m: f64,
    climb_mps: f64,
    zero_m: f64,
}

impl Baro {
    pub(crate) fn new(seed: u64, vehicle: usize, height_m: f64) -> Self {
        let mut noise = Noise::new(seed, vehicle, "baro");
        // The filter below passes half of the variance of noise as slow as itself.
        let input_m = NOISE_M * core::f64::consts::SQRT_2;
        let jitter = Wander::new(&mut noise, input_m, NOISE_MEMORY_S, BARO_STEP_S);
        Self {
            noise,
            jitter,
            drift_m: 0.0,
            felt_m: height_m,
            altitude_m: height_m,
            climb_mps: 0.0,
            zero_m: height_m,
        }
    }

    /// Every [`BARO_STEP_S`]: true height above the floor and mean motor speed.
    pub(crate) fn step(&mut self, height_m: f64, motor_speed: f64) {
        self.drift_m += self.noise.gauss(DRIFT_M * libm::sqrt(BARO_STEP_S));
        let near = (1.0 - height_m / FLOOR_PRESSURE_ENDS_M).clamp(0.0, 1.0);
        let pressed_m = FLOOR_PRESSURE_M * near * (motor_speed / 0.57) * (motor_speed / 0.57);
        let felt_m = height_m + self.jitter.step(&mut self.noise) + self.drift_m - pressed_m;
        self.felt_m = felt_m;
        let slope_mps = (felt_m - self.altitude_m) / (LAG_S + BARO_STEP_S);
        self.altitude_m += slope_mps * BARO_STEP_S;
        self.climb_mps +=
            (slope_mps - self.climb_mps) * (BARO_STEP_S / (CLIMB_LAG_S + BARO_STEP_S));
    }

    /// Here is zero: the controller does so when it arms.
    pub(crate) const fn zero(&mut self) {
        self.zero_m = self.altitude_m;
    }

    pub(crate) fn altitude_m(&self) -> f64 {
        self.altitude_m - self.zero_m
    }

    /// Altitude behind the newest pressure, before the controller's own filter: what the sensor feels.
    pub(crate) const fn felt_m(&self) -> f64 {
        self.felt_m
    }

    pub(crate) const fn climb_mps(&self) -> f64 {
        self.climb_mps
    }
}
