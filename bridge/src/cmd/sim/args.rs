//! What `kestrel sim` can be told on the command line.

use super::super::camera::CameraArgs;
use super::super::uquad::UquadLawArgs;
use bridge::autopilot::flight::Start;
use bridge::web::console;
use clap::{Args, ValueEnum};
use sim::{Delivery, Manner, Walker};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;
use vehicle::{FloorPlan, MapPose};

/// Simulate a drone in a room.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel sim                                      the office, real time, UDP 14550/14540/14555 and TCP 5760\n  kestrel sim maze --seed 7 --rangers sonar8\n  kestrel sim plans/plan.yaml --start 2.0,3.5,0\n  kestrel sim --start unknown                      it does not know where it stands\n  kestrel sim --manner inav                        the flight controller behaves like INAV 9\n  kestrel sim --firmware inav --fc tcpclient://127.0.0.1:5770   INAV itself, started with --tcpbaseport 5770\n  kestrel sim --airframe uquad                     uQuad: inertial unit, thesis filter, LQR, motor driver\n  kestrel sim --airframe uquad --states 8          without a position source\n  kestrel sim --console 127.0.0.1:9000                the page in a browser at another port\n  kestrel sim --mavlink udpserver://127.0.0.1:14600 --truth truth.csv --speed 4 --headless"
)]
pub(crate) struct SimArgs {
    /// A bundled room (see `kestrel rooms`) or the YAML of a floor plan.
    #[arg(value_name = "ROOM|PLAN.yaml", default_value = "office")]
    pub(crate) room: String,
    /// Every random number follows from it.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// Simulated seconds per second, or `max`.
    #[arg(long, value_name = "X|max")]
    pub(crate) speed: Option<Speed>,
    /// Where it stands: x,y,yaw (plan metres, radians counter-clockwise from plan x); `unknown`: somewhere free that follows
    /// from the seed, and it does not know where; default: home.
    #[arg(long, value_name = "x,y,yaw|unknown", allow_hyphen_values = true)]
    pub(crate) start: Option<StartArg>,
    /// Ring of range finders: tof32, sonar8, snsi6, or a TOML file.
    #[arg(long, value_name = "NAME|FILE", default_value = "tof32")]
    pub(crate) rangers: String,
    /// Firmware that the simulated flight controller pretends to be: bf-old, bf-4.6, bf-new, inav, cleanflight, multiwii.
    #[arg(long, value_name = "NAME", default_value_t = Manner::default())]
    pub(crate) manner: Manner,
    /// Settings of the flight controller at the start: ready-to-fly (RC by MSP, switches set), provisioned (and the throttle
    /// holds when RC stops), beside-radio (a pilot's receiver, override box on Aux4), factory (as delivered, for `kestrel fc
    /// provision`).
    #[arg(long, value_name = "STATE", default_value_t = Delivery::default())]
    pub(crate) fc_settings: Delivery,
    /// The aircraft: a quadcopter with a flight controller, or uQuad, flown by motor speeds from the bytes of its inertial unit.
    #[arg(long, value_name = "NAME", default_value = "quad")]
    pub(crate) airframe: AirframeArg,
    #[command(flatten)]
    pub(crate) uquad: UquadLawArgs,
    /// Optical flow sensor.
    #[arg(long, default_value = "on")]
    pub(crate) flow: Switch,
    /// What flies it: the built-in controller, or the real firmware (its simulator build, in real time only).
    #[arg(long, value_name = "NAME", default_value = "built-in")]
    pub(crate) firmware: FirmwareArg,
    /// INAV: the MSP port it is flown by (tcpclient://host:port or serial:///dev/...). Start its simulator build with its
    /// base port moved off 5760, which ground stations use.
    #[arg(long, value_name = "URL")]
    pub(crate) fc: Option<String>,
    /// INAV: the MSP port that takes the simulated sensors; default: the TCP port after that of --fc.
    #[arg(long, value_name = "URL")]
    pub(crate) fc_sim: Option<String>,
    /// Betaflight: edition of its state packets; default: by the MSP version it tells.
    #[arg(long, value_name = "NAME")]
    pub(crate) fc_dialect: Option<DialectArg>,
    /// The firmware's simulator build; default: the one in the Python package `betaflight`.
    #[arg(long, value_name = "FILE")]
    pub(crate) fc_binary: Option<PathBuf>,
    /// Folder of the firmware's settings (eeprom.bin) and words (firmware.log); default: a fresh one that is removed at the end.
    #[arg(long, value_name = "DIR")]
    pub(crate) fc_dir: Option<PathBuf>,
    /// Leave the firmware's settings as they are, instead of making a fresh one fit to fly by MSP.
    #[arg(long)]
    pub(crate) no_provision: bool,
    /// MAVLink endpoint (repeatable); replaces the default set.
    #[arg(long, value_name = "URL")]
    pub(crate) mavlink: Vec<String>,
    #[command(flatten)]
    pub(crate) camera: CameraArgs,
    /// Write truth beside estimate, 50 rows a second (CSV).
    #[arg(long, value_name = "FILE")]
    pub(crate) truth: Option<PathBuf>,
    /// Write the flight log (FILE.mcap and FILE.tlog); default: with --state-dir, numbered files in its folder `logs`.
    #[arg(long, value_name = "FILE")]
    pub(crate) log: Option<PathBuf>,
    /// Keep parameters, mission, flight logs and uploaded files in this folder.
    #[arg(long, value_name = "DIR")]
    pub(crate) state_dir: Option<PathBuf>,
    /// Number of this vehicle: system id 1 + N, default ports + 10 N.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(0..=200))]
    pub(crate) instance: u16,
    /// A person who walks from one place to the other: x1,y1,x2,y2,speed and, if wanted, a start time (plan metres, m/s, s; repeatable).
    #[arg(
        long,
        value_name = "x1,y1,x2,y2,speed[,start_s]",
        allow_hyphen_values = true
    )]
    pub(crate) person: Vec<PersonArg>,
    /// A box that the plan does not show: centre x,y and side (plan metres; repeatable).
    #[arg(long, value_name = "x,y,side", allow_hyphen_values = true)]
    pub(crate) obstacle: Vec<BoxArg>,
    /// Charge of the battery at start, percent.
    #[arg(long, value_name = "PERCENT", default_value_t = 100.0)]
    pub(crate) battery: f64,
    /// Test of failsafes: hold the flight loop at a time, for a time (s), while the world goes on.
    #[arg(long, hide = true, value_name = "AT,FOR")]
    pub(crate) hold: Option<HoldArg>,
    /// Address of the console, the page in a browser; default: 127.0.0.1, port 8443 + 10 N (or the next free one). Other
    /// machines reach it only when somebody has a password: see `kestrel passwd`.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = console::DEFAULT)]
    pub(crate) console: Option<SocketAddr>,
    /// No console.
    #[arg(long, conflicts_with = "console")]
    pub(crate) no_console: bool,
    /// Configuration file (TOML, one table per section of `kestrel params`).
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Set a parameter: NAME=VALUE (repeatable).
    #[arg(long = "param", value_name = "NAME=VALUE")]
    pub(crate) params: Vec<String>,
    /// At the end say what processor time went where: simulator, flight loop, MAVLink (a line of JSON).
    #[arg(long)]
    pub(crate) cpu: bool,
    /// No status line (a log line when something happens).
    #[arg(long)]
    pub(crate) headless: bool,
    /// Say nothing.
    #[arg(long)]
    pub(crate) quiet: bool,
}

impl Default for SimArgs {
    fn default() -> Self {
        Self {
            room: "office".to_owned(),
            seed: 1,
            speed: None,
            start: None,
            rangers: "tof32".to_owned(),
            manner: Manner::default(),
            fc_settings: Delivery::default(),
            airframe: AirframeArg::Quad,
            uquad: UquadLawArgs::default(),
            flow: Switch::On,
            firmware: FirmwareArg::BuiltIn,
            fc: None,
            fc_sim: None,
            fc_dialect: None,
            fc_binary: None,
            fc_dir: None,
            no_provision: false,
            mavlink: Vec::new(),
            camera: CameraArgs::default(),
            truth: None,
            log: None,
            state_dir: None,
            instance: 0,
            person: Vec::new(),
            obstacle: Vec::new(),
            battery: 100.0,
            hold: None,
            console: None,
            no_console: false,
            config: None,
            params: Vec::new(),
            cpu: false,
            headless: false,
            quiet: false,
        }
    }
}

/// `--airframe`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum AirframeArg {
    /// Indoor quadcopter with a flight controller behind MSP.
    Quad,
    /// uQuad: four motors on I2C, an inertial unit on a serial line, no flight controller.
    Uquad,
}

/// `--firmware`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FirmwareArg {
    /// The fake controller of the simulator.
    BuiltIn,
    /// Betaflight itself.
    Betaflight,
    /// INAV, started by you: see --fc.
    Inav,
}

/// `--fc-dialect`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum DialectArg {
    /// Betaflight 4.6 and older.
    #[value(name = "bf-4.6")]
    Bf46,
    /// Betaflight 2026.12.
    #[value(name = "bf-2026")]
    Bf2026,
}

/// Speed of simulated time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Speed {
    /// Simulated seconds per second.
    Times(f64),
    /// As fast as it goes.
    Max,
}

impl FromStr for Speed {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        if s == "max" {
            return Ok(Self::Max);
        }
        match s.parse::<f64>() {
            Ok(x) if (0.01..=1000.0).contains(&x) => Ok(Self::Times(x)),
            _ => Err("a number from 0.01 to 1000, or `max`".to_owned()),
        }
    }
}

/// `--hold`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HoldArg {
    pub(super) at: Duration,
    pub(super) duration: Duration,
}

impl FromStr for HoldArg {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let seconds = |t: &str| Duration::try_from_secs_f64(t.parse().ok()?).ok();
        s.split_once(',')
            .and_then(|(at, duration)| {
                Some(Self {
                    at: seconds(at)?,
                    duration: seconds(duration)?,
                })
            })
            .ok_or_else(|| "two times in seconds, like 20,0.6".to_owned())
    }
}

/// `--start`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum StartArg {
    /// On the plan.
    At(MapPose),
    /// Somewhere, and it does not know where.
    Unknown,
}

impl StartArg {
    /// Where a vehicle on this plan believes to start: at home unless said otherwise.
    pub(crate) fn on(given: Option<Self>, plan: &FloorPlan) -> Start {
        match given {
            Some(Self::At(pose)) => Start::Known(pose),
            Some(Self::Unknown) => Start::Unknown,
            None => Start::Known(plan.home.unwrap_or_default()),
        }
    }
}

impl FromStr for StartArg {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        if s == "unknown" {
            return Ok(Self::Unknown);
        }
        match numbers(s)[..] {
            [x_m, y_m, yaw_rad] => Ok(Self::At(MapPose { x_m, y_m, yaw_rad })),
            _ => Err("x,y,yaw (plan metres, radians) or `unknown`".to_owned()),
        }
    }
}

/// `--person`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PersonArg(pub(super) Walker);

impl FromStr for PersonArg {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let (x1, y1, x2, y2, speed_mps, start_s) = match numbers(s)[..] {
            [x1, y1, x2, y2, v] => (x1, y1, x2, y2, v, 0.0),
            [x1, y1, x2, y2, v, t] if t >= 0.0 => (x1, y1, x2, y2, v, t),
            _ => return Err("x1,y1,x2,y2,speed[,start_s]".to_owned()),
        };
        Ok(Self(Walker {
            path: vec![[x1, y1], [x2, y2]],
            speed_mps,
            start: Duration::from_secs_f64(start_s),
            then: sim::Then::Stay,
        }))
    }
}

/// `--obstacle`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BoxArg(pub(super) [f64; 3]);

impl FromStr for BoxArg {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        match numbers(s)[..] {
            [x, y, side] if side > 0.0 => Ok(Self([x, y, side])),
            _ => Err("x,y,side (plan metres)".to_owned()),
        }
    }
}

/// Finite numbers between commas; none if one is not.
pub(super) fn numbers(s: &str) -> Vec<f64> {
    let all: Option<Vec<f64>> = s
        .split(',')
        .map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite()))
        .collect();
    all.unwrap_or_default()
}

/// `on` or `off`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Switch {
    /// On.
    On,
    /// Off.
    Off,
}
