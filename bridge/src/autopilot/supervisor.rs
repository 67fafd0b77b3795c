//! The last word before an RC frame, and the failsafes of the [`table`](super::failsafes).
//!
//! A row fires when its condition holds; it asks the arbiter for a mode, stops the motors, or only tells. Rows are
//! in order of importance: the first that fires and acts decides; if what it wants is being done already, it tells. When its condition
//! ends, the pilot who was told is told that too; the mode stays.

use super::failsafes::{Answer, Facts, TABLE};
use super::mode::{Because, Mode};
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

/// A descent without attitude from the ceiling is over after this, s.
const BLIND_DESCENT_S: f64 = 8.0;
/// Share of the hover throttle that brings a level vehicle down.
const BLIND_THROTTLE: f64 = 0.95;

/// What the supervisor wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// A row fires: change to this mode and say why.
    Act(Because, Mode),
    /// A row fires: stop the motors and say why.
    Stop(Because),
    /// A row that only tells began to fire, or one whose answer is being flown already.
    Tell(Because),
    /// A row that was told stopped firing.
    Clear(Because),
}

/// Remembers which rows fire, as far as they were told.
#[derive(Clone, Debug, Default)]
pub struct Supervisor {
    told: [bool; TABLE.len()],
    /// How long we have flown without attitude, s.
    blind_s: f64,
}

impl Supervisor {
    /// Looks at the facts; calls `verdict` for every change and for the mode to be in.
    pub fn watch(&mut self, facts: &Facts<'_>, mut verdict: impl FnMut(Verdict)) {
        let mut decided = false;
        for (row, told) in TABLE.iter().zip(&mut self.told) {
            let fires = row.counts.in_state(facts) && (row.when)(facts);
            if !fires {
                if *told && facts.is_flying && row.tells_end {
                    verdict(Verdict::Clear(row.because));
                }
                *told = false;
                continue;
            }
            let says = match (row.answer)(facts) {
                Answer::Tell => Some(Verdict::Tell(row.because)).filter(|_| !*told),
                _ if decided => None,
                Answer::Mode(mode) => {
                    decided = true;
                    if mode != facts.mode && !is_safer(facts.mode, mode) {
                        Some(Verdict::Act(row.because, mode))
                    } else {
                        Some(Verdict::Tell(row.because)).filter(|_| !*told)
                    }
                }
                Answer::Stop => {
                    decided = true;
                    Some(Verdict::Stop(row.because))
                }
                Answer::Nothing => {
                    decided = true;
                    None
                }
            };
            if let Some(says) = says {
                *told = true;
                verdict(says);
            }
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
    use super::super::door::HostReport;
    use super::super::failsafes::tests::well;
    use super::super::params::AutopilotParams;
    use super::*;

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
        let hot = HostReport {
            temperature_c: Some(95.0),
            ..HostReport::default()
        };
        let cases = [
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
        let flies = |change: &dyn Fn(&mut Facts<'_>)| {
            let mut facts = well(&p);
            change(&mut facts);
            verdicts(&facts)
        };
        let land = |because| [Verdict::Act(because, Mode::Land)];
        assert_eq!(
            flies(&|f| f.toppled_s = 0.4),
            [Verdict::Stop(Because::Toppled)]
        );
        assert_eq!(flies(&|f| f.tilted_s = 0.3), land(Because::Tilted));
        assert_eq!(
            flies(&|f| f.inconsistent_s = 1.1),
            land(Because::Inconsistent)
        );
        assert_eq!(flies(&|f| f.jumps = 3), land(Because::PlaceJumps));
        assert_eq!(flies(&|f| f.stuck_s = 3.1), land(Because::RangersStuck));
        assert_eq!(
            flies(&|f| f.battery = Some(0.05)),
            land(Because::BatteryCritical)
        );
        assert_eq!(flies(&|f| f.sag_s = 1.1), land(Because::BatterySags));
        assert_eq!(flies(&|f| f.missed_share = 0.5), land(Because::LoopOverrun));
        assert_eq!(flies(&|f| f.fc_slow_s = 1.1), land(Because::FcSlow));
        assert_eq!(flies(&|f| f.host = hot), land(Because::Hot));
        let stuck_on_the_way = |mode| {
            flies(&|f| {
                f.mode = mode;
                f.no_progress_s = 31.0;
            })
        };
        assert_eq!(
            stuck_on_the_way(Mode::Mission),
            [Verdict::Act(Because::NoProgress, Mode::Hold)]
        );
        assert_eq!(stuck_on_the_way(Mode::Return), land(Because::NoProgress));
        type Set = fn(&mut HostReport);
        let told: [(Set, Because); 4] = [
            (|h| h.is_throttled = true, Because::Throttled),
            (|h| h.disk_fails = true, Because::DiskFails),
            (|h| h.clock_jumped = true, Because::ClockJumped),
            (|h| h.is_overloaded = true, Because::Overloaded),
        ];
        for (set, because) in told {
            assert_eq!(flies(&|f| set(&mut f.host)), [Verdict::Tell(because)]);
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
    fn a_second_cause_of_the_same_answer_is_told_and_what_was_never_told_is_not_cleared() {
        let p = AutopilotParams::default();
        let mut s = Supervisor::default();
        let mut watch = |change: &dyn Fn(&mut Facts<'_>)| {
            let mut facts = well(&p);
            facts.mode = Mode::Land;
            change(&mut facts);
            let mut out = Vec::new();
            s.watch(&facts, |v| out.push(v));
            out
        };
        // Landing for another reason: the slow loop is news once, what it hides is none.
        let slow = |f: &mut Facts<'_>| {
            f.missed_share = 0.6;
            f.has_attitude_and_height = false;
        };
        assert_eq!(watch(&slow), [Verdict::Tell(Because::LoopOverrun)]);
        assert_eq!(watch(&slow), []);
        assert_eq!(watch(&|_| ()), [Verdict::Clear(Because::LoopOverrun)]);
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
