//! BMP085 barometer: a conversion is started, something else is done, the result is collected.

use embedded_hal::i2c::I2c;

/// Its address.
pub(super) const BARO: u8 = 0x77;
/// Oversampling setting 1: two samples, 7.5 ms, so that a conversion fits between two frames.
const OVERSAMPLING: u8 = 1;
/// Time of a pressure conversion at that setting, us.
const PRESSURE_US: u64 = 7_500;
/// Time of a temperature conversion, us.
const TEMPERATURE_US: u64 = 4_500;
/// Conversions of pressure between two of temperature.
const PRESSURES: u8 = 63;

/// Constants from the chip's EEPROM, in the order of the data sheet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Constants {
    pub(super) ac1: i16,
    pub(super) ac2: i16,
    pub(super) ac3: i16,
    pub(super) ac4: u16,
    pub(super) ac5: u16,
    pub(super) ac6: u16,
    pub(super) b1: i16,
    pub(super) b2: i16,
    pub(super) mb: i16,
    pub(super) mc: i16,
    pub(super) md: i16,
}

impl Constants {
    fn parse(b: &[u8; 22]) -> Self {
        let signed = |i: usize| i16::from_be_bytes([b[2 * i], b[2 * i + 1]]);
        let unsigned = |i: usize| u16::from_be_bytes([b[2 * i], b[2 * i + 1]]);
        Self {
            ac1: signed(0),
            ac2: signed(1),
            ac3: signed(2),
            ac4: unsigned(3),
            ac5: unsigned(4),
            ac6: unsigned(5),
            b1: signed(6),
            b2: signed(7),
            mb: signed(8),
            mc: signed(9),
            md: signed(10),
        }
    }

    /// The data sheet's b5: temperature on its way to both results.
    fn b5(&self, ut: i64) -> i64 {
        let x1 = ((ut - i64::from(self.ac6)) * i64::from(self.ac5)) >> 15;
        let divisor = x1 + i64::from(self.md);
        if divisor == 0 {
            // Constants of a broken chip.
            return 0;
        }
        x1 + (i64::from(self.mc) << 11) / divisor
    }

    /// Temperature, 0.1 degC.
    fn temperature_ddeg(&self, ut: i64) -> i64 {
        (self.b5(ut) + 8) >> 4
    }

    /// Pressure, Pa. The arithmetic is the data sheet's, in integers wide enough for any constants.
    fn pressure_pa(&self, ut: i64, up: i64, oversampling: u8) -> i64 {
        let b6 = self.b5(ut) - 4000;
        let square = (b6 * b6) >> 12;
        let x3 = ((i64::from(self.b2) * square) >> 11) + ((i64::from(self.ac2) * b6) >> 11);
        let b3 = (((i64::from(self.ac1) * 4 + x3) << oversampling) + 2) / 4;
        let x3 = ((i64::from(self.ac3) * b6) >> 13) + ((i64::from(self.b1) * square) >> 16);
        let b4 = (i64::from(self.ac4) * (((x3 + 2) >> 2) + 32_768)) >> 15;
        let b7 = (up - b3) * (50_000 >> oversampling);
        if b4 == 0 {
            return 0;
        }
        let p = b7 * 2 / b4;
        let x1 = ((p >> 8) * (p >> 8) * 3038) >> 16;
        p + ((x1 + ((-7357 * p) >> 16) + 3791) >> 4)
    }
}

/// What is being converted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Conversion {
    Pressure { ready_us: u64 },
    Temperature { ready_us: u64 },
}

/// The chip as the board sees it.
#[derive(Clone, Debug, Default)]
pub(super) struct Barometer {
    pub(super) constants: Constants,
    conversion: Option<Conversion>,
    ut: i64,
    since_temperature: u8,
    /// Last temperature, 0.1 degC.
    pub(super) temperature_ddeg: u16,
    /// Last pressure, Pa.
    pub(super) pressure_pa: u32,
}

impl Barometer {
    /// Reads the constants.
    pub(super) fn set_up<B: I2c>(&mut self, bus: &mut B) -> Result<(), B::Error> {
        let mut bytes = [0; 22];
        bus.write_read(BARO, &[0xaa], &mut bytes)?;
        self.constants = Constants::parse(&bytes);
        Ok(())
    }

    /// Collects what is ready and starts the next conversion. Never waits.
    pub(super) fn poll<B: I2c>(&mut self, now_us: u64, bus: &mut B) -> Result<(), B::Error> {
        match self.conversion {
            Some(Conversion::Temperature { ready_us }) if now_us >= ready_us => {
                self.conversion = None;
                let mut b = [0; 2];
                bus.write_read(BARO, &[0xf6], &mut b)?;
                self.ut = i64::from(u16::from_be_bytes(b));
                let t = self.constants.temperature_ddeg(self.ut);
                self.temperature_ddeg = t.clamp(0, 1250) as u16;
                self.since_temperature = 0;
            }
            Some(Conversion::Pressure { ready_us }) if now_us >= ready_us => {
                self.conversion = None;
                let mut b = [0; 3];
                bus.write_read(BARO, &[0xf6], &mut b)?;
                let raw = i64::from(b[0]) << 16 | i64::from(b[1]) << 8 | i64::from(b[2]);
                let up = raw >> (8 - OVERSAMPLING);
                let p = self.constants.pressure_pa(self.ut, up, OVERSAMPLING);
                self.pressure_pa = p.clamp(30_000, 110_000) as u32;
                self.since_temperature += 1;
            }
            Some(_) => return Ok(()),
            None => {}
        }
        let (command, next) = if self.ut == 0 || self.since_temperature >= PRESSURES {
            let ready_us = now_us + TEMPERATURE_US;
            (0x2e, Conversion::Temperature { ready_us })
        } else {
            let ready_us = now_us + PRESSURE_US;
            (0x34 | OVERSAMPLING << 6, Conversion::Pressure { ready_us })
        };
        bus.write(BARO, &[0xf4, command])?;
        self.conversion = Some(next);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_data_sheets_example_is_15_degrees_and_69964_pa() {
        let constants = Constants {
            ac1: 408,
            ac2: -72,
            ac3: -14_383,
            ac4: 32_741,
            ac5: 32_757,
            ac6: 23_153,
            b1: 6190,
            b2: 4,
            mb: -32_768,
            mc: -8711,
            md: 2868,
        };
        assert_eq!(constants.temperature_ddeg(27_898), 150);
        assert_eq!(constants.pressure_pa(27_898, 23_843, 0), 69_964);
    }

    #[test]
    fn a_chip_that_answers_zeros_or_ones_does_not_stop_the_board() {
        for byte in [0, 0xff] {
            let constants = Constants::parse(&[byte; 22]);
            for up in [0, 0x7_ffff] {
                let _ = constants.temperature_ddeg(0);
                let _ = constants.pressure_pa(65_535, up, OVERSAMPLING);
            }
        }
    }
}
