//! What happens when something falls silent.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::door::HostReport;
use bridge::autopilot::mode::{Because, Mode};
use flight_tests::{Scenario, modes, places};
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

/// Flies until a row of the table has set a mode.
fn until_row(f: &mut flight_tests::Flight, because: Because, mode: Mode, limit_s: f64) {
    f.until(because.words(), limit_s, |f| {
        f.snapshot().mode.because == because
    });
    f.assert(
        f.snapshot().mode.mode == mode,
        &format!("{:?}", f.snapshot().mode),
    );
    f.wait_s(0.3);
    let texts = f.station.heard().texts.join("; ");
    f.assert(
        texts.contains(because.words()),
        &format!("not told: {texts}"),
    );
}

#[test]
fn a_lost_motor_stops_the_others() {
    for motor in 0..4 {
        let mut f = Scenario::office().seed(u64::from(motor)).start();
        f.take_off(1.0);
        f.world
            .simulator
            .set_fault(0, Fault::MotorDead(motor), true);
        let from = f.now();
        f.until("motors off", 2.5, |f| !f.snapshot().is_armed);
        println!(
            "motor {motor} lost: off after {:.2} s",
            f.now().since(from).as_secs_f64()
        );
        f.wait_s(0.3);
        let texts = f.station.heard().texts.join("; ");
        f.assert(texts.contains("toppled over"), &texts);
        // The controller's own runaway protection may be quicker; either way nothing turns any more.
        f.until("down", 5.0, |f| !f.truth().armed && f.truth().on_floor);
    }
}

#[test]
fn a_tilt_that_control_never_asks_for_lands() {
    let mut f = Scenario::office().param("KST_CRASH_TILT", "180").start();
    f.take_off(1.0);
    f.world.simulator.set_fault(0, Fault::MotorDead(1), true);
    until_row(&mut f, Because::Tilted, Mode::Land, 2.0);
}

#[test]
fn a_flight_loop_that_is_too_slow_lands() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.wait_s(2.0);
    for _ in 0..40 {
        f.world.hold_flight(Duration::from_millis(100));
        f.wait_s(0.13);
        if f.snapshot().mode.because == Because::LoopOverrun {
            break;
        }
    }
    until_row(&mut f, Because::LoopOverrun, Mode::Land, 0.5);
    f.until_down(20.0);
    f.assert(f.truth().contacts == 0, "touched something");
}

#[test]
fn a_controller_that_answers_too_seldom_is_not_flown_on() {
    let mut f = Scenario::office().param("KST_FC_MIN_HZ", "60").start();
    f.take_off(1.0);
    f.world.simulator.set_fault(0, Fault::FcBusy, true);
    until_row(&mut f, Because::FcSlow, Mode::Land, 3.0);
    f.until_down(20.0);
    f.assert(f.truth().contacts == 0, "touched something");
}

#[test]
fn a_noisy_line_is_not_flown_on() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.world.simulator.set_fault(0, Fault::FcNoisy, true);
    f.until("landing", 6.0, |f| f.snapshot().mode.mode == Mode::Land);
    let because = f.snapshot().mode.because;
    f.assert(
        matches!(because, Because::FcSlow | Because::FcSilent),
        &format!("{because:?}"),
    );
    println!("noisy line: {because:?} at {:.1} s", f.now().s());
    f.world.simulator.set_fault(0, Fault::FcNoisy, false);
    f.until_down(20.0);
}

#[test]
fn an_attitude_that_does_not_fit_the_motion_lands() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.world.simulator.set_fault(0, Fault::AttitudeAskew, true);
    until_row(&mut f, Because::Inconsistent, Mode::Land, 1.5);
}

#[test]
fn without_down_ranger_and_barometer_it_lands() {
    // The barometer is the controller's: with the line gone both heights and the attitude are.
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.world.simulator.set_fault(0, Fault::DownSilent, true);
    f.wait_s(3.0);
    f.assert(
        f.snapshot().mode.mode == Mode::Hold,
        "the barometer holds the height",
    );
    f.world.simulator.set_fault(0, Fault::FcSilent, true);
    f.until("landing", 2.0, |f| f.snapshot().mode.mode == Mode::Land);
}

#[test]
fn a_vehicle_that_is_lost_for_too_long_lands() {
    // Its estimate is broken by a place it cannot explain: outside of what the plan shows as rooms.
    let mut f = Scenario::room("maze").param("LOC_LOST_T", "0.5").start();
    f.take_off(1.0);
    let home = f.world.simulator.floor_plan().home.unwrap();
    for shift in [3.0, -2.0, 4.0, 1.5] {
        let pose = vehicle::MapPose::new(
            home.x_m + shift,
            home.y_m + 0.3 * shift,
            home.yaw_rad + 1.3 * shift,
        );
        f.world.simulator.carry_to(0, pose);
        f.wait_s(0.6);
        if f.snapshot().mode.because == Because::NotLocalized {
            break;
        }
    }
    until_row(&mut f, Because::NotLocalized, Mode::Land, 10.0);
}

#[test]
fn a_place_that_jumps_again_and_again_lands() {
    // Finding the place in a search flight is one jump; here one is too many.
    let mut f = Scenario::office()
        .unknown()
        .param("KST_JUMPS_MAX", "1")
        .start();
    f.arm();
    let result = f.command(22, [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, 1.0]);
    f.assert(result == 0, &format!("take-off was refused: {result}"));
    until_row(&mut f, Because::PlaceJumps, Mode::Land, 60.0);
    f.until_down(20.0);
}

#[test]
fn a_stuck_ranger_lands_the_vehicle() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.world.simulator.set_fault(0, Fault::RangerStuck(1), true);
    f.wait_s(6.0);
    f.assert(
        f.snapshot().mode.mode == Mode::Hold,
        "in a hover everything stays the same",
    );
    let place = places("office")[0];
    let now = f.now();
    let [north, east] = place.map(|m| m as f32);
    f.station.command(
        now,
        192,
        [-1.0, 1.0, 0.0, f32::NAN, 0.3 * north, 0.3 * east, 1.0],
    );
    let north_m = |f: &flight_tests::Flight| f.truth().position.norm_xy();
    if f.try_until(10.0, |f| north_m(f) > 0.4).is_err() {
        // Where that place is refused, the sticks move it.
        f.set_mode(modes::POSITION);
        for _ in 0..100 {
            f.station.send(&sticks(500));
            f.wait_s(0.05);
        }
    }
    until_row(&mut f, Because::RangersStuck, Mode::Land, 20.0);
    f.until_down(20.0);
    f.assert(f.truth().contacts == 0, "touched something");
}

fn sticks(x: i16) -> mavlink_dialect::raw::MANUAL_CONTROL_DATA {
    mavlink_dialect::raw::MANUAL_CONTROL_DATA {
        target: 1,
        x,
        z: 500,
        ..Default::default()
    }
}

#[test]
fn sticks_that_stop_end_in_hold() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    for _ in 0..4 {
        f.station.send(&sticks(0));
        f.wait_s(0.05);
    }
    assert_eq!(f.set_mode(modes::POSITION), 0);
    for _ in 0..20 {
        f.station.send(&sticks(150));
        f.wait_s(0.05);
    }
    until_row(&mut f, Because::ManualSilent, Mode::Hold, 4.0);
    f.wait_s(2.0);
    f.assert(f.truth().velocity.norm_xy() < 0.15, "it still moves");
}

#[test]
fn a_sagging_battery_lands_the_vehicle() {
    let mut f = Scenario::office()
        .param("BAT_V_SAG", "3.5")
        .param("BAT_LOW_THR", "0")
        .param("BAT_CRIT_THR", "0")
        .start();
    f.take_off(1.0);
    f.world.simulator.set_charge(0, 0.02);
    until_row(&mut f, Because::BatterySags, Mode::Land, 10.0);
    f.until_down(20.0);
}

#[test]
fn a_critical_battery_lands_where_it_is() {
    let mut f = Scenario::office().param("BAT_V_SAG", "0").start();
    f.take_off(1.0);
    f.world.simulator.set_charge(0, 0.04);
    f.until("landing", 20.0, |f| {
        f.snapshot().mode.because == Because::BatteryCritical
    });
    f.until_down(20.0);
}

#[test]
fn a_computer_that_is_too_hot_lands() {
    let hot = |c| HostReport {
        temperature_c: Some(c),
        ..HostReport::default()
    };
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.world.host(hot(70.0));
    f.wait_s(1.0);
    f.assert(f.snapshot().mode.mode == Mode::Hold, "70 degrees are usual");
    f.world.host(hot(95.0));
    until_row(&mut f, Because::Hot, Mode::Land, 1.0);
    f.until_down(20.0);
    let now = f.now();
    f.station.arm(now, true);
    f.wait_s(1.0);
    let texts = f.station.heard().texts.join("; ");
    f.assert(
        texts.contains("failsafe holds: computer too hot"),
        &format!("armed while hot: {texts}"),
    );
}

#[test]
fn what_the_computer_tells_reaches_the_pilot_and_flying_goes_on() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.world.host(HostReport {
        is_throttled: true,
        disk_fails: true,
        clock_jumped: true,
        is_overloaded: true,
        temperature_c: None,
    });
    f.wait_s(1.0);
    let texts = f.station.heard().texts.join("; ");
    for because in [
        Because::Throttled,
        Because::DiskFails,
        Because::ClockJumped,
        Because::Overloaded,
    ] {
        f.assert(
            texts.contains(&format!("Warning: {}", because.words())),
            &format!("{because:?} not told: {texts}"),
        );
    }
    f.wait_s(5.0);
    f.assert(
        f.snapshot().mode.mode == Mode::Hold,
        "it does not hover any more",
    );
    f.world.host(HostReport::default());
    f.wait_s(0.5);
    let texts = f.station.heard().texts.join("; ");
    f.assert(texts.contains("Failsafe cleared: disk full"), &texts);
}

#[test]
fn a_way_that_stays_blocked_ends_in_hold() {
    let mut f = Scenario::office()
        .param("KST_PROGRESS_T", "5")
        .param("MPC_XY_CRUISE", "0.1")
        .start();
    f.take_off(1.0);
    let stay = |f: &mut flight_tests::Flight| {
        // A place that is crawled to: on its way, and nowhere. (A stream of speeds leads to no place.)
        f.station
            .send(&mavlink_dialect::raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
                target_system: 1,
                target_component: 1,
                coordinate_frame: 1,
                type_mask: 0b1101_1111_1000,
                x: 1.5,
                z: -1.0,
                ..Default::default()
            });
        f.wait_s(0.05);
    };
    for _ in 0..10 {
        stay(&mut f);
    }
    assert_eq!(f.set_mode(modes::OFFBOARD), 0);
    for _ in 0..400 {
        stay(&mut f);
        if f.snapshot().mode.because == Because::NoProgress {
            break;
        }
    }
    until_row(&mut f, Because::NoProgress, Mode::Hold, 0.5);
}

#[test]
fn a_flight_thread_that_never_comes_back_is_brought_down_without_it() {
    // A panic leaves the keeper alone with the line, as a loop does that is held up for good.
    let mut f = Scenario::office().delivery(Delivery::Provisioned).start();
    f.take_off(1.0);
    f.wait_s(2.0);
    let place = f.truth().position;
    f.world.hold_flight(Duration::from_secs(60));
    let mut fastest = 0.0f64;
    f.until("down with motors off", 12.0, |f| {
        fastest = fastest.max(f.truth().velocity.z());
        !f.truth().armed && f.truth().on_floor
    });
    println!(
        "no flight thread: down {:.2} m away, at up to {fastest:.1} m/s",
        (f.truth().position - place).norm_xy()
    );
    f.assert(
        (f.truth().position - place).norm_xy() < 1.0,
        "it drifted away",
    );
}

#[test]
fn stop_holds_and_stop_again_lands() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    assert_eq!(
        f.command(193, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        0,
        "STOP"
    );
    f.wait_s(1.0);
    f.assert(f.snapshot().mode.mode == Mode::Hold, "no Hold");
    assert_eq!(
        f.command(193, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        0,
        "STOP again"
    );
    f.until_down(20.0);
}

#[test]
fn a_station_breaks_and_mends_things_in_the_simulator() {
    let mut f = Scenario::office().start();
    let inject = |f: &mut flight_tests::Flight, unit: f32, kind: f32, instance: f32| {
        f.command(420, [unit, kind, instance, 0.0, 0.0, 0.0, 0.0])
    };
    f.take_off(1.0);
    assert_eq!(inject(&mut f, 7.0, 1.0, 9.0), 2, "there is no ninth ranger");
    assert_eq!(inject(&mut f, 4.0, 1.0, 0.0), 3, "there are no satellites");
    assert_eq!(inject(&mut f, 5.0, 2.0, 0.0), 3, "flow does not get stuck");
    assert_eq!(inject(&mut f, 7.0, 1.0, 0.0), 0);
    until_row(&mut f, Because::RangersSilent, Mode::Land, 3.0);
    assert_eq!(inject(&mut f, 7.0, 0.0, 0.0), 0);
    f.wait_s(0.5);
    let texts = f.station.heard().texts.join("; ");
    f.assert(
        texts.contains("Failsafe cleared: range finders silent"),
        &texts,
    );
    assert_eq!(inject(&mut f, 101.0, 1.0, 2.0), 0);
    f.until("motors off", 2.5, |f| !f.snapshot().is_armed);
}
