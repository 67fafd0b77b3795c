//! `maze`: 6 x 6 m of 0.1 m panels on a 1.2 m grid, walls only, many places that look alike but no symmetry.
//!
//! ```text
//! +-------+-------+---+
//! |       |       |   |
//! |   +---+   +   |   |
//! |   |       |       |
//! |   +   +---+---+   |
//! |       |       |   |
//! |   +---+   +---+   |
//! |   |       |       |
//! |   +   +   +   +---|
//! | H     |           |
//! +-------+-----------+
//! ```

use super::draw::Drawing;
use vehicle::MapPose;

/// Distance between grid lines, m.
const CELL_M: f64 = 1.2;

pub(super) fn draw() -> Drawing {
    let mut d = Drawing::new([6.0, 6.0], MapPose::new(0.6, 0.6, 0.0));
    // Panels: grid line, from, to, counted in cells from the lower left.
    for (row, from, to) in [(1, 4, 5), (2, 1, 2), (2, 3, 4), (3, 2, 4), (4, 1, 2)] {
        let (y, x) = (
            f64::from(row) * CELL_M,
            [from, to].map(|i| f64::from(i) * CELL_M),
        );
        d.block([x[0] - 0.05, x[1] + 0.05], [y - 0.05, y + 0.05]);
    }
    for (column, from, to) in [
        (1, 1, 2),
        (1, 3, 4),
        (2, 0, 1),
        (2, 2, 3),
        (2, 4, 5),
        (3, 1, 2),
        (3, 3, 4),
        (4, 2, 3),
        (4, 4, 5),
    ] {
        let (x, y) = (
            f64::from(column) * CELL_M,
            [from, to].map(|i| f64::from(i) * CELL_M),
        );
        d.block([x - 0.05, x + 0.05], [y[0] - 0.05, y[1] + 0.05]);
    }
    d.place("south west", 0.6, 0.6);
    d.place("south east", 5.4, 0.6);
    d.place("centre", 3.0, 3.0);
    d.place("north west", 0.6, 5.4);
    d.place("north east", 5.4, 5.4);
    d
}
