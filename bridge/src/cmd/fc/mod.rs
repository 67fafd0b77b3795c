//! `kestrel fc`: a flight controller on the bench.

mod check;
mod monitor;
mod motor_test;
pub(crate) mod passthrough;
mod provision;
mod restore;

use super::Usage;
use anyhow::{Context as _, Result, anyhow};
use bridge::fc::setup::{Finding, Survey, Verdict, findings, findings_beside_radio};
use bridge::io::bench_line::BenchLine;
use bridge::io::endpoint::{Endpoint, EndpointError};
use clap::{Args, Subcommand};
use std::io::{BufRead as _, IsTerminal as _, Write as _, stdin, stdout};
use std::path::PathBuf;
use std::process::ExitCode;

/// Look at a flight controller, make it fit to fly by MSP, put it back.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel fc check --fc serial:///dev/ttyACM0                 what is missing, as a table\n  kestrel fc provision --fc serial:///dev/ttyACM0 --dry-run   what would be written\n  kestrel fc provision --fc serial:///dev/ttyACM0             saves the old settings, asks, writes, verifies\n  kestrel fc provision --fc serial:///dev/ttyACM0 --beside-radio   our sticks behind a switch of the pilot's radio\n  kestrel fc restore settings.json --fc serial:///dev/ttyACM0 the old settings again\n  kestrel fc motor-test --fc serial:///dev/ttyACM0 --motor 1  propellers off\n  kestrel fc monitor --fc tcpclient://127.0.0.1:5761          live values\n  kestrel fc passthrough --fc serial:///dev/ttyACM0           a configurator connects to 127.0.0.1:5761"
)]
pub(crate) struct FcArgs {
    #[command(subcommand)]
    command: FcCommand,
}

#[derive(Clone, Debug, Subcommand)]
enum FcCommand {
    /// What is missing for flight by MSP; exit code 1 if something is.
    Check(check::CheckArgs),
    /// Make it fit to fly by MSP; saves the old settings first.
    Provision(provision::ProvisionArgs),
    /// Bring saved settings back.
    Restore(restore::RestoreArgs),
    /// Live values.
    Monitor(monitor::MonitorArgs),
    /// Let a configurator have its line by TCP, while it is disarmed.
    Passthrough(passthrough::PassthroughArgs),
    /// Turn motors one after the other, propellers off.
    MotorTest(motor_test::MotorTestArgs),
}

pub(crate) fn run(args: FcArgs) -> Result<ExitCode> {
    match args.command {
        FcCommand::Check(args) => check::run(&args),
        FcCommand::Provision(args) => provision::run(&args),
        FcCommand::Restore(args) => restore::run(&args),
        FcCommand::Monitor(args) => monitor::run(&args),
        FcCommand::Passthrough(args) => passthrough::run(&args),
        FcCommand::MotorTest(args) => motor_test::run(&args),
    }
}

/// Where the controller is.
#[derive(Clone, Debug, Args)]
struct FcLine {
    /// Flight controller: serial:///dev/...?baudrate=N or tcpclient://host:port.
    #[arg(long, value_name = "URL")]
    fc: String,
}

impl FcLine {
    fn open(&self) -> Result<BenchLine> {
        let endpoint: Endpoint = self
            .fc
            .parse()
            .map_err(|e: EndpointError| Usage(e.to_string()))?;
        BenchLine::open(endpoint).map_err(|e| anyhow!(e))
    }
}

/// What flight by MSP needs of the controller there, with what was found; nothing is written.
pub(crate) fn settings_findings(fc: &str) -> Result<Vec<Finding>> {
    let line = FcLine { fc: fc.to_owned() };
    Ok(findings(&Survey::take(&mut line.open()?)?, None))
}

/// How it is going to be flown.
#[derive(Clone, Copy, Debug, Args)]
struct Way {
    /// Beside a pilot's radio, whose override switch lets our sticks in, instead of by MSP alone.
    #[arg(long)]
    beside_radio: bool,
    /// Channel of the override switch, 4 = Aux4.
    #[arg(long, value_name = "AUX", default_value_t = 4, requires = "beside_radio", value_parser = clap::value_parser!(u8).range(1..=14))]
    switch: u8,
}

impl Way {
    fn findings(self, survey: &Survey, service_hz: Option<f64>) -> Vec<Finding> {
        if self.beside_radio {
            findings_beside_radio(survey, self.switch.saturating_sub(1), service_hz)
        } else {
            findings(survey, service_hz)
        }
    }
}

/// A line on standard output; a closed one is no reason to fail half-way through writing settings.
fn say(text: &str) {
    let _ = writeln!(stdout(), "{text}");
}

/// The table, in words.
fn show(table: &[Finding]) {
    let width = |f: fn(&Finding) -> usize| table.iter().map(f).max().unwrap_or(0);
    let (what, found) = (width(|f| f.what.len()), width(|f| f.found.len()));
    for finding in table {
        let verdict = match &finding.verdict {
            Verdict::Fine => "ok".to_owned(),
            Verdict::Advice(how) => format!("note: {how}"),
            Verdict::ByHand(how) => format!("MISSING, by hand: {how}"),
            Verdict::Provision(writes) => {
                let texts: Vec<&str> = writes.iter().map(|w| w.text.as_str()).collect();
                format!("MISSING, `fc provision` sets: {}", texts.join("; "))
            }
        };
        say(&format!(
            "{:what$}  {:found$}  {verdict}",
            finding.what, finding.found
        ));
    }
}

/// Asks on the terminal; a script says so on its command line instead.
fn confirmed(question: &str, word: &str, is_given: bool, flag: &str) -> Result<bool> {
    if is_given {
        return Ok(true);
    }
    if !stdin().is_terminal() {
        return Err(Usage(format!("nobody to ask: give {flag} if it is meant")).into());
    }
    let _ = write!(stdout(), "{question} Type `{word}`: ");
    let _ = stdout().flush();
    let mut line = String::new();
    stdin().lock().read_line(&mut line)?;
    Ok(line.trim() == word)
}

/// Where old settings go when no file is named.
fn default_file(letters: &str) -> Result<PathBuf> {
    let folder = super::fly::state_folder()
        .ok_or_else(|| {
            Usage("no home folder to save the old settings in: name a file with --save".to_owned())
        })?
        .join("fc");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("cannot make {}", folder.display()))?;
    let now_s = bridge::io::clock::utc_us() / 1_000_000;
    Ok(folder.join(format!("{letters}-{now_s}.json")))
}
