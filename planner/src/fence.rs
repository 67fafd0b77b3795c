//! Where the vehicle may be: zones to stay in, zones to stay out of, and how much room is left to their borders.
//!
//! Plane geometry without units of its own: a fence in NED about home and the no-fly zones of a plan are the same thing in
//! other coordinates. A place is inside if it lies in at least one zone to stay in (or there is none) and in no zone to stay out
//! of. Zones have no height.
//!
//! ```
//! use planner::fence::{Fence, Zone};
//! let room = Zone::keep_in(&[[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]]);
//! let pillar = Zone::circle([2.0, 1.5], 0.5, false);
//! let fence = Fence::new(vec![room, pillar]);
//! assert!(fence.contains([1.0, 1.0]) && !fence.contains([2.0, 1.5]) && !fence.contains([5.0, 1.0]));
//! assert!((fence.room_m([0.25, 1.5]) - 0.25).abs() < 1e-12);
//! ```

use serde::{Deserialize, Serialize};
use vehicle::{In, Ned};

/// One zone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Zone {
    /// To stay in; else to stay out of.
    pub is_inclusion: bool,
    /// Its border.
    pub shape: Shape,
}

/// A border.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    /// Corners, either way round, m.
    Polygon(Vec<[f64; 2]>),
    /// Centre and radius, m.
    Circle([f64; 2], f64),
}

impl Zone {
    /// A polygon to stay in.
    #[must_use]
    pub fn keep_in(corners: &[[f64; 2]]) -> Self {
        Self {
            is_inclusion: true,
            shape: Shape::Polygon(corners.to_vec()),
        }
    }

    /// A polygon to stay out of.
    #[must_use]
    pub fn keep_out(corners: &[[f64; 2]]) -> Self {
        Self {
            is_inclusion: false,
            ..Self::keep_in(corners)
        }
    }

    /// A circle.
    #[must_use]
    pub const fn circle(centre: [f64; 2], radius_m: f64, is_inclusion: bool) -> Self {
        Self {
            is_inclusion,
            shape: Shape::Circle(centre, radius_m),
        }
    }

    /// Distance to the border, m: positive where the zone allows to be, negative where it does not.
    #[must_use]
    pub fn room_m(&self, at: [f64; 2]) -> f64 {
        let inside_m = self.shape.inside_m(at);
        if self.is_inclusion {
            inside_m
        } else {
            -inside_m
        }
    }
}

impl Shape {
    /// Distance to the border, m: positive inside, negative outside.
    #[must_use]
    pub fn inside_m(&self, at: [f64; 2]) -> f64 {
        match self {
            Self::Circle(centre, radius) => {
                radius - libm::hypot(at[0] - centre[0], at[1] - centre[1])
            }
            Self::Polygon(corners) => {
                let mut is_inside = false;
                let mut nearest_m = f64::INFINITY;
                let mut last = corners.len().wrapping_sub(1);
                for i in 0..corners.len() {
                    let (a, b) = (corners[last], corners[i]);
                    nearest_m = nearest_m.min(distance_to_edge(a, b, at));
                    // Even-odd rule: a ray to the side crosses the border an odd number of times.
                    let crosses = (a[0] > at[0]) != (b[0] > at[0]);
                    if crosses && at[1] < (b[1] - a[1]) * (at[0] - a[0]) / (b[0] - a[0]) + a[1] {
                        is_inside = !is_inside;
                    }
                    last = i;
                }
                if is_inside { nearest_m } else { -nearest_m }
            }
        }
    }

    /// Calls `see` with points of the border, at most `step_m` apart.
    pub fn outline(&self, step_m: f64, mut see: impl FnMut([f64; 2])) {
        match self {
            Self::Circle(centre, radius) => {
                let n = libm::ceil(core::f64::consts::TAU * radius / step_m).max(8.0) as usize;
                for k in 0..n {
                    let (s, c) = libm::sincos(core::f64::consts::TAU * k as f64 / n as f64);
                    see([centre[0] + radius * c, centre[1] + radius * s]);
                }
            }
            Self::Polygon(corners) => {
                let mut last = corners.len().wrapping_sub(1);
                for i in 0..corners.len() {
                    let (a, b) = (corners[last], corners[i]);
                    let n = libm::ceil(libm::hypot(b[0] - a[0], b[1] - a[1]) / step_m).max(1.0);
                    for k in 0..n as usize {
                        let t = k as f64 / n;
                        see([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
                    }
                    last = i;
                }
            }
        }
    }
}

/// All zones together.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fence {
    zones: Vec<Zone>,
}

impl Fence {
    /// Of these zones.
    #[must_use]
    pub const fn new(zones: Vec<Zone>) -> Self {
        Self { zones }
    }

    /// No zones: everything is allowed.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.zones.is_empty()
    }

    /// The zones.
    #[must_use]
    pub fn zones(&self) -> &[Zone] {
        &self.zones
    }

    /// True if a place is inside.
    #[must_use]
    pub fn contains(&self, at: [f64; 2]) -> bool {
        self.room_m(at) >= 0.0
    }

    /// Room to the nearest border, m; negative outside, infinite without zones. (In the overlap of two zones to stay in it may
    /// be less than there is.)
    #[must_use]
    pub fn room_m(&self, at: [f64; 2]) -> f64 {
        let mut best_in: Option<f64> = None;
        let mut room = f64::INFINITY;
        for zone in &self.zones {
            let m = zone.room_m(at);
            if zone.is_inclusion {
                best_in = Some(best_in.map_or(m, |b: f64| b.max(m)));
            } else {
                room = room.min(m);
            }
        }
        best_in.map_or(room, |b| room.min(b))
    }
}

/// What a station drew for the vehicle: where it may be, and where else than home it may land. NED about home.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Site {
    /// Zones.
    pub fence: Fence,
    /// Places to return to, m.
    pub rally: Vec<In<Ned>>,
}

fn distance_to_edge(a: [f64; 2], b: [f64; 2], p: [f64; 2]) -> f64 {
    let (abx, aby) = (b[0] - a[0], b[1] - a[1]);
    let length2 = abx * abx + aby * aby;
    let t = if length2 > 0.0 {
        (((p[0] - a[0]) * abx + (p[1] - a[1]) * aby) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    libm::hypot(a[0] + t * abx - p[0], a[1] + t * aby - p[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn inside_is_in_a_zone_to_stay_in_and_in_none_to_stay_out_of() {
        // An L without its upper right quarter.
        let l = [[0., 0.], [4., 0.], [4., 2.], [2., 2.], [2., 4.], [0., 4.]];
        let fence = Fence::new(vec![
            Zone::keep_in(&l),
            Zone::circle([1.0, 1.0], 0.5, false),
        ]);
        assert!(fence.contains([3.0, 1.0]) && fence.contains([1.0, 3.0]));
        assert!(!fence.contains([3.0, 3.0]) && !fence.contains([1.2, 1.2]));
        assert!((fence.room_m([3.0, 1.0]) - 1.0).abs() < 1e-12);
        assert!((fence.room_m([1.0, 1.0]) + 0.5).abs() < 1e-12);
        assert!(Fence::default().contains([9.0, 9.0]));
    }

    proptest! {
        #[test]
        fn room_is_the_distance_to_the_outline(x in -3.0..3.0f64, y in -3.0..3.0f64, r in 0.2..2.0f64) {
            for shape in [Shape::Circle([0.3, -0.2], r), Shape::Polygon(vec![[-r, -1.0], [r, -1.0], [0.0, 1.5]])] {
                let mut nearest = f64::INFINITY;
                shape.outline(0.005, |p| nearest = nearest.min(libm::hypot(p[0] - x, p[1] - y)));
                prop_assert!((shape.inside_m([x, y]).abs() - nearest).abs() < 0.01);
            }
        }
    }
}
