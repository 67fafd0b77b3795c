//! When each sensor last spoke, and what may be flown on therefore.

use vehicle::{LocalizationState, NavHealth, Timestamp};

/// Roll, pitch and rates must be this fresh, s.
const ATTITUDE_S: f64 = 0.25;
/// Height and velocity must be this fresh, s.
const HEIGHT_S: f64 = 0.5;
const VELOCITY_S: f64 = 0.5;

/// Time of the last usable word of each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Freshness {
    pub(crate) imu: Option<Timestamp>,
    pub(crate) attitude: Option<Timestamp>,
    pub(crate) down_range: Option<Timestamp>,
    pub(crate) baro: Option<Timestamp>,
    pub(crate) flow: Option<Timestamp>,
    pub(crate) fix: Option<Timestamp>,
    /// A pose from outside that is believed like one on the plan.
    pub(crate) external: Option<Timestamp>,
    /// Velocity from outside.
    pub(crate) external_velocity: Option<Timestamp>,
}

fn is_fresh(at: Option<Timestamp>, now: Timestamp, limit_s: f64) -> bool {
    at.is_some_and(|t| now.seconds_since(t) < limit_s)
}

impl Freshness {
    pub(crate) fn has_range(&self, now: Timestamp) -> bool {
        is_fresh(self.down_range, now, HEIGHT_S)
    }

    pub(crate) fn has_flow(&self, now: Timestamp) -> bool {
        is_fresh(self.flow, now, VELOCITY_S) || is_fresh(self.external_velocity, now, VELOCITY_S)
    }

    pub(crate) fn has_external(&self, now: Timestamp) -> bool {
        is_fresh(self.external, now, VELOCITY_S)
    }

    pub(crate) fn health(
        &self,
        now: Timestamp,
        localization: LocalizationState,
        is_landed: bool,
    ) -> NavHealth {
        let attitude =
            is_fresh(self.imu, now, ATTITUDE_S) && is_fresh(self.attitude, now, ATTITUDE_S);
        let has_external = self.has_external(now);
        let position = localization == LocalizationState::Localized || has_external;
        let has_fix = has_external || position && is_fresh(self.fix, now, VELOCITY_S);
        NavHealth {
            attitude,
            height: attitude && (self.has_range(now) || is_fresh(self.baro, now, HEIGHT_S)),
            velocity: attitude && (self.has_flow(now) || has_fix || is_landed),
            position: attitude && position,
        }
    }
}
