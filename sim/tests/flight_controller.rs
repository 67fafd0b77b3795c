//! The fake flight controller's manners, seen from the end of its wire.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "a test may panic, and figures here are exact by construction"
)]

mod pilot;

use msp::command;
use msp::message::multiple::Replies;
use msp::message::{
    Attitude, BoxIds, FcVariant, Message, ModeRange, Motor, Rc, SetModeRange, SetMotor, StatusEx,
};
use pilot::{IDLE, Pilot, office};
use vehicle::In;

const BOOT_GRACE: u32 = 1 << 9;
const RX_FAILSAFE: u32 = 1 << 2;
const THROTTLE: u32 = 1 << 7;
const MSP: u32 = 1 << 16;
const ARM_SWITCH: u32 = 1 << 28;

fn pilot() -> Pilot {
    Pilot::new(office("tof32", 11))
}

#[test]
fn arms_hovers_at_its_place_and_lands_by_msp_bytes_alone() {
    let mut p = pilot();
    p.take_off(1.2);
    let place = In::new(0.0, 0.0, -1.2);
    let mut throttles = Vec::new();
    p.fly(10_000, |p| {
        p.steer_to(place, 0.0);
        throttles.push(f64::from(p.sticks_us[2]));
    });
    let truth = p.sim.truth(0);
    assert!(
        (truth.position - place).norm() < 0.2,
        "{:?}",
        truth.position
    );
    // Thrust is the square of motor speed: sqrt(0.6 x 9.81 / 18) = 57 % of the motor range, and 1570 us by the throttle stick.
    let motor: Motor = p.ask();
    let mean_us = f64::from(motor.motors_us[..4].iter().sum::<u16>()) / 4.0;
    let stick_us = throttles.iter().sum::<f64>() / throttles.len() as f64;
    println!("hover: motors at {mean_us:.0} us, throttle stick at {stick_us:.0} us");
    assert!((1550.0..1600.0).contains(&mean_us) && (1550.0..1590.0).contains(&stick_us));
    // Down slowly, then the switch.
    let down = In::new(0.0, 0.0, 0.3);
    p.fly(6000, |p| p.steer_to(down, 0.0));
    p.sticks_us = IDLE;
    p.fly(500, |_| {});
    let truth = p.sim.truth(0);
    assert!(truth.on_floor && !truth.armed);
    assert_eq!(truth.contacts, 0, "a soft landing is no contact");
}

#[test]
fn arming_is_refused_during_boot_grace_and_the_switch_latches() {
    let mut p = pilot();
    p.fly(1000, |_| {});
    assert_eq!(p.blockers(), BOOT_GRACE);
    p.set_arm_switch(true);
    p.fly(5000, |_| {});
    assert_eq!(
        p.blockers(),
        ARM_SWITCH,
        "grace is over, the switch is not forgiven"
    );
    assert!(!p.sim.truth(0).armed);
    p.set_arm_switch(false);
    p.fly(200, |_| {});
    assert_eq!(p.blockers(), 0);
    p.set_arm_switch(true);
    p.fly(100, |_| {});
    assert!(p.sim.truth(0).armed, "armed within 100 ms");
    let status: StatusEx = p.ask();
    let boxes: BoxIds = p.ask();
    assert!(status.mode_flag(boxes.index_of(0).unwrap()));
}

#[test]
fn throttle_up_and_configurators_block_arming() {
    let mut p = pilot();
    p.fly(5500, |_| {});
    p.sticks_us[2] = 1100;
    p.fly(100, |_| {});
    assert_eq!(p.blockers(), THROTTLE);
    p.sticks_us = IDLE;
    assert!(p.ask_raw(command::SET_ARMING_DISABLED, &[1, 0]).is_some());
    p.fly(100, |_| {});
    assert_eq!(p.blockers(), MSP);
    assert!(p.ask_raw(command::SET_ARMING_DISABLED, &[0, 0]).is_some());
    p.fly(100, |_| {});
    assert_eq!(p.blockers(), 0);
}

#[test]
fn without_rc_it_flags_then_falls_then_disarms_and_wants_the_switch_low() {
    let mut p = pilot();
    p.take_off(1.5);
    let heading = p.sim.truth(0).attitude.yaw();
    let hover = p.sim.truth(0).position;
    p.fly(2000, |p| p.steer_to(hover, heading));
    p.sends_rc = false;
    // The last frame was up to 20 ms ago and 17 bytes take 1.5 ms on the wire.
    p.fly(130, |_| {});
    assert!(p.sim.truth(0).velocity.z().abs() < 0.3, "still hovers");
    p.fly(60, |_| {});
    assert_eq!(p.blockers() & RX_FAILSAFE, RX_FAILSAFE);
    p.fly(300, |_| {});
    assert!(
        p.sim.truth(0).armed && p.sim.truth(0).velocity.z() > 1.0,
        "it falls"
    );
    p.fly(1200, |_| {});
    let truth = p.sim.truth(0);
    assert!(!truth.armed && truth.on_floor);
    assert!(truth.contacts >= 1, "a fall from 1.5 m is a contact");
    p.sends_rc = true;
    p.sticks_us[2] = 1000;
    p.fly(1500, |_| {});
    assert_ne!(p.blockers() & ARM_SWITCH, 0);
    assert!(!p.sim.truth(0).armed);
    p.set_arm_switch(false);
    p.fly(200, |_| {});
    p.set_arm_switch(true);
    p.fly(200, |_| {});
    assert!(p.sim.truth(0).armed);
}

#[test]
fn one_command_per_run_of_the_serial_task_whatever_is_pipelined() {
    let mut p = pilot();
    p.sends_rc = false;
    for _ in 0..30 {
        p.send(command::ATTITUDE, &[]);
    }
    p.fly(200, |_| {});
    let n = p.replies.len();
    assert!((18..=20).contains(&n), "{n} answers in 200 ms");
}

#[test]
fn a_batch_costs_one_run_and_ends_at_a_question_it_does_not_know() {
    let mut p = pilot();
    p.sends_rc = false;
    let asked = [108, 102, 109];
    let payload = p.ask_raw(command::MULTIPLE_MSP, &asked).unwrap();
    let mut replies = Replies::new(&asked, &payload);
    let sizes: Vec<_> = replies
        .by_ref()
        .map(|(id, payload)| (id, payload.len()))
        .collect();
    assert_eq!(sizes, [(108, 6), (102, 18), (109, 6)]);
    let cut = p.ask_raw(command::MULTIPLE_MSP, &[108, 199, 109]).unwrap();
    assert_eq!(cut.len(), 7);
    assert!(p.ask_raw(command::MULTIPLE_MSP, &[]).is_none());
}

#[test]
fn what_it_does_not_know_is_refused() {
    let mut p = pilot();
    assert!(p.ask_raw(199, &[]).is_none());
    assert!(
        p.ask_raw(command::SET_RAW_RC, &[0; 38]).is_none(),
        "19 channels"
    );
    assert!(
        p.ask_raw(command::SET_RAW_RC, &[0; 36]).is_some(),
        "18 channels"
    );
    let mut unknown_box = Vec::new();
    let order = SetModeRange {
        slot: 2,
        range: ModeRange::from_us(99, 2, 1700, 2100),
        ..SetModeRange::default()
    };
    order.emit(&mut unknown_box);
    assert!(p.ask_raw(command::SET_MODE_RANGE, &unknown_box).is_none());
}

#[test]
fn every_question_of_the_protocol_facts_is_answered() {
    let mut p = pilot();
    let variant: FcVariant = p.ask();
    assert_eq!(&variant.variant, b"BTFL");
    for id in [
        1, 2, 3, 4, 5, 10, 34, 36, 42, 44, 64, 75, 101, 102, 104, 105, 108, 109, 110, 116, 119,
        130, 131, 150, 160,
    ] {
        let payload = p.ask_raw(id, &[]);
        let payload = payload.unwrap_or_else(|| panic!("command {id} refused"));
        assert!(!payload.is_empty(), "command {id}");
        msp::Reply::parse(id, &payload).unwrap_or_else(|e| panic!("command {id}: {e}"));
    }
}

#[test]
fn rc_is_reported_in_roll_pitch_yaw_throttle_order() {
    let mut p = pilot();
    p.sticks_us = [1501, 1502, 1003, 1504, 1005, 1006];
    p.fly(100, |_| {});
    let rc: Rc = p.ask();
    assert_eq!(rc.channels_us[..6], [1501, 1502, 1504, 1003, 1005, 1006]);
    assert_eq!(rc.channels_us.len(), 18);
}

#[test]
fn a_motor_test_persists_until_told_otherwise_and_is_ignored_when_armed() {
    let mut p = pilot();
    p.sends_rc = false;
    let set = |motors_us: [u16; 8]| {
        let mut payload = Vec::new();
        SetMotor { motors_us }.emit(&mut payload);
        payload
    };
    let slow = [1100, 1110, 1120, 1130, 0, 0, 0, 0];
    p.ask_raw(command::SET_MOTOR, &set(slow)).unwrap();
    p.fly(3000, |_| {});
    assert_eq!(p.ask::<Motor>().motors_us, slow);
    p.ask_raw(command::SET_MOTOR, &set([1000; 8])).unwrap();
    p.sends_rc = true;
    p.arm();
    p.ask_raw(command::SET_MOTOR, &set([1500; 8])).unwrap();
    p.fly(300, |_| {});
    assert_eq!(p.ask::<Motor>().motors_us[..4], [1055; 4], "armed idle");
    assert!(p.sim.truth(0).on_floor);
}

#[test]
fn a_reboot_is_silent_and_brings_back_the_boot_grace() {
    let mut p = pilot();
    p.fly(6000, |_| {});
    assert_eq!(p.blockers(), 0);
    assert_eq!(p.ask_raw(command::REBOOT, &[]), Some(vec![0]));
    p.replies.clear();
    p.fly(1400, |_| {});
    assert!(p.replies.is_empty());
    p.fly(1000, |_| {});
    assert_eq!(p.blockers() & BOOT_GRACE, BOOT_GRACE);
}

#[test]
fn heading_has_its_own_north_and_drifts_slowly() {
    let heading_off = |seed| {
        let mut p = Pilot::new(office("tof32", seed));
        p.fly(100, |_| {});
        let first: Attitude = p.ask();
        p.fly(60_000, |_| {});
        let last: Attitude = p.ask();
        (first.yaw_deg, last.yaw_deg - first.yaw_deg)
    };
    let (a, drift) = heading_off(1);
    let (b, _) = heading_off(2);
    assert_ne!(a, b);
    assert!(drift.abs() <= 2, "{drift} degrees in a minute");
}
