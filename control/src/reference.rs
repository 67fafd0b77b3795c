//! The moving set point on the way to a place: where the vehicle should be now, and what a vehicle with its lag makes of it.
//!
//! A place that is asked for at once is approached along a curve of limited speed, acceleration and jerk. Its acceleration is fed
//! forward; feedback sees only what differs from the curve as the vehicle can follow it (dead time of the RC stream and the
//! attitude's response, together a first-order lag). So the loops need not be fast for the step to be: they keep their margins,
//! the curve does the way. At rest on the place this is the plain loop around it.
//!
//! ```text
//! place asked for -> curve (p, v, a) --a--> acceleration fed forward
//!                        | lag T
//!                        v
//!                 where the vehicle should be (p_m, v_m, a_m) -> feedback
//! ```

use crate::params::ControlParams;
use nalgebra::Vector2;

/// Dead time and attitude response together, s: 60 ms and 100 ms of a Betaflight-class controller over MSP.
const LAG_S: f64 = 0.16;
/// The curve's own loops have no lag and can be fast: place to velocity and velocity to acceleration, 1/s.
const PLACE_PER_S: f64 = 2.0;
const VELOCITY_PER_S: f64 = 10.0;
/// Share of `MPC_ACC_HOR` that the curve speeds up with: the rest is for corrections, and less tilt sees more level.
const ACCEL_SHARE: f64 = 0.7;
/// Faster than this it is under way, m/s.
const UNDER_WAY_MPS: f64 = 0.15;
/// Something holds the vehicle farther off its curve than this, m, or it is elsewhere: the curve begins anew where it is.
const LEASH_M: f64 = 0.6;

/// The curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlaceReference {
    place: Vector2<f64>,
    velocity: Vector2<f64>,
    accel: Vector2<f64>,
    /// What a vehicle with the lag flies of it, m/s2.
    followed_accel: Vector2<f64>,
    /// Begun under way it is no faster than it began, m/s: what is left of a leg is flown at the leg's speed. 0 at rest: no limit.
    begun_mps: f64,
}

impl PlaceReference {
    /// Begins with the present motion, m, m/s, m/s2; `asked` is the acceleration that was asked for last and is on its way.
    #[must_use]
    pub fn from_motion(
        place: Vector2<f64>,
        velocity: Vector2<f64>,
        accel: Vector2<f64>,
        asked: Vector2<f64>,
    ) -> Self {
        let ahead = velocity + accel * LAG_S;
        Self {
            place: place + velocity * LAG_S,
            velocity: ahead,
            accel: asked,
            followed_accel: accel,
            begun_mps: if velocity.norm() > UNDER_WAY_MPS {
                velocity.norm()
            } else {
                0.0
            },
        }
    }

    /// Where the vehicle should be now, m.
    #[must_use]
    pub fn place(&self) -> Vector2<f64> {
        self.place - self.followed_velocity() * LAG_S
    }

    /// How fast it should be now, m/s.
    #[must_use]
    pub fn followed_velocity(&self) -> Vector2<f64> {
        self.velocity - self.followed_accel * LAG_S
    }

    /// What it should feel now, m/s2.
    #[must_use]
    pub const fn followed_accel(&self) -> Vector2<f64> {
        self.followed_accel
    }

    /// Acceleration to feed forward, m/s2.
    #[must_use]
    pub const fn accel(&self) -> Vector2<f64> {
        self.accel
    }

    /// True while the vehicle is where the curve can lead it.
    #[must_use]
    pub fn holds(&self, place: Vector2<f64>) -> bool {
        // False for what is no number.
        (self.place() - place).norm() <= LEASH_M
    }

    /// A step towards `target`, m.
    pub fn step(&mut self, p: &ControlParams, dt_s: f64, target: Vector2<f64>) {
        let mut wanted = approach(p, PLACE_PER_S, target - self.place);
        if self.begun_mps > 0.0 {
            wanted = wanted.cap_magnitude(self.begun_mps);
        }
        let accel =
            ((wanted - self.velocity) * VELOCITY_PER_S).cap_magnitude(ACCEL_SHARE * p.acc_hor);
        self.accel += (accel - self.accel).cap_magnitude(p.jerk_max * dt_s);
        self.velocity += self.accel * dt_s;
        self.place += self.velocity * dt_s;
        // The exact answer of the lag to what stands still for a step.
        self.followed_accel +=
            (self.accel - self.followed_accel) * (1.0 - libm::exp(-dt_s / LAG_S));
    }
}

/// Velocity that leads over a way, m/s: `gain` (1/s) times it when near, along a braking curve from afar, at most
/// `MPC_XY_VEL_MAX`.
#[must_use]
pub fn approach(p: &ControlParams, gain: f64, way: Vector2<f64>) -> Vector2<f64> {
    let distance = way.norm();
    // Braking with half of the allowed acceleration leaves the other half for corrections.
    let brake = 0.5 * p.acc_hor;
    let linear_to = brake / (gain * gain);
    let speed = if distance <= linear_to {
        gain * distance
    } else {
        libm::sqrt(2.0 * brake * (distance - 0.5 * linear_to))
    };
    let speed = speed.min(p.xy_vel_max);
    if distance > 1e-9 && speed.is_finite() {
        way * (speed / distance)
    } else {
        Vector2::zeros()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DT_S: f64 = 0.025;

    #[test]
    fn a_metre_is_done_in_little_more_than_two_seconds_without_overshoot() {
        let p = ControlParams::default();
        let target = Vector2::new(1.0, 0.0);
        let mut r = PlaceReference::default();
        let (mut most, mut settled) = (0.0_f64, 0.0);
        for n in 0..400 {
            r.step(&p, DT_S, target);
            most = most.max(r.place().x);
            if (r.place() - target).norm() > 0.05 {
                settled = f64::from(n) * DT_S;
            }
        }
        assert!(most < 1.02, "{most}");
        assert!(settled < 2.4, "{settled}");
    }

    #[test]
    fn it_begins_where_and_as_the_vehicle_moves() {
        let (v, a) = (Vector2::new(0.7, -0.1), Vector2::new(-0.5, 0.3));
        let r = PlaceReference::from_motion(Vector2::new(3.0, 2.0), v, a, a * 1.5);
        assert!((r.followed_velocity() - v).norm() < 1e-12);
        assert!((r.place() - Vector2::new(3.0, 2.0)).norm() < 1e-12);
        assert!((r.accel() - a * 1.5).norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn speed_acceleration_and_jerk_stay_within_their_limits(
            x in -5.0..5.0f64, y in -5.0..5.0f64, again in -5.0..5.0f64,
        ) {
            let p = ControlParams::default();
            let mut r = PlaceReference::default();
            for n in 0..400 {
                let before = r.accel();
                let target = Vector2::new(if n < 60 { x } else { again }, y);
                r.step(&p, DT_S, target);
                prop_assert!(r.accel().norm() <= p.acc_hor + 1e-9);
                prop_assert!((r.accel() - before).norm() <= p.jerk_max * DT_S + 1e-9);
                prop_assert!(r.velocity.norm() <= p.xy_vel_max + 0.35);
            }
            prop_assert!((r.place() - Vector2::new(again, y)).norm() < 0.02);
        }
    }
}
