//! Arming as a state machine: the arm switch goes up only when nothing blocks, comes down when the controller latches, and
//! the reason of every refusal is known.

use super::door::{FcBlock, RequestId, Station};
use core::time::Duration;
use vehicle::Timestamp;

/// The controller shows ARM within about 0.1 s; longer than this it will not.
const CONFIRM: Duration = Duration::from_millis(1_500);

/// Where arming stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Arming {
    /// Switch low, motors off.
    Disarmed,
    /// Switch high, not confirmed yet.
    Arming {
        /// Since when.
        since: Timestamp,
        /// Who waits for the answer.
        asked: Option<(RequestId, Station)>,
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
    Armed(Option<(RequestId, Station)>),
    /// It did not happen; the switch is low again.
    Failed(Option<(RequestId, Station)>),
    /// The controller stopped the motors by itself.
    DisarmedByController,
}

/// What the controller said last.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FcArmState {
    /// ARM mode flag.
    pub is_armed: bool,
    /// First blocking flag, if any.
    pub block: Option<FcBlock>,
    /// When it said so.
    pub at: Option<Timestamp>,
}

impl Arming {
    /// True while the arm channel is high.
    #[must_use]
    pub const fn switch_is_high(&self) -> bool {
        !matches!(self, Self::Disarmed)
    }

    /// True while the motors run.
    #[must_use]
    pub const fn is_armed(&self) -> bool {
        matches!(self, Self::Armed { .. })
    }

    /// Raises the switch.
    pub const fn raise(&mut self, now: Timestamp, asked: Option<(RequestId, Station)>) {
        *self = Self::Arming { since: now, asked };
    }

    /// Lowers the switch: motors stop at once.
    pub const fn lower(&mut self) {
        *self = Self::Disarmed;
    }

    /// Compares with what the controller says.
    pub fn step(&mut self, now: Timestamp, fc: &FcArmState) -> Option<Change> {
        match *self {
            Self::Disarmed => None,
            Self::Arming { since, asked } => {
                let said_since = fc.at.is_some_and(|at| at > since);
                if said_since && fc.is_armed {
                    *self = Self::Armed { since: now };
                    Some(Change::Armed(asked))
                } else if now.since(since) > CONFIRM {
                    // Any flag that blocked while the switch went up latches it: only low again clears that.
                    *self = Self::Disarmed;
                    Some(Change::Failed(asked))
                } else {
                    None
                }
            }
            Self::Armed { since } => {
                let said_since = fc.at.is_some_and(|at| at > since);
                if said_since && !fc.is_armed {
                    *self = Self::Disarmed;
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

    fn said(ms: u64, is_armed: bool) -> FcArmState {
        FcArmState {
            is_armed,
            block: None,
            at: Some(Timestamp::from_ms(ms)),
        }
    }

    #[test]
    fn armed_only_when_the_controller_confirms_after_the_switch_went_up() {
        let mut a = Arming::Disarmed;
        a.raise(Timestamp::from_ms(100), None);
        assert_eq!(
            a.step(Timestamp::from_ms(110), &said(90, true)),
            None,
            "an old status proves nothing"
        );
        assert_eq!(
            a.step(Timestamp::from_ms(200), &said(190, true)),
            Some(Change::Armed(None))
        );
        assert!(a.is_armed());
    }

    #[test]
    fn a_latched_switch_is_lowered_again() {
        let mut a = Arming::Disarmed;
        a.raise(Timestamp::from_ms(100), None);
        assert_eq!(
            a.step(Timestamp::from_ms(1_700), &said(1_600, false)),
            Some(Change::Failed(None))
        );
        assert!(!a.switch_is_high());
    }

    #[test]
    fn a_controller_that_disarms_by_itself_is_noticed() {
        let mut a = Arming::Armed {
            since: Timestamp::from_ms(100),
        };
        assert_eq!(
            a.step(Timestamp::from_ms(400), &said(300, false)),
            Some(Change::DisarmedByController)
        );
        assert!(!a.switch_is_high());
    }
}
