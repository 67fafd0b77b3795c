//! The door between [`Flight`](super::flight::Flight) and [`Ground`](super::ground::Ground): typed values only.
//!
//! One way go [`Asked`] requests, each with the station that asked. The other way come [`Answer`]s, [`Event`]s and a
//! [`Snapshot`] copied each tick. Nothing else passes; `Flight` formats no text, so reasons travel as values
//! ([`Refusal`], [`Notice`]) and become words in `Ground`.

pub use super::bench_work::{MotorTurn, Progress, Sensor};
use super::handover::Steering;
use super::latency::LatencySummary;
use super::mode::{Because, Mode, ModeState};
use crate::sensor::Sample;
use crate::uquad::aircraft::Off;
use arrayvec::ArrayVec;
use msp::firmware::{ArmingBlocker, arming_blockers};
use msp::message::FcVariant;
use planner::fence::Site;
use planner::mission::Plan;
use planner::navigator::Avoidance;
use planner::trajectory::{Figure, Nose};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;
use vehicle::{
    BaroSample, BatterySample, DownRange, FlowSample, Frd, GnssFix, ImuSample, In, NavState, Ned,
    ParamValue, RangeScan, Rot, Setpoint, Sticks, Timestamp,
};

/// Matches an [`Answer`] to its [`Asked`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RequestId(pub u32);

/// Who asked: enough to know one station from another, nothing about links.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Station {
    /// MAVLink system id.
    pub system: u8,
    /// MAVLink component id.
    pub component: u8,
}

/// A request with its sender.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Asked {
    /// Comes back in the answer.
    pub id: RequestId,
    /// Who asked.
    pub station: Station,
    /// What for.
    pub request: Request,
}

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
    /// Replace the plan. The old one comes back in [`Event::PlanRetired`].
    SetPlan(Arc<Plan>),
    /// Replace fence and rally points. The old ones come back in [`Event::SiteRetired`].
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

/// What became of a request.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Of which request.
    pub id: RequestId,
    /// Who asked.
    pub station: Station,
    /// What became of it.
    pub outcome: Outcome,
}

/// What became of a request.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Outcome {
    /// Done, or begun.
    Accepted,
    /// A key was taken; the set point now is this.
    KeyTaken(KeySetpoint),
    /// Not done.
    Refused(Refusal),
}

/// Set point of key mode, for the reply to each key.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct KeySetpoint {
    /// Manual mode is on.
    pub is_manual: bool,
    /// Roll right +, rad.
    pub roll_rad: f64,
    /// Nose down +, rad.
    pub nose_down_rad: f64,
    /// Clockwise from north, rad.
    pub yaw_rad: f64,
    /// NED about home, m.
    pub position: In<Ned>,
    /// Mass of the thrust model, kg.
    pub mass_kg: f64,
}

/// How a refusal is reported: MAV_RESULT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RefusalClass {
    /// Not now: MAV_RESULT_TEMPORARILY_REJECTED.
    NotNow,
    /// Never like this: MAV_RESULT_DENIED.
    Denied,
    /// Not built or not known: MAV_RESULT_UNSUPPORTED.
    Unsupported,
}

/// Why a request was refused. `Display` is the sentence for the pilot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Refusal {
    /// The flight controller does not answer.
    FcSilent,
    /// The flight controller blocks arming.
    FcBlocks(FcBlocks),
    /// It did not arm in time.
    FcDidNotArm,
    /// Roll, pitch or height is not known yet.
    NoAttitude,
    /// The place on the plan is not known.
    NotLocalized,
    /// The search flight is not allowed (parameter LOC_SEARCH).
    SearchDisabled,
    /// No ranger delivers.
    NoRangers,
    /// The battery is too low, percent.
    BatteryLow {
        /// Percent left.
        percent: u8,
    },
    /// Disarmed, and the request needs a flying vehicle.
    NotFlying,
    /// Armed or flying, and the request needs a vehicle at rest.
    Flying,
    /// Needs to be armed first.
    NotArmed,
    /// Needs to be disarmed first.
    Armed,
    /// No plan is stored.
    NoPlan,
    /// The plan has no such item.
    NoSuchItem {
        /// Asked for.
        seq: u16,
        /// Items of the plan.
        total: u16,
    },
    /// A place outside the plan or too near a wall.
    PlaceBlocked,
    /// A place outside the fence, in a no-fly zone, or too near to their border.
    OutsideFence,
    /// No way leads there.
    NoRoute,
    /// Off-board needs a stream of set points first.
    NoOffboardStream,
    /// Another station is steering.
    OtherStation {
        /// Its system id.
        system: u8,
    },
    /// Keys count only while manual mode is on (`m`).
    KeyModeOff,
    /// Manual input counts only in stick modes.
    NotStickMode,
    /// A number is NaN, infinite or out of range.
    BadNumber,
    /// The vehicle is being shut down.
    ShuttingDown,
    /// A failsafe holds the vehicle.
    Failsafe(Because),
    /// Not built.
    Unsupported,
    /// Its firmware is not one we know: it may be watched, not flown.
    FcUnknown {
        /// What it calls itself.
        variant: [u8; 4],
    },
    /// It answers, but its scheduler does not run.
    FcStalled,
    /// Arming is under way already.
    ArmingUnderWay,
    /// Somebody disarmed before the motors ran.
    DisarmedMeanwhile,
    /// Beside a live radio the pilot arms and disarms.
    PilotArms,
    /// The pilot's radio steers; his override switch is off.
    PilotSteers,
    /// A calibration, motor test or restart is under way.
    BenchBusy,
    /// Motor tests are switched off.
    MotorTestOff,
    /// The flight controller refused the order.
    FcRefused,
    /// The motors of a craft without flight controller were stopped for a reason; the program must be started again.
    MotorsOff(Off),
}

impl Refusal {
    /// How it is reported.
    #[must_use]
    pub const fn class(&self) -> RefusalClass {
        match self {
            Self::BadNumber
            | Self::PlaceBlocked
            | Self::OutsideFence
            | Self::NoSuchItem { .. }
            | Self::Flying
            | Self::MotorTestOff
            | Self::FcRefused
            | Self::NotArmed
            | Self::Armed => RefusalClass::Denied,
            Self::Unsupported => RefusalClass::Unsupported,
            _ => RefusalClass::NotNow,
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FcSilent => write!(f, "flight controller does not answer"),
            Self::FcBlocks(blocks) => write!(f, "flight controller blocks arming: {blocks}"),
            Self::FcDidNotArm => write!(f, "flight controller did not arm in time"),
            Self::NoAttitude => write!(f, "attitude and height are not known yet"),
            Self::NotLocalized => write!(f, "not localized"),
            Self::SearchDisabled => write!(f, "not localized and LOC_SEARCH is 0"),
            Self::NoRangers => write!(f, "range finders are silent"),
            Self::BatteryLow { percent } => write!(f, "battery low ({percent} %)"),
            Self::NotFlying => write!(f, "not flying"),
            Self::Flying => write!(f, "flying: land first"),
            Self::NotArmed => write!(f, "not armed"),
            Self::Armed => write!(f, "armed: disarm first"),
            Self::NoPlan => write!(f, "no mission stored"),
            Self::NoSuchItem { seq, total } => {
                write!(f, "no mission item {seq} (there are {total})")
            }
            Self::PlaceBlocked => write!(f, "that place is in a wall or off the plan"),
            Self::OutsideFence => write!(f, "that place is outside the fence or in a no-fly zone"),
            Self::NoRoute => write!(f, "no way leads there"),
            Self::NoOffboardStream => write!(f, "send off-board set points first"),
            Self::OtherStation { system } => write!(f, "system {system} is steering"),
            Self::KeyModeOff => write!(f, "manual mode is off (m switches it on)"),
            Self::NotStickMode => write!(f, "sticks count in Position, Altitude, Stabilized"),
            Self::BadNumber => write!(f, "a value is not a number or out of range"),
            Self::ShuttingDown => write!(f, "shutting down"),
            Self::Failsafe(because) => write!(f, "failsafe holds: {}", because.words()),
            Self::Unsupported => write!(f, "not supported"),
            Self::FcUnknown { variant } => write!(
                f,
                "flight controller firmware {} is not known: watched, not flown",
                variant.escape_ascii()
            ),
            Self::FcStalled => write!(
                f,
                "flight controller does not run its loop (cycle time 0): restart it"
            ),
            Self::ArmingUnderWay => write!(f, "arming is under way"),
            Self::DisarmedMeanwhile => write!(f, "disarmed meanwhile"),
            Self::BenchBusy => write!(f, "a calibration, motor test or restart is under way"),
            Self::MotorTestOff => write!(f, "propellers off, then set KST_MOTOR_TEST to 1"),
            Self::FcRefused => write!(f, "the flight controller refuses it"),
            Self::PilotArms => write!(f, "the pilot arms and disarms with his radio"),
            Self::MotorsOff(why) => write!(f, "motors were stopped: {}; start again", why.words()),
            Self::PilotSteers => write!(
                f,
                "the pilot steers: his MSP OVERRIDE switch must be on, then ask again"
            ),
        }
    }
}

impl Because {
    /// In words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Asked => "asked for",
            Self::Finished => "finished",
            Self::OffboardSilent => "off-board set points stopped",
            Self::ManualSilent => "manual input stopped",
            Self::GroundLost => "ground station lost",
            Self::NotLocalized => "not localized",
            Self::RangersSilent => "range finders silent",
            Self::BatteryLow => "battery low",
            Self::BatteryReserve => "battery just enough for the way home",
            Self::ShuttingDown => "shutting down",
            Self::EstimatorFailed => "estimate unusable",
            Self::FcSilent => "flight controller silent",
            Self::LoopHeld => "flight loop held up",
            Self::PilotTookOver => "pilot took over",
        }
    }
}

/// What a flight controller says blocks arming: its own bits, which are words by its firmware.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FcBlocks {
    /// What the firmware calls itself: the same bit has other names in others.
    pub variant: [u8; 4],
    /// Number of bits it knows (Betaflight; the last one is always ARM_SWITCH).
    pub count: u8,
    /// The bits as it sent them, states that block nothing among them.
    pub flags: u32,
}

impl FcBlocks {
    /// Blocks that a controller raises for want of what we are about to send, or that go when the switch is low.
    const TRANSIENT: [&str; 6] = [
        "ARM_SWITCH",
        "NOT_DISARMED",
        "BAD_RX_RECOVERY",
        "RX_FAILSAFE",
        "RC_LINK",
        "FAILSAFE",
    ];

    /// Each of them with name and advice, lowest bit first.
    pub fn blockers(&self) -> impl Iterator<Item = ArmingBlocker> + use<> {
        let variant = FcVariant {
            variant: self.variant,
        };
        arming_blockers(variant.into(), self.count, self.flags)
    }

    /// Nothing blocks.
    #[must_use]
    pub fn is_clear(&self) -> bool {
        self.blockers().next().is_none()
    }

    /// A name is among them.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.blockers().any(|b| b.name == name)
    }

    /// None but those that pass by themselves once frames with a low switch come.
    #[must_use]
    pub fn will_pass(&self) -> bool {
        self.blockers().all(|b| Self::TRANSIENT.contains(&b.name))
    }
}

/// Every flag in words: `THROTTLE (throttle is not low), ANGLE (not level enough)`.
impl fmt::Display for FcBlocks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, blocker) in self.blockers().enumerate() {
            let comma = if i > 0 { ", " } else { "" };
            write!(f, "{comma}{} ({})", blocker.name, blocker.advice)?;
        }
        Ok(())
    }
}

/// What happened, once each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// Mode changed.
    Mode(ModeState),
    /// Motors started or stopped.
    Armed(bool),
    /// Landed state changed.
    Landed(LandedState),
    /// A mission item is done.
    ItemReached(u16),
    /// Something to tell the pilot.
    Notice(Notice),
    /// Home moved.
    HomeSet,
    /// A plan no longer in use, to be freed by `Ground`.
    PlanRetired(Arc<Plan>),
    /// Fence and rally points no longer in use, the same way.
    SiteRetired(Arc<Site>),
    /// A marker of the key console.
    Marker(Timestamp),
}

/// How loud a notice is: MAV_SEVERITY.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Severity {
    /// 2.
    Critical,
    /// 3.
    Error,
    /// 4.
    Warning,
    /// 5.
    Notice,
    /// 6.
    Info,
}

/// Sentences for the pilot, as values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Notice {
    /// The flight controller answered.
    FcFound {
        /// `BTFL`, `INAV` ...
        variant: [u8; 4],
        /// Firmware version.
        version: [u8; 3],
    },
    /// The flight controller fell silent.
    FcLost {
        /// Bytes came that are no MSP: its text console may be open.
        noise: bool,
    },
    /// It is of a firmware we do not know.
    FcUnknown {
        /// What it calls itself.
        variant: [u8; 4],
    },
    /// The pilot flipped his switch: he steers.
    PilotTookOver,
    /// The pilot's switch is on: a mode may be asked for.
    PilotOffers,
    /// We steer again, by request.
    PilotHandedBack,
    /// The pilot disarmed with his radio.
    PilotDisarmed,
    /// Place found.
    Localized {
        /// On the plan, m.
        x_m: f64,
        /// On the plan, m.
        y_m: f64,
    },
    /// Place lost.
    LocalizationLost,
    /// Search flight begins.
    Searching,
    /// Search flight gave up.
    SearchFailed,
    /// A failsafe acts.
    Failsafe {
        /// Trigger.
        because: Because,
        /// Mode it set.
        mode: Mode,
    },
    /// A failsafe's cause is gone.
    FailsafeCleared(Because),
    /// A request was refused.
    Refused(Refusal),
    /// The plan is done.
    MissionFinished,
    /// An item could not be flown.
    ItemRefused {
        /// Item.
        seq: u16,
        /// Why.
        why: Refusal,
    },
    /// Return goes to a rally point, which is nearer than home.
    ToRallyPoint {
        /// Which, counted from 1.
        number: u16,
        /// Way to it, m.
        way_m: f64,
    },
    /// An obstacle blocks the way.
    WayBlocked,
    /// Battery low, percent.
    BatteryLow {
        /// Percent left.
        percent: u8,
    },
    /// Touched down.
    Landed,
    /// The flight controller disarmed by itself.
    FcDisarmed,
    /// How punctual the flight was; told when it is over.
    FlightTiming {
        /// Age of the attitude at each RC frame.
        sample_to_command: LatencySummary,
        /// Beats missed.
        missed: u64,
    },
    /// The flight controller has started anew.
    FcRestarted,
    /// The flight controller serves fewer requests than flight wants.
    FcSlow {
        /// Requests per second it serves.
        service_hz: u16,
        /// Whether one line of Betaflight's command line makes it faster.
        has_cli_line: bool,
    },
    /// The control loop of the flight controller stands still.
    FcStalled,
    /// How a calibration stands.
    Calibration {
        /// Of what.
        sensor: Sensor,
        /// How far.
        progress: Progress,
    },
    /// The inertial unit knows its zeros.
    ImuCalibrated,
    /// It was moved meanwhile and begins again.
    ImuDisturbed,
    /// The inertial unit's period was out of range.
    ImuPeriod {
        /// Measured, ms.
        ms: f64,
        /// Errors counted; ten stop the motors.
        errors: u32,
    },
    /// A craft without flight controller stopped its motors.
    MotorsOff(Off),
}

impl Notice {
    /// How loud.
    #[must_use]
    pub const fn severity(&self) -> Severity {
        match self {
            Self::FcLost { .. }
            | Self::Failsafe { .. }
            | Self::FcDisarmed
            | Self::MotorsOff(_)
            | Self::PilotTookOver => Severity::Critical,
            Self::LocalizationLost | Self::SearchFailed | Self::BatteryLow { .. } => {
                Severity::Error
            }
            Self::Refused(_)
            | Self::ItemRefused { .. }
            | Self::WayBlocked
            | Self::FcUnknown { .. }
            | Self::FcRestarted
            | Self::ImuDisturbed
            | Self::ImuPeriod { .. }
            | Self::PilotOffers => Severity::Warning,
            Self::FcStalled => Severity::Error,
            Self::FcSlow { .. } => Severity::Notice,
            _ => Severity::Info,
        }
    }
}

impl fmt::Display for Notice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FcFound {
                variant,
                version: [a, b, c],
            } => {
                write!(
                    f,
                    "Flight controller {} {a}.{b}.{c}",
                    String::from_utf8_lossy(variant)
                )
            }
            Self::FcLost { noise: false } => write!(f, "Flight controller lost"),
            Self::FcLost { noise: true } => write!(
                f,
                "Flight controller lost: what it sends is not MSP; if its CLI is open, leave it with `exit`"
            ),
            Self::FcUnknown { variant } => {
                write!(f, "{}", Refusal::FcUnknown { variant: *variant })
            }
            Self::PilotTookOver => write!(f, "Pilot took over: his radio steers"),
            Self::PilotOffers => write!(
                f,
                "Pilot's override switch is on: ask for a mode to steer again"
            ),
            Self::PilotHandedBack => write!(f, "Steering again by request"),
            Self::PilotDisarmed => write!(f, "Pilot disarmed with his radio"),
            Self::Localized { x_m, y_m } => {
                write!(f, "Localized at {x_m:.2}, {y_m:.2} on the plan")
            }
            Self::LocalizationLost => write!(f, "Localization lost"),
            Self::Searching => write!(f, "Not localized: searching"),
            Self::SearchFailed => write!(f, "Not localized: search gave up, landing"),
            Self::Failsafe { because, mode } => {
                write!(f, "Failsafe: {}: {}", because.words(), mode.name())
            }
            Self::FailsafeCleared(because) => write!(f, "Failsafe cleared: {}", because.words()),
            Self::Refused(why) => write!(f, "Refused: {why}"),
            Self::MissionFinished => write!(f, "Mission finished"),
            Self::ItemRefused { seq, why } => write!(f, "Mission item {seq}: {why}"),
            Self::ToRallyPoint { number, way_m } => {
                write!(f, "Return to rally point {number}, {way_m:.1} m away")
            }
            Self::WayBlocked => write!(f, "Way blocked: looking for another"),
            Self::BatteryLow { percent } => write!(f, "Battery low: {percent} %"),
            Self::Landed => write!(f, "Landed"),
            Self::FcDisarmed => write!(f, "Flight controller disarmed by itself"),
            Self::FlightTiming {
                sample_to_command,
                missed,
            } => write!(
                f,
                "Flight: sample to command {sample_to_command}, {missed} beats missed"
            ),
            Self::FcRestarted => write!(f, "Flight controller restarted"),
            Self::FcSlow {
                service_hz,
                has_cli_line: true,
            } => write!(
                f,
                "FC serves {service_hz}/s; CLI: set serial_update_rate_hz = 1000"
            ),
            Self::FcSlow { service_hz, .. } => {
                write!(f, "FC serves {service_hz}/s: raise the baud rate")
            }
            Self::ImuCalibrated => write!(f, "IMU calibrated: ready"),
            Self::ImuDisturbed => write!(f, "IMU moved while calibrating: begins again"),
            Self::ImuPeriod { ms, errors } => write!(
                f,
                "IMU period of {ms:.1} ms instead of 8-12 ms ({errors} of 10 errors)"
            ),
            Self::MotorsOff(why) => write!(f, "Motors stopped: {}", why.words()),
            Self::FcStalled => write!(f, "FC control loop stands still: restart it"),
            // PX4's words: QGroundControl and MAVSDK read them.
            Self::Calibration { sensor, progress } => {
                let name = sensor.name();
                match progress {
                    Progress::Started => write!(f, "[cal] calibration started: 2 {name}"),
                    Progress::Half => write!(f, "[cal] progress <50>"),
                    Progress::Done => write!(f, "[cal] calibration done: {name}"),
                    Progress::Failed => {
                        write!(f, "[cal] calibration failed: {name}: no answer")
                    }
                    Progress::Cancelled => write!(f, "[cal] calibration cancelled"),
                }
            }
        }
    }
}

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
