//! A fan of rays on the plan about the forward direction: for each, the nearest wall and the nearest movers before it.

use super::scenery::{Paint, Scenery};
use super::{Mover, Shot};
use crate::geometry;

/// Rays.
pub(super) const RAYS: usize = 2560;
/// Tangent of the outermost ray: a tilted camera sees further round than a level one.
pub(super) const SPREAD: f32 = 2.5;
/// Walls further away are not drawn, m.
const FAR_M: f64 = 80.0;

/// What a direction shows. Distances are along the forward direction, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// To the wall; infinite if there is none.
    pub(super) wall_m: f32,
    /// Along the wall, m.
    pub(super) along_m: f32,
    /// How the wall looks.
    pub(super) paint: Paint,
    /// Light on it, 0..=1, with distance.
    pub(super) light: f32,
    /// The two nearest movers before it.
    pub(super) movers: [Seen; 2],
}

/// A mover in a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seen {
    /// To its surface; infinite if there is none.
    pub(super) distance_m: f32,
    /// Where the ray passes its axis, in radii: -1 left edge ..= 1 right edge.
    pub(super) aside: f32,
    /// Which.
    pub(super) mover: u8,
}

const NOBODY: Seen = Seen {
    distance_m: f32::INFINITY,
    aside: 0.0,
    mover: 0,
};

/// Light lost with distance.
pub(super) fn fade(distance_m: f32) -> f32 {
    1.0 / (1.0 + 0.045 * distance_m)
}

/// The fan: reused from picture to picture.
#[derive(Clone, Debug)]
pub(super) struct Fan {
    pub(super) rays: Vec<Ray>,
    /// Forward on the plan, unit length; right of it is (y, -x).
    pub(super) forward: [f64; 2],
}

impl Fan {
    pub(super) fn new() -> Self {
        let empty = Ray {
            wall_m: f32::INFINITY,
            along_m: 0.0,
            paint: Paint::default(),
            light: 1.0,
            movers: [NOBODY; 2],
        };
        Self {
            rays: vec![empty; RAYS],
            forward: [1.0, 0.0],
        }
    }

    /// Tangent of a ray.
    fn tangent(ray: usize) -> f64 {
        ((ray as f64 + 0.5) / RAYS as f64 * 2.0 - 1.0) * f64::from(SPREAD)
    }

    /// Casts all rays.
    pub(super) fn cast(&mut self, scenery: &Scenery, shot: &Shot) {
        let ahead = shot.axes[0];
        let level = ahead.norm_xy();
        // Straight up or down there is no forward: keep the last.
        if level > 1e-3 {
            self.forward = [ahead.x() / level, ahead.y() / level];
        }
        let [fx, fy] = self.forward;
        let eye = [shot.eye.x(), shot.eye.y()];
        for (i, ray) in self.rays.iter_mut().enumerate() {
            let t = Self::tangent(i);
            let stretch = (1.0 + t * t).sqrt();
            let direction = [(fx + t * fy) / stretch, (fy - t * fx) / stretch];
            ray.movers = [NOBODY; 2];
            let Some(hit) = scenery.walls.cast(eye, direction, FAR_M) else {
                ray.wall_m = f32::INFINITY;
                continue;
            };
            let at = [0, 1].map(|k| eye[k] + direction[k] * hit.distance_m);
            let start = scenery.walls.segments()[hit.segment as usize].a;
            let (paint, light) = scenery.surface(hit.segment, at);
            ray.wall_m = (hit.distance_m / stretch) as f32;
            ray.along_m = geometry::distance(start, at) as f32;
            ray.paint = paint;
            ray.light = light * fade(hit.distance_m as f32);
        }
        for (index, mover) in shot.movers.iter().enumerate() {
            self.see(eye, index as u8, mover);
        }
    }

    fn see(&mut self, eye: [f64; 2], index: u8, mover: &Mover) {
        let [fx, fy] = self.forward;
        let to = [mover.centre[0] - eye[0], mover.centre[1] - eye[1]];
        let far = geometry::distance(eye, mover.centre);
        // From within it nothing is seen of it.
        if far <= mover.radius_m {
            return;
        }
        let ahead = to[0] * fx + to[1] * fy;
        let right = to[0] * fy - to[1] * fx;
        if ahead < 0.02 {
            return;
        }
        // Wide enough on either side; the rays themselves decide.
        let reach = mover.radius_m / ahead * (1.0 + (right / ahead).abs()) * 2.0 + 0.05;
        let ray_of = |t: f64| {
            let i = (t / f64::from(SPREAD) + 1.0) * 0.5 * RAYS as f64;
            i.clamp(0.0, RAYS as f64) as usize
        };
        let span = ray_of(right / ahead - reach)..ray_of(right / ahead + reach);
        for i in span {
            let t = Self::tangent(i);
            let stretch = (1.0 + t * t).sqrt();
            let direction = [(fx + t * fy) / stretch, (fy - t * fx) / stretch];
            let hit = geometry::ray_disc(eye, direction, mover.centre, mover.radius_m);
            let Some(d) = hit else { continue };
            let seen = Seen {
                distance_m: (d / stretch) as f32,
                aside: ((direction[0] * to[1] - direction[1] * to[0]) / mover.radius_m) as f32,
                mover: index,
            };
            let ray = &mut self.rays[i];
            if seen.distance_m >= ray.wall_m {
                continue;
            }
            if seen.distance_m < ray.movers[0].distance_m {
                ray.movers = [seen, ray.movers[0]];
            } else if seen.distance_m < ray.movers[1].distance_m {
                ray.movers[1] = seen;
            }
        }
    }
}
