//! Optimal gains for a craft flown by motor speeds: linearise, discretise, solve, fly.
//!
//! | Module | Does |
//! | --- | --- |
//! | [`motion`] | equations of motion of [`vehicle::UquadAirframe`], and their Jacobians by differentiation of the same code |
//! | [`dual`] | numbers that carry a slope: how that is done |
//! | [`trim`] | state and speeds that keep up hover, straight flight, a circle |
//! | [`discretize`] | zero-order hold: exact motion between two samples |
//! | [`riccati`] | discrete algebraic Riccati equation by structured doubling |
//! | [`design`] | gains around a trim: LQR with 12 or 8 states, LQI with four integrals more |
//!
//! A design takes well under a millisecond and allocates a little, so it runs beside the flight loop as a job; the loop
//! swaps gains.
//!
//! ```
//! use control::lqr::{Motion, Trim, Weights, design};
//! let motion = Motion::uquad();
//! let hover = Trim::hover(&motion.craft, 0.0);
//! let lqi = design::twelve_and_integrals(&motion, &hover, &Weights::uquad()).unwrap();
//! // A metre too low: all motors faster.
//! assert!(lqi.gains.matrix.column(2).iter().all(|&k| k > 0.0));
//! ```
//!
//! References: Chu, Fan, Lin 2005, "A structure-preserving doubling algorithm for continuous-time algebraic Riccati equations"
//! and its discrete sibling (Chu, Fan, Lin, Wang 2004); Anderson and Moore, "Optimal Control".

pub mod design;
pub mod discretize;
pub mod dual;
pub mod motion;
pub mod riccati;
pub mod trim;

pub use design::{Design, Weights};
pub use discretize::zero_order_hold;
pub use motion::{Inputs, Motion, State};
pub use riccati::{LqrError, Solution, dare};
pub use trim::{Trim, TrimError};
