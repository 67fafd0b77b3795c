//! Missions through doors: truth decides. The same bars as the Python campaign, in virtual time.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::station::{return_home, take_off, waypoint};
use flight_tests::{Errors, Flight, Scenario, modes, places};
use std::time::Instant;

/// Six waypoints from home through two doors and back, NED about home: places and door centres of the office.
fn tour() -> Vec<[f64; 2]> {
    let places = places("office");
    // Out and back over the nearest rooms: every leg between rooms passes doors.
    let p = &places;
    vec![p[0], p[1], p[2], p[3], p[2], p[0]]
}

fn fly(scenario: Scenario) -> (Flight, Vec<f64>) {
    let mut f = scenario.start();
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
    f.until_down(240.0);
    let passes = tour().iter().map(|p| f.nearest_pass(p[0], p[1])).collect();
    (f, passes)
}

struct Judged {
    contacts: u32,
    worst_pass_m: f64,
    landing_m: f64,
    errors: Errors,
    seconds: f64,
}

fn judge(f: &Flight, passes: &[f64]) -> Judged {
    Judged {
        contacts: f.truth().contacts,
        worst_pass_m: passes.iter().copied().fold(0.0, f64::max),
        landing_m: f.truth().position.norm_xy(),
        errors: f.errors(),
        seconds: f.now().s(),
    }
}

fn campaign(ring: &str, seeds: std::ops::RangeInclusive<u64>) -> Vec<(u64, Judged)> {
    println!("FIGURES mission campaign {ring}: office, 6 waypoints");
    println!(
        " seed  contacts  worst pass m  landing m  error mean m  p95 m  yaw rms deg  flight s"
    );
    let mut all = Vec::new();
    for seed in seeds {
        let (f, passes) = fly(Scenario::office().ring(ring).seed(seed));
        let j = judge(&f, &passes);
        println!(
            " {seed:4}  {:8}  {:12.2}  {:9.2}  {:12.3}  {:5.3}  {:11.2}  {:8.1}",
            j.contacts,
            j.worst_pass_m,
            j.landing_m,
            j.errors.mean_m,
            j.errors.p95_m,
            j.errors.yaw_rms_deg,
            j.seconds
        );
        all.push((seed, j));
    }
    println!("END");
    all
}

fn is_good(j: &Judged) -> bool {
    j.contacts == 0 && j.worst_pass_m <= 0.25 && j.landing_m <= 0.30
}

#[test]
fn twenty_missions_with_the_tof_ring_touch_nothing_and_come_home() {
    let all = campaign("tof32", 1..=20);
    for (seed, j) in &all {
        assert!(
            is_good(j),
            "seed {seed}: contacts {}, pass {:.2}, landing {:.2}",
            j.contacts,
            j.worst_pass_m,
            j.landing_m
        );
        assert!(
            j.errors.yaw_rms_deg <= 3.0,
            "seed {seed}: yaw {:.2} deg",
            j.errors.yaw_rms_deg
        );
    }
    let n = all.len() as f64;
    let mean = all.iter().map(|(_, j)| j.errors.mean_m).sum::<f64>() / n;
    let p95 = all.iter().map(|(_, j)| j.errors.p95_m).sum::<f64>() / n;
    assert!(mean <= 0.08, "mean error {mean:.3} m");
    assert!(p95 <= 0.16, "95th percentile {p95:.3} m");
}

#[test]
fn twenty_missions_with_eight_sonars_touch_nothing() {
    let all = campaign("sonar8", 1..=20);
    let contacts: u32 = all.iter().map(|(_, j)| j.contacts).sum();
    assert_eq!(contacts, 0, "contacts");
    let good = all.iter().filter(|(_, j)| is_good(j)).count();
    assert!(good >= 18, "{good} of 20");
    let mean = all.iter().map(|(_, j)| j.errors.mean_m).sum::<f64>() / all.len() as f64;
    assert!(mean <= 0.15, "mean error {mean:.3} m");
}

/// Speed is printed, not asserted: it belongs to the machine, not to the code.
#[test]
fn a_simulated_minute_takes_about_a_second() {
    #[expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
    let started = Instant::now();
    let (f, _) = fly(Scenario::office().seed(3));
    let wall_s = started.elapsed().as_secs_f64();
    println!(
        "FIGURES speed of the whole stack, one core, tof32, 2000 particles, profile of this test"
    );
    println!(
        " {:.0} simulated seconds per second ({:.1} s in {wall_s:.2} s)\nEND",
        f.now().s() / wall_s,
        f.now().s()
    );
}

#[test]
fn a_plan_through_a_wall_is_refused_with_the_item() {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let result = f.upload(vec![take_off(1.0), waypoint(500.0, 0.0, -1.0, None)]);
    f.assert(result != 0, "a waypoint outside the plan was accepted");
    f.wait_s(0.2);
    let texts = f.station.heard().texts.join("; ");
    f.assert(
        texts.contains('1'),
        &format!("the item is not named: {texts}"),
    );
}

#[test]
fn a_paused_mission_resumes_where_it_was() {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let mut items = vec![take_off(1.0)];
    items.extend(tour().iter().map(|p| waypoint(p[0], p[1], -1.0, None)));
    items.push(return_home());
    assert_eq!(f.upload(items), 0);
    f.arm();
    assert_eq!(f.set_mode(modes::MISSION), 0);
    f.until("first waypoint", 60.0, |f| {
        f.station.heard().reached.contains(&1)
    });
    assert_eq!(f.set_mode(modes::HOLD), 0);
    f.wait_s(3.0);
    let stopped = f.truth().position;
    f.wait_s(5.0);
    f.assert(
        (f.truth().position - stopped).norm() < 0.3,
        "it did not hold",
    );
    let reached = f.station.heard().reached.len();
    assert_eq!(f.set_mode(modes::MISSION), 0);
    f.until_down(240.0);
    f.assert(
        f.station.heard().reached[reached..].first() == Some(&2),
        "it did not go on with item 2",
    );
}
