//! `kestrel fly`: the real thing.

mod ground_loop;
mod uquad;

use super::camera::CameraArgs;
use super::fc::passthrough::open_door;
use super::sim::{AirframeArg, StartArg, parse_endpoints};
use super::stop::Stop;
use super::term::Terminal;
use super::{Usage, load_plan, settings};
use anyhow::{Context as _, Result, anyhow};
use bridge::autopilot::door::Severity;
use bridge::autopilot::flight::{Flight, FlightConfig};
use bridge::autopilot::ground::{Ground, GroundConfig};
use bridge::gcs::{DOCUMENTS, Document};
use bridge::io::bench_line::BenchLine;
use bridge::io::clock::{self, Clock};
use bridge::io::endpoint::{Endpoint, EndpointError};
use bridge::io::flight_thread::{self, Borrower};
use bridge::io::keep::Keep;
use bridge::io::lockstep::our_address;
use bridge::io::logger::{self, DiskFiles, Limits, WhenFull};
use bridge::io::net::{Links, Wanted};
use bridge::io::passthrough::Door;
use bridge::log::Header;
use bridge::settings::{Origin, Settings};
use bridge::web::{Console, ConsoleConfig, console};
use clap::Args;
use ground_loop::GroundLoop;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use uquad::fly_uquad;
use vehicle::Airframe;

/// Where stations of the local network listen, when no link is named: they find the vehicle and may watch.
const ANNOUNCE: &str = "udpbroadcast://255.255.255.255:14550";
/// How often the door is looked at when no link speaks.
const LOOK: Duration = Duration::from_millis(2);
/// A controller that has not said who it is after this does not hear us, or we not it.
const FIRST_ANSWER: Duration = Duration::from_secs(6);
/// What stopping the motors may take, and the frames that say so.
const CUT: Duration = Duration::from_millis(200);
/// Longest landing before the program ends anyway.
const LANDING: Duration = Duration::from_secs(30);

/// Fly the real thing.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel fly --fc serial:///dev/ttyAMA0?baudrate=115200 --map plan.yaml --mavlink udpclient://192.168.1.2:14550\n  kestrel fly --fc tcpclient://127.0.0.1:5761 --map plan.yaml --mavlink udpserver://127.0.0.1:14555    a firmware simulator\n  kestrel fly --fc serial:///dev/ttyAMA0 --map plan.yaml --mavlink udpclient://192.168.1.2:14550 --sensor 'ld06:///dev/ttyUSB0?yaw_deg=180' --sensor msp:///dev/ttyUSB1\n\n  kestrel fly --airframe uquad --imu serial:///dev/ttyUSB0?baudrate=115200 --calib imu_calib.txt --motors i2c:///dev/i2c-2 --mavlink udpclient://192.168.1.2:14550\n  kestrel fly --airframe uquad --imu imu_raw.log --calib imu_calib.txt --motors sim --mavlink udpserver://127.0.0.1:14555\n\nWithout range finders that speak, take-off is refused: see --sensor and docs/sensors.md. `kestrel rehearse` gives a\nsimulated vehicle to try the whole command line on. uQuad flies without: height, heading and tilt are held, the place is not."
)]
pub(crate) struct FlyArgs {
    /// Flight controller: serial:///dev/...?baudrate=N or tcpclient://host:port.
    #[arg(long, value_name = "URL", required_unless_present = "imu")]
    fc: Option<String>,
    /// Floor plan (ROS map_server YAML).
    #[arg(long, value_name = "PLAN.yaml", required_unless_present = "imu")]
    map: Option<PathBuf>,
    /// The aircraft: a quadcopter with a flight controller, or uQuad, flown by motor speeds from the bytes of its inertial unit.
    #[arg(long, value_name = "NAME", default_value = "quad")]
    airframe: AirframeArg,
    /// uQuad: its inertial unit, serial:///dev/...?baudrate=N, or a recorded imu_raw.log, replayed as slow as it was recorded.
    #[arg(long, value_name = "URL|FILE", conflicts_with = "fc")]
    imu: Option<String>,
    /// uQuad: its motors: sim (a simulated bus), i2c:///dev/i2c-2, or stdin (a simulated bus that turns at typed speeds: four
    /// numbers a line, rad/s).
    #[arg(long, value_name = "sim|i2c://DEVICE|stdin", default_value = "sim")]
    motors: String,
    /// uQuad: calibration of its inertial unit (imu_calib.txt); default: that of the simulated chips.
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// uQuad: frames of the calibration at rest.
    #[arg(long, value_name = "N", default_value_t = 512)]
    calibration_frames: u32,
    /// uQuad: write its own text logs into this folder (imu_raw, kalman_in, flags, x_hat, w, w_ctrl, int, t_err, err), see docs/uquad.md.
    #[arg(long, value_name = "DIR")]
    log_dir: Option<PathBuf>,
    #[command(flatten)]
    uquad: super::uquad::UquadLawArgs,
    /// MAVLink endpoint (repeatable); only these open. None: announced by broadcast to port 14550, where stations may watch. Options: ?role=viewer|pilot|engineer&key=file:PATH|pass:TEXT&rate=BYTES_PER_S&route=on.
    #[arg(long, value_name = "URL")]
    mavlink: Vec<String>,
    /// Where it stands: x,y,yaw (plan metres, radians counter-clockwise from plan x), or `unknown`; default: the plan's home.
    #[arg(long, value_name = "x,y,yaw|unknown", allow_hyphen_values = true)]
    start: Option<StartArg>,
    /// A sensor: ld06, rplidar, tof_ring, hc_sr04, msp, mavlink, gpsd, gps_log, gps_fake, each with its device and options, like
    /// 'ld06:///dev/ttyUSB0?yaw_deg=90' (repeatable; also as a table `sensor` in the configuration file).
    #[arg(long = "sensor", value_name = "URL")]
    sensors: Vec<String>,
    /// Keep parameters, mission, flight logs and uploaded files in this folder; default: $XDG_STATE_HOME/kestrel or ~/.local/state/kestrel.
    #[arg(long, value_name = "DIR")]
    state_dir: Option<PathBuf>,
    /// Configuration file (TOML).
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set a parameter: NAME=VALUE (repeatable).
    #[arg(long = "param", value_name = "NAME=VALUE")]
    params: Vec<String>,
    /// Wait for a flight controller that is not there or does not answer yet, as a service started at boot must.
    #[arg(long)]
    wait: bool,
    /// Let a configurator have the controller's line by TCP while it is disarmed, for example tcpserver://127.0.0.1:5761.
    /// Meanwhile nothing can be flown. Whoever reaches it can do anything to the controller.
    #[arg(long, value_name = "URL")]
    passthrough: Option<String>,
    #[command(flatten)]
    camera: CameraArgs,
    /// Open the console, the page in a browser, at this address (127.0.0.1:8443 if none is named). Other machines reach it only
    /// when somebody has a password: see `kestrel passwd`.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = console::DEFAULT)]
    console: Option<SocketAddr>,
    /// No status line.
    #[arg(long)]
    headless: bool,
    /// Say nothing.
    #[arg(long)]
    quiet: bool,
}

pub(crate) fn run(args: FlyArgs) -> Result<ExitCode> {
    let stop = Stop::listen()?;
    if args.airframe == AirframeArg::Uquad {
        return fly_uquad(args, stop);
    }
    let (Some(fc_name), Some(map)) = (&args.fc, &args.map) else {
        return Err(Usage("--imu is uQuad's: say --airframe uquad".to_owned()).into());
    };
    let fc: Endpoint = fc_name
        .parse()
        .map_err(|e: EndpointError| Usage(e.to_string()))?;
    let wanted = wanted(&args)?;
    let plan = Arc::new(load_plan(map)?);
    let specs = super::sensors::specs(args.config.as_deref(), &args.sensors)?;
    let suite = super::sensors::suite(&specs, fc_name)?;
    let Kept {
        state_dir,
        mut keep,
        settings,
        documents,
    } = Kept::open(&args)?;
    let receiver = specs.iter().find(|s| s.driver.starts_with("gps"));
    if let (true, Some(receiver)) = (settings.ground.gps_emulation, receiver) {
        return Err(Usage(format!(
            "KST_GPS_EMU and {receiver}: stations are told of one receiver, a real or an invented one"
        ))
        .into());
    }
    if let (true, Some(receiver)) = (settings.autopilot.fc_gps, receiver) {
        return Err(Usage(format!(
            "KST_FC_GPS and {receiver}: one source of satellite fixes at a time"
        ))
        .into());
    }
    let start = StartArg::on(args.start, &plan);

    let clock = Clock::start(1.0);
    let boot_utc_us = clock::utc_us();
    let mut ground = Ground::new(GroundConfig {
        us: our_address(&settings),
        settings: settings.clone(),
        anchor: plan.anchor(),
        plan: Arc::clone(&plan),
        airframe: Airframe::default(),
        boot_utc_us,
        documents,
    });
    let listen = args.console.map(|a| a.ip());
    let camera = args.camera.start(&mut ground, listen, None)?;
    let console_config = args.console.map(|listen| ConsoleConfig {
        listen,
        is_default: false,
        state_dir: Some(state_dir),
        has_link: false,
        names: host_names(),
        vehicle: place_name(map),
        us: our_address(&settings),
        plan: Arc::clone(&plan),
        settings: settings.clone(),
        camera: camera.desk(),
    });
    let config = FlightConfig {
        plan,
        ring: suite.ring.clone(),
        airframe: Airframe::default(),
        start,
        settings,
        seed: boot_utc_us,
    };
    let made_at = clock.now();
    let header = Header::new(made_at, &config, &format!("fly {fc}"), boot_utc_us);
    let limits = Limits::of(&config.settings);
    let flight = Flight::new(made_at, config);
    // A disk that cannot be written is no reason not to fly, and a reason to say so.
    let started = keep.fresh_run().and_then(|place| {
        place
            .map(|(folder, run)| {
                let files = DiskFiles::of_run(&folder, &run, limits);
                logger::start(header, files, limits, WhenFull::Lose)
            })
            .transpose()
    });
    let (log, no_log) = match started {
        Ok(log) => (log, None),
        Err(e) => (None, Some(format!("Flights are not logged: {e}"))),
    };
    let (taps, log) = log.unzip();
    let (flight_tap, ground_tap) = taps.map(|t| (t.flight, t.ground)).unzip();
    if let Some(why) = no_log {
        ground.say(clock.now(), Severity::Warning, why);
    }
    ground.set_policies(wanted.iter().map(|w| w.policy.clone()).collect());
    if let Some(feed) = suite.mavlink {
        ground.listen_to_sensors(feed);
    }
    let links = Links::open(&wanted).map_err(|e| anyhow!(e))?;
    links.route_for(&mut ground);
    let door = args.passthrough.as_deref().map(open_door).transpose()?;
    let mut handle =
        flight_thread::start(flight, fc.clone(), clock, flight_tap).map_err(|e| anyhow!(e))?;
    let console = console_config
        .map(|config| Console::start(config, links.joint()))
        .transpose()?;
    let sensors_told = bridge::io::sensors::start(suite.devices, &handle.inlet(), clock)
        .context("cannot start the sensors")?;
    let told = match (door, handle.take_borrower()) {
        (Some(door), Some(borrower)) => Some(lend(door, borrower, fc.clone(), stop.clone())?),
        _ => None,
    };

    let mut terminal = Terminal::new(args.quiet);
    terminal.line(&format!("Kestrel {} on {fc}", env!("CARGO_PKG_VERSION")));
    for link in &links.described {
        terminal.line(&format!("  MAVLink {link}"));
    }
    if suite
        .ring
        .rangers
        .iter()
        .all(vehicle::RangerConfig::looks_down)
    {
        terminal.line(
            "  No range finder looks around (--sensor, docs/sensors.md): take-off will be refused.",
        );
    }
    GroundLoop {
        ground,
        handle,
        links,
        console,
        camera: Some(camera),
        keep,
        log,
        tap: ground_tap,
        texts_logged: 0,
        terminal,
        clock,
        stop,
        unanswered: format!(
            "flight controller {fc} does not answer MSP: check the baud rate and that MSP is enabled on that port"
        ),
        told,
        sensors_told: Some(sensors_told),
        shows_status: !args.headless,
        waits: args.wait,
    }
    .run()
}

/// The links as asked for; none named = announced on the local network.
fn wanted(args: &FlyArgs) -> Result<Vec<Wanted>> {
    if args.mavlink.is_empty() {
        parse_endpoints(&[ANNOUNCE.to_owned()])
    } else {
        parse_endpoints(&args.mavlink)
    }
}

/// What an earlier run had kept, and the parameters.
struct Kept {
    state_dir: PathBuf,
    keep: Keep,
    settings: Settings,
    documents: Vec<Document>,
}

impl Kept {
    fn open(args: &FlyArgs) -> Result<Self> {
        let state_dir = args
            .state_dir
            .clone()
            .or_else(state_folder)
            .ok_or_else(|| {
                Usage("no home folder to keep parameters in: name one with --state-dir".to_owned())
            })?;
        let keep = Keep::in_folder(Some(&state_dir))
            .with_context(|| format!("cannot make the state folder {}", state_dir.display()))?;
        let mut settings = settings(args.config.as_deref(), &[])?;
        if let Some(bytes) = keep
            .read("parameters.toml")
            .context("cannot read the stored parameters")?
        {
            settings
                .set_toml(&String::from_utf8_lossy(&bytes), Origin::Stored)
                .context("in the stored parameters")?;
        }
        super::apply_sets(&mut settings, &args.params)?;
        let mut documents = Vec::new();
        for name in DOCUMENTS {
            if let Some(bytes) = keep
                .read(name)
                .with_context(|| format!("cannot read the stored {name}"))?
            {
                documents.push(Document { name, bytes });
            }
        }
        Ok(Self {
            state_dir,
            keep,
            settings,
            documents,
        })
    }
}

/// The thread of `--passthrough`: borrows the line for each client. What it has to tell comes out of the channel.
fn lend(door: Door, borrower: Borrower, fc: Endpoint, stop: Stop) -> Result<Receiver<String>> {
    let (tell, told) = sync_channel(64);
    std::thread::Builder::new()
        .name("passthrough".to_owned())
        .spawn(move || {
            let is_over = || stop.count() > 0;
            let say = |text: String| drop(tell.try_send(text));
            while let Some(client) = door.wait(&is_over) {
                let Some(line) = borrower.borrow() else {
                    say(
                        "a configurator was sent away: the flight controller is armed or absent"
                            .to_owned(),
                    );
                    continue;
                };
                say("a configurator has the flight controller: nothing can be flown".to_owned());
                let mut bench = BenchLine::on(fc.clone(), line);
                let ended = match door.carry(&mut bench, client, &is_over) {
                    Ok(ended) => ended.to_string(),
                    Err(e) => e.to_string(),
                };
                borrower.give_back(bench.into_line());
                say(format!("the configurator's time is over: {ended}"));
            }
        })
        .context("cannot start the thread of --passthrough")?;
    Ok(told)
}

/// What people call the place of a plan: its file, or its folder if the file is called like every other.
fn place_name(map: &Path) -> String {
    let stem = map.file_stem().unwrap_or_default();
    let folder = map.parent().and_then(Path::file_name);
    match folder {
        Some(folder) if stem == "plan" || stem == "map" => folder,
        _ => stem,
    }
    .to_string_lossy()
    .into_owned()
}

/// What this machine is called by others.
pub(crate) fn host_names() -> Vec<String> {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name = name.trim().to_ascii_lowercase();
    if name.is_empty() {
        return Vec::new();
    }
    vec![format!("{name}.local"), name]
}

/// Where a user's programs keep what they must remember (XDG base directories).
pub(crate) fn state_folder() -> Option<PathBuf> {
    let folder = |name: &str| {
        std::env::var_os(name)
            .filter(|v| !v.is_empty())
            .map(PathBuf::from)
    };
    folder("XDG_STATE_HOME")
        .or_else(|| folder("HOME").map(|home| home.join(".local/state")))
        .map(|base| base.join("kestrel"))
}
