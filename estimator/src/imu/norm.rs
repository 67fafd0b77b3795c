//! Is this gravity alone, is this the Earth's field alone: the flags of the dynamic covariance.
//!
//! The field is compared with its mean at calibration: the recorded indoor run measures 0.775 of the outdoor calibration all the time,
//! an absolute band would flag all of it.

use super::GRAVITY_MPS2;
use nalgebra::Vector3;

/// Allowed deviation of a norm from its reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormBands {
    /// Share of g, around g.
    pub accel: f64,
    /// Share of the reference, around the reference.
    pub mag: f64,
}

impl Default for NormBands {
    fn default() -> Self {
        Self {
            accel: 0.15,
            mag: 0.15,
        }
    }
}

impl NormBands {
    /// True if the specific force is gravity within the band.
    #[must_use]
    pub fn accel_is_gravity(&self, accel_mps2: Vector3<f64>) -> bool {
        is_within(accel_mps2.norm(), GRAVITY_MPS2, self.accel)
    }

    /// True if the field is as strong as at calibration within the band.
    #[must_use]
    pub fn mag_is_earth(&self, mag: Vector3<f64>, reference: f64) -> bool {
        is_within(mag.norm(), reference, self.mag)
    }
}

/// NaN is never within.
fn is_within(norm: f64, reference: f64, share: f64) -> bool {
    (norm - reference).abs() <= share * reference
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    #[test]
    fn thirty_percent_more_is_neither_gravity_nor_the_field() {
        let bands = NormBands::default();
        let accel = Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        let mag = Vector3::new(0.0, 0.66, 0.4);
        assert!(bands.accel_is_gravity(accel) && !bands.accel_is_gravity(accel * 1.3));
        assert!(bands.mag_is_earth(mag, 0.775) && !bands.mag_is_earth(mag * 1.3, 0.775));
        assert!(!bands.accel_is_gravity(accel * f64::NAN));
    }
}
