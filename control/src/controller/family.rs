//! SNSI's family in the place of the cascade's sticks: `control.variant = "snsi"`.

use super::Controller;
use super::horizontal::Horizontal;
use super::trusted::Trusted;
use crate::params::Variant;
use crate::snsi::law::Seen;
use vehicle::{Heading, NavState, Setpoint, Sticks};

impl Controller {
    /// SNSI's family where it flies: set points with a height, sonar and attitude speaking.
    pub(super) fn snsi_sticks(
        &mut self,
        nav: &NavState,
        trusted: &Trusted,
        setpoint: &Setpoint,
        horizontal: &Horizontal,
        throttle: f64,
    ) -> Option<Sticks> {
        let (height, heading) = match *setpoint {
            Setpoint::Hover { position, heading } => (Some(-position.z()), heading),
            Setpoint::Velocity {
                down_m, heading, ..
            } => (down_m.map(|d| -d), heading),
            _ => (None, Heading::Rate(0.0)),
        };
        let is_flown = self.params.variant == Variant::Snsi && trusted.attitude;
        let (true, Some(height_m)) = (is_flown, height.filter(|h| h.is_finite())) else {
            self.snsi_ran = false;
            return None;
        };
        if !self.snsi_ran {
            self.snsi.take_over(1000.0 + 1000.0 * throttle);
            self.snsi_ran = true;
        }
        let turn_deg = match heading {
            Heading::Yaw(yaw) if yaw.is_finite() => {
                Some(vehicle::angle::shortest_turn(nav.yaw_rad(), yaw).to_degrees())
            }
            // A rate: what turns so much in half a second.
            Heading::Rate(rate) if rate.is_finite() => Some((0.5 * rate).to_degrees()),
            _ => None,
        };
        let (_, pitch, _) = nav.attitude.roll_pitch_yaw();
        let most = crate::snsi::pid::MAX_INCLINATION_DEG.to_radians();
        let wanted = (-horizontal.pitch).clamp(-most, most);
        let us = self.snsi.cycle(&Seen {
            height_cm: trusted.height.then_some(-100.0 * nav.position.z()),
            target_cm: 100.0 * height_m,
            inclination_deg: Some(-pitch.to_degrees()),
            target_inclination_deg: wanted.to_degrees(),
            turn_deg,
            elevator_us: -500.0 * self.curve.stick_of_angle(-wanted),
            roll_us: 1500.0 + 500.0 * self.curve.stick_of_angle(horizontal.roll),
        });
        let [throttle_us, roll_us, elevator_us, rudder_us, _] = us;
        // A silent sonar leaves the cascade's blind descent.
        let throttle = if trusted.height {
            (throttle_us - 1000.0) / 1000.0
        } else {
            throttle
        };
        Some(Sticks {
            roll: (roll_us - 1500.0) / 500.0,
            // The elevator's plus is nose down.
            pitch: -(elevator_us - 1500.0) / 500.0,
            yaw: (rudder_us - 1500.0) / 500.0,
            throttle,
        })
    }
}
