//! Manual mode of the key console, a flag of Hold: each key steps a set point (uQuad 1.2.6).
//!
//! Tilt keys lean the vehicle as the thesis does: a latched tilt accelerates it. Here the lean is a demand for
//! acceleration that avoidance may overrule and that stops growing at a safe speed, with height held.

use super::hold::Target;
use super::{Air, Cockpit};
use crate::autopilot::door::{Key, KeySetpoint, Refusal};
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::angle::wrap_pi;
use vehicle::{Heading, In, Ned, Setpoint};

/// Step of attitude and yaw keys, rad (uQuad manual_mode.h).
pub const ANGLE_STEP_RAD: f64 = 0.045;
/// Step of the height keys, m (uQuad manual_mode.h).
pub const HEIGHT_STEP_M: f64 = 0.2;
/// Step of the mass keys, kg (uQuad manual_mode.h).
pub const MASS_STEP_KG: f64 = 0.05;
/// Step of the nudge keys, m.
pub const NUDGE_STEP_M: f64 = 0.2;
/// Largest tilt set point, rad (seed-facts 1.8).
const MAX_TILT_RAD: f64 = 0.35;
/// Speed at which a latched tilt stops accelerating: indoors, able to stop within half a metre.
const MAX_SPEED_MPS: f64 = 0.5;
/// Allowed masses of the thrust model, kg.
const MASS_KG: core::ops::RangeInclusive<f64> = 0.1..=10.0;

/// Set points of the keys.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KeyMode {
    is_on: bool,
    roll_rad: f64,
    nose_down_rad: f64,
    velocity: Option<In<Ned>>,
    /// Mass of the thrust model, kg; none = the airframe's.
    mass_kg: Option<f64>,
}

impl KeyMode {
    /// Keys count.
    #[must_use]
    pub const fn is_on(&self) -> bool {
        self.is_on
    }

    /// Mass for the thrust model, kg; none = the airframe's.
    #[must_use]
    pub const fn mass_kg(&self) -> Option<f64> {
        self.mass_kg
    }

    /// Ends manual mode; the tilt is gone, the mass stays.
    pub const fn switch_off(&mut self) {
        *self = Self {
            mass_kg: self.mass_kg,
            ..Self::OFF
        };
    }

    const OFF: Self = Self {
        is_on: false,
        roll_rad: 0.0,
        nose_down_rad: 0.0,
        velocity: None,
        mass_kg: None,
    };

    /// Takes a key; changes the hover target where the key says so.
    ///
    /// # Errors
    /// Manual mode is off, or the vehicle is not where it counts.
    pub fn press(
        &mut self,
        c: &mut Cockpit<'_>,
        key: Key,
        target: &mut Target,
    ) -> Result<KeySetpoint, Refusal> {
        if key == Key::ToggleManual {
            if self.is_on {
                self.switch_off();
            } else if c.air == Air::Flying {
                self.is_on = true;
            } else {
                return Err(Refusal::NotFlying);
            }
            return Ok(self.report(c, target));
        }
        if !self.is_on {
            return Err(Refusal::KeyModeOff);
        }
        match key {
            Key::Roll(s) => self.roll_rad = lean(self.roll_rad + s.sign() * ANGLE_STEP_RAD),
            Key::NoseDown(s) => {
                self.nose_down_rad = lean(self.nose_down_rad + s.sign() * ANGLE_STEP_RAD)
            }
            // Counter-clockwise is against our heading.
            Key::YawLeft(s) => target.yaw_rad = wrap_pi(target.yaw_rad - s.sign() * ANGLE_STEP_RAD),
            Key::Height(s) => {
                let down_m = c.clamped_down_m(target.position.z() - s.sign() * HEIGHT_STEP_M);
                target.position = target.position.with_z(down_m);
            }
            Key::Mass(s) => {
                let mass_kg = self.mass_kg.unwrap_or(c.airframe.mass_kg) + s.sign() * MASS_STEP_KG;
                self.mass_kg = Some(mass_kg.clamp(*MASS_KG.start(), *MASS_KG.end()));
            }
            Key::MassDefault => self.mass_kg = None,
            Key::NudgeForward(s) => {
                target.position += along(target.yaw_rad, s.sign() * NUDGE_STEP_M, 0.0)
            }
            Key::NudgeRight(s) => {
                target.position += along(target.yaw_rad, 0.0, s.sign() * NUDGE_STEP_M)
            }
            Key::ToggleManual | Key::Marker | Key::Escape => {}
        }
        Ok(self.report(c, target))
    }

    /// Set points for the reply.
    #[must_use]
    pub fn report(&self, c: &Cockpit<'_>, target: &Target) -> KeySetpoint {
        KeySetpoint {
            is_manual: self.is_on,
            roll_rad: self.roll_rad,
            nose_down_rad: self.nose_down_rad,
            yaw_rad: target.yaw_rad,
            position: target.position,
            mass_kg: self.mass_kg.unwrap_or(c.airframe.mass_kg),
        }
    }

    /// A set point while a tilt is latched (or its speed not yet braked); none = hover at the target. The target follows
    /// the vehicle, so that the hover begins where the tilt ends.
    pub fn fly(&mut self, c: &mut Cockpit<'_>, target: &mut Target) -> Option<Setpoint> {
        let is_level = self.roll_rad.abs() < 1e-9 && self.nose_down_rad.abs() < 1e-9;
        if is_level {
            if self.velocity.take().is_some() {
                target.position = c.stopping_point().with_z(target.position.z());
                c.navigator
                    .hold(target.position, Some(target.yaw_rad), c.nav);
            }
            return None;
        }
        let accel = along(
            target.yaw_rad,
            libm::tan(self.nose_down_rad),
            libm::tan(self.roll_rad),
        ) * GRAVITY_MPS2;
        let asked = self.velocity.unwrap_or_else(In::zero) + accel * c.dt_s;
        let allowed = c
            .navigator
            .protect(c.now, c.nav, asked.limited_xy(MAX_SPEED_MPS));
        self.velocity = Some(allowed);
        target.position = c.nav.position.with_z(target.position.z());
        Some(Setpoint::Velocity {
            velocity: allowed,
            down_m: Some(target.position.z()),
            heading: Heading::Yaw(target.yaw_rad),
        })
    }
}

/// Within the largest tilt; steps that cancel out are exactly level.
fn lean(rad: f64) -> f64 {
    let rad = rad.clamp(-MAX_TILT_RAD, MAX_TILT_RAD);
    if rad.abs() < ANGLE_STEP_RAD / 4.0 {
        0.0
    } else {
        rad
    }
}

/// Forward and right along a heading, level.
fn along(yaw_rad: f64, forward: f64, right: f64) -> In<Ned> {
    let (s, c) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
    In::new(forward * c - right * s, forward * s + right * c, 0.0)
}
