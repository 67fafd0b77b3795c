//! Patrols of rooms small enough to know the answer.

use super::floor::Reach;
use super::tour::{Distances, length_between, tour};
use super::*;
use crate::patrol::lanes::Lane;
use proptest::prelude::*;
use vehicle::floor_plan::{Cell, Room};
use vehicle::{FloorPlan, In, Map};

/// A plan drawn with characters, 0.1 m each: `#` wall, anything else floor; the first row is the top.
fn drawn(rows: &[&str]) -> FloorPlan {
    let cells = rows
        .iter()
        .rev()
        .flat_map(|row| row.chars())
        .map(|c| if c == '#' { Cell::Occupied } else { Cell::Free })
        .collect();
    FloorPlan::from_cells(rows[0].len(), 0.1, [0.0, 0.0], cells).unwrap()
}

/// An empty room with walls of one cell, m.
fn room(w_m: f64, h_m: f64) -> FloorPlan {
    room_of(0.1, w_m, h_m)
}

/// A room of cells of a size.
fn room_of(cell_m: f64, w_m: f64, h_m: f64) -> FloorPlan {
    let cells = |m: f64| (m / cell_m).round() as usize + 2;
    let (w, h) = (cells(w_m), cells(h_m));
    let cells = (0..w * h)
        .map(|i| {
            let is_wall = i % w == 0 || i % w == w - 1 || i / w == 0 || i / w == h - 1;
            if is_wall { Cell::Occupied } else { Cell::Free }
        })
        .collect();
    FloorPlan::from_cells(w, cell_m, [0.0, 0.0], cells).unwrap()
}

fn at(x: f64, y: f64) -> In<Map> {
    In::new(x, y, 0.0)
}

#[test]
fn on_whole_cells_the_spanning_tree_s_walk_visits_each_once_and_comes_back() {
    // 4.8 m x 2.4 m: 8 x 4 cells of 0.6 m, all of them whole.
    let plan = room(4.8, 2.4);
    let floor = Floor::new(&plan, at(1.0, 1.0), 0.16, 0.1, 0.3).unwrap();
    let walk = spanning_tree::walk(&floor, 6);
    assert_eq!((walk.visited, walk.spikes, walk.cells.len()), (32, 0, 32));
    let mut seen = walk.cells.clone();
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen.len(), 32);
    let ring = walk.cells.iter().zip(walk.cells.iter().cycle().skip(1));
    for (a, b) in ring {
        let step_m = (floor.centre(*a) - floor.centre(*b)).norm_xy();
        // Beside walls a cell is passed up to 0.1 m off its middle.
        assert!((step_m - 0.6).abs() < 0.21, "{step_m}");
    }
}

#[test]
fn an_empty_room_is_swept_by_lanes_that_lie_a_swath_apart() {
    let plan = room_of(0.05, 6.0, 3.0);
    let s = sweep(
        &plan,
        at(1.0, 1.0),
        &SweepConfig::default(),
        Method::Boustrophedon,
    )
    .unwrap();
    assert!(s.covered >= 0.98, "{}", s.covered);
    assert!(
        s.length_m <= 1.35 * s.bound_m,
        "{} {}",
        s.length_m,
        s.bound_m
    );
    assert!((s.area_m2 - 18.0).abs() < 0.2, "{}", s.area_m2);
}

#[test]
fn walls_block_the_swath() {
    // A niche behind a thin wall: within reach as the crow flies, not to be seen.
    let plan = drawn(&[
        "#################",
        "#...............#",
        "#...............#",
        "#...............#",
        "#...............#",
        "#...............#",
        "#################",
        "#...............#",
        "#################",
    ]);
    let floor = Floor::new(&plan, at(0.8, 0.55), 0.16, 0.0, 0.3).unwrap();
    let niche = floor.index(at(0.8, 0.15)).unwrap();
    assert!(!floor.sweepable()[niche as usize]);
}

#[test]
fn what_cannot_be_patrolled_is_refused_with_the_reason() {
    let plan = room(3.0, 3.0);
    let say = |r: Result<Sweep, PatrolError>| r.unwrap_err().to_string();
    let config = SweepConfig::default;
    let lanes = Method::Boustrophedon;
    assert!(say(sweep(&plan, at(0.15, 1.0), &config(), lanes)).contains("the start 0.15, 1.00"));
    assert!(say(sweep(&plan, at(9.0, 1.0), &config(), lanes)).contains("off the plan"));
    let fat = SweepConfig {
        radius_m: 2.0,
        ..config()
    };
    assert!(say(sweep(&plan, at(1.0, 1.0), &fat, lanes)).contains("no free cell"));
    for swath_m in [0.1, 9.0, f64::NAN] {
        let odd = SweepConfig {
            swath_m,
            ..config()
        };
        assert!(say(sweep(&plan, at(1.0, 1.0), &odd, lanes)).contains("is outside"));
    }
    let attic = SweepConfig {
        rooms: vec!["attic".to_owned()],
        ..config()
    };
    assert!(say(sweep(&plan, at(1.0, 1.0), &attic, lanes)).contains("no room `attic`"));
}

#[test]
fn no_fly_zones_are_neither_entered_nor_swept_through() {
    let mut plan = room(5.0, 3.0);
    plan.no_fly = vec![vec![[2.0, 0.0], [3.0, 0.0], [3.0, 2.0], [2.0, 2.0]]];
    for method in [Method::Boustrophedon, Method::SpanningTree] {
        let s = sweep(&plan, at(1.0, 1.0), &SweepConfig::default(), method).unwrap();
        assert!(s.covered >= 0.97, "{method:?} {}", s.covered);
        for w in s.path.windows(2) {
            for k in 0..=20 {
                let p = w[0] + (w[1] - w[0]) * (f64::from(k) / 20.0);
                let is_in = (2.0..=3.0).contains(&p.x()) && p.y() < 2.0;
                assert!(!is_in, "{method:?} at {p:?}");
            }
        }
    }
}

#[test]
fn a_room_behind_a_closed_door_is_named() {
    let mut plan = drawn(&[
        "###################",
        "#........#........#",
        "#........#........#",
        "#........#........#",
        "#........#........#",
        "#........#........#",
        "###################",
    ]);
    for (name, x) in [("west", 0.5), ("east", 1.45)] {
        plan.rooms.push(Room {
            name: name.to_owned(),
            x,
            y: 0.35,
        });
    }
    let floor = Floor::new(&plan, at(0.5, 0.35), 0.16, 0.0, 0.3).unwrap();
    let why = places(&floor, &plan, &[]).unwrap_err().to_string();
    assert!(why.contains("room `east` cannot be reached"), "{why}");
}

#[test]
fn a_plan_without_rooms_gets_places_that_leave_no_floor_far_away() {
    let plan = room(9.0, 4.0);
    let floor = Floor::new(&plan, at(0.5, 0.5), 0.16, 0.1, 0.3).unwrap();
    let places = places(&floor, &plan, &[]).unwrap();
    assert!((2..=8).contains(&places.len()), "{}", places.len());
    let mut reach = Reach::default();
    for i in (0..floor.len() as u32).filter(|i| floor.is_roomy(*i)) {
        let p = floor.centre(i);
        let near =
            places.iter().any(|q| (q.at - p).norm_xy() < 3.0) || (p - at(0.5, 0.5)).norm_xy() < 3.0;
        assert!(near, "{p:?} is far from all");
    }
    assert!(round(&floor, &places).unwrap().length_m > 0.0);
    assert!(
        floor
            .way(floor.start(), floor.start(), &mut reach)
            .is_some()
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_round_over_rooms_is_the_shortest_there_is(points in proptest::collection::vec((0.4..5.6f64, 0.4..3.6f64), 2..6)) {
        let plan = room(6.0, 4.0);
        let floor = Floor::new(&plan, at(3.0, 2.0), 0.16, 0.1, 0.3).unwrap();
        let places: Vec<Place> = points
            .iter()
            .zip(1..)
            .map(|((x, y), k): (_, usize)| Place { name: k.to_string(), at: at(*x, *y) })
            .filter(|p| (p.at - floor.centre(floor.start())).norm_xy() > 0.5)
            .collect();
        prop_assume!(!places.is_empty());
        let found = round(&floor, &places).unwrap();
        // In an empty room ways are straight: try every order.
        let mut orders = vec![vec![]];
        for k in 0..places.len() {
            orders = orders
                .into_iter()
                .flat_map(|o: Vec<usize>| (0..=o.len()).map(move |i| { let mut o = o.clone(); o.insert(i, k); o }))
                .collect();
        }
        let length = |o: &[usize]| {
            let stops: Vec<In<Map>> = std::iter::once(floor.centre(floor.start()))
                .chain(o.iter().map(|k| places[*k].at))
                .chain([floor.centre(floor.start())])
                .collect();
            stops.windows(2).map(|w| (w[1] - w[0]).norm_xy()).sum::<f64>()
        };
        let best = orders.iter().map(|o| length(o)).fold(f64::INFINITY, f64::min);
        let order: Vec<usize> = found.places.iter().map(|p| p.name.parse::<usize>().unwrap()).collect();
        let index = |name: usize| places.iter().position(|p| p.name == name.to_string()).unwrap();
        let mine = length(&order.iter().map(|n| index(*n)).collect::<Vec<_>>());
        // Ways are reckoned on the grid, up to 8 % longer than straight.
        prop_assert!(mine <= 1.09 * best + 1e-9, "{mine} {best}");
    }

    #[test]
    fn a_tour_flies_every_piece_once_and_is_no_longer_than_the_nearest_neighbour_s(
        ends in proptest::collection::vec(((0.4..5.6f64, 0.4..3.6f64), (0.4..5.6f64, 0.4..3.6f64)), 1..9),
    ) {
        let plan = room(6.0, 4.0);
        let floor = Floor::new(&plan, at(3.0, 2.0), 0.16, 0.1, 0.3).unwrap();
        let cell = |(x, y): (f64, f64)| floor.nearest_fit(at(x, y), 0.5).unwrap();
        let pieces: Vec<Lane> = ends.iter().map(|(a, b)| Lane { a: cell(*a), b: cell(*b) }).collect();
        let d = Distances::new(&floor, floor.start(), &pieces);
        for is_closed in [false, true] {
            let order = tour(&d, pieces.len(), is_closed);
            let mut seen: Vec<usize> = order.iter().map(|v| v.piece).collect();
            seen.sort_unstable();
            prop_assert_eq!(seen, (0..pieces.len()).collect::<Vec<_>>());
            prop_assert!(length_between(&d, &order, is_closed).is_finite());
        }
    }
}
