//! Whose sticks fly beside a live radio: the pilot's, until somebody asks us; the pilot's again the moment he flips his switch.
//!
//! The controller keeps its receiver; while the pilot's switch selects the MSP OVERRIDE box our roll, pitch, yaw and throttle
//! replace his (channel mask 15). The switch is the controller's business: it acts on its next frame without us. What is ours:
//!
//! ```text
//!               switch on              asked (mode, take-off, go-to ...)
//!    Pilot <-------------> Offered ---------------------------------------> Kestrel
//!      ^       off            |  we send nothing: the radio stays in charge    |
//!      +----------------------+-------------------- switch off ---------------+
//!       we repeat his sticks
//! ```
//!
//! Firmware without a freshness test (Betaflight 4.6) goes on with the last frame when the switch comes back: therefore we repeat the
//! pilot's own sticks while he flies. When we are asked, we start from his sticks and leave them slowly.

use super::door::Refusal;
use core::time::Duration;
use serde::{Deserialize, Serialize};
use vehicle::{Sticks, Timestamp};

/// Largest change of a stick a frame until our own sticks are reached; 1 = full deflection.
const STEP: f64 = 0.04;
/// The steps stay small for this long after a hand-back, while our loops find the motion he left.
const HAND_BACK: Duration = Duration::from_secs(1);
/// Sticks of the pilot older than this are not repeated.
const FRESH: Duration = Duration::from_millis(500);

/// Who steers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Steering {
    /// Nobody but us: there is no radio.
    #[default]
    Alone,
    /// The pilot; his switch is off.
    Pilot,
    /// The pilot still; his switch is on, but nobody asked us.
    Offered,
    /// We do, by his leave.
    Kestrel,
}

/// What changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The pilot took over.
    TakenOver,
    /// His switch is on: we may be asked.
    Offered,
}

/// The state machine, and the way from his sticks to ours.
#[derive(Clone, Debug, Default)]
pub struct Handover {
    steering: Steering,
    pilot: Option<(Sticks, Timestamp)>,
    /// Last sticks on the way to our own; none once they are reached and the hand-back is over.
    leaving: Option<Sticks>,
    handed_back: Timestamp,
}

impl Handover {
    /// Beside a live radio, or alone.
    #[must_use]
    pub const fn new(has_radio: bool) -> Self {
        Self {
            steering: if has_radio {
                Steering::Pilot
            } else {
                Steering::Alone
            },
            pilot: None,
            leaving: None,
            handed_back: Timestamp::ZERO,
        }
    }

    /// Who steers.
    #[must_use]
    pub const fn steering(&self) -> Steering {
        self.steering
    }

    /// True if a radio is in charge of switches, and of the sticks unless we were asked.
    #[must_use]
    pub const fn has_radio(&self) -> bool {
        !matches!(self.steering, Steering::Alone)
    }

    /// True while our own sticks count for nothing.
    #[must_use]
    pub const fn pilot_steers(&self) -> bool {
        matches!(self.steering, Steering::Pilot | Steering::Offered)
    }

    /// The controller told what its receiver has, after the override. While we steer that is an echo of ourselves.
    pub fn heard_pilot(&mut self, now: Timestamp, sticks: Sticks) {
        if self.steering == Steering::Pilot {
            self.pilot = Some((sticks.clamped(), now));
        }
    }

    /// The pilot's sticks as last heard.
    #[must_use]
    pub fn pilot(&self) -> Sticks {
        self.pilot.map_or(Sticks::IDLE, |(sticks, _)| sticks)
    }

    /// The controller told whether the switch is on.
    pub fn observe(&mut self, switch_is_on: bool) -> Option<Change> {
        match (self.steering, switch_is_on) {
            (Steering::Kestrel, false) => {
                self.steering = Steering::Pilot;
                self.pilot = None;
                self.leaving = None;
                Some(Change::TakenOver)
            }
            (Steering::Offered, false) => {
                self.steering = Steering::Pilot;
                None
            }
            (Steering::Pilot, true) => {
                self.steering = Steering::Offered;
                Some(Change::Offered)
            }
            _ => None,
        }
    }

    /// Somebody asks us to steer; true if we did not before.
    ///
    /// # Errors
    /// The pilot's switch is off.
    pub fn ask(&mut self, now: Timestamp) -> Result<bool, Refusal> {
        match self.steering {
            Steering::Alone | Steering::Kestrel => Ok(false),
            Steering::Pilot => Err(Refusal::PilotSteers),
            Steering::Offered => {
                self.steering = Steering::Kestrel;
                self.leaving = Some(self.pilot());
                self.handed_back = now;
                Ok(true)
            }
        }
    }

    /// The sticks to send instead of `own`; none = send nothing.
    pub fn sticks(&mut self, now: Timestamp, own: Sticks) -> Option<Sticks> {
        match self.steering {
            Steering::Alone => Some(own),
            Steering::Pilot => self
                .pilot
                .filter(|(_, at)| now.since(*at) <= FRESH)
                .map(|(sticks, _)| sticks),
            Steering::Offered => None,
            Steering::Kestrel => {
                let Some(last) = self.leaving else {
                    return Some(own);
                };
                let own = own.clamped();
                let near = |from: f64, to: f64| from + (to - from).clamp(-STEP, STEP);
                let next = Sticks {
                    roll: near(last.roll, own.roll),
                    pitch: near(last.pitch, own.pitch),
                    yaw: near(last.yaw, own.yaw),
                    throttle: near(last.throttle, own.throttle),
                };
                let is_over = next == own && now.since(self.handed_back) >= HAND_BACK;
                self.leaving = (!is_over).then_some(next);
                Some(next)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HIS: Sticks = Sticks {
        roll: 0.3,
        pitch: -0.2,
        yaw: 0.1,
        throttle: 0.55,
    };
    const OURS: Sticks = Sticks {
        roll: -0.5,
        pitch: 0.4,
        yaw: 0.0,
        throttle: 0.4,
    };

    fn ms(ms: u64) -> Timestamp {
        Timestamp::from_ms(ms)
    }

    fn steering() -> Handover {
        let mut h = Handover::new(true);
        h.heard_pilot(ms(0), HIS);
        h.observe(true);
        h.ask(ms(0)).unwrap();
        while h.leaving.is_some() {
            h.sticks(ms(1_000), OURS);
        }
        h
    }

    #[test]
    fn alone_our_sticks_pass_and_no_switch_matters() {
        let mut h = Handover::new(false);
        assert_eq!(h.observe(false), None);
        assert_eq!(h.sticks(ms(0), OURS), Some(OURS));
        assert_eq!(h.ask(ms(0)), Ok(false));
    }

    #[test]
    fn from_the_frame_after_the_switch_on_none_of_our_sticks_is_sent() {
        let mut h = steering();
        assert_eq!(h.observe(false), Some(Change::TakenOver));
        assert_eq!(h.sticks(ms(10), OURS), None, "his are not known yet");
        h.heard_pilot(ms(20), HIS);
        assert_eq!(h.sticks(ms(25), OURS), Some(HIS));
        assert_eq!(h.sticks(ms(600), OURS), None, "old ones are not repeated");
    }

    #[test]
    fn the_switch_alone_gives_nothing_back() {
        let mut h = steering();
        h.observe(false);
        h.heard_pilot(ms(20), HIS);
        assert_eq!(
            h.ask(ms(30)),
            Err(Refusal::PilotSteers),
            "his switch is off"
        );
        assert_eq!(h.observe(true), Some(Change::Offered));
        assert_eq!(h.sticks(ms(40), OURS), None);
        assert_eq!(h.ask(ms(50)), Ok(true));
        assert_eq!(h.steering(), Steering::Kestrel);
    }

    #[test]
    fn what_the_receiver_shows_while_we_steer_is_not_taken_for_the_pilot() {
        let mut h = steering();
        h.heard_pilot(ms(10), OURS);
        assert_eq!(h.pilot(), HIS);
    }

    proptest! {
        #[test]
        fn a_hand_back_starts_at_his_sticks_and_no_frame_steps_more_than_a_twentieth(
            his in prop::array::uniform4(-1.0f64..1.0), ours in prop::collection::vec(prop::array::uniform4(-1.0f64..1.0), 1..200)
        ) {
            let of = |v: [f64; 4]| Sticks { roll: v[0], pitch: v[1], yaw: v[2], throttle: v[3].abs() };
            let mut h = Handover::new(true);
            h.heard_pilot(ms(0), of(his));
            h.observe(true);
            h.ask(ms(0)).unwrap();
            let mut last = of(his);
            for own in ours {
                let next = h.sticks(ms(1), of(own)).unwrap();
                let step = [next.roll - last.roll, next.pitch - last.pitch, next.yaw - last.yaw, next.throttle - last.throttle];
                if h.leaving.is_some() {
                    prop_assert!(step.iter().all(|s| s.abs() <= 0.05 + 1e-12), "{step:?}");
                }
                last = next;
            }
        }
    }
}
