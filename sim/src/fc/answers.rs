//! Questions and their answers: SI and our frames become counts, decidegrees and centimetres here and nowhere else.
//!
//! Axes of the wire: FLU, attitude roll right +, pitch nose **down** +, heading clockwise 0..=359.

use super::FlightController;
use super::receiver::AETR;
use crate::quad::Quad;
use crate::quad::battery::{CAPACITY_MAH, CELLS};
use crate::sensor::MAG_COUNTS_PER_GAUSS;
use arrayvec::ArrayVec;
use core::f64::consts::PI;
use msp::firmware::box_id;
use msp::message::{
    Altitude, Analog, ApiVersion, Attitude, BatteryState, BoardInfo, BoxIds, BoxNames, BuildInfo,
    FailsafeConfig, FcVariant, FcVersion, FeatureConfig, Message, MixerConfig, ModeRanges, Motor,
    MotorConfig, Name, RawImu, Rc, RxConfig, RxMap, Status, StatusEx, StatusExTail, StatusHead,
    StatusTail, Uid,
};
use msp::{LongText, ShortText, command};
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::{Frd, In};

/// Features of the default set-up: MSP receiver (14), airmode off, anti-gravity (28).
pub(super) const FEATURES: u32 = FeatureConfig::RX_MSP | 1 << 28;
/// Boxes in the order of the mode flags. Not the order of their ids: HEADFREE is 6, HEADADJ 7.
const BOXES: [(u8, &str); 8] = [
    (box_id::ARM, "ARM"),
    (box_id::ANGLE, "ANGLE"),
    (box_id::HORIZON, "HORIZON"),
    (6, "HEADFREE"),
    (box_id::FAILSAFE, "FAILSAFE"),
    (7, "HEADADJ"),
    (box_id::BEEPER, "BEEPER"),
    (box_id::MSP_OVERRIDE, "MSP OVERRIDE"),
];
const BOX_NAMES: &str = "ARM;ANGLE;HORIZON;HEADFREE;FAILSAFE;HEADADJ;BEEPER;MSP OVERRIDE;";
/// Accelerometer, barometer, gyro.
const SENSORS: u16 = 1 | 1 << 1 | 1 << 5;
const SENSOR_MAG: u16 = 1 << 2;
const ACC_COUNTS_PER_MPS2: f64 = 2048.0 / GRAVITY_MPS2;
const GYRO_COUNTS_PER_RADPS: f64 = 16.4 * 180.0 / PI;

/// Whether the box has a place in BOXIDS.
pub(super) fn is_known_box(permanent_id: u8) -> bool {
    BOXES.iter().any(|(id, _)| *id == permanent_id)
}

impl FlightController {
    /// Appends the answer to a question to `out`; false if the firmware does not know it.
    pub(super) fn answer(&mut self, question: u16, quad: &Quad, out: &mut Vec<u8>) -> bool {
        match question {
            command::ALTITUDE => self.altitude().emit(out),
            command::ANALOG => analog(quad).emit(out),
            command::API_VERSION => ApiVersion {
                protocol: 0,
                major: 1,
                minor: self.config.firmware.api_minor(),
            }
            .emit(out),
            command::ATTITUDE => self.attitude().emit(out),
            command::BATTERY_STATE => battery_state(quad).emit(out),
            command::BOARD_INFO => board_info().emit(out),
            command::BOXIDS => BoxIds {
                ids: BOXES.iter().map(|(id, _)| *id).collect(),
            }
            .emit(out),
            command::BOXNAMES => BoxNames {
                text: LongText::new(BOX_NAMES),
            }
            .emit(out),
            command::BUILD_INFO => BuildInfo {
                date: *b"Jan 01 2026",
                time: *b"00:00:00",
                revision: b"kestrel".iter().copied().collect(),
            }
            .emit(out),
            command::FAILSAFE_CONFIG => FailsafeConfig {
                delay_ds: 15,
                landing_time: 60,
                throttle_us: 1000,
                switch_mode: 0,
                throttle_low_delay_ds: 100,
                procedure: 1,
                rest: ArrayVec::new(),
            }
            .emit(out),
            command::FC_VARIANT => FcVariant { variant: *b"BTFL" }.emit(out),
            command::FC_VERSION => self.version().emit(out),
            command::FEATURE_CONFIG => FeatureConfig {
                features: self.features,
            }
            .emit(out),
            command::MIXER_CONFIG => MixerConfig {
                mixer_mode: 3,
                yaw_motors_reversed: Some(0),
            }
            .emit(out),
            command::MODE_RANGES => ModeRanges {
                slots: self.mode_ranges.iter().copied().collect(),
            }
            .emit(out),
            command::MOTOR => self.motor().emit(out),
            command::MOTOR_CONFIG => MotorConfig {
                min_throttle_us: 0,
                max_throttle_us: 2000,
                min_command_us: 1000,
                // Motors, poles, telemetry.
                rest: [4, 14, 0, 0].into_iter().collect(),
            }
            .emit(out),
            command::NAME => Name {
                name: LongText::new("kestrel-sim"),
            }
            .emit(out),
            command::RAW_IMU => self.raw_imu(quad).emit(out),
            command::RC => Rc {
                channels_us: self.receiver.channels_us().iter().copied().collect(),
            }
            .emit(out),
            command::RX_CONFIG => RxConfig {
                serial_provider: 0,
                max_check_us: 1900,
                mid_rc_us: 1500,
                min_check_us: super::MIN_CHECK_US,
                spektrum_sat_bind: 0,
                rx_min_us: 885,
                rx_max_us: 2115,
                rest: ArrayVec::new(),
            }
            .emit(out),
            command::RX_MAP => {
                let mut map = RxMap::identity();
                for (entry, position) in map.map.iter_mut().zip(AETR) {
                    *entry = position as u8;
                }
                map.emit(out);
            }
            command::STATUS => self.status().emit(out),
            command::STATUS_EX => self.status_ex().emit(out),
            command::UID => Uid { uid: [0, 1, 2] }.emit(out),
            _ => return false,
        }
        true
    }

    fn version(&self) -> FcVersion {
        let (major, minor, patch) = self.config.firmware.version();
        FcVersion {
            major,
            minor,
            patch,
            text: None,
        }
    }

    fn attitude(&self) -> Attitude {
        let deci_degrees = |rad: f64| whole(rad.to_degrees() * 10.0);
        let heading_deg = libm::floor(self.estimate.heading().to_degrees().rem_euclid(360.0));
        Attitude {
            roll_ddeg: deci_degrees(self.estimate.roll()),
            pitch_ddeg: deci_degrees(-self.estimate.pitch()),
            // 359.99999 may round up to 360 in rem_euclid.
            yaw_deg: whole(heading_deg) % 360,
        }
    }

    fn raw_imu(&mut self, quad: &Quad) -> RawImu {
        let (accel, gyro) = self.imu.read(quad.rates(), quad.mean_speed());
        let field = self
            .mag
            .as_mut()
            .map(|mag| mag.read(quad.position(), &quad.attitude(), quad.mean_speed()));
        let flu = |v: In<Frd>, scale: f64| [v.x(), -v.y(), -v.z()].map(|c| whole(c * scale));
        RawImu {
            acc: flu(accel, ACC_COUNTS_PER_MPS2),
            gyro: flu(gyro, GYRO_COUNTS_PER_RADPS),
            mag: field.map_or([0; 3], |field| flu(field, MAG_COUNTS_PER_GAUSS)),
        }
    }

    fn altitude(&self) -> Altitude {
        Altitude {
            altitude_cm: i32::from(whole(self.baro.altitude_m() * 100.0)),
            vario_cms: whole(self.baro.climb_mps() * 100.0),
            baro_altitude_cm: None,
        }
    }

    fn motor(&self) -> Motor {
        let mut motors_us = [0; 8];
        for (us, motor) in motors_us.iter_mut().zip(self.motors) {
            *us = libm::round(1000.0 + 1000.0 * motor) as u16;
        }
        Motor { motors_us }
    }

    fn status_head(&self) -> StatusHead {
        let active = |id: u8| match id {
            box_id::ARM => self.arming.is_armed(),
            box_id::FAILSAFE => self.arming.is_failsafe(),
            id => self.is_box_on(id),
        };
        let flags = (0..)
            .zip(BOXES)
            .map(|(bit, (id, _))| u32::from(active(id)) << bit);
        StatusHead {
            cycle_time_us: 125,
            i2c_errors: 0,
            sensors: SENSORS | if self.mag.is_some() { SENSOR_MAG } else { 0 },
            mode_flags: flags.sum(),
            profile: 0,
        }
    }

    fn status_tail(&self) -> StatusTail {
        StatusTail {
            more_mode_flags: ArrayVec::new(),
            arming_disable_count: self.config.firmware.arming_disable_count(),
            arming_disable: self.arming.blockers(),
            config_state: Some(0),
            cpu_temperature_c: Some(45),
            rate_profile_count: Some(4),
            battery_profiles: None,
        }
    }

    fn status(&self) -> Status {
        Status {
            head: self.status_head(),
            load_pct: Some(12),
            gyro_cycle_us: Some(0),
            tail: Some(self.status_tail()),
        }
    }

    fn status_ex(&self) -> StatusEx {
        StatusEx {
            head: self.status_head(),
            load_pct: 12,
            tail: StatusExTail::Betaflight {
                pid_profile_count: 4,
                rate_profile: 0,
                tail: self.status_tail(),
            },
        }
    }
}

fn analog(quad: &Quad) -> Analog {
    let battery = quad.battery();
    Analog {
        vbat_dv: whole(battery.voltage_v() * 10.0) as u8,
        drawn_mah: whole(battery.counted_mah()) as u16,
        rssi: 1023,
        current_ca: whole(battery.current_a() * 100.0),
        vbat_cv: Some(whole(battery.voltage_v() * 100.0) as u16),
    }
}

fn battery_state(quad: &Quad) -> BatteryState {
    let analog = analog(quad);
    let cell_v = quad.battery().voltage_v() / f64::from(CELLS);
    // vbat_warning_cell_voltage 3.5 V, vbat_min_cell_voltage 3.3 V.
    let state = match cell_v {
        v if v < 3.3 => 2,
        v if v < 3.5 => 1,
        _ => 0,
    };
    BatteryState {
        cells: CELLS,
        capacity_mah: CAPACITY_MAH as u16,
        vbat_dv: analog.vbat_dv,
        drawn_mah: analog.drawn_mah,
        current_ca: analog.current_ca,
        state: Some(state),
        vbat_cv: analog.vbat_cv,
    }
}

fn board_info() -> BoardInfo {
    BoardInfo {
        board: *b"S7X2",
        hardware_revision: 0,
        osd_type: Some(0),
        capabilities: Some(0),
        target: Some(ShortText::new("KESTRELSIM")),
        board_name: Some(ShortText::new("KESTRELSIM")),
        manufacturer: Some(ShortText::new("KSTL")),
        signature: Some([0; 32]),
        mcu_type: Some(0),
        config_state: Some(2),
        gyro_rate_hz: Some(8000),
        config_problems: Some(0),
        spi_devices: Some(0),
        i2c_devices: Some(0),
    }
}

/// Rounded, held inside 16 bits.
fn whole(v: f64) -> i16 {
    // `as` saturates and takes NaN to 0.
    libm::round(v) as i16
}
