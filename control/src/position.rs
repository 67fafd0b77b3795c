//! Horizontal control: position P to velocity, velocity PID to acceleration, acceleration to tilt in the yaw frame.
//!
//! Set points are shaped before they are tracked: the velocity asked for never changes faster than `MPC_ACC_HOR`, the
//! acceleration never faster than `MPC_JERK_MAX`, so that a controller with 60 ms of dead time and 100 ms of attitude
//! response can follow without overshoot. A place is approached along a curve of its own ([`crate::reference`]).

use crate::params::ControlParams;
use crate::reference::{PlaceReference, approach};
use nalgebra::Vector2;
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::{In, NavState, Ned};

/// Largest acceleration the integral may stand for (a slope of 7 degrees: trim errors, draught), m/s2.
const INTEGRAL_MAX_MPS2: f64 = 1.2;
/// Share of the shaped velocity's slope that is fed forward: less than one, because attitude lags.
const FEED_FORWARD: f64 = 0.6;
/// Low-pass of the measured acceleration (D term), time constant, s (5 Hz).
const DERIVATIVE_TAU_S: f64 = 0.032;

/// The horizontal loops.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PositionLoop {
    velocity_sp: Vector2<f64>,
    accel_sp: Vector2<f64>,
    integral: Vector2<f64>,
    accel_lp: Vector2<f64>,
    last_velocity: Option<Vector2<f64>>,
    /// The curve to the place that is flown to; none while a velocity is flown.
    curve: Option<PlaceReference>,
}

impl PositionLoop {
    /// Starts from the present motion: the velocity asked for is the measured one, the acceleration asked for that of the
    /// present tilt, so that the first sticks continue what was flown before.
    pub fn reset(&mut self, nav: &NavState) {
        let (roll, pitch, yaw) = nav.attitude.roll_pitch_yaw();
        let accel = accel_of_tilt(roll, pitch, yaw);
        let finite = |v: Vector2<f64>| {
            if v.iter().all(|c| c.is_finite()) {
                v
            } else {
                Vector2::zeros()
            }
        };
        *self = Self {
            velocity_sp: finite(xy(nav.velocity)),
            accel_sp: finite(accel),
            integral: Vector2::zeros(),
            accel_lp: Vector2::zeros(),
            last_velocity: None,
            curve: None,
        };
    }

    /// The curve towards a place (NED, m) after this step; begun anew where the vehicle is if it flew something else before, or is
    /// elsewhere.
    pub fn curve_to(
        &mut self,
        p: &ControlParams,
        dt_s: f64,
        nav: &NavState,
        target: In<Ned>,
    ) -> PlaceReference {
        let here = xy(nav.position);
        let mut curve = self.curve.filter(|c| c.holds(here)).unwrap_or_else(|| {
            let (roll, pitch, yaw) = nav.attitude.roll_pitch_yaw();
            let accel = limited(accel_of_tilt(roll, pitch, yaw), p.acc_hor);
            let asked = limited(self.accel_sp, p.acc_hor);
            PlaceReference::from_motion(here, xy(nav.velocity), accel, asked)
        });
        curve.step(p, dt_s, xy(target));
        self.curve = Some(curve);
        curve
    }

    /// Acceleration that keeps to the curve of [`Self::curve_to`], NED, m/s2.
    pub fn step_along(
        &mut self,
        p: &ControlParams,
        dt_s: f64,
        nav: &NavState,
        curve: &PlaceReference,
    ) -> Vector2<f64> {
        let off = curve.place() - xy(nav.position);
        let wanted = curve.followed_velocity() + approach(p, p.xy_p, off);
        self.velocity_sp = limited(wanted, p.xy_vel_max);
        self.track(p, dt_s, nav, curve.accel(), curve.followed_accel())
    }

    /// Acceleration that brings the velocity to `wanted`, NED, m/s2.
    pub fn step(
        &mut self,
        p: &ControlParams,
        dt_s: f64,
        nav: &NavState,
        wanted: Vector2<f64>,
    ) -> Vector2<f64> {
        self.curve = None;
        let wanted = limited(wanted, p.xy_vel_max);
        let before = self.velocity_sp;
        self.velocity_sp += limited(wanted - before, p.acc_hor * dt_s);
        let slope = (self.velocity_sp - before) / dt_s;
        self.track(p, dt_s, nav, slope * FEED_FORWARD, slope)
    }

    /// Velocity PID around what is fed forward; `expected` is the acceleration that should be felt now.
    fn track(
        &mut self,
        p: &ControlParams,
        dt_s: f64,
        nav: &NavState,
        forward: Vector2<f64>,
        expected: Vector2<f64>,
    ) -> Vector2<f64> {
        let velocity = xy(nav.velocity);
        if let Some(last) = self.last_velocity {
            let k = dt_s / (dt_s + DERIVATIVE_TAU_S);
            // A corrected state estimate is not an acceleration.
            let measured = limited((velocity - last) / dt_s, 10.0);
            self.accel_lp += (measured - self.accel_lp) * k;
        }
        self.last_velocity = Some(velocity);

        let error = self.velocity_sp - velocity;
        let raw =
            error * p.xy_vel_p + self.integral + forward - (self.accel_lp - expected) * p.xy_vel_d;
        let tilt_max_mps2 = GRAVITY_MPS2 * libm::tan(p.tilt_max_deg.to_radians());
        let demand = limited(raw, tilt_max_mps2.min(1.5 * p.acc_hor));
        // Clamping: while saturated the integral may only move back.
        let push = error * (p.xy_vel_i * dt_s);
        let saturated = (raw - demand).norm_squared() > 1e-12;
        if !saturated || push.dot(&raw) < 0.0 {
            self.integral = limited(self.integral + push, INTEGRAL_MAX_MPS2);
        }
        self.accel_sp += limited(demand - self.accel_sp, p.jerk_max * dt_s);
        self.accel_sp
    }

    /// Velocity asked for after shaping, m/s.
    #[must_use]
    pub const fn velocity_sp(&self) -> Vector2<f64> {
        self.velocity_sp
    }
}

/// (roll, pitch) in radians that accelerate a vehicle of heading `yaw_rad` by `accel` (NED, m/s2) while it carries its
/// weight; tilt at most `tilt_max_rad`.
#[must_use]
pub fn tilt_of_accel(accel: Vector2<f64>, yaw_rad: f64, tilt_max_rad: f64) -> (f64, f64) {
    let (s, c) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
    let a = limited(accel, GRAVITY_MPS2 * libm::tan(tilt_max_rad));
    let forward = a.x * c + a.y * s;
    let right = -a.x * s + a.y * c;
    // Thrust (0, 0, -t) turned by pitch, then roll: forward = -g tan(pitch), right = g tan(roll) / cos(pitch).
    let pitch = -libm::atan2(forward, GRAVITY_MPS2);
    let roll = libm::atan2(right * libm::cos(pitch), GRAVITY_MPS2);
    (roll, pitch)
}

/// The acceleration (NED, m/s2) of a tilt that carries the weight: the way back of [`tilt_of_accel`].
pub(crate) fn accel_of_tilt(roll: f64, pitch: f64, yaw: f64) -> Vector2<f64> {
    let forward = -GRAVITY_MPS2 * libm::tan(pitch.clamp(-1.2, 1.2));
    let right = GRAVITY_MPS2 * libm::tan(roll.clamp(-1.2, 1.2)) / libm::cos(pitch.clamp(-1.2, 1.2));
    let (s, c) = (libm::sin(yaw), libm::cos(yaw));
    Vector2::new(forward * c - right * s, forward * s + right * c)
}

pub(crate) fn xy(v: In<Ned>) -> Vector2<f64> {
    Vector2::new(v.x(), v.y())
}

fn limited(v: Vector2<f64>, max: f64) -> Vector2<f64> {
    let n = v.norm();
    if n > max { v * (max / n) } else { v }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TILT_MAX: f64 = 0.6;

    #[test]
    fn north_is_nose_down_and_east_is_right_side_down_when_the_nose_is_north() {
        let (roll, pitch) = tilt_of_accel(Vector2::new(1.0, 0.0), 0.0, TILT_MAX);
        assert!(pitch < -0.05 && roll.abs() < 1e-12);
        let (roll, pitch) = tilt_of_accel(Vector2::new(0.0, 1.0), 0.0, TILT_MAX);
        assert!(roll > 0.05 && pitch.abs() < 1e-12);
    }

    #[test]
    fn far_away_the_speed_is_the_largest_and_at_the_target_it_is_zero() {
        let p = ControlParams::default();
        let v = |d: f64| approach(&p, p.xy_p, Vector2::new(d, 0.0)).x;
        assert!((v(50.0) - p.xy_vel_max).abs() < 1e-9);
        assert!(v(0.0).abs() < 1e-12);
        assert!((v(0.1) - 0.1 * p.xy_p).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn tilt_and_acceleration_are_inverse(ax in -2.0..2.0f64, ay in -2.0..2.0f64, yaw in -3.1..3.1f64) {
            let a = Vector2::new(ax, ay);
            let (roll, pitch) = tilt_of_accel(a, yaw, TILT_MAX);
            prop_assert!((accel_of_tilt(roll, pitch, yaw) - a).norm() < 1e-9);
            // And the typed rotation agrees: thrust along body up, scaled to carry the weight.
            let up = vehicle::Rot::<vehicle::Frd, Ned>::from_roll_pitch_yaw(roll, pitch, yaw) * In::new(0.0, 0.0, -1.0);
            let k = GRAVITY_MPS2 / -up.z();
            prop_assert!((up.x() * k - ax).abs() < 1e-9 && (up.y() * k - ay).abs() < 1e-9);
        }

        #[test]
        fn tilt_never_exceeds_its_limit(ax in -50.0..50.0f64, ay in -50.0..50.0f64, yaw in -3.1..3.1f64) {
            let (roll, pitch) = tilt_of_accel(Vector2::new(ax, ay), yaw, 0.26);
            let tilt = vehicle::Rot::<vehicle::Frd, Ned>::from_roll_pitch_yaw(roll, pitch, yaw).tilt();
            prop_assert!(tilt <= 0.26 + 1e-9);
        }
    }
}
