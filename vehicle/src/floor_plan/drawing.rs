//! A floor plan from a picture of one: a scan, an export, a photograph of the fire escape plan, and what a person marks on it.
//!
//! Marks are in pixels of the picture, x to the right, y down from the upper left corner, as every picture viewer shows them.
//! Order of the work: pixels to cells, rubber, specks, walls drawn by hand, doors, and last what lies outside the building.

use super::{Cell, Doorway, FloorPlan, PlanError, Room, load};
use crate::MapPose;
use thiserror::Error;

/// A door opens everything within this distance of the line between its jambs, m: walls are up to 0.6 m thick.
const DOOR_REACH_M: f64 = 0.3;
/// A wall drawn by hand is this thick, m.
const WALL_M: f64 = 0.1;

/// A point of the picture: x right, y down, pixels.
pub type Pixel = [f64; 2];

/// What a person marks on the picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Marks {
    /// Two points and the distance between them, m.
    pub scale: (Pixel, Pixel, f64),
    /// Cells of the plan, m.
    pub resolution_m: f64,
    /// Darker than this (0 black, 255 white) is wall.
    pub threshold: u8,
    /// Direction of north on the picture, degrees counter-clockwise from its right edge; 90 is up.
    pub north_deg: f64,
    /// Take-off place, and heading in degrees counter-clockwise from the picture's right.
    pub home: Option<(Pixel, f64)>,
    /// Rooms by name, each with a point inside.
    pub rooms: Vec<(String, Pixel)>,
    /// Doors by name, each with its two jambs.
    pub doors: Vec<(String, Pixel, Pixel)>,
    /// Walls that the picture lacks.
    pub walls: Vec<(Pixel, Pixel)>,
    /// Corners of zones not to be flown over.
    pub no_fly: Vec<Vec<Pixel>>,
    /// Corners of what the rubber takes away: words, furniture, dimension lines.
    pub erased: Vec<Vec<Pixel>>,
    /// Marks smaller than this that touch nothing are no walls, m.
    pub speck_m: f64,
}

impl Marks {
    /// Only the scale; north is up.
    #[must_use]
    pub const fn new(a: Pixel, b: Pixel, metres: f64) -> Self {
        Self {
            scale: (a, b, metres),
            resolution_m: 0.05,
            threshold: 128,
            north_deg: 90.0,
            home: None,
            rooms: Vec::new(),
            doors: Vec::new(),
            walls: Vec::new(),
            no_fly: Vec::new(),
            erased: Vec::new(),
            speck_m: 0.15,
        }
    }
}

/// Why a picture does not become a plan.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DrawingError {
    /// The picture, or the plan made from it.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The two points of the scale.
    #[error("the scale needs two different points and the metres between them")]
    Scale,
    /// A mark lies off the picture.
    #[error("{what} at pixel {x:.0}, {y:.0} is off the picture of {width} x {height} pixels")]
    Off {
        /// Which mark.
        what: String,
        /// Where, pixels.
        x: f64,
        /// Where, pixels.
        y: f64,
        /// Size of the picture.
        width: usize,
        /// Size of the picture.
        height: usize,
    },
    /// An area without area.
    #[error("{0} needs two opposite corners or at least three corners")]
    Area(&'static str),
}

/// Makes a plan from a picture (PNG or PGM) and marks. The plan's origin is the lower left corner of the picture.
///
/// # Errors
/// [`DrawingError`] names the mark, or what is wrong with the picture.
pub fn from_drawing(bytes: &[u8], marks: &Marks) -> Result<FloorPlan, DrawingError> {
    let (width, pixels) = load::gray_pixels(bytes)?;
    let height = pixels.len() / width;
    let (a, b, metres) = marks.scale;
    let apart = libm::hypot(b[0] - a[0], b[1] - a[1]);
    if !(apart > 0.0 && metres > 0.0 && metres.is_finite() && apart.is_finite()) {
        return Err(DrawingError::Scale);
    }
    let page = Page {
        width,
        height,
        m_per_px: metres / apart,
    };
    page.check(marks)?;
    let cell_m = marks.resolution_m;
    let size = |px: usize| libm::ceil(px as f64 * page.m_per_px / cell_m - 1e-9).max(1.0);
    let (columns, rows) = (size(width), size(height));
    let fits = columns * rows <= super::MAX_PIXELS as f64;
    // Also what is no number is too large.
    if !fits {
        return Err(PlanError::TooLarge {
            pixels: (columns * rows) as u64,
        }
        .into());
    }
    let (columns, rows) = (columns as usize, rows as usize);
    let mut cells = vec![Cell::Free; columns * rows];
    // A thin line is a wall however large a cell is; a cell smaller than a pixel takes the pixel it lies in.
    let per_cell = cell_m / page.m_per_px;
    let range = |k: usize, n: usize| {
        let from = libm::floor(k as f64 * per_cell + 1e-9) as usize;
        let to = (libm::ceil((k + 1) as f64 * per_cell - 1e-9) as usize).max(from + 1);
        from.min(n - 1)..to.min(n)
    };
    for row in 0..rows {
        // Rows of the picture run down, from its lower edge here.
        let lines = range(row, height);
        for column in 0..columns {
            let is_dark = lines.clone().any(|up| {
                let line = &pixels[(height - 1 - up) * width..];
                range(column, width).any(|x| line[x] < marks.threshold)
            });
            if is_dark {
                cells[row * columns + column] = Cell::Occupied;
            }
        }
    }
    let mut sheet = Sheet {
        columns,
        rows,
        cell_m,
        cells,
    };
    for area in &marks.erased {
        let corners: Vec<_> = area.iter().map(|p| page.metres(*p)).collect();
        sheet.set_where(|at| covers(&corners, at), Cell::Free);
    }
    sheet.drop_specks(marks.speck_m);
    for (a, b) in &marks.walls {
        let (a, b) = (page.metres(*a), page.metres(*b));
        sheet.set_where(|at| beside(a, b, at, true) <= 0.5 * WALL_M, Cell::Occupied);
    }
    for (_, a, b) in &marks.doors {
        let (a, b) = (page.metres(*a), page.metres(*b));
        sheet.set_where(|at| beside(a, b, at, false) <= DOOR_REACH_M, Cell::Free);
    }
    let inside: Vec<_> = marks
        .home
        .iter()
        .map(|(p, _)| page.metres(*p))
        .chain(marks.rooms.iter().map(|(_, p)| page.metres(*p)))
        .collect();
    sheet.blot_outside(&inside);

    if !sheet.cells.contains(&Cell::Free) {
        return Err(PlanError::NoFreeCell.into());
    }
    let mut plan = FloorPlan::from_cells(columns, cell_m, [0.0, 0.0], sheet.cells)?;
    plan.north_rad = marks.north_deg.to_radians();
    plan.home = marks.home.map(|(p, heading_deg)| {
        let [x, y] = page.metres(p);
        MapPose::new(x, y, heading_deg.to_radians())
    });
    plan.rooms = marks
        .rooms
        .iter()
        .map(|(name, p)| {
            let [x, y] = page.metres(*p);
            Room {
                name: name.clone(),
                x,
                y,
            }
        })
        .collect();
    plan.doors = marks
        .doors
        .iter()
        .map(|(name, a, b)| Doorway {
            name: name.clone(),
            a: page.metres(*a),
            b: page.metres(*b),
        })
        .collect();
    plan.no_fly = marks
        .no_fly
        .iter()
        .map(|zone| boxed(zone.iter().map(|p| page.metres(*p)).collect()))
        .collect();
    Ok(plan)
}

/// The picture's size and scale.
struct Page {
    width: usize,
    height: usize,
    m_per_px: f64,
}

impl Page {
    fn metres(&self, [x, y]: Pixel) -> [f64; 2] {
        [x * self.m_per_px, (self.height as f64 - y) * self.m_per_px]
    }

    fn check(&self, marks: &Marks) -> Result<(), DrawingError> {
        let on = |what: &dyn Fn() -> String, [x, y]: Pixel| {
            let inside =
                (0.0..=self.width as f64).contains(&x) && (0.0..=self.height as f64).contains(&y);
            if inside {
                Ok(())
            } else {
                Err(DrawingError::Off {
                    what: what(),
                    x,
                    y,
                    width: self.width,
                    height: self.height,
                })
            }
        };
        if let Some((p, _)) = marks.home {
            on(&|| "home".to_owned(), p)?;
        }
        for (name, p) in &marks.rooms {
            on(&|| format!("room `{name}`"), *p)?;
        }
        for (name, a, b) in &marks.doors {
            on(&|| format!("door `{name}`"), *a)?;
            on(&|| format!("door `{name}`"), *b)?;
        }
        for p in marks.walls.iter().flat_map(|(a, b)| [a, b]) {
            on(&|| "a wall".to_owned(), *p)?;
        }
        for p in marks.no_fly.iter().chain(&marks.erased).flatten() {
            on(&|| "a zone".to_owned(), *p)?;
        }
        if marks.no_fly.iter().any(|z| z.len() < 2) {
            return Err(DrawingError::Area("a no-fly zone"));
        }
        if marks.erased.iter().any(|z| z.len() < 2) {
            return Err(DrawingError::Area("the rubber"));
        }
        Ok(())
    }
}

/// The plan being made.
struct Sheet {
    columns: usize,
    rows: usize,
    cell_m: f64,
    cells: Vec<Cell>,
}

impl Sheet {
    fn set_where(&mut self, is_it: impl Fn([f64; 2]) -> bool, to: Cell) {
        for (i, cell) in self.cells.iter_mut().enumerate() {
            let (c, r) = (i % self.columns, i / self.columns);
            let at = [c, r].map(|k| (k as f64 + 0.5) * self.cell_m);
            if is_it(at) {
                *cell = to;
            }
        }
    }

    /// Calls `visit` with each group of cells of a kind that hang together, diagonals counted for walls.
    fn group(&self, from: usize, is_kind: &dyn Fn(Cell) -> bool, seen: &mut [bool]) -> Vec<usize> {
        let mut out = Vec::new();
        let mut stack = vec![from];
        seen[from] = true;
        while let Some(i) = stack.pop() {
            out.push(i);
            let (c, r) = (i % self.columns, i / self.columns);
            let diagonal = self.cells[from] == Cell::Occupied;
            for dr in -1_i64..=1 {
                for dc in -1_i64..=1 {
                    if !diagonal && dc != 0 && dr != 0 {
                        continue;
                    }
                    let (x, y) = (c as i64 + dc, r as i64 + dr);
                    if x < 0 || y < 0 || x >= self.columns as i64 || y >= self.rows as i64 {
                        continue;
                    }
                    let j = y as usize * self.columns + x as usize;
                    if !seen[j] && is_kind(self.cells[j]) {
                        seen[j] = true;
                        stack.push(j);
                    }
                }
            }
        }
        out
    }

    fn drop_specks(&mut self, smaller_m: f64) {
        let mut seen = vec![false; self.cells.len()];
        for i in 0..self.cells.len() {
            if seen[i] || self.cells[i] != Cell::Occupied {
                continue;
            }
            let group = self.group(i, &|c| c == Cell::Occupied, &mut seen);
            let span = |of: &dyn Fn(usize) -> usize| {
                let low = group.iter().map(|i| of(*i)).min().unwrap_or(0);
                let high = group.iter().map(|i| of(*i)).max().unwrap_or(0);
                (high - low + 1) as f64 * self.cell_m
            };
            let size_m = span(&|i| i % self.columns).max(span(&|i| i / self.columns));
            if size_m < smaller_m {
                for i in group {
                    self.cells[i] = Cell::Free;
                }
            }
        }
    }

    /// The paper around the building is not floor; left as it is where it cannot be told from a room.
    fn blot_outside(&mut self, inside: &[[f64; 2]]) {
        let rooms: Vec<usize> = inside
            .iter()
            .map(|p| {
                let k =
                    |v: f64, n: usize| (libm::floor(v / self.cell_m).max(0.0) as usize).min(n - 1);
                k(p[1], self.rows) * self.columns + k(p[0], self.columns)
            })
            .collect();
        let mut seen = vec![false; self.cells.len()];
        for i in 0..self.cells.len() {
            let (c, r) = (i % self.columns, i / self.columns);
            let is_edge = c == 0 || r == 0 || c + 1 == self.columns || r + 1 == self.rows;
            if !is_edge || seen[i] || self.cells[i] == Cell::Occupied {
                continue;
            }
            let group = self.group(i, &|c| c != Cell::Occupied, &mut seen);
            if !rooms.iter().any(|room| group.contains(room)) {
                for i in group {
                    self.cells[i] = Cell::Unknown;
                }
            }
        }
    }
}

/// Two corners are those of a box.
fn boxed(corners: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    match corners[..] {
        [a, b] => vec![a, [b[0], a[1]], b, [a[0], b[1]]],
        _ => corners,
    }
}

fn covers(corners: &[[f64; 2]], at: [f64; 2]) -> bool {
    let corners = boxed(corners.to_vec());
    let mut inside = false;
    let mut last = corners.len().wrapping_sub(1);
    for i in 0..corners.len() {
        let (a, b) = (corners[last], corners[i]);
        if (a[1] > at[1]) != (b[1] > at[1])
            && at[0] < (b[0] - a[0]) * (at[1] - a[1]) / (b[1] - a[1]) + a[0]
        {
            inside = !inside;
        }
        last = i;
    }
    inside
}

/// Distance to a line; beyond its ends too, or infinite there.
fn beside(a: [f64; 2], b: [f64; 2], at: [f64; 2], with_ends: bool) -> f64 {
    let (abx, aby) = (b[0] - a[0], b[1] - a[1]);
    let length2 = abx * abx + aby * aby;
    let t = if length2 > 0.0 {
        ((at[0] - a[0]) * abx + (at[1] - a[1]) * aby) / length2
    } else {
        0.0
    };
    if !with_ends && !(0.0..=1.0).contains(&t) {
        return f64::INFINITY;
    }
    let t = t.clamp(0.0, 1.0);
    libm::hypot(a[0] + t * abx - at[0], a[1] + t * aby - at[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::In;
    use crate::floor_plan::check::{Finding, check};
    use proptest::prelude::*;

    /// 100 x 80 pixels of 5 cm: two rooms side by side behind lines of one pixel, a word, a dot; `gap` pixels are missing in the
    /// outer wall, the wall between the rooms has no door.
    fn picture(gap: usize) -> Vec<u8> {
        let mut px = vec![255u8; 100 * 80];
        for x in 10..=90 {
            px[10 * 100 + x] = 0;
            px[70 * 100 + x] = 0;
        }
        for y in 10..=70 {
            px[y * 100 + 10] = 0;
            px[y * 100 + 50] = 0;
            px[y * 100 + 90] = 0;
        }
        for x in 20..20 + gap {
            px[10 * 100 + x] = 255;
        }
        for x in 60..80 {
            px[40 * 100 + x] = 90;
        }
        px[30 * 100 + 30] = 0;
        let mut out = b"P5\n100 80\n255\n".to_vec();
        out.extend(px);
        out
    }

    fn marks() -> Marks {
        Marks {
            home: Some(([30.0, 60.0], 90.0)),
            rooms: vec![
                ("west".to_owned(), [30.0, 40.0]),
                ("east".to_owned(), [70.0, 60.0]),
            ],
            doors: vec![("west-east".to_owned(), [50.0, 45.0], [50.0, 63.0])],
            no_fly: vec![vec![[80.0, 12.0], [88.0, 20.0]]],
            erased: vec![vec![[58.0, 38.0], [82.0, 43.0]]],
            ..Marks::new([10.0, 10.0], [90.0, 10.0], 4.0)
        }
    }

    #[test]
    fn a_drawing_with_its_marks_becomes_a_plan_without_faults() {
        let plan = from_drawing(&picture(0), &marks()).unwrap();
        assert_eq!((plan.width(), plan.height()), (100, 80));
        let at = |x: f64, y: f64| plan.at(In::new(0.05 * x + 0.01, 0.05 * (80.0 - y) - 0.01, 0.0));
        assert_eq!(
            at(10.0, 40.0),
            Cell::Occupied,
            "a line of one pixel is a wall"
        );
        assert_eq!(at(70.0, 40.0), Cell::Free, "the rubber took the word");
        assert_eq!(at(30.0, 30.0), Cell::Free, "a dot is no wall");
        assert_eq!(at(50.0, 54.0), Cell::Free, "the door is open");
        assert_eq!(at(50.0, 30.0), Cell::Occupied);
        assert_eq!(at(3.0, 3.0), Cell::Unknown, "outside");
        let home = plan.home.unwrap();
        assert!((home.x_m - 1.5).abs() < 1e-9 && (home.y_m - 1.0).abs() < 1e-9);
        assert_eq!(plan.no_fly[0].len(), 4);
        assert_eq!(check(&plan, 0.16), []);
    }

    #[test]
    fn a_gap_in_the_wall_is_found_where_it_is() {
        let plan = from_drawing(&picture(4), &marks()).unwrap();
        let found = check(&plan, 0.16);
        let [Finding::Open { at, width_m }] = found[..] else {
            panic!("{found:?}");
        };
        assert!(
            (at[0] - 1.1).abs() < 0.15 && (at[1] - 3.5).abs() < 0.15,
            "{at:?}"
        );
        assert!((0.1..=0.3).contains(&width_m), "{width_m}");
        let closed = Marks {
            walls: vec![([18.0, 10.0], [26.0, 10.0])],
            ..marks()
        };
        assert_eq!(
            check(&from_drawing(&picture(4), &closed).unwrap(), 0.16),
            []
        );
    }

    #[test]
    fn a_room_that_no_door_reaches_is_named() {
        let shut = Marks {
            doors: Vec::new(),
            ..marks()
        };
        let found = check(&from_drawing(&picture(0), &shut).unwrap(), 0.16);
        assert_eq!(
            found.iter().map(ToString::to_string).collect::<Vec<_>>(),
            ["room `east`: no door reaches it from home"]
        );
        let narrow = Marks {
            doors: vec![("crack".to_owned(), [50.0, 50.0], [50.0, 54.0])],
            ..marks()
        };
        let found = check(&from_drawing(&picture(0), &narrow).unwrap(), 0.16);
        assert!(
            found[0].to_string().contains("about 0.15 m wide"),
            "{}",
            found[0]
        );
    }

    #[test]
    fn marks_off_the_picture_and_a_scale_without_length_are_refused() {
        let refused = |m: Marks| from_drawing(&picture(0), &m).unwrap_err().to_string();
        let off = Marks {
            rooms: vec![("attic".to_owned(), [300.0, 4.0])],
            ..marks()
        };
        assert!(
            refused(off).contains("room `attic` at pixel 300, 4 is off the picture of 100 x 80")
        );
        let flat = Marks::new([5.0, 5.0], [5.0, 5.0], 1.0);
        assert!(refused(flat).contains("two different points"));
        let nan = Marks::new([5.0, 5.0], [9.0, 5.0], f64::NAN);
        assert!(refused(nan).contains("two different points"));
        let one = Marks {
            no_fly: vec![vec![[5.0, 5.0]]],
            ..marks()
        };
        assert!(refused(one).contains("a no-fly zone needs"));
        assert!(from_drawing(b"no picture", &marks()).is_err());
    }

    proptest! {
        #[test]
        fn whatever_is_marked_nothing_panics(x in -50.0..200.0f64, y in -50.0..200.0f64, m in 0.01..2000.0f64,
                                             resolution_m in 0.001..2.0f64) {
            let marks = Marks { resolution_m, home: Some(([x, y], 0.0)), ..Marks::new([0.0, 0.0], [x, y], m) };
            if let Ok(plan) = from_drawing(&picture(3), &marks) {
                let _ = check(&plan, 0.16);
            }
        }
    }
}
