//! Where the vehicle is, how it moves, how sure it is.

use super::table::View;
use crate::gcs::convert::{heading_cdeg, heading_deg, quaternion, to_i16, to_i32, to_u16};
use crate::gcs::origin::origin_message;
use mavlink_dialect::Message;
use mavlink_dialect::standard::{
    ALTITUDE_DATA, ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, ESTIMATOR_STATUS_DATA,
    EstimatorStatusFlags, GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, GpsFixType, HIGHRES_IMU_DATA,
    HOME_POSITION_DATA, HighresImuUpdatedFlags, LOCAL_POSITION_NED_DATA, MavEstimatorType,
    MavFrame, MavMessage, ODOMETRY_DATA, RAW_IMU_DATA, SCALED_IMU_DATA, VFR_HUD_DATA,
};
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::{Frd, In, Ned, Rot};

/// Variance of roll and pitch in ODOMETRY, rad2. They come from the flight controller, which tells none: 2 degrees.
const TILT_VARIANCE: f32 = 1.2e-3;
/// Below this speed the course over ground is noise, m/s.
const MIN_COURSE_SPEED_MPS: f64 = 0.2;

pub(super) fn attitude(v: &View<'_>, out: &mut Vec<Message>) {
    let nav = &v.snapshot.nav;
    if !nav.health.attitude {
        return;
    }
    let (roll, pitch, yaw) = nav.attitude.roll_pitch_yaw();
    out.push(
        MavMessage::ATTITUDE(ATTITUDE_DATA {
            time_boot_ms: nav.at.boot_ms(),
            roll: roll as f32,
            pitch: pitch as f32,
            yaw: yaw as f32,
            rollspeed: nav.rates_radps.x() as f32,
            pitchspeed: nav.rates_radps.y() as f32,
            yawspeed: nav.rates_radps.z() as f32,
        })
        .into(),
    );
}

pub(super) fn attitude_quaternion(v: &View<'_>, out: &mut Vec<Message>) {
    let nav = &v.snapshot.nav;
    if !nav.health.attitude {
        return;
    }
    let [q1, q2, q3, q4] = quaternion(&nav.attitude);
    out.push(
        MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
            time_boot_ms: nav.at.boot_ms(),
            q1,
            q2,
            q3,
            q4,
            rollspeed: nav.rates_radps.x() as f32,
            pitchspeed: nav.rates_radps.y() as f32,
            yawspeed: nav.rates_radps.z() as f32,
            // All zero: no offset.
            repr_offset_q: [0.0; 4],
        })
        .into(),
    );
}

pub(super) fn local_position_ned(v: &View<'_>, out: &mut Vec<Message>) {
    let nav = &v.snapshot.nav;
    if !nav.health.position {
        return;
    }
    out.push(
        MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
            time_boot_ms: nav.at.boot_ms(),
            x: nav.position.x() as f32,
            y: nav.position.y() as f32,
            z: nav.position.z() as f32,
            vx: nav.velocity.x() as f32,
            vy: nav.velocity.y() as f32,
            vz: nav.velocity.z() as f32,
        })
        .into(),
    );
}

pub(super) fn global_position_int(v: &View<'_>, out: &mut Vec<Message>) {
    let nav = &v.snapshot.nav;
    if !nav.health.position {
        return;
    }
    let here = v.geo.to_global(nav.position);
    out.push(
        MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
            time_boot_ms: nav.at.boot_ms(),
            lat: here.lat_e7,
            lon: here.lon_e7,
            alt: to_i32(here.alt_m * 1e3),
            relative_alt: to_i32((v.snapshot.home.z() - nav.position.z()) * 1e3),
            vx: to_i16(nav.velocity.x() * 1e2),
            vy: to_i16(nav.velocity.y() * 1e2),
            vz: to_i16(nav.velocity.z() * 1e2),
            hdg: heading_cdeg(nav.yaw_rad()),
        })
        .into(),
    );
}

/// A fix of a receiver older than this is none, s.
const FIX_FRESH_S: f64 = 5.0;

/// A receiver's fix as it is; without a receiver one is reported only by KST_GPS_EMU, and only while the place on the plan is known.
pub(super) fn gps_raw_int(v: &View<'_>, out: &mut Vec<Message>) {
    let nav = &v.snapshot.nav;
    let unknown = GPS_RAW_INT_DATA {
        time_usec: nav.at.us(),
        fix_type: GpsFixType::GPS_FIX_TYPE_NO_FIX,
        eph: u16::MAX,
        epv: u16::MAX,
        vel: u16::MAX,
        cog: u16::MAX,
        satellites_visible: 0,
        ..GPS_RAW_INT_DATA::default()
    };
    let receiver = v
        .snapshot
        .gnss
        .filter(|fix| v.snapshot.at.seconds_since(fix.at) < FIX_FRESH_S);
    let message = if let Some(fix) = receiver {
        let speed = fix.velocity.map_or(f64::NAN, |v| v.norm_xy());
        GPS_RAW_INT_DATA {
            time_usec: fix.at.us(),
            lat: to_i32(fix.place_deg[0] * 1e7),
            lon: to_i32(fix.place_deg[1] * 1e7),
            alt: to_i32(fix.altitude_m * 1e3),
            vel: if speed.is_finite() {
                to_u16(speed * 1e2)
            } else {
                u16::MAX
            },
            fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
            satellites_visible: fix.satellites,
            h_acc: to_i32(fix.std_m[0] * 1e3).unsigned_abs(),
            v_acc: to_i32(fix.std_m[1] * 1e3).unsigned_abs(),
            ..unknown
        }
    } else if v.settings.ground.gps_emulation && nav.health.position {
        let here = v.geo.to_global(nav.position);
        let std_xy = nav.position_std_m.norm_xy();
        let speed = nav.velocity.norm_xy();
        let course = libm::atan2(nav.velocity.y(), nav.velocity.x());
        GPS_RAW_INT_DATA {
            lat: here.lat_e7,
            lon: here.lon_e7,
            alt: to_i32(here.alt_m * 1e3),
            // Dilution of precision as if one metre were the error of the ranges.
            eph: to_u16((std_xy * 1e2).max(1.0)),
            epv: to_u16((nav.position_std_m.z() * 1e2).max(1.0)),
            vel: to_u16(speed * 1e2),
            cog: if speed > MIN_COURSE_SPEED_MPS {
                heading_cdeg(course)
            } else {
                u16::MAX
            },
            fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
            satellites_visible: 10,
            alt_ellipsoid: to_i32(here.alt_m * 1e3),
            h_acc: to_i32(std_xy * 1e3).unsigned_abs(),
            v_acc: to_i32(nav.position_std_m.z() * 1e3).unsigned_abs(),
            vel_acc: to_i32(nav.velocity_std_mps.norm() * 1e3).unsigned_abs(),
            hdg_acc: to_i32(nav.yaw_std_rad.to_degrees() * 1e5).unsigned_abs(),
            // 0 means "no heading", so north is 36000.
            yaw: match heading_cdeg(nav.yaw_rad()) {
                0 => 36_000,
                heading => heading,
            },
            ..unknown
        }
    } else {
        unknown
    };
    out.push(MavMessage::GPS_RAW_INT(message).into());
}

pub(super) fn gps_global_origin(v: &View<'_>, out: &mut Vec<Message>) {
    out.push(origin_message(v.now, v.geo.origin()).into());
}

pub(super) fn home_position(v: &View<'_>, out: &mut Vec<Message>) {
    let home = v.snapshot.home;
    let there = v.geo.to_global(home);
    let heading = Rot::<Frd, Ned>::from_roll_pitch_yaw(0.0, 0.0, v.snapshot.home_yaw_rad);
    out.push(
        MavMessage::HOME_POSITION(HOME_POSITION_DATA {
            latitude: there.lat_e7,
            longitude: there.lon_e7,
            altitude: to_i32(there.alt_m * 1e3),
            x: home.x() as f32,
            y: home.y() as f32,
            z: home.z() as f32,
            q: quaternion(&heading),
            // Straight down.
            approach_x: 0.0,
            approach_y: 0.0,
            approach_z: 0.0,
            time_usec: v.now.us(),
        })
        .into(),
    );
}

pub(super) fn vfr_hud(v: &View<'_>, out: &mut Vec<Message>) {
    let s = v.snapshot;
    if !s.nav.health.attitude {
        return;
    }
    let speed = s.nav.velocity.norm_xy() as f32;
    let thrust = if s.is_armed { s.thrust_target } else { 0.0 };
    out.push(
        MavMessage::VFR_HUD(VFR_HUD_DATA {
            // No wind indoors.
            airspeed: speed,
            groundspeed: speed,
            alt: v.geo.to_global(s.nav.position).alt_m as f32,
            climb: -s.nav.velocity.z() as f32,
            heading: heading_deg(s.nav.yaw_rad()),
            throttle: to_u16(thrust.clamp(0.0, 1.0) * 100.0),
        })
        .into(),
    );
}

pub(super) fn altitude(v: &View<'_>, out: &mut Vec<Message>) {
    let s = v.snapshot;
    if !s.nav.health.height {
        return;
    }
    let up = -s.nav.position.z();
    out.push(
        MavMessage::ALTITUDE(ALTITUDE_DATA {
            time_usec: s.nav.at.us(),
            altitude_monotonic: s.baro.map_or(up, |b| b.altitude_m) as f32,
            altitude_amsl: v.geo.to_global(s.nav.position).alt_m as f32,
            altitude_local: up as f32,
            altitude_relative: (s.home.z() - s.nav.position.z()) as f32,
            altitude_terrain: (up - s.nav.height_m) as f32,
            bottom_clearance: s.nav.height_m as f32,
        })
        .into(),
    );
}

/// Position in LOCAL_NED, velocity in BODY_FRD, with how sure they are; also while the place is lost (quality -1).
pub(super) fn odometry(v: &View<'_>, out: &mut Vec<Message>) {
    let nav = &v.snapshot.nav;
    if !nav.health.attitude {
        return;
    }
    let square = |std: f64| (std * std) as f32;
    let body: In<Frd> = nav.attitude.inverse() * nav.velocity;
    // Row-major upper triangles of 6 x 6: x, y, z, roll, pitch, yaw; the diagonal is at 0, 6, 11, 15, 18, 20.
    let mut pose_covariance = [0.0f32; 21];
    pose_covariance[0] = square(nav.position_std_m.x());
    pose_covariance[6] = square(nav.position_std_m.y());
    pose_covariance[11] = square(nav.position_std_m.z());
    pose_covariance[15] = TILT_VARIANCE;
    pose_covariance[18] = TILT_VARIANCE;
    pose_covariance[20] = square(nav.yaw_std_rad);
    let mut velocity_covariance = [0.0f32; 21];
    // Turning by yaw mixes x and y: the larger of the two stands for both.
    let std_xy = nav.velocity_std_mps.x().max(nav.velocity_std_mps.y());
    velocity_covariance[0] = square(std_xy);
    velocity_covariance[6] = square(std_xy);
    velocity_covariance[11] = square(nav.velocity_std_mps.z());
    out.push(
        MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: nav.at.us(),
            frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
            x: nav.position.x() as f32,
            y: nav.position.y() as f32,
            z: nav.position.z() as f32,
            q: quaternion(&nav.attitude),
            vx: body.x() as f32,
            vy: body.y() as f32,
            vz: body.z() as f32,
            rollspeed: nav.rates_radps.x() as f32,
            pitchspeed: nav.rates_radps.y() as f32,
            yawspeed: nav.rates_radps.z() as f32,
            pose_covariance,
            velocity_covariance,
            reset_counter: nav.localization.reset_counter,
            estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_LIDAR,
            quality: if nav.health.position {
                to_i16(nav.localization.fit.clamp(0.0, 1.0) * 100.0).clamp(1, 100) as i8
            } else {
                -1
            },
        })
        .into(),
    );
}

pub(super) fn estimator_status(v: &View<'_>, out: &mut Vec<Message>) {
    let nav = &v.snapshot.nav;
    let mut flags = EstimatorStatusFlags::empty();
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_ATTITUDE,
        nav.health.attitude,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_VELOCITY_HORIZ,
        nav.health.velocity,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_VELOCITY_VERT,
        nav.health.height,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_REL,
        nav.health.velocity,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_ABS,
        nav.health.position,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_POS_VERT_ABS,
        nav.health.height,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_POS_VERT_AGL,
        nav.health.height
            && v.snapshot
                .down_range
                .is_some_and(|r| r.distance_m.is_some()),
    );
    out.push(
        MavMessage::ESTIMATOR_STATUS(ESTIMATOR_STATUS_DATA {
            time_usec: nav.at.us(),
            flags,
            // Innovation test ratios are not in the snapshot.
            vel_ratio: f32::NAN,
            pos_horiz_ratio: f32::NAN,
            pos_vert_ratio: f32::NAN,
            mag_ratio: f32::NAN,
            hagl_ratio: f32::NAN,
            tas_ratio: f32::NAN,
            pos_horiz_accuracy: nav.position_std_m.norm_xy() as f32,
            pos_vert_accuracy: nav.position_std_m.z() as f32,
        })
        .into(),
    );
}

pub(super) fn highres_imu(v: &View<'_>, out: &mut Vec<Message>) {
    let Some(imu) = v.snapshot.imu else { return };
    let mut fields_updated = HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XACC
        | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_YACC
        | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZACC
        | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XGYRO
        | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_YGYRO
        | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZGYRO;
    fields_updated.set(
        HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_PRESSURE_ALT,
        v.snapshot.baro.is_some(),
    );
    out.push(
        MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA {
            time_usec: imu.at.us(),
            xacc: imu.accel_mps2.x() as f32,
            yacc: imu.accel_mps2.y() as f32,
            zacc: imu.accel_mps2.z() as f32,
            xgyro: imu.gyro_radps.x() as f32,
            ygyro: imu.gyro_radps.y() as f32,
            zgyro: imu.gyro_radps.z() as f32,
            // MSP does not tell the scale of the magnetometer: its counts are in RAW_IMU.
            xmag: f32::NAN,
            ymag: f32::NAN,
            zmag: f32::NAN,
            abs_pressure: f32::NAN,
            diff_pressure: f32::NAN,
            pressure_alt: v.snapshot.baro.map_or(f32::NAN, |b| b.altitude_m as f32),
            temperature: f32::NAN,
            fields_updated,
            id: 0,
        })
        .into(),
    );
}

pub(super) fn scaled_imu(v: &View<'_>, out: &mut Vec<Message>) {
    let Some(imu) = v.snapshot.imu else { return };
    let milli_g = |mps2: f64| to_i16(mps2 / GRAVITY_MPS2 * 1e3);
    let milli_radps = |radps: f64| to_i16(radps * 1e3);
    out.push(
        MavMessage::SCALED_IMU(SCALED_IMU_DATA {
            time_boot_ms: imu.at.boot_ms(),
            xacc: milli_g(imu.accel_mps2.x()),
            yacc: milli_g(imu.accel_mps2.y()),
            zacc: milli_g(imu.accel_mps2.z()),
            xgyro: milli_radps(imu.gyro_radps.x()),
            ygyro: milli_radps(imu.gyro_radps.y()),
            zgyro: milli_radps(imu.gyro_radps.z()),
            ..SCALED_IMU_DATA::default()
        })
        .into(),
    );
}

/// Accelerometer and gyro as in SCALED_IMU (as other autopilots send them), the magnetometer in its own counts.
pub(super) fn raw_imu(v: &View<'_>, out: &mut Vec<Message>) {
    let Some(imu) = v.snapshot.imu else { return };
    let milli_g = |mps2: f64| to_i16(mps2 / GRAVITY_MPS2 * 1e3);
    let milli_radps = |radps: f64| to_i16(radps * 1e3);
    let mag = imu.mag.unwrap_or_default();
    out.push(
        MavMessage::RAW_IMU(RAW_IMU_DATA {
            time_usec: imu.at.us(),
            xacc: milli_g(imu.accel_mps2.x()),
            yacc: milli_g(imu.accel_mps2.y()),
            zacc: milli_g(imu.accel_mps2.z()),
            xgyro: milli_radps(imu.gyro_radps.x()),
            ygyro: milli_radps(imu.gyro_radps.y()),
            zgyro: milli_radps(imu.gyro_radps.z()),
            xmag: to_i16(mag.x()),
            ymag: to_i16(mag.y()),
            zmag: to_i16(mag.z()),
            ..RAW_IMU_DATA::default()
        })
        .into(),
    );
}
