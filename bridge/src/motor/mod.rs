//! uQuad's motor side: for craft that are commanded in motor speeds over I2C instead of through a flight controller.
//!
//! | Module | Does |
//! | --- | --- |
//! | [`mod@units`] | rad/s to the driver's units, the pair of limits, lines of four numbers |
//! | [`commander`] | the side of the control loop: limits, spacing of messages, waits for the acknowledgements |
//! | [`driver`] | the side of the bus: checks, acknowledges, starts with a ramp, re-sends, stops |
//! | [`mod@bench`] | both in one hand, fed with lines: `kestrel motors` |
//!
//! ```text
//!  control loop ── speeds ──> Commander ── 4 bytes ──> Driver ── I2C writes, each 2 ms ──> 4 speed controllers
//!                                 <── "ACK" + counter ──                  stop by themselves when nobody writes
//! ```
//!
//! Both are state machines without clock; the bus is any [`embedded_hal::i2c::I2c`]: `/dev/i2c-2` on Linux, [`sim::EscBus`] on the bench and in tests.
//! The thesis's driver re-sends its last order for ever when the control program dies; here silence stops the motors
//! ([`driver::DriverConfig::silence`]), and a driver that does not acknowledge stops the flight ([`commander::ACK_TIMEOUT`]).

pub mod bench;
pub mod commander;
pub mod driver;
pub mod units;

pub use commander::{Commanded, Commander};
pub use driver::{Driver, DriverConfig, DriverEvent, DriverState};
pub use units::{MAX_UNITS, Order, SpeedRange, units};
