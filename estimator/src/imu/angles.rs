//! Euler angles from gravity and the Earth's field, in uQuad's names (see the [module page](super)).

use super::{Build, GRAVITY_MPS2};
use core::f64::consts::FRAC_PI_2;
use nalgebra::Vector3;
use vehicle::angle::wrap_pi;

/// Above this share of the norm along x the board stands on its nose or tail, and psi means nothing.
const GIMBAL_SHARE: f64 = 9.72 / 9.81;

/// Declination in Uruguay in the program, rad: 9.78 degrees.
pub const URUGUAY_DECLINATION_RAD: f64 = 0.17069;

/// Attitude as uQuad writes it, rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Angles {
    /// About x, positive right side down: roll.
    pub psi_rad: f64,
    /// About y, positive nose down: minus pitch.
    pub phi_rad: f64,
    /// About z, positive counter-clockwise: minus yaw. In (-pi, pi].
    pub theta_rad: f64,
}

impl Angles {
    /// From specific force (m/s2) and field (any unit), body axes x forward, y left, z up.
    #[must_use]
    pub fn from_fields(
        accel: Vector3<f64>,
        mag: Vector3<f64>,
        declination_rad: f64,
        build: Build,
    ) -> Self {
        let (psi_rad, phi_rad) = tilt(accel, build);
        let [north, east] = level(mag, psi_rad, phi_rad);
        let theta_rad = match build {
            Build::Final => wrap_pi(declination_rad - libm::atan2(east, north)),
            Build::March2012 => libm::atan2(north, east) + declination_rad,
        };
        Self {
            psi_rad,
            phi_rad,
            theta_rad,
        }
    }

    /// Roll, pitch and yaw of aviation (NED, FRD), rad.
    #[must_use]
    pub fn roll_pitch_yaw(&self) -> [f64; 3] {
        [self.psi_rad, -self.phi_rad, wrap_pi(-self.theta_rad)]
    }
}

/// psi and phi that explain a specific force.
fn tilt(accel: Vector3<f64>, build: Build) -> (f64, f64) {
    let norm = match build {
        Build::Final => accel.norm(),
        Build::March2012 => GRAVITY_MPS2,
    };
    let share = if norm > 0.0 { accel.x / norm } else { 0.0 };
    if share.abs() >= GIMBAL_SHARE {
        return (0.0, -share.signum() * FRAC_PI_2);
    }
    (libm::atan2(accel.y, accel.z), -libm::asin(share))
}

/// The horizontal part of a field: turned by psi about x, then by phi about y.
///
/// The thesis prints the last element of its matrix as sin phi cos psi; it is cos phi cos psi, and not needed for the heading.
fn level(mag: Vector3<f64>, psi: f64, phi: f64) -> [f64; 2] {
    let (sin_psi, cos_psi) = (libm::sin(psi), libm::cos(psi));
    let (sin_phi, cos_phi) = (libm::sin(phi), libm::cos(phi));
    [
        cos_phi * mag.x + sin_phi * sin_psi * mag.y + cos_psi * sin_phi * mag.z,
        cos_psi * mag.y - sin_psi * mag.z,
    ]
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    const G: f64 = GRAVITY_MPS2;

    fn of(accel: [f64; 3], mag: [f64; 3]) -> Angles {
        Angles::from_fields(accel.into(), mag.into(), 0.0, Build::Final)
    }

    #[test]
    fn signs_are_those_of_forward_left_up() {
        let north = [0.5, 0.0, -0.8];
        assert_eq!(of([0.0, 0.0, G], north), Angles::default());
        // Nose down: the forward axis points below the horizon and feels less than nothing.
        assert!(of([-1.0, 0.0, G], north).phi_rad > 0.0);
        // Right side down: the left axis points above the horizon.
        assert!(of([0.0, 1.0, G], north).psi_rad > 0.0);
        // Turned counter-clockwise by 90 degrees: north is on the right, which is -y.
        let left = of([0.0, 0.0, G], [0.0, -0.5, -0.8]);
        assert!((left.theta_rad - FRAC_PI_2).abs() < 1e-12);
        let [roll, pitch, yaw] = of([-1.0, 1.0, G], [0.0, -0.5, -0.8]).roll_pitch_yaw();
        assert!(roll > 0.0 && pitch < 0.0 && yaw < 0.0);
    }

    #[test]
    fn tilt_does_not_turn_the_heading() {
        // The field (0.5, 0, -0.8) seen by a board with phi = 0.3 about y: x' = cos x - sin z, z' = sin x + cos z.
        let (s, c) = (libm::sin(0.3), libm::cos(0.3));
        let accel = [-s * G, 0.0, c * G];
        let mag = [c * 0.5 - s * -0.8, 0.0, s * 0.5 + c * -0.8];
        let a = of(accel, mag);
        assert!((a.phi_rad - 0.3).abs() < 1e-12 && a.theta_rad.abs() < 1e-12);
    }

    #[test]
    fn ax_of_0_995_g_is_the_gimbal_branch() {
        let rest = (1.0_f64 - 0.995 * 0.995).sqrt() * G;
        let a = of([0.995 * G, rest * 0.6, rest * 0.8], [0.5, 0.1, -0.8]);
        assert_eq!((a.phi_rad, a.psi_rad), (-FRAC_PI_2, 0.0));
        let a = of([-0.995 * G, rest, 0.0], [0.5, 0.1, -0.8]);
        assert_eq!((a.phi_rad, a.psi_rad), (FRAC_PI_2, 0.0));
        let rest = (1.0_f64 - 0.98 * 0.98).sqrt() * G;
        let a = of([0.98 * G, rest * 0.6, rest * 0.8], [0.5, 0.1, -0.8]);
        assert!((a.phi_rad + libm::asin(0.98)).abs() < 1e-12 && a.psi_rad > 0.6);
    }

    #[test]
    fn declination_turns_the_heading_and_stays_in_one_turn() {
        let mag = Vector3::new(-0.5, -0.01, 0.0);
        let accel = Vector3::new(0.0, 0.0, G);
        let plain = Angles::from_fields(accel, mag, 0.0, Build::Final).theta_rad;
        let turned = Angles::from_fields(accel, mag, 0.17069, Build::Final).theta_rad;
        assert!(plain > 3.1 && turned < -2.9, "wrapped: {plain} {turned}");
        assert!((wrap_pi(turned - plain) - 0.17069).abs() < 1e-12);
    }

    #[test]
    fn weightless_is_level_and_not_nan() {
        let a = of([0.0; 3], [0.0; 3]);
        assert_eq!(a, Angles::default());
    }
}
