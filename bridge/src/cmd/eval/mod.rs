//! `kestrel eval`: estimators on recorded logs, for people who tune on their own. One file per estimator.

mod chart;
mod progress;
mod uquad;

use anyhow::Result;
use clap::{Args, Subcommand};
use std::process::ExitCode;

/// Run an estimator on a recorded log.
#[derive(Debug, Args)]
pub(crate) struct EvalArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// uQuad's chain: raw counts, conversion, filter, motor speeds.
    Uquad(uquad::UquadArgs),
}

pub(crate) fn run(args: EvalArgs) -> Result<ExitCode> {
    match args.what {
        What::Uquad(args) => uquad::run(&args),
    }
}
