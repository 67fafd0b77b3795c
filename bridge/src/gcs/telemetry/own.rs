//! What no standard message carries: our own messages of `kestrel.xml`, on request or by interval.

use super::table::View;
use mavlink_dialect::Message;
use mavlink_dialect::raw::{
    KESTREL_AVOIDANCE_DATA, KESTREL_CONTROL_DATA, KESTREL_LOCALIZATION_DATA, KESTREL_LOOP_DATA,
    MavMessage,
};
use planner::navigator::SteeringState;
use planner::vfh::sector_of;
use vehicle::LocalizationState;

pub(super) fn localization(v: &View<'_>, out: &mut Vec<Message>) {
    let l = &v.snapshot.nav.localization;
    let pose = l.pose.map_or([f32::NAN; 3], |p| {
        [p.x_m as f32, p.y_m as f32, p.yaw_rad as f32]
    });
    out.push(
        MavMessage::KESTREL_LOCALIZATION(KESTREL_LOCALIZATION_DATA {
            time_boot_ms: v.snapshot.at.boot_ms(),
            particles: l.particles,
            effective_particles: l.effective_particles as f32,
            cluster_mass: l.mass as f32,
            fit: l.fit as f32,
            x: pose[0],
            y: pose[1],
            yaw: pose[2],
            state: match l.state {
                LocalizationState::Off => 0,
                LocalizationState::Searching => 1,
                LocalizationState::Localized => 2,
                LocalizationState::Lost => 3,
            },
            reset_counter: l.reset_counter,
        })
        .into(),
    );
}

pub(super) fn avoidance(v: &View<'_>, out: &mut Vec<Message>) {
    let a = &v.snapshot.avoidance;
    out.push(
        MavMessage::KESTREL_AVOIDANCE(KESTREL_AVOIDANCE_DATA {
            time_boot_ms: v.snapshot.at.boot_ms(),
            threshold: v.settings.vfh.threshold as f32,
            chosen: a.chosen_rad.map_or(f32::NAN, |c| c as f32),
            nearest: a.nearest_m as f32,
            sector: a.chosen_rad.map_or(-1, |c| sector_of(c) as i16),
            reason: match a.state {
                SteeringState::Clear => 0,
                SteeringState::Avoiding => 1,
                SteeringState::Evading => 2,
                SteeringState::Blocked => 3,
            },
        })
        .into(),
    );
}

pub(super) fn control(v: &View<'_>, out: &mut Vec<Message>) {
    let s = v.snapshot;
    let [roll, pitch, yaw] = {
        let (roll, pitch, yaw) = s.attitude_target.roll_pitch_yaw();
        [roll, pitch, yaw].map(|a| a as f32)
    };
    let three = |v: &vehicle::In<vehicle::Ned>| [v.x() as f32, v.y() as f32, v.z() as f32];
    out.push(
        MavMessage::KESTREL_CONTROL(KESTREL_CONTROL_DATA {
            time_boot_ms: s.at.boot_ms(),
            velocity_sp: three(&s.velocity_target),
            velocity: three(&s.nav.velocity),
            accel_sp: three(&s.accel_target),
            roll_sp: roll,
            pitch_sp: pitch,
            yaw_sp: yaw,
            yaw_rate_sp: s.yaw_rate_target_radps as f32,
            thrust: s.thrust_target as f32,
        })
        .into(),
    );
}

pub(super) fn flight_loop(v: &View<'_>, out: &mut Vec<Message>) {
    let (l, fc) = (&v.snapshot.flight_loop, &v.snapshot.fc);
    let us = |us: u64| u32::try_from(us).unwrap_or(u32::MAX);
    out.push(
        MavMessage::KESTREL_LOOP(KESTREL_LOOP_DATA {
            time_boot_ms: v.snapshot.at.boot_ms(),
            ticks: us(l.ticks),
            missed: us(l.missed),
            sample_to_command_p50: us(l.sample_to_command.p50_us),
            sample_to_command_p99: us(l.sample_to_command.p99_us),
            sample_to_command_max: us(l.sample_to_command.max_us),
            reply_to_command_p50: us(l.reply_to_command.p50_us),
            reply_to_command_p99: us(l.reply_to_command.p99_us),
            round_trip: fc.round_trip_us as u32,
            service_rate: fc.service_rate_hz as f32,
        })
        .into(),
    );
}
