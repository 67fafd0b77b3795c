//! What goes into `Flight` and what comes out: values only. A flight is its log of inputs.

use super::door::{Answer, Asked, Event, HostReport};
use crate::sensor::Sample;
use arrayvec::ArrayVec;
use estimator::{SearchRequest, SearchResult};
use serde::{Deserialize, Serialize};
use vehicle::{DownRange, ExternalPose, FlowSample, GnssFix, RangerReading};

/// A piece of the byte stream from or to the flight controller.
pub type FcBytes = ArrayVec<u8, 256>;

/// Everything that can happen to `Flight`. No variant carries a true pose, velocity or wall: what the simulator knows
/// cannot reach the estimator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Input {
    /// Bytes from the flight controller.
    Fc(FcBytes),
    /// The line to the flight controller was opened (again).
    FcOpened,
    /// A range finder of the ring.
    Ranger(RangerReading),
    /// The down-ranger.
    DownRange(DownRange),
    /// Optical flow.
    Flow(FlowSample),
    /// A request through the door.
    Asked(Asked),
    /// A job has been done.
    JobDone(SearchResult),
    /// Only time has passed.
    Wake,
    /// The line to the flight controller is gone.
    FcClosed,
    /// A satellite fix.
    Gnss(GnssFix),
    /// A pose from a camera or a tracking system.
    Pose(ExternalPose),
    /// The computer tells how it is.
    Host(HostReport),
}

impl From<Sample> for Input {
    fn from(sample: Sample) -> Self {
        match sample {
            Sample::Ranger(reading) => Self::Ranger(reading),
            Sample::DownRange(range) => Self::DownRange(range),
            Sample::Flow(flow) => Self::Flow(flow),
            Sample::Gnss(fix) => Self::Gnss(fix),
            Sample::Pose(pose) => Self::Pose(pose),
        }
    }
}

/// What `Flight` wants done.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "kept in a preallocated queue; a box would allocate in flight"
)]
pub enum Output {
    /// Bytes to the flight controller, whole frames.
    Fc(FcBytes),
    /// What became of a request.
    Answer(Answer),
    /// Something happened.
    Event(Event),
    /// Long work to be done outside the loop; comes back as [`Input::JobDone`].
    Job(SearchRequest),
}
