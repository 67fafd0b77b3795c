//! `kestrel fc restore`.

use super::{FcLine, confirmed, say};
use anyhow::{Context as _, Result, bail};
use bridge::fc::setup::apply::{ApplyError, differing};
use bridge::fc::setup::{Backup, Survey, apply};
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Clone, Debug, Args)]
pub(super) struct RestoreArgs {
    /// Settings saved by `fc provision`.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    line: FcLine,
    /// Only say what would be written.
    #[arg(long)]
    dry_run: bool,
    /// Do not ask.
    #[arg(long)]
    yes: bool,
    /// Write settings of one board to another.
    #[arg(long)]
    other_board: bool,
}

pub(super) fn run(args: &RestoreArgs) -> Result<ExitCode> {
    let text = std::fs::read_to_string(&args.file)
        .with_context(|| format!("cannot read {}", args.file.display()))?;
    let backup = Backup::from_json(&text).with_context(|| format!("in {}", args.file.display()))?;
    let wanted = backup.settings()?;
    let mut line = args.line.open()?;
    let survey = Survey::take(&mut line)?;
    if survey.is_armed && !args.dry_run {
        return Err(ApplyError::Armed.into());
    }
    let orders = backup.writes(&survey, args.other_board)?;
    say(&format!(
        "{}, saved from {}",
        survey.identity, backup.controller
    ));
    if orders.is_empty() {
        say("nothing to do: it is set as saved");
        return Ok(ExitCode::SUCCESS);
    }
    for order in &orders {
        say(&format!("  {}", order.text));
    }
    if args.dry_run {
        return Ok(ExitCode::SUCCESS);
    }
    let question = format!("Write {} settings and restart it?", orders.len());
    if !confirmed(&question, "yes", args.yes, "--yes")? {
        bail!("nothing was written");
    }
    let differs = |survey: &Survey| differing(&wanted, &survey.settings);
    apply(&mut line, &orders, &differs, &mut say)?;
    say("set as saved");
    Ok(ExitCode::SUCCESS)
}
