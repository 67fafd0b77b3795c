//! `kestrel mav`: a small client for people and scripts, through the same door as everyone.

mod client;
mod console;
mod flight;
mod logs;
mod mission;
mod parameters;

use self::client::{Client, Silent};
use super::term::complain;
use anyhow::Result;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// Talk to a vehicle over MAVLink.
///
/// A client for a moment: it sends no ground station's heartbeat, so that the vehicle does not take its end for a lost station (only
/// `keys` does).
#[derive(Debug, Args)]
#[command(
    after_help = "Exit code: 0 done, 1 refused or failed, 2 wrong command line, 3 no vehicle, or no answer.\n\nExamples:\n  kestrel mav status\n  kestrel mav params get MIS_TAKEOFF_ALT\n  kestrel mav params save before.txt\n  kestrel mav mission up plan.plan && kestrel mav arm\n  kestrel mav takeoff 1.2 && kestrel mav goto 2.0 -1.5 && kestrel mav land\n  kestrel mav watch ATTITUDE --hz 50 --count 100\n  kestrel mav --to 'udpclient://192.168.1.20:14555?key=file:pilot.key' status"
)]
pub(crate) struct MavArgs {
    /// Where the vehicle listens: udpclient://, udpserver://, tcpclient:// or serial:// (`?key=` signs).
    #[arg(
        long,
        global = true,
        value_name = "URL",
        default_value = "udpclient://127.0.0.1:14555"
    )]
    to: String,
    /// Our MAVLink system id.
    #[arg(long, global = true, value_name = "N", default_value_t = 245, value_parser = clap::value_parser!(u8).range(1..))]
    system: u8,
    /// Longest wait for the vehicle, s.
    #[arg(long, global = true, value_name = "S", default_value_t = 5.0)]
    patience: f64,
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Mode, place, battery, what hinders arming.
    Status,
    /// Parameters.
    #[command(subcommand)]
    Params(parameters::What),
    /// Missions, fences and rally points of QGroundControl's plans (.plan) and way point files (QGC WPL 110).
    #[command(subcommand)]
    Mission(mission::What),
    /// Start the motors.
    Arm {
        /// Skip our pre-flight checks, never the flight controller's.
        #[arg(long)]
        force: bool,
    },
    /// Stop the motors, on the ground.
    Disarm {
        /// Also in flight: it falls.
        #[arg(long)]
        force: bool,
    },
    /// Arm, climb, and come back when the vehicle hovers.
    Takeoff {
        /// Height above the floor at home, m; default: the vehicle's MIS_TAKEOFF_ALT.
        height: Option<f64>,
        /// Do not wait for the end.
        #[arg(long)]
        no_wait: bool,
    },
    /// Fly to a place and hover there.
    #[command(allow_negative_numbers = true)]
    Goto {
        /// North of home, m.
        north: f64,
        /// East of home, m.
        east: f64,
        /// Height above the floor at home, m; default: as now.
        height: Option<f64>,
        /// Heading there, degrees clockwise from north.
        #[arg(long)]
        yaw: Option<f64>,
        /// Do not wait for the end.
        #[arg(long)]
        no_wait: bool,
    },
    /// Land here, and come back when the motors stand.
    Land {
        /// Do not wait for the end.
        #[arg(long)]
        no_wait: bool,
    },
    /// Fly home, land, and come back when the motors stand.
    Return {
        /// Do not wait for the end.
        #[arg(long)]
        no_wait: bool,
    },
    /// Stop and hover; again within 3 s: land.
    Stop,
    /// Type at the key console (`help` lists the words; Ctrl-D ends). At a terminal each key goes out at once.
    Keys,
    /// Flight logs.
    #[command(subcommand)]
    Log(logs::What),
    /// Show messages as they come.
    Watch {
        /// Names, as MAVLink spells them; none = all.
        messages: Vec<String>,
        /// Ask the vehicle for this rate.
        #[arg(long)]
        hz: Option<f64>,
        /// End after so many.
        #[arg(long, short = 'n')]
        count: Option<u64>,
    },
    /// Print our own messages as a MAVLink definition file, for other generators.
    #[command(
        after_help = "Python:\n  kestrel mav dialect > kestrel.xml\n  folder=$(python3 -c 'import pymavlink.dialects.v20 as d; print(d.__path__[0])')\n  cp kestrel.xml $folder && cd $folder && mavgen.py --lang Python3 --wire-protocol 2.0 -o kestrel.py kestrel.xml\nthen mavutil.set_dialect('kestrel'), or MAVLINK_DIALECT=kestrel, or mavproxy.py --dialect=kestrel."
    )]
    Dialect,
}

/// Where a plan or a log goes to, or comes from.
type File = PathBuf;

pub(crate) fn run(args: &MavArgs) -> Result<ExitCode> {
    match carry_out(args) {
        Err(e) if e.downcast_ref::<Silent>().is_some() => {
            complain(&format!("{e:#}"));
            Ok(ExitCode::from(3))
        }
        result => result.map(|()| ExitCode::SUCCESS),
    }
}

fn carry_out(args: &MavArgs) -> Result<()> {
    match &args.what {
        What::Dialect => return console::print(&mavlink_dialect::export::client_xml()),
        What::Mission(what @ mission::What::Show { .. }) => return mission::show(what),
        _ => {}
    }
    let is_station = matches!(args.what, What::Keys);
    let mut client = Client::connect(&args.to, args.system, args.patience, is_station)?;
    match &args.what {
        What::Status => flight::status(&mut client),
        What::Params(what) => parameters::run(&mut client, what),
        What::Mission(what) => mission::run(&mut client, what),
        What::Arm { force } => flight::arm(&mut client, *force),
        What::Disarm { force } => flight::disarm(&mut client, *force),
        What::Takeoff { height, no_wait } => flight::take_off(&mut client, *height, !no_wait),
        What::Goto {
            north,
            east,
            height,
            yaw,
            no_wait,
        } => flight::go_to(&mut client, [*north, *east], *height, *yaw, !no_wait),
        What::Land { no_wait } => flight::land(&mut client, !no_wait),
        What::Return { no_wait } => flight::come_home(&mut client, !no_wait),
        What::Stop => flight::stop(&mut client),
        What::Keys => console::keys(&mut client),
        What::Log(what) => logs::run(&mut client, what),
        What::Watch {
            messages,
            hz,
            count,
        } => console::watch(&mut client, messages, *hz, *count),
        What::Dialect => Ok(()),
    }
}
