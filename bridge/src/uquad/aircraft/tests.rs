#![allow(clippy::print_stdout, reason = "a flight prints its figures")]

use super::*;
use crate::motor::{Driver, DriverConfig};
use control::integral::{Integrated, Thresholds};
use control::lqr::{Motion, Trim, Weights, design};
use estimator::thesis::{Noise, StateSet};
use sim::imu_board::{Bench, Received};
use sim::{EscBus, MotorCraft};
use vehicle::UquadAirframe;

/// The scales of the simulated chips.
fn calibration() -> Calibration {
    let rows = |k: f64| format!("{k} 0 0 0 {k} 0 0 0 {k} 0 0 0 ");
    let text = [
        9.80665 / 256.0,
        (1.0 / 14.375_f64).to_radians(),
        1.0 / 1300.0,
    ]
    .map(rows)
    .concat();
    Calibration::parse(&text).unwrap()
}

fn config(states: StateSet, theta: f64) -> UquadConfig {
    let mut config = UquadConfig::corrected();
    let motion = Motion::of(config.filter.craft);
    let hover = Trim::hover(&motion.craft, theta);
    let weights = Weights::indoor();
    let design = match states {
        StateSet::Full => design::twelve_and_integrals(&motion, &hover, &weights).unwrap(),
        StateSet::Reduced => design::eight(&motion, &hover, &weights).unwrap(),
    };
    config.filter.noise = Noise::flight();
    config.filter.states = states;
    config.gains = design.gains;
    let indoor = Thresholds::INDOOR_HORIZONTAL;
    config.integral = design.integral_action().map(|i| {
        i.with_thresholds(Integrated::X, indoor)
            .with_thresholds(Integrated::Y, indoor)
    });
    config
}

/// Aircraft, driver, bus, airframe, inertial unit: bytes all the way round, on one clock.
struct World {
    ms: u64,
    craft: MotorCraft,
    bus: EscBus,
    driver: Driver,
    board: Bench,
    aircraft: Aircraft,
    said: Vec<Said>,
    steps: u32,
    last: Option<Step>,
    has_fix: bool,
    line_is_cut: bool,
    noise: u64,
}

impl World {
    fn new(seed: u64, states: StateSet) -> Self {
        Self {
            ms: 0,
            craft: MotorCraft::landed(UquadAirframe::default(), 0.0),
            bus: EscBus::default(),
            driver: Driver::new(DriverConfig::default()),
            board: Bench::new(seed, false),
            aircraft: Aircraft::new(calibration(), config(states, 0.0)).unwrap(),
            said: Vec::new(),
            steps: 0,
            last: None,
            has_fix: states == StateSet::Full,
            line_is_cut: false,
            noise: seed,
        }
    }

    /// About +-3 cm, portable.
    fn error(&mut self) -> f64 {
        self.noise = self
            .noise
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        ((self.noise >> 40) as f64 / f64::from(1_u32 << 24) - 0.5) * 0.06
    }

    fn pass(&mut self, seconds: f64, mut each: impl FnMut(&MotorCraft)) {
        let end = self.ms + (seconds * 1e3) as u64;
        let mut out: Vec<Received> = Vec::new();
        while self.ms < end {
            self.ms += 1;
            let now = Timestamp::from_ms(self.ms);
            self.bus.advance(now.us());
            self.craft.step(self.bus.speeds_radps());
            self.board.feel(self.craft.environment());
            out.clear();
            self.board.advance(now.us(), &mut out);
            if self.has_fix && self.ms.is_multiple_of(100) {
                let error = Vector3::new(self.error(), self.error(), self.error());
                self.aircraft.fix(self.craft.motion().position_m + error);
            }
            if !self.line_is_cut {
                let bytes: Vec<u8> = out.iter().map(|r| r.byte).collect();
                let said = &mut self.said;
                let step = self.aircraft.bytes(now, &bytes, &mut |s| said.push(s));
                self.steps += u32::from(step.is_some());
                self.last = step.or(self.last);
            }
            while let Some(message) = self.aircraft.poll(now) {
                if let Some(ack) = self.driver.handle(now, &message) {
                    self.aircraft.acknowledged(&ack);
                }
            }
            self.driver.poll(now, &mut self.bus);
            each(&self.craft);
        }
    }

    /// In the air at 1 m.
    fn flying(seed: u64, states: StateSet) -> Self {
        let mut world = Self::new(seed, states);
        world.pass(6.0, |_| {});
        assert_eq!(
            world.aircraft.phase(),
            Phase::Ready,
            "seed {seed}: {:?}",
            world.said
        );
        let now = Timestamp::from_ms(world.ms);
        assert!(world.aircraft.take_off(now, 1.0));
        world.pass(9.0, |_| {});
        assert_eq!(
            world.aircraft.phase(),
            Phase::Running,
            "seed {seed}: {:?}",
            world.said
        );
        world
    }
}

#[test]
fn bytes_in_motor_bytes_out_it_takes_off_to_a_metre_and_hovers() {
    println!("FIGURES");
    for seed in 1..=5 {
        let mut world = World::flying(seed, StateSet::Full);
        let (mut level, mut height, mut square, mut n) = (0.0_f64, 0.0_f64, 0.0, 0.0);
        world.pass(20.0, |craft| {
            let off = craft.motion().position_m - Vector3::new(0.0, 0.0, 1.0);
            level = level.max(off.xy().norm());
            height = height.max(off.z.abs());
            square += off.norm_squared();
            n += 1.0;
        });
        let rms = libm::sqrt(square / n);
        println!(
            "seed {seed}: hover 20 s, {rms:.3} m RMS, at most {level:.3} m beside, {height:.3} m above or below"
        );
        assert_eq!(world.aircraft.phase(), Phase::Running);
        assert!(rms < 0.15 && level < 0.35 && height < 0.30, "seed {seed}");
    }
    println!("END");
}

#[test]
fn eight_states_hover_without_a_position_source() {
    let mut world = World::flying(1, StateSet::Reduced);
    let (mut height, mut tilt) = (0.0_f64, 0.0_f64);
    world.pass(20.0, |craft| {
        let [_, _, z, psi, phi, ..] = craft.motion().states();
        height = height.max((z - 1.0).abs());
        tilt = tilt.max(psi.abs()).max(phi.abs());
    });
    println!(
        "FIGURES\neight states, barometer only, 20 s: at most {height:.3} m above or below, tilt {tilt:.3} rad\nEND"
    );
    assert_eq!(world.aircraft.phase(), Phase::Running);
    assert!(height < 0.5 && tilt < 0.2, "{height} {tilt}");
}

#[test]
fn a_metre_aside_is_reached_and_kept() {
    let mut world = World::flying(2, StateSet::Full);
    assert!(!world.aircraft.go_to(Vector3::new(f64::NAN, 0.0, 1.0), 0.0));
    let theta = world.aircraft.uquad.setpoint().state[5];
    assert!(world.aircraft.go_to(Vector3::new(1.0, 0.0, 1.0), theta));
    world.pass(5.0, |_| {});
    let mut worst = 0.0_f64;
    world.pass(5.0, |craft| {
        worst = worst.max((craft.motion().position_m - Vector3::new(1.0, 0.0, 1.0)).norm());
    });
    println!(
        "FIGURES\n1 m aside through bytes: kept within {worst:.3} m, {:?}\nEND",
        world.aircraft.phase()
    );
    assert!(worst < 0.2, "{worst}");
}

#[test]
fn a_second_without_frames_stops_the_motors() {
    let mut world = World::flying(1, StateSet::Full);
    world.line_is_cut = true;
    world.pass(1.1, |_| {});
    assert_eq!(world.aircraft.phase(), Phase::Off(Off::ImuSilent));
    assert_eq!(world.bus.values(), [0; 4]);
}

#[test]
fn a_dead_driver_ends_the_flight_within_a_second() {
    let mut world = World::flying(1, StateSet::Full);
    world.driver = Driver::new(DriverConfig::default());
    for address in sim::esc_bus::ADDRESSES {
        world.bus.set_dead(address, true);
    }
    // Nothing acknowledges: the process is gone.
    let mut stopped_ms = None;
    for ms in 0..1000 {
        world.ms += 1;
        let now = Timestamp::from_ms(world.ms);
        let mut out: Vec<Received> = Vec::new();
        world.board.advance(now.us(), &mut out);
        let bytes: Vec<u8> = out.iter().map(|r| r.byte).collect();
        world.aircraft.bytes(now, &bytes, &mut |_| {});
        while world.aircraft.poll(now).is_some() {}
        if world.aircraft.phase() == Phase::Off(Off::DriverSilent) {
            stopped_ms.get_or_insert(ms);
        }
    }
    assert!(stopped_ms.is_some_and(|ms| ms <= 520), "{stopped_ms:?}");
    world.bus.advance(world.ms * 1000);
    assert_eq!(
        world.bus.values(),
        [0; 4],
        "speed controllers stop by themselves"
    );
}

#[test]
fn a_tilt_of_1_1_rad_for_21_samples_stops_the_motors_and_the_estimate_goes_on() {
    let mut world = World::flying(1, StateSet::Full);
    let mut tilted = world.last.unwrap();
    tilted.state[3] = 1.1;
    let now = Timestamp::from_ms(world.ms);
    for sample in 1..=21 {
        assert_eq!(world.aircraft.phase(), Phase::Running, "sample {sample}");
        world.aircraft.judge(now, &tilted);
    }
    assert_eq!(world.aircraft.phase(), Phase::Off(Off::Insane));
    let steps = world.steps;
    world.pass(1.0, |_| {});
    assert_eq!(world.bus.values(), [0; 4]);
    assert!(world.steps - steps >= 98, "the estimate goes on");
    assert!(!world.aircraft.take_off(now, 1.0), "off is off");
}

#[test]
fn no_take_off_before_the_calibration() {
    let mut world = World::new(1, StateSet::Full);
    assert!(!world.aircraft.take_off(Timestamp::ZERO, 1.0));
    world.pass(0.5, |_| {});
    assert_eq!(world.aircraft.phase(), Phase::Calibrating);
    assert_eq!(world.bus.values(), [0; 4]);
}

/// A frame of a craft at rest with a period of the board's clock.
fn frame_after(period_us: u32) -> [u8; 30] {
    estimator::imu::RawFrame {
        since_previous_us: period_us,
        accel: [0, 0, 256],
        gyro: [0, 0, 0],
        mag: [247, 0, -182],
        temperature_ddeg: 249,
        pressure_pa: 101_193,
    }
    .emit(b'A')
}

#[test]
fn a_gap_of_15_ms_is_clamped_and_logged_and_ten_stop_the_motors() {
    let mut world = World::flying(1, StateSet::Full);
    world.said.clear();
    let mut periods = Vec::new();
    let mut gaps = 0;
    while world.aircraft.phase() == Phase::Running && gaps < 12 {
        gaps += 1;
        world.ms += 15;
        let now = Timestamp::from_ms(world.ms);
        let mut said = Vec::new();
        let frame = frame_after(15_000);
        let step = world.aircraft.bytes(now, &frame, &mut |s| said.push(s));
        while world.aircraft.poll(now).is_some() {}
        periods.extend(said.into_iter().filter(|s| matches!(s, Said::Period(_))));
        if gaps < 10 {
            assert!(step.is_some(), "gap {gaps}: it flies on");
        }
    }
    let said: Vec<String> = periods.iter().map(ToString::to_string).collect();
    assert_eq!(
        said,
        [
            "sampling period of 15.0 ms instead of 8-12 ms (1 of 10 errors)",
            "sampling period of 15.0 ms instead of 8-12 ms (10 of 10 errors)",
        ],
        "the first and the tenth"
    );
    assert!(gaps >= 10, "{gaps} gaps");
    assert_eq!(world.aircraft.phase(), Phase::Off(Off::Timing));
}

#[test]
#[allow(
    clippy::disallowed_methods,
    reason = "what a frame costs is what is measured"
)]
fn from_frame_to_motor_message_takes_less_than_a_millisecond() {
    use rustix::time::{ClockId, clock_gettime};
    // Processor time of this thread: what other programs take from it is not the loop's.
    let spent_us = || {
        let t = clock_gettime(ClockId::ThreadCPUTime);
        t.tv_sec as f64 * 1e6 + t.tv_nsec as f64 * 1e-3
    };
    let mut world = World::flying(1, StateSet::Full);
    let mut took = Vec::new();
    for n in 0..3000_u64 {
        world.ms += 10;
        let now = Timestamp::from_ms(world.ms);
        let frame = frame_after(10_000);
        if n % 10 == 0 {
            world.aircraft.fix(Vector3::new(0.0, 0.0, 1.0));
        }
        let began = spent_us();
        world.aircraft.bytes(now, &frame, &mut |_| {});
        let message = world.aircraft.poll(now);
        took.push(spent_us() - began);
        if let Some(ack) = message.and_then(|m| world.driver.handle(now, &m)) {
            world.aircraft.acknowledged(&ack);
        }
    }
    took.sort_by(f64::total_cmp);
    let at = |share: f64| took[((took.len() - 1) as f64 * share) as usize];
    println!(
        "FIGURES\nIMU frame to motor message, processor time: p50 {:.0} us, p99 {:.0} us, p99.9 {:.0} us (bar 1000)\nEND",
        at(0.5),
        at(0.99),
        at(0.999)
    );
    assert!(at(0.999) <= 1000.0);
}
