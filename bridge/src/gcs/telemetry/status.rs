//! What state the vehicle is in.

use super::table::View;
use crate::autopilot::mode::Mode;
use crate::gcs::convert::{
    landed_state_code, mission_state_code, mode_to_px4, standard_mode, to_i16, to_i32, to_u16,
};
use crate::gcs::fence::Mitigation;
use mavlink_dialect::Message;
use mavlink_dialect::standard::{
    BATTERY_STATUS_DATA, CURRENT_MODE_DATA, EXTENDED_SYS_STATE_DATA, FENCE_STATUS_DATA,
    FLIGHT_INFORMATION_DATA, FenceBreach, FenceMitigate, MISSION_CURRENT_DATA,
    MavBatteryChargeState, MavBatteryFault, MavBatteryFunction, MavLandedState, MavMessage,
    MavStandardMode, MavSysStatusSensor, MavSysStatusSensorExtended, MissionState,
    NAMED_VALUE_FLOAT_DATA, RC_CHANNELS_DATA, SYS_STATUS_DATA, SYSTEM_TIME_DATA,
};
use vehicle::{BatterySample, Timestamp};

/// Sensors and functions. MAVSDK derives its health from these bits: `is_global_position_ok` is GPS (present and
/// healthy), `is_local_position_ok` any of GPS, flow, vision; a magnetometer that is never present would keep
/// `health_all_ok` false for ever, so the yaw that localization gives stands for it.
pub(super) fn sys_status(v: &View<'_>, out: &mut Vec<Message>) {
    use MavSysStatusSensor as Bit;
    let s = v.snapshot;
    let health = s.nav.health;
    let flow_ok = s.flow.is_some_and(|f| f.quality > 0);
    let down_ok = s.down_range.is_some_and(|r| r.distance_m.is_some());
    // A controller that still calibrates its gyro will not arm: stations that wait for health wait for that.
    let calibrates = s.fc.blocks.blockers().any(|b| {
        matches!(
            b.name,
            "BOOT_GRACE_TIME" | "CALIBRATING" | "SENSORS_CALIBRATING"
        )
    });
    let imu_ok = health.attitude && s.fc.is_connected && !calibrates;
    // Bit, present, healthy.
    let table = [
        (Bit::MAV_SYS_STATUS_SENSOR_3D_GYRO, true, imu_ok),
        (
            Bit::MAV_SYS_STATUS_SENSOR_3D_ACCEL,
            true,
            imu_ok && s.imu_flags.is_none_or(|f| f.accel_is_gravity),
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_3D_MAG,
            true,
            s.imu_flags.map_or(health.position, |f| f.mag_is_earth),
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
            s.baro.is_some(),
            s.baro.is_some(),
        ),
        (Bit::MAV_SYS_STATUS_SENSOR_GPS, true, health.position),
        (
            Bit::MAV_SYS_STATUS_SENSOR_OPTICAL_FLOW,
            s.flow.is_some(),
            flow_ok && health.velocity,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_VISION_POSITION,
            true,
            health.position,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_LASER_POSITION,
            s.down_range.is_some(),
            down_ok,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL,
            true,
            s.fc.is_connected,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION,
            true,
            s.fc.is_connected && health.attitude,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_YAW_POSITION,
            true,
            health.attitude,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL,
            true,
            health.height,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL,
            true,
            health.position,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS,
            true,
            s.fc.is_connected,
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_RC_RECEIVER,
            true,
            s.fc.is_connected && !s.rc_us.is_empty(),
        ),
        // MAVProxy reads a missing health bit as a breach, fence or none.
        (
            Bit::MAV_SYS_STATUS_GEOFENCE,
            v.fence.is_set,
            !v.fence.is_outside,
        ),
        (Bit::MAV_SYS_STATUS_AHRS, true, health.attitude),
        (
            Bit::MAV_SYS_STATUS_SENSOR_BATTERY,
            s.battery.is_some(),
            s.battery.is_some() && !is_battery_low(v),
        ),
        (
            Bit::MAV_SYS_STATUS_SENSOR_PROXIMITY,
            s.scan.is_some(),
            s.rangers_alive,
        ),
        (
            Bit::MAV_SYS_STATUS_PREARM_CHECK,
            true,
            s.is_armed || s.arm_blocked_by.is_none(),
        ),
        (
            Bit::MAV_SYS_STATUS_OBSTACLE_AVOIDANCE,
            true,
            s.rangers_alive && health.position,
        ),
    ];
    let mut present = Bit::empty();
    let mut healthy = Bit::empty();
    for (bit, is_present, is_healthy) in table {
        present.set(bit, is_present);
        healthy.set(bit, is_healthy);
    }
    let battery = s.battery;
    out.push(
        MavMessage::SYS_STATUS(SYS_STATUS_DATA {
            onboard_control_sensors_present: present,
            onboard_control_sensors_enabled: present,
            onboard_control_sensors_health: healthy,
            // Per mille, of the flight controller.
            load: to_u16(s.fc.load_percent.clamp(0.0, 100.0) * 10.0),
            voltage_battery: battery.map_or(u16::MAX, |b| to_u16(b.voltage_v * 1e3)),
            current_battery: battery.map_or(-1, |b| current_ca(&b)),
            drop_rate_comm: 0,
            errors_comm: 0,
            errors_count1: u16::try_from(s.fc.bad_frames).unwrap_or(u16::MAX),
            errors_count2: u16::try_from(s.fc.timeouts).unwrap_or(u16::MAX),
            errors_count3: u16::try_from(s.flight_loop.missed).unwrap_or(u16::MAX),
            errors_count4: 0,
            battery_remaining: battery.map_or(-1, |b| remaining_percent(&b)),
            onboard_control_sensors_present_extended: MavSysStatusSensorExtended::empty(),
            onboard_control_sensors_enabled_extended: MavSysStatusSensorExtended::empty(),
            onboard_control_sensors_health_extended: MavSysStatusSensorExtended::empty(),
        })
        .into(),
    );
}

/// Centiamperes; never -1, which means unknown.
fn current_ca(b: &BatterySample) -> i16 {
    to_i16(b.current_a * 1e2).max(0)
}

/// Percent, -1 unknown.
fn remaining_percent(b: &BatterySample) -> i8 {
    b.remaining
        .map_or(-1, |share| to_i16(share.clamp(0.0, 1.0) * 100.0) as i8)
}

fn is_battery_low(v: &View<'_>) -> bool {
    let share = v.snapshot.battery.and_then(|b| b.remaining);
    share.is_some_and(|share| share * 100.0 < v.settings.autopilot.battery_low_percent)
}

pub(super) fn battery_status(v: &View<'_>, out: &mut Vec<Message>) {
    let Some(b) = v.snapshot.battery else { return };
    // Clients add the cells up. Only the pack's voltage is measured: each cell gets its share.
    let cells = match usize::from(b.cells) {
        0 => usize::try_from(v.settings.ground.battery_cells).unwrap_or(0),
        known => known,
    };
    let mut voltages = [u16::MAX; 10];
    let shown = cells.clamp(1, voltages.len());
    voltages[..shown].fill(to_u16(b.voltage_v * 1e3 / shown as f64));
    out.push(
        MavMessage::BATTERY_STATUS(BATTERY_STATUS_DATA {
            id: 0,
            battery_function: MavBatteryFunction::MAV_BATTERY_FUNCTION_ALL,
            current_consumed: to_i32(b.used_mah),
            energy_consumed: -1,
            temperature: i16::MAX,
            voltages,
            current_battery: current_ca(&b),
            battery_remaining: remaining_percent(&b),
            // 0 is unknown.
            time_remaining: v.snapshot.endurance_s.map_or(0, |s| to_i32(s).max(1)),
            charge_state: match (b.remaining, is_battery_low(v)) {
                (None, _) => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_UNDEFINED,
                (Some(_), false) => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK,
                (Some(_), true) => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_LOW,
            },
            voltages_ext: [0; 4],
            // The generated default is the first flag, not none.
            fault_bitmask: MavBatteryFault::empty(),
            ..BATTERY_STATUS_DATA::default()
        })
        .into(),
    );
}

/// Only while there is a fence.
pub(super) fn fence_status(v: &View<'_>, out: &mut Vec<Message>) {
    let fence = v.fence;
    if !fence.is_set {
        return;
    }
    out.push(
        MavMessage::FENCE_STATUS(FENCE_STATUS_DATA {
            breach_time: fence.breached_at.map_or(0, Timestamp::boot_ms),
            breach_count: fence.breaches,
            breach_status: u8::from(fence.is_outside),
            breach_type: if fence.breaches > 0 {
                FenceBreach::FENCE_BREACH_BOUNDARY
            } else {
                FenceBreach::FENCE_BREACH_NONE
            },
            breach_mitigation: match fence.mitigation {
                Mitigation::None => FenceMitigate::FENCE_MITIGATE_NONE,
                Mitigation::Stopping => FenceMitigate::FENCE_MITIGATE_VEL_LIMIT,
            },
        })
        .into(),
    );
}

pub(super) fn extended_sys_state(v: &View<'_>, out: &mut Vec<Message>) {
    let landed_state = match landed_state_code(v.snapshot.landed) {
        2 => MavLandedState::MAV_LANDED_STATE_IN_AIR,
        3 => MavLandedState::MAV_LANDED_STATE_TAKEOFF,
        4 => MavLandedState::MAV_LANDED_STATE_LANDING,
        _ => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
    };
    out.push(
        MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
            landed_state,
            ..EXTENDED_SYS_STATE_DATA::default()
        })
        .into(),
    );
}

pub(super) fn mission_current(v: &View<'_>, out: &mut Vec<Message>) {
    let mission = v.snapshot.mission;
    let mission_state = match mission_state_code(mission.state) {
        2 => MissionState::MISSION_STATE_NOT_STARTED,
        3 => MissionState::MISSION_STATE_ACTIVE,
        4 => MissionState::MISSION_STATE_PAUSED,
        5 => MissionState::MISSION_STATE_COMPLETE,
        _ => MissionState::MISSION_STATE_NO_MISSION,
    };
    out.push(
        MavMessage::MISSION_CURRENT(MISSION_CURRENT_DATA {
            seq: mission.seq,
            total: mission.total,
            mission_state,
            // 1 the vehicle flies missions now, 2 it is in another mode.
            mission_mode: if v.snapshot.mode.mode == Mode::Mission {
                1
            } else {
                2
            },
            mission_id: v.plan_ids.mission,
            fence_id: v.plan_ids.fence,
            rally_points_id: v.plan_ids.rally,
        })
        .into(),
    );
}

pub(super) fn current_mode(v: &View<'_>, out: &mut Vec<Message>) {
    let state = v.snapshot.mode;
    let custom_mode = mode_to_px4(state.mode).custom_mode();
    out.push(
        MavMessage::CURRENT_MODE(CURRENT_MODE_DATA {
            standard_mode: standard_mode_enum(state.mode),
            custom_mode,
            // 0: not known which mode the pilot meant when a failsafe took over.
            intended_custom_mode: if state.because.is_failsafe() {
                0
            } else {
                custom_mode
            },
        })
        .into(),
    );
}

/// MAV_STANDARD_MODE as the dialect's type.
pub(super) fn standard_mode_enum(mode: Mode) -> MavStandardMode {
    match standard_mode(mode) {
        1 => MavStandardMode::MAV_STANDARD_MODE_POSITION_HOLD,
        4 => MavStandardMode::MAV_STANDARD_MODE_ALTITUDE_HOLD,
        5 => MavStandardMode::MAV_STANDARD_MODE_SAFE_RECOVERY,
        6 => MavStandardMode::MAV_STANDARD_MODE_MISSION,
        7 => MavStandardMode::MAV_STANDARD_MODE_LAND,
        8 => MavStandardMode::MAV_STANDARD_MODE_TAKEOFF,
        _ => MavStandardMode::MAV_STANDARD_MODE_NON_STANDARD,
    }
}

pub(super) fn system_time(v: &View<'_>, out: &mut Vec<Message>) {
    out.push(
        MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
            // 0 = unknown, when nobody told the wall time at boot.
            time_unix_usec: if v.boot_utc_us == 0 {
                0
            } else {
                v.boot_utc_us.saturating_add(v.now.us())
            },
            time_boot_ms: v.now.boot_ms(),
        })
        .into(),
    );
}

pub(super) fn rc_channels(v: &View<'_>, out: &mut Vec<Message>) {
    let s = v.snapshot;
    if s.rc_us.is_empty() {
        return;
    }
    let us = |i: usize| s.rc_us.get(i).copied().unwrap_or(u16::MAX);
    out.push(
        MavMessage::RC_CHANNELS(RC_CHANNELS_DATA {
            time_boot_ms: s.at.boot_ms(),
            chan1_raw: us(0),
            chan2_raw: us(1),
            chan3_raw: us(2),
            chan4_raw: us(3),
            chan5_raw: us(4),
            chan6_raw: us(5),
            chan7_raw: us(6),
            chan8_raw: us(7),
            chan9_raw: us(8),
            chan10_raw: us(9),
            chan11_raw: us(10),
            chan12_raw: us(11),
            chan13_raw: us(12),
            chan14_raw: us(13),
            chan15_raw: us(14),
            chan16_raw: us(15),
            chan17_raw: us(16),
            chan18_raw: us(17),
            chancount: s.rc_us.len() as u8,
            rssi: s.fc.rssi.unwrap_or(u8::MAX),
        })
        .into(),
    );
}

/// How punctual the flight loop is, us: age of the attitude at each RC frame, and our own share of it.
pub(super) fn timing(v: &View<'_>, out: &mut Vec<Message>) {
    let timing = v.snapshot.flight_loop;
    let (whole, own) = (timing.sample_to_command, timing.reply_to_command);
    let mut push = |name: &str, value: u64| {
        let mut field = [0u8; 10];
        field[..name.len()].copy_from_slice(name.as_bytes());
        out.push(
            MavMessage::NAMED_VALUE_FLOAT(NAMED_VALUE_FLOAT_DATA {
                time_boot_ms: v.snapshot.at.boot_ms(),
                value: value as f32,
                name: field.into(),
            })
            .into(),
        );
    };
    if whole.count > 0 {
        push("cmd_p50_us", whole.p50_us);
        push("cmd_p99_us", whole.p99_us);
        push("cmd_max_us", whole.max_us);
        push("missed", timing.missed);
    }
    if own.count > 0 {
        push("own_p50_us", own.p50_us);
        push("own_p99_us", own.p99_us);
        push("own_max_us", own.max_us);
    }
}

pub(super) fn flight_information(v: &View<'_>, out: &mut Vec<Message>) {
    let us = |at: Option<Timestamp>| at.map_or(0, Timestamp::us);
    out.push(
        MavMessage::FLIGHT_INFORMATION(FLIGHT_INFORMATION_DATA {
            time_boot_ms: v.now.boot_ms(),
            arming_time_utc: us(v.flights.armed_at),
            takeoff_time_utc: us(v.flights.took_off_at),
            flight_uuid: v.flights.count,
            landing_time: v.flights.landed_at.map_or(0, Timestamp::boot_ms),
        })
        .into(),
    );
}
