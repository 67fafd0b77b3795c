//! Frames that lie.
//!
//! | Fault | Seen by | What happens |
//! | --- | --- | --- |
//! | duplicate | no time since the frame before | frame refused |
//! | out of order | arrives before the one before | frame refused |
//! | gap | more than a second since the frame before | used, said |
//! | saturated | a channel at its rail | used, the sensor is not believed |
//! | silent | pressure 0: the barometer is switched off, or has not spoken yet | used, the barometer is not believed |
//! | stuck | same counts for too long | used, the sensor is not believed |
//! | spike | pressure jumps further than a quadcopter falls | last good pressure instead, for half a second at most |
//!
//! A fault is said once when it begins and may be said again when it has ended.

use super::frame::RawFrame;
use core::fmt;
use vehicle::Timestamp;

/// A gap, us.
const GAP_US: u32 = 1_000_000;
/// Rails: ADXL345 in full resolution has 13 bits, the ITG3200 16; the HMC5843 answers -4096 on overflow, else 12 bits.
const ACCEL_RAIL: i16 = 4095;
const GYRO_RAIL: i16 = 32_767;
const MAG_RAIL: i16 = 2047;
/// A real accelerometer and gyro flicker by a count; half a second of sameness is none (recording: at most 2 repeats).
const STUCK_FRAMES: u32 = 50;
/// The magnetometer is read at 14 Hz: two seconds (recording: at most 6 repeats).
const MAG_STUCK_FRAMES: u32 = 200;
/// Pressure step that is no flight, Pa: 20 m between two frames.
const SPIKE_PA: u32 = 250;
/// A step that stays this long is believed.
const SPIKE_FRAMES: u32 = 50;

/// One of the sensors on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// ADXL345.
    Accelerometer,
    /// BMP085.
    Barometer,
    /// ITG3200.
    Gyro,
    /// HMC5843.
    Magnetometer,
}

impl fmt::Display for Sensor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Accelerometer => "accelerometer",
            Self::Barometer => "barometer",
            Self::Gyro => "gyro",
            Self::Magnetometer => "magnetometer",
        })
    }
}

/// Why a frame, or a sensor in it, is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameFault {
    /// No time has passed since the frame before.
    Duplicate,
    /// Nothing for more than a second.
    Gap {
        /// Time since the frame before, us.
        elapsed_us: u32,
    },
    /// The frame arrived before the one before it.
    OutOfOrder,
    /// A channel is at its rail.
    Saturated(Sensor),
    /// The sensor sends nothing.
    Silent(Sensor),
    /// The pressure jumped.
    Spike {
        /// The refused value, Pa.
        pressure_pa: u32,
    },
    /// The same counts for too long.
    Stuck(Sensor),
}

impl fmt::Display for FrameFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Duplicate => f.write_str("IMU frame refused: no time since the one before"),
            Self::Gap { elapsed_us } => {
                write!(f, "IMU silent for {:.1} s", f64::from(*elapsed_us) * 1e-6)
            }
            Self::OutOfOrder => f.write_str("IMU frame refused: older than the one before"),
            Self::Saturated(sensor) => write!(f, "IMU {sensor} is saturated"),
            Self::Silent(sensor) => write!(f, "IMU {sensor} is silent: is it switched on?"),
            Self::Spike { pressure_pa } => {
                write!(f, "IMU pressure jumped to {pressure_pa} Pa: not used")
            }
            Self::Stuck(sensor) => write!(f, "IMU {sensor} is stuck"),
        }
    }
}

/// What may be believed of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Watched {
    /// The frame, a spike of the pressure replaced; none if refused.
    pub frame: Option<RawFrame>,
    /// A fault that has just begun.
    pub fault: Option<FrameFault>,
    /// The accelerometer moves and is within its rails.
    pub accel_is_good: bool,
    /// The gyro moves and is within its rails.
    pub gyro_is_good: bool,
    /// The magnetometer moves and is within its rails.
    pub mag_is_good: bool,
    /// There is a pressure.
    pub baro_is_good: bool,
}

/// Watches the stream.
#[derive(Clone, Debug, Default)]
pub struct FrameWatch {
    last: Option<(Timestamp, RawFrame)>,
    accel_same: u32,
    gyro_same: u32,
    mag_same: u32,
    good_pressure_pa: Option<u32>,
    spikes: u32,
    /// The fault the last frame had, so that it is not said again.
    said: Option<FrameFault>,
}

impl FrameWatch {
    /// Judges one frame that arrived at `now`.
    pub fn judge(&mut self, now: Timestamp, mut frame: RawFrame) -> Watched {
        if let Some((at, _)) = self.last {
            if now < at {
                return self.refuse(FrameFault::OutOfOrder);
            }
            if frame.since_previous_us == 0 {
                return self.refuse(FrameFault::Duplicate);
            }
        }
        let before = self.last.map(|(_, f)| f);
        let count = |same: u32, is_same: bool| if is_same { same.saturating_add(1) } else { 0 };
        self.accel_same = count(
            self.accel_same,
            before.is_some_and(|b| b.accel == frame.accel),
        );
        self.gyro_same = count(self.gyro_same, before.is_some_and(|b| b.gyro == frame.gyro));
        self.mag_same = count(self.mag_same, before.is_some_and(|b| b.mag == frame.mag));
        self.last = Some((now, frame));

        let accel = at_rail(&frame.accel, ACCEL_RAIL, Sensor::Accelerometer)
            .or_else(|| stuck(self.accel_same, STUCK_FRAMES, Sensor::Accelerometer));
        let gyro = at_rail(&frame.gyro, GYRO_RAIL, Sensor::Gyro)
            .or_else(|| stuck(self.gyro_same, STUCK_FRAMES, Sensor::Gyro));
        let mag = at_rail(&frame.mag, MAG_RAIL, Sensor::Magnetometer)
            .or_else(|| stuck(self.mag_same, MAG_STUCK_FRAMES, Sensor::Magnetometer));
        let gap =
            (frame.since_previous_us > GAP_US && before.is_some()).then_some(FrameFault::Gap {
                elapsed_us: frame.since_previous_us,
            });
        let spike = self.without_spike(&mut frame);
        let fault = gyro.or(accel).or(gap).or(mag).or(spike);
        Watched {
            frame: Some(frame),
            fault: self.say(fault),
            accel_is_good: accel.is_none(),
            gyro_is_good: gyro.is_none(),
            mag_is_good: mag.is_none(),
            baro_is_good: frame.pressure_pa != 0,
        }
    }

    fn refuse(&mut self, fault: FrameFault) -> Watched {
        Watched {
            frame: None,
            fault: self.say(Some(fault)),
            accel_is_good: false,
            gyro_is_good: false,
            mag_is_good: false,
            baro_is_good: false,
        }
    }

    fn say(&mut self, fault: Option<FrameFault>) -> Option<FrameFault> {
        let is_new = match (fault, self.said) {
            // Its value changes with every frame, the fault is the same.
            (Some(FrameFault::Spike { .. }), Some(FrameFault::Spike { .. })) => false,
            (now, before) => now != before,
        };
        self.said = fault;
        fault.filter(|_| is_new)
    }

    fn without_spike(&mut self, frame: &mut RawFrame) -> Option<FrameFault> {
        let pressure_pa = frame.pressure_pa;
        if pressure_pa == 0 {
            return Some(FrameFault::Silent(Sensor::Barometer));
        }
        let Some(good) = self.good_pressure_pa else {
            self.good_pressure_pa = Some(pressure_pa);
            return None;
        };
        if pressure_pa.abs_diff(good) > SPIKE_PA && self.spikes < SPIKE_FRAMES {
            self.spikes += 1;
            frame.pressure_pa = good;
            return Some(FrameFault::Spike { pressure_pa });
        }
        self.spikes = 0;
        self.good_pressure_pa = Some(pressure_pa);
        None
    }
}

fn at_rail(values: &[i16; 3], rail: i16, sensor: Sensor) -> Option<FrameFault> {
    values
        .iter()
        .any(|v| v.unsigned_abs() >= rail.unsigned_abs())
        .then_some(FrameFault::Saturated(sensor))
}

fn stuck(same: u32, limit: u32, sensor: Sensor) -> Option<FrameFault> {
    (same >= limit).then_some(FrameFault::Stuck(sensor))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(k: u64) -> RawFrame {
        let flicker = (k % 2) as i16;
        RawFrame {
            since_previous_us: 10_000,
            accel: [10 + flicker, -9, 207],
            gyro: [-15, -21 - flicker, -17],
            mag: [-98, 130 + flicker, 8],
            temperature_ddeg: 249,
            pressure_pa: 101_205,
        }
    }

    /// Judges one frame each 10 ms, answers the faults said with the frame they were said at.
    fn run(n: u64, change: impl Fn(u64, &mut RawFrame)) -> (Vec<(u64, FrameFault)>, Watched) {
        let mut watch = FrameWatch::default();
        let mut said = Vec::new();
        let mut last = None;
        for k in 0..n {
            let mut f = frame(k);
            change(k, &mut f);
            let watched = watch.judge(Timestamp::from_ms(10 * k), f);
            said.extend(watched.fault.map(|fault| (k, fault)));
            last = Some(watched);
        }
        (said, last.unwrap())
    }

    #[test]
    fn a_healthy_stream_has_no_fault() {
        let (said, last) = run(500, |_, _| {});
        assert!(said.is_empty() && last.accel_is_good && last.gyro_is_good && last.mag_is_good);
    }

    #[test]
    fn a_stuck_sensor_is_said_once_and_not_believed() {
        let (said, last) = run(300, |_, f| f.gyro = [1, 2, 3]);
        assert_eq!(said, [(50, FrameFault::Stuck(Sensor::Gyro))]);
        assert!(!last.gyro_is_good && last.accel_is_good && last.frame.is_some());
        let (said, last) = run(300, |_, f| f.mag = [1, 2, 3]);
        assert_eq!(said, [(200, FrameFault::Stuck(Sensor::Magnetometer))]);
        assert!(!last.mag_is_good);
    }

    #[test]
    fn a_saturated_axis_is_named() {
        let (said, _) = run(20, |k, f| {
            if k == 7 {
                f.accel[2] = -4096;
            }
        });
        assert_eq!(said, [(7, FrameFault::Saturated(Sensor::Accelerometer))]);
        let (said, _) = run(20, |k, f| {
            if k == 7 {
                f.gyro[0] = i16::MIN;
            }
        });
        assert_eq!(said, [(7, FrameFault::Saturated(Sensor::Gyro))]);
    }

    #[test]
    fn duplicates_and_late_comers_are_refused() {
        let (said, last) = run(10, |k, f| {
            if k == 9 {
                f.since_previous_us = 0;
            }
        });
        assert_eq!(said, [(9, FrameFault::Duplicate)]);
        assert_eq!(last.frame, None);
        let mut watch = FrameWatch::default();
        watch.judge(Timestamp::from_ms(20), frame(0));
        let late = watch.judge(Timestamp::from_ms(10), frame(1));
        assert_eq!(
            (late.frame, late.fault),
            (None, Some(FrameFault::OutOfOrder))
        );
    }

    #[test]
    fn a_barometer_that_has_not_spoken_yet_is_no_reference_for_spikes() {
        let (said, last) = run(40, |k, f| {
            if k < 3 {
                f.pressure_pa = 0;
            }
        });
        assert_eq!(said, [(0, FrameFault::Silent(Sensor::Barometer))]);
        assert!(last.baro_is_good && last.frame.unwrap().pressure_pa == 101_205);
        let (said, last) = run(40, |k, f| {
            if k >= 20 {
                f.pressure_pa = 0;
            }
        });
        assert_eq!(said, [(20, FrameFault::Silent(Sensor::Barometer))]);
        assert!(!last.baro_is_good && last.frame.is_some());
    }

    #[test]
    fn a_pressure_spike_is_bridged_and_a_lasting_step_believed() {
        let (said, last) = run(40, |k, f| {
            if k >= 20 {
                f.pressure_pa = 99_000 + k as u32;
            }
        });
        assert_eq!(
            said,
            [(
                20,
                FrameFault::Spike {
                    pressure_pa: 99_020
                }
            )]
        );
        assert_eq!(last.frame.unwrap().pressure_pa, 101_205);
        let (_, last) = run(80, |k, f| {
            if k >= 20 {
                f.pressure_pa = 99_000;
            }
        });
        assert_eq!(last.frame.unwrap().pressure_pa, 99_000);
    }
}
