//! What differs between the firmwares, seen from the end of the wire: settings that need saving and a restart, the pilot's
//! radio beside MSP, loss of RC frames, the text command line.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    clippy::print_stdout,
    reason = "a test may panic, prints its figures, and figures here are exact by construction"
)]

mod pilot;

use msp::command;
use msp::message::{
    Attitude, FailsafeConfig, FeatureConfig, InavStatus, Message, ModeRange, ModeRanges, RawImu,
    Rc, RxConfig, RxMap, SetModeRange, Status,
};
use pilot::{IDLE, Pilot, office};
use sim::{Delivery, Manner, Radio, SimOutput};
use vehicle::Timestamp;

/// Manners with a receiver that can be chosen.
const CHOOSE_RECEIVER: [Manner; 5] = [
    Manner::BetaflightOld,
    Manner::Betaflight46,
    Manner::BetaflightNew,
    Manner::Inav,
    Manner::Cleanflight,
];

fn pilot(manner: Manner, delivery: Delivery) -> Pilot {
    let mut config = office("tof32", 3);
    config.vehicles[0].fc.manner = manner;
    config.vehicles[0].fc.delivery = delivery;
    let mut p = Pilot::new(config);
    if manner == Manner::MultiWii {
        // Roll, pitch, yaw, throttle.
        p.sticks_us = [1500, 1500, 1500, 1000, 1000, 1500];
    }
    p
}

fn payload(message: &impl Message) -> Vec<u8> {
    let mut out = Vec::new();
    message.emit(&mut out);
    out
}

fn set(p: &mut Pilot, id: u16, message: &impl Message) {
    let done = p.ask_raw(id, &payload(message));
    assert!(done.is_some(), "command {id} refused");
}

/// Raises the arm switch; whether it armed.
fn arms(p: &mut Pilot) -> bool {
    p.set_arm_switch(false);
    p.fly(6000, |_| {});
    p.set_arm_switch(true);
    p.fly(300, |_| {});
    let armed = p.sim.truth(0).armed;
    p.set_arm_switch(false);
    p.fly(300, |_| {});
    armed
}

/// What a provisioning tool does, without saving.
fn provision(p: &mut Pilot, manner: Manner) {
    let slots = [(0, 0, 0, 1700, 2100), (1, 1, 1, 900, 2100)];
    for (slot, id, aux, from, to) in slots {
        let order = SetModeRange {
            slot,
            range: ModeRange::from_us(id, aux, from, to),
            ..SetModeRange::default()
        };
        set(p, command::SET_MODE_RANGE, &order);
    }
    if manner == Manner::Inav {
        let mut rx: RxConfig = p.ask();
        assert_eq!(rx.receiver_type(), Some(1), "serial as delivered");
        rx.set_receiver_type(2);
        set(p, command::SET_RX_CONFIG, &rx);
    } else {
        let mut features: FeatureConfig = p.ask();
        assert!(!features.has(FeatureConfig::RX_MSP));
        features.features |= FeatureConfig::RX_MSP;
        set(p, command::SET_FEATURE_CONFIG, &features);
    }
}

#[test]
fn from_the_factory_it_flies_by_msp_only_once_provisioned_saved_and_restarted() {
    for manner in CHOOSE_RECEIVER {
        let mut p = pilot(manner, Delivery::Factory);
        assert!(!arms(&mut p), "{manner}: as delivered");
        provision(&mut p, manner);
        assert!(!arms(&mut p), "{manner}: not restarted yet");
        p.ask_raw(command::REBOOT, &[]).unwrap();
        p.fly(2000, |_| {});
        let ranges: ModeRanges = p.ask();
        assert!(!ranges.slots[0].is_used(), "{manner}: not saved, so gone");
        provision(&mut p, manner);
        assert!(p.ask_raw(command::EEPROM_WRITE, &[]).is_some());
        p.fly(500, |_| {});
        p.ask_raw(command::REBOOT, &[]).unwrap();
        p.fly(2000, |_| {});
        assert!(arms(&mut p), "{manner}: provisioned");
    }
}

#[test]
fn betaflight_asks_for_a_restart_when_the_receiver_was_changed() {
    let mut p = pilot(Manner::Betaflight46, Delivery::Factory);
    p.fly(6000, |_| {});
    let told = |p: &mut Pilot| {
        let status: Status = p.ask();
        let tail = status.tail.unwrap();
        (tail.arming_disable & 1 << 21, tail.config_state.unwrap())
    };
    assert_eq!(told(&mut p), (0, 0));
    provision(&mut p, Manner::Betaflight46);
    p.fly(100, |_| {});
    assert_eq!(told(&mut p), (1 << 21, 1));
}

#[test]
fn every_setting_that_is_written_is_read_back_the_same() {
    for manner in CHOOSE_RECEIVER {
        let mut p = pilot(manner, Delivery::ReadyToFly);
        let mut rx: RxConfig = p.ask();
        rx.min_check_us = 1080;
        set(&mut p, command::SET_RX_CONFIG, &rx);
        assert_eq!(p.ask::<RxConfig>(), rx, "{manner}");
        let mut failsafe: FailsafeConfig = p.ask();
        failsafe.delay_ds = 20;
        set(&mut p, command::SET_FAILSAFE_CONFIG, &failsafe);
        assert_eq!(p.ask::<FailsafeConfig>(), failsafe, "{manner}");
        let mut map: RxMap = p.ask();
        map.map[..4].copy_from_slice(&[1, 2, 3, 0]);
        set(&mut p, command::SET_RX_MAP, &map);
        assert_eq!(p.ask::<RxMap>(), map, "{manner}");
        // TAER: throttle first.
        p.sticks_us = [1001, 1502, 1503, 1504, 1000, 1500];
        p.fly(100, |_| {});
        let rc: Rc = p.ask();
        assert_eq!(rc.channels_us[..4], [1502, 1503, 1504, 1001], "{manner}");
        map.map[..4].copy_from_slice(&[1, 1, 3, 0]);
        assert!(
            p.ask_raw(command::SET_RX_MAP, &payload(&map)).is_none(),
            "{manner}: no permutation"
        );
    }
}

#[test]
fn saving_is_refused_while_armed() {
    for manner in Manner::ALL {
        let mut p = pilot(manner, Delivery::ReadyToFly);
        p.fly(6000, |_| {});
        p.set_arm_switch(true);
        p.fly(300, |_| {});
        assert!(p.sim.truth(0).armed, "{manner}");
        assert!(p.ask_raw(command::EEPROM_WRITE, &[]).is_none(), "{manner}");
    }
}

#[test]
fn units_and_axes_are_those_of_each_firmware() {
    for (manner, counts_per_g) in [
        (Manner::BetaflightNew, 2048.0),
        (Manner::Inav, 512.0),
        (Manner::Cleanflight, 512.0),
        (Manner::MultiWii, 512.0),
    ] {
        let mut p = pilot(manner, Delivery::ReadyToFly);
        p.fly(500, |_| {});
        let mean = (0..50)
            .map(|_| f64::from(p.ask::<RawImu>().acc[2]))
            .sum::<f64>()
            / 50.0;
        assert!((mean / counts_per_g - 1.0).abs() < 0.03, "{manner}: {mean}");
    }
    // The heading of MultiWii is signed.
    let headings: Vec<i16> = (0..30)
        .map(|seed| {
            let mut config = office("tof32", seed);
            config.vehicles[0].fc.manner = Manner::MultiWii;
            Pilot::new(config).ask::<Attitude>().yaw_deg
        })
        .collect();
    assert!(headings.iter().all(|h| (-180..=180).contains(h)) && headings.iter().any(|h| *h < 0));
}

#[test]
fn inav_tells_its_blockers_in_its_own_status_and_betaflight_has_none_of_it() {
    let mut p = pilot(Manner::Inav, Delivery::ReadyToFly);
    p.fly(1000, |_| {});
    let calibrating: InavStatus = p.ask();
    assert_eq!(calibrating.arming_flags, 1 << 9);
    p.fly(3000, |_| {});
    p.sticks_us[2] = 1200;
    p.fly(100, |_| {});
    assert_eq!(p.ask::<InavStatus>().arming_flags, 1 << 19);
    p.sticks_us = IDLE;
    p.set_arm_switch(true);
    p.fly(200, |_| {});
    assert_eq!(p.ask::<InavStatus>().arming_flags, 1 << 2 | 1 << 3);
    let mut p = pilot(Manner::BetaflightNew, Delivery::ReadyToFly);
    assert!(
        p.ask_raw(command::MULTIPLE_MSP, &[108, 199]).is_none(),
        "refused whole"
    );
    assert!(p.ask_raw(command::ATTITUDE_QUATERNION, &[]).is_some());
    assert!(p.ask_raw(command::IDENT, &[]).is_none());
}

/// Milliseconds from the last RC frame until the motors stop, armed on the floor.
fn disarmed_after_ms(manner: Manner) -> u64 {
    let mut p = pilot(manner, Delivery::ReadyToFly);
    if manner != Manner::MultiWii {
        let mut failsafe: FailsafeConfig = p.ask();
        failsafe.procedure = 1;
        set(&mut p, command::SET_FAILSAFE_CONFIG, &failsafe);
    }
    p.fly(6000, |_| {});
    p.set_arm_switch(true);
    p.fly(300, |_| {});
    assert!(p.sim.truth(0).armed, "{manner}");
    p.sends_rc = false;
    let from = p.sim.now();
    while p.sim.truth(0).armed {
        p.step();
        assert!(
            p.sim.now().since(from).as_secs() < 10,
            "{manner} stays armed"
        );
    }
    p.sim.now().since(from).as_millis() as u64
}

#[test]
fn each_firmware_drops_after_its_own_time_without_rc() {
    println!("FIGURES RC frames stop, procedure DROP: motors stop after");
    for (manner, table_ms) in [
        (Manner::BetaflightOld, 1500),
        (Manner::Betaflight46, 1500),
        (Manner::BetaflightNew, 1500),
        (Manner::Inav, 800),
        (Manner::Cleanflight, 1000),
        (Manner::MultiWii, 1000),
    ] {
        let ms = disarmed_after_ms(manner);
        println!(" {:11}  {ms:5} ms  table {table_ms:5} ms", manner.name());
        // The last frame was handled up to one period of 20 ms before, or 10 ms later by the serial task.
        assert!(ms.abs_diff(table_ms) <= 25, "{manner}: {ms} ms");
    }
    println!("END");
}

/// What a bridge that is held up for a second costs: 0.3 s of hold as delivered, and with `rxfail` HOLD until stage 2.
#[test]
fn betaflight_holds_the_throttle_until_stage_two_once_told_so() {
    for (hold, throttle) in [(false, 885), (true, 1400)] {
        let mut p = pilot(Manner::Betaflight46, Delivery::ReadyToFly);
        if hold {
            // Channel 3 is the throttle, mode 1 holds.
            assert!(p.ask_raw(78, &[3, 1, 0xdc, 5]).is_some());
        }
        let told = p.ask_raw(77, &[]).unwrap();
        assert_eq!((told.len(), told[9]), (54, u8::from(hold)));
        p.arm();
        p.sticks_us[2] = 1400;
        p.fly(200, |_| {});
        p.sends_rc = false;
        p.fly(1000, |_| {});
        assert!(p.sim.truth(0).armed);
        assert_eq!(p.sim.used_sticks_us(0)[3], throttle);
        p.fly(600, |_| {});
        assert!(!p.sim.truth(0).armed, "stage 2 comes all the same");
    }
    let mut p = pilot(Manner::Betaflight46, Delivery::ReadyToFly);
    assert!(p.ask_raw(78, &[3, 3, 0, 0]).is_none(), "no such mode");
    assert!(p.ask_raw(78, &[18, 1, 0, 0]).is_none(), "no such channel");
}

/// Roll, throttle and Aux1 as the controller uses them.
fn used(p: &mut Pilot) -> [u16; 3] {
    let rc: Rc = p.ask();
    [rc.channels_us[0], rc.channels_us[3], rc.channels_us[4]]
}

#[test]
fn beside_a_radio_msp_has_the_sticks_only_while_the_pilot_lets_it() {
    for manner in [Manner::Betaflight46, Manner::BetaflightNew, Manner::Inav] {
        let mut p = pilot(manner, Delivery::BesideRadio);
        let mut radio = Radio::default();
        p.sim.set_radio(0, Some(radio));
        p.sticks_us = [1600, 1500, 1700, 1500, 2000, 1500];
        p.fly(6000, |_| {});
        assert_eq!(used(&mut p), [1500, 1000, 1000], "{manner}: the pilot's");
        radio.aux_us[0] = 2000;
        p.sim.set_radio(0, Some(radio));
        p.fly(300, |_| {});
        assert!(p.sim.truth(0).armed, "{manner}: armed by the pilot");
        radio.aux_us[3] = 2000;
        p.sim.set_radio(0, Some(radio));
        p.fly(100, |_| {});
        assert_eq!(used(&mut p), [1600, 1700, 2000], "{manner}: handed over");
        assert_eq!(
            p.sim.used_sticks_us(0),
            [1600, 1500, 1500, 1700],
            "{manner}"
        );
        radio.aux_us[3] = 1000;
        radio.sticks_us[0] = 1450;
        p.sim.set_radio(0, Some(radio));
        // A frame of the radio every 20 ms.
        p.fly(21, |_| {});
        assert_eq!(used(&mut p), [1450, 1000, 2000], "{manner}: taken back");
        radio.aux_us[3] = 2000;
        p.sim.set_radio(0, Some(radio));
        p.fly(100, |_| {});
        p.sends_rc = false;
        p.fly(1000, |_| {});
        let kept = manner == Manner::Betaflight46;
        let roll = if kept { 1600 } else { 1450 };
        assert_eq!(used(&mut p)[0], roll, "{manner}: MSP silent for a second");
        // The transmitter goes out of reach.
        p.sim.set_radio(0, None);
        p.fly(1700, |_| {});
        let landing = manner == Manner::Inav;
        assert_eq!(p.sim.truth(0).armed, landing, "{manner}: failsafe");
    }
}

#[test]
fn multiwii_is_overridden_for_a_second_and_then_the_radio_is_back() {
    let mut p = pilot(Manner::MultiWii, Delivery::BesideRadio);
    p.sim.set_radio(0, Some(Radio::default()));
    p.sticks_us = [1600, 1500, 1500, 1300, 1000, 1500];
    p.fly(500, |_| {});
    assert_eq!(used(&mut p), [1600, 1300, 1000]);
    p.sends_rc = false;
    p.fly(950, |_| {});
    assert_eq!(used(&mut p)[0], 1600);
    p.fly(100, |_| {});
    assert_eq!(used(&mut p), [1500, 1000, 1000]);
}

#[test]
fn the_switches_of_multiwii_are_words_of_three_bits_a_channel() {
    let mut p = pilot(Manner::MultiWii, Delivery::ReadyToFly);
    let words = p.ask_raw(113, &[]).unwrap();
    let word = |words: &[u8], i: usize| u16::from_le_bytes([words[2 * i], words[2 * i + 1]]);
    assert_eq!(words.len(), 14, "seven boxes");
    // ARM with Aux1 high; ANGLE with Aux2 anywhere.
    assert_eq!((word(&words, 0), word(&words, 1)), (0b100, 0b111_000));
    let mut changed = words;
    changed[0] = 0b010;
    assert!(p.ask_raw(203, &changed).is_some());
    assert_eq!(p.ask_raw(113, &[]), Some(changed));
    assert!(p.ask_raw(203, &[0; 3]).is_none());
    assert!(
        p.ask_raw(command::API_VERSION, &[]).is_none(),
        "it has none"
    );
    assert_eq!(p.ask_raw(command::IDENT, &[]).unwrap()[0], 240);
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(60))]
    #[test]
    fn no_settings_and_no_noise_bring_it_down(
        manner in 0..6usize,
        orders in proptest::collection::vec((proptest::prelude::any::<u8>(), proptest::collection::vec(proptest::prelude::any::<u8>(), 0..40)), 0..12),
        noise in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..60),
    ) {
        let mut p = pilot(Manner::ALL[manner], Delivery::ReadyToFly);
        p.fly(5500, |_| {});
        p.sim.write_fc(0, &noise);
        const SETS: [u16; 12] = [11, 35, 37, 45, 65, 76, 78, 99, 200, 203, 214, 250];
        for (which, payload) in orders {
            p.send(SETS[usize::from(which) % SETS.len()], &payload);
            p.fly(20, |_| {});
        }
        p.set_arm_switch(true);
        p.sticks_us[2] = 1300;
        p.fly(1500, |_| {});
        let truth = p.sim.truth(0);
        proptest::prop_assert!(truth.position.is_finite() && truth.velocity.is_finite());
    }
}

fn type_line(p: &mut Pilot, line: &str) -> String {
    p.outputs.clear();
    p.sim.write_fc(0, line.as_bytes());
    let end = p.sim.now() + std::time::Duration::from_millis(300);
    while p.sim.now() < end {
        p.step();
    }
    let bytes: Vec<u8> = p
        .outputs
        .iter()
        .filter_map(|o| match o {
            SimOutput::FcBytes { bytes, .. } => Some(bytes.as_slice()),
            _ => None,
        })
        .flatten()
        .copied()
        .collect();
    String::from_utf8(bytes).unwrap()
}

#[test]
fn a_stray_hash_opens_the_command_line_and_msp_is_deaf_until_it_is_left() {
    let mut p = pilot(Manner::Betaflight46, Delivery::ReadyToFly);
    p.sends_rc = false;
    let hello = type_line(&mut p, "#");
    assert!(hello.contains("Entering CLI Mode"), "{hello}");
    p.replies.clear();
    p.send(command::ATTITUDE, &[]);
    p.fly(300, |_| {});
    assert!(p.replies.is_empty(), "MSP is deaf");
    let said = type_line(&mut p, "\rget serial\r");
    assert!(said.contains("serial_update_rate_hz = 100"), "{said}");
    let said = type_line(&mut p, "set serial_update_rate_hz = 500\r");
    assert!(said.contains("set to 500"), "{said}");
    let said = type_line(
        &mut p,
        "set serial_update_rate_hz = 99\rset nothing = 1\rfly\r",
    );
    assert_eq!(said.matches("###ERROR").count(), 3, "{said}");
    let said = type_line(&mut p, "save\r");
    assert!(said.contains("Saving"), "{said}");
    p.fly(2000, |_| {});
    // Twenty questions at once: at 500 a second they need 40 ms, at 100 two hundred.
    p.replies.clear();
    for _ in 0..20 {
        p.send(command::ATTITUDE, &[]);
    }
    p.fly(100, |_| {});
    assert_eq!(p.replies.len(), 20);
}

#[test]
fn leaving_the_command_line_without_saving_changes_nothing_and_armed_it_does_not_open() {
    let mut p = pilot(Manner::Inav, Delivery::ReadyToFly);
    let said = type_line(&mut p, "#set receiver_type = SERIAL\rexit\r");
    assert!(said.contains("receiver_type set to SERIAL"), "{said}");
    p.fly(2000, |_| {});
    assert_eq!(p.ask::<RxConfig>().receiver_type(), Some(2));
    p.arm();
    p.sim.write_fc(0, b"#");
    p.fly(200, |_| {});
    assert!(p.ask_raw(command::ATTITUDE, &[]).is_some());
    assert!(p.sim.now() > Timestamp::ZERO);
}
