//! Messages of the JSON topics.

use super::summary::FlightSummary;
use crate::autopilot::door::{Severity, Snapshot};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, Frd, In, MapAnchor, Ned, Rot, Timestamp};

/// UTC of an instant, ns.
pub(super) const fn utc_ns(boot_utc_us: u64, at: Timestamp) -> u64 {
    (boot_utc_us + at.us()).saturating_mul(1_000)
}

fn time(ns: u64) -> Value {
    json!({ "sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000 })
}

/// Four decimals: a tenth of a millimetre, and a third of the bytes.
fn r(x: f64) -> f64 {
    (x * 1e4).round() * 1e-4
}

/// The decimal text of the rounded number, not of the nearest double's seventeen digits.
fn n(x: f64) -> Value {
    let rounded = r(x);
    if !rounded.is_finite() {
        return Value::Null;
    }
    format!("{rounded:.4}")
        .parse::<f64>()
        .map_or(Value::Null, |v| json!(v))
}

fn v3<F>(v: In<F>) -> Value {
    json!([n(v.x()), n(v.y()), n(v.z())])
}

fn xyz(x: f64, y: f64, z: f64) -> Value {
    json!({ "x": n(x), "y": n(y), "z": n(z) })
}

/// Attitude of the body (x forward, y left, z up) on the plan (x right, y up on paper, z up).
fn on_plan(attitude: &Rot<Frd, Ned>, anchor: &MapAnchor) -> UnitQuaternion<f64> {
    let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI);
    let north = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), anchor.north_rad());
    north * flip * attitude.quaternion() * flip
}

fn quaternion(q: &UnitQuaternion<f64>) -> Value {
    json!({ "x": n(q.i), "y": n(q.j), "z": n(q.k), "w": n(q.w) })
}

fn level() -> Value {
    json!({ "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 })
}

/// `/pose`.
pub(super) fn pose(ns: u64, s: &Snapshot, anchor: &MapAnchor) -> Value {
    let p = anchor.to_map(s.nav.position);
    json!({
        "timestamp": time(ns), "frame_id": "map",
        "pose": {
            "position": xyz(p.x(), p.y(), -s.nav.position.z()),
            "orientation": quaternion(&on_plan(&s.nav.attitude, anchor)),
        },
    })
}

/// `/tf`.
pub(super) fn transform(ns: u64, s: &Snapshot, anchor: &MapAnchor) -> Value {
    let p = anchor.to_map(s.nav.position);
    json!({
        "timestamp": time(ns), "parent_frame_id": "map", "child_frame_id": "base",
        "translation": xyz(p.x(), p.y(), -s.nav.position.z()),
        "rotation": quaternion(&on_plan(&s.nav.attitude, anchor)),
    })
}

/// `/scan`: where the beams ended; none without a return.
pub(super) fn scan(ns: u64, s: &Snapshot) -> Option<Value> {
    let scan = s.scan.as_ref()?;
    let mut data = Vec::with_capacity(scan.beams.len() * 12);
    for beam in &scan.beams {
        let Some(distance_m) = beam.distance_m else {
            continue;
        };
        let level_m = distance_m * libm::cos(beam.elevation_rad);
        let end = [
            beam.origin.x() + level_m * libm::cos(beam.bearing_rad),
            -(beam.origin.y() + level_m * libm::sin(beam.bearing_rad)),
            -beam.origin.z() + distance_m * libm::sin(beam.elevation_rad),
        ];
        for coordinate in end {
            data.extend_from_slice(&(coordinate as f32).to_le_bytes());
        }
    }
    let field = |name: &str, offset: u32| json!({ "name": name, "offset": offset, "type": 7 });
    Some(json!({
        "timestamp": time(ns), "frame_id": "base",
        "pose": { "position": xyz(0.0, 0.0, 0.0), "orientation": level() },
        "point_stride": 12, "fields": [field("x", 0), field("y", 4), field("z", 8)],
        "data": base64(&data),
    }))
}

/// `/map`.
pub(super) fn grid(ns: u64, plan: &FloorPlan) -> Value {
    let cells: Vec<u8> = plan
        .cells()
        .iter()
        .map(|cell| match cell {
            Cell::Free => 255,
            Cell::Unknown => 128,
            Cell::Occupied => 0,
        })
        .collect();
    let corner = plan.centre_of(0, 0);
    let half_m = plan.resolution_m() / 2.0;
    json!({
        "timestamp": time(ns), "frame_id": "map",
        "pose": { "position": xyz(corner.x() - half_m, corner.y() - half_m, 0.0), "orientation": level() },
        "column_count": plan.width(), "row_stride": plan.width(), "cell_stride": 1,
        "cell_size": { "x": plan.resolution_m(), "y": plan.resolution_m() },
        "fields": [{ "name": "free", "offset": 0, "type": 1 }],
        "data": base64(&cells),
    })
}

/// `/log`.
pub(super) fn text(ns: u64, severity: Severity, text: &str) -> Value {
    let level = match severity {
        Severity::Critical => 5,
        Severity::Error => 4,
        Severity::Warning => 3,
        Severity::Notice | Severity::Info => 2,
    };
    json!({ "timestamp": time(ns), "level": level, "message": text, "name": "kestrel", "file": "", "line": 0 })
}

/// `/state`.
pub(super) fn state(ns: u64, s: &Snapshot) -> Value {
    let nav = &s.nav;
    let (roll, pitch, yaw) = nav.attitude.roll_pitch_yaw();
    let (roll_sp, pitch_sp, yaw_sp) = s.attitude_target.roll_pitch_yaw();
    let battery = s.battery.map(|b| {
        json!({ "voltage_v": n(b.voltage_v), "current_a": n(b.current_a), "remaining": b.remaining.map(n) })
    });
    json!({
        "timestamp": time(ns), "t_s": n(s.at.s()),
        "mode": s.mode.mode.name(), "because": s.mode.because.words(), "armed": s.is_armed, "landed": format!("{:?}", s.landed),
        "position_m": v3(nav.position), "velocity_mps": v3(nav.velocity), "height_m": n(nav.height_m),
        "roll_rad": n(roll), "pitch_rad": n(pitch), "yaw_rad": n(yaw), "rates_radps": v3(nav.rates_radps),
        "position_std_m": v3(nav.position_std_m), "yaw_std_rad": n(nav.yaw_std_rad),
        "health": {
            "attitude": nav.health.attitude, "height": nav.health.height,
            "velocity": nav.health.velocity, "position": nav.health.position, "rangers": s.rangers_alive,
        },
        "localization": {
            "state": format!("{:?}", nav.localization.state), "fit": n(nav.localization.fit), "mass": n(nav.localization.mass),
            "resets": nav.localization.reset_counter,
        },
        "roll_sp_rad": n(roll_sp), "pitch_sp_rad": n(pitch_sp), "yaw_sp_rad": n(yaw_sp),
        "velocity_sp_mps": v3(s.velocity_target), "thrust": n(s.thrust_target),
        "sticks": [n(s.sticks.roll), n(s.sticks.pitch), n(s.sticks.yaw), n(s.sticks.throttle)],
        "battery": battery,
        "down_range_m": s.down_range.and_then(|d| d.distance_m).map(n),
        "fc": { "connected": s.fc.is_connected, "rate_hz": n(s.fc.service_rate_hz), "round_trip_us": n(s.fc.round_trip_us), "timeouts": s.fc.timeouts },
        "loop": { "ticks": s.flight_loop.ticks, "missed": s.flight_loop.missed, "p99_us": s.flight_loop.sample_to_command.p99_us },
        "item": s.mission.seq,
    })
}

/// `/summary`.
pub(super) fn summary(ns: u64, flight: &FlightSummary) -> Value {
    let latency = |l: crate::autopilot::latency::LatencySummary| json!({ "count": l.count, "p50_us": l.p50_us, "p99_us": l.p99_us, "p999_us": l.p999_us, "max_us": l.max_us });
    json!({
        "timestamp": time(ns), "text": flight.to_string(),
        "duration_s": n(flight.duration_s), "distance_m": n(flight.distance_m), "highest_m": n(flight.highest_m),
        "localized": n(flight.localized_share()), "localization_resets": flight.resets,
        "sample_to_command": latency(flight.sample_to_command), "reply_to_command": latency(flight.reply_to_command),
        "missed_beats": flight.missed, "battery_used": flight.battery_used().map(n),
        "faults": flight.faults,
    })
}

/// Standard alphabet with padding (RFC 4648).
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let word = group
            .iter()
            .enumerate()
            .fold(0u32, |word, (i, b)| word | u32::from(*b) << (16 - 8 * i));
        for i in 0..4 {
            if i <= group.len() {
                out.push(char::from(ALPHABET[(word >> (18 - 6 * i)) as usize & 63]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use core::f64::consts::FRAC_PI_2;

    #[test]
    fn base64_as_in_the_standard() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn a_level_body_that_looks_east_looks_to_the_right_where_north_is_up_on_paper() {
        let anchor = MapAnchor::new(0.0, 0.0, FRAC_PI_2);
        let q = on_plan(&Rot::from_roll_pitch_yaw(0.0, 0.0, FRAC_PI_2), &anchor);
        let forward = q * Vector3::x();
        let up = q * Vector3::z();
        assert_relative_eq!(forward, Vector3::x(), epsilon = 1e-12);
        assert_relative_eq!(up, Vector3::z(), epsilon = 1e-12);
        // Nose up is nose up.
        let q = on_plan(&Rot::from_roll_pitch_yaw(0.0, 0.3, 0.0), &anchor);
        assert!((q * Vector3::x()).z > 0.29);
    }

    #[test]
    fn numbers_are_short_and_what_is_no_number_is_null() {
        assert_eq!(n(0.1 + 0.2).to_string(), "0.3");
        assert_eq!(n(-1.23456789).to_string(), "-1.2346");
        assert_eq!(n(f64::NAN), Value::Null);
    }
}
