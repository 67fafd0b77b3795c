//! Figures of a flight, from truth.

use bridge::io::truth::Row;
use vehicle::angle::wrap_pi;

/// Estimate against truth while in the air and localized.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// Mean horizontal error, m.
    pub mean_m: f64,
    /// 95th percentile, m.
    pub p95_m: f64,
    /// Largest, m.
    pub max_m: f64,
    /// Yaw, root mean square, degrees.
    pub yaw_rms_deg: f64,
    /// Rows counted.
    pub rows: usize,
}

impl Errors {
    pub(crate) fn of(rows: &[Row]) -> Self {
        let counted: Vec<&Row> = rows
            .iter()
            .filter(|r| r.position[2] < -0.2 && r.localized)
            .collect();
        if counted.is_empty() {
            return Self::default();
        }
        let mut errors: Vec<f64> = counted
            .iter()
            .map(|r| (r.position[0] - r.est_position[0]).hypot(r.position[1] - r.est_position[1]))
            .collect();
        errors.sort_by(f64::total_cmp);
        let n = counted.len() as f64;
        let yaw = counted
            .iter()
            .map(|r| wrap_pi(r.yaw_rad - r.est_yaw_rad).powi(2))
            .sum::<f64>()
            / n;
        Self {
            mean_m: errors.iter().sum::<f64>() / n,
            p95_m: percentile(&errors, 0.95),
            max_m: errors.last().copied().unwrap_or(0.0),
            yaw_rms_deg: yaw.sqrt().to_degrees(),
            rows: counted.len(),
        }
    }
}

/// Value below which a share of the sorted values lies.
#[must_use]
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let index = ((sorted.len() as f64 * share) as usize).min(sorted.len().saturating_sub(1));
    sorted.get(index).copied().unwrap_or(f64::NAN)
}
