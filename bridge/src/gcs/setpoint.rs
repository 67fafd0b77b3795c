//! Set points of a ground program: SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT, SET_ATTITUDE_TARGET.
//!
//! | Message | Frames | Taken |
//! | --- | --- | --- |
//! | 84 LOCAL_NED | 1 LOCAL_NED; 7 LOCAL_OFFSET_NED; 8 BODY_NED, 9 BODY_OFFSET_NED, 12 BODY_FRD | position, velocity, yaw, yaw rate |
//! | 86 GLOBAL_INT | 0, 5 above sea level; 3, 6, 11 above home | the same, position converted to NED about home |
//! | 82 ATTITUDE_TARGET | | attitude with yaw or yaw rate, thrust |
//!
//! A set bit of `type_mask` says "ignore". With a place a velocity is not used; an axis that nothing is said about stays where it is; a
//! heading alone turns on the spot. A place on one horizontal axis beside a speed on the other is refused. Acceleration is feed-forward we do not use; a set point of nothing else, the
//! force bit, body rates without an attitude, a missing thrust, NaN and infinities are refused as a whole with a text (at
//! most one each two seconds). Whether off-board mode is on is the vehicle's business: it takes set points before the mode
//! is entered, as MAVSDK and PX4 have it.

use super::convert::GeoAnchor;
use super::{Context, Outbox, Peer};
use crate::autopilot::door::{OffboardFrame, OffboardSetpoint, Request, Severity};
use core::time::Duration;
use mavlink_dialect::{Message, raw};
use nalgebra::{Quaternion, UnitQuaternion};
use vehicle::angle::wrap_pi;
use vehicle::{Frd, Ned, Rot, Timestamp};

/// Time between two complaints.
const COMPLAINT_PERIOD: Duration = Duration::from_secs(2);

/// Bits of POSITION_TARGET_TYPEMASK.
mod motion_bit {
    /// x, y, z of the position: bits 0, 1, 2.
    pub(super) const POSITION: [u16; 3] = [1, 2, 4];
    /// x, y, z of the velocity.
    pub(super) const VELOCITY: [u16; 3] = [8, 16, 32];
    /// Acceleration fields are forces.
    pub(super) const FORCE: u16 = 0x200;
    pub(super) const YAW: u16 = 0x400;
    pub(super) const YAW_RATE: u16 = 0x800;
}

/// Bits of ATTITUDE_TARGET_TYPEMASK.
mod attitude_bit {
    pub(super) const ROLL_RATE: u8 = 1;
    pub(super) const PITCH_RATE: u8 = 2;
    pub(super) const YAW_RATE: u8 = 4;
    pub(super) const THRUST: u8 = 64;
    pub(super) const ATTITUDE: u8 = 128;
}

/// Takes set points. It keeps nothing but when it complained last.
#[derive(Debug, Default)]
pub struct SetpointService {
    complained_at: Option<Timestamp>,
}

impl SetpointService {
    /// No complaint yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a message for us.
    pub fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        use raw::MavMessage as M;
        let setpoint = match message {
            Message::Raw(M::SET_POSITION_TARGET_LOCAL_NED(m)) => local(m),
            Message::Raw(M::SET_POSITION_TARGET_GLOBAL_INT(m)) => global(m, ctx),
            Message::Raw(M::SET_ATTITUDE_TARGET(m)) => attitude(m),
            _ => return,
        };
        match setpoint {
            Ok(setpoint) => {
                out.ask(from, Request::Offboard(setpoint));
            }
            Err(why) => {
                if self
                    .complained_at
                    .is_none_or(|at| now.since(at) >= COMPLAINT_PERIOD)
                {
                    self.complained_at = Some(now);
                    out.text(
                        Severity::Warning,
                        format!("{} ignored: {why}", message.name()),
                    );
                }
            }
        }
    }
}

fn local(m: &raw::SET_POSITION_TARGET_LOCAL_NED_DATA) -> Result<OffboardSetpoint, &'static str> {
    let frame = match m.coordinate_frame {
        1 => OffboardFrame::Local,
        7 => OffboardFrame::LocalOffset,
        8 | 9 | 12 => OffboardFrame::Body,
        _ => return Err("coordinate frame not supported"),
    };
    let position = masked(m.type_mask, motion_bit::POSITION, [m.x, m.y, m.z])?;
    motion(
        frame,
        m.type_mask,
        position,
        [m.vx, m.vy, m.vz],
        m.yaw,
        m.yaw_rate,
    )
}

fn global(
    m: &raw::SET_POSITION_TARGET_GLOBAL_INT_DATA,
    ctx: &Context<'_>,
) -> Result<OffboardSetpoint, &'static str> {
    let geo = GeoAnchor::from_params(&ctx.settings.ground);
    let [lat, lon, up] = motion_bit::POSITION.map(|bit| m.type_mask & bit == 0);
    if (up && !m.alt.is_finite())
        || (lat && m.lat_int == i32::MAX)
        || (lon && m.lon_int == i32::MAX)
    {
        return Err(NOT_A_NUMBER);
    }
    let alt = f64::from(m.alt);
    let down = match m.coordinate_frame {
        0 | 5 => geo.down_of_amsl(alt),
        // There is no terrain indoors but the floor at home.
        3 | 6 | 11 => geo.down_of_relative(alt, &ctx.snapshot.home),
        _ => return Err("coordinate frame not supported"),
    };
    let position = [
        lat.then(|| geo.north_of(m.lat_int)),
        lon.then(|| geo.east_of(m.lon_int)),
        up.then_some(down),
    ];
    motion(
        OffboardFrame::Local,
        m.type_mask,
        position,
        [m.vx, m.vy, m.vz],
        m.yaw,
        m.yaw_rate,
    )
}

const NOT_A_NUMBER: &str = "a value is not a number";

fn motion(
    frame: OffboardFrame,
    type_mask: u16,
    position: [Option<f64>; 3],
    velocity: [f32; 3],
    yaw: f32,
    yaw_rate: f32,
) -> Result<OffboardSetpoint, &'static str> {
    if type_mask & motion_bit::FORCE != 0 {
        return Err("force set points are not supported");
    }
    let velocity = masked(type_mask, motion_bit::VELOCITY, velocity)?;
    for (this, other) in [(0, 1), (1, 0)] {
        if position[this].is_some() && position[other].is_none() && velocity[other].is_some() {
            return Err("x and y are places or speeds together");
        }
    }
    let [yaw_rad] = masked(type_mask, [motion_bit::YAW], [yaw])?;
    let [yaw_rate_radps] = masked(type_mask, [motion_bit::YAW_RATE], [yaw_rate])?;
    let is_empty = position.iter().chain(&velocity).all(Option::is_none)
        && yaw_rad.or(yaw_rate_radps).is_none();
    if is_empty {
        return Err("it names neither position, velocity nor yaw");
    }
    Ok(OffboardSetpoint::Motion {
        frame,
        position,
        velocity,
        yaw_rad: yaw_rad.map(wrap_pi),
        yaw_rate_radps,
    })
}

/// The values whose "ignore" bit is not set.
fn masked<const N: usize>(
    type_mask: u16,
    bits: [u16; N],
    values: [f32; N],
) -> Result<[Option<f64>; N], &'static str> {
    let mut out = [None; N];
    for ((to, bit), value) in out.iter_mut().zip(bits).zip(values) {
        if type_mask & bit == 0 {
            if !value.is_finite() {
                return Err(NOT_A_NUMBER);
            }
            *to = Some(f64::from(value));
        }
    }
    Ok(out)
}

fn attitude(m: &raw::SET_ATTITUDE_TARGET_DATA) -> Result<OffboardSetpoint, &'static str> {
    use attitude_bit::{ATTITUDE, PITCH_RATE, ROLL_RATE, THRUST, YAW_RATE};
    let is_used = |bit: u8| m.type_mask & bit == 0;
    if !is_used(ATTITUDE) {
        return Err("body rates are not supported, send an attitude");
    }
    if !is_used(THRUST) {
        return Err("it names no thrust");
    }
    if !(0.0..=1.0).contains(&m.thrust) {
        return Err("thrust is outside 0..1");
    }
    let [w, x, y, z] = m.q.map(f64::from);
    let q = Quaternion::new(w, x, y, z);
    if !(0.9..=1.1).contains(&q.norm()) {
        return Err("the quaternion is not a rotation");
    }
    let (roll_rad, pitch_rad, yaw_rad) =
        Rot::<Frd, Ned>::from_quaternion(UnitQuaternion::from_quaternion(q)).roll_pitch_yaw();
    // All three rates in use are the feed-forward of the attitude; the yaw rate alone takes the place of its yaw.
    let is_yaw_by_rate = is_used(YAW_RATE) && !is_used(ROLL_RATE) && !is_used(PITCH_RATE);
    if is_yaw_by_rate && !m.body_yaw_rate.is_finite() {
        return Err(NOT_A_NUMBER);
    }
    Ok(OffboardSetpoint::Attitude {
        roll_rad,
        pitch_rad,
        yaw_rad: (!is_yaw_by_rate).then_some(yaw_rad),
        yaw_rate_radps: is_yaw_by_rate.then(|| f64::from(m.body_yaw_rate)),
        thrust: f64::from(m.thrust),
    })
}

#[cfg(test)]
mod tests {
    use super::super::bench::{Bench, station};
    use super::*;
    use proptest::prelude::*;
    use vehicle::In;

    fn ask(message: raw::MavMessage, bench: &Bench) -> Result<OffboardSetpoint, String> {
        let mut out = Outbox::default();
        SetpointService::new().handle(
            Timestamp::ZERO,
            station(245),
            &message.into(),
            &bench.ctx(),
            &mut out,
        );
        match (out.asked().pop().map(|a| a.request), out.said().pop()) {
            (Some(Request::Offboard(s)), None) => Ok(s),
            (None, Some((_, text))) => Err(text),
            other => panic!("{other:?}"),
        }
    }

    fn local_target(frame: u8, type_mask: u16) -> raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
        raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
            coordinate_frame: frame,
            type_mask,
            x: 1.0,
            y: 2.0,
            z: -1.5,
            vx: 0.25,
            vy: -0.5,
            vz: 0.0,
            afx: f32::NAN,
            yaw: 0.5,
            yaw_rate: 0.125,
            ..Default::default()
        }
    }

    fn ask_local(m: raw::SET_POSITION_TARGET_LOCAL_NED_DATA) -> Result<OffboardSetpoint, String> {
        ask(
            raw::MavMessage::SET_POSITION_TARGET_LOCAL_NED(m),
            &Bench::default(),
        )
    }

    #[test]
    fn masks_of_mavsdk_choose_position_and_yaw_or_velocity_and_yaw_rate() {
        let position = OffboardSetpoint::Motion {
            frame: OffboardFrame::Local,
            position: [Some(1.0), Some(2.0), Some(-1.5)],
            velocity: [None; 3],
            yaw_rad: Some(0.5),
            yaw_rate_radps: None,
        };
        assert_eq!(ask_local(local_target(1, 0b1001_1111_1000)), Ok(position));
        let velocity = OffboardSetpoint::Motion {
            frame: OffboardFrame::Body,
            position: [None; 3],
            velocity: [Some(0.25), Some(-0.5), Some(0.0)],
            yaw_rad: None,
            yaw_rate_radps: Some(0.125),
        };
        for frame in [8, 9, 12] {
            assert_eq!(
                ask_local(local_target(frame, 0b0101_1100_0111)),
                Ok(velocity),
                "frame {frame}"
            );
        }
    }

    #[test]
    fn what_cannot_be_flown_is_refused_with_a_reason() {
        let refused = |m, reason: &str| {
            let text = ask_local(m).unwrap_err();
            assert!(
                text.starts_with("SET_POSITION_TARGET_LOCAL_NED ignored: "),
                "{text}"
            );
            assert!(text.contains(reason), "{text}");
        };
        refused(local_target(4, 0), "frame");
        refused(local_target(1, motion_bit::FORCE), "force");
        refused(local_target(1, 0b1100_0011_1111), "neither");
        refused(local_target(1, 0b1100_0010_1110), "together");
        refused(
            raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
                x: f32::NAN,
                ..local_target(1, 0)
            },
            "not a number",
        );
        refused(
            raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
                vz: f32::INFINITY,
                ..local_target(1, 7)
            },
            "not a number",
        );
        refused(
            raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
                yaw: f32::NAN,
                ..local_target(1, 0)
            },
            "not a number",
        );
    }

    #[test]
    fn ignored_fields_may_be_nan() {
        let m = raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
            yaw: f32::NAN,
            vx: f32::NAN,
            ..local_target(1, 0xC38)
        };
        assert!(ask_local(m).is_ok());
    }

    #[test]
    fn global_places_arrive_in_ned_about_home() {
        let mut bench = Bench::default();
        bench.snapshot.home = In::new(0.0, 0.0, -0.25);
        let geo = GeoAnchor::from_params(&bench.settings.ground);
        let p = geo.to_global(In::new(3.0, -2.0, -1.0));
        for (frame, down) in [(0, -1.0), (5, -1.0), (3, -1.25), (6, -1.25), (11, -1.25)] {
            let m = raw::SET_POSITION_TARGET_GLOBAL_INT_DATA {
                coordinate_frame: frame,
                type_mask: 0b1101_1111_1000,
                lat_int: p.lat_e7,
                lon_int: p.lon_e7,
                alt: 1.0,
                ..Default::default()
            };
            match ask(raw::MavMessage::SET_POSITION_TARGET_GLOBAL_INT(m), &bench) {
                Ok(OffboardSetpoint::Motion {
                    position: [Some(x), Some(y), Some(z)],
                    ..
                }) => {
                    assert!(
                        (x - 3.0).abs() < 0.006 && (y + 2.0).abs() < 0.006,
                        "{x} {y}"
                    );
                    assert!((z - down).abs() < 1e-9, "frame {frame}: {z}");
                }
                other => panic!("{other:?}"),
            }
        }
    }

    fn attitude_target(type_mask: u8) -> raw::SET_ATTITUDE_TARGET_DATA {
        let q: [f64; 4] = Rot::<Frd, Ned>::from_roll_pitch_yaw(0.1, -0.2, 1.5).into();
        raw::SET_ATTITUDE_TARGET_DATA {
            type_mask,
            q: q.map(|c| c as f32),
            body_yaw_rate: 0.25,
            thrust: 0.5,
            ..Default::default()
        }
    }

    fn ask_attitude(m: raw::SET_ATTITUDE_TARGET_DATA) -> Result<OffboardSetpoint, String> {
        ask(raw::MavMessage::SET_ATTITUDE_TARGET(m), &Bench::default())
    }

    #[test]
    fn a_quaternion_becomes_roll_pitch_and_yaw() {
        for type_mask in [7, 0] {
            match ask_attitude(attitude_target(type_mask)) {
                Ok(OffboardSetpoint::Attitude {
                    roll_rad,
                    pitch_rad,
                    yaw_rad: Some(yaw),
                    yaw_rate_radps,
                    thrust,
                }) => {
                    assert!((roll_rad - 0.1).abs() < 1e-6 && (pitch_rad + 0.2).abs() < 1e-6);
                    assert!((yaw - 1.5).abs() < 1e-6 && (thrust - 0.5).abs() < 1e-9);
                    assert_eq!(yaw_rate_radps, None);
                }
                other => panic!("{other:?}"),
            }
        }
        let by_rate = ask_attitude(attitude_target(3));
        assert!(
            matches!(by_rate, Ok(OffboardSetpoint::Attitude { yaw_rad: None, yaw_rate_radps: Some(r), .. }) if (r - 0.25).abs() < 1e-9)
        );
    }

    #[test]
    fn attitudes_without_rotation_or_thrust_are_refused() {
        for wrong in [
            attitude_target(128),
            attitude_target(7 | 64),
            raw::SET_ATTITUDE_TARGET_DATA {
                thrust: 1.5,
                ..attitude_target(7)
            },
            raw::SET_ATTITUDE_TARGET_DATA {
                thrust: f32::NAN,
                ..attitude_target(7)
            },
            raw::SET_ATTITUDE_TARGET_DATA {
                q: [0.0; 4],
                ..attitude_target(7)
            },
            raw::SET_ATTITUDE_TARGET_DATA {
                q: [f32::NAN; 4],
                ..attitude_target(7)
            },
            raw::SET_ATTITUDE_TARGET_DATA {
                body_yaw_rate: f32::NAN,
                ..attitude_target(3)
            },
        ] {
            assert!(ask_attitude(wrong.clone()).is_err(), "{wrong:?}");
        }
    }

    proptest! {
        #[test]
        fn what_passes_is_finite(frame in 0u8..14, type_mask in 0u16..0x1000, words in any::<[u32; 11]>()) {
            let f = words.map(f32::from_bits);
            let m = raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
                coordinate_frame: frame, type_mask, x: f[0], y: f[1], z: f[2], vx: f[3], vy: f[4], vz: f[5],
                yaw: f[6], yaw_rate: f[7], ..Default::default()
            };
            if let Ok(OffboardSetpoint::Motion { position, velocity, yaw_rad, yaw_rate_radps, .. }) = ask_local(m) {
                let all = position.iter().chain(&velocity).chain([&yaw_rad, &yaw_rate_radps]);
                prop_assert!(all.flatten().all(|v| v.is_finite()));
            }
            let a = raw::SET_ATTITUDE_TARGET_DATA {
                type_mask: type_mask as u8, q: [f[0], f[1], f[2], f[3]], body_yaw_rate: f[4], thrust: f[5],
                ..Default::default()
            };
            if let Ok(OffboardSetpoint::Attitude { roll_rad, pitch_rad, .. }) = ask_attitude(a) {
                prop_assert!(roll_rad.is_finite() && pitch_rad.is_finite());
            }
        }
    }
}
