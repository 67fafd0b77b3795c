//! Sweeping the floor: lanes or a walk joined to one path, gaps filled, judged.

use super::floor::{CellIndex, Floor, Reach};
use super::lanes::{self, Lane};
use super::rooms::regions;
use super::tour::{self, Distances};
use super::{PatrolError, spanning_tree};
use vehicle::{FloorPlan, In, Map};

/// Gaps are filled until this share is swept.
const ENOUGH: f64 = 0.985;
/// A gap smaller than this is left, share of a square of half a swath.
const LEAST_GAP: f64 = 0.12;

/// What is to be swept, and by what.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepConfig {
    /// Radius of the vehicle, m.
    pub radius_m: f64,
    /// Kept from walls beyond the radius where there is room, m.
    pub margin_m: f64,
    /// Width that one pass sweeps, m.
    pub swath_m: f64,
    /// Only the rooms of these names; empty = the whole floor.
    pub rooms: Vec<String>,
}

impl Default for SweepConfig {
    fn default() -> Self {
        Self {
            radius_m: 0.16,
            margin_m: 0.11,
            swath_m: 0.6,
            rooms: Vec::new(),
        }
    }
}

/// How lanes are laid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Parallel lanes, room by room.
    Boustrophedon,
    /// One closed walk over square cells.
    SpanningTree,
}

/// A path that sweeps the floor.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Corners, from the start on, on the plan.
    pub path: Vec<In<Map>>,
    /// Its length, m.
    pub length_m: f64,
    /// Share of the floor within half a swath of a place where the vehicle fits that the path sweeps, walls minded, 0..=1.
    pub covered: f64,
    /// That floor, m2.
    pub area_m2: f64,
    /// Area by swath, m: what a spanning tree over whole cells needs, and no path less.
    pub bound_m: f64,
}

/// A path that sweeps the floor a vehicle can reach from `start`.
///
/// # Errors
/// [`PatrolError`] says why there is none.
pub fn sweep(
    plan: &FloorPlan,
    start: In<Map>,
    config: &SweepConfig,
    method: Method,
) -> Result<Sweep, PatrolError> {
    let least_m = 4.0 * plan.resolution_m();
    if !(least_m..=5.0).contains(&config.swath_m) {
        return Err(PatrolError::Swath {
            swath_m: config.swath_m,
            least_m,
        });
    }
    let floor = Floor::new(
        plan,
        start,
        config.radius_m,
        config.margin_m,
        0.5 * config.swath_m,
    )?;
    let (region, names) = regions(&floor, plan);
    let mut wanted = floor.sweepable();
    if !config.rooms.is_empty() {
        let chosen = config
            .rooms
            .iter()
            .map(|name| {
                names
                    .iter()
                    .position(|n| n == name)
                    .ok_or_else(|| PatrolError::NoSuchRoom {
                        name: name.clone(),
                        known: names.join(", "),
                    })
            })
            .collect::<Result<Vec<_>, _>>()?;
        for (w, r) in wanted.iter_mut().zip(&region) {
            *w &= chosen.contains(&usize::from(*r));
        }
    }
    let mut reach = Reach::default();
    let mut cells = match method {
        Method::Boustrophedon => {
            let lanes = lanes::lanes(&floor, &wanted, &region, names.len() as u16);
            joined(&floor, &lanes, &mut reach)
        }
        Method::SpanningTree => {
            let side = libm::round(config.swath_m / floor.cell_m()) as i64;
            let walk = spanning_tree::walk(&floor, side);
            let mut walk = walk.cells;
            if !config.rooms.is_empty() {
                walk.retain(|i| wanted[*i as usize]);
            }
            let mut out = vec![floor.start()];
            for next in walk {
                go(&floor, &mut out, next, &mut reach);
            }
            out
        }
    };
    fill_gaps(&floor, &wanted, &mut cells, &mut reach);
    straighten(&mut cells, &floor);
    let swept = swept(&floor, &wanted, &cells);
    let total = wanted.iter().filter(|w| **w).count();
    let path: Vec<In<Map>> = cells.iter().map(|i| floor.centre(*i)).collect();
    let area_m2 = total as f64 * floor.cell_m() * floor.cell_m();
    Ok(Sweep {
        length_m: length(&path),
        path,
        covered: swept.iter().filter(|s| **s).count() as f64 / total.max(1) as f64,
        area_m2,
        bound_m: area_m2 / config.swath_m,
    })
}

fn length(path: &[In<Map>]) -> f64 {
    path.windows(2).map(|w| (w[1] - w[0]).norm_xy()).sum()
}

/// Lanes in the order of a short tour, with the ways between them.
fn joined(floor: &Floor, lanes: &[Lane], reach: &mut Reach) -> Vec<CellIndex> {
    let distances = Distances::new(floor, floor.start(), lanes);
    let mut out = vec![floor.start()];
    for visit in tour::tour(&distances, lanes.len(), false) {
        let lane = lanes[visit.piece];
        let (from, to) = if visit.is_reversed {
            (lane.b, lane.a)
        } else {
            (lane.a, lane.b)
        };
        go(floor, &mut out, from, reach);
        if to != from {
            out.push(to);
        }
    }
    out
}

/// Goes on to a cell by the shortest way.
fn go(floor: &Floor, path: &mut Vec<CellIndex>, to: CellIndex, reach: &mut Reach) {
    let Some(from) = path.last().copied() else {
        return path.push(to);
    };
    if from == to {
        return;
    }
    // All cells that fit hang together, so there is a way.
    if let Some(way) = floor.way(from, to, reach) {
        path.extend(&way[1..]);
    }
}

/// What a path sweeps of what is wanted.
fn swept(floor: &Floor, wanted: &[bool], path: &[CellIndex]) -> Vec<bool> {
    let mut out = vec![false; floor.len()];
    let mut see = |i: CellIndex| {
        floor.swept_from(i, |j| out[j as usize] |= wanted[j as usize]);
    };
    if let Some(first) = path.first() {
        see(*first);
    }
    for pair in path.windows(2) {
        floor.line(pair[0], pair[1], &mut see);
    }
    out
}

/// Detours to what is left, the largest gaps first.
fn fill_gaps(floor: &Floor, wanted: &[bool], path: &mut Vec<CellIndex>, reach: &mut Reach) {
    let total = wanted.iter().filter(|w| **w).count();
    let mut left: Vec<bool> = swept(floor, wanted, path)
        .iter()
        .zip(wanted)
        .map(|(swept, wanted)| *wanted && !swept)
        .collect();
    let mut missing = left.iter().filter(|l| **l).count();
    let mut disc = 0usize;
    floor.swept_from(floor.start(), |_| disc += 1);
    let least = (LEAST_GAP * disc as f64).max(2.0) as u32;
    // How much each cell would sweep; kept up to date as gaps close.
    let mut gain = vec![0u32; floor.len()];
    for i in 0..floor.len() as u32 {
        if left[i as usize] {
            floor.swept_from(i, |j| gain[j as usize] += u32::from(floor.is_lane(j)));
        }
    }
    let mut detours = Detours::new(floor, path);
    while missing as f64 > (1.0 - ENOUGH) * total as f64 {
        let Some((at, best)) = gain
            .iter()
            .enumerate()
            .max_by_key(|(i, g)| (**g, floor.is_roomy(*i as u32), core::cmp::Reverse(*i)))
            .map(|(i, g)| (i as u32, *g))
        else {
            break;
        };
        if best < least {
            break;
        }
        let mut new = Vec::new();
        floor.swept_from(at, |j| {
            if left[j as usize] {
                new.push(j);
            }
        });
        // Lines of sight are not quite symmetric on a grid; what is not seen from there is not asked of it again.
        gain[at as usize] = 0;
        if new.is_empty() {
            continue;
        }
        detours.add(floor, path, at, reach);
        for i in new {
            left[i as usize] = false;
            missing -= 1;
            floor.swept_from(i, |j| {
                gain[j as usize] = gain[j as usize].saturating_sub(1);
            });
        }
    }
    detours.insert(path);
}

/// Ways that leave the path where it comes nearest to a place, and come back there.
struct Detours {
    /// Per cell the corner of the path that comes next; 0 off the path.
    on_path: Vec<u32>,
    /// Corner that comes next, distance from the last one, corners of the detour.
    found: Vec<(u32, f64, Vec<CellIndex>)>,
}

impl Detours {
    fn new(floor: &Floor, path: &[CellIndex]) -> Self {
        let mut on_path = vec![0; floor.len()];
        for (pair, k) in path.windows(2).zip(1..) {
            floor.line(pair[0], pair[1], |i| {
                if on_path[i as usize] == 0 {
                    on_path[i as usize] = k;
                }
            });
        }
        Self {
            on_path,
            found: Vec::new(),
        }
    }

    fn add(&mut self, floor: &Floor, path: &[CellIndex], to: CellIndex, reach: &mut Reach) {
        let mut met = None;
        floor.spread(to, reach, |i, _| {
            let k = self.on_path[i as usize];
            met = (k > 0).then_some((k, i));
            met.is_some()
        });
        let Some((k, leave)) = met else { return };
        let Some(way) = floor.way(leave, to, reach) else {
            return;
        };
        let from = floor.centre(path[k as usize - 1]);
        let back = way.iter().rev().skip(1);
        let there_and_back = way.iter().chain(back).copied().collect();
        let along_m = (floor.centre(leave) - from).norm_xy();
        self.found.push((k, along_m, there_and_back));
    }

    fn insert(mut self, path: &mut Vec<CellIndex>) {
        self.found
            .sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut out = Vec::with_capacity(path.len());
        let mut detours = self.found.into_iter().peekable();
        for (corner, k) in path.iter().zip(0..) {
            while let Some((_, _, cells)) = detours.next_if(|(at, ..)| *at == k) {
                out.extend(cells);
            }
            out.push(*corner);
        }
        *path = out;
    }
}

/// Drops corners that are none.
fn straighten(path: &mut Vec<CellIndex>, floor: &Floor) {
    path.dedup();
    let mut out: Vec<CellIndex> = Vec::with_capacity(path.len());
    for i in path.iter() {
        if let [.., a, b] = out[..] {
            let ((ac, ar), (bc, br), (cc, cr)) = (floor.split(a), floor.split(b), floor.split(*i));
            let (d1, d2) = ((bc - ac, br - ar), (cc - bc, cr - br));
            let is_straight = d1.0 * d2.1 == d1.1 * d2.0 && d1.0 * d2.0 + d1.1 * d2.1 > 0;
            if is_straight {
                out.pop();
            }
        }
        out.push(*i);
    }
    *path = out;
}
