use super::findings::writes;
use super::survey::{RXFAIL_CONFIG, SET_RXFAIL_CONFIG};
use super::test_controller::TestController;
use super::*;
use crate::fc::conversation::AskError;
use msp::command;
use msp::firmware::box_id;
use msp::message::{ModeRange, SetModeRange};

fn survey(controller: &mut TestController) -> Survey {
    Survey::take(controller).unwrap()
}

fn missing(survey: &Survey) -> Vec<u16> {
    writes(&findings(survey, None))
        .iter()
        .map(|w| w.command)
        .collect()
}

fn provision(controller: &mut TestController) -> Result<Survey, ApplyError> {
    let before = survey(controller);
    let orders = writes(&findings(&before, None));
    apply(controller, &orders, &missing, &mut |_| {})
}

fn put(controller: &mut TestController, slot: u8, range: ModeRange) {
    let mut order = Vec::new();
    msp::Message::emit(
        &SetModeRange {
            slot,
            range,
            logic: None,
            linked_to: None,
        },
        &mut order,
    );
    let _ = crate::fc::conversation::Controller::ask(controller, command::SET_MODE_RANGE, &order);
    controller.saved = controller.now.clone();
    controller.heard.clear();
}

#[test]
fn a_fresh_controller_needs_receiver_arm_switch_angle_mode_and_a_held_throttle() {
    let mut controller = TestController::betaflight();
    let orders = missing(&survey(&mut controller));
    assert_eq!(
        orders,
        [
            command::SET_FEATURE_CONFIG,
            command::SET_MODE_RANGE,
            command::SET_MODE_RANGE,
            SET_RXFAIL_CONFIG
        ]
    );
}

#[test]
fn once_provisioned_there_is_nothing_left_to_do_and_it_is_saved() {
    let mut controller = TestController::betaflight();
    let after = provision(&mut controller).unwrap();
    assert!(missing(&after).is_empty());
    assert_eq!(controller.now, controller.saved);
    // Features that are none of our business stay: telemetry, airmode.
    assert_eq!(
        after.features().unwrap().features,
        1 << 10 | 1 << 14 | 1 << 22
    );
    assert_eq!(after.rx_fail(3), Some((1, 875)));
    assert_eq!(after.mode_ranges()[0], ModeRange::from_us(0, 0, 1700, 2100));
    assert_eq!(after.mode_ranges()[1], ModeRange::from_us(1, 1, 1700, 2100));
}

#[test]
fn nothing_but_receiver_switches_and_throttle_hold_is_ever_ordered() {
    let mut controller = TestController::betaflight();
    provision(&mut controller).unwrap();
    let orders: Vec<u16> = controller
        .heard
        .iter()
        .filter(|(_, payload)| !payload.is_empty())
        .map(|(c, _)| *c)
        .collect();
    for order in orders {
        assert!(
            [
                command::SET_FEATURE_CONFIG,
                command::SET_MODE_RANGE,
                SET_RXFAIL_CONFIG
            ]
            .contains(&order),
            "{order}"
        );
    }
}

#[test]
fn a_backup_brings_identical_settings_back() {
    let mut controller = TestController::betaflight();
    put(
        &mut controller,
        3,
        ModeRange::from_us(box_id::ALTITUDE_HOLD, 2, 900, 1300),
    );
    let before = survey(&mut controller);
    let file = Backup::of(&before).to_json();
    let after = provision(&mut controller).unwrap();
    assert_ne!(after.settings, before.settings);

    let backup = Backup::from_json(&file).unwrap();
    let orders = backup.writes(&after, false).unwrap();
    let wanted = backup.settings().unwrap();
    let restored = apply(
        &mut controller,
        &orders,
        &|s: &Survey| apply::differing(&wanted, &s.settings),
        &mut |_| {},
    )
    .unwrap();
    assert_eq!(restored.settings, before.settings);
    assert_eq!(backup.writes(&restored, false).unwrap(), []);
}

#[test]
fn an_armed_controller_is_written_nothing() {
    let mut controller = TestController::betaflight();
    let orders = writes(&findings(&survey(&mut controller), None));
    controller.is_armed = true;
    controller.heard.clear();
    let refused = apply(&mut controller, &orders, &missing, &mut |_| {});
    assert_eq!(refused, Err(ApplyError::Armed));
    assert!(
        controller
            .heard
            .iter()
            .all(|(_, payload)| payload.is_empty())
    );
    assert!(
        controller
            .heard
            .iter()
            .all(|(c, _)| *c != command::EEPROM_WRITE)
    );
}

#[test]
fn a_refused_order_ends_it_before_anything_is_saved() {
    let mut controller = TestController::betaflight();
    controller.refuses.push(command::SET_MODE_RANGE);
    let before = controller.saved.clone();
    let error = provision(&mut controller).unwrap_err();
    assert!(matches!(error, ApplyError::Refused { .. }), "{error}");
    assert_eq!(controller.saved, before);
}

#[test]
fn a_controller_that_acknowledges_and_does_not_obey_is_found_out_before_saving() {
    let mut controller = TestController::betaflight();
    controller.is_deaf = true;
    let error = provision(&mut controller).unwrap_err();
    assert!(
        matches!(
            &error,
            ApplyError::Differs {
                when: "writing",
                ..
            }
        ),
        "{error}"
    );
    assert!(
        controller
            .heard
            .iter()
            .all(|(c, _)| *c != command::EEPROM_WRITE)
    );
}

#[test]
fn an_arm_range_that_is_on_with_the_switch_low_is_cleared() {
    let mut controller = TestController::betaflight();
    put(
        &mut controller,
        5,
        ModeRange::from_us(box_id::ARM, 0, 900, 2100),
    );
    let after = provision(&mut controller).unwrap();
    assert!(!after.mode_ranges()[5].is_used());
    let arm = ModeRange::from_us(box_id::ARM, 0, 1700, 2100);
    assert!(after.mode_ranges().contains(&arm));
}

#[test]
fn a_switch_of_the_pilots_own_radio_stays() {
    let mut controller = TestController::betaflight();
    let beeper = ModeRange::from_us(box_id::BEEPER, 6, 1700, 2100);
    put(&mut controller, 0, beeper);
    let after = provision(&mut controller).unwrap();
    assert_eq!(after.mode_ranges()[0], beeper);
}

#[test]
fn full_slots_are_a_matter_for_the_hand() {
    let mut controller = TestController::betaflight();
    for slot in 0..20 {
        put(
            &mut controller,
            slot,
            ModeRange::from_us(box_id::BEEPER, 6, 1700, 2100),
        );
    }
    let table = findings(&survey(&mut controller), None);
    let arm = table.iter().find(|f| f.what == "arm switch").unwrap();
    assert!(matches!(arm.verdict, Verdict::ByHand(_)), "{arm:?}");
}

#[test]
fn files_of_another_firmware_another_board_or_nonsense_are_refused() {
    let mut controller = TestController::betaflight();
    let here = survey(&mut controller);
    let text = Backup::of(&here).to_json();
    let other = Backup::from_json(&text.replace("4.6.0", "4.5.1")).unwrap();
    assert!(matches!(
        other.writes(&here, false),
        Err(BackupError::OtherFirmware { .. })
    ));
    let board = Backup::from_json(&text.replace("010101", "020202")).unwrap();
    assert!(matches!(
        board.writes(&here, false),
        Err(BackupError::OtherBoard { .. })
    ));
    assert_eq!(board.writes(&here, true), Ok(vec![]));
    for wrong in [
        "",
        "{}",
        &text.replace("MSP_MODE", "MSP_NODE"),
        &text.replace("\"00", "\"0x"),
    ] {
        assert!(Backup::from_json(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn a_firmware_without_rx_fail_is_surveyed_all_the_same() {
    let mut controller = TestController::betaflight();
    controller.refuses.push(RXFAIL_CONFIG);
    let survey = survey(&mut controller);
    assert!(!survey.settings.contains_key(&RXFAIL_CONFIG));
    controller.refuses.push(command::BOXIDS);
    let error = Survey::take(&mut controller).unwrap_err();
    assert_eq!(error, AskError::Refused(command::BOXIDS));
}

#[test]
fn a_slow_serial_task_is_advice_and_a_stopped_scheduler_is_named() {
    let mut controller = TestController::betaflight();
    let mut survey = survey(&mut controller);
    survey.cycle_us = 0;
    let table = findings(&survey, Some(100.0));
    let row = |what: &str| table.iter().find(|f| f.what == what).unwrap();
    assert!(matches!(row("control loop").verdict, Verdict::ByHand(_)));
    assert!(
        matches!(&row("serial task").verdict, Verdict::Advice(how) if how.contains("serial_update_rate_hz"))
    );
}
