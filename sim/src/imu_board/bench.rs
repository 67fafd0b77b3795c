//! A bench for the board: four simulated chips on an I2C bus whose transfers take their time, and a serial line that sends one byte each
//! 86.8 us.
//!
//! | Part | Like |
//! | --- | --- |
//! | bus | 400 kHz, 9 bits a byte, start and stop: a frame's transfers take 0.9 ms |
//! | main loop | looks every 20-60 us |
//! | board's crystal | up to 40 ppm off |
//! | accelerometer | 256 per g, noise 1 count, bias a few counts |
//! | gyro | 14.375 per deg/s, noise 3 counts, bias up to 30 counts |
//! | magnetometer | 1300 per gauss, noise 1 count |
//! | barometer | noise 3 Pa, conversions take what the data sheet says; a result collected too early is the old one |

use super::bmp085::BARO;
use super::board::Board;
use super::chips::{ACCEL, GYRO, MAG};
use crate::noise::Noise;
use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

/// One byte on the bus, ns: 9 bits at 400 kHz.
const BUS_BYTE_NS: u64 = 22_500;
/// One byte on the line, ns: 10 bits at 115200 baud.
const LINE_BYTE_NS: u64 = 86_806;
/// Gravity of the counts' scale, m/s2.
const G: f64 = 9.806_65;

/// What the chips feel: body forward, left, up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Environment {
    /// Specific force, m/s2.
    pub accel_mps2: [f64; 3],
    /// Rate, rad/s.
    pub gyro_radps: [f64; 3],
    /// Field, gauss.
    pub field_gauss: [f64; 3],
    /// Temperature, degC.
    pub temperature_degc: f64,
    /// Pressure, Pa.
    pub pressure_pa: f64,
}

impl Default for Environment {
    /// Level and at rest.
    fn default() -> Self {
        Self {
            accel_mps2: [0.0, 0.0, G],
            gyro_radps: [0.0; 3],
            field_gauss: [0.19, 0.0, -0.14],
            temperature_degc: 24.9,
            pressure_pa: 101_205.0,
        }
    }
}

/// A byte of the line with the time its last bit arrived, us.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// Arrival, us since power-on, true time.
    pub at_us: u64,
    /// The byte.
    pub byte: u8,
}

/// The bus refused: the chip does not answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct NoAnswer;

impl embedded_hal::i2c::Error for NoAnswer {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address)
    }
}

/// The chips.
#[derive(Clone, Debug)]
struct Chips {
    environment: Environment,
    noise: Noise,
    gyro_bias: [f64; 3],
    accel_bias: [f64; 3],
    /// True time, ns; transfers move it on.
    now_ns: u64,
    /// Last register address written to each chip.
    pointer: u8,
    /// The barometer's result, and when and what the next one is.
    result: [u8; 3],
    converting: Option<(u64, u8)>,
    dead: Option<u8>,
}

/// The constants of the data sheet's example.
const EEPROM: [u16; 11] = [
    408,
    (-72_i16) as u16,
    (-14_383_i16) as u16,
    32_741,
    32_757,
    23_153,
    6190,
    4,
    (-32_768_i16) as u16,
    (-8711_i16) as u16,
    2868,
];

impl Chips {
    fn register(&mut self, chip: u8, to: &mut [u8]) {
        let e = self.environment;
        match (chip, self.pointer) {
            (ACCEL, 0x32) => {
                for (i, pair) in to.chunks_mut(2).enumerate() {
                    let counts =
                        e.accel_mps2[i] / G * 256.0 + self.accel_bias[i] + self.noise.gauss(1.0);
                    pair.copy_from_slice(&within(counts, 4095.0).to_le_bytes());
                }
            }
            (GYRO, 0x1d) => {
                for (i, pair) in to.chunks_mut(2).enumerate() {
                    let counts = e.gyro_radps[i].to_degrees() * 14.375
                        + self.gyro_bias[i]
                        + self.noise.gauss(3.0);
                    pair.copy_from_slice(&within(counts, 32_767.0).to_be_bytes());
                }
            }
            (MAG, 0x03) => {
                for (i, pair) in to.chunks_mut(2).enumerate() {
                    let counts = e.field_gauss[i] * 1300.0 + self.noise.gauss(1.0);
                    let value = if counts.abs() > 2047.0 {
                        -4096
                    } else {
                        within(counts, 2047.0)
                    };
                    pair.copy_from_slice(&value.to_be_bytes());
                }
            }
            (BARO, 0xaa) => {
                for (pair, constant) in to.chunks_mut(2).zip(EEPROM) {
                    pair.copy_from_slice(&constant.to_be_bytes());
                }
            }
            (BARO, 0xf6) => {
                self.convert();
                let n = to.len().min(3);
                to[..n].copy_from_slice(&self.result[..n]);
            }
            _ => to.fill(0),
        }
    }

    fn command(&mut self, chip: u8, bytes: &[u8]) {
        if let [register, ..] = *bytes {
            self.pointer = register;
        }
        if let (BARO, [0xf4, command]) = (chip, bytes) {
            let takes_us = match command {
                0x2e => 4_500,
                // 4.5, 7.5, 13.5, 25.5 ms for 1, 2, 4, 8 samples.
                _ => 1_500 + 3_000 * (1_u64 << (command >> 6)),
            };
            self.converting = Some((self.now_ns + takes_us * 1000, *command));
        }
    }

    /// Puts the result of a finished conversion into the registers.
    fn convert(&mut self) {
        let Some((ready_ns, command)) = self.converting else {
            return;
        };
        if self.now_ns < ready_ns {
            return;
        }
        self.converting = None;
        let ut = solve(65_535.0, |ut| {
            baro::temperature(ut) - self.environment.temperature_degc
        });
        if command == 0x2e {
            let raw = (libm::round(ut) as u16).to_be_bytes();
            self.result = [raw[0], raw[1], 0];
            return;
        }
        let oversampling = command >> 6;
        let pressure = self.environment.pressure_pa + self.noise.gauss(3.0);
        let up = solve(524_287.0, |up| {
            baro::pressure(ut, up, oversampling) - pressure
        });
        let raw = ((libm::round(up) as u32) << (8 - oversampling)).to_be_bytes();
        self.result = [raw[1], raw[2], raw[3]];
    }
}

fn within(counts: f64, rail: f64) -> i16 {
    libm::round(counts.clamp(-rail - 1.0, rail)) as i16
}

/// Root of a monotonic function in 0..=high.
fn solve(high: f64, f: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, high);
    let rises = f(high) > f(low);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if (f(middle) > 0.0) == rises {
            high = middle;
        } else {
            low = middle;
        }
    }
    low
}

/// The physics behind the data sheet's integers, in real numbers.
mod baro {
    use super::EEPROM;

    fn signed(i: usize) -> f64 {
        f64::from(EEPROM[i] as i16)
    }

    fn b5(ut: f64) -> f64 {
        let x1 = (ut - f64::from(EEPROM[5])) * f64::from(EEPROM[4]) / 32_768.0;
        x1 + signed(9) * 2048.0 / (x1 + signed(10))
    }

    /// Temperature of a raw value, degC. Below the pole of the formula nothing is measured.
    pub(super) fn temperature(ut: f64) -> f64 {
        let pole = f64::from(EEPROM[5]) - signed(10) * 32_768.0 / f64::from(EEPROM[4]);
        if ut <= pole + 1.0 {
            -1e6
        } else {
            (b5(ut) + 8.0) / 160.0
        }
    }

    /// Pressure of a raw value, Pa.
    pub(super) fn pressure(ut: f64, up: f64, oversampling: u8) -> f64 {
        let scale = f64::from(1_u32 << oversampling);
        let b6 = b5(ut) - 4000.0;
        let x3 = signed(7) * b6 * b6 / 4096.0 / 2048.0 + signed(1) * b6 / 2048.0;
        let b3 = ((signed(0) * 4.0 + x3) * scale + 2.0) / 4.0;
        let x3 = (signed(2) * b6 / 8192.0 + signed(6) * b6 * b6 / 4096.0 / 65_536.0 + 2.0) / 4.0;
        let b4 = f64::from(EEPROM[3]) * (x3 + 32_768.0) / 32_768.0;
        let p = (up - b3) * (50_000.0 / scale) * 2.0 / b4;
        p + (p * p / 65_536.0 * 3038.0 / 65_536.0 - 7357.0 * p / 65_536.0 + 3791.0) / 16.0
    }
}

impl ErrorType for Chips {
    type Error = NoAnswer;
}

impl I2c for Chips {
    fn transaction(&mut self, chip: u8, operations: &mut [Operation<'_>]) -> Result<(), NoAnswer> {
        if self.dead == Some(chip) || ![ACCEL, GYRO, MAG, BARO].contains(&chip) {
            self.now_ns += BUS_BYTE_NS;
            return Err(NoAnswer);
        }
        for operation in operations {
            // The address goes first.
            self.now_ns += BUS_BYTE_NS;
            match operation {
                Operation::Write(bytes) => {
                    self.now_ns += bytes.len() as u64 * BUS_BYTE_NS;
                    self.command(chip, bytes);
                }
                Operation::Read(bytes) => {
                    self.now_ns += bytes.len() as u64 * BUS_BYTE_NS;
                    self.register(chip, bytes);
                }
            }
        }
        Ok(())
    }
}

/// The board with its chips and its line, on virtual time.
#[derive(Clone, Debug)]
pub struct Bench {
    board: Board,
    chips: Chips,
    noise: Noise,
    /// Board's us for each true us.
    crystal: f64,
    /// When the transmitter is empty again, ns.
    line_free_ns: u64,
    /// True times of sampling, us, of the last [`Bench::advance`].
    sampled_us: Vec<u64>,
}

impl Bench {
    /// A bench that follows from its seed.
    #[must_use]
    pub fn new(seed: u64, alternates: bool) -> Self {
        let mut noise = Noise::new(seed, 0, "imu board");
        let gyro_bias = [0; 3].map(|_| noise.between(-30.0, 30.0));
        let accel_bias = [0; 3].map(|_| noise.between(-5.0, 5.0));
        Self {
            board: Board::new(alternates),
            crystal: 1.0 + noise.between(-40e-6, 40e-6),
            chips: Chips {
                environment: Environment::default(),
                noise: Noise::new(seed, 0, "imu chips"),
                gyro_bias,
                accel_bias,
                now_ns: 0,
                pointer: 0,
                result: [0; 3],
                converting: None,
                dead: None,
            },
            noise,
            line_free_ns: 0,
            sampled_us: Vec::new(),
        }
    }

    /// The firmware.
    #[must_use]
    pub const fn board(&self) -> &Board {
        &self.board
    }

    /// What the chips feel from now on.
    pub const fn feel(&mut self, environment: Environment) {
        self.chips.environment = environment;
    }

    /// A chip stops answering (0x53, 0x68, 0x1e, 0x77), or all answer again.
    pub const fn break_chip(&mut self, address: Option<u8>) {
        self.chips.dead = address;
    }

    /// Says something to the board.
    pub fn say(&mut self, bytes: &[u8]) {
        let now_us = self.board_us();
        for &b in bytes {
            self.board.receive(now_us, b);
        }
    }

    /// True times at which samples were begun during the last [`Bench::advance`], us.
    #[must_use]
    pub fn sampled_us(&self) -> &[u64] {
        &self.sampled_us
    }

    /// Lets time pass until `until_us` since power-on; what the line brought goes to `out`.
    pub fn advance(&mut self, until_us: u64, out: &mut Vec<Received>) {
        self.sampled_us.clear();
        while self.chips.now_ns < until_us * 1000 {
            let begun_us = self.chips.now_ns / 1000;
            let now_us = self.board_us();
            // The main loop has its own errands.
            self.chips.now_ns += self.noise.between(20_000.0, 60_000.0) as u64;
            if self.board.poll(now_us, &mut self.chips) {
                self.sampled_us.push(begun_us);
            }
            self.line(out);
        }
    }

    /// The transmitter's interrupt, as often as it came.
    fn line(&mut self, out: &mut Vec<Received>) {
        let now = self.chips.now_ns;
        while self.line_free_ns <= now {
            let Some(byte) = self.board.transmit() else {
                self.line_free_ns = now;
                return;
            };
            self.line_free_ns += LINE_BYTE_NS;
            let at_us = self.line_free_ns / 1000;
            out.push(Received { at_us, byte });
        }
    }

    fn board_us(&self) -> u64 {
        (self.chips.now_ns as f64 * 1e-3 * self.crystal) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imu_board::PERIOD_US;

    fn bytes(out: &[Received]) -> Vec<u8> {
        out.iter().map(|r| r.byte).collect()
    }

    #[test]
    fn sampling_keeps_its_10_ms_within_a_tenth_with_every_sensor_on() {
        let mut bench = Bench::new(1, false);
        let mut out = Vec::new();
        bench.advance(60_000_000, &mut out);
        let sampled = bench.sampled_us();
        assert!((5990..=6000).contains(&sampled.len()), "{}", sampled.len());
        let worst = sampled
            .windows(2)
            .map(|w| (w[1] - w[0]).abs_diff(PERIOD_US))
            .max()
            .unwrap();
        println!(
            "sampling period: at most {worst} us from 10 ms over {} samples",
            sampled.len()
        );
        assert!(worst <= 100, "{worst} us");
        let stats = bench.board().stats();
        assert_eq!((stats.dropped, stats.bus_errors, stats.missed), (0, 0, 0));
    }

    #[test]
    fn thirty_bytes_a_frame_and_starts_that_alternate_when_asked() {
        for (alternates, second) in [(false, b'A'), (true, b'C')] {
            let mut bench = Bench::new(2, alternates);
            let mut out = Vec::new();
            bench.advance(100_000, &mut out);
            let line = bytes(&out);
            assert_eq!(
                (line[0], line[29], line[30], line[59]),
                (b'A', b'Z', second, b'Z')
            );
        }
    }

    #[test]
    fn the_menu_stops_the_frames_switches_and_lets_them_run_again() {
        let mut bench = Bench::new(3, false);
        let mut out = Vec::new();
        bench.advance(50_000, &mut out);
        bench.say(b"$\n");
        out.clear();
        bench.advance(200_000, &mut out);
        let text = String::from_utf8_lossy(&bytes(&out)).into_owned();
        assert!(
            text.contains("2 acc on") && text.ends_with("run\r\n"),
            "{text}"
        );
        bench.say(b"7\n");
        out.clear();
        bench.advance(250_000, &mut out);
        assert!(String::from_utf8_lossy(&bytes(&out)).starts_with("ac1 408 ac2 -72"));
        bench.say(b"2\n1\n");
        bench.advance(400_000, &mut out);
        bench.say(b"#\n");
        out.clear();
        bench.advance(600_000, &mut out);
        let text = String::from_utf8(bytes(&out)).unwrap();
        let line = text.lines().nth(3).unwrap();
        let words: Vec<&str> = line.split('\t').collect();
        assert_eq!((words.len(), words[0], words[13]), (14, "A", "Z"));
        assert_eq!(words[2..5], ["0", "0", "0"], "the accelerometer is off");
        assert_ne!(words[5..8], ["0", "0", "0"]);
        bench.say(b"!\n");
        out.clear();
        bench.advance(700_000, &mut out);
        assert!(
            bytes(&out).contains(&b'Z') && bytes(&out).contains(&0),
            "binary again"
        );
    }

    #[test]
    fn a_dead_chip_is_counted_and_the_others_go_on() {
        let mut bench = Bench::new(4, false);
        let mut out = Vec::new();
        bench.advance(1_000_000, &mut out);
        let before = bench.board().stats().frames;
        for chip in [ACCEL, GYRO, MAG, BARO] {
            bench.break_chip(Some(chip));
            let errors = bench.board().stats().bus_errors;
            let until = bench.chips.now_ns / 1000 + 500_000;
            bench.advance(until, &mut out);
            assert!(bench.board().stats().bus_errors > errors, "{chip:#x}");
        }
        assert!(bench.board().stats().frames - before >= 199);
    }

    #[test]
    fn same_seed_same_bytes() {
        let run = || {
            let mut out = Vec::new();
            Bench::new(7, true).advance(300_000, &mut out);
            out
        };
        assert_eq!(run(), run());
    }
}
