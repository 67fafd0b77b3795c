//! The vehicle as the ground sees it, copied each tick.

use super::{FcBlocks, Refusal};
use crate::autopilot::handover::Steering;
use crate::autopilot::latency::LatencySummary;
use crate::autopilot::mode::ModeState;
use arrayvec::ArrayVec;
use planner::navigator::Avoidance;
use serde::{Deserialize, Serialize};
use vehicle::{
    BaroSample, BatterySample, DownRange, FlowSample, Frd, GnssFix, ImuSample, In, NavState, Ned,
    RangeScan, Rot, Setpoint, Sticks, Timestamp,
};

/// On the ground or not: MAV_LANDED_STATE.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum LandedState {
    /// On the ground.
    #[default]
    OnGround,
    /// Flying.
    InAir,
    /// Climbing to the take-off height.
    TakingOff,
    /// Coming down.
    Landing,
}

/// Where the plan stands: MISSION_STATE.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum MissionState {
    /// No plan.
    #[default]
    None,
    /// Stored, not begun.
    NotStarted,
    /// Being flown.
    Active,
    /// Interrupted; mode Mission resumes it.
    Paused,
    /// Flown to its end.
    Complete,
}

/// Where the plan stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MissionStatus {
    /// Current item.
    pub seq: u16,
    /// Items.
    pub total: u16,
    /// State.
    pub state: MissionState,
}

/// The flight controller as the link sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FcStatus {
    /// It answers.
    pub is_connected: bool,
    /// `BTFL`, `INAV` ...; zeros before it answered.
    pub variant: [u8; 4],
    /// Firmware version.
    pub version: [u8; 3],
    /// MSP API version.
    pub api: [u8; 2],
    /// Replies a second.
    pub service_rate_hz: f64,
    /// Round trip, us, smoothed.
    pub round_trip_us: f64,
    /// Why it would not arm now.
    pub blocks: FcBlocks,
    /// Received signal strength, 0..=254, none if unknown.
    pub rssi: Option<u8>,
    /// CPU load, percent.
    pub load_percent: f64,
    /// Frames dropped for a bad checksum.
    pub bad_frames: u64,
    /// Requests that were not answered in time.
    pub timeouts: u64,
    /// Who steers beside a live radio.
    pub steering: Steering,
}

/// Timing of the flight loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopStatus {
    /// Ticks since start.
    pub ticks: u64,
    /// Periods that passed without a tick; never made up for.
    pub missed: u64,
    /// Age of the newest attitude at each RC frame, since the last arming.
    pub sample_to_command: LatencySummary,
    /// Our own share: from the arrival of a reply to the end of the write of the RC frame it caused, since the last arming.
    /// Nothing in the simulator, where our computing takes no time.
    pub reply_to_command: LatencySummary,
}

/// Whether the inertial unit measures what a craft at rest would: gravity alone, the Earth's field alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuFlags {
    /// The norm of the specific force is that of gravity.
    pub accel_is_gravity: bool,
    /// The norm of the magnetic field is that at calibration.
    pub mag_is_earth: bool,
}

/// Everything the ground may want to know, copied each tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// When it was taken.
    pub at: Timestamp,
    /// The estimate.
    pub nav: NavState,
    /// Mode and why.
    pub mode: ModeState,
    /// Motors run.
    pub is_armed: bool,
    /// On the ground or not.
    pub landed: LandedState,
    /// Manual mode of the key console is on.
    pub is_key_mode: bool,
    /// Why an arm would be refused now; none = armable.
    pub arm_blocked_by: Option<Refusal>,
    /// The set point that control follows.
    pub setpoint: Option<Setpoint>,
    /// Attitude that control asks for.
    pub attitude_target: Rot<Frd, Ned>,
    /// Velocity that control asks for, m/s.
    pub velocity_target: In<Ned>,
    /// Thrust that control asks for, 0..=1.
    pub thrust_target: f64,
    /// Acceleration that control asks for, m/s2.
    pub accel_target: In<Ned>,
    /// Yaw rate that control asks for, clockwise, rad/s.
    pub yaw_rate_target_radps: f64,
    /// What obstacle avoidance chose last.
    pub avoidance: Avoidance,
    /// Sticks sent last.
    pub sticks: Sticks,
    /// RC channels sent last, us: roll, pitch, throttle, yaw, aux ...
    pub rc_us: ArrayVec<u16, 18>,
    /// Battery.
    pub battery: Option<BatterySample>,
    /// Time the battery lasts at the present rate, s.
    pub endurance_s: Option<f64>,
    /// Way home on the plan, m; none where there is none or the place is not known.
    pub way_home_m: Option<f64>,
    /// Flight controller.
    pub fc: FcStatus,
    /// Newest inertial sample.
    pub imu: Option<ImuSample>,
    /// What its norms say; none where they are not judged (a flight controller's are its own).
    pub imu_flags: Option<ImuFlags>,
    /// Newest barometer sample.
    pub baro: Option<BaroSample>,
    /// Newest down range.
    pub down_range: Option<DownRange>,
    /// Newest optical flow.
    pub flow: Option<FlowSample>,
    /// Newest satellite fix.
    pub gnss: Option<GnssFix>,
    /// Newest reading of each horizontal ranger, as one scan.
    pub scan: Option<RangeScan>,
    /// A horizontal ranger spoke within the last second.
    pub rangers_alive: bool,
    /// Where the plan stands.
    pub mission: MissionStatus,
    /// Home, NED (zero unless it was moved), m.
    pub home: In<Ned>,
    /// Heading at home, rad.
    pub home_yaw_rad: f64,
    /// Flight loop.
    pub flight_loop: LoopStatus,
}
