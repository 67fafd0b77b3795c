//! `kestrel sim`: a drone in a simulated room, in real time, for ordinary ground stations.

mod args;

use args::Switch;
pub(crate) use args::{AirframeArg, DialectArg, FirmwareArg, SimArgs, Speed, StartArg};

use super::camera::CameraSeat;
use super::session::{DEFAULT_LINKS, Session};
use super::stop::Stop;
use super::term::Terminal;
use super::{Usage, firmware, rooms};
use anyhow::{Context as _, Result, anyhow};
use bridge::autopilot::flight::Start;
use bridge::autopilot::ground::Ground;
use bridge::gcs::access::LinkPolicy;
use bridge::gcs::{DOCUMENTS, Document};
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
use sim::{Room, SimConfig, Simulator, VehicleConfig};
use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use vehicle::{FloorPlan, In, MapPose, RingConfig, Timestamp};

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
            .read("parameters.toml")
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
        links.route_for(ground);
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
