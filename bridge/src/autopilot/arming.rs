//! Arming as a state machine: the arm switch goes up only after a neutral phase and when nothing blocks, comes down again
//! when the controller latches, and the reason of every refusal is known.
//!
//! ```text
//!            asked            neutral for 1 s, a status since says nothing blocks         ARM flag
//!  Neutral ---------> Waiting ---------------------------------------------> Raised ---------> Armed
//!     ^   disarm         |  ^          latched, or not armed in time            |                |
//!     |                  |  +---------------- switch low again ----------------+                |
//!     +---- gave up -----+                                            disarm, or ARM flag gone   |
//!     +------------------------------------------------------------------------------------------+
//! ```
//!
//! Why (measured on Betaflight and INAV): the controller must have seen the switch low and frames without a gap before;
//! any flag that blocks in the moment the switch goes high latches ARM_SWITCH until it is low again; a single lost frame
//! around arming is enough for that, so trying again is not a luxury.

use super::door::{FcBlocks, RequestId, Station};
use core::time::Duration;
use vehicle::Timestamp;

/// Frames with the switch low and the throttle down that the controller must have seen before the switch goes up.
const NEUTRAL: Duration = Duration::from_secs(1);
/// The controller shows ARM within about 0.1 s; longer than this it will not.
const CONFIRM: Duration = Duration::from_millis(1_000);
/// The switch stays low this long before it is raised again.
const LOWERED: Duration = Duration::from_millis(250);
/// What blocks must be gone after this, or arming is given up.
const PATIENCE: Duration = Duration::from_millis(3_000);
/// How often the switch is raised for one request.
const TRIES: u8 = 3;

/// Who asked, to be answered.
pub type Asker = Option<(RequestId, Station)>;

/// Where arming stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Arming {
    /// Switch low, motors off.
    Neutral,
    /// Switch low, to be raised as soon as nothing blocks.
    Waiting {
        /// Asked at.
        asked_at: Timestamp,
        /// Switch low since, for this try.
        since: Timestamp,
        /// Who waits for the answer.
        asker: Asker,
        /// How often the switch was raised.
        tries: u8,
    },
    /// Switch high, not confirmed yet.
    Raised {
        /// Asked at.
        asked_at: Timestamp,
        /// Since when.
        since: Timestamp,
        /// Who waits for the answer.
        asker: Asker,
        /// How often the switch was raised.
        tries: u8,
    },
    /// Switch high, motors run.
    Armed {
        /// Since when.
        since: Timestamp,
    },
}

/// What the machine reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// Motors run; answer the one who asked.
    Armed(Asker),
    /// It did not happen; the switch is low.
    Failed(Asker),
    /// The controller stopped the motors by itself.
    DisarmedByController,
}

/// What the controller said last.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FcArmState {
    /// ARM mode flag.
    pub is_armed: bool,
    /// What blocks.
    pub blocks: FcBlocks,
    /// When it said so.
    pub at: Option<Timestamp>,
    /// Since when it gets RC frames with the switch low; none while it gets none.
    pub neutral_since: Option<Timestamp>,
    /// Neutral time wanted beyond the second that it needs.
    pub neutral_beyond: Duration,
}

impl FcArmState {
    fn said_after(&self, at: Timestamp) -> bool {
        self.at.is_some_and(|said| said > at)
    }
}

impl Arming {
    /// True while the arm channel is high.
    #[must_use]
    pub const fn switch_is_high(&self) -> bool {
        matches!(self, Self::Raised { .. } | Self::Armed { .. })
    }

    /// True while the motors run.
    #[must_use]
    pub const fn is_armed(&self) -> bool {
        matches!(self, Self::Armed { .. })
    }

    /// True from the request to its end.
    #[must_use]
    pub const fn is_under_way(&self) -> bool {
        matches!(self, Self::Raised { .. } | Self::Waiting { .. })
    }

    /// Begins to arm. One request at a time: false if one is under way or the motors run.
    pub const fn ask(&mut self, now: Timestamp, asker: Asker) -> bool {
        if !matches!(self, Self::Neutral) {
            return false;
        }
        *self = Self::Waiting {
            asked_at: now,
            since: now,
            asker,
            tries: 0,
        };
        true
    }

    /// Lowers the switch: motors stop at once. Whoever was waiting for them to start.
    pub const fn lower(&mut self) -> Asker {
        let waiting = match *self {
            Self::Waiting { asker, .. } | Self::Raised { asker, .. } => asker,
            Self::Neutral | Self::Armed { .. } => None,
        };
        *self = Self::Neutral;
        waiting
    }

    /// The motors run although nobody here raised a switch: a pilot's radio did.
    pub const fn follow_radio(&mut self, now: Timestamp) {
        *self = Self::Armed { since: now };
    }

    /// Compares with what the controller says.
    pub fn step(&mut self, now: Timestamp, fc: &FcArmState) -> Option<Change> {
        match *self {
            Self::Neutral => None,
            Self::Waiting {
                asked_at,
                since,
                asker,
                tries,
            } => {
                let is_neutral = fc
                    .neutral_since
                    .is_some_and(|neutral| now.since(neutral) >= NEUTRAL + fc.neutral_beyond);
                // The first try trusts the last status: it was looked at when arming was asked for.
                let is_clear = fc.blocks.is_clear()
                    && (tries == 0 || fc.said_after(since) && now.since(since) >= LOWERED);
                if is_neutral && is_clear {
                    *self = Self::Raised {
                        asked_at,
                        since: now,
                        asker,
                        tries: tries + 1,
                    };
                    None
                } else if now.since(asked_at) > PATIENCE + fc.neutral_beyond {
                    *self = Self::Neutral;
                    Some(Change::Failed(asker))
                } else {
                    None
                }
            }
            Self::Raised {
                asked_at,
                since,
                asker,
                tries,
            } => {
                let said = fc.said_after(since);
                if said && fc.is_armed {
                    *self = Self::Armed { since: now };
                    return Some(Change::Armed(asker));
                }
                let is_latched = said && !fc.blocks.is_clear();
                if !is_latched && now.since(since) <= CONFIRM {
                    return None;
                }
                if tries >= TRIES || now.since(asked_at) > PATIENCE + fc.neutral_beyond {
                    *self = Self::Neutral;
                    return Some(Change::Failed(asker));
                }
                *self = Self::Waiting {
                    asked_at,
                    since: now,
                    asker,
                    tries,
                };
                None
            }
            Self::Armed { since } => {
                if fc.said_after(since) && !fc.is_armed {
                    *self = Self::Neutral;
                    Some(Change::DisarmedByController)
                } else {
                    None
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ARM_SWITCH: FcBlocks = FcBlocks {
        variant: *b"BTFL",
        count: 29,
        flags: 1 << 28,
    };

    fn ms(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    fn said(at_ms: u64, is_armed: bool) -> FcArmState {
        FcArmState {
            is_armed,
            blocks: FcBlocks::default(),
            at: Some(ms(at_ms)),
            neutral_since: Some(ms(0)),
            neutral_beyond: Duration::ZERO,
        }
    }

    fn asked(at_ms: u64) -> Arming {
        let mut a = Arming::Neutral;
        assert!(a.ask(ms(at_ms), None));
        a
    }

    #[test]
    fn the_switch_stays_low_until_the_controller_has_seen_it_low_for_a_second() {
        let mut a = asked(400);
        let fc = said(300, false);
        a.step(ms(999), &fc);
        assert!(!a.switch_is_high());
        a.step(ms(1_000), &fc);
        assert!(a.switch_is_high() && !a.is_armed());
    }

    #[test]
    fn a_longer_neutral_phase_is_waited_for_as_the_first_program_did_for_five_seconds() {
        let mut a = asked(400);
        let fc = FcArmState {
            neutral_beyond: Duration::from_secs(4),
            ..said(300, false)
        };
        assert_eq!(a.step(ms(4_999), &fc), None, "nor is it given up");
        assert!(!a.switch_is_high());
        a.step(ms(5_000), &fc);
        assert!(a.switch_is_high() && !a.is_armed());
    }

    #[test]
    fn armed_only_when_the_controller_confirms_after_the_switch_went_up() {
        let mut a = asked(2_000);
        a.step(ms(2_010), &said(1_990, false));
        assert_eq!(
            a.step(ms(2_020), &said(1_990, true)),
            None,
            "an old status proves nothing"
        );
        assert_eq!(
            a.step(ms(2_200), &said(2_190, true)),
            Some(Change::Armed(None))
        );
        assert!(a.is_armed());
    }

    #[test]
    fn a_latched_switch_is_lowered_until_the_latch_is_gone_and_raised_again() {
        let mut a = asked(2_000);
        a.step(ms(2_000), &said(1_990, false));
        let latched = FcArmState {
            blocks: ARM_SWITCH,
            ..said(2_150, false)
        };
        assert_eq!(a.step(ms(2_160), &latched), None);
        assert!(!a.switch_is_high(), "low again at once");
        assert_eq!(a.step(ms(2_420), &latched), None);
        assert!(!a.switch_is_high(), "the latch is still told");
        assert_eq!(a.step(ms(2_450), &said(2_440, false)), None);
        assert!(a.switch_is_high());
        assert_eq!(
            a.step(ms(2_600), &said(2_590, true)),
            Some(Change::Armed(None))
        );
    }

    #[test]
    fn what_blocks_for_three_seconds_is_given_up_with_the_switch_low() {
        let mut a = asked(2_000);
        let blocked = FcArmState {
            blocks: ARM_SWITCH,
            ..said(5_000, false)
        };
        assert_eq!(a.step(ms(4_990), &blocked), None);
        assert_eq!(a.step(ms(5_001), &blocked), Some(Change::Failed(None)));
        assert_eq!(a, Arming::Neutral);
    }

    #[test]
    fn a_controller_that_never_confirms_is_tried_again_then_given_up() {
        let mut a = asked(2_000);
        let mut raised = 0;
        let mut was_high = false;
        let end = (2_000..20_000).step_by(25).find(|t| {
            let change = a.step(ms(*t), &said(*t, false));
            raised += u32::from(a.switch_is_high() && !was_high);
            was_high = a.switch_is_high();
            change == Some(Change::Failed(None))
        });
        assert!(
            end.is_some_and(|t| t < 6_500) && raised == 3,
            "{end:?} {raised}"
        );
    }

    #[test]
    fn a_controller_that_disarms_by_itself_is_noticed() {
        let mut a = Arming::Armed { since: ms(100) };
        assert_eq!(
            a.step(ms(400), &said(300, false)),
            Some(Change::DisarmedByController)
        );
        assert!(!a.switch_is_high());
    }

    proptest! {
        #[test]
        fn disarming_lowers_the_switch_in_every_state(statuses in prop::collection::vec((any::<bool>(), any::<bool>()), 0..40)) {
            let mut a = asked(1_000);
            let mut t = 1_000;
            for (is_armed, is_blocked) in statuses {
                t += 50;
                let blocks = if is_blocked { ARM_SWITCH } else { FcBlocks::default() };
                a.step(ms(t), &FcArmState { blocks, ..said(t, is_armed) });
            }
            a.lower();
            prop_assert!(!a.switch_is_high() && !a.is_armed());
        }

        #[test]
        fn the_switch_never_goes_up_while_something_blocks(flags in prop::collection::vec(0u32..4, 1..80)) {
            let mut a = asked(1_000);
            let mut t = 1_000;
            for f in flags {
                t += 50;
                let was_high = a.switch_is_high();
                let blocks = FcBlocks { flags: f << 7, ..ARM_SWITCH };
                a.step(ms(t), &FcArmState { blocks, ..said(t, false) });
                prop_assert!(was_high || !a.switch_is_high() || blocks.is_clear());
            }
        }
    }
}
