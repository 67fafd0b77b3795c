//! Stick modes: Position (velocity), Altitude (tilt, height held), Stabilized (tilt, thrust direct). Avoidance brakes in all of
//! them: a velocity that leads into something is bent along it, a tilt that would is bent likewise.

use super::{Air, Cockpit, Wish};
use crate::autopilot::door::ManualInput;
use crate::autopilot::mode::{Because, Mode};
use vehicle::setpoint::Lift;
use vehicle::{Heading, In, Ned, Setpoint};

/// Deflection that counts as centred.
const DEAD_ZONE: f64 = 0.05;
/// Full stick in Position, m/s: stops within half a metre.
const MAX_SPEED_MPS: f64 = 0.8;
/// Full throttle stick, m/s.
const MAX_CLIMB_MPS: f64 = 0.6;
/// Full yaw stick, rad/s.
const MAX_YAW_RATE_RADPS: f64 = 1.2;
/// Full stick in Altitude and Stabilized, rad.
const MAX_TILT_RAD: f64 = 0.26;
/// Steepest tilt to brake before an obstacle, rad.
const MAX_BRAKE_RAD: f64 = 0.35;
const GRAVITY_MPS2: f64 = 9.806_65;
/// Throttle stick above which a vehicle on the floor takes off, below which one near the floor lands.
const TAKE_OFF_ABOVE: f64 = 0.6;
const LAND_BELOW: f64 = 0.1;
/// Height above the floor at which a low throttle stick lands, m.
const LAND_HEIGHT_M: f64 = 0.25;

/// The three stick modes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SticksMode {
    hold_at: Option<In<Ned>>,
    hold_down_m: Option<f64>,
    yaw_rad: Option<f64>,
}

impl SticksMode {
    /// The estimate jumped.
    pub const fn relocalized(&mut self) {
        self.hold_at = None;
        self.yaw_rad = None;
    }

    /// One tick with the sticks as they are (none = centred).
    pub fn step(&mut self, c: &mut Cockpit<'_>, mode: Mode, input: &ManualInput) -> Wish {
        let centred = |v: Option<f64>| v.map_or(0.0, with_dead_zone);
        let (forward, right, yaw) = (
            centred(input.forward),
            centred(input.right),
            centred(input.yaw),
        );
        let throttle = input.throttle.unwrap_or(0.5).clamp(0.0, 1.0);

        if c.air == Air::Ground && throttle < TAKE_OFF_ABOVE {
            return Wish::Rest;
        }
        let heading = self.heading(c, yaw);
        if mode == Mode::Stabilized {
            let lift = Lift::Thrust(throttle);
            let setpoint = tilted(c, forward, right, heading, lift);
            return airborne(c, setpoint);
        }
        if c.air == Air::Flying && throttle < LAND_BELOW && c.nav.height_m < LAND_HEIGHT_M {
            return Wish::Switch(Mode::Land, Because::Asked);
        }
        let climb = with_dead_zone(2.0 * throttle - 1.0) * MAX_CLIMB_MPS;
        let down_m = self.height(c, climb);
        if mode == Mode::Altitude || !c.nav.health.position {
            let lift = down_m.map_or(Lift::Climb(-climb), Lift::Height);
            let setpoint = tilted(c, forward, right, heading, lift);
            return airborne(c, setpoint);
        }
        let setpoint = self.position(c, forward, right, climb, down_m, heading);
        airborne(c, setpoint)
    }

    fn position(
        &mut self,
        c: &mut Cockpit<'_>,
        forward: f64,
        right: f64,
        climb_mps: f64,
        down_m: Option<f64>,
        heading: Heading,
    ) -> Setpoint {
        let is_centred = forward == 0.0 && right == 0.0;
        let is_slow = c.nav.velocity.norm_xy() < 0.25;
        if is_centred && (is_slow || self.hold_at.is_some()) {
            if self.hold_at.is_none() {
                let here = c.stopping_point();
                self.hold_at = Some(here);
                c.navigator.hold(here, None, c.nav);
            }
            if let Setpoint::Velocity { velocity, .. } = c.navigator.step(c.now, c.nav).setpoint {
                // Something comes near: give way.
                return Setpoint::Velocity {
                    velocity: velocity.with_z(-climb_mps),
                    down_m,
                    heading,
                };
            }
            if let (Some(at), Some(down_m)) = (self.hold_at, down_m) {
                return Setpoint::Hover {
                    position: at.with_z(down_m),
                    heading,
                };
            }
        } else {
            self.hold_at = None;
        }
        let yaw = c.nav.yaw_rad();
        let (s, k) = (libm::sin(yaw), libm::cos(yaw));
        let asked = In::new(forward * k - right * s, forward * s + right * k, 0.0) * MAX_SPEED_MPS;
        let allowed = c
            .navigator
            .protect(c.now, c.nav, asked.limited_xy(MAX_SPEED_MPS));
        Setpoint::Velocity {
            velocity: allowed.with_z(-climb_mps),
            down_m,
            heading,
        }
    }

    /// Height to hold while the throttle stick is centred.
    fn height(&mut self, c: &Cockpit<'_>, climb_mps: f64) -> Option<f64> {
        let at_limit = (climb_mps > 0.0 && c.nav.position.z() < -c.params.ceiling_m)
            || (climb_mps < 0.0 && c.nav.height_m < super::MIN_HEIGHT_M / 2.0);
        if climb_mps != 0.0 && !at_limit {
            self.hold_down_m = None;
            return None;
        }
        Some(*self.hold_down_m.get_or_insert_with(|| {
            let stop = c.nav.velocity.z() * 0.3;
            (c.nav.position.z() + stop).max(-c.params.ceiling_m)
        }))
    }

    fn heading(&mut self, c: &Cockpit<'_>, yaw_stick: f64) -> Heading {
        if yaw_stick != 0.0 {
            self.yaw_rad = None;
            return Heading::Rate(yaw_stick * MAX_YAW_RATE_RADPS);
        }
        Heading::Yaw(
            *self
                .yaw_rad
                .get_or_insert_with(|| c.nav.yaw_rad() + 0.2 * c.nav.rates_radps.z()),
        )
    }
}

fn airborne(c: &Cockpit<'_>, setpoint: Setpoint) -> Wish {
    if c.air == Air::Flying {
        Wish::Fly(setpoint)
    } else {
        Wish::LiftOff(setpoint)
    }
}

/// Forward stick leans the nose down; what would lead into an obstacle is taken away.
fn tilted(c: &mut Cockpit<'_>, forward: f64, right: f64, heading: Heading, lift: Lift) -> Setpoint {
    let (roll_rad, pitch_rad) = (right * MAX_TILT_RAD, -forward * MAX_TILT_RAD);
    let (roll_rad, pitch_rad) = if c.air == Air::Flying {
        protected(c, roll_rad, pitch_rad)
    } else {
        (roll_rad, pitch_rad)
    };
    Setpoint::Attitude {
        roll_rad,
        pitch_rad,
        heading,
        lift,
    }
}

/// Tilt as acceleration over ground, through avoidance, and back.
fn protected(c: &mut Cockpit<'_>, roll_rad: f64, pitch_rad: f64) -> (f64, f64) {
    let ahead = -GRAVITY_MPS2 * libm::tan(pitch_rad);
    let right = GRAVITY_MPS2 * libm::tan(roll_rad);
    let (s, k) = libm::sincos(c.nav.yaw_rad());
    let asked = In::new(ahead * k - right * s, ahead * s + right * k, 0.0);
    let most = GRAVITY_MPS2 * libm::tan(MAX_BRAKE_RAD);
    let allowed = c.navigator.protect_acceleration(c.now, c.nav, asked, most);
    if allowed == asked {
        return (roll_rad, pitch_rad);
    }
    let ahead = allowed.x() * k + allowed.y() * s;
    let right = allowed.y() * k - allowed.x() * s;
    (
        libm::atan2(right, GRAVITY_MPS2),
        -libm::atan2(ahead, GRAVITY_MPS2),
    )
}

fn with_dead_zone(v: f64) -> f64 {
    let v = if v.is_finite() {
        v.clamp(-1.0, 1.0)
    } else {
        0.0
    };
    if v.abs() < DEAD_ZONE {
        0.0
    } else {
        libm::copysign((v.abs() - DEAD_ZONE) / (1.0 - DEAD_ZONE), v)
    }
}
