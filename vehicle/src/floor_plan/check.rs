//! Is a plan fit to fly by? Walls that do not close, rooms no door reaches, places in walls.

use super::{Cell, FloorPlan};
use crate::{In, Map};
use core::cmp::Ordering;
use std::collections::BinaryHeap;
use thiserror::Error;

/// What is wrong with a plan. `Display` is the sentence for a person.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Finding {
    /// Local coordinates have no natural zero.
    #[error("no home: local north and east count from the plan's origin; name one")]
    NoHome,
    /// Home, a room, a door cannot be where it is.
    #[error("{what} is {problem}")]
    Misplaced {
        /// `home`, ``room `lab` `` ...
        what: String,
        /// `in a wall` ...
        problem: &'static str,
    },
    /// One can walk off the plan.
    #[error("the walls do not close: a gap about {width_m:.2} m wide at {:.2}, {:.2} leads off the plan", at[0], at[1])]
    Open {
        /// The narrowest place of the widest way out, plan metres.
        at: [f64; 2],
        /// How wide it is, m.
        width_m: f64,
    },
    /// No way leads into a room.
    #[error("room `{name}`: no door reaches it from home")]
    Shut {
        /// Its name.
        name: String,
    },
    /// The way into a room is too narrow.
    #[error(
        "room `{name}`: the widest way to it is only about {width_m:.2} m wide, at {:.2}, {:.2}; the vehicle needs {needed_m:.2} m",
        at[0],
        at[1]
    )]
    Narrow {
        /// Its name.
        name: String,
        /// The narrowest place of the widest way, plan metres.
        at: [f64; 2],
        /// How wide it is, m.
        width_m: f64,
        /// Twice the vehicle's radius, m.
        needed_m: f64,
    },
}

/// Looks a plan over for a vehicle of this radius. Nothing found is a good plan.
#[must_use]
pub fn check(plan: &FloorPlan, radius_m: f64) -> Vec<Finding> {
    let mut found = Vec::new();
    let home = plan.home.map(|h| In::<Map>::new(h.x_m, h.y_m, 0.0));
    let Some(from) = home.or_else(|| plan.rooms.first().map(|r| In::new(r.x, r.y, 0.0))) else {
        return vec![Finding::NoHome];
    };
    let problem = |p: In<Map>| match plan.at(p) {
        Cell::Free => None,
        Cell::Occupied => Some("in a wall"),
        Cell::Unknown => Some("outside the plan's free space"),
    };
    let mut misplaced = |what: String, p: In<Map>| {
        problem(p)
            .map(|problem| found.push(Finding::Misplaced { what, problem }))
            .is_some()
    };
    match home {
        None => found.push(Finding::NoHome),
        Some(home) if misplaced("home".to_owned(), home) => return found,
        Some(_) => {}
    }
    let widths = Widths::from(plan, from);
    for room in &plan.rooms {
        let p = In::new(room.x, room.y, 0.0);
        if let Some(problem) = problem(p) {
            found.push(Finding::Misplaced {
                what: format!("room `{}`", room.name),
                problem,
            });
            continue;
        }
        match widths.to(plan, p) {
            None => found.push(Finding::Shut {
                name: room.name.clone(),
            }),
            Some((at, width_m)) if width_m < 2.0 * radius_m => found.push(Finding::Narrow {
                name: room.name.clone(),
                at,
                width_m,
                needed_m: 2.0 * radius_m,
            }),
            Some(_) => {}
        }
    }
    for door in &plan.doors {
        let middle = In::new(
            0.5 * (door.a[0] + door.b[0]),
            0.5 * (door.a[1] + door.b[1]),
            0.0,
        );
        if let Some(problem) = problem(middle) {
            found.push(Finding::Misplaced {
                what: format!("door `{}`", door.name),
                problem,
            });
        }
    }
    if let Some((at, width_m)) = widths.way_out(plan) {
        found.push(Finding::Open { at, width_m });
    }
    found
}

/// For every cell the width of the widest way to it from a place, and where that way is narrowest.
struct Widths {
    clear_m: Vec<f32>,
    neck: Vec<u32>,
}

impl Widths {
    fn from(plan: &FloorPlan, from: In<Map>) -> Self {
        let field = plan.distance_field(10.0);
        let n = plan.width() * plan.height();
        let mut this = Self {
            clear_m: vec![0.0; n],
            neck: vec![u32::MAX; n],
        };
        let (c, r) = plan.index_of(from);
        let Some(start) = index(plan, c, r) else {
            return this;
        };
        let mut open = BinaryHeap::new();
        open.push(Step {
            clear_m: f32::INFINITY,
            cell: start,
            neck: start,
        });
        while let Some(step) = open.pop() {
            let i = step.cell as usize;
            if this.neck[i] != u32::MAX || plan.cells()[i] == Cell::Occupied {
                continue;
            }
            let here = field.distances_m()[i];
            let (clear_m, neck) = if here < step.clear_m {
                (here, step.cell)
            } else {
                (step.clear_m, step.neck)
            };
            (this.clear_m[i], this.neck[i]) = (clear_m, neck);
            let (c, r) = (
                i as i64 % plan.width() as i64,
                i as i64 / plan.width() as i64,
            );
            for (dc, dr) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if let Some(cell) = index(plan, c + dc, r + dr) {
                    open.push(Step {
                        clear_m,
                        cell,
                        neck,
                    });
                }
            }
        }
        this
    }

    fn neck(&self, plan: &FloorPlan, i: usize) -> ([f64; 2], f64) {
        let neck = i64::from(self.neck[i]);
        let p = plan.centre_of(neck % plan.width() as i64, neck / plan.width() as i64);
        // From the middle of the neck to the walls' faces.
        let width_m = 2.0 * f64::from(self.clear_m[i]) - plan.resolution_m();
        ([p.x(), p.y()], width_m.max(plan.resolution_m()))
    }

    fn to(&self, plan: &FloorPlan, p: In<Map>) -> Option<([f64; 2], f64)> {
        let (c, r) = plan.index_of(p);
        let i = index(plan, c, r)? as usize;
        (self.neck[i] != u32::MAX).then(|| self.neck(plan, i))
    }

    /// The widest way to the edge of the plan.
    fn way_out(&self, plan: &FloorPlan) -> Option<([f64; 2], f64)> {
        let (w, h) = (plan.width(), plan.height());
        (0..w * h)
            .filter(|i| {
                let (c, r) = (i % w, i / w);
                let is_edge = c == 0 || r == 0 || c + 1 == w || r + 1 == h;
                is_edge && self.neck[*i] != u32::MAX
            })
            .max_by(|a, b| self.clear_m[*a].total_cmp(&self.clear_m[*b]))
            .map(|i| self.neck(plan, i))
    }
}

fn index(plan: &FloorPlan, c: i64, r: i64) -> Option<u32> {
    let inside = c >= 0 && r >= 0 && c < plan.width() as i64 && r < plan.height() as i64;
    inside.then(|| (r * plan.width() as i64 + c) as u32)
}

#[derive(Clone, Copy)]
struct Step {
    clear_m: f32,
    cell: u32,
    neck: u32,
}

impl Ord for Step {
    fn cmp(&self, other: &Self) -> Ordering {
        self.clear_m
            .total_cmp(&other.clear_m)
            .then_with(|| other.cell.cmp(&self.cell))
    }
}

impl PartialOrd for Step {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Step {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Step {}
