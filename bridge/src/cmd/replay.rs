//! `kestrel replay`: a recorded flight flown again.

use super::sim::{Speed, parse_endpoints};
use super::stop::Stop;
use super::term::Terminal;
use super::{Usage, log::read_parts};
use anyhow::{Context as _, Result, anyhow};
use bridge::autopilot::door::Snapshot;
use bridge::autopilot::ground::{Ground, GroundConfig, GroundOutput};
use bridge::io::clock::{Clock, monotonic_ns};
use bridge::io::lockstep::our_address;
use bridge::io::net::{LinkEvent, Links};
use bridge::log::replay::{Replay, Report, Seen};
use bridge::log::{Emitted, LogFile};
use clap::Args;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use vehicle::{In, Ned, Timestamp};

/// Fly a recorded flight again.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel replay 0007.mcap --check                         the same, bit for bit? exit code 1 and the first difference if not\n  kestrel replay 0007.mcap --set LOC_LOST_T=2              what would have been with another parameter\n  kestrel replay 0007.mcap --mavlink udpclient://127.0.0.1:14550 --speed 1   watch it in a ground station\n\nParts that follow (0007-2.mcap ...) are read too. A log is checked by the program that wrote it: another version may compute otherwise."
)]
pub(crate) struct ReplayArgs {
    /// The log.
    file: PathBuf,
    /// Compare everything that comes out with what came out then.
    #[arg(long)]
    check: bool,
    /// Set a parameter otherwise: NAME=VALUE (repeatable).
    #[arg(long = "set", value_name = "NAME=VALUE")]
    sets: Vec<String>,
    /// Show it to ground stations (repeatable).
    #[arg(long, value_name = "URL")]
    mavlink: Vec<String>,
    /// Recorded seconds a second, or `max`; default: max, with --mavlink 1.
    #[arg(long, value_name = "X|max")]
    speed: Option<Speed>,
    /// Say nothing but what differs.
    #[arg(long)]
    quiet: bool,
}

pub(crate) fn run(args: ReplayArgs) -> Result<ExitCode> {
    let stop = Stop::listen()?;
    let mut terminal = Terminal::new(args.quiet);
    let parts = read_parts(&args.file)?;
    let sets: Vec<(&str, &str)> = args
        .sets
        .iter()
        .map(|set| {
            set.split_once('=')
                .ok_or_else(|| Usage(format!("--set {set}: write it like NAME=VALUE")))
        })
        .collect::<Result<_, _>>()?;
    let mut replay = Replay::new(&parts, &sets)
        .with_context(|| format!("cannot fly {} again", args.file.display()))?;
    let mut audience = Audience::open(&args, &parts)?;
    let speed = match (args.speed, audience.is_some()) {
        (Some(Speed::Times(x)), _) => Some(x),
        (None, true) => Some(1.0),
        (Some(Speed::Max), _) | (None, false) => None,
    };
    let mut then = Track::of(&parts);
    let clock = speed.map(Clock::start);
    let began_ns = monotonic_ns();
    loop {
        if let (Some(clock), Some(at)) = (&clock, replay.next_at()) {
            while clock.now() < at && stop.count() == 0 {
                match &mut audience {
                    Some(audience) => audience.wait(clock, at),
                    None => bridge::io::clock::sleep(clock.until(at)),
                }
            }
        }
        let at = replay.next_at().unwrap_or(replay.report().end);
        let goes_on = replay.step(|seen| {
            if let Seen::Tick(snapshot) = &seen {
                then.compare(snapshot);
            }
            if let Some(audience) = &mut audience {
                audience.see(at, &seen);
            }
        });
        if !goes_on || stop.count() > 0 {
            break;
        }
    }
    let took_s = (monotonic_ns() - began_ns) as f64 * 1e-9;
    let report = replay.report();
    let flown_s = report.end.s();
    terminal.line(&format!(
        "{flown_s:.1} s flown again in {took_s:.2} s ({:.0} x real time): {} inputs, {} outputs, {} ticks",
        flown_s / took_s.max(1e-6),
        report.inputs,
        report.outputs,
        report.ticks
    ));
    Ok(verdict(&args, report, &then, &mut terminal))
}

fn verdict(args: &ReplayArgs, report: &Report, then: &Track, terminal: &mut Terminal) -> ExitCode {
    if let Some((m, at_s)) = then.farthest {
        terminal.line(&format!(
            "  estimates are up to {m:.3} m apart, at {at_s:.1} s; {} of {} ticks differ",
            report.differing_ticks, report.ticks
        ));
    }
    if report.lost > 0 {
        terminal.line(&format!(
            "  {} records are missing in the log: nothing can be compared from there on",
            report.lost
        ));
    }
    match &report.difference {
        None if report.lost == 0 => {
            terminal.line("  the same, bit for bit");
            ExitCode::SUCCESS
        }
        None => ExitCode::from(u8::from(args.check)),
        Some(difference) if args.sets.is_empty() || args.check => {
            super::term::complain(&difference.to_string());
            ExitCode::from(u8::from(args.check))
        }
        Some(difference) => {
            terminal.line(&format!("  first difference: {difference}"));
            ExitCode::SUCCESS
        }
    }
}

/// Estimated places as recorded in `/state`, by tick time, ms.
struct Track {
    places: BTreeMap<u64, In<Ned>>,
    /// Largest distance between then and now, m, and when, s.
    farthest: Option<(f64, f64)>,
}

impl Track {
    fn of(parts: &[LogFile]) -> Self {
        let places = parts
            .iter()
            .flat_map(|p| p.values("/state"))
            .filter_map(|(_, state)| {
                let n = |pointer: &str| state.pointer(pointer)?.as_f64();
                let place = In::new(
                    n("/position_m/0")?,
                    n("/position_m/1")?,
                    n("/position_m/2")?,
                );
                Some(((n("/t_s")? * 1e4).round() as u64, place))
            })
            .collect();
        Self {
            places,
            farthest: None,
        }
    }

    fn compare(&mut self, snapshot: &Snapshot) {
        let key = (snapshot.at.s() * 1e4).round() as u64;
        if let Some(then) = self.places.get(&key) {
            let m = (snapshot.nav.position - *then).norm();
            if self.farthest.is_none_or(|(most, _)| m > most) {
                self.farthest = Some((m, snapshot.at.s()));
            }
        }
    }
}

/// Ground stations that watch.
struct Audience {
    ground: Ground,
    links: Links,
    snapshot_at: Timestamp,
}

impl Audience {
    fn open(args: &ReplayArgs, parts: &[LogFile]) -> Result<Option<Self>> {
        if args.mavlink.is_empty() {
            return Ok(None);
        }
        let wanted = parse_endpoints(&args.mavlink)?;
        let header = parts
            .first()
            .ok_or_else(|| anyhow!("no log"))?
            .header
            .clone()?;
        let config = header.config()?;
        let mut ground = Ground::new(GroundConfig {
            us: our_address(&config.settings),
            anchor: config.plan.anchor(),
            plan: Arc::clone(&config.plan),
            airframe: config.airframe,
            boot_utc_us: header.boot_utc_us,
            documents: Vec::new(),
            settings: config.settings,
        });
        ground.set_policies(wanted.iter().map(|w| w.policy.clone()).collect());
        let links = Links::open(&wanted).map_err(|e| anyhow!(e))?;
        Ok(Some(Self {
            ground,
            links,
            snapshot_at: Timestamp::ZERO,
        }))
    }

    fn see(&mut self, at: Timestamp, seen: &Seen<'_>) {
        match seen {
            Seen::Output(Emitted::Event(event)) => self.ground.event(at, event),
            Seen::Output(_) => {}
            Seen::Tick(snapshot) => {
                self.snapshot_at = at;
                self.ground.snapshot(at, snapshot);
            }
        }
        if self.ground.deadline() <= at {
            self.ground.tick(at);
        }
        self.carry_out();
    }

    /// Listens to the stations until it is time. What they ask for changes nothing: the flight is over.
    fn wait(&mut self, clock: &Clock, at: Timestamp) {
        let now = self.snapshot_at;
        match self.links.wait(clock.until(at)) {
            Some(LinkEvent::Up(link)) => drop(self.ground.link_up(now, link)),
            Some(LinkEvent::Down(link)) => self.ground.link_down(link),
            Some(LinkEvent::Bytes {
                link,
                bytes,
                is_datagram,
            }) => self.ground.receive(now, link, &bytes, is_datagram),
            None => {}
        }
        self.carry_out();
    }

    fn carry_out(&mut self) {
        while let Some(output) = self.ground.poll() {
            if let GroundOutput::Send { link, bytes } = output {
                self.links.send(link, bytes);
            }
        }
    }
}
