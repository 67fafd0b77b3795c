//! Cycle time, sensors, active modes and what blocks arming. Three layouts share a head of 11
//! bytes:
//!
//! | | bytes 0..11 | then |
//! | --- | --- | --- |
//! | STATUS, MultiWii, Cleanflight, INAV | [`StatusHead`] | nothing |
//! | STATUS, Betaflight | [`StatusHead`] | `load u16, gyro_cycle u16`, [`StatusTail`] |
//! | STATUS_EX, Cleanflight | [`StatusHead`] | `load u16` |
//! | STATUS_EX, INAV | [`StatusHead`] | `load u16, arming_flags_low u16, acc_calibration u8` |
//! | STATUS_EX, Betaflight | [`StatusHead`] | `load u16, pid_profiles u8, rate_profile u8`, [`StatusTail`] |
//! | INAV_STATUS | own layout, [`InavStatus`] | |
//!
//! `mode_flags` bit *i* belongs to the *i*-th entry of BOXIDS, not to the permanent id *i*.

use super::{Message, messages};
use crate::command;
use crate::wire::{ParseError, Reader, Wire};
use arrayvec::ArrayVec;

messages! {
    /// Status of INAV, with all 64 mode flags and all arming flags (STATUS and STATUS_EX cut both
    /// short).
    #[derive(Copy)]
    InavStatus = INAV_STATUS {
        /// Control loop time in microseconds.
        cycle_time_us: u16,
        /// I2C errors since start.
        i2c_errors: u16,
        /// Sensor bits, see [`StatusHead::sensors`]; INAV: 5 optical flow, 6 pitot, 7 temperature,
        /// 15 hardware failure.
        sensors: u16,
        /// Processor load in percent.
        load_pct: u16,
        /// Low nibble: profile; high nibble: battery profile.
        profiles: u8,
        /// Arming flags of INAV ([`crate::firmware::arming_blockers`]); bit 2 = armed.
        arming_flags: u32,
        /// Active boxes, in BOXIDS order.
        mode_flags: u64,
        /// Mixer profile (INAV 7 and later).
        mixer_profile: Option<u8>,
    }

    /// Values a developer of the firmware looks at; what they mean depends on `debug_mode`. Betaflight
    /// 8, INAV 4 (the same bytes as two 32-bit numbers in newer ones).
    Debug = DEBUG {
        /// Values.
        debug: ArrayVec<i16, 16>,
    }
}

/// The 11 bytes every firmware sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct StatusHead {
    /// Control loop time in microseconds. 0 for seconds on end means that the controller's
    /// scheduler stands still.
    pub cycle_time_us: u16,
    /// I2C errors since start.
    pub i2c_errors: u16,
    /// Bit 0 accelerometer, 1 barometer, 2 magnetometer, 3 GPS, 4 rangefinder; Betaflight 5 gyro, 6
    /// optical flow.
    pub sensors: u16,
    /// Active boxes 0..32, in BOXIDS order.
    pub mode_flags: u32,
    /// PID profile.
    pub profile: u8,
}

/// What Betaflight appends to STATUS and STATUS_EX.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct StatusTail {
    /// Active boxes from 32 on, eight per byte.
    pub more_mode_flags: ArrayVec<u8, 15>,
    /// Number of arming-disable bits this version has; the last one is always `ARM_SWITCH`.
    pub arming_disable_count: u8,
    /// What blocks arming ([`crate::firmware::arming_blockers`]); 0 = ready.
    pub arming_disable: u32,
    /// Bit 0: reboot required.
    pub config_state: Option<u8>,
    /// Processor temperature in degrees Celsius (API 1.46).
    pub cpu_temperature_c: Option<u16>,
    /// Number of rate profiles (API 1.46).
    pub rate_profile_count: Option<u8>,
    /// Battery profiles (API 1.48).
    pub battery_profiles: Option<BatteryProfiles>,
}

/// Battery profiles of Betaflight (API 1.48).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct BatteryProfiles {
    /// How many there are.
    pub count: u8,
    /// The active one.
    pub current: u8,
}

/// MSP_STATUS.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Status {
    /// The common part.
    #[serde(flatten)]
    pub head: StatusHead,
    /// Betaflight only: processor load in percent.
    pub load_pct: Option<u16>,
    /// Betaflight only: gyro cycle time in microseconds (0 in current versions).
    pub gyro_cycle_us: Option<u16>,
    /// Betaflight only.
    #[serde(flatten)]
    pub tail: Option<StatusTail>,
}

/// MSP_STATUS_EX.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct StatusEx {
    /// The common part.
    #[serde(flatten)]
    pub head: StatusHead,
    /// Processor load in percent.
    pub load_pct: u16,
    /// What the firmware appends.
    #[serde(flatten)]
    pub tail: StatusExTail,
}

/// What follows the load in STATUS_EX; the length of the payload tells which.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(untagged)]
pub enum StatusExTail {
    /// Betaflight.
    Betaflight {
        /// Number of PID profiles.
        pid_profile_count: u8,
        /// Active rate profile.
        rate_profile: u8,
        /// The rest.
        #[serde(flatten)]
        tail: StatusTail,
    },
    /// Nothing follows.
    #[default]
    Cleanflight,
    /// INAV.
    Inav {
        /// Arming flags 0..16 only; use [`InavStatus`].
        arming_flags_low: u16,
        /// Accelerometer calibration axes done.
        acc_calibration: u8,
    },
}

impl Status {
    /// Whether box number `index` (position in BOXIDS) is active.
    #[must_use]
    pub fn mode_flag(&self, index: usize) -> bool {
        self.head.mode_flag(index, self.tail.as_ref())
    }
}

impl StatusEx {
    /// Whether box number `index` (position in BOXIDS) is active.
    #[must_use]
    pub fn mode_flag(&self, index: usize) -> bool {
        self.head.mode_flag(index, self.betaflight())
    }

    /// The tail of Betaflight, when this is one.
    #[must_use]
    pub const fn betaflight(&self) -> Option<&StatusTail> {
        match &self.tail {
            StatusExTail::Betaflight { tail, .. } => Some(tail),
            StatusExTail::Cleanflight | StatusExTail::Inav { .. } => None,
        }
    }
}

impl StatusHead {
    fn mode_flag(&self, index: usize, tail: Option<&StatusTail>) -> bool {
        if index < 32 {
            return self.mode_flags & (1 << index) != 0;
        }
        let byte = tail.and_then(|tail| tail.more_mode_flags.get(index / 8 - 4));
        byte.is_some_and(|byte| byte & (1 << (index % 8)) != 0)
    }
}

impl InavStatus {
    /// Whether box number `index` (position in BOXIDS) is active.
    #[must_use]
    pub const fn mode_flag(&self, index: usize) -> bool {
        index < 64 && self.mode_flags & (1 << index) != 0
    }

    /// Control profile.
    #[must_use]
    pub const fn profile(&self) -> u8 {
        self.profiles & 0x0f
    }

    /// Battery profile.
    #[must_use]
    pub const fn battery_profile(&self) -> u8 {
        self.profiles >> 4
    }
}

impl Message for Status {
    const COMMAND: u16 = command::STATUS;

    fn parse(payload: &[u8]) -> Result<Self, ParseError> {
        let mut reader = Reader::new(Self::COMMAND, payload);
        Ok(Self {
            head: Wire::read(&mut reader)?,
            load_pct: Wire::read(&mut reader)?,
            gyro_cycle_us: Wire::read(&mut reader)?,
            tail: Wire::read(&mut reader)?,
        })
    }

    fn emit(&self, out: &mut Vec<u8>) {
        self.head.write(out);
        self.load_pct.write(out);
        self.gyro_cycle_us.write(out);
        self.tail.write(out);
    }
}

impl Message for StatusEx {
    const COMMAND: u16 = command::STATUS_EX;

    fn parse(payload: &[u8]) -> Result<Self, ParseError> {
        let mut reader = Reader::new(Self::COMMAND, payload);
        let head = Wire::read(&mut reader)?;
        let load_pct = Wire::read(&mut reader)?;
        let tail = match reader.remaining() {
            0 => StatusExTail::Cleanflight,
            3 => StatusExTail::Inav {
                arming_flags_low: Wire::read(&mut reader)?,
                acc_calibration: Wire::read(&mut reader)?,
            },
            _ => StatusExTail::Betaflight {
                pid_profile_count: Wire::read(&mut reader)?,
                rate_profile: Wire::read(&mut reader)?,
                tail: Wire::read(&mut reader)?,
            },
        };
        Ok(Self {
            head,
            load_pct,
            tail,
        })
    }

    fn emit(&self, out: &mut Vec<u8>) {
        self.head.write(out);
        self.load_pct.write(out);
        match &self.tail {
            StatusExTail::Betaflight {
                pid_profile_count,
                rate_profile,
                tail,
            } => {
                out.extend_from_slice(&[*pid_profile_count, *rate_profile]);
                tail.write(out);
            }
            StatusExTail::Cleanflight => {}
            StatusExTail::Inav {
                arming_flags_low,
                acc_calibration,
            } => {
                arming_flags_low.write(out);
                out.push(*acc_calibration);
            }
        }
    }
}

impl Wire for StatusHead {
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
        Ok(Self {
            cycle_time_us: Wire::read(reader)?,
            i2c_errors: Wire::read(reader)?,
            sensors: Wire::read(reader)?,
            mode_flags: Wire::read(reader)?,
            profile: Wire::read(reader)?,
        })
    }

    fn write(&self, out: &mut Vec<u8>) {
        self.cycle_time_us.write(out);
        self.i2c_errors.write(out);
        self.sensors.write(out);
        self.mode_flags.write(out);
        self.profile.write(out);
    }
}

impl Wire for StatusTail {
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
        // The high nibble of the count is reserved by the firmware.
        let count = usize::from(u8::read(reader)? & 0x0f);
        Ok(Self {
            more_mode_flags: reader.bytes(count)?.iter().copied().collect(),
            arming_disable_count: Wire::read(reader)?,
            arming_disable: Wire::read(reader)?,
            config_state: Wire::read(reader)?,
            cpu_temperature_c: Wire::read(reader)?,
            rate_profile_count: Wire::read(reader)?,
            battery_profiles: Wire::read(reader)?,
        })
    }

    fn write(&self, out: &mut Vec<u8>) {
        out.push(u8::try_from(self.more_mode_flags.len()).unwrap_or(0));
        out.extend_from_slice(&self.more_mode_flags);
        self.arming_disable_count.write(out);
        self.arming_disable.write(out);
        self.config_state.write(out);
        self.cpu_temperature_c.write(out);
        self.rate_profile_count.write(out);
        self.battery_profiles.write(out);
    }
}

impl Wire for BatteryProfiles {
    fn read(reader: &mut Reader<'_>) -> Result<Self, ParseError> {
        Ok(Self {
            count: Wire::read(reader)?,
            current: Wire::read(reader)?,
        })
    }

    fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&[self.count, self.current]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mode_flags_beyond_32_are_found_in_the_appended_bytes() {
        let tail = StatusTail {
            more_mode_flags: ArrayVec::from_iter([0b10, 0b1]),
            ..StatusTail::default()
        };
        let status = Status {
            head: StatusHead {
                mode_flags: 0b100,
                ..StatusHead::default()
            },
            load_pct: Some(0),
            gyro_cycle_us: Some(0),
            tail: Some(tail),
        };
        let active: Vec<usize> = (0..200).filter(|&index| status.mode_flag(index)).collect();
        assert_eq!(active, [2, 33, 40]);
    }

    #[test]
    fn length_tells_the_three_kinds_of_status_ex_apart() {
        let head = [0u8; 11];
        let parse = |rest: &[u8]| StatusEx::parse(&[&head[..], rest].concat()).unwrap().tail;
        assert_eq!(parse(&[0, 0]), StatusExTail::Cleanflight);
        assert_eq!(
            parse(&[0, 0, 24, 0, 63]),
            StatusExTail::Inav {
                arming_flags_low: 24,
                acc_calibration: 63
            }
        );
        assert!(matches!(
            parse(&[0, 0, 4, 0, 0, 29, 4, 0, 0, 0, 0]),
            StatusExTail::Betaflight {
                rate_profile: 0,
                ..
            }
        ));
    }
}
