//! What the console prints: set point, status, parameters. Plain ASCII, one fact a line.

use crate::autopilot::door::{KeySetpoint, LandedState, MissionState, Snapshot};
use crate::settings::Settings;
use std::fmt::Write;
use vehicle::LocalizationState;

/// The set point of key mode.
pub(super) fn setpoint(s: &KeySetpoint) -> String {
    format!(
        "roll {:+.3} nose-down {:+.3} yaw {:+.3} rad, x {:+.2} y {:+.2} height {:.2} m, mass {:.3} kg",
        s.roll_rad,
        s.nose_down_rad,
        s.yaw_rad,
        s.position.x(),
        s.position.y(),
        -s.position.z(),
        s.mass_kg
    )
}

/// The vehicle in a few lines.
pub(super) fn status(s: &Snapshot) -> String {
    let mut out = String::new();
    let armed = if s.is_armed { "armed" } else { "disarmed" };
    let landed = match s.landed {
        LandedState::OnGround => "on the ground",
        LandedState::InAir => "in the air",
        LandedState::TakingOff => "taking off",
        LandedState::Landing => "landing",
    };
    let keys = if s.is_key_mode {
        ", manual mode on"
    } else {
        ""
    };
    let because = if s.mode.because.is_failsafe() {
        format!(" ({})", s.mode.because.words())
    } else {
        String::new()
    };
    let p = s.nav.position;
    let place = match s.nav.localization.state {
        LocalizationState::Off => "off",
        LocalizationState::Searching => "searching",
        LocalizationState::Localized => "localized",
        LocalizationState::Lost => "lost",
    };
    // Writing into a String cannot fail.
    let _ = writeln!(
        out,
        "mode {}{because}, {armed}, {landed}{keys}",
        s.mode.mode.name()
    );
    let _ = writeln!(
        out,
        "x {:+.2} y {:+.2} height {:.2} m, heading {:.0} deg, {place}",
        p.x(),
        p.y(),
        -p.z(),
        s.nav.yaw_rad().to_degrees().rem_euclid(360.0)
    );
    if let Some(battery) = &s.battery {
        let left = battery
            .remaining
            .map_or(String::new(), |r| format!(", {:.0} %", 100.0 * r));
        let _ = writeln!(out, "battery {:.2} V{left}", battery.voltage_v);
    }
    let mission = match s.mission.state {
        MissionState::None => "none".to_owned(),
        MissionState::NotStarted => format!("{} items, not started", s.mission.total),
        MissionState::Active => format!("item {} of {}, active", s.mission.seq, s.mission.total),
        MissionState::Paused => format!("item {} of {}, paused", s.mission.seq, s.mission.total),
        MissionState::Complete => format!("{} items, complete", s.mission.total),
    };
    let _ = writeln!(out, "mission {mission}");
    if let (false, Some(why)) = (s.is_armed, &s.arm_blocked_by) {
        let _ = writeln!(out, "arming would be refused: {why}");
    }
    out
}

/// A parameter with its unit and where its value came from, or the nearest name.
pub(super) fn param(settings: &Settings, name: &str) -> String {
    match settings
        .rows()
        .find(|r| r.meta.id.eq_ignore_ascii_case(name))
    {
        Some(r) => {
            let unit = if r.meta.unit == "1" {
                String::new()
            } else {
                format!(" {}", r.meta.unit)
            };
            format!("{} = {}{unit} ({})\n", r.meta.id, r.value, r.origin)
        }
        None => match settings.nearest(name) {
            Some(nearest) => format!("no parameter `{name}`; did you mean `{nearest}`?\n"),
            None => format!("no parameter `{name}`\n"),
        },
    }
}
