//! Scalar measurement updates.
//!
//! Each measurement is one scalar with its own gate, so there is no matrix inverse and no failure path. The covariance
//! loses `(P h)(P h)' / S`, which is Joseph's form for the optimal gain written without its cancelling terms; it is
//! symmetric by construction.

use super::gate::Verdict;
use super::{ACCEL_BIAS, ATTITUDE, Aid, Filter, GYRO_BIAS, Observation, POSITION, VELOCITY};
use nalgebra::Vector3;
use vehicle::Timestamp;
use vehicle::angle::wrap_pi;

/// Half corrections of the attitude are gathered up to this, squared, rad2 (2 mrad, which turn no covariance by more than so
/// much), before the covariance turns with them.
const SMALL_TURN2: f64 = 4e-6;

/// How good a measurement is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// One standard deviation, unit of the measurement.
    pub std: f64,
    /// Neighbouring samples share their error for this long, s: faster streams do not know more.
    pub correlation_s: f64,
    /// What is measured never gets surer than this by it: variance, unit of the measurement squared. For an estimate that has
    /// gathered evidence itself, which counted again and again would be worth more every time.
    pub least_variance: f64,
}

impl Quality {
    /// Independent samples.
    #[must_use]
    pub const fn white(std: f64) -> Self {
        Self {
            std,
            correlation_s: 0.0,
            least_variance: 0.0,
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
        if observation.is_angle() {
            innovation = wrap_pi(innovation);
        }
        if !self.is_running || !innovation.is_finite() || quality.std.is_nan() {
            return false;
        }
        let gate = &mut self.gates[aid as usize];
        let spacing = gate.spacing_s(at);
        let mut r = quality.std * quality.std;
        if quality.correlation_s > 0.0 {
            r *= (quality.correlation_s / spacing.max(1e-3)).max(1.0);
        }
        let r = r.max(1e-10);
        let (mut ph, mut hph) = self
            .covariance
            .times(observation.row(), observation.support());
        let mut per_s = 1.0 / (hph + r);
        match gate.judge(at, innovation, hph + r, per_s) {
            Verdict::Use => {}
            Verdict::Refuse => return false,
            Verdict::Widen(extra) => {
                // Doubt the state along the measured direction until the measurement is at the edge of the gate.
                if !extra.is_finite() {
                    return false;
                }
                if hph > 0.0 {
                    self.covariance.add_outer(&ph, extra / (hph * hph));
                    self.covariance.keep_sound();
                    ph = ph.scaled(1.0 + extra / hph);
                    hph += extra;
                    per_s = 1.0 / (hph + r);
                }
            }
        }
        // `p - p^2 / s` is left of a variance p. The state follows all the same: what gathered evidence is not surer, but newer.
        let mut learnt_per_s = per_s;
        if quality.least_variance > 0.0 {
            let most = (hph - quality.least_variance) / (hph * hph);
            learnt_per_s = if most > 0.0 { per_s.min(most) } else { 0.0 };
        }
        let gain = innovation * per_s;
        // The state was finite before, so it is enough to look at what is added; no correction is larger than the root of its
        // variance's part in hph.
        if !(hph.is_finite() && gain.is_finite()) {
            return false;
        }
        let correction = ph.scaled(gain);
        let part = |first: usize| correction.part(first);
        let turn = part(ATTITUDE);
        self.state.add(
            &part(POSITION),
            &part(VELOCITY),
            &turn,
            &part(ACCEL_BIAS),
            &part(GYRO_BIAS),
        );
        self.covariance.add_outer(&ph, -learnt_per_s);
        self.turned += turn * 0.5;
        if self.turned.norm_squared() > SMALL_TURN2 {
            self.settle();
        }
        true
    }

    /// Moves the attitude error to the new nominal attitude: `P <- G P G'` with `G = I - [error / 2]x`.
    pub(super) fn settle(&mut self) {
        self.covariance.turn_attitude(&self.turned);
        self.turned = Vector3::zeros();
    }
}
