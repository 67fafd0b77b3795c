//! Look-ahead over the vehicle's own answer: what a velocity leads to before the vehicle could stand again.
//!
//! A direction may be free and the speed right, and the vehicle still drifts into a post, because it answers with a lag and
//! cuts its corners. Each velocity is therefore flown in thought: held for as long as it takes to think again, then braked
//! to a stand. If that touches something, slower and other directions are tried (the look-ahead of VFH*, Ulrich and
//! Borenstein 2000, over the projected motion instead of straight steps).

use super::{Navigator, SURE_WEIGHT};
use nalgebra::{Rotation2, Vector2};

/// The vehicle's answer to a velocity: dead time and lag, s; braking and turning acceleration, m/s2.
const DEAD_TIME_S: f64 = 0.1;
const LAG_S: f64 = 0.3;
const ACCEL_MPS2: f64 = 2.0;
/// A velocity is held this long before the next thought can change it, s.
const HELD_S: f64 = 0.2;
/// Steps of the thought and its end, s.
const STEP_S: f64 = 0.05;
const HORIZON_S: f64 = 1.6;
/// Free space between hull and obstacle on the way to a stand, m.
pub(super) const KEEP_M: f64 = 0.06;
/// Slower is standing, m/s.
const STANDING_MPS: f64 = 0.05;
/// What is tried instead of a velocity that leads into something: shares of its speed, and turns, degrees.
const SHARES: [f64; 4] = [1.0, 0.6, 0.35, 0.2];
const TURNS_DEG: [f64; 11] = [
    0.0, 12.0, -12.0, 25.0, -25.0, 40.0, -40.0, 60.0, -60.0, 85.0, -85.0,
];

impl Navigator {
    /// The velocity wanted if it is safe, else the safe one that leads farthest the same way, else a retreat.
    pub(super) fn foreseen(&self, velocity: Vector2<f64>, wanted: Vector2<f64>) -> Vector2<f64> {
        let mut near = arrayvec::ArrayVec::<Vector2<f64>, 512>::new();
        let reach_m = self.radius_m + KEEP_M + velocity.norm().max(wanted.norm()) * HORIZON_S;
        for o in self.surroundings.points() {
            if o.weight >= SURE_WEIGHT && o.distance_m < reach_m && near.try_push(o.offset).is_err()
            {
                break;
            }
        }
        if self.stays_clear(&near, velocity, wanted) {
            return wanted;
        }
        let speed = wanted.norm();
        let mut best: Option<(f64, Vector2<f64>)> = None;
        for turn_deg in TURNS_DEG {
            let turned = Rotation2::from_matrix_unchecked(turn(turn_deg)) * wanted;
            for share in SHARES {
                let v = turned * share;
                let progress =
                    v.dot(&wanted) / speed.max(1e-6) - 0.05 * speed * turn_deg.abs() / 90.0;
                if best.is_none_or(|(p, _)| progress > p) && self.stays_clear(&near, velocity, v) {
                    best = Some((progress, v));
                }
            }
        }
        match best {
            Some((_, v)) => v,
            None => self.held_back_by_all(Vector2::zeros(), self.radius_m + KEEP_M + 0.04),
        }
    }

    /// True if flying `wanted` for a moment and braking then comes no nearer to anything than allowed, or than now.
    fn stays_clear(
        &self,
        near: &[Vector2<f64>],
        velocity: Vector2<f64>,
        wanted: Vector2<f64>,
    ) -> bool {
        let keep_m = self.radius_m + KEEP_M;
        let (mut p, mut v) = (Vector2::zeros(), velocity);
        let mut t = 0.0;
        while t < HORIZON_S {
            let target = if t < DEAD_TIME_S {
                v
            } else if t < DEAD_TIME_S + HELD_S {
                wanted
            } else {
                Vector2::zeros()
            };
            let mut a = (target - v) / LAG_S;
            let n = a.norm();
            if n > ACCEL_MPS2 {
                a *= ACCEL_MPS2 / n;
            }
            v += a * STEP_S;
            p += v * STEP_S;
            t += STEP_S;
            for o in near {
                let away2 = (o - p).norm_squared();
                if away2 < keep_m * keep_m && away2 < o.norm_squared() {
                    return false;
                }
            }
            if t > DEAD_TIME_S + HELD_S && v.norm() < STANDING_MPS {
                break;
            }
        }
        true
    }
}

fn turn(degrees: f64) -> nalgebra::Matrix2<f64> {
    let (s, c) = libm::sincos(degrees.to_radians());
    nalgebra::Matrix2::new(c, -s, s, c)
}
