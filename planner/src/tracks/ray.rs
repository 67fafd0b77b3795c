//! One ray of a scan on the plan.

use arrayvec::ArrayVec;
use nalgebra::Vector2;
use vehicle::sample::MAX_BEAMS;

/// Short readings of a wall lose at most this share of the way, and this more, m.
const SHORT_SHARE: f64 = 0.5;
const SHORT_M: f64 = 0.2;
/// Columns of one sensor lie at most this many spacings apart.
const NEIGHBOUR: f64 = 1.6;

/// One ray of a scan on the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts, m on the plan.
    pub from: Vector2<f64>,
    /// Where it ends: at the return or where sight ends.
    pub to: Vector2<f64>,
    /// It ends at something that the plan does not explain.
    pub unexplained: bool,
    /// How far the plan leaves the way open in its direction, m.
    pub open_m: f64,
    /// Half the opening angle of its cone, rad; columns of a multizone ranger lie two of these apart.
    pub half_cone_rad: f64,
}

/// Cones wider than this (half, rad) do not tell where on their front a return came from.
pub(crate) const WIDE_RAD: f64 = 0.06;

impl Ray {
    /// A wide cone: where on its front the return came from is not known.
    #[must_use]
    pub fn is_wide(&self) -> bool {
        self.half_cone_rad > WIDE_RAD
    }

    pub(super) fn length_m(&self) -> f64 {
        (self.to - self.from).norm()
    }

    /// A return so near that no short reading of the wall behind explains it.
    pub(super) fn is_beyond_doubt(&self) -> bool {
        self.length_m() < SHORT_SHARE * self.open_m - SHORT_M
    }

    /// True if another ray is the next column of the same sensor (or the one after a column that failed).
    pub(super) fn is_beside(&self, other: &Self) -> bool {
        let (a, b) = (self.to - self.from, other.to - other.from);
        let (cross, dot) = (a.perp(&b), a.dot(&b));
        libm::atan2(cross.abs(), dot) < NEIGHBOUR * 2.0 * self.half_cone_rad
    }
}

/// The rays of one scan.
pub type Rays = ArrayVec<Ray, MAX_BEAMS>;

/// The way out (unit) and the length by which a disc must move so that a ray can go past it; none if it does already.
pub(super) fn goes_past(
    ray: &Ray,
    place: Vector2<f64>,
    radius_m: f64,
) -> Option<(Vector2<f64>, f64)> {
    let along = ray.to - ray.from;
    let length = along.norm();
    if length < 1e-6 {
        return None;
    }
    let unit = along / length;
    let to = place - ray.from;
    let (forward, aside) = (to.dot(&unit), unit.perp(&to));
    let past = forward > 0.0 && forward + radius_m < length && aside.abs() < radius_m;
    let left = Vector2::new(-unit.y, unit.x);
    past.then(|| (left * libm::copysign(1.0, aside), radius_m - aside.abs()))
}

pub(super) fn passes_through(ray: &Ray, place: Vector2<f64>) -> bool {
    let along = ray.to - ray.from;
    let length = along.norm();
    if length < 1e-6 {
        return false;
    }
    let unit = along / length;
    let to = place - ray.from;
    to.perp(&unit).abs() < 0.12 && to.dot(&unit) > 0.0 && to.dot(&unit) + 0.3 < length
}
