//! Fences, no-fly zones, rally points, a blocked way home: judged by the truth.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::mode::Mode;
use bridge::station::{return_home, take_off, waypoint};
use flight_tests::{Flight, Scenario, modes};
use mavlink_dialect::raw::{self, MISSION_ITEM_INT_DATA as Item};

const FENCE: u8 = 1;
const RALLY: u8 = 2;

/// A zone of the fence in the local frame.
fn polygon(command: u16, corners: &[[f64; 2]]) -> Vec<Item> {
    corners
        .iter()
        .map(|[n, e]| Item {
            command,
            param1: corners.len() as f32,
            ..waypoint(*n, *e, 0.0, None)
        })
        .collect()
}

fn circle(command: u16, at: [f64; 2], radius_m: f32) -> Item {
    Item {
        command,
        param1: radius_m,
        ..waypoint(at[0], at[1], 0.0, None)
    }
}

/// A go-to, NED about home; its MAV_RESULT.
fn go_to(f: &mut Flight, north_m: f64, east_m: f64) -> u8 {
    use bridge::gcs::convert::GeoAnchor;
    use bridge::gcs::params::GroundParams;
    let geo = GeoAnchor::from_params(&GroundParams::default());
    let [lat, lon] = geo.to_degrees(vehicle::In::new(north_m, east_m, -1.0));
    let params = [-1.0, 1.0, 0.0, f32::NAN, lat as f32, lon as f32, f32::NAN];
    f.reposition(params, (lat, lon))
}

fn says(f: &Flight, words: &str) -> bool {
    // Long texts come in pieces.
    f.station.heard().texts.concat().contains(words)
}

#[test]
fn a_goal_beyond_the_fence_is_refused_and_the_way_goes_round_what_is_fenced_off() {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    // The lab's middle, with a pillar between home and the north-east.
    let mut items = polygon(5001, &[[-1.6, -2.0], [1.7, -2.0], [1.7, 2.0], [-1.6, 2.0]]);
    items.push(circle(5004, [0.75, 0.75], 0.3));
    assert_eq!(f.upload_list(FENCE, items), 0);
    f.take_off(1.0);
    f.wait_s(2.0);
    assert_eq!(go_to(&mut f, 2.9, 2.0), 2, "beyond the fence");
    f.wait_s(0.3);
    f.assert(says(&f, "outside the fence"), "the reason is not said");
    assert_eq!(go_to(&mut f, 0.75, 0.75), 2, "in the pillar");
    assert_eq!(go_to(&mut f, 1.3, 1.3), 0);
    f.until("it is there", 40.0, |f| {
        (f.truth().position.x() - 1.3).hypot(f.truth().position.y() - 1.3) < 0.2
    });
    let nearest_m = f.nearest_pass(0.75, 0.75);
    let reach_m = f.rows.iter().map(|r| r.position[0]).fold(0.0, f64::max);
    println!(
        "FENCE go-to round a pillar: {nearest_m:.2} m from its middle (radius 0.30), north {reach_m:.2} of 1.70"
    );
    f.assert(nearest_m > 0.3 && reach_m < 1.7, "it left the fence");
    assert_eq!(f.station.heard().fence, Some((0, 0)), "FENCE_STATUS");
}

#[test]
fn a_goal_that_a_new_fence_cuts_off_is_dropped_at_full_speed() {
    for seed in 1..=3 {
        let mut f = Scenario::room("corridor").seed(seed).start();
        let places = flight_tests::places("corridor");
        let [n, e] = *places.last().unwrap();
        f.take_off(1.0);
        f.wait_s(1.0);
        // A wall of air across the way, a third of the way out.
        let far_m = n.hypot(e);
        let unit = [n / far_m, e / far_m];
        let limit_m = (0.4 * far_m).max(2.0);
        assert_eq!(go_to(&mut f, n, e), 0);
        f.wait_s(0.6);
        let side = |along: f64, across: f64| {
            [
                unit[0] * along - unit[1] * across,
                unit[1] * along + unit[0] * across,
            ]
        };
        let items = polygon(
            5001,
            &[
                side(-30.0, -30.0),
                side(-30.0, 30.0),
                side(limit_m, 30.0),
                side(limit_m, -30.0),
            ],
        );
        assert_eq!(f.upload_list(FENCE, items), 0);
        f.wait_s(15.0);
        let along_m = f
            .rows
            .iter()
            .map(|r| r.position[0] * unit[0] + r.position[1] * unit[1])
            .fold(0.0, f64::max);
        println!(
            "FENCE seed {seed}: goal at {far_m:.1} m, fence at {limit_m:.2} m, never beyond {along_m:.2} m"
        );
        f.assert(along_m < limit_m, "it flew through the fence");
        f.assert(f.truth().velocity.norm_xy() < 0.1, "it does not stand");
        f.assert(f.snapshot().mode.mode == Mode::Hold, "not in Hold");
        f.assert(
            says(&f, "Refused: that place is outside the fence"),
            "it is not said",
        );
    }
}

#[test]
fn a_fence_that_excludes_home_and_a_rally_point_in_a_wall_are_refused_with_the_item() {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let away = polygon(5001, &[[3.0, 0.0], [5.0, 0.0], [5.0, 2.0]]);
    assert_ne!(f.upload_list(FENCE, away), 0);
    f.wait_s(0.3);
    f.assert(
        says(&f, "Fence refused: item 0: home would be outside"),
        "no reason",
    );
    assert_ne!(f.upload_list(FENCE, vec![circle(5004, [0.1, 0.1], 0.5)]), 0);
    f.wait_s(0.3);
    f.assert(
        says(&f, "Fence refused: item 0: home would be in"),
        "no reason",
    );
    let rally = |n, e| Item {
        command: 5100,
        ..waypoint(n, e, -1.0, None)
    };
    assert_ne!(
        f.upload_list(RALLY, vec![rally(0.5, 0.5), rally(0.0, 2.85)]),
        0
    );
    f.wait_s(0.3);
    f.assert(
        says(&f, "Rally points refused: item 1: the place is"),
        "no reason",
    );
    // A mission out of the fence, with its item.
    let room = polygon(5001, &[[-1.6, -2.0], [1.7, -2.0], [1.7, 2.0], [-1.6, 2.0]]);
    assert_eq!(f.upload_list(FENCE, room), 0);
    let mission = vec![
        take_off(1.0),
        waypoint(1.0, 0.0, -1.0, None),
        waypoint(2.9, 2.0, -1.0, None),
    ];
    assert_eq!(f.upload(mission), 10);
    f.wait_s(0.3);
    f.assert(
        says(&f, "item 2: the place is outside the fence"),
        "no reason",
    );
}

#[test]
fn no_fly_zones_of_the_plan_are_flown_round_and_refused_as_goals() {
    // Plan metres: home is at 2.6, 2.05; the zone lies east of it, the goal behind it.
    let zone = [[3.1, 1.5], [3.6, 1.5], [3.6, 2.6], [3.1, 2.6]];
    let mut f = Scenario::office().no_fly(&zone).start();
    f.take_off(1.0);
    f.wait_s(2.0);
    assert_eq!(go_to(&mut f, 0.0, 0.75), 2, "in the zone");
    assert_eq!(go_to(&mut f, 0.0, 1.6), 0);
    f.until("it is there", 40.0, |f| {
        f.truth().position.x().hypot(f.truth().position.y() - 1.6) < 0.2
    });
    let is_in = |r: &bridge::io::truth::Row| {
        (0.5..=1.0).contains(&r.position[1]) && (-0.55..=0.55).contains(&r.position[0])
    };
    let inside = f.rows.iter().filter(|r| is_in(r)).count();
    println!(
        "FENCE no-fly zone of the plan: {inside} samples inside of {}",
        f.rows.len()
    );
    f.assert(inside == 0, "it flew over the zone");
}

/// Full stick to the right in Position mode for some seconds; the farthest east it came, m.
fn push_east(f: &mut Flight, seconds: f64) -> f64 {
    let stick = raw::MANUAL_CONTROL_DATA {
        target: 1,
        y: 1000,
        z: 500,
        ..Default::default()
    };
    f.station.send(&stick);
    f.wait_s(0.1);
    assert_eq!(f.set_mode(modes::POSITION), 0);
    let until_s = f.now().s() + seconds;
    while f.now().s() < until_s {
        f.station.send(&stick);
        f.wait_s(0.04);
    }
    f.rows.iter().map(|r| r.position[1]).fold(0.0, f64::max)
}

#[test]
fn full_stick_at_a_no_fly_zone_and_at_the_fence_stops_before_them() {
    let mut farthest_m = [0.0_f64; 2];
    for seed in 1..=5 {
        // Home is at 2.6, 2.05 heading north: the zone begins 1.2 m to the right.
        let zone = [[3.8, 0.9], [4.6, 0.9], [4.6, 3.2], [3.8, 3.2]];
        let mut f = Scenario::office().seed(seed).no_fly(&zone).start();
        f.take_off(1.0);
        f.wait_s(1.0);
        let east_m = push_east(&mut f, 6.0);
        f.assert(east_m > 0.4, &format!("only {east_m:.2} m"));
        // It may slide along the border and round the corner, and never in.
        let beside = f.rows.iter().filter(|r| r.position[0].abs() < 1.15);
        let east_m = beside.map(|r| r.position[1]).fold(0.0, f64::max);
        farthest_m[0] = farthest_m[0].max(east_m);
        f.assert(east_m < 1.2, &format!("{east_m:.2} m of 1.20 m"));

        let mut f = Scenario::office().seed(seed).start();
        f.until("armable", 20.0, |f| f.station.heard().is_armable);
        let fence = polygon(5001, &[[-1.5, -1.5], [1.5, -1.5], [1.5, 1.2], [-1.5, 1.2]]);
        assert_eq!(f.upload_list(FENCE, fence), 0);
        f.take_off(1.0);
        f.wait_s(1.0);
        let east_m = push_east(&mut f, 4.0);
        farthest_m[1] = farthest_m[1].max(east_m);
        f.assert(
            east_m > 0.4 && east_m < 1.2,
            &format!("{east_m:.2} m of 1.20 m"),
        );
        f.assert(says(&f, "Fence ahead: Hold"), "it is not said");
        let (outside, breaches) = f.station.heard().fence.unwrap();
        f.assert(outside == 0 && breaches >= 1, "FENCE_STATUS does not tell");
    }
    println!(
        "FENCE full stick, border at 1.20 m, 5 seeds: no-fly zone {:.2} m, fence {:.2} m",
        farthest_m[0], farthest_m[1]
    );
}

#[test]
fn return_takes_the_nearest_rally_point() {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let rally = |n, e| Item {
        command: 5100,
        ..waypoint(n, e, 0.0, None)
    };
    // In the workshop, and far away in the kitchen.
    assert_eq!(
        f.upload_list(RALLY, vec![rally(1.45, 7.2), rally(1.0, 3.8)]),
        0
    );
    f.take_off(1.0);
    f.wait_s(1.0);
    assert_eq!(go_to(&mut f, 1.2, 3.4), 0);
    f.until("in the workshop", 60.0, |f| {
        (f.truth().position.x() - 1.2).hypot(f.truth().position.y() - 3.4) < 0.3
    });
    assert_eq!(f.set_mode(modes::RETURN), 0);
    f.until_down(60.0);
    let p = f.truth().position;
    let off_m = (p.x() - 1.0).hypot(p.y() - 3.8);
    println!("RALLY landed {off_m:.2} m from the point");
    f.assert(off_m <= 0.15, "not at the rally point");
    f.assert(says(&f, "Return to rally point 2"), "it is not said");
}

#[test]
fn with_the_direct_way_home_blocked_it_returns_the_way_it_came() {
    for seed in 1..=3 {
        // A box in the door from the corridor to the lab that the plan does not show.
        let mut f = Scenario::office()
            .seed(seed)
            .unmapped([4.1, 4.25, 0.9])
            .start();
        f.until("armable", 20.0, |f| f.station.heard().is_armable);
        let ned = |x: f64, y: f64| waypoint(y - 2.05, x - 2.6, -1.0, None);
        let out = vec![
            take_off(1.0),
            ned(6.2, 3.3),
            ned(7.9, 4.95),
            ned(5.3, 4.95),
            return_home(),
        ];
        assert_eq!(f.upload(out), 0);
        f.arm();
        assert_eq!(f.set_mode(modes::MISSION), 0);
        f.until("under way", 20.0, |f| f.truth().position.z() < -0.5);
        f.until_down(240.0);
        let landing_m = f.truth().position.norm_xy();
        println!(
            "RETURN seed {seed}: direct door blocked, landed {landing_m:.2} m from home after {:.0} s, contacts {}",
            f.now().s(),
            f.truth().contacts
        );
        f.assert(f.truth().contacts == 0, "touched the box");
        f.assert(landing_m <= 0.15, "not at home");
    }
}

#[test]
fn a_mission_stops_for_the_battery_and_resumes_with_a_new_one() {
    let mut f = Scenario::office()
        .param("BAT_LOW_THR", "18")
        .param("KST_BAT_RESERVE", "0")
        .start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let mut items = vec![take_off(1.0)];
    for _ in 0..6 {
        items.push(waypoint(1.1, -0.9, -1.0, None));
        items.push(waypoint(-0.6, 0.9, -1.0, None));
    }
    items.push(return_home());
    assert_eq!(f.upload(items), 0);
    f.arm();
    assert_eq!(f.set_mode(modes::MISSION), 0);
    f.until("some items", 120.0, |f| {
        f.station.heard().reached.len() >= 4
    });
    f.world.simulator.set_charge(0, 0.15);
    f.until("the battery is low", 20.0, |f| {
        f.snapshot().mode.mode == Mode::Return
    });
    f.until_down(60.0);
    let reached = f.station.heard().reached.len();
    f.assert(
        (2..11).contains(&reached),
        &format!("{reached} items before the stop"),
    );
    f.assert(
        says(&f, "for the battery"),
        "it is not said where it stopped",
    );
    f.world.simulator.set_charge(0, 1.0);
    f.wait_s(3.0);
    f.arm();
    assert_eq!(f.set_mode(modes::MISSION), 0);
    f.until("under way again", 20.0, |f| f.truth().position.z() < -0.5);
    f.until_down(180.0);
    let all: Vec<u16> = (0..14).collect();
    println!(
        "BATTERY stopped after {reached} items, resumed, all {} reached in order",
        all.len()
    );
    assert_eq!(f.station.heard().reached, all);
}

#[test]
fn the_reserve_rule_turns_back_in_time_and_the_time_left_is_told() {
    let mut f = Scenario::office()
        .param("BAT_LOW_THR", "0")
        .param("BAT1_CAPACITY", "1500")
        .param("KST_BAT_RESERVE", "580")
        .start();
    f.take_off(1.0);
    f.world.simulator.set_charge(0, 0.75);
    f.wait_s(5.0);
    let told_s = f.station.heard().battery_left_s;
    let b = f.snapshot().battery.unwrap();
    let true_s = b.remaining.unwrap() * 1500.0 * 3.6 / b.current_a;
    f.assert(
        (f64::from(told_s) / true_s - 1.0).abs() < 0.25,
        &format!("told {told_s} s, {true_s:.0} s at the current of now"),
    );
    assert_eq!(go_to(&mut f, 2.9, 2.0), 0);
    f.until("it turns back", 120.0, |f| {
        f.snapshot().mode.mode == Mode::Return
    });
    let s = f.snapshot();
    let (left_s, way_m) = (s.endurance_s.unwrap(), s.way_home_m.unwrap());
    println!(
        "BATTERY told {told_s} s of {true_s:.0} s; turned back with {left_s:.0} s left, {way_m:.1} m from home, reserve 580 s"
    );
    f.assert((570.0..640.0).contains(&left_s), "too early or too late");
    f.assert(says(&f, "just enough for the way home"), "it is not said");
}
