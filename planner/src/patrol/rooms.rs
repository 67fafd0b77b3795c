//! Rooms: which there are, which cell belongs to which, and the round that leaves each alone for the shortest time.

use super::PatrolError;
use super::floor::{CellIndex, Floor, Reach};
use super::lanes::Lane;
use super::tour::{self, Distances, Visit};
use vehicle::{FloorPlan, In, Map};

/// A place named on the plan may lie this far from where the vehicle fits, m.
const SNAP_M: f64 = 0.5;
/// On a plan without rooms no floor is farther than this from a place to visit, m.
const PLACE_REACH_M: f64 = 2.5;
/// Places with this much clearance are as good as any, m.
const ENOUGH_CLEARANCE_M: f64 = 0.6;
/// Up to so many rooms the shortest round is found exactly.
const EXACT: usize = 11;

/// A room to visit.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Its name.
    pub name: String,
    /// Where the vehicle goes, on the plan.
    pub at: In<Map>,
}

/// A round over rooms, from the start back to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Round {
    /// The rooms in the order of the visits.
    pub places: Vec<Place>,
    /// Ways from the start to the first, from each to the next, and home: corners on the plan.
    pub ways: Vec<Vec<In<Map>>>,
    /// Length of the round, m. With one vehicle this is also the longest way between two visits of any room, and no other order has
    /// a shorter one.
    pub length_m: f64,
}

/// The rooms of a plan as places the vehicle can be at; where the plan names none, places spread over the floor.
///
/// # Errors
/// [`PatrolError`] if a named room cannot be reached, or there is no such room.
pub fn places(floor: &Floor, plan: &FloorPlan, only: &[String]) -> Result<Vec<Place>, PatrolError> {
    if plan.rooms.is_empty() && only.is_empty() {
        return Ok(spread_out(floor));
    }
    let mut out = Vec::new();
    for room in &plan.rooms {
        if !only.is_empty() && !only.contains(&room.name) {
            continue;
        }
        let at = In::new(room.x, room.y, 0.0);
        let cell = floor
            .nearest_fit(at, SNAP_M)
            .ok_or_else(|| PatrolError::Unreachable {
                name: room.name.clone(),
                why: "no way leads there from the start that the vehicle fits through",
            })?;
        let is_it = floor.index(at) == Some(cell);
        out.push(Place {
            name: room.name.clone(),
            at: if is_it { at } else { floor.centre(cell) },
        });
    }
    if let Some(name) = only.iter().find(|n| !out.iter().any(|p| &p.name == *n)) {
        let known: Vec<&str> = plan.rooms.iter().map(|r| r.name.as_str()).collect();
        return Err(PatrolError::NoSuchRoom {
            name: name.clone(),
            known: known.join(", "),
        });
    }
    Ok(out)
}

/// The shortest round over places, from the floor's start back to it. A place at the start is not visited.
///
/// # Errors
/// [`PatrolError::NoRooms`] if none is left.
pub fn round(floor: &Floor, places: &[Place]) -> Result<Round, PatrolError> {
    let near_start = |p: &&Place| (p.at - floor.centre(floor.start())).norm_xy() > 0.5;
    let places: Vec<Place> = places.iter().filter(near_start).cloned().collect();
    let cells: Vec<CellIndex> = places
        .iter()
        .filter_map(|p| floor.nearest_fit(p.at, SNAP_M))
        .collect();
    if places.is_empty() || cells.len() != places.len() {
        return Err(PatrolError::NoRooms);
    }
    let stops: Vec<Lane> = cells.iter().map(|c| Lane { a: *c, b: *c }).collect();
    let d = Distances::new(floor, floor.start(), &stops);
    let order: Vec<usize> = if places.len() <= EXACT {
        shortest(&d, places.len())
    } else {
        let visits: Vec<Visit> = tour::tour(&d, places.len(), true);
        visits.iter().map(|v| v.piece).collect()
    };
    let mut reach = Reach::default();
    let mut ways = Vec::new();
    let mut from = floor.start();
    for to in order.iter().map(|k| cells[*k]).chain([floor.start()]) {
        let way = floor.way(from, to, &mut reach).unwrap_or_default();
        ways.push(way.iter().map(|i| floor.centre(*i)).collect::<Vec<_>>());
        from = to;
    }
    let length_m = ways
        .iter()
        .flat_map(|way: &Vec<In<Map>>| way.windows(2).map(|w| (w[1] - w[0]).norm_xy()))
        .sum();
    Ok(Round {
        places: order.iter().map(|k| places[*k].clone()).collect(),
        ways,
        length_m,
    })
}

/// The shortest closed tour, by dynamic programming over subsets (Held and Karp 1962).
fn shortest(d: &Distances, n: usize) -> Vec<usize> {
    let stop = |k: usize| 2 * k;
    let full = 1usize << n;
    let mut best = vec![f64::INFINITY; full * n];
    let mut from = vec![usize::MAX; full * n];
    for k in 0..n {
        best[(1 << k) * n + k] = d.between(d.start(), stop(k));
    }
    for set in 1..full {
        for last in 0..n {
            let so_far = best[set * n + last];
            if set & (1 << last) == 0 || so_far.is_infinite() {
                continue;
            }
            for next in 0..n {
                if set & (1 << next) != 0 {
                    continue;
                }
                let into = (set | (1 << next)) * n + next;
                let m = so_far + d.between(stop(last), stop(next));
                if m < best[into] {
                    (best[into], from[into]) = (m, last);
                }
            }
        }
    }
    let home = |last: usize| best[(full - 1) * n + last] + d.between(stop(last), d.start());
    let mut last = (0..n)
        .min_by(|a, b| home(*a).total_cmp(&home(*b)))
        .unwrap_or(0);
    let mut set = full - 1;
    let mut order = Vec::with_capacity(n);
    while last != usize::MAX {
        order.push(last);
        let before = from[set * n + last];
        set &= !(1 << last);
        last = before;
    }
    order.reverse();
    order
}

/// The room of each cell (by the shortest way to the rooms' places) and the rooms' names; one region without rooms.
#[must_use]
pub fn regions(floor: &Floor, plan: &FloorPlan) -> (Vec<u16>, Vec<String>) {
    let mut seeds: Vec<(CellIndex, String)> = Vec::new();
    for room in plan.rooms.iter().take(usize::from(u16::MAX)) {
        if let Some(cell) = floor.nearest_fit(In::new(room.x, room.y, 0.0), SNAP_M) {
            seeds.push((cell, room.name.clone()));
        }
    }
    if seeds.is_empty() {
        return (vec![0; floor.len()], vec!["floor".to_owned()]);
    }
    let mut region = vec![0u16; floor.len()];
    let mut nearest_m = vec![f64::INFINITY; floor.len()];
    let mut reach = Reach::default();
    for (k, (seed, _)) in seeds.iter().enumerate() {
        floor.spread(*seed, &mut reach, |i, m| {
            if m < nearest_m[i as usize] {
                (nearest_m[i as usize], region[i as usize]) = (m, k as u16);
            }
            false
        });
    }
    // Cells beside the walls, where the vehicle does not fit, go with a neighbour it sweeps them from.
    for i in 0..floor.len() as u32 {
        if floor.fits(i) {
            let mine = region[i as usize];
            let m = nearest_m[i as usize];
            floor.swept_from(i, |j| {
                if !floor.fits(j) && m < nearest_m[j as usize] {
                    (nearest_m[j as usize], region[j as usize]) = (m, mine);
                }
            });
        }
    }
    (region, seeds.into_iter().map(|(_, name)| name).collect())
}

/// Places such that no floor is far from one, each where there is room.
fn spread_out(floor: &Floor) -> Vec<Place> {
    let mut out = Vec::new();
    let mut nearest_m = vec![f64::INFINITY; floor.len()];
    let mut reach = Reach::default();
    let mut from = floor.start();
    loop {
        floor.spread(from, &mut reach, |i, m| {
            nearest_m[i as usize] = nearest_m[i as usize].min(m);
            false
        });
        let farthest = (0..floor.len() as u32)
            .filter(|i| floor.is_roomy(*i))
            .max_by(|a, b| nearest_m[*a as usize].total_cmp(&nearest_m[*b as usize]));
        let Some(far) = farthest.filter(|i| nearest_m[*i as usize] > PLACE_REACH_M) else {
            return out;
        };
        // From the far end of a dead end a step back to where there is most room.
        let mut best = far;
        floor.spread(far, &mut reach, |i, m| {
            let room = |i| floor.clearance_m(i).min(ENOUGH_CLEARANCE_M);
            if room(i) > room(best) + 1e-6 {
                best = i;
            }
            m > 0.6
        });
        out.push(Place {
            name: format!("place {}", out.len() + 1),
            at: floor.centre(best),
        });
        from = best;
    }
}
