//! Coordinate frames as types, so that mixing two of them does not compile.
//!
//! | Frame | Axes | Used for |
//! | --- | --- | --- |
//! | [`Ned`] | x north, y east, z down; origin at the plan's home, on the floor | the world inside Kestrel, MAVLink LOCAL_NED |
//! | [`Frd`] | x forward, y right, z down; origin at the body centre | the body; roll right +, pitch nose-up +, yaw clockwise + |
//! | [`Map`] | x right and y up on the floor plan, z up; origin as the plan's YAML says | the plan; yaw counter-clockwise from x |
//! | [`Odom`] | level, z down, heading and origin where odometry began, never corrected (ROS REP-105) | moving particles |
//!
//! ```compile_fail
//! use vehicle::{Frd, In, Ned};
//! let mixed = In::<Ned>::new(1.0, 0.0, 0.0) + In::<Frd>::new(1.0, 0.0, 0.0);
//! ```
//! ```compile_fail
//! use vehicle::{Frd, In, Ned, Rot};
//! let frd_to_ned = Rot::<Frd, Ned>::identity();
//! let nonsense = frd_to_ned * In::<Ned>::new(1.0, 0.0, 0.0);
//! ```

use crate::angle::wrap_pi;
use core::fmt;
use core::marker::PhantomData;
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// North, east, down about home.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ned {}
/// Forward, right, down about the body centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frd {}
/// The floor plan: x right, y up on paper, z up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Map {}
/// Never-corrected odometry: level, z down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Odom {}

/// A vector (position, velocity, force ...) in frame `F`, SI units.
#[derive(Serialize, Deserialize)]
#[serde(from = "[f64; 3]", into = "[f64; 3]")]
pub struct In<F> {
    v: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> In<F> {
    /// From components.
    #[must_use]
    pub const fn new(x: f64, y: f64, z: f64) -> Self {
        Self {
            v: Vector3::new(x, y, z),
            frame: PhantomData,
        }
    }

    /// The zero vector.
    #[must_use]
    pub const fn zero() -> Self {
        Self::new(0.0, 0.0, 0.0)
    }

    /// From a bare vector that is known to be in this frame.
    #[must_use]
    pub const fn from_vector(v: Vector3<f64>) -> Self {
        Self {
            v,
            frame: PhantomData,
        }
    }

    /// First component.
    #[must_use]
    pub fn x(&self) -> f64 {
        self.v.x
    }

    /// Second component.
    #[must_use]
    pub fn y(&self) -> f64 {
        self.v.y
    }

    /// Third component.
    #[must_use]
    pub fn z(&self) -> f64 {
        self.v.z
    }

    /// The bare vector.
    #[must_use]
    pub const fn vector(&self) -> &Vector3<f64> {
        &self.v
    }

    /// Length.
    #[must_use]
    pub fn norm(&self) -> f64 {
        self.v.norm()
    }

    /// Length of the horizontal part (all four frames are level or used so).
    #[must_use]
    pub fn norm_xy(&self) -> f64 {
        libm::hypot(self.v.x, self.v.y)
    }

    /// Scalar product.
    #[must_use]
    pub fn dot(&self, other: &Self) -> f64 {
        self.v.dot(&other.v)
    }

    /// Vector product.
    #[must_use]
    pub fn cross(&self, other: &Self) -> Self {
        Self::from_vector(self.v.cross(&other.v))
    }

    /// The same vector with another third component.
    #[must_use]
    pub fn with_z(&self, z: f64) -> Self {
        Self::new(self.v.x, self.v.y, z)
    }

    /// The same vector, no longer than `max` horizontally.
    #[must_use]
    pub fn limited_xy(&self, max: f64) -> Self {
        let n = self.norm_xy();
        if n <= max || n == 0.0 {
            *self
        } else {
            Self::new(self.v.x * max / n, self.v.y * max / n, self.v.z)
        }
    }

    /// True if no component is NaN or infinite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.v.iter().all(|c| c.is_finite())
    }
}

// Derives would ask the marker types for these traits.
impl<F> Clone for In<F> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<F> Copy for In<F> {}
impl<F> Default for In<F> {
    fn default() -> Self {
        Self::zero()
    }
}
impl<F> PartialEq for In<F> {
    fn eq(&self, other: &Self) -> bool {
        self.v == other.v
    }
}
impl<F> fmt::Debug for In<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({:.4}, {:.4}, {:.4})", self.v.x, self.v.y, self.v.z)
    }
}
impl<F> From<[f64; 3]> for In<F> {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self::new(x, y, z)
    }
}
impl<F> From<In<F>> for [f64; 3] {
    fn from(a: In<F>) -> Self {
        [a.v.x, a.v.y, a.v.z]
    }
}
impl<F> Add for In<F> {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self::from_vector(self.v + o.v)
    }
}
impl<F> AddAssign for In<F> {
    fn add_assign(&mut self, o: Self) {
        self.v += o.v;
    }
}
impl<F> Sub for In<F> {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self::from_vector(self.v - o.v)
    }
}
impl<F> Neg for In<F> {
    type Output = Self;
    fn neg(self) -> Self {
        Self::from_vector(-self.v)
    }
}
impl<F> Mul<f64> for In<F> {
    type Output = Self;
    fn mul(self, k: f64) -> Self {
        Self::from_vector(self.v * k)
    }
}
impl<F> Div<f64> for In<F> {
    type Output = Self;
    fn div(self, k: f64) -> Self {
        Self::from_vector(self.v / k)
    }
}

/// A rotation that takes vectors of frame `A` to frame `B`; name values by direction: `frd_to_ned`.
#[derive(Serialize, Deserialize)]
#[serde(from = "[f64; 4]", into = "[f64; 4]")]
pub struct Rot<A, B> {
    q: UnitQuaternion<f64>,
    frames: PhantomData<(A, B)>,
}

impl<A, B> Rot<A, B> {
    /// No rotation.
    #[must_use]
    pub fn identity() -> Self {
        Self::from_quaternion(UnitQuaternion::identity())
    }

    /// From a unit quaternion that turns `A` vectors into `B` vectors.
    #[must_use]
    pub const fn from_quaternion(q: UnitQuaternion<f64>) -> Self {
        Self {
            q,
            frames: PhantomData,
        }
    }

    /// The unit quaternion, Hamilton.
    #[must_use]
    pub const fn quaternion(&self) -> &UnitQuaternion<f64> {
        &self.q
    }

    /// The way back.
    #[must_use]
    pub fn inverse(&self) -> Rot<B, A> {
        Rot::from_quaternion(self.q.inverse())
    }

    /// Rotation about z, then y, then x (aerospace order), radians: for `Rot<Frd, Ned>` roll right +, pitch nose-up +,
    /// yaw clockwise from north +.
    #[must_use]
    pub fn from_roll_pitch_yaw(roll_rad: f64, pitch_rad: f64, yaw_rad: f64) -> Self {
        Self::from_quaternion(UnitQuaternion::from_euler_angles(
            roll_rad, pitch_rad, yaw_rad,
        ))
    }

    /// (roll, pitch, yaw) in radians, aerospace order.
    #[must_use]
    pub fn roll_pitch_yaw(&self) -> (f64, f64, f64) {
        self.q.euler_angles()
    }

    /// Yaw in radians, (-pi, pi].
    #[must_use]
    pub fn yaw(&self) -> f64 {
        self.roll_pitch_yaw().2
    }

    /// Angle between the two z axes, radians; for `Rot<Frd, Ned>` the tilt of the vehicle.
    #[must_use]
    pub fn tilt(&self) -> f64 {
        let z = self.q * Vector3::z();
        libm::acos(z.z.clamp(-1.0, 1.0))
    }
}

impl<A, B> Clone for Rot<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<A, B> Copy for Rot<A, B> {}
impl<A, B> Default for Rot<A, B> {
    fn default() -> Self {
        Self::identity()
    }
}
impl<A, B> PartialEq for Rot<A, B> {
    fn eq(&self, other: &Self) -> bool {
        self.q == other.q
    }
}
impl<A, B> fmt::Debug for Rot<A, B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (r, p, y) = self.roll_pitch_yaw();
        write!(f, "rpy({r:.4}, {p:.4}, {y:.4})")
    }
}
impl<A, B> From<[f64; 4]> for Rot<A, B> {
    /// From w, x, y, z; normalised.
    fn from([w, x, y, z]: [f64; 4]) -> Self {
        Self::from_quaternion(UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
            w, x, y, z,
        )))
    }
}
impl<A, B> From<Rot<A, B>> for [f64; 4] {
    fn from(r: Rot<A, B>) -> Self {
        [r.q.w, r.q.i, r.q.j, r.q.k]
    }
}
impl<A, B> Mul<In<A>> for Rot<A, B> {
    type Output = In<B>;
    fn mul(self, v: In<A>) -> In<B> {
        In::from_vector(self.q * v.v)
    }
}
impl<A, B, C> Mul<Rot<A, B>> for Rot<B, C> {
    type Output = Rot<A, C>;
    fn mul(self, first: Rot<A, B>) -> Rot<A, C> {
        Rot::from_quaternion(self.q * first.q)
    }
}

/// A pose on the floor plan: metres, yaw counter-clockwise from plan x, radians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapPose {
    /// Right on the plan, metres.
    pub x_m: f64,
    /// Up on the plan, metres.
    pub y_m: f64,
    /// Counter-clockwise from plan x, radians.
    pub yaw_rad: f64,
}

impl MapPose {
    /// From components.
    #[must_use]
    pub const fn new(x_m: f64, y_m: f64, yaw_rad: f64) -> Self {
        Self { x_m, y_m, yaw_rad }
    }

    /// Distance to another pose on the plan, metres.
    #[must_use]
    pub fn distance(&self, other: &Self) -> f64 {
        libm::hypot(self.x_m - other.x_m, self.y_m - other.y_m)
    }
}

/// Ties the floor plan to the world: where home is on the plan and which way north points. Fixed at start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapAnchor {
    home_x_m: f64,
    home_y_m: f64,
    north_rad: f64,
}

impl MapAnchor {
    /// Home on the plan (metres) and the plan direction of north (radians counter-clockwise from plan x;
    /// pi/2 = north is up on paper).
    #[must_use]
    pub const fn new(home_x_m: f64, home_y_m: f64, north_rad: f64) -> Self {
        Self {
            home_x_m,
            home_y_m,
            north_rad,
        }
    }

    /// Plan direction of north, radians counter-clockwise from plan x.
    #[must_use]
    pub const fn north_rad(&self) -> f64 {
        self.north_rad
    }

    /// A point of the plan in the world.
    #[must_use]
    pub fn to_ned(&self, p: In<Map>) -> In<Ned> {
        let (s, c) = (libm::sin(self.north_rad), libm::cos(self.north_rad));
        let (dx, dy) = (p.x() - self.home_x_m, p.y() - self.home_y_m);
        In::new(dx * c + dy * s, dx * s - dy * c, -p.z())
    }

    /// A point of the world on the plan.
    #[must_use]
    pub fn to_map(&self, p: In<Ned>) -> In<Map> {
        let v = self.vector_to_map(p);
        In::new(v.x() + self.home_x_m, v.y() + self.home_y_m, v.z())
    }

    /// A direction or velocity of the world on the plan (no translation).
    #[must_use]
    pub fn vector_to_map(&self, v: In<Ned>) -> In<Map> {
        let (s, c) = (libm::sin(self.north_rad), libm::cos(self.north_rad));
        In::new(v.x() * c + v.y() * s, v.x() * s - v.y() * c, -v.z())
    }

    /// Plan yaw (counter-clockwise from plan x) as heading (clockwise from north), radians.
    #[must_use]
    pub fn yaw_to_ned(&self, map_yaw_rad: f64) -> f64 {
        wrap_pi(self.north_rad - map_yaw_rad)
    }

    /// Heading as plan yaw, radians. The same formula both ways.
    #[must_use]
    pub fn yaw_to_map(&self, ned_yaw_rad: f64) -> f64 {
        wrap_pi(self.north_rad - ned_yaw_rad)
    }

    /// Plan pose of a world position and heading.
    #[must_use]
    pub fn pose_to_map(&self, position: In<Ned>, yaw_rad: f64) -> MapPose {
        let p = self.to_map(position);
        MapPose::new(p.x(), p.y(), self.yaw_to_map(yaw_rad))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;
    use core::f64::consts::{FRAC_PI_2, PI};
    use proptest::prelude::*;

    fn close<F>(a: In<F>, b: In<F>) {
        assert_abs_diff_eq!((a - b).norm(), 0.0, epsilon = 1e-9);
    }

    #[test]
    fn nose_up_pitch_points_forward_axis_at_the_sky() {
        let frd_to_ned = Rot::<Frd, Ned>::from_roll_pitch_yaw(0.0, FRAC_PI_2, 0.0);
        close(frd_to_ned * In::new(1.0, 0.0, 0.0), In::new(0.0, 0.0, -1.0));
    }

    #[test]
    fn right_roll_points_the_right_axis_down() {
        let frd_to_ned = Rot::<Frd, Ned>::from_roll_pitch_yaw(FRAC_PI_2, 0.0, 0.0);
        close(frd_to_ned * In::new(0.0, 1.0, 0.0), In::new(0.0, 0.0, 1.0));
    }

    #[test]
    fn with_north_up_on_paper_plan_y_is_north_and_plan_x_is_east() {
        let anchor = MapAnchor::new(2.0, 3.0, FRAC_PI_2);
        close(
            anchor.to_ned(In::new(2.0, 4.0, 1.5)),
            In::new(1.0, 0.0, -1.5),
        );
        close(
            anchor.to_ned(In::new(3.0, 3.0, 0.0)),
            In::new(0.0, 1.0, 0.0),
        );
        assert_abs_diff_eq!(anchor.yaw_to_ned(0.0), FRAC_PI_2, epsilon = 1e-12);
        assert_abs_diff_eq!(anchor.yaw_to_ned(FRAC_PI_2), 0.0, epsilon = 1e-12);
    }

    proptest! {
        #[test]
        fn plan_and_world_are_inverse(x in -50.0..50.0, y in -50.0..50.0, z in -3.0..3.0, n in -PI..PI) {
            let anchor = MapAnchor::new(1.0, -2.0, n);
            let p = In::<Map>::new(x, y, z);
            prop_assert!((anchor.to_map(anchor.to_ned(p)) - p).norm() < 1e-9);
            // A heading drawn on the plan and one computed in the world are the same direction.
            let yaw = 0.7;
            let ahead_map = In::<Map>::new(x + libm::cos(yaw), y + libm::sin(yaw), z);
            let d = anchor.to_ned(ahead_map) - anchor.to_ned(p);
            prop_assert!(wrap_pi(libm::atan2(d.y(), d.x()) - anchor.yaw_to_ned(yaw)).abs() < 1e-9);
        }
    }
}
