//! `kestrel fc monitor`.

use super::super::stop::Stop;
use super::{FcLine, say};
use anyhow::Result;
use bridge::fc::conversation::{AskError, read};
use bridge::fc::setup::survey::identify;
use bridge::io::bench_line::BenchLine;
use bridge::io::clock;
use clap::Args;
use msp::firmware::box_id;
use msp::message::{Altitude, Analog, Attitude, Motor, Rc, Reply};
use std::process::ExitCode;
use std::time::Duration;

#[derive(Clone, Debug, Args)]
pub(super) struct MonitorArgs {
    #[command(flatten)]
    line: FcLine,
    /// Lines a second at most.
    #[arg(long, default_value_t = 4.0, value_parser = rate)]
    hz: f64,
    /// End after so many lines; default: at Ctrl-C.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(hz) if (0.1..=50.0).contains(&hz) => Ok(hz),
        _ => Err("a number from 0.1 to 50".to_owned()),
    }
}

pub(super) fn run(args: &MonitorArgs) -> Result<ExitCode> {
    let stop = Stop::listen()?;
    let mut line = args.line.open()?;
    let identity = identify(&mut line)?;
    say(&identity.to_string());
    let mut shown = 0;
    while stop.count() == 0 && args.count.is_none_or(|n| shown < n) {
        let began = line.now();
        say(&values(&mut line, &identity)?);
        shown += 1;
        let period = Duration::from_secs_f64(1.0 / args.hz);
        clock::sleep(period.saturating_sub(line.now().since(began)));
    }
    Ok(ExitCode::SUCCESS)
}

/// One line. What a firmware does not have is left out.
fn values(line: &mut BenchLine, identity: &msp::Identity) -> Result<String, AskError> {
    use bridge::fc::conversation::Controller as _;
    let status_command = identity.status_command();
    let status = Reply::parse(status_command, &line.ask(status_command, &[])?)?;
    let is_armed = identity.is_box_active(box_id::ARM, &status) == Some(true);
    let blockers: Vec<&str> = identity.arming_blockers(&status).map(|b| b.name).collect();
    let state = match (is_armed, blockers.is_empty()) {
        (true, _) => "ARMED".to_owned(),
        (false, true) => "ready".to_owned(),
        (false, false) => blockers.join(" "),
    };
    let mut parts = Vec::new();
    let attitude: Attitude = read(line)?;
    parts.push(format!(
        "roll {:+6.1} pitch {:+6.1} (nose up +) heading {:3}",
        f64::from(attitude.roll_ddeg) * 0.1,
        f64::from(attitude.pitch_ddeg) * -0.1,
        attitude.yaw_deg
    ));
    if let Some(altitude) = known(read::<Altitude>(line))? {
        parts.push(format!("{:+.2} m", f64::from(altitude.altitude_cm) * 0.01));
    }
    if let Some(analog) = known(read::<Analog>(line))? {
        parts.push(format!("{:.1} V", f64::from(analog.vbat_dv) * 0.1));
    }
    if let Some(rc) = known(read::<Rc>(line))? {
        let channels: Vec<String> = rc.channels_us.iter().take(8).map(u16::to_string).collect();
        parts.push(format!("RC {}", channels.join(" ")));
    }
    if let Some(motor) = known(read::<Motor>(line))? {
        let motors: Vec<String> = motor
            .motors_us
            .iter()
            .filter(|us| **us > 0)
            .map(u16::to_string)
            .collect();
        parts.push(format!("motors {}", motors.join(" ")));
    }
    parts.push(state);
    Ok(parts.join(" | "))
}

fn known<T>(answer: Result<T, AskError>) -> Result<Option<T>, AskError> {
    match answer {
        Ok(value) => Ok(Some(value)),
        Err(AskError::Refused(_)) => Ok(None),
        Err(e) => Err(e),
    }
}
