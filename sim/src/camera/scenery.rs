//! What a camera sees that does not move: walls, furniture, doors, and their colours.

use crate::geometry::Point;
use crate::room::Room;
use crate::walls::Walls;
use vehicle::Segment;

/// Jambs of doors are this wide on either side, m.
const JAMB_M: f64 = 0.07;
/// Thresholds are this deep, m.
const THRESHOLD_M: f64 = 0.16;

/// How a surface looks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Paint {
    /// Brightness in full light, 16..=235.
    pub(super) y: f32,
    /// Blue and red difference.
    pub(super) uv: [u8; 2],
    /// Pattern.
    pub(super) pattern: Pattern,
}

/// What is painted on a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Pattern {
    /// Skirting below, a rail above, joints between panels.
    #[default]
    Wall,
    /// Boards, and doors side by side.
    Furniture,
    /// Nothing.
    Plain,
}

const fn paint(y: f32, u: u8, v: u8, pattern: Pattern) -> Paint {
    Paint {
        y,
        uv: [u, v],
        pattern,
    }
}

/// Walls: every side of every wall has one of these.
const WALLS: [Paint; 6] = [
    paint(196.0, 124, 131, Pattern::Wall),
    paint(188.0, 132, 124, Pattern::Wall),
    paint(190.0, 120, 128, Pattern::Wall),
    paint(182.0, 128, 134, Pattern::Wall),
    paint(192.0, 134, 126, Pattern::Wall),
    paint(186.0, 122, 122, Pattern::Wall),
];
/// Furniture: wood, steel, green boards, dark wood.
const FURNITURE: [Paint; 4] = [
    paint(132.0, 106, 146, Pattern::Furniture),
    paint(138.0, 136, 122, Pattern::Furniture),
    paint(118.0, 118, 112, Pattern::Furniture),
    paint(96.0, 112, 142, Pattern::Furniture),
];
/// What the plan does not show: crates.
const CRATE: Paint = paint(150.0, 98, 156, Pattern::Furniture);
/// Frames of doors.
pub(super) const JAMB: Paint = paint(84.0, 114, 140, Pattern::Plain);

/// A room as a camera sees it.
#[derive(Clone, Debug)]
pub struct Scenery {
    pub(super) walls: Walls,
    paints: Vec<Paint>,
    /// Brightness by where a wall faces, 0..=1.
    light: Vec<f32>,
    jambs: Vec<Point>,
    /// Thresholds on the floor: x from, x to, y from, y to.
    thresholds: Vec<[f64; 4]>,
}

impl Scenery {
    /// The room with these walls (without glass: a camera looks through it). `walls_end`: segments before it are walls, those up
    /// to `furniture_end` furniture, the rest was put there later.
    pub(crate) fn new(room: &Room, walls: &Walls, walls_end: usize, furniture_end: usize) -> Self {
        let of = |i: usize| {
            // Four sides belong together; neighbours differ.
            let body = i / 4;
            if i < walls_end {
                WALLS[(body * 7 + i) % WALLS.len()]
            } else if i < furniture_end {
                FURNITURE[(body * 3 + body / 4) % FURNITURE.len()]
            } else {
                CRATE
            }
        };
        let mut jambs = Vec::new();
        let mut thresholds = Vec::new();
        for door in room.doors() {
            // A door lies across x or across y: the wall goes on beside it.
            let half = 0.5 * door.width_m;
            let is_wall = |x: f64, y: f64| walls.nearest([x, y], 0.08).is_some();
            let along_x = is_wall(door.x_m + half, door.y_m) || is_wall(door.x_m - half, door.y_m);
            let (dx, dy) = if along_x { (half, 0.0) } else { (0.0, half) };
            jambs.push([door.x_m - dx, door.y_m - dy]);
            jambs.push([door.x_m + dx, door.y_m + dy]);
            let (wx, wy) = if along_x {
                (half, 0.5 * THRESHOLD_M)
            } else {
                (0.5 * THRESHOLD_M, half)
            };
            let (x, y) = (door.x_m, door.y_m);
            thresholds.push([x - wx, x + wx, y - wy, y + wy]);
        }
        Self {
            paints: (0..walls.segments().len()).map(of).collect(),
            light: walls.segments().iter().map(light).collect(),
            walls: walls.clone(),
            jambs,
            thresholds,
        }
    }

    /// Where a ray along the floor crosses the nearest threshold, in lengths of `direction`: from, to; infinite if it crosses none.
    pub(super) fn sill(&self, eye: Point, direction: Point) -> [f32; 2] {
        let mut best = [f64::INFINITY; 2];
        for [x0, x1, y0, y1] in &self.thresholds {
            let (mut from, mut to) = (0.0_f64, f64::INFINITY);
            for (p, d, low, high) in [
                (eye[0], direction[0], x0, x1),
                (eye[1], direction[1], y0, y1),
            ] {
                // Parallel to a side, and beside it: the bounds are infinite with the right signs.
                let (a, b) = ((low - p) / d, (high - p) / d);
                from = from.max(a.min(b));
                to = to.min(a.max(b));
            }
            if from < to && from < best[0] {
                best = [from, to];
            }
        }
        best.map(|v| v as f32)
    }

    /// Paint and light of a segment where it is hit.
    pub(super) fn surface(&self, segment: u32, at: Point) -> (Paint, f32) {
        let i = segment as usize;
        let is_jamb = |j: &Point| {
            let (dx, dy) = ((j[0] - at[0]).abs(), (j[1] - at[1]).abs());
            dx.max(dy) < JAMB_M
        };
        let paint = if self.jambs.iter().any(is_jamb) {
            JAMB
        } else {
            self.paints[i]
        };
        (paint, self.light[i])
    }
}

/// Light falls in from one side, so that corners are seen.
fn light(s: &Segment) -> f32 {
    let (dx, dy) = (s.b[0] - s.a[0], s.b[1] - s.a[1]);
    let length = libm::hypot(dx, dy).max(1e-9);
    // Across the segment, and how far it faces north-east on the plan.
    let (nx, ny) = (dy / length, -dx / length);
    (0.80 + 0.14 * nx + 0.08 * ny) as f32
}
