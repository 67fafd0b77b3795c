//! What happened and must be told, in words.

use super::{LandedState, Refusal};
use crate::autopilot::bench_work::{Progress, Sensor};
use crate::autopilot::latency::LatencySummary;
use crate::autopilot::mode::{Because, Mode, ModeState};
use crate::uquad::aircraft::Off;
use planner::fence::Site;
use planner::mission::Plan;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;
use vehicle::Timestamp;

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
    /// A row of the table that only tells.
    Trouble(Because),
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
            Self::Trouble(_) => Severity::Warning,
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
            Self::Trouble(because) => write!(f, "Warning: {}", because.words()),
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
