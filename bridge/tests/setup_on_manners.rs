//! `kestrel fc check`, `provision` and `restore` on the simulator's controller with the manners of every firmware, as it
//! leaves the shop, in virtual time.

#![allow(clippy::unwrap_used, reason = "a test program fails where it stands")]

use bridge::fc::conversation::{AskError, Controller, Conversation, Outcome};
use bridge::fc::setup::apply::differing;
use bridge::fc::setup::findings::writes;
use bridge::fc::setup::{
    ApplyError, Backup, Finding, Survey, Verdict, apply, findings, findings_beside_radio,
};
use core::time::Duration;
use msp::firmware::box_id;
use msp::message::SetRawRc;
use msp::{Direction, Framing, Message as _, command};
use sim::{Delivery, FcConfig, Manner, Room, SimConfig, SimOutput, Simulator, VehicleConfig};
use std::collections::BTreeMap;
use vehicle::{RingConfig, Timestamp};

/// What can be provisioned; MultiWii has settings of another kind.
const PROVISIONED: [Manner; 5] = [
    Manner::BetaflightOld,
    Manner::Betaflight46,
    Manner::BetaflightNew,
    Manner::Inav,
    Manner::Cleanflight,
];

/// A controller on the bench whose time passes only while somebody waits for it.
struct Bench {
    sim: Simulator,
    now: Timestamp,
    talk: Conversation,
    /// Aileron, elevator, throttle, rudder, Aux1 ..., sent every 20 ms beside the questions.
    rc_us: Option<[u16; 8]>,
}

impl Bench {
    fn new(manner: Manner, delivery: Delivery) -> Self {
        let ring = RingConfig::built_in("tof32").unwrap();
        let room = Room::named("office").unwrap();
        let vehicle = VehicleConfig {
            fc: FcConfig {
                manner,
                delivery,
                ..FcConfig::default()
            },
            ..VehicleConfig::new(room.home(), ring.clone())
        };
        let sim = Simulator::new(SimConfig {
            vehicles: vec![vehicle],
            ..SimConfig::new(room, ring, 1)
        });
        Self {
            sim: sim.unwrap(),
            now: Timestamp::ZERO,
            talk: Conversation::default(),
            rc_us: None,
        }
    }

    /// One millisecond; the bytes that came.
    fn step(&mut self) -> Vec<u8> {
        self.now += Duration::from_millis(1);
        if let Some(channels_us) = self.rc_us
            && (self.now.us() / 1000).is_multiple_of(20)
        {
            let mut payload = Vec::new();
            let channels_us = channels_us.into_iter().collect();
            SetRawRc { channels_us }.emit(&mut payload);
            let mut wire = Vec::new();
            let request = Direction::Request;
            msp::encode(
                Framing::V1,
                request,
                command::SET_RAW_RC,
                &payload,
                &mut wire,
            )
            .unwrap();
            self.sim.write_fc(0, &wire);
        }
        let mut heard = Vec::new();
        self.sim.advance(self.now, &mut |_, output| {
            if let SimOutput::FcBytes { bytes, .. } = output {
                heard.extend_from_slice(&bytes);
            }
        });
        heard
    }

    fn pass(&mut self, seconds: u32) {
        for _ in 0..1000 * seconds {
            self.step();
        }
    }

    /// Everything that a configurator reads and provisioning has nothing to do with.
    fn other_settings(&mut self) -> BTreeMap<u16, Result<Vec<u8>, AskError>> {
        [
            command::FAILSAFE_CONFIG,
            command::RX_MAP,
            command::NAME,
            command::MIXER_CONFIG,
        ]
        .map(|message| (message, self.ask(message, &[])))
        .into_iter()
        .collect()
    }
}

impl Controller for Bench {
    fn ask(&mut self, command: u16, payload: &[u8]) -> Outcome {
        self.talk.ask(self.now, command, payload)?;
        loop {
            while let Some(frame) = self.talk.poll_transmit() {
                self.sim.write_fc(0, frame);
            }
            let heard = self.step();
            if let Some(outcome) = self.talk.handle(&heard) {
                return outcome;
            }
            if let Some(outcome) = self.talk.tick(self.now) {
                return outcome;
            }
        }
    }

    fn come_back(&mut self) -> Result<(), AskError> {
        self.pass(2);
        self.talk = Conversation::default();
        self.ask(command::API_VERSION, &[]).map(drop)
    }
}

fn missing(survey: &Survey) -> Vec<u16> {
    let left = writes(&findings(survey, None));
    left.iter().map(|write| write.command).collect()
}

fn provision(bench: &mut Bench) -> Survey {
    let before = Survey::take(bench).unwrap();
    let orders = writes(&findings(&before, None));
    apply(bench, &orders, &missing, &mut |_| {}).unwrap()
}

fn row<'a>(table: &'a [Finding], what: &str) -> &'a Finding {
    let found = table.iter().find(|finding| finding.what == what);
    found.unwrap_or_else(|| panic!("no row `{what}` in {table:#?}"))
}

/// Level, throttle at the bottom, ANGLE on; the arm switch as wanted.
fn sticks(arm: bool) -> [u16; 8] {
    let aux1 = if arm { 2000 } else { 1000 };
    [1500, 1500, 1000, 1500, aux1, 2000, 1000, 1000]
}

#[test]
fn fresh_from_the_shop_receiver_and_switches_are_missing() {
    for manner in PROVISIONED {
        let mut bench = Bench::new(manner, Delivery::Factory);
        let survey = Survey::take(&mut bench).unwrap();
        let table = findings(&survey, None);
        for what in ["receiver", "arm switch", "angle mode"] {
            let verdict = &row(&table, what).verdict;
            assert!(
                matches!(verdict, Verdict::Provision(_)),
                "{manner}, {what}: {verdict:?}"
            );
        }
        for finding in &table {
            assert!(
                !matches!(finding.verdict, Verdict::ByHand(_)),
                "{manner}: {finding:?}"
            );
        }
    }
}

#[test]
fn provisioned_it_lacks_nothing_and_a_second_run_has_nothing_to_do() {
    for manner in PROVISIONED {
        let mut bench = Bench::new(manner, Delivery::Factory);
        let others = bench.other_settings();
        let after = provision(&mut bench);
        assert!(missing(&after).is_empty(), "{manner}");
        // Power off and on: it was kept.
        bench.ask(command::REBOOT, &[]).unwrap();
        bench.come_back().unwrap();
        let again = Survey::take(&mut bench).unwrap();
        assert!(missing(&again).is_empty(), "{manner}");
        assert_eq!(again.settings, after.settings, "{manner}");
        assert_eq!(
            bench.other_settings(),
            others,
            "{manner}: what is none of our business changed"
        );
    }
}

#[test]
fn restored_it_is_as_it_left_the_shop_byte_for_byte() {
    for manner in PROVISIONED {
        let mut bench = Bench::new(manner, Delivery::Factory);
        let before = Survey::take(&mut bench).unwrap();
        let file = Backup::of(&before).to_json();
        let after = provision(&mut bench);
        assert_ne!(after.settings, before.settings, "{manner}");

        let backup = Backup::from_json(&file).unwrap();
        let wanted = backup.settings().unwrap();
        let orders = backup.writes(&after, false).unwrap();
        let differs = |survey: &Survey| differing(&wanted, &survey.settings);
        let restored = apply(&mut bench, &orders, &differs, &mut |_| {}).unwrap();
        assert_eq!(restored.settings, before.settings, "{manner}");
        assert_eq!(backup.writes(&restored, false), Ok(vec![]), "{manner}");
    }
}

#[test]
fn provisioned_it_arms_by_msp_and_armed_it_is_written_nothing() {
    for manner in PROVISIONED {
        let mut bench = Bench::new(manner, Delivery::Factory);
        let before = Survey::take(&mut bench).unwrap();
        let backup = Backup::of(&before);
        provision(&mut bench);
        bench.rc_us = Some(sticks(false));
        bench.pass(8);
        bench.rc_us = Some(sticks(true));
        bench.pass(1);
        let armed = Survey::take(&mut bench).unwrap();
        assert!(
            armed.is_armed,
            "{manner} does not arm: {:?}",
            armed.blockers
        );

        let orders = backup.writes(&armed, false).unwrap();
        assert!(!orders.is_empty());
        let refused = apply(&mut bench, &orders, &missing, &mut |_| {});
        assert_eq!(refused.unwrap_err(), ApplyError::Armed, "{manner}");
        let still = Survey::take(&mut bench).unwrap();
        assert!(still.is_armed, "{manner} was disarmed");
        assert_eq!(still.settings, armed.settings, "{manner}");
        let saving = bench.ask(command::EEPROM_WRITE, &[]);
        assert_eq!(
            saving,
            Err(AskError::Refused(command::EEPROM_WRITE)),
            "{manner}"
        );
    }
}

#[test]
fn multiwii_is_recognised_and_left_to_its_own_configurator() {
    let mut bench = Bench::new(Manner::MultiWii, Delivery::Factory);
    let survey = Survey::take(&mut bench).unwrap();
    assert_eq!(survey.identity.firmware, msp::Firmware::MultiWii);
    let table = findings(&survey, None);
    assert!(matches!(
        row(&table, "firmware").verdict,
        Verdict::ByHand(_)
    ));
    assert_eq!(writes(&table), []);
}

fn missing_beside(survey: &Survey) -> Vec<u16> {
    let left = writes(&findings_beside_radio(survey, 3, None));
    left.iter().map(|write| write.command).collect()
}

#[test]
fn beside_a_radio_the_override_switch_is_set_where_the_firmware_has_it_and_levels() {
    for manner in PROVISIONED {
        let mut bench = Bench::new(manner, Delivery::Factory);
        let before = Survey::take(&mut bench).unwrap();
        let table = findings_beside_radio(&before, 3, None);
        assert_eq!(row(&table, "receiver").verdict, Verdict::Fine, "{manner}");
        // It has no arm switch yet: that is the pilot's affair.
        assert!(matches!(
            row(&table, "arm switch").verdict,
            Verdict::ByHand(_)
        ));
        let orders = writes(&table);
        if manner == Manner::Cleanflight {
            assert!(matches!(
                row(&table, "override").verdict,
                Verdict::ByHand(_)
            ));
            assert_eq!(orders, []);
            continue;
        }
        let after = apply(&mut bench, &orders, &missing_beside, &mut |_| {}).unwrap();
        let on_aux4 = |id| msp::message::ModeRange::from_us(id, 3, 1700, 2100);
        let ranges = after.mode_ranges();
        assert!(ranges.contains(&on_aux4(box_id::MSP_OVERRIDE)), "{manner}");
        assert!(ranges.contains(&on_aux4(box_id::ANGLE)), "{manner}");
        // Nothing else than two mode slots was touched: the pilot keeps their receiver.
        let used = ranges.iter().filter(|range| range.is_used()).count();
        assert_eq!(used, 2, "{manner}");
        for (message, payload) in &before.settings {
            if *message != command::MODE_RANGES {
                assert_eq!(after.settings.get(message), Some(payload), "{manner}");
            }
        }
        assert_eq!(missing_beside(&after), Vec::<u16>::new(), "{manner}");
    }
}

#[test]
fn a_switch_that_the_pilot_uses_already_is_not_taken() {
    let mut bench = Bench::new(Manner::Betaflight46, Delivery::Factory);
    let mut order = Vec::new();
    msp::message::SetModeRange {
        slot: 7,
        range: msp::message::ModeRange::from_us(box_id::BEEPER, 3, 1800, 2100),
        logic: None,
        linked_to: None,
    }
    .emit(&mut order);
    bench.ask(command::SET_MODE_RANGE, &order).unwrap();
    let survey = Survey::take(&mut bench).unwrap();
    let table = findings_beside_radio(&survey, 3, None);
    assert!(matches!(
        row(&table, "override switch").verdict,
        Verdict::ByHand(_)
    ));
    let table = findings_beside_radio(&survey, 4, None);
    assert!(matches!(
        row(&table, "override switch").verdict,
        Verdict::Provision(_)
    ));
}

#[test]
fn by_msp_alone_a_controller_set_for_a_radio_gets_the_msp_receiver() {
    for manner in PROVISIONED {
        let mut bench = Bench::new(manner, Delivery::BesideRadio);
        let after = provision(&mut bench);
        assert!(missing(&after).is_empty(), "{manner}");
        let table = findings_beside_radio(&after, 3, None);
        assert!(
            matches!(row(&table, "receiver").verdict, Verdict::ByHand(_)),
            "{manner}"
        );
    }
}
