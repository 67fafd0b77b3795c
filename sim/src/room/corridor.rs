//! `corridor`: 18 m long with a bend, 1.8 m wide, two niches and two cabinets: the hard case for localization, where
//! position along the corridor shows only at its ends and niches.
//!
//! ```text
//! 8 +---------------------------------------+  +----+
//!   |                solid                  |  |    |
//! 3 +------+ niche +---------+ niche +------+  |    |
//!   |  home                                    |    |
//! 0 +------------------------------------------+----+
//!   0                                         16.4
//! ```

use super::draw::{Drawing, Wall};
use vehicle::MapPose;

pub(super) fn draw() -> Drawing {
    let mut d = Drawing::new([16.4, 8.0], MapPose::new(1.5, 0.9, 0.0));
    // The block north of the corridor, with a shallow niche and a deep one.
    d.block([0.0, 4.0], [1.8, 8.0]);
    d.block([4.0, 5.2], [2.6, 8.0]);
    d.block([5.2, 10.4], [1.8, 8.0]);
    d.block([10.4, 11.4], [3.0, 8.0]);
    d.block([11.4, 14.6], [1.8, 8.0]);
    // A fire door half way, and a narrower one to the bend.
    d.wall(
        Wall::Up {
            x: [8.0, 8.1],
            y: [0.0, 1.8],
        },
        &[("fire door", 0.9, 1.0)],
    );
    d.wall(
        Wall::Across {
            x: [14.6, 16.4],
            y: [5.0, 5.1],
        },
        &[("end door", 15.4, 0.9)],
    );
    d.block([6.0, 6.8], [0.0, 0.3]);
    d.block([12.6, 13.0], [1.45, 1.8]);
    d.block([16.1, 16.4], [3.0, 4.2]);
    d.place("west", 2.5, 0.9);
    d.place("shallow niche", 4.6, 1.2);
    d.place("middle", 9.2, 0.9);
    d.place("bend", 15.4, 0.9);
    d.place("end", 15.4, 6.6);
    d
}
