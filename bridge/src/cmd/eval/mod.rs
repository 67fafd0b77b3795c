//! `kestrel eval`: the production estimators on recorded logs, for those who tune on their own.

mod mcl;

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
    /// Localization on a floor plan: ranges and odometry in, poses out.
    Mcl(mcl::MclArgs),
}

pub(crate) fn run(args: EvalArgs) -> Result<ExitCode> {
    match args.what {
        What::Mcl(args) => mcl::run(&args),
    }
}
