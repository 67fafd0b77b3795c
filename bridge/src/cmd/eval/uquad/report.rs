//! Stages as CSV, a picture, a summary. Numbers are written in the fewest digits that read back to the same bits.

use super::super::chart::{self, Panel};
use super::{Outcome, UquadArgs};
use anyhow::{Context as _, Result};
use bridge::log::uquad::UquadLog;
use bridge::uquad::Step;
use estimator::imu::replay::LogRow;
use serde_json::json;
use std::fmt::Write as _;

/// Columns of the converted stage, in the order of uQuad's `kalman_in`.
const CONVERTED: [&str; 12] = [
    "t_us",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
    "gx_radps",
    "gy_radps",
    "gz_radps",
    "psi_rad",
    "phi_rad",
    "theta_rad",
    "temperature_degc",
    "altitude_m",
];
/// Columns of the filter, in the order of uQuad's `x_hat`, the biases behind.
const STATE: [&str; 15] = [
    "x_m",
    "y_m",
    "z_m",
    "psi_rad",
    "phi_rad",
    "theta_rad",
    "vqx_mps",
    "vqy_mps",
    "vqz_mps",
    "wqx_radps",
    "wqy_radps",
    "wqz_radps",
    "bax_mps2",
    "bay_mps2",
    "baz_mps2",
];
/// Columns of the motors.
const MOTORS: [&str; 4] = ["w0_radps", "w1_radps", "w2_radps", "w3_radps"];

fn converted(s: &Step) -> Vec<f64> {
    let m = &s.reading.measured;
    let mut out = vec![s.elapsed_us as f64];
    out.extend(m.accel_mps2.as_slice());
    out.extend(m.gyro_radps.as_slice());
    let a = &m.angles;
    out.extend([
        a.psi_rad,
        a.phi_rad,
        a.theta_rad,
        m.temperature_degc,
        m.altitude_m,
    ]);
    out
}

fn csv(names: &[&str], steps: &[Step], values: impl Fn(&Step) -> Vec<f64>) -> String {
    let mut out = format!("row,{}\n", names.join(","));
    for step in steps {
        // Writing to a String cannot fail.
        let _ = write!(out, "{}", step.frame);
        for value in values(step) {
            let _ = write!(out, ",{value}");
        }
        out.push('\n');
    }
    out
}

/// Mean, standard deviation, smallest and largest.
fn spread(values: &[f64]) -> serde_json::Value {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n;
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| {
            (l.min(v), h.max(v))
        });
    json!({ "mean": mean, "std": variance.sqrt(), "min": low, "max": high })
}

fn spreads(
    names: &[&str],
    steps: &[Step],
    values: impl Fn(&Step) -> Vec<f64>,
) -> serde_json::Value {
    let rows: Vec<Vec<f64>> = steps.iter().map(values).collect();
    let columns = names.iter().enumerate().map(|(i, &name)| {
        let column: Vec<f64> = rows.iter().map(|r| r[i]).collect();
        (name.to_owned(), spread(&column))
    });
    serde_json::Value::Object(columns.collect())
}

fn picture(title: &str, steps: &[Step]) -> String {
    let mut t = 0.0;
    let times: Vec<f64> = steps
        .iter()
        .map(|s| {
            let now = t;
            t += s.elapsed_us as f64 * 1e-6;
            now
        })
        .collect();
    let line = |f: &dyn Fn(&Step) -> f64| steps.iter().map(f).collect::<Vec<f64>>();
    let state = |i: usize| line(&move |s: &Step| s.state[i]);
    let panels = [
        Panel {
            title: "specific force, m/s2",
            lines: vec![
                ("ax", line(&|s| s.reading.measured.accel_mps2.x)),
                ("ay", line(&|s| s.reading.measured.accel_mps2.y)),
                ("az", line(&|s| s.reading.measured.accel_mps2.z)),
            ],
        },
        Panel {
            title: "angles: measured and estimated, rad",
            lines: vec![
                ("psi measured", line(&|s| s.reading.measured.angles.psi_rad)),
                ("phi measured", line(&|s| s.reading.measured.angles.phi_rad)),
                (
                    "theta measured",
                    line(&|s| s.reading.measured.angles.theta_rad),
                ),
                ("psi", state(3)),
                ("phi", state(4)),
                ("theta", state(5)),
            ],
        },
        Panel {
            title: "height: barometer and estimate, m",
            lines: vec![
                ("barometer", line(&|s| s.reading.measured.altitude_m)),
                ("z", state(2)),
            ],
        },
        Panel {
            title: "body velocity, m/s",
            lines: vec![("vqx", state(6)), ("vqy", state(7)), ("vqz", state(8))],
        },
        Panel {
            title: "motor speeds, rad/s",
            lines: ["w0", "w1", "w2", "w3"]
                .into_iter()
                .enumerate()
                .map(|(m, name)| (name, line(&move |s: &Step| s.speeds_radps[m])))
                .collect(),
        },
    ];
    chart::svg(title, "s since the filter started", &times, &panels)
}

/// `--logs` names what is written; without it everything is.
fn is_wanted(args: &UquadArgs, name: &str) -> bool {
    args.logs.is_empty() || name == "summary.json" || args.logs.iter().any(|log| log.file() == name)
}

pub(super) fn write(args: &UquadArgs, outcome: &Outcome) -> Result<()> {
    let steps = &outcome.steps;
    let mode = if args.legacy {
        "legacy (23 March 2012)"
    } else {
        "corrected"
    };
    let estimated = |s: &Step| s.state.to_vec();
    let motors = |s: &Step| s.speeds_radps.to_vec();
    let summary = json!({
        "program": format!("kestrel {}", env!("CARGO_PKG_VERSION")),
        "raw": args.raw.display().to_string(),
        "calibration": args.calib.display().to_string(),
        "mode": mode,
        "frames": outcome.frames,
        "rows_not_used": outcome.refused_rows.len(),
        "reasons": outcome.refused_rows.iter().take(20).collect::<Vec<_>>(),
        "estimates": steps.len(),
        "first_row": steps.first().map(|s| s.frame),
        "seconds": steps.iter().map(|s| s.elapsed_us as f64).sum::<f64>() * 1e-6,
        "remarks": outcome.said.len(),
        "first_remarks": outcome.said.iter().take(20).map(|(row, s)| format!("row {row}: {s}")).collect::<Vec<_>>(),
        "stopped_by_timing": outcome.is_stopped,
        "accel_norm_believed": steps.iter().filter(|s| s.reading.accel_is_good).count(),
        "mag_norm_believed": steps.iter().filter(|s| s.reading.mag_is_good).count(),
        "converted": spreads(&CONVERTED, steps, converted),
        "filter": spreads(&STATE, steps, estimated),
        "motors": spreads(&MOTORS, steps, motors),
        "last_state": steps.last().map(|s| s.state),
        "last_motors": steps.last().map(|s| s.speeds_radps),
    });
    // What is not asked for is not written; the summary is.
    let files = [
        ("kalman_in.csv", csv(&CONVERTED, steps, converted)),
        ("x_hat.csv", csv(&STATE, steps, estimated)),
        ("w.csv", csv(&MOTORS, steps, motors)),
        ("uquad.svg", picture(&format!("uQuad chain, {mode}"), steps)),
        ("summary.json", format!("{summary:#}\n")),
    ];
    for (name, text) in files.into_iter().filter(|(name, _)| is_wanted(args, name)) {
        let path = args.out.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// The streams as a flight log, which opens with the matrices of gain and calibration.
pub(super) fn log(args: &UquadArgs, rows: &[LogRow], outcome: &Outcome) -> Result<Vec<u8>> {
    let mut facts = vec![
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("legacy", args.legacy.to_string()),
        ("calibration", super::read(&args.calib, "calibration")?),
    ];
    for (name, path) in [("gains", &args.gains), ("integral", &args.integral)] {
        if let Some(path) = path {
            facts.push((name, super::read(path, name)?));
        }
    }
    let mut log = UquadLog::new(&facts)?;
    let time = |row: &LogRow| (row.host_us / 1_000_000, row.host_us % 1_000_000);
    for row in rows {
        let f = &row.frame;
        let mut values = vec![f64::from(f.since_previous_us)];
        values.extend(
            f.accel
                .iter()
                .chain(&f.gyro)
                .chain(&f.mag)
                .map(|v| f64::from(*v)),
        );
        values.extend([f64::from(f.temperature_ddeg), f64::from(f.pressure_pa)]);
        log.row(0, time(row), &values);
    }
    for step in &outcome.steps {
        let Some(row) = rows.get(step.frame as usize) else {
            continue;
        };
        log.row(1, time(row), &converted(step));
        log.row(2, time(row), &step.state);
        log.row(3, time(row), &step.speeds_radps);
    }
    Ok(log.finish())
}
