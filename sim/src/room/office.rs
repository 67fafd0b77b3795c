//! `office`, 12 x 9 m.
//!
//! ```text
//! 9 +---------+------------+-----------------+
//!   | office a|  meeting   |    office b     |
//!   |         |            |         +--  ---+ 6.2
//! 5.8-+  +----+-------+  +--+--------|       |
//!   |        corridor                 kitchen|
//! 4.2-----------+  +----+----+  +----+       |
//!   |                   |            +--  ---+ 2.6
//!   |  lab (home)        workshop    | store |
//! 0 +-------------------+------------+-------+
//!   0                  5.4          9.0     12
//! ```

use super::draw::{Drawing, Wall};
use core::f64::consts::FRAC_PI_2;
use vehicle::MapPose;

const DOOR_M: f64 = 0.9;

pub(super) fn draw() -> Drawing {
    let mut d = Drawing::new([12.0, 9.0], MapPose::new(2.6, 2.05, FRAC_PI_2));
    walls(&mut d);
    furniture(&mut d);
    d.place("lab", 2.6, 2.05);
    d.place("workshop", 6.2, 3.3);
    d.place("corridor", 4.6, 4.95);
    d.place("office a", 1.7, 7.2);
    d.place("meeting", 5.2, 6.5);
    d.place("office b", 9.8, 7.6);
    d.place("kitchen", 9.8, 3.5);
    d.place("store", 10.5, 1.5);
    d
}

fn walls(d: &mut Drawing) {
    d.wall(
        Wall::Across {
            x: [0.0, 9.0],
            y: [4.2, 4.3],
        },
        &[
            ("lab-corridor", 4.1, DOOR_M),
            ("workshop-corridor", 7.9, DOOR_M),
        ],
    );
    d.wall(
        Wall::Up {
            x: [5.4, 5.5],
            y: [0.0, 4.2],
        },
        &[("lab-workshop", 2.9, DOOR_M)],
    );
    d.wall(
        Wall::Up {
            x: [9.0, 9.1],
            y: [0.0, 6.3],
        },
        &[("corridor-kitchen", 5.0, DOOR_M)],
    );
    d.wall(
        Wall::Across {
            x: [9.1, 12.0],
            y: [2.6, 2.7],
        },
        &[("kitchen-store", 10.4, DOOR_M)],
    );
    d.wall(
        Wall::Across {
            x: [9.1, 12.0],
            y: [6.2, 6.3],
        },
        &[("kitchen-office b", 10.3, DOOR_M)],
    );
    d.wall(
        Wall::Across {
            x: [0.0, 9.0],
            y: [5.7, 5.8],
        },
        &[
            ("corridor-office a", 1.0, DOOR_M),
            ("corridor-meeting", 6.3, DOOR_M),
        ],
    );
    let from_corridor_up = [5.8, 9.0];
    d.wall(
        Wall::Up {
            x: [3.2, 3.3],
            y: from_corridor_up,
        },
        &[],
    );
    d.wall(
        Wall::Up {
            x: [7.6, 7.7],
            y: from_corridor_up,
        },
        &[],
    );
}

fn furniture(d: &mut Drawing) {
    d.furnish();
    // Lab: bench, cupboard, and a drawer unit under the north wall.
    d.block([4.75, 5.4], [0.0, 1.2]);
    d.block([0.0, 0.5], [3.6, 4.2]);
    d.block([0.0, 0.35], [0.0, 1.0]);
    // Workshop: a machine that stands askew, a long shelf.
    d.turned_block([7.2, 1.7], [1.5, 0.7], 20.0);
    d.block([8.6, 9.0], [0.5, 2.4]);
    // Corridor: cabinets.
    d.block([0.0, 0.45], [4.3, 4.75]);
    d.block([2.3, 3.1], [5.45, 5.7]);
    // Office a: desk, book shelf.
    d.block([1.9, 3.2], [8.2, 9.0]);
    d.block([0.0, 0.4], [6.7, 8.0]);
    // Meeting room: the table.
    d.block([4.3, 6.0], [7.3, 8.3]);
    // Office b: two desks in an L, a corner cupboard.
    d.block([7.7, 9.1], [8.3, 9.0]);
    d.block([7.7, 8.3], [7.1, 8.3]);
    d.solid(&[[12.0, 7.8], [12.0, 9.0], [11.2, 9.0]]);
    // Kitchen: counter, round table.
    d.block([11.4, 12.0], [3.2, 5.4]);
    d.round([10.5, 4.6], 0.35);
    // Store: shelves, pallets.
    d.block([11.45, 12.0], [0.0, 2.0]);
    d.block([9.1, 9.75], [0.0, 0.8]);
}
