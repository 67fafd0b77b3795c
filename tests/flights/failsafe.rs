//! What happens when something falls silent.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::mode::Mode;
use flight_tests::Scenario;
use sim::Fault;

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
