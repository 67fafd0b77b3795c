//! Plans on disk: QGroundControl's `.plan` (JSON) and way point files (`QGC WPL 110`).

use super::super::Usage;
use anyhow::{Context as _, Result};
use mavlink_dialect::mission_item::MissionItem;
use serde_json::{Value, json};
use std::path::Path;

/// The three lists of a plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Plan {
    /// Items to fly.
    pub(super) mission: Vec<MissionItem>,
    /// Fence.
    pub(super) fence: Vec<MissionItem>,
    /// Rally points.
    pub(super) rally: Vec<MissionItem>,
}

const LOCAL_NED: u8 = 1;
const RELATIVE_ALT: u8 = 3;
const FENCE_POLYGON_IN: u16 = 5001;
const FENCE_POLYGON_OUT: u16 = 5002;
const FENCE_CIRCLE_IN: u16 = 5003;
const FENCE_CIRCLE_OUT: u16 = 5004;
const RALLY_POINT: u16 = 5100;

impl Plan {
    /// Reads a file of either kind.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let plan = if text.trim_start().starts_with("QGC WPL") {
            Self::from_way_points(&text)
        } else {
            Self::from_json(&text)
        };
        plan.map_err(|why| Usage(format!("{}: {why}", path.display())).into())
    }

    fn from_json(text: &str) -> Result<Self, String> {
        let root: Value = serde_json::from_str(text).map_err(|e| format!("no plan: {e}"))?;
        if root["fileType"] != "Plan" {
            return Err("no plan of QGroundControl (fileType is not Plan)".to_owned());
        }
        let mut mission = Vec::new();
        for (n, item) in (1..).zip(array(&root["mission"]["items"])) {
            simple_items(item, n, &mut mission)?;
        }
        let mut fence = Vec::new();
        for (n, polygon) in (1..).zip(array(&root["geoFence"]["polygons"])) {
            let corners = array(&polygon["polygon"]);
            let command = if polygon["inclusion"] == true {
                FENCE_POLYGON_IN
            } else {
                FENCE_POLYGON_OUT
            };
            for corner in corners {
                let wrong = || format!("polygon {n} has a corner that is no place");
                let at = place(corner).ok_or_else(wrong)?;
                fence.push(point(command, corners.len() as f32, at, 0.0));
            }
        }
        for (n, c) in (1..).zip(array(&root["geoFence"]["circles"])) {
            let wrong = || format!("circle {n} is none");
            let at = place(&c["circle"]["center"]).ok_or_else(wrong)?;
            let radius = c["circle"]["radius"].as_f64().ok_or_else(wrong)?;
            let command = if c["inclusion"] == true {
                FENCE_CIRCLE_IN
            } else {
                FENCE_CIRCLE_OUT
            };
            fence.push(point(command, radius as f32, at, 0.0));
        }
        let mut rally = Vec::new();
        for (n, p) in (1..).zip(array(&root["rallyPoints"]["points"])) {
            let at = place(p).ok_or_else(|| format!("rally point {n} is no place"))?;
            rally.push(point(RALLY_POINT, 0.0, at, number(&p[2])));
        }
        Ok(Self {
            mission: numbered(mission),
            fence: numbered(fence),
            rally: numbered(rally),
        })
    }

    /// Lines of twelve columns: number, current, frame, command, p1..p4, x, y, z, autocontinue.
    fn from_way_points(text: &str) -> Result<Self, String> {
        let mut mission = Vec::new();
        for (n, line) in (1..).zip(text.lines()).skip(1) {
            let words: Vec<f64> = line
                .split_whitespace()
                .map(str::parse)
                .collect::<Result<_, _>>()
                .map_err(|_| format!("line {n} is no way point"))?;
            if words.is_empty() {
                continue;
            }
            let [_, current, frame, command, p1, p2, p3, p4, x, y, z, auto] = words.as_slice()
            else {
                return Err(format!("line {n} has {} columns, not 12", words.len()));
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
        Ok(Self {
            mission: numbered(mission),
            ..Self::default()
        })
    }

    /// As QGroundControl opens it.
    pub(super) fn to_json(&self) -> String {
        let float = |v: f32| {
            if v.is_finite() { json!(v) } else { Value::Null }
        };
        let at = |i: &MissionItem| json!([off_wire(i.frame, i.x), off_wire(i.frame, i.y)]);
        let items: Vec<Value> = (1..)
            .zip(&self.mission)
            .map(|(n, i)| {
                let [p1, p2, p3, p4] = i.params.map(float);
                json!({
                    "type": "SimpleItem", "doJumpId": n, "autoContinue": i.autocontinue != 0,
                    "command": i.command, "frame": i.frame,
                    "params": [p1, p2, p3, p4, off_wire(i.frame, i.x), off_wire(i.frame, i.y), float(i.z)],
                })
            })
            .collect();
        let mut polygons = Vec::new();
        let mut circles = Vec::new();
        let mut fence = self.fence.as_slice();
        while let Some((first, rest)) = fence.split_first() {
            let is_in = matches!(first.command, FENCE_POLYGON_IN | FENCE_CIRCLE_IN);
            if matches!(first.command, FENCE_POLYGON_IN | FENCE_POLYGON_OUT) {
                let corners = (first.params[0] as usize).clamp(1, fence.len());
                let (polygon, others) = fence.split_at(corners);
                let corners: Vec<Value> = polygon.iter().map(at).collect();
                polygons.push(json!({ "polygon": corners, "inclusion": is_in, "version": 1 }));
                fence = others;
            } else {
                let circle = json!({ "center": at(first), "radius": first.params[0] });
                circles.push(json!({ "circle": circle, "inclusion": is_in, "version": 1 }));
                fence = rest;
            }
        }
        let rally: Vec<Value> = self
            .rally
            .iter()
            .map(|i| json!([off_wire(i.frame, i.x), off_wire(i.frame, i.y), i.z]))
            .collect();
        let home = self.mission.first().map_or(json!([0, 0, 0]), |i| {
            json!([off_wire(i.frame, i.x), off_wire(i.frame, i.y), 0])
        });
        let plan = json!({
            "fileType": "Plan", "version": 1, "groundStation": "Kestrel",
            "mission": {
                "version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 1, "hoverSpeed": 1,
                "globalPlanAltitudeMode": 1, "plannedHomePosition": home, "items": items,
            },
            "geoFence": { "version": 2, "polygons": polygons, "circles": circles },
            "rallyPoints": { "version": 2, "points": rally },
        });
        // A value made here cannot fail to serialise.
        serde_json::to_string_pretty(&plan).unwrap_or_default() + "\n"
    }

    /// One line an item.
    pub(super) fn to_text(&self) -> String {
        let mut out = String::new();
        for (name, list) in [
            ("mission", &self.mission),
            ("fence", &self.fence),
            ("rally points", &self.rally),
        ] {
            out.push_str(&format!("{name}: {} items\n", list.len()));
            for i in list {
                let command = mavlink_dialect::command::name(i.command)
                    .map_or_else(|| i.command.to_string(), str::to_owned);
                let params: Vec<String> = i.params.iter().map(ToString::to_string).collect();
                let (x, y) = (off_wire(i.frame, i.x), off_wire(i.frame, i.y));
                out.push_str(&format!(
                    "{:>4}  {command:<24} frame {:<2} {x:.7}, {y:.7}, {}  ({})\n",
                    i.seq,
                    i.frame,
                    i.z,
                    params.join(", ")
                ));
            }
        }
        out
    }
}

fn array(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// A number, NaN where there is none.
fn number(value: &Value) -> f32 {
    value.as_f64().map_or(f32::NAN, |v| v as f32)
}

fn place(value: &Value) -> Option<[f64; 2]> {
    let (lat, lon) = (value[0].as_f64()?, value[1].as_f64()?);
    (lat.abs() <= 90.0 && lon.abs() <= 180.0).then_some([lat, lon])
}

/// Simple items, and those inside a survey.
fn simple_items(item: &Value, n: usize, out: &mut Vec<MissionItem>) -> Result<(), String> {
    let inner = &item["TransectStyleComplexItem"]["Items"];
    if inner.is_array() {
        return array(inner)
            .iter()
            .try_for_each(|i| simple_items(i, n, out));
    }
    if item["type"] != "SimpleItem" {
        let kind = item["complexItemType"].as_str().unwrap_or("without type");
        return Err(format!("item {n} ({kind}) has no simple items in it"));
    }
    let (Some(command), Some(frame)) = (item["command"].as_u64(), item["frame"].as_u64()) else {
        return Err(format!("item {n} has no command or no frame"));
    };
    let p = &item["params"];
    let (frame, command) = (frame as u8, command as u16);
    let coordinate = |i: usize| p[i].as_f64().unwrap_or(0.0);
    out.push(MissionItem {
        seq: 0,
        frame,
        command,
        current: 0,
        autocontinue: u8::from(item["autoContinue"] != false),
        params: core::array::from_fn(|i| number(&p[i])),
        x: on_wire(frame, coordinate(4)),
        y: on_wire(frame, coordinate(5)),
        z: number(&p[6]),
    });
    Ok(())
}

fn point(command: u16, param1: f32, [lat, lon]: [f64; 2], z: f32) -> MissionItem {
    MissionItem {
        seq: 0,
        frame: RELATIVE_ALT,
        command,
        current: 0,
        autocontinue: 1,
        params: [param1, 0.0, 0.0, 0.0],
        x: on_wire(RELATIVE_ALT, lat),
        y: on_wire(RELATIVE_ALT, lon),
        z,
    }
}

/// Degrees as 1e-7 degrees, metres of local frames as 1e-4 m.
fn on_wire(frame: u8, v: f64) -> i32 {
    let scale = if frame == LOCAL_NED { 1e4 } else { 1e7 };
    // What does not fit saturates, and is refused as a place.
    (v * scale).round() as i32
}

fn off_wire(frame: u8, v: i32) -> f64 {
    let scale = if frame == LOCAL_NED { 1e4 } else { 1e7 };
    f64::from(v) / scale
}

fn numbered(mut items: Vec<MissionItem>) -> Vec<MissionItem> {
    for (seq, item) in (0..).zip(&mut items) {
        item.seq = seq;
        item.current = u8::from(seq == 0);
    }
    items
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: &str = r#"{"fileType":"Plan","version":1,
      "mission":{"items":[
        {"type":"SimpleItem","command":22,"frame":3,"autoContinue":true,"params":[0,0,0,null,47.3977,8.5456,1.5]},
        {"type":"ComplexItem","complexItemType":"survey","TransectStyleComplexItem":{"Items":[
          {"type":"SimpleItem","command":16,"frame":3,"autoContinue":true,"params":[1,0,0,null,47.3978,8.5457,1.5]}]}},
        {"type":"SimpleItem","command":16,"frame":1,"autoContinue":true,"params":[0,0,0,null,2.5,-1.25,-1.5]}]},
      "geoFence":{"circles":[{"circle":{"center":[47.3977,8.5456],"radius":2.5},"inclusion":false}],
        "polygons":[{"polygon":[[47.397,8.545],[47.398,8.545],[47.398,8.546]],"inclusion":true}]},
      "rallyPoints":{"points":[[47.3977,8.5456,1.0]]}}"#;

    #[test]
    fn a_plan_of_qgroundcontrol_is_read_and_written_back() {
        let plan = Plan::from_json(PLAN).unwrap();
        let commands: Vec<u16> = plan.mission.iter().map(|i| i.command).collect();
        assert_eq!(commands, [22, 16, 16]);
        assert_eq!((plan.mission[2].x, plan.mission[2].y), (25_000, -12_500));
        assert!(plan.mission[0].params[3].is_nan());
        let fence: Vec<(u16, f32)> = plan
            .fence
            .iter()
            .map(|i| (i.command, i.params[0]))
            .collect();
        assert_eq!(fence, [(5001, 3.0), (5001, 3.0), (5001, 3.0), (5004, 2.5)]);
        assert_eq!(plan.rally.len(), 1);
        let again = Plan::from_json(&plan.to_json()).unwrap();
        let bytes =
            |items: &[MissionItem]| items.iter().map(MissionItem::bytes).collect::<Vec<_>>();
        assert_eq!(bytes(&again.mission), bytes(&plan.mission));
        assert_eq!(bytes(&again.fence), bytes(&plan.fence));
        assert_eq!(bytes(&again.rally), bytes(&plan.rally));
    }

    #[test]
    fn way_point_files_are_read_and_wrong_lines_named() {
        let text = "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47.3977\t8.5456\t0\t1\n1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t1.5\t1\n";
        let plan = Plan::from_way_points(text).unwrap();
        assert_eq!(plan.mission.len(), 2);
        assert_eq!(plan.mission[0].x, 473_977_000);
        assert!(
            Plan::from_way_points("QGC WPL 110\n1 2 3\n")
                .unwrap_err()
                .contains("line 2")
        );
        for wrong in [
            "{",
            "{}",
            r#"{"fileType":"Plan","mission":{"items":[{"type":"ComplexItem"}]}}"#,
        ] {
            assert!(Plan::from_json(wrong).is_err(), "{wrong}");
        }
    }
}
