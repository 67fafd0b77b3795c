//! Flight modes and why the vehicle is in one.

use serde::{Deserialize, Serialize};

/// Flight modes, named as ground stations name them (PX4 encoding in `gcs/convert.rs`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Angle sticks, thrust direct.
    Stabilized,
    /// Angle sticks, height held.
    Altitude,
    /// Velocity sticks; avoidance brakes.
    Position,
    /// Hover at a set point; keys nudge it.
    #[default]
    Hold,
    /// Fly the plan.
    Mission,
    /// Fly home and land.
    Return,
    /// Come down here.
    Land,
    /// Climb to the take-off height, then Hold.
    Takeoff,
    /// Set points streamed by a ground program.
    Offboard,
}

impl Mode {
    /// Every mode, in the order AVAILABLE_MODES lists them.
    pub const ALL: [Self; 9] = [
        Self::Hold,
        Self::Mission,
        Self::Return,
        Self::Land,
        Self::Takeoff,
        Self::Offboard,
        Self::Position,
        Self::Altitude,
        Self::Stabilized,
    ];

    /// Name for people, as QGroundControl shows it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stabilized => "Stabilized",
            Self::Altitude => "Altitude",
            Self::Position => "Position",
            Self::Hold => "Hold",
            Self::Mission => "Mission",
            Self::Return => "Return",
            Self::Land => "Land",
            Self::Takeoff => "Takeoff",
            Self::Offboard => "Offboard",
        }
    }

    /// True if a pilot's sticks steer it.
    #[must_use]
    pub const fn is_stick_mode(self) -> bool {
        matches!(self, Self::Stabilized | Self::Altitude | Self::Position)
    }
}

/// Why the vehicle is in its mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Because {
    /// Somebody asked for it, or it is the mode at start.
    #[default]
    Asked,
    /// The mode before it came to its end (take-off reached, mission finished, search over).
    Finished,
    /// Off-board set points stopped.
    OffboardSilent,
    /// Manual input stopped.
    ManualSilent,
    /// The ground station fell silent.
    GroundLost,
    /// Localization is lost, or did not come in time.
    NotLocalized,
    /// The range finders fell silent.
    RangersSilent,
    /// The battery is low.
    BatteryLow,
    /// The battery is just enough for the way home and the reserve.
    BatteryReserve,
    /// The program is asked to end.
    ShuttingDown,
    /// The estimator has no usable state.
    EstimatorFailed,
    /// The flight controller stopped answering.
    FcSilent,
    /// The flight loop itself was held up.
    LoopHeld,
    /// The pilot took over with his radio.
    PilotTookOver,
    /// It lies on its side: a crash, or a motor is gone.
    Toppled,
    /// It tilts further than control ever asks for.
    Tilted,
    /// The estimate contradicts itself or what is possible.
    Inconsistent,
    /// The place on the plan jumps again and again.
    PlaceJumps,
    /// A range finder says the same wherever the vehicle is.
    RangersStuck,
    /// The battery is nearly empty.
    BatteryCritical,
    /// The voltage under load is too low.
    BatterySags,
    /// The way does not get shorter.
    NoProgress,
    /// The flight loop misses its beats.
    LoopOverrun,
    /// The flight controller answers too seldom to be flown by.
    FcSlow,
    /// The computer is too hot.
    Hot,
    /// The computer runs slower than it could.
    Throttled,
    /// Flights are not being logged.
    DiskFails,
    /// The wall clock jumped.
    ClockJumped,
    /// Ground side, web or video are behind.
    Overloaded,
}

impl Because {
    /// True if the mode was forced by a failsafe.
    #[must_use]
    pub const fn is_failsafe(self) -> bool {
        !matches!(self, Self::Asked | Self::Finished | Self::PilotTookOver)
    }
}

/// Mode and reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModeState {
    /// Mode.
    pub mode: Mode,
    /// Why.
    pub because: Because,
}
