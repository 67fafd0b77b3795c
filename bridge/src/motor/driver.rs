//! The bus's side: takes messages, keeps four speed controllers turning.
//!
//! | State | On the bus | Leaves |
//! | --- | --- | --- |
//! | stopped | speed 0 to all, each 2 ms | all four asked for more than 45: enabling |
//! | enabling | enable (0xA0) to all, at most 100 times, 0.4 ms apart | all answered: waiting; else stopped, reported |
//! | waiting | nothing for 420 ms | ramp |
//! | ramp | for r = 30..=49: 2 r writes 1235 us apart, r + 25, every seventh r - 25: the jitter breaks the rotors free | running |
//! | running | speed (0xA2) + offset, each 2 ms | one motor asked for 0, or silence: stopping |
//! | stopping | speed 0 and disable (0xA1) to all, at most 1000 times | all answered: stopped; else aborted |
//! | aborted | nothing: the speed controllers stop by themselves | - |
//!
//! A message with a value above 220 is refused whole: the old order stays, nothing is acknowledged. A write that fails is an error, a round without one takes
//! an error back; more than 20 abort. All four are written even when one does not answer.

use super::units::{MAX_UNITS, START_ABOVE_UNITS};
use arrayvec::ArrayVec;
use core::fmt;
use embedded_hal::i2c::I2c;
use std::time::Duration;
use vehicle::Timestamp;

/// Speed controllers in the driver's order.
pub const ADDRESSES: [u8; 4] = [0x69, 0x6a, 0x6b, 0x68];
/// Register: begin to turn.
pub const ENABLE: u8 = 0xa0;
/// Register: brake.
pub const DISABLE: u8 = 0xa1;
/// Register: speed.
pub const SPEED: u8 = 0xa2;

const LOOP: Duration = Duration::from_millis(2);
const ENABLE_AGAIN: Duration = Duration::from_micros(400);
const ENABLE_TRIES: u32 = 100;
const WAIT: Duration = Duration::from_millis(420);
const RAMP: core::ops::Range<u8> = 30..50;
const RAMP_STEP: Duration = Duration::from_micros(1235);
const JITTER: u8 = 25;
const JITTER_EACH: u16 = 7;
const STOP_TRIES: u32 = 1000;
const MAX_ERRORS: u32 = 20;
const AFTER_ERROR: Duration = Duration::from_millis(10);

/// How the driver works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverConfig {
    /// Added to what a turning motor is sent, driver's order: the four speed controllers of the thesis are not alike.
    pub offsets: [i8; 4],
    /// No message for so long: motors stop. (The thesis's driver goes on for ever.)
    pub silence: Duration,
}

impl Default for DriverConfig {
    /// The thesis's craft, and half a second of silence.
    fn default() -> Self {
        Self {
            offsets: [15, 15, -18, -9],
            silence: Duration::from_millis(500),
        }
    }
}

/// What the driver is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriverState {
    /// Motors stand.
    Stopped,
    /// Waking the speed controllers.
    Enabling {
        /// How often that failed.
        tries: u32,
    },
    /// Before the ramp.
    Waiting,
    /// Breaking the rotors free.
    Ramp {
        /// Centre of the jitter.
        level: u8,
        /// Writes at this level.
        write: u16,
    },
    /// Sending what was ordered.
    Running,
    /// Until every speed controller has acknowledged.
    Stopping {
        /// How often that failed.
        tries: u32,
        /// Ends in aborted: too many errors.
        is_last: bool,
    },
    /// Too many errors, or a stop that was not acknowledged.
    Aborted,
}

/// What there is to say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriverEvent {
    /// More than 20 errors, or a stop that failed 1000 times.
    Aborted,
    /// A message of another length.
    BadMessage {
        /// Bytes.
        length: usize,
    },
    /// A speed controller did not take a write; said when it begins.
    BusError {
        /// Its address.
        address: u8,
    },
    /// A value above 220; the old order stays.
    OutOfRange {
        /// Position in the message, from 0.
        position: usize,
        /// The value.
        value: u8,
    },
    /// The ramp is over.
    Running,
    /// Nothing was ordered for too long: stopping.
    Silence,
    /// A speed controller was not there after 100 tries: not started.
    StartFailed,
    /// The motors begin to turn.
    Starting,
    /// The motors stand.
    Stopped,
}

impl fmt::Display for DriverEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Aborted => f.write_str(
                "the motor driver gives up: too many errors on the bus; motors stop by themselves",
            ),
            Self::BadMessage { length } => {
                write!(f, "a message of {length} bytes: four are needed")
            }
            Self::BusError { address } => {
                write!(f, "speed controller 0x{address:02x} does not answer")
            }
            Self::OutOfRange { position, value } => write!(
                f,
                "value {value} at {position} is above {MAX_UNITS}: refused, the old order stays"
            ),
            Self::Running => f.write_str("motors turn as ordered"),
            Self::Silence => f.write_str("no order for too long: motors stop"),
            Self::StartFailed => {
                f.write_str("not started: a speed controller did not answer 100 times")
            }
            Self::Starting => f.write_str("motors start"),
            Self::Stopped => f.write_str("motors stand"),
        }
    }
}

/// The state machine. Hand it messages, and the bus at [`deadline`](Self::deadline); then [`event`](Self::event) until none.
#[derive(Clone, Debug)]
pub struct Driver {
    config: DriverConfig,
    state: DriverState,
    /// Driver's order.
    wanted: [u8; 4],
    heard_at: Timestamp,
    due: Timestamp,
    errors: u32,
    ack: u8,
    silent_chips: [bool; 4],
    events: ArrayVec<DriverEvent, 16>,
}

impl Driver {
    /// Motors stand.
    #[must_use]
    pub const fn new(config: DriverConfig) -> Self {
        Self {
            config,
            state: DriverState::Stopped,
            wanted: [0; 4],
            heard_at: Timestamp::ZERO,
            due: Timestamp::ZERO,
            errors: 0,
            ack: 0,
            silent_chips: [false; 4],
            events: ArrayVec::new_const(),
        }
    }

    /// Takes a message; answers what goes back.
    pub fn handle(&mut self, now: Timestamp, message: &[u8]) -> Option<[u8; 4]> {
        if self.state == DriverState::Aborted {
            return None;
        }
        let Ok(wanted) = <[u8; 4]>::try_from(message) else {
            self.say(DriverEvent::BadMessage {
                length: message.len(),
            });
            return None;
        };
        if let Some(position) = wanted.iter().position(|&v| v > MAX_UNITS) {
            self.say(DriverEvent::OutOfRange {
                position,
                value: wanted[position],
            });
            return None;
        }
        self.wanted = wanted;
        self.heard_at = now;
        self.follow(now);
        let counter = self.ack;
        self.ack = self.ack.wrapping_add(1);
        Some([b'A', b'C', b'K', counter])
    }

    /// What an order means in this state.
    fn follow(&mut self, now: Timestamp) {
        let is_start = self.wanted.iter().all(|&v| v > START_ABOVE_UNITS);
        let is_stop = self.wanted.contains(&0);
        match self.state {
            DriverState::Stopped if is_start => {
                self.say(DriverEvent::Starting);
                self.enter(DriverState::Enabling { tries: 0 }, now);
            }
            DriverState::Enabling { .. }
            | DriverState::Waiting
            | DriverState::Ramp { .. }
            | DriverState::Running
                if is_stop =>
            {
                self.begin_stop(now, false);
            }
            _ => {}
        }
    }

    /// Does on the bus what is due.
    pub fn poll<B: I2c>(&mut self, now: Timestamp, bus: &mut B) {
        let is_turning = !matches!(
            self.state,
            DriverState::Stopped | DriverState::Stopping { .. } | DriverState::Aborted
        );
        if is_turning && now.since(self.heard_at) > self.config.silence {
            self.say(DriverEvent::Silence);
            self.begin_stop(now, false);
        }
        if now < self.due {
            return;
        }
        match self.state {
            DriverState::Aborted => {}
            DriverState::Stopped => self.round(now, bus, [0; 4], LOOP),
            DriverState::Running => {
                let speeds = core::array::from_fn(|i| {
                    self.wanted[i].saturating_add_signed(self.config.offsets[i])
                });
                self.round(now, bus, speeds, LOOP);
            }
            DriverState::Enabling { tries } => self.enable(now, bus, tries),
            DriverState::Waiting => {
                let ramp = DriverState::Ramp {
                    level: RAMP.start,
                    write: 0,
                };
                self.enter(ramp, now);
                self.poll(now, bus);
            }
            DriverState::Ramp { level, write } => self.ramp(now, bus, level, write),
            DriverState::Stopping { tries, is_last } => self.try_stop(now, bus, tries, is_last),
        }
    }

    fn enable<B: I2c>(&mut self, now: Timestamp, bus: &mut B, tries: u32) {
        if self.write_all(bus, ENABLE, [0; 4]) {
            self.enter(DriverState::Waiting, now + WAIT);
        } else if tries + 1 == ENABLE_TRIES {
            self.say(DriverEvent::StartFailed);
            self.begin_stop(now, false);
        } else {
            let again = DriverState::Enabling { tries: tries + 1 };
            self.enter(again, now + ENABLE_AGAIN);
        }
    }

    fn ramp<B: I2c>(&mut self, now: Timestamp, bus: &mut B, level: u8, write: u16) {
        let value = if write.is_multiple_of(JITTER_EACH) {
            level - JITTER
        } else {
            level + JITTER
        };
        let next = if write + 1 < 2 * u16::from(level) {
            DriverState::Ramp {
                level,
                write: write + 1,
            }
        } else if level + 1 < RAMP.end {
            DriverState::Ramp {
                level: level + 1,
                write: 0,
            }
        } else {
            self.say(DriverEvent::Running);
            DriverState::Running
        };
        self.state = next;
        self.round(now, bus, [value; 4], RAMP_STEP);
    }

    fn try_stop<B: I2c>(&mut self, now: Timestamp, bus: &mut B, tries: u32, is_last: bool) {
        let is_slow = self.write_all(bus, SPEED, [0; 4]);
        let is_disabled = self.write_all(bus, DISABLE, [0; 4]);
        if is_slow && is_disabled && !is_last {
            self.say(DriverEvent::Stopped);
            self.enter(DriverState::Stopped, now + LOOP);
        } else if (is_slow && is_disabled) || tries + 1 == STOP_TRIES {
            self.say(DriverEvent::Aborted);
            self.enter(DriverState::Aborted, now);
        } else {
            let again = DriverState::Stopping {
                tries: tries + 1,
                is_last,
            };
            self.enter(again, now + LOOP);
        }
    }

    /// One write of speeds to all; late rounds are skipped, never made up in a burst.
    fn round<B: I2c>(&mut self, now: Timestamp, bus: &mut B, speeds: [u8; 4], period: Duration) {
        if self.write_all(bus, SPEED, speeds) {
            self.errors = self.errors.saturating_sub(1);
            let next = self.due + period;
            self.due = if next > now { next } else { now + period };
            return;
        }
        self.errors += 1;
        self.due = now + AFTER_ERROR;
        if self.errors > MAX_ERRORS {
            self.begin_stop(now, true);
        }
    }

    /// True when all four took it.
    fn write_all<B: I2c>(&mut self, bus: &mut B, register: u8, values: [u8; 4]) -> bool {
        let mut is_all = true;
        for (i, address) in ADDRESSES.into_iter().enumerate() {
            let is_silent = bus.write(address, &[register, values[i]]).is_err();
            if is_silent && !self.silent_chips[i] {
                self.say(DriverEvent::BusError { address });
            }
            self.silent_chips[i] = is_silent;
            is_all &= !is_silent;
        }
        is_all
    }

    fn begin_stop(&mut self, now: Timestamp, is_last: bool) {
        self.wanted = [0; 4];
        self.enter(DriverState::Stopping { tries: 0, is_last }, now);
    }

    fn enter(&mut self, state: DriverState, due: Timestamp) {
        self.state = state;
        self.due = due;
    }

    fn say(&mut self, event: DriverEvent) {
        // Sixteen unheard events: what is newer says nothing else.
        let _ = self.events.try_push(event);
    }

    /// What there is to say, oldest first.
    pub fn event(&mut self) -> Option<DriverEvent> {
        self.events.pop_at(0)
    }

    /// When the bus is due; none once aborted.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        (self.state != DriverState::Aborted).then_some(self.due)
    }

    /// What it is doing.
    #[must_use]
    pub const fn state(&self) -> DriverState {
        self.state
    }
}

#[cfg(test)]
mod tests;
