//! The brain: two pure machines with one narrow door.
//!
//! [`flight`] is the page to read first: the tick, in order. [`ground`] holds every MAVLink service. They meet only
//! through [`door`].

pub mod arbiter;
pub mod arming;
pub mod beat;
pub mod bench_work;
pub mod door;
pub mod endurance;
pub mod failsafe_page;
pub mod failsafes;
pub mod flight;
pub mod ground;
pub mod handover;
pub mod health;
pub mod insight;
pub mod io;
pub mod keeper;
pub mod latency;
pub mod mode;
pub mod modes;
pub mod params;
pub mod supervisor;
pub mod watch;
