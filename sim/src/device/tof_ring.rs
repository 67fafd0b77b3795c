//! The microcontroller of a ring of multizone sensors: one frame per firing (docs/sensors.md has the format).

use vehicle::RangerReading;

/// One frame: `K R`, kind 1, number of columns, sensor, count, age in 0.1 ms, depths in mm (0xFFFF none), CRC-16/CCITT-FALSE.
pub fn frame(reading: &RangerReading, sensor: u8, count: u8, age_us: u64, out: &mut Vec<u8>) {
    let from = out.len();
    out.extend([b'K', b'R', 1, reading.columns_mm.len() as u8, sensor, count]);
    out.extend(((age_us / 100).min(0xFFFF) as u16).to_le_bytes());
    for column in &reading.columns_mm {
        out.extend(column.unwrap_or(0xFFFF).to_le_bytes());
    }
    let mut crc = 0xFFFFu16;
    for byte in &out[from + 2..] {
        crc ^= u16::from(*byte) << 8;
        for _ in 0..8 {
            crc = if crc & 0x8000 == 0 {
                crc << 1
            } else {
                (crc << 1) ^ 0x1021
            };
        }
    }
    out.extend(crc.to_le_bytes());
}
