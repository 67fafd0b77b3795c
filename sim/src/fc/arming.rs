//! Arming of Betaflight: what blocks it, and how a switch that was raised too early latches.

use super::Firmware;
use core::time::Duration;
use vehicle::Timestamp;

/// Arming is blocked this long after start.
const BOOT_GRACE: Duration = Duration::from_secs(5);
/// `small_angle`: no arming at a larger tilt, cosine of 25 degrees.
const SMALL_ANGLE_COS: f64 = 0.906_307_787;

/// Bits of `arming_disable` that the fake sets; ARM_SWITCH, always the last one, comes on top.
pub(crate) mod blocker {
    pub(crate) const FAILSAFE: u32 = 1 << 1;
    pub(crate) const RX_FAILSAFE: u32 = 1 << 2;
    pub(crate) const NOT_DISARMED: u32 = 1 << 3;
    pub(crate) const THROTTLE: u32 = 1 << 7;
    pub(crate) const ANGLE: u32 = 1 << 8;
    pub(crate) const BOOT_GRACE: u32 = 1 << 9;
    pub(crate) const MSP: u32 = 1 << 16;
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
}

/// Armed or not, and why not.
#[derive(Clone, Debug)]
pub(super) struct Arming {
    booted: Timestamp,
    armed: bool,
    blockers: u32,
    arm_switch_bit: u32,
    latched: bool,
    not_disarmed: bool,
    failsafe: bool,
    msp_block: bool,
}

impl Arming {
    pub(super) fn new(booted: Timestamp, firmware: Firmware) -> Self {
        Self {
            booted,
            armed: false,
            blockers: blocker::BOOT_GRACE | blocker::RX_FAILSAFE,
            arm_switch_bit: 1 << (firmware.arming_disable_count() - 1),
            latched: false,
            not_disarmed: false,
            failsafe: false,
            msp_block: false,
        }
    }

    pub(super) fn update(&mut self, s: &Situation) {
        if self.failsafe && s.receiver_ok {
            self.failsafe = false;
            // The switch was high all the while: it must be seen low first.
            self.not_disarmed = s.arm_switch;
        }
        if !s.arm_switch {
            self.latched = false;
            self.not_disarmed = false;
        }
        if self.armed {
            if s.receiver_lost {
                self.failsafe = true;
            }
            self.armed = s.arm_switch && !s.receiver_lost && !self.msp_block;
        }
        let blockers = self.present_blockers(s);
        if !self.armed && s.arm_switch {
            if blockers == 0 && !self.latched {
                self.armed = true;
            } else {
                self.latched = true;
            }
        }
        let latch = if self.latched { self.arm_switch_bit } else { 0 };
        self.blockers = blockers | latch;
    }

    fn present_blockers(&self, s: &Situation) -> u32 {
        let on_ground = [
            (s.now.since(self.booted) < BOOT_GRACE, blocker::BOOT_GRACE),
            (!s.throttle_low, blocker::THROTTLE),
            (s.tilt_cos < SMALL_ANGLE_COS, blocker::ANGLE),
            (self.not_disarmed, blocker::NOT_DISARMED),
        ];
        let always = [
            (!s.receiver_ok, blocker::RX_FAILSAFE),
            (self.failsafe, blocker::FAILSAFE),
            (self.msp_block, blocker::MSP),
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

    pub(super) const fn is_armed(&self) -> bool {
        self.armed
    }

    pub(super) const fn is_failsafe(&self) -> bool {
        self.failsafe
    }

    pub(super) const fn blockers(&self) -> u32 {
        self.blockers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SWITCH: u32 = 1 << 28;

    fn ready() -> Situation {
        Situation {
            now: Timestamp::from_ms(6000),
            arm_switch: false,
            throttle_low: true,
            tilt_cos: 1.0,
            receiver_ok: true,
            receiver_lost: false,
        }
    }

    fn arming() -> Arming {
        Arming::new(Timestamp::ZERO, Firmware::Betaflight46)
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
        assert_eq!(arming.blockers(), blocker::BOOT_GRACE | SWITCH);
        arming.update(&switch_up);
        assert_eq!((arming.is_armed(), arming.blockers()), (false, SWITCH));
        arming.update(&ready());
        assert_eq!(arming.blockers(), 0);
        arming.update(&switch_up);
        assert!(arming.is_armed());
    }

    #[test]
    fn each_cause_has_its_bit() {
        let mut arming = arming();
        let mut blockers = |s: Situation| {
            arming.update(&s);
            arming.blockers()
        };
        let r = ready();
        assert_eq!(
            blockers(Situation {
                throttle_low: false,
                ..r
            }),
            blocker::THROTTLE
        );
        assert_eq!(blockers(Situation { tilt_cos: 0.9, ..r }), blocker::ANGLE);
        assert_eq!(
            blockers(Situation {
                receiver_ok: false,
                ..r
            }),
            blocker::RX_FAILSAFE
        );
        arming.block_by_msp(true);
        arming.update(&r);
        assert_eq!(arming.blockers(), blocker::MSP);
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
        assert_eq!(arming.blockers(), blocker::NOT_DISARMED | SWITCH);
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
}
