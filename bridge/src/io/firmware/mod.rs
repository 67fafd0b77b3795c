//! The real firmware in the loop: Betaflight's simulator build as a child process, fed by the simulated body.
//!
//! | File | Does |
//! | --- | --- |
//! | [`find`](mod@find) | where the program is: given, or in the Python package `betaflight` |
//! | [`process`] | starts it in a folder of its own, starts it again when it ends, never leaves it behind |
//! | [`line`](mod@line) | states out, motors in, MSP by TCP |
//! | `pause` | stops the firmware while this program has no processor |
//! | `patience` | whether the world may go on while the firmware has not answered |
//!
//! What is in the packets: [`sim::firmware`].

pub mod find;
pub mod line;
mod patience;
mod pause;
pub mod process;

pub use find::{FindError, find};
pub use line::FirmwareLine;
pub use process::{Firmware, StartError};
