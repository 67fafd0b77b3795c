//! `kestrel doctor`: what is missing on this computer and its flight controller, and what to do about it.

use super::fc::settings_findings;
use super::fly::state_folder;
use super::{Usage, sensors};
use anyhow::Result;
use bridge::fc::setup::Verdict as FcVerdict;
use bridge::io::clock::utc_us;
use bridge::io::doctor::{Computer, Finding, Verdict, disk, realtime};
use bridge::io::endpoint::{Endpoint, EndpointError};
use bridge::sensor::suite::Device;
use clap::Args;
use std::io::{Write as _, stdout};
use std::path::PathBuf;
use std::process::ExitCode;

/// Check this computer and the flight controller: devices, permissions, real time, clock, disk, heat, camera, settings.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel doctor\n  kestrel doctor --fc serial:///dev/ttyAMA0?baudrate=115200 --sensor ld06:///dev/ttyUSB0 --state-dir /var/lib/kestrel\n\nEach line says what was found, and the line below it what to do. With --fc the settings of the flight controller are read too\n(as by `kestrel fc check`; nothing is written). Exit code 1 if something is MISSING: it will not fly like this; `poor` flies."
)]
pub(crate) struct DoctorArgs {
    /// Flight controller, as for `kestrel fly`.
    #[arg(long, value_name = "URL")]
    fc: Option<String>,
    /// A sensor, as for `kestrel fly` (repeatable).
    #[arg(long = "sensor", value_name = "URL")]
    sensors: Vec<String>,
    /// Configuration file, as for `kestrel fly`.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// State folder, as for `kestrel fly`.
    #[arg(long, value_name = "DIR")]
    state_dir: Option<PathBuf>,
}

pub(crate) fn run(args: &DoctorArgs) -> Result<ExitCode> {
    let fc: Option<Endpoint> = args
        .fc
        .as_deref()
        .map(str::parse)
        .transpose()
        .map_err(|e: EndpointError| Usage(e.to_string()))?;
    let specs = sensors::specs(args.config.as_deref(), &args.sensors)?;
    let suite = sensors::suite(&specs, args.fc.as_deref().unwrap_or_default())?;
    let computer = Computer::default();
    let mut findings = vec![controller_port(&computer, fc.as_ref())];
    for named in &suite.devices {
        match &named.device {
            Device::Serial { path, .. } => findings.push(computer.device("sensor", path)),
            Device::Gpio { chip, .. } => findings.push(computer.device("sensor", chip)),
            Device::Gpsd { .. } | Device::GpsLog { .. } | Device::GpsFake(_) => {}
        }
    }
    findings.extend([
        computer.meddlers(),
        realtime(),
        computer.processor(),
        computer.heat(),
        computer.clock(utc_us()),
    ]);
    findings.push(match args.state_dir.clone().or_else(state_folder) {
        Some(folder) => disk(&folder),
        None => Finding {
            what: "disk",
            verdict: Verdict::Missing,
            found: "no state folder".to_owned(),
            advice: "name one with --state-dir".to_owned(),
        },
    });
    findings.push(computer.camera());
    let can_ask = findings
        .first()
        .is_some_and(|f| f.verdict != Verdict::Missing);
    findings.extend(settings(args.fc.as_deref().filter(|_| can_ask)));
    for finding in &findings {
        show(finding);
    }
    let missing = findings.iter().filter(|f| f.verdict == Verdict::Missing);
    let missing = missing.count();
    say(&match missing {
        0 => "nothing is missing".to_owned(),
        n => format!("{n} missing"),
    });
    Ok(ExitCode::from(u8::from(missing > 0)))
}

fn controller_port(computer: &Computer, fc: Option<&Endpoint>) -> Finding {
    let what = "serial port";
    match fc {
        Some(Endpoint::Serial { device, .. }) => computer.device(what, device),
        Some(other) => Finding {
            what,
            verdict: Verdict::Good,
            found: format!("not needed: {other}"),
            advice: String::new(),
        },
        None => match computer.likely_port() {
            Some(device) => computer.device(what, &device),
            None => computer.device(what, "/dev/ttyAMA0"),
        },
    }
}

/// What the flight controller lacks.
fn settings(fc: Option<&str>) -> Vec<Finding> {
    let what = "controller";
    let Some(fc) = fc else {
        return vec![Finding {
            what,
            verdict: Verdict::Good,
            found: "settings not read".to_owned(),
            advice: "name it with --fc to have them read".to_owned(),
        }];
    };
    let found = match settings_findings(fc) {
        Ok(found) => found,
        Err(e) => {
            return vec![Finding {
                what,
                verdict: Verdict::Missing,
                found: format!("{e:#}"),
                advice: "is it powered, is MSP on that port (its Ports tab), is the baud rate the same at both ends?".to_owned(),
            }];
        }
    };
    let lacking = found.iter().filter_map(|f| {
        let (verdict, advice) = match &f.verdict {
            FcVerdict::Fine => return None,
            FcVerdict::Advice(how) => (Verdict::Poor, how.clone()),
            FcVerdict::ByHand(how) => (Verdict::Missing, format!("by hand: {how}")),
            FcVerdict::Provision(_) => (
                Verdict::Missing,
                format!("kestrel fc provision --fc '{fc}' sets it"),
            ),
        };
        Some(Finding {
            what,
            verdict,
            found: format!("{}: {}", f.what, f.found),
            advice,
        })
    });
    let lacking: Vec<Finding> = lacking.collect();
    if lacking.is_empty() {
        return vec![Finding {
            what,
            verdict: Verdict::Good,
            found: format!("fit to fly by MSP, {} settings read", found.len()),
            advice: String::new(),
        }];
    }
    lacking
}

fn show(finding: &Finding) {
    let mark = match finding.verdict {
        Verdict::Good => "ok",
        Verdict::Poor => "poor",
        Verdict::Missing => "MISSING",
    };
    say(&format!("{mark:8}{:15}{}", finding.what, finding.found));
    if !finding.advice.is_empty() {
        say(&format!("{:23}-> {}", "", finding.advice));
    }
}

/// A line; a closed pipe is no reason to fail.
fn say(text: &str) {
    let _ = writeln!(stdout(), "{text}");
}
