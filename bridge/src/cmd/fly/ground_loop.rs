//! `Ground` and its links, on the main thread, beside whatever thread flies.

use super::super::camera::CameraSeat;
use super::super::session::end_log;
use super::super::stop::Stop;
use super::super::term::Terminal;
use super::{CUT, FIRST_ANSWER, LANDING, LOOK};
use anyhow::{Result, anyhow};
use bridge::autopilot::door::{Asked, Request, RequestId, Severity, Snapshot, Station};
use bridge::autopilot::ground::{Ground, GroundOutput};
use bridge::io::clock::{self, Clock};
use bridge::io::flight_thread::{FlightHandle, News};
use bridge::io::host::HostWatch;
use bridge::io::keep::Keep;
use bridge::io::logger::{GroundTap, LogThread};
use bridge::io::net::{LinkEvent, Links};
use bridge::log::GroundRecord;
use bridge::web::{Console, Picture};
use std::collections::BTreeSet;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Duration;
use vehicle::{Pace, Timestamp};

/// `Ground` and its links, on the main thread.
pub(super) struct GroundLoop {
    pub(super) ground: Ground,
    pub(super) handle: FlightHandle,
    pub(super) links: Links,
    pub(super) console: Option<Console>,
    pub(super) camera: Option<CameraSeat>,
    pub(super) keep: Keep,
    pub(super) log: Option<LogThread>,
    pub(super) tap: Option<GroundTap>,
    pub(super) texts_logged: u64,
    pub(super) terminal: Terminal,
    pub(super) clock: Clock,
    pub(super) stop: Stop,
    /// What to say when nothing is heard.
    pub(super) unanswered: String,
    /// What the thread of `--passthrough` tells.
    pub(super) told: Option<Receiver<String>>,
    /// What the threads of sensors tell.
    pub(super) sensors_told: Option<Receiver<String>>,
    pub(super) shows_status: bool,
    /// A controller that has never answered is waited for.
    pub(super) waits: bool,
}

impl GroundLoop {
    pub(super) fn run(mut self) -> Result<ExitCode> {
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
        let pulse = self.handle.pulse();
        if let Err(e) = bridge::io::watchdog::start(Arc::clone(&pulse)) {
            self.terminal
                .line(&format!("  systemd's watchdog cannot be told: {e}"));
        }
        let mut host_watch = HostWatch::default();
        let mut host_pace = Pace::hz(1.0);
        // Made at first use, which would hold up the first station that asks.
        std::thread::spawn(bridge::gcs::metadata::general_crc);
        loop {
            pulse.ground();
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
                    News::RecordingOver => {
                        self.terminal.line("  the recording is over");
                        self.terminal.finish();
                        return Ok(ExitCode::SUCCESS);
                    }
                    News::LineOpened => {
                        is_open = true;
                        opened_at = now;
                    }
                }
                self.carry_out();
            }
            while let Some(line) = self.camera.as_ref().and_then(CameraSeat::poll_told) {
                self.terminal.line(&format!("  {line}"));
            }
            while let Some(text) = self.told.as_ref().and_then(|told| told.try_recv().ok()) {
                self.terminal.line(&format!("  {text}"));
            }
            while let Some(text) = self
                .sensors_told
                .as_ref()
                .and_then(|told| told.try_recv().ok())
            {
                self.terminal.line(&format!("  {text}"));
                self.ground.say(now, Severity::Notice, text);
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
            self.show(&snapshot, known.len());
            if self.shows_status && status.is_due(now) {
                self.terminal.status(&snapshot, known.len());
            }
            if snapshot.fc.is_connected {
                (is_open, was_connected) = (false, true);
            } else if is_open && now.since(opened_at) > FIRST_ANSWER {
                is_open = false;
                let why = &self.unanswered;
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
                        .line("  Stopping: landing first (Ctrl-C again stops the motors at once)");
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
                _ => {
                    self.cut_motors(&mut snapshot);
                    break;
                }
            }
        }
        if let Some(log) = self.log.take() {
            end_log(log, &mut self.terminal);
        }
        self.terminal.finish();
        Ok(ExitCode::SUCCESS)
    }

    /// Whoever asks twice wants it still, wherever it is.
    fn cut_motors(&mut self, snapshot: &mut Snapshot) {
        let asked = Asked {
            id: RequestId(0),
            station: Station::default(),
            request: Request::Disarm { force: true },
        };
        let _ = self.handle.ask(asked);
        let until = self.clock.now() + CUT;
        while snapshot.is_armed && self.clock.now() < until {
            clock::sleep(LOOK);
            self.handle.read_snapshot(snapshot);
        }
        self.terminal.line(if snapshot.is_armed {
            "  The motors could not be stopped: the flight controller's own failsafe decides"
        } else {
            "  Motors stopped"
        });
        // The frame that says so must reach the controller before its line is closed.
        clock::sleep(CUT);
    }

    /// Shows the vehicle to the console's pages.
    fn show(&mut self, snapshot: &Snapshot, links: usize) {
        let Some(console) = &mut self.console else {
            return;
        };
        while let Some(line) = console.poll_told() {
            self.terminal.line(&format!("  {line}"));
        }
        if console.wants_picture() {
            let mut picture = Picture {
                snapshot: snapshot.clone(),
                control: self.ground.control(),
                links: links as u32,
                dropped: self.links.dropped(),
                ..Picture::default()
            };
            self.handle.read_insight(&mut picture.insight);
            console.show(picture);
        }
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
                    self.links.note(&document);
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
