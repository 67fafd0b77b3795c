//! `kestrel motors`: uQuad's motor driver on the bench, four numbers a line.

use super::Usage;
use super::stop::Stop;
use anyhow::{Context as _, Result};
use bridge::io::clock::Clock;
use bridge::motor::bench::Bench;
use bridge::motor::driver::DriverConfig;
use clap::Args;
use embedded_hal::i2c::I2c;
use linux_embedded_hal::I2cdev;
use sim::EscBus;
use std::io::{BufRead as _, Write as _, stdin, stdout};
use std::process::ExitCode;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;
use vehicle::Timestamp;

/// Longest wait: so soon a Ctrl-C is seen.
const LOOK: Duration = Duration::from_millis(20);

#[derive(Debug, Args)]
pub(crate) struct MotorsArgs {
    /// Where the speed controllers are: sim, or i2c:///dev/i2c-2.
    #[arg(long, value_name = "BUS", default_value = "sim")]
    bus: String,
    /// Numbers are rad/s (0 to 368.16) and not the driver's units (0 to 220).
    #[arg(long)]
    radps: bool,
    /// Propellers are off; a real bus is not touched without it.
    #[arg(long)]
    props_off: bool,
    /// Correction of the four speed controllers in the driver's units, in the driver's order (front,rear,left,right).
    #[arg(
        long,
        value_name = "N,N,N,N",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    offsets: Vec<i8>,
}

/// A bus that can be looked at.
trait BenchBus: I2c {
    /// Time goes on.
    fn advance(&mut self, _now: Timestamp) {}
    /// Speeds the motors turn at, rad/s, where they are known.
    fn speeds_radps(&self) -> Option<[f64; 4]> {
        None
    }
}

impl BenchBus for EscBus {
    fn advance(&mut self, now: Timestamp) {
        Self::advance(self, now.us());
    }

    fn speeds_radps(&self) -> Option<[f64; 4]> {
        Some(Self::speeds_radps(self))
    }
}

impl BenchBus for I2cdev {}

pub(crate) fn run(args: &MotorsArgs) -> Result<ExitCode> {
    let mut config = DriverConfig::default();
    if !args.offsets.is_empty() {
        config.offsets = args.offsets.as_slice().try_into().map_err(|_| {
            Usage(format!(
                "--offsets: {} numbers, four are needed",
                args.offsets.len()
            ))
        })?;
    }
    let bench = Bench::new(config, args.radps);
    if args.bus == "sim" {
        return turn(bench, EscBus::default());
    }
    let path = args.bus.strip_prefix("i2c://").ok_or_else(|| {
        Usage(format!(
            "--bus {}: write sim, or i2c:///dev/i2c-2",
            args.bus
        ))
    })?;
    if !args.props_off {
        return Err(Usage(
            "motors will turn: take the propellers off and say --props-off".to_owned(),
        )
        .into());
    }
    let bus = I2cdev::new(path).with_context(|| format!("cannot open the I2C bus {path}"))?;
    turn(bench, bus)
}

fn turn(mut bench: Bench, mut bus: impl BenchBus) -> Result<ExitCode> {
    let stop = Stop::listen()?;
    // One sender stays here: a channel that nobody can send to would not wait.
    let (send, typed) = sync_channel(16);
    read_lines(send.clone())?;
    let clock = Clock::start(1.0);
    let mut shown = None;
    let mut is_open = true;
    let mut is_ending = false;
    while !bench.is_over() {
        let now = clock.now();
        if !is_ending && (stop.count() > 0 || !is_open) {
            is_ending = true;
            bench.end(now);
        }
        bus.advance(now);
        bench.poll(now, &mut bus);
        while let Some(event) = bench.event() {
            say(&event.to_string());
        }
        let speeds = bus.speeds_radps().filter(|_| bench.is_running());
        if speeds.is_some() && speeds != shown {
            let [front, left, rear, right] = speeds.unwrap_or_default();
            say(&format!(
                "front {front:.1}, left {left:.1}, rear {rear:.1}, right {right:.1} rad/s"
            ));
            shown = speeds;
        }
        let wait = bench
            .deadline()
            .map_or(LOOK, |at| clock.until(at).min(LOOK));
        match typed.recv_timeout(wait) {
            Ok(Typed::Line(line)) => {
                if let Err(error) = bench.line(clock.now(), &line) {
                    say(&format!("not done: {error}"));
                }
            }
            Ok(Typed::End) => is_open = false,
            Err(_) => {}
        }
    }
    drop(send);
    Ok(if bench.has_failed() {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}

/// From standard input.
enum Typed {
    Line(String),
    End,
}

/// Reads standard input on a thread of its own: a person may think as long as he likes.
fn read_lines(send: SyncSender<Typed>) -> Result<()> {
    std::thread::Builder::new()
        .name("stdin".to_owned())
        .spawn(move || {
            let lines = stdin().lock().lines().map_while(Result::ok);
            for typed in lines.map(Typed::Line).chain([Typed::End]) {
                if send.send(typed).is_err() {
                    break;
                }
            }
        })
        .context("cannot start the thread that reads standard input")?;
    Ok(())
}

fn say(text: &str) {
    // A closed terminal is no reason to leave motors turning.
    let _ = writeln!(stdout().lock(), "{text}");
}
