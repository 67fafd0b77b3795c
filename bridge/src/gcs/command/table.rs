//! What each command does. A new command is a row in `mavlink-dialect/src/command.rs` and an arm here.
//!
//! Stations fill parameters they do not use with NaN, 0 or -1; all three read as "not given" where a command allows it.

use super::super::access::Role;
use super::super::convert::{GeoPoint, mode_from_px4, mode_from_standard};
use super::super::params::Identity;
use super::super::place::Place;
use super::super::{Context, Destination, Outbox, Peer, keys, origin};
use super::Streams;
use crate::autopilot::door::{
    Failure, FailureKind, FailureUnit, FigureNose, FigureRequest, GoTo, MotorTurn, Request, Sensor,
    Severity,
};
use crate::autopilot::mode::Mode;
use mavlink_dialect::command::{self, Command, cmd, result};
use mavlink_dialect::mission_item::{Frame, Point};
use mavlink_dialect::mode::{FLAG_CUSTOM, Px4Mode};
use mavlink_dialect::standard::{MESSAGE_INTERVAL_DATA, MavMessage};
use vehicle::Timestamp;
use vehicle::angle::wrap_pi;

/// Parameter 2 of ARM_DISARM: without checks (PX4, ArduPilot).
const FORCE: f32 = 21196.0;
/// Parameter 2 of ARM_DISARM: QGroundControl's "force arm".
const FORCE_ARM: f32 = 2989.0;
/// MAV_DO_REPOSITION_FLAGS: leave the mode for Hold.
const REPOSITION_CHANGE_MODE: i32 = 1;
/// MAV_DO_REPOSITION_FLAGS: the heading is a turn.
const REPOSITION_RELATIVE_YAW: i32 = 2;
/// Lowest take-off, m.
const MIN_TAKEOFF_M: f64 = 0.3;
/// Message ids asked for by commands of their own.
const AUTOPILOT_VERSION: u32 = 148;
const HOME_POSITION: u32 = 242;
const PROTOCOL_VERSION: u32 = 300;

/// What a command comes to.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Verdict {
    /// Answered here.
    Done(u8),
    /// Refused here, with the reason for the pilot.
    Refused(u8, String),
    /// The vehicle answers.
    Ask(Request),
}

use Verdict::{Ask, Done};

fn denied(why: impl Into<String>) -> Verdict {
    Verdict::Refused(result::DENIED, why.into())
}

fn unsupported(why: &str) -> Verdict {
    Verdict::Refused(result::UNSUPPORTED, why.to_owned())
}

/// Judges a command; what can be done at once is done.
pub(super) fn verdict(
    now: Timestamp,
    from: Peer,
    c: &Command,
    ctx: &Context<'_>,
    streams: &mut dyn Streams,
    out: &mut Outbox,
) -> Verdict {
    let snapshot = ctx.snapshot;
    match c.number {
        cmd::COMPONENT_ARM_DISARM => arm_disarm(c),
        cmd::NAV_TAKEOFF => take_off(c, ctx),
        cmd::NAV_LAND => Ask(Request::SetMode(Mode::Land)),
        cmd::NAV_RETURN_TO_LAUNCH => Ask(Request::SetMode(Mode::Return)),
        cmd::NAV_LOITER_UNLIM => Ask(Request::Stop),
        cmd::DO_REPOSITION => reposition(c, ctx),
        cmd::DO_ORBIT => orbit(c, ctx),
        cmd::DO_FIGURE_EIGHT => figure_eight(c, ctx),
        cmd::MISSION_START => match c.param(1).unwrap_or(0.0).max(0.0) {
            first if first <= 65_535.0 => Ask(Request::StartMission {
                first: first.round() as u16,
            }),
            _ => denied("there is no such item"),
        },
        cmd::DO_PAUSE_CONTINUE => match c.whole(1) {
            Some(0) => Ask(Request::Stop),
            Some(1) => Ask(Request::SetMode(Mode::Mission)),
            _ => denied("parameter 1 must be 0 (pause) or 1 (continue)"),
        },
        cmd::DO_SET_MISSION_CURRENT => match c.whole(1).map(u16::try_from) {
            Some(Ok(seq)) => Ask(Request::SetMissionItem(seq)),
            _ => denied("there is no such item"),
        },
        cmd::DO_CHANGE_SPEED => change_speed(c, ctx),
        cmd::DO_SET_MODE => set_mode(c, ctx),
        cmd::DO_SET_STANDARD_MODE => {
            match c
                .whole(1)
                .and_then(|m| u8::try_from(m).ok())
                .and_then(mode_from_standard)
            {
                Some(mode) => Ask(mode_request(mode)),
                None => unsupported("this standard mode is not flown"),
            }
        }
        cmd::DO_SET_HOME => set_home(c, ctx),
        cmd::DO_SET_GLOBAL_ORIGIN => set_origin(now, from, c, ctx, out),
        cmd::DO_FLIGHTTERMINATION => match c.param(1) {
            Some(v) if v > 0.5 => Ask(Request::Disarm { force: true }),
            _ => Done(result::ACCEPTED),
        },
        cmd::SET_MESSAGE_INTERVAL => match (message_id(c), c.whole(2)) {
            (Some(id), Some(interval_us)) => {
                Done(streams.set_interval(now, from.link, id, interval_us))
            }
            _ => Done(result::DENIED),
        },
        cmd::GET_MESSAGE_INTERVAL => match message_id(c).map(u16::try_from) {
            Some(Ok(message_id)) => {
                let interval_us = streams.interval_us(from.link, u32::from(message_id));
                let reply = MavMessage::MESSAGE_INTERVAL(MESSAGE_INTERVAL_DATA {
                    interval_us,
                    message_id,
                });
                out.send(Destination::Link(from.link), reply);
                Done(result::ACCEPTED)
            }
            _ => Done(result::DENIED),
        },
        cmd::REQUEST_MESSAGE => match message_id(c) {
            Some(id) => Done(streams.request(now, from, id, c.params[1], ctx, out)),
            None => Done(result::DENIED),
        },
        cmd::REQUEST_AUTOPILOT_CAPABILITIES => {
            Done(streams.request(now, from, AUTOPILOT_VERSION, 0.0, ctx, out))
        }
        cmd::REQUEST_PROTOCOL_VERSION => {
            Done(streams.request(now, from, PROTOCOL_VERSION, 0.0, ctx, out))
        }
        cmd::GET_HOME_POSITION => Done(streams.request(now, from, HOME_POSITION, 0.0, ctx, out)),
        cmd::PREFLIGHT_STORAGE => match c.whole(1).unwrap_or(1) {
            // Parameters are kept as they are set: nothing to read or write.
            ..=1 => Done(result::ACCEPTED),
            _ => unsupported("parameters are reset by removing parameters.toml"),
        },
        cmd::PREFLIGHT_CALIBRATION => {
            let is_nothing = c.params.iter().all(|v| v.is_nan() || *v == 0.0)
                && [c.point.x, c.point.y].iter().all(|v| v.unwrap_or(0) == 0)
                && c.point.z_m.unwrap_or(0.0) == 0.0;
            if is_nothing {
                // "Cancel".
                Ask(Request::EndBenchWork)
            } else {
                calibration(c)
            }
        }
        cmd::RUN_PREARM_CHECKS if snapshot.is_armed => Done(result::TEMPORARILY_REJECTED),
        cmd::RUN_PREARM_CHECKS => {
            match &snapshot.arm_blocked_by {
                Some(why) => out.text(Severity::Warning, format!("Arming would be refused: {why}")),
                None => out.text(Severity::Info, "Ready to arm"),
            }
            Done(result::ACCEPTED)
        }
        cmd::PREFLIGHT_REBOOT_SHUTDOWN => {
            match (c.whole(1).unwrap_or(0), c.whole(2).unwrap_or(0)) {
                (0, 0) => Done(result::ACCEPTED),
                _ if snapshot.is_armed => denied("disarm first"),
                // The companion computer stays: nobody would start this program again.
                (1, 0 | 1) => Ask(Request::RestartFc),
                (0, 1) => unsupported("restart the service on the companion computer"),
                _ => unsupported("it is switched off with its battery"),
            }
        }
        cmd::DO_MOTOR_TEST | cmd::ACTUATOR_TEST if snapshot.is_armed => denied("disarm first"),
        cmd::DO_MOTOR_TEST => motor_test(c),
        cmd::ACTUATOR_TEST => actuator_test(c),
        cmd::INJECT_FAILURE => inject_failure(c),
        cmd::USER_1 => match c
            .whole(1)
            .and_then(|code| u8::try_from(code).ok())
            .and_then(keys::key)
        {
            Some(key) => Ask(Request::Key(key)),
            None => denied("no key has this code"),
        },
        _ => Done(result::UNSUPPORTED),
    }
}

fn calibration(c: &Command) -> Verdict {
    let [gyro, mag, pressure, _] = [1, 2, 3, 4].map(|n| c.whole(n).unwrap_or(0));
    // Parameter 5, which COMMAND_LONG reads as degrees: 1 = accelerometer, 2 = level, 4 = simple accelerometer.
    let accel = match c.point.x.map(f64::from) {
        Some(e7) if c.is_int => e7,
        Some(e7) => libm::round(e7 * 1e-7),
        None => 0.0,
    };
    match (gyro, mag, pressure, accel as i32) {
        (1, 0, 0, 0) => Ask(Request::Calibrate(Sensor::Gyroscope)),
        (0, 0, 0, 1 | 4) => Ask(Request::Calibrate(Sensor::Accelerometer)),
        (0, 0, 0, 2) => Ask(Request::Calibrate(Sensor::Level)),
        (0, 1, 0, 0) => unsupported("no compass is used: nothing to calibrate"),
        (0, 0, 1, 0) => unsupported("the flight controller sets its barometer by itself"),
        _ => unsupported("calibrate one at a time: gyroscope, accelerometer, level"),
    }
}

/// Parameters: FAILURE_UNIT, FAILURE_TYPE, instance.
fn inject_failure(c: &Command) -> Verdict {
    let unit = match c.whole(1) {
        Some(5) => FailureUnit::Flow,
        Some(7) => FailureUnit::Distance,
        Some(100) => FailureUnit::Battery,
        Some(101) => FailureUnit::Motor,
        Some(102) => FailureUnit::Controller,
        _ => {
            return unsupported(
                "flow, distance sensors, battery, motors, controller (102) can fail",
            );
        }
    };
    let kind = match c.whole(2) {
        Some(0) => FailureKind::Ok,
        Some(1) => FailureKind::Off,
        Some(2) => FailureKind::Stuck,
        Some(4) => FailureKind::Wrong,
        Some(7) => FailureKind::Intermittent,
        _ => return unsupported("it can be ok, off, stuck, wrong, intermittent"),
    };
    match u8::try_from(c.whole(3).unwrap_or(0)) {
        Ok(instance) => Ask(Request::Inject(Failure {
            unit,
            kind,
            instance,
        })),
        Err(_) => denied("there is no such instance"),
    }
}

/// Parameters: motor from 1, kind of throttle (0 percent, 1 us), throttle, seconds, motors in turn (0 and 1 = one).
fn motor_test(c: &Command) -> Verdict {
    let count = c.point.x.map_or(0.0, |e7| f64::from(e7) * 1e-7);
    if count > 1.5 {
        return unsupported("one motor at a time");
    }
    let motor = c.whole(1).and_then(|m| u8::try_from(m).ok());
    let value = f64::from(c.param(3).unwrap_or(0.0));
    let percent = match c.whole(2).unwrap_or(0) {
        0 => value,
        1 => (value - 1000.0) / 10.0,
        _ => return unsupported("throttle in percent (0) or us (1) only"),
    };
    match motor {
        Some(motor @ 1..) => Ask(Request::TurnMotor(MotorTurn {
            motor: Some(motor),
            percent,
            time_s: f64::from(c.param(4).unwrap_or(0.0)),
        })),
        _ => denied("motors count from 1"),
    }
}

/// Parameters: value 0..=1 (NaN = let go), seconds, and as the fifth the function (1 = motor 1 ...).
fn actuator_test(c: &Command) -> Verdict {
    let function = match c.point.x.map(f64::from) {
        Some(e7) if c.is_int => e7,
        Some(e7) => libm::round(e7 * 1e-7),
        None => 0.0,
    };
    match (c.param(1), function) {
        (None, _) => Ask(Request::EndBenchWork),
        (Some(v), f) if (0.5..8.5).contains(&f) => Ask(Request::TurnMotor(MotorTurn {
            motor: Some(f as u8),
            percent: 100.0 * f64::from(v),
            time_s: f64::from(c.param(2).unwrap_or(0.0)),
        })),
        _ => unsupported("there are motors 1 to 8 only"),
    }
}

fn arm_disarm(c: &Command) -> Verdict {
    let is_param2 = |magic: f32| c.param(2).is_some_and(|v| (v - magic).abs() < 0.5);
    match c.whole(1) {
        Some(1) => Ask(Request::Arm {
            force: is_param2(FORCE) || is_param2(FORCE_ARM),
        }),
        Some(0) => Ask(Request::Disarm {
            force: is_param2(FORCE),
        }),
        _ => denied("parameter 1 must be 1 (arm) or 0 (disarm)"),
    }
}

pub(super) fn is_arm(c: &Command) -> bool {
    c.number == cmd::COMPONENT_ARM_DISARM && c.whole(1) == Some(1)
}

/// Above sea level in PX4's way, above home in everybody else's; COMMAND_INT says which. Nothing, zero and less than
/// zero are "no height given": with an anchor above sea level they come from stations of the other way.
fn take_off(c: &Command, ctx: &Context<'_>) -> Verdict {
    let mut point = c.point;
    if !c.is_int && ctx.settings.ground.identity == Identity::Generic {
        point.frame = Some(Frame::GlobalRelative);
    }
    if point.z_m.is_some_and(f32::is_infinite) {
        return denied("the height is not a number");
    }
    let down_m = match point.z_m {
        None => None,
        Some(_) => match Place::from_point(&point, ctx) {
            Some(place) => place.down_m,
            None => return Done(result::UNSUPPORTED_MAV_FRAME),
        },
    };
    let ceiling_m = ctx.settings.autopilot.ceiling_m;
    let height_m = down_m
        .map(|down| -down)
        .filter(|h| *h > 0.0)
        .map(|h| h.max(MIN_TAKEOFF_M).min(ceiling_m));
    Ask(Request::Takeoff { height_m })
}

fn reposition(c: &Command, ctx: &Context<'_>) -> Verdict {
    let Some(place) = Place::from_point(&c.point, ctx) else {
        return Done(result::UNSUPPORTED_MAV_FRAME);
    };
    if let Some(n) = c.point.invalid_param() {
        return denied(format!("parameter {n} cannot be used"));
    }
    let yaw = c.param(4).map(f64::from);
    if yaw.is_some_and(f64::is_infinite) {
        return denied("parameter 4 cannot be used");
    }
    let flags = c.whole(2).unwrap_or(0);
    let mode = ctx.snapshot.mode.mode;
    let is_steered = mode.is_stick_mode() || mode == Mode::Offboard;
    if is_steered && flags & REPOSITION_CHANGE_MODE == 0 {
        let why = format!(
            "mode {} is flown: set Hold first, or parameter 2 to 1",
            mode.name()
        );
        return Verdict::Refused(result::TEMPORARILY_REJECTED, why);
    }
    let from_yaw = if flags & REPOSITION_RELATIVE_YAW == 0 {
        0.0
    } else {
        ctx.snapshot.nav.yaw_rad()
    };
    Ask(Request::GoTo(GoTo {
        north_m: place.north_m,
        east_m: place.east_m,
        down_m: place.down_m,
        yaw_rad: yaw.map(|yaw| wrap_pi(from_yaw + yaw)),
        speed_mps: c
            .param(1)
            .map(f64::from)
            .filter(|v| *v > 0.0 && v.is_finite()),
    }))
}

/// Radius of an orbit that names none, m.
const ORBIT_RADIUS_M: f32 = 1.0;

/// Radius (negative: counter-clockwise), speed, ORBIT_YAW_BEHAVIOUR, angle in rad (0 or none: for ever), centre.
fn orbit(c: &Command, ctx: &Context<'_>) -> Verdict {
    let Some(place) = Place::from_point(&c.point, ctx) else {
        return Done(result::UNSUPPORTED_MAV_FRAME);
    };
    if let Some(n) = c.point.invalid_param() {
        return denied(format!("parameter {n} cannot be used"));
    }
    let radius_m = f64::from(c.param(1).unwrap_or(ORBIT_RADIUS_M));
    let nose = match c.whole(3) {
        None | Some(0) => FigureNose::Centre,
        Some(1 | 2 | 5) => FigureNose::Initial,
        Some(3) => FigureNose::Tangent,
        Some(_) => return unsupported("this yaw behaviour of an orbit is not flown"),
    };
    let rounds = c
        .param(4)
        .map(|rad| f64::from(rad) / core::f64::consts::TAU)
        .filter(|rounds| *rounds != 0.0);
    Ask(Request::Figure(FigureRequest {
        north_m: place.north_m,
        east_m: place.east_m,
        down_m: place.down_m,
        radius_m: radius_m.abs(),
        is_clockwise: radius_m > 0.0,
        speed_mps: c.param(2).map(f64::from).filter(|v| *v > 0.0),
        rounds,
        nose,
        ..FigureRequest::default()
    }))
}

/// Long radius (negative: the end in the direction of the axis counter-clockwise), short radius, -, direction of the axis in rad, centre.
fn figure_eight(c: &Command, ctx: &Context<'_>) -> Verdict {
    let Some(place) = Place::from_point(&c.point, ctx) else {
        return Done(result::UNSUPPORTED_MAV_FRAME);
    };
    if let Some(n) = c.point.invalid_param() {
        return denied(format!("parameter {n} cannot be used"));
    }
    let (Some(major_m), Some(minor_m)) = (c.param(1), c.param(2)) else {
        return denied("parameters 1 and 2 must be the two radii");
    };
    Ask(Request::Figure(FigureRequest {
        north_m: place.north_m,
        east_m: place.east_m,
        down_m: place.down_m,
        radius_m: f64::from(major_m).abs(),
        minor_m: Some(f64::from(minor_m).abs()),
        axis_rad: f64::from(c.param(4).unwrap_or(0.0)),
        is_clockwise: major_m > 0.0,
        nose: FigureNose::Tangent,
        ..FigureRequest::default()
    }))
}

fn change_speed(c: &Command, ctx: &Context<'_>) -> Verdict {
    let fastest = ctx.settings.control.xy_vel_max;
    match c.param(2).map(f64::from) {
        Some(v) if v > 0.0 && v.is_finite() => Ask(Request::ChangeSpeed(v.min(fastest))),
        // -1: no change; -2: back to the default.
        Some(v) if (v + 1.0).abs() < 1e-3 => Done(result::ACCEPTED),
        Some(v) if (v + 2.0).abs() < 1e-3 => {
            Ask(Request::ChangeSpeed(ctx.settings.planner.cruise_mps))
        }
        _ => denied("parameter 2 is not a speed"),
    }
}

/// (a) main and sub mode in parameters 2 and 3; (b) `custom_mode` packed into parameter 2. Arming bits are ignored.
fn set_mode(c: &Command, ctx: &Context<'_>) -> Verdict {
    match mode_of(c) {
        // A viewer's Hold is STOP: the second one lands.
        Some(Mode::Hold) if ctx.role < Role::Pilot => Ask(Request::Stop),
        Some(mode) => Ask(mode_request(mode)),
        None => unsupported("this mode is not flown"),
    }
}

/// The mode that DO_SET_MODE names; none if it is not flown.
pub(in super::super) fn mode_of(c: &Command) -> Option<Mode> {
    let is_custom = c
        .whole(1)
        .is_some_and(|base| base & i32::from(FLAG_CUSTOM) != 0);
    let packed = |v: i32| u32::try_from(v).ok().map(Px4Mode::from_custom_mode);
    let px4 = match (is_custom, c.whole(2)) {
        (true, Some(main @ 0..=255)) => {
            u8::try_from(c.whole(3).unwrap_or(0))
                .ok()
                .map(|sub| Px4Mode {
                    // 0..=255, checked above.
                    main: main as u8,
                    sub,
                })
        }
        (true, Some(custom_mode)) => packed(custom_mode),
        _ => None,
    };
    px4.and_then(mode_from_px4)
}

/// Every form of setting a mode ends here.
pub(super) const fn mode_request(mode: Mode) -> Request {
    Request::SetMode(mode)
}

fn set_home(c: &Command, ctx: &Context<'_>) -> Verdict {
    if c.whole(1) == Some(1) {
        return Ask(Request::SetHome(None));
    }
    let Some(place) = Place::from_point(&c.point, ctx) else {
        return Done(result::UNSUPPORTED_MAV_FRAME);
    };
    match place.whole() {
        Some(place) if c.point.invalid_param().is_none() && !is_left_blank(&c.point) => {
            Ask(Request::SetHome(Some(place)))
        }
        _ => denied("it needs a whole place"),
    }
}

/// Latitude and longitude 0: parameters nobody filled in.
fn is_left_blank(point: &Point) -> bool {
    point.frame != Some(Frame::Local) && (point.x, point.y) == (Some(0), Some(0))
}

fn set_origin(
    now: Timestamp,
    from: Peer,
    c: &Command,
    ctx: &Context<'_>,
    out: &mut Outbox,
) -> Verdict {
    let (Some(lat_e7), Some(lon_e7), Some(alt_m)) = (c.point.x, c.point.y, c.point.z_m) else {
        return denied("it needs a whole place");
    };
    if c.point.frame != Some(Frame::Global) {
        return Done(result::UNSUPPORTED_MAV_FRAME);
    }
    if c.point.invalid_param().is_some() || is_left_blank(&c.point) {
        return denied("it needs a whole place");
    }
    match origin::move_to(
        now,
        from,
        GeoPoint {
            lat_e7,
            lon_e7,
            alt_m: f64::from(alt_m),
        },
        ctx,
        out,
    ) {
        Ok(()) => Done(result::ACCEPTED),
        Err(why) => denied(why),
    }
}

/// Parameter 1 as a message id.
fn message_id(c: &Command) -> Option<u32> {
    c.whole(1).and_then(|id| u32::try_from(id).ok())
}

/// The command in the words of a pilot.
pub(in super::super) fn label(c: &Command) -> &'static str {
    match c.number {
        cmd::COMPONENT_ARM_DISARM if is_arm(c) => "Arming",
        cmd::COMPONENT_ARM_DISARM | cmd::DO_FLIGHTTERMINATION => "Disarming",
        cmd::NAV_TAKEOFF => "Take-off",
        cmd::NAV_LAND => "Landing",
        cmd::NAV_RETURN_TO_LAUNCH => "Return",
        cmd::DO_SET_MODE | cmd::DO_SET_STANDARD_MODE => "Mode",
        cmd::DO_REPOSITION => "Go-to",
        cmd::DO_ORBIT => "Orbit",
        cmd::DO_FIGURE_EIGHT => "Figure eight",
        cmd::MISSION_START => "Mission start",
        cmd::DO_SET_MISSION_CURRENT => "Mission item",
        cmd::DO_CHANGE_SPEED => "Speed",
        cmd::DO_SET_HOME => "Home",
        cmd::DO_SET_GLOBAL_ORIGIN => "Origin",
        cmd::PREFLIGHT_CALIBRATION => "Calibration",
        cmd::PREFLIGHT_REBOOT_SHUTDOWN => "Reboot",
        cmd::DO_MOTOR_TEST | cmd::ACTUATOR_TEST => "Motor test",
        cmd::USER_1 => "Key",
        other => command::name(other).unwrap_or("Command"),
    }
}
