//! The real firmware in the loop, fed by the simulated body: Betaflight's simulator build as a child process, or an INAV that
//! somebody has started.
//!
//! | File | Does |
//! | --- | --- |
//! | [`find`](mod@find) | where the program is: given, or in the Python package `betaflight` |
//! | [`process`] | starts it in a folder of its own, starts it again when it ends, never leaves it behind |
//! | [`line`](mod@line) | Betaflight: states out, motors in, MSP by TCP |
//! | [`inav`] | INAV: the same by MSP on two of its ports |
//! | `pause` | stops the firmware while this program has no processor |
//! | `patience` | whether the world may go on while the firmware has not answered |
//!
//! What is in the packets: [`sim::firmware`].

pub mod find;
pub mod inav;
pub mod line;
mod patience;
mod pause;
pub mod process;

pub use find::{FindError, find};
pub use inav::InavLine;
pub use line::FirmwareLine;
pub use process::{Firmware, StartError};

use crate::autopilot::io::Input;
use sim::Simulator;
use std::collections::VecDeque;
use vehicle::Timestamp;

/// A firmware in place of the fake controller.
#[derive(Debug)]
pub enum Outside {
    /// Betaflight.
    Betaflight(Box<FirmwareLine>),
    /// INAV.
    Inav(Box<InavLine>),
}

impl Outside {
    /// After each step of the simulation: the newest motor commands in, the state out, bytes of the UART to the inputs.
    pub fn exchange(
        &mut self,
        now: Timestamp,
        simulator: &mut Simulator,
        inputs: &mut VecDeque<Input>,
    ) {
        match self {
            Self::Betaflight(line) => line.exchange(now, simulator, inputs),
            Self::Inav(line) => line.exchange(now, simulator, inputs),
        }
    }

    /// Whether the world may go on. If not, it has napped already: look after the rest of the program and come again.
    pub fn keeps_up(&mut self) -> bool {
        match self {
            Self::Betaflight(line) => line.keeps_up(),
            Self::Inav(line) => line.keeps_up(),
        }
    }

    /// The companion computer writes to the UART.
    pub fn write(&mut self, bytes: &[u8]) {
        match self {
            Self::Betaflight(line) => line.write(bytes),
            Self::Inav(line) => line.write(bytes),
        }
    }

    /// The next thing worth a line on the terminal.
    pub fn poll_news(&mut self) -> Option<String> {
        match self {
            Self::Betaflight(line) => line.poll_news(),
            Self::Inav(line) => line.poll_news(),
        }
    }
}
