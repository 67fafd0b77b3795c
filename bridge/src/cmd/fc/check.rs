//! `kestrel fc check`.

use super::{FcLine, Way, say, show};
use anyhow::Result;
use bridge::fc::conversation::Controller;
use bridge::fc::setup::{Survey, Verdict};
use bridge::io::bench_line::BenchLine;
use clap::Args;
use std::process::ExitCode;

/// Questions whose answers are timed.
const TIMED: u32 = 40;

#[derive(Clone, Debug, Args)]
pub(super) struct CheckArgs {
    #[command(flatten)]
    line: FcLine,
    #[command(flatten)]
    way: Way,
}

pub(super) fn run(args: &CheckArgs) -> Result<ExitCode> {
    let mut line = args.line.open()?;
    let survey = Survey::take(&mut line)?;
    let service_hz = service_hz(&mut line, &survey)?;
    let table = args.way.findings(&survey, Some(service_hz));
    show(&table);
    for blocker in &survey.blockers {
        say(&format!(
            "not armable now: {} ({})",
            blocker.name, blocker.advice
        ));
    }
    let missing = table
        .iter()
        .filter(|f| matches!(f.verdict, Verdict::ByHand(_) | Verdict::Provision(_)))
        .count();
    if missing == 0 {
        say(if args.way.beside_radio {
            "fit to fly by MSP beside a radio"
        } else {
            "fit to fly by MSP"
        });
        return Ok(ExitCode::SUCCESS);
    }
    say(&format!("{missing} missing"));
    Ok(ExitCode::FAILURE)
}

/// Messages a second, one after the other.
fn service_hz(line: &mut BenchLine, survey: &Survey) -> Result<f64> {
    let began = line.now();
    for _ in 0..TIMED {
        line.ask(survey.identity.status_command(), &[])?;
    }
    Ok(f64::from(TIMED) / line.now().seconds_since(began).max(1e-6))
}
