//! `kestrel fc provision`.

use super::{FcLine, Way, confirmed, default_file, say, show};
use anyhow::{Context as _, Result, bail};
use bridge::fc::setup::apply::ApplyError;
use bridge::fc::setup::findings::writes;
use bridge::fc::setup::{Backup, Survey, Verdict, apply};
use clap::Args;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Clone, Debug, Args)]
pub(super) struct ProvisionArgs {
    #[command(flatten)]
    line: FcLine,
    #[command(flatten)]
    way: Way,
    /// Only say what would be written.
    #[arg(long)]
    dry_run: bool,
    /// Do not ask.
    #[arg(long)]
    yes: bool,
    /// File for the old settings (must not exist yet); default: the state folder.
    #[arg(long, value_name = "FILE")]
    save: Option<PathBuf>,
}

pub(super) fn run(args: &ProvisionArgs) -> Result<ExitCode> {
    let mut line = args.line.open()?;
    let survey = Survey::take(&mut line)?;
    let table = args.way.findings(&survey, None);
    show(&table);
    let orders = writes(&table);
    let by_hand = table
        .iter()
        .filter(|f| matches!(f.verdict, Verdict::ByHand(_)))
        .count();
    if orders.is_empty() {
        if by_hand > 0 {
            bail!("nothing that can be written from here; {by_hand} to be mended by hand");
        }
        say("nothing to do");
        return Ok(ExitCode::SUCCESS);
    }
    if args.dry_run {
        say("would write:");
        for order in &orders {
            say(&format!("  {}", order.text));
        }
        return Ok(ExitCode::SUCCESS);
    }
    if survey.is_armed {
        return Err(ApplyError::Armed.into());
    }
    let question = format!("Write {} settings and restart it?", orders.len());
    if !confirmed(&question, "yes", args.yes, "--yes")? {
        bail!("nothing was written");
    }
    let file = match &args.save {
        Some(file) => file.clone(),
        None => default_file(&survey.identity.firmware.to_string())?,
    };
    save(&file, &Backup::of(&survey))?;
    say(&format!("old settings saved in {}", file.display()));
    let still_missing = |survey: &Survey| {
        let left = writes(&args.way.findings(survey, None));
        left.iter().map(|write| write.command).collect()
    };
    apply(&mut line, &orders, &still_missing, &mut say)?;
    say(&format!(
        "done; `kestrel fc restore {} --fc {}` brings the old settings back",
        file.display(),
        args.line.fc
    ));
    if by_hand > 0 {
        bail!("{by_hand} left to be mended by hand");
    }
    Ok(ExitCode::SUCCESS)
}

/// Never over an older file: that may be the only copy of what the owner had.
fn save(file: &Path, backup: &Backup) -> Result<()> {
    let why = || format!("cannot save the old settings in {}", file.display());
    let mut out = OpenOptions::new()
        .write(true)
        .create_new(true)
        .open(file)
        .with_context(why)?;
    out.write_all(backup.to_json().as_bytes())
        .and_then(|()| out.sync_all())
        .with_context(why)
}
