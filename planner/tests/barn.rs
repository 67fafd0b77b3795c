//! The BARN obstacle courses (Perille, Truong, Xiao, Stone 2020), unknown to the planner: success, contacts, time, score.
//!
//! Some worlds by default (every tenth, or every `BARN_STRIDE`th with `BARN_SEEDS` seeds), all with three seeds each with
//! `KESTREL_FULL=1`; `BARN_WORLD=N` flies one of them. Skipped without the recordings.

#![allow(
    clippy::disallowed_methods,
    clippy::print_stdout,
    reason = "a test is no core, and this one prints its figures"
)]

use planner::episode::{Course, Episode, Flown, Sensor};
use std::path::PathBuf;

const START: [f64; 3] = [-2.0, 3.0, std::f64::consts::FRAC_PI_2];
const GOAL: [f64; 2] = [-2.0, 13.0];
/// Every so many worlds are flown by default.
const STRIDE: usize = 10;

struct World {
    number: u32,
    reference_m: f64,
    course: Course,
}

fn worlds(stride: usize) -> Option<Vec<World>> {
    let base = std::env::var_os("KESTREL_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")),
        PathBuf::from,
    );
    let folder = base.join("barn");
    let Ok(index) = std::fs::read_to_string(folder.join("index.csv")) else {
        println!(
            "SKIPPED: no courses at {} (set KESTREL_DATA)",
            folder.display()
        );
        return None;
    };
    let mut out = Vec::new();
    for line in index.lines().skip(1).step_by(stride) {
        let fields: Vec<&str> = line.split(',').collect();
        let number = fields[0].parse().expect("a number of a world");
        let csv = std::fs::read_to_string(folder.join(format!("worlds/world_{number:03}.csv")))
            .expect("a world");
        out.push(World {
            number,
            reference_m: fields[3].parse().expect("a length"),
            course: Course::from_csv(&csv).expect("a course"),
        });
    }
    Some(out)
}

#[derive(Default)]
struct Tally {
    flights: f64,
    success: f64,
    collided: f64,
    timeout: f64,
    time_s: f64,
    score_28: f64,
    score_48: f64,
    nearest_m: f64,
}

impl Tally {
    fn add(&mut self, f: &Flown, reference_m: f64) {
        self.flights += 1.0;
        self.success += f64::from(u8::from(f.success));
        self.collided += f64::from(u8::from(f.collided));
        self.timeout += f64::from(u8::from(f.timeout));
        if f.success {
            self.time_s += f.time_s;
        }
        self.score_28 += f.score(reference_m, 2.0, 8.0);
        self.score_48 += f.score(reference_m, 4.0, 8.0);
        self.nearest_m += f.min_clearance_m;
    }

    fn row(&self, name: &str) -> String {
        let share = |v: f64| 100.0 * v / self.flights;
        format!(
            "{name:<10} {:>7.0} {:>8.1} % {:>8.1} % {:>7.1} % {:>9.1} {:>7.3} {:>7.3} {:>9.3}",
            self.flights,
            share(self.success),
            share(self.collided),
            share(self.timeout),
            self.time_s / self.success.max(1.0),
            self.score_48 / self.flights,
            self.score_28 / self.flights,
            self.nearest_m / self.flights,
        )
    }
}

const HEAD: &str =
    "           flights   success  contacts  timeout  mean s   (4,8)   (2,8) clearance";

fn campaign(sensor: Sensor) -> Option<Tally> {
    let full = std::env::var_os("KESTREL_FULL").is_some_and(|v| v == "1");
    let stride = std::env::var("BARN_STRIDE")
        .ok()
        .and_then(|s| s.parse().ok());
    let seeds = std::env::var("BARN_SEEDS")
        .ok()
        .and_then(|s| s.parse().ok());
    let (stride, seeds) = if full {
        (1, 3)
    } else {
        (stride.unwrap_or(STRIDE), seeds.unwrap_or(1))
    };
    let worlds = worlds(stride)?;
    let mut tally = Tally::default();
    let only: Option<u32> = std::env::var("BARN_WORLD")
        .ok()
        .and_then(|s| s.parse().ok());
    for world in &worlds {
        if only.is_some_and(|n| n != world.number) {
            continue;
        }
        for seed in 1..=seeds {
            let mut episode = Episode::new(START, GOAL, sensor);
            episode.seed = seed;
            let flown = episode.fly(&world.course, |_| ());
            tally.add(&flown, world.reference_m);
            if !flown.success || std::env::var_os("BARN_ALL").is_some() {
                println!("world {}, seed {seed}: {flown:?}", world.number);
            }
        }
    }
    println!(
        "FIGURES barn {}\n{HEAD}\n{}\nEND",
        sensor.name(),
        tally.row(sensor.name())
    );
    Some(tally)
}

/// True if a share of the flights is kept to. One flight of a small sample may go wrong without saying anything about the share.
fn at_most(count: f64, share: f64, flights: f64) -> bool {
    count <= (share * flights).max(1.0)
}

#[test]
fn laser_passes_98_percent_with_a_score_of_45_hundredths() {
    let Some(t) = campaign(Sensor::Laser270) else {
        return;
    };
    assert!(
        at_most(t.flights - t.success, 0.02, t.flights) && at_most(t.collided, 0.01, t.flights)
    );
    assert!(t.score_28 >= 0.45 * t.flights);
}

#[test]
fn multizone_ring_passes_95_percent() {
    let Some(t) = campaign(Sensor::Tof32) else {
        return;
    };
    assert!(
        at_most(t.flights - t.success, 0.05, t.flights) && at_most(t.collided, 0.02, t.flights)
    );
}

#[test]
fn eight_sonars_pass_92_percent() {
    let Some(t) = campaign(Sensor::Sonar8) else {
        return;
    };
    assert!(
        at_most(t.flights - t.success, 0.08, t.flights) && at_most(t.collided, 0.02, t.flights)
    );
}
