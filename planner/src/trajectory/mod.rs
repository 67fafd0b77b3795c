//! Paths with time: orbits, figures of eight, and curves of least jerk through way points.
//!
//! | Module | Does |
//! | --- | --- |
//! | [`figure`] | orbit and figure eight: place and velocity by the way flown on them |
//! | [`minimum_jerk`] | the curve through way points whose jerk is least, with its speeds and limits |

pub mod figure;
pub mod minimum_jerk;

pub use figure::{Figure, FigureError, Nose};
pub use minimum_jerk::{CurveError, MinimumJerk, Motion, Piece};
