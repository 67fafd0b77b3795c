//! `kestrel fc motor-test`.

use super::super::Usage;
use super::super::stop::Stop;
use super::{FcLine, confirmed, say};
use anyhow::{Result, bail};
use bridge::fc::motor_test::{Bench, MotorTest, STRONGEST_PERCENT};
use bridge::io::clock;
use clap::Args;
use std::process::ExitCode;
use std::time::Duration;

#[derive(Clone, Debug, Args)]
pub(super) struct MotorTestArgs {
    #[command(flatten)]
    line: FcLine,
    /// Which motor, from 1; default: one after the other.
    #[arg(long, value_name = "N")]
    motor: Option<u8>,
    /// Share of full throttle.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u8).range(1..=i64::from(STRONGEST_PERCENT)))]
    percent: u8,
    /// Time for each motor.
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
    /// All propellers are off.
    #[arg(long)]
    props_off: bool,
}

struct Terminal {
    stop: Stop,
}

impl Bench for Terminal {
    fn stop(&self) -> bool {
        self.stop.count() > 0
    }
    fn pause(&mut self, time: Duration) {
        clock::sleep(time);
    }
    fn tell(&mut self, text: &str) {
        say(text);
    }
}

pub(super) fn run(args: &MotorTestArgs) -> Result<ExitCode> {
    if !(0.1..=30.0).contains(&args.seconds) {
        return Err(Usage("--seconds: a number from 0.1 to 30".to_owned()).into());
    }
    let question = "Motors will turn. Are ALL propellers off?";
    if !confirmed(question, "off", args.props_off, "--props-off")? {
        bail!("no motor was turned");
    }
    // Before the line is opened: from now on Ctrl-C stops motors instead of this program.
    let stop = Stop::listen()?;
    let mut line = args.line.open()?;
    let test = MotorTest {
        motor: args.motor,
        percent: args.percent,
        time: Duration::from_secs_f64(args.seconds),
    };
    let is_whole = test.run(&mut line, &mut Terminal { stop })?;
    if !is_whole {
        bail!("stopped before its end");
    }
    Ok(ExitCode::SUCCESS)
}
