//! A pilot's radio beside us: he takes over with his switch, and gives back only when somebody asks.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::handover::Steering;
use bridge::autopilot::mode::{Because, Mode};
use flight_tests::{Flight, Scenario, modes};
use mavlink_dialect::command::cmd;
use sim::{Manner, Radio};

/// MAV_RESULT.
const ACCEPTED: u8 = 0;
const TEMPORARILY_REJECTED: u8 = 1;
/// A twentieth of a stick's way, us: from the centre 500, of the throttle 1000; and half a microsecond of rounding each.
const STEP_US: [u16; 4] = [26, 26, 26, 51];

/// Between two frames of the pilot's radio, s.
const RADIO_PERIOD_S: f64 = 0.021;

/// Arm on Aux1, override on Aux4.
fn radio(sticks_us: [u16; 4], arm: bool, override_is_on: bool) -> Radio {
    let switch = |on| if on { 2000 } else { 1000 };
    let mut radio = Radio {
        sticks_us,
        ..Radio::default()
    };
    radio.aux_us[0] = switch(arm);
    radio.aux_us[3] = switch(override_is_on);
    radio
}

const DOWN: [u16; 4] = [1500, 1500, 1500, 1000];

/// In a hover that was asked for, beside a radio; and the throttle that holds it, us.
fn hovering(manner: Manner, seed: u64) -> (Flight, u16) {
    let mut f = Scenario::office()
        .seed(seed)
        .manner(manner)
        .beside_radio()
        .start();
    f.world
        .simulator
        .set_radio(0, Some(radio(DOWN, false, true)));
    f.until("localized", 20.0, |f| f.snapshot().nav.health.position);
    f.wait_s(6.0);
    let now = f.now();
    f.station.arm(now, true);
    f.wait_s(0.5);
    f.assert(!f.snapshot().is_armed, "only the pilot arms");
    f.world
        .simulator
        .set_radio(0, Some(radio(DOWN, true, true)));
    f.until("armed by the pilot", 3.0, |f| f.snapshot().is_armed);
    let result = f.command(
        cmd::NAV_TAKEOFF,
        [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, 1.0],
    );
    f.assert(
        result == ACCEPTED,
        &format!("take-off was refused: {result}"),
    );
    f.until("hold", 20.0, |f| {
        f.snapshot().mode.mode == Mode::Hold && f.truth().position.z() < -0.8
    });
    f.wait_s(3.0);
    let mut sum_us = 0;
    for _ in 0..600 {
        f.step();
        sum_us += u32::from(f.world.simulator.used_sticks_us(0)[3]);
    }
    (f, (sum_us / 600) as u16)
}

/// Takes over, flies, offers, gives back; all of it watched at the mixer.
fn round(manner: Manner, seed: u64) {
    let (mut f, hover_us) = hovering(manner, seed);
    let his = [1512, 1490, 1505, hover_us];

    // He takes over: from the next frame of his radio (50 a second) on every stick is his.
    f.world
        .simulator
        .set_radio(0, Some(radio(his, true, false)));
    let from = f.now();
    let mut told_s = None;
    while f.now().since(from).as_secs_f64() < 1.5 {
        f.step();
        let at_mixer = f.world.simulator.used_sticks_us(0);
        let is_heard = f.now().since(from).as_secs_f64() > RADIO_PERIOD_S;
        f.assert(
            at_mixer == his || !is_heard,
            &format!("{at_mixer:?} is not his"),
        );
        if told_s.is_none() && f.snapshot().fc.steering == Steering::Pilot {
            told_s = Some(f.now().since(from).as_secs_f64());
        }
    }
    let told_s = told_s.unwrap_or(f64::INFINITY);
    f.assert(told_s < 0.2, &format!("noticed after {told_s:.2} s"));
    let mode = f.snapshot().mode;
    f.assert(
        mode.mode == Mode::Stabilized && mode.because == Because::PilotTookOver,
        &format!("{mode:?}"),
    );
    let texts = f.station.heard().texts.join("; ");
    f.assert(texts.contains("Pilot took over"), &texts);
    let result = f.set_mode(modes::HOLD);
    f.assert(
        result == TEMPORARILY_REJECTED,
        &format!("his switch is off, and Hold gave {result}"),
    );

    // His switch alone gives nothing back.
    f.world.simulator.set_radio(0, Some(radio(his, true, true)));
    let from = f.now();
    while f.now().since(from).as_secs_f64() < 1.0 {
        f.step();
        let at_mixer = f.world.simulator.used_sticks_us(0);
        f.assert(at_mixer == his, &format!("{at_mixer:?} without a request"));
    }

    // A request does, from his sticks on, in small steps.
    let place = f.truth().position;
    let now = f.now();
    f.station.set_mode(now, modes::HOLD);
    let mut last = his;
    let mut largest = [0; 4];
    let from = f.now();
    while f.now().since(from).as_secs_f64() < 5.0 {
        f.step();
        let at_mixer = f.world.simulator.used_sticks_us(0);
        if f.now().since(from).as_secs_f64() < 0.4 {
            for (l, (a, b)) in largest.iter_mut().zip(at_mixer.into_iter().zip(last)) {
                *l = (*l).max(a.abs_diff(b));
            }
        }
        last = at_mixer;
    }
    let moved_m = (f.truth().position - place).norm();
    println!(
        "{manner} seed {seed}: noticed after {told_s:.3} s, largest steps {largest:?} us, {moved_m:.2} m from where it was given back"
    );
    f.assert(
        largest.iter().zip(STEP_US).all(|(l, limit)| *l <= limit),
        &format!("steps {largest:?} us"),
    );
    f.assert(
        f.snapshot().mode.mode == Mode::Hold && f.snapshot().fc.steering == Steering::Kestrel,
        &format!("{:?}", f.snapshot().mode),
    );
    f.assert(
        f.truth().contacts == 0 && moved_m < 1.0,
        &format!("{moved_m:.2} m away"),
    );

    // He disarms on the floor.
    f.set_mode(modes::LAND);
    f.until("on the floor", 20.0, |f| f.truth().on_floor);
    f.wait_s(1.5);
    f.world
        .simulator
        .set_radio(0, Some(radio(DOWN, false, false)));
    f.until("disarmed", 3.0, |f| !f.snapshot().is_armed);
}

#[test]
fn a_pilot_takes_over_from_betaflight_4_6_and_gives_back_on_request() {
    for seed in 1..=3 {
        round(Manner::Betaflight46, seed);
    }
}

#[test]
fn a_pilot_takes_over_from_the_newest_betaflight_and_gives_back_on_request() {
    for seed in 1..=3 {
        round(Manner::BetaflightNew, seed);
    }
}

#[test]
fn a_pilot_takes_over_from_inav_and_gives_back_on_request() {
    for seed in 1..=3 {
        round(Manner::Inav, seed);
    }
}

#[test]
fn what_our_loops_hold_does_not_wind_up_while_he_flies() {
    let (mut f, hover_us) = hovering(Manner::BetaflightNew, 4);
    // Off our set point for seconds: an integral that ran on would shoot back.
    let his = [1500, 1500, 1500, hover_us];
    f.world
        .simulator
        .set_radio(0, Some(radio(his, true, false)));
    f.wait_s(3.0);
    let target = f.snapshot().sticks;
    f.assert(
        target.roll.abs() < 0.01 && target.pitch.abs() < 0.01,
        &format!("his sticks pass, not {target:?}"),
    );
    f.world.simulator.set_radio(0, Some(radio(his, true, true)));
    f.wait_s(0.5);
    let result = f.set_mode(modes::HOLD);
    f.assert(result == ACCEPTED, &format!("{result}"));
    let mut fastest = 0.0f64;
    for _ in 0..400 {
        f.step();
        fastest = fastest.max(f.truth().velocity.norm_xy());
    }
    f.assert(fastest < 0.8, &format!("shot off at {fastest:.2} m/s"));
}
