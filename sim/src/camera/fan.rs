//! A fan of rays on the plan about the forward direction: for each, the nearest wall and the nearest movers before it.

use super::scenery::{Paint, Pattern, Scenery};
use super::{HALF_VIEW, Mover, Shot};
use crate::geometry;

/// Rays: one for each column of the picture, and some.
pub(super) const RAYS: usize = 1024;
/// Widest fan, as the tangent of the outermost ray: a camera tilted so far sees the same beside it.
const WIDEST: f64 = 6.0;
/// Width of a panel of a wall, m.
const PANEL_M: f64 = 1.2;
/// Width of a door of furniture, m.
const LEAF_M: f64 = 0.6;
/// Walls further away are not drawn, m.
const FAR_M: f64 = 80.0;

/// What a direction shows. Distances are along the forward direction, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// To the wall; infinite if there is none.
    pub(super) wall_m: f32,
    /// Here two panels or doors meet.
    pub(super) is_joint: bool,
    /// How well patterns are seen at this distance, 0..=1: far ones would flicker.
    pub(super) sharp: f32,
    /// Light on it, 0..=1, with distance.
    pub(super) light: f32,
    /// How the wall looks.
    pub(super) paint: Paint,
    /// Where the floor is the threshold of a door: from, to.
    pub(super) sill_m: [f32; 2],
    /// Somebody is before the wall.
    pub(super) is_busy: bool,
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
    /// The two nearest movers of each ray.
    pub(super) movers: Vec<[Seen; 2]>,
    /// Forward on the plan, unit length; right of it is (y, -x).
    pub(super) forward: [f64; 2],
    /// Tangent of the outermost ray.
    pub(super) spread: f64,
}

impl Fan {
    pub(super) fn new() -> Self {
        let empty = Ray {
            wall_m: f32::INFINITY,
            is_joint: false,
            sharp: 1.0,
            light: 1.0,
            paint: Paint::default(),
            sill_m: [f32::INFINITY; 2],
            is_busy: false,
        };
        Self {
            rays: vec![empty; RAYS],
            movers: vec![[NOBODY; 2]; RAYS],
            forward: [1.0, 0.0],
            spread: HALF_VIEW,
        }
    }

    /// Tangent of a ray.
    fn tangent(&self, ray: usize) -> f64 {
        ((ray as f64 + 0.5) / RAYS as f64 * 2.0 - 1.0) * self.spread
    }

    /// Casts all rays. `aspect`: height of the picture over its width.
    pub(super) fn cast(&mut self, scenery: &Scenery, shot: &Shot, aspect: f64) {
        let ahead = shot.axes[0];
        let level = ahead.norm_xy();
        // Straight up or down there is no forward: keep the last.
        if level > 1e-3 {
            self.forward = [ahead.x() / level, ahead.y() / level];
        }
        let [fx, fy] = self.forward;
        // As wide as the corners of the picture look.
        let corners = [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]].map(|[x, y]| {
            let d = ahead + (shot.axes[1] * x + shot.axes[2] * (y * aspect)) * HALF_VIEW;
            let (a, r) = (d.x() * fx + d.y() * fy, d.x() * fy - d.y() * fx);
            if a > 0.1 { (r / a).abs() } else { WIDEST }
        });
        self.spread = corners.into_iter().fold(HALF_VIEW, f64::max).min(WIDEST) * 1.002;
        let eye = [shot.eye.x(), shot.eye.y()];
        self.movers.fill([NOBODY; 2]);
        for i in 0..RAYS {
            let t = self.tangent(i);
            let ray = &mut self.rays[i];
            let stretch = (1.0 + t * t).sqrt();
            let direction = [(fx + t * fy) / stretch, (fy - t * fx) / stretch];
            ray.is_busy = false;
            ray.sill_m = scenery.sill(eye, [fx + t * fy, fy - t * fx]);
            let Some(hit) = scenery.walls.cast(eye, direction, FAR_M) else {
                ray.wall_m = f32::INFINITY;
                continue;
            };
            let at = [0, 1].map(|k| eye[k] + direction[k] * hit.distance_m);
            let start = scenery.walls.segments()[hit.segment as usize].a;
            let (paint, light) = scenery.surface(hit.segment, at);
            ray.wall_m = (hit.distance_m / stretch) as f32;
            let along_m = geometry::distance(start, at);
            ray.is_joint = match paint.pattern {
                Pattern::Wall => along_m % PANEL_M < 0.018,
                Pattern::Furniture => along_m % LEAF_M < 0.018,
                Pattern::Plain => false,
            };
            ray.sharp = (1.2 - 0.14 * ray.wall_m).clamp(0.0, 1.0);
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
            let i = (t / self.spread + 1.0) * 0.5 * RAYS as f64;
            i.clamp(0.0, RAYS as f64) as usize
        };
        let span = ray_of(right / ahead - reach)..ray_of(right / ahead + reach);
        for i in span {
            let t = self.tangent(i);
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
            ray.is_busy = true;
            let nearest = &mut self.movers[i];
            if seen.distance_m < nearest[0].distance_m {
                *nearest = [seen, nearest[0]];
            } else if seen.distance_m < nearest[1].distance_m {
                nearest[1] = seen;
            }
        }
    }
}
