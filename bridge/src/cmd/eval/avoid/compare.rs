//! Every method over the same courses: a table beside each other, a picture of each course.

use super::super::super::term::Terminal;
use super::picture::{Track, draw};
use super::{AvoidArgs, Method};
use anyhow::{Context as _, Result};
use planner::episode::standard::{self, Standard};
use planner::episode::{Course, Episode, Flown};
use serde_json::json;
use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;

/// Where the published courses begin and end.
const START: [f64; 3] = [-2.0, 3.0, std::f64::consts::FRAC_PI_2];
const GOAL: [f64; 2] = [-2.0, 13.0];
/// Points of a track farther apart than this are drawn, m.
const DRAWN_EVERY_M: f64 = 0.03;

/// One method on one course, or on all of a folder.
#[derive(Clone, Debug, Default)]
struct Tally {
    flights: f64,
    arrived: f64,
    touched: f64,
    time_s: f64,
    score: f64,
    nearest_m: f64,
    /// Standard deviation across the straight piece, m: its sum and the flights that have one.
    weave: (f64, f64),
}

impl Tally {
    fn add(&mut self, f: &Flown, reference_m: f64, weave_m: Option<f64>) {
        self.flights += 1.0;
        self.arrived += f64::from(u8::from(f.success));
        self.touched += f64::from(u8::from(f.collided));
        if f.success {
            self.time_s += f.time_s;
        }
        self.score += f.score(reference_m, 2.0, 8.0);
        self.nearest_m += f.min_clearance_m;
        if let Some(m) = weave_m {
            self.weave = (self.weave.0 + m, self.weave.1 + 1.0);
        }
    }

    fn row(&self, course: &str, method: Method) -> String {
        let n = self.flights.max(1.0);
        let or_dash = |has: bool, text: String| if has { text } else { "-".to_owned() };
        format!(
            "| {course} | {} | {} | {} | {} | {} | {} | {:.3} | {:.2} | {} |",
            method.name(),
            self.flights,
            self.arrived,
            self.touched,
            self.flights - self.arrived - self.touched,
            or_dash(
                self.arrived > 0.0,
                format!("{:.1}", self.time_s / self.arrived.max(1.0))
            ),
            self.score / n,
            self.nearest_m / n,
            or_dash(
                self.weave.1 > 0.0,
                format!("{:.3}", self.weave.0 / self.weave.1.max(1.0))
            ),
        )
    }
}

const HEAD: &str = "\
| course | method | flights | arrived | touched | gave up | mean s | score (2,8) | nearest m | std m |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |";

pub(super) fn run(args: &AvoidArgs, folder: &Path) -> Result<ExitCode> {
    let mut terminal = Terminal::new(args.quiet);
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let mut table = String::from(HEAD);
    let mut summary = Vec::new();
    terminal.line(HEAD);
    let mut say = |course: &str, method: Method, tally: &Tally| {
        let row = tally.row(course, method);
        terminal.line(&row);
        // Writing to a String cannot fail.
        let _ = write!(table, "\n{row}");
        summary.push(json!({
            "course": course, "method": method.name(), "flights": tally.flights, "arrived": tally.arrived,
            "touched": tally.touched,
        }));
    };
    for standard in standard::all() {
        let mut tracks = Vec::new();
        for method in Method::ALL {
            let (tally, track) = fly_all(args, &standard, method)?;
            say(standard.name, method, &tally);
            tracks.push(track);
        }
        let file = folder.join(format!("{}.svg", standard.name));
        std::fs::write(&file, draw(&standard, &tracks))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    if let Some(from) = &args.courses {
        let courses = published(from, usize::from(args.every))?;
        for method in Method::ALL {
            let mut tally = Tally::default();
            for (course, reference_m) in &courses {
                for seed in seeds(args) {
                    let mut episode = args.on_course(START, GOAL, method)?;
                    episode.seed = seed;
                    tally.add(&episode.fly(course, |_| ()), *reference_m, None);
                }
            }
            say(&format!("{} published", courses.len()), method, &tally);
        }
    }
    table.push('\n');
    let file = folder.join("table.md");
    std::fs::write(&file, &table).with_context(|| format!("cannot write {}", file.display()))?;
    terminal.line(&format!("table and pictures -> {}", folder.display()));
    Terminal::new(false).line(&json!(summary).to_string());
    Ok(ExitCode::SUCCESS)
}

fn seeds(args: &AvoidArgs) -> impl Iterator<Item = u64> {
    (0..u64::from(args.seeds)).map(|k| args.seed.wrapping_add(k))
}

/// All seeds of a method on a course; the track of the first.
fn fly_all(args: &AvoidArgs, standard: &Standard, method: Method) -> Result<(Tally, Track)> {
    let mut tally = Tally::default();
    let mut first = None;
    for seed in seeds(args) {
        let mut episode = args.on_course(standard.start, standard.goal, method)?;
        episode.seed = seed;
        let (flown, track, weave_m) = fly(&episode, standard);
        tally.add(&flown, standard.reference_m, weave_m);
        first.get_or_insert(Track {
            name: method.name(),
            points: track,
            outcome: outcome(&flown),
        });
    }
    Ok((tally, first.context("no seed to fly")?))
}

const fn outcome(flown: &Flown) -> &'static str {
    match (flown.success, flown.collided) {
        (true, _) => "arrived",
        (false, true) => "touched",
        (false, false) => "gave up",
    }
}

/// A flight, its track, and how much it swung on the straight piece.
fn fly(episode: &Episode, standard: &Standard) -> (Flown, Vec<[f64; 2]>, Option<f64>) {
    let (mut track, mut across): (Vec<[f64; 2]>, Vec<f64>) = (Vec::new(), Vec::new());
    let flown = episode.fly(&standard.course, |m| {
        let here = [m.x_m, m.y_m];
        let moved = track
            .last()
            .is_none_or(|p| (p[0] - here[0]).hypot(p[1] - here[1]) > DRAWN_EVERY_M);
        if moved {
            track.push(here);
        }
        if standard
            .straight_m
            .is_some_and(|[from, to]| (from..to).contains(&m.x_m))
        {
            across.push(m.y_m);
        }
    });
    // Only who came through has flown the straight piece.
    let weave_m = (flown.success && !across.is_empty()).then(|| deviation(&across));
    (flown, track, weave_m)
}

fn deviation(values: &[f64]) -> f64 {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// Every so many of the published courses with the lengths of their reference paths.
fn published(folder: &Path, every: usize) -> Result<Vec<(Course, f64)>> {
    let index = folder.join("index.csv");
    let text = std::fs::read_to_string(&index)
        .with_context(|| format!("cannot read {}", index.display()))?;
    let mut out = Vec::new();
    for (number, line) in text.lines().enumerate().skip(1).step_by(every) {
        let fields: Vec<&str> = line.split(',').collect();
        let parsed = fields
            .first()
            .and_then(|f| f.parse::<u32>().ok())
            .zip(fields.get(3).and_then(|f| f.parse::<f64>().ok()));
        let (world, reference_m) = parsed.with_context(|| {
            format!(
                "{}, line {}: a number and a length are needed",
                index.display(),
                number + 1
            )
        })?;
        let file = folder.join(format!("worlds/world_{world:03}.csv"));
        let text = std::fs::read_to_string(&file)
            .with_context(|| format!("cannot read {}", file.display()))?;
        let course = Course::from_csv(&text).with_context(|| format!("in {}", file.display()))?;
        out.push((course, reference_m));
    }
    Ok(out)
}
