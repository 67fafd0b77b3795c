//! Every item that a mission may hold, one mission each: what it does is judged by the truth.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::gcs::convert::GeoAnchor;
use bridge::gcs::params::GroundParams;
use bridge::io::truth::Row;
use bridge::station::{return_home, take_off, waypoint};
use flight_tests::{Flight, Scenario, modes};
use mavlink_dialect::raw::MISSION_ITEM_INT_DATA as Item;
use vehicle::In;
use vehicle::angle::wrap_pi;

/// A place in the lab with a metre of room around it, NED about home.
const THERE: [f64; 2] = [1.1, -0.9];
/// Another.
const ELSEWHERE: [f64; 2] = [-0.6, 0.9];
/// How near the plan is flown, m.
const NEAR_M: f64 = 0.10;

/// An item that is nowhere.
fn order(command: u16, params: [f32; 4]) -> Item {
    Item {
        frame: 2,
        command,
        autocontinue: 1,
        param1: params[0],
        param2: params[1],
        param3: params[2],
        param4: params[3],
        ..Default::default()
    }
}

/// A waypoint that is held, so that it is flown to and not past.
fn held(at: [f64; 2], seconds: f32) -> Item {
    Item {
        param1: seconds,
        ..waypoint(at[0], at[1], -1.0, None)
    }
}

/// Flies a mission: take-off, the items, and home; returns when down.
fn fly(name: &str, items: Vec<Item>) -> Flight {
    let mut f = begin(items);
    f.until_down(180.0);
    f.assert(
        f.truth().contacts == 0,
        &format!("{name}: touched something"),
    );
    f
}

/// The same up to the start.
fn begin(items: Vec<Item>) -> Flight {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let mut all = vec![take_off(1.0)];
    all.extend(items);
    all.push(return_home());
    let result = f.upload(all);
    f.assert(result == 0, &format!("the mission was refused: {result}"));
    f.arm();
    let result = f.set_mode(modes::MISSION);
    f.assert(result == 0, &format!("mode Mission was refused: {result}"));
    f
}

fn off(r: &Row, at: [f64; 2]) -> f64 {
    (r.position[0] - at[0]).hypot(r.position[1] - at[1])
}

/// Longest time without a break within a distance of a place, s.
fn stayed_s(f: &Flight, at: [f64; 2], within_m: f64) -> f64 {
    let mut longest = 0.0_f64;
    let mut since: Option<f64> = None;
    for r in &f.rows {
        if off(r, at) <= within_m && r.position[2] < -0.3 {
            longest = longest.max(r.t_s - *since.get_or_insert(r.t_s));
        } else {
            since = None;
        }
    }
    longest
}

fn say(name: &str, figures: &str) {
    println!("ITEM {name:22} {figures}");
}

#[test]
fn waypoints_are_passed_held_and_faced() {
    let east = 90_f64.to_radians();
    let f = fly(
        "16 hold",
        vec![
            Item {
                param1: 4.0,
                ..waypoint(THERE[0], THERE[1], -1.2, Some(east))
            },
            waypoint(ELSEWHERE[0], ELSEWHERE[1], -1.0, None),
        ],
    );
    let passes = [THERE, ELSEWHERE].map(|p| f.nearest_pass(p[0], p[1]));
    let held_s = stayed_s(&f, THERE, 0.2);
    let there: Vec<&Row> = f.rows.iter().filter(|r| off(r, THERE) < 0.12).collect();
    let faced = there
        .iter()
        .map(|r| wrap_pi(r.yaw_rad - east).abs().to_degrees())
        .fold(f64::INFINITY, f64::min);
    let height_m = there.iter().map(|r| -r.position[2]).fold(0.0, f64::max);
    say(
        "16 WAYPOINT",
        &format!(
            "passed at {:.2} {:.2} m, held {held_s:.1} s, faced within {faced:.0} deg",
            passes[0], passes[1]
        ),
    );
    f.assert(passes[0] <= NEAR_M, "the held waypoint was missed");
    // Passed without a stop: the acceptance radius and the error of the estimate.
    f.assert(passes[1] <= 0.15, "the passed waypoint was missed");
    f.assert(held_s >= 4.0 && faced < 10.0, "not held or not faced");
    f.assert((height_m - 1.2).abs() < 0.15, "not at its height");
}

#[test]
fn take_off_climbs_to_its_height_and_return_lands_at_home() {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    assert_eq!(
        f.upload(vec![take_off(1.6), held(THERE, 1.0), return_home()]),
        0
    );
    f.arm();
    assert_eq!(f.set_mode(modes::MISSION), 0);
    f.until("the height of the take-off", 30.0, |f| {
        f.station.heard().reached.contains(&0)
    });
    let height_m = -f.truth().position.z();
    let aside_m = f.truth().position.norm_xy();
    f.until_down(120.0);
    let landing_m = f.truth().position.norm_xy();
    say(
        "22 TAKEOFF",
        &format!("{height_m:.2} m of 1.60 m, {aside_m:.2} m aside"),
    );
    say(
        "20 RETURN_TO_LAUNCH",
        &format!("landed {landing_m:.2} m from home"),
    );
    f.assert((height_m - 1.6).abs() < 0.2 && aside_m < 0.25, "not up");
    f.assert(landing_m <= 0.15, "not at home");
    assert_eq!(f.station.heard().reached, [0, 1, 2]);
}

#[test]
fn land_comes_down_at_its_place() {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let land = Item {
        command: 21,
        ..waypoint(THERE[0], THERE[1], 0.0, None)
    };
    assert_eq!(f.upload(vec![take_off(1.0), held(ELSEWHERE, 0.0), land]), 0);
    f.arm();
    assert_eq!(f.set_mode(modes::MISSION), 0);
    f.until("under way", 20.0, |f| f.truth().position.z() < -0.5);
    f.until_down(90.0);
    let p = f.truth().position;
    let landing_m = (p.x() - THERE[0]).hypot(p.y() - THERE[1]);
    say("21 LAND", &format!("{landing_m:.2} m from its place"));
    f.assert(landing_m <= 0.15 && f.truth().contacts == 0, "not there");
}

#[test]
fn loiters_and_delays_last_as_long_as_they_say() {
    let loiter = Item {
        command: 19,
        param1: 6.0,
        ..waypoint(THERE[0], THERE[1], -1.0, None)
    };
    let f = fly("19", vec![loiter]);
    let loitered_s = stayed_s(&f, THERE, 0.2);
    say("19 LOITER_TIME", &format!("{loitered_s:.1} s of 6 s"));
    f.assert((6.0..10.0).contains(&loitered_s), "not as long as said");

    for (command, name) in [(93, "93 DELAY"), (112, "112 CONDITION_DELAY")] {
        let without = fly(name, vec![waypoint(THERE[0], THERE[1], -1.0, None)]);
        let with = fly(
            name,
            vec![
                waypoint(THERE[0], THERE[1], -1.0, None),
                order(command, [5.0, 0.0, 0.0, 0.0]),
            ],
        );
        let [a, b] = [&without, &with].map(|f| stayed_s(f, THERE, 0.2));
        say(name, &format!("{:.1} s more of 5 s", b - a));
        with.assert((4.0..8.0).contains(&(b - a)), "not as long as said");
        assert_eq!(with.station.heard().reached, [0, 1, 2, 3]);
    }
}

#[test]
fn an_unlimited_loiter_stays_until_it_is_told_to_go_on() {
    let mut f = begin(vec![
        Item {
            command: 17,
            ..waypoint(THERE[0], THERE[1], -1.0, None)
        },
        held(ELSEWHERE, 1.0),
    ]);
    f.until("it is there", 60.0, |f| {
        (f.truth().position - In::new(THERE[0], THERE[1], -1.0)).norm() < 0.2
    });
    f.wait_s(20.0);
    let stays_m = (f.truth().position - In::new(THERE[0], THERE[1], -1.0)).norm_xy();
    f.assert(stays_m < 0.2, "it did not stay");
    f.assert(
        !f.station.heard().reached.contains(&1),
        "it went on by itself",
    );
    // DO_SET_MISSION_CURRENT.
    assert_eq!(f.command(224, [2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 0);
    f.until_down(120.0);
    let pass_m = f.nearest_pass(ELSEWHERE[0], ELSEWHERE[1]);
    say(
        "17 LOITER_UNLIM",
        &format!("20 s within {stays_m:.2} m, then on to {pass_m:.2} m"),
    );
    f.assert(pass_m <= NEAR_M, "it did not go on");
}

#[test]
fn condition_yaw_turns_where_it_says_and_the_way_round_it_says() {
    let f = fly(
        "115",
        vec![
            held(THERE, 1.0),
            order(115, [120.0, 0.0, 0.0, 0.0]),
            order(93, [1.0, 0.0, 0.0, 0.0]),
            // Back by 90 degrees counter-clockwise.
            order(115, [90.0, 0.0, -1.0, 1.0]),
            order(93, [1.0, 0.0, 0.0, 0.0]),
        ],
    );
    let faced = |deg: f64| {
        f.rows
            .iter()
            .filter(|r| off(r, THERE) < 0.25)
            .map(|r| wrap_pi(r.yaw_rad - deg.to_radians()).abs().to_degrees())
            .fold(f64::INFINITY, f64::min)
    };
    let (first, second) = (faced(120.0), faced(30.0));
    say(
        "115 CONDITION_YAW",
        &format!("within {first:.0} and {second:.0} deg"),
    );
    f.assert(first < 10.0 && second < 10.0, "not turned");
}

#[test]
fn change_speed_holds_from_there_on() {
    let f = fly(
        "178",
        vec![
            held(THERE, 1.0),
            order(178, [1.0, 0.3, -1.0, 0.0]),
            held(ELSEWHERE, 1.0),
        ],
    );
    // The row at which item 2 was reached is not kept; the second leg begins when the first place is left.
    let near = |r: &Row| off(r, THERE) < 0.12;
    let there = f.rows.iter().position(near).unwrap();
    let to = f
        .rows
        .iter()
        .rposition(|r| off(r, ELSEWHERE) < 0.2)
        .unwrap();
    let from = f.rows[..to].iter().rposition(near).unwrap();
    let speeds = |rows: &[Row]| {
        rows.windows(25)
            .map(|w| off(&w[24], [w[0].position[0], w[0].position[1]]) / (w[24].t_s - w[0].t_s))
            .fold(0.0, f64::max)
    };
    let (before, after) = (speeds(&f.rows[..there]), speeds(&f.rows[from..to]));
    say(
        "178 CHANGE_SPEED",
        &format!("{before:.2} m/s before, {after:.2} m/s after, asked 0.30"),
    );
    f.assert(before > 0.5 && after < 0.34, "the speed did not change");
}

#[test]
fn a_jump_flies_its_round_as_often_as_it_says() {
    let f = fly(
        "177",
        vec![
            waypoint(THERE[0], THERE[1], -1.0, None),
            waypoint(ELSEWHERE[0], ELSEWHERE[1], -1.0, None),
            order(177, [1.0, 2.0, 0.0, 0.0]),
        ],
    );
    let mut visits = 0;
    let mut is_near = false;
    for r in f.rows.iter().filter(|r| r.position[2] < -0.5) {
        let near = off(r, THERE) < if is_near { 0.5 } else { 0.2 };
        visits += u32::from(near && !is_near);
        is_near = near;
    }
    say("177 DO_JUMP", &format!("{visits} visits of 3"));
    assert_eq!(visits, 3);
    assert_eq!(f.station.heard().reached, [0, 1, 2, 3, 1, 2, 3, 1, 2, 3, 4]);
}

#[test]
fn cameras_gimbals_and_regions_of_interest_are_taken_and_disturb_nothing() {
    let commands = [
        201, 195, 197, 530, 2000, 2001, 2500, 2501, 203, 206, 1000, 1001,
    ];
    let plain = fly("plain", vec![held(THERE, 1.0), held(ELSEWHERE, 1.0)]);
    let mut items = vec![held(THERE, 1.0)];
    items.extend(commands.map(|command| order(command, [f32::NAN; 4])));
    items.push(held(ELSEWHERE, 1.0));
    let with = fly("with", items);
    let [a, b] = [&plain, &with].map(|f| f.now().s());
    say(
        "12 camera and ROI",
        &format!("{:.1} s longer, all reached in order", b - a),
    );
    with.assert((b - a).abs() < 3.0, "they cost time");
    let all: Vec<u16> = (0..commands.len() as u16 + 4).collect();
    assert_eq!(with.station.heard().reached, all);
}

#[test]
fn the_same_place_is_flown_to_in_every_frame() {
    let geo = GeoAnchor::from_params(&GroundParams::default());
    let there = geo.to_global(In::new(THERE[0], THERE[1], -1.0));
    for frame in [0u8, 3, 5, 6] {
        let item = Item {
            frame,
            x: there.lat_e7,
            y: there.lon_e7,
            z: 1.0,
            ..held(THERE, 1.0)
        };
        let f = fly("frames", vec![item]);
        let pass_m = f.nearest_pass(THERE[0], THERE[1]);
        say(
            &format!("frame {frame}"),
            &format!("passed at {pass_m:.2} m"),
        );
        f.assert(pass_m <= NEAR_M, "another place");
    }
}

#[test]
fn what_cannot_be_flown_is_refused_with_item_and_reason() {
    let mut f = Scenario::office().start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let cases: [(&str, Item, u8, &str); 7] = [
        (
            "82 SPLINE",
            Item {
                command: 82,
                ..held(THERE, 0.0)
            },
            3,
            "item 1: command 82",
        ),
        (
            "a way through no door",
            waypoint(60.0, 0.0, -1.0, None),
            10,
            "item 1: the place is outside",
        ),
        (
            "in a wall",
            waypoint(0.0, 2.85, -1.0, None),
            10,
            "item 1: the place is",
        ),
        (
            "no number",
            waypoint(0.5, 0.5, f64::NAN, None),
            12,
            "item 1: parameter 7",
        ),
        (
            "too high",
            waypoint(0.5, 0.5, -9.0, None),
            12,
            "item 1: height 9.00 m",
        ),
        (
            "a jump to nowhere",
            order(177, [9.0, 1.0, 0.0, 0.0]),
            6,
            "item 1: parameter 1",
        ),
        (
            "a frame of terrain",
            Item {
                frame: 10,
                ..held(THERE, 0.0)
            },
            2,
            "item 1: frame 10",
        ),
    ];
    for (name, item, expected, words) in cases {
        let heard = f.station.heard().texts.len();
        let result = f.upload(vec![take_off(1.0), item, return_home()]);
        // Until the last repeat of the answer has come.
        f.wait_s(1.2);
        // Long texts come in pieces.
        let text = f.station.heard().texts[heard..].concat();
        say(name, &format!("{result}: {text}"));
        f.assert(
            result == expected,
            &format!("{name}: {result} instead of {expected}"),
        );
        f.assert(text.contains(words), &format!("{name}: says `{text}`"));
    }
}
