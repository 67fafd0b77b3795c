//! What may be asked of the vehicle, and what that carries.

use crate::autopilot::bench_work::{MotorTurn, Sensor};
use crate::autopilot::mode::Mode;
use crate::sensor::Sample;
use planner::fence::Site;
use planner::mission::Plan;
use planner::trajectory::{Figure, Nose};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vehicle::{In, Ned, ParamValue};

/// What may be asked of the vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// Start the motors. `force` skips our pre-flight checks, never the flight controller's.
    Arm {
        /// Skip pre-flight checks.
        force: bool,
    },
    /// Stop the motors. In flight only with `force`.
    Disarm {
        /// Also in flight.
        force: bool,
    },
    /// Change the mode.
    SetMode(Mode),
    /// Climb to a height above home's floor (the parameter's if none); starts on arm if disarmed.
    Takeoff {
        /// m, positive up.
        height_m: Option<f64>,
    },
    /// Fly to a place and hover. What is none stays as it is; all none = stop here.
    GoTo(GoTo),
    /// Fly around something until told otherwise, in mode Hold.
    Figure(FigureRequest),
    /// Replace the plan. The old one comes back in [`Event::PlanRetired`](super::Event::PlanRetired).
    SetPlan(Arc<Plan>),
    /// Replace fence and rally points. The old ones come back in [`Event::SiteRetired`](super::Event::SiteRetired).
    SetSite(Arc<Site>),
    /// Continue the plan at an item.
    SetMissionItem(u16),
    /// Start the plan at an item (MAV_CMD_MISSION_START).
    StartMission {
        /// First item.
        first: u16,
    },
    /// Cruise speed, m/s.
    ChangeSpeed(f64),
    /// Sticks of a pilot.
    Manual(ManualInput),
    /// RC channels as a pilot's radio would send them, us; none = not overridden. Order roll, pitch, throttle, yaw.
    RcOverride([Option<u16>; 4]),
    /// One off-board set point.
    Offboard(OffboardSetpoint),
    /// A key of the key console.
    Key(Key),
    /// Hold here, whoever asks; again within 3 s = land.
    Stop,
    /// Set home here, or at a place.
    SetHome(Option<In<Ned>>),
    /// A parameter, already checked, by its index in [`Settings`](crate::settings::Settings).
    SetParam {
        /// Flat index.
        index: u16,
        /// Value.
        value: ParamValue,
    },
    /// A ground station's heartbeat arrived.
    GroundHeartbeat,
    /// Land (or disarm on the ground); the program wants to end.
    ShutDown,
    /// Calibrate a sensor of the flight controller, on the ground.
    Calibrate(Sensor),
    /// End what is done to the flight controller: a motor test stops, a calibration is no longer waited for.
    EndBenchWork,
    /// Turn a motor, on the ground (parameter KST_MOTOR_TEST).
    TurnMotor(MotorTurn),
    /// Restart the flight controller, on the ground.
    RestartFc,
    /// A sensor whose messages come over a link. It is not answered.
    Sensed(Sample),
    /// Break or mend something of a simulated vehicle; whoever simulates it carries it out, a real vehicle refuses.
    Inject(Failure),
}

/// A failure to be injected (MAV_CMD_INJECT_FAILURE).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// What fails.
    pub unit: FailureUnit,
    /// How.
    pub kind: FailureKind,
    /// Which of them, from 1; 0 all.
    pub instance: u8,
}

/// What fails (FAILURE_UNIT, as far as it is simulated).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FailureUnit {
    /// Optical flow.
    Flow,
    /// Range finders.
    Distance,
    /// The battery.
    Battery,
    /// Motors.
    Motor,
    /// The line of the flight controller.
    Controller,
}

/// How it fails (FAILURE_TYPE, as far as it is simulated).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FailureKind {
    /// It works again.
    Ok,
    /// It says nothing, gives nothing.
    Off,
    /// It says the same for ever.
    Stuck,
    /// What it says is not so.
    Wrong,
    /// It comes and goes.
    Intermittent,
}

/// Target of [`Request::GoTo`]; none keeps what is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GoTo {
    /// NED x about home, m.
    pub north_m: Option<f64>,
    /// NED y about home, m.
    pub east_m: Option<f64>,
    /// NED z about home, m.
    pub down_m: Option<f64>,
    /// Clockwise from north, rad.
    pub yaw_rad: Option<f64>,
    /// m/s.
    pub speed_mps: Option<f64>,
}

/// Target of [`Request::Figure`]; what is none is where the vehicle is, or the usual.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FigureRequest {
    /// Centre, NED x about home, m.
    pub north_m: Option<f64>,
    /// Centre, NED y about home, m.
    pub east_m: Option<f64>,
    /// NED z about home, m.
    pub down_m: Option<f64>,
    /// Of an orbit; of an eight centre to its far ends, m.
    pub radius_m: f64,
    /// Half the width of an eight, m; none = an orbit.
    pub minor_m: Option<f64>,
    /// Direction of the long axis of an eight, clockwise from north, rad.
    pub axis_rad: f64,
    /// Seen from above (an eight: its end in the direction of the axis).
    pub is_clockwise: bool,
    /// m/s.
    pub speed_mps: Option<f64>,
    /// Rounds; none = until something else is asked for.
    pub rounds: Option<f64>,
    /// Where the nose points.
    pub nose: FigureNose,
}

/// Where the nose points on a figure: ORBIT_YAW_BEHAVIOUR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum FigureNose {
    /// HOLD_FRONT_TO_CIRCLE_CENTER.
    #[default]
    Centre,
    /// HOLD_INITIAL_HEADING.
    Initial,
    /// HOLD_FRONT_TANGENT_TO_CIRCLE.
    Tangent,
}

impl From<FigureNose> for Nose {
    fn from(nose: FigureNose) -> Self {
        match nose {
            FigureNose::Centre => Self::Centre,
            FigureNose::Initial => Self::Initial,
            FigureNose::Tangent => Self::Tangent,
        }
    }
}

impl From<FigureRequest> for Figure {
    fn from(asked: FigureRequest) -> Self {
        match asked.minor_m {
            None => Self::Orbit {
                radius_m: asked.radius_m,
                is_clockwise: asked.is_clockwise,
            },
            Some(minor_m) => Self::Eight {
                major_m: asked.radius_m,
                minor_m,
                axis_rad: asked.axis_rad,
                is_clockwise: asked.is_clockwise,
            },
        }
    }
}

/// Sticks of MANUAL_CONTROL, -1..=1; none = axis not used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ManualInput {
    /// Forward +.
    pub forward: Option<f64>,
    /// Right +.
    pub right: Option<f64>,
    /// Clockwise +.
    pub yaw: Option<f64>,
    /// 0..=1, 0.5 = hold height (thrust itself in Stabilized).
    pub throttle: Option<f64>,
}

/// Frame of an off-board set point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum OffboardFrame {
    /// NED about home (MAV_FRAME_LOCAL_NED; global frames arrive converted).
    Local,
    /// Position relative to where the vehicle is, along NED (MAV_FRAME_LOCAL_OFFSET_NED).
    LocalOffset,
    /// Relative to the vehicle, along its heading, level (MAV_FRAME_BODY_NED, BODY_OFFSET_NED, BODY_FRD).
    Body,
}

/// One off-board set point: what is none is not controlled by it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum OffboardSetpoint {
    /// Position and velocity, each axis on its own.
    Motion {
        /// Frame of all axes.
        frame: OffboardFrame,
        /// m.
        position: [Option<f64>; 3],
        /// m/s.
        velocity: [Option<f64>; 3],
        /// rad, clockwise from north (relative to heading in body frames).
        yaw_rad: Option<f64>,
        /// rad/s clockwise.
        yaw_rate_radps: Option<f64>,
    },
    /// Attitude and thrust (SET_ATTITUDE_TARGET).
    Attitude {
        /// Right side down +, rad.
        roll_rad: f64,
        /// Nose up +, rad.
        pitch_rad: f64,
        /// Clockwise from north, rad; none = use the rate.
        yaw_rad: Option<f64>,
        /// rad/s clockwise.
        yaw_rate_radps: Option<f64>,
        /// 0..=1.
        thrust: f64,
    },
}

/// Keys of the key console, already decoded (uQuad's table, seed-facts 1.8; our signs in `gcs/keys.rs`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Key {
    /// m: manual mode on or off (allowed in Hold while flying).
    ToggleManual,
    /// j +, g -: roll right set point, one step of 0.045 rad.
    Roll(Step),
    /// y +, h -: nose down set point, one step of 0.045 rad.
    NoseDown(Step),
    /// q +, w -: counter-clockwise yaw set point, one step of 0.045 rad.
    YawLeft(Step),
    /// e +, d -: height set point, one step of 0.2 m.
    Height(Step),
    /// i +, k -: mass of the thrust model, one step of 0.05 kg.
    Mass(Step),
    /// 0: mass back to the airframe's.
    MassDefault,
    /// 8 forward, 2 back: hover position along the heading, one step of 0.2 m.
    NudgeForward(Step),
    /// 6 right, 4 left: hover position across the heading, one step of 0.2 m.
    NudgeRight(Step),
    /// Lone ENTER: a marker into the log.
    Marker,
    /// Lone ESC: land in flight, disarm on the ground.
    Escape,
}

/// Direction of a key's step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Step {
    /// One step up.
    Plus,
    /// One step down.
    Minus,
}

impl Step {
    /// +1 or -1.
    #[must_use]
    pub const fn sign(self) -> f64 {
        match self {
            Self::Plus => 1.0,
            Self::Minus => -1.0,
        }
    }
}

/// How the computer is, as the shell finds it; once a second, and when something changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HostReport {
    /// Its hottest sensor, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// It runs slower than it could, for heat or for want of voltage.
    pub is_throttled: bool,
    /// Flights are not being logged: the disk is full or broken.
    pub disk_fails: bool,
    /// The wall clock jumped by more than a second lately.
    pub clock_jumped: bool,
    /// Ground side, web or video are behind with their work.
    pub is_overloaded: bool,
}
