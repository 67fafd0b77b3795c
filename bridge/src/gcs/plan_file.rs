//! QGroundControl's plan files (`.plan`, JSON): a mission, a fence and rally points, written and read.
//!
//! Source: QGroundControl developer guide, "Plan File Format" (version 1; mission version 2). Coordinates are degrees, heights
//! metres above home. Item ids (`doJumpId`) count from 1; a jump names the id of its target. What a station uploads to us counts
//! from 0 and carries no home item. Our key `kestrel` names rooms; stations leave it alone.

use super::convert::GeoAnchor;
use mavlink_dialect::command::cmd;
use mavlink_dialect::mission_item::MissionItem;
use serde_json::{Value, json};
use thiserror::Error;
use vehicle::{In, Ned};

/// MAV_FRAME_GLOBAL_RELATIVE_ALT and MAV_FRAME_MISSION.
const RELATIVE: u8 = 3;
const NO_PLACE: u8 = 2;
/// MAV_AUTOPILOT_PX4, MAV_TYPE_QUADROTOR: what the vehicle says it is.
const FIRMWARE: u8 = 12;
const QUADROTOR: u8 = 2;

/// A step of a mission to be written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Climb, m above home.
    Takeoff(f64),
    /// Pass a place; stay, s.
    Waypoint(In<Ned>, f64),
    /// Fly on with another speed, m/s.
    Speed(f64),
    /// Continue at a step, so many times.
    Jump(usize, u32),
    /// Fly home and land.
    Return,
}

/// What goes into a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanFile {
    /// In order.
    pub steps: Vec<Step>,
    /// Polygons to stay out of, NED about home.
    pub no_fly: Vec<Vec<In<Ned>>>,
    /// Rooms by name, NED about home.
    pub rooms: Vec<(String, In<Ned>)>,
    /// Speed that stations reckon with, m/s.
    pub cruise_mps: f64,
}

impl PlanFile {
    /// The file's text. Degrees have as many digits as it takes to be exact to a millimetre, which is finer than what the mission
    /// protocol carries (1.1 cm).
    #[must_use]
    pub fn to_json(&self, geo: &GeoAnchor) -> String {
        let degrees = |p: &In<Ned>| {
            let [lat, lon] = geo.to_degrees(*p);
            [lat, lon].map(|v| (v * 1e9).round() * 1e-9)
        };
        let home = degrees(&In::zero());
        let items: Vec<Value> = self
            .steps
            .iter()
            .zip(1..)
            .map(|(step, id): (_, usize)| {
                let nan = Value::Null;
                let (command, frame, params, height_m) = match step {
                    Step::Takeoff(height_m) => (
                        cmd::NAV_TAKEOFF,
                        RELATIVE,
                        json!([0, 0, 0, nan, home[0], home[1], height_m]),
                        Some(*height_m),
                    ),
                    Step::Waypoint(p, hold_s) => {
                        let [lat, lon] = degrees(p);
                        (
                            cmd::NAV_WAYPOINT,
                            RELATIVE,
                            json!([hold_s, 0, 0, nan, lat, lon, -p.z()]),
                            Some(-p.z()),
                        )
                    }
                    Step::Speed(mps) => (
                        cmd::DO_CHANGE_SPEED,
                        NO_PLACE,
                        json!([1, mps, -1, 0, 0, 0, 0]),
                        None,
                    ),
                    Step::Jump(to, times) => (
                        cmd::DO_JUMP,
                        NO_PLACE,
                        json!([to + 1, times, 0, 0, 0, 0, 0]),
                        None,
                    ),
                    Step::Return => (
                        cmd::NAV_RETURN_TO_LAUNCH,
                        NO_PLACE,
                        json!([0, 0, 0, 0, 0, 0, 0]),
                        None,
                    ),
                };
                let mut item = json!({
                    "type": "SimpleItem", "autoContinue": true, "command": command, "doJumpId": id,
                    "frame": frame, "params": params,
                });
                if let Some(height_m) = height_m {
                    item["AMSLAltAboveTerrain"] = Value::Null;
                    item["Altitude"] = json!(height_m);
                    item["AltitudeMode"] = json!(1);
                }
                item
            })
            .collect();
        let polygons: Vec<Value> = self
            .no_fly
            .iter()
            .map(|zone| {
                let path: Vec<_> = zone.iter().map(degrees).collect();
                json!({"inclusion": false, "polygon": path, "version": 1})
            })
            .collect();
        let rooms: Vec<Value> = self
            .rooms
            .iter()
            .map(|(name, p)| json!({"name": name, "north_m": p.x(), "east_m": p.y()}))
            .collect();
        let file = json!({
            "fileType": "Plan",
            "version": 1,
            "groundStation": "QGroundControl",
            "mission": {
                "version": 2,
                "firmwareType": FIRMWARE,
                "vehicleType": QUADROTOR,
                "globalPlanAltitudeMode": 1,
                "cruiseSpeed": self.cruise_mps,
                "hoverSpeed": self.cruise_mps,
                "plannedHomePosition": [home[0], home[1], 0],
                "items": items,
            },
            "geoFence": {"version": 2, "circles": [], "polygons": polygons},
            "rallyPoints": {"version": 2, "points": []},
            "kestrel": {"rooms": rooms},
        });
        // Values made above always serialize.
        serde_json::to_string_pretty(&file).unwrap_or_default() + "\n"
    }
}

/// Why a plan file cannot be read.
#[derive(Debug, Error)]
pub enum PlanFileError {
    /// Not JSON.
    #[error("not a plan file: {0}")]
    Json(#[from] serde_json::Error),
    /// Something is missing or of another kind.
    #[error("not a plan file: {0}")]
    Shape(String),
    /// Survey patterns and the like, which only QGroundControl turns into items.
    #[error("item {seq} is a {kind}: save the mission from QGroundControl as simple items")]
    Complex {
        /// Which.
        seq: usize,
        /// What it calls itself.
        kind: String,
    },
}

/// The mission items of a plan file as a station would upload them, numbered from 0.
///
/// # Errors
/// [`PlanFileError`] names what is not understood.
pub fn items(text: &str) -> Result<Vec<MissionItem>, PlanFileError> {
    let shape = |what: &str| PlanFileError::Shape(what.to_owned());
    let file: Value = serde_json::from_str(text)?;
    if file["fileType"] != "Plan" {
        return Err(shape("fileType is not `Plan`"));
    }
    let list = file["mission"]["items"]
        .as_array()
        .ok_or_else(|| shape("mission.items is missing"))?;
    list.iter()
        .enumerate()
        .map(|(seq, item)| {
            if item["type"] != "SimpleItem" {
                let kind = item["complexItemType"].as_str().or(item["type"].as_str());
                return Err(PlanFileError::Complex {
                    seq,
                    kind: kind.unwrap_or("thing without a type").to_owned(),
                });
            }
            let whole = |key: &str| {
                item[key]
                    .as_u64()
                    .and_then(|v| u16::try_from(v).ok())
                    .ok_or_else(|| PlanFileError::Shape(format!("item {seq} has no {key}")))
            };
            let (command, frame) = (whole("command")?, whole("frame")? as u8);
            let params = item["params"]
                .as_array()
                .filter(|p| p.len() == 7)
                .ok_or_else(|| PlanFileError::Shape(format!("item {seq} has no seven params")))?;
            let number = |k: usize| params[k].as_f64().unwrap_or(f64::NAN);
            let mut short = [0, 1, 2, 3].map(|k| number(k) as f32);
            if command == cmd::DO_JUMP {
                // Ids count from 1, items on the wire from 0.
                short[0] -= 1.0;
            }
            let scaled = |v: f64| {
                let scale = if frame == 1 { 1e4 } else { 1e7 };
                if v.is_finite() {
                    super::convert::to_i32(v * scale)
                } else {
                    i32::MAX
                }
            };
            Ok(MissionItem {
                seq: seq as u16,
                frame,
                command,
                current: u8::from(seq == 0),
                autocontinue: u8::from(item["autoContinue"].as_bool().unwrap_or(true)),
                params: short,
                x: scaled(number(4)),
                y: scaled(number(5)),
                z: number(6) as f32,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::params::GroundParams;
    use super::super::place::Place;
    use super::*;
    use mavlink_dialect::mission_item::{Action, Point};

    fn file() -> PlanFile {
        PlanFile {
            steps: vec![
                Step::Takeoff(1.2),
                Step::Speed(0.5),
                Step::Waypoint(In::new(3.004, -2.5, -1.2), 2.0),
                Step::Waypoint(In::new(-0.75, 4.25, -1.2), 0.0),
                Step::Jump(2, 4),
                Step::Return,
            ],
            no_fly: vec![vec![
                In::zero(),
                In::new(1.0, 0.0, 0.0),
                In::new(0.0, 1.0, 0.0),
            ]],
            rooms: vec![("lab".to_owned(), In::new(1.0, 2.0, 0.0))],
            cruise_mps: 0.5,
        }
    }

    #[test]
    fn what_is_written_is_read_back_within_the_protocol_s_centimetre() {
        let bench = super::super::bench::Bench::default();
        let geo = GeoAnchor::from_params(&GroundParams::default());
        let items = items(&file().to_json(&geo)).unwrap();
        let commands: Vec<u16> = items.iter().map(|i| i.command).collect();
        assert_eq!(commands, [22, 178, 16, 16, 177, 20]);
        let place = |i: &MissionItem| {
            let p = Point::from_wire(i.frame, i.x, i.y, i.z);
            Place::from_point(&p, &bench.ctx())
                .unwrap()
                .whole()
                .unwrap()
        };
        assert!((place(&items[2]) - In::new(3.004, -2.5, -1.2)).norm() < 0.01);
        assert!((place(&items[3]) - In::new(-0.75, 4.25, -1.2)).norm() < 0.01);
        assert_eq!(items[4].action(), Ok(Action::Jump { to: 2, count: 4 }));
        assert!(items.iter().all(|i| i.action().is_ok()));
    }

    #[test]
    fn stations_find_the_keys_they_insist_on() {
        let geo = GeoAnchor::from_params(&GroundParams::default());
        let v: Value = serde_json::from_str(&file().to_json(&geo)).unwrap();
        assert_eq!(
            (&v["version"], &v["mission"]["version"]),
            (&json!(1), &json!(2))
        );
        assert_eq!(
            v["mission"]["items"][4]["params"][0],
            json!(3),
            "an id, not a seq"
        );
        assert_eq!(v["geoFence"]["polygons"][0]["inclusion"], json!(false));
        assert_eq!(v["rallyPoints"]["points"], json!([]));
        assert_eq!(v["kestrel"]["rooms"][0]["name"], json!("lab"));
    }

    #[test]
    fn what_is_not_understood_is_named() {
        let said = |text: &str| items(text).unwrap_err().to_string();
        assert!(said("{").contains("not a plan file"));
        assert!(said(r#"{"fileType": "Parameters"}"#).contains("fileType"));
        let survey = r#"{"fileType": "Plan", "mission": {"items": [{"type": "ComplexItem", "complexItemType": "survey"}]}}"#;
        assert!(said(survey).contains("item 0 is a survey"));
        let short = r#"{"fileType": "Plan", "mission": {"items": [{"type": "SimpleItem", "command": 16, "frame": 3, "params": [1]}]}}"#;
        assert!(said(short).contains("item 0 has no seven params"));
    }
}
