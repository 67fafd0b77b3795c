//! Level poses: what moves particles.

use serde::{Deserialize, Serialize};
use vehicle::angle::wrap_pi;
use vehicle::{In, MapPose, Odom};

/// A pose, or the step between two poses, in a level frame with z up: x forward, y left, yaw counter-clockwise; metres, rad.
///
/// The plan is drawn this way, so odometry is turned over once (y and yaw change sign) and never again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Planar {
    /// Forward (or the first axis of the frame), m.
    pub x: f64,
    /// Left (or the second axis of the frame), m.
    pub y: f64,
    /// Counter-clockwise, rad.
    pub yaw: f64,
}

impl Planar {
    /// From components.
    #[must_use]
    pub const fn new(x: f64, y: f64, yaw: f64) -> Self {
        Self { x, y, yaw }
    }

    /// From a position in [`Odom`] (z down) and a heading (clockwise).
    #[must_use]
    pub fn from_odom(position: In<Odom>, heading_rad: f64) -> Self {
        Self::new(position.x(), -position.y(), -heading_rad)
    }

    /// This pose followed by a step in its own axes.
    #[must_use]
    pub fn then(&self, step: &Self) -> Self {
        let p = self.point(step.x, step.y);
        Self::new(p[0], p[1], wrap_pi(self.yaw + step.yaw))
    }

    /// The step from this pose to another, in this pose's axes.
    #[must_use]
    pub fn step_to(&self, other: &Self) -> Self {
        let p = self.point_inverse(other.x, other.y);
        Self::new(p[0], p[1], wrap_pi(other.yaw - self.yaw))
    }

    /// The pose's axes, for turning many points.
    #[must_use]
    pub fn axes(&self) -> Axes {
        Axes {
            origin: [self.x, self.y],
            sin: libm::sin(self.yaw),
            cos: libm::cos(self.yaw),
        }
    }

    /// A point given in this pose's axes, in the frame the pose is in.
    #[must_use]
    pub fn point(&self, x: f64, y: f64) -> [f64; 2] {
        self.axes().outward([x, y])
    }

    /// A point of the frame the pose is in, in the pose's axes.
    #[must_use]
    pub fn point_inverse(&self, x: f64, y: f64) -> [f64; 2] {
        self.axes().inward([x, y])
    }

    /// Length of the translation, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        libm::hypot(self.x, self.y)
    }

    /// Distance between two poses of the same frame, m.
    #[must_use]
    pub fn distance(&self, other: &Self) -> f64 {
        libm::hypot(self.x - other.x, self.y - other.y)
    }

    /// True if both poses are within a distance (m) and a turn (rad) of each other.
    #[must_use]
    pub fn is_near(&self, other: &Self, distance_m: f64, turn_rad: f64) -> bool {
        self.distance(other) <= distance_m && wrap_pi(self.yaw - other.yaw).abs() <= turn_rad
    }

    /// True if no component is NaN or infinite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.yaw.is_finite()
    }
}

/// A [`Planar`] with its sine and cosine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes {
    origin: [f64; 2],
    sin: f64,
    cos: f64,
}

impl Axes {
    /// A point given in these axes, in the frame they are given in.
    #[must_use]
    pub fn outward(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.origin[0] + self.cos * x - self.sin * y,
            self.origin[1] + self.sin * x + self.cos * y,
        ]
    }

    /// A point of the frame these axes are given in, in these axes.
    #[must_use]
    pub fn inward(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (dx, dy) = (x - self.origin[0], y - self.origin[1]);
        [
            self.cos * dx + self.sin * dy,
            -self.sin * dx + self.cos * dy,
        ]
    }
}

impl From<MapPose> for Planar {
    fn from(p: MapPose) -> Self {
        Self::new(p.x_m, p.y_m, p.yaw_rad)
    }
}

impl From<Planar> for MapPose {
    fn from(p: Planar) -> Self {
        Self::new(p.x, p.y, wrap_pi(p.yaw))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_turn_to_the_right_in_odometry_is_clockwise_on_the_plan() {
        // One metre ahead, one metre right, nose right.
        let p = Planar::from_odom(In::new(1.0, 1.0, -1.0), 0.5);
        assert_eq!(p, Planar::new(1.0, -1.0, -0.5));
    }

    proptest! {
        #[test]
        fn a_step_leads_back_to_where_it_was_measured(a in -9.0..9.0f64, b in -9.0..9.0f64, c in -3.0..3.0f64, d in -9.0..9.0f64, e in -3.0..3.0f64) {
            let (from, to) = (Planar::new(a, b, c), Planar::new(d, a - b, e));
            let back = from.then(&from.step_to(&to));
            prop_assert!(back.is_near(&to, 1e-9, 1e-9));
        }
    }
}
