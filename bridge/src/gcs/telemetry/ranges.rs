//! What the range finders and the flow camera see.

use super::table::View;
use crate::gcs::convert::to_u16;
use core::f64::consts::{FRAC_PI_4, TAU};
use mavlink_dialect::Message;
use mavlink_dialect::standard::{
    DISTANCE_SENSOR_DATA, MavDistanceSensor, MavFrame, MavMessage, MavSensorOrientation,
    OBSTACLE_DISTANCE_DATA, OPTICAL_FLOW_DATA,
};
use vehicle::{Beam, Timestamp};

/// MAV_SENSOR_ROTATION of the eight sides, clockwise from forward.
const SIDES: [MavSensorOrientation; 8] = [
    MavSensorOrientation::MAV_SENSOR_ROTATION_NONE,
    MavSensorOrientation::MAV_SENSOR_ROTATION_YAW_45,
    MavSensorOrientation::MAV_SENSOR_ROTATION_YAW_90,
    MavSensorOrientation::MAV_SENSOR_ROTATION_YAW_135,
    MavSensorOrientation::MAV_SENSOR_ROTATION_YAW_180,
    MavSensorOrientation::MAV_SENSOR_ROTATION_YAW_225,
    MavSensorOrientation::MAV_SENSOR_ROTATION_YAW_270,
    MavSensorOrientation::MAV_SENSOR_ROTATION_YAW_315,
];
/// DISTANCE_SENSOR.id of the down-ranger; sides have 0..=7.
const DOWN_ID: u8 = 25;
/// Range of the down-ranger, m: the snapshot names none.
const DOWN_RANGE_M: (f64, f64) = (0.02, 4.0);
/// Sectors of OBSTACLE_DISTANCE.
const BINS: usize = 72;
/// OBSTACLE_DISTANCE: nothing measured there.
const UNKNOWN_CM: u16 = u16::MAX;

/// One message for each of the eight sides that a beam looks at, with its nearest return, and one for down.
pub(super) fn distance_sensor(v: &View<'_>, out: &mut Vec<Message>) {
    if let Some(scan) = v
        .snapshot
        .scan
        .as_ref()
        .filter(|_| v.snapshot.rangers_alive)
    {
        for (side, orientation) in (0u8..).zip(SIDES) {
            let beams = || {
                scan.beams
                    .iter()
                    .filter(move |b| sector(b.bearing_rad, SIDES.len()) == usize::from(side))
            };
            let Some(any) = beams().next() else { continue };
            let nearest = beams()
                .filter(|b| b.distance_m.is_some())
                .min_by(|a, b| total(a).total_cmp(&total(b)))
                .unwrap_or(any);
            out.push(side_message(scan.at, nearest, side, orientation));
        }
    }
    if let Some(down) = v.snapshot.down_range {
        out.push(
            MavMessage::DISTANCE_SENSOR(DISTANCE_SENSOR_DATA {
                time_boot_ms: down.at.boot_ms(),
                min_distance: to_u16(DOWN_RANGE_M.0 * 1e2),
                max_distance: to_u16(DOWN_RANGE_M.1 * 1e2),
                current_distance: reading_cm(down.distance_m, DOWN_RANGE_M.1),
                mavtype: MavDistanceSensor::MAV_DISTANCE_SENSOR_UNKNOWN,
                id: DOWN_ID,
                orientation: MavSensorOrientation::MAV_SENSOR_ROTATION_PITCH_270,
                covariance: u8::MAX,
                signal_quality: signal_quality(down.distance_m),
                ..DISTANCE_SENSOR_DATA::default()
            })
            .into(),
        );
    }
}

fn side_message(at: Timestamp, beam: &Beam, id: u8, orientation: MavSensorOrientation) -> Message {
    let opening = (2.0 * beam.half_cone_rad) as f32;
    MavMessage::DISTANCE_SENSOR(DISTANCE_SENSOR_DATA {
        time_boot_ms: at.boot_ms(),
        min_distance: to_u16(beam.min_m * 1e2),
        max_distance: to_u16(beam.max_m * 1e2),
        current_distance: reading_cm(beam.distance_m, beam.max_m),
        mavtype: MavDistanceSensor::MAV_DISTANCE_SENSOR_UNKNOWN,
        id,
        orientation,
        covariance: u8::MAX,
        horizontal_fov: opening,
        vertical_fov: opening,
        signal_quality: signal_quality(beam.distance_m),
        ..DISTANCE_SENSOR_DATA::default()
    })
    .into()
}

/// Without a return: one more than the largest.
fn reading_cm(distance_m: Option<f64>, max_m: f64) -> u16 {
    distance_m.map_or_else(
        || to_u16(max_m * 1e2).saturating_add(1),
        |d| to_u16(d * 1e2),
    )
}

/// 1 = invalid, 0 = unknown.
fn signal_quality(distance_m: Option<f64>) -> u8 {
    u8::from(distance_m.is_none())
}

/// Distance for comparison.
fn total(b: &Beam) -> f64 {
    b.distance_m.unwrap_or(f64::INFINITY)
}

/// Index of the sector (clockwise, the first centred on forward) that holds a bearing.
fn sector(bearing_rad: f64, sectors: usize) -> usize {
    let turns = bearing_rad / TAU;
    let share = turns - libm::floor(turns);
    (libm::round(share * sectors as f64) as usize) % sectors
}

/// 72 sectors of 5 degrees around the body: the nearest return of each, seen from the body's centre.
pub(super) fn obstacle_distance(v: &View<'_>, out: &mut Vec<Message>) {
    let Some(scan) = &v.snapshot.scan else { return };
    let mut nearest_m = [f64::INFINITY; BINS];
    let mut is_seen = [false; BINS];
    let (mut min_m, mut max_m) = (f64::INFINITY, 0.0_f64);
    for beam in scan.beams.iter().filter(|_| v.snapshot.rangers_alive) {
        let (bearing, reach) = seen_from_centre(beam, beam.distance_m.unwrap_or(beam.max_m));
        min_m = min_m.min(beam.min_m);
        max_m = max_m.max(seen_from_centre(beam, beam.max_m).1);
        // A cone covers every sector it touches; a cone of more than a quarter turn says nothing about direction.
        let half = beam.half_cone_rad.clamp(0.0, FRAC_PI_4);
        let first = libm::round((bearing - half) / TAU * BINS as f64) as i32;
        let last = libm::round((bearing + half) / TAU * BINS as f64) as i32;
        for bin in first..=last {
            let bin = bin.rem_euclid(BINS as i32) as usize;
            is_seen[bin] = true;
            if beam.distance_m.is_some() {
                nearest_m[bin] = nearest_m[bin].min(reach);
            }
        }
    }
    let max_cm = to_u16(max_m * 1e2).min(u16::MAX - 2);
    let mut distances = [UNKNOWN_CM; BINS];
    for (bin, cm) in distances
        .iter_mut()
        .enumerate()
        .filter(|(bin, _)| is_seen[*bin])
    {
        *cm = if nearest_m[bin].is_finite() {
            to_u16(nearest_m[bin] * 1e2).min(max_cm)
        } else {
            max_cm + 1
        };
    }
    out.push(
        MavMessage::OBSTACLE_DISTANCE(OBSTACLE_DISTANCE_DATA {
            time_usec: scan.at.us(),
            sensor_type: MavDistanceSensor::MAV_DISTANCE_SENSOR_UNKNOWN,
            distances,
            increment: 5,
            min_distance: if min_m.is_finite() {
                to_u16(min_m * 1e2)
            } else {
                0
            },
            max_distance: max_cm,
            increment_f: 5.0,
            angle_offset: 0.0,
            frame: MavFrame::MAV_FRAME_BODY_FRD,
        })
        .into(),
    );
}

/// (bearing clockwise from forward, horizontal distance) of a beam's end, seen from the body's centre: rad, m.
fn seen_from_centre(beam: &Beam, length_m: f64) -> (f64, f64) {
    let level = length_m * libm::cos(beam.elevation_rad);
    let x = beam.origin.x() + level * libm::cos(beam.bearing_rad);
    let y = beam.origin.y() + level * libm::sin(beam.bearing_rad);
    (libm::atan2(y, x), libm::hypot(x, y))
}

pub(super) fn optical_flow(v: &View<'_>, out: &mut Vec<Message>) {
    let Some(flow) = v.snapshot.flow else { return };
    // The flow left when the turning is taken out, times the distance, is the velocity over the floor.
    let nav = &v.snapshot.nav;
    let height = nav.height_m;
    out.push(
        MavMessage::OPTICAL_FLOW(OPTICAL_FLOW_DATA {
            time_usec: flow.at.us(),
            sensor_id: 0,
            // Pixels of a camera that is not known; the rates below carry the same.
            flow_x: 0,
            flow_y: 0,
            flow_comp_m_x: ((flow.y_radps - nav.rates_radps.y()) * height) as f32,
            flow_comp_m_y: ((nav.rates_radps.x() - flow.x_radps) * height) as f32,
            quality: flow.quality,
            ground_distance: if nav.health.height {
                height as f32
            } else {
                -1.0
            },
            flow_rate_x: flow.x_radps as f32,
            flow_rate_y: flow.y_radps as f32,
        })
        .into(),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sectors_are_centred_on_forward_and_run_clockwise() {
        let deg = |d: f64| sector(d.to_radians(), 8);
        assert_eq!(
            [
                deg(0.0),
                deg(-22.0),
                deg(22.0),
                deg(23.0),
                deg(90.0),
                deg(-90.0),
                deg(359.0)
            ],
            [0, 0, 0, 1, 2, 6, 0]
        );
    }
}
