//! What pages are shown: the vehicle as it is, put down by the main thread, picked up by every page at its own pace.

use crate::autopilot::door::Snapshot;
use crate::autopilot::insight::Insight;
use crate::gcs::operator::Control;

/// One look at the vehicle.
#[derive(Clone, Debug, Default)]
pub struct Picture {
    /// What MAVLink telemetry is made from.
    pub snapshot: Snapshot,
    /// What it thinks.
    pub insight: Insight,
    /// Who may fly.
    pub control: Control,
    /// Links up.
    pub links: u32,
    /// Frames and datagrams dropped at full queues.
    pub dropped: u64,
}
