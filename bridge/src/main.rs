//! `kestrel`: the program. One file per sub-command in `cmd/`.

mod cmd;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory as _, Parser, Subcommand};
use std::process::ExitCode;

/// Autopilot bridge for indoor quadcopters: MSP on one side, MAVLink on the other.
///
/// `kestrel` alone flies nothing and needs nothing: it opens a simulated office with a drone in it and waits for your ground
/// station on UDP 14550.
#[derive(Debug, Parser)]
#[command(
    name = "kestrel",
    version,
    about,
    after_help = "Examples:\n  kestrel                       a drone in a simulated office\n  kestrel demo                  watch it fly a patrol, get a picture\n  kestrel sim maze --seed 7     another room\n  kestrel fly --fc serial:///dev/ttyAMA0?baudrate=115200 --map plan.yaml --mavlink udpclient://192.168.1.2:14550\n  kestrel params                every parameter with its range"
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Simulate a drone in a room; ground stations connect as to a real one.
    Sim(cmd::sim::SimArgs),
    /// Fly a scripted patrol in the simulator and draw it.
    Demo(cmd::demo::DemoArgs),
    /// Fly the real thing.
    Fly(cmd::fly::FlyArgs),
    /// A simulated vehicle without a brain: fly it with `kestrel fly` as the real thing.
    Rehearse(cmd::rehearse::RehearseArgs),
    /// Check this computer and the flight controller, and say what to do.
    Doctor(cmd::doctor::DoctorArgs),
    /// Look at a flight controller on the bench, make it fit to fly by MSP.
    Fc(cmd::fc::FcArgs),
    /// Turn the motors of a craft without flight controller by hand, on the bench.
    #[command(
        after_help = "Each line of standard input: four numbers, front left rear right. All above 45 start the motors (ramp of 2.4 s), a 0\n\
        stops them; a line stands until the next. The end of the input and Ctrl-C stop them.\n\n\
        Examples:\n  (echo 167 167 167 167; sleep 5) | kestrel motors\n  kestrel motors --radps\n  kestrel motors --bus i2c:///dev/i2c-2 --props-off"
    )]
    Motors(cmd::motors::MotorsArgs),
    /// Look into the protocol of flight controllers.
    Msp(cmd::msp::MspArgs),
    /// Talk to a vehicle over MAVLink: status, parameters, missions, keys, logs.
    Mav(cmd::mav::MavArgs),
    /// Make and show keys of signed MAVLink links.
    Keys(cmd::keys::KeysArgs),
    /// A console off the drone, for several vehicles and their users.
    Console(cmd::console::ConsoleArgs),
    /// Make, change and list users of the console, and keys for consoles off the drone.
    Passwd(cmd::passwd::PasswdArgs),
    /// Show, check and import floor plans.
    Map(cmd::map::MapArgs),
    /// Make a patrol from a floor plan: a QGroundControl plan file and a picture.
    Plan(cmd::plan::PlanArgs),
    /// List every parameter.
    Params(cmd::params::ParamsArgs),
    /// List the bundled rooms, or write one as a floor plan.
    Rooms(cmd::rooms::RoomsArgs),
    /// Fly a relay test in the simulator and propose gains.
    Tune(cmd::tune::TuneArgs),
    /// Run an estimator on a recorded log.
    Eval(cmd::eval::EvalArgs),
    /// Look at flight logs: what they hold, pictures, tables.
    Log(cmd::log::LogArgs),
    /// Fly a campaign of faults in simulated rooms, judged by the truth.
    Experiment(cmd::experiment::ExperimentArgs),
    /// Fly a recorded flight again, compare, or with other parameters.
    Replay(cmd::replay::ReplayArgs),
    /// The camera's picture: for players, and a recording to try things with.
    #[cfg(feature = "video")]
    Video(cmd::video::VideoArgs),
}

fn main() -> ExitCode {
    let cli = Cli::try_parse().unwrap_or_else(|e| refuse(&e));
    let command = cli
        .command
        .unwrap_or_else(|| Command::Sim(cmd::sim::SimArgs::default()));
    let result = match command {
        Command::Sim(args) => cmd::sim::run(args),
        Command::Demo(args) => cmd::demo::run(args),
        Command::Fly(args) => cmd::fly::run(args),
        Command::Rehearse(args) => cmd::rehearse::run(&args),
        Command::Doctor(args) => cmd::doctor::run(&args),
        Command::Fc(args) => cmd::fc::run(args),
        Command::Motors(args) => cmd::motors::run(&args),
        Command::Msp(args) => cmd::msp::run(&args),
        Command::Mav(args) => cmd::mav::run(&args),
        Command::Keys(args) => cmd::keys::run(&args),
        Command::Console(args) => cmd::console::run(args),
        Command::Passwd(args) => cmd::passwd::run(&args),
        Command::Map(args) => cmd::map::run(args),
        Command::Plan(args) => cmd::plan::run(&args),
        Command::Params(args) => cmd::params::run(&args),
        Command::Rooms(args) => cmd::rooms::run(&args),
        Command::Tune(args) => cmd::tune::run(&args),
        Command::Eval(args) => cmd::eval::run(args),
        Command::Log(args) => cmd::log::run(args),
        Command::Experiment(args) => cmd::experiment::run(&args),
        Command::Replay(args) => cmd::replay::run(args),
        #[cfg(feature = "video")]
        Command::Video(args) => cmd::video::run(&args),
    };
    match result {
        Ok(code) => code,
        Err(e) => {
            cmd::term::complain(&format!("{e:#}"));
            if e.downcast_ref::<cmd::Usage>().is_some() {
                ExitCode::from(2)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}

/// Help and version as asked; a wrong command line with the nearest sub-command to a mistyped one.
fn refuse(e: &clap::Error) -> ! {
    let wrong = match (e.kind(), e.get(ContextKind::InvalidSubcommand)) {
        (ErrorKind::InvalidSubcommand, Some(ContextValue::String(wrong))) => wrong.clone(),
        _ => e.exit(),
    };
    let command = Cli::command();
    let names: Vec<&str> = command
        .get_subcommands()
        .map(clap::Command::get_name)
        .collect();
    let nearest = bridge::settings::nearest(&wrong, names.iter().copied());
    let hint = nearest
        .map(|n| format!("; did you mean `{n}`?"))
        .unwrap_or_default();
    cmd::term::complain(&format!(
        "no command `{wrong}`{hint}; there are {} (kestrel --help)",
        names.join(", ")
    ));
    std::process::exit(2)
}
