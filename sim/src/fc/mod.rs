//! A flight controller that speaks MSP bytes and flies like Betaflight, INAV, Cleanflight or MultiWii in ANGLE mode.
//!
//! It keeps the manners that were measured on real firmware: one command per run of its serial task, a boot grace, an
//! arm switch that latches, steps from the first missing RC frame to failsafe, motors that a test keeps turning, `!` for
//! what it does not know, settings that only EEPROM_WRITE keeps and only a restart brings into force. What differs from
//! firmware to firmware is in the table of [`Manner`].
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`manner`] | the firmwares as rows of a table |
//! | `uart` | bytes that take their time |
//! | `settings` | what a configurator reads and writes |
//! | `receiver` | sticks by MSP and by the pilot's radio, their freshness, override |
//! | `cli` | the text command line behind `#` |
//! | `arming` | causes, latch, failsafe |
//! | `estimate` | attitude without a compass |
//! | `stabilizer` | angle mode, rate loops, mixer |
//! | `answers` | questions: the scale factors and axis flips of this boundary |
//! | `orders` | everything that sets or starts something |

mod answers;
pub(crate) mod arming;
mod cli;
pub(crate) mod estimate;
pub mod manner;
mod orders;
mod receiver;
mod settings;
mod stabilizer;
pub(crate) mod uart;

use crate::quad::Quad;
use crate::sensor::{BARO_STEP_S, Baro, Imu, Mag, MagneticField};
use arming::{Arming, Situation};
use cli::Cli;
use core::time::Duration;
use estimate::Estimate;
use manner::Table;
use msp::Server;
use receiver::{Mixing, Receiver};
use serde::{Deserialize, Serialize};
use settings::{Settings, Source};
use stabilizer::{Command, Stabilizer};
use std::sync::Arc;
use uart::Uart;
use vehicle::{Pace, Timestamp};

/// A reboot takes this long; the controller is silent meanwhile.
const REBOOT: Duration = Duration::from_millis(1500);
/// Saving takes this long; the controller is deaf meanwhile.
const SAVE: Duration = Duration::from_millis(300);
/// What a busy controller carries out a second.
const BUSY_HZ: f64 = 40.0;
/// How wrong the roll is that an askew one tells, rad.
const ASKEW_RAD: f64 = 15.0 * core::f64::consts::PI / 180.0;
/// Frames of the pilot's radio a second.
const RADIO_HZ: f64 = 50.0;

pub use manner::Manner;
pub use receiver::Radio;
pub use settings::Delivery;

/// Settings of the fake flight controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FcConfig {
    /// Which firmware it pretends to be.
    pub manner: Manner,
    /// Its settings at the start.
    pub delivery: Delivery,
    /// `msp_override_channels_mask`: channels that MSP takes beside a radio while the override box is on; bit 0 roll, 1
    /// pitch, 2 yaw, 3 throttle, 4 Aux1 ... 15 = the sticks.
    pub override_mask: u32,
    /// `serial_update_rate_hz`: MSP commands it handles a second, 100..=2000 in Betaflight, 100 unless changed.
    /// More than 1000 count as 1000: the simulator's step is a millisecond.
    pub serial_rate_hz: u32,
    /// Speed of the UART, bits a second.
    pub baud: u32,
    /// Whether it has a magnetometer. It is only reported: the controller's own heading stays that of its gyro, as one sets
    /// it up for flight between steel.
    pub mag: bool,
}

impl Default for FcConfig {
    fn default() -> Self {
        Self {
            manner: Manner::default(),
            delivery: Delivery::default(),
            override_mask: 15,
            serial_rate_hz: 100,
            baud: 115_200,
            mag: true,
        }
    }
}

/// The fake flight controller.
#[derive(Clone, Debug)]
pub(crate) struct FlightController {
    config: FcConfig,
    table: &'static Table,
    server: Server,
    uart: Uart,
    serial_task: Pace,
    silent_until: Timestamp,
    receiver: Receiver,
    arming: Arming,
    estimate: Estimate,
    /// Added to the roll that is told, rad.
    askew_rad: f64,
    stabilizer: Stabilizer,
    imu: Imu,
    baro: Baro,
    mag: Option<Mag>,
    baro_task: Pace,
    radio: Option<Radio>,
    hears_radio: bool,
    radio_pace: Pace,
    cli: Cli,
    /// What runs, and what the eeprom holds.
    settings: Settings,
    saved: Settings,
    /// Where sticks come from since the last start.
    source: Source,
    /// Motor test by MSP_SET_MOTOR, us; stays until changed.
    motor_test_us: [u16; 4],
    motors: [f64; 4],
    /// Answers are built here.
    payload: Vec<u8>,
    batch: Vec<u8>,
}

impl FlightController {
    pub(crate) fn new(
        config: FcConfig,
        seed: u64,
        vehicle: usize,
        quad: &Quad,
        field: &Arc<MagneticField>,
    ) -> Self {
        let table = config.manner.table();
        let settings = Settings::new(table, &config);
        let source = settings.source(table);
        Self {
            config,
            table,
            server: Server::new(),
            uart: Uart::new(config.baud),
            serial_task: Pace::hz(f64::from(settings.serial_rate_hz.max(1))),
            silent_until: Timestamp::ZERO,
            receiver: Receiver::new(&table.receiver, table.beside_radio, source),
            arming: Arming::new(Timestamp::ZERO, &table.arming),
            estimate: Estimate::new(seed, vehicle, quad.attitude().yaw()),
            askew_rad: 0.0,
            stabilizer: Stabilizer::default(),
            imu: Imu::new(seed, vehicle),
            baro: Baro::new(seed, vehicle, quad.height_m()),
            mag: config
                .mag
                .then(|| Mag::new(seed, vehicle, Arc::clone(field))),
            baro_task: Pace::hz(1.0 / BARO_STEP_S),
            radio: None,
            hears_radio: false,
            radio_pace: Pace::hz(RADIO_HZ),
            cli: Cli::default(),
            saved: settings.clone(),
            settings,
            source,
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
        self.receive_radio(now);
        self.update_arming(now, quad);
        self.motors = self.drive(quad);
        self.motors
    }

    fn serve(&mut self, now: Timestamp, quad: &Quad) {
        while let Some(byte) = self.uart.receive(now) {
            if self.cli.is_open {
                self.type_cli(now, byte);
            } else if byte == b'#' && !self.server.has_partial() {
                self.open_cli();
            } else {
                self.server.handle(&[byte]);
            }
        }
        if !self.cli.out.is_empty() {
            let out = core::mem::take(&mut self.cli.out);
            self.uart.send(now, out.as_bytes());
        }
        // One command per run, however many wait.
        if !self.cli.is_open
            && let Some(request) = self.server.pop()
        {
            self.carry_out(now, &request, quad);
            self.uart.send(now, self.server.output());
            self.server.clear_output();
        }
    }

    /// Hears the pilot and mixes their sticks with those of MSP.
    fn receive_radio(&mut self, now: Timestamp) {
        if let Some(radio) = &self.radio
            && self.radio_pace.is_due(now)
        {
            self.receiver.hear(now, radio);
        }
        let id = msp::firmware::box_id::MSP_OVERRIDE;
        let box_on = self.is_box_on(id);
        let ranges = &self.settings.mode_ranges;
        let range = ranges.iter().find(|r| r.is_used() && r.permanent_id == id);
        let switch = range.map(|r| 4 + usize::from(r.aux));
        let rules = Mixing {
            mask: self.settings.override_mask,
            box_on,
            switch,
            without_signal: &self.settings.without_signal,
        };
        self.receiver.update(now, &rules);
        self.hears_radio = self.receiver.signal(now);
    }

    fn update_arming(&mut self, now: Timestamp, quad: &Quad) {
        let was_armed = self.arming.is_armed();
        let failsafe = &self.settings.failsafe;
        let delay = Duration::from_millis(100 * u64::from(failsafe.delay_ds));
        let blocking = self.table.arming.blocking_boxes.iter();
        let blocking_boxes = blocking
            .filter(|(id, _)| self.is_box_on(*id))
            .fold(0, |bits, (_, bit)| bits | bit);
        self.arming.update(&Situation {
            now,
            arm_switch: self.is_box_on(msp::firmware::box_id::ARM),
            throttle_low: self.receiver.channels_us()[3] < self.settings.rx.min_check_us,
            tilt_cos: quad.tilt_cos(),
            receiver_ok: self.receiver.is_ok(now),
            receiver_lost: self.receiver.is_lost(now, delay),
            failsafe_drops: failsafe.procedure != 0,
            landing: Duration::from_millis(100 * u64::from(failsafe.landing_time)),
            needs_reboot: self.needs_reboot(),
            in_cli: self.cli.is_open,
            blocking_boxes,
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
        let rules = &self.table.sticks;
        let min_check_us = self.settings.rx.min_check_us;
        let mut command = Command {
            sticks: self.receiver.sticks(min_check_us),
            angle_mode: self.is_box_on(msp::firmware::box_id::ANGLE),
            rules,
        };
        if self.arming.is_failsafe() {
            // Landing blindly: level, at the throttle of the failsafe configuration.
            let low = f64::from(min_check_us);
            let range = (2000.0 - low).max(1.0);
            let lift = (f64::from(self.settings.failsafe.throttle_us) - low) / range;
            command.sticks = [0.0, 0.0, 0.0, lift.clamp(0.0, 1.0)];
            command.angle_mode = true;
        }
        let (roll, pitch) = (self.estimate.roll(), self.estimate.pitch());
        let motors = self.stabilizer.step(&command, roll, pitch, &quad.rates());
        let [idle, full] = rules.motors;
        motors.map(|m| m.clamp(idle, full))
    }

    /// Whether a switch selects the box.
    fn is_box_on(&self, permanent_id: u8) -> bool {
        let aux_us = &self.receiver.channels_us()[4..];
        self.settings.mode_ranges.iter().any(|range| {
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

    /// Carries out fewer commands from now on, or as many as it is set to.
    pub(crate) fn be_busy(&mut self, is_busy: bool) {
        let usual_hz = f64::from(self.settings.serial_rate_hz.max(1));
        let hz = if is_busy {
            BUSY_HZ.min(usual_hz)
        } else {
            usual_hz
        };
        self.serial_task = Pace::hz(hz);
    }

    /// Tells a wrong roll from now on, or the true one again.
    pub(crate) const fn tell_askew(&mut self, is_askew: bool) {
        self.askew_rad = if is_askew { ASKEW_RAD } else { 0.0 };
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

    /// What the loops fly.
    pub(crate) const fn used_sticks_us(&self) -> [u16; 4] {
        let [roll, pitch, yaw, throttle, ..] = *self.receiver.channels_us();
        [roll, pitch, yaw, throttle]
    }

    /// The pilot's transmitter: switched on with these sticks, moved, or off.
    pub(crate) const fn set_radio(&mut self, radio: Option<Radio>) {
        self.radio = radio;
    }

    /// Settings wait for a restart.
    fn needs_reboot(&self) -> bool {
        self.settings.source(self.table) != self.source
    }

    fn save(&mut self, now: Timestamp) {
        self.saved = self.settings.clone();
        self.silent_until = now + SAVE;
    }

    fn reboot(&mut self, now: Timestamp) {
        self.silent_until = now + REBOOT;
        self.uart.clear();
        self.server = Server::new();
        self.settings = self.saved.clone();
        self.source = self.settings.source(self.table);
        self.serial_task = Pace::hz(f64::from(self.settings.serial_rate_hz.max(1)));
        self.arming = Arming::new(now, &self.table.arming);
        self.receiver = Receiver::new(&self.table.receiver, self.table.beside_radio, self.source);
        self.motor_test_us = [1000; 4];
        self.cli = Cli::default();
    }
}
