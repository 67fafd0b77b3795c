//! Pixels: each looks its direction up in the fan, and decides between wall, floor, ceiling and whoever stands before them.

use super::fan::{Fan, RAYS, Ray, Seen, fade};
use super::scenery::{Pattern, Scenery};
use super::{HALF_VIEW, Mover, Picture, Shot};
use crate::world::CEILING_M;

/// Side of a floor tile, m.
const TILE_M: f32 = 0.5;
/// Distance between lamps, m.
const LAMPS_M: [f32; 2] = [2.4, 3.0];
/// Half of a lamp, m.
const LAMP_M: [f32; 2] = [0.60, 0.12];
/// Height of a board, m.
const BOARD_M: f32 = 0.42;
/// Height of a neck, m: above it a person is narrow.
const NECK_M: f32 = 1.48;
/// Height of a belt, m.
const BELT_M: f32 = 0.95;

/// The table of light by distance: finely enough for eight bits.
const FADE_STEPS: usize = 1024;
const FADE_STEPS_PER_M: f32 = 16.0;

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
    fades: [f32; FADE_STEPS],
}

impl Camera {
    /// A camera in a room.
    #[must_use]
    pub fn new(scenery: Scenery) -> Self {
        Self {
            scenery,
            fan: Fan::new(),
            fades: core::array::from_fn(|i| fade((i as f32 + 0.5) / FADE_STEPS_PER_M)),
        }
    }

    /// Draws a shot over the whole picture. The same shot gives the same picture.
    pub fn render(&mut self, shot: &Shot, picture: &mut Picture) {
        let (width, height) = (picture.width, picture.height);
        if width == 0 || height == 0 {
            return;
        }
        self.fan
            .cast(&self.scenery, shot, height as f64 / width as f64);
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
            fan: &self.fan,
            movers: &shot.movers,
            eye,
            forward: [fx as f32, fy as f32],
            spread: self.fan.spread as f32,
            fades: &self.fades,
            per_tangent: RAYS as f32 / (2.0 * self.fan.spread as f32),
        };
        for row in 0..height {
            let y = (row as f64 + 0.5 - 0.5 * height as f64) * pixel;
            let x = (0.5 - 0.5 * width as f64) * pixel;
            let start: [f32; 3] =
                core::array::from_fn(|k| (ahead[k] + x * right[k] + y * down[k]) as f32);
            let line = &mut picture.y[row * width..(row + 1) * width];
            let colours = row / 2 * (width / 2);
            for (n, pixels) in line.chunks_mut(BLOCK).enumerate() {
                let first = n * BLOCK;
                let block = look.aim(start, step, first);
                for (k, luma) in pixels.iter_mut().enumerate() {
                    let c = look.pixel(&block, k);
                    *luma = c.y as u8;
                    if (row | k) & 1 == 0 {
                        let at = colours + (first + k) / 2;
                        picture.u[at] = c.uv[0];
                        picture.v[at] = c.uv[1];
                    }
                }
            }
        }
    }
}

/// Pixels of a row that are aimed together: divisions side by side cost a quarter.
const BLOCK: usize = 16;

/// Where the pixels of a block look.
struct Block {
    /// Forward part of the direction.
    ahead: [f32; BLOCK],
    /// Upward part.
    up: [f32; BLOCK],
    /// Right over forward.
    tangent: [f32; BLOCK],
    /// Up over forward.
    slope: [f32; BLOCK],
    /// Forward over up.
    reach: [f32; BLOCK],
    /// Which ray.
    ray: [i32; BLOCK],
}

/// What a pixel needs to know.
struct Look<'a> {
    fan: &'a Fan,
    movers: &'a [Mover],
    eye: [f32; 3],
    forward: [f32; 2],
    /// Tangent of the outermost ray.
    spread: f32,
    /// Rays per unit of tangent.
    per_tangent: f32,
    fades: &'a [f32; FADE_STEPS],
}

impl Look<'_> {
    /// `direction`: ahead and right on the plan, up; any length.
    #[inline]
    fn aim(&self, start: [f32; 3], step: [f32; 3], first: usize) -> Block {
        let mut b = Block {
            ahead: [0.0; BLOCK],
            up: [0.0; BLOCK],
            tangent: [0.0; BLOCK],
            slope: [0.0; BLOCK],
            reach: [0.0; BLOCK],
            ray: [0; BLOCK],
        };
        let begin = first as f32;
        for k in 0..BLOCK {
            let n = begin + k as f32;
            let ahead = start[0] + n * step[0];
            let up = start[2] + n * step[2];
            let inverse = 1.0 / ahead;
            b.ahead[k] = ahead;
            b.up[k] = up;
            b.tangent[k] = (start[1] + n * step[1]) * inverse;
            b.slope[k] = up * inverse;
            b.reach[k] = ahead / up;
        }
        for k in 0..BLOCK {
            b.ray[k] = ((b.tangent[k] + self.spread) * self.per_tangent) as i32;
        }
        b
    }

    #[inline]
    fn pixel(&self, block: &Block, k: usize) -> Colour {
        // Behind the lens: only a camera that looks straight up or down gets there.
        if block.ahead[k] < 0.05 {
            let y = if block.up[k] > 0.0 { 150.0 } else { 96.0 };
            return colour(y, 128, 128);
        }
        let (tangent, slope) = (block.tangent[k], block.slope[k]);
        let i = block.ray[k].clamp(0, RAYS as i32 - 1) as usize;
        let ray = &self.fan.rays[i];
        if ray.is_busy {
            for seen in &self.fan.movers[i] {
                if seen.distance_m < f32::INFINITY
                    && let Some(c) = self.mover(seen, slope)
                {
                    return c;
                }
            }
        }
        let z = self.eye[2] + slope * ray.wall_m;
        if z < 0.0 || (slope < 0.0 && !z.is_finite()) {
            self.floor(ray, tangent, -self.eye[2] * block.reach[k])
        } else if z > CEILING_M as f32 || !z.is_finite() {
            self.ceiling(tangent, (CEILING_M as f32 - self.eye[2]) * block.reach[k])
        } else {
            wall(ray, z)
        }
    }

    /// Light left at a distance, from a table.
    #[inline]
    fn faded(&self, distance_m: f32) -> f32 {
        let i = (distance_m * FADE_STEPS_PER_M) as usize;
        self.fades[i.min(FADE_STEPS - 1)]
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
    fn floor(&self, ray: &Ray, tangent: f32, ahead_m: f32) -> Colour {
        let [sill, end] = ray.sill_m;
        if sill <= ahead_m && ahead_m <= end {
            return colour(88.0 * self.faded(ahead_m), 112, 144);
        }
        let [x, y] = self.place(tangent, ahead_m);
        // Far tiles would flicker: they melt into their mean.
        let sharp = (1.2 - 0.16 * ahead_m).clamp(0.0, 1.0);
        let (u, v) = ((x + 1000.0) * (1.0 / TILE_M), (y + 1000.0) * (1.0 / TILE_M));
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
        colour((112.0 + sharp * tone) * self.faded(ahead_m), 122, 131)
    }

    #[inline]
    fn ceiling(&self, tangent: f32, ahead_m: f32) -> Colour {
        let [x, y] = self.place(tangent, ahead_m);
        let off = |v: f32, period: f32| {
            let n = v * (1.0 / period) + 1000.0;
            ((n - (n as i32) as f32) - 0.5) * period
        };
        let (dx, dy) = (off(x, LAMPS_M[0]), off(y, LAMPS_M[1]));
        if dx.abs() < LAMP_M[0] && dy.abs() < LAMP_M[1] {
            return colour(234.0, 126, 129);
        }
        let near = (dx * dx + dy * dy).min(2.0);
        colour((186.0 - 14.0 * near) * self.faded(ahead_m), 127, 129)
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
        let round = (1.0 - 0.45 * seen.aside * seen.aside) * self.faded(seen.distance_m);
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
    let tone = match paint.pattern {
        Pattern::Plain => 0.0,
        Pattern::Wall if z < 0.09 => -78.0,
        Pattern::Wall if z > CEILING_M as f32 - 0.06 => 18.0,
        Pattern::Wall if ray.is_joint || (z - 0.95).abs() < 0.02 => -24.0 * ray.sharp,
        Pattern::Wall => 6.0 * (z - 1.2),
        Pattern::Furniture => {
            let board = z * (1.0 / BOARD_M);
            let is_edge = board - (board as i32 as f32) < 0.06;
            if ray.is_joint || is_edge {
                -38.0 * ray.sharp
            } else {
                0.0
            }
        }
    };
    Colour {
        y: ((paint.y + tone) * ray.light).clamp(16.0, 235.0),
        uv: paint.uv,
    }
}
