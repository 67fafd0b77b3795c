//! A flight controller that speaks MSP bytes and flies like Betaflight in ANGLE mode.
//!
//! It keeps the manners that were measured on Betaflight 4.6: one command per run of its serial task, 5 s of boot grace, an
//! arm switch that latches, 0.15 / 0.30 / 1.5 s until a silent receiver is flagged, dropped and disarmed, motors that a test
//! keeps turning, `!` for what it does not know.
//!
//! | Module | Holds |
//! | --- | --- |
//! | `uart` | bytes that take their time |
//! | `receiver` | sticks by MSP and their freshness |
//! | `arming` | blockers, latch, failsafe |
//! | `estimate` | attitude without a compass |
//! | `stabilizer` | angle mode, rate loops, mixer |
//! | `answers` | questions: the scale factors and axis flips of this boundary |
//! | `orders` | everything that sets or starts something |

mod answers;
pub(crate) mod arming;
pub(crate) mod estimate;
mod orders;
mod receiver;
mod stabilizer;
pub(crate) mod uart;

use crate::quad::Quad;
use crate::sensor::{BARO_STEP_S, Baro, Imu};
use arming::{Arming, Situation};
use core::time::Duration;
use estimate::Estimate;
use msp::Server;
use msp::message::ModeRange;
use receiver::Receiver;
use serde::{Deserialize, Serialize};
use stabilizer::{Command, IDLE, Stabilizer};
use uart::Uart;
use vehicle::{Pace, Timestamp};

/// Throttle below this counts as low, us.
const MIN_CHECK_US: u16 = 1050;
/// A reboot takes this long; the controller is silent meanwhile.
const REBOOT: Duration = Duration::from_millis(1500);
/// Slots of MSP_MODE_RANGES.
const MODE_SLOTS: usize = 20;

/// Which firmware the flight controller pretends to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Firmware {
    /// Betaflight 4.5.1, MSP API 1.46.
    Betaflight45,
    /// Betaflight 4.6.0, MSP API 1.47.
    #[default]
    Betaflight46,
}

impl Firmware {
    const fn api_minor(self) -> u8 {
        match self {
            Self::Betaflight45 => 46,
            Self::Betaflight46 => 47,
        }
    }

    const fn version(self) -> (u8, u8, u8) {
        match self {
            Self::Betaflight45 => (4, 5, 1),
            Self::Betaflight46 => (4, 6, 0),
        }
    }

    /// Bits in `arming_disable`; the last one is ARM_SWITCH.
    const fn arming_disable_count(self) -> u8 {
        match self {
            Self::Betaflight45 => 26,
            Self::Betaflight46 => 29,
        }
    }
}

/// Settings of the fake flight controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FcConfig {
    /// Which firmware it pretends to be.
    pub firmware: Firmware,
    /// `serial_update_rate_hz`: MSP commands it handles a second, 100..=2000 in Betaflight, 100 unless changed.
    /// More than 1000 count as 1000: the simulator's step is a millisecond.
    pub serial_rate_hz: u32,
    /// Speed of the UART, bits a second.
    pub baud: u32,
}

impl Default for FcConfig {
    fn default() -> Self {
        Self {
            firmware: Firmware::default(),
            serial_rate_hz: 100,
            baud: 115_200,
        }
    }
}

/// The fake flight controller.
#[derive(Clone, Debug)]
pub(crate) struct FlightController {
    config: FcConfig,
    server: Server,
    uart: Uart,
    serial_task: Pace,
    silent_until: Timestamp,
    receiver: Receiver,
    arming: Arming,
    estimate: Estimate,
    stabilizer: Stabilizer,
    imu: Imu,
    baro: Baro,
    baro_task: Pace,
    mode_ranges: [ModeRange; MODE_SLOTS],
    features: u32,
    /// Motor test by MSP_SET_MOTOR, us; stays until changed.
    motor_test_us: [u16; 4],
    motors: [f64; 4],
    /// Answers are built here.
    payload: Vec<u8>,
    batch: Vec<u8>,
}

impl FlightController {
    pub(crate) fn new(config: FcConfig, seed: u64, vehicle: usize, quad: &Quad) -> Self {
        let mut mode_ranges = [ModeRange::default(); MODE_SLOTS];
        mode_ranges[0] = ModeRange::from_us(msp::firmware::box_id::ARM, 0, 1700, 2100);
        mode_ranges[1] = ModeRange::from_us(msp::firmware::box_id::ANGLE, 1, 900, 2100);
        Self {
            config,
            server: Server::new(),
            uart: Uart::new(config.baud),
            serial_task: Pace::hz(f64::from(config.serial_rate_hz.max(1))),
            silent_until: Timestamp::ZERO,
            receiver: Receiver::new(),
            arming: Arming::new(Timestamp::ZERO, config.firmware),
            estimate: Estimate::new(seed, vehicle, quad.attitude().yaw()),
            stabilizer: Stabilizer::default(),
            imu: Imu::new(seed, vehicle),
            baro: Baro::new(seed, vehicle, quad.height_m()),
            baro_task: Pace::hz(1.0 / BARO_STEP_S),
            mode_ranges,
            features: answers::FEATURES,
            motor_test_us: [1000; 4],
            motors: [0.0; 4],
            payload: Vec::with_capacity(512),
            batch: Vec::with_capacity(1024),
        }
    }

    /// One millisecond: sense, serve the serial line, arm or disarm, stabilise. Yields motor commands 0..=1.
    pub(crate) fn step(&mut self, now: Timestamp, quad: &Quad) -> [f64; 4] {
        self.imu.feel(quad.specific_force());
        self.estimate.step(&quad.attitude());
        if self.baro_task.is_due(now) {
            self.baro.step(quad.height_m(), quad.mean_speed());
        }
        if now < self.silent_until {
            // Nobody listens while it boots.
            while self.uart.receive(now).is_some() {}
        } else if self.serial_task.is_due(now) {
            self.serve(now, quad);
        }
        self.receiver.age(now);
        self.update_arming(now, quad);
        self.motors = self.drive(quad);
        self.motors
    }

    fn serve(&mut self, now: Timestamp, quad: &Quad) {
        while let Some(byte) = self.uart.receive(now) {
            self.server.handle(&[byte]);
        }
        // One command per run, however many wait.
        if let Some(request) = self.server.pop() {
            self.carry_out(now, &request, quad);
            self.uart.send(now, self.server.output());
            self.server.clear_output();
        }
    }

    fn update_arming(&mut self, now: Timestamp, quad: &Quad) {
        let was_armed = self.arming.is_armed();
        self.arming.update(&Situation {
            now,
            arm_switch: self.is_box_on(msp::firmware::box_id::ARM),
            throttle_low: self.receiver.channels_us()[3] < MIN_CHECK_US,
            tilt_cos: quad.tilt_cos(),
            receiver_ok: self.receiver.is_ok(now),
            receiver_lost: self.receiver.is_lost(now),
        });
        if self.arming.is_armed() && !was_armed {
            self.baro.zero();
            self.stabilizer = Stabilizer::default();
        }
    }

    fn drive(&mut self, quad: &Quad) -> [f64; 4] {
        if !self.arming.is_armed() {
            return self
                .motor_test_us
                .map(|us| (f64::from(us) - 1000.0).clamp(0.0, 1000.0) / 1000.0);
        }
        let command = Command {
            sticks: self.receiver.sticks(),
            angle_mode: self.is_box_on(msp::firmware::box_id::ANGLE),
        };
        let (roll, pitch) = (self.estimate.roll(), self.estimate.pitch());
        let motors = self.stabilizer.step(&command, roll, pitch, &quad.rates());
        motors.map(|m| m.clamp(IDLE, 1.0))
    }

    /// Whether a switch selects the box.
    fn is_box_on(&self, permanent_id: u8) -> bool {
        let aux_us = &self.receiver.channels_us()[4..];
        self.mode_ranges.iter().any(|range| {
            range.is_used()
                && range.permanent_id == permanent_id
                && aux_us
                    .get(usize::from(range.aux))
                    .is_some_and(|us| range.contains(*us))
        })
    }

    /// The companion computer writes to the UART.
    pub(crate) fn write(&mut self, now: Timestamp, bytes: &[u8]) {
        self.uart.write(now, bytes);
    }

    /// What has arrived at the companion computer.
    pub(crate) fn deliver(&mut self, now: Timestamp) -> Option<uart::Burst> {
        self.uart.deliver(now)
    }

    pub(crate) const fn is_armed(&self) -> bool {
        self.arming.is_armed()
    }

    /// The vehicle was carried to another heading.
    pub(crate) const fn carried(&mut self, yaw_rad: f64) {
        self.estimate.carried(yaw_rad);
    }

    fn reboot(&mut self, now: Timestamp) {
        self.silent_until = now + REBOOT;
        self.uart.clear();
        self.server = Server::new();
        self.arming = Arming::new(now, self.config.firmware);
        self.receiver = Receiver::new();
        self.motor_test_us = [1000; 4];
    }
}
