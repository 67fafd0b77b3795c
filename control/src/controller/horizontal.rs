//! Level flight: from a set point to the tilt that flies it.

use super::trusted::{Trusted, finite_or_zero};
use super::{Controller, Hold};
use crate::params::Variant;
use crate::position::{accel_of_tilt, tilt_of_accel, xy};
use crate::reference::PlaceReference;
use nalgebra::Vector2;
use vehicle::{NavState, Setpoint};

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Horizontal {
    pub(super) roll: f64,
    pub(super) pitch: f64,
    pub(super) accel: Vector2<f64>,
    pub(super) velocity_sp: Vector2<f64>,
    pub(super) hold: Hold,
}

impl Controller {
    pub(super) fn horizontal(
        &mut self,
        dt_s: f64,
        nav: &NavState,
        trusted: &Trusted,
        setpoint: &Setpoint,
    ) -> Horizontal {
        if let Setpoint::Attitude {
            roll_rad,
            pitch_rad,
            ..
        } = *setpoint
        {
            self.horizontal_ran = false;
            let limit = self.params.angle_limit_deg.to_radians().min(0.6);
            return Horizontal {
                roll: finite_or_zero(roll_rad).clamp(-limit, limit),
                pitch: finite_or_zero(pitch_rad).clamp(-limit, limit),
                hold: Hold::Height,
                ..Horizontal::default()
            };
        }
        // The place to fly to, or the velocity.
        let (place, wanted) = match *setpoint {
            Setpoint::Hover { position, .. } | Setpoint::Land { position, .. } => {
                let is_known =
                    trusted.position && position.x().is_finite() && position.y().is_finite();
                (is_known.then_some(position), Vector2::zeros())
            }
            Setpoint::Velocity { velocity, .. } if velocity.is_finite() => (None, xy(velocity)),
            _ => (None, Vector2::zeros()),
        };
        let hold = if place.is_some() {
            Hold::Position
        } else {
            Hold::Velocity
        };
        if !trusted.velocity {
            // Nothing tells where we drift: level is the best there is.
            self.horizontal_ran = false;
            return Horizontal {
                hold: Hold::Height,
                ..Horizontal::default()
            };
        }
        if !self.horizontal_ran {
            self.position.reset(nav);
            self.start_outer_level();
            self.horizontal_ran = true;
        }
        let p = &self.params;
        let accel = match place {
            None => {
                let accel = self.position.step(p, dt_s, nav, wanted);
                self.start_outer_level();
                accel
            }
            Some(target) => {
                let curve = self.position.curve_to(p, dt_s, nav, target);
                let accel = self.position.step_along(p, dt_s, nav, &curve);
                if self.params.variant == Variant::Lqr {
                    self.outer_accel(dt_s, nav, &curve).unwrap_or(accel)
                } else {
                    accel
                }
            }
        };
        let tilt_max = self.params.tilt_max_deg.to_radians();
        let (roll, pitch) = tilt_of_accel(accel, nav.yaw_rad(), tilt_max);
        Horizontal {
            roll,
            pitch,
            accel,
            velocity_sp: self.position.velocity_sp(),
            hold,
        }
    }

    /// The LQR corrects what is flown: nothing of its own is on its way.
    pub(super) fn start_outer_level(&mut self) {
        if let Some(outer) = &mut self.outer {
            outer.level.iter_mut().for_each(|axis| axis.reset(0.0));
        }
    }

    /// Acceleration by LQR that keeps to a curve, NED, m/s2; none without gains.
    fn outer_accel(
        &mut self,
        dt_s: f64,
        nav: &NavState,
        curve: &PlaceReference,
    ) -> Option<Vector2<f64>> {
        let outer = self.outer.as_mut()?;
        let (roll, pitch, yaw) = nav.attitude.roll_pitch_yaw();
        let felt = accel_of_tilt(roll, pitch, yaw) - curve.followed_accel();
        let error = xy(nav.position) - curve.place();
        // Far away the limited error is its share of the direction, not of each axis.
        let error = error.cap_magnitude(crate::outer_lqr::REACH_M);
        let velocity = xy(nav.velocity) - curve.followed_velocity();
        let most = self.params.acc_hor;
        let [north, east] = &mut outer.level;
        let correction = Vector2::new(
            north.step(dt_s, Some(error.x), velocity.x, felt.x, most),
            east.step(dt_s, Some(error.y), velocity.y, felt.y, most),
        );
        Some(curve.accel() + correction)
    }
}
