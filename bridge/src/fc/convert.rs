//! MSP replies as samples in SI and our frames. The only place where MSP's units and signs are known.
//!
//! | MSP | Here |
//! | --- | --- |
//! | ATTITUDE roll 0.1 deg right +, pitch 0.1 deg nose DOWN +, yaw whole deg clockwise | rad, pitch nose up + |
//! | RAW_IMU acc counts, forward left up | m/s2, forward right down: (x, -y, -z) |
//! | RAW_IMU gyro counts, x roll right, y nose down, z counter-clockwise | rad/s: (x, -y, -z) |
//! | RAW_IMU mag counts, forward left up; all zero without a magnetometer | counts, (x, -y, -z); none |
//! | ALTITUDE cm, cm/s | m, m/s, up + |
//! | SONAR_ALTITUDE cm, corrected for tilt; 0 and less = none | m along body down |
//! | INAV_OPTICAL_FLOW deg/s, x roll right, y nose down, quality 0-100 | rad/s: (x, -y), 0-255 |
//! | RAW_GPS 1e-7 deg, m, cm/s, 0.1 deg, DOP times 100 | deg, m, m/s |
//! | ANALOG, BATTERY_STATE, INAV_ANALOG 0.1 or 0.01 V, 0.01 A | V, A |
//!
//! Source: `msp-facts` sections 4 and 5, measured against running Betaflight and INAV.

use crate::autopilot::door::FcBlocks;
use crate::sensor::gps::RawFix;
use core::time::Duration;
use msp::firmware::Firmware;
use msp::message::{
    Altitude, Analog, Attitude, BatteryState, InavAnalog, InavOpticalFlow, InavStatus, RawGps,
    RawImu, Reply, SonarAltitude, Status,
};
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::angle::wrap_pi;
use vehicle::{
    AttitudeSample, BaroSample, BatterySample, DownRange, FlowSample, ImuSample, In, Timestamp,
};

/// Time a reply of the fast group spends on a 115200 baud line after it was sampled (about 30 bytes of 86.8 us).
pub const REPLY_WIRE_TIME: Duration = Duration::from_micros(2_600);

/// Accelerometer scales that flight controllers use, counts per g.
const ACC_SCALES: [f64; 4] = [256.0, 512.0, 1024.0, 2048.0];
/// Samples at rest averaged before the accelerometer's scale is trusted.
const ACC_SCALE_SAMPLES: u32 = 20;

/// The four letters a firmware calls itself, for telemetry.
#[must_use]
pub const fn four_letters(firmware: Firmware) -> [u8; 4] {
    match firmware {
        Firmware::Betaflight => *b"BTFL",
        Firmware::Cleanflight => *b"CLFL",
        Firmware::Inav => *b"INAV",
        Firmware::MultiWii => *b"MWII",
        Firmware::Other(letters) => letters,
    }
}

/// What a status reply says about arming; none if it says nothing.
#[must_use]
pub fn arming_blocks(firmware: Firmware, reply: &Reply) -> Option<FcBlocks> {
    let (count, flags) = match reply {
        Reply::Status(Status {
            tail: Some(tail), ..
        }) => (tail.arming_disable_count, tail.arming_disable),
        Reply::StatusEx(status) => {
            let tail = status.betaflight()?;
            (tail.arming_disable_count, tail.arming_disable)
        }
        Reply::InavStatus(InavStatus { arming_flags, .. }) => (32, *arming_flags),
        _ => return None,
    };
    Some(FcBlocks {
        variant: four_letters(firmware),
        count,
        flags,
    })
}

/// Time of the controller's own loop in a status reply, us; 0 = it does not run.
#[must_use]
pub const fn cycle_time_us(reply: &Reply) -> Option<u16> {
    match reply {
        Reply::Status(s) => Some(s.head.cycle_time_us),
        Reply::StatusEx(s) => Some(s.head.cycle_time_us),
        Reply::InavStatus(s) => Some(s.cycle_time_us),
        _ => None,
    }
}

/// Converts replies of one flight controller; learns the scale of its accelerometer at rest.
#[derive(Clone, Debug)]
pub struct Convert {
    gyro_radps_per_count: f64,
    acc_mps2_per_count: Option<f64>,
    norm_sum: f64,
    norm_samples: u32,
}

impl Convert {
    /// For a firmware; where its accelerometer scale depends on the board, the norm at rest decides.
    #[must_use]
    pub fn new(firmware: Firmware) -> Self {
        Self {
            gyro_radps_per_count: (1.0 / firmware.gyro_counts_per_dps()).to_radians(),
            acc_mps2_per_count: firmware.acc_counts_per_g().map(|c| GRAVITY_MPS2 / c),
            norm_sum: 0.0,
            norm_samples: 0,
        }
    }

    /// Attitude as the controller's filter has it.
    #[must_use]
    pub fn attitude(&self, at: Timestamp, a: &Attitude) -> AttitudeSample {
        AttitudeSample {
            at,
            roll_rad: (f64::from(a.roll_ddeg) * 0.1).to_radians(),
            pitch_rad: -(f64::from(a.pitch_ddeg) * 0.1).to_radians(),
            heading_rad: wrap_pi(f64::from(a.yaw_deg).to_radians()),
        }
    }

    /// Inertial sample; none until the accelerometer's scale is known. `at_rest` allows learning it.
    pub fn imu(&mut self, at: Timestamp, raw: &RawImu, at_rest: bool) -> Option<ImuSample> {
        let [ax, ay, az] = raw.acc.map(f64::from);
        let [gx, gy, gz] = raw.gyro.map(f64::from);
        let [mx, my, mz] = raw.mag.map(f64::from);
        if self.acc_mps2_per_count.is_none() && at_rest {
            self.learn_scale(libm::sqrt(ax * ax + ay * ay + az * az));
        }
        let acc = self.acc_mps2_per_count?;
        let gyro = self.gyro_radps_per_count;
        Some(ImuSample {
            at,
            accel_mps2: In::new(ax, -ay, -az) * acc,
            gyro_radps: In::new(gx, -gy, -gz) * gyro,
            mag: (raw.mag != [0; 3]).then(|| In::new(mx, -my, -mz)),
        })
    }

    fn learn_scale(&mut self, norm_counts: f64) {
        self.norm_sum += norm_counts;
        self.norm_samples += 1;
        if self.norm_samples < ACC_SCALE_SAMPLES {
            return;
        }
        let mean = self.norm_sum / f64::from(self.norm_samples);
        (self.norm_sum, self.norm_samples) = (0.0, 0);
        // Within 10 % of a known scale the known one is meant; anything else is no accelerometer at rest.
        self.acc_mps2_per_count = ACC_SCALES
            .iter()
            .find(|s| (mean / **s - 1.0).abs() < 0.1)
            .map(|s| GRAVITY_MPS2 / s);
    }

    /// Barometric altitude.
    #[must_use]
    pub fn baro(&self, at: Timestamp, a: &Altitude) -> BaroSample {
        BaroSample {
            at,
            altitude_m: f64::from(a.altitude_cm) * 0.01,
            climb_mps: f64::from(a.vario_cms) * 0.01,
        }
    }

    /// Distance to the floor of the controller's own range finder, along body down at this cosine of tilt. Both firmwares
    /// say 0 where there is none.
    #[must_use]
    pub fn down_range(&self, at: Timestamp, s: &SonarAltitude, cos_tilt: f64) -> DownRange {
        let is_valid = (1..=1000).contains(&s.altitude_cm) && cos_tilt > 0.5;
        DownRange {
            at,
            distance_m: is_valid.then(|| f64::from(s.altitude_cm) * 0.01 / cos_tilt),
        }
    }

    /// Optical flow as INAV has it.
    #[must_use]
    pub fn flow(&self, at: Timestamp, f: &InavOpticalFlow) -> FlowSample {
        FlowSample {
            at,
            x_radps: f64::from(f.flow_x_dps).to_radians(),
            y_radps: -f64::from(f.flow_y_dps).to_radians(),
            quality: (u16::from(f.quality.min(100)) * 255 / 100) as u8,
        }
    }

    /// A satellite fix. The controller tells the dilution of precision, not the doubt: a receiver's range error of 2.5 m
    /// times that, and no fix without it.
    #[must_use]
    pub fn gps(&self, firmware: Firmware, g: &RawGps) -> RawFix {
        // INAV counts dimensions, Betaflight says yes.
        let mode = match (firmware, g.fix) {
            (_, 0) => 0,
            (Firmware::Inav, fix) => fix + 1,
            _ => 3,
        };
        let doubt_m = g.dop_e2.map(|dop| 2.5 * (f64::from(dop) * 0.01).max(0.5));
        RawFix {
            mode,
            place_deg: [f64::from(g.lat_e7) * 1e-7, f64::from(g.lon_e7) * 1e-7],
            altitude_m: f64::from(g.altitude_m),
            speed_mps: Some(f64::from(g.ground_speed_cms) * 0.01),
            track_deg: Some(f64::from(g.course_ddeg) * 0.1),
            climb_mps: None,
            doubt_m: doubt_m.map(|d| [d, d, 1.5 * d]),
            satellites: g.satellites,
        }
    }

    /// Battery from the detailed message.
    #[must_use]
    pub fn battery(&self, at: Timestamp, b: &BatteryState) -> BatterySample {
        let voltage_v = b
            .vbat_cv
            .map_or(f64::from(b.vbat_dv) * 0.1, |cv| f64::from(cv) * 0.01);
        let used_mah = f64::from(b.drawn_mah);
        let remaining = if b.cells == 0 {
            None
        } else if b.capacity_mah > 0 {
            Some((1.0 - used_mah / f64::from(b.capacity_mah)).clamp(0.0, 1.0))
        } else {
            // Resting voltage of a lithium cell: 4.2 V full, 3.3 V empty.
            Some(((voltage_v / f64::from(b.cells) - 3.3) / 0.9).clamp(0.0, 1.0))
        };
        BatterySample {
            at,
            voltage_v,
            current_a: f64::from(b.current_ca) * 0.01,
            used_mah,
            cells: b.cells,
            remaining,
        }
    }

    /// Battery from the message of controllers that have none of its own: cells and capacity are not told.
    #[must_use]
    pub fn battery_of_analog(&self, at: Timestamp, a: &Analog) -> BatterySample {
        BatterySample {
            at,
            voltage_v: a
                .vbat_cv
                .map_or(f64::from(a.vbat_dv) * 0.1, |cv| f64::from(cv) * 0.01),
            current_a: f64::from(a.current_ca) * 0.01,
            used_mah: f64::from(a.drawn_mah),
            cells: 0,
            remaining: None,
        }
    }

    /// Battery of INAV, which judges itself what is left.
    #[must_use]
    pub fn battery_of_inav(&self, at: Timestamp, a: &InavAnalog) -> BatterySample {
        BatterySample {
            at,
            voltage_v: f64::from(a.vbat_cv) * 0.01,
            current_a: f64::from(a.current_ca) * 0.01,
            used_mah: f64::from(a.drawn_mah),
            cells: a.cells(),
            remaining: (a.cells() > 0).then(|| (f64::from(a.percentage) * 0.01).min(1.0)),
        }
    }

    /// Received signal strength, 0..=254, of the controller's 0..=1023.
    #[must_use]
    pub fn rssi(&self, of_1023: u16) -> u8 {
        (u32::from(of_1023).min(1023) * 254 / 1023) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    fn at_rest_scale(counts: i16) -> Option<f64> {
        let mut c = Convert::new(Firmware::Betaflight);
        let raw = RawImu {
            acc: [0, 0, counts],
            gyro: [0; 3],
            mag: [0; 3],
        };
        (0..40)
            .filter_map(|_| c.imu(Timestamp::ZERO, &raw, true))
            .last()
            .map(|s| s.accel_mps2.z())
    }

    #[test]
    fn nose_down_of_the_controller_is_negative_pitch_here() {
        let c = Convert::new(Firmware::Betaflight);
        let s = c.attitude(
            Timestamp::ZERO,
            &Attitude {
                roll_ddeg: 200,
                pitch_ddeg: 150,
                yaw_deg: 270,
            },
        );
        assert_abs_diff_eq!(s.roll_rad.to_degrees(), 20.0, epsilon = 1e-9);
        assert_abs_diff_eq!(s.pitch_rad.to_degrees(), -15.0, epsilon = 1e-9);
        assert_abs_diff_eq!(s.heading_rad.to_degrees(), -90.0, epsilon = 1e-9);
    }

    #[test]
    fn what_the_controllers_own_sensors_say_is_si_in_our_axes() {
        let c = Convert::new(Firmware::Inav);
        let at = Timestamp::ZERO;
        let height = |altitude_cm, cos| {
            c.down_range(at, &SonarAltitude { altitude_cm }, cos)
                .distance_m
        };
        assert_abs_diff_eq!(height(90, 0.9).unwrap(), 1.0, epsilon = 1e-9);
        assert_eq!(
            [height(0, 1.0), height(-1, 1.0), height(90, 0.2)],
            [None; 3]
        );
        let flow = c.flow(
            at,
            &InavOpticalFlow {
                quality: 80,
                flow_x_dps: 90,
                flow_y_dps: -30,
                body_x_dps: 0,
                body_y_dps: 0,
            },
        );
        assert_abs_diff_eq!(flow.x_radps.to_degrees(), 90.0, epsilon = 1e-9);
        assert_abs_diff_eq!(flow.y_radps.to_degrees(), 30.0, epsilon = 1e-9);
        assert_eq!(flow.quality, 204);
        let raw = RawGps {
            fix: 2,
            satellites: 11,
            lat_e7: -349_193_630,
            lon_e7: -561_673_820,
            altitude_m: 40,
            ground_speed_cms: 150,
            course_ddeg: 450,
            dop_e2: Some(120),
        };
        let fix = c.gps(Firmware::Inav, &raw);
        assert_eq!((fix.mode, fix.satellites), (3, 11));
        assert_abs_diff_eq!(fix.place_deg[0], -34.919_363, epsilon = 1e-9);
        assert_abs_diff_eq!(fix.doubt_m.unwrap()[0], 3.0, epsilon = 1e-9);
        assert_eq!(
            c.gps(
                Firmware::Betaflight,
                &RawGps {
                    fix: 1,
                    dop_e2: None,
                    ..raw
                }
            )
            .doubt_m,
            None
        );
        assert_eq!(c.gps(Firmware::Inav, &RawGps { fix: 1, ..raw }).mode, 2);
    }

    #[test]
    fn one_g_is_recognised_on_every_known_board_and_nothing_else_is() {
        for counts in [256, 500, 1024, 2100] {
            assert_abs_diff_eq!(at_rest_scale(counts).unwrap(), -9.80665, epsilon = 0.5);
        }
        assert_eq!(at_rest_scale(700), None);
    }

    #[test]
    fn gyro_of_betaflight_reads_30_degrees_per_second_at_491_counts() {
        let mut c = Convert::new(Firmware::Betaflight);
        let rest = RawImu {
            acc: [0, 0, 2048],
            gyro: [0; 3],
            mag: [0; 3],
        };
        for _ in 0..40 {
            c.imu(Timestamp::ZERO, &rest, true);
        }
        let turning = RawImu {
            acc: [0, 0, 2048],
            gyro: [491, 491, 491],
            mag: [0; 3],
        };
        let s = c.imu(Timestamp::ZERO, &turning, false).unwrap();
        let [x, y, z]: [f64; 3] = s.gyro_radps.into();
        assert_abs_diff_eq!(x.to_degrees(), 29.94, epsilon = 0.01);
        assert_abs_diff_eq!(y.to_degrees(), -29.94, epsilon = 0.01);
        assert_abs_diff_eq!(z.to_degrees(), -29.94, epsilon = 0.01);
    }

    #[test]
    fn every_count_the_wire_can_carry_gives_finite_values() {
        let mut c = Convert::new(Firmware::Inav);
        for v in [i16::MIN, -1, 0, 1, i16::MAX] {
            let s = c
                .imu(
                    Timestamp::ZERO,
                    &RawImu {
                        acc: [v; 3],
                        gyro: [v; 3],
                        mag: [v; 3],
                    },
                    true,
                )
                .unwrap();
            assert!(s.accel_mps2.is_finite() && s.gyro_radps.is_finite());
        }
    }
}
