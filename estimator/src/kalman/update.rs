//! Scalar measurement updates.
//!
//! Each measurement is one scalar with its own gate, so there is no matrix inverse and no failure path. The covariance
//! loses `(P h)(P h)' / S`, which is Joseph's form for the optimal gain written without its cancelling terms; it is
//! symmetric by construction.

use super::gate::Verdict;
use super::{ATTITUDE, Aid, Filter, Observation, covariance};
use vehicle::Timestamp;
use vehicle::angle::wrap_pi;

/// How good a measurement is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// One standard deviation, unit of the measurement.
    pub std: f64,
    /// Neighbouring samples share their error for this long, s: faster streams do not know more.
    pub correlation_s: f64,
}

impl Quality {
    /// Independent samples.
    #[must_use]
    pub const fn white(std: f64) -> Self {
        Self {
            std,
            correlation_s: 0.0,
        }
    }
}

impl Filter {
    /// Corrects with one scalar; true if it was used.
    pub fn fuse(
        &mut self,
        aid: Aid,
        at: Timestamp,
        observation: &Observation,
        measured: f64,
        quality: Quality,
    ) -> bool {
        let mut innovation = measured - observation.predicted;
        if observation.is_angle {
            innovation = wrap_pi(innovation);
        }
        if !self.is_running || !innovation.is_finite() || quality.std.is_nan() {
            return false;
        }
        let spacing = self.gates[aid as usize].spacing_s(at);
        let sharing = (quality.correlation_s / spacing.max(1e-3)).max(1.0);
        let r = (quality.std * quality.std * sharing).max(1e-10);
        let mut ph = covariance::times(&self.covariance, &observation.row);
        let mut hph = observation.row.dot(&ph);
        match self.gates[aid as usize].judge(at, innovation, hph + r) {
            Verdict::Use => {}
            Verdict::Refuse => return false,
            Verdict::Widen(extra) => {
                // Doubt the state along the measured direction until the measurement is at the edge of the gate.
                if hph > 0.0 {
                    let k = extra / (hph * hph);
                    covariance::add_outer(&mut self.covariance, &ph, k);
                    ph *= 1.0 + extra / hph;
                    hph += extra;
                }
            }
        }
        let per_s = 1.0 / (hph + r);
        let correction = ph * (innovation * per_s);
        // The state was finite before, so it is enough to look at what is added.
        if !correction.norm_squared().is_finite() {
            return false;
        }
        self.state = self.state.plus(&correction);
        covariance::add_outer(&mut self.covariance, &ph, -per_s);
        self.reset_attitude(&correction.fixed_rows::<3>(ATTITUDE).into_owned());
        true
    }

    /// Moves the attitude error to the new nominal attitude: `P <- G P G'` with `G = I - [error / 2]x`.
    fn reset_attitude(&mut self, error: &nalgebra::Vector3<f64>) {
        if error.norm_squared() < 1e-8 {
            return;
        }
        covariance::turn_attitude(&mut self.covariance, &(error * 0.5));
    }
}
