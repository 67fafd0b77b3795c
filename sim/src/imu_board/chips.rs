//! Accelerometer, gyro and magnetometer over I2C at 400 kHz, by their data sheets.

use embedded_hal::i2c::I2c;

/// ADXL345, Analog Devices.
pub(super) const ACCEL: u8 = 0x53;
/// ITG3200, InvenSense.
pub(super) const GYRO: u8 = 0x68;
/// HMC5843, Honeywell.
pub(super) const MAG: u8 = 0x1e;

/// Registers written at start-up: address, register, value.
const SET_UP: [(u8, u8, u8); 5] = [
    // Full resolution, +-16 g.
    (ACCEL, 0x31, 0x0b),
    // Measure.
    (ACCEL, 0x2d, 0x08),
    // +-2000 deg/s, 42 Hz low-pass.
    (GYRO, 0x16, 0x1b),
    // 20 Hz.
    (MAG, 0x00, 0x14),
    // Continuous.
    (MAG, 0x02, 0x00),
];

/// Wakes the three chips.
pub(super) fn set_up<B: I2c>(bus: &mut B) -> Result<(), B::Error> {
    SET_UP
        .iter()
        .try_for_each(|&(chip, register, value)| bus.write(chip, &[register, value]))
}

fn registers<B: I2c>(bus: &mut B, chip: u8, first: u8) -> Result<[u8; 6], B::Error> {
    let mut bytes = [0; 6];
    bus.write_read(chip, &[first], &mut bytes)?;
    Ok(bytes)
}

/// Counts x y z, 256 per g; little-endian.
pub(super) fn accel<B: I2c>(bus: &mut B) -> Result<[i16; 3], B::Error> {
    let b = registers(bus, ACCEL, 0x32)?;
    Ok([0, 2, 4].map(|i| i16::from_le_bytes([b[i], b[i + 1]])))
}

/// Counts x y z, 14.375 per deg/s; big-endian.
pub(super) fn gyro<B: I2c>(bus: &mut B) -> Result<[i16; 3], B::Error> {
    let b = registers(bus, GYRO, 0x1d)?;
    Ok([0, 2, 4].map(|i| i16::from_be_bytes([b[i], b[i + 1]])))
}

/// Counts x y z, 1300 per gauss; big-endian, -4096 is overflow.
pub(super) fn mag<B: I2c>(bus: &mut B) -> Result<[i16; 3], B::Error> {
    let b = registers(bus, MAG, 0x03)?;
    Ok([0, 2, 4].map(|i| i16::from_be_bytes([b[i], b[i + 1]])))
}
