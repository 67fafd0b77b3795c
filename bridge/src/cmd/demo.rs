//! `kestrel demo`: a patrol flown in the simulator through the MAVLink door, with a summary and a picture.

use super::picture::{Picture, TrackPoint};
use super::session::end_log;
use super::sim::{Built, SimArgs, Speed};
use super::stop::Stop;
use super::term::Terminal;
use anyhow::{Context as _, Result, bail};
use bridge::gcs::LinkId;
use bridge::io::clock::Clock;
use bridge::io::lockstep::{Lockstep, Outgoing};
use bridge::io::logger::WhenFull;
use bridge::io::net::LinkEvent;
use bridge::io::truth::Row;
use bridge::station::{self, GroundStation, Reply};
use clap::Args;
use mavlink_dialect::mode::Px4Mode;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use vehicle::{In, Map, Ned, Pace, Timestamp};

/// The in-process station's link.
const STATION: LinkId = LinkId(0);
/// Flying height, m.
const HEIGHT_M: f64 = 1.0;
/// Places visited at most.
const PLACES: usize = 5;
/// Landing this near home counts as home, m.
const HOME_M: f64 = 0.3;
/// A flight longer than this (virtual time) has gone wrong.
const TIME_OUT: Duration = Duration::from_secs(600);

/// Fly a scripted patrol in the simulator and draw it.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel demo                       as fast as it goes; writes flight.svg\n  kestrel demo --speed 1             in real time: watch it in QGroundControl\n  kestrel demo maze --seed 7 --out pictures/"
)]
pub(crate) struct DemoArgs {
    #[command(flatten)]
    sim: SimArgs,
    /// Folder for flight.svg.
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
}

pub(crate) fn run(args: DemoArgs) -> Result<ExitCode> {
    let stop = Stop::listen()?;
    let speed = args.sim.speed.unwrap_or(Speed::Max);
    // Nothing flies: a slow disk may hold it up.
    let Built {
        mut lockstep, log, ..
    } = args.sim.build(WhenFull::Wait)?;
    // Only a flight that can be watched needs links.
    let links = match speed {
        Speed::Max if args.sim.mavlink.is_empty() => None,
        _ => Some(args.sim.links(&mut lockstep.ground)?),
    };
    let mut terminal = Terminal::new(args.sim.quiet);
    let places = places(&lockstep)?;
    terminal.line(&format!(
        "Patrol of `{}`, seed {}: {}",
        args.sim.room,
        args.sim.seed,
        places
            .iter()
            .map(|p| p.name.as_str())
            .collect::<Vec<_>>()
            .join(", ")
    ));

    let mut flight = Demo::new(places.clone());
    lockstep.link_up(STATION);
    let clock = match speed {
        Speed::Times(x) => Some(Clock::start(x)),
        Speed::Max => None,
    };
    let mut status = Pace::hz(1.0);
    let mut texts_shown = Timestamp::ZERO;
    let mut track_pace = Pace::hz(20.0);
    let mut track = Vec::new();
    while !flight.is_over(&lockstep) && stop.count() == 0 {
        let now = lockstep.now();
        if now > Timestamp::ZERO + TIME_OUT {
            flight.fault = Some("the flight took too long".to_owned());
            break;
        }
        lockstep.advance(now + Duration::from_millis(5));
        let now = lockstep.now();
        if let Some(links) = &links {
            let mut event = clock
                .as_ref()
                .map_or_else(|| links.poll(), |clock| links.wait(clock.until(now)));
            // Bounded: a flood waits in its queue, not in our loop.
            for _ in 0..256 {
                match event {
                    Some(LinkEvent::Up(link)) => lockstep.link_up(link),
                    Some(LinkEvent::Down(link)) => lockstep.link_down(link),
                    Some(LinkEvent::Bytes {
                        link,
                        bytes,
                        is_datagram,
                    }) => lockstep.receive(link, &bytes, is_datagram),
                    None => break,
                }
                event = links.poll();
            }
        }
        while let Some(out) = lockstep.poll() {
            match out {
                Outgoing::Frame(STATION, frame) => flight.station.receive(&frame),
                Outgoing::Frame(link, frame) => {
                    if let Some(links) = &links {
                        links.send(link, frame);
                    }
                }
                Outgoing::Keep(_) | Outgoing::Disk(..) => {}
            }
        }
        flight.step(now);
        while let Some(frame) = flight.station.poll() {
            lockstep.receive(STATION, &frame, true);
        }
        if track_pace.is_due(now) {
            let row = Row::take(now, &lockstep.simulator, 0, lockstep.snapshot());
            track.push(TrackPoint {
                row,
                target: lockstep.snapshot().setpoint,
            });
        }
        terminal.texts(&lockstep.ground, &mut texts_shown);
        if status.is_due(now) && !args.sim.headless {
            terminal.status(lockstep.snapshot(), 1);
        }
    }
    terminal.finish();
    lockstep.flush();
    if let Some(log) = log {
        end_log(log, &mut terminal);
    }
    if let Some(e) = lockstep.write_error.take() {
        return Err(anyhow::Error::new(e).context("a log could not be written completely"));
    }
    let summary = Summary::of(&lockstep, &track, &places, &flight);
    terminal.line(&summary.to_string());

    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make {}", args.out.display()))?;
    let path = args.out.join("flight.svg");
    let title = format!("{}, seed {}", args.sim.room, args.sim.seed);
    let anchor = lockstep.simulator.anchor();
    let picture = Picture {
        title: &title,
        room: lockstep.simulator.room(),
        anchor,
        track: &track,
    };
    std::fs::write(&path, picture.svg())
        .with_context(|| format!("cannot write {}", path.display()))?;
    terminal.line(&format!("  picture: {}", path.display()));

    match summary.failure() {
        None => Ok(ExitCode::SUCCESS),
        Some(why) => bail!(
            "the patrol did not end well: {why}; fly it again with `kestrel demo {} --seed {}`",
            args.sim.room,
            args.sim.seed
        ),
    }
}

/// A place to visit.
#[derive(Clone, Debug)]
struct Place {
    name: String,
    ned: In<Ned>,
}

/// The named rooms of the plan, each next one the nearest not yet visited; free places where the plan names none.
fn places(lockstep: &Lockstep) -> Result<Vec<Place>> {
    let plan = lockstep.simulator.floor_plan();
    let anchor = lockstep.simulator.anchor();
    let mut open: Vec<(String, In<Map>)> = plan
        .rooms
        .iter()
        .map(|r| (r.name.clone(), In::new(r.x, r.y, 0.0)))
        .collect();
    let mut here = anchor.to_map(In::zero());
    if open.is_empty() {
        // Places far from each other and from walls.
        let clearance = plan.distance_field(5.0);
        let mut chosen = vec![here];
        while open.len() < 4 {
            let far = (0..plan.height() as i64)
                .step_by(4)
                .flat_map(|row| {
                    (0..plan.width() as i64)
                        .step_by(4)
                        .map(move |column| (column, row))
                })
                .map(|(column, row)| plan.centre_of(column, row))
                .filter(|p| plan.is_free(*p) && clearance.at(*p) > 0.5)
                .map(|p| {
                    (
                        chosen
                            .iter()
                            .map(|c| (*c - p).norm_xy())
                            .fold(f64::INFINITY, f64::min),
                        p,
                    )
                })
                .max_by(|a, b| a.0.total_cmp(&b.0));
            match far {
                Some((distance, p)) if distance > 1.0 => {
                    chosen.push(p);
                    open.push((format!("place {}", open.len() + 1), p));
                }
                _ => break,
            }
        }
    }
    let mut visits = Vec::new();
    while let Some(nearest) = (0..open.len())
        .min_by(|a, b| {
            (open[*a].1 - here)
                .norm_xy()
                .total_cmp(&(open[*b].1 - here).norm_xy())
        })
        .filter(|_| visits.len() < PLACES)
    {
        let (name, map) = open.swap_remove(nearest);
        here = map;
        let ned = anchor.to_ned(map).with_z(-HEIGHT_M);
        if ned.norm_xy() > 1.0 {
            visits.push(Place { name, ned });
        }
    }
    if visits.is_empty() {
        bail!("this floor plan has no free place to fly to");
    }
    Ok(visits)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    WaitReady,
    Uploading,
    Arming,
    Starting,
    Flying,
    Down,
}

/// The script: wait until armable, upload, arm, fly the mission, wait until landed and disarmed.
struct Demo {
    station: GroundStation,
    places: Vec<Place>,
    stage: Stage,
    fault: Option<String>,
}

impl Demo {
    fn new(places: Vec<Place>) -> Self {
        Self {
            station: GroundStation::default(),
            places,
            stage: Stage::WaitReady,
            fault: None,
        }
    }

    fn is_over(&self, lockstep: &Lockstep) -> bool {
        self.fault.is_some() || (self.stage == Stage::Down && !lockstep.snapshot().is_armed)
    }

    fn step(&mut self, now: Timestamp) {
        self.station.tick(now);
        let reply = self.station.reply();
        if let Some(Reply::Command(command, result)) = reply
            && result != 0
        {
            let texts = &self.station.heard().texts;
            self.fault = Some(format!(
                "command {command} was refused ({result}): {}",
                texts.last().cloned().unwrap_or_default()
            ));
            return;
        }
        let heard = self.station.heard();
        match (self.stage, reply) {
            (Stage::WaitReady, _) if heard.vehicle.is_some() && heard.is_armable => {
                let mut items = vec![station::take_off(HEIGHT_M)];
                items.extend(
                    self.places
                        .iter()
                        .map(|p| station::waypoint(p.ned.x(), p.ned.y(), p.ned.z(), None)),
                );
                items.push(station::return_home());
                self.station.upload(now, items);
                self.stage = Stage::Uploading;
            }
            (Stage::Uploading, Some(Reply::Upload(0))) => {
                self.station.arm(now, true);
                self.stage = Stage::Arming;
            }
            (Stage::Uploading, Some(Reply::Upload(code))) => {
                let why = heard.texts.last().cloned().unwrap_or_default();
                self.fault = Some(format!("the mission was refused ({code}): {why}"));
            }
            (Stage::Arming, Some(Reply::Command(..))) => {
                self.station.set_mode(now, Px4Mode { main: 4, sub: 4 });
                self.stage = Stage::Starting;
            }
            (Stage::Starting, Some(Reply::Command(..))) => self.stage = Stage::Flying,
            (Stage::Flying, _) if !heard.is_armed && heard.landed_state == 1 => {
                self.stage = Stage::Down
            }
            _ => {}
        }
    }
}

/// How it went, by the simulator's truth.
struct Summary {
    duration_s: f64,
    path_m: f64,
    contacts: u32,
    landing_error_m: f64,
    error_mean_m: f64,
    error_p95_m: f64,
    places: usize,
    nearest_m: Vec<(String, f64)>,
    fault: Option<String>,
}

impl Summary {
    fn of(lockstep: &Lockstep, track: &[TrackPoint], places: &[Place], demo: &Demo) -> Self {
        let distance = |a: [f64; 3], b: [f64; 3]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let in_air: Vec<&TrackPoint> = track.iter().filter(|t| t.row.position[2] < -0.15).collect();
        let path_m = in_air
            .windows(2)
            .map(|w| distance(w[0].row.position, w[1].row.position))
            .sum();
        let mut errors: Vec<f64> = in_air
            .iter()
            .map(|t| distance(t.row.position, t.row.est_position))
            .collect();
        errors.sort_by(f64::total_cmp);
        let mean = if errors.is_empty() {
            0.0
        } else {
            errors.iter().sum::<f64>() / errors.len() as f64
        };
        let p95 = errors.get(errors.len() * 95 / 100).copied().unwrap_or(0.0);
        let truth = lockstep.simulator.truth(0);
        let nearest_m = places
            .iter()
            .map(|p| {
                let to: [f64; 3] = p.ned.into();
                let near = track
                    .iter()
                    .map(|t| distance(t.row.position, to))
                    .fold(f64::INFINITY, f64::min);
                (p.name.clone(), near)
            })
            .collect();
        Self {
            duration_s: lockstep.now().s(),
            path_m,
            contacts: truth.contacts,
            landing_error_m: truth.position.norm_xy(),
            error_mean_m: mean,
            error_p95_m: p95,
            places: places.len(),
            nearest_m,
            fault: demo.fault.clone(),
        }
    }

    fn failure(&self) -> Option<String> {
        if let Some(fault) = &self.fault {
            return Some(fault.clone());
        }
        if self.contacts > 0 {
            return Some(format!("{} contacts", self.contacts));
        }
        if self.landing_error_m > HOME_M {
            return Some(format!("landed {:.2} m from home", self.landing_error_m));
        }
        self.nearest_m
            .iter()
            .find(|(_, m)| *m > 0.3)
            .map(|(name, m)| format!("{name} was passed at {m:.2} m"))
    }
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let worst = self.nearest_m.iter().map(|(_, m)| *m).fold(0.0, f64::max);
        write!(
            f,
            "  {} places, {:.1} m in {:.0} s | contacts {} | landed {:.2} m from home | places passed within {worst:.2} m\n  estimate against truth: mean {:.3} m, 95 % {:.3} m",
            self.places,
            self.path_m,
            self.duration_s,
            self.contacts,
            self.landing_error_m,
            self.error_mean_m,
            self.error_p95_m,
        )
    }
}
