//! The firmware: samples on a fixed grid, sends in the background, listens.

use super::bmp085::Barometer;
use super::chips;
use super::line::{self, Sample, Switches};
use arrayvec::ArrayVec;
use embedded_hal::i2c::I2c;

/// Sampling period, us.
pub const PERIOD_US: u64 = 10_000;
/// Frames that are held back at most until the barometer has measured: a start with zeros would be a wrong reference for the host.
const PATIENCE: u8 = 5;
/// Frames between two readings of the magnetometer.
const MAG_EVERY: u8 = 7;
/// Bytes that wait for the transmitter: two of the longest lines.
const QUEUE: usize = 448;

/// What the board is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// Chips are not set up yet.
    Reset,
    /// Sends frames.
    Run {
        /// When the next sample is due.
        next_us: u64,
        /// When the last one was taken.
        last_us: Option<u64>,
    },
    /// Shows the menu.
    Menu,
}

/// What the board has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardStats {
    /// Frames put on the line.
    pub frames: u32,
    /// Frames dropped because the line was still busy.
    pub dropped: u32,
    /// Transfers that a chip did not answer; its last values were sent.
    pub bus_errors: u32,
    /// Sampling times missed altogether: the main loop was away.
    pub missed: u32,
}

/// The firmware of the inertial unit. Nothing in it waits or allocates.
#[derive(Clone, Debug)]
pub struct Board {
    mode: Mode,
    switches: Switches,
    alternates: bool,
    sample: Sample,
    barometer: Barometer,
    until_mag: u8,
    held_back: u8,
    is_odd: bool,
    queue: ArrayVec<u8, QUEUE>,
    sent: usize,
    command: Option<u8>,
    stats: BoardStats,
}

impl Board {
    /// Out of reset: it sets its chips up and runs. With `alternates` every other frame starts with `C`.
    #[must_use]
    pub fn new(alternates: bool) -> Self {
        Self {
            mode: Mode::Reset,
            switches: Switches::default(),
            alternates,
            sample: Sample::default(),
            barometer: Barometer::default(),
            until_mag: 0,
            held_back: 0,
            is_odd: false,
            queue: ArrayVec::new(),
            sent: 0,
            command: None,
            stats: BoardStats::default(),
        }
    }

    /// What the board has seen.
    #[must_use]
    pub const fn stats(&self) -> &BoardStats {
        &self.stats
    }

    /// The main loop: samples when it is time. True if it did.
    pub fn poll<B: I2c>(&mut self, now_us: u64, bus: &mut B) -> bool {
        match self.mode {
            Mode::Menu => false,
            Mode::Reset => {
                let is_up = chips::set_up(bus).is_ok() && self.barometer.set_up(bus).is_ok();
                self.stats.bus_errors += u32::from(!is_up);
                // A dead chip must not silence the others.
                self.run(now_us);
                false
            }
            Mode::Run { next_us, .. } if now_us < next_us => false,
            Mode::Run { next_us, last_us } => {
                // On the grid again, however late; what was missed is not made up for.
                let missed = (now_us - next_us) / PERIOD_US;
                self.stats.missed = self.stats.missed.saturating_add(missed as u32);
                self.mode = Mode::Run {
                    next_us: next_us + (missed + 1) * PERIOD_US,
                    last_us: Some(now_us),
                };
                let since = last_us.map_or(PERIOD_US, |last| now_us - last);
                self.sample.since_previous_us = u32::try_from(since).unwrap_or(u32::MAX);
                self.measure(now_us, bus);
                if self.barometer.pressure_pa == 0 && self.held_back < PATIENCE {
                    self.held_back += 1;
                } else {
                    self.send_frame();
                }
                true
            }
        }
    }

    const fn run(&mut self, now_us: u64) {
        self.mode = Mode::Run {
            next_us: now_us + PERIOD_US,
            last_us: None,
        };
    }

    fn measure<B: I2c>(&mut self, now_us: u64, bus: &mut B) {
        let on = self.switches;
        let (sample, stats) = (&mut self.sample, &mut self.stats);
        let mut keep =
            |value: Result<[i16; 3], B::Error>, is_on: bool, to: &mut [i16; 3]| match value {
                Ok(v) => *to = if is_on { v } else { [0; 3] },
                Err(_) => stats.bus_errors = stats.bus_errors.saturating_add(1),
            };
        // Switched off chips are read too: the line's timing stays the same.
        keep(chips::accel(bus), on.accel, &mut sample.accel);
        keep(chips::gyro(bus), on.gyro, &mut sample.gyro);
        if self.until_mag == 0 {
            keep(chips::mag(bus), on.mag, &mut sample.mag);
            self.until_mag = MAG_EVERY;
        }
        self.until_mag -= 1;
        if self.barometer.poll(now_us, bus).is_err() {
            self.stats.bus_errors = self.stats.bus_errors.saturating_add(1);
        }
        let b = &self.barometer;
        self.sample.temperature_ddeg = if on.temperature {
            b.temperature_ddeg
        } else {
            0
        };
        self.sample.pressure_pa = if on.pressure { b.pressure_pa } else { 0 };
    }

    fn send_frame(&mut self) {
        let start = if self.alternates && self.is_odd {
            b'C'
        } else {
            b'A'
        };
        self.is_odd = !self.is_odd;
        let has_room = if self.switches.is_text {
            self.send(self.sample.text(start).as_bytes())
        } else {
            self.send(&self.sample.binary(start))
        };
        if has_room {
            self.stats.frames = self.stats.frames.saturating_add(1);
        } else {
            self.stats.dropped = self.stats.dropped.saturating_add(1);
        }
    }

    /// Queues all of it or nothing.
    fn send(&mut self, bytes: &[u8]) -> bool {
        if self.sent > 0 {
            self.queue.drain(..self.sent);
            self.sent = 0;
        }
        self.queue.try_extend_from_slice(bytes).is_ok()
    }

    /// The transmitter is empty: the next byte, if there is one.
    pub fn transmit(&mut self) -> Option<u8> {
        let byte = self.queue.get(self.sent).copied()?;
        self.sent += 1;
        Some(byte)
    }

    /// A byte was received.
    pub fn receive(&mut self, now_us: u64, byte: u8) {
        if byte != b'\n' && byte != b'\r' {
            self.command = Some(byte);
            return;
        }
        if let Some(command) = self.command.take() {
            self.obey(now_us, command);
        }
    }

    fn obey(&mut self, now_us: u64, command: u8) {
        let is_menu = self.mode == Mode::Menu;
        match command {
            b'!' => {
                self.switches = Switches::default();
                self.run(now_us);
            }
            b'#' if is_menu => self.run(now_us),
            b'$' => {
                self.mode = Mode::Menu;
                self.show_menu();
            }
            b'7' if is_menu => {
                let text = line::barometer(&self.barometer.constants);
                self.send(text.as_bytes());
            }
            b'1'..=b'6' if is_menu => {
                let s = &mut self.switches;
                let switch = match command {
                    b'1' => &mut s.is_text,
                    b'2' => &mut s.accel,
                    b'3' => &mut s.gyro,
                    b'4' => &mut s.mag,
                    b'5' => &mut s.temperature,
                    _ => &mut s.pressure,
                };
                *switch = !*switch;
                self.show_menu();
            }
            _ => {}
        }
    }

    fn show_menu(&mut self) {
        let text = line::menu(&self.switches);
        self.send(text.as_bytes());
    }
}
