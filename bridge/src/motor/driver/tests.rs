use super::*;
use crate::motor::commander::{Commander, StopReason, driver_order};
use crate::motor::units::SpeedRange;
use proptest::prelude::*;
use sim::EscBus;

const HOVER: [f64; 4] = [312.498; 4];

/// Commander, driver and bus on one clock of 0.1 ms.
struct Bench {
    now_us: u64,
    commander: Commander,
    driver: Driver,
    bus: EscBus,
    events: Vec<(u64, DriverEvent)>,
    /// Messages, acknowledgements, the driver as a whole are there.
    carries: bool,
    acknowledges: bool,
    runs: bool,
}

impl Bench {
    fn new() -> Self {
        let mut bus = EscBus::default();
        bus.record();
        Self {
            now_us: 1_000_000,
            commander: Commander::new(SpeedRange::around(312.498)),
            driver: Driver::new(DriverConfig::default()),
            bus,
            events: Vec::new(),
            carries: true,
            acknowledges: true,
            runs: true,
        }
    }

    /// Commands `speeds` each 10 ms for some time.
    fn fly(&mut self, seconds: f64, speeds: Option<[f64; 4]>) {
        let end = self.now_us + (seconds * 1e6) as u64;
        while self.now_us < end {
            let now = Timestamp::from_us(self.now_us);
            self.bus.advance(self.now_us);
            let mut messages = Vec::new();
            if let Some(speeds) = speeds.filter(|_| self.now_us.is_multiple_of(10_000)) {
                messages.extend(self.commander.command(now, speeds).message);
            }
            messages.extend(self.commander.poll(now));
            if self.runs {
                for message in messages.iter().filter(|_| self.carries) {
                    if let Some(ack) = self.driver.handle(now, message)
                        && self.acknowledges
                    {
                        self.commander.acknowledged(&ack);
                    }
                }
                self.driver.poll(now, &mut self.bus);
                while let Some(event) = self.driver.event() {
                    self.events.push((self.now_us, event));
                }
            }
            self.now_us += 100;
        }
    }

    fn said(&self, event: DriverEvent) -> Option<u64> {
        self.events.iter().find(|(_, e)| *e == event).map(|e| e.0)
    }

    fn running() -> Self {
        let mut bench = Self::new();
        bench.fly(3.0, Some(HOVER));
        assert_eq!(bench.driver.state(), DriverState::Running);
        bench
    }
}

#[test]
fn ramp_trace_is_that_of_the_thesis() {
    let bench = Bench::running();
    let speeds_of = |address: u8| -> Vec<(u64, u8)> {
        let enabled = bench
            .bus
            .trace()
            .iter()
            .position(|w| w.register == ENABLE)
            .unwrap();
        bench.bus.trace()[enabled..]
            .iter()
            .filter(|w| w.address == address && w.register == SPEED)
            .map(|w| (w.at_us, w.value))
            .collect()
    };
    let expected: Vec<u8> = (30..50)
        .flat_map(|r: u8| (0..2 * r).map(move |k| if k % 7 == 0 { r - 25 } else { r + 25 }))
        .collect();
    assert_eq!(expected.len(), 1580);
    for (i, address) in ADDRESSES.into_iter().enumerate() {
        let writes = speeds_of(address);
        let values: Vec<u8> = writes[..1580].iter().map(|w| w.1).collect();
        assert_eq!(values, expected, "0x{address:02x}");
        let enabled = bench.said(DriverEvent::Starting).unwrap();
        assert!(
            (writes[0].0 - enabled).abs_diff(420_000) <= 200,
            "420 ms of waiting"
        );
        let took = writes[1579].0 - writes[0].0;
        assert!(took.abs_diff(1579 * 1235) <= 200, "1235 us apart: {took}");
        // Hover is 167, straightened out by the offset; each 2 ms.
        let value = 167_u8.saturating_add_signed(DriverConfig::default().offsets[i]);
        assert!(writes[1580..].iter().all(|w| w.1 == value));
        let gaps = writes[1581..].windows(2).map(|w| w[1].0 - w[0].0);
        assert!(gaps.max().unwrap() <= 2100, "re-sent each 2 ms");
    }
    assert_eq!(bench.bus.values(), [167; 4]);
    let turned = bench.bus.speeds_radps();
    assert!(
        turned.iter().all(|w| (w - 312.498).abs() < 1.0),
        "{turned:?}"
    );
}

#[test]
fn each_motor_gets_its_own_speed_in_spite_of_the_swap() {
    let mut bench = Bench::running();
    bench.fly(0.1, Some([300.0, 312.498, 316.104, 350.0]));
    assert_eq!(bench.bus.values(), [157, 167, 170, 201]);
    assert_eq!(driver_order(driver_order([1, 2, 3, 4])), [1, 2, 3, 4]);
}

#[test]
fn too_slow_an_order_does_not_start() {
    let mut driver = Driver::new(DriverConfig::default());
    let ack = driver.handle(Timestamp::ZERO, &[46, 46, 45, 46]);
    assert_eq!(ack, Some(*b"ACK\0"), "acknowledged all the same");
    assert_eq!(driver.state(), DriverState::Stopped);
    assert_eq!(driver.handle(Timestamp::ZERO, &[46; 4]), Some(*b"ACK\x01"));
    assert_eq!(driver.state(), DriverState::Enabling { tries: 0 });
}

#[test]
fn an_illegal_value_is_refused_and_never_reaches_the_bus() {
    let mut bench = Bench::running();
    let now = Timestamp::from_us(bench.now_us);
    assert_eq!(bench.driver.handle(now, &[100, 221, 100, 100]), None);
    assert_eq!(bench.driver.handle(now, &[100; 3]), None);
    bench.fly(0.005, None);
    assert!(
        bench
            .said(DriverEvent::OutOfRange {
                position: 1,
                value: 221
            })
            .is_some()
    );
    assert!(bench.said(DriverEvent::BadMessage { length: 3 }).is_some());
    assert_eq!(bench.bus.values(), [167; 4], "the old order stays");
}

#[test]
fn a_zero_stops_all_four() {
    let mut bench = Bench::running();
    let now = Timestamp::from_us(bench.now_us);
    bench.driver.handle(now, &[167, 0, 167, 167]);
    bench.fly(0.01, None);
    assert_eq!(bench.bus.values(), [0; 4]);
    assert_eq!(bench.driver.state(), DriverState::Stopped);
    let disabled = |w: &&sim::BusWrite| w.register == DISABLE;
    assert_eq!(bench.bus.trace().iter().filter(disabled).count(), 4);
}

#[test]
fn silence_of_the_control_loop_stops_the_motors_within_a_second() {
    let mut bench = Bench::running();
    let from = bench.now_us;
    bench.carries = false;
    bench.fly(1.0, Some(HOVER));
    let stopped = bench.said(DriverEvent::Stopped).unwrap();
    assert!(bench.said(DriverEvent::Silence).is_some());
    assert!(stopped - from < 520_000, "{} us", stopped - from);
    assert_eq!(bench.bus.values(), [0; 4]);
}

#[test]
fn silence_in_the_ramp_stops_too() {
    let mut bench = Bench::new();
    bench.fly(1.0, Some(HOVER));
    assert!(matches!(bench.driver.state(), DriverState::Ramp { .. }));
    bench.fly(0.6, None);
    assert_eq!(bench.driver.state(), DriverState::Stopped);
}

#[test]
fn a_missing_acknowledgement_stops_the_motors_within_a_second() {
    let mut bench = Bench::running();
    bench.acknowledges = false;
    bench.fly(1.0, Some(HOVER));
    assert_eq!(bench.commander.stopped(), Some(StopReason::DriverSilent));
    assert_eq!(bench.bus.values(), [0; 4]);
}

#[test]
fn a_dead_driver_lets_the_speed_controllers_stop_by_themselves() {
    let mut bench = Bench::running();
    bench.runs = false;
    bench.fly(0.11, Some(HOVER));
    assert_eq!(bench.bus.values(), [0; 4]);
    bench.fly(0.5, Some(HOVER));
    assert_eq!(bench.commander.stopped(), Some(StopReason::DriverSilent));
}

#[test]
fn one_silent_speed_controller_ends_the_flight_and_the_others_are_stopped() {
    let mut bench = Bench::running();
    bench.bus.set_dead(0x6b, true);
    bench.fly(0.15, Some(HOVER));
    assert!(
        bench
            .said(DriverEvent::BusError { address: 0x6b })
            .is_some()
    );
    assert_eq!(
        bench.driver.state(),
        DriverState::Running,
        "20 errors are borne"
    );
    assert_eq!(bench.bus.values()[0], 167, "the others are still commanded");
    bench.fly(4.0, Some(HOVER));
    assert_eq!(bench.driver.state(), DriverState::Aborted);
    assert!(bench.said(DriverEvent::Aborted).is_some());
    assert_eq!(bench.bus.values(), [0; 4]);
    assert_eq!(bench.commander.stopped(), Some(StopReason::DriverSilent));
    assert_eq!(bench.driver.deadline(), None);
}

#[test]
fn a_start_without_all_four_is_given_up_after_100_tries() {
    let mut bench = Bench::new();
    bench.bus.set_dead(0x68, true);
    bench.fly(0.05, Some(HOVER));
    assert!(bench.said(DriverEvent::StartFailed).is_some());
    assert!(bench.bus.values().iter().all(|v| *v == 0));
}

#[test]
fn a_late_driver_skips_rounds_instead_of_bursting() {
    let mut bench = Bench::running();
    bench.runs = false;
    bench.fly(0.05, Some(HOVER));
    let before = bench.bus.trace().len();
    bench.runs = true;
    bench.fly(0.004, None);
    assert!(bench.bus.trace().len() - before <= 3 * 4);
}

proptest! {
    #[test]
    fn whatever_comes_no_illegal_value_reaches_the_bus(
        messages in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..6), 0..60),
        dead in proptest::option::of(0x68_u8..0x6c),
    ) {
        let mut bus = EscBus::default();
        bus.record();
        let config = DriverConfig { offsets: [0; 4], ..DriverConfig::default() };
        let mut driver = Driver::new(config);
        for (k, message) in messages.iter().enumerate() {
            if k == 20 && let Some(address) = dead {
                bus.set_dead(address, true);
            }
            for step in 0..300_u64 {
                let us = (k as u64 * 300 + step) * 500;
                let now = Timestamp::from_us(us);
                if step == 0 {
                    driver.handle(now, message);
                }
                bus.advance(us);
                driver.poll(now, &mut bus);
            }
        }
        prop_assert!(bus.trace().iter().all(|w| w.value <= MAX_UNITS));
    }
}
