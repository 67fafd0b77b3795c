//! `kestrel eval attitude`: the attitude estimator on a recording of gyro, accelerometer and magnetometer.

use super::chart::{self, Panel};
use super::progress::Progress;
use crate::cmd::Usage;
use crate::cmd::term::Terminal;
use anyhow::{Context as _, Result};
use clap::Args;
use estimator::attitude::score::{AttitudeError, AttitudeScore};
use estimator::attitude::{AttitudeEstimator, AttitudeParams, MargSample};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vehicle::Timestamp;

/// Bytes of a row: nine little-endian float32.
const ROW_BYTES: usize = 36;
/// Sample rates that make sense, Hz: below, the trapezoid means nothing; above, stamps of a microsecond collide.
const RATES_HZ: std::ops::RangeInclusive<f64> = 20.0..=20_000.0;
/// Points in the picture; more would only make it larger.
const PICTURE_POINTS: usize = 1500;

/// Attitude of a 9-axis sensor.
///
/// Reads rows of nine little-endian float32: gyro x y z [rad/s], accelerometer x y z [m/s2, +g up at rest], magnetometer x y z
/// [any unit]. Writes sample,qw,qx,qy,qz: the rotation from the sensor's frame to east, north, up (magnetic north).
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel eval attitude --imu log.imu.f32 --rate 285.714 --out est.csv\n  kestrel eval attitude --imu log.imu.f32 --rate 285.714 --out est.csv --ref log.ref.csv --svg est.svg --json est.json"
)]
pub(crate) struct AttitudeArgs {
    /// The recording.
    #[arg(long, value_name = "FILE")]
    imu: PathBuf,
    /// Its sample rate.
    #[arg(long, value_name = "HZ")]
    rate: f64,
    /// Where the attitude goes (CSV).
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Write every Nth sample.
    #[arg(long, value_name = "N", default_value_t = 10)]
    every: usize,
    /// Truth to score against: sample,qw,qx,qy,qz and optionally moving (rows with 1 count).
    #[arg(long = "ref", value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Picture of angles, biases and (with --ref) errors.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Summary: errors, biases, what was refused.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Delay of the inertial sensor's low-pass, ms.
    #[arg(long, value_name = "MS")]
    sensor_delay: Option<f64>,
    /// No words, no progress bar.
    #[arg(long, short)]
    quiet: bool,
}

/// A row of the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reference {
    sample: usize,
    imu_to_enu: UnitQuaternion<f64>,
    is_moving: bool,
}

/// What is drawn, one entry per point.
#[derive(Default)]
struct Curves {
    time_s: Vec<f64>,
    angles_deg: [Vec<f64>; 3],
    bias_dps: [Vec<f64>; 3],
    errors: Vec<(f64, AttitudeError)>,
}

pub(crate) fn run(args: &AttitudeArgs) -> Result<ExitCode> {
    if !RATES_HZ.contains(&args.rate) {
        return Err(Usage(format!(
            "--rate {} is outside {}..={} Hz",
            args.rate,
            RATES_HZ.start(),
            RATES_HZ.end()
        ))
        .into());
    }
    if args.every == 0 {
        return Err(Usage("--every 0: write at least every sample (1)".to_owned()).into());
    }
    let mut params = AttitudeParams::default();
    if let Some(ms) = args.sensor_delay {
        if !(0.0..=50.0).contains(&ms) {
            return Err(Usage(format!("--sensor-delay {ms} is outside 0..=50 ms")).into());
        }
        params.sensor_delay_s = ms * 1e-3;
    }
    let bytes =
        std::fs::read(&args.imu).with_context(|| format!("cannot read {}", args.imu.display()))?;
    let rows = rows(&bytes).with_context(|| format!("in {}", args.imu.display()))?;
    let reference = match &args.reference {
        Some(path) => read_reference(path)?,
        None => Vec::new(),
    };

    let mut terminal = Terminal::new(args.quiet);
    let mut progress = Progress::new(args.quiet);
    let mut estimator = AttitudeEstimator::new(params);
    let mut score = AttitudeScore::default();
    let mut truth = reference.iter().peekable();
    let mut csv = String::from("sample,qw,qx,qy,qz\n");
    let mut curves = Curves::default();
    let stride = rows.len().div_ceil(PICTURE_POINTS);
    for (row, values) in rows.iter().enumerate() {
        estimator.update(&sample(row, values, args.rate));
        let q = estimator.imu_to_enu();
        if row % args.every == 0 {
            // Writing to a String cannot fail.
            let _ = writeln!(csv, "{row},{:.9},{:.9},{:.9},{:.9}", q.w, q.i, q.j, q.k);
        }
        while truth.next_if(|r| r.sample < row).is_some() {}
        if let Some(r) = truth.next_if(|r| r.sample == row) {
            let error = AttitudeError::between(&q, &r.imu_to_enu);
            if r.is_moving {
                score.add(&error);
            }
            curves.errors.push((row as f64 / args.rate, error));
        }
        if row % stride == 0 {
            curves.push(row as f64 / args.rate, &estimator);
        }
        progress.show(row + 1, rows.len());
    }
    progress.finish();
    write(&args.out, &csv)?;
    let status = estimator.status();
    terminal.line(&format!(
        "{} samples, {:.1} s: {} used, {} refused, {} clipped, {} gaps -> {}",
        rows.len(),
        rows.len() as f64 / args.rate,
        status.accepted,
        status.refused,
        status.saturated,
        status.gaps,
        args.out.display()
    ));
    if args.reference.is_some() {
        let rms = score.rms().with_context(
            || "the reference has no moving row that belongs to a sample of the recording",
        )?;
        terminal.line(&format!(
            "RMSE of {} moving rows: total {:.3} deg, heading {:.3} deg, inclination {:.3} deg",
            score.rows(),
            rms.total_rad.to_degrees(),
            rms.heading_rad.to_degrees(),
            rms.inclination_rad.to_degrees()
        ));
    }
    if let Some(path) = &args.json {
        let text = summary(args, rows.len(), &estimator, &score);
        write(path, &format!("{text:#}\n"))?;
    }
    if let Some(path) = &args.svg {
        write(path, &curves.svg(&args.imu))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn write(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// The recording's rows of nine numbers.
fn rows(bytes: &[u8]) -> Result<Vec<[f64; 9]>> {
    anyhow::ensure!(
        !bytes.is_empty() && bytes.len().is_multiple_of(ROW_BYTES),
        "{} bytes are no whole number of rows of nine float32 ({ROW_BYTES} bytes)",
        bytes.len()
    );
    let rows = bytes.chunks_exact(ROW_BYTES).map(|row| {
        let mut values = [0.0; 9];
        for (value, bytes) in values.iter_mut().zip(row.as_chunks::<4>().0) {
            *value = f64::from(f32::from_le_bytes(*bytes));
        }
        values
    });
    Ok(rows.collect())
}

fn sample(row: usize, v: &[f64; 9], rate_hz: f64) -> MargSample {
    MargSample {
        at: Timestamp::from_us((row as f64 * 1e6 / rate_hz).round() as u64),
        gyro_radps: Vector3::new(v[0], v[1], v[2]),
        accel_mps2: Vector3::new(v[3], v[4], v[5]),
        mag: Some(Vector3::new(v[6], v[7], v[8])),
    }
}

fn read_reference(path: &Path) -> Result<Vec<Reference>> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    parse_reference(&text).with_context(|| format!("in {}", path.display()))
}

fn parse_reference(text: &str) -> Result<Vec<Reference>> {
    let mut lines = text.lines();
    let head: Vec<&str> = lines
        .next()
        .unwrap_or("")
        .split(',')
        .map(str::trim)
        .collect();
    anyhow::ensure!(
        head.starts_with(&["sample", "qw", "qx", "qy", "qz"]),
        "the first line is not sample,qw,qx,qy,qz[,moving]"
    );
    let moving = head.iter().position(|name| *name == "moving");
    let mut rows: Vec<Reference> = Vec::new();
    for (number, line) in (2..).zip(lines).filter(|(_, l)| !l.trim().is_empty()) {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let value = |i: usize| -> Result<f64> {
            fields
                .get(i)
                .and_then(|f| f.parse::<f64>().ok())
                .filter(|v| v.is_finite())
                .with_context(|| {
                    format!("line {number}: `{line}` has no number in column {}", i + 1)
                })
        };
        let sample = fields[0]
            .parse::<usize>()
            .with_context(|| format!("line {number}: `{}` is no sample number", fields[0]))?;
        anyhow::ensure!(
            rows.last().is_none_or(|r| r.sample < sample),
            "line {number}: sample {sample} is not beyond the one before"
        );
        let q = Quaternion::new(value(1)?, value(2)?, value(3)?, value(4)?);
        let imu_to_enu = UnitQuaternion::try_new(q, 0.5)
            .with_context(|| format!("line {number}: the quaternion has no length"))?;
        let is_moving = match moving {
            Some(i) => value(i)? > 0.5,
            None => true,
        };
        rows.push(Reference {
            sample,
            imu_to_enu,
            is_moving,
        });
    }
    Ok(rows)
}

fn summary(
    args: &AttitudeArgs,
    samples: usize,
    estimator: &AttitudeEstimator,
    score: &AttitudeScore,
) -> serde_json::Value {
    let status = estimator.status();
    let bias = estimator.gyro_bias_radps();
    let iron = estimator.hard_iron();
    serde_json::json!({
        "imu": args.imu.display().to_string(),
        "rate_hz": args.rate,
        "samples": samples,
        "accepted": status.accepted,
        "refused": status.refused,
        "saturated": status.saturated,
        "gaps": status.gaps,
        "gyro_bias_radps": [bias.x, bias.y, bias.z],
        "hard_iron": [iron.x, iron.y, iron.z],
        "mag_delay_s": estimator.mag_delay_s(),
        "tilt_std_deg": status.tilt_std_rad.to_degrees(),
        "heading_std_deg": status.heading_std_rad.map(f64::to_degrees),
        "rmse_deg": score.rms().map(|e| serde_json::json!({
            "rows": score.rows(),
            "total": e.total_rad.to_degrees(),
            "heading": e.heading_rad.to_degrees(),
            "inclination": e.inclination_rad.to_degrees(),
        })),
    })
}

impl Curves {
    fn push(&mut self, time_s: f64, estimator: &AttitudeEstimator) {
        let (roll, pitch, yaw) = estimator.imu_to_enu().euler_angles();
        let bias = estimator.gyro_bias_radps();
        self.time_s.push(time_s);
        for (i, angle) in [roll, pitch, yaw].into_iter().enumerate() {
            self.angles_deg[i].push(angle.to_degrees());
            self.bias_dps[i].push(bias[i].to_degrees());
        }
    }

    fn svg(self, imu: &Path) -> String {
        // Errors come at the truth's own times: brought to the picture's by the nearest before.
        let mut errors = self.errors.iter().peekable();
        let mut last = None;
        let (mut heading, mut inclination) = (Vec::new(), Vec::new());
        for t in &self.time_s {
            while let Some(e) = errors.next_if(|e| e.0 <= *t) {
                last = Some(*e);
            }
            // Older than half a second is a gap of the truth.
            let e = last.filter(|(at, _)| t - at < 0.5).map(|(_, e)| e);
            heading.push(e.map_or(f64::NAN, |e| e.heading_rad.to_degrees()));
            inclination.push(e.map_or(f64::NAN, |e| e.inclination_rad.to_degrees()));
        }
        let named = |names: [&'static str; 3], values: [Vec<f64>; 3]| -> Vec<(&str, Vec<f64>)> {
            names.into_iter().zip(values).collect()
        };
        let mut panels = vec![
            Panel {
                title: "attitude, deg",
                lines: named(["roll", "pitch", "yaw"], self.angles_deg),
            },
            Panel {
                title: "gyro bias, deg/s",
                lines: named(["x", "y", "z"], self.bias_dps),
            },
        ];
        if !self.errors.is_empty() {
            panels.push(Panel {
                title: "error, deg",
                lines: vec![("heading", heading), ("inclination", inclination)],
            });
        }
        let name = imu.file_name().unwrap_or_default().to_string_lossy();
        chart::svg(
            &format!("Kestrel: {name}"),
            "time, s",
            &self.time_s,
            &panels,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_was_cut_is_refused_with_its_size() {
        assert_eq!(rows(&[0; 72]).unwrap().len(), 2);
        assert!(rows(&[]).is_err());
        let e = rows(&[0; 71]).unwrap_err().to_string();
        assert!(e.contains("71 bytes"), "{e}");
    }

    #[test]
    fn the_reference_may_have_a_moving_column() {
        let text = "sample,qw,qx,qy,qz,moving\n10,1,0,0,0,0\n20,0,1,0,0,1\n\n";
        let rows = parse_reference(text).unwrap();
        assert_eq!(rows.len(), 2);
        assert_eq!((rows[0].is_moving, rows[1].is_moving), (false, true));
        let rows = parse_reference("sample,qw,qx,qy,qz\n10,1,0,0,0\n").unwrap();
        assert!(rows[0].is_moving);
    }

    #[test]
    fn what_is_wrong_with_a_reference_is_said_with_its_line() {
        for (text, word) in [
            ("time,q\n", "first line"),
            ("sample,qw,qx,qy,qz\n10,1,0,0\n", "line 2"),
            ("sample,qw,qx,qy,qz\n10,nan,0,0,0\n", "line 2"),
            ("sample,qw,qx,qy,qz\n10,0,0,0,0\n", "no length"),
            ("sample,qw,qx,qy,qz\n10,1,0,0,0\n10,1,0,0,0\n", "line 3"),
            ("sample,qw,qx,qy,qz\nx,1,0,0,0\n", "`x`"),
        ] {
            let e = parse_reference(text).unwrap_err().to_string();
            assert!(e.contains(word), "{e}");
        }
    }
}
