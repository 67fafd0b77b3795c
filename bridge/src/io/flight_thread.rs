//! The thread that owns the real flight controller's line and the `Flight` machine.
//!
//! It waits in one `poll` for bytes, requests and an absolute timer, and never for anything else: requests come through a
//! bounded ring with a wake-up descriptor, answers leave through a bounded ring, the snapshot through a cell that is
//! skipped for a tick when the reader holds it. What may block (opening a line, a search) is done by two threads of its own.
//!
//! The order of a round is what counts for the age of a command: bytes are read and stamped, the tick runs, the RC frame
//! is written, and only then anything else happens.

mod keeping;
mod lending;

pub use lending::Borrower;

use super::clock::Clock;
use super::endpoint::Endpoint;
use super::line::{Line, LineError};
use super::logger::FlightTap;
use super::realtime::Realtime;
use super::timer::AbsoluteTimer;
use super::watchdog::Pulse;
use crate::autopilot::door::{Answer, Asked, Event, HostReport, Snapshot};
use crate::autopilot::flight::Flight;
use crate::autopilot::insight::Insight;
use crate::autopilot::io::{FcBytes, Input, Output};
use crate::autopilot::latency::Histogram;
use crate::log::{Emitted, FlightRecord, Part};
use crate::sensor::Sample;
use keeping::{Kept, keeper_thread};
use lending::{Lender, lending};
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::{AsFd as _, OwnedFd};
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;
use vehicle::Timestamp;

/// Requests that wait for the flight thread at most.
pub(super) const REQUESTS: usize = 256;
/// Samples of sensors that wait for the flight thread at most.
const SAMPLES: usize = 512;
/// Samples taken in a round at most.
const SAMPLES_A_ROUND: usize = 64;
/// Answers and events that wait for the ground at most.
pub(super) const NEWS: usize = 1024;
/// Reports about the computer that wait at most.
pub(super) const REPORTS: usize = 4;
/// Pause before a lost line is opened again.
const REOPEN: Duration = Duration::from_millis(500);
/// Bytes taken from the kernel at once.
const READ: usize = 256;
/// Reads in a row at most: a line that never pauses still leaves time for the tick.
const READS: usize = 16;
/// Requests carried out in a round at most.
const REQUESTS_A_ROUND: usize = 16;

/// News from the flight thread.
#[derive(Clone, Debug)]
pub enum News {
    /// What became of a request.
    Answer(Answer),
    /// Something happened.
    Event(Event),
    /// What the system granted the thread; once, at its start.
    Realtime(Realtime),
    /// The line cannot be opened; told once, it goes on being tried.
    LineAbsent(String),
    /// The line is open.
    LineOpened,
    /// The recording that stood for a line is over.
    RecordingOver,
}

/// The ground's end of the door.
#[derive(Debug)]
pub struct FlightHandle {
    requests: SyncSender<Asked>,
    host: SyncSender<HostReport>,
    pulse: Arc<Pulse>,
    wake: Arc<OwnedFd>,
    news: Receiver<News>,
    snapshot: Arc<Mutex<Snapshot>>,
    insight: Arc<InsightCell>,
    borrower: Option<Borrower>,
    inlet: Inlet,
}

/// Where sensors give their samples.
#[derive(Clone, Debug)]
pub struct Inlet {
    samples: SyncSender<Sample>,
    wake: Arc<OwnedFd>,
    /// Its owner is the flight thread: when that is gone nobody wants samples.
    alive: std::sync::Weak<()>,
}

impl Inlet {
    /// Gives a sample; dropped if too many wait.
    pub fn give(&self, sample: Sample) {
        if self.samples.try_send(sample).is_ok() {
            wake_up(&self.wake);
        }
    }

    /// True when nobody takes samples any more.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.alive.strong_count() == 0
    }
}

impl FlightHandle {
    /// Of a thread whose line nobody may borrow.
    pub(super) fn without_line(
        requests: SyncSender<Asked>,
        host: SyncSender<HostReport>,
        pulse: Arc<Pulse>,
        wake: Arc<OwnedFd>,
        news: Receiver<News>,
        snapshot: Arc<Mutex<Snapshot>>,
    ) -> Self {
        let inlet_wake = Arc::clone(&wake);
        Self {
            requests,
            host,
            pulse,
            wake,
            news,
            snapshot,
            insight: Arc::default(),
            borrower: None,
            // Of a craft that takes no samples from elsewhere.
            inlet: Inlet {
                samples: sync_channel(1).0,
                wake: inlet_wake,
                alive: std::sync::Weak::new(),
            },
        }
    }

    /// Who may have the line for a while; once.
    pub const fn take_borrower(&mut self) -> Option<Borrower> {
        self.borrower.take()
    }

    /// Where sensors give their samples.
    #[must_use]
    pub fn inlet(&self) -> Inlet {
        self.inlet.clone()
    }

    /// Hands a request over; false if the ring is full.
    #[must_use]
    pub fn ask(&self, asked: Asked) -> bool {
        let taken = self.requests.try_send(asked).is_ok();
        wake_up(&self.wake);
        taken
    }

    /// What the loops show of themselves, for the watchdog.
    #[must_use]
    pub fn pulse(&self) -> Arc<Pulse> {
        Arc::clone(&self.pulse)
    }

    /// Tells how the computer is; the next report makes up for one that is lost.
    pub fn tell_host(&self, report: HostReport) {
        let _ = self.host.try_send(report);
        wake_up(&self.wake);
    }

    /// The next news, without waiting.
    #[must_use]
    pub fn poll(&self) -> Option<News> {
        self.news.try_recv().ok()
    }

    /// Copies the newest look into the vehicle's thoughts and asks for the next one.
    pub fn read_insight(&self, into: &mut Insight) {
        if let Ok(seen) = self.insight.seen.lock() {
            into.copy_from(&seen);
        }
        self.insight.is_wanted.store(true, Ordering::Relaxed);
    }

    /// Copies the newest snapshot.
    pub fn read_snapshot(&self, into: &mut Snapshot) {
        if let Ok(snapshot) = self.snapshot.lock() {
            into.clone_from(&snapshot);
        }
    }
}

/// Starts the thread. A line that is not there yet is waited for. What goes in and out is recorded through the tap, if there is one.
///
/// # Errors
/// [`LineError`]: no kind of line a flight controller is on, or the system has no threads left.
pub fn start(
    flight: Flight,
    endpoint: Endpoint,
    clock: Clock,
    tap: Option<FlightTap>,
) -> Result<FlightHandle, LineError> {
    if !matches!(endpoint, Endpoint::Serial { .. } | Endpoint::TcpClient(_)) {
        return Err(LineError::Kind(endpoint));
    }
    let failed = |e: rustix::io::Errno| LineError::Thread(e.into());
    let (requests, asked) = sync_channel(REQUESTS);
    let (samples, sensed) = sync_channel(SAMPLES);
    let alive = Arc::new(());
    let (tell, news) = sync_channel(NEWS);
    let (host, reports) = sync_channel(REPORTS);
    let pulse = Arc::<Pulse>::default();
    let wake = eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC).map_err(failed)?;
    let wake = Arc::new(wake);
    let timer = AbsoluteTimer::new().map_err(failed)?;
    let snapshot = Arc::new(Mutex::new(flight.snapshot().clone()));
    let insight = Arc::<InsightCell>::default();
    let (jobs, done) = job_thread(Arc::clone(&wake)).map_err(LineError::Thread)?;
    let (want_line, lines) =
        line_thread(endpoint, tell.clone(), Arc::clone(&wake)).map_err(LineError::Thread)?;
    let kept = Arc::new(Kept::new().map_err(failed)?);
    keeper_thread(Arc::clone(&kept), clock).map_err(LineError::Thread)?;
    let (lender, borrower) = lending(&wake);
    let handle = FlightHandle {
        requests,
        host,
        pulse: Arc::clone(&pulse),
        wake: Arc::clone(&wake),
        news,
        snapshot: Arc::clone(&snapshot),
        insight: Arc::clone(&insight),
        borrower: Some(borrower),
        inlet: Inlet {
            samples,
            wake: Arc::clone(&wake),
            alive: Arc::downgrade(&alive),
        },
    };
    let shell = Shell {
        flight,
        clock,
        line: None,
        want_line,
        lines,
        lender,
        asked,
        reports,
        pulse,
        sensed,
        _alive: alive,
        tell,
        jobs,
        done,
        wake,
        timer,
        cell: snapshot,
        insight,
        kept,
        own: Histogram::default(),
        was_armed: false,
        tap,
        is_line_lost: false,
    };
    thread::Builder::new()
        .name("flight".to_owned())
        .spawn(move || shell.run())
        .map_err(LineError::Thread)?;
    Ok(handle)
}

pub(super) fn wake_up(wake: &OwnedFd) {
    let _ = rustix::io::write(wake, &1u64.to_ne_bytes());
}

type Jobs = (
    SyncSender<estimator::SearchRequest>,
    Receiver<estimator::SearchResult>,
);

/// Does searches.
fn job_thread(wake: Arc<OwnedFd>) -> io::Result<Jobs> {
    let (jobs, requests) = sync_channel::<estimator::SearchRequest>(1);
    let (results, done) = sync_channel(1);
    thread::Builder::new()
        .name("jobs".to_owned())
        .spawn(move || {
            for job in requests {
                if results.send(estimator::search(&job)).is_err() {
                    return;
                }
                wake_up(&wake);
            }
        })?;
    Ok((jobs, done))
}

#[expect(
    clippy::disallowed_methods,
    reason = "a thread that does nothing but wait for a device"
)]
fn pause() {
    thread::sleep(REOPEN);
}

/// Opens the line whenever it is wanted, for as long as it takes.
fn line_thread(
    endpoint: Endpoint,
    tell: SyncSender<News>,
    wake: Arc<OwnedFd>,
) -> io::Result<(SyncSender<()>, Receiver<Line>)> {
    let (want, wanted) = sync_channel::<()>(1);
    let (opened, lines) = sync_channel(1);
    thread::Builder::new()
        .name("line".to_owned())
        .spawn(move || {
            let mut is_first = true;
            for () in wanted {
                // A device that has just vanished takes a moment to be really gone.
                if !is_first {
                    pause();
                }
                is_first = false;
                let mut told = false;
                let line = loop {
                    match Line::open(&endpoint) {
                        Ok(line) => break line,
                        Err(e) if !told => {
                            told = true;
                            let _ = tell.try_send(News::LineAbsent(e.to_string()));
                        }
                        Err(_) => {}
                    }
                    pause();
                };
                let _ = tell.try_send(News::LineOpened);
                if opened.send(line).is_err() {
                    return;
                }
                wake_up(&wake);
            }
        })?;
    Ok((want, lines))
}

/// A look into the flight's thoughts, taken only when somebody wants it.
#[derive(Debug, Default)]
struct InsightCell {
    is_wanted: AtomicBool,
    seen: Mutex<Insight>,
}

struct Shell {
    flight: Flight,
    clock: Clock,
    line: Option<Line>,
    want_line: SyncSender<()>,
    lines: Receiver<Line>,
    lender: Lender,
    asked: Receiver<Asked>,
    reports: Receiver<HostReport>,
    pulse: Arc<Pulse>,
    sensed: Receiver<Sample>,
    /// Held by this thread as long as it runs.
    _alive: Arc<()>,
    tell: SyncSender<News>,
    jobs: SyncSender<estimator::SearchRequest>,
    done: Receiver<estimator::SearchResult>,
    wake: Arc<OwnedFd>,
    timer: AbsoluteTimer,
    cell: Arc<Mutex<Snapshot>>,
    insight: Arc<InsightCell>,
    kept: Arc<Kept>,
    /// From the stamp of a reply to the end of the write of the frame it caused.
    own: Histogram,
    was_armed: bool,
    /// Into the flight log.
    tap: Option<FlightTap>,
    /// A write has failed: `Flight` is told once its outputs are carried out.
    is_line_lost: bool,
}

impl Shell {
    fn run(mut self) {
        let _ = self.tell.try_send(News::Realtime(Realtime::enter()));
        let _ = self.want_line.try_send(());
        loop {
            self.publish();
            self.pulse.flight(self.was_armed);
            self.wait();
            self.lend_line();
            self.take_line();
            self.read_line();
            for _ in 0..SAMPLES_A_ROUND {
                match self.sensed.try_recv() {
                    Ok(sample) => self.handle(sample.into()),
                    Err(_) => break,
                }
            }
            while let Ok(result) = self.done.try_recv() {
                self.handle(Input::JobDone(result));
            }
            if let Ok(report) = self.reports.try_recv() {
                self.handle(Input::Host(report));
            }
            for _ in 0..REQUESTS_A_ROUND {
                match self.asked.try_recv() {
                    Ok(asked) => self.handle(Input::Asked(asked)),
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return,
                }
            }
            if self.flight.deadline() <= self.clock.now() {
                self.handle(Input::Wake);
            }
        }
    }

    fn handle(&mut self, input: Input) {
        let now = self.clock.now();
        let is_reply = matches!(input, Input::Fc(_));
        let rc_before = self.flight.rc_frames_sent();
        let ticks = self.flight.snapshot().flight_loop.ticks;
        if let Some(tap) = &mut self.tap {
            let input = input.clone();
            tap.put(FlightRecord::Input { at: now, input });
        }
        self.flight.handle(now, input);
        self.carry_out(now);
        if self.flight.rc_frames_sent() != rc_before {
            self.kept.refresh(now, self.flight.standby());
        }
        if is_reply && self.flight.rc_frames_sent() != rc_before {
            self.own.record(self.clock.now().since(now));
        }
        let snapshot = self.flight.snapshot();
        if snapshot.flight_loop.ticks != ticks
            && let Some(tap) = &mut self.tap
        {
            let digests = Part::digests(snapshot);
            tap.put(FlightRecord::Tick { at: now, digests });
        }
        if core::mem::take(&mut self.is_line_lost) {
            self.handle(Input::FcClosed);
        }
    }

    /// Sleeps until bytes, a request or the deadline. The timer is absolute: what this round took does not add up.
    fn wait(&mut self) {
        self.timer.set(&self.clock, self.flight.deadline());
        self.timer.wait(&self.wake, self.line.as_ref());
    }

    fn take_line(&mut self) {
        if self.line.is_none()
            && let Ok(line) = self.lines.try_recv()
        {
            self.have_line(line);
        }
    }

    fn have_line(&mut self, line: Line) {
        self.kept.set_line(line.as_fd().try_clone_to_owned().ok());
        self.line = Some(line);
        self.handle(Input::FcOpened);
    }

    /// A configurator gets the line on the ground only, and then `Flight` has none: nothing arms meanwhile.
    fn lend_line(&mut self) {
        if self.lender.wanted.try_recv().is_ok() {
            let line = if self.flight.snapshot().is_armed {
                None
            } else {
                self.line.take()
            };
            if line.is_some() {
                self.kept.set_line(None);
                self.handle(Input::FcClosed);
            }
            let _ = self.lender.give.try_send(line);
        }
        match self.lender.back.try_recv() {
            Ok(Some(line)) => self.have_line(line),
            Ok(None) => drop(self.want_line.try_send(())),
            Err(_) => {}
        }
    }

    fn lose_line(&mut self) {
        if self.drop_line() {
            self.handle(Input::FcClosed);
        }
    }

    /// True if there was one.
    fn drop_line(&mut self) -> bool {
        let was_there = self.line.take().is_some();
        if was_there {
            self.kept.set_line(None);
            let _ = self.want_line.try_send(());
        }
        was_there
    }

    fn read_line(&mut self) {
        let mut buffer = [0u8; READ];
        for _ in 0..READS {
            let Some(line) = &mut self.line else { return };
            match line.read(&mut buffer) {
                Ok(0) => self.lose_line(),
                Ok(n) => {
                    let bytes: FcBytes = buffer[..n].iter().copied().collect();
                    self.handle(Input::Fc(bytes));
                    if n < buffer.len() {
                        return;
                    }
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => self.lose_line(),
            }
        }
    }

    fn carry_out(&mut self, at: Timestamp) {
        while let Some(output) = self.flight.poll() {
            if let Some(tap) = &mut self.tap {
                let output = Emitted::from(&output);
                tap.put(FlightRecord::Output { at, output });
            }
            match output {
                Output::Fc(bytes) => {
                    if let Some(line) = &mut self.line
                        && line.write(&bytes).is_err()
                    {
                        self.is_line_lost |= self.drop_line();
                    }
                }
                Output::Answer(answer) => drop(self.tell.try_send(News::Answer(answer))),
                Output::Event(event) => drop(self.tell.try_send(News::Event(event))),
                Output::Job(job) => drop(self.jobs.try_send(job)),
            }
        }
        if let Some(line) = &mut self.line
            && line.flush().is_err()
        {
            self.is_line_lost |= self.drop_line();
        }
    }

    fn publish(&mut self) {
        let snapshot = self.flight.snapshot();
        if snapshot.is_armed && !self.was_armed {
            self.own.clear();
        }
        self.was_armed = snapshot.is_armed;
        if let Ok(mut cell) = self.cell.try_lock()
            && cell.flight_loop.ticks != snapshot.flight_loop.ticks
        {
            cell.clone_from(snapshot);
            cell.flight_loop.reply_to_command = self.own.summary();
        }
        if self.insight.is_wanted.load(Ordering::Relaxed)
            && let Ok(mut seen) = self.insight.seen.try_lock()
        {
            self.insight.is_wanted.store(false, Ordering::Relaxed);
            seen.look(&self.flight);
        }
    }
}
