//! What control follows, for tuning plots.

use super::table::View;
use crate::gcs::convert::quaternion;
use mavlink_dialect::Message;
use mavlink_dialect::standard::{
    ATTITUDE_TARGET_DATA, AttitudeTargetTypemask, MavFrame, MavMessage,
    POSITION_TARGET_LOCAL_NED_DATA, PositionTargetTypemask,
};
use vehicle::{Heading, Setpoint};

pub(super) fn attitude_target(v: &View<'_>, out: &mut Vec<Message>) {
    let s = v.snapshot;
    if !s.is_armed {
        return;
    }
    out.push(
        MavMessage::ATTITUDE_TARGET(ATTITUDE_TARGET_DATA {
            time_boot_ms: s.at.boot_ms(),
            type_mask: AttitudeTargetTypemask::ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
                | AttitudeTargetTypemask::ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
                | AttitudeTargetTypemask::ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE,
            q: quaternion(&s.attitude_target),
            body_roll_rate: 0.0,
            body_pitch_rate: 0.0,
            body_yaw_rate: 0.0,
            thrust: s.thrust_target.clamp(0.0, 1.0) as f32,
        })
        .into(),
    );
}

pub(super) fn position_target_local_ned(v: &View<'_>, out: &mut Vec<Message>) {
    use PositionTargetTypemask as Ignore;
    let s = v.snapshot;
    let xy = Ignore::POSITION_TARGET_TYPEMASK_X_IGNORE | Ignore::POSITION_TARGET_TYPEMASK_Y_IGNORE;
    let z = Ignore::POSITION_TARGET_TYPEMASK_Z_IGNORE;
    let (x_m, y_m, z_m, heading, not_used) = match s.setpoint {
        Some(Setpoint::Hover { position, heading }) => (
            position.x(),
            position.y(),
            position.z(),
            heading,
            Ignore::empty(),
        ),
        Some(Setpoint::Land {
            position, heading, ..
        }) => (position.x(), position.y(), 0.0, heading, z),
        Some(Setpoint::Velocity {
            down_m, heading, ..
        }) => (
            0.0,
            0.0,
            down_m.unwrap_or(0.0),
            heading,
            if down_m.is_some() { xy } else { xy | z },
        ),
        Some(Setpoint::Attitude { .. } | Setpoint::Idle | Setpoint::Sticks(_)) | None => return,
    };
    let (yaw, yaw_rate, turn_not_used) = match heading {
        Heading::Yaw(yaw) => (yaw, 0.0, Ignore::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE),
        Heading::Rate(rate) => (0.0, rate, Ignore::POSITION_TARGET_TYPEMASK_YAW_IGNORE),
    };
    let accel = Ignore::POSITION_TARGET_TYPEMASK_AX_IGNORE
        | Ignore::POSITION_TARGET_TYPEMASK_AY_IGNORE
        | Ignore::POSITION_TARGET_TYPEMASK_AZ_IGNORE;
    out.push(
        MavMessage::POSITION_TARGET_LOCAL_NED(POSITION_TARGET_LOCAL_NED_DATA {
            time_boot_ms: s.at.boot_ms(),
            coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
            type_mask: not_used | turn_not_used | accel,
            x: x_m as f32,
            y: y_m as f32,
            z: z_m as f32,
            vx: s.velocity_target.x() as f32,
            vy: s.velocity_target.y() as f32,
            vz: s.velocity_target.z() as f32,
            afx: 0.0,
            afy: 0.0,
            afz: 0.0,
            yaw: yaw as f32,
            yaw_rate: yaw_rate as f32,
        })
        .into(),
    );
}
