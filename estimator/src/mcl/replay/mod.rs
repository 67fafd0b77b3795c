//! A recorded log driven through the same [`Localizer`] that flies.
//!
//! Rows are fed in order; a pose comes out for each stop or scan. Searches, which in flight run outside the loop, are
//! answered at once. Only public doors of the locator are used: nothing here knows anything that a flight does not.

pub mod log;
pub mod score;

pub use log::{Log, LogError, Row, Sensors};

use super::beams::{Stance, level};
use super::localizer::Localizer;
use super::planar::Planar;
use super::search::search;
use crate::EstimatorParams;
use vehicle::{FloorPlan, LocalizationState, MapPose};

/// Doubt of a told start, m and rad.
const START_STD_M: f64 = 0.10;
const START_STD_RAD: f64 = 0.10;
/// Logs do not carry attitude: the vehicle is level, below the top of the walls.
const STANCE: Stance = Stance {
    roll_rad: 0.0,
    pitch_rad: 0.0,
    height_m: 0.6,
    wall_height_m: 2.2,
};

/// Where a replay begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Begin {
    /// About here.
    At(MapPose),
    /// Anywhere on the plan.
    Anywhere,
}

/// What was known at one stop or scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Stop or scan.
    pub key: u32,
    /// Pose on the plan; before the first guess the mean of all places there are.
    pub pose: MapPose,
    /// Probability that the pose is right as far as the filter can tell, 0..=1 (see
    /// [`Localization::mass`](vehicle::Localization::mass)).
    pub mass: f64,
    /// Covariance of x, y, yaw, m2, m rad, rad2.
    pub covariance: [[f64; 3]; 3],
    /// Searching, localized, lost.
    pub state: LocalizationState,
    /// Share of returns that end at a wall, 0..=1.
    pub fit: f64,
    /// Particles in use.
    pub particles: u32,
}

/// A log on its way through a locator.
#[derive(Clone, Debug)]
pub struct Replay {
    locator: Localizer,
}

impl Replay {
    /// A locator on a plan, before the first row.
    #[must_use]
    pub fn new(params: &EstimatorParams, plan: &FloorPlan, begin: Begin, seed: u64) -> Self {
        Self::with(Localizer::new(params, plan, seed), begin)
    }

    /// The same with a localizer made elsewhere.
    #[must_use]
    pub fn with(mut locator: Localizer, begin: Begin) -> Self {
        match begin {
            Begin::At(pose) => locator.start_at(pose, START_STD_M, START_STD_RAD),
            Begin::Anywhere => locator.start_unknown(),
        }
        Self { locator }
    }

    /// Feeds a row; a pose at each key.
    pub fn feed(&mut self, row: &Row) -> Option<Placed> {
        let beams = level(&row.scan, &STANCE);
        self.locator.add(row.at, &row.odometry, &beams);
        self.locator.update(row.at, 1.0);
        if let Some(job) = self.locator.poll_job() {
            self.locator.search_done(&search(&job));
        }
        row.is_key.then(|| self.placed(row))
    }

    fn placed(&self, row: &Row) -> Placed {
        let status = self.locator.status();
        let since = self
            .locator
            .updated_at()
            .map_or_else(Planar::default, |pose| pose.step_to(&row.odometry));
        let (pose, covariance) = match status.pose {
            Some(pose) => (Planar::from(pose).then(&since), self.locator.covariance()),
            None => self.locator.field().anywhere(),
        };
        Placed {
            key: row.key,
            pose: pose.into(),
            mass: status.mass,
            covariance,
            state: status.state,
            fit: status.fit,
            particles: status.particles,
        }
    }

    /// The whole log.
    pub fn run(&mut self, rows: &[Row]) -> Vec<Placed> {
        rows.iter().filter_map(|row| self.feed(row)).collect()
    }

    /// The locator.
    #[must_use]
    pub const fn locator(&self) -> &Localizer {
        &self.locator
    }
}
