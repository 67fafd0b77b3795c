//! `maze:SEED`: a maze of 7 x 7 m that follows from its seed, with loops, a few cupboards, and seven places.
//!
//! A spanning tree over 5 x 5 cells opens the panels between them; a third of the others is taken out, so that there is more
//! than one way. Cupboards in some corners are on the plan: they tell cells from each other.

use super::draw::Drawing;
use crate::noise::Noise;
use vehicle::MapPose;

/// Cells along each side, and their size, m.
const CELLS: usize = 5;
const CELL_M: f64 = 1.4;
const HALF_PANEL_M: f64 = 0.05;
/// Share of the panels left by the tree that is taken out again.
const LOOPS: f64 = 0.35;
/// Cells with a cupboard, and its size, m.
const CUPBOARDS: usize = 6;
const CUPBOARD_M: [f64; 2] = [0.2, 0.35];
/// Places to visit besides home.
const PLACES: usize = 6;

/// A maze that is the same for the same seed.
pub(super) fn draw(seed: u64) -> Drawing {
    let mut dice = Noise::new(seed, 0, "maze");
    let side_m = CELLS as f64 * CELL_M;
    let middle = |k: usize| (k as f64 + 0.5) * CELL_M;
    let mut d = Drawing::new([side_m, side_m], MapPose::new(middle(0), middle(0), 0.0));
    let open = openings(&mut dice);
    for row in 0..CELLS {
        for column in 0..CELLS {
            let (x, y) = (column as f64 * CELL_M, row as f64 * CELL_M);
            let cell = row * CELLS + column;
            let ends = |from: f64| [from - HALF_PANEL_M, from + CELL_M + HALF_PANEL_M];
            let across = |at: f64| [at - HALF_PANEL_M, at + HALF_PANEL_M];
            if column + 1 < CELLS && !open.contains(&(cell, cell + 1)) {
                d.block(across(x + CELL_M), ends(y));
            }
            if row + 1 < CELLS && !open.contains(&(cell, cell + CELLS)) {
                d.block(ends(x), across(y + CELL_M));
            }
        }
    }
    let mut cells: Vec<usize> = (1..CELLS * CELLS).collect();
    for i in (1..cells.len()).rev() {
        cells.swap(i, pick(&mut dice, i + 1));
    }
    for cell in &cells[..CUPBOARDS] {
        let size = dice.between(CUPBOARD_M[0], CUPBOARD_M[1]);
        let [x, y] = [cell % CELLS, cell / CELLS].map(|k| k as f64 * CELL_M + HALF_PANEL_M);
        let far = CELL_M - 2.0 * HALF_PANEL_M - size;
        let x = if dice.chance(0.5) { x } else { x + far };
        let y = if dice.chance(0.5) { y } else { y + far };
        d.block([x, x + size], [y, y + size]);
    }
    d.place("home", middle(0), middle(0));
    let mut rooms: Vec<usize> = cells[CUPBOARDS..CUPBOARDS + PLACES].to_vec();
    rooms.sort_unstable();
    for (cell, k) in rooms.into_iter().zip(1..) {
        d.place(
            &format!("cell {k}"),
            middle(cell % CELLS),
            middle(cell / CELLS),
        );
    }
    d
}

/// Pairs of neighbouring cells without a panel between them.
fn openings(dice: &mut Noise) -> Vec<(usize, usize)> {
    let mut panels: Vec<(usize, usize)> = Vec::new();
    for cell in 0..CELLS * CELLS {
        if cell % CELLS + 1 < CELLS {
            panels.push((cell, cell + 1));
        }
        if cell / CELLS + 1 < CELLS {
            panels.push((cell, cell + CELLS));
        }
    }
    for i in (1..panels.len()).rev() {
        panels.swap(i, pick(dice, i + 1));
    }
    // Kruskal: a panel between parts that do not hang together goes.
    let mut part: Vec<usize> = (0..CELLS * CELLS).collect();
    let mut open = Vec::new();
    for (a, b) in panels {
        let (pa, pb) = (part[a], part[b]);
        if pa != pb {
            part.iter_mut().filter(|p| **p == pb).for_each(|p| *p = pa);
            open.push((a, b));
        } else if dice.chance(LOOPS) {
            open.push((a, b));
        }
    }
    open
}

fn pick(dice: &mut Noise, n: usize) -> usize {
    ((dice.unit() * n as f64) as usize).min(n - 1)
}
