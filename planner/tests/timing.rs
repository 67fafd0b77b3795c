//! Times of one step, printed: `cargo test -p planner --profile ci --test timing -- --ignored --nocapture`.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]

#[allow(dead_code, reason = "every test uses its own part of the world")]
mod world;

use planner::{Goal, PlannerParams, Router};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, In};
use world::{Person, World};

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

#[test]
#[ignore = "measures, proves nothing"]
fn one_step_in_rooms_with_a_person() {
    let mut w = World::new(ROOMS, ROOMS, "tof32");
    w.people.push(Person {
        x: 6.0,
        y: 2.5,
        vx: -0.2,
        vy: 0.0,
        r: 0.25,
    });
    let goal = Goal {
        position: w.place(26.0, 12.0, 15),
        heading: None,
        speed_mps: None,
    };
    let nav = w.nav();
    w.navigator.set_goal(goal, &nav).unwrap();
    let mut times: Vec<f64> = Vec::new();
    for _ in 0..600 {
        w.tick();
        let (now, nav) = (w.now(), w.nav());
        let mut copy = w.navigator.clone();
        let start = Instant::now();
        black_box(copy.step(now, &nav));
        times.push(start.elapsed().as_secs_f64() * 1e6);
    }
    println!("first {:.0?}", &times[..3]);
    times.sort_by(f64::total_cmp);
    println!(
        "step: p50 {:.1} us, p99 {:.1} us, max {:.1} us",
        times[300], times[594], times[599]
    );
}

#[test]
#[ignore = "measures, proves nothing"]
fn one_search_on_12_by_9_metres() {
    let (w, h) = (240, 180);
    let cells = (0..w * h)
        .map(|i| {
            let (c, r) = (i % w, i / w);
            let border = c < 2 || r < 2 || c >= w - 2 || r >= h - 2;
            // Three walls with a door each at alternating ends: the longest way through.
            let inner = [60, 120, 180].iter().enumerate().any(|(k, x)| {
                let door = if k % 2 == 0 { 10..28 } else { 150..168 };
                (*x..x + 2).contains(&c) && !door.contains(&r)
            });
            if border || inner {
                Cell::Occupied
            } else {
                Cell::Free
            }
        })
        .collect();
    let plan = Arc::new(FloorPlan::from_cells(w, 0.05, [0.0, 0.0], cells).unwrap());
    let start = Instant::now();
    let mut router = Router::new(plan, 0.16, &PlannerParams::default());
    println!(
        "router built in {:.1} ms",
        start.elapsed().as_secs_f64() * 1e3
    );
    let mut best = f64::INFINITY;
    for _ in 0..20 {
        let start = Instant::now();
        let path = router
            .find(In::new(0.6, 8.2, 0.0), In::new(11.4, 8.2, 0.0), &[])
            .unwrap();
        best = best.min(start.elapsed().as_secs_f64() * 1e3);
        black_box(path);
    }
    println!("search: best of 20 {best:.2} ms");
}
