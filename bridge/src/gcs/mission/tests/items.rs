//! What an item may be: places, frames, home.

use super::*;

#[test]
fn items_in_a_wall_off_the_plan_or_through_the_ceiling_are_refused_with_the_reason() {
    let mut v = Vehicle::new(Some(room()));
    assert_eq!(
        v.upload(A, &[waypoint(0, 1.0, 1.0), waypoint(1, -4.0, 4.0)]),
        0
    );
    for (item, result, reason) in [
        (
            waypoint(1, 4.85, 0.0),
            mission_result::INVALID_PARAM5_X,
            "from a wall",
        ),
        (
            waypoint(1, 60.0, 0.0),
            mission_result::INVALID_PARAM5_X,
            "outside the floor plan",
        ),
        (
            MissionItem {
                z: -9.0,
                ..waypoint(1, 1.0, 1.0)
            },
            mission_result::INVALID_PARAM7,
            "height 9.00 m",
        ),
    ] {
        assert_eq!(v.upload(A, &[waypoint(0, 1.0, 1.0), item]), result);
        let said = v.out.said();
        assert!(
            said.iter()
                .any(|(_, t)| t.contains("item 1") && t.contains(reason)),
            "{said:?}"
        );
        assert_eq!(v.service.items().len(), 2);
    }
}

#[test]
fn frames_give_the_same_place() {
    let v = Vehicle::new(None);
    let ctx = v.bench.ctx();
    let geo = crate::gcs::convert::GeoAnchor::from_params(&ctx.settings.ground);
    let p = geo.to_global(vehicle::In::new(1.0, 2.0, -1.0));
    let local = plan::plan_item(&waypoint(0, 1.0, 2.0), &ctx);
    let Ok(planner::mission::PlanItem::Waypoint {
        position,
        yaw_rad: None,
        ..
    }) = local
    else {
        panic!("{local:?}")
    };
    for frame in [0, 3, 5, 6] {
        let item = MissionItem {
            frame,
            x: p.lat_e7,
            y: p.lon_e7,
            z: 1.0,
            ..waypoint(0, 0.0, 0.0)
        };
        match plan::plan_item(&item, &ctx) {
            Ok(planner::mission::PlanItem::Waypoint { position: same, .. }) => {
                assert!((same - position).norm() < 0.01, "frame {frame}: {same:?}");
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_home_item_of_an_ardupilot_file_is_skipped_and_a_real_first_item_is_not() {
    let mut v = Vehicle::new(None);
    let (lat, lon) = (
        v.bench.settings.ground.lat0_e7,
        v.bench.settings.ground.lon0_e7,
    );
    let home = MissionItem {
        frame: 0,
        x: lat,
        y: lon,
        z: 0.0,
        ..waypoint(0, 0.0, 0.0)
    };
    v.upload(A, &[home, waypoint(1, 1.0, 1.0)]);
    assert_eq!(v.plans[0].items[0], planner::mission::PlanItem::Skip);
    v.upload(
        A,
        &[
            MissionItem {
                frame: 3,
                z: 1.0,
                ..home
            },
            waypoint(1, 1.0, 1.0),
        ],
    );
    assert_ne!(v.plans[1].items[0], planner::mission::PlanItem::Skip);
    assert_eq!(
        bytes(&v.service.items()[1..]),
        bytes(&[waypoint(1, 1.0, 1.0)])
    );
}
