//! uQuad's inertial unit as firmware: a state machine over `embedded-hal`, and a bench with simulated chips to run it on.
//!
//! The firmware half ([`Board`], `chips`, `bmp085`, `line`) allocates nothing, waits for nothing and knows no clock: three
//! functions are called by the main loop and two interrupts of an 8-bit controller, or by [`Bench`].
//!
//! | Called by | Function |
//! | --- | --- |
//! | main loop, as often as it can | [`Board::poll`]: samples when 10 ms are over |
//! | UART, byte received | [`Board::receive`] |
//! | UART, transmitter empty | [`Board::transmit`]: the next byte, while the next sample is already being taken |
//!
//! | Chip | Address | Read |
//! | --- | --- | --- |
//! | ADXL345 accelerometer | 0x53 | every frame |
//! | ITG3200 gyro | 0x68 | every frame |
//! | HMC5843 magnetometer | 0x1e | every 7th frame (14 Hz) |
//! | BMP085 barometer | 0x77 | started in one frame, collected in the next; temperature each 64th time |
//!
//! Commands, each a character and a newline: `!` default mode and run, `#` run, `$` stop and show the menu; in the menu `1` format (ours: the original's
//! switch is not known), `2`-`6` accelerometer, gyro, compass, temperature, pressure on or off, `7` the barometer's constants.

mod bench;
mod bmp085;
mod board;
mod chips;
mod line;

pub use bench::{Bench, Environment, Received};
pub use board::{Board, BoardStats, PERIOD_US};
