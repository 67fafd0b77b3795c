//! What happens when something falls silent.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::mode::{Because, Mode};
use flight_tests::{Scenario, modes};
use sim::{Delivery, Fault};
use std::time::Duration;

#[test]
fn a_lost_ground_station_lands_the_vehicle() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.station.be_silent(true);
    f.until("landing", 6.0, |f| f.snapshot().mode.mode == Mode::Land);
    f.until_down(20.0);
    f.assert(f.truth().contacts == 0, "touched something");
}

#[test]
fn silent_rangers_land_the_vehicle() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    for ranger in 0..4 {
        f.world
            .simulator
            .set_fault(0, Fault::RangerSilent(ranger), true);
    }
    f.until("landing", 5.0, |f| f.snapshot().mode.mode == Mode::Land);
    f.until_down(20.0);
}

#[test]
fn take_off_without_rangers_is_refused() {
    let mut f = Scenario::office().start();
    for ranger in 0..4 {
        f.world
            .simulator
            .set_fault(0, Fault::RangerSilent(ranger), true);
    }
    f.wait_s(10.0);
    let result = f.command(400, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    f.assert(result == 1, &format!("got {result}"));
    f.wait_s(0.2);
    let texts = f.station.heard().texts.join("; ");
    f.assert(
        texts.contains("range finders"),
        &format!("no reason: {texts}"),
    );
}

#[test]
fn a_low_battery_brings_it_home() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.world.simulator.set_charge(0, 0.05);
    f.until("return", 20.0, |f| {
        matches!(f.snapshot().mode.mode, Mode::Return | Mode::Land)
    });
    f.until_down(60.0);
    f.assert(f.truth().position.norm_xy() < 0.4, "landed elsewhere");
}

#[test]
fn shutting_down_in_flight_lands_first() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.world.shut_down();
    f.until_down(20.0);
    f.assert(f.truth().contacts == 0, "touched something");
}

#[test]
fn a_controller_that_stops_answering_is_acted_on_within_a_quarter_of_a_second() {
    for seed in 1..=5 {
        let mut f = Scenario::office().seed(seed).start();
        f.take_off(1.0);
        f.world.simulator.set_fault(0, Fault::FcSilent, true);
        let from = f.now();
        f.until("landing", 2.0, |f| f.snapshot().mode.mode == Mode::Land);
        let took = f.now().since(from).as_secs_f64();
        f.assert(took <= 0.25, &format!("acted after {took:.3} s"));
        f.assert(
            f.snapshot().mode.because == Because::FcSilent,
            &format!("{:?}", f.snapshot().mode),
        );
        let sticks = f.snapshot().sticks;
        f.assert(
            sticks.roll == 0.0 && sticks.pitch == 0.0 && sticks.throttle > 0.2,
            &format!("level and sinking, not {sticks:?}"),
        );
        f.wait_s(0.2);
        let texts = f.station.heard().texts.join("; ");
        f.assert(
            texts.contains("flight controller silent"),
            &format!("not told: {texts}"),
        );
        // Nobody will say when it is down: after the longest descent the arm switch is lowered.
        f.until("switch low", 10.0, |f| !f.snapshot().is_armed);
    }
}

#[test]
fn a_flight_loop_held_for_a_fifth_of_a_second_flies_on() {
    for seed in 1..=5 {
        let mut f = Scenario::office().seed(seed).start();
        f.take_off(1.0);
        f.wait_s(3.0);
        let missed = f.snapshot().flight_loop.missed;
        let (mode, place) = (f.snapshot().mode, f.truth().position);
        f.world.hold_flight(Duration::from_millis(200));
        f.wait_s(0.25);
        let counted = f.snapshot().flight_loop.missed - missed;
        f.assert((6..=8).contains(&counted), &format!("{counted} missed"));
        f.wait_s(5.0);
        let moved = (f.truth().position - place).norm();
        println!("seed {seed}: held 0.20 s: {moved:.3} m away after 5 s");
        f.assert(
            f.snapshot().mode == mode,
            &format!("{:?}", f.snapshot().mode),
        );
        f.assert(
            f.snapshot().is_armed && f.truth().contacts == 0 && moved < 0.25,
            &format!("{moved:.2} m away"),
        );
    }
}

#[test]
fn a_flight_loop_held_for_longer_than_the_receiver_waits_is_kept_level_and_lands() {
    for seed in 1..=5 {
        let mut f = Scenario::office().seed(seed).start();
        f.take_off(1.0);
        f.wait_s(3.0);
        f.world.hold_flight(Duration::from_millis(600));
        let mut lowest = 1.0f64;
        for _ in 0..140 {
            f.step();
            lowest = lowest.min(-f.truth().position.z());
        }
        println!(
            "seed {seed}: held 0.60 s: lowest {lowest:.2} m, {:?}",
            f.snapshot().mode
        );
        f.assert(
            f.snapshot().mode.because == Because::LoopHeld && f.snapshot().is_armed,
            &format!("{:?}", f.snapshot().mode),
        );
        f.assert(lowest > 0.5, &format!("sank to {lowest:.2} m"));
        f.until_down(20.0);
        f.assert(f.truth().contacts == 0, "touched something");
        let texts = f.station.heard().texts.join("; ");
        f.assert(texts.contains("flight loop held up"), &texts);
    }
}

#[test]
fn a_program_frozen_for_a_fifth_of_a_second_flies_on_and_for_longer_falls_as_the_page_says() {
    for (ms, falls) in [(200, false), (600, true)] {
        let mut f = Scenario::office().start();
        f.take_off(1.0);
        f.wait_s(3.0);
        f.world.freeze(Duration::from_millis(ms));
        let mut lowest = 1.0f64;
        for _ in 0..200 {
            f.step();
            lowest = lowest.min(-f.truth().position.z());
        }
        println!(
            "frozen {ms} ms: lowest {lowest:.2} m, {:?}",
            f.snapshot().mode
        );
        // Betaflight idles the motors 0.30 s after the last frame; nothing on this side can speak then.
        f.assert((lowest < 0.6) == falls, &format!("{lowest:.2} m"));
        let because = f.snapshot().mode.because;
        f.assert(
            (because == Because::LoopHeld) == falls,
            &format!("{because:?}"),
        );
        if falls {
            f.until_down(20.0);
        }
    }
}

#[test]
fn a_provisioned_controller_keeps_a_frozen_program_in_the_air_until_its_second_stage() {
    for (ms, falls) in [(200, false), (600, false), (1_200, false), (2_500, true)] {
        let mut f = Scenario::office().delivery(Delivery::Provisioned).start();
        f.take_off(1.0);
        f.wait_s(3.0);
        f.world.freeze(Duration::from_millis(ms));
        f.wait_s(ms as f64 / 1000.0 + 0.1);
        let height_m = -f.truth().position.z();
        println!(
            "frozen {ms} ms, throttle holds: {height_m:.2} m high afterwards, armed {}, {:?}",
            f.truth().armed,
            f.snapshot().mode
        );
        f.assert((height_m < 0.6) == falls, &format!("{height_m:.2} m"));
        f.assert(f.truth().armed != falls, "motors");
        if f.snapshot().is_armed && f.snapshot().mode.mode == Mode::Hold {
            assert_eq!(f.set_mode(modes::LAND), 0);
        }
        f.until_down(20.0);
    }
}
