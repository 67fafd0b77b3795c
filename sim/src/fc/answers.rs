//! Questions and their answers: SI and our frames become counts, decidegrees and centimetres here and nowhere else.
//!
//! Axes of the wire: FLU, attitude roll right +, pitch nose **down** +, heading clockwise 0..=359.

use super::FlightController;
use super::manner::{Board, MULTIWII_BOX, RXFAIL_CONFIG, StatusKind};
use crate::quad::Quad;
use crate::quad::battery::{CAPACITY_MAH, CELLS};
use crate::sensor::MAG_COUNTS_PER_GAUSS;
use arrayvec::ArrayVec;
use core::f64::consts::PI;
use msp::firmware::box_id;
use msp::message::{
    Altitude, Analog, ApiVersion, Attitude, AttitudeQuaternion, BatteryProfiles, BatteryState,
    BoardInfo, BoxIds, BoxNames, BuildInfo, FcVariant, FcVersion, FeatureConfig, Ident, InavAnalog,
    InavStatus, Message, MixerConfig, ModeRanges, Motor, MotorConfig, Name, RawImu, Rc,
    SonarAltitude, Status, StatusEx, StatusExTail, StatusHead, StatusTail, Uid,
};
use msp::{LongText, ShortText, command};
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::{Frd, In, Ned, Rot};

/// Accelerometer, barometer.
const SENSORS: u16 = 1 | 1 << 1;
const SENSOR_MAG: u16 = 1 << 2;
/// INAV and Cleanflight have no bit for the gyro.
const SENSOR_GYRO: u16 = 1 << 5;

impl FlightController {
    /// Appends the answer to a question to `out`; false if the firmware does not know it.
    pub(super) fn answer(&mut self, question: u16, quad: &Quad, out: &mut Vec<u8>) -> bool {
        let table = self.table;
        if !table.questions.contains(&question) {
            return false;
        }
        match question {
            command::ALTITUDE => self.altitude().emit(out),
            command::ANALOG => self.analog(quad).emit(out),
            command::API_VERSION => ApiVersion {
                protocol: 0,
                major: table.identity.api.0,
                minor: table.identity.api.1,
            }
            .emit(out),
            command::ATTITUDE => self.attitude().emit(out),
            command::ATTITUDE_QUATERNION => self.quaternion().emit(out),
            command::BATTERY_STATE => battery_state(quad).emit(out),
            command::BOARD_INFO => board_info(table.identity.board).emit(out),
            command::BOXIDS => BoxIds {
                ids: table.boxes.iter().map(|(id, _)| *id).collect(),
            }
            .emit(out),
            command::BOXNAMES => BoxNames {
                text: LongText::new(
                    &table
                        .boxes
                        .iter()
                        .flat_map(|(_, name)| [*name, ";"])
                        .collect::<String>(),
                ),
            }
            .emit(out),
            command::BUILD_INFO => BuildInfo {
                date: *b"Jan 01 2026",
                time: *b"00:00:00",
                revision: b"kestrel".iter().copied().collect(),
            }
            .emit(out),
            command::FAILSAFE_CONFIG => self.settings.failsafe.emit(out),
            command::FC_VARIANT => FcVariant {
                variant: table.identity.variant.unwrap_or(*b"MWII"),
            }
            .emit(out),
            command::FC_VERSION => self.version().emit(out),
            command::FEATURE_CONFIG => FeatureConfig {
                features: self.settings.features,
            }
            .emit(out),
            command::IDENT => self.ident().emit(out),
            command::INAV_ANALOG => inav_analog(quad).emit(out),
            command::INAV_STATUS => self.inav_status().emit(out),
            command::MIXER_CONFIG => MixerConfig {
                mixer_mode: 3,
                yaw_motors_reversed: matches!(table.status, StatusKind::Betaflight { .. })
                    .then_some(0),
            }
            .emit(out),
            command::MODE_RANGES => ModeRanges {
                slots: self.settings.mode_ranges.iter().copied().collect(),
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
                name: self.settings.name.clone(),
            }
            .emit(out),
            command::RAW_IMU => self.raw_imu(quad).emit(out),
            command::RC => Rc {
                channels_us: self
                    .receiver
                    .channels_us()
                    .iter()
                    .copied()
                    .take(table.wire.told_channels)
                    .collect(),
            }
            .emit(out),
            command::RX_CONFIG => self.settings.rx.emit(out),
            command::RX_MAP => self.settings.rx_map(table.wire.rx_map_len).emit(out),
            // No rangefinder on board: both firmwares say 0.
            command::SONAR_ALTITUDE => SonarAltitude { altitude_cm: 0 }.emit(out),
            command::STATUS => self.status().emit(out),
            command::STATUS_EX => self.status_ex().emit(out),
            MULTIWII_BOX => self.switches(out),
            RXFAIL_CONFIG => {
                for (channel, then) in self.settings.without_signal.iter().enumerate() {
                    then.emit(channel, out);
                }
            }
            command::UID => Uid { uid: [0, 1, 2] }.emit(out),
            _ => return false,
        }
        true
    }

    fn version(&self) -> FcVersion {
        let (major, minor, patch) = self.table.identity.version;
        FcVersion {
            major,
            minor,
            patch,
            text: self.table.identity.version_text.map(ShortText::new),
        }
    }

    /// MultiWii's first question, and old Cleanflight's.
    const fn ident(&self) -> Ident {
        let (major, minor, _) = self.table.identity.version;
        Ident {
            // 240 is MultiWii 2.4; Cleanflight always says 2.3.
            version: if self.table.identity.variant.is_none() {
                100 * major + minor
            } else {
                230
            },
            // Quadcopter X.
            multitype: 3,
            msp_version: 4,
            capability: 0,
        }
    }

    /// BOX of MultiWii: per box a word, three bits (low, middle, high) for each of Aux1 to Aux4.
    fn switches(&self, out: &mut Vec<u8>) {
        for (id, _) in self.table.boxes {
            let ranges = self.settings.mode_ranges.iter();
            let word = ranges
                .filter(|r| r.is_used() && r.permanent_id == *id && r.aux < 4)
                .fold(0_u16, |word, range| {
                    let on = |(bit, us): (u16, u16)| u16::from(range.contains(us)) << bit;
                    let bits: u16 = [(0, 1000), (1, 1500), (2, 2000)].into_iter().map(on).sum();
                    word | bits << (3 * range.aux)
                });
            out.extend_from_slice(&word.to_le_bytes());
        }
    }

    fn attitude(&self) -> Attitude {
        let deci_degrees = |rad: f64| whole(rad.to_degrees() * 10.0);
        let heading_deg = libm::floor(self.estimate.heading().to_degrees().rem_euclid(360.0));
        // 359.99999 may round up to 360 in rem_euclid.
        let yaw_deg = whole(heading_deg) % 360;
        let is_signed = self.table.wire.heading_is_signed;
        Attitude {
            roll_ddeg: deci_degrees(self.estimate.roll() + self.askew_rad),
            pitch_ddeg: deci_degrees(-self.estimate.pitch()),
            yaw_deg: if is_signed && yaw_deg > 180 {
                yaw_deg - 360
            } else {
                yaw_deg
            },
        }
    }

    /// Body FLU to earth NWU.
    fn quaternion(&self) -> AttitudeQuaternion {
        let e = &self.estimate;
        let roll = e.roll() + self.askew_rad;
        let turn = Rot::<Frd, Ned>::from_roll_pitch_yaw(roll, e.pitch(), e.heading());
        let q = turn.quaternion();
        let q15 = |v: f64| whole(v * 32767.0);
        AttitudeQuaternion {
            w_q15: q15(q.w),
            x_q15: q15(q.i),
            y_q15: q15(-q.j),
            z_q15: q15(-q.k),
        }
    }

    fn raw_imu(&mut self, quad: &Quad) -> RawImu {
        let (accel, gyro) = self.imu.read(quad.rates(), quad.mean_speed());
        let wire = &self.table.wire;
        let field = self
            .mag
            .as_mut()
            .map(|mag| mag.read(quad.position(), &quad.attitude(), quad.mean_speed()));
        let flu = |v: In<Frd>, scale: f64| [v.x(), -v.y(), -v.z()].map(|c| whole(c * scale));
        RawImu {
            acc: flu(accel, wire.acc_counts_per_g / GRAVITY_MPS2),
            gyro: flu(gyro, wire.gyro_counts_per_dps * 180.0 / PI),
            mag: field.map_or([0; 3], |field| flu(field, MAG_COUNTS_PER_GAUSS)),
        }
    }

    fn altitude(&self) -> Altitude {
        Altitude {
            altitude_cm: i32::from(whole(self.baro.altitude_m() * 100.0)),
            vario_cms: whole(self.baro.climb_mps() * 100.0),
            baro_altitude_cm: self
                .table
                .wire
                .altitude_has_baro
                .then(|| i32::from(whole(self.baro.altitude_m() * 100.0))),
        }
    }

    fn motor(&self) -> Motor {
        let mut motors_us = [0; 8];
        for (us, motor) in motors_us.iter_mut().zip(self.motors) {
            *us = libm::round(1000.0 + 1000.0 * motor) as u16;
        }
        Motor { motors_us }
    }

    /// Bit i is box i of the table.
    fn mode_flags(&self) -> u32 {
        let active = |id: u8| match id {
            box_id::ARM => self.arming.is_armed(),
            box_id::FAILSAFE => self.arming.is_failsafe(),
            id => self.is_box_on(id),
        };
        let flags = (0..)
            .zip(self.table.boxes)
            .map(|(bit, (id, _))| u32::from(active(*id)) << bit);
        flags.sum()
    }

    const fn sensors(&self) -> u16 {
        let gyro = match self.table.status {
            StatusKind::Betaflight { .. } => SENSOR_GYRO,
            StatusKind::Inav | StatusKind::Cleanflight | StatusKind::MultiWii => 0,
        };
        let mag = if self.mag.is_some() { SENSOR_MAG } else { 0 };
        SENSORS | gyro | mag
    }

    fn status_head(&self) -> StatusHead {
        StatusHead {
            cycle_time_us: 125,
            i2c_errors: 0,
            sensors: self.sensors(),
            mode_flags: self.mode_flags(),
            profile: 0,
        }
    }

    fn status_tail(&self, has_temperature: bool, has_battery_profiles: bool) -> StatusTail {
        StatusTail {
            more_mode_flags: ArrayVec::new(),
            arming_disable_count: self.table.arming.count,
            arming_disable: self.arming.told(),
            config_state: Some(u8::from(self.needs_reboot())),
            cpu_temperature_c: has_temperature.then_some(45),
            rate_profile_count: has_temperature.then_some(4),
            battery_profiles: has_battery_profiles.then_some(BatteryProfiles {
                count: 3,
                current: 0,
            }),
        }
    }

    fn long_status(&self) -> Option<StatusTail> {
        match self.table.status {
            StatusKind::Betaflight {
                has_temperature,
                has_battery_profiles,
            } => Some(self.status_tail(has_temperature, has_battery_profiles)),
            StatusKind::Inav | StatusKind::Cleanflight | StatusKind::MultiWii => None,
        }
    }

    fn status(&self) -> Status {
        let tail = self.long_status();
        Status {
            head: self.status_head(),
            load_pct: tail.is_some().then_some(12),
            gyro_cycle_us: tail.is_some().then_some(0),
            tail,
        }
    }

    fn status_ex(&self) -> StatusEx {
        let short = if self.table.status == StatusKind::Inav {
            StatusExTail::Inav {
                arming_flags_low: (self.arming.told() & 0xffff) as u16,
                acc_calibration: 0x3f,
            }
        } else {
            StatusExTail::Cleanflight
        };
        let long = |tail| StatusExTail::Betaflight {
            pid_profile_count: 4,
            rate_profile: 0,
            tail,
        };
        StatusEx {
            head: self.status_head(),
            load_pct: 12,
            tail: self.long_status().map_or(short, long),
        }
    }

    fn inav_status(&self) -> InavStatus {
        InavStatus {
            cycle_time_us: 500,
            i2c_errors: 0,
            sensors: self.sensors(),
            load_pct: 12,
            profiles: 0,
            arming_flags: self.arming.told(),
            mode_flags: self.mode_flags().into(),
            mixer_profile: Some(0),
        }
    }

    fn analog(&self, quad: &Quad) -> Analog {
        let full = analog(quad);
        Analog {
            rssi: if self.hears_radio { 1023 } else { 0 },
            vbat_cv: full
                .vbat_cv
                .filter(|_| self.table.wire.analog_has_centivolts),
            ..full
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

fn inav_analog(quad: &Quad) -> InavAnalog {
    let battery = quad.battery();
    let (volts, amps) = (battery.voltage_v(), battery.current_a());
    let positive = |v: f64| libm::round(v).max(0.0) as u32;
    let remaining = battery.remaining();
    InavAnalog {
        // Full when plugged in; cells in the high nibble.
        flags: 1 | CELLS << 4,
        vbat_cv: positive(volts * 100.0) as u16,
        current_ca: whole(amps * 100.0),
        power_cw: positive(volts * amps * 100.0),
        drawn_mah: positive(battery.counted_mah()),
        drawn_mwh: positive(battery.counted_mah() * volts),
        remaining: positive(CAPACITY_MAH * remaining),
        percentage: positive(remaining * 100.0) as u8,
        rssi: 1023,
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

fn board_info(extent: Board) -> BoardInfo {
    let full = BoardInfo {
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
    };
    let short = BoardInfo {
        board: full.board,
        osd_type: Some(0),
        ..BoardInfo::default()
    };
    match extent {
        Board::Full => full,
        Board::Short => short,
        Board::Target => BoardInfo {
            capabilities: full.capabilities,
            target: full.target,
            ..short
        },
    }
}

/// Rounded, held inside 16 bits.
fn whole(v: f64) -> i16 {
    // `as` saturates and takes NaN to 0.
    libm::round(v) as i16
}
