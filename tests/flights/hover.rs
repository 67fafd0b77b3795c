//! Arming, take-off, hovering, landing.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use flight_tests::{Scenario, modes};
use sim::Walker;
use std::time::Duration;
use vehicle::{In, MapPose};

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

/// How a landing from 1.5 m went.
struct Descended {
    /// From 1.3 to 0.6 m, m/s.
    speed_mps: f64,
    /// Last speed before it stood, m/s.
    touch_mps: f64,
    /// Most that it rose again, m.
    rose_m: f64,
    /// From standing to motors off, s.
    disarmed_s: f64,
}

fn descend(land_mps: &str, from_m: f64) -> Descended {
    let mut f = Scenario::office().param("MPC_LAND_SPEED", land_mps).start();
    f.take_off(from_m);
    f.wait_s(4.0);
    assert_eq!(f.set_mode(modes::LAND), 0);
    let mut path = vec![];
    let mut stood_s = None;
    let mut t = 0.0;
    while f.snapshot().is_armed {
        f.wait_s(0.02);
        t += 0.02;
        let truth = f.truth();
        path.push((t, -truth.position.z(), truth.velocity.z()));
        if truth.on_floor && stood_s.is_none() {
            stood_s = Some(t);
        }
        f.assert(t < 200.0, "never came down");
    }
    f.assert(f.truth().on_floor && f.truth().contacts == 0, "stands");
    let at = |height: f64| {
        path.iter()
            .find(|(_, z, _)| *z < height)
            .map_or(f64::NAN, |p| p.0)
    };
    let (high, low) = (0.87 * from_m, 0.4 * from_m);
    let stood_s = stood_s.unwrap_or(f64::NAN);
    let mut lowest = f64::INFINITY;
    let mut rose_m = 0.0_f64;
    for (_, z, _) in path.iter().filter(|p| p.0 < stood_s) {
        lowest = lowest.min(*z);
        rose_m = rose_m.max(z - lowest);
    }
    let mut before = path.iter().filter(|p| p.0 < stood_s - 0.03);
    Descended {
        speed_mps: (high - low) / (at(low) - at(high)),
        touch_mps: before.next_back().map_or(f64::NAN, |p| p.2),
        rose_m,
        disarmed_s: t - stood_s,
    }
}

#[test]
fn a_landing_sinks_at_its_speed_slows_near_the_floor_and_disarms_there() {
    println!("FIGURES landing");
    // The vehicle's own speed, and as slow as SNSI's first landings may be asked for.
    for (wanted, mps, from_m) in [("0.4", 0.4, 1.5), ("0.05", 0.05, 0.8)] {
        let d = descend(wanted, from_m);
        println!(
            " MPC_LAND_SPEED {wanted}: {:.3} m/s, touches at {:.2} m/s, rises {:.0} mm, motors off {:.2} s later",
            d.speed_mps,
            d.touch_mps,
            1e3 * d.rose_m,
            d.disarmed_s
        );
        assert!((d.speed_mps / mps - 1.0).abs() < 0.25, "{}", d.speed_mps);
        assert!(d.touch_mps < 0.35, "{}", d.touch_mps);
        assert!(d.rose_m < 0.05, "{}", d.rose_m);
        assert!(d.disarmed_s < 4.0, "{}", d.disarmed_s);
    }
    println!("END");
}

#[test]
fn the_offset_of_the_controllers_heading_is_what_is_told_before_the_place_is_known() {
    let yaw = |offset: &str| {
        let mut f = Scenario::office()
            .unknown()
            .param("KST_HDG_OFFSET", offset)
            .start();
        f.until("attitude", 5.0, |f| f.snapshot().nav.health.attitude);
        f.wait_s(0.5);
        f.assert(!f.snapshot().nav.health.position, "it knows no place");
        f.snapshot().nav.yaw_rad()
    };
    let turned = vehicle::angle::wrap_pi(yaw("35") - yaw("0"));
    assert!((turned.to_degrees() - 35.0).abs() < 2.0, "{turned}");
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

/// What a hover beside a walking person was worth.
struct Visit {
    clearance_m: f64,
    alone_rms_m: f64,
    back_s: f64,
    lost_s: f64,
    contacts: u32,
}

impl Visit {
    fn is_good(&self) -> bool {
        self.lost_s < 0.5
            && self.clearance_m >= 0.2
            && self.alone_rms_m <= 0.15
            && self.back_s <= 5.0
            && self.contacts == 0
    }
}

/// Hovers at home while somebody walks by: in a direction of the plan, past the set point at an offset.
fn walk_by(seed: u64, direction_rad: f64, offset_m: f64, start_s: f64) -> Visit {
    let home = sim::Room::named("office").unwrap().home();
    let (sin, cos) = direction_rad.sin_cos();
    let along = |m: f64| {
        [
            home.x_m + cos * m - sin * offset_m,
            home.y_m + sin * m + cos * offset_m,
        ]
    };
    let walker = Walker {
        path: vec![along(-1.8), along(1.8)],
        speed_mps: 0.8,
        start: Duration::from_secs_f64(start_s),
        then: sim::Then::Stay,
    };
    let mut f = Scenario::office().seed(seed).person(walker).start();
    f.take_off(1.0);
    f.until("settled", 30.0, |f| f.now().s() > 24.0);
    // It took off at home and hovers over it.
    let target = In::new(0.0, 0.0, -1.0);
    let (mut clearance_m, mut squares, mut far) = (f64::INFINITY, 0.0, 0u32);
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
        clearance_m = clearance_m.min(apart - sim::PERSON_RADIUS_M - 0.16);
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
    Visit {
        clearance_m,
        alone_rms_m: (squares / f64::from(far)).sqrt(),
        back_s: back_at.unwrap_or(f64::INFINITY) - near_until,
        lost_s,
        contacts: f.truth().contacts,
    }
}

#[test]
fn gives_way_to_a_person_and_comes_back() {
    // From all around, out of the gaps of the ring too, passing 0.2 to 0.4 m from the set point, at every moment of the
    // nose's swing.
    //
    // NOT REACHED YET: about one flight in fifty misses a bar (5 of 240, KESTREL_WALKS=240), most by a hair: a walker who
    // stays in the gap of the turning ring is seen late. This guards against worse and prints every flight.
    let flights = std::env::var("KESTREL_WALKS").map_or(32, |n| n.parse().unwrap());
    let mut table = format!(
        "FIGURES person walking by, {flights} flights\n seed  from deg  clearance m  rms far m  back after s  lost s\n"
    );
    let mut bad = Vec::new();
    for seed in 1..=flights {
        let n = seed as f64;
        let direction_rad =
            n * std::f64::consts::FRAC_PI_8 * 3.0 + if seed > 16 { 0.37 * n } else { 0.0 };
        let offset_m = if seed % 2 == 0 { 0.2 } else { 0.4 };
        let start_s = 30.0 + if seed > 16 { 0.61 * n % 4.0 } else { 0.0 };
        let v = walk_by(seed, direction_rad, offset_m, start_s);
        let mark = if v.is_good() { "" } else { " <" };
        table += &format!(
            " {seed:4}  {:8.0}  {:11.2}  {:9.3}  {:12.1}  {:6.1}{mark}\n",
            direction_rad.to_degrees() % 360.0,
            v.clearance_m,
            v.alone_rms_m,
            v.back_s,
            v.lost_s
        );
        if !v.is_good() {
            bad.push(seed);
        }
        assert!(v.contacts == 0, "seed {seed} touched\n{table}");
    }
    println!("{table}END");
    assert!(
        bad.len() <= 2.max(flights as usize / 16),
        "seeds {bad:?}\n{table}"
    );
}

/// When a hover with nobody about was pushed from its place, s of virtual time, and its RMS, m.
fn quiet_hover(seed: u64, place: MapPose, minutes: f64) -> (Vec<f64>, f64) {
    let mut f = Scenario::office().seed(seed).at(place).start();
    f.take_off(1.0);
    f.wait_s(10.0);
    let until = f.now().s() + minutes * 60.0;
    let held = f.truth().position;
    let (mut pushed, mut out) = (Vec::new(), false);
    let (mut squares, mut n) = (0.0, 0u32);
    while f.now().s() < until {
        f.step();
        let off = (f.truth().position - held).norm_xy();
        squares += off * off;
        n += 1;
        if off > 0.25 && !out {
            pushed.push(f.now().s());
        }
        out = off > 0.25 || (out && off > 0.15);
    }
    (pushed, (squares / f64::from(n)).sqrt())
}

#[test]
fn nobody_about_is_nobody_to_give_way_to() {
    let flights = std::env::var("KESTREL_QUIET").map_or(4, |n| n.parse().unwrap());
    let mut table = String::from("FIGURES hover with nobody about, 2 minutes each\n");
    let mut pushes = 0;
    let home = sim::Room::named("office").unwrap().home();
    for seed in 1..=flights {
        for (dx, dy, yaw_rad) in [(0.0, 0.0, home.yaw_rad), (1.2, 1.0, 0.0)] {
            let place = MapPose {
                x_m: home.x_m + dx,
                y_m: home.y_m + dy,
                yaw_rad,
            };
            let (pushed, rms) = quiet_hover(seed, place, 2.0);
            table += &format!(
                " seed {seed} at ({dx}, {dy}): RMS {rms:.3} m, pushed at {pushed:.1?} s\n"
            );
            pushes += pushed.len();
        }
    }
    println!("{table}END");
    assert!(pushes == 0, "{table}");
}
