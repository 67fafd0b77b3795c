//! `kestrel fly`: the real thing.

use super::fc::passthrough::open_door;
use super::session::end_log;
use super::sim::{StartArg, parse_endpoints};
use super::stop::Stop;
use super::term::Terminal;
use super::{Usage, load_plan, settings};
use anyhow::{Context as _, Result, anyhow};
use bridge::autopilot::door::{Asked, Request, RequestId, Severity, Snapshot, Station};
use bridge::autopilot::flight::{Flight, FlightConfig, Start};
use bridge::autopilot::ground::{Ground, GroundConfig, GroundOutput};
use bridge::gcs::Document;
use bridge::io::bench_line::BenchLine;
use bridge::io::clock::{self, Clock};
use bridge::io::endpoint::{Endpoint, EndpointError};
use bridge::io::flight_thread::{self, Borrower, FlightHandle, News};
use bridge::io::host::HostWatch;
use bridge::io::keep::Keep;
use bridge::io::lockstep::our_address;
use bridge::io::logger::{self, DiskFiles, GroundTap, Limits, LogThread, WhenFull};
use bridge::io::net::{LinkEvent, Links};
use bridge::io::passthrough::Door;
use bridge::log::{GroundRecord, Header};
use bridge::settings::Origin;
use clap::Args;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use vehicle::{Airframe, Pace, RingConfig, Timestamp};

/// How often the door is looked at when no link speaks.
const LOOK: Duration = Duration::from_millis(2);
/// A controller that has not said who it is after this does not hear us, or we not it.
const FIRST_ANSWER: Duration = Duration::from_secs(6);
/// Longest landing before the program ends anyway.
const LANDING: Duration = Duration::from_secs(30);

/// Fly the real thing.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel fly --fc serial:///dev/ttyAMA0?baudrate=115200 --map plan.yaml --mavlink udpclient://192.168.1.2:14550\n  kestrel fly --fc tcpclient://127.0.0.1:5761 --map plan.yaml --mavlink udpserver://127.0.0.1:14555    a firmware simulator\n\nRange finder drivers are not built yet: without a ring that speaks, take-off is refused."
)]
pub(crate) struct FlyArgs {
    /// Flight controller: serial:///dev/...?baudrate=N or tcpclient://host:port.
    #[arg(long, value_name = "URL")]
    fc: String,
    /// Floor plan (ROS map_server YAML).
    #[arg(long, value_name = "PLAN.yaml")]
    map: PathBuf,
    /// MAVLink endpoint (repeatable); only these open.
    #[arg(long, value_name = "URL")]
    mavlink: Vec<String>,
    /// Where it stands: x,y,yaw (plan metres, radians counter-clockwise from plan x), or `unknown`; default: the plan's home.
    #[arg(long, value_name = "x,y,yaw|unknown", allow_hyphen_values = true)]
    start: Option<StartArg>,
    /// Ring of range finders: tof32, sonar8, snsi6, or a TOML file.
    #[arg(long, value_name = "NAME|FILE", default_value = "tof32")]
    rangers: String,
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
    /// No status line.
    #[arg(long)]
    headless: bool,
    /// Say nothing.
    #[arg(long)]
    quiet: bool,
}

pub(crate) fn run(args: FlyArgs) -> Result<ExitCode> {
    let stop = Stop::listen()?;
    let fc: Endpoint = args
        .fc
        .parse()
        .map_err(|e: EndpointError| Usage(e.to_string()))?;
    if args.mavlink.is_empty() {
        return Err(Usage(
            "name at least one --mavlink endpoint: in `fly` only named links open".to_owned(),
        )
        .into());
    }
    let wanted = parse_endpoints(&args.mavlink)?;
    let plan = Arc::new(load_plan(&args.map)?);
    let ring = match RingConfig::built_in(&args.rangers) {
        Ok(ring) => ring,
        Err(e) if !args.rangers.ends_with(".toml") => return Err(Usage(e.to_string()).into()),
        Err(_) => {
            let text = std::fs::read_to_string(&args.rangers)
                .with_context(|| format!("cannot read {}", args.rangers))?;
            RingConfig::from_toml(&text).with_context(|| format!("in {}", args.rangers))?
        }
    };
    let state_dir = args
        .state_dir
        .clone()
        .or_else(state_folder)
        .ok_or_else(|| {
            Usage("no home folder to keep parameters in: name one with --state-dir".to_owned())
        })?;
    let mut keep = Keep::in_folder(Some(&state_dir))
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
    for name in [
        "mission.json",
        "fence.json",
        "rally.json",
        "signing-clock.txt",
    ] {
        if let Some(bytes) = keep
            .read(name)
            .with_context(|| format!("cannot read the stored {name}"))?
        {
            documents.push(Document { name, bytes });
        }
    }
    let start = match args.start {
        Some(StartArg::At(pose)) => Start::Known(pose),
        Some(StartArg::Unknown) => Start::Unknown,
        None => Start::Known(plan.home.unwrap_or_default()),
    };

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
    let config = FlightConfig {
        plan,
        ring,
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
    ground.set_keys(wanted.iter().map(|w| w.key.clone()).collect());
    let links = Links::open(&wanted).map_err(|e| anyhow!(e))?;
    let door = args.passthrough.as_deref().map(open_door).transpose()?;
    let mut handle =
        flight_thread::start(flight, fc.clone(), clock, flight_tap).map_err(|e| anyhow!(e))?;
    let told = match (door, handle.take_borrower()) {
        (Some(door), Some(borrower)) => Some(lend(door, borrower, fc.clone(), stop.clone())?),
        _ => None,
    };

    let mut terminal = Terminal::new(args.quiet);
    terminal.line(&format!("Kestrel {} on {fc}", env!("CARGO_PKG_VERSION")));
    for link in &links.described {
        terminal.line(&format!("  MAVLink {link}"));
    }
    terminal.line(
        "  Range finder drivers are not built yet: take-off will be refused until a ring speaks.",
    );
    GroundLoop {
        ground,
        handle,
        links,
        keep,
        log,
        tap: ground_tap,
        texts_logged: 0,
        terminal,
        clock,
        stop,
        fc,
        told,
        shows_status: !args.headless,
        waits: args.wait,
    }
    .run()
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

/// `Ground` and its links, on the main thread.
struct GroundLoop {
    ground: Ground,
    handle: FlightHandle,
    links: Links,
    keep: Keep,
    log: Option<LogThread>,
    tap: Option<GroundTap>,
    texts_logged: u64,
    terminal: Terminal,
    clock: Clock,
    stop: Stop,
    fc: Endpoint,
    /// What the thread of `--passthrough` tells.
    told: Option<Receiver<String>>,
    shows_status: bool,
    /// A controller that has never answered is waited for.
    waits: bool,
}

impl GroundLoop {
    fn run(mut self) -> Result<ExitCode> {
        let mut snapshot = Snapshot::default();
        let mut known = BTreeSet::new();
        let mut status = Pace::hz(2.0);
        let mut texts_shown = Timestamp::ZERO;
        let mut seen_tick = 0;
        // Open, and whether it answers is not known yet.
        let mut is_open = false;
        let mut was_connected = false;
        let mut opened_at = Timestamp::ZERO;
        let mut stopping_since: Option<Timestamp> = None;
        let mut host_watch = HostWatch::default();
        let mut host_pace = Pace::hz(1.0);
        loop {
            let mut event = self.links.wait(LOOK);
            for _ in 0..256 {
                let Some(e) = event.take() else { break };
                let now = self.clock.now();
                match e {
                    LinkEvent::Up(link) => {
                        known.insert(link);
                        self.ground.link_up(now, link);
                    }
                    LinkEvent::Down(link) => {
                        known.remove(&link);
                        self.ground.link_down(link);
                    }
                    LinkEvent::Bytes {
                        link,
                        bytes,
                        is_datagram,
                    } => {
                        self.ground.receive(now, link, &bytes, is_datagram);
                        self.record(|| GroundRecord::Received {
                            at: now,
                            link,
                            bytes: bytes.to_vec(),
                            is_datagram,
                        });
                    }
                }
                self.carry_out();
                event = self.links.poll();
            }
            let now = self.clock.now();
            while let Some(news) = self.handle.poll() {
                match news {
                    News::Answer(answer) => self.ground.answer(now, &answer),
                    News::Event(event) => self.ground.event(now, &event),
                    News::Realtime(granted) => self.terminal.line(&format!("  {granted}")),
                    // Whoever mistyped a device wants to know it now; one that was there comes back.
                    News::LineAbsent(why) if !was_connected && !self.waits => {
                        self.terminal.finish();
                        return Err(anyhow!("{why} (--wait waits for it)"));
                    }
                    News::LineAbsent(why) => self
                        .terminal
                        .line(&format!("  {why}; trying again until it is there")),
                    News::LineOpened => {
                        is_open = true;
                        opened_at = now;
                    }
                }
                self.carry_out();
            }
            while let Some(text) = self.told.as_ref().and_then(|told| told.try_recv().ok()) {
                self.terminal.line(&format!("  {text}"));
            }
            self.handle.read_snapshot(&mut snapshot);
            if snapshot.flight_loop.ticks != seen_tick {
                seen_tick = snapshot.flight_loop.ticks;
                self.ground.snapshot(now, &snapshot);
                self.record(|| GroundRecord::Snapshot(Box::new(snapshot.clone())));
            }
            if host_pace.is_due(now) {
                let disk_fails = self.log.as_ref().is_some_and(LogThread::is_failing);
                let dropped = self.ground.counters().dropped_answers;
                self.handle.tell_host(host_watch.look(disk_fails, dropped));
            }
            if self.ground.deadline() <= now {
                self.ground.tick(now);
            }
            self.carry_out();
            self.terminal.texts(&self.ground, &mut texts_shown);
            if self.shows_status && status.is_due(now) {
                self.terminal.status(&snapshot, known.len());
            }
            if snapshot.fc.is_connected {
                (is_open, was_connected) = (false, true);
            } else if is_open && now.since(opened_at) > FIRST_ANSWER {
                is_open = false;
                let why = format!(
                    "flight controller {} does not answer MSP: check the baud rate and that MSP is enabled on that port",
                    self.fc
                );
                if !was_connected && !self.waits {
                    self.terminal.finish();
                    return Err(anyhow!("{why} (--wait asks on)"));
                }
                self.terminal.line(&format!("  {why}; asking on"));
            }
            match (self.stop.count(), stopping_since) {
                (0, _) => {}
                (1, None) => {
                    stopping_since = Some(now);
                    self.terminal
                        .line("  Stopping: landing first (Ctrl-C again ends at once)");
                    let asked = Asked {
                        id: RequestId(0),
                        station: Station::default(),
                        request: Request::ShutDown,
                    };
                    let _ = self.handle.ask(asked);
                }
                (1, Some(since)) => {
                    let is_down =
                        !snapshot.is_armed && now.since(since) > Duration::from_millis(200);
                    if is_down || now.since(since) > LANDING {
                        break;
                    }
                }
                _ => break,
            }
        }
        if let Some(log) = self.log.take() {
            end_log(log, &mut self.terminal);
        }
        self.terminal.finish();
        Ok(ExitCode::SUCCESS)
    }

    fn carry_out(&mut self) {
        while let Some(output) = self.ground.poll() {
            match output {
                GroundOutput::Send { link, bytes } => {
                    let at = self.clock.now();
                    self.record(|| GroundRecord::Sent {
                        at,
                        link,
                        frame: bytes.clone(),
                    });
                    self.links.send(link, bytes);
                }
                GroundOutput::Request(asked) => {
                    if !self.handle.ask(asked) {
                        self.terminal
                            .line("  the flight thread is behind: a request was dropped");
                    }
                }
                GroundOutput::Disk(ticket, job) => {
                    let reply = self.keep.carry_out(&job);
                    self.ground.disk(self.clock.now(), ticket, &reply);
                }
                GroundOutput::Keep(document) => {
                    if let Err(e) = self.keep.write(&document) {
                        self.terminal
                            .line(&format!("  cannot keep {}: {e}", document.name));
                    }
                }
            }
        }
        let Some(tap) = &mut self.tap else { return };
        for told in self.ground.texts_since(&mut self.texts_logged) {
            tap.put(GroundRecord::Text {
                at: told.at,
                severity: told.severity,
                text: told.text.clone(),
            });
        }
    }

    fn record(&mut self, record: impl FnOnce() -> GroundRecord) {
        if let Some(tap) = &mut self.tap {
            tap.put(record());
        }
    }
}
