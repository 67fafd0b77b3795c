//! Pre-flight checks: why an arm would be refused now.

use super::arming::FcArmState;
use super::door::Refusal;
use super::failsafes::{Facts, TABLE};
use super::mode::Because;
use vehicle::NavState;

/// What the checks look at.
#[derive(Clone, Copy, Debug)]
pub struct Checks<'a> {
    /// The flight controller answers and is identified.
    pub fc_is_connected: bool,
    /// It is of a firmware we do not know.
    pub unknown_firmware: Option<[u8; 4]>,
    /// It answers but does not run its loop.
    pub is_stalled: bool,
    /// Blocks that pass once frames with a low switch come do not count.
    pub may_wait: bool,
    /// What it says about arming.
    pub fc: &'a FcArmState,
    /// The estimate.
    pub nav: &'a NavState,
    /// What the rows of the table look at.
    pub facts: Facts<'a>,
    /// The program wants to end.
    pub is_shutting_down: bool,
}

/// The first failing check; none = armable.
#[must_use]
pub fn first_failure(c: &Checks<'_>) -> Option<Refusal> {
    if c.is_shutting_down {
        return Some(Refusal::ShuttingDown);
    }
    controller_failure(c).or_else(|| own_failure(c))
}

/// What the flight controller objects to; a forced arm cannot skip it.
#[must_use]
pub fn controller_failure(c: &Checks<'_>) -> Option<Refusal> {
    if !c.fc_is_connected {
        return Some(Refusal::FcSilent);
    }
    if let Some(variant) = c.unknown_firmware {
        return Some(Refusal::FcUnknown { variant });
    }
    if c.is_stalled {
        return Some(Refusal::FcStalled);
    }
    let blocks = c.fc.blocks;
    let is_clear = if c.may_wait {
        blocks.will_pass()
    } else {
        blocks.is_clear()
    };
    (!is_clear).then_some(Refusal::FcBlocks(blocks))
}

/// What we object to; a forced arm skips it. The rows of the table that keep from flying keep from taking off.
fn own_failure(c: &Checks<'_>) -> Option<Refusal> {
    let mut rows = TABLE.iter().filter(|row| row.refuses_arming);
    let fires = |because: Because| {
        TABLE
            .iter()
            .any(|row| row.because == because && row.refuses_arming && (row.when)(&c.facts))
    };
    if fires(Because::EstimatorFailed) {
        return Some(Refusal::NoAttitude);
    }
    if fires(Because::RangersSilent) {
        return Some(Refusal::NoRangers);
    }
    if !c.nav.health.position && !c.facts.params.search {
        return Some(Refusal::SearchDisabled);
    }
    rows.find(|row| (row.when)(&c.facts))
        .map(|row| match (row.because, c.facts.battery) {
            (Because::BatteryLow, Some(left)) => Refusal::BatteryLow {
                percent: (left * 100.0) as u8,
            },
            (because, _) => Refusal::Failsafe(because),
        })
}

#[cfg(test)]
mod tests {
    use super::super::failsafes::tests::well;
    use super::super::params::AutopilotParams;
    use super::*;
    use crate::autopilot::door::FcBlocks;
    use vehicle::NavHealth;

    #[test]
    fn each_check_names_its_reason_in_order() {
        let params = AutopilotParams::default();
        let unknown = NavState::default();
        let flying = NavState {
            health: NavHealth {
                attitude: true,
                height: true,
                velocity: true,
                position: false,
            },
            ..unknown
        };
        let blocked = FcArmState {
            blocks: FcBlocks {
                variant: *b"BTFL",
                count: 29,
                flags: 1 << 7 | 1 << 8,
            },
            ..Default::default()
        };
        let free = FcArmState::default();
        let said = |c: &Checks<'_>| first_failure(c).map(|r| r.to_string()).unwrap_or_default();
        let c = Checks {
            fc_is_connected: false,
            unknown_firmware: Some(*b"EMUF"),
            is_stalled: true,
            may_wait: false,
            fc: &blocked,
            nav: &unknown,
            facts: Facts {
                has_attitude_and_height: false,
                rangers_silent_s: f64::INFINITY,
                battery: Some(0.05),
                ..well(&params)
            },
            is_shutting_down: false,
        };
        assert_eq!(said(&c), "flight controller does not answer");
        let c = Checks {
            fc_is_connected: true,
            ..c
        };
        assert_eq!(
            said(&c),
            "flight controller firmware EMUF is not known: watched, not flown"
        );
        let c = Checks {
            unknown_firmware: None,
            ..c
        };
        assert!(said(&c).contains("cycle time 0"));
        let c = Checks {
            is_stalled: false,
            ..c
        };
        assert_eq!(
            said(&c),
            "flight controller blocks arming: THROTTLE (throttle is not low), ANGLE (not level enough)"
        );
        let c = Checks { fc: &free, ..c };
        assert_eq!(said(&c), "attitude and height are not known yet");
        let c = Checks {
            nav: &flying,
            facts: Facts {
                has_attitude_and_height: true,
                ..c.facts
            },
            ..c
        };
        assert_eq!(said(&c), "range finders are silent");
        let c = Checks {
            facts: Facts {
                rangers_silent_s: 0.1,
                ..c.facts
            },
            ..c
        };
        assert_eq!(said(&c), "battery low (5 %)");
        let c = Checks {
            facts: Facts {
                battery: Some(0.8),
                ..c.facts
            },
            ..c
        };
        assert_eq!(said(&c), "", "an unknown place is looked for in flight");
        let c = Checks {
            facts: Facts {
                tilted_s: 1.0,
                ..c.facts
            },
            ..c
        };
        assert_eq!(said(&c), "failsafe holds: tilted too far");
    }
}
