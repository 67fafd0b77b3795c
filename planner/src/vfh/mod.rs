//! VFH+ obstacle avoidance (Ulrich and Borenstein 1998, after Borenstein and Koren 1991).
//!
//! ```text
//! range scan -> certainty grid -> obstacles in the window -> polar histogram -> openings -> direction -> speed
//!               (grid)            (surroundings)             (histogram)        (valley)    (steering)
//! ```
//!
//! | Module | Does |
//! | --- | --- |
//! | [`config`] | [`VfhParams`], the threshold among them |
//! | [`grid`] | certainty that a cell of the plan holds something that the plan does not show |
//! | [`surroundings`] | obstacle points near the vehicle: plan walls, certain cells, people |
//! | [`histogram`] | polar density, enlarged by the vehicle's size, with hysteresis |
//! | [`valley`] | openings and the directions worth trying |
//! | [`steering`] | the cheapest direction; the speed from which stopping is possible |
//! | [`thesis`] | SNSI's histogram of 2018 as its thesis prints it, selectable for comparison |
//!
//! Sectors are fixed to the plan: sector k spans `5 k .. 5 k + 5` degrees counter-clockwise from plan x. The vehicle can
//! fly sideways and stop on the spot, so the paper's masking by turning circles falls away.

pub mod config;
pub mod grid;
pub mod histogram;
pub mod steering;
pub mod surroundings;
pub mod thesis;
pub mod valley;

pub use config::{VfhParams, VfhVariant};

/// Sectors of the polar histogram.
pub const SECTORS: usize = 72;
/// Angle of one sector, rad.
pub const SECTOR_RAD: f64 = core::f64::consts::TAU / SECTORS as f64;

/// The sector of a direction, rad counter-clockwise from plan x.
#[must_use]
pub fn sector_of(direction_rad: f64) -> usize {
    let turns = direction_rad / core::f64::consts::TAU;
    let k = ((turns - libm::floor(turns)) * SECTORS as f64) as usize;
    k.min(SECTORS - 1)
}

/// Middle of a sector, rad counter-clockwise from plan x.
#[must_use]
pub fn middle_of(sector: usize) -> f64 {
    (sector as f64 + 0.5) * SECTOR_RAD
}
