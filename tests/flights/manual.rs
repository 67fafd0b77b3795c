//! A pilot who pushes the stick all the way: at a wall, into a corner, at a person, at glass, in every stick mode.
//!
//! The vehicle stops at least 0.25 m off, touches nothing, and slides along what it is pushed at aslant. A few seeds by
//! default, twenty with `KESTREL_FULL=1`, one with `KESTREL_SEED=N`.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use flight_tests::{Flight, Scenario, modes};
use mavlink_dialect::mode::Px4Mode;
use mavlink_dialect::{raw, standard};
use sim::{Room, Then, Walker};
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, MapPose, Segment};

const RADIUS_M: f64 = 0.16;
const PERSON_M: f64 = 0.25;
/// The hall, m, and where it starts, looking along x.
const HALL: [f64; 2] = [8.0, 6.0];
const START: [f64; 2] = [4.0, 3.0];
/// Nearer than this it may not come.
const OFF_M: f64 = 0.25;

const STICK_MODES: [(&str, Px4Mode); 3] = [
    ("Position", modes::POSITION),
    ("Altitude", Px4Mode { main: 2, sub: 0 }),
    ("Stabilized", Px4Mode { main: 7, sub: 0 }),
];

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

/// A floor plan of the hall, with a pane of glass drawn in or not.
fn plan(pane: Option<Segment>) -> FloorPlan {
    let cell_m = 0.05;
    let (w, h) = (
        (HALL[0] / cell_m) as usize + 4,
        (HALL[1] / cell_m) as usize + 4,
    );
    let cells = (0..w * h)
        .map(|i| {
            let p = [i % w, i / w].map(|k| (k as f64 - 1.5) * cell_m);
            let is_floor = (0..2).all(|axis| (0.0..HALL[axis]).contains(&p[axis]));
            let is_pane = pane
                .is_some_and(|s| (p[0] - s.a[0]).abs() < 0.03 && (s.a[1]..s.b[1]).contains(&p[1]));
            let is_pillar = p[0] > 7.2 && p[1] < 0.4;
            if is_floor && !is_pane && !is_pillar {
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

/// What it is pushed at.
#[derive(Clone, Copy, Debug, PartialEq)]
enum At {
    Wall,
    Corner,
    Person,
    Glass,
}

const PANE: Segment = Segment {
    a: [6.2, 1.5],
    b: [6.2, 4.5],
};
const PERSON: [f64; 2] = [6.0, 3.1];

impl At {
    const ALL: [Self; 4] = [Self::Wall, Self::Corner, Self::Person, Self::Glass];

    fn scenario(self, ring: &str, seed: u64) -> Scenario {
        let room = Room::from_plan("hall", plan(None));
        let room = match (self, ring) {
            // Light passes: the plan must show it.
            (Self::Glass, "tof32") => room.with_glass(&[PANE]).shown_as(plan(Some(PANE))),
            (Self::Glass, _) => room.with_glass(&[PANE]),
            _ => room,
        };
        let scenario = Scenario::in_room(room).ring(ring).seed(seed);
        if self == Self::Person {
            scenario.person(Walker {
                path: vec![PERSON],
                speed_mps: 0.0,
                start: std::time::Duration::ZERO,
                then: Then::Stay,
            })
        } else {
            scenario
        }
    }

    /// Where it lies from the start: east, north.
    const fn direction(self) -> [f64; 2] {
        match self {
            Self::Corner => [1.0, 0.8],
            _ => [1.0, 0.0],
        }
    }
}

/// Hull to the nearest thing, m.
fn clear_m(at: At, f: &Flight) -> f64 {
    let p = f.truth().position;
    let [x, y] = [p.y() + START[0], p.x() + START[1]];
    let mut m = x.min(y).min(HALL[0] - x).min(HALL[1] - y);
    if at == At::Person {
        m = m.min((x - PERSON[0]).hypot(y - PERSON[1]) - PERSON_M);
    }
    if at == At::Glass {
        let beside = (PANE.a[1] - y).max(y - PANE.b[1]).max(0.0);
        m = m.min((x - PANE.a[0]).hypot(beside));
    }
    m - RADIUS_M
}

/// The estimate's error and deviation, east and north, m.
fn off_m(f: &Flight) -> [f64; 4] {
    let nav = &f.snapshot().nav;
    let off = nav.position - f.truth().position;
    let std = nav.position_std_m;
    [off.y(), off.x(), std.y(), std.x()]
}

/// The stick (forward, right) that leads east and north, one of the two all the way: a hovering nose looks around, and stays where it
/// looked when the pilot took over.
fn stick(f: &Flight, [east, north]: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = f.truth().attitude.yaw().sin_cos();
    let [forward, right] = [east * sin + north * cos, east * cos - north * sin];
    let most = forward.abs().max(right.abs());
    [forward / most, right / most]
}

/// One message of the pilot: MANUAL_CONTROL or RC_CHANNELS_OVERRIDE.
fn push(f: &mut Flight, by_radio: bool, mode: &str, [forward, right]: [f64; 2]) {
    // Stabilized has no height of its own: the pilot holds it.
    let throttle = if mode == "Stabilized" {
        let (z, vz) = (f.truth().position.z(), f.truth().velocity.z());
        (0.4 + 0.25 * (z + 1.0) + 0.25 * vz).clamp(0.2, 0.8)
    } else {
        0.5
    };
    if by_radio {
        let us = |v: f64| (1500.0 + 500.0 * v) as u16;
        f.station.send(&standard::RC_CHANNELS_OVERRIDE_DATA {
            target_system: 1,
            target_component: 1,
            chan1_raw: us(right),
            chan2_raw: us(forward),
            chan3_raw: (1000.0 + 1000.0 * throttle) as u16,
            chan4_raw: 1500,
            ..Default::default()
        });
    } else {
        let milli = |v: f64| (1000.0 * v) as i16;
        f.station.send(&raw::MANUAL_CONTROL_DATA {
            target: 1,
            x: milli(forward),
            y: milli(right),
            z: milli(throttle),
            ..Default::default()
        });
    }
    f.wait_s(0.04);
}

fn airborne(at: At, ring: &str, seed: u64, by_radio: bool, mode: (&str, Px4Mode)) -> Flight {
    let mut f = at.scenario(ring, seed).start();
    f.take_off(1.0);
    f.wait_s(1.0);
    for _ in 0..6 {
        push(&mut f, by_radio, mode.0, [0.0, 0.0]);
    }
    assert_eq!(f.set_mode(mode.1), 0);
    f
}

#[test]
fn full_stick_stops_a_quarter_of_a_metre_off_whatever_it_is_pushed_at() {
    println!("FIGURES manual flight, full stick for 8 s");
    let mut bad = Vec::new();
    for ring in ["tof32", "sonar8"] {
        for mode in STICK_MODES {
            for at in At::ALL {
                let (mut nearest_m, mut contacts, mut fastest) = (f64::INFINITY, 0, 0.0_f64);
                for seed in seeds(1) {
                    let by_radio = seed % 2 == 0;
                    let mut f = airborne(at, ring, seed, by_radio, mode);
                    let until = f.now().s() + 8.0;
                    let (mut nearest_now_m, mut off) = (f64::INFINITY, [0.0; 4]);
                    while f.now().s() < until {
                        let full = stick(&f, at.direction());
                        push(&mut f, by_radio, mode.0, full);
                        let clear_m = clear_m(at, &f);
                        if clear_m < nearest_now_m {
                            (nearest_now_m, off) = (clear_m, off_m(&f));
                        }
                        fastest = fastest.max(f.truth().velocity.norm_xy());
                    }
                    contacts += f.truth().contacts;
                    nearest_m = nearest_m.min(nearest_now_m);
                    if f.truth().contacts > 0 || nearest_now_m < OFF_M {
                        bad.push(format!(
                            "{ring} {} {at:?} seed {seed}: {nearest_now_m:.2} m, estimate {off:.2?} m off",
                            mode.0
                        ));
                    }
                }
                println!(
                    " {ring:<7} {:<10} {at:?}: came to {nearest_m:.2} m, {contacts} contacts, at most {fastest:.2} m/s",
                    mode.0
                );
            }
        }
    }
    println!("END");
    assert!(bad.is_empty(), "{bad:#?}");
}

#[test]
fn pushed_aslant_it_slides_along_the_wall() {
    println!("FIGURES manual flight, 45 degrees into a wall");
    let mut bad = Vec::new();
    for ring in ["tof32", "sonar8"] {
        for mode in STICK_MODES {
            for seed in seeds(1) {
                let mut f = airborne(At::Wall, ring, seed, false, mode);
                // To the wall ahead first, then along it.
                for _ in 0..150 {
                    let full = stick(&f, [1.0, 0.0]);
                    push(&mut f, false, mode.0, full);
                }
                let from = f.truth().position;
                let (mut nearest_m, mut ran_m) = (f64::INFINITY, 0.0_f64);
                for _ in 0..75 {
                    let aslant = stick(&f, [1.0, 1.0]).map(|v| 0.7 * v);
                    push(&mut f, false, mode.0, aslant);
                    nearest_m = nearest_m.min(clear_m(At::Wall, &f));
                    ran_m = ran_m.max((f.truth().position - from).norm_xy());
                }
                println!(
                    " {ring:<7} {:<10} seed {seed:2}: {ran_m:.2} m along it in 3 s, {nearest_m:.2} m off",
                    mode.0
                );
                if ran_m < 0.5 || nearest_m < OFF_M || f.truth().contacts > 0 {
                    bad.push(format!("{ring} {} seed {seed}", mode.0));
                }
            }
        }
    }
    println!("END");
    assert!(bad.is_empty(), "{bad:#?}");
}

/// A door of 0.9 m leaves 0.29 m on each side: less than the sticks are stopped at, and yet a way through.
#[test]
fn a_stick_flies_through_a_door_of_90_centimetres() {
    println!("FIGURES manual flight, door of 0.9 m by hand");
    let mut bad = Vec::new();
    for ring in ["tof32", "sonar8"] {
        for mode in STICK_MODES {
            for seed in seeds(1) {
                // Aimed beside the middle, half a metre behind the door, as hands do.
                let aside_m = [0.0, 0.12, -0.12][seed as usize % 3];
                let wall_x_m = 5.5;
                let jambs = [[0.0, START[1] - 0.45], [START[1] + 0.45, HALL[1]]];
                let mut plan = plan(None);
                let cells = (0..plan.width() * plan.height())
                    .map(|i| {
                        let (c, r) = (i % plan.width(), i / plan.width());
                        let p = [c, r].map(|k| (k as f64 - 1.5) * 0.05);
                        let is_wall = (wall_x_m..wall_x_m + 0.1).contains(&p[0])
                            && jambs.iter().any(|j| (j[0]..j[1]).contains(&p[1]));
                        if is_wall {
                            Cell::Occupied
                        } else {
                            plan.cell(c as i64, r as i64)
                        }
                    })
                    .collect();
                let (home, north_rad) = (plan.home, plan.north_rad);
                plan = FloorPlan::from_cells(plan.width(), 0.05, plan.origin(), cells).unwrap();
                (plan.home, plan.north_rad) = (home, north_rad);
                let room = Room::from_plan("hall", plan);
                let mut f = Scenario::in_room(room).ring(ring).seed(seed).start();
                f.take_off(1.0);
                f.wait_s(1.0);
                assert_eq!(f.set_mode(mode.1), 0);
                let began_s = f.now().s();
                let (mut beside_m, mut passed_s) = (f64::INFINITY, f64::NAN);
                while f.now().s() < began_s + 20.0 && passed_s.is_nan() {
                    let p = f.truth().position;
                    let to = [wall_x_m + 0.6 - START[0] - p.y(), aside_m - p.x()];
                    let half = stick(&f, to).map(|v| 0.5 * v);
                    push(&mut f, false, mode.0, half);
                    let p = f.truth().position;
                    let [x, y] = [p.y() + START[0], p.x() + START[1]];
                    let along = (wall_x_m - x).max(x - wall_x_m - 0.1).max(0.0);
                    let across = (0.45 - (y - START[1]).abs()).max(0.0);
                    beside_m = beside_m.min(along.hypot(across) - RADIUS_M);
                    if x > wall_x_m + 0.5 {
                        passed_s = f.now().s() - began_s;
                    }
                }
                println!(
                    " {ring:<7} {:<10} seed {seed:2}, aimed {aside_m:+.2} m beside: through after {passed_s:.1} s, {beside_m:.2} m off its jambs",
                    mode.0
                );
                if passed_s.is_nan() || f.truth().contacts > 0 {
                    bad.push(format!("{ring} {} seed {seed}", mode.0));
                }
            }
        }
    }
    println!("END");
    assert!(bad.is_empty(), "{bad:#?}");
}
