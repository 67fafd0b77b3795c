//! The table of streams: message, default rate, builder.

use super::{Flights, PlanIds, identity, own, pose, ranges, status, target};
use crate::autopilot::door::Snapshot;
use crate::gcs::convert::GeoAnchor;
use crate::gcs::fence::FenceState;
use crate::settings::Settings;
use mavlink_dialect::{Address, Message};
use vehicle::Timestamp;

/// What builders look at.
pub(super) struct View<'a> {
    pub(super) now: Timestamp,
    pub(super) snapshot: &'a Snapshot,
    pub(super) settings: &'a Settings,
    pub(super) geo: GeoAnchor,
    pub(super) us: Address,
    pub(super) boot_utc_us: u64,
    pub(super) flights: &'a Flights,
    pub(super) plan_ids: PlanIds,
    pub(super) fence: FenceState,
}

type Build = fn(&View<'_>, &mut Vec<Message>);

/// One message we can send.
pub(super) struct Row {
    pub(super) id: u32,
    /// Time between two by default, us; 0 only on request.
    pub(super) period_us: u32,
    pub(super) build: Build,
}

const fn row(id: u32, hz: f64, build: Build) -> Row {
    Row {
        id,
        period_us: if hz > 0.0 { (1e6 / hz) as u32 } else { 0 },
        build,
    }
}

pub(super) const HEARTBEAT: u32 = 0;
pub(super) const MISSION_CURRENT: u32 = 42;
pub(super) const GPS_GLOBAL_ORIGIN: u32 = 49;
pub(super) const HOME_POSITION: u32 = 242;
pub(super) const EXTENDED_SYS_STATE: u32 = 245;
pub(super) const AVAILABLE_MODES: u32 = 435;
pub(super) const CURRENT_MODE: u32 = 436;

/// Every stream, by message id. Default rates come to about 6 kB a second; 0 = on request or by interval only.
pub(super) const TABLE: &[Row] = &[
    row(1, 1.0, status::sys_status),
    row(2, 1.0, status::system_time),
    row(24, 1.0, pose::gps_raw_int),
    row(26, 0.0, pose::scaled_imu),
    row(27, 0.0, pose::raw_imu),
    row(30, 20.0, pose::attitude),
    row(31, 10.0, pose::attitude_quaternion),
    row(32, 20.0, pose::local_position_ned),
    row(33, 5.0, pose::global_position_int),
    row(MISSION_CURRENT, 1.0, status::mission_current),
    row(GPS_GLOBAL_ORIGIN, 0.2, pose::gps_global_origin),
    row(65, 2.0, status::rc_channels),
    row(74, 4.0, pose::vfr_hud),
    row(83, 0.0, target::attitude_target),
    row(85, 0.0, target::position_target_local_ned),
    row(100, 0.0, ranges::optical_flow),
    row(105, 0.0, pose::highres_imu),
    row(132, 5.0, ranges::distance_sensor),
    row(141, 4.0, pose::altitude),
    row(147, 0.5, status::battery_status),
    row(148, 0.0, identity::autopilot_version),
    row(162, 1.0, status::fence_status),
    row(230, 1.0, pose::estimator_status),
    row(HOME_POSITION, 0.5, pose::home_position),
    row(EXTENDED_SYS_STATE, 1.0, status::extended_sys_state),
    row(251, 0.2, status::timing),
    row(264, 0.0, status::flight_information),
    row(300, 0.0, identity::protocol_version),
    row(330, 5.0, ranges::obstacle_distance),
    row(331, 10.0, pose::odometry),
    row(397, 0.0, identity::component_metadata),
    row(AVAILABLE_MODES, 0.0, identity::available_modes),
    // Begins on a link where somebody asks for AVAILABLE_MODES: older dialects count an id they do not know as a lost frame.
    row(CURRENT_MODE, 0.0, status::current_mode),
    row(53_000, 0.0, own::localization),
    row(53_001, 0.0, own::avoidance),
    row(53_002, 0.0, own::control),
    row(53_003, 0.0, own::flight_loop),
];

/// Place of a message in the table.
pub(super) fn index_of(id: u32) -> Option<usize> {
    TABLE.binary_search_by_key(&id, |r| r.id).ok()
}
