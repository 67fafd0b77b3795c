//! A simulated vehicle behind sockets until somebody says stop.

use super::camera::CameraSeat;
use super::stop::Stop;
use super::term::Terminal;
use anyhow::Result;
use bridge::autopilot::door::{HostReport, Snapshot};
use bridge::autopilot::flight::Flight;
use bridge::autopilot::ground::Ground;
use bridge::gcs::disk::{DiskReply, Ticket};
use bridge::gcs::{Document, LinkId};
use bridge::io::clock::Clock;
use bridge::io::endpoint::Endpoint;
use bridge::io::firmware::Outside;
use bridge::io::keep::Keep;
use bridge::io::lockstep::{Lockstep, Outgoing, Spent};
use bridge::io::logger::LogThread;
use bridge::io::net::{LinkEvent, Links};
use bridge::io::uquad_lockstep::UquadLockstep;
use bridge::web::{Console, Picture};
use sim::camera::Shot;
use std::collections::BTreeSet;
use std::io::Write as _;
use std::process::ExitCode;
use std::time::Duration;
use vehicle::{Pace, Timestamp};

/// A link of the default set.
pub(crate) struct DefaultLink {
    /// Port on loopback.
    pub(crate) port: u16,
    /// Kind.
    pub(crate) endpoint: fn(String) -> Endpoint,
}

/// What opens when no `--mavlink` is given: where QGroundControl and MAVSDK listen, and two doors for scripts.
pub(crate) const DEFAULT_LINKS: [DefaultLink; 4] = [
    DefaultLink {
        port: 14550,
        endpoint: Endpoint::UdpClient,
    },
    DefaultLink {
        port: 14540,
        endpoint: Endpoint::UdpClient,
    },
    DefaultLink {
        port: 14555,
        endpoint: Endpoint::UdpServer,
    },
    DefaultLink {
        port: 5760,
        endpoint: Endpoint::TcpServer,
    },
];

/// Virtual time that passes between two looks at the sockets.
const SLICE: Duration = Duration::from_millis(2);
/// Furthest that virtual time runs to catch up after this process was held up.
const CATCH_UP: Duration = Duration::from_millis(200);
/// The same with the real firmware, which does not wait meanwhile: the body must not move long on old motor commands.
const FIRMWARE_CATCH_UP: Duration = Duration::from_millis(10);
/// Longest landing before the program ends anyway, virtual time.
const LANDING: Duration = Duration::from_secs(30);

/// Ends a log and says if something is missing in it.
pub(crate) fn end_log(log: LogThread, terminal: &mut Terminal) {
    let status = log.status();
    if !log.finish() {
        terminal.line(&format!(
            "  the flight log is not complete: {} records are missing",
            status.lost()
        ));
    }
}

/// One line of JSON: seconds of simulated time and of the processor.
fn tell_time(spent: &Spent, now: Timestamp) {
    let s = |ns: u64| ns as f64 * 1e-9;
    let line = serde_json::json!({
        "simulated_s": now.s(),
        "simulator_s": s(spent.simulator_ns),
        "flight_s": s(spent.flight_ns),
        "ground_s": s(spent.ground_ns),
        "search_s": s(spent.search_ns),
        "thread_s": s(bridge::io::clock::thread_cpu_ns()),
    });
    let _ = writeln!(std::io::stdout(), "{line}");
}

/// A simulated vehicle with its brain, whichever.
pub(crate) trait World {
    fn now(&self) -> Timestamp;
    fn advance(&mut self, until: Timestamp);
    fn snapshot(&self) -> &Snapshot;
    fn ground(&self) -> &Ground;
    fn link_up(&mut self, link: LinkId);
    fn link_down(&mut self, link: LinkId);
    fn receive(&mut self, link: LinkId, bytes: &[u8], is_datagram: bool);
    fn disk(&mut self, ticket: Ticket, reply: &DiskReply);
    fn shut_down(&mut self);
    fn host(&mut self, report: HostReport);
    fn poll(&mut self) -> Option<Outgoing>;
    fn flush(&mut self);
    /// What its camera sees.
    fn shot(&self) -> Shot;
    fn write_error(&mut self) -> Option<std::io::Error>;
    /// The brain, if it is the one whose thoughts the console shows.
    fn flight(&self) -> Option<&Flight> {
        None
    }
    /// The real firmware, if it flies.
    fn firmware(&mut self) -> Option<&mut Outside> {
        None
    }
    /// Where processor time went, if it is counted.
    fn spent(&self) -> Option<Spent> {
        None
    }
}

/// Both worlds have methods of these names.
macro_rules! world {
    ($world:ty { $($more:item)* }) => {
        impl World for $world {
            fn now(&self) -> Timestamp {
                <$world>::now(self)
            }
            fn advance(&mut self, until: Timestamp) {
                <$world>::advance(self, until);
            }
            fn snapshot(&self) -> &Snapshot {
                <$world>::snapshot(self)
            }
            fn ground(&self) -> &Ground {
                &self.ground
            }
            fn link_up(&mut self, link: LinkId) {
                <$world>::link_up(self, link);
            }
            fn link_down(&mut self, link: LinkId) {
                <$world>::link_down(self, link);
            }
            fn receive(&mut self, link: LinkId, bytes: &[u8], is_datagram: bool) {
                <$world>::receive(self, link, bytes, is_datagram);
            }
            fn disk(&mut self, ticket: Ticket, reply: &DiskReply) {
                <$world>::disk(self, ticket, reply);
            }
            fn shut_down(&mut self) {
                <$world>::shut_down(self);
            }
            fn host(&mut self, report: HostReport) {
                <$world>::host(self, report);
            }
            fn poll(&mut self) -> Option<Outgoing> {
                <$world>::poll(self)
            }
            fn flush(&mut self) {
                <$world>::flush(self);
            }
            fn shot(&self) -> Shot {
                self.simulator.shot(0)
            }
            fn write_error(&mut self) -> Option<std::io::Error> {
                self.write_error.take()
            }
            $($more)*
        }
    };
}

world!(Lockstep {
    fn flight(&self) -> Option<&Flight> {
        Some(&self.flight)
    }
    fn firmware(&mut self) -> Option<&mut Outside> {
        Self::firmware(self)
    }
    fn spent(&self) -> Option<Spent> {
        Self::spent(self)
    }
});
world!(UquadLockstep {});

/// Everything a running simulation needs.
pub(crate) struct Session<W> {
    pub(crate) lockstep: W,
    pub(crate) links: Links,
    pub(crate) console: Option<Console>,
    pub(crate) camera: CameraSeat,
    pub(crate) keep: Keep,
    pub(crate) log: Option<LogThread>,
    pub(crate) terminal: Terminal,
    pub(crate) stop: Stop,
    /// Simulated seconds per second; none = as fast as it goes.
    pub(crate) speed: Option<f64>,
    pub(crate) shows_status: bool,
}

impl<W: World> Session<W> {
    /// Runs until stopped.
    pub(crate) fn run(mut self) -> Result<ExitCode> {
        let clock = Clock::start(self.speed.unwrap_or(1.0));
        let mut known = BTreeSet::new();
        let mut status = Pace::hz(2.0 * self.speed.unwrap_or(1.0).recip().min(5.0));
        let mut texts_shown = Timestamp::ZERO;
        // Made at first use, which would hold up the first station that asks.
        std::thread::spawn(bridge::gcs::metadata::general_crc);
        let mut stopping_since: Option<Timestamp> = None;
        let mut behind = Duration::ZERO;
        let mut was_failing = false;
        let (slice, catch_up) = if self.lockstep.firmware().is_some() {
            (sim::STEP, FIRMWARE_CATCH_UP)
        } else {
            (SLICE, CATCH_UP)
        };
        loop {
            self.take_links(&mut known);
            let now = self.lockstep.now();
            let target = match self.speed {
                None => now + slice,
                Some(_) => {
                    let due = Timestamp::from_us(
                        clock.now().us().saturating_sub(behind.as_micros() as u64),
                    );
                    if due.since(now) > catch_up {
                        // Held up: let the lost time go instead of racing after it.
                        behind += due.since(now) - catch_up;
                    }
                    due.min(now + catch_up)
                }
            };
            self.lockstep.advance(target);
            self.carry_out();

            let now = self.lockstep.now();
            while let Some(news) = self.lockstep.firmware().and_then(|f| f.poll_news()) {
                self.terminal.line(&format!("  {news}"));
            }
            let disk_fails = self.log.as_ref().is_some_and(LogThread::is_failing);
            if disk_fails != was_failing {
                was_failing = disk_fails;
                self.lockstep.host(HostReport {
                    disk_fails,
                    ..HostReport::default()
                });
            }
            self.terminal
                .texts(self.lockstep.ground(), &mut texts_shown);
            self.show(&known);
            if self.shows_status && status.is_due(now) {
                self.terminal.status(self.lockstep.snapshot(), known.len());
            }
            match (self.stop.count(), stopping_since) {
                (0, _) => {}
                (1, None) => {
                    stopping_since = Some(now);
                    self.terminal
                        .line("  Stopping: landing first (Ctrl-C again ends at once)");
                    self.lockstep.shut_down();
                }
                (1, Some(since)) => {
                    let is_down = !self.lockstep.snapshot().is_armed
                        && now.since(since) > Duration::from_millis(200);
                    if is_down || now.since(since) > LANDING {
                        break;
                    }
                }
                _ => break,
            }
            if self.speed.is_some() {
                let next = now + slice + behind;
                if let Some(event) = self.links.wait(clock.until(next)) {
                    self.link_event(event, &mut known);
                }
            }
        }
        self.carry_out();
        self.lockstep.flush();
        self.terminal.finish();
        if let Some(spent) = self.lockstep.spent() {
            tell_time(&spent, self.lockstep.now());
        }
        if let Some(log) = self.log.take() {
            end_log(log, &mut self.terminal);
        }
        if let Some(e) = self.lockstep.write_error() {
            return Err(anyhow::Error::new(e).context("a log could not be written completely"));
        }
        Ok(ExitCode::SUCCESS)
    }

    fn take_links(&mut self, known: &mut BTreeSet<LinkId>) {
        // Bounded: a flood waits in its queue, not in our loop.
        for _ in 0..256 {
            let Some(event) = self.links.poll() else {
                break;
            };
            self.link_event(event, known);
        }
    }

    fn link_event(&mut self, event: LinkEvent, known: &mut BTreeSet<LinkId>) {
        match event {
            LinkEvent::Up(link) => {
                known.insert(link);
                self.lockstep.link_up(link);
            }
            LinkEvent::Down(link) => {
                known.remove(&link);
                self.lockstep.link_down(link);
            }
            LinkEvent::Bytes {
                link,
                bytes,
                is_datagram,
            } => self.lockstep.receive(link, &bytes, is_datagram),
        }
        self.carry_out();
    }

    /// Shows the vehicle to the console's pages.
    fn show(&mut self, known: &BTreeSet<LinkId>) {
        let world = &self.lockstep;
        self.camera.show(|| Some(world.shot()));
        while let Some(line) = self.camera.poll_told() {
            self.terminal.line(&format!("  {line}"));
        }
        let Some(console) = &mut self.console else {
            return;
        };
        while let Some(line) = console.poll_told() {
            self.terminal.line(&format!("  {line}"));
        }
        if console.wants_picture() {
            let mut picture = Picture {
                snapshot: self.lockstep.snapshot().clone(),
                control: self.lockstep.ground().control(),
                links: known.len() as u32,
                dropped: self.links.dropped(),
                ..Picture::default()
            };
            if let Some(flight) = self.lockstep.flight() {
                picture.insight.look(flight);
            }
            console.show(picture);
        }
    }

    fn carry_out(&mut self) {
        while let Some(out) = self.lockstep.poll() {
            match out {
                Outgoing::Frame(link, frame) => self.links.send(link, frame),
                Outgoing::Keep(document) => self.store(&document),
                Outgoing::Disk(ticket, job) => {
                    let reply = self.keep.carry_out(&job);
                    self.lockstep.disk(ticket, &reply);
                }
            }
        }
    }

    fn store(&mut self, document: &Document) {
        if let Err(e) = self.keep.write(document) {
            self.terminal
                .line(&format!("  cannot keep {}: {e}", document.name));
        }
    }
}
