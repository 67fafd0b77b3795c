//! Patrols: the office swept within its bars, and mazes nobody has seen before patrolled from an unknown place.
//!
//! `KESTREL_MAZE_SEEDS=1..100` flies the campaign of row 10; without it a few seeds.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::mode::Mode;
use bridge::station::{return_home, take_off, waypoint};
use flight_tests::{Flight, Scenario, modes};
use planner::patrol::{Floor, Method, SweepConfig, places, round, sweep};
use sim::Room;
use std::f64::consts::{PI, TAU};
use std::ops::RangeInclusive;
use vehicle::{Airframe, FloorPlan, In, LocalizationState, Map, MapPose};

/// Row 9: of the floor within half a swath of a place where the vehicle fits.
#[test]
fn the_office_is_swept_within_its_bars() {
    println!(
        "FIGURES coverage of the bundled rooms, swath 0.6 m; bound = area by swath, the spanning tree's over whole cells"
    );
    println!(
        " room       method          area m2  bound m   path m  path/bound  covered %  corners"
    );
    for (name, bar) in [("office", 1.6), ("maze", 2.0), ("corridor", 2.0)] {
        let room = Room::named(name).unwrap();
        let home = room.home();
        let start = In::new(home.x_m, home.y_m, 0.0);
        let mut shortest = f64::INFINITY;
        for method in [Method::Boustrophedon, Method::SpanningTree] {
            let s = sweep(room.floor_plan(), start, &SweepConfig::default(), method).unwrap();
            println!(
                " {name:9}  {:14}  {:7.1}  {:7.1}  {:7.1}  {:10.2}  {:9.2}  {:7}",
                format!("{method:?}"),
                s.area_m2,
                s.bound_m,
                s.length_m,
                s.length_m / s.bound_m,
                100.0 * s.covered,
                s.path.len()
            );
            assert!(s.covered >= 0.98, "{name} {method:?}: {}", s.covered);
            shortest = shortest.min(s.length_m / s.bound_m);
        }
        assert!(shortest <= bar, "{name}: {shortest:.2} times area by swath");
    }
    println!("END");
}

/// SplitMix64: what stands where follows from the seed.
struct Dice(u64);

impl Dice {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A maze, where the vehicle stands in it, and what the plan does not show.
struct Course {
    plan: FloorPlan,
    start: MapPose,
    boxes: Vec<[f64; 3]>,
}

/// Cells of the mazes, m.
const CELL_M: f64 = 1.4;
const CELLS: usize = 5;

impl Course {
    fn new(seed: u64) -> Self {
        let room = Room::named(&format!("maze:{seed}")).unwrap();
        let plan = (**room.floor_plan()).clone();
        let mut dice = Dice(seed);
        let home = plan.home.unwrap();
        let taken: Vec<[f64; 2]> = plan
            .rooms
            .iter()
            .map(|r| [r.x, r.y])
            .chain([[home.x_m, home.y_m]])
            .collect();
        let field = plan.distance_field(2.0);
        let mut free = Vec::new();
        for i in 0..CELLS * CELLS {
            let [x, y] = [i % CELLS, i / CELLS].map(|k| (k as f64 + 0.5) * CELL_M);
            if taken.iter().all(|[a, b]| (a - x).hypot(b - y) > 0.9) {
                free.push([x, y]);
            }
        }
        let mut draw = |from: &mut Vec<[f64; 2]>| {
            let k = (dice.unit() * from.len() as f64) as usize;
            from.swap_remove(k.min(from.len() - 1))
        };
        let start = draw(&mut free);
        let mut boxes = Vec::new();
        while boxes.len() < 3 && !free.is_empty() {
            let [x, y] = draw(&mut free);
            if let Some(place) = beside_a_panel(&plan, [x, y], 0.3) {
                boxes.push(place);
            }
        }
        assert_eq!(boxes.len(), 3, "seed {seed}");
        let at = In::<Map>::new(start[0], start[1], 0.0);
        let clear_m = field.at(at);
        assert!(
            clear_m > 0.3,
            "seed {seed}: starts {clear_m:.2} m from a wall"
        );
        Self {
            plan,
            start: MapPose::new(start[0], start[1], TAU * dice.unit() - PI),
            boxes,
        }
    }
}

/// A box that stands at a panel of its cell, so that there is a way past it.
fn beside_a_panel(plan: &FloorPlan, [x, y]: [f64; 2], side_m: f64) -> Option<[f64; 3]> {
    let reach = 0.5 * CELL_M - 0.05 - 0.5 * side_m;
    [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
        .into_iter()
        .find(|[dx, dy]| {
            let at = |k: f64| In::<Map>::new(x + k * dx, y + k * dy, 0.0);
            plan.is_free(at(0.4)) && !plan.is_free(at(0.5 * CELL_M))
        })
        .map(|[dx, dy]| [x + reach * dx, y + reach * dy, side_m])
}

/// What a flight was worth.
#[derive(Debug, Default)]
struct Worth {
    localized_s: Option<f64>,
    worst_pass_m: f64,
    landing_m: f64,
    contacts: u32,
    flight_s: f64,
    fault: Option<&'static str>,
}

impl Worth {
    fn is_good(&self) -> bool {
        self.fault.is_none()
            && self.contacts == 0
            && self.worst_pass_m <= 0.25
            && self.landing_m <= 0.15
    }
}

/// Takes off not knowing where, finds its place, patrols every room, comes home, lands.
fn fly(seed: u64) -> (Flight, Worth) {
    let course = Course::new(seed);
    let mut scenario = Scenario::room(&format!("maze:{seed}"))
        .seed(seed)
        .at(course.start)
        .unknown();
    for place in &course.boxes {
        scenario = scenario.unmapped(*place);
    }
    let mut f = scenario.start();
    let mut worth = Worth::default();
    let fault = patrol(&mut f, &course, &mut worth).err();
    worth.fault = fault;
    worth.contacts = f.truth().contacts;
    worth.landing_m = f.truth().position.norm_xy();
    worth.flight_s = f.now().s();
    (f, worth)
}

fn patrol(f: &mut Flight, course: &Course, worth: &mut Worth) -> Result<(), &'static str> {
    f.arm();
    let up = [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, 1.0];
    if f.command(22, up) != 0 {
        return Err("take-off refused");
    }
    let began_s = f.now().s();
    let is_localized =
        |f: &Flight| f.snapshot().nav.localization.state == LocalizationState::Localized;
    f.try_until(90.0, |f| {
        (is_localized(f) && f.snapshot().mode.mode == Mode::Hold)
            || (f.now().s() > began_s + 15.0 && !f.snapshot().is_armed)
    })
    .map_err(|_| "not localized in time")?;
    if !is_localized(f) {
        return Err("landed without its place");
    }
    worth.localized_s = Some(f.now().s() - began_s);
    let anchor = course.plan.anchor();
    let home = anchor.to_map(In::zero());
    let floor = Floor::new(&course.plan, home, Airframe::default().radius_m, 0.09, 0.3).unwrap();
    let rooms = places(&floor, &course.plan, &[]).unwrap();
    let round = round(&floor, &rooms).unwrap();
    let stops: Vec<In<vehicle::Ned>> = round.places.iter().map(|p| anchor.to_ned(p.at)).collect();
    let mut items = vec![take_off(1.0)];
    items.extend(stops.iter().map(|p| {
        let mut item = waypoint(p.x(), p.y(), -1.0, None);
        item.param1 = 1.0;
        item
    }));
    items.push(return_home());
    if f.upload(items) != 0 {
        return Err("mission refused");
    }
    if f.set_mode(modes::MISSION) != 0 {
        return Err("mode Mission refused");
    }
    f.try_until(400.0, |f| !f.snapshot().is_armed && f.truth().on_floor)
        .map_err(|_| "not home in time")?;
    worth.worst_pass_m = stops
        .iter()
        .map(|p| f.nearest_pass(p.x(), p.y()))
        .fold(0.0, f64::max);
    Ok(())
}

fn seeds() -> RangeInclusive<u64> {
    let asked = std::env::var("KESTREL_MAZE_SEEDS").ok();
    let range = asked.as_deref().and_then(|text| {
        let (a, b) = text.split_once("..").unwrap_or((text, text));
        Some(a.parse().ok()?..=b.parse().ok()?)
    });
    range.unwrap_or(1..=4)
}

/// Row 10.
#[test]
fn random_mazes_are_patrolled_from_an_unknown_place_around_what_the_plan_does_not_show() {
    let seeds = seeds();
    let n = seeds.clone().count();
    println!("FIGURES random mazes 7 x 7 m, unknown start, 3 boxes off the plan, 6 rooms, tof32");
    println!(" seed  localized s  worst pass m  landing m  contacts  flight s  verdict");
    let mut good = 0;
    let mut bad = Vec::new();
    for seed in seeds {
        let (f, w) = fly(seed);
        let verdict = if w.is_good() {
            "good"
        } else {
            w.fault.unwrap_or("missed a bar")
        };
        println!(
            " {seed:4}  {:11.1}  {:12.2}  {:9.2}  {:8}  {:8.0}  {verdict}",
            w.localized_s.unwrap_or(f64::NAN),
            w.worst_pass_m,
            w.landing_m,
            w.contacts,
            w.flight_s
        );
        if w.is_good() {
            good += 1;
        } else {
            let last = f.station.heard().texts.last().cloned().unwrap_or_default();
            bad.push(format!(
                "seed {seed}: {verdict}; last text `{last}`; again: KESTREL_MAZE_SEEDS={seed} cargo test -p flight-tests \
                 --profile ci --test patrol mazes -- --nocapture"
            ));
        }
    }
    println!("END {good} of {n} good");
    // 95 of 100; of few seeds all but one.
    let needed = if n >= 20 {
        (n * 95).div_ceil(100)
    } else {
        n - 1
    };
    assert!(good >= needed, "{good} of {n}\n{}", bad.join("\n"));
}
