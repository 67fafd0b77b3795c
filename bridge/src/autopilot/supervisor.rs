//! The last word before an RC frame, and the table of failsafes.
//!
//! A row of [`TABLE`] fires when its condition holds; it asks the arbiter for a mode and tells the pilot once. Rows are
//! in order of importance: the first that fires decides. When its condition ends, the pilot is told; the mode stays.

use super::mode::{Because, Mode};
use super::params::{AutopilotParams, LossAction};
use vehicle::Sticks;

/// A value that only the supervisor can make: sticks fit to be sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cleared<T>(T);

impl<T> Cleared<T> {
    /// The value.
    pub const fn get(&self) -> &T {
        &self.0
    }
}

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
    /// Parameters.
    pub params: &'a AutopilotParams,
}

/// One failsafe.
#[derive(Clone, Copy)]
pub struct Row {
    /// Its name to the pilot.
    pub because: Because,
    /// When it fires.
    pub when: fn(&Facts<'_>) -> bool,
    /// The mode it asks for; none while it only warns.
    pub action: fn(&Facts<'_>) -> Option<Mode>,
    /// The pilot is told when its condition ends (not where the answer itself ends it).
    pub tells_end: bool,
    /// When it fires, for the documentation.
    pub doc: &'static str,
    /// What it does, for the documentation.
    pub does: &'static str,
}

/// Rangers may be silent this long before the vehicle no longer flies on what it remembers.
const RANGERS_SILENT_S: f64 = 1.0;

/// A flight controller that answers 60 times a second and is silent for this long will not answer soon.
pub const FC_SILENT_S: f64 = 0.2;
/// A stall of the flight loop that Betaflight's receiver does not bridge: it idles the motors after 0.30 s without a frame.
pub const LOOP_HELD_S: f64 = 0.3;
/// A descent without attitude from the ceiling is over after this, s.
const BLIND_DESCENT_S: f64 = 8.0;
/// Share of the hover throttle that brings a level vehicle down.
const BLIND_THROTTLE: f64 = 0.95;

/// The failsafes, most important first.
pub const TABLE: [Row; 11] = [
    Row {
        because: Because::FcSilent,
        when: |f| f.is_armed && f.fc_silent_s > FC_SILENT_S,
        action: |_| Some(Mode::Land),
        tells_end: true,
        doc: "flight controller silent for 0.2 s while armed",
        does: "Land; until it answers: sticks level, throttle 95 % of hover; after 8 s the arm switch is lowered",
    },
    Row {
        because: Because::LoopHeld,
        when: |f| f.is_flying && f.loop_gap_s > LOOP_HELD_S,
        action: |_| Some(Mode::Land),
        tells_end: false,
        doc: "the flight loop itself was held up for more than 0.3 s in the air",
        does: "Land, from the first tick that runs again",
    },
    Row {
        because: Because::EstimatorFailed,
        when: |f| f.is_flying && !f.has_attitude_and_height,
        action: |_| Some(Mode::Land),
        tells_end: true,
        doc: "attitude or height unknown in the air",
        does: "Land; without attitude: sticks level, throttle 95 % of hover; after 8 s the arm switch is lowered",
    },
    Row {
        because: Because::NotLocalized,
        when: |f| f.is_flying && f.search_s.is_some_and(|s| s > f.params.search_timeout_s),
        action: |_| Some(Mode::Land),
        tells_end: false,
        doc: "search flight longer than LOC_SEARCH_T",
        does: "Land",
    },
    Row {
        because: Because::NotLocalized,
        when: |f| {
            f.is_flying
                && f.search_s.is_none()
                && f.not_localized_s > f.params.lost_timeout_s
                && !matches!(f.mode, Mode::Stabilized | Mode::Altitude)
        },
        action: |_| Some(Mode::Land),
        tells_end: true,
        doc: "place unknown in the air for LOC_LOST_T in a mode that needs it",
        does: "Land",
    },
    Row {
        because: Because::RangersSilent,
        when: |f| {
            f.is_flying
                && f.rangers_silent_s > RANGERS_SILENT_S
                && !matches!(f.mode, Mode::Stabilized | Mode::Altitude)
        },
        action: |_| Some(Mode::Land),
        tells_end: true,
        doc: "no horizontal range finder for 1 s in a mode that avoids obstacles",
        does: "Land",
    },
    Row {
        because: Because::BatteryLow,
        when: |f| {
            f.is_flying
                && f.battery
                    .is_some_and(|b| b * 100.0 < f.params.battery_low_percent)
        },
        action: |f| (!matches!(f.mode, Mode::Land | Mode::Return)).then_some(Mode::Return),
        tells_end: true,
        doc: "battery below BAT_LOW_THR",
        does: "Return, unless landing already",
    },
    Row {
        because: Because::BatteryReserve,
        when: |f| {
            let reserve_s = f.params.battery_reserve_s;
            f.is_flying && reserve_s > 0.0 && f.spare_s.is_some_and(|s| s < reserve_s)
        },
        action: |f| (!matches!(f.mode, Mode::Land | Mode::Return)).then_some(Mode::Return),
        tells_end: false,
        doc: "battery lasts less than KST_BAT_RESERVE longer than the way home and the landing take",
        does: "Return, unless landing already",
    },
    Row {
        because: Because::GroundLost,
        when: |f| {
            f.is_flying
                && f.params.ground_loss_action != LossAction::Disabled
                && f.ground_silent_s
                    .is_some_and(|s| s > f.params.ground_loss_s)
        },
        action: |f| match f.params.ground_loss_action {
            LossAction::Disabled => None,
            LossAction::Hold => Some(Mode::Hold),
            LossAction::Return => Some(Mode::Return),
            LossAction::Land => Some(Mode::Land),
        },
        tells_end: true,
        doc: "no ground station heartbeat for COM_DL_LOSS_T (only if one was ever heard)",
        does: "NAV_DLL_ACT: Land by default",
    },
    Row {
        because: Because::OffboardSilent,
        when: |f| {
            f.is_armed && f.mode == Mode::Offboard && f.offboard_silent_s > f.params.offboard_loss_s
        },
        action: |_| Some(Mode::Hold),
        tells_end: false,
        doc: "mode Offboard without a set point for COM_OF_LOSS_T",
        does: "Hold",
    },
    Row {
        because: Because::ManualSilent,
        when: |f| {
            f.is_flying
                && f.mode.is_stick_mode()
                && f.manual_silent_s > f.params.manual_loss_s + f.params.manual_hold_s
        },
        action: |_| Some(Mode::Hold),
        tells_end: false,
        doc: "stick mode without sticks for COM_RC_LOSS_T + KST_MAN_HOLD_T",
        does: "Hold",
    },
];

/// What the supervisor wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// A row began to fire: change to this mode and say why.
    Act(Because, Mode),
    /// A row stopped firing.
    Clear(Because),
}

/// Remembers which rows fire.
#[derive(Clone, Debug, Default)]
pub struct Supervisor {
    firing: [bool; TABLE.len()],
    /// How long we have flown without attitude, s.
    blind_s: f64,
}

impl Supervisor {
    /// Looks at the facts; calls `verdict` for every change and for the mode to be in.
    pub fn watch(&mut self, facts: &Facts<'_>, mut verdict: impl FnMut(Verdict)) {
        let mut decided = false;
        for (row, firing) in TABLE.iter().zip(&mut self.firing) {
            let fires = (row.when)(facts);
            if fires && !decided {
                decided = true;
                if let Some(mode) = (row.action)(facts)
                    && mode != facts.mode
                    && !is_safer(facts.mode, mode)
                {
                    verdict(Verdict::Act(row.because, mode));
                }
            }
            if *firing && !fires && facts.is_flying && row.tells_end {
                verdict(Verdict::Clear(row.because));
            }
            *firing = fires;
        }
    }

    /// Counts the time without attitude; true when a blind descent has lasted so long that the vehicle is down whatever it
    /// did, and the motors must stop.
    #[must_use]
    pub fn is_blind_too_long(&mut self, dt_s: f64, is_flying: bool, has_attitude: bool) -> bool {
        self.blind_s = if is_flying && !has_attitude {
            self.blind_s + dt_s
        } else {
            0.0
        };
        self.blind_s > BLIND_DESCENT_S
    }

    /// Sticks fit to be sent: idle unless armed, in range, and level with sinking thrust when attitude is unknown.
    #[must_use]
    pub fn clear(
        &self,
        wanted: Sticks,
        may_spin: bool,
        has_attitude: bool,
        hover_throttle: f64,
    ) -> Cleared<Sticks> {
        // Critical for safety: nothing else makes `Cleared<Sticks>`.
        Cleared(match (may_spin, has_attitude) {
            (false, _) => Sticks::IDLE,
            (true, true) => wanted.clamped(),
            // The controller keeps itself level in angle mode; a little less than hover brings it down.
            (true, false) => Sticks {
                throttle: hover_throttle * BLIND_THROTTLE,
                ..Sticks::IDLE
            }
            .clamped(),
        })
    }
}

/// True if `now` already is the stronger of the two answers: Land over Return over Hold.
const fn is_safer(now: Mode, asked: Mode) -> bool {
    const fn rank(m: Mode) -> u8 {
        match m {
            Mode::Land => 3,
            Mode::Return => 2,
            Mode::Hold => 1,
            _ => 0,
        }
    }
    rank(now) > rank(asked)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn well(params: &AutopilotParams) -> Facts<'_> {
        Facts {
            mode: Mode::Hold,
            is_flying: true,
            is_armed: true,
            has_attitude_and_height: true,
            not_localized_s: 0.0,
            search_s: None,
            rangers_silent_s: 0.05,
            ground_silent_s: Some(0.5),
            offboard_silent_s: f64::INFINITY,
            manual_silent_s: f64::INFINITY,
            battery: Some(0.9),
            spare_s: Some(400.0),
            fc_silent_s: 0.01,
            loop_gap_s: 0.025,
            params,
        }
    }

    fn verdicts(facts: &Facts<'_>) -> Vec<Verdict> {
        let mut out = Vec::new();
        Supervisor::default().watch(facts, |v| out.push(v));
        out
    }

    #[test]
    fn a_healthy_hover_is_left_alone() {
        assert_eq!(verdicts(&well(&AutopilotParams::default())), []);
    }

    #[test]
    fn each_row_acts() {
        let p = AutopilotParams::default();
        let cases: [(Facts<'_>, Verdict); 11] = [
            (
                Facts {
                    fc_silent_s: 0.21,
                    ..well(&p)
                },
                Verdict::Act(Because::FcSilent, Mode::Land),
            ),
            (
                Facts {
                    loop_gap_s: 0.31,
                    ..well(&p)
                },
                Verdict::Act(Because::LoopHeld, Mode::Land),
            ),
            (
                Facts {
                    has_attitude_and_height: false,
                    ..well(&p)
                },
                Verdict::Act(Because::EstimatorFailed, Mode::Land),
            ),
            (
                Facts {
                    mode: Mode::Takeoff,
                    search_s: Some(60.0),
                    not_localized_s: 60.0,
                    ..well(&p)
                },
                Verdict::Act(Because::NotLocalized, Mode::Land),
            ),
            (
                Facts {
                    not_localized_s: 5.0,
                    ..well(&p)
                },
                Verdict::Act(Because::NotLocalized, Mode::Land),
            ),
            (
                Facts {
                    rangers_silent_s: 1.1,
                    ..well(&p)
                },
                Verdict::Act(Because::RangersSilent, Mode::Land),
            ),
            (
                Facts {
                    battery: Some(0.1),
                    ..well(&p)
                },
                Verdict::Act(Because::BatteryLow, Mode::Return),
            ),
            (
                Facts {
                    spare_s: Some(44.0),
                    ..well(&p)
                },
                Verdict::Act(Because::BatteryReserve, Mode::Return),
            ),
            (
                Facts {
                    ground_silent_s: Some(3.1),
                    ..well(&p)
                },
                Verdict::Act(Because::GroundLost, Mode::Land),
            ),
            (
                Facts {
                    mode: Mode::Offboard,
                    offboard_silent_s: 0.6,
                    ..well(&p)
                },
                Verdict::Act(Because::OffboardSilent, Mode::Hold),
            ),
            (
                Facts {
                    mode: Mode::Position,
                    manual_silent_s: 3.0,
                    ..well(&p)
                },
                Verdict::Act(Because::ManualSilent, Mode::Hold),
            ),
        ];
        for (facts, expected) in cases {
            assert_eq!(verdicts(&facts), [expected]);
        }
    }

    #[test]
    fn nothing_acts_on_the_ground_and_a_ground_never_heard_is_not_lost() {
        let p = AutopilotParams::default();
        assert_eq!(
            verdicts(&Facts {
                is_flying: false,
                ground_silent_s: Some(99.0),
                battery: Some(0.0),
                ..well(&p)
            }),
            []
        );
        assert_eq!(
            verdicts(&Facts {
                ground_silent_s: None,
                ..well(&p)
            }),
            []
        );
    }

    #[test]
    fn a_row_that_ends_is_told_once_and_a_landing_is_not_turned_into_a_hover() {
        let p = AutopilotParams::default();
        let mut s = Supervisor::default();
        let mut out = Vec::new();
        s.watch(
            &Facts {
                ground_silent_s: Some(4.0),
                ..well(&p)
            },
            |v| out.push(v),
        );
        s.watch(
            &Facts {
                mode: Mode::Land,
                ground_silent_s: Some(0.1),
                ..well(&p)
            },
            |v| out.push(v),
        );
        s.watch(
            &Facts {
                mode: Mode::Land,
                ..well(&p)
            },
            |v| out.push(v),
        );
        assert_eq!(
            out,
            [
                Verdict::Act(Because::GroundLost, Mode::Land),
                Verdict::Clear(Because::GroundLost)
            ]
        );
    }

    #[test]
    fn a_loop_held_for_a_fifth_of_a_second_is_no_reason_to_land() {
        let p = AutopilotParams::default();
        let held = Facts {
            loop_gap_s: 0.2,
            ..well(&p)
        };
        assert_eq!(verdicts(&held), []);
    }

    #[test]
    fn a_blind_descent_ends_with_the_motors_stopped() {
        let mut s = Supervisor::default();
        let ticks = (0..400).take_while(|_| !s.is_blind_too_long(0.025, true, false));
        assert!((318..=322).contains(&ticks.count()));
        assert!(!s.is_blind_too_long(0.025, true, true));
    }

    #[test]
    fn disarmed_sticks_are_idle_whatever_is_wanted() {
        let wild = Sticks {
            roll: 1.0,
            pitch: -1.0,
            yaw: 1.0,
            throttle: 1.0,
        };
        let s = Supervisor::default();
        assert_eq!(*s.clear(wild, false, true, 0.5).get(), Sticks::IDLE);
        assert_eq!(*s.clear(wild, true, true, 0.5).get(), wild);
        let blind = *s.clear(wild, true, false, 0.5).get();
        assert!(blind.roll == 0.0 && blind.throttle < 0.5 && blind.throttle > 0.4);
    }
}
