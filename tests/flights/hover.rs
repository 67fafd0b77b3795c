//! Arming, take-off, hovering, landing.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use flight_tests::{Scenario, modes};
use sim::Walker;
use std::time::Duration;
use vehicle::In;

#[test]
fn arms_climbs_hovers_and_lands() {
    let mut f = Scenario::office().start();
    f.take_off(1.0);
    f.wait_s(5.0);
    let home = f.truth().position;
    let mut worst = 0.0_f64;
    for _ in 0..200 {
        f.wait_s(0.1);
        worst = worst.max((f.truth().position - home).norm());
    }
    f.assert(
        worst < 0.25,
        &format!("hover wandered {worst:.2} m in 20 s"),
    );
    assert_eq!(f.set_mode(modes::LAND), 0);
    f.until_down(15.0);
    f.assert(f.truth().contacts == 0, "touched something");
    f.assert(f.truth().position.norm_xy() < 0.3, "landed elsewhere");
}

#[test]
fn arming_is_refused_during_the_boot_grace_with_the_reason() {
    let mut f = Scenario::office().start();
    f.until("heartbeat", 2.0, |f| f.station.heard().vehicle.is_some());
    let result = f.command(400, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    f.assert(
        result == 1,
        &format!("expected TEMPORARILY_REJECTED, got {result}"),
    );
    f.wait_s(0.2);
    let texts = f.station.heard().texts.join("; ");
    f.assert(
        texts.contains("Refused") || texts.contains("rm"),
        &format!("no reason was given: {texts}"),
    );
    f.assert(!f.truth().armed, "armed all the same");
}

#[test]
fn a_vehicle_armed_and_left_alone_disarms() {
    let mut f = Scenario::office().start();
    f.arm();
    f.until("disarmed", 15.0, |f| !f.snapshot().is_armed);
}

#[test]
fn gives_way_to_a_person_and_comes_back() {
    let mut table = String::from(
        "FIGURES person walking by, 16 directions\n seed  clearance m  rms far m  back after s  lost s\n",
    );
    let mut bad = Vec::new();
    for seed in 1..=16_u64 {
        // From all around, out of the gaps of the ring too, passing 0.2 to 0.4 m from the set point.
        let home = sim::Room::named("office").unwrap().home();
        let (sin, cos) = (f64::from(seed as u8) * std::f64::consts::FRAC_PI_8 * 3.0).sin_cos();
        let offset = if seed % 2 == 0 { 0.2 } else { 0.4 };
        let along = |m: f64| {
            [
                home.x_m + cos * m - sin * offset,
                home.y_m + sin * m + cos * offset,
            ]
        };
        let (from, to) = (along(-1.8), along(1.8));
        let walker = Walker {
            path: vec![from, to],
            speed_mps: 0.8,
            start: Duration::from_secs(30),
            then: sim::Then::Stay,
        };
        let mut f = Scenario::office().seed(seed).person(walker).start();
        f.take_off(1.0);
        f.until("settled", 30.0, |f| f.now().s() > 24.0);
        // It took off at home and hovers over it.
        let target = In::new(0.0, 0.0, -1.0);
        let (mut clearance, mut squares, mut far) = (f64::INFINITY, 0.0, 0u32);
        let (mut near_until, mut back_at) = (0.0, None);
        let mut lost_s = 0.0;
        while f.now().s() < 60.0 {
            f.step();
            if !f.snapshot().nav.health.position {
                lost_s += 0.005;
            }
            let person = f.world.simulator.people().next().expect("somebody");
            let here = f.world.simulator.anchor().to_map(f.truth().position);
            let apart = (here - In::new(person[0], person[1], here.z())).norm_xy();
            clearance = clearance.min(apart - sim::PERSON_RADIUS_M - 0.16);
            let off = (f.truth().position - target).norm_xy();
            if apart > 1.5 {
                squares += off * off;
                far += 1;
            } else {
                (near_until, back_at) = (f.now().s(), None);
            }
            if off <= 0.15 && back_at.is_none() {
                back_at = Some(f.now().s());
            }
        }
        let rms = (squares / f64::from(far)).sqrt();
        let back = back_at.unwrap_or(f64::INFINITY) - near_until;
        table += &format!(" {seed:4}  {clearance:11.2}  {rms:9.3}  {back:12.1}  {lost_s:6.1}\n");
        let is_good = lost_s < 0.5
            && clearance >= 0.2
            && rms <= 0.15
            && back <= 5.0
            && f.truth().contacts == 0;
        if !is_good {
            bad.push(seed);
        }
    }
    println!("{table}END");
    assert!(bad.is_empty(), "seeds {bad:?}\n{table}");
}
