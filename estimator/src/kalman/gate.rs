//! Innovation gates: what does not fit is refused, but never for ever.

use serde::{Deserialize, Serialize};
use vehicle::Timestamp;

/// Normalised innovation squared that one scalar may have: chi-squared, one degree of freedom, 99.7 %.
pub const GATE: f64 = 8.8;
/// After this long of nothing but refusals the state is believed to be wrong, not the sensor, s.
const PATIENCE_S: f64 = 1.0;

/// Each scalar the filter can be corrected with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aid {
    /// Roll of the flight controller.
    Roll,
    /// Pitch of the flight controller.
    Pitch,
    /// Heading of the flight controller (odometry only).
    Heading,
    /// Change of the flight controller's heading over a window.
    HeadingIncrement,
    /// Down-looking range.
    Height,
    /// Barometer.
    Baro,
    /// Optical flow about body x.
    FlowX,
    /// Optical flow about body y.
    FlowY,
    /// Plan pose, along the direction the particles know worst.
    PoseLong,
    /// Plan pose, across it.
    PoseCross,
    /// Plan pose, yaw.
    PoseYaw,
    /// Velocity, north.
    VelocityNorth,
    /// Velocity, east.
    VelocityEast,
    /// Velocity, down.
    VelocityDown,
    /// Angular rate on the ground: nothing turns.
    Rate,
    /// Pose from outside, north.
    ExternalNorth,
    /// Pose from outside, east.
    ExternalEast,
    /// Pose from outside, yaw.
    ExternalYaw,
    /// Velocity from outside, forward.
    ExternalForward,
    /// Velocity from outside, right.
    ExternalRight,
    /// Satellite fix, north.
    GnssNorth,
    /// Satellite fix, east.
    GnssEast,
}

impl Aid {
    /// Number of aids.
    pub const COUNT: usize = 22;
    /// All, in order.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Roll,
        Self::Pitch,
        Self::Heading,
        Self::HeadingIncrement,
        Self::Height,
        Self::Baro,
        Self::FlowX,
        Self::FlowY,
        Self::PoseLong,
        Self::PoseCross,
        Self::PoseYaw,
        Self::VelocityNorth,
        Self::VelocityEast,
        Self::VelocityDown,
        Self::Rate,
        Self::ExternalNorth,
        Self::ExternalEast,
        Self::ExternalYaw,
        Self::ExternalForward,
        Self::ExternalRight,
        Self::GnssNorth,
        Self::GnssEast,
    ];
}

/// What an aid did so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AidStatus {
    /// Scalars used.
    pub accepted: u32,
    /// Scalars refused by the gate.
    pub rejected: u32,
    /// Last innovation, unit of the measurement.
    pub innovation: f64,
    /// Last innovation squared over its variance.
    pub normalised: f64,
    /// Last time one was used.
    pub accepted_at: Option<Timestamp>,
}

/// What to do with a scalar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Verdict {
    Use,
    Refuse,
    /// Use, after adding this much to the predicted variance of the innovation: the state was wrong for too long.
    Widen(f64),
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Gate {
    status: AidStatus,
    refusing_since: Option<Timestamp>,
    seen_at: Option<Timestamp>,
}

impl Gate {
    pub(crate) const fn status(&self) -> AidStatus {
        self.status
    }

    pub(crate) fn reset(&mut self) {
        self.refusing_since = None;
    }

    /// How long it has refused by now: from the first refusal in a row to the newest scalar, s.
    pub(crate) fn refused_s(&self) -> f64 {
        match (self.refusing_since, self.seen_at) {
            (Some(since), Some(at)) => at.seconds_since(since).max(0.0),
            _ => 0.0,
        }
    }

    /// Seconds since the previous scalar of this aid.
    pub(crate) fn spacing_s(&mut self, at: Timestamp) -> f64 {
        let spacing = self.seen_at.map_or(f64::INFINITY, |t| at.seconds_since(t));
        self.seen_at = Some(at);
        spacing
    }

    /// Judges an innovation by its predicted variance; the caller has its inverse at hand.
    pub(crate) fn judge(
        &mut self,
        at: Timestamp,
        innovation: f64,
        variance: f64,
        inverse: f64,
    ) -> Verdict {
        let normalised = innovation * innovation * inverse;
        self.status.innovation = innovation;
        self.status.normalised = normalised;
        if normalised <= GATE {
            self.refusing_since = None;
            self.status.accepted = self.status.accepted.saturating_add(1);
            self.status.accepted_at = Some(at);
            return Verdict::Use;
        }
        let since = *self.refusing_since.get_or_insert(at);
        if at.seconds_since(since) >= PATIENCE_S {
            self.refusing_since = None;
            self.status.accepted = self.status.accepted.saturating_add(1);
            self.status.accepted_at = Some(at);
            return Verdict::Widen(innovation * innovation / GATE - variance);
        }
        self.status.rejected = self.status.rejected.saturating_add(1);
        Verdict::Refuse
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spike_is_refused_and_a_second_of_spikes_is_believed() {
        let mut gate = Gate::default();
        let at = Timestamp::from_ms;
        assert_eq!(gate.judge(at(0), 1.0, 1.0, 1.0), Verdict::Use);
        assert_eq!(gate.judge(at(100), 10.0, 1.0, 1.0), Verdict::Refuse);
        assert_eq!(gate.judge(at(200), 1.0, 1.0, 1.0), Verdict::Use);
        assert_eq!(gate.judge(at(300), 10.0, 1.0, 1.0), Verdict::Refuse);
        assert_eq!(gate.judge(at(1290), 10.0, 1.0, 1.0), Verdict::Refuse);
        assert_eq!(
            gate.judge(at(1300), 10.0, 1.0, 1.0),
            Verdict::Widen(100.0 / GATE - 1.0)
        );
        assert_eq!((gate.status().accepted, gate.status().rejected), (3, 3));
    }

    #[test]
    fn every_aid_has_its_own_place() {
        for (i, aid) in Aid::ALL.iter().enumerate() {
            assert_eq!(*aid as usize, i);
        }
    }
}
