//! The table of failsafes: what may go wrong, what is done about it, which parameters set it, which test flies it.
//!
//! `docs/failsafe.md` and the pre-flight checks ([`health`](super::health)) are made from it.

use super::door::HostReport;
use super::mode::{Because, Mode};
use super::params::{AutopilotParams, LossAction};

/// What the rows look at. Times are seconds, infinite if it never happened.
#[derive(Clone, Copy, Debug)]
pub struct Facts<'a> {
    /// Mode now.
    pub mode: Mode,
    /// Off the ground.
    pub is_flying: bool,
    /// Motors run.
    pub is_armed: bool,
    /// Roll, pitch and height are known.
    pub has_attitude_and_height: bool,
    /// Time since the place on the plan was last known.
    pub not_localized_s: f64,
    /// Time the search flight lasts, none outside of it.
    pub search_s: Option<f64>,
    /// Time since a horizontal ranger spoke.
    pub rangers_silent_s: f64,
    /// Time since a ground station spoke; none if none ever did.
    pub ground_silent_s: Option<f64>,
    /// Time since the last off-board set point.
    pub offboard_silent_s: f64,
    /// Time since the last manual input.
    pub manual_silent_s: f64,
    /// Battery left, 0..=1.
    pub battery: Option<f64>,
    /// Time the battery lasts beyond the way home and the landing; none while it cannot be told.
    pub spare_s: Option<f64>,
    /// Time since the flight controller said anything.
    pub fc_silent_s: f64,
    /// Time between the last two ticks.
    pub loop_gap_s: f64,
    /// Time beyond KST_CRASH_TILT.
    pub toppled_s: f64,
    /// Time beyond KST_TILT_MAX.
    pub tilted_s: f64,
    /// Time that the estimate contradicts itself.
    pub inconsistent_s: f64,
    /// Jumps of the place within ten seconds.
    pub jumps: u32,
    /// Time that a ranger says the same on the move.
    pub stuck_s: f64,
    /// Time with cells below BAT_V_SAG.
    pub sag_s: f64,
    /// Time on the way without getting anywhere.
    pub no_progress_s: f64,
    /// Share of beats missed lately, 0..=1.
    pub missed_share: f64,
    /// Time that the flight controller answers too seldom.
    pub fc_slow_s: f64,
    /// How the computer is.
    pub host: HostReport,
    /// Parameters.
    pub params: &'a AutopilotParams,
}

impl<'a> Facts<'a> {
    /// Standing on the floor, and nothing is wrong.
    #[must_use]
    pub const fn quiet(params: &'a AutopilotParams) -> Self {
        Self {
            mode: Mode::Hold,
            is_flying: false,
            is_armed: false,
            has_attitude_and_height: true,
            not_localized_s: 0.0,
            search_s: None,
            rangers_silent_s: 0.0,
            ground_silent_s: None,
            offboard_silent_s: f64::INFINITY,
            manual_silent_s: f64::INFINITY,
            battery: None,
            spare_s: None,
            fc_silent_s: 0.0,
            loop_gap_s: 0.0,
            toppled_s: 0.0,
            tilted_s: 0.0,
            inconsistent_s: 0.0,
            jumps: 0,
            stuck_s: 0.0,
            sag_s: 0.0,
            no_progress_s: 0.0,
            missed_share: 0.0,
            fc_slow_s: 0.0,
            host: HostReport {
                temperature_c: None,
                is_throttled: false,
                disk_fails: false,
                clock_jumped: false,
                is_overloaded: false,
            },
            params,
        }
    }
}

/// When a row counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counts {
    /// Off the ground.
    Flying,
    /// Motors run.
    Armed,
    /// Always.
    Always,
}

impl Counts {
    pub(super) const fn in_state(self, facts: &Facts<'_>) -> bool {
        match self {
            Self::Flying => facts.is_flying,
            Self::Armed => facts.is_armed,
            Self::Always => true,
        }
    }
}

/// What a row wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// This mode.
    Mode(Mode),
    /// Motors stopped at once.
    Stop,
    /// The pilot told.
    Tell,
    /// Nothing more than is being done already.
    Nothing,
}

/// One failsafe.
#[derive(Clone, Copy)]
pub struct Row {
    /// Its name to the pilot.
    pub because: Because,
    /// In which state it counts.
    pub counts: Counts,
    /// When it fires.
    pub when: fn(&Facts<'_>) -> bool,
    /// What it wants.
    pub answer: fn(&Facts<'_>) -> Answer,
    /// The pilot is told when its condition ends (not where the answer itself ends it).
    pub tells_end: bool,
    /// While its condition holds on the ground, arming is refused.
    pub refuses_arming: bool,
    /// When it fires, for the documentation.
    pub doc: &'static str,
    /// What it does, for the documentation.
    pub does: &'static str,
    /// Parameters that set it.
    pub params: &'static [&'static str],
    /// Test that flies it (`tests/flights`).
    pub test: &'static str,
}

/// Rangers may be silent this long before the vehicle no longer flies on what it remembers.
const RANGERS_SILENT_S: f64 = 1.0;
/// A flight controller that answers 60 times a second and is silent for this long will not answer soon.
pub const FC_SILENT_S: f64 = 0.2;
/// A stall of the flight loop that Betaflight's receiver does not bridge: it idles the motors after 0.30 s without a frame.
pub const LOOP_HELD_S: f64 = 0.3;
/// Time beyond a tilt that is no gust.
const TILTED_S: f64 = 0.2;
/// Time on its side that is no bounce.
const TOPPLED_S: f64 = 0.3;
/// Time that voltage or answers must stay low.
const LASTING_S: f64 = 1.0;

const LAND: fn(&Facts<'_>) -> Answer = |_| Answer::Mode(Mode::Land);
const HOLD: fn(&Facts<'_>) -> Answer = |_| Answer::Mode(Mode::Hold);
const TELL: fn(&Facts<'_>) -> Answer = |_| Answer::Tell;

/// A mode that goes by walls.
const fn needs_a_place(mode: Mode) -> bool {
    !matches!(mode, Mode::Stabilized | Mode::Altitude)
}

/// A row that lands, told when it ends, and keeps from arming.
const ROW: Row = Row {
    because: Because::Asked,
    counts: Counts::Flying,
    when: |_| false,
    answer: LAND,
    tells_end: true,
    refuses_arming: false,
    doc: "",
    does: "Land",
    params: &[],
    test: "",
};

/// The failsafes, most important first.
pub const TABLE: [Row; 26] = [
    Row {
        because: Because::Toppled,
        when: |f| f.toppled_s > TOPPLED_S,
        answer: |_| Answer::Stop,
        tells_end: false,
        refuses_arming: true,
        doc: "tilted beyond KST_CRASH_TILT for 0.3 s: a crash, a lost motor",
        does: "motors stop at once",
        params: &["KST_CRASH_TILT"],
        test: "a_lost_motor_stops_the_others",
        ..ROW
    },
    Row {
        because: Because::FcSilent,
        counts: Counts::Armed,
        when: |f| f.fc_silent_s > FC_SILENT_S,
        doc: "flight controller silent for 0.2 s while armed",
        does: "Land; until it answers: sticks level, throttle 95 % of hover; after 8 s the arm switch is lowered. One that comes back disarmed (it restarted) stays so",
        test: "a_controller_that_stops_answering_is_acted_on_within_a_quarter_of_a_second",
        ..ROW
    },
    Row {
        because: Because::LoopHeld,
        when: |f| f.loop_gap_s > LOOP_HELD_S,
        tells_end: false,
        doc: "the flight loop itself was held up for more than 0.3 s in the air",
        does: "Land, from the first tick that runs again",
        test: "a_flight_loop_held_for_longer_than_the_receiver_waits_is_kept_level_and_lands",
        ..ROW
    },
    Row {
        because: Because::LoopOverrun,
        when: |f| f.missed_share * 100.0 > f.params.missed_max_percent,
        doc: "the flight loop misses more than KST_MISS_MAX of its beats within 2 s",
        params: &["KST_MISS_MAX"],
        test: "a_flight_loop_that_is_too_slow_lands",
        ..ROW
    },
    Row {
        because: Because::FcSlow,
        when: |f| f.fc_slow_s > LASTING_S,
        doc: "flight controller answers fewer than KST_FC_MIN_HZ times a second, for 1 s",
        params: &["KST_FC_MIN_HZ"],
        test: "a_controller_that_answers_too_seldom_is_not_flown_on",
        ..ROW
    },
    Row {
        because: Because::EstimatorFailed,
        when: |f| !f.has_attitude_and_height,
        refuses_arming: true,
        doc: "attitude or height unknown in the air",
        does: "Land; without attitude: sticks level, throttle 95 % of hover; after 8 s the arm switch is lowered",
        test: "without_down_ranger_and_barometer_it_lands",
        ..ROW
    },
    Row {
        because: Because::Inconsistent,
        when: |f| f.inconsistent_s > f.params.inconsistent_s,
        doc: "the estimate is no number, faster than 6 m/s, or refuses the controller's attitude, for KST_EST_T",
        does: "Land, level: by the height alone, without steering by what may be wrong",
        params: &["KST_EST_T"],
        test: "an_attitude_that_does_not_fit_the_motion_lands",
        ..ROW
    },
    Row {
        because: Because::Tilted,
        when: |f| f.tilted_s > TILTED_S && needs_a_place(f.mode),
        refuses_arming: true,
        doc: "tilted beyond KST_TILT_MAX for 0.2 s in a mode that avoids obstacles",
        params: &["KST_TILT_MAX"],
        test: "a_tilt_that_control_never_asks_for_lands",
        ..ROW
    },
    Row {
        because: Because::NotLocalized,
        when: |f| f.search_s.is_some_and(|s| s > f.params.search_timeout_s),
        tells_end: false,
        doc: "search flight longer than LOC_SEARCH_T",
        params: &["LOC_SEARCH_T"],
        test: "a_search_that_fails_lands_and_says_so",
        ..ROW
    },
    Row {
        because: Because::NotLocalized,
        when: |f| {
            f.search_s.is_none()
                && f.not_localized_s > f.params.lost_timeout_s
                && needs_a_place(f.mode)
        },
        doc: "place unknown in the air for LOC_LOST_T in a mode that needs it",
        params: &["LOC_LOST_T"],
        test: "a_vehicle_that_is_lost_for_too_long_lands",
        ..ROW
    },
    Row {
        because: Because::PlaceJumps,
        when: |f| {
            f.jumps >= f.params.jumps_max.unsigned_abs()
                && f.search_s.is_none()
                && needs_a_place(f.mode)
        },
        doc: "the place jumps KST_JUMPS_MAX times within 10 s in a mode that needs it",
        params: &["KST_JUMPS_MAX"],
        test: "a_place_that_jumps_again_and_again_lands",
        ..ROW
    },
    Row {
        because: Because::RangersSilent,
        when: |f| f.rangers_silent_s > RANGERS_SILENT_S && needs_a_place(f.mode),
        refuses_arming: true,
        doc: "no horizontal range finder for 1 s in a mode that avoids obstacles",
        test: "silent_rangers_land_the_vehicle",
        ..ROW
    },
    Row {
        because: Because::RangersStuck,
        when: |f| f.stuck_s > f.params.stuck_s && needs_a_place(f.mode),
        doc: "a range finder says the same for KST_STUCK_T while the vehicle moves 0.3 m (a single beam: 1 m), in a mode that avoids obstacles",
        params: &["KST_STUCK_T"],
        test: "a_stuck_ranger_lands_the_vehicle",
        ..ROW
    },
    Row {
        because: Because::BatterySags,
        when: |f| f.sag_s > LASTING_S,
        refuses_arming: true,
        doc: "cells below BAT_V_SAG for 1 s",
        params: &["BAT_V_SAG"],
        test: "a_sagging_battery_lands_the_vehicle",
        ..ROW
    },
    Row {
        because: Because::BatteryCritical,
        when: |f| {
            f.battery
                .is_some_and(|b| b * 100.0 < f.params.battery_critical_percent)
        },
        doc: "battery below BAT_CRIT_THR",
        params: &["BAT_CRIT_THR"],
        test: "a_critical_battery_lands_where_it_is",
        ..ROW
    },
    Row {
        because: Because::Hot,
        when: |f| f.host.temperature_c.is_some_and(|c| c > f.params.hot_c),
        refuses_arming: true,
        doc: "the computer is hotter than KST_TEMP_MAX",
        params: &["KST_TEMP_MAX"],
        test: "a_computer_that_is_too_hot_lands",
        ..ROW
    },
    Row {
        because: Because::BatteryLow,
        when: |f| {
            f.battery
                .is_some_and(|b| b * 100.0 < f.params.battery_low_percent)
        },
        answer: |f| match f.mode {
            Mode::Land | Mode::Return => Answer::Nothing,
            _ => Answer::Mode(Mode::Return),
        },
        refuses_arming: true,
        doc: "battery below BAT_LOW_THR",
        does: "Return, unless landing already",
        params: &["BAT_LOW_THR"],
        test: "a_low_battery_brings_it_home",
        ..ROW
    },
    Row {
        because: Because::BatteryReserve,
        when: |f| {
            let reserve_s = f.params.battery_reserve_s;
            reserve_s > 0.0 && f.spare_s.is_some_and(|s| s < reserve_s)
        },
        answer: |f| match f.mode {
            Mode::Land | Mode::Return => Answer::Nothing,
            _ => Answer::Mode(Mode::Return),
        },
        tells_end: false,
        doc: "battery lasts less than KST_BAT_RESERVE longer than the way home and the landing take",
        does: "Return, unless landing already",
        params: &["KST_BAT_RESERVE", "BAT1_CAPACITY"],
        test: "the_reserve_rule_turns_back_in_time_and_the_time_left_is_told",
        ..ROW
    },
    Row {
        because: Because::GroundLost,
        when: |f| {
            f.params.ground_loss_action != LossAction::Disabled
                && f.ground_silent_s
                    .is_some_and(|s| s > f.params.ground_loss_s)
        },
        answer: |f| match f.params.ground_loss_action {
            LossAction::Disabled => Answer::Nothing,
            LossAction::Hold => Answer::Mode(Mode::Hold),
            LossAction::Return => Answer::Mode(Mode::Return),
            LossAction::Land => Answer::Mode(Mode::Land),
        },
        doc: "no ground station heartbeat for COM_DL_LOSS_T (only if one was ever heard)",
        does: "NAV_DLL_ACT: Land by default",
        params: &["COM_DL_LOSS_T", "NAV_DLL_ACT"],
        test: "a_lost_ground_station_lands_the_vehicle",
        ..ROW
    },
    Row {
        because: Because::OffboardSilent,
        counts: Counts::Armed,
        when: |f| f.mode == Mode::Offboard && f.offboard_silent_s > f.params.offboard_loss_s,
        answer: HOLD,
        tells_end: false,
        doc: "mode Offboard without a set point for COM_OF_LOSS_T",
        does: "Hold",
        params: &["COM_OF_LOSS_T"],
        test: "off_board_velocity_follows_its_frame_and_holds_when_the_stream_stops",
        ..ROW
    },
    Row {
        because: Because::ManualSilent,
        when: |f| {
            f.mode.is_stick_mode()
                && f.manual_silent_s > f.params.manual_loss_s + f.params.manual_hold_s
        },
        answer: HOLD,
        tells_end: false,
        doc: "stick mode without sticks for COM_RC_LOSS_T + KST_MAN_HOLD_T",
        does: "Hold",
        params: &["COM_RC_LOSS_T", "KST_MAN_HOLD_T"],
        test: "sticks_that_stop_end_in_hold",
        ..ROW
    },
    Row {
        because: Because::NoProgress,
        when: |f| {
            f.params.no_progress_s > 0.0
                && f.no_progress_s > f.params.no_progress_s
                && matches!(f.mode, Mode::Mission | Mode::Return | Mode::Offboard)
        },
        answer: |f| match f.mode {
            Mode::Return => Answer::Mode(Mode::Land),
            _ => Answer::Mode(Mode::Hold),
        },
        tells_end: false,
        doc: "on the way and within a metre for KST_PROGRESS_T, in Mission, Return or Offboard",
        does: "Hold; Return lands",
        params: &["KST_PROGRESS_T"],
        test: "a_way_that_stays_blocked_ends_in_hold",
        ..ROW
    },
    Row {
        because: Because::Throttled,
        counts: Counts::Always,
        when: |f| f.host.is_throttled,
        answer: TELL,
        doc: "the computer runs slower than it could (heat, low voltage)",
        does: "tells; the loop's own rows above act",
        test: "what_the_computer_tells_reaches_the_pilot_and_flying_goes_on",
        ..ROW
    },
    Row {
        because: Because::DiskFails,
        counts: Counts::Always,
        when: |f| f.host.disk_fails,
        answer: TELL,
        doc: "flights are not logged: the disk is full or broken",
        does: "tells; flying goes on",
        params: &["LOG_TOTAL_MB"],
        test: "what_the_computer_tells_reaches_the_pilot_and_flying_goes_on",
        ..ROW
    },
    Row {
        because: Because::ClockJumped,
        counts: Counts::Always,
        when: |f| f.host.clock_jumped,
        answer: TELL,
        doc: "the wall clock jumps by more than 1 s",
        does: "tells; flight goes by a clock that never jumps",
        test: "what_the_computer_tells_reaches_the_pilot_and_flying_goes_on",
        ..ROW
    },
    Row {
        because: Because::Overloaded,
        counts: Counts::Always,
        when: |f| f.host.is_overloaded,
        answer: TELL,
        doc: "ground side, web or video are behind with their work",
        does: "tells; they drop what is old, the flight loop has its own thread",
        test: "what_the_computer_tells_reaches_the_pilot_and_flying_goes_on",
        ..ROW
    },
];

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A healthy hover.
    pub(in crate::autopilot) fn well(params: &AutopilotParams) -> Facts<'_> {
        Facts {
            is_flying: true,
            is_armed: true,
            rangers_silent_s: 0.05,
            ground_silent_s: Some(0.5),
            battery: Some(0.9),
            spare_s: Some(400.0),
            fc_silent_s: 0.01,
            loop_gap_s: 0.025,
            ..Facts::quiet(params)
        }
    }

    #[test]
    fn every_row_names_parameters_that_exist_and_a_test_that_flies_it() {
        let flights = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/flights");
        let tests: String = std::fs::read_dir(flights)
            .unwrap()
            .map(|entry| std::fs::read_to_string(entry.unwrap().path()).unwrap())
            .chain([include_str!("supervisor.rs").to_owned()])
            .collect();
        let settings = crate::settings::Settings::default();
        for row in &TABLE {
            assert!(
                tests.contains(&format!("fn {}()", row.test)),
                "{}: no test `{}`",
                row.doc,
                row.test
            );
            for name in row.params {
                assert!(settings.index_of(name).is_some(), "{name}");
            }
        }
    }
}
