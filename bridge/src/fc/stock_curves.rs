//! What sticks mean to each firmware as it is delivered: used while `FC_STICK_CURVE` is `auto`.
//!
//! | | Angle at full stick | Expo | Yaw | Motors |
//! | --- | --- | --- | --- | --- |
//! | Betaflight | the parameters as they are: 60 degrees, ACTUAL rates 70 / 670 | | | idle 5.5 % |
//! | INAV | 30 degrees | 0.64 (2.3 degrees measured at 1600 us) | 200 deg/s, expo 0.26 (30 deg/s measured) | idle 8 % |
//! | Cleanflight 1.x, MultiWii 2.x | 90, cut off at 50 degrees | 0.65 | 114 deg/s | idle 15 % (`min_throttle` 1150) |

use control::{ControlParams, CurveKind};
use msp::firmware::Firmware;

/// Replaces the stick curves in `p` by those of the firmware, if they were left to it.
pub fn apply(firmware: Firmware, p: &mut ControlParams) {
    if p.curve != CurveKind::Auto {
        return;
    }
    match firmware {
        Firmware::Betaflight | Firmware::Other(_) => p.curve = CurveKind::BetaflightActual,
        Firmware::Inav => {
            p.curve = CurveKind::Expo;
            (p.angle_limit_deg, p.angle_gain_deg, p.tilt_expo) = (30.0, 30.0, 0.64);
            (p.yaw_max_dps, p.yaw_expo) = (200.0, 0.26);
            p.motor_idle = 0.08;
        }
        Firmware::Cleanflight | Firmware::MultiWii => {
            p.curve = CurveKind::Expo;
            (p.angle_limit_deg, p.angle_gain_deg, p.tilt_expo) = (50.0, 90.0, 0.65);
            (p.yaw_max_dps, p.yaw_expo) = (114.0, 0.0);
            p.motor_idle = 0.15;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use control::stick_curve::StickCurve;

    #[test]
    fn a_curve_that_the_owner_chose_is_left_alone() {
        let mut p = ControlParams {
            curve: CurveKind::Linear,
            ..ControlParams::default()
        };
        let chosen = p.clone();
        apply(Firmware::Inav, &mut p);
        assert_eq!(p, chosen);
    }

    #[test]
    fn stick_1600_is_what_was_measured_on_each_firmware() {
        for (firmware, tilt_deg, yaw_dps) in [
            (Firmware::Betaflight, 3.4, 38.0),
            (Firmware::Inav, 2.3, 30.0),
            (Firmware::Cleanflight, 6.8, 22.8),
        ] {
            let mut p = ControlParams::default();
            apply(firmware, &mut p);
            let c = StickCurve::new(&p);
            let (tilt, yaw) = (c.angle_of_stick(0.2), c.yaw_rate_of_stick(0.2));
            assert!((tilt.to_degrees() - tilt_deg).abs() < 0.05, "{firmware}");
            assert!((yaw.to_degrees() - yaw_dps).abs() < 0.5, "{firmware}");
        }
    }
}
