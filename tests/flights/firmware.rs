//! Every firmware that the fake flight controller can pretend to be flies the same mission.
//! What differs between them is the table in `sim/src/fc/manner.rs`.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::station::{return_home, take_off, waypoint};
use flight_tests::{Flight, Scenario, modes, places};
use sim::Manner;

/// Four waypoints through two doors and back: the two rooms nearest to home.
fn tour() -> Vec<[f64; 2]> {
    let places = places("office");
    vec![places[0], places[1], places[2], places[0]]
}

fn fly(manner: Manner, seed: u64) -> Flight {
    let mut f = Scenario::office().seed(seed).manner(manner).start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let mut items = vec![take_off(1.0)];
    items.extend(tour().iter().map(|p| waypoint(p[0], p[1], -1.0, None)));
    items.push(return_home());
    let result = f.upload(items);
    f.assert(result == 0, &format!("the mission was refused: {result}"));
    f.arm();
    let result = f.set_mode(modes::MISSION);
    f.assert(result == 0, &format!("mode Mission was refused: {result}"));
    f.until("under way", 20.0, |f| f.truth().position.z() < -0.5);
    f.until_down(200.0);
    f
}

/// Five seeds; truth decides.
fn campaign(manner: Manner) {
    println!("FIGURES flight controller {manner}: office, 4 waypoints");
    println!(
        " seed  contacts  worst pass m  landing m  error mean m  p95 m  yaw rms deg  flight s"
    );
    let mut bad = Vec::new();
    for seed in 1..=5 {
        let f = fly(manner, seed);
        let passes = tour().into_iter().map(|p| f.nearest_pass(p[0], p[1]));
        let worst_pass_m = passes.fold(0.0, f64::max);
        let (landing_m, contacts) = (f.truth().position.norm_xy(), f.truth().contacts);
        let e = f.errors();
        println!(
            " {seed:4}  {contacts:8}  {worst_pass_m:12.2}  {landing_m:9.2}  {:12.3}  {:5.3}  {:11.2}  {:8.1}",
            e.mean_m,
            e.p95_m,
            e.yaw_rms_deg,
            f.now().s()
        );
        if contacts > 0 || worst_pass_m > 0.25 || landing_m > 0.30 {
            bad.push(seed);
        }
    }
    println!("END");
    assert!(bad.is_empty(), "{manner}: seeds {bad:?}");
}

#[test]
fn an_old_betaflight_flies_the_mission() {
    campaign(Manner::BetaflightOld);
}

#[test]
fn the_newest_betaflight_flies_the_mission() {
    campaign(Manner::BetaflightNew);
}

#[test]
fn inav_flies_the_mission() {
    campaign(Manner::Inav);
}

#[test]
fn cleanflight_flies_the_mission() {
    campaign(Manner::Cleanflight);
}

#[test]
fn multiwii_flies_the_mission() {
    campaign(Manner::MultiWii);
}
