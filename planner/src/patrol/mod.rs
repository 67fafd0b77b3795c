//! Patrols made from a floor plan: every room visited, or every square metre passed within half a swath.
//!
//! All here is work for the ground, seconds at most; the vehicle flies what comes out as an ordinary mission.
//!
//! | Module | Does |
//! | --- | --- |
//! | [`floor`] | where the vehicle fits, what it can sweep from there, ways between places |
//! | [`lanes`] | boustrophedon: parallel lanes per room |
//! | [`spanning_tree`] | one closed walk over square cells, grown from the start |
//! | [`tour`] | the order of lanes and rooms |
//! | [`sweep`](mod@sweep) | lanes or walk joined to one path, gaps filled, judged |
//! | [`rooms`] | which rooms there are; the round that leaves each alone for the shortest time |
//!
//! ```
//! use planner::patrol::{Method, SweepConfig, sweep};
//! use vehicle::floor_plan::Cell;
//! use vehicle::{FloorPlan, In};
//!
//! // An empty room of 6 m by 4 m.
//! let wall = |i: usize| [0, 119].contains(&(i % 120)) || [0, 79].contains(&(i / 120));
//! let cells = (0..120 * 80).map(|i| if wall(i) { Cell::Occupied } else { Cell::Free }).collect();
//! let plan = FloorPlan::from_cells(120, 0.05, [0.0, 0.0], cells)?;
//! let swept = sweep(&plan, In::new(1.0, 1.0, 0.0), &SweepConfig::default(), Method::Boustrophedon)?;
//! assert!(swept.covered > 0.98 && swept.length_m < 1.6 * swept.bound_m);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! References: H. Choset, "Coverage of known spaces: the boustrophedon cellular decomposition", Autonomous Robots 9, 2000;
//! Y. Gabriely and E. Rimon, "Spanning-tree based coverage of continuous areas by a mobile robot", Annals of Mathematics
//! and Artificial Intelligence 31, 2001; Y. Chevaleyre, "Theoretical analysis of the multi-agent patrolling problem", IAT 2004
//! (one agent: the shortest closed tour has the smallest worst idle time).

pub mod floor;
pub mod lanes;
pub mod rooms;
pub mod spanning_tree;
pub mod sweep;
#[cfg(test)]
mod tests;
pub mod tour;

pub use floor::Floor;
pub use rooms::{Place, Round, places, round};
pub use sweep::{Method, Sweep, SweepConfig, sweep};

use thiserror::Error;

/// Why no patrol can be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PatrolError {
    /// The vehicle fits nowhere.
    #[error("the plan has no free cell where a vehicle of {radius_m:.2} m radius fits")]
    NoFreeCell {
        /// Radius of the vehicle, m.
        radius_m: f64,
    },
    /// It does not fit where it starts.
    #[error("the start {x_m:.2}, {y_m:.2} is in a wall, too near to one, or off the plan")]
    Start {
        /// On the plan, m.
        x_m: f64,
        /// On the plan, m.
        y_m: f64,
    },
    /// A swath that cannot be swept on this plan.
    #[error("a swath of {swath_m} m is outside {least_m:.2}..=5 m")]
    Swath {
        /// Asked for, m.
        swath_m: f64,
        /// Four cells of the plan, m.
        least_m: f64,
    },
    /// There is no room of that name.
    #[error("the plan has no room `{name}`; it has {known}")]
    NoSuchRoom {
        /// Asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// No way leads into a room.
    #[error("room `{name}` cannot be reached: {why}")]
    Unreachable {
        /// Its name.
        name: String,
        /// In words.
        why: &'static str,
    },
    /// Nothing to visit.
    #[error("the plan has no room to visit but the start")]
    NoRooms,
}
