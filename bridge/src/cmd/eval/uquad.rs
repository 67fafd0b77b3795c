//! `kestrel eval uquad`: a recorded `imu_raw` log through conversion, filter and law, every stage as CSV.

mod report;

use super::super::Usage;
use super::super::term::{Terminal, complain};
use super::super::uquad::{Order, States};
use super::progress::Progress;
use anyhow::{Context as _, Result, bail};
use bridge::io::clock::Clock;
use bridge::sensor::gps::fake::Fake;
use bridge::sensor::gps::log as gps_log;
use bridge::uquad::{Said, Start, Step, Uquad, UquadConfig, speed_range};
use clap::{Args, ValueEnum};
use control::integral::IntegralAction;
use control::proportional::Gains;
use estimator::imu::fir::Fir;
use estimator::imu::replay::{LogRow, Replay, Speed};
use estimator::imu::{Calibration, RawFrame, Smoothing, ascii};
use estimator::thesis::StateSet;
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vehicle::{GnssFix, Timestamp};

/// Complaints of one kind that are printed; the rest is counted.
const SHOWN: usize = 5;

/// Run a recorded uQuad log through conversion, filter and control law.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel eval uquad --raw imu_raw.log --calib imu_calib.txt --legacy --out run/\n  kestrel eval uquad --raw imu_raw.log --calib imu_calib.txt --calibration-frames 200 --out run/\n\nWrites to the folder: kalman_in.csv (converted), x_hat.csv (filter), w.csv (motor speeds), uquad.svg, summary.json.\nThe log is imu_raw (14 columns) or text frames of the board (A ... Z)."
)]
pub(crate) struct UquadArgs {
    /// Recorded frames.
    #[arg(long, value_name = "FILE")]
    raw: PathBuf,
    /// Calibration file.
    #[arg(long, value_name = "FILE")]
    calib: PathBuf,
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write the streams as a flight log too (MCAP); `kestrel log export --format uquad` makes uQuad's text files of it again.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Arithmetic, constants and law of the run of 23 March 2012, misprints and all, from row 200 on.
    #[arg(long)]
    legacy: bool,
    /// First row of the filter, with --legacy (default 200).
    #[arg(long, value_name = "ROW", requires = "legacy")]
    start: Option<u32>,
    /// Pressure of height zero in Pa, with --legacy (default 101205).
    #[arg(long, value_name = "PA", requires = "legacy")]
    p0: Option<f64>,
    /// Frames of the start-up calibration (default 512).
    #[arg(long, value_name = "N", conflicts_with = "legacy")]
    calibration_frames: Option<u32>,
    /// Height of the floor at the start, m.
    #[arg(long, value_name = "M", conflicts_with = "legacy")]
    start_altitude: Option<f64>,
    /// Declination, degrees, added to the heading counter-clockwise (Uruguay 2012: 9.78).
    #[arg(
        long,
        value_name = "DEG",
        conflicts_with = "legacy",
        allow_hyphen_values = true
    )]
    declination: Option<f64>,
    /// Filter coefficients, the newest frame first.
    #[arg(
        long,
        value_name = "C,C,...",
        value_delimiter = ',',
        conflicts_with = "legacy",
        allow_hyphen_values = true
    )]
    fir: Vec<f64>,
    /// Frames kept in the ring, more than the filter takes, 32 at most.
    #[arg(long, value_name = "N", conflicts_with = "legacy")]
    ring: Option<usize>,
    /// Mass, kg.
    #[arg(long, value_name = "KG", conflicts_with = "legacy")]
    mass: Option<f64>,
    /// Moments of inertia about x and y, and about z, kg m2.
    #[arg(
        long,
        value_name = "XY,Z",
        value_delimiter = ',',
        num_args = 1,
        conflicts_with = "legacy"
    )]
    inertia: Vec<f64>,
    /// Estimated states.
    #[arg(long, value_name = "N", conflicts_with = "legacy")]
    states: Option<States>,
    /// Position fixes: off, zeros, random (once a second), or a GPS log, replayed by its own time.
    #[arg(
        long,
        value_name = "SOURCE",
        default_value = "off",
        conflicts_with = "legacy"
    )]
    gps: String,
    /// Frames for each action of the control law.
    #[arg(long, value_name = "N", conflicts_with = "legacy")]
    frames_per_action: Option<u32>,
    /// Write these logs only: kalman_in, x_hat, w (summary.json always).
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    logs: Vec<Log>,
    /// No accelerometer biases.
    #[arg(long, conflicts_with = "legacy")]
    no_bias: bool,
    /// Angles' noise that does not follow the norms.
    #[arg(long, conflicts_with = "legacy")]
    static_covariance: bool,
    /// Proportional gains, 4 x 12 or 4 x 8 numbers.
    #[arg(long, value_name = "FILE", conflicts_with = "legacy")]
    gains: Option<PathBuf>,
    /// Integral gains, 4 x 4 numbers.
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "legacy",
        requires = "integral_columns"
    )]
    integral: Option<PathBuf>,
    /// What the columns of the integral gains are; files differ in spite of their names.
    #[arg(long, value_name = "ORDER")]
    integral_columns: Option<Order>,
    /// As slow as it was recorded.
    #[arg(long)]
    real_time: bool,
    /// Only the files.
    #[arg(long, short)]
    quiet: bool,
}

/// A log of the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Log {
    /// Converted readings.
    #[value(name = "kalman_in")]
    KalmanIn,
    /// The estimate.
    #[value(name = "x_hat")]
    XHat,
    /// Motor speeds.
    #[value(name = "w")]
    W,
}

impl Log {
    const fn file(self) -> &'static str {
        match self {
            Self::KalmanIn => "kalman_in.csv",
            Self::XHat => "x_hat.csv",
            Self::W => "w.csv",
        }
    }
}

/// Where position fixes come from.
enum Gps {
    Off,
    Fake(Fake),
    Log(gps_log::Log),
}

impl Gps {
    fn poll(&mut self, now: Timestamp) -> Option<GnssFix> {
        match self {
            Self::Off => None,
            Self::Fake(fake) => fake.poll(now),
            Self::Log(log) => log.poll(now),
        }
    }
}

impl UquadArgs {
    fn gps(&self) -> Result<Gps> {
        let source = match self.gps.as_str() {
            "off" => return Ok(Gps::Off),
            "zeros" => Gps::Fake(Fake::new(false, 1)),
            "random" => Gps::Fake(Fake::new(true, 1)),
            path => Gps::Log(gps_log::Log::from_text(&read(Path::new(path), "GPS log")?)?),
        };
        if matches!(self.states, Some(States::Eight)) {
            bail!(Usage(format!(
                "--gps {} and --states 8: a fix is a horizontal position, which 8 states do not have; estimate 12 or leave --gps off",
                self.gps
            )));
        }
        Ok(source)
    }

    fn config(&self) -> Result<UquadConfig> {
        if self.legacy {
            let mut config = UquadConfig::march_2012();
            if let Start::AtFrame {
                frame,
                reference_pa,
            } = &mut config.start
            {
                *frame = self.start.unwrap_or(*frame);
                *reference_pa = self.p0.unwrap_or(*reference_pa);
                if !(30_000.0..=110_000.0).contains(reference_pa) {
                    bail!(Usage(format!(
                        "--p0 {reference_pa}: a pressure in Pa, 30000-110000"
                    )));
                }
            }
            return Ok(config);
        }
        let mut config = UquadConfig::corrected();
        let imu = &mut config.imu;
        imu.calibration_frames = self.calibration_frames.unwrap_or(imu.calibration_frames);
        imu.start_altitude_m = self.start_altitude.unwrap_or(0.0);
        imu.declination_rad = self.declination.unwrap_or(0.0).to_radians();
        if !self.fir.is_empty() {
            let fir = Fir::new(&self.fir).map_err(|e| Usage(format!("--fir: {e}")))?;
            imu.smoothing = Smoothing::Fir(fir);
        }
        imu.ring_frames = self.ring.unwrap_or(imu.ring_frames);
        let filter = &mut config.filter;
        filter.craft.mass_kg = self.mass.unwrap_or(filter.craft.mass_kg);
        if let [xy, z] = self.inertia[..] {
            // False for NaN.
            if !(xy > 0.0 && z > 0.0 && xy < 10.0 && z < 10.0) {
                bail!(Usage(format!("--inertia {xy},{z}: both within 0-10 kg m2")));
            }
            (filter.craft.inertia_xy, filter.craft.inertia_z) = (xy, z);
        }
        config.steps_per_action = self.frames_per_action.unwrap_or(1);
        filter.has_bias = !self.no_bias;
        filter.noise.is_dynamic = !self.static_covariance;
        if matches!(self.states, Some(States::Eight)) {
            filter.states = StateSet::Reduced;
        }
        config.hover_radps = filter.craft.hover_speed_radps();
        config.first_speeds_radps = config.hover_radps;
        config.speed_range_radps = speed_range(config.hover_radps);
        if let Some(path) = &self.gains {
            config.gains = Gains::parse(&read(path, "gains")?)
                .with_context(|| format!("cannot use the gains {}", path.display()))?;
        }
        if let (Some(path), Some(order)) = (&self.integral, self.integral_columns) {
            let action = IntegralAction::parse(&read(path, "integral gains")?, order.columns())
                .with_context(|| format!("cannot use the integral gains {}", path.display()))?;
            config.integral = Some(action);
        }
        Ok(config)
    }
}

fn read(path: &Path, what: &str) -> Result<String> {
    std::fs::read_to_string(path)
        .with_context(|| format!("cannot read the {what} {}", path.display()))
}

/// What came of a log.
struct Outcome {
    frames: usize,
    refused_rows: Vec<String>,
    steps: Vec<Step>,
    said: Vec<(usize, Said)>,
    is_stopped: bool,
}

pub(crate) fn run(args: &UquadArgs) -> Result<ExitCode> {
    let config = args.config()?;
    let gps = args.gps()?;
    let calibration = Calibration::parse(&read(&args.calib, "calibration")?)
        .with_context(|| format!("cannot use the calibration {}", args.calib.display()))?;
    let (rows, refused_rows) = read_rows(&read(&args.raw, "log")?);
    let frames: Vec<RawFrame> = rows.iter().map(|row| row.frame).collect();
    let mut terminal = Terminal::new(args.quiet);
    for row in refused_rows.iter().take(SHOWN) {
        terminal.line(&format!("not used: {row}"));
    }
    if frames.is_empty() {
        bail!("{} has no usable row", args.raw.display());
    }
    let needed = match config.start {
        Start::AtFrame { frame, .. } => frame as usize + 1,
        Start::Calibrated => config.imu.calibration_frames as usize,
    };
    if frames.len() < needed {
        let remedy = match config.start {
            Start::AtFrame { .. } => "--start ROW begins earlier",
            Start::Calibrated => "--calibration-frames N takes fewer",
        };
        bail!(
            "{} has {} usable rows, {needed} are needed before the filter starts: {remedy}",
            args.raw.display(),
            frames.len()
        );
    }
    let uquad = Uquad::new(calibration, config).map_err(|e| Usage(e.to_string()))?;
    let outcome = replay(args, uquad, gps, frames, refused_rows);
    for (row, said) in outcome.said.iter().take(SHOWN) {
        terminal.line(&format!("row {row}: {said}"));
    }
    if outcome.steps.is_empty() {
        bail!("the craft never stood still for long enough: no calibration, no estimate");
    }
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make {}", args.out.display()))?;
    report::write(args, &outcome)?;
    if let Some(path) = &args.log {
        let bytes = report::log(args, &rows, &outcome)?;
        std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    }
    terminal.line(&format!(
        "{} frames, {} estimates, {} rows not used, {} remarks: {}",
        outcome.frames,
        outcome.steps.len(),
        outcome.refused_rows.len(),
        outcome.said.len(),
        args.out.display()
    ));
    if outcome.is_stopped {
        complain("stopped before the end: ten timing errors (see summary.json)");
        return Ok(ExitCode::FAILURE);
    }
    Ok(ExitCode::SUCCESS)
}

/// Rows of a log in either format, and the lines that are none with their reasons. Text frames of the board carry no host
/// time: theirs is the board's.
pub(super) fn read_rows(text: &str) -> (Vec<LogRow>, Vec<String>) {
    let mut rows = Vec::new();
    let mut board_us = 0;
    let mut refused = Vec::new();
    let mut before: Option<LogRow> = None;
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() {
            continue;
        }
        let answer = if line.starts_with(['A', 'C']) {
            ascii::parse_line(line)
                .map(|frame| {
                    board_us += u64::from(frame.since_previous_us);
                    LogRow {
                        host_us: board_us,
                        frame,
                    }
                })
                .map_err(|e| e.to_string())
        } else {
            LogRow::parse(line)
                .and_then(|row| {
                    before.map_or(Ok(()), |b| row.follows(&b))?;
                    before = Some(row);
                    Ok(row)
                })
                .map_err(|e| e.to_string())
        };
        match answer {
            Ok(row) => rows.push(row),
            Err(why) => refused.push(format!("line {}: {why}", number + 1)),
        }
    }
    (rows, refused)
}

fn replay(
    args: &UquadArgs,
    mut uquad: Uquad,
    mut gps: Gps,
    frames: Vec<RawFrame>,
    refused_rows: Vec<String>,
) -> Outcome {
    let speed = if args.real_time {
        Speed::RealTime
    } else {
        Speed::AsFastAsPossible
    };
    let mut outcome = Outcome {
        frames: frames.len(),
        refused_rows,
        steps: Vec::with_capacity(frames.len()),
        said: Vec::new(),
        is_stopped: false,
    };
    let mut progress = Progress::new(args.quiet);
    let clock = Clock::start(1.0);
    let mut replay = Replay::new(frames, speed, Timestamp::ZERO);
    while let Some(due) = replay.deadline() {
        if args.real_time {
            wait(&clock, due);
        }
        while let Some((at, frame)) = replay.poll(clock.now()) {
            let (done, all) = replay.progress();
            if let Some(fix) = gps.poll(at) {
                let [north, east, down] = fix.position.into();
                uquad.fix(Vector3::new(east, north, -down));
            }
            let said = &mut outcome.said;
            let step = uquad.frame(at, frame, &mut |s| said.push((done - 1, s)));
            outcome.steps.extend(step);
            progress.show(done, all);
        }
    }
    progress.finish();
    outcome.is_stopped = uquad.is_stopped();
    outcome
}

#[expect(
    clippy::disallowed_methods,
    reason = "a log replayed in real time has nothing else to wait for"
)]
fn wait(clock: &Clock, due: Timestamp) {
    std::thread::sleep(clock.until(due));
}

#[cfg(test)]
mod tests;
