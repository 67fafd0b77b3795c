//! Whole-simulator properties: same seed, same bits; streams that do not disturb each other; speed.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "a test may panic, and figures here are exact by construction"
)]

mod pilot;

use core::hash::{Hash, Hasher};
use core::time::Duration;
use pilot::{Pilot, office};
use sim::{SimOutput, Then, VehicleConfig, Walker};
use std::hash::DefaultHasher;
use std::time::Instant;
use vehicle::{MapPose, RingConfig};

/// A flight that uses everything: climb, a square, somebody walking past.
fn fly(mut p: Pilot, seconds: u64) -> Pilot {
    p.take_off(1.2);
    let corners = [(0.0, 0.0), (0.6, 0.6), (-0.6, 0.6), (-0.6, -0.6)];
    for i in 0..seconds {
        let (north, east) = corners[(i / 3 % 4) as usize];
        p.fly(1000, |p| {
            p.steer_to(vehicle::In::new(north, east, -1.2), 0.3 * i as f64);
        });
    }
    p
}

fn hash(outputs: &[SimOutput]) -> u64 {
    let mut hasher = DefaultHasher::new();
    format!("{outputs:?}").hash(&mut hasher);
    hasher.finish()
}

#[test]
fn same_seed_gives_the_same_bits_and_another_seed_others() {
    let run = |seed| {
        let p = fly(Pilot::new(office("tof32", seed)), 6);
        (hash(&p.outputs), p.sim.truth(0).position.x().to_bits())
    };
    let first = run(42);
    assert_eq!(first, run(42));
    assert_ne!(first, run(43));
}

#[test]
fn how_often_it_is_advanced_does_not_matter() {
    let run = |chunk_ms: u64| {
        let mut sim = sim::Simulator::new(office("sonar8", 9)).unwrap();
        let mut outputs = Vec::new();
        for end in (chunk_ms..=1200).step_by(chunk_ms as usize) {
            sim.advance(vehicle::Timestamp::from_ms(end), &mut |_, o| {
                outputs.push(o)
            });
        }
        hash(&outputs)
    };
    assert_eq!(run(1), run(300));
}

#[test]
fn one_sensor_more_or_less_changes_no_other_sensors_numbers() {
    let rangers_of = |flow: bool, second_vehicle: bool| {
        let mut config = office("tof32", 5);
        config.vehicles[0].flow = flow;
        if second_vehicle {
            // Behind walls.
            let ring = RingConfig::built_in("tof32").unwrap();
            config
                .vehicles
                .push(VehicleConfig::new(MapPose::new(10.4, 1.5, 0.0), ring));
        }
        let mut p = Pilot::new(config);
        p.fly(2000, |_| {});
        p.outputs
            .retain(|o| matches!(o, SimOutput::Ranger(_) | SimOutput::DownRange(_)));
        hash(&p.outputs)
    };
    let reference = rangers_of(true, false);
    assert_eq!(reference, rangers_of(false, false));
    assert_eq!(reference, rangers_of(true, true));
}

/// Printed, not asserted: machines differ. The whole stack must reach 60, so the simulator alone should be far above 300.
#[test]
fn speed_figure() {
    let time = |vehicles: usize, people: usize| {
        let mut config = office("tof32", 1);
        let ring = RingConfig::built_in("tof32").unwrap();
        for i in 1..vehicles {
            let start = MapPose::new(5.0 + i as f64, 4.95, 0.0);
            config
                .vehicles
                .push(VehicleConfig::new(start, ring.clone()));
        }
        for i in 0..people {
            config.people.push(Walker {
                path: vec![[1.0, 4.6 + 0.2 * i as f64], [8.0, 5.0]],
                speed_mps: 1.0,
                start: Duration::ZERO,
                then: Then::Return,
            });
        }
        let started = Instant::now();
        let p = fly(Pilot::new(config), 120);
        let speed = p.sim.now().s() / started.elapsed().as_secs_f64();
        println!(
            "office, tof32, {vehicles} vehicles, {people} people: {speed:.0} times real time on one core"
        );
    };
    time(1, 0);
    time(4, 3);
}
