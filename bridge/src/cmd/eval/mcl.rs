//! `kestrel eval mcl`: a recorded log of ranges and odometry through the localization that flies.

mod plot;

use crate::cmd::{Usage, load_plan, settings};
use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use estimator::EstimatorParams;
use estimator::mcl::replay::score::{self, Judged};
use estimator::mcl::replay::{Begin, Log, Placed, Replay, Sensors};
use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _, stderr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use vehicle::{FloorPlan, LocalizationState, MapPose};

/// Localization on a floor plan: ranges and odometry in, poses out.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel eval mcl --map maze.yaml --log flight.csv --sensor tof32 --start known --initial=-0.97,0,0 --out poses.csv\n  kestrel eval mcl --map maze.yaml --log flight.csv --sensor sonar4 --start global --seed 7 --out poses.csv --truth flight_gt.csv --plot flight.svg\n\nLogs are CSV with a header: `node,frame` (tof32, sonar4) or `idx,t_s` (laser, sonar8), `odom_x_m,odom_y_m,odom_yaw_rad`, then\nreadings in mm, -1 without return: f0_mm..f7_mm, b.., l.., r.. (depth along the axis), l0_mm..l59_mm, or s0_mm..s7_mm."
)]
pub(crate) struct MclArgs {
    /// Floor plan (ROS map_server YAML).
    #[arg(long, value_name = "PLAN.yaml")]
    map: PathBuf,
    /// Recorded log.
    #[arg(long, value_name = "LOG.csv")]
    log: PathBuf,
    /// Which readings of the log to use: tof32, sonar4, laser, sonar8.
    #[arg(long, value_name = "NAME", value_parser = Sensors::from_str)]
    sensor: Sensors,
    /// Start at --initial (known), or anywhere on the plan (global).
    #[arg(long, value_enum)]
    start: StartKind,
    /// Pose at the first row, plan metres and radians counter-clockwise; right to within about 0.15 m and 0.1 rad.
    #[arg(long, value_name = "x,y,yaw", allow_hyphen_values = true)]
    initial: Option<PoseArg>,
    /// Seed of all random numbers: same seed, same poses.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Where to write the poses, one row per stop or scan.
    #[arg(long, value_name = "POSES.csv")]
    out: PathBuf,
    /// Poses known better (`node` or `idx`, x_m, y_m, yaw_rad): adds the errors to the summary.
    #[arg(long, value_name = "TRUTH.csv")]
    truth: Option<PathBuf>,
    /// Draw plan and poses.
    #[arg(long, value_name = "PICTURE.svg")]
    plot: Option<PathBuf>,
    /// Write the summary as JSON.
    #[arg(long, value_name = "SUMMARY.json")]
    json: Option<PathBuf>,
    /// Configuration file (TOML).
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set a parameter: NAME=VALUE (repeatable).
    #[arg(long = "param", value_name = "NAME=VALUE")]
    params: Vec<String>,
    /// No progress, no summary.
    #[arg(long)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StartKind {
    Known,
    Global,
}

#[derive(Clone, Copy, Debug)]
struct PoseArg(MapPose);

impl FromStr for PoseArg {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f64> = text
            .split(',')
            .map(|v| v.trim().parse().map_err(|_| format!("`{v}` is no number")))
            .collect::<Result<_, _>>()?;
        match numbers[..] {
            [x, y, yaw] if numbers.iter().all(|v| v.is_finite()) => {
                Ok(Self(MapPose::new(x, y, yaw)))
            }
            _ => Err("three finite numbers are needed: x,y,yaw".to_owned()),
        }
    }
}

pub(crate) fn run(args: &MclArgs) -> Result<ExitCode> {
    let begin = match (args.start, args.initial) {
        (StartKind::Known, Some(PoseArg(pose))) => Begin::At(pose),
        (StartKind::Known, None) => {
            return Err(Usage("--start known needs --initial x,y,yaw".to_owned()).into());
        }
        (StartKind::Global, None) => Begin::Anywhere,
        (StartKind::Global, Some(_)) => {
            return Err(
                Usage("--initial goes with --start known, not with global".to_owned()).into(),
            );
        }
    };
    let settings = settings(args.config.as_deref(), &args.params)?;
    let plan = load_plan(&args.map)?;
    let log = Log::from_csv(&read(&args.log)?, args.sensor)
        .with_context(|| format!("cannot use the log {}", args.log.display()))?;
    let truth = match &args.truth {
        Some(path) => Some(
            Log::truth_from_csv(&read(path)?, args.sensor)
                .with_context(|| format!("cannot use the truth {}", path.display()))?,
        ),
        None => None,
    };
    let placed = place(&settings.estimator, &plan, &log, begin, args);
    write(&args.out, &csv(&placed, args.sensor))?;
    let judged = truth.as_ref().map(|t| score::judge(&placed, t));
    if let Some(path) = &args.plot {
        let title = args.log.file_stem().unwrap_or_default().to_string_lossy();
        let picture = plot::Picture {
            title: &title,
            plan: &plan,
            placed: &placed,
            truth: truth.as_deref(),
        };
        write(path, &picture.svg())?;
    }
    let summary = summary(args, &log, &placed, judged.as_deref());
    if let Some(path) = &args.json {
        write(path, &serde_json::to_string_pretty(&summary)?)?;
    }
    if !args.quiet {
        let mut out = std::io::stdout().lock();
        // A closed pipe is no reason to fail: the files are written.
        let _ = writeln!(out, "{}", words(args, &placed, judged.as_deref()));
    }
    Ok(ExitCode::SUCCESS)
}

fn place(
    params: &EstimatorParams,
    plan: &FloorPlan,
    log: &Log,
    begin: Begin,
    args: &MclArgs,
) -> Vec<Placed> {
    let mut replay = Replay::new(params, plan, begin, args.seed);
    let mut placed = Vec::new();
    let shows = stderr().is_terminal() && !args.quiet;
    for (i, row) in log.rows.iter().enumerate() {
        placed.extend(replay.feed(row));
        if shows && (row.is_key || i + 1 == log.rows.len()) {
            let done = (i + 1) as f64 / log.rows.len() as f64;
            let bar = "#".repeat((done * 40.0) as usize);
            let _ = write!(stderr(), "\r[{bar:<40}] {} {}", args.sensor.key(), row.key);
        }
    }
    if shows {
        let _ = write!(stderr(), "\r\x1b[2K");
    }
    placed
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

fn write(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

const fn word(state: LocalizationState) -> &'static str {
    match state {
        LocalizationState::Off => "off",
        LocalizationState::Searching => "searching",
        LocalizationState::Localized => "localized",
        LocalizationState::Lost => "lost",
    }
}

fn csv(placed: &[Placed], sensors: Sensors) -> String {
    let mut out = format!(
        "{},x_m,y_m,yaw_rad,mass,var_x_m2,cov_xy_m2,cov_xyaw_mrad,var_y_m2,cov_yyaw_mrad,var_yaw_rad2,state,fit,particles\n",
        sensors.key()
    );
    for p in placed {
        let c = &p.covariance;
        // Writing to a String cannot fail.
        let _ = writeln!(
            out,
            "{},{:.5},{:.5},{:.6},{:.4},{:.8},{:.8},{:.8},{:.8},{:.8},{:.8},{},{:.3},{}",
            p.key,
            p.pose.x_m,
            p.pose.y_m,
            p.pose.yaw_rad,
            p.mass,
            c[0][0],
            c[0][1],
            c[0][2],
            c[1][1],
            c[1][2],
            c[2][2],
            word(p.state),
            p.fit,
            p.particles
        );
    }
    out
}

fn summary(
    args: &MclArgs,
    log: &Log,
    placed: &[Placed],
    judged: Option<&[Judged]>,
) -> serde_json::Value {
    let first_claim = placed
        .iter()
        .find(|p| p.mass > score::CLAIM_MASS)
        .map(|p| p.key);
    let mut out = serde_json::json!({
        "map": args.map,
        "log": args.log,
        "sensor": format!("{:?}", args.sensor).to_lowercase(),
        "start": format!("{:?}", args.start).to_lowercase(),
        "seed": args.seed,
        "rows": log.rows.len(),
        "poses": placed.len(),
        "first_claim": first_claim,
        "localized": placed.iter().filter(|p| p.state == LocalizationState::Localized).count(),
    });
    if let (Some(keys), serde_json::Value::Object(map)) = (judged, &mut out) {
        let worst = keys.iter().map(|k| k.error_m).fold(0.0, f64::max);
        map.extend([
            ("judged".to_owned(), keys.len().into()),
            ("ate_rmse_m".to_owned(), score::ate_m(keys).into()),
            (
                "yaw_rmse_deg".to_owned(),
                score::yaw_rms_rad(keys).to_degrees().into(),
            ),
            ("worst_m".to_owned(), worst.into()),
            (
                "converged_at".to_owned(),
                score::converged_at(keys).map(|i| keys[i].placed.key).into(),
            ),
            ("success".to_owned(), score::is_success(keys).into()),
            (
                "wrong_claims".to_owned(),
                keys.iter().filter(|k| k.is_wrong_claim()).count().into(),
            ),
        ]);
    }
    out
}

fn words(args: &MclArgs, placed: &[Placed], judged: Option<&[Judged]>) -> String {
    let mut out = format!("{} poses written to {}", placed.len(), args.out.display());
    if let Some(keys) = judged {
        let _ = write!(
            out,
            "\nATE {:.3} m, yaw {:.2} deg rms, worst {:.2} m over {} poses; {}; {} wrong claims",
            score::ate_m(keys),
            score::yaw_rms_rad(keys).to_degrees(),
            keys.iter().map(|k| k.error_m).fold(0.0, f64::max),
            keys.len(),
            if score::is_success(keys) {
                "success"
            } else {
                "no success"
            },
            keys.iter().filter(|k| k.is_wrong_claim()).count(),
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_three_finite_numbers() {
        let PoseArg(p) = "-0.97, 0.5,3".parse().unwrap();
        assert!((p.x_m + 0.97).abs() < 1e-12 && (p.yaw_rad - 3.0).abs() < 1e-12);
        for wrong in ["1,2", "1,2,3,4", "1,2,x", "1,2,inf", ""] {
            assert!(wrong.parse::<PoseArg>().is_err(), "{wrong}");
        }
    }
}
