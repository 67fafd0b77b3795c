//! The thread that owns the real flight controller's line and the `Flight` machine.
//!
//! It waits in one `poll` for bytes, requests and its deadline, and never for anything else: requests come through a
//! bounded ring with a wake-up descriptor, answers leave through a bounded ring, the snapshot through a cell that is
//! skipped for a tick when the reader holds it.

use super::clock::Clock;
use super::endpoint::Endpoint;
use crate::autopilot::door::{Answer, Asked, Event, Snapshot};
use crate::autopilot::flight::Flight;
use crate::autopilot::io::{FcBytes, Input, Output};
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use rustix::termios::{OptionalActions, QueueSelector};
use std::io::{self, Read as _, Write as _};
use std::net::TcpStream;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use thiserror::Error;
use vehicle::Timestamp;

/// Requests that wait for the flight thread at most.
const REQUESTS: usize = 256;
/// Answers and events that wait for the ground at most.
const NEWS: usize = 1024;
/// Pause before a lost line is opened again.
const REOPEN: Duration = Duration::from_millis(500);

/// Why the flight controller's line could not be opened.
#[derive(Debug, Error)]
pub enum LineError {
    /// No such device, or not allowed.
    #[error(
        "flight controller {endpoint}: {source}: check the cable, the name and that you may open it (group dialout)"
    )]
    Open {
        /// Where.
        endpoint: Endpoint,
        /// Reason.
        source: io::Error,
    },
    /// Not a kind of line a flight controller is on.
    #[error("flight controller {0}: use serial:///dev/...?baudrate=N or tcpclient://host:port")]
    Kind(Endpoint),
    /// The thread could not be started.
    #[error("cannot start the flight thread: {0}")]
    Thread(io::Error),
}

/// An open line.
pub(super) enum Line {
    Serial(std::fs::File),
    Tcp(TcpStream),
}

impl Line {
    pub(super) fn open(endpoint: &Endpoint) -> Result<Self, LineError> {
        let failed = |source| LineError::Open {
            endpoint: endpoint.clone(),
            source,
        };
        match endpoint {
            Endpoint::Serial { device, baud } => {
                open_serial(device, *baud).map(Self::Serial).map_err(failed)
            }
            Endpoint::TcpClient(address) => {
                let stream = TcpStream::connect(address).map_err(failed)?;
                stream
                    .set_nodelay(true)
                    .and_then(|()| stream.set_nonblocking(true))
                    .map_err(failed)?;
                Ok(Self::Tcp(stream))
            }
            other => Err(LineError::Kind(other.clone())),
        }
    }

    pub(super) fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Serial(file) => file.read(into),
            Self::Tcp(stream) => stream.read(into),
        }
    }

    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Serial(file) => file.write(bytes),
            Self::Tcp(stream) => stream.write(bytes),
        }
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Serial(file) => file.as_fd(),
            Self::Tcp(stream) => stream.as_fd(),
        }
    }
}

/// Raw, no flow control, never blocking.
fn open_serial(device: &str, baud: u32) -> io::Result<std::fs::File> {
    use rustix::fs::{Mode, OFlags};
    let fd = rustix::fs::open(
        device,
        OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC,
        Mode::empty(),
    )?;
    let mut settings = rustix::termios::tcgetattr(&fd)?;
    settings.make_raw();
    settings.set_speed(baud)?;
    rustix::termios::tcsetattr(&fd, OptionalActions::Now, &settings)?;
    rustix::termios::tcflush(&fd, QueueSelector::IOFlush)?;
    Ok(std::fs::File::from(fd))
}

/// News from the flight thread.
#[derive(Clone, Debug)]
pub enum News {
    /// What became of a request.
    Answer(Answer),
    /// Something happened.
    Event(Event),
}

/// The ground's end of the door.
#[derive(Debug)]
pub struct FlightHandle {
    requests: SyncSender<Asked>,
    wake: Arc<OwnedFd>,
    news: Receiver<News>,
    snapshot: Arc<Mutex<Snapshot>>,
}

impl FlightHandle {
    /// Hands a request over; false if the ring is full.
    #[must_use]
    pub fn ask(&self, asked: Asked) -> bool {
        let taken = self.requests.try_send(asked).is_ok();
        let _ = rustix::io::write(&*self.wake, &1u64.to_ne_bytes());
        taken
    }

    /// The next news, without waiting.
    #[must_use]
    pub fn poll(&self) -> Option<News> {
        self.news.try_recv().ok()
    }

    /// Copies the newest snapshot.
    pub fn read_snapshot(&self, into: &mut Snapshot) {
        if let Ok(snapshot) = self.snapshot.lock() {
            into.clone_from(&snapshot);
        }
    }
}

/// Opens the line and starts the thread.
///
/// # Errors
/// [`LineError`] says what to check.
pub fn start(
    mut flight: Flight,
    endpoint: Endpoint,
    clock: Clock,
) -> Result<FlightHandle, LineError> {
    let line = Line::open(&endpoint)?;
    let (requests, asked) = sync_channel(REQUESTS);
    let (tell, news) = sync_channel(NEWS);
    let wake = eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC)
        .map_err(|e| LineError::Thread(e.into()))?;
    let wake = Arc::new(wake);
    let snapshot = Arc::new(Mutex::new(flight.snapshot().clone()));
    let handle = FlightHandle {
        requests,
        wake: Arc::clone(&wake),
        news,
        snapshot: Arc::clone(&snapshot),
    };
    let (jobs, job_requests) = sync_channel::<estimator::SearchRequest>(1);
    let (job_results, done) = sync_channel::<estimator::SearchResult>(1);
    let job_wake = Arc::clone(&wake);
    std::thread::Builder::new()
        .name("jobs".to_owned())
        .spawn(move || {
            for job in job_requests {
                if job_results.send(estimator::search(&job)).is_err() {
                    return;
                }
                let _ = rustix::io::write(&*job_wake, &1u64.to_ne_bytes());
            }
        })
        .map_err(LineError::Thread)?;
    std::thread::Builder::new()
        .name("flight".to_owned())
        .spawn(move || {
            let mut shell = Shell {
                line: Some(line),
                endpoint,
                clock,
                tell,
                jobs,
                reopen_at: Timestamp::ZERO,
            };
            flight.handle(clock.now(), Input::FcOpened);
            loop {
                shell.carry_out(&mut flight);
                if let Ok(mut cell) = snapshot.try_lock() {
                    cell.clone_from(flight.snapshot());
                }
                shell.wait(&flight, &wake);
                shell.read_line(&mut flight);
                while let Ok(result) = done.try_recv() {
                    flight.handle(clock.now(), Input::JobDone(result));
                }
                loop {
                    match asked.try_recv() {
                        Ok(request) => flight.handle(clock.now(), Input::Asked(request)),
                        Err(TryRecvError::Empty) => break,
                        Err(TryRecvError::Disconnected) => return,
                    }
                    shell.carry_out(&mut flight);
                }
                if flight.deadline() <= clock.now() {
                    flight.handle(clock.now(), Input::Wake);
                }
            }
        })
        .map_err(LineError::Thread)?;
    Ok(handle)
}

struct Shell {
    line: Option<Line>,
    endpoint: Endpoint,
    clock: Clock,
    tell: SyncSender<News>,
    jobs: SyncSender<estimator::SearchRequest>,
    reopen_at: Timestamp,
}

impl Shell {
    fn wait(&mut self, flight: &Flight, wake: &OwnedFd) {
        let timeout = self.clock.until(flight.deadline()).min(REOPEN);
        let timeout = Timespec {
            tv_sec: 0,
            tv_nsec: i64::from(timeout.subsec_nanos()),
        };
        let fds = &mut [
            PollFd::new(wake, PollFlags::IN),
            PollFd::new(wake, PollFlags::IN),
        ];
        if let Some(line) = &self.line {
            fds[1] = PollFd::from_borrowed_fd(line.fd(), PollFlags::IN);
        }
        let _ = poll(fds, Some(&timeout));
        let mut drain = [0u8; 8];
        let _ = rustix::io::read(wake, &mut drain);
    }

    fn read_line(&mut self, flight: &mut Flight) {
        let Some(line) = &mut self.line else {
            let now = self.clock.now();
            if now >= self.reopen_at {
                self.reopen_at = now + REOPEN;
                if let Ok(line) = Line::open(&self.endpoint) {
                    self.line = Some(line);
                    flight.handle(now, Input::FcOpened);
                }
            }
            return;
        };
        let mut buffer = [0u8; 256];
        // Bounded: a line that never pauses still leaves time for the tick.
        for _ in 0..16 {
            match line.read(&mut buffer) {
                Ok(0) => {
                    self.line = None;
                    return;
                }
                Ok(n) => {
                    let bytes: FcBytes = buffer[..n].iter().copied().collect();
                    flight.handle(self.clock.now(), Input::Fc(bytes));
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => {
                    self.line = None;
                    return;
                }
            }
        }
    }

    fn carry_out(&mut self, flight: &mut Flight) {
        while let Some(output) = flight.poll() {
            match output {
                Output::Fc(bytes) => {
                    // A full kernel buffer means the controller is not reading: what does not fit now is too old later.
                    if let Some(line) = &mut self.line
                        && let Err(e) = line.write(&bytes)
                        && e.kind() != io::ErrorKind::WouldBlock
                    {
                        self.line = None;
                    }
                }
                Output::Answer(answer) => drop(self.tell.try_send(News::Answer(answer))),
                Output::Event(event) => drop(self.tell.try_send(News::Event(event))),
                Output::Job(job) => drop(self.jobs.try_send(job)),
            }
        }
    }
}
