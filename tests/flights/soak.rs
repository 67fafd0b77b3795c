//! Hours of flight in virtual time: memory and descriptors stay as they were.
//!
//! A tenth of an hour by default; `KESTREL_SOAK_H=24 cargo test -p flight-tests --test soak --profile ci -- --show-output` flies a day.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::io::clock::monotonic_ns;
use flight_tests::{Flight, Scenario, modes, places};
use mavlink_dialect::raw;

/// Nothing is measured before everything has happened a few times.
const WARM_UP_S: f64 = 120.0;
/// Growth that counts as none, MB an hour, and what the allocator may keep once, MB.
const GROWTH_MB_H: f64 = 1.0;
const SLACK_MB: f64 = 2.0;

fn resident_mb() -> f64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
    let pages: f64 = statm.split(' ').nth(1).unwrap().parse().unwrap();
    pages * 4096.0 / 1e6
}

fn descriptors() -> usize {
    std::fs::read_dir("/proc/self/fd").unwrap().count()
}

/// Five minutes of everything: take-off, places, sticks, a mission, parameters, a landing.
fn round(f: &mut Flight, place: [f64; 2], n: u64) {
    f.world.simulator.set_charge(0, 1.0);
    f.take_off(1.0);
    for _ in 0..3 {
        let [north, east] = place.map(|m| 0.5 * m as f32);
        for (n, e) in [(north, east), (0.0, 0.0)] {
            let now = f.now();
            f.station
                .command(now, 192, [-1.0, 1.0, 0.0, f32::NAN, n, e, 1.0]);
            f.wait_s(12.0);
        }
    }
    for i in 0..200 {
        f.station.send(&raw::MANUAL_CONTROL_DATA {
            target: 1,
            x: if i % 40 < 20 { 200 } else { -200 },
            z: 500,
            ..Default::default()
        });
        f.wait_s(0.05);
        if i == 4 {
            assert_eq!(f.set_mode(modes::POSITION), 0);
        }
    }
    let [north, east] = place;
    let mission = vec![
        bridge::station::waypoint(0.5 * north, 0.5 * east, -1.0, None),
        bridge::station::waypoint(0.0, 0.0, -1.0, None),
        bridge::station::return_home(),
    ];
    assert_eq!(f.upload(mission), 0);
    assert_eq!(f.set_mode(modes::MISSION), 0);
    f.wait_s(40.0);
    let now = f.now();
    f.station.set_mode(now, modes::LAND);
    f.until("down", 40.0, |f| !f.snapshot().is_armed);
    assert!(f.truth().contacts == 0, "round {n}: touched something");
    // What the harness keeps is not the vehicle's.
    f.rows.clear();
    f.rows.shrink_to_fit();
}

#[test]
fn hours_of_flight_leave_memory_and_descriptors_as_they_were() {
    let hours: f64 = std::env::var("KESTREL_SOAK_H").map_or(0.1, |h| h.parse().unwrap());
    let mut f = Scenario::office().seed(24).start();
    let place = places("office")[0];
    let began = monotonic_ns();
    let mut warm: Option<(f64, f64, usize)> = None;
    let mut n = 0;
    while f.now().s() < hours * 3600.0 || warm.is_none() {
        n += 1;
        round(&mut f, place, n);
        if warm.is_none() && f.now().s() > WARM_UP_S {
            warm = Some((f.now().s(), resident_mb(), descriptors()));
        }
    }
    let (from_s, from_mb, from_fds) = warm.unwrap();
    let over_h = (f.now().s() - from_s) / 3600.0;
    let grown_mb = resident_mb() - from_mb;
    let missed = f.snapshot().flight_loop.missed;
    println!("FIGURES");
    println!(
        "soak: {:.2} h of virtual flight, {n} rounds, in {:.0} s: {:+.2} MB after the first {from_s:.0} s ({from_mb:.0} MB), {} descriptors more, {missed} beats missed",
        f.now().s() / 3600.0,
        (monotonic_ns() - began) as f64 * 1e-9,
        grown_mb,
        descriptors() as i64 - from_fds as i64,
    );
    println!("END");
    assert!(
        grown_mb <= SLACK_MB + GROWTH_MB_H * over_h,
        "{grown_mb:.1} MB in {over_h:.2} h"
    );
    assert_eq!(descriptors(), from_fds);
}
