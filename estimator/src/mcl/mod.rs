//! Monte Carlo localization: where on the floor plan do the ranges say we are?
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`planar`] | level poses and steps between them |
//! | [`beams`] | scans as level points: rays, cones, beams without return |
//! | [`field`] | the plan as a table of distances |
//! | [`sensor`] | likelihood of readings, by table |
//! | [`drift`] | bias and noise of odometry, learned while the place is known |
//! | [`range_table`], [`beam_model`] | expected ranges of every cell and direction; beam mixture on them |
//! | [`motion`] | how particles move with odometry |
//! | [`particles`] | the particles, systematic resampling |
//! | [`bins`] | counting by place; KLD size of the set |
//! | [`cluster`] | mean, mass and covariance of the heaviest cluster |
//! | [`filter`] | one update of all that |
//! | [`stack`] | scans of the last seconds as one |
//! | [`search`](mod@search) | global start: exhaustive match of a stacked scan |
//! | [`locator`] | searching, localized, lost: when to believe it |
//! | [`thesis`] | the filter of the SNSI thesis, to compare with |
//! | [`localizer`] | one of the two |
//! | [`random`] | seeded random numbers |
//! | [`replay`] | recorded logs through the same locator, scored |
//!
//! Dellaert, Fox, Burgard, Thrun 1999; Thrun, Burgard, Fox, "Probabilistic Robotics" (2005), chapters 4, 6, 8; Fox 2003 (KLD).

pub mod beam_model;
pub mod beams;
pub mod bins;
pub mod cluster;
pub mod drift;
pub mod field;
pub mod filter;
pub mod localizer;
pub mod locator;
pub mod motion;
pub mod particles;
pub mod planar;
pub mod random;
pub mod range_table;
pub mod replay;
pub mod search;
pub mod sensor;
pub mod stack;
pub mod thesis;

pub use field::Field;
pub use filter::ParticleFilter;
pub use localizer::Localizer;
pub use locator::{Fix, Locator};
pub use planar::Planar;
pub use search::{Peak, SearchRequest, SearchResult, search};
