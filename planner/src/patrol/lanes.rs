//! Boustrophedon lanes: from one side of a room to the other, each as far from the last as the swath allows.
//!
//! The classic decomposition cuts the floor where walls begin and end. Here the sweep itself finds them: the lane that is laid
//! next is the farthest one that still sweeps what is left farthest back. Each room is laid along and across, and keeps what is
//! shorter to fly.

use super::floor::{CellIndex, Floor};

/// A lane sweeping less than this much that is new is not worth a lane, in squares of the reach.
const LEAST_GAIN: f64 = 6.0;
/// What the turn into a lane costs, in reaches.
const TURN_COST: f64 = 2.0;
/// A stretch that long with nothing to sweep ends a lane, in reaches.
const GAP: f64 = 3.0;

/// A straight piece to fly, either way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lane {
    /// One end.
    pub a: CellIndex,
    /// The other end.
    pub b: CellIndex,
}

/// Which way lanes run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Along {
    X,
    Y,
}

/// Lanes that sweep each region of the floor; `region` names the region of each cell, `wanted` what is to be swept.
#[must_use]
pub fn lanes(floor: &Floor, wanted: &[bool], region: &[u16], regions: u16) -> Vec<Lane> {
    let mut out = Vec::new();
    let mut left = wanted.to_vec();
    for k in 0..regions {
        let mine: Vec<CellIndex> = (0..floor.len() as u32)
            .filter(|i| left[*i as usize] && region[*i as usize] == k)
            .collect();
        let [x, y] = [Along::X, Along::Y].map(|along| lay(floor, &left, &mine, along));
        let best = if x.cost <= y.cost { x } else { y };
        out.extend(best.lanes);
        left = best.left;
    }
    out
}

struct Laid {
    lanes: Vec<Lane>,
    left: Vec<bool>,
    /// Cells to fly, turns and what stayed unswept included.
    cost: f64,
}

fn lay(floor: &Floor, wanted: &[bool], mine: &[CellIndex], along: Along) -> Laid {
    let mut reach = 0;
    floor.swept_from(floor.start(), |i| {
        let ((c, r), (c0, r0)) = (floor.split(i), floor.split(floor.start()));
        reach = reach.max((c - c0).abs()).max((r - r0).abs());
    });
    let reach = reach.max(2);
    let grid = Turned { floor, along };
    let mut left = wanted.to_vec();
    let mut skipped = 0usize;
    let mut lanes = Vec::new();
    let mut cost = 0.0;
    let mut order = mine.to_vec();
    order.sort_by_key(|i| {
        let (across, on) = grid.split(*i);
        (across, on)
    });
    for cell in order {
        if !left[cell as usize] {
            continue;
        }
        let laid = grid.lane(cell, &left, reach);
        let gain = laid.map_or(0, |lane| swept_new(floor, lane, &left, |_| {}));
        match laid {
            Some(lane) if gain as f64 >= LEAST_GAIN * (reach * reach) as f64 => {
                let mut swept = Vec::new();
                swept_new(floor, lane, &left, |i| swept.push(i));
                for i in swept {
                    left[i as usize] = false;
                }
                let ((c0, r0), (c1, r1)) = (floor.split(lane.a), floor.split(lane.b));
                cost += ((c1 - c0).abs() + (r1 - r0).abs()) as f64 + TURN_COST * reach as f64;
                lanes.push(lane);
                // What the lane left behind itself is for the gaps.
                if left[cell as usize] {
                    skipped += 1;
                }
            }
            _ => skipped += 1,
        }
    }
    Laid {
        lanes,
        left,
        cost: cost + skipped as f64 / reach as f64,
    }
}

/// Cells still wanted that a lane sweeps.
fn swept_new(floor: &Floor, lane: Lane, left: &[bool], mut see: impl FnMut(CellIndex)) -> usize {
    let mut seen = std::collections::BTreeSet::new();
    floor.line(lane.a, lane.b, |i| {
        floor.swept_from(i, |j| {
            if left[j as usize] && seen.insert(j) {
                see(j);
            }
        });
    });
    seen.len()
}

/// The floor with lanes running along its second coordinate.
struct Turned<'a> {
    floor: &'a Floor,
    along: Along,
}

impl Turned<'_> {
    const fn split(&self, i: CellIndex) -> (i64, i64) {
        let (c, r) = self.floor.split(i);
        match self.along {
            Along::Y => (c, r),
            Along::X => (r, c),
        }
    }

    fn at(&self, across: i64, on: i64) -> Option<CellIndex> {
        match self.along {
            Along::Y => self.floor.at(across, on),
            Along::X => self.floor.at(on, across),
        }
    }

    /// The farthest lane that sweeps a cell, with the margin where there is room for it.
    fn lane(&self, cell: CellIndex, left: &[bool], reach: i64) -> Option<Lane> {
        let (across0, on0) = self.split(cell);
        let roomy = |i: CellIndex| self.floor.is_roomy(i);
        let tight = |i: CellIndex| self.floor.is_lane(i);
        // One cell less than the reach: neighbouring lanes lie a swath apart, not a swath and a cell.
        let farthest = reach - 1;
        for is_ok in [&roomy as &dyn Fn(CellIndex) -> bool, &tight] {
            for across in (across0 - reach..=across0 + farthest).rev() {
                // The run may begin a little farther along than the cell: lanes end before walls.
                for step in 0..=reach {
                    for on in [on0 + step, on0 - step] {
                        let Some(_) = self.at(across, on).filter(|i| is_ok(*i)) else {
                            continue;
                        };
                        if let Some(lane) = self.run(across, on, is_ok, left, reach) {
                            return Some(lane);
                        }
                    }
                }
            }
        }
        None
    }

    /// The run of good cells through a place, cut to where there is something to sweep.
    fn run(
        &self,
        across: i64,
        on: i64,
        is_ok: &dyn Fn(CellIndex) -> bool,
        left: &[bool],
        reach: i64,
    ) -> Option<Lane> {
        let is_useful = |on: i64| {
            (across - reach..=across + reach).any(|x| {
                self.at(x, on)
                    .is_some_and(|i| left[i as usize] && self.is_beside(across, x, on))
            })
        };
        let walk = |direction: i64| {
            let mut end = on;
            let mut useful = None;
            let mut gap = 0;
            loop {
                if is_useful(end) {
                    (useful, gap) = (Some(end), 0);
                } else {
                    gap += 1;
                    if gap as f64 > GAP * reach as f64 {
                        break;
                    }
                }
                match self.at(across, end + direction) {
                    Some(i) if is_ok(i) => end += direction,
                    _ => break,
                }
            }
            useful
        };
        let (up, down) = (walk(1), walk(-1));
        let high = up.or(down)?;
        let low = down.or(up)?;
        Some(Lane {
            a: self.at(across, low.min(high))?,
            b: self.at(across, high.max(low))?,
        })
    }

    /// No wall between the lane and a cell beside it.
    fn is_beside(&self, across: i64, x: i64, on: i64) -> bool {
        let (from, to) = (across.min(x), across.max(x));
        (from..=to).all(|k| {
            self.at(k, on)
                .is_some_and(|i| self.floor.clearance_m(i) > -1.0)
        })
    }
}
