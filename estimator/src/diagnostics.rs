//! What the estimator has seen and refused, for logs and for people who tune.

use crate::kalman::{Aid, AidStatus, Filter};
use serde::{Deserialize, Serialize};

/// Counters since construction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Diagnostics {
    /// Samples with NaN, infinite or absurd values, or older than one already used.
    pub refused_samples: u32,
    /// Scans taken.
    pub scans: u32,
    /// Scans whose moment odometry did not know, or taken at too much tilt.
    pub unused_scans: u32,
    /// Beams compared with the plan.
    pub beams: u32,
    /// Searches answered.
    pub searches: u32,
    /// Navigation filter, by aid.
    pub navigation: [AidStatus; Aid::COUNT],
    /// Odometry filter, by aid.
    pub odometry: [AidStatus; Aid::COUNT],
}

impl Diagnostics {
    pub(crate) fn read(&mut self, navigation: &Filter, odometry: &Filter) {
        for (i, aid) in Aid::ALL.into_iter().enumerate() {
            self.navigation[i] = navigation.status(aid);
            self.odometry[i] = odometry.status(aid);
        }
    }
}
