//! The order of pieces: start at the nearest, then improve by turning stretches round and moving pieces elsewhere.
//!
//! Pieces have two ends and may be flown either way; a place is a piece whose ends are one. Travelling-salesman heuristics:
//! nearest neighbour, 2-opt, Or-opt (G. Croes 1958; I. Or 1976).

use super::floor::{CellIndex, Floor, Reach};
use super::lanes::Lane;

/// Distances are searched exactly to this many nearest ends; what is farther is guessed.
const NEAR_ENDS: usize = 48;
/// A way that was not searched is guessed this much longer than the straight line.
const DETOUR: f64 = 1.8;
/// Rounds of improvement at most.
const ROUNDS: usize = 60;
/// Longest stretch moved as a whole.
const STRETCH: usize = 3;

/// A piece and which way it is flown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Visit {
    /// Which piece.
    pub piece: usize,
    /// From its second end to its first.
    pub is_reversed: bool,
}

/// Distances between all ends of pieces and the start.
#[derive(Clone, Debug)]
pub struct Distances {
    n: usize,
    m: Vec<f32>,
}

impl Distances {
    /// Searches the floor. End `2 k` is the first of piece k, `2 k + 1` its second, the last is the start.
    #[must_use]
    pub fn new(floor: &Floor, start: CellIndex, pieces: &[Lane]) -> Self {
        let mut ends: Vec<CellIndex> = pieces.iter().flat_map(|p| [p.a, p.b]).collect();
        ends.push(start);
        let n = ends.len();
        let mut here: Vec<(CellIndex, u32)> = ends.iter().copied().zip(0..).collect();
        here.sort_unstable();
        let mut m = vec![f32::INFINITY; n * n];
        let mut reach = Reach::default();
        for (i, from) in ends.iter().enumerate() {
            let mut found = 0;
            floor.spread(*from, &mut reach, |cell, cost| {
                let first = here.partition_point(|(c, _)| *c < cell);
                for (_, j) in here[first..].iter().take_while(|(c, _)| *c == cell) {
                    let j = *j as usize;
                    let cost = cost as f32;
                    m[i * n + j] = m[i * n + j].min(cost);
                    m[j * n + i] = m[j * n + i].min(cost);
                    found += 1;
                }
                found >= NEAR_ENDS
            });
        }
        for i in 0..n {
            for j in 0..n {
                if m[i * n + j].is_infinite() {
                    let d = floor.centre(ends[i]) - floor.centre(ends[j]);
                    m[i * n + j] = (DETOUR * d.norm_xy()) as f32;
                }
            }
        }
        Self { n, m }
    }

    /// From one end to another, m.
    #[must_use]
    pub fn between(&self, a: usize, b: usize) -> f64 {
        f64::from(self.m[a * self.n + b])
    }

    /// The start's end.
    #[must_use]
    pub const fn start(&self) -> usize {
        self.n - 1
    }
}

/// First and last end of a visit.
const fn ends(v: Visit) -> (usize, usize) {
    if v.is_reversed {
        (2 * v.piece + 1, 2 * v.piece)
    } else {
        (2 * v.piece, 2 * v.piece + 1)
    }
}

/// Length between the pieces of a tour, m: from the start, and back to it if the tour is closed.
#[must_use]
pub fn length_between(d: &Distances, tour: &[Visit], is_closed: bool) -> f64 {
    let mut at = d.start();
    let mut sum = 0.0;
    for v in tour {
        let (first, last) = ends(*v);
        sum += d.between(at, first);
        at = last;
    }
    if is_closed {
        sum += d.between(at, d.start());
    }
    sum
}

/// A short tour over all pieces, from the start and, if it is closed, back to it.
#[must_use]
pub fn tour(d: &Distances, pieces: usize, is_closed: bool) -> Vec<Visit> {
    let mut open: Vec<usize> = (0..pieces).collect();
    let mut tour = Vec::with_capacity(pieces);
    let mut at = d.start();
    while !open.is_empty() {
        let mut best = (f64::INFINITY, 0, false);
        for (k, piece) in open.iter().enumerate() {
            for is_reversed in [false, true] {
                let (first, _) = ends(Visit {
                    piece: *piece,
                    is_reversed,
                });
                let m = d.between(at, first);
                if m < best.0 {
                    best = (m, k, is_reversed);
                }
            }
        }
        let visit = Visit {
            piece: open.swap_remove(best.1),
            is_reversed: best.2,
        };
        at = ends(visit).1;
        tour.push(visit);
    }
    for _ in 0..ROUNDS {
        let turned = turn_round(d, &mut tour, is_closed);
        let moved = move_elsewhere(d, &mut tour, is_closed);
        if !turned && !moved {
            break;
        }
    }
    tour
}

/// End before and after a stretch `i..j`; none after the last of an open tour.
fn around(
    d: &Distances,
    tour: &[Visit],
    i: usize,
    j: usize,
    is_closed: bool,
) -> (usize, Option<usize>) {
    let before = if i == 0 {
        d.start()
    } else {
        ends(tour[i - 1]).1
    };
    let after = match tour.get(j) {
        Some(v) => Some(ends(*v).0),
        None => is_closed.then(|| d.start()),
    };
    (before, after)
}

fn leg(d: &Distances, a: usize, b: Option<usize>) -> f64 {
    b.map_or(0.0, |b| d.between(a, b))
}

/// 2-opt: a stretch flown the other way.
fn turn_round(d: &Distances, tour: &mut [Visit], is_closed: bool) -> bool {
    let mut better = false;
    for i in 0..tour.len() {
        for j in i + 1..=tour.len() {
            let (before, after) = around(d, tour, i, j, is_closed);
            let (first, last) = (ends(tour[i]).0, ends(tour[j - 1]).1);
            let was = d.between(before, first) + leg(d, last, after);
            let turned = d.between(before, last) + leg(d, first, after);
            if turned < was - 1e-6 {
                tour[i..j].reverse();
                for v in &mut tour[i..j] {
                    v.is_reversed = !v.is_reversed;
                }
                better = true;
            }
        }
    }
    better
}

/// Or-opt: one to three pieces flown at another time, either way round.
fn move_elsewhere(d: &Distances, tour: &mut Vec<Visit>, is_closed: bool) -> bool {
    let mut better = false;
    for length in 1..=STRETCH {
        let mut i = 0;
        while i + length <= tour.len() {
            let (before, after) = around(d, tour, i, i + length, is_closed);
            let (first, last) = (ends(tour[i]).0, ends(tour[i + length - 1]).1);
            let saved = d.between(before, first) + leg(d, last, after) - leg(d, before, after);
            let stretch: Vec<Visit> = tour.drain(i..i + length).collect();
            let mut best: (f64, usize, bool) = (saved - 1e-6, i, false);
            for k in 0..=tour.len() {
                let (before, after) = around(d, tour, k, k, is_closed);
                let skipped = leg(d, before, after);
                for is_turned in [false, true] {
                    let (a, b) = if is_turned {
                        (last, first)
                    } else {
                        (first, last)
                    };
                    let cost = d.between(before, a) + leg(d, b, after) - skipped;
                    if cost < best.0 {
                        best = (cost, k, is_turned);
                        better = true;
                    }
                }
            }
            let (_, at, is_turned) = best;
            let mut stretch = stretch;
            if is_turned {
                stretch.reverse();
                for v in &mut stretch {
                    v.is_reversed = !v.is_reversed;
                }
            }
            tour.splice(at..at, stretch);
            i += 1;
        }
    }
    better
}
