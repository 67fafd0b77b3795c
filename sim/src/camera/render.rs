//! Pixels: each looks its direction up in the fan, and decides between wall, floor, ceiling and whoever stands before them.

use super::fan::{Fan, RAYS, Ray, SPREAD, Seen, fade};
use super::scenery::{Pattern, Scenery};
use super::{HALF_VIEW, Mover, Picture, Shot};
use crate::world::CEILING_M;

/// Side of a floor tile, m.
const TILE_M: f32 = 0.5;
/// Distance between lamps, m.
const LAMPS_M: [f32; 2] = [2.4, 3.0];
/// Half of a lamp, m.
const LAMP_M: [f32; 2] = [0.60, 0.12];
/// Height of a neck, m: above it a person is narrow.
const NECK_M: f32 = 1.48;
/// Height of a belt, m.
const BELT_M: f32 = 0.95;

/// A brightness, and the two colour differences.
#[derive(Clone, Copy)]
struct Colour {
    y: f32,
    uv: [u8; 2],
}

const fn colour(y: f32, u: u8, v: u8) -> Colour {
    Colour { y, uv: [u, v] }
}

/// Draws what a vehicle's camera sees.
#[derive(Clone, Debug)]
pub struct Camera {
    scenery: Scenery,
    fan: Fan,
}

impl Camera {
    /// A camera in a room.
    #[must_use]
    pub fn new(scenery: Scenery) -> Self {
        Self {
            scenery,
            fan: Fan::new(),
        }
    }

    /// Draws a shot over the whole picture. The same shot gives the same picture.
    pub fn render(&mut self, shot: &Shot, picture: &mut Picture) {
        self.fan.cast(&self.scenery, shot);
        let (width, height) = (picture.width, picture.height);
        let [fx, fy] = self.fan.forward;
        // Of the three axes: ahead and right on the plan, and up.
        let part = |axis: usize| {
            let v = shot.axes[axis];
            [v.x() * fx + v.y() * fy, v.x() * fy - v.y() * fx, v.z()]
        };
        let (ahead, right, down) = (part(0), part(1), part(2));
        let pixel = 2.0 * HALF_VIEW / width as f64;
        let step = right.map(|v| (v * pixel) as f32);
        let eye = [shot.eye.x(), shot.eye.y(), shot.eye.z()].map(|v| v as f32);
        let look = Look {
            scenery: &self.scenery,
            movers: &shot.movers,
            eye,
            forward: [fx as f32, fy as f32],
        };
        for row in 0..height {
            let y = (row as f64 + 0.5 - 0.5 * height as f64) * pixel;
            let x = (0.5 - 0.5 * width as f64) * pixel;
            let start: [f32; 3] =
                core::array::from_fn(|k| (ahead[k] + x * right[k] + y * down[k]) as f32);
            let line = &mut picture.y[row * width..(row + 1) * width];
            let is_colour_row = row % 2 == 0;
            let colours = row / 2 * (width / 2);
            for (column, luma) in line.iter_mut().enumerate() {
                let n = column as f32;
                let c = look.pixel(&self.fan.rays, [0, 1, 2].map(|k| start[k] + n * step[k]));
                *luma = c.y as u8;
                if is_colour_row && column % 2 == 0 {
                    picture.u[colours + column / 2] = c.uv[0];
                    picture.v[colours + column / 2] = c.uv[1];
                }
            }
        }
    }
}

/// What a pixel needs to know.
struct Look<'a> {
    scenery: &'a Scenery,
    movers: &'a [Mover],
    eye: [f32; 3],
    forward: [f32; 2],
}

impl Look<'_> {
    /// `direction`: ahead and right on the plan, up; any length.
    #[inline]
    fn pixel(&self, rays: &[Ray], [ahead, right, up]: [f32; 3]) -> Colour {
        const PER_TANGENT: f32 = RAYS as f32 / (2.0 * SPREAD);
        // Behind the lens: only a camera that looks straight up or down gets there.
        if ahead < 0.05 {
            let y = if up > 0.0 { 150.0 } else { 96.0 };
            return colour(y, 128, 128);
        }
        let (tangent, slope) = (right / ahead, up / ahead);
        let i = ((tangent + SPREAD) * PER_TANGENT) as usize;
        let ray = &rays[i.min(RAYS - 1)];
        for seen in &ray.movers {
            if seen.distance_m < f32::INFINITY
                && let Some(c) = self.mover(seen, slope)
            {
                return c;
            }
        }
        let z = self.eye[2] + slope * ray.wall_m;
        if z < 0.0 || (slope < 0.0 && !z.is_finite()) {
            self.floor(tangent, self.eye[2] / -slope)
        } else if z > CEILING_M as f32 || !z.is_finite() {
            self.ceiling(tangent, (CEILING_M as f32 - self.eye[2]) / slope)
        } else {
            wall(ray, z)
        }
    }

    /// A point of the plan: this far ahead in a direction.
    #[inline]
    fn place(&self, tangent: f32, ahead_m: f32) -> [f32; 2] {
        let [fx, fy] = self.forward;
        [
            self.eye[0] + ahead_m * (fx + tangent * fy),
            self.eye[1] + ahead_m * (fy - tangent * fx),
        ]
    }

    #[inline]
    fn floor(&self, tangent: f32, ahead_m: f32) -> Colour {
        let [x, y] = self.place(tangent, ahead_m);
        for [x0, x1, y0, y1] in &self.scenery.thresholds {
            if (*x0..=*x1).contains(&x) && (*y0..=*y1).contains(&y) {
                return colour(88.0 * fade(ahead_m), 112, 144);
            }
        }
        // Far tiles would flicker: they melt into their mean.
        let sharp = (1.2 - 0.16 * ahead_m).clamp(0.0, 1.0);
        let (u, v) = ((x + 1000.0) / TILE_M, (y + 1000.0) / TILE_M);
        let (iu, iv) = (u as i32, v as i32);
        let is_dark = (iu + iv) & 1 == 1;
        let (du, dv) = (u - iu as f32, v - iv as f32);
        let joint = du.min(dv) < 0.03;
        let tone = if joint {
            -26.0
        } else if is_dark {
            -7.0
        } else {
            7.0
        };
        colour((112.0 + sharp * tone) * fade(ahead_m), 122, 131)
    }

    #[inline]
    fn ceiling(&self, tangent: f32, ahead_m: f32) -> Colour {
        let [x, y] = self.place(tangent, ahead_m);
        let off = |v: f32, period: f32| {
            let n = (v + 1000.0 * period) / period;
            ((n - (n as i32) as f32) - 0.5) * period
        };
        let (dx, dy) = (off(x, LAMPS_M[0]), off(y, LAMPS_M[1]));
        if dx.abs() < LAMP_M[0] && dy.abs() < LAMP_M[1] {
            return colour(234.0, 126, 129);
        }
        let near = (dx * dx + dy * dy).min(2.0);
        colour((186.0 - 14.0 * near) * fade(ahead_m), 127, 129)
    }

    /// A person or a vehicle, if the ray meets it at its height.
    #[inline]
    fn mover(&self, seen: &Seen, slope: f32) -> Option<Colour> {
        let mover = &self.movers[seen.mover as usize];
        let z = self.eye[2] + slope * seen.distance_m;
        let [low, high] = mover.heights_m.map(|v| v as f32);
        if !(low..=high).contains(&z) {
            return None;
        }
        // Round: darker towards the edges.
        let round = (1.0 - 0.45 * seen.aside * seen.aside) * fade(seen.distance_m);
        if !mover.is_person {
            return Some(colour(70.0 * round, 128, 150));
        }
        let half = seen.aside.abs();
        if z > NECK_M {
            return (half < 0.42).then(|| colour((158.0 * round).max(16.0), 112, 152));
        }
        if z < BELT_M {
            // Two legs.
            return (half > 0.06 && half < 0.72).then(|| colour(58.0 * round, 140, 120));
        }
        Some(colour(104.0 * round, 118, 172))
    }
}

#[inline]
fn wall(ray: &Ray, z: f32) -> Colour {
    let paint = ray.paint;
    let sharp = (1.2 - 0.14 * ray.wall_m).clamp(0.0, 1.0);
    let part = |v: f32| v - (v as i32) as f32;
    let tone = match paint.pattern {
        Pattern::Plain => 0.0,
        Pattern::Wall if z < 0.09 => -78.0,
        Pattern::Wall if z > CEILING_M as f32 - 0.06 => 18.0,
        Pattern::Wall => {
            let joint = part(ray.along_m / 1.2) < 0.015;
            let rail = (z - 0.95).abs() < 0.02;
            if joint || rail {
                -24.0 * sharp
            } else {
                6.0 * (z - 1.2)
            }
        }
        Pattern::Furniture => {
            let board = part(z / 0.42) < 0.06;
            let gap = part(ray.along_m / 0.6) < 0.03;
            if board || gap { -38.0 * sharp } else { 0.0 }
        }
    };
    Colour {
        y: ((paint.y + tone) * ray.light).clamp(16.0, 235.0),
        uv: paint.uv,
    }
}
