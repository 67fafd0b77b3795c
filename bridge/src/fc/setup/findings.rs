//! What flight by MSP needs, what is there, and what would mend it.
//!
//! | What | Needed | Mended by |
//! | --- | --- | --- |
//! | firmware | one that can be flown | hand |
//! | scheduler | runs | hand |
//! | accelerometer | there, calibrated | hand |
//! | motor protocol | chosen | hand |
//! | receiver | MSP, no other | provision |
//! | arm switch | high on Aux1 arms, low does not | provision |
//! | angle mode | on at Aux2 high | provision |
//! | modes that block or steer | none on by the channels that Kestrel sends | provision |
//! | throttle without receiver | holds until stage 2 (Betaflight) | provision |
//! | rate of its serial task | 200 a second or more is better | hand |

use super::apply::Write;
use super::survey::{RXFAIL_CONFIG, SET_RXFAIL_CONFIG, Survey};
use crate::fc::rc_out;
use msp::firmware::{Firmware, box_id};
use msp::message::{FeatureConfig, ModeRange, SetModeRange};
use msp::{Message, command};

/// Receivers that exclude each other: PPM, UDP (simulator), serial, parallel PWM, SPI.
const OTHER_RECEIVERS: u32 = 1 | 1 << 1 | 1 << 3 | 1 << 13 | 1 << 25;
/// INAV: `receiver_type`.
pub(super) const INAV_RX_MSP: u8 = 2;
/// RXFAIL_CONFIG: keep the last value.
const HOLD: u8 = 1;
/// Throttle among roll, pitch, yaw, throttle, Aux1 ...
const THROTTLE: usize = 3;
/// MSP messages a second below which flight is worse.
const GOOD_SERVICE_HZ: f64 = 150.0;
/// Bits of `problems` in BOARD_INFO.
const PROBLEM_ACC: u32 = 1;
const PROBLEM_MOTOR_PROTOCOL: u32 = 2;

/// What is to be done about a finding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As it must be.
    Fine,
    /// Could be better; the words say how.
    Advice(String),
    /// Must be mended by hand; the words say how.
    ByHand(String),
    /// [`apply`](super::apply()) can mend it.
    Provision(Vec<Write>),
}

/// One row of the table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What it is about.
    pub what: &'static str,
    /// What is there.
    pub found: String,
    /// What is to be done.
    pub verdict: Verdict,
}

impl Finding {
    pub(super) fn new(what: &'static str, found: impl Into<String>, verdict: Verdict) -> Self {
        Self {
            what,
            found: found.into(),
            verdict,
        }
    }
}

/// The table for a controller. `service_hz`: messages a second it was measured to answer.
#[must_use]
pub fn findings(survey: &Survey, service_hz: Option<f64>) -> Vec<Finding> {
    let mut table = common(survey);
    table.extend(receiver(survey));
    if !survey.mode_ranges().is_empty() {
        table.extend(switches(survey));
    }
    table.extend(throttle_without_receiver(survey));
    table.extend(service_hz.map(service));
    table
}

/// What every way of flying needs.
pub(super) fn common(survey: &Survey) -> Vec<Finding> {
    let mut table = vec![firmware(survey), scheduler(survey)];
    table.extend(board(survey));
    table
}

/// Every write that the table asks for.
#[must_use]
pub fn writes(table: &[Finding]) -> Vec<Write> {
    table
        .iter()
        .filter_map(|finding| match &finding.verdict {
            Verdict::Provision(writes) => Some(writes.clone()),
            _ => None,
        })
        .flatten()
        .collect()
}

fn firmware(survey: &Survey) -> Finding {
    let verdict = match survey.identity.firmware {
        Firmware::Betaflight | Firmware::Inav | Firmware::Cleanflight => Verdict::Fine,
        Firmware::MultiWii | Firmware::Other(_) => Verdict::ByHand(
            "its settings are not known here: set receiver and switches with its own configurator"
                .to_owned(),
        ),
    };
    Finding::new("firmware", survey.identity.to_string(), verdict)
}

fn scheduler(survey: &Survey) -> Finding {
    if survey.cycle_us == 0 {
        let how = "power it off and on: its scheduler does not run".to_owned();
        return Finding::new("control loop", "stands still", Verdict::ByHand(how));
    }
    let found = format!("{} us", survey.cycle_us);
    Finding::new("control loop", found, Verdict::Fine)
}

fn board(survey: &Survey) -> Vec<Finding> {
    let problems = survey
        .identity
        .board
        .as_ref()
        .and_then(|board| board.config_problems)
        .unwrap_or(0);
    let accelerometer = if !survey.has_accelerometer {
        let how = "angle mode needs one: enable it in the configurator".to_owned();
        Finding::new("accelerometer", "none", Verdict::ByHand(how))
    } else if problems & PROBLEM_ACC != 0 {
        let how = "put it level and still and calibrate it in the configurator".to_owned();
        Finding::new("accelerometer", "not calibrated", Verdict::ByHand(how))
    } else {
        Finding::new("accelerometer", "there", Verdict::Fine)
    };
    let mut table = vec![accelerometer];
    if problems & PROBLEM_MOTOR_PROTOCOL != 0 {
        let how = "choose the protocol of the ESCs in the configurator".to_owned();
        table.push(Finding::new("motor protocol", "none", Verdict::ByHand(how)));
    }
    table
}

fn receiver(survey: &Survey) -> Option<Finding> {
    if let Some(config) = survey.rx_config() {
        // INAV.
        let is = config.receiver_type()?;
        if is == INAV_RX_MSP {
            return Some(Finding::new("receiver", "MSP", Verdict::Fine));
        }
        // As it came, but for one byte: the struct may not know all that follows.
        let mut payload = survey.settings.get(&command::RX_CONFIG)?.clone();
        *payload.get_mut(23)? = INAV_RX_MSP;
        let write = Write {
            text: format!("receiver: type {is} -> MSP"),
            command: command::SET_RX_CONFIG,
            payload,
        };
        return Some(Finding::new(
            "receiver",
            format!("type {is}"),
            Verdict::Provision(vec![write]),
        ));
    }
    let is = survey.features()?;
    let wanted = FeatureConfig {
        features: is.features & !OTHER_RECEIVERS | FeatureConfig::RX_MSP,
    };
    if is == wanted {
        return Some(Finding::new("receiver", "MSP", Verdict::Fine));
    }
    let found = if is.has(FeatureConfig::RX_MSP) {
        "MSP and another"
    } else {
        "not MSP"
    };
    let write = Write::message(
        format!(
            "receiver: {found} -> MSP (features {:#010x} -> {:#010x})",
            is.features, wanted.features
        ),
        command::SET_FEATURE_CONFIG,
        &wanted,
    );
    Some(Finding::new(
        "receiver",
        found,
        Verdict::Provision(vec![write]),
    ))
}

/// Modes that block arming, or take the sticks or the throttle, when they are on.
const UNWANTED: [(u8, &str); 6] = [
    (box_id::ALTITUDE_HOLD, "ALTITUDE HOLD"),
    (box_id::POSITION_HOLD, "POSITION HOLD"),
    (box_id::FAILSAFE, "FAILSAFE"),
    (box_id::HEADING_HOLD, "HEADING HOLD"),
    (box_id::BETAFLIGHT_PREARM, "PREARM"),
    (box_id::BETAFLIGHT_GPS_RESCUE, "GPS RESCUE"),
];

/// The slots as they will be, while they are being changed.
pub(super) struct Slots {
    pub(super) ranges: Vec<ModeRange>,
    writes: Vec<Write>,
}

impl Slots {
    pub(super) fn of(survey: &Survey) -> Self {
        Self {
            ranges: survey.mode_ranges(),
            writes: Vec::new(),
        }
    }

    /// The orders since the last call.
    pub(super) fn take(&mut self) -> Vec<Write> {
        core::mem::take(&mut self.writes)
    }

    /// On by the switches in one of their two states (disarmed, armed).
    fn is_on(range: &ModeRange, aux_us: &[u16]) -> bool {
        range.is_used()
            && aux_us
                .get(usize::from(range.aux))
                .is_some_and(|us| range.contains(*us))
    }

    fn set(&mut self, slot: usize, range: ModeRange, text: String) {
        self.ranges[slot] = range;
        let order = SetModeRange {
            slot: u8::try_from(slot).unwrap_or(u8::MAX),
            range,
            logic: None,
            linked_to: None,
        };
        let text = format!("mode slot {slot}: {text}");
        self.writes
            .push(Write::message(text, command::SET_MODE_RANGE, &order));
    }

    pub(super) fn add(&mut self, range: ModeRange, text: &str) -> bool {
        let free = self.ranges.iter().position(|range| !range.is_used());
        if let Some(slot) = free {
            self.set(slot, range, format!("unused -> {text}"));
        }
        free.is_some()
    }

    fn clear(&mut self, slot: usize, name: &str) {
        let range = ModeRange::default();
        self.set(slot, range, format!("{name} -> unused"));
    }
}

fn switches(survey: &Survey) -> Vec<Finding> {
    let [disarmed, armed] = [false, true].map(rc_out::aux_us);
    let mut slots = Slots::of(survey);
    let mut table = Vec::new();
    let full = || Verdict::ByHand("no mode slot is free: clear one in the configurator".to_owned());

    // Modes first: they may free slots.
    let mut names = Vec::new();
    for slot in 0..slots.ranges.len() {
        let range = slots.ranges[slot];
        let Some((id, name)) = UNWANTED.iter().find(|(id, _)| *id == range.permanent_id) else {
            continue;
        };
        let is_inav = survey.identity.firmware == Firmware::Inav;
        if is_inav && *id >= box_id::BETAFLIGHT_PREARM {
            // Other modes have these numbers there.
            continue;
        }
        // The mere presence of a PREARM switch makes it needed.
        let is_prearm = *id == box_id::BETAFLIGHT_PREARM && range.is_used();
        if is_prearm || Slots::is_on(&range, &disarmed) || Slots::is_on(&range, &armed) {
            slots.clear(slot, name);
            names.push(*name);
        }
    }
    let unwanted = slots.take();

    // ARM: nothing arms with the switch low, something does with the switch high.
    for slot in 0..slots.ranges.len() {
        let range = slots.ranges[slot];
        if range.permanent_id == box_id::ARM && Slots::is_on(&range, &disarmed) {
            slots.clear(slot, "ARM with the switch low");
        }
    }
    let arms = |range: &ModeRange| range.permanent_id == box_id::ARM && Slots::is_on(range, &armed);
    let has_arm = slots.ranges.iter().any(arms);
    let fits = has_arm
        || slots.add(
            ModeRange::from_us(box_id::ARM, 0, 1700, 2100),
            "ARM on Aux1 1700..2100",
        );
    let arm = slots.take();
    table.push(match (fits, arm.is_empty()) {
        (false, _) => Finding::new("arm switch", "none", full()),
        (true, true) => Finding::new("arm switch", "Aux1 high", Verdict::Fine),
        (true, false) if has_arm => Finding::new(
            "arm switch",
            "arms with the switch low",
            Verdict::Provision(arm),
        ),
        (true, false) => Finding::new("arm switch", "none", Verdict::Provision(arm)),
    });

    let levels = |range: &ModeRange| {
        range.permanent_id == box_id::ANGLE
            && Slots::is_on(range, &disarmed)
            && Slots::is_on(range, &armed)
    };
    let has_angle = slots.ranges.iter().any(levels);
    let fits = has_angle
        || slots.add(
            ModeRange::from_us(box_id::ANGLE, 1, 1700, 2100),
            "ANGLE on Aux2 1700..2100",
        );
    let angle = slots.take();
    table.push(match (fits, has_angle) {
        (false, _) => Finding::new("angle mode", "none", full()),
        (true, true) => Finding::new("angle mode", "Aux2 high", Verdict::Fine),
        (true, false) => Finding::new("angle mode", "none", Verdict::Provision(angle)),
    });

    table.push(if unwanted.is_empty() {
        Finding::new("modes in the way", "none", Verdict::Fine)
    } else {
        Finding::new(
            "modes in the way",
            names.join(", "),
            Verdict::Provision(unwanted),
        )
    });
    table
}

fn throttle_without_receiver(survey: &Survey) -> Option<Finding> {
    let what = "throttle without receiver";
    survey.settings.get(&RXFAIL_CONFIG)?;
    let Some((mode, value_us)) = survey.rx_fail(THROTTLE) else {
        let how = "its receiver has no channels yet; provision twice".to_owned();
        return Some(Finding::new(what, "not told", Verdict::Advice(how)));
    };
    if mode == HOLD {
        return Some(Finding::new(what, "holds until stage 2", Verdict::Fine));
    }
    let found = if mode == 0 { "off after 0.3 s" } else { "set" };
    let mut payload = vec![THROTTLE as u8, HOLD];
    payload.extend_from_slice(&value_us.to_le_bytes());
    let write = Write {
        text: format!("throttle without receiver: {found} -> holds until failsafe stage 2"),
        command: SET_RXFAIL_CONFIG,
        payload,
    };
    Some(Finding::new(what, found, Verdict::Provision(vec![write])))
}

pub(super) fn service(hz: f64) -> Finding {
    let found = format!("{hz:.0} messages/s");
    let verdict = if hz < GOOD_SERVICE_HZ {
        Verdict::Advice(
            "it flies; better with the CLI line `set serial_update_rate_hz = 1000`, then `save` (Betaflight 4.x)".to_owned(),
        )
    } else {
        Verdict::Fine
    };
    Finding::new("serial task", found, verdict)
}

impl Write {
    fn message(text: String, command: u16, message: &impl Message) -> Self {
        let mut payload = Vec::new();
        message.emit(&mut payload);
        Self {
            text,
            command,
            payload,
        }
    }
}
