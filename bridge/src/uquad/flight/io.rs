//! What goes in and what comes out.

use crate::autopilot::door::{Answer, Asked, Event, HostReport};
use crate::autopilot::flight::Start;
use crate::autopilot::io::FcBytes;
use crate::settings::Settings;
use crate::uquad::UquadConfig;
use crate::uquad::laws::DesignRequest;
use control::lqr::{Design, LqrError, Weights};
use control::setpoint_list::SetpointList;
use estimator::imu::Calibration;
use estimator::{SearchRequest, SearchResult};
use std::sync::Arc;
use vehicle::{
    Airframe, DownRange, FloorPlan, FlowSample, RangerReading, RingConfig, UquadAirframe,
};

/// What goes in.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a box would allocate in flight")]
pub enum UquadInput {
    /// Bytes of the inertial unit.
    Imu(FcBytes),
    /// What the motor driver sent back.
    Ack([u8; 4]),
    /// A range finder of the ring.
    Ranger(RangerReading),
    /// The down-ranger.
    DownRange(DownRange),
    /// Optical flow.
    Flow(FlowSample),
    /// A request through the door.
    Asked(Asked),
    /// A search is done.
    JobDone(SearchResult),
    /// Gains are made.
    Designed(Result<Design, LqrError>),
    /// Speeds that the motors turn at whatever the law says, rad/s: typed on the bench.
    Speeds([f64; 4]),
    /// The computer tells how it is.
    Host(HostReport),
    /// Only time has passed.
    Wake,
}

/// What comes out.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a box would allocate in flight")]
pub enum UquadOutput {
    /// A message for the motor driver.
    Motors([u8; 4]),
    /// What became of a request.
    Answer(Answer),
    /// Something happened.
    Event(Event),
    /// A search to be done outside the loop.
    Job(SearchRequest),
    /// Gains to be made outside the loop.
    Design(DesignRequest),
}

/// Everything it is made from.
#[derive(Clone, Debug)]
pub struct UquadFlightConfig {
    /// Walls.
    pub plan: Arc<FloorPlan>,
    /// The ring of range finders; none = no position source, 8 states.
    pub ring: Option<RingConfig>,
    /// Where it stands.
    pub start: Start,
    /// Parameters.
    pub settings: Settings,
    /// Of the particles.
    pub seed: u64,
    /// Of the inertial unit.
    pub calibration: Calibration,
    /// Law and filter, from [`laws::config`](crate::uquad::laws::config).
    pub uquad: UquadConfig,
    /// Gains are made again for headings they were not made for; none = they are from a file and stay.
    pub weights: Option<Weights>,
    /// Set points that are flown in place of a MAVLink mission while none is stored.
    pub list: Option<SetpointList>,
}

/// uQuad as the modes and the navigator see it: 10-inch propellers at the ends of its arms, and legs.
#[must_use]
pub fn airframe(craft: &UquadAirframe) -> Airframe {
    Airframe {
        mass_kg: craft.mass_kg,
        max_thrust_n: 4.0 * craft.thrust_n(vehicle::uquad::DRIVER_SPEED_RADPS),
        radius_m: craft.arm_m + 0.127,
        arm_m: craft.arm_m,
        landed_height_m: 0.10,
    }
}
