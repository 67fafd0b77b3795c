//! What flight beside a live radio needs: the pilot arms and flies with a receiver of their own, and one switch of theirs
//! hands the sticks to MSP.
//!
//! | What | Needed | Mended by |
//! | --- | --- | --- |
//! | receiver | the pilot's, not MSP | hand |
//! | override | a firmware that has it, its channels chosen | hand: no message sets them |
//! | override switch | MSP OVERRIDE on a switch of the pilot's radio | provision |
//! | angle mode | on whenever the sticks are ours | provision: on the same switch |
//! | arm switch | the pilot's | hand |

use super::findings::{Finding, INAV_RX_MSP, Slots, Verdict, common, service};
use super::survey::Survey;
use msp::firmware::{Firmware, box_id};
use msp::message::{FeatureConfig, ModeRange};

/// The table for a controller with the pilot's receiver on it. `aux`: the channel of the override switch, 0 = Aux1.
#[must_use]
pub fn findings_beside_radio(survey: &Survey, aux: u8, service_hz: Option<f64>) -> Vec<Finding> {
    let mut table = common(survey);
    table.extend(receiver(survey));
    table.push(override_there(survey));
    if !survey.mode_ranges().is_empty() {
        table.extend(switches(survey, aux));
    }
    table.extend(service_hz.map(service));
    table
}

fn receiver(survey: &Survey) -> Option<Finding> {
    let is_msp = match survey.rx_config() {
        Some(config) => config.receiver_type()? == INAV_RX_MSP,
        None => survey.features()?.has(FeatureConfig::RX_MSP),
    };
    Some(if is_msp {
        let how =
            "choose the pilot's receiver in the configurator: which one it is cannot be known here";
        Finding::new("receiver", "MSP", Verdict::ByHand(how.to_owned()))
    } else {
        Finding::new("receiver", "the pilot's", Verdict::Fine)
    })
}

/// Which channels MSP takes is told by no message. That Betaflight lists the box means that it is at least one.
fn override_there(survey: &Survey) -> Finding {
    let what = "override";
    let has_box = survey
        .identity
        .box_ids
        .index_of(box_id::MSP_OVERRIDE)
        .is_some();
    let (found, verdict) = match (survey.identity.firmware, has_box) {
        (Firmware::Betaflight, true) => (
            "there",
            Verdict::Advice(
                "its channels cannot be read here: `get msp_override_channels_mask` on its command line must say 15 (the \
                 sticks). Up to Betaflight 4.6 the last stick stays when we fall silent: the switch must stay in reach"
                    .to_owned(),
            ),
        ),
        (Firmware::Inav, true) => (
            "there",
            Verdict::Advice(
                "its channels cannot be read here: `get msp_override_channels` on its command line must say 15 (the sticks)"
                    .to_owned(),
            ),
        ),
        (Firmware::Betaflight, false) => (
            "no channels",
            Verdict::ByHand(
                "on its command line: `set msp_override_channels_mask = 15`, then `save`; a firmware that does not know \
                 it was built without override"
                    .to_owned(),
            ),
        ),
        (Firmware::Inav, false) => (
            "none",
            Verdict::ByHand(
                "on its command line: `set msp_override_channels = 15`, then `save`; a firmware that does not know it was \
                 built without override"
                    .to_owned(),
            ),
        ),
        (Firmware::MultiWii, _) => (
            "always",
            Verdict::Advice(
                "MSP speaks over the radio for a second after each frame: no switch keeps it out".to_owned(),
            ),
        ),
        (Firmware::Cleanflight | Firmware::Other(_), _) => (
            "none",
            Verdict::ByHand(
                "this firmware takes no sticks from MSP beside a radio: fly it by MSP alone".to_owned(),
            ),
        ),
    };
    Finding::new(what, found, verdict)
}

fn switches(survey: &Survey, aux: u8) -> Vec<Finding> {
    let has_override = survey
        .identity
        .box_ids
        .index_of(box_id::MSP_OVERRIDE)
        .is_some();
    let mut slots = Slots::of(survey);
    let ours = |id| ModeRange::from_us(id, aux, 1700, 2100);
    let name = format!("Aux{} 1700..2100", u32::from(aux) + 1);
    let mut table = Vec::new();
    let full = || Verdict::ByHand("no mode slot is free: clear one in the configurator".to_owned());

    let arms = slots
        .ranges
        .iter()
        .any(|range| range.is_used() && range.permanent_id == box_id::ARM);
    table.push(if arms {
        Finding::new("arm switch", "the pilot's", Verdict::Fine)
    } else {
        let how = "the pilot arms: give ARM a switch in the configurator".to_owned();
        Finding::new("arm switch", "none", Verdict::ByHand(how))
    });

    let what = "override switch";
    let set = slots
        .ranges
        .iter()
        .find(|range| range.is_used() && range.permanent_id == box_id::MSP_OVERRIDE)
        .copied();
    // Another mode on the same position would come on with it. ANGLE is wanted there.
    let taken = slots.ranges.iter().any(|range| {
        let is_other = ![box_id::MSP_OVERRIDE, box_id::ANGLE].contains(&range.permanent_id);
        let always_on = range.contains(1000) && range.contains(2000);
        range.is_used() && range.aux == aux && is_other && range.contains(2000) && !always_on
    });
    let switch = match set {
        Some(range) => {
            let found = format!("Aux{}", u32::from(range.aux) + 1);
            table.push(Finding::new(what, found, Verdict::Fine));
            Some(range)
        }
        // Without the box in its list there is nothing to switch.
        None if !has_override => None,
        None if taken => {
            let how = format!("another mode is on {name}: name a free channel with --switch");
            table.push(Finding::new(what, "none", Verdict::ByHand(how)));
            None
        }
        None if !slots.add(
            ours(box_id::MSP_OVERRIDE),
            &format!("MSP OVERRIDE on {name}"),
        ) =>
        {
            table.push(Finding::new(what, "none", full()));
            None
        }
        None => {
            let verdict = Verdict::Provision(slots.take());
            table.push(Finding::new(what, "none", verdict));
            Some(ours(box_id::MSP_OVERRIDE))
        }
    };

    // Our sticks are angles: the switch that lets them in must level too.
    if let Some(switch) = switch {
        let angle = ModeRange {
            permanent_id: box_id::ANGLE,
            ..switch
        };
        let covers = |range: &ModeRange| {
            let steps = |r: &ModeRange| {
                (900..=2100)
                    .step_by(25)
                    .filter(|us| r.contains(*us))
                    .count()
            };
            let both = (900..=2100)
                .step_by(25)
                .filter(|us| range.contains(*us) && switch.contains(*us))
                .count();
            let is_always = range.contains(900) && range.contains(2000);
            is_always || (range.aux == switch.aux && both == steps(&switch))
        };
        let levels = slots
            .ranges
            .iter()
            .any(|range| range.is_used() && range.permanent_id == box_id::ANGLE && covers(range));
        table.push(if levels {
            Finding::new("angle mode", "on with it", Verdict::Fine)
        } else if slots.add(angle, "ANGLE with the override switch") {
            Finding::new(
                "angle mode",
                "not with it",
                Verdict::Provision(slots.take()),
            )
        } else {
            Finding::new("angle mode", "not with it", full())
        });
    }
    table
}
