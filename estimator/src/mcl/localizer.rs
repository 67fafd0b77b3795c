//! The localization that was chosen: production or thesis.

use super::beams::LevelBeam;
use super::field::Field;
use super::locator::{Fix, Locator};
use super::particles::Particles;
use super::planar::Planar;
use super::search::{SearchRequest, SearchResult};
use super::thesis::{ThesisLocator, ThesisNoise};
use crate::EstimatorParams;
use crate::params::MclVariant;
use std::sync::Arc;
use vehicle::{FloorPlan, Localization, MapPose, Timestamp};

/// Localization on one plan, by the parameter `MCL_VARIANT`.
#[derive(Clone, Debug)]
pub enum Localizer {
    /// [`Locator`].
    Production(Box<Locator>),
    /// [`ThesisLocator`].
    Thesis(Box<ThesisLocator>),
}

impl Localizer {
    /// The variant that the parameters name, without a start.
    #[must_use]
    pub fn new(params: &EstimatorParams, plan: &FloorPlan, seed: u64) -> Self {
        match params.mcl_variant {
            MclVariant::Production => Self::Production(Box::new(Locator::new(params, plan, seed))),
            MclVariant::Thesis => Self::Thesis(Box::new(ThesisLocator::new(
                ThesisNoise::AS_RECORDED,
                plan,
                seed,
            ))),
        }
    }

    /// Starts at a told pose, known to within standard deviations of metres and radians.
    pub fn start_at(&mut self, pose: MapPose, std_xy_m: f64, std_yaw_rad: f64) {
        match self {
            Self::Production(l) => l.start_at(pose, std_xy_m, std_yaw_rad),
            Self::Thesis(l) => l.start_at(pose, std_xy_m, std_yaw_rad),
        }
    }

    /// Starts anywhere on the plan.
    pub fn start_unknown(&mut self) {
        match self {
            Self::Production(l) => l.start_unknown(),
            Self::Thesis(l) => l.start_unknown(),
        }
    }

    /// What is known.
    #[must_use]
    pub fn status(&self) -> &Localization {
        match self {
            Self::Production(l) => l.status(),
            Self::Thesis(l) => l.status(),
        }
    }

    /// Covariance of the published pose: x, y, yaw, m2, m rad, rad2.
    #[must_use]
    pub fn covariance(&self) -> [[f64; 3]; 3] {
        match self {
            Self::Production(l) => l.covariance(),
            Self::Thesis(l) => l.covariance(),
        }
    }

    /// Odometry pose of the last update: what [`Localizer::status`] is true at.
    #[must_use]
    pub fn updated_at(&self) -> Option<Planar> {
        match self {
            Self::Production(l) => l.updated_at(),
            Self::Thesis(l) => l.updated_at(),
        }
    }

    /// The particles.
    #[must_use]
    pub fn particles(&self) -> &Particles {
        match self {
            Self::Production(l) => l.particles(),
            Self::Thesis(l) => l.particles(),
        }
    }

    /// The plan's table.
    #[must_use]
    pub fn field(&self) -> &Arc<Field> {
        match self {
            Self::Production(l) => l.field(),
            Self::Thesis(l) => l.field(),
        }
    }

    /// Adds readings about the body, taken at an odometry pose.
    pub fn add(&mut self, at: Timestamp, odometry: &Planar, beams: &[LevelBeam]) {
        match self {
            Self::Production(l) => l.add(at, odometry, beams),
            Self::Thesis(l) => l.add(at, odometry, beams),
        }
    }

    /// Time passes: updates the particles if enough readings wait.
    pub fn update(&mut self, now: Timestamp, noise_scale: f64) -> Option<Fix> {
        match self {
            Self::Production(l) => l.update(now, noise_scale),
            Self::Thesis(l) => l.update(),
        }
    }

    /// A search to run outside the loop, if one is wanted now; the thesis has none.
    pub fn poll_job(&mut self) -> Option<SearchRequest> {
        match self {
            Self::Production(l) => l.poll_job(),
            Self::Thesis(_) => None,
        }
    }

    /// The answer of a search.
    pub fn search_done(&mut self, result: &SearchResult) {
        if let Self::Production(l) = self {
            l.search_done(result);
        }
    }
}
