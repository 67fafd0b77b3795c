//! Plans read, written, and read again.

use super::super::bench::Bench;
use super::super::params::GroundParams;
use super::super::place::Place;
use super::*;
use mavlink_dialect::mission_item::{Action, Point};
use serde_json::{Value, json};

const PLAN: &str = r#"{"fileType":"Plan","version":1,
  "mission":{"plannedHomePosition":[47.3977,8.5456,0],"items":[
    {"type":"SimpleItem","command":22,"frame":3,"autoContinue":true,"doJumpId":1,"params":[0,0,0,null,47.3977,8.5456,1.5]},
    {"type":"ComplexItem","complexItemType":"survey","TransectStyleComplexItem":{"Items":[
      {"type":"SimpleItem","command":16,"frame":3,"autoContinue":true,"doJumpId":3,"params":[1,0,0,null,47.3978,8.5457,1.5]}]}},
    {"type":"SimpleItem","command":16,"frame":1,"autoContinue":true,"doJumpId":4,"params":[0,0,0,null,2.5,-1.25,-1.5]},
    {"type":"SimpleItem","command":17,"frame":3,"autoContinue":true,"doJumpId":5,"params":[0,0,0,null,null,null,1.5]},
    {"type":"SimpleItem","command":177,"frame":2,"autoContinue":true,"doJumpId":6,"params":[3,2,0,0,0,0,0]}]},
  "geoFence":{"circles":[{"circle":{"center":[47.3977,8.5456],"radius":2.5},"inclusion":false}],
    "polygons":[{"polygon":[[47.397,8.545],[47.398,8.545],[47.398,8.546]],"inclusion":true}]},
  "rallyPoints":{"points":[[47.3977,8.5456,1.0]]},
  "kestrel":{"rooms":[{"name":"lab","north_m":1.0,"east_m":2.0}]}}"#;

fn made() -> PlanFile {
    let steps = [
        Step::Takeoff(1.2),
        Step::Speed(0.5),
        Step::Waypoint(In::new(3.004, -2.5, -1.2), 2.0),
        Step::Waypoint(In::new(-0.75, 4.25, -1.2), 0.0),
        Step::Jump(2, 4),
        Step::Return,
    ];
    let zone = vec![In::zero(), In::new(1.0, 0.0, 0.0), In::new(0.0, 1.0, 0.0)];
    let geo = GeoAnchor::from_params(&GroundParams::default());
    PlanFile {
        rooms: vec![("lab".to_owned(), In::new(1.0, 2.0, 0.0))],
        cruise_mps: Some(0.5),
        ..PlanFile::from_steps(&steps, &[zone], &geo)
    }
}

/// NaN is not itself, so items are compared by their bytes.
fn bytes(items: &[MissionItem]) -> Vec<[u8; 34]> {
    items.iter().map(MissionItem::bytes).collect()
}

#[test]
fn a_plan_of_qgroundcontrol_is_read_and_written_back() {
    let plan = PlanFile::parse(PLAN).unwrap();
    let commands: Vec<u16> = plan.mission.iter().map(|i| i.command).collect();
    assert_eq!(commands, [22, 16, 16, 17, 177]);
    assert_eq!((plan.mission[2].x, plan.mission[2].y), (25_000, -12_500));
    assert!(plan.mission[0].params[3].is_nan());
    assert_eq!(plan.mission[3].x, i32::MAX, "not given is not zero");
    let jump = plan.mission[4].action();
    assert_eq!(jump, Ok(Action::Jump { to: 1, count: 2 }), "by id");
    let fence: Vec<(u16, f32)> = plan
        .fence
        .iter()
        .map(|i| (i.command, i.params[0]))
        .collect();
    assert_eq!(fence, [(5001, 3.0), (5001, 3.0), (5001, 3.0), (5004, 2.5)]);
    assert_eq!((plan.rally.len(), plan.rooms.len()), (1, 1));
    let again = PlanFile::parse(&plan.to_json()).unwrap();
    assert_eq!(bytes(&again.mission), bytes(&plan.mission));
    assert_eq!(bytes(&again.fence), bytes(&plan.fence));
    assert_eq!(bytes(&again.rally), bytes(&plan.rally));
    assert_eq!((&again.rooms, again.home), (&plan.rooms, plan.home));
}

#[test]
fn what_is_made_of_steps_is_read_back_within_the_protocol_s_centimetre() {
    let bench = Bench::default();
    let items = PlanFile::parse(&made().to_json()).unwrap().mission;
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
    let v: Value = serde_json::from_str(&made().to_json()).unwrap();
    assert_eq!(
        (&v["version"], &v["mission"]["version"]),
        (&json!(1), &json!(2))
    );
    let items = &v["mission"]["items"];
    assert_eq!(items[4]["params"][0], json!(3.0), "an id, not a number");
    assert_eq!(items[2]["AltitudeMode"], json!(1));
    assert_eq!(v["geoFence"]["polygons"][0]["inclusion"], json!(false));
    assert_eq!(v["geoFence"]["polygons"].as_array().map(Vec::len), Some(1));
    assert_eq!(v["rallyPoints"]["points"], json!([]));
    assert_eq!(v["kestrel"]["rooms"][0]["name"], json!("lab"));
}

#[test]
fn way_point_files_are_read_and_wrong_lines_named() {
    let text = "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47.3977\t8.5456\t0\t1\n1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t1.5\t1\n";
    let plan = PlanFile::parse(text).unwrap();
    assert_eq!(plan.mission.len(), 2);
    assert_eq!(plan.mission[0].x, 473_977_000);
    let wrong = PlanFile::parse("QGC WPL 110\n1 2 3\n").unwrap_err();
    assert!(wrong.to_string().contains("line 2"), "{wrong}");
}

#[test]
fn what_is_not_understood_is_named() {
    let said = |text: &str| PlanFile::parse(text).unwrap_err().to_string();
    assert!(said("{").contains("not a plan file"));
    assert!(said(r#"{"fileType": "Parameters"}"#).contains("fileType"));
    let survey = r#"{"fileType": "Plan", "mission": {"items": [{"type": "ComplexItem", "complexItemType": "survey"}]}}"#;
    assert!(said(survey).contains("item 0 is a survey"));
    let short = r#"{"fileType": "Plan", "mission": {"items": [{"type": "SimpleItem", "command": 16, "frame": 3, "params": [1]}]}}"#;
    assert!(said(short).contains("item 0 has no seven params"));
}
