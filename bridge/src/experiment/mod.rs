//! Fault-injection campaigns: faults x modes x rooms in virtual time, each flight judged by the simulator's truth.
//!
//! A campaign is a TOML file and a number of seeds; a seed is a flight ([`plan`]). [`flight`] flies it, [`judge`] says how it
//! ended, [`matrix`] makes the report.
//!
//! ```toml
//! rooms = ["office", "corridor", "maze"]
//! modes = ["hold", "position", "mission", "offboard"]
//! faults = ["none", "ground-silent", "rangers-silent"]   # default: all
//! seeds = 100
//! ```

pub mod flight;
pub mod judge;
pub mod matrix;
pub mod plan;

pub use flight::{fly, watch};
pub use judge::{Outcome, Trouble};
pub use matrix::report;
pub use plan::{Campaign, Case, Fault, FlownMode};
