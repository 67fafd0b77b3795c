//! The same seed is the same flight, and a log is the flight: flown again it is the same to the bit.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::door::HostReport;
use bridge::io::clock::monotonic_ns;
use bridge::log::replay::{Replay, Report};
use bridge::log::{Emitted, FlightRecord, LogFile};
use flight_tests::{Flight, Scenario, modes, places};
use sim::{Fault, Manner};
use std::time::Duration;

#[test]
fn the_same_seed_gives_the_same_flight() {
    let fly = |seed| {
        let mut f = Scenario::office().seed(seed).start();
        f.take_off(1.0);
        f.wait_s(10.0);
        (f.rows.clone(), f.snapshot().clone())
    };
    let (a, b, c) = (fly(7), fly(7), fly(8));
    assert!(a == b, "two flights with one seed differ");
    assert!(a.0 != c.0, "two seeds give one flight");
}

/// Numbers that follow from a seed (splitmix64).
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % sides
    }
}

/// A flight whose room, firmware, modes and faults follow from its seed.
fn random_flight(seed: u64) -> Flight {
    let mut dice = Dice(seed);
    let rooms = ["office", "maze", "corridor"];
    let room = rooms[dice.roll(3) as usize];
    let manners = Manner::ALL;
    let manner = manners[dice.roll(manners.len() as u64) as usize];
    let mut scenario = Scenario::room(room).seed(seed).manner(manner).recorded();
    if dice.roll(5) == 0 {
        scenario = scenario.unknown();
    }
    let mut f = scenario.start();
    if f.try_until(20.0, |f| f.station.heard().is_armable).is_err() {
        return f;
    }
    let now = f.now();
    f.station.arm(now, true);
    f.wait_s(1.5);
    f.command(22, [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, 1.0]);
    f.wait_s(6.0);
    for _ in 0..4 {
        match dice.roll(13) {
            0 => drop(f.set_mode(modes::POSITION)),
            1 => f
                .world
                .simulator
                .set_fault(0, Fault::RangerSilent(dice.roll(4) as u8), true),
            2 => f.world.simulator.set_fault(0, Fault::FlowSilent, true),
            3 => f.world.simulator.set_fault(0, Fault::FcSilent, true),
            4 => f
                .world
                .hold_flight(Duration::from_millis(50 + dice.roll(600))),
            5 => f.world.simulator.set_charge(0, 0.1),
            7 => f
                .world
                .simulator
                .set_fault(0, Fault::RangerStuck(dice.roll(4) as u8), true),
            8 => f.world.simulator.set_fault(0, Fault::DownSilent, true),
            9 => f.world.simulator.set_fault(0, Fault::FcNoisy, true),
            10 => f.world.host(HostReport {
                temperature_c: Some(60.0 + dice.roll(50) as f64),
                is_overloaded: true,
                ..HostReport::default()
            }),
            11 => f
                .world
                .simulator
                .set_fault(0, Fault::MotorDead(dice.roll(4) as u8), true),
            6 => {
                let place = places(room)[0];
                let now = f.now();
                f.station.command(
                    now,
                    192,
                    [
                        -1.0,
                        1.0,
                        0.0,
                        f32::NAN,
                        place[0] as f32,
                        place[1] as f32,
                        1.0,
                    ],
                );
            }
            _ => f.station.be_silent(dice.roll(2) == 0),
        }
        f.wait_s(1.0 + dice.roll(4) as f64);
    }
    f.station.be_silent(false);
    let now = f.now();
    f.station.set_mode(now, modes::LAND);
    let _ = f.try_until(15.0, |f| !f.snapshot().is_armed);
    f
}

fn replay(f: &Flight, sets: &[(&str, &str)]) -> (Report, f64, LogFile) {
    let (mcap, _) = f.log.as_ref().unwrap().finish();
    let log = LogFile::read(&mcap).unwrap();
    let again = Replay::new(std::slice::from_ref(&log), sets).unwrap();
    let began = monotonic_ns();
    let report = again.run();
    let took_s = (monotonic_ns() - began) as f64 * 1e-9;
    (report, took_s, log)
}

#[test]
fn random_flights_with_faults_replay_bit_for_bit() {
    let flights = match std::env::var("KESTREL_REPLAYS") {
        Ok(n) => n.parse().unwrap(),
        Err(_) => 6,
    };
    let (mut flown_s, mut took_s, mut bytes) = (0.0, 0.0, 0);
    let mut outputs = 0;
    for seed in 1..=flights {
        let f = random_flight(seed);
        let (report, took, log) = replay(&f, &[]);
        assert!(
            report.is_same(),
            "seed {seed}: {}",
            report.difference.unwrap()
        );
        assert!(report.ticks > 100 && report.outputs > 1_000, "{report:?}");
        flown_s += report.end.s();
        took_s += took;
        outputs += report.outputs;
        bytes += log.messages.iter().map(|m| m.data.len()).sum::<usize>();
    }
    println!("FIGURES");
    println!(
        "replay: {flights} flights of {flown_s:.0} s in {took_s:.2} s ({:.0} x real time), {outputs} outputs the same; {:.1} kB/s of log",
        flown_s / took_s,
        bytes as f64 / flown_s * 1e-3
    );
    println!("END");
    assert!(
        flown_s / took_s >= 20.0,
        "{:.1} x real time",
        flown_s / took_s
    );
}

#[test]
fn another_parameter_gives_another_flight_and_the_first_difference_has_a_name() {
    let mut f = Scenario::office().seed(5).recorded().start();
    f.take_off(1.0);
    f.wait_s(3.0);
    let (report, ..) = replay(&f, &[("MPC_TKO_SPEED", "0.3")]);
    let difference = report.difference.unwrap();
    println!("{difference}");
    assert!(difference.to_string().contains("differs at"));
    assert!(report.differing_ticks > 10);
}

#[test]
fn one_bit_of_one_input_is_found_and_named() {
    let mut f = Scenario::office().seed(6).recorded().start();
    f.take_off(1.0);
    let (mcap, _) = f.log.as_ref().unwrap().finish();
    let log = LogFile::read(&mcap).unwrap();
    let header = log.header.clone().unwrap();
    let mut records = log.stream().unwrap();
    let n = records.len();
    let hit = records[n / 2..]
        .iter_mut()
        .find_map(|r| match r {
            FlightRecord::Output {
                at,
                output: Emitted::Fc(bytes),
            } => Some((*at, bytes)),
            _ => None,
        })
        .unwrap();
    let at = hit.0;
    hit.1[3] ^= 1;
    let report = Replay::of(&header, records, &[]).unwrap().run();
    let difference = report.difference.unwrap();
    assert_eq!(difference.what, "bytes to the flight controller");
    assert_eq!(difference.at, at);
}

#[test]
fn a_log_without_its_end_replays_to_where_it_ends() {
    let mut f = Scenario::office().seed(9).recorded().start();
    f.take_off(1.0);
    f.log.as_ref().unwrap().flush();
    f.wait_s(5.0);
    let (mcap, tlog) = f.log.as_ref().unwrap().finish();
    assert!(bridge::log::tlog::frames(&tlog).count() > 500);
    let log = LogFile::read(&mcap[..mcap.len() * 9 / 10]).unwrap();
    assert!(log.is_torn);
    let report = Replay::new(&[log], &[]).unwrap().run();
    assert!(report.is_same(), "{:?}", report.difference);
    assert!(report.ticks > 50);
}
