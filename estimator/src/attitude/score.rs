//! Errors of an attitude against a reference, as the BROAD benchmark counts them.
//!
//! `e = q_est * conj(q_ref)`: total `2 acos |w|`, heading `2 atan |z / w|`, inclination `2 acos sqrt(w2 + z2)`.
//! Daniel Laidig, Marco Caruso, Andrea Cereatti, Thomas Seel, "BROAD - a benchmark for robust inertial orientation
//! estimation" (2021).

use nalgebra::UnitQuaternion;

/// Errors of one attitude, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeError {
    /// Angle of the whole rotation between the two.
    pub total_rad: f64,
    /// Part of it about up.
    pub heading_rad: f64,
    /// The rest: how far up is from up.
    pub inclination_rad: f64,
}

impl AttitudeError {
    /// Errors of an estimate; both rotations from the sensor to the earth frame.
    #[must_use]
    pub fn between(estimate: &UnitQuaternion<f64>, reference: &UnitQuaternion<f64>) -> Self {
        let e = (estimate * reference.inverse()).into_inner();
        let acos = |c: f64| libm::acos(c.clamp(-1.0, 1.0));
        Self {
            total_rad: 2.0 * acos(e.w.abs()),
            heading_rad: 2.0 * libm::atan2(e.k.abs(), e.w.abs()),
            inclination_rad: 2.0 * acos(libm::hypot(e.w, e.k)),
        }
    }
}

/// Root mean squares of many errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AttitudeScore {
    squares: [f64; 3],
    rows: u32,
}

impl AttitudeScore {
    /// Counts an error.
    pub fn add(&mut self, error: &AttitudeError) {
        let parts = [error.total_rad, error.heading_rad, error.inclination_rad];
        for (sum, e) in self.squares.iter_mut().zip(parts) {
            *sum += e * e;
        }
        self.rows += 1;
    }

    /// Number of errors counted.
    #[must_use]
    pub const fn rows(&self) -> u32 {
        self.rows
    }

    /// Root mean squares; none before the first error.
    #[must_use]
    pub fn rms(&self) -> Option<AttitudeError> {
        if self.rows == 0 {
            return None;
        }
        let [total_rad, heading_rad, inclination_rad] =
            self.squares.map(|s| (s / f64::from(self.rows)).sqrt());
        Some(AttitudeError {
            total_rad,
            heading_rad,
            inclination_rad,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn turning_about_up_is_heading_and_leaning_is_inclination() {
        let reference = UnitQuaternion::from_euler_angles(0.3, -0.2, 1.0);
        let turn = |axis| UnitQuaternion::from_axis_angle(&axis, 0.1) * reference;
        let e = AttitudeError::between(&turn(Vector3::z_axis()), &reference);
        assert!((e.heading_rad - 0.1).abs() < 1e-9 && e.inclination_rad < 1e-7);
        let e = AttitudeError::between(&turn(Vector3::x_axis()), &reference);
        assert!((e.inclination_rad - 0.1).abs() < 1e-9 && e.heading_rad < 1e-9);
        assert!((e.total_rad - 0.1).abs() < 1e-9);
    }

    #[test]
    fn a_score_is_the_root_of_the_mean_square() {
        let mut score = AttitudeScore::default();
        assert_eq!(score.rms(), None);
        for total_rad in [3.0, 4.0] {
            score.add(&AttitudeError {
                total_rad,
                heading_rad: 0.0,
                inclination_rad: 1.0,
            });
        }
        let rms = score.rms().unwrap();
        assert!((rms.total_rad - 12.5f64.sqrt()).abs() < 1e-12);
        assert!((rms.inclination_rad - 1.0).abs() < 1e-12);
    }
}
