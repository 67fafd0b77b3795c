//! Status and the commands that fly.

use super::client::Client;
use super::console::print;
use anyhow::Result;
use mavlink_dialect::command::cmd;
use mavlink_dialect::mode::Px4Mode;
use mavlink_dialect::standard::MavMessage as Std;
use mavlink_dialect::{Message, raw};
use std::fmt::Write as _;

/// MAV_FRAME_LOCAL_NED, MAV_FRAME_GLOBAL_RELATIVE_ALT.
const LOCAL_NED: u8 = 1;
const RELATIVE_ALT: u8 = 3;
/// Near enough, m.
const ARRIVED_M: f64 = 0.2;

pub(super) fn status(client: &mut Client) -> Result<()> {
    let mut s = Status::default();
    let until = client.within(2.2);
    while !s.is_whole() {
        let Some(frame) = client.next(until) else {
            break;
        };
        if frame.from == client.vehicle {
            s.take(&frame.message);
        }
    }
    print(&s.to_text(client))
}

#[derive(Default)]
struct Status {
    beat: Option<raw::HEARTBEAT_DATA>,
    place: Option<[f32; 3]>,
    heading_rad: Option<f32>,
    battery: Option<(f64, i8)>,
    is_ready: Option<bool>,
    landed: Option<u8>,
    mission: Option<(u16, u16)>,
}

impl Status {
    fn is_whole(&self) -> bool {
        let rest = self.battery.is_some() && self.is_ready.is_some() && self.landed.is_some();
        self.beat.is_some() && self.place.is_some() && self.mission.is_some() && rest
    }

    fn take(&mut self, message: &Message) {
        match message {
            Message::Raw(raw::MavMessage::HEARTBEAT(m)) => self.beat = Some(m.clone()),
            Message::Standard(Std::LOCAL_POSITION_NED(m)) => self.place = Some([m.x, m.y, m.z]),
            Message::Standard(Std::ATTITUDE(m)) => self.heading_rad = Some(m.yaw),
            Message::Standard(Std::SYS_STATUS(m)) => {
                /// MAV_SYS_STATUS_PREARM_CHECK.
                const PREARM: u32 = 0x1000_0000;
                self.is_ready = Some(m.onboard_control_sensors_health.bits() & PREARM != 0);
                self.battery = Some((f64::from(m.voltage_battery) * 1e-3, m.battery_remaining));
            }
            Message::Standard(Std::EXTENDED_SYS_STATE(m)) => {
                self.landed = Some(m.landed_state as u8);
            }
            Message::Standard(Std::MISSION_CURRENT(m)) => self.mission = Some((m.seq, m.total)),
            _ => {}
        }
    }

    fn to_text(&self, client: &Client) -> String {
        let mut out = String::new();
        let unknown = || "unknown".to_owned();
        let mode = self.beat.as_ref().map_or_else(unknown, |b| {
            let armed = if b.base_mode & 128 != 0 {
                "armed"
            } else {
                "disarmed"
            };
            format!("{}, {armed}", mode_name(b.custom_mode))
        });
        let place = self.place.map_or_else(
            || "not localized".to_owned(),
            |[n, e, d]| format!("north {n:.2}, east {e:.2}, height {:.2} m", -d),
        );
        let heading = self.heading_rad.map_or_else(unknown, |yaw| {
            format!("{:.0} deg", yaw.to_degrees().rem_euclid(360.0))
        });
        let landed = match self.landed {
            Some(1) => "on the ground",
            Some(2) => "in the air",
            Some(3) => "taking off",
            Some(4) => "landing",
            _ => "unknown",
        };
        let battery = self.battery.map_or_else(unknown, |(v, left)| match left {
            0.. => format!("{v:.1} V, {left} %"),
            _ => format!("{v:.1} V"),
        });
        let arming = match self.is_ready {
            Some(true) => "would be accepted",
            Some(false) => "would be refused (`kestrel mav arm` says why)",
            None => "unknown",
        };
        let mission = match self.mission {
            Some((_, 0)) => "none".to_owned(),
            Some((seq, total)) => format!("item {seq} of {total}"),
            None => unknown(),
        };
        for (name, value) in [
            ("vehicle", format!("system {}", client.vehicle.system)),
            ("mode", mode),
            ("state", landed.to_owned()),
            ("place", place),
            ("heading", heading),
            ("battery", battery),
            ("arming", arming.to_owned()),
            ("mission", mission),
        ] {
            // Writing into a String cannot fail.
            let _ = writeln!(out, "{name:<9}{value}");
        }
        out
    }
}

fn mode_name(custom_mode: u32) -> String {
    let mode = bridge::gcs::convert::mode_from_px4(Px4Mode::from_custom_mode(custom_mode));
    mode.map_or_else(|| format!("{custom_mode:#x}"), |m| m.name().to_owned())
}

fn command(number: u16) -> raw::COMMAND_INT_DATA {
    raw::COMMAND_INT_DATA {
        command: number,
        frame: RELATIVE_ALT,
        ..Default::default()
    }
}

pub(super) fn arm(client: &mut Client, force: bool) -> Result<()> {
    let magic = if force { 21196.0 } else { 0.0 };
    client.command(
        "arm",
        raw::COMMAND_INT_DATA {
            param1: 1.0,
            param2: magic,
            ..command(cmd::COMPONENT_ARM_DISARM)
        },
    )
}

pub(super) fn disarm(client: &mut Client, force: bool) -> Result<()> {
    let magic = if force { 21196.0 } else { 0.0 };
    client.command(
        "disarm",
        raw::COMMAND_INT_DATA {
            param2: magic,
            ..command(cmd::COMPONENT_ARM_DISARM)
        },
    )
}

pub(super) fn take_off(client: &mut Client, height: Option<f64>, waits: bool) -> Result<()> {
    client.command(
        "takeoff",
        raw::COMMAND_INT_DATA {
            x: i32::MAX,
            y: i32::MAX,
            z: height.map_or(f32::NAN, |h| h as f32),
            ..command(cmd::NAV_TAKEOFF)
        },
    )?;
    // It climbs as soon as the motors run.
    arm(client, false)?;
    if waits {
        let mut is_up = false;
        client.wait_until("takeoff: hovering", 60.0, |m| {
            is_up |= is_landed_state(m, 2);
            is_up && mode_of(m).is_some_and(|mode| mode == HOLD)
        })?;
    }
    Ok(())
}

/// Main and sub mode of Hold.
const HOLD: (u8, u8) = (4, 3);

fn mode_of(message: &Message) -> Option<(u8, u8)> {
    match message {
        Message::Raw(raw::MavMessage::HEARTBEAT(m)) => {
            let mode = Px4Mode::from_custom_mode(m.custom_mode);
            Some((mode.main, mode.sub))
        }
        _ => None,
    }
}

fn is_landed_state(message: &Message, state: u8) -> bool {
    matches!(message, Message::Standard(Std::EXTENDED_SYS_STATE(m)) if m.landed_state as u8 == state)
}

fn is_disarmed(message: &Message) -> bool {
    matches!(message, Message::Raw(raw::MavMessage::HEARTBEAT(m)) if m.base_mode & 128 == 0)
}

pub(super) fn go_to(
    client: &mut Client,
    [north, east]: [f64; 2],
    height: Option<f64>,
    yaw_deg: Option<f64>,
    waits: bool,
) -> Result<()> {
    let tenth_mm = |m: f64| (m * 1e4).round() as i32;
    client.command(
        "goto",
        raw::COMMAND_INT_DATA {
            frame: LOCAL_NED,
            param1: -1.0,
            param2: 1.0,
            param4: yaw_deg.map_or(f32::NAN, |y| y.to_radians() as f32),
            x: tenth_mm(north),
            y: tenth_mm(east),
            z: height.map_or(f32::NAN, |h| -h as f32),
            ..command(cmd::DO_REPOSITION)
        },
    )?;
    if waits {
        client.wait_until("goto: arriving", 120.0, |m| match m {
            Message::Standard(Std::LOCAL_POSITION_NED(p)) => {
                let (dn, de) = (f64::from(p.x) - north, f64::from(p.y) - east);
                let dd = height.map_or(0.0, |h| f64::from(p.z) + h);
                libm::sqrt(dn * dn + de * de + dd * dd) < ARRIVED_M
            }
            _ => false,
        })?;
    }
    Ok(())
}

pub(super) fn land(client: &mut Client, waits: bool) -> Result<()> {
    client.command("land", command(cmd::NAV_LAND))?;
    if waits {
        client.wait_until("land: motors standing", 60.0, is_disarmed)?;
    }
    Ok(())
}

pub(super) fn come_home(client: &mut Client, waits: bool) -> Result<()> {
    client.command("return", command(cmd::NAV_RETURN_TO_LAUNCH))?;
    if waits {
        client.wait_until("return: motors standing", 180.0, is_disarmed)?;
    }
    Ok(())
}

pub(super) fn stop(client: &mut Client) -> Result<()> {
    client.command("stop", command(cmd::DO_PAUSE_CONTINUE))
}
