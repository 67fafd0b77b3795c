//! How good a replay was, against poses known better.

use super::Placed;
use vehicle::{LocalizationState, MapPose};

/// Right: this near and turned no more than this against the truth, m and rad (36 degrees).
pub const RIGHT_M: f64 = 0.20;
/// See [`RIGHT_M`].
pub const RIGHT_RAD: f64 = 0.628;
/// Keys in a row that must be right before a run has converged.
const CONVERGED_KEYS: usize = 3;
/// Farther than this after it has converged is a failure, m.
const LOST_M: f64 = 1.0;
/// Deviation of the recorded truth itself (data note: aligning scans moves it by 0.01 - 0.02 m), m.
pub const TRUTH_STD_M: f64 = 0.015;
/// A weight share that claims to know the place.
pub const CLAIM_MASS: f64 = 0.8;
/// A claim this far from the truth is a wrong one, m.
const WRONG_M: f64 = 0.5;

/// A key that has a truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// What was known.
    pub placed: Placed,
    /// Pose minus truth along plan x and y, m.
    pub offset_m: [f64; 2],
    /// Distance to the truth, m.
    pub error_m: f64,
    /// Turn against the truth, rad.
    pub error_rad: f64,
}

impl Judged {
    /// True if the pose is right.
    #[must_use]
    pub fn is_right(&self) -> bool {
        self.error_m < RIGHT_M && self.error_rad < RIGHT_RAD
    }

    /// True if the position error is within so many standard deviations of the published covariance, to which the
    /// truth's own error ([`TRUTH_STD_M`]) is added.
    #[must_use]
    pub fn is_within_sigmas(&self, sigmas: f64) -> bool {
        let c = &self.placed.covariance;
        let truth = TRUTH_STD_M * TRUTH_STD_M;
        let (xx, xy, yy) = (c[0][0] + truth, c[0][1], c[1][1] + truth);
        let [dx, dy] = self.offset_m;
        let determinant = xx * yy - xy * xy;
        let square = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant;
        determinant > 0.0 && square <= sigmas * sigmas
    }

    /// True if a place was claimed.
    #[must_use]
    pub fn is_claim(&self) -> bool {
        self.placed.mass > CLAIM_MASS || self.placed.state == LocalizationState::Localized
    }

    /// True if a place was claimed that is another.
    #[must_use]
    pub fn is_wrong_claim(&self) -> bool {
        self.is_claim() && (self.error_m > WRONG_M || self.error_rad > RIGHT_RAD)
    }
}

/// The keys that have a truth, with their errors.
#[must_use]
pub fn judge(placed: &[Placed], truth: &[(u32, MapPose)]) -> Vec<Judged> {
    placed
        .iter()
        .filter_map(|p| {
            let (_, t) = truth.iter().find(|(key, _)| *key == p.key)?;
            Some(Judged {
                placed: *p,
                offset_m: [p.pose.x_m - t.x_m, p.pose.y_m - t.y_m],
                error_m: p.pose.distance(t),
                error_rad: vehicle::angle::shortest_turn(t.yaw_rad, p.pose.yaw_rad).abs(),
            })
        })
        .collect()
}

/// Root mean square of the position errors, m.
#[must_use]
pub fn ate_m(keys: &[Judged]) -> f64 {
    let sum: f64 = keys.iter().map(|k| k.error_m * k.error_m).sum();
    libm::sqrt(sum / keys.len().max(1) as f64)
}

/// Root mean square of the yaw errors, rad.
#[must_use]
pub fn yaw_rms_rad(keys: &[Judged]) -> f64 {
    let sum: f64 = keys.iter().map(|k| k.error_rad * k.error_rad).sum();
    libm::sqrt(sum / keys.len().max(1) as f64)
}

/// The first of three keys in a row that are right.
#[must_use]
pub fn converged_at(keys: &[Judged]) -> Option<usize> {
    keys.windows(CONVERGED_KEYS)
        .position(|w| w.iter().all(Judged::is_right))
}

/// Converged, and never farther off than 1 m afterwards.
#[must_use]
pub fn is_success(keys: &[Judged]) -> bool {
    converged_at(keys).is_some_and(|i| keys[i..].iter().all(|k| k.error_m <= LOST_M))
}
