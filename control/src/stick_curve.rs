//! What stick deflection makes the flight controller do what is wanted: the exact inverse of its stick curves.
//!
//! Betaflight with `ACTUAL` rates and expo 0 turns a deflection x into the rate `center x + (max - center) x |x|`; in
//! angle mode the angle is that rate's share of `max`, times the angle limit (Betaflight 4.5, `pidLevel`). A linear
//! firmware turns x into `limit x`; INAV, Cleanflight and MultiWii bend it with expo e, `gain x (1 - e + e x^2)`.

use crate::params::{ControlParams, CurveKind};

/// One axis: deflection to rate, deg/s, at most `max_dps`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Curve {
    /// Betaflight `ACTUAL` with expo 0.
    Actual { center_dps: f64, max_dps: f64 },
    /// Proportional.
    Linear { max_dps: f64 },
    /// Flat in the middle.
    Expo { max_dps: f64, expo: f64 },
}

impl Curve {
    const fn max_dps(self) -> f64 {
        match self {
            Self::Actual { max_dps, .. }
            | Self::Linear { max_dps }
            | Self::Expo { max_dps, .. } => max_dps,
        }
    }

    /// Rate of a deflection, deg/s.
    fn rate_dps(self, stick: f64) -> f64 {
        let x = stick.clamp(-1.0, 1.0);
        match self {
            Self::Actual {
                center_dps,
                max_dps,
            } => center_dps * x + (max_dps - center_dps) * x * x.abs(),
            Self::Linear { max_dps } => max_dps * x,
            Self::Expo { max_dps, expo } => max_dps * x * (1.0 - expo + expo * x * x),
        }
    }

    /// Deflection of a rate, deg/s; saturates at full stick.
    fn stick(self, rate_dps: f64) -> f64 {
        let r = rate_dps.clamp(-self.max_dps(), self.max_dps());
        match self {
            Self::Actual {
                center_dps,
                max_dps,
            } => {
                // The positive root of (max - center) x^2 + center x - |r| = 0, in the form that stays exact when the
                // quadratic term vanishes.
                let quadratic = max_dps - center_dps;
                let root = libm::sqrt(center_dps * center_dps + 4.0 * quadratic * r.abs());
                libm::copysign(2.0 * r.abs() / (center_dps + root), r)
            }
            Self::Linear { max_dps } => r / max_dps,
            Self::Expo { max_dps, expo } => inverse_expo(r / max_dps, expo),
        }
    }
}

/// The x with `x (1 - e + e x^2) = y`: the only real root of the depressed cubic `x^3 + p x - q = 0`, p > 0.
fn inverse_expo(y: f64, expo: f64) -> f64 {
    let e = expo.clamp(0.0, 0.99);
    if e < 1e-6 {
        return y;
    }
    let (p, q) = ((1.0 - e) / e, y / e);
    let k = libm::sqrt(p / 3.0);
    2.0 * k * libm::sinh(libm::asinh(q / (2.0 * k * k * k)) / 3.0)
}

/// The stick curves of one flight controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StickCurve {
    tilt: Curve,
    yaw: Curve,
    angle_limit_rad: f64,
    /// Angle at the end of the tilt curve; beyond the limit for firmwares that cut off.
    angle_gain_rad: f64,
}

impl StickCurve {
    /// From the parameters.
    #[must_use]
    pub fn new(p: &ControlParams) -> Self {
        let curve = |center_dps: f64, max_dps: f64, expo: f64| match p.curve {
            // The firmware itself never lets the maximum fall below the centre sensitivity.
            CurveKind::BetaflightActual | CurveKind::Auto => Curve::Actual {
                center_dps,
                max_dps: max_dps.max(center_dps),
            },
            CurveKind::Linear => Curve::Linear { max_dps },
            CurveKind::Expo => Curve::Expo { max_dps, expo },
        };
        let gain_deg = match p.curve {
            CurveKind::Expo if p.angle_gain_deg > 0.0 => p.angle_gain_deg,
            _ => p.angle_limit_deg,
        };
        Self {
            tilt: curve(p.rate_center_dps, p.rate_max_dps, p.tilt_expo),
            yaw: curve(p.yaw_center_dps, p.yaw_max_dps, p.yaw_expo),
            angle_limit_rad: p.angle_limit_deg.to_radians(),
            angle_gain_rad: gain_deg.to_radians(),
        }
    }

    /// Roll or pitch deflection for an angle, rad; full stick beyond the firmware's limit.
    #[must_use]
    pub fn stick_of_angle(&self, angle_rad: f64) -> f64 {
        if angle_rad.abs() > self.angle_limit_rad {
            return libm::copysign(1.0, angle_rad);
        }
        self.tilt
            .stick(angle_rad / self.angle_gain_rad * self.tilt.max_dps())
    }

    /// Angle that a roll or pitch deflection asks for, rad.
    #[must_use]
    pub fn angle_of_stick(&self, stick: f64) -> f64 {
        let angle = self.tilt.rate_dps(stick) / self.tilt.max_dps() * self.angle_gain_rad;
        angle.clamp(-self.angle_limit_rad, self.angle_limit_rad)
    }

    /// Yaw deflection for a yaw rate, rad/s.
    #[must_use]
    pub fn stick_of_yaw_rate(&self, rate_radps: f64) -> f64 {
        self.yaw.stick(rate_radps.to_degrees())
    }

    /// Yaw rate that a yaw deflection asks for, rad/s.
    #[must_use]
    pub fn yaw_rate_of_stick(&self, stick: f64) -> f64 {
        self.yaw.rate_dps(stick).to_radians()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;
    use proptest::prelude::*;

    #[test]
    fn half_a_stick_of_betaflight_asks_for_16_57_degrees_and_185_degrees_a_second() {
        // (70 * 0.5 + 600 * 0.25) = 185; 185 / 670 * 60 = 16.567.
        let c = StickCurve::new(&ControlParams::default());
        assert_abs_diff_eq!(
            c.angle_of_stick(0.5).to_degrees(),
            16.567_164,
            epsilon = 1e-5
        );
        assert_abs_diff_eq!(
            c.yaw_rate_of_stick(-0.5).to_degrees(),
            -185.0,
            epsilon = 1e-9
        );
    }

    #[test]
    fn multiwii_cuts_its_curve_off_at_the_limit() {
        let c = StickCurve::new(&ControlParams {
            curve: CurveKind::Expo,
            angle_gain_deg: 90.0,
            angle_limit_deg: 50.0,
            tilt_expo: 0.65,
            ..ControlParams::default()
        });
        // 90 * 0.2 * (0.35 + 0.65 * 0.04) = 6.768.
        assert_abs_diff_eq!(c.angle_of_stick(0.2).to_degrees(), 6.768, epsilon = 1e-9);
        assert_abs_diff_eq!(c.angle_of_stick(1.0).to_degrees(), 50.0, epsilon = 1e-9);
        assert_abs_diff_eq!(
            c.stick_of_angle(6.768_f64.to_radians()),
            0.2,
            epsilon = 1e-9
        );
        assert_abs_diff_eq!(c.stick_of_angle(-1.0), -1.0, epsilon = 1e-12);
    }

    #[test]
    fn beyond_the_limit_is_full_stick() {
        let c = StickCurve::new(&ControlParams::default());
        assert_abs_diff_eq!(c.stick_of_angle(2.0), 1.0, epsilon = 1e-12);
        assert_abs_diff_eq!(c.stick_of_yaw_rate(-100.0), -1.0, epsilon = 1e-12);
    }

    proptest! {
        #[test]
        fn the_inverse_is_exact(
            x in -1.0..1.0f64, center in 10.0..400.0f64, span in 0.0..800.0f64, expo in 0.0..0.95f64, kind in 0..3,
        ) {
            let p = ControlParams {
                curve: [CurveKind::BetaflightActual, CurveKind::Linear, CurveKind::Expo][kind as usize],
                tilt_expo: expo,
                yaw_expo: expo,
                rate_center_dps: center,
                rate_max_dps: center + span,
                yaw_center_dps: center,
                yaw_max_dps: center + span,
                ..ControlParams::default()
            };
            let c = StickCurve::new(&p);
            prop_assert!((c.stick_of_angle(c.angle_of_stick(x)) - x).abs() < 1e-9);
            prop_assert!((c.stick_of_yaw_rate(c.yaw_rate_of_stick(x)) - x).abs() < 1e-9);
        }
    }
}
