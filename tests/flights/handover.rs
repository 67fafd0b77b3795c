//! MSP override beside a live radio: a pilot who takes off by himself lends the sticks in the air and takes them back.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "a test program prints its figures and fails where it stands"
)]

use flight_tests::{Flight, Scenario, modes};
use sim::{Manner, Radio};
use vehicle::{In, Ned, angle};

/// Aux1 arms, Aux4 is the override switch.
const ARM: usize = 0;
const LEND: usize = 3;

/// Stick whose ACTUAL rate (70 at the centre, 670 at the end) is this, deg/s.
fn inverse_rate(dps: f64) -> u16 {
    let x = (-70.0 + (4900.0 + 2400.0 * dps.abs()).sqrt()) / 1200.0;
    (1500.0 + 500.0 * x.copysign(dps)).round() as u16
}

/// A pilot with perfect sight steers towards a place.
fn steer(f: &Flight, radio: &mut Radio, place: In<Ned>) {
    let truth = f.truth();
    let error = place - truth.position;
    let accel = ((error * 1.2).limited_xy(0.8) - truth.velocity) * 2.5;
    let (s, c) = truth.attitude.yaw().sin_cos();
    let forward = c * accel.x() + s * accel.y();
    let right = -s * accel.x() + c * accel.y();
    let tilt = |a: f64| (a / 9.81).atan().to_degrees().clamp(-20.0, 20.0) / 60.0 * 670.0;
    let turn = angle::shortest_turn(truth.attitude.yaw(), 0.0).to_degrees() * 1.5;
    let climb = (-error.z() * 1.5).clamp(-0.6, 0.8);
    let lift = 1.0 + 0.25 * (climb + truth.velocity.z());
    radio.sticks_us = [
        inverse_rate(tilt(right)),
        inverse_rate(tilt(forward)),
        inverse_rate(turn.clamp(-90.0, 90.0)),
        (1565.0 + 520.0 * (lift - 1.0)).clamp(1060.0, 1900.0) as u16,
    ];
}

/// The pilot flies for a time.
fn fly(f: &mut Flight, radio: &mut Radio, place: In<Ned>, seconds: f64) {
    let end = f.now().s() + seconds;
    while f.now().s() < end {
        steer(f, radio, place);
        f.world.simulator.set_radio(0, Some(*radio));
        f.step();
    }
}

fn lend_and_take_back(manner: Manner) {
    let mut f = Scenario::office()
        .seed(3)
        .manner(manner)
        .beside_radio()
        .start();
    let mut radio = Radio::default();
    f.world.simulator.set_radio(0, Some(radio));
    f.until("localized", 20.0, |f| f.snapshot().nav.health.position);
    f.wait_s(5.0);
    radio.aux_us[ARM] = 2000;
    f.world.simulator.set_radio(0, Some(radio));
    f.wait_s(1.0);
    f.assert(f.truth().armed, "the pilot could not arm");
    let place = f.truth().position.with_z(-1.0);
    fly(&mut f, &mut radio, place, 6.0);
    f.assert(
        (f.truth().position - place).norm() < 0.3,
        "the pilot hovers",
    );
    f.assert(
        f.snapshot().is_armed,
        "Kestrel does not know that it is armed",
    );

    // His switch alone changes nothing.
    radio.aux_us[LEND] = 2000;
    fly(&mut f, &mut radio, place, 0.3);
    let before = f.world.simulator.used_sticks_us(0);
    let result = f.set_mode(modes::HOLD);
    f.assert(result == 0, &format!("Hold was refused: {result}"));
    let mut last = before;
    let mut largest_step = 0;
    let until = f.now().s() + 10.0;
    let mut worst_m: f64 = 0.0;
    let at = f.truth().position;
    while f.now().s() < until {
        f.step();
        let used = f.world.simulator.used_sticks_us(0);
        let step = used.iter().zip(last).map(|(a, b)| a.abs_diff(b)).max();
        // The hand-over itself; later steps are those of flying in noise.
        if until - f.now().s() > 9.9 {
            largest_step = largest_step.max(step.unwrap());
        }
        last = used;
        worst_m = worst_m.max((f.truth().position - at).norm());
    }
    println!(
        "{manner}: largest stick step of the hand-over {largest_step} us, farthest from where it was lent {worst_m:.2} m, steering {:?}",
        f.snapshot().fc.steering
    );
    f.assert(worst_m < 0.3, "it does not hold its place");
    // 5 % of 1000 us.
    f.assert(largest_step <= 50, &format!("a step of {largest_step} us"));

    // He takes back in the middle of it, with his own sticks.
    radio.aux_us[LEND] = 1000;
    radio.sticks_us = [1531, 1507, 1503, 1566];
    f.world.simulator.set_radio(0, Some(radio));
    let mut strangers = 0;
    for _ in 0..100 {
        f.step();
        let used = f.world.simulator.used_sticks_us(0);
        strangers += u32::from(used != radio.sticks_us);
    }
    // A frame of his radio comes every 20 ms: four looks of 5 ms.
    f.assert(
        strangers <= 4,
        &format!("{strangers} looks at other sticks than his"),
    );
    let place = f.truth().position.with_z(-1.0);
    fly(&mut f, &mut radio, place, 4.0);
    f.wait_s(0.1);
    let texts = f.station.heard().texts.join("; ");
    f.assert(texts.contains("Pilot took over"), &texts);
    f.assert(f.truth().contacts == 0, "touched something");
}

#[test]
fn the_pilot_lends_the_sticks_of_betaflight_and_takes_them_back() {
    for manner in [Manner::Betaflight46, Manner::BetaflightNew] {
        lend_and_take_back(manner);
    }
}
