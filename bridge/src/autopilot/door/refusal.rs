//! What was answered: done, refused and why, in words.

use super::{RequestId, Station};
use crate::autopilot::mode::Because;
use crate::uquad::aircraft::Off;
use msp::firmware::{ArmingBlocker, arming_blockers};
use msp::message::FcVariant;
use serde::{Deserialize, Serialize};
use std::fmt;
use vehicle::{In, Ned};

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
    /// Failures are injected in a simulator only.
    NotSimulated,
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
            Self::Unsupported | Self::NotSimulated => RefusalClass::Unsupported,
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
            Self::NotSimulated => write!(f, "failures are injected in the simulator only"),
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
            Self::Toppled => "toppled over",
            Self::Tilted => "tilted too far",
            Self::Inconsistent => "estimate inconsistent",
            Self::PlaceJumps => "place jumps",
            Self::RangersStuck => "range finder stuck",
            Self::BatteryCritical => "battery critical",
            Self::BatterySags => "battery sags",
            Self::NoProgress => "no progress",
            Self::LoopOverrun => "flight loop too slow",
            Self::FcSlow => "flight controller too slow",
            Self::Hot => "computer too hot",
            Self::Throttled => "computer throttled",
            Self::DiskFails => "disk full, not logged",
            Self::ClockJumped => "wall clock jumped",
            Self::Overloaded => "ground side overloaded",
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
