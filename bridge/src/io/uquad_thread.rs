//! uQuad for real: the thread that owns the inertial unit's line and the aircraft, and the thread that owns the motors.
//!
//! The flight thread waits in one `poll` for bytes, requests and an absolute timer. The motor driver is what its process was in the thesis: it sends
//! the last speeds again each 2 ms and may block on its bus, so it has a thread of its own; messages and acknowledgements pass through bounded channels.

use super::clock::Clock;
use super::endpoint::Endpoint;
use super::flight_thread::{FlightHandle, NEWS, News, REPORTS, REQUESTS, wake_up};
use super::line::{Line, LineError};
use super::realtime::Realtime;
use super::timer::AbsoluteTimer;
use super::uquad_logs::UquadLogs;
use super::watchdog::Pulse;
use crate::autopilot::door::{Asked, HostReport, Snapshot};
use crate::autopilot::io::FcBytes;
use crate::autopilot::latency::Histogram;
use crate::motor::units::Order;
use crate::motor::{Driver, DriverConfig};
use crate::uquad::board_words::BoardWords;
use crate::uquad::flight::{UquadFlight, UquadInput, UquadOutput};
use crate::uquad::laws;
use embedded_hal::i2c::I2c;
use estimator::imu::RawFrame;
use estimator::imu::replay::{Replay, Speed};
use linux_embedded_hal::I2cdev;
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::OwnedFd;
use sim::EscBus;
use std::io::{self, BufRead as _, Write as _};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Messages for the motor driver that wait at most: more are old ones.
const MESSAGES: usize = 8;
/// Acknowledgements and typed speeds that wait at most.
const REPLIES: usize = 64;
/// The driver's thread looks at least so often.
const DRIVER_LOOK: Duration = Duration::from_millis(2);
/// Bytes taken from the kernel at once.
const READ: usize = 256;

/// Where frames come from.
#[derive(Debug)]
pub enum ImuSource {
    /// The board.
    Line(Endpoint),
    /// A recording, as slow as it was made.
    Recording(Vec<RawFrame>),
}

/// What the motors are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Motors {
    /// Speed controllers on a simulated bus.
    Simulated,
    /// Speed controllers on this bus.
    I2c(PathBuf),
    /// A simulated bus that turns at the speeds of standard input, four numbers a line, rad/s; those of the law are not commanded.
    Typed,
}

type Jobs = (SyncSender<Job>, Receiver<UquadInput>);

#[expect(
    clippy::large_enum_variant,
    reason = "one at a time, in a channel of one place"
)]
enum Job {
    Search(estimator::SearchRequest),
    Design(laws::DesignRequest),
}

/// Starts both threads. Once the handle is dropped the flight's thread ends; whoever waits for it has the logs whole.
///
/// # Errors
/// The line or the bus cannot be opened, or no thread is left.
pub fn start(
    flight: UquadFlight,
    source: ImuSource,
    motors: &Motors,
    logs: Option<UquadLogs>,
    clock: Clock,
) -> Result<(FlightHandle, JoinHandle<()>), UquadThreadError> {
    let failed = |e: rustix::io::Errno| UquadThreadError::Thread(e.into());
    let (requests, asked) = sync_channel(REQUESTS);
    let (tell, news) = sync_channel(NEWS);
    let (host, reports) = sync_channel(REPORTS);
    let pulse = Arc::<Pulse>::default();
    let wake = eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC).map_err(failed)?;
    let wake = Arc::new(wake);
    let timer = AbsoluteTimer::new().map_err(failed)?;
    let snapshot = Arc::new(Mutex::new(flight.snapshot().clone()));
    let (line, replay) = match source {
        ImuSource::Line(endpoint) => {
            let line = Line::open(&endpoint)?;
            let _ = tell.try_send(News::LineOpened);
            (Some(line), None)
        }
        ImuSource::Recording(frames) => {
            let replay = Replay::new(frames, Speed::RealTime, clock.now());
            (None, Some(replay))
        }
    };
    let (messages, replies) = motor_thread(motors, clock, Arc::clone(&wake))?;
    let (jobs, done) = job_thread(Arc::clone(&wake)).map_err(UquadThreadError::Thread)?;
    let handle = FlightHandle::without_line(
        requests,
        host,
        Arc::clone(&pulse),
        Arc::clone(&wake),
        news,
        Arc::clone(&snapshot),
    );
    let shell = Shell {
        flight,
        clock,
        line,
        words: BoardWords::opened(clock.now()),
        replay,
        asked,
        reports,
        pulse,
        tell,
        messages,
        replies,
        jobs,
        done,
        logs,
        wake,
        timer,
        cell: snapshot,
        own: Histogram::default(),
        was_armed: false,
    };
    let thread = thread::Builder::new()
        .name("flight".to_owned())
        .spawn(move || shell.run())
        .map_err(UquadThreadError::Thread)?;
    Ok((handle, thread))
}

/// Why it could not be started.
#[derive(Debug, thiserror::Error)]
pub enum UquadThreadError {
    /// The inertial unit's line.
    #[error("inertial unit: {0}")]
    Line(#[from] LineError),
    /// The motors' bus.
    #[error("motors: cannot open the I2C bus {path}: {source}")]
    Bus {
        /// Device.
        path: PathBuf,
        /// Reason.
        source: linux_embedded_hal::i2cdev::linux::LinuxI2CError,
    },
    /// No thread.
    #[error("cannot start a thread: {0}")]
    Thread(io::Error),
}

fn job_thread(wake: Arc<OwnedFd>) -> io::Result<Jobs> {
    let (jobs, wanted) = sync_channel::<Job>(2);
    let (results, done) = sync_channel(2);
    thread::Builder::new()
        .name("jobs".to_owned())
        .spawn(move || {
            for job in wanted {
                let input = match job {
                    Job::Search(request) => UquadInput::JobDone(estimator::search(&request)),
                    Job::Design(request) => UquadInput::Designed(laws::make(&request)),
                };
                if results.send(input).is_err() {
                    return;
                }
                wake_up(&wake);
            }
        })?;
    Ok((jobs, done))
}

type MotorEnds = (SyncSender<[u8; 4]>, Receiver<UquadInput>);

/// The motor driver on its bus.
fn motor_thread(
    motors: &Motors,
    clock: Clock,
    wake: Arc<OwnedFd>,
) -> Result<MotorEnds, UquadThreadError> {
    let (messages, wanted) = sync_channel::<[u8; 4]>(MESSAGES);
    let (replies, heard) = sync_channel(REPLIES);
    let end = DriverEnd {
        driver: Driver::new(DriverConfig::default()),
        wanted,
        replies: replies.clone(),
        wake: Arc::clone(&wake),
        clock,
        is_deaf: *motors == Motors::Typed,
    };
    let builder = thread::Builder::new().name("motors".to_owned());
    let spawned = match motors {
        Motors::I2c(path) => {
            let bus = I2cdev::new(path).map_err(|source| UquadThreadError::Bus {
                path: path.clone(),
                source,
            })?;
            builder.spawn(move || end.run(bus))
        }
        Motors::Simulated | Motors::Typed => builder.spawn(move || end.run(EscBus::default())),
    };
    spawned.map_err(UquadThreadError::Thread)?;
    if *motors == Motors::Typed {
        typing_thread(replies, wake).map_err(UquadThreadError::Thread)?;
    }
    Ok((messages, heard))
}

/// Speeds from standard input.
fn typing_thread(replies: SyncSender<UquadInput>, wake: Arc<OwnedFd>) -> io::Result<()> {
    thread::Builder::new()
        .name("stdin".to_owned())
        .spawn(move || {
            for line in io::stdin().lock().lines().map_while(Result::ok) {
                match Order::parse(&line, true) {
                    Ok(order) => {
                        let typed = UquadInput::Speeds(order.speeds_radps());
                        if replies.send(typed).is_err() {
                            return;
                        }
                        wake_up(&wake);
                    }
                    Err(e) => {
                        let _ = writeln!(io::stderr(), "not a line of speeds: {e}");
                    }
                }
            }
        })?;
    Ok(())
}

/// The driver's end.
struct DriverEnd {
    driver: Driver,
    wanted: Receiver<[u8; 4]>,
    replies: SyncSender<UquadInput>,
    wake: Arc<OwnedFd>,
    clock: Clock,
    /// Acknowledges and does nothing.
    is_deaf: bool,
}

impl DriverEnd {
    fn run(mut self, mut bus: impl I2c) {
        let _ = Realtime::enter();
        let mut counter = 0_u8;
        loop {
            let due = self.driver.deadline();
            let wait = due.map_or(DRIVER_LOOK, |at| self.clock.until(at).min(DRIVER_LOOK));
            match self.wanted.recv_timeout(wait) {
                Ok(_) if self.is_deaf => {
                    let ack = [b'A', b'C', b'K', counter];
                    counter = counter.wrapping_add(1);
                    self.answer(ack);
                }
                Ok(message) => {
                    if let Some(ack) = self.driver.handle(self.clock.now(), &message) {
                        self.answer(ack);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                // The flight thread is gone: silence stops the motors.
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.driver.poll(self.clock.now(), &mut bus);
            while self.driver.event().is_some() {}
        }
    }

    fn answer(&self, ack: [u8; 4]) {
        let _ = self.replies.try_send(UquadInput::Ack(ack));
        wake_up(&self.wake);
    }
}

struct Shell {
    flight: UquadFlight,
    clock: Clock,
    line: Option<Line>,
    words: BoardWords,
    replay: Option<Replay>,
    asked: Receiver<Asked>,
    reports: Receiver<HostReport>,
    pulse: Arc<Pulse>,
    tell: SyncSender<News>,
    messages: SyncSender<[u8; 4]>,
    replies: Receiver<UquadInput>,
    jobs: SyncSender<Job>,
    done: Receiver<UquadInput>,
    logs: Option<UquadLogs>,
    wake: Arc<OwnedFd>,
    timer: AbsoluteTimer,
    cell: Arc<Mutex<Snapshot>>,
    /// From the stamp of a frame to the hand-over of its motor message.
    own: Histogram,
    was_armed: bool,
}

impl Shell {
    fn run(mut self) {
        let _ = self.tell.try_send(News::Realtime(Realtime::enter()));
        loop {
            self.publish();
            self.pulse.flight(self.was_armed);
            self.wait();
            self.read_line();
            self.speak();
            self.read_recording();
            while let Ok(input) = self.replies.try_recv() {
                self.handle(input);
            }
            while let Ok(input) = self.done.try_recv() {
                self.handle(input);
            }
            if let Ok(report) = self.reports.try_recv() {
                self.handle(UquadInput::Host(report));
            }
            loop {
                match self.asked.try_recv() {
                    Ok(asked) => self.handle(UquadInput::Asked(asked)),
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => {
                        if let Some(line) = &mut self.line {
                            let _ = line.write(&BoardWords::end().bytes());
                        }
                        return;
                    }
                }
            }
            self.handle(UquadInput::Wake);
        }
    }

    fn wait(&mut self) {
        let mut at = self.flight.deadline(self.clock.now());
        if let Some(due) = self.replay.as_ref().and_then(Replay::deadline) {
            at = at.min(due);
        }
        self.timer.set(&self.clock, at);
        self.timer.wait(&self.wake, self.line.as_ref());
    }

    fn handle(&mut self, input: UquadInput) {
        let now = self.clock.now();
        let is_frame = matches!(input, UquadInput::Imu(_));
        if let (Some(logs), UquadInput::Imu(bytes)) = (&mut self.logs, &input) {
            logs.bytes(now, bytes);
        }
        self.flight.handle(now, input);
        let mut has_commanded = false;
        while let Some(output) = self.flight.poll() {
            match output {
                UquadOutput::Motors(message) => {
                    has_commanded |= self.messages.try_send(message).is_ok();
                }
                UquadOutput::Answer(answer) => drop(self.tell.try_send(News::Answer(answer))),
                UquadOutput::Event(event) => {
                    if let Some(logs) = &mut self.logs {
                        logs.event(now, &event);
                    }
                    drop(self.tell.try_send(News::Event(event)));
                }
                UquadOutput::Job(job) => drop(self.jobs.try_send(Job::Search(job))),
                UquadOutput::Design(request) => {
                    drop(self.jobs.try_send(Job::Design(request)));
                }
            }
        }
        if is_frame && has_commanded {
            self.own.record(self.clock.now().since(now));
        }
        if is_frame && let (Some(logs), Some(step)) = (&mut self.logs, self.flight.take_step()) {
            logs.step(now, step);
        }
    }

    fn speak(&mut self) {
        if let Some(line) = &mut self.line
            && let Some(word) = self.words.poll(self.clock.now())
        {
            let _ = line.write(&word.bytes());
        }
    }

    fn read_line(&mut self) {
        let mut buffer = [0u8; READ];
        loop {
            let Some(line) = &mut self.line else { return };
            match line.read(&mut buffer) {
                Ok(0) => self.line = None,
                Ok(n) => {
                    self.words.heard(self.clock.now());
                    let bytes: FcBytes = buffer[..n].iter().copied().collect();
                    self.handle(UquadInput::Imu(bytes));
                    if n < buffer.len() {
                        return;
                    }
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => self.line = None,
            }
            if self.line.is_none() {
                let _ = self.tell.try_send(News::LineAbsent(
                    "the inertial unit's line is gone".to_owned(),
                ));
            }
        }
    }

    fn read_recording(&mut self) {
        while let Some((_, frame)) = self.replay.as_mut().and_then(|r| r.poll(self.clock.now())) {
            let bytes: FcBytes = frame.emit(b'A').iter().copied().collect();
            self.handle(UquadInput::Imu(bytes));
        }
        if self.replay.as_ref().is_some_and(|r| r.deadline().is_none()) {
            self.replay = None;
            let _ = self.tell.try_send(News::RecordingOver);
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
    }
}
