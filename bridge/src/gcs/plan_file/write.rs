//! Items to `.plan`, with the keys that QGroundControl insists on.

use super::{PlanFile, point, scale};
use mavlink_dialect::command::cmd;
use mavlink_dialect::mission_item::{Frame, MissionItem};
use serde_json::{Value, json};

/// MAV_AUTOPILOT_PX4, MAV_TYPE_QUADROTOR: what the vehicle says it is.
const FIRMWARE: u8 = 12;
const QUADROTOR: u8 = 2;

impl PlanFile {
    /// The text of a `.plan`.
    #[must_use]
    pub fn to_json(&self) -> String {
        let cruise_mps = self.cruise_mps.unwrap_or(1.0);
        let begins = || self.mission.iter().find(|i| has_place(i)).map(at);
        let [lat, lon] = match self.home {
            Some(home) => home.map(|v| json!(v)),
            None => begins().unwrap_or([json!(0), json!(0)]),
        };
        let items: Vec<Value> = (1..)
            .zip(&self.mission)
            .map(|(id, i)| item(id, i))
            .collect();
        let (polygons, circles) = fence(&self.fence);
        let rally: Vec<Value> = self
            .rally
            .iter()
            .map(|i| {
                let [lat, lon] = at(i);
                json!([lat, lon, i.z])
            })
            .collect();
        let mut file = json!({
            "fileType": "Plan",
            "version": 1,
            // Stations check it and read what they know.
            "groundStation": "QGroundControl",
            "mission": {
                "version": 2,
                "firmwareType": FIRMWARE,
                "vehicleType": QUADROTOR,
                "globalPlanAltitudeMode": 1,
                "cruiseSpeed": cruise_mps,
                "hoverSpeed": cruise_mps,
                "plannedHomePosition": [lat, lon, 0],
                "items": items,
            },
            "geoFence": {"version": 2, "circles": circles, "polygons": polygons},
            "rallyPoints": {"version": 2, "points": rally},
        });
        if !self.rooms.is_empty() {
            let rooms = self.rooms.iter();
            let rooms: Vec<Value> = rooms
                .map(|(name, p)| json!({"name": name, "north_m": p.x(), "east_m": p.y()}))
                .collect();
            file["kestrel"] = json!({ "rooms": rooms });
        }
        // Values made above always serialize.
        serde_json::to_string_pretty(&file).unwrap_or_default() + "\n"
    }
}

/// A number, null for "not given".
fn float(v: f32) -> Value {
    if v.is_finite() { json!(v) } else { Value::Null }
}

/// The two coordinates.
fn at(i: &MissionItem) -> [Value; 2] {
    [i.x, i.y].map(|v| match v {
        i32::MAX => Value::Null,
        v => json!(f64::from(v) / scale(i.frame)),
    })
}

fn has_place(i: &MissionItem) -> bool {
    let is_global = matches!(
        Frame::from_wire(i.frame),
        Some(Frame::Global | Frame::GlobalRelative)
    );
    is_global && i.x != i32::MAX && i.y != i32::MAX && (i.x, i.y) != (0, 0)
}

fn item(id: usize, i: &MissionItem) -> Value {
    let [mut p1, p2, p3, p4] = i.params.map(float);
    if i.command == cmd::DO_JUMP {
        p1 = float(i.params[0] + 1.0);
    }
    let [x, y] = at(i);
    let mut item = json!({
        "type": "SimpleItem", "autoContinue": i.autocontinue != 0, "command": i.command, "doJumpId": id,
        "frame": i.frame, "params": [p1, p2, p3, p4, x, y, float(i.z)],
    });
    let altitude_mode = match Frame::from_wire(i.frame) {
        Some(Frame::GlobalRelative) => Some(1),
        Some(Frame::Global) => Some(2),
        _ => None,
    };
    if let Some(mode) = altitude_mode {
        item["AMSLAltAboveTerrain"] = Value::Null;
        item["Altitude"] = float(i.z);
        item["AltitudeMode"] = json!(mode);
    }
    item
}

/// (polygons, circles).
fn fence(mut items: &[MissionItem]) -> (Vec<Value>, Vec<Value>) {
    let (mut polygons, mut circles) = (Vec::new(), Vec::new());
    while let Some((first, rest)) = items.split_first() {
        let is_in = matches!(first.command, point::POLYGON_IN | point::CIRCLE_IN);
        if matches!(first.command, point::POLYGON_IN | point::POLYGON_OUT) {
            let corners = (first.params[0] as usize).clamp(1, items.len());
            let (polygon, others) = items.split_at(corners);
            let corners: Vec<_> = polygon.iter().map(at).collect();
            polygons.push(json!({"polygon": corners, "inclusion": is_in, "version": 1}));
            items = others;
        } else {
            let circle = json!({"center": at(first), "radius": first.params[0]});
            circles.push(json!({"circle": circle, "inclusion": is_in, "version": 1}));
            items = rest;
        }
    }
    (polygons, circles)
}
