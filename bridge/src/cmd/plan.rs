//! `kestrel plan`: a patrol made from a floor plan, as a QGroundControl plan file and a picture.

use super::plan_picture::PlanPicture;
use super::{Usage, rooms};
use anyhow::{Context as _, Result};
use bridge::gcs::convert::GeoAnchor;
use bridge::gcs::mission::CAPACITY;
use bridge::gcs::plan_file::{PlanFile, Step};
use clap::{Args, ValueEnum};
use planner::patrol::{self, Floor, Method, SweepConfig};
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use vehicle::floor_plan::check::check;
use vehicle::{Airframe, FloorPlan, In, Map};

/// Room kept from walls beyond the radius where there is room, m.
const MARGIN_M: f64 = 0.11;

/// Make a patrol from a floor plan: a QGroundControl plan file and a picture.
#[derive(Debug, Args)]
#[command(
    after_help = "The plan file goes up from QGroundControl (Plan view, Open, Upload) or any MAVLink station.\n\n\
    Examples:\n  kestrel plan office -o patrol.plan --picture patrol.svg          every room, by the shortest round\n  \
    kestrel plan office --rounds 5 --hold 3 -o night.plan            five rounds, three seconds in each room\n  \
    kestrel plan plan.yaml --coverage --swath 0.6 -o sweep.plan      every square metre within 0.3 m\n  \
    kestrel plan office --coverage --rooms lab,corridor -o lab.plan  only these"
)]
pub(crate) struct PlanArgs {
    /// A bundled room (see `kestrel rooms`) or the YAML of a floor plan.
    #[arg(value_name = "ROOM|PLAN.yaml")]
    map: String,
    /// Visit every room, by the shortest round (this is the default).
    #[arg(long, conflicts_with = "coverage")]
    patrol: bool,
    /// Sweep the whole floor.
    #[arg(long)]
    coverage: bool,
    /// Width that one pass sweeps, m.
    #[arg(long, value_name = "M", default_value_t = 0.6)]
    swath: f64,
    /// How the floor is swept: parallel lanes, the walk of a spanning tree, or whichever is shorter.
    #[arg(long, value_name = "NAME", default_value = "shorter")]
    method: MethodArg,
    /// Only these rooms.
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    rooms: Vec<String>,
    /// Height above home, m.
    #[arg(long, value_name = "M", default_value_t = 1.0)]
    height: f64,
    /// Speed, m/s; default: the vehicle's own (MPC_XY_CRUISE).
    #[arg(long, value_name = "MPS")]
    speed: Option<f64>,
    /// Stay in each room of a patrol, s.
    #[arg(long, value_name = "S", default_value_t = 2.0)]
    hold: f64,
    /// Rounds of a patrol before it goes home.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    rounds: u32,
    /// File to write (QGroundControl's .plan).
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Picture to write (SVG).
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Set a parameter of the vehicle it is for: KST_LAT0, KST_LON0 ... (repeatable).
    #[arg(long = "param", value_name = "NAME=VALUE")]
    params: Vec<String>,
    /// Configuration file of the vehicle.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// `--method`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MethodArg {
    /// Boustrophedon lanes.
    Lanes,
    /// Spanning tree.
    Tree,
    /// The shorter of both.
    Shorter,
}

/// A mission in the making.
struct Made {
    /// Where to pass, and how long to stay, s.
    waypoints: Vec<(In<Map>, f64)>,
    /// For the picture.
    path: Vec<In<Map>>,
    stops: Vec<(String, In<Map>)>,
    /// What was made, in words.
    words: String,
    rooms: Vec<(String, In<Map>)>,
}

pub(crate) fn run(args: &PlanArgs) -> Result<ExitCode> {
    let settings = super::settings(args.config.as_deref(), &args.params)?;
    let numbers = [
        ("--height", args.height, 0.2, settings.autopilot.ceiling_m),
        ("--hold", args.hold, 0.0, 3600.0),
        ("--speed", args.speed.unwrap_or(0.5), 0.05, 3.0),
    ];
    for (name, value, low, high) in numbers {
        if !(low..=high).contains(&value) {
            return Err(Usage(format!("{name} {value} is outside {low}..={high}")).into());
        }
    }
    let plan = rooms::plan_of(&args.map)?;
    let anchor = plan.anchor();
    let radius_m = Airframe::default().radius_m;
    for finding in check(&plan, radius_m) {
        super::term::warn(&format!("{}: {finding}", args.map));
    }
    let start = anchor.to_map(In::zero());
    let made = if args.coverage {
        sweep(args, &plan, start, radius_m)
    } else {
        visit(args, &plan, start, radius_m)
    }
    .with_context(|| format!("no patrol of {}", args.map))?;

    let ned = |p: &In<Map>| anchor.to_ned(*p).with_z(-args.height);
    let mut steps = vec![Step::Takeoff(args.height)];
    steps.extend(args.speed.map(Step::Speed));
    let first = steps.len();
    steps.extend(
        made.waypoints
            .iter()
            .map(|(p, hold_s)| Step::Waypoint(ned(p), *hold_s)),
    );
    if args.rounds > 1 {
        steps.push(Step::Jump(first, args.rounds - 1));
    }
    steps.push(Step::Return);
    if steps.len() > usize::from(CAPACITY) {
        return Err(Usage(format!(
            "the mission has {} items, {CAPACITY} fit: sweep some of the rooms (--rooms), or a wider swath (--swath)",
            steps.len()
        ))
        .into());
    }
    let items = steps.len();
    let no_fly: Vec<Vec<_>> = plan
        .no_fly
        .iter()
        .map(|zone| {
            let corner = |[x, y]: &[f64; 2]| anchor.to_ned(In::new(*x, *y, 0.0));
            zone.iter().map(corner).collect()
        })
        .collect();
    let geo = GeoAnchor::from_params(&settings.ground);
    let file = PlanFile {
        rooms: made
            .rooms
            .iter()
            .map(|(n, p)| (n.clone(), ned(p)))
            .collect(),
        cruise_mps: Some(args.speed.unwrap_or(settings.planner.cruise_mps)),
        ..PlanFile::from_steps(&steps, &no_fly, &geo)
    };
    std::fs::write(&args.out, file.to_json())
        .with_context(|| format!("cannot write {}", args.out.display()))?;
    let mut out = std::io::stdout().lock();
    let _ = writeln!(out, "{}", made.words);
    let _ = writeln!(out, "wrote {} ({items} items)", args.out.display());
    if let Some(path) = &args.picture {
        let title = format!("{}: {}", args.map, made.words.lines().next().unwrap_or(""));
        let picture = PlanPicture {
            title: &title,
            plan: &plan,
            path: &made.path,
            stops: &made.stops,
            swath_m: if args.coverage { args.swath } else { 0.0 },
        };
        std::fs::write(path, picture.svg())
            .with_context(|| format!("cannot write {}", path.display()))?;
        let _ = writeln!(out, "wrote {}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

fn visit(args: &PlanArgs, plan: &FloorPlan, start: In<Map>, radius_m: f64) -> Result<Made> {
    let floor = Floor::new(plan, start, radius_m, MARGIN_M, 0.3)?;
    let places = patrol::places(&floor, plan, &args.rooms)?;
    let round = patrol::round(&floor, &places)?;
    let names: Vec<&str> = round.places.iter().map(|p| p.name.as_str()).collect();
    let mps = args.speed.unwrap_or(0.7);
    let idle_s = round.length_m / mps + args.hold * names.len() as f64;
    Ok(Made {
        waypoints: round.places.iter().map(|p| (p.at, args.hold)).collect(),
        path: round.ways.concat(),
        stops: round
            .places
            .iter()
            .zip(1..)
            .map(|(p, k): (_, usize)| (k.to_string(), p.at))
            .collect(),
        words: format!(
            "{} rooms, {:.1} m a round: {}\neach room is left alone for about {idle_s:.0} s",
            names.len(),
            round.length_m,
            names.join(", ")
        ),
        rooms: round
            .places
            .iter()
            .map(|p| (p.name.clone(), p.at))
            .collect(),
    })
}

fn sweep(args: &PlanArgs, plan: &FloorPlan, start: In<Map>, radius_m: f64) -> Result<Made> {
    let config = SweepConfig {
        radius_m,
        margin_m: MARGIN_M,
        swath_m: args.swath,
        rooms: args.rooms.clone(),
    };
    let methods: &[Method] = match args.method {
        MethodArg::Lanes => &[Method::Boustrophedon],
        MethodArg::Tree => &[Method::SpanningTree],
        MethodArg::Shorter => &[Method::Boustrophedon, Method::SpanningTree],
    };
    let mut best: Option<patrol::Sweep> = None;
    for method in methods {
        let swept = patrol::sweep(plan, start, &config, *method)?;
        if best.as_ref().is_none_or(|b| swept.length_m < b.length_m) {
            best = Some(swept);
        }
    }
    let swept = best.context("no method")?;
    Ok(Made {
        waypoints: swept.path.iter().skip(1).map(|p| (*p, 0.0)).collect(),
        words: format!(
            "{:.1} % of {:.1} m2 swept by a path of {:.1} m ({:.2} x area by swath)",
            100.0 * swept.covered,
            swept.area_m2,
            swept.length_m,
            swept.length_m / swept.bound_m
        ),
        path: swept.path,
        stops: Vec::new(),
        rooms: Vec::new(),
    })
}
