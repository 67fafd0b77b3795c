//! Nothing allocates in the flight loop after take-off, and a flight is its log of inputs.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use assert_no_alloc::{AllocDisabler, assert_no_alloc, reset_violation_count, violation_count};
use bridge::autopilot::flight::{Flight, FlightConfig, Start};
use bridge::autopilot::io::Input;
use bridge::autopilot::latency::Histogram;
use bridge::io::clock::monotonic_ns;
use bridge::settings::Settings;
use flight_tests::{Scenario, modes};
use sim::Room;
use std::sync::Arc;
use std::time::Duration;
use vehicle::{Airframe, RingConfig, Timestamp};

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

#[test]
fn a_flight_flown_again_from_its_inputs_is_the_same_and_allocates_nothing() {
    reset_violation_count();
    assert_no_alloc(|| drop(std::hint::black_box(vec![1u8; 64])));
    assert!(violation_count() > 0, "the allocator does not count");

    let mut f = Scenario::office().seed(3).start();
    f.world.keep_inputs();
    f.take_off(1.0);
    let in_the_air = f.now();
    f.wait_s(10.0);
    f.set_mode(modes::POSITION);
    f.wait_s(2.0);
    f.set_mode(modes::LAND);
    f.until_down(20.0);
    let inputs = f.world.take_inputs();

    let room = Room::named("office").unwrap();
    let mut flight = Flight::new(
        Timestamp::ZERO,
        FlightConfig {
            plan: Arc::clone(room.floor_plan()),
            ring: RingConfig::built_in("tof32").unwrap(),
            airframe: Airframe::default(),
            start: Start::Known(room.home()),
            settings: Settings::default(),
            seed: 3,
        },
    );
    let mut own = Histogram::default();
    let mut allocating = 0;
    let mut take = |now: Timestamp, input: Input| {
        let is_flying = now >= in_the_air;
        let is_reply = matches!(input, Input::Fc(_));
        let rc_before = flight.rc_frames_sent();
        reset_violation_count();
        let began_ns = monotonic_ns();
        assert_no_alloc(|| flight.handle(now, input));
        let took = Duration::from_nanos(monotonic_ns() - began_ns);
        assert_no_alloc(|| while flight.poll().is_some() {});
        if is_flying && violation_count() > 0 {
            allocating += 1;
        }
        if is_flying && is_reply && flight.rc_frames_sent() != rc_before {
            own.record(took);
        }
    };
    take(Timestamp::ZERO, Input::FcOpened);
    for (now, input) in inputs {
        take(now, input);
    }
    let s = own.summary();
    println!(
        "reply to RC frame, computing only: {} frames, p10 {} p50 {} p99 {} max {} us",
        s.count,
        own.quantile_us(0.1),
        s.p50_us,
        s.p99_us,
        s.max_us
    );
    assert!(
        flight.snapshot() == f.snapshot(),
        "the flight flown again differs"
    );
    assert_eq!(allocating, 0, "inputs that allocated in the air");
}
