//! `kestrel rehearse`: a simulated vehicle without a brain, for `kestrel fly` to fly as the real thing.
//!
//! The flight controller answers on TCP, sensors on pseudo terminals and by MAVLink, all in real time: everything between the
//! wires and the sticks is then the code that flies, with the options that will be used in the air.

use super::sim::StartArg;
use super::{Usage, rooms, sensors};
use anyhow::{Context as _, Result, anyhow};
use bridge::io::clock::Clock;
use bridge::io::endpoint::{Endpoint, EndpointError};
use bridge::io::terminal::Terminal;
use bridge::io::truth::{Row, TruthFile};
use bridge::sensor::options::{Options, SensorSpec};
use clap::Args;
use mavlink_dialect::standard::{
    DISTANCE_SENSOR_DATA, MavDistanceSensor, MavFrame, MavMessage, MavSensorOrientation,
    OBSTACLE_DISTANCE_DATA, OPTICAL_FLOW_RAD_DATA,
};
use mavlink_dialect::{Address, Encoder, Message};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use sim::device::{msp_module, tof_ring};
use sim::{
    FcConfig, LaserConfig, LaserMount, Manner, SimConfig, SimOutput, Simulator, VehicleConfig,
};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use vehicle::{
    DownRange, FlowSample, MapPose, Pace, RangerKind, RangerReading, RingConfig, Timestamp,
};

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel rehearse office --sensor ld06:///tmp/lidar --sensor msp:///tmp/flow\n  kestrel rooms office --export plans/\n  kestrel fly --fc tcpclient://127.0.0.1:5761 --map plans/plan.yaml --sensor ld06:///tmp/lidar --sensor msp:///tmp/flow --mavlink udpserver://127.0.0.1:14555\n\nA sensor is written as for `kestrel fly`; its device is a name for a pseudo terminal, that of `mavlink` the address its\nmessages go to: mavlink://127.0.0.1:14555?obstacle=on&down=on&flow=on\n\nTwo in one room, each flown by a program of its own (docs/examples/two_drones.py does it):\n  kestrel rehearse office --sensor ld06:///tmp/lidar --sensor msp:///tmp/flow --also 4.5,2.0,1.57\n\nA pseudo terminal falls silent while a file of its name with `.cut` at the end is there: `touch /tmp/lidar.cut`."
)]
pub(crate) struct RehearseArgs {
    /// The room it stands in.
    #[arg(value_name = "ROOM", default_value = "office")]
    room: String,
    /// Where its flight controller listens; one client at a time.
    #[arg(long, value_name = "URL", default_value = "tcpserver://127.0.0.1:5761")]
    fc: String,
    /// A sensor and its plug: ld06, rplidar, tof_ring, msp, mavlink (repeatable).
    #[arg(long = "sensor", value_name = "URL")]
    sensors: Vec<String>,
    /// Seed of all noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Which firmware it behaves like (see `kestrel sim --manner`).
    #[arg(long, value_name = "NAME", default_value_t = Manner::default())]
    manner: Manner,
    /// Write where the vehicle really is to a CSV file.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Another vehicle in the same room, which the first sees and which sees the first: where it stands, on the plan
    /// (repeatable). Its flight controller is on the next port, and -2 (-3 ...) is added to its devices and its truth file.
    #[arg(long, value_name = "x,y,yaw", allow_hyphen_values = true)]
    also: Vec<StartArg>,
}

/// Address of the simulated companion that speaks MAVLink: an obstacle sensor.
const COMPANION: Address = Address {
    system: 42,
    component: 196,
};

/// A sensor's plug.
enum Plug {
    Laser(u8, Terminal),
    TofRing {
        terminal: Terminal,
        /// First ranger of the ring and how many.
        rangers: [u8; 2],
        counts: [u8; 16],
    },
    Msp {
        terminal: Terminal,
        flow_at: Option<Timestamp>,
    },
    Mavlink(Companion),
}

/// A companion program that sends what it senses by MAVLink.
struct Companion {
    socket: UdpSocket,
    encoder: Encoder,
    /// Orientation of the rangers from this index on.
    distance: Option<(u8, Vec<u8>)>,
    /// First ranger of the circle, and the circle in 72 bins of cm.
    obstacle: Option<(u8, [u16; 72])>,
    circle: Pace,
    down: bool,
    flow: bool,
}

pub(crate) fn run(args: &RehearseArgs) -> Result<ExitCode> {
    let endpoint: Endpoint = args
        .fc
        .parse()
        .map_err(|e: EndpointError| Usage(e.to_string()))?;
    let Endpoint::TcpServer(address) = endpoint else {
        return Err(Usage(format!("{}: use tcpserver://host:port", args.fc)).into());
    };
    let room = rooms::bundled(&args.room)?;
    let mut places = vec![room.home()];
    for place in &args.also {
        let StartArg::At(place) = place else {
            return Err(Usage("--also unknown: write x,y,yaw".to_owned()).into());
        };
        places.push(*place);
    }
    let (mut crafts, mut vehicles, mut said) = (Vec::new(), Vec::new(), String::new());
    for (number, place) in places.into_iter().enumerate() {
        let (craft, vehicle, devices) = craft(args, &address, number, place)?;
        let fc = craft.listener.local_addr()?;
        said += &format!(
            "vehicle in `{}`: flight controller on {fc}; Ctrl-C ends\n  kestrel fly --fc tcpclient://{fc} --map PLAN.yaml {devices}\n",
            args.room,
        );
        crafts.push(craft);
        vehicles.push(vehicle);
    }
    let simulator = Simulator::new(SimConfig {
        vehicles,
        ..SimConfig::new(room, RingConfig::built_in("tof32")?, args.seed)
    })?;
    let _ = std::io::stdout().write_all(said.as_bytes());
    let _ = std::io::stdout().flush();
    Rehearsal { simulator, crafts }.run()
}

/// The `number`-th vehicle's ends, its place in the world, and the options that fly it.
fn craft(
    args: &RehearseArgs,
    address: &str,
    number: usize,
    place: MapPose,
) -> Result<(Craft, VehicleConfig, String)> {
    let own = |name: &str| match number {
        0 => name.to_owned(),
        n => format!("{name}-{}", n + 1),
    };
    let mut ring = RingConfig {
        name: "rehearsal".to_owned(),
        rangers: Vec::new(),
    };
    let (mut lasers, mut plugs, mut devices) = (Vec::new(), Vec::new(), Vec::new());
    for (mut spec, url) in sensors::specs(None, &args.sensors)?
        .into_iter()
        .zip(&args.sensors)
    {
        let named = own(&spec.place);
        devices.push(format!("--sensor '{}'", url.replace(&spec.place, &named)));
        spec.place = named;
        plugs.push(plug(&spec, &mut ring, &mut lasers)?);
    }
    let vehicle = VehicleConfig {
        fc: FcConfig {
            manner: args.manner,
            ..FcConfig::default()
        },
        lasers,
        ..VehicleConfig::new(place, ring)
    };
    let address = match (number, address.rsplit_once(':')) {
        (1.., Some((host, port))) => {
            let port: u16 = port.parse().with_context(|| format!("no port: {port}"))?;
            // Port 0 is any that is free.
            let next = if port == 0 { 0 } else { port + number as u16 };
            format!("{host}:{next}")
        }
        _ => address.to_owned(),
    };
    let listener =
        TcpListener::bind(&address).with_context(|| format!("cannot listen on {address}"))?;
    listener.set_nonblocking(true)?;
    let truth = match &args.truth {
        Some(path) => {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            let mut path = path.with_file_name(own(&stem));
            path.set_extension(
                args.truth
                    .as_deref()
                    .and_then(Path::extension)
                    .unwrap_or_default(),
            );
            let file = TruthFile::create(&path);
            Some(file.with_context(|| format!("cannot write {}", path.display()))?)
        }
        None => None,
    };
    let craft = Craft {
        listener,
        line: None,
        plugs,
        truth,
        said: Vec::with_capacity(4096),
    };
    Ok((craft, vehicle, devices.join(" ")))
}

fn plug(spec: &SensorSpec, ring: &mut RingConfig, lasers: &mut Vec<LaserConfig>) -> Result<Plug> {
    let usage = |what: String| anyhow!(Usage(what));
    let mut options = Options::of(spec);
    let terminal = || {
        Terminal::open(Path::new(&spec.place))
            .with_context(|| format!("cannot make the pseudo terminal {}", spec.place))
    };
    // Options that are the business of the driver alone.
    const DRIVERS_OWN: [&str; 9] = [
        "baudrate",
        "least_intensity",
        "min_m",
        "max_m",
        "rate_hz",
        "blind_deg",
        "latency_ms",
        "from",
        "half_cone_deg",
    ];
    for own in DRIVERS_OWN {
        let _ = options.text(own);
    }
    let plug = match spec.driver.as_str() {
        driver @ ("ld06" | "rplidar") => {
            let mount = LaserMount {
                offset_m: [
                    options.number("x_m", 0.0, -2.0..=2.0)?,
                    options.number("y_m", 0.0, -2.0..=2.0)?,
                    options.number("z_m", 0.0, -2.0..=2.0)?,
                ],
                yaw_deg: options.number("yaw_deg", 0.0, -360.0..=360.0)?,
                is_upside_down: options.flag("upside_down", false)?,
            };
            lasers.push(if driver == "ld06" {
                LaserConfig::Ld06(mount)
            } else {
                LaserConfig::Rplidar(mount)
            });
            Plug::Laser(lasers.len() as u8 - 1, terminal()?)
        }
        "tof_ring" => {
            let name = options.text("rangers").unwrap_or("tof32");
            let table = sensors::ring(name).map_err(|e| usage(e.to_string()))?;
            let rangers = [ring.rangers.len() as u8, table.rangers.len() as u8];
            ring.rangers.extend(table.rangers);
            Plug::TofRing {
                terminal: terminal()?,
                rangers,
                counts: [0; 16],
            }
        }
        "msp" => {
            let _ = (options.text("yaw_deg"), options.text("counts_per_deg"));
            Plug::Msp {
                terminal: terminal()?,
                flow_at: None,
            }
        }
        "mavlink" => {
            let distance = options.text("distance").map(|text| {
                let orientations: Vec<u8> = text
                    .split(',')
                    .filter_map(|w| w.trim().parse().ok())
                    .collect();
                let first = ring.rangers.len() as u8;
                let eight = RingConfig::built_in("sonar8")
                    .map(|r| r.rangers)
                    .unwrap_or_default();
                ring.rangers.extend(
                    orientations
                        .iter()
                        .filter_map(|o| eight.get(usize::from(*o)).cloned()),
                );
                (first, orientations)
            });
            let obstacle = options.flag("obstacle", false)?.then(|| {
                let first = ring.rangers.len() as u8;
                ring.rangers.extend(
                    RingConfig::built_in("lidar60")
                        .map(|r| r.rangers)
                        .unwrap_or_default(),
                );
                (first, [u16::MAX; 72])
            });
            let socket = UdpSocket::bind("127.0.0.1:0")?;
            socket.set_nonblocking(true)?;
            socket.connect(&spec.place).with_context(|| {
                format!(
                    "mavlink: no address `{}`: write it like mavlink://127.0.0.1:14555",
                    spec.place
                )
            })?;
            let _ = (options.text("vision"), options.text("yaw_deg"));
            Plug::Mavlink(Companion {
                socket,
                encoder: Encoder::new(COMPANION),
                distance,
                obstacle,
                circle: Pace::hz(10.0),
                down: options.flag("down", false)?,
                flow: options.flag("flow", false)?,
            })
        }
        other => {
            return Err(usage(format!(
                "no simulated plug for `{other}`; there are ld06, rplidar, tof_ring, msp, mavlink"
            )));
        }
    };
    options.finish().map_err(|e| usage(e.to_string()))?;
    Ok(plug)
}

struct Rehearsal {
    simulator: Simulator,
    crafts: Vec<Craft>,
}

/// What of a vehicle the world outside touches.
struct Craft {
    listener: TcpListener,
    line: Option<TcpStream>,
    plugs: Vec<Plug>,
    truth: Option<TruthFile>,
    /// Bytes of its flight controller on their way.
    said: Vec<u8>,
}

impl Rehearsal {
    /// Until the program is ended. The world goes on whether anybody flies or not.
    fn run(mut self) -> Result<ExitCode> {
        let clock = Clock::start(1.0);
        let stop = super::stop::Stop::listen()?;
        let pause = Timespec {
            tv_sec: 0,
            tv_nsec: 500_000,
        };
        let mut truth_pace = Pace::hz(50.0);
        let mut heard = [0u8; 2048];
        while stop.count() == 0 {
            self.wait(&pause);
            for (index, craft) in self.crafts.iter_mut().enumerate() {
                craft.read(index, &mut self.simulator, &mut heard)?;
            }
            let now = clock.now();
            let crafts = &mut self.crafts;
            self.simulator.advance(now, &mut |index, output| {
                let Some(craft) = crafts.get_mut(index) else {
                    return;
                };
                match output {
                    SimOutput::FcBytes { bytes, .. } => craft.said.extend_from_slice(&bytes),
                    output => craft
                        .plugs
                        .iter_mut()
                        .for_each(|plug| plug.take(now, &output)),
                }
            });
            let is_due = truth_pace.is_due(now);
            for (index, craft) in self.crafts.iter_mut().enumerate() {
                craft.write();
                if is_due && let Some(truth) = &mut craft.truth {
                    // Nobody estimates here: those columns are zero.
                    let row = Row::take(now, &self.simulator, index, &Default::default());
                    truth.write(&row)?;
                }
            }
        }
        for truth in self.crafts.iter_mut().filter_map(|c| c.truth.as_mut()) {
            truth.flush()?;
        }
        Ok(ExitCode::SUCCESS)
    }

    /// Until a controller is asked something, or for a moment.
    fn wait(&self, pause: &Timespec) {
        let lines = self.crafts.iter().filter_map(|c| c.line.as_ref());
        let mut news: Vec<_> = lines.map(|l| PollFd::new(l, PollFlags::IN)).collect();
        if news.is_empty() {
            bridge::io::clock::sleep(Duration::from_millis(1));
        } else {
            let _ = poll(&mut news, Some(pause));
        }
    }
}

impl Craft {
    /// Takes what is said to its controller and to its sensors.
    fn read(&mut self, index: usize, simulator: &mut Simulator, heard: &mut [u8]) -> Result<()> {
        match &mut self.line {
            None => {
                if let Ok((line, _)) = self.listener.accept() {
                    line.set_nodelay(true)?;
                    line.set_nonblocking(true)?;
                    self.line = Some(line);
                }
            }
            Some(line) => match line.read(heard) {
                Ok(0) => self.line = None,
                Ok(n) => simulator.write_fc(index, &heard[..n]),
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(_) => self.line = None,
            },
        }
        for plug in &mut self.plugs {
            if let Plug::Laser(laser, terminal) = plug {
                let n = terminal.receive(heard);
                simulator.write_laser(index, usize::from(*laser), &heard[..n]);
            }
        }
        Ok(())
    }

    fn write(&mut self) {
        if let Some(line) = &mut self.line
            && line.write_all(&self.said).is_err()
        {
            self.line = None;
        }
        self.said.clear();
    }
}

impl Plug {
    fn take(&mut self, now: Timestamp, output: &SimOutput) {
        let mut bytes = Vec::new();
        match (self, output) {
            (Self::Laser(which, terminal), SimOutput::Laser { laser, bytes }) if which == laser => {
                terminal.send(bytes);
            }
            (
                Self::TofRing {
                    terminal,
                    rangers: [first, n],
                    counts,
                },
                SimOutput::Ranger(reading),
            ) if (*first..*first + *n).contains(&reading.ranger) => {
                let sensor = reading.ranger - *first;
                let count = &mut counts[usize::from(sensor) % 16];
                *count = count.wrapping_add(1);
                let age_us = now.since(reading.at).as_micros() as u64;
                tof_ring::frame(reading, sensor, *count, age_us, &mut bytes);
                terminal.send(&bytes);
            }
            (Self::Msp { terminal, .. }, SimOutput::DownRange(range)) => {
                msp_module::range(range, &mut bytes);
                terminal.send(&bytes);
            }
            (Self::Msp { terminal, flow_at }, SimOutput::Flow(flow)) => {
                if let Some(before) = flow_at.replace(flow.at) {
                    msp_module::flow(flow, flow.at.seconds_since(before), &mut bytes);
                    terminal.send(&bytes);
                }
            }
            (Self::Mavlink(companion), output) => companion.take(now, output),
            _ => {}
        }
    }
}

impl Companion {
    fn send(&mut self, message: MavMessage) {
        let frame = self.encoder.encode_message(&Message::Standard(message));
        // Nobody there yet: a datagram is lost.
        let _ = self.socket.send(&frame);
        // Telemetry that comes back is not ours to read.
        while self.socket.recv(&mut [0u8; 512]).is_ok() {}
    }

    fn take(&mut self, now: Timestamp, output: &SimOutput) {
        match output {
            SimOutput::Ranger(reading) => self.ranger(now, reading),
            SimOutput::DownRange(range) if self.down => {
                self.distance(
                    now,
                    range,
                    MavSensorOrientation::MAV_SENSOR_ROTATION_PITCH_270,
                );
            }
            SimOutput::Flow(flow) if self.flow => self.flow(now, flow),
            _ => {}
        }
    }

    fn distance(&mut self, now: Timestamp, range: &DownRange, orientation: MavSensorOrientation) {
        const MAX_CM: u16 = 400;
        let cm = range
            .distance_m
            .map_or(MAX_CM, |m| (m * 100.0).round() as u16);
        self.send(MavMessage::DISTANCE_SENSOR(DISTANCE_SENSOR_DATA {
            time_boot_ms: now.boot_ms(),
            min_distance: 2,
            max_distance: MAX_CM,
            current_distance: cm,
            mavtype: MavDistanceSensor::MAV_DISTANCE_SENSOR_ULTRASOUND,
            orientation,
            ..DISTANCE_SENSOR_DATA::DEFAULT
        }));
    }

    fn ranger(&mut self, now: Timestamp, reading: &RangerReading) {
        use MavSensorOrientation as O;
        const LEVEL: [MavSensorOrientation; 8] = [
            O::MAV_SENSOR_ROTATION_NONE,
            O::MAV_SENSOR_ROTATION_YAW_45,
            O::MAV_SENSOR_ROTATION_YAW_90,
            O::MAV_SENSOR_ROTATION_YAW_135,
            O::MAV_SENSOR_ROTATION_YAW_180,
            O::MAV_SENSOR_ROTATION_YAW_225,
            O::MAV_SENSOR_ROTATION_YAW_270,
            O::MAV_SENSOR_ROTATION_YAW_315,
        ];
        let orientation = self.distance.as_ref().and_then(|(first, orientations)| {
            let of = orientations.get(usize::from(reading.ranger.checked_sub(*first)?))?;
            LEVEL.get(usize::from(*of)).copied()
        });
        if let Some(orientation) = orientation {
            let distance_m = reading
                .columns_mm
                .first()
                .copied()
                .flatten()
                .map(|mm| f64::from(mm) * 1e-3);
            let range = DownRange {
                at: reading.at,
                distance_m,
            };
            return self.distance(now, &range, orientation);
        }
        let Some((first, bins)) = &mut self.obstacle else {
            return;
        };
        let Some(part) = reading.ranger.checked_sub(*first).filter(|p| *p < 10) else {
            return;
        };
        // Bin i of 72 looks 5 i degrees to the right; of two columns that share a bin the nearer one counts.
        let ring = RingConfig::built_in("lidar60")
            .map(|r| r.rangers)
            .unwrap_or_default();
        let Some(config) = ring
            .get(usize::from(part))
            .filter(|r| r.kind == RangerKind::Laser)
        else {
            return;
        };
        let mut fresh = [None; 72];
        for (column, mm) in reading.columns_mm.iter().enumerate() {
            let deg = config
                .column_bearing_rad(column)
                .to_degrees()
                .rem_euclid(360.0);
            let bin = (deg / 5.0).round() as usize % 72;
            let cm = mm.map_or(1201, |mm| mm / 10);
            fresh[bin] = Some(fresh[bin].map_or(cm, |other: u16| other.min(cm)));
        }
        for (bin, cm) in bins.iter_mut().zip(fresh) {
            *bin = cm.unwrap_or(*bin);
        }
        let distances = *bins;
        if self.circle.is_due(now) {
            self.send(MavMessage::OBSTACLE_DISTANCE(OBSTACLE_DISTANCE_DATA {
                time_usec: now.us(),
                distances,
                min_distance: 15,
                max_distance: 1200,
                increment: 5,
                frame: MavFrame::MAV_FRAME_BODY_FRD,
                ..OBSTACLE_DISTANCE_DATA::DEFAULT
            }));
        }
    }

    fn flow(&mut self, now: Timestamp, flow: &FlowSample) {
        const EXPOSURE_US: u32 = 20_000;
        let integrated = |radps: f64| (radps * f64::from(EXPOSURE_US) * 1e-6) as f32;
        self.send(MavMessage::OPTICAL_FLOW_RAD(OPTICAL_FLOW_RAD_DATA {
            time_usec: now.us(),
            integration_time_us: EXPOSURE_US,
            integrated_x: integrated(flow.x_radps),
            integrated_y: integrated(flow.y_radps),
            distance: -1.0,
            quality: flow.quality,
            ..OPTICAL_FLOW_RAD_DATA::DEFAULT
        }));
    }
}
