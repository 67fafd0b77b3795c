//! Spanning-tree coverage: one closed walk over square cells as wide as the swath.
//!
//! On cells grouped by four, walking round a spanning tree of the groups passes each cell once, and the walk is as long as the
//! cells are many: no path is shorter. Here the same walk is grown from the start: a step of the walk gives way to the pair of
//! cells beside it (two cells for two steps); a cell that has no pair left is visited and left again (one cell for two steps), which
//! is what the tree pays at the edge of floors that are not made of groups.

use super::floor::{CellIndex, Floor};

/// Offsets of the grid that are tried in each direction.
const OFFSETS: i64 = 6;

/// A walk, closed, and how many of its cells were visited twice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Walk {
    /// Corner after corner; the first is not repeated at the end.
    pub cells: Vec<CellIndex>,
    /// Square cells visited.
    pub visited: usize,
    /// Of them, those that cost two steps.
    pub spikes: usize,
}

/// The walk over cells `side` plan cells wide.
#[must_use]
pub fn walk(floor: &Floor, side: i64) -> Walk {
    let step = (side / OFFSETS).max(1);
    let mut best: Option<Nodes> = None;
    for oy in (0..side).step_by(step as usize) {
        for ox in (0..side).step_by(step as usize) {
            let nodes = Nodes::new(floor, side, ox, oy);
            if best.as_ref().is_none_or(|b| nodes.count > b.count) {
                best = Some(nodes);
            }
        }
    }
    best.map_or_else(Walk::default, |nodes| nodes.grow(floor))
}

struct Nodes {
    columns: i64,
    rows: i64,
    /// Where the vehicle passes a square cell.
    place: Vec<Option<CellIndex>>,
    count: usize,
}

impl Nodes {
    fn new(floor: &Floor, side: i64, ox: i64, oy: i64) -> Self {
        let (w, h) = floor.size();
        let (columns, rows) = ((w - ox) / side + 1, (h - oy) / side + 1);
        let mut place = Vec::with_capacity((columns * rows) as usize);
        for r in 0..rows {
            for c in 0..columns {
                let (x, y) = (ox + c * side + side / 2, oy + r * side + side / 2);
                place.push(nearest(floor, x, y, side / 4));
            }
        }
        let count = place.iter().flatten().count();
        Self {
            columns,
            rows,
            place,
            count,
        }
    }

    fn neighbour(&self, node: usize, (dc, dr): (i64, i64)) -> Option<usize> {
        let (c, r) = (
            node as i64 % self.columns + dc,
            node as i64 / self.columns + dr,
        );
        let inside = c >= 0 && r >= 0 && c < self.columns && r < self.rows;
        inside.then(|| (r * self.columns + c) as usize)
    }

    fn is_edge(&self, floor: &Floor, a: usize, b: usize) -> bool {
        match (self.place[a], self.place[b]) {
            (Some(a), Some(b)) => floor.is_straight(a, b, 0.0),
            _ => false,
        }
    }

    fn grow(&self, floor: &Floor) -> Walk {
        const SIDES: [(i64, i64); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];
        let (c0, r0) = floor.split(floor.start());
        let from_start = |i: CellIndex| {
            let (c, r) = floor.split(i);
            (c - c0).pow(2) + (r - r0).pow(2)
        };
        let Some(first) = (0..self.place.len())
            .filter(|n| self.place[*n].is_some())
            .min_by_key(|n| self.place[*n].map(from_start))
        else {
            return Walk::default();
        };
        let mut is_visited = vec![false; self.place.len()];
        is_visited[first] = true;
        // The walk as a ring of steps: node of each, and the step after it.
        let mut node = vec![first];
        let mut next = vec![0usize];
        let mut fresh = vec![0usize];
        let (mut visited, mut spikes) = (1, 0);
        loop {
            while let Some(u) = fresh.pop() {
                let v = next[u];
                let (a, b) = (node[u], node[v]);
                let along = (
                    b as i64 % self.columns - a as i64 % self.columns,
                    b as i64 / self.columns - a as i64 / self.columns,
                );
                if along.0.abs() + along.1.abs() != 1 {
                    continue;
                }
                for side in [(along.1, -along.0), (-along.1, along.0)] {
                    let pair = (self.neighbour(a, side), self.neighbour(b, side));
                    let (Some(p), Some(q)) = pair else { continue };
                    let is_new = !is_visited[p] && !is_visited[q];
                    let is_open = self.is_edge(floor, a, p)
                        && self.is_edge(floor, p, q)
                        && self.is_edge(floor, q, b);
                    if !is_new || !is_open {
                        continue;
                    }
                    (is_visited[p], is_visited[q]) = (true, true);
                    visited += 2;
                    let (sp, sq) = (node.len(), node.len() + 1);
                    node.extend([p, q]);
                    next.extend([sq, v]);
                    next[u] = sp;
                    fresh.extend([u, sq, sp]);
                    break;
                }
            }
            let spike = (0..node.len()).find_map(|u| {
                SIDES.iter().find_map(|side| {
                    self.neighbour(node[u], *side)
                        .filter(|p| !is_visited[*p] && self.is_edge(floor, node[u], *p))
                        .map(|p| (u, p))
                })
            });
            let Some((u, p)) = spike else { break };
            is_visited[p] = true;
            visited += 1;
            if node.len() == 1 {
                // There and back between two cells is a ring already.
                node.push(p);
                next = vec![1, 0];
                fresh.extend([0, 1]);
                continue;
            }
            spikes += 1;
            let (there, back) = (node.len(), node.len() + 1);
            node.extend([p, node[u]]);
            next.extend([back, next[u]]);
            next[u] = there;
            fresh.extend([u, there]);
        }
        let mut cells = Vec::with_capacity(node.len());
        let mut at = 0;
        loop {
            cells.extend(self.place[node[at]]);
            at = next[at];
            if at == 0 {
                break;
            }
        }
        Walk {
            cells,
            visited,
            spikes,
        }
    }
}

/// The nearest cell with room to a place, else the nearest where the vehicle fits at all.
fn nearest(floor: &Floor, x: i64, y: i64, within: i64) -> Option<CellIndex> {
    let search = |is_ok: &dyn Fn(CellIndex) -> bool| {
        let mut best: Option<(i64, CellIndex)> = None;
        for dy in -within..=within {
            for dx in -within..=within {
                let d = dx * dx + dy * dy;
                if let Some(i) = floor.at(x + dx, y + dy)
                    && is_ok(i)
                    && best.is_none_or(|(b, _)| d < b)
                {
                    best = Some((d, i));
                }
            }
        }
        best.map(|(_, i)| i)
    };
    search(&|i| floor.is_roomy(i)).or_else(|| search(&|i| floor.is_lane(i)))
}
