//! `kestrel eval`: the production estimators on recorded logs, for those who tune on their own. One file per estimator.

mod attitude;
mod avoid;
pub(crate) mod chart;
mod mcl;
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
    /// Attitude of a 9-axis sensor: gyro, accelerometer, magnetometer.
    Attitude(attitude::AttitudeArgs),
    /// Avoidance: through obstacles the planner does not know.
    Avoid(avoid::AvoidArgs),
    /// Localization on a floor plan: ranges and odometry in, poses out.
    Mcl(mcl::MclArgs),
    /// uQuad's chain: raw counts, conversion, filter, motor speeds.
    Uquad(uquad::UquadArgs),
}

pub(crate) fn run(args: EvalArgs) -> Result<ExitCode> {
    match args.what {
        What::Attitude(args) => attitude::run(&args),
        What::Avoid(args) => avoid::run(&args),
        What::Mcl(args) => mcl::run(&args),
        What::Uquad(args) => uquad::run(&args),
    }
}

/// Frames of a recorded log of uQuad's inertial unit, and the rows that are none.
pub(crate) fn uquad_frames(text: &str) -> (Vec<estimator::imu::RawFrame>, Vec<String>) {
    let (rows, refused) = uquad::read_rows(text);
    (rows.iter().map(|row| row.frame).collect(), refused)
}
