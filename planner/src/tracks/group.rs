//! Returns of one scan that belong together, and how much of a person they could be.

use super::ray::{Ray, Rays};
use arrayvec::ArrayVec;
use nalgebra::Vector2;
use vehicle::sample::MAX_BEAMS;

/// Returns nearer to each other than this belong together, m.
const GROUP_GAP_M: f64 = 0.35;
/// Columns on somebody's near side differ by less than this in range, m; two short readings seldom agree so well.
const FACE_DEPTH_M: f64 = 0.15;
/// Share of the columns a person fills that must see them.
const FILLED: f64 = 0.6;

/// Returns of a group that agree in range.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    pub(super) near_m: f64,
    pub(super) columns: usize,
    pub(super) is_beyond_doubt: bool,
}

impl Face {
    pub(super) fn holds(&self, ray: &Ray) -> bool {
        (self.near_m..self.near_m + FACE_DEPTH_M).contains(&ray.length_m())
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Group {
    pub(super) sum: Vector2<f64>,
    pub(super) low: Vector2<f64>,
    pub(super) high: Vector2<f64>,
    pub(super) count: f64,
    pub(super) last: Vector2<f64>,
    /// First and last ray, by number in the scan.
    pub(super) first: usize,
    pub(super) end: usize,
}

impl Group {
    pub(super) const fn of(i: usize, p: Vector2<f64>) -> Self {
        Self {
            first: i,
            end: i,
            sum: p,
            low: p,
            high: p,
            count: 1.0,
            last: p,
        }
    }

    /// The group's returns.
    pub(super) fn members<'a>(&'a self, rays: &'a Rays) -> impl Iterator<Item = &'a Ray> {
        rays[self.first..=self.end]
            .iter()
            .filter(|r| r.unexplained && self.holds(r.to))
    }

    /// The most of the group's returns that agree in range: they could lie on one near side.
    pub(super) fn face(&self, rays: &Rays) -> Face {
        let from = |near_m: f64| {
            let empty = Face {
                near_m,
                columns: 0,
                is_beyond_doubt: true,
            };
            let inside = self.members(rays).filter(|r| empty.holds(r));
            inside.fold(empty, |face, ray| Face {
                columns: face.columns + 1,
                is_beyond_doubt: face.is_beyond_doubt && ray.is_beyond_doubt(),
                ..face
            })
        };
        self.members(rays)
            .map(|r| from(r.length_m()))
            .max_by_key(|f| f.columns)
            .unwrap_or_else(|| from(0.0))
    }

    /// Whether the columns next to the group, before and after it, exist.
    pub(super) fn neighbours(&self, rays: &Rays) -> (bool, bool) {
        let (first, end) = (&rays[self.first], &rays[self.end]);
        let before = self.first > 0 && first.is_beside(&rays[self.first - 1]);
        let after = rays.get(self.end + 1).is_some_and(|r| end.is_beside(r));
        (before, after)
    }

    /// Centre of the person whose near side this is. At the edge of a sensor's field only a shoulder is seen: the ray that
    /// goes past it on the one side touches the body there, and the rest is in the gap on the other.
    pub(super) fn centre(&self, eye: Vector2<f64>, rays: &Rays, radius_m: f64) -> Vector2<f64> {
        let face = self.mean();
        // Only the near side of a round body is seen; its centre is most of a radius farther.
        let outward = (face - eye) / (face - eye).norm().max(1e-6);
        let middle = face + outward * (0.8 * radius_m);
        let (past, shoulder, inner) = match self.neighbours(rays) {
            (true, false) => (self.first - 1, self.first, self.end),
            (false, true) => (self.end + 1, self.end, self.first),
            _ => return middle,
        };
        let direction = |r: &Ray| (r.to - r.from) / r.length_m().max(1e-6);
        let tangent = (direction(&rays[past]) + direction(&rays[shoulder])).normalize();
        let hit = rays[inner].to - eye;
        let side = libm::copysign(1.0, tangent.perp(&direction(&rays[shoulder])));
        let normal = Vector2::new(-tangent.y, tangent.x) * side;
        let (along, aside) = (hit.dot(&tangent), hit.dot(&normal));
        if !(0.0..radius_m).contains(&aside) {
            return middle;
        }
        // The circle touches the tangent and passes through the innermost return.
        let behind = libm::sqrt(radius_m * radius_m - (radius_m - aside) * (radius_m - aside));
        eye + tangent * (along + behind) + normal * radius_m
    }

    /// True if the group fills most of the columns that a person would fill there. At the edge of a sensor's field, where
    /// only a part can be seen, two columns do, or one beyond doubt; a ranger with a single beam has nothing better.
    pub(super) fn fills_a_person(
        &self,
        rays: &Rays,
        face: &Face,
        distance_m: f64,
        radius_m: f64,
    ) -> bool {
        let first = &rays[self.first];
        let least = match (self.neighbours(rays), self.first == self.end) {
            _ if first.is_wide() => 1.0,
            ((false, false), true) => 1.0,
            ((true, true), _) => {
                let half_fan = libm::asin((radius_m / distance_m.max(0.3)).min(0.8));
                let filled = half_fan / first.half_cone_rad.max(1e-3);
                libm::floor(FILLED * filled).clamp(2.0, 4.0)
            }
            _ if face.is_beyond_doubt => 1.0,
            _ => 2.0,
        };
        face.columns as f64 >= least
    }

    pub(super) fn add(&mut self, i: usize, p: Vector2<f64>) {
        self.end = i;
        self.sum += p;
        self.low = self.low.inf(&p);
        self.high = self.high.sup(&p);
        self.count += 1.0;
        self.last = p;
    }

    /// True if a return is part of the group (groups do not overlap).
    pub(super) fn holds(&self, p: Vector2<f64>) -> bool {
        let inside = |v: f64, low: f64, high: f64| v >= low - 1e-9 && v <= high + 1e-9;
        inside(p.x, self.low.x, self.high.x) && inside(p.y, self.low.y, self.high.y)
    }

    pub(super) fn mean(&self) -> Vector2<f64> {
        self.sum / self.count
    }

    pub(super) fn width_m(&self) -> f64 {
        (self.high - self.low).norm()
    }
}

pub(super) fn groups(rays: &Rays) -> ArrayVec<Group, MAX_BEAMS> {
    let mut out: ArrayVec<Group, MAX_BEAMS> = ArrayVec::new();
    for (i, ray) in rays.iter().enumerate().filter(|(_, r)| r.unexplained) {
        match out
            .iter_mut()
            .find(|g| (g.last - ray.to).norm() < GROUP_GAP_M)
        {
            Some(g) => g.add(i, ray.to),
            None => out.push(Group::of(i, ray.to)),
        }
    }
    out
}
