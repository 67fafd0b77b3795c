//! `kestrel sim`: a drone in a simulated room, in real time, for ordinary ground stations.

use super::camera::{CameraArgs, CameraSeat};
use super::session::{DEFAULT_LINKS, Session};
use super::stop::Stop;
use super::term::Terminal;
use super::{Usage, firmware, rooms};
use anyhow::{Context as _, Result, anyhow};
use bridge::autopilot::flight::Start;
use bridge::autopilot::ground::Ground;
use bridge::gcs::Document;
use bridge::gcs::access::LinkPolicy;
use bridge::io::endpoint::{self, Endpoint, EndpointError};
use bridge::io::keep::Keep;
use bridge::io::lockstep::{Lockstep, LockstepConfig, our_address};
use bridge::io::logger::{self, DiskFiles, Limits, LogThread, WhenFull};
use bridge::io::net::{Links, Wanted};
use bridge::io::truth::TruthFile;
use bridge::io::uquad_lockstep::{UquadLockstep, UquadLockstepConfig};
use bridge::log::record::LogSink;
use bridge::settings::{Origin, Settings};
use bridge::web::{Console, ConsoleConfig, console};
use clap::{Args, ValueEnum};
use sim::{Delivery, Manner, Room, SimConfig, Simulator, VehicleConfig, Walker};
use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;
use vehicle::{FloorPlan, In, MapPose, RingConfig, Timestamp};

/// Documents that may be in the state folder.
const DOCUMENTS: [&str; 4] = [
    "parameters.toml",
    "mission.json",
    "fence.json",
    "rally.json",
];

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
    pub(crate) uquad: super::uquad::UquadLawArgs,
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
            uquad: super::uquad::UquadLawArgs::default(),
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
    at: Duration,
    duration: Duration,
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
pub(crate) struct PersonArg(Walker);

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
pub(crate) struct BoxArg([f64; 3]);

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
fn numbers(s: &str) -> Vec<f64> {
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

/// A simulated vehicle ready to fly.
pub(crate) struct Built {
    pub(crate) lockstep: Lockstep,
    pub(crate) keep: Keep,
    pub(crate) log: Option<LogThread>,
}

impl SimArgs {
    fn room(&self) -> Result<Room> {
        if rooms::is_file(&self.room) {
            let path = Path::new(&self.room);
            Ok(Room::from_plan(&self.room, super::load_plan(path)?))
        } else {
            rooms::bundled(&self.room)
        }
    }

    fn ring(&self) -> Result<RingConfig> {
        if self.rangers.ends_with(".toml") || self.rangers.contains('/') {
            let text = std::fs::read_to_string(&self.rangers)
                .with_context(|| format!("cannot read the ring {}", self.rangers))?;
            return RingConfig::from_toml(&text).with_context(|| format!("in {}", self.rangers));
        }
        Ok(RingConfig::built_in(&self.rangers).map_err(|e| {
            let nearest =
                bridge::settings::nearest(&self.rangers, RingConfig::BUILT_IN.into_iter());
            Usage(format!(
                "{e}{}",
                nearest
                    .map(|n| format!("; did you mean `{n}`?"))
                    .unwrap_or_default()
            ))
        })?)
    }

    fn settings(&self, keep: &Keep) -> Result<Settings> {
        let mut settings = super::settings(self.config.as_deref(), &[])?;
        if self.instance > 0 {
            settings.set_text(
                "MAV_SYS_ID",
                &(1 + self.instance).to_string(),
                Origin::CommandLine,
            )?;
        }
        if let Some(bytes) = keep
            .read(DOCUMENTS[0])
            .context("cannot read the stored parameters")?
        {
            let text = String::from_utf8_lossy(&bytes);
            settings
                .set_toml(&text, Origin::Stored)
                .context("in the stored parameters (parameters.toml)")?;
        }
        super::apply_sets(&mut settings, &self.params)?;
        Ok(settings)
    }

    /// Parameters as the arguments give them, without those that an earlier run has kept.
    pub(crate) fn settings_now(&self) -> Result<Settings> {
        super::settings(self.config.as_deref(), &self.params)
    }

    /// What every simulated vehicle is made from.
    fn describe(&self) -> Result<Described> {
        let keep = Keep::in_folder(self.state_dir.as_deref()).with_context(|| {
            format!(
                "cannot make the state folder {}",
                self.state_dir
                    .as_deref()
                    .unwrap_or_else(|| Path::new(""))
                    .display()
            )
        })?;
        let boxes: Vec<[f64; 3]> = self.obstacle.iter().map(|b| b.0).collect();
        let room = self.room()?.with_boxes(&boxes);
        let settings = self.settings(&keep)?;
        let (pose, start) = match self.start {
            None => (room.home(), Start::Known(room.home())),
            Some(StartArg::At(pose)) => (pose, Start::Known(pose)),
            Some(StartArg::Unknown) => (somewhere(room.floor_plan(), self.seed), Start::Unknown),
        };
        if !(1.0..=100.0).contains(&self.battery) {
            return Err(Usage(format!("--battery {} is outside 1..=100", self.battery)).into());
        }
        let mut vehicle = VehicleConfig {
            flow: self.flow == Switch::On,
            charge: self.battery / 100.0,
            outside_fc: self.firmware != FirmwareArg::BuiltIn,
            ..VehicleConfig::new(pose, self.ring()?)
        };
        vehicle.fc.manner = self.manner;
        vehicle.fc.delivery = self.fc_settings;
        let sim = SimConfig {
            vehicles: vec![vehicle],
            people: self.person.iter().map(|p| p.0.clone()).collect(),
            ..SimConfig::new(room, RingConfig::built_in("tof32")?, self.seed)
        };
        let mut documents = Vec::new();
        for name in DOCUMENTS {
            if let Some(bytes) = keep
                .read(name)
                .with_context(|| format!("cannot read {name}"))?
            {
                documents.push(Document { name, bytes });
            }
        }
        Ok(Described {
            sim,
            start,
            settings,
            documents,
            keep,
        })
    }

    /// World, vehicle and brain as the arguments describe them.
    pub(crate) fn build(&self, when_full: WhenFull) -> Result<Built> {
        let Described {
            sim,
            start,
            settings,
            documents,
            mut keep,
        } = self.describe()?;
        let limits = Limits::of(&settings);
        let config = LockstepConfig {
            sim,
            start,
            settings,
            documents,
        };
        // With a state folder every run is kept, where ground stations find it.
        let files = match &self.log {
            Some(path) => Some(DiskFiles::named(path)),
            None => keep
                .fresh_run()
                .context("cannot keep the flight log")?
                .map(|(folder, run)| DiskFiles::of_run(&folder, &run, limits)),
        };
        let (taps, log) = files
            .map(|files| {
                let path = files.path(1, "mcap");
                let header = config.header(&format!("sim {}", self.room))?;
                logger::start(header, files, limits, when_full)
                    .with_context(|| format!("cannot write the flight log {}", path.display()))
            })
            .transpose()?
            .unzip();
        let sink = taps.map(|taps| Box::new(taps) as Box<dyn LogSink>);
        let mut lockstep = Lockstep::with_log(config, sink)?;
        if let Some(hold) = self.hold {
            lockstep.hold_flight_at(Timestamp::ZERO + hold.at, hold.duration);
        }
        if let Some(path) = &self.truth {
            lockstep.write_truth(
                TruthFile::create(path)
                    .with_context(|| format!("cannot write {}", path.display()))?,
            );
        }
        Ok(Built {
            lockstep,
            keep,
            log,
        })
    }

    /// Where the console listens, unless it is not wanted.
    fn console_address(&self) -> Option<SocketAddr> {
        let default = SocketAddr::from(([127, 0, 0, 1], console::PORT + 10 * self.instance));
        (!self.no_console).then_some(self.console.unwrap_or(default))
    }

    /// The camera, as the arguments name it.
    fn start_camera(&self, ground: &mut Ground, simulator: &Simulator) -> Result<CameraSeat> {
        let listen = self.console_address().map(|a| a.ip());
        self.camera.start(ground, listen, Some(simulator.scenery()))
    }

    /// The console, unless it is not wanted.
    fn console(
        &self,
        ground: &Ground,
        plan: Arc<FloorPlan>,
        links: &Links,
        camera: &CameraSeat,
    ) -> Result<Option<Console>> {
        let Some(listen) = self.console_address() else {
            return Ok(None);
        };
        let config = ConsoleConfig {
            listen,
            is_default: self.console.is_none(),
            state_dir: self.state_dir.clone(),
            has_link: self.console.is_none_or(|a| a.ip().is_loopback()),
            names: Vec::new(),
            vehicle: self.room.clone(),
            us: our_address(ground.settings()),
            plan,
            settings: ground.settings().clone(),
            camera: camera.desk(),
        };
        Ok(Some(Console::start(config, links.joint())?))
    }

    /// uQuad in its world.
    fn build_uquad(&self) -> Result<(UquadLockstep, Keep)> {
        if self.firmware != FirmwareArg::BuiltIn || self.log.is_some() || self.hold.is_some() {
            return Err(Usage(
                "--airframe uquad has no flight controller: --firmware, --log and --hold do not apply"
                    .to_owned(),
            )
            .into());
        }
        let Described {
            sim,
            start,
            settings,
            documents,
            keep,
        } = self.describe()?;
        let law = self.uquad.law()?;
        let uquad = self.uquad.config(&law)?;
        let mut world = UquadLockstep::new(UquadLockstepConfig {
            sim,
            start,
            settings,
            documents,
            uquad,
            weights: law.weights(),
            list: self.uquad.list()?,
            has_place: self.uquad.has_place(),
        })?;
        if let Some(path) = &self.truth {
            world.write_truth(
                TruthFile::create(path)
                    .with_context(|| format!("cannot write {}", path.display()))?,
            );
        }
        Ok((world, keep))
    }

    /// Links as asked for; none named = the default set.
    pub(crate) fn links(&self, ground: &mut Ground) -> Result<Links> {
        let wanted: Vec<Wanted> = if self.mavlink.is_empty() {
            DEFAULT_LINKS
                .iter()
                .map(|link| {
                    let port = link.port + 10 * self.instance;
                    let address = format!("127.0.0.1:{port}");
                    let endpoint = (link.endpoint)(address);
                    Wanted {
                        policy: LinkPolicy {
                            url: endpoint.to_string(),
                            ..LinkPolicy::default()
                        },
                        endpoint,
                        is_default: true,
                    }
                })
                .collect()
        } else {
            parse_endpoints(&self.mavlink)?
        };
        ground.set_policies(wanted.iter().map(|w| w.policy.clone()).collect());
        let links = Links::open(&wanted).map_err(|e| anyhow!(e))?;
        let us = our_address(ground.settings());
        ground.set_shell_routes(links.routes_as(us));
        Ok(links)
    }
}

/// What every simulated vehicle is made from.
struct Described {
    sim: SimConfig,
    start: Start,
    settings: Settings,
    documents: Vec<Document>,
    keep: Keep,
}

/// A free place that a seed chooses: reachable from home, clear of walls, any heading.
fn somewhere(plan: &FloorPlan, seed: u64) -> MapPose {
    /// Free floor around the place, m.
    const CLEAR_M: f64 = 0.45;
    /// A way must be this wide, m.
    const WAY_M: f64 = 0.30;
    let home = plan.home.unwrap_or_default();
    let clearance = plan.distance_field(1.0);
    let is_free = |c: i64, r: i64, m: f64| {
        let p = plan.centre_of(c, r);
        plan.is_free(p) && clearance.at(p) > m
    };
    let start = plan.index_of(In::new(home.x_m, home.y_m, 0.0));
    let mut reached = BTreeSet::from([start]);
    let mut open = vec![start];
    while let Some((c, r)) = open.pop() {
        for next in [(c + 1, r), (c - 1, r), (c, r + 1), (c, r - 1)] {
            if is_free(next.0, next.1, WAY_M) && reached.insert(next) {
                open.push(next);
            }
        }
    }
    let places: Vec<(i64, i64)> = reached
        .into_iter()
        .filter(|(c, r)| is_free(*c, *r, CLEAR_M))
        .collect();
    // Two numbers of one splitmix64 stream: neighbouring seeds are far apart.
    let mix = |n: u64| {
        let mut z = seed.wrapping_add(n.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    };
    let Some((c, r)) = places.get((mix(1) % places.len().max(1) as u64) as usize) else {
        return home;
    };
    let p = plan.centre_of(*c, *r);
    let yaw_rad = ((mix(2) % 3600) as f64 * 0.1 - 180.0).to_radians();
    MapPose::new(p.x(), p.y(), yaw_rad)
}

/// Endpoints a user named.
pub(crate) fn parse_endpoints(urls: &[String]) -> Result<Vec<Wanted>> {
    urls.iter()
        .map(|url| {
            let wrong = |e: EndpointError| Usage(e.to_string());
            let (url, policy) = endpoint::split_options(url).map_err(wrong)?;
            let endpoint: Endpoint = url.parse().map_err(wrong)?;
            Ok(Wanted {
                endpoint,
                is_default: false,
                policy,
            })
        })
        .collect()
}

pub(crate) fn run(args: SimArgs) -> Result<ExitCode> {
    let stop = Stop::listen()?;
    let speed = match args.speed.unwrap_or(Speed::Times(1.0)) {
        Speed::Times(x) => Some(x),
        Speed::Max => None,
    };
    if args.airframe == AirframeArg::Uquad {
        let (mut lockstep, keep) = args.build_uquad()?;
        let links = args.links(&mut lockstep.ground)?;
        let camera = args.start_camera(&mut lockstep.ground, &lockstep.simulator)?;
        let plan = lockstep.simulator.floor_plan();
        let console = args.console(&lockstep.ground, plan, &links, &camera)?;
        let terminal = args.greet(&links);
        return Session {
            lockstep,
            links,
            console,
            camera,
            keep,
            log: None,
            terminal,
            stop,
            speed,
            shows_status: !args.headless,
        }
        .run();
    }
    let when_full = match speed {
        Some(_) => WhenFull::Lose,
        None => WhenFull::Wait,
    };
    let Built {
        mut lockstep,
        keep,
        log,
    } = args.build(when_full)?;
    let links = args.links(&mut lockstep.ground)?;
    // After the links: a ground station hears the first heartbeat without waiting for a certificate.
    let camera = args.start_camera(&mut lockstep.ground, &lockstep.simulator)?;
    let plan = lockstep.simulator.floor_plan();
    let console = args.console(&lockstep.ground, plan, &links, &camera)?;
    let mut terminal = args.greet(&links);
    if let Some(firmware) = firmware::start(&args, &mut terminal)? {
        lockstep.fly_by(firmware);
    }
    if args.cpu {
        lockstep.count_time();
    }
    Session {
        lockstep,
        links,
        console,
        camera,
        keep,
        log,
        terminal,
        stop,
        speed,
        shows_status: !args.headless,
    }
    .run()
}

impl SimArgs {
    fn greet(&self, links: &Links) -> Terminal {
        let mut terminal = Terminal::new(self.quiet);
        let what = match self.airframe {
            AirframeArg::Quad => "",
            AirframeArg::Uquad => ", uQuad",
        };
        terminal.line(&format!(
            "Kestrel {} in `{}`, seed {}, ring {}{what}",
            env!("CARGO_PKG_VERSION"),
            self.room,
            self.seed,
            self.rangers
        ));
        for link in &links.described {
            terminal.line(&format!("  MAVLink {link}"));
        }
        terminal.line(
            "  Open a ground station now (QGroundControl finds it by itself). Ctrl-C lands and ends.",
        );
        terminal
    }
}
