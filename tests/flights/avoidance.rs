//! Avoidance in the whole stack, judged by truth: rooms of which the floor plan tells only a part.
//!
//! A few seeds of each by default, twenty with `KESTREL_FULL=1`, one with `KESTREL_SEED=N`.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::station::{take_off, waypoint};
use flight_tests::{Flight, Scenario, modes, places};
use planner::VfhParams;
use planner::vfh::steering::{reaction_s, stopping_speed};
use sim::Room;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, MapPose, RingConfig, Segment};

/// Hull of the vehicle, m.
const RADIUS_M: f64 = 0.16;
/// The hall: from 0 to here, m.
const HALL: [f64; 2] = [10.0, 6.0];
/// Where it starts, looking along x.
const START: [f64; 2] = [1.5, 3.0];

fn seeds(few: u64) -> std::ops::RangeInclusive<u64> {
    if let Some(seed) = std::env::var("KESTREL_SEED")
        .ok()
        .and_then(|s| s.parse().ok())
    {
        return seed..=seed;
    }
    let full = std::env::var_os("KESTREL_FULL").is_some_and(|v| v == "1");
    1..=if full { 20 } else { few }
}

/// A floor plan of the hall with boxes (from, to) in it; home at the start, north up on paper.
fn plan(boxes: &[[[f64; 2]; 2]]) -> FloorPlan {
    let cell_m = 0.05;
    let (w, h) = (
        (HALL[0] / cell_m) as usize + 4,
        (HALL[1] / cell_m) as usize + 4,
    );
    // Two cells of wall around; a pillar in a corner so that no two corners look alike.
    let pillar = [[8.8, 0.0], [10.0, 0.5]];
    let cells = (0..w * h)
        .map(|i| {
            let p = [i % w, i / w].map(|k| (k as f64 - 1.5) * cell_m);
            let inside =
                |b: &[[f64; 2]; 2]| (0..2).all(|axis| (b[0][axis]..=b[1][axis]).contains(&p[axis]));
            let is_floor = (0..2).all(|axis| (0.0..HALL[axis]).contains(&p[axis]));
            if is_floor && !inside(&pillar) && !boxes.iter().any(inside) {
                Cell::Free
            } else {
                Cell::Occupied
            }
        })
        .collect();
    let mut plan = FloorPlan::from_cells(w, cell_m, [-2.0 * cell_m; 2], cells).unwrap();
    plan.home = Some(MapPose::new(START[0], START[1], 0.0));
    plan.north_rad = std::f64::consts::FRAC_PI_2;
    plan
}

fn hall(boxes: &[[[f64; 2]; 2]]) -> Room {
    Room::from_plan("hall", plan(boxes))
}

fn outline(from: [f64; 2], to: [f64; 2]) -> [Segment; 4] {
    let corners = [from, [to[0], from[1]], to, [from[0], to[1]]];
    [0, 1, 2, 3].map(|i| Segment {
        a: corners[i],
        b: corners[(i + 1) % 4],
    })
}

/// Plan to north, east about home.
fn ned([x, y]: [f64; 2]) -> [f64; 2] {
    [y - START[1], x - START[0]]
}

/// The way it really flew, on the plan.
fn track(f: &Flight) -> Vec<[f64; 2]> {
    let flying = f.rows.iter().filter(|r| r.position[2] < -0.5);
    flying
        .map(|r| [r.position[1] + START[0], r.position[0] + START[1]])
        .collect()
}

/// Takes off and flies to a place on the plan; true if it came there.
fn fly_to(scenario: Scenario, goal: [f64; 2], limit_s: f64) -> (Flight, bool) {
    let mut f = scenario.start();
    f.until("armable", 20.0, |f| f.station.heard().is_armable);
    let [north, east] = ned(goal);
    let result = f.upload(vec![take_off(1.0), waypoint(north, east, -1.0, None)]);
    f.assert(result == 0, &format!("the mission was refused: {result}"));
    f.arm();
    let result = f.set_mode(modes::MISSION);
    f.assert(result == 0, &format!("mode Mission was refused: {result}"));
    let has_arrived = f
        .try_until(limit_s, |f| {
            let p = f.truth().position;
            p.z() < -0.5 && (p.x() - north).hypot(p.y() - east) < 0.35
        })
        .is_ok();
    f.wait_s(2.0);
    (f, has_arrived)
}

/// Every ring over every seed; what `judge` says of a flight is printed and must hold.
fn campaign(
    name: &str,
    rings: &[&str],
    few: u64,
    limit_s: f64,
    goal: [f64; 2],
    room: impl Fn(&str) -> Room,
    judge: impl Fn(&Flight) -> (String, bool),
) {
    println!("FIGURES avoidance, {name}");
    let mut bad = 0;
    for ring in rings {
        for seed in seeds(few) {
            let scenario = Scenario::in_room(room(ring)).ring(ring).seed(seed);
            let (f, has_arrived) = fly_to(scenario, goal, limit_s);
            let contacts = f.truth().contacts;
            let (said, is_good) = judge(&f);
            let outcome = if has_arrived {
                String::new()
            } else {
                let texts = &f.station.heard().texts;
                format!(", NOT THERE: {}", texts.join("; "))
            };
            println!(
                " {ring:<7} seed {seed:2}: {contacts} contacts, {:.1} s{said}{outcome}",
                f.now().s()
            );
            bad += u32::from(contacts > 0 || !is_good || !has_arrived);
        }
    }
    println!("END");
    assert_eq!(bad, 0, "{name}");
}

const BOTH: [&str; 2] = ["tof32", "sonar8"];

fn nothing_more(_: &Flight) -> (String, bool) {
    (String::new(), true)
}

#[test]
fn through_a_door_of_90_centimetres() {
    let wall = [[[5.0, 0.0], [5.1, 3.55]], [[5.0, 4.45], [5.1, 6.0]]];
    campaign(
        "door 0.9 m",
        &BOTH,
        2,
        90.0,
        [8.0, 3.0],
        |_| hall(&wall),
        nothing_more,
    );
}

#[test]
fn through_a_corridor_of_120_centimetres_without_swinging() {
    let walls = [[[3.0, 0.0], [8.0, 2.4]], [[3.0, 3.6], [8.0, 6.0]]];
    campaign(
        "corridor 1.2 m",
        &BOTH,
        2,
        90.0,
        [9.0, 3.0],
        |_| hall(&walls),
        |f| {
            let inside: Vec<f64> = track(f)
                .iter()
                .filter(|p| (3.2..7.8).contains(&p[0]))
                .map(|p| p[1])
                .collect();
            let n = inside.len() as f64;
            let mean = inside.iter().sum::<f64>() / n;
            let std = (inside.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / n).sqrt();
            (format!(", lateral std {std:.3} m"), std <= 0.08)
        },
    );
}

/// The plan shows a recess of 3 m with a way out at its end; in truth that is shut. Open on the side of the start.
#[test]
fn out_of_a_dead_end_of_3_metres_that_the_plan_shows_open() {
    let recess = [
        [[3.0, 1.9], [6.1, 2.0]],
        [[3.0, 4.0], [6.1, 4.1]],
        [[6.0, 2.0], [6.1, 2.5]],
        [[6.0, 3.5], [6.1, 4.0]],
    ];
    let shut = outline([6.0, 2.5], [6.1, 3.5]);
    campaign(
        "dead end 3 m",
        &BOTH,
        2,
        180.0,
        [8.0, 3.0],
        |_| hall(&recess).with_unmapped(&shut),
        nothing_more,
    );
}

/// The same recess on no plan at all: nothing of what the rangers see in there is what localization knows. What odometry carries on
/// is believed meanwhile.
#[test]
fn out_of_a_dead_end_of_3_metres_that_no_plan_shows() {
    let walls = [
        outline([3.0, 1.9], [6.1, 2.0]),
        outline([3.0, 4.0], [6.1, 4.1]),
        outline([6.0, 2.0], [6.1, 4.0]),
    ]
    .concat();
    campaign(
        "dead end 3 m that no plan shows",
        &BOTH,
        1,
        90.0,
        [8.0, 3.0],
        |_| hall(&[]).with_unmapped(&walls),
        |f| {
            let off_m = f.rows.iter().map(|r| {
                let (e, t) = (r.est_position, r.position);
                (e[0] - t[0]).hypot(e[1] - t[1])
            });
            let worst_m = off_m.fold(0.0, f64::max);
            (format!(", estimate at most {worst_m:.2} m off"), true)
        },
    );
}

/// Both as near, both as wide: it takes one and keeps to it. (On no plan: the course `two-gaps` of `eval avoid --compare`.)
#[test]
fn through_one_of_two_equal_gaps() {
    let wall = [
        [[5.0, 0.0], [5.1, 1.25]],
        [[5.0, 2.15], [5.1, 3.85]],
        [[5.0, 4.75], [5.1, 6.0]],
    ];
    campaign(
        "two equal gaps",
        &BOTH,
        2,
        120.0,
        [8.0, 3.0],
        |_| hall(&wall),
        nothing_more,
    );
}

#[test]
fn around_a_pane_of_glass_at_45_degrees() {
    let pane = Segment {
        a: [4.2, 2.2],
        b: [5.8, 3.8],
    };
    // Cells of the pane: for who cannot see it.
    let steps: Vec<[[f64; 2]; 2]> = (0..=32)
        .map(|k| {
            let p = [4.2 + 0.05 * f64::from(k), 2.2 + 0.05 * f64::from(k)];
            [p.map(|v| v - 0.026), p.map(|v| v + 0.026)]
        })
        .collect();
    campaign(
        "glass at 45 degrees, on the plan for tof32 only",
        &BOTH,
        2,
        120.0,
        [8.0, 3.0],
        |ring| {
            let room = hall(&[]).with_glass(&[pane]);
            if ring == "tof32" {
                room.shown_as(plan(&steps))
            } else {
                room
            }
        },
        nothing_more,
    );
}

/// What the law allows a ring when something may appear this far ahead of the centre.
fn speed_for(ring: &str, free_m: f64) -> f64 {
    let vfh = VfhParams::default();
    let rangers = RingConfig::built_in(ring).unwrap().rangers;
    let period_s = 1.0 / rangers[0].rate_hz;
    stopping_speed(
        vfh.brake_mps2,
        reaction_s(vfh.latency_s, period_s),
        free_m - RADIUS_M - 0.05,
    )
}

#[test]
fn stops_for_what_appears_80_centimetres_ahead_at_the_speed_the_law_allows() {
    println!("FIGURES avoidance, obstacle appearing 0.8 m ahead");
    // A wide passage: where walls are near, the speed of the law is flown.
    let walls = [[[0.0, 0.0], [10.0, 1.6]], [[0.0, 4.4], [10.0, 6.0]]];
    let mut touched = 0;
    for ring in BOTH {
        let cruise = speed_for(ring, 0.8);
        for seed in seeds(2) {
            let mut f = Scenario::in_room(hall(&walls))
                .ring(ring)
                .seed(seed)
                .param("MPC_XY_CRUISE", &format!("{cruise:.2}"))
                .start();
            f.until("armable", 20.0, |f| f.station.heard().is_armable);
            let [north, east] = ned([8.0, 3.0]);
            assert_eq!(
                f.upload(vec![take_off(1.0), waypoint(north, east, -1.0, None)]),
                0
            );
            f.arm();
            assert_eq!(f.set_mode(modes::MISSION), 0);
            f.until("under way", 60.0, |f| {
                f.truth().position.y() > 2.5 + 0.05 * seed as f64
            });
            let (p, speed) = (f.truth().position, f.truth().velocity.norm_xy());
            let (x, y) = (p.y() + START[0] + 0.8, p.x() + START[1]);
            f.world
                .simulator
                .raise(&outline([x, y - 0.3], [x + 0.3, y + 0.3]));
            let mut nearest_m = f64::INFINITY;
            for _ in 0..800 {
                f.step();
                let p = f.truth().position;
                let (px, py) = (p.y() + START[0], p.x() + START[1]);
                let off = [
                    (x - px).max(px - x - 0.3).max(0.0),
                    (y - 0.3 - py).max(py - y - 0.3).max(0.0),
                ];
                nearest_m = nearest_m.min(off[0].hypot(off[1]) - RADIUS_M);
            }
            println!(
                " {ring:<7} seed {seed:2}: allowed {cruise:.2} m/s, flew {speed:.2} m/s, came to {nearest_m:.2} m, {} contacts",
                f.truth().contacts
            );
            touched += f.truth().contacts;
        }
    }
    println!("END");
    assert_eq!(touched, 0);
}

/// SNSI's ring is blind behind: it turns before it flies.
#[test]
fn the_blind_rear_of_snsi6_is_never_flown_into() {
    println!("FIGURES avoidance, snsi6 in the office");
    let p = places("office");
    let tour = [p[0], p[1], p[2], p[0], [0.0, 0.0]];
    let mut bad = 0;
    for seed in seeds(2) {
        let mut f = Scenario::office().ring("snsi6").seed(seed).start();
        f.until("armable", 20.0, |f| f.station.heard().is_armable);
        let mut items = vec![take_off(1.0)];
        items.extend(tour.iter().map(|p| waypoint(p[0], p[1], -1.0, None)));
        let result = f.upload(items);
        f.assert(result == 0, &format!("refused: {result}"));
        f.arm();
        assert_eq!(f.set_mode(modes::MISSION), 0);
        let mut backwards_mps = 0.0_f64;
        let last = tour.len() as u16;
        f.until("the last place", 300.0, |f| {
            let t = f.truth();
            let yaw = t.attitude.yaw();
            let ahead = t.velocity.x() * yaw.cos() + t.velocity.y() * yaw.sin();
            if f.snapshot().mode.mode == bridge::autopilot::mode::Mode::Mission {
                backwards_mps = backwards_mps.max(-ahead);
            }
            f.station.heard().reached.contains(&last)
        });
        let contacts = f.truth().contacts;
        println!(
            " seed {seed:2}: {contacts} contacts, {:.0} s, at most {backwards_mps:.2} m/s backwards",
            f.now().s()
        );
        bad += contacts;
    }
    println!("END");
    assert_eq!(bad, 0);
}
