//! The curve through way points whose integral of squared jerk is least, at rest at both ends.
//!
//! Between two points it is a quintic; where two meet, place, velocity, acceleration, jerk and its derivative agree: those are the conditions of the
//! optimum, and they make a band of 2 x 2 blocks for the velocities and accelerations at the inner points (Flash and Hogan 1985 for one piece). Times
//! of the pieces follow their lengths and are stretched until neither speed nor acceleration exceeds its limit.

use nalgebra::{Matrix2, Vector2, Vector3};
use thiserror::Error;

/// Way points at most.
pub const MAX_POINTS: usize = 256;
/// Points closer than this are one, m.
const SAME_M: f64 = 1e-3;
/// Samples of a piece that are looked at for limits.
const SAMPLES: u32 = 24;

/// Why there is no curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum CurveError {
    /// One point, or none.
    #[error("a curve needs two different points")]
    TooFew,
    /// More than are flown.
    #[error("more than {MAX_POINTS} way points")]
    TooMany,
    /// A coordinate, speed or acceleration that is no positive number.
    #[error("a coordinate or a limit is not a number")]
    NotFinite,
}

/// Place, velocity and acceleration at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// m.
    pub position: Vector3<f64>,
    /// m/s.
    pub velocity: Vector3<f64>,
    /// m/s2.
    pub acceleration: Vector3<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Knot {
    at_s: f64,
    motion: Motion,
}

/// One piece between two motions: for joining something that moves. Nothing is allocated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// Where and how it begins.
    pub from: Motion,
    /// Where and how it ends.
    pub to: Motion,
    /// How long it takes, s, more than zero.
    pub time_s: f64,
}

impl Piece {
    /// Where it is at a time within it, s.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Motion {
        piece(
            &self.from,
            &self.to,
            self.time_s,
            time_s.clamp(0.0, self.time_s),
        )
    }
}

/// The curve.
#[derive(Clone, Debug, PartialEq)]
pub struct MinimumJerk {
    knots: Vec<Knot>,
}

impl MinimumJerk {
    /// Through these points, m, no faster than `speed_mps` and no harder than `accel_mps2`.
    ///
    /// # Errors
    /// [`CurveError`].
    pub fn through(
        points: &[Vector3<f64>],
        speed_mps: f64,
        accel_mps2: f64,
    ) -> Result<Self, CurveError> {
        let limits = [speed_mps, accel_mps2];
        let is_good = limits.iter().all(|v| v.is_finite() && *v > 0.0)
            && points.iter().flat_map(|p| p.iter()).all(|v| v.is_finite());
        if !is_good {
            return Err(CurveError::NotFinite);
        }
        let mut distinct: Vec<Vector3<f64>> = Vec::with_capacity(points.len());
        for p in points {
            if distinct.last().is_none_or(|q| (p - q).norm() > SAME_M) {
                distinct.push(*p);
            }
        }
        if distinct.len() < 2 {
            return Err(CurveError::TooFew);
        }
        if distinct.len() > MAX_POINTS {
            return Err(CurveError::TooMany);
        }
        let mut times: Vec<f64> = distinct
            .windows(2)
            .map(|w| {
                let far_m = (w[1] - w[0]).norm();
                (far_m / speed_mps).max(libm::sqrt(far_m / accel_mps2))
            })
            .collect();
        // Speeds scale with 1/stretch, accelerations with its square: two rounds settle it, a third proves it.
        for _ in 0..3 {
            let curve = Self::with_times(&distinct, &times);
            let (fast, hard) = curve.extremes();
            let stretch = (fast / speed_mps).max(libm::sqrt(hard / accel_mps2));
            if (stretch - 1.0).abs() < 1e-9 {
                break;
            }
            times.iter_mut().for_each(|t| *t *= stretch);
        }
        Ok(Self::with_times(&distinct, &times))
    }

    fn with_times(points: &[Vector3<f64>], times: &[f64]) -> Self {
        let inner = solve(points, times);
        let mut at_s = 0.0;
        let mut knots = Vec::with_capacity(points.len());
        for (i, p) in points.iter().enumerate() {
            let (velocity, acceleration) = match i {
                0 => Default::default(),
                i => inner.get(i - 1).copied().unwrap_or_default(),
            };
            let motion = Motion {
                position: *p,
                velocity,
                acceleration,
            };
            knots.push(Knot { at_s, motion });
            at_s += times.get(i).copied().unwrap_or(0.0);
        }
        Self { knots }
    }

    /// How long it takes, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.knots.last().map_or(0.0, |k| k.at_s)
    }

    /// Where it is at a time; before the start and after the end it rests there.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Motion {
        let rest = |m: Motion| Motion {
            position: m.position,
            ..Motion::default()
        };
        let (Some(first), Some(last)) = (self.knots.first(), self.knots.last()) else {
            return Motion::default();
        };
        if time_s.is_nan() || time_s <= 0.0 {
            return rest(first.motion);
        }
        if time_s >= last.at_s {
            return rest(last.motion);
        }
        let next = self.knots.partition_point(|k| k.at_s <= time_s);
        let (a, b) = (&self.knots[next - 1], &self.knots[next]);
        piece(&a.motion, &b.motion, b.at_s - a.at_s, time_s - a.at_s)
    }

    /// Largest speed and acceleration.
    fn extremes(&self) -> (f64, f64) {
        let (mut fast, mut hard) = (1e-12_f64, 1e-12_f64);
        for pair in self.knots.windows(2) {
            for i in 0..=SAMPLES {
                let time_s = pair[1].at_s - pair[0].at_s;
                let t = time_s * f64::from(i) / f64::from(SAMPLES);
                let m = piece(&pair[0].motion, &pair[1].motion, time_s, t);
                fast = fast.max(m.velocity.norm());
                hard = hard.max(m.acceleration.norm());
            }
        }
        (fast, hard)
    }
}

/// The quintic between two motions.
fn piece(a: &Motion, b: &Motion, time_s: f64, t: f64) -> Motion {
    let (h, h2) = (time_s, time_s * time_s);
    let way = b.position - a.position - a.velocity * h - a.acceleration * (0.5 * h2);
    let speed = b.velocity - a.velocity - a.acceleration * h;
    let accel = b.acceleration - a.acceleration;
    let c3 = (way * 10.0 - speed * (4.0 * h) + accel * (0.5 * h2)) / (h2 * h);
    let c4 = (way * -15.0 + speed * (7.0 * h) - accel * h2) / (h2 * h2);
    let c5 = (way * 6.0 - speed * (3.0 * h) + accel * (0.5 * h2)) / (h2 * h2 * h);
    let (t2, t3) = (t * t, t * t * t);
    Motion {
        position: a.position
            + a.velocity * t
            + a.acceleration * (0.5 * t2)
            + (c3 + c4 * t + c5 * t2) * t3,
        velocity: a.velocity
            + a.acceleration * t
            + (c3 * 3.0 + c4 * (4.0 * t) + c5 * (5.0 * t2)) * t2,
        acceleration: a.acceleration + (c3 * 6.0 + c4 * (12.0 * t) + c5 * (20.0 * t2)) * t,
    }
}

#[expect(
    clippy::needless_range_loop,
    reason = "an axis of every point, not of the points"
)]
/// Velocities and accelerations at the inner points: jerk and snap agree from both sides.
fn solve(points: &[Vector3<f64>], times: &[f64]) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let inner = points.len().saturating_sub(2);
    let mut out = vec![(Vector3::zeros(), Vector3::zeros()); inner];
    if inner == 0 {
        return out;
    }
    // Jerk and snap of a quintic at its ends are linear in (v, a) of both ends and in the way. Rows: jerk, snap.
    let at_start_own = |h: f64| {
        Matrix2::new(
            -36.0 / (h * h),
            -9.0 / h,
            192.0 / (h * h * h),
            36.0 / (h * h),
        )
    };
    let at_start_other = |h: f64| {
        Matrix2::new(
            -24.0 / (h * h),
            3.0 / h,
            168.0 / (h * h * h),
            -24.0 / (h * h),
        )
    };
    let at_start_way = |h: f64| Vector2::new(60.0 / (h * h * h), -360.0 / (h * h * h * h));
    let at_end_own = |h: f64| {
        Matrix2::new(
            -36.0 / (h * h),
            9.0 / h,
            -192.0 / (h * h * h),
            36.0 / (h * h),
        )
    };
    let at_end_other = |h: f64| {
        Matrix2::new(
            -24.0 / (h * h),
            -3.0 / h,
            -168.0 / (h * h * h),
            -24.0 / (h * h),
        )
    };
    let at_end_way = |h: f64| Vector2::new(60.0 / (h * h * h), 360.0 / (h * h * h * h));
    for axis in 0..3 {
        // Thomas with blocks.
        let mut upper = vec![Matrix2::zeros(); inner];
        let mut right = vec![Vector2::zeros(); inner];
        for k in 0..inner {
            let (h1, h2) = (times[k], times[k + 1]);
            let before = points[k + 1][axis] - points[k][axis];
            let after = points[k + 2][axis] - points[k + 1][axis];
            let lower = at_end_other(h1);
            let mut middle = at_end_own(h1) - at_start_own(h2);
            let above = -at_start_other(h2);
            let mut r = at_start_way(h2) * after - at_end_way(h1) * before;
            if k > 0 {
                middle -= lower * upper[k - 1];
                r -= lower * right[k - 1];
            }
            // The least of a strictly convex problem is unique: the blocks can be inverted.
            let inverse = middle.try_inverse().unwrap_or_else(Matrix2::zeros);
            upper[k] = inverse * above;
            right[k] = inverse * r;
        }
        let mut next = Vector2::zeros();
        for k in (0..inner).rev() {
            let x = right[k] - upper[k] * next;
            out[k].0[axis] = x.x;
            out[k].1[axis] = x.y;
            next = x;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner() -> [Vector3<f64>; 4] {
        [
            Vector3::new(0.0, 0.0, -1.0),
            Vector3::new(2.0, 0.0, -1.0),
            Vector3::new(2.0, 2.0, -1.2),
            Vector3::new(0.0, 3.0, -1.0),
        ]
    }

    #[test]
    fn between_two_points_it_is_the_curve_of_flash_and_hogan() {
        let points = [Vector3::zeros(), Vector3::new(1.0, 0.0, 0.0)];
        let curve = MinimumJerk::through(&points, 1.0, 10.0).unwrap();
        // Peak speed 15/8 of the mean.
        assert!(
            (curve.duration_s() - 1.875).abs() < 1e-3,
            "{}",
            curve.duration_s()
        );
        for i in 0..=10 {
            let s = f64::from(i) / 10.0;
            let x = 10.0 * s.powi(3) - 15.0 * s.powi(4) + 6.0 * s.powi(5);
            let at = curve.at(s * curve.duration_s());
            assert!((at.position.x - x).abs() < 1e-9);
        }
    }

    #[test]
    fn it_passes_all_points_within_its_limits_and_without_a_jump_up_to_snap() {
        let points = corner();
        let curve = MinimumJerk::through(&points, 1.0, 1.5).unwrap();
        for (knot, p) in curve.knots.iter().zip(points) {
            assert!((curve.at(knot.at_s).position - p).norm() < 1e-9);
        }
        let h = 1e-3;
        let n = (curve.duration_s() / h) as u32;
        let (mut fast, mut hard) = (0.0_f64, 0.0_f64);
        let mut last_jerk: Option<Vector3<f64>> = None;
        for i in 0..n - 1 {
            let t = f64::from(i) * h;
            let (a, b) = (curve.at(t), curve.at(t + h));
            fast = fast.max(a.velocity.norm());
            hard = hard.max(a.acceleration.norm());
            let jerk = (b.acceleration - a.acceleration) / h;
            if let Some(last) = last_jerk {
                assert!(
                    (jerk - last).norm() < 0.1,
                    "a jump of jerk at {t}: {}",
                    (jerk - last).norm()
                );
            }
            last_jerk = Some(jerk);
        }
        assert!(fast <= 1.0 + 5e-3 && hard <= 1.5 + 2e-2, "{fast} {hard}");
        let end = curve.at(curve.duration_s() + 1.0);
        assert!(end.velocity.norm() < 1e-12);
    }

    #[test]
    fn its_jerk_is_less_than_that_of_neighbours() {
        // Any other velocity at the corner costs more.
        let points = corner();
        let curve = MinimumJerk::through(&points, 1.0, 1.5).unwrap();
        let cost = |c: &MinimumJerk| {
            let h = 2e-3;
            let n = (c.duration_s() / h) as u32;
            (0..n)
                .map(|i| {
                    let t = f64::from(i) * h + 0.5 * h;
                    let j = (c.at(t + 1e-4).acceleration - c.at(t - 1e-4).acceleration) / 2e-4;
                    j.norm_squared() * h
                })
                .sum::<f64>()
        };
        let least = cost(&curve);
        for change in [0.05, -0.05] {
            let mut other = curve.clone();
            other.knots[1].motion.velocity.x += change;
            assert!(cost(&other) > least);
            let mut other = curve.clone();
            other.knots[2].motion.acceleration.y += change;
            assert!(cost(&other) > least);
        }
    }

    #[test]
    fn what_is_no_curve_is_refused() {
        let one = [Vector3::zeros(); 3];
        assert_eq!(
            MinimumJerk::through(&one, 1.0, 1.0),
            Err(CurveError::TooFew)
        );
        let nan = [Vector3::zeros(), Vector3::new(f64::NAN, 0.0, 0.0)];
        assert_eq!(
            MinimumJerk::through(&nan, 1.0, 1.0),
            Err(CurveError::NotFinite)
        );
        assert_eq!(
            MinimumJerk::through(&corner(), 0.0, 1.0),
            Err(CurveError::NotFinite)
        );
    }
}
