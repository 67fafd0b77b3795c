//! Both kinds of text to items.

use super::super::convert::to_i32;
use super::{PlanFile, PlanFileError, fence_point, numbered, point, scale};
use mavlink_dialect::command::cmd;
use mavlink_dialect::mission_item::MissionItem;
use serde_json::Value;
use vehicle::In;

/// A `.plan`.
pub(super) fn plan(text: &str) -> Result<PlanFile, PlanFileError> {
    let file: Value = serde_json::from_str(text)?;
    if file["fileType"] != "Plan" {
        return Err(shape("fileType is not `Plan`"));
    }
    let items = file["mission"]["items"]
        .as_array()
        .ok_or_else(|| shape("mission.items is missing"))?;
    // With the id that jumps know each by.
    let mut mission: Vec<(Option<u64>, MissionItem)> = Vec::new();
    for item in items {
        simple_items(item, &mut mission)?;
    }
    let home = &file["mission"]["plannedHomePosition"];
    let rooms = array(&file["kestrel"]["rooms"]).iter().filter_map(|room| {
        let at = In::new(room["north_m"].as_f64()?, room["east_m"].as_f64()?, 0.0);
        Some((room["name"].as_str()?.to_owned(), at))
    });
    Ok(PlanFile {
        mission: numbered(with_jumps(mission)),
        fence: numbered(fence(&file["geoFence"])?),
        rally: numbered(rally(&file["rallyPoints"])?),
        rooms: rooms.collect(),
        home: degrees(home),
        cruise_mps: file["mission"]["cruiseSpeed"].as_f64(),
    })
}

/// Lines of twelve columns: number, current, frame, command, p1..p4, x, y, z, autocontinue.
pub(super) fn way_points(text: &str) -> Result<PlanFile, PlanFileError> {
    let mut mission = Vec::new();
    for (n, line) in (1..).zip(text.trim_start().lines()).skip(1) {
        let words: Vec<f64> = line
            .split_whitespace()
            .map(str::parse)
            .collect::<Result<_, _>>()
            .map_err(|_| PlanFileError::Line(n))?;
        if words.is_empty() {
            continue;
        }
        let [_, current, frame, command, p1, p2, p3, p4, x, y, z, auto] = words.as_slice() else {
            return Err(PlanFileError::Line(n));
        };
        let frame = *frame as u8;
        mission.push(MissionItem {
            seq: 0,
            frame,
            command: *command as u16,
            current: *current as u8,
            autocontinue: *auto as u8,
            params: [p1, p2, p3, p4].map(|p| *p as f32),
            x: on_wire(frame, *x),
            y: on_wire(frame, *y),
            z: *z as f32,
        });
    }
    Ok(PlanFile {
        mission: numbered(mission),
        ..PlanFile::default()
    })
}

fn shape(what: impl Into<String>) -> PlanFileError {
    PlanFileError::Shape(what.into())
}

fn array(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// A number, NaN where there is none.
fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// Degrees as 1e-7 degrees, metres of local frames as 1e-4 m; what does not fit saturates, and is refused as a place.
fn on_wire(frame: u8, v: f64) -> i32 {
    if v.is_finite() {
        to_i32(v * scale(frame))
    } else {
        i32::MAX
    }
}

/// Simple items, and those inside a survey.
fn simple_items(
    item: &Value,
    out: &mut Vec<(Option<u64>, MissionItem)>,
) -> Result<(), PlanFileError> {
    let seq = out.len();
    let inner = &item["TransectStyleComplexItem"]["Items"];
    if inner.is_array() {
        // Simple ones: a survey in a survey is none.
        return array(inner).iter().try_for_each(|i| simple_item(i, out));
    }
    if item["type"] != "SimpleItem" {
        let kind = item["complexItemType"].as_str().or(item["type"].as_str());
        return Err(PlanFileError::Complex {
            seq,
            kind: kind.unwrap_or("thing without a type").to_owned(),
        });
    }
    simple_item(item, out)
}

fn simple_item(
    item: &Value,
    out: &mut Vec<(Option<u64>, MissionItem)>,
) -> Result<(), PlanFileError> {
    let seq = out.len();
    let whole = |key: &str, most: u64| {
        item[key]
            .as_u64()
            .filter(|v| *v <= most)
            .ok_or_else(|| shape(format!("item {seq} has no {key}")))
    };
    // Both fit: `most` says so.
    let command = whole("command", u64::from(u16::MAX))? as u16;
    let frame = whole("frame", u64::from(u8::MAX))? as u8;
    let params = item["params"]
        .as_array()
        .filter(|p| p.len() == 7)
        .ok_or_else(|| shape(format!("item {seq} has no seven params")))?;
    let item = (
        item["doJumpId"].as_u64(),
        MissionItem {
            seq: 0,
            frame,
            command,
            current: 0,
            autocontinue: u8::from(item["autoContinue"].as_bool().unwrap_or(true)),
            params: [0, 1, 2, 3].map(|k| number(&params[k]) as f32),
            x: on_wire(frame, number(&params[4])),
            y: on_wire(frame, number(&params[5])),
            z: number(&params[6]) as f32,
        },
    );
    out.push(item);
    Ok(())
}

/// Jumps to ids become jumps to numbers.
fn with_jumps(items: Vec<(Option<u64>, MissionItem)>) -> Vec<MissionItem> {
    let ids: Vec<Option<u64>> = items.iter().map(|(id, _)| *id).collect();
    let number_of = |id: f32| {
        let named = ids
            .iter()
            .position(|i| i.is_some_and(|i| i == id.round() as u64));
        // Without ids they count from 1.
        named.map_or(id - 1.0, |at| at as f32)
    };
    items
        .into_iter()
        .map(|(_, mut item)| {
            if item.command == cmd::DO_JUMP {
                item.params[0] = number_of(item.params[0]);
            }
            item
        })
        .collect()
}

fn degrees(value: &Value) -> Option<[f64; 2]> {
    let (lat, lon) = (value[0].as_f64()?, value[1].as_f64()?);
    (lat.abs() <= 90.0 && lon.abs() <= 180.0).then_some([lat, lon])
}

fn place(value: &Value) -> Option<[i32; 2]> {
    degrees(value).map(|at| at.map(|v| to_i32(v * 1e7)))
}

fn fence(file: &Value) -> Result<Vec<MissionItem>, PlanFileError> {
    let mut fence = Vec::new();
    for (n, polygon) in (1..).zip(array(&file["polygons"])) {
        let corners = array(&polygon["polygon"]);
        let command = if polygon["inclusion"] == true {
            point::POLYGON_IN
        } else {
            point::POLYGON_OUT
        };
        for corner in corners {
            let at = place(corner)
                .ok_or_else(|| shape(format!("polygon {n} has a corner that is no place")))?;
            fence.push(fence_point(command, corners.len() as f32, at, 0.0));
        }
    }
    for (n, c) in (1..).zip(array(&file["circles"])) {
        let wrong = || shape(format!("circle {n} has no place or no radius"));
        let at = place(&c["circle"]["center"]).ok_or_else(wrong)?;
        let radius = c["circle"]["radius"].as_f64().ok_or_else(wrong)?;
        let command = if c["inclusion"] == true {
            point::CIRCLE_IN
        } else {
            point::CIRCLE_OUT
        };
        fence.push(fence_point(command, radius as f32, at, 0.0));
    }
    Ok(fence)
}

fn rally(file: &Value) -> Result<Vec<MissionItem>, PlanFileError> {
    (1..)
        .zip(array(&file["points"]))
        .map(|(n, p)| {
            let at = place(p).ok_or_else(|| shape(format!("rally point {n} is no place")))?;
            Ok(fence_point(point::RALLY, 0.0, at, number(&p[2]) as f32))
        })
        .collect()
}
