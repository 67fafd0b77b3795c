//! Four speed controllers with their motors on a simulated I2C bus: the far side of uQuad's motor driver.
//!
//! | Register | Effect |
//! | --- | --- |
//! | 0xA0 | enabled: speeds count from now on |
//! | 0xA1 | disabled: brakes |
//! | 0xA2 | speed, 0 to 255 |
//!
//! A controller that nobody writes to for [`SILENCE_US`] lets its motor run down: nobody has to tell it to stop.

use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

/// Addresses of the motors front, rear, left, right.
pub const ADDRESSES: [u8; 4] = [0x69, 0x6a, 0x6b, 0x68];
/// So long a motor turns without being commanded, us (chosen: fifty times the driver's period).
pub const SILENCE_US: u64 = 100_000;
/// What the four controllers are off by, in the same order: the thesis's driver adds the opposite.
const ERRORS: [i16; 4] = [-15, -15, 18, 9];

/// One write as an analyser on the bus sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusWrite {
    /// Time, us.
    pub at_us: u64,
    /// Chip.
    pub address: u8,
    /// Register.
    pub register: u8,
    /// Value.
    pub value: u8,
}

/// Nobody answered at that address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoAnswer;

impl embedded_hal::i2c::Error for NoAnswer {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address)
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Esc {
    is_enabled: bool,
    value: u8,
    written_us: u64,
    is_dead: bool,
}

/// The bus with its four chips.
#[derive(Clone, Debug, Default)]
pub struct EscBus {
    escs: [Esc; 4],
    now_us: u64,
    trace: Option<Vec<BusWrite>>,
}

impl EscBus {
    /// Time goes on; controllers nobody writes to stop.
    pub fn advance(&mut self, now_us: u64) {
        self.now_us = now_us;
        for esc in &mut self.escs {
            if now_us.saturating_sub(esc.written_us) > SILENCE_US {
                esc.value = 0;
            }
        }
    }

    /// Keeps every write from now on.
    pub fn record(&mut self) {
        self.trace = Some(Vec::new());
    }

    /// What was recorded.
    #[must_use]
    pub fn trace(&self) -> &[BusWrite] {
        self.trace.as_deref().unwrap_or_default()
    }

    /// A chip stops answering, or answers again.
    pub fn set_dead(&mut self, address: u8, is_dead: bool) {
        for (esc, a) in self.escs.iter_mut().zip(ADDRESSES) {
            if a == address {
                esc.is_dead = is_dead;
            }
        }
    }

    /// Values the motors turn at, front, left, rear, right; 0 = stands. The error of each controller is in them.
    #[must_use]
    pub fn values(&self) -> [u8; 4] {
        let at = |i: usize| {
            let esc = &self.escs[i];
            if esc.is_enabled && esc.value > 0 {
                (i16::from(esc.value) + ERRORS[i]).clamp(0, 255) as u8
            } else {
                0
            }
        };
        [at(0), at(2), at(1), at(3)]
    }

    /// Speeds the motors settle at, front, left, rear, right, rad/s.
    #[must_use]
    pub fn speeds_radps(&self) -> [f64; 4] {
        self.values().map(speed_radps)
    }
}

/// Speed at a value, rad/s: root of the thesis's measured cubic, which rises everywhere.
fn speed_radps(value: u8) -> f64 {
    let target = f64::from(value);
    let (mut low, mut high) = (0.0, 450.0);
    for _ in 0..50 {
        let w: f64 = 0.5 * (low + high);
        let cubic = 3.250_387_423_510_62e-6 * w * w * w - 0.001_073_450_943_483_45 * w * w
            + 0.552_199_572_510_559 * w;
        if cubic < target {
            low = w;
        } else {
            high = w;
        }
    }
    low
}

impl ErrorType for EscBus {
    type Error = NoAnswer;
}

impl I2c for EscBus {
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), NoAnswer> {
        let index = ADDRESSES.iter().position(|&a| a == address);
        let esc = index.map(|i| &mut self.escs[i]).filter(|e| !e.is_dead);
        let esc = esc.ok_or(NoAnswer)?;
        for operation in operations {
            match operation {
                Operation::Write([register, value]) => {
                    match *register {
                        0xa0 => esc.is_enabled = true,
                        0xa1 => (esc.is_enabled, esc.value) = (false, 0),
                        0xa2 => (esc.value, esc.written_us) = (*value, self.now_us),
                        _ => return Err(NoAnswer),
                    }
                    if let Some(trace) = &mut self.trace {
                        trace.push(BusWrite {
                            at_us: self.now_us,
                            address,
                            register: *register,
                            value: *value,
                        });
                    }
                }
                // Write-only chips.
                _ => return Err(NoAnswer),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motor_turns_when_enabled_and_commanded_and_stops_in_silence() {
        let mut bus = EscBus::default();
        bus.write(0x69, &[0xa2, 182]).unwrap();
        assert_eq!(bus.values(), [0; 4], "not enabled");
        bus.write(0x69, &[0xa0, 0]).unwrap();
        assert_eq!(bus.values(), [167, 0, 0, 0]);
        assert!((bus.speeds_radps()[0] - 312.5).abs() < 0.6, "hover");
        bus.advance(SILENCE_US);
        assert_eq!(bus.values()[0], 167);
        bus.advance(SILENCE_US + 1);
        assert_eq!(bus.values(), [0; 4], "nobody commands it any more");
    }

    #[test]
    fn the_second_chip_is_the_rear_motor() {
        let mut bus = EscBus::default();
        bus.write(0x6a, &[0xa0, 0]).unwrap();
        bus.write(0x6a, &[0xa2, 115]).unwrap();
        assert_eq!(bus.values(), [0, 0, 100, 0]);
    }

    #[test]
    fn strangers_and_dead_chips_do_not_answer() {
        let mut bus = EscBus::default();
        assert!(bus.write(0x50, &[0xa2, 1]).is_err());
        bus.set_dead(0x68, true);
        assert!(bus.write(0x68, &[0xa2, 1]).is_err());
        bus.set_dead(0x68, false);
        assert!(bus.write(0x68, &[0xa2, 1]).is_ok());
    }
}
