//! Flights of the navigator in a flat world of its own: doors, dead ends, people, manual flight.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]

mod world;

use planner::{Goal, SteeringState};
use vehicle::In;
use world::{Person, World};

/// Three rooms in a row, doors of 0.9 m; a letter is 0.3 m.
const ROOMS: &str = "
    ##############################
    #.........#........#.........#
    #.........#........#.........#
    #..S......#........#.........#
    #.........#........#.........#
    #..................#.........#
    #..................#.........#
    #..................#.........#
    #.........#........#.........#
    #.........#..................#
    #.........#..................#
    #.........#..................#
    #.........#........#......G..#
    #.........#........#.........#
    ##############################";
const ROWS: usize = 15;

const HALL: &str = "
    ####################
    #..................#
    #..................#
    #..................#
    #..................#
    #..................#
    #..................#
    #.........S........#
    #..................#
    #..................#
    #..................#
    #..................#
    #..................#
    ####################";
const HALL_ROWS: usize = 14;

const BIG: &str = "
    ##########################
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #...........S............#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    #........................#
    ##########################";

fn go(w: &mut World, column: f64, row: f64, rows: usize) {
    let goal = Goal {
        position: w.place(column, row, rows),
        heading: None,
        speed_mps: None,
    };
    let nav = w.nav();
    w.navigator.set_goal(goal, &nav).expect("a free place");
}

/// Flies until arrived; the time it took.
fn fly(w: &mut World, limit_s: f64) -> Option<f64> {
    let start = w.time_s;
    while w.time_s < start + limit_s {
        if w.tick().arrived {
            return Some(w.time_s - start);
        }
    }
    None
}

#[test]
fn two_doors_are_passed_without_touching_for_every_ring() {
    for ring in ["tof32", "sonar8"] {
        let mut w = World::new(ROOMS, ROOMS, ring);
        go(&mut w, 26.0, 12.0, ROWS);
        let took = fly(&mut w, 60.0);
        println!(
            "{ring}: {took:?} s, smallest hull clearance {:.2} m",
            w.wall_clearance
        );
        assert!(
            took.is_some_and(|t| t < 40.0),
            "{ring}: stuck at ({:.2}, {:.2})",
            w.x,
            w.y
        );
        assert!(w.wall_clearance > 0.15, "{ring}: {}", w.wall_clearance);
    }
}

#[test]
fn a_dead_end_that_is_not_on_the_plan_is_left_again() {
    let truth = "
    ####################
    #..................#
    #..................#
    #..................#
    #.....######.......#
    #..........#.......#
    #..........#.......#
    #...S......#.......#
    #..........#.......#
    #..........#.......#
    #.....######.......#
    #..................#
    #..................#
    ####################";
    for (ring, seed) in [
        ("tof32", 11),
        ("tof32", 77),
        ("sonar8", 11),
        ("sonar8", 3333),
        ("sonar8", 555_555),
    ] {
        let mut w = World::new(HALL, truth, ring);
        w.noise = seed;
        // The start is in the middle row of the picture, west of the trap.
        (w.x, w.y) = (4.5 * 0.3, 6.5 * 0.3);
        go(&mut w, 16.0, 7.0, HALL_ROWS);
        let took = fly(&mut w, 120.0);
        println!(
            "{ring}, seed {seed}: out of the trap after {took:?} s, clearance {:.2} m",
            w.wall_clearance
        );
        assert!(
            took.is_some(),
            "{ring}, seed {seed}: stuck at ({:.2}, {:.2})",
            w.x,
            w.y
        );
        assert!(
            w.wall_clearance > 0.05,
            "{ring}, seed {seed}: {}",
            w.wall_clearance
        );
    }
}

fn person(x: f64, y: f64, vx: f64, vy: f64) -> Person {
    Person {
        x,
        y,
        vx,
        vy,
        r: 0.25,
    }
}

#[test]
fn a_hovering_vehicle_keeps_clear_of_people_walking_by_and_comes_back() {
    let (mut worst, mut slowest, mut widest) = (f64::INFINITY, 0.0f64, 0.0f64);
    for direction in 0..12u32 {
        for (offset, speed) in [(0.0, 0.8), (0.4, 0.8), (-0.2, 0.5), (0.25, 0.3)] {
            let mut w = World::new(BIG, BIG, "tof32");
            w.noise += u64::from(direction);
            let home = (w.x, w.y);
            let nav = w.nav();
            // No heading asked: half of the directions lie in the gaps of the ring, and only a nose that looks around sees
            // them in time.
            w.navigator.hold(nav.position, None, &nav);
            for _ in 0..300 {
                w.tick();
            }
            let a = f64::from(direction) * 30_f64.to_radians() + 0.1;
            let (ux, uy) = (a.cos(), a.sin());
            let far = 3.0;
            w.people.push(person(
                home.0 - ux * far - uy * offset,
                home.1 - uy * far + ux * offset,
                ux * speed,
                uy * speed,
            ));
            let (mut passed_at, mut back_at) = (None, None);
            let (mut sum2, mut n) = (0.0, 0.0f64);
            for _ in 0..(14.0 / speed.max(0.5) / 0.02) as usize {
                w.tick();
                let away = (w.people[0].x - home.0).hypot(w.people[0].y - home.1);
                let off = (w.x - home.0).hypot(w.y - home.1);
                let behind = (w.people[0].x - home.0) * ux + (w.people[0].y - home.1) * uy;
                if behind > 0.0 {
                    passed_at.get_or_insert(w.time_s);
                }
                if passed_at.is_some() && off > 0.15 {
                    back_at = Some(w.time_s);
                }
                if away > 1.5 {
                    sum2 += off * off;
                    n += 1.0;
                }
            }
            // Counted from the moment the person passes the set point.
            let back = back_at
                .zip(passed_at)
                .map_or(0.0, |(b, p): (f64, f64)| b - p);
            // As if it were a minute of hovering in which this happens once.
            let rms = (sum2 / n.max(60.0 / 0.02)).sqrt();
            worst = worst.min(w.person_clearance);
            (slowest, widest) = (slowest.max(back * speed / 0.8), widest.max(rms));
            assert!(
                w.person_clearance >= 0.2,
                "from {} deg, offset {offset}, {speed} m/s: clearance {}",
                direction * 30,
                w.person_clearance
            );
        }
    }
    println!(
        "clearance at least {worst:.2} m, back within {slowest:.1} s at 0.8 m/s, rms at most {widest:.3} m"
    );
    assert!(slowest < 5.0 && widest < 0.15);
}

#[test]
fn somebody_in_the_way_is_passed_with_clearance() {
    for (vx, vy) in [(-0.6, 0.0), (0.0, 0.0), (-0.3, 0.3)] {
        let mut w = World::new(HALL, HALL, "tof32");
        (w.x, w.y) = (0.9, 2.1);
        for _ in 0..50 {
            w.tick();
        }
        w.people.push(person(3.4, 2.1, vx, vy));
        go(&mut w, 17.0, 6.5, HALL_ROWS);
        let took = fly(&mut w, 60.0);
        println!(
            "person ({vx}, {vy}): {took:?} s, person {:.2} m, wall {:.2} m",
            w.person_clearance, w.wall_clearance
        );
        assert!(took.is_some() && w.person_clearance > 0.1 && w.wall_clearance > 0.05);
    }
}

#[test]
fn pushed_against_a_wall_by_hand_the_hull_stops_25_centimetres_off_and_slides_along() {
    for ring in ["tof32", "sonar8"] {
        for direction in 0..16 {
            let mut w = World::new(HALL, HALL, ring);
            let a = f64::from(direction) * 22.5_f64.to_radians();
            let desired = In::new(1.2 * a.cos(), 1.2 * a.sin(), 0.0);
            for _ in 0..500 {
                w.tick_manual(desired);
            }
            assert!(
                w.wall_clearance >= 0.25,
                "{ring}, direction {direction}: {}",
                w.wall_clearance
            );
            assert!(
                w.wall_clearance < 0.45,
                "it does come close: {}",
                w.wall_clearance
            );
        }
    }
}

#[test]
fn manual_flight_stops_before_a_wall_that_is_not_on_the_plan() {
    let truth = HALL.replace("#.........S........#", "#.........S...###..#");
    let mut w = World::new(HALL, &truth, "tof32");
    w.yaw = 0.0;
    let east = w.anchor.to_ned(In::new(1.0, 0.0, 0.0)) - w.anchor.to_ned(In::zero());
    for _ in 0..400 {
        w.tick_manual(east.with_z(0.0));
    }
    println!("unmapped wall: {:.2} m", w.wall_clearance);
    assert!(w.wall_clearance > 0.2);
}

#[test]
fn hovering_is_still_when_nobody_is_there() {
    let mut w = World::new(ROOMS, ROOMS, "tof32");
    let nav = w.nav();
    let home = (w.x, w.y);
    w.navigator.hold(nav.position, None, &nav);
    let mut worst = 0.0f64;
    for _ in 0..3000 {
        let s = w.tick();
        assert_ne!(s.state, SteeringState::Evading);
        worst = worst.max((w.x - home.0).hypot(w.y - home.1));
    }
    assert!(worst < 0.02);
}
