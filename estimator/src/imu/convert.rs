//! Counts to SI.

use super::Build;
use super::angles::Angles;
use super::barometer::{SEA_LEVEL_PA, altitude_m};
use super::calibration::Calibration;
use super::frame::Counts;
use nalgebra::Vector3;

/// One frame, or several smoothed, in SI. Body axes x forward, y left, z up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Specific force, m/s2.
    pub accel_mps2: Vector3<f64>,
    /// Angular rate, rad/s.
    pub gyro_radps: Vector3<f64>,
    /// Field, normalised by the calibration.
    pub mag: Vector3<f64>,
    /// Attitude from gravity and field.
    pub angles: Angles,
    /// Temperature, degC.
    pub temperature_degc: f64,
    /// Height above the reference pressure, m.
    pub altitude_m: f64,
}

/// Converts with one calibration.
#[derive(Clone, Debug)]
pub struct Converter {
    /// What the file says.
    pub calibration: Calibration,
    /// Rate measured at rest, rad/s: subtracted (not in the build of March 2012).
    pub gyro_null_radps: Vector3<f64>,
    /// Pressure of height zero, Pa.
    pub reference_pa: f64,
    /// Added to the magnetic heading, rad, counter-clockwise.
    pub declination_rad: f64,
    /// Whose arithmetic.
    pub build: Build,
}

impl Converter {
    /// Without gyro null, height zero at sea level.
    #[must_use]
    pub const fn new(calibration: Calibration, declination_rad: f64, build: Build) -> Self {
        Self {
            calibration,
            gyro_null_radps: Vector3::new(0.0, 0.0, 0.0),
            reference_pa: SEA_LEVEL_PA,
            declination_rad,
            build,
        }
    }

    /// Converts all channels.
    #[must_use]
    pub fn convert(&self, counts: &Counts) -> Measured {
        let c = &self.calibration;
        let temperature_degc = counts.temperature_ddeg / 10.0;
        let accel_mps2 = c.accel.apply(counts.accel) - c.accel_drift(temperature_degc);
        let mag = c.mag.apply(counts.mag);
        Measured {
            accel_mps2,
            gyro_radps: self.rate(counts),
            mag,
            angles: Angles::from_fields(accel_mps2, mag, self.declination_rad, self.build),
            temperature_degc,
            altitude_m: altitude_m(counts.pressure_pa, self.reference_pa),
        }
    }

    fn rate(&self, counts: &Counts) -> Vector3<f64> {
        let c = &self.calibration;
        let rate = c.gyro.apply(counts.gyro) - c.gyro_drift(counts.temperature_ddeg / 10.0);
        match self.build {
            Build::Final => rate - self.gyro_null_radps,
            Build::March2012 => rate.map(f64::to_radians),
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use crate::imu::calibration::tests::SQUARE;

    fn counts(temperature_ddeg: f64) -> Counts {
        Counts {
            accel: Vector3::new(3.0, -5.0, 245.0),
            gyro: Vector3::new(11.0, -8.0, 23.0),
            mag: Vector3::new(100.0, 20.0, -150.0),
            temperature_ddeg,
            pressure_pa: 101_000.0,
        }
    }

    #[test]
    fn from_25_to_40_degrees_the_acceleration_moves_by_the_z_term_alone() {
        let calibration = Calibration::parse(SQUARE).unwrap();
        let converter = Converter::new(calibration, 0.0, Build::Final);
        let cold = converter.convert(&counts(250.0));
        let warm = converter.convert(&counts(400.0));
        let moved = warm.accel_mps2 - cold.accel_mps2;
        let expected = calibration.accel.tk_inv * Vector3::new(0.0, 0.0, 0.6 * 15.0);
        assert!((moved - expected).norm() < 1e-12, "{moved}");
        let turned = warm.gyro_radps - cold.gyro_radps;
        let expected = -(calibration.gyro.tk_inv * Vector3::new(-0.4, 2.8, -1.9)) * 15.0;
        assert!((turned - expected).norm() < 1e-12);
    }

    #[test]
    fn the_gyro_null_is_subtracted() {
        let mut converter = Converter::new(Calibration::parse(SQUARE).unwrap(), 0.0, Build::Final);
        let before = converter.convert(&counts(250.0)).gyro_radps;
        converter.gyro_null_radps = before;
        assert_eq!(
            converter.convert(&counts(250.0)).gyro_radps,
            Vector3::zeros()
        );
    }
}
