//! What sensors deliver, in SI and our frames, each with the time it was true.

use crate::{Frd, In, Ned, Timestamp};
use arrayvec::ArrayVec;
use serde::{Deserialize, Serialize};

/// Most beams one [`RangeScan`] carries.
pub const MAX_BEAMS: usize = 64;
/// Most columns one ranger reports at once.
pub const MAX_COLUMNS: usize = 8;

/// Inertial sample of the flight controller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImuSample {
    /// When it was measured, our clock.
    pub at: Timestamp,
    /// Specific force, m/s2: level at rest is (0, 0, -9.81).
    pub accel_mps2: In<Frd>,
    /// Angular rate, rad/s.
    pub gyro_radps: In<Frd>,
    /// Magnetic field in counts of the sensor, whose scale the flight controller does not tell: direction and changes of
    /// the norm mean something, the norm does not. None without a magnetometer. Indoors steel bends it by tens of degrees.
    pub mag: Option<In<Frd>>,
}

/// Attitude as the flight controller's own filter has it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AttitudeSample {
    /// When it was measured, our clock.
    pub at: Timestamp,
    /// Roll, right side down +, rad.
    pub roll_rad: f64,
    /// Pitch, nose up +, rad.
    pub pitch_rad: f64,
    /// The controller's heading, clockwise +, rad. Without a compass its zero is arbitrary and drifts: use its changes.
    pub heading_rad: f64,
}

/// Barometric altitude (and climb rate) of the flight controller, zero where it was armed or started.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BaroSample {
    /// When it was measured, our clock.
    pub at: Timestamp,
    /// Altitude, up +, m.
    pub altitude_m: f64,
    /// Climb rate, up +, m/s.
    pub climb_mps: f64,
}

/// Battery as the flight controller reports it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BatterySample {
    /// When it was measured, our clock.
    pub at: Timestamp,
    /// Pack voltage, V.
    pub voltage_v: f64,
    /// Current, A.
    pub current_a: f64,
    /// Charge used since start, mAh.
    pub used_mah: f64,
    /// Number of cells, 0 when unknown.
    pub cells: u8,
    /// Charge left, 0..=1, if it can be told.
    pub remaining: Option<f64>,
}

/// Distance to the floor along body down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DownRange {
    /// When it was measured, our clock.
    pub at: Timestamp,
    /// Distance along the body's down axis, m; none without a valid return.
    pub distance_m: Option<f64>,
}

/// Optical flow, axes and signs as MAVLink OPTICAL_FLOW_RAD: with d = distance to the floor along body down,
/// `x = gyro_x - v_right / d`, `y = gyro_y + v_forward / d`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlowSample {
    /// Middle of the exposure, our clock.
    pub at: Timestamp,
    /// Flow about body x (forward), rad/s.
    pub x_radps: f64,
    /// Flow about body y (right), rad/s.
    pub y_radps: f64,
    /// 0 (unusable) ..= 255 (best).
    pub quality: u8,
}

/// Pose from a camera, a tracking system or another localizer (VISION_POSITION_ESTIMATE, ODOMETRY).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExternalPose {
    /// When it was measured, our clock.
    pub at: Timestamp,
    /// What its position and yaw are relative to.
    pub frame: ExternalFrame,
    /// m.
    pub position: In<Ned>,
    /// Clockwise from the frame's x, rad.
    pub yaw_rad: f64,
    /// Velocity along the body's axes, m/s, if it is told.
    pub velocity: Option<In<Frd>>,
    /// Doubt of each horizontal position axis, one standard deviation, m; none if it is not told.
    pub position_std_m: Option<f64>,
    /// Doubt of yaw, one standard deviation, rad; none if it is not told.
    pub yaw_std_rad: Option<f64>,
    /// Changes when the source jumps.
    pub reset_counter: u8,
}

/// What an [`ExternalPose`] is relative to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExternalFrame {
    /// Our local frame: NED about home. It is believed like a place on the plan.
    Local,
    /// A frame of its own that drifts: only its changes count.
    Own,
}

/// A satellite fix, metres from where the receiver first knew its place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GnssFix {
    /// When it was received, our clock.
    pub at: Timestamp,
    /// North, east, down from the first fix, m.
    pub position: In<Ned>,
    /// m/s, if it is told.
    pub velocity: Option<In<Ned>>,
    /// Doubt north and east, down, one standard deviation, m.
    pub std_m: [f64; 2],
    /// Latitude and longitude, degrees.
    pub place_deg: [f64; 2],
    /// Above mean sea level, m.
    pub altitude_m: f64,
    /// Satellites in use, 0 if not told.
    pub satellites: u8,
}

/// One firing of one range finder of the ring, as its driver delivers it: millimetres, by column.
///
/// What a column means (bearing, ray or depth along the axis) is in the ranger's [`RangerConfig`](crate::RangerConfig).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RangerReading {
    /// When it was measured, our clock.
    pub at: Timestamp,
    /// Index into [`RingConfig::rangers`](crate::RingConfig).
    pub ranger: u8,
    /// Column readings, left-most seen from the sensor first, mm; none without a valid return.
    pub columns_mm: ArrayVec<Option<u16>, MAX_COLUMNS>,
}

/// One beam of a scan: a ray from the body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beam {
    /// Where the ray starts, m from the body centre.
    pub origin: In<Frd>,
    /// Direction in the body's horizontal plane, clockwise from forward, rad.
    pub bearing_rad: f64,
    /// Direction above the body's horizontal plane, rad.
    pub elevation_rad: f64,
    /// Half the opening angle of the cone that the reading is the nearest return of, rad (0 for a ray).
    pub half_cone_rad: f64,
    /// Length along the ray from its origin, m; none without a valid return.
    pub distance_m: Option<f64>,
    /// Shortest distance that can be measured, m.
    pub min_m: f64,
    /// Longest distance that can be measured along this ray, m.
    pub max_m: f64,
}

/// Beams measured together around the vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RangeScan {
    /// When it was measured, our clock.
    pub at: Timestamp,
    /// The beams.
    pub beams: ArrayVec<Beam, MAX_BEAMS>,
}
