//! Arming: what blocks it, how a switch that was raised too early latches, and what failsafe does.
//!
//! Causes are the same for every firmware; which bits tell them, if any, is in the table of manners.

use super::manner::ArmingRules;
use vehicle::Timestamp;

/// `small_angle`: no arming at a larger tilt, cosine of 25 degrees.
const SMALL_ANGLE_COS: f64 = 0.906_307_787;
/// A calibration takes so long: 400 samples of Betaflight at a kilohertz and some more.
const CALIBRATION: core::time::Duration = core::time::Duration::from_millis(800);

/// Why it does not arm.
pub(crate) mod cause {
    pub(crate) const FAILSAFE: u32 = 1;
    pub(crate) const RX_LOST: u32 = 1 << 1;
    pub(crate) const NOT_DISARMED: u32 = 1 << 2;
    pub(crate) const THROTTLE: u32 = 1 << 3;
    pub(crate) const TILT: u32 = 1 << 4;
    /// Boot grace or sensor calibration.
    pub(crate) const SETTLING: u32 = 1 << 5;
    pub(crate) const MSP: u32 = 1 << 6;
    /// Settings changed that need a restart.
    pub(crate) const REBOOT: u32 = 1 << 7;
    /// Another box is on.
    pub(crate) const BOX: u32 = 1 << 8;
    /// The text command line is open.
    pub(crate) const CLI: u32 = 1 << 9;
    pub(crate) const ARM_SWITCH: u32 = 1 << 10;
    /// A sensor is being measured at rest.
    pub(crate) const CALIBRATING: u32 = 1 << 11;
}

/// What arming depends on in this step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Situation {
    pub(super) now: Timestamp,
    pub(super) arm_switch: bool,
    pub(super) throttle_low: bool,
    pub(super) tilt_cos: f64,
    pub(super) receiver_ok: bool,
    pub(super) receiver_lost: bool,
    /// Failsafe stage 2 disarms at once instead of landing.
    pub(super) failsafe_drops: bool,
    /// How long it lands blindly before it disarms.
    pub(super) landing: core::time::Duration,
    pub(super) needs_reboot: bool,
    pub(super) in_cli: bool,
    /// Bits of boxes that block and are on.
    pub(super) blocking_boxes: u32,
}

/// Armed or not, and why not.
#[derive(Clone, Debug)]
pub(super) struct Arming {
    rules: &'static ArmingRules,
    booted: Timestamp,
    armed: bool,
    was_armed: bool,
    /// What blocks now, as causes, and the bits of boxes.
    causes: u32,
    box_bits: u32,
    latched: bool,
    not_disarmed: bool,
    failsafe_since: Option<Timestamp>,
    msp_block: bool,
    calibrating_until: Timestamp,
}

impl Arming {
    pub(super) const fn new(booted: Timestamp, rules: &'static ArmingRules) -> Self {
        Self {
            rules,
            booted,
            armed: false,
            was_armed: false,
            causes: cause::SETTLING | cause::RX_LOST,
            box_bits: 0,
            latched: false,
            not_disarmed: false,
            failsafe_since: None,
            msp_block: false,
            calibrating_until: Timestamp::ZERO,
        }
    }

    pub(super) fn update(&mut self, s: &Situation) {
        if self.failsafe_since.is_some() && s.receiver_ok {
            self.failsafe_since = None;
            // The switch was high all the while: it must be seen low first.
            self.not_disarmed = s.arm_switch && !self.armed;
        }
        if !s.arm_switch {
            self.latched = false;
            self.not_disarmed = false;
        }
        if self.armed {
            if s.receiver_lost && self.failsafe_since.is_none() {
                self.failsafe_since = Some(s.now);
            }
            let landed = |since: Timestamp| s.failsafe_drops || s.now.since(since) >= s.landing;
            let dropped = self.failsafe_since.is_some_and(landed);
            // While it lands by itself the old position of the switch does not matter.
            let wanted = s.arm_switch || self.failsafe_since.is_some();
            self.armed = wanted && !dropped && !self.msp_block;
        }
        self.causes = self.present_causes(s);
        self.box_bits = if self.armed { 0 } else { s.blocking_boxes };
        if !self.armed && s.arm_switch {
            let waits_for_throttle = self.causes == cause::THROTTLE && !self.rules.throttle_latches;
            if self.causes == 0 && !self.latched {
                self.armed = true;
                self.was_armed = true;
            } else if !waits_for_throttle {
                self.latched = true;
            }
        }
        if self.latched {
            self.causes |= cause::ARM_SWITCH;
        }
    }

    fn present_causes(&self, s: &Situation) -> u32 {
        let settling = s.now.since(self.booted) < self.rules.settle;
        let on_ground = [
            (settling, cause::SETTLING),
            (s.now < self.calibrating_until, cause::CALIBRATING),
            (!s.throttle_low, cause::THROTTLE),
            (s.tilt_cos < SMALL_ANGLE_COS, cause::TILT),
            (self.not_disarmed, cause::NOT_DISARMED),
            (s.needs_reboot, cause::REBOOT),
            (s.in_cli, cause::CLI),
            (s.blocking_boxes != 0, cause::BOX),
        ];
        let always = [
            (!s.receiver_ok, cause::RX_LOST),
            (self.failsafe_since.is_some(), cause::FAILSAFE),
            (self.msp_block, cause::MSP),
        ];
        let bits = |table: &[(bool, u32)]| -> u32 {
            let set = table.iter().filter(|(on, _)| *on);
            set.map(|(_, bit)| bit).sum()
        };
        // Once armed the firmware no longer looks at what only concerns arming.
        bits(&always) | if self.armed { 0 } else { bits(&on_ground) }
    }

    /// MSP_SET_ARMING_DISABLED: blocks arming and disarms.
    pub(super) const fn block_by_msp(&mut self, block: bool) {
        self.msp_block = block;
    }

    /// Measures a sensor at rest; while armed nothing happens.
    pub(super) fn calibrate(&mut self, now: Timestamp) {
        if !self.armed {
            self.calibrating_until = now + CALIBRATION;
        }
    }

    pub(super) const fn is_armed(&self) -> bool {
        self.armed
    }

    pub(super) const fn is_failsafe(&self) -> bool {
        self.failsafe_since.is_some()
    }

    /// The word that STATUS or INAV_STATUS tells.
    pub(super) fn told(&self) -> u32 {
        let rules = self.rules;
        let bits = rules
            .told
            .iter()
            .filter(|(cause, _)| self.causes & cause != 0)
            .fold(self.box_bits, |word, (_, bit)| word | bit);
        let armed = if self.armed { rules.armed_bit } else { 0 };
        let was = if self.was_armed {
            rules.was_armed_bit
        } else {
            0
        };
        bits | armed | was
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fc::manner::Manner;
    use core::time::Duration;

    const SWITCH: u32 = 1 << 28;

    fn ready() -> Situation {
        Situation {
            now: Timestamp::from_ms(6000),
            arm_switch: false,
            throttle_low: true,
            tilt_cos: 1.0,
            receiver_ok: true,
            receiver_lost: false,
            failsafe_drops: true,
            landing: Duration::ZERO,
            needs_reboot: false,
            in_cli: false,
            blocking_boxes: 0,
        }
    }

    fn arming() -> Arming {
        Arming::new(Timestamp::ZERO, &Manner::Betaflight46.table().arming)
    }

    #[test]
    fn a_switch_raised_while_something_blocks_latches_until_it_is_lowered() {
        let mut arming = arming();
        let switch_up = Situation {
            arm_switch: true,
            ..ready()
        };
        arming.update(&Situation {
            now: Timestamp::from_ms(4999),
            ..switch_up
        });
        assert_eq!(arming.told(), 1 << 9 | SWITCH);
        arming.update(&switch_up);
        assert_eq!((arming.is_armed(), arming.told()), (false, SWITCH));
        arming.update(&ready());
        assert_eq!(arming.told(), 0);
        arming.update(&switch_up);
        assert!(arming.is_armed());
    }

    #[test]
    fn each_cause_has_its_bit() {
        let mut arming = arming();
        let mut blockers = |s: Situation| {
            arming.update(&s);
            arming.told()
        };
        let r = ready();
        assert_eq!(
            blockers(Situation {
                throttle_low: false,
                ..r
            }),
            1 << 7
        );
        assert_eq!(blockers(Situation { tilt_cos: 0.9, ..r }), 1 << 8);
        assert_eq!(
            blockers(Situation {
                receiver_ok: false,
                ..r
            }),
            1 << 2
        );
        arming.block_by_msp(true);
        arming.update(&r);
        assert_eq!(arming.told(), 1 << 16);
    }

    #[test]
    fn after_a_lost_receiver_the_switch_must_be_seen_low() {
        let mut arming = arming();
        arming.update(&ready());
        let up = Situation {
            arm_switch: true,
            ..ready()
        };
        arming.update(&up);
        arming.update(&Situation {
            receiver_ok: false,
            ..up
        });
        assert!(arming.is_armed(), "stage 1 does not disarm");
        arming.update(&Situation {
            receiver_ok: false,
            receiver_lost: true,
            ..up
        });
        assert!(!arming.is_armed() && arming.is_failsafe());
        arming.update(&up);
        assert_eq!(arming.told(), 1 << 3 | SWITCH);
        arming.update(&ready());
        arming.update(&up);
        assert!(arming.is_armed());
    }

    #[test]
    fn msp_can_disarm_in_the_air() {
        let mut arming = arming();
        arming.update(&ready());
        let up = Situation {
            arm_switch: true,
            throttle_low: false,
            ..ready()
        };
        arming.update(&Situation {
            throttle_low: true,
            ..up
        });
        arming.update(&up);
        assert!(arming.is_armed(), "throttle does not matter once armed");
        arming.block_by_msp(true);
        arming.update(&up);
        assert!(!arming.is_armed());
    }

    #[test]
    fn cleanflight_and_multiwii_wait_for_the_throttle_where_the_others_latch() {
        for manner in Manner::ALL {
            let mut arming = Arming::new(Timestamp::ZERO, &manner.table().arming);
            let up = Situation {
                arm_switch: true,
                throttle_low: false,
                ..ready()
            };
            arming.update(&ready());
            arming.update(&up);
            assert!(!arming.is_armed());
            arming.update(&Situation {
                throttle_low: true,
                ..up
            });
            let waits = matches!(manner, Manner::Cleanflight | Manner::MultiWii);
            assert_eq!(arming.is_armed(), waits, "{manner}");
        }
    }

    #[test]
    fn inav_tells_armed_and_was_armed_in_the_word_of_its_blockers() {
        let mut arming = Arming::new(Timestamp::ZERO, &Manner::Inav.table().arming);
        arming.update(&ready());
        assert_eq!(arming.told(), 0);
        arming.update(&Situation {
            arm_switch: true,
            ..ready()
        });
        assert_eq!(arming.told(), 1 << 2 | 1 << 3);
        arming.update(&ready());
        assert_eq!(arming.told(), 1 << 3);
    }

    #[test]
    fn a_failsafe_that_lands_disarms_when_its_time_is_over() {
        let mut arming = Arming::new(Timestamp::ZERO, &Manner::Inav.table().arming);
        let up = Situation {
            arm_switch: true,
            ..ready()
        };
        arming.update(&ready());
        arming.update(&up);
        let lost = |ms| Situation {
            now: Timestamp::from_ms(ms),
            receiver_ok: false,
            receiver_lost: true,
            failsafe_drops: false,
            landing: Duration::from_secs(20),
            ..up
        };
        arming.update(&lost(7_000));
        assert!(arming.is_armed() && arming.is_failsafe());
        arming.update(&lost(26_999));
        assert!(arming.is_armed());
        arming.update(&lost(27_000));
        assert!(!arming.is_armed());
    }
}
