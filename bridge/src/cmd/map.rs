//! `kestrel map`: floor plans shown, checked, and made from drawings.

use super::plan_picture::PlanPicture;
use super::{Usage, rooms, term};
use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use vehicle::floor_plan::Cell;
use vehicle::floor_plan::check::check;
use vehicle::floor_plan::drawing::{Marks, Pixel, from_drawing};
use vehicle::{Airframe, FloorPlan};

/// Show, check and import floor plans.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel map show office --picture office.svg\n  kestrel map check plan.yaml\n  \
    kestrel map import scan.png --scale 120,80,920,80,10.0 --home 300,400 --room lab,310,420 --room hall,600,420 \\\n      \
    --door lab-hall,450,400,450,436 --no-fly 700,100,760,160 --rubber 20,20,220,60 -o plans/ground.yaml"
)]
pub(crate) struct MapArgs {
    #[command(subcommand)]
    command: MapCommand,
}

#[derive(Debug, Subcommand)]
enum MapCommand {
    /// Size, rooms, doors and zones of a floor plan.
    Show(ShowArgs),
    /// What is wrong with a floor plan: walls that do not close, rooms no door reaches. Exit code 1 if anything is.
    Check(CheckArgs),
    /// Make a floor plan from a drawing or a scan (PNG or PGM) and marks on it.
    Import(Box<ImportArgs>),
}

#[derive(Debug, Args)]
struct ShowArgs {
    /// A bundled room or the YAML of a floor plan.
    #[arg(value_name = "ROOM|PLAN.yaml")]
    map: String,
    /// Picture to write (SVG).
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct CheckArgs {
    /// A bundled room or the YAML of a floor plan.
    #[arg(value_name = "ROOM|PLAN.yaml")]
    map: String,
    /// Radius of the vehicle, m.
    #[arg(long, value_name = "M", default_value_t = Airframe::default().radius_m)]
    radius: f64,
}

/// Marks are in pixels of the drawing, x to the right, y down from its upper left corner.
#[derive(Debug, Args)]
struct ImportArgs {
    /// The drawing: dark walls on light paper.
    drawing: PathBuf,
    /// Two points and the metres between them.
    #[arg(long, value_name = "x1,y1,x2,y2,METRES", allow_hyphen_values = true)]
    scale: Numbers,
    /// Direction of north, degrees counter-clockwise from the right edge; 90 is up.
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 90.0,
        allow_hyphen_values = true
    )]
    north: f64,
    /// Take-off place, and heading in degrees counter-clockwise from the right edge (default: north).
    #[arg(long, value_name = "x,y[,DEG]", allow_hyphen_values = true)]
    home: Option<Numbers>,
    /// A room: its name and a point in it (repeatable).
    #[arg(long, value_name = "NAME,x,y")]
    room: Vec<Named>,
    /// A door: its name and its two jambs; what stands between them is opened (repeatable).
    #[arg(long, value_name = "NAME,x1,y1,x2,y2")]
    door: Vec<Named>,
    /// A wall that the drawing lacks (repeatable).
    #[arg(long, value_name = "x1,y1,x2,y2")]
    wall: Vec<Numbers>,
    /// A zone not to fly over: two opposite corners, or three and more (repeatable).
    #[arg(long, value_name = "x1,y1,x2,y2[,...]")]
    no_fly: Vec<Numbers>,
    /// Rubber: an area whose marks are no walls (words, furniture, dimension lines); corners as for --no-fly (repeatable).
    #[arg(long, value_name = "x1,y1,x2,y2[,...]")]
    rubber: Vec<Numbers>,
    /// Darker than this is wall: 0 black, 255 white.
    #[arg(long, value_name = "GREY", default_value_t = 128)]
    threshold: u8,
    /// Cells of the plan, m.
    #[arg(long, value_name = "M", default_value_t = 0.05)]
    resolution: f64,
    /// Marks smaller than this that touch nothing are no walls, m.
    #[arg(long, value_name = "M", default_value_t = 0.15)]
    speck: f64,
    /// The plan to write: NAME.yaml, and NAME.pgm beside it.
    #[arg(short, long, value_name = "NAME.yaml")]
    out: PathBuf,
    /// Picture of what was understood (SVG).
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

/// Numbers between commas.
#[derive(Clone, Debug)]
struct Numbers(Vec<f64>);

impl FromStr for Numbers {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let number = |v: &str| v.trim().parse().ok().filter(|v: &f64| v.is_finite());
        s.split(',')
            .map(number)
            .collect::<Option<Vec<_>>>()
            .map(Self)
            .ok_or_else(|| format!("`{s}`: numbers between commas"))
    }
}

/// A name and numbers between commas.
#[derive(Clone, Debug)]
struct Named(String, Vec<f64>);

impl FromStr for Named {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let (name, rest) = s
            .split_once(',')
            .filter(|(name, _)| !name.trim().is_empty())
            .ok_or_else(|| format!("`{s}`: a name, then numbers between commas"))?;
        Ok(Self(name.trim().to_owned(), rest.parse::<Numbers>()?.0))
    }
}

pub(crate) fn run(args: MapArgs) -> Result<ExitCode> {
    match args.command {
        MapCommand::Show(args) => show(&args),
        MapCommand::Check(args) => {
            let plan = rooms::plan_of(&args.map)?;
            Ok(if report(&args.map, &plan, args.radius) == 0 {
                let _ = writeln!(std::io::stdout(), "{}: nothing wrong", args.map);
                ExitCode::SUCCESS
            } else {
                ExitCode::FAILURE
            })
        }
        MapCommand::Import(args) => import(&args),
    }
}

/// Says what is wrong; returns how much.
fn report(name: &str, plan: &FloorPlan, radius_m: f64) -> usize {
    let found = check(plan, radius_m);
    for finding in &found {
        term::warn(&format!("{name}: {finding}"));
    }
    found.len()
}

fn show(args: &ShowArgs) -> Result<ExitCode> {
    let plan = rooms::plan_of(&args.map)?;
    describe(&args.map, &plan);
    if let Some(path) = &args.picture {
        write_picture(&args.map, &plan, path)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn describe(name: &str, plan: &FloorPlan) {
    let mut out = std::io::stdout().lock();
    let cell_m2 = plan.resolution_m() * plan.resolution_m();
    let free = plan.cells().iter().filter(|c| **c == Cell::Free).count();
    let _ = writeln!(
        out,
        "{name}: {:.1} x {:.1} m in cells of {} m, {:.1} m2 of free floor, north {:.0} deg",
        plan.width() as f64 * plan.resolution_m(),
        plan.height() as f64 * plan.resolution_m(),
        plan.resolution_m(),
        free as f64 * cell_m2,
        plan.north_rad.to_degrees(),
    );
    if let Some(h) = plan.home {
        let _ = writeln!(
            out,
            "  home          {:7.2} {:7.2}  heading {:.0} deg",
            h.x_m,
            h.y_m,
            h.yaw_rad.to_degrees()
        );
    }
    for r in &plan.rooms {
        let _ = writeln!(out, "  room {:<12} {:7.2} {:7.2}", r.name, r.x, r.y);
    }
    for d in &plan.doors {
        let width = libm::hypot(d.b[0] - d.a[0], d.b[1] - d.a[1]);
        let _ = writeln!(out, "  door {:<12} {width:7.2} m wide", d.name);
    }
    for z in &plan.no_fly {
        let _ = writeln!(out, "  no-fly zone of {} corners", z.len());
    }
}

fn write_picture(name: &str, plan: &FloorPlan, path: &Path) -> Result<()> {
    let picture = PlanPicture {
        title: name,
        plan,
        path: &[],
        stops: &[],
        swath_m: 0.0,
    };
    std::fs::write(path, picture.svg())
        .with_context(|| format!("cannot write {}", path.display()))?;
    let _ = writeln!(std::io::stdout(), "wrote {}", path.display());
    Ok(())
}

impl ImportArgs {
    fn marks(&self) -> Result<Marks> {
        let wrong = |what: &str, want: &str| Usage(format!("{what}: write it like {want}"));
        let [x1, y1, x2, y2, metres] = self.scale.0[..] else {
            return Err(wrong("--scale", "x1,y1,x2,y2,METRES").into());
        };
        let home = match self.home.as_ref().map(|h| &h.0[..]) {
            None => None,
            Some([x, y]) => Some(([*x, *y], self.north)),
            Some([x, y, deg]) => Some(([*x, *y], *deg)),
            Some(_) => return Err(wrong("--home", "x,y or x,y,DEG").into()),
        };
        let pair = |n: &Numbers| match n.0[..] {
            [a, b, c, d] => Ok(([a, b], [c, d])),
            _ => Err(wrong("--wall", "x1,y1,x2,y2")),
        };
        let area = |n: &Numbers, what: &str| -> Result<Vec<Pixel>, Usage> {
            if n.0.len() < 4 || n.0.len() % 2 == 1 {
                return Err(wrong(what, "x1,y1,x2,y2[,x3,y3,...]"));
            }
            Ok(n.0.chunks_exact(2).map(|p| [p[0], p[1]]).collect())
        };
        Ok(Marks {
            resolution_m: self.resolution,
            threshold: self.threshold,
            north_deg: self.north,
            home,
            rooms: self
                .room
                .iter()
                .map(|Named(name, n)| match n[..] {
                    [x, y] => Ok((name.clone(), [x, y])),
                    _ => Err(wrong("--room", "NAME,x,y")),
                })
                .collect::<Result<_, _>>()?,
            doors: self
                .door
                .iter()
                .map(|Named(name, n)| match n[..] {
                    [a, b, c, d] => Ok((name.clone(), [a, b], [c, d])),
                    _ => Err(wrong("--door", "NAME,x1,y1,x2,y2")),
                })
                .collect::<Result<_, _>>()?,
            walls: self.wall.iter().map(pair).collect::<Result<_, _>>()?,
            no_fly: self
                .no_fly
                .iter()
                .map(|n| area(n, "--no-fly"))
                .collect::<Result<_, _>>()?,
            erased: self
                .rubber
                .iter()
                .map(|n| area(n, "--rubber"))
                .collect::<Result<_, _>>()?,
            speck_m: self.speck,
            ..Marks::new([x1, y1], [x2, y2], metres)
        })
    }
}

fn import(args: &ImportArgs) -> Result<ExitCode> {
    let marks = args.marks()?;
    let bytes = std::fs::read(&args.drawing)
        .with_context(|| format!("cannot read {}", args.drawing.display()))?;
    let plan = from_drawing(&bytes, &marks)
        .with_context(|| format!("cannot use {}", args.drawing.display()))?;
    let stem = args
        .out
        .file_stem()
        .and_then(|s| s.to_str())
        .filter(|_| {
            args.out
                .extension()
                .is_some_and(|e| e == "yaml" || e == "yml")
        })
        .ok_or_else(|| Usage(format!("-o {}: it must end in .yaml", args.out.display())))?;
    let image = format!("{stem}.pgm");
    let folder = args.out.parent().unwrap_or_else(|| Path::new(""));
    if !folder.as_os_str().is_empty() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
    }
    let write = |path: &Path, bytes: &[u8]| {
        std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
    };
    write(&folder.join(&image), &plan.to_pgm())?;
    write(&args.out, plan.to_yaml(&image).as_bytes())?;
    let name = args.out.display().to_string();
    describe(&name, &plan);
    let warnings = report(&name, &plan, Airframe::default().radius_m);
    if let Some(path) = &args.picture {
        write_picture(&name, &plan, path)?;
    }
    let _ = writeln!(
        std::io::stdout(),
        "wrote {name} and {image}{}",
        match warnings {
            0 => String::new(),
            1 => ", with a warning: see above".to_owned(),
            n => format!(", with {n} warnings: see above"),
        }
    );
    Ok(ExitCode::SUCCESS)
}
