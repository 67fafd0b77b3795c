//! `kestrel eval avoid`: the navigator that flies, through obstacles it knows nothing about.

mod compare;
mod picture;

use super::super::Usage;
use super::super::term::Terminal;
use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use planner::VfhVariant;
use planner::episode::{Course, Episode, Sensor};
use serde_json::json;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// Fly through obstacles nobody knows of, by ranges only.
///
/// The vehicle answers as in the air (dead time, lag, at most 3 m/s2); the rangers have the rates, latencies and faults of
/// the simulator. Writes `t_s,x_m,y_m,yaw_rad,clearance_m`, 50 rows a second; `clearance_m` is hull to obstacle. The flight
/// succeeds within 1 m of the goal in 100 s without contact. The last line of standard output is a JSON summary.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel eval avoid --world world_000.csv --start -2,3,1.5708 --goal -2,13 --sensor laser270 --seed 1 --out run.csv\n  kestrel eval avoid --world world_000.csv --start -2,3,1.5708 --goal -2,13 --sensor tof32 --method vfh-thesis --out run.csv\n  kestrel eval avoid --compare methods --sensor tof32\n\nThe world is a table of cylinders: x_m,y_m,radius_m. --compare writes a table and a picture of every course into a folder."
)]
pub(crate) struct AvoidArgs {
    /// The obstacles (CSV: x_m,y_m,radius_m).
    #[arg(long, value_name = "FILE", required_unless_present = "compare")]
    world: Option<PathBuf>,
    /// Start: place in m, heading in rad counter-clockwise from x.
    #[arg(
        long,
        value_name = "X,Y,YAW",
        value_delimiter = ',',
        num_args = 1,
        allow_hyphen_values = true,
        required_unless_present = "compare"
    )]
    start: Vec<f64>,
    /// Goal in m.
    #[arg(
        long,
        value_name = "X,Y",
        value_delimiter = ',',
        num_args = 1,
        allow_hyphen_values = true,
        required_unless_present = "compare"
    )]
    goal: Vec<f64>,
    /// The rangers.
    #[arg(long, value_name = "NAME")]
    sensor: SensorName,
    /// Radius of the vehicle, m.
    #[arg(long, value_name = "M", default_value_t = 0.2)]
    radius: f64,
    /// Largest speed, m/s.
    #[arg(long, value_name = "M/S", default_value_t = 2.0)]
    vmax: f64,
    /// Seed of the rangers' noise.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// How the way around obstacles is chosen.
    #[arg(long, value_name = "NAME", default_value = "vfh+")]
    method: Method,
    /// Let the two older methods brake before obstacles, as they do in flight.
    #[arg(long)]
    guard: bool,
    /// Where the track goes (CSV).
    #[arg(long, value_name = "FILE", required_unless_present = "compare")]
    out: Option<PathBuf>,
    /// Fly every method over the standard courses (post, door, corridor, two gaps, dead end): table and pictures into this
    /// folder.
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["world", "start", "goal", "out"])]
    compare: Option<PathBuf>,
    /// With --compare: the obstacle courses of this folder too (index.csv and worlds/, as the BARN courses are published).
    #[arg(long, value_name = "FOLDER", requires = "compare")]
    courses: Option<PathBuf>,
    /// With --courses: every so many of them.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..))]
    every: u16,
    /// With --compare: flights of each method on each course, with seeds from --seed on.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    seeds: u16,
    /// Only the summary.
    #[arg(long, short)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SensorName {
    /// A planar laser of 270 degrees.
    Laser270,
    /// Eight sonars.
    Sonar8,
    /// Four time-of-flight sensors of eight columns.
    Tof32,
}

/// How the way around obstacles is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Method {
    /// VFH+ with memory, ways planned anew, look-ahead: what flies.
    #[value(name = "vfh+")]
    VfhPlus,
    /// SNSI's histogram of 2018 as its thesis prints it.
    #[value(name = "vfh-thesis")]
    VfhThesis,
    /// SNSI's first planner, a potential field.
    #[value(name = "potential")]
    Potential,
}

impl Method {
    const ALL: [Self; 3] = [Self::VfhPlus, Self::VfhThesis, Self::Potential];

    const fn variant(self) -> VfhVariant {
        match self {
            Self::VfhPlus => VfhVariant::Plus,
            Self::VfhThesis => VfhVariant::Thesis,
            Self::Potential => VfhVariant::Potential,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::VfhPlus => "VFH+",
            Self::VfhThesis => "thesis VFH",
            Self::Potential => "potential field",
        }
    }
}

impl SensorName {
    const fn sensor(self) -> Sensor {
        match self {
            Self::Laser270 => Sensor::Laser270,
            Self::Sonar8 => Sensor::Sonar8,
            Self::Tof32 => Sensor::Tof32,
        }
    }
}

impl AvoidArgs {
    fn episode(&self) -> Result<Episode, Usage> {
        let numbers = |what: &str, given: &[f64], form: &str| {
            Usage(format!(
                "--{what} {given:?}: {form} is needed, finite numbers"
            ))
        };
        let start = <[f64; 3]>::try_from(self.start.as_slice())
            .ok()
            .filter(|s| s.iter().all(|v| v.is_finite()))
            .ok_or_else(|| numbers("start", &self.start, "X,Y,YAW"))?;
        let goal = <[f64; 2]>::try_from(self.goal.as_slice())
            .ok()
            .filter(|s| s.iter().all(|v| v.is_finite()))
            .ok_or_else(|| numbers("goal", &self.goal, "X,Y"))?;
        if (start[0] - goal[0]).abs().max((start[1] - goal[1]).abs()) > 150.0 {
            return Err(Usage("start and goal are more than 150 m apart".to_owned()));
        }
        self.on_course(start, goal, self.method)
    }

    /// Between two places, by a method, with everything else as given.
    fn on_course(&self, start: [f64; 3], goal: [f64; 2], method: Method) -> Result<Episode, Usage> {
        let within = |what: &str, v: f64, low: f64, high: f64| {
            if (low..=high).contains(&v) {
                Ok(v)
            } else {
                Err(Usage(format!("--{what} {v} is outside {low}..={high}")))
            }
        };
        let mut episode = Episode::new(start, goal, self.sensor.sensor());
        episode.radius_m = within("radius", self.radius, 0.05, 1.0)?;
        episode.vmax_mps = within("vmax", self.vmax, 0.1, 5.0)?;
        episode.seed = self.seed;
        episode.vfh.variant = method.variant();
        episode.vfh.guard = self.guard;
        Ok(episode)
    }
}

pub(crate) fn run(args: &AvoidArgs) -> Result<ExitCode> {
    if let Some(folder) = &args.compare {
        return compare::run(args, folder);
    }
    // The command line asks for them unless --compare is given.
    let (Some(world), Some(out)) = (&args.world, &args.out) else {
        return Err(Usage("--world and --out are needed".to_owned()).into());
    };
    let episode = args.episode()?;
    let text = std::fs::read_to_string(world)
        .with_context(|| format!("cannot read {}", world.display()))?;
    let course = Course::from_csv(&text).with_context(|| format!("in {}", world.display()))?;
    let mut csv = String::from("t_s,x_m,y_m,yaw_rad,clearance_m\n");
    let flown = episode.fly(&course, |m| {
        // Writing to a String cannot fail.
        let _ = writeln!(
            csv,
            "{:.3},{:.4},{:.4},{:.4},{:.4}",
            m.t_s, m.x_m, m.y_m, m.yaw_rad, m.clearance_m
        );
    });
    std::fs::write(out, &csv).with_context(|| format!("cannot write {}", out.display()))?;
    Terminal::new(args.quiet).line(&format!(
        "{} obstacles, {}, {}: {} after {:.1} s and {:.1} m, {:.2} m from the nearest -> {}",
        course.cylinders().len(),
        args.sensor.sensor().name(),
        args.method.name(),
        match (flown.success, flown.collided) {
            (true, _) => "arrived",
            (false, true) => "touched an obstacle",
            (false, false) => "gave up",
        },
        flown.time_s,
        flown.path_m,
        flown.min_clearance_m,
        out.display()
    ));
    let rounded = |v: f64| (v * 1e4).round() / 1e4;
    let summary = json!({
        "success": flown.success,
        "collided": flown.collided,
        "timeout": flown.timeout,
        "time_s": rounded(flown.time_s),
        "path_m": rounded(flown.path_m),
        "min_clearance_m": rounded(flown.min_clearance_m),
    });
    // Asked for even when quiet: it is the result.
    Terminal::new(false).line(&summary.to_string());
    // A contact is a result of the evaluation, no failure of it.
    Ok(ExitCode::SUCCESS)
}
