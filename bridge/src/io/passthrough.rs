//! A configurator on the controller's line, by TCP: one client at a time, and only while the controller is disarmed.

use super::bench_line::BenchLine;
use crate::fc::conversation::AskError;
use crate::fc::motor_test::{MotorTestError, stop_motors};
use crate::fc::passthrough::{Passthrough, Step};
use crate::fc::setup::survey::identify;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::AsFd as _;
use std::fmt;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

/// Looks for the end of the program this often.
const LOOK: Duration = Duration::from_millis(100);
/// A client that leaves more than this unread is gone.
const UNREAD: usize = 256 * 1024;
/// Bytes of the client taken at once.
const READ: usize = 256;

/// Why a client's time is over.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ended {
    /// It has closed its connection, or does not read.
    ClientLeft,
    /// The controller is armed.
    Armed,
    /// The line to the controller is gone: unplugged, or a restart.
    LineLost(String),
    /// The controller does not answer.
    Ask(AskError),
    /// The program ends.
    Stopped,
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ClientLeft => f.write_str("the client left"),
            Self::Armed => f.write_str("the flight controller is armed: the client was sent away"),
            Self::LineLost(why) => write!(f, "the line to the flight controller is gone: {why}"),
            Self::Ask(e) => e.fmt(f),
            Self::Stopped => f.write_str("stopped"),
        }
    }
}

/// Where clients come.
#[derive(Debug)]
pub struct Door {
    listener: TcpListener,
}

impl Door {
    /// Opens it at `host:port`.
    ///
    /// # Errors
    /// What the system says, for example that the port is taken.
    pub fn open(address: &str) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener })
    }

    /// Where it is.
    ///
    /// # Errors
    /// What the system says.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Waits for a client; none when it is time to end.
    pub fn wait(&self, stop: &dyn Fn() -> bool) -> Option<TcpStream> {
        while !stop() {
            let mut fds = [PollFd::new(&self.listener, PollFlags::IN)];
            let _ = poll(&mut fds, Some(&timespec(LOOK)));
            if let Ok((client, _)) = self.listener.accept() {
                let is_set = client
                    .set_nodelay(true)
                    .and_then(|()| client.set_nonblocking(true));
                if is_set.is_ok() {
                    return Some(client);
                }
            }
        }
        None
    }

    /// Carries bytes between client and controller until one of them is gone, the controller is armed, or it is time to
    /// end. Leaves no motor turning and no command line open.
    ///
    /// # Errors
    /// A motor that the client turned may still turn.
    pub fn carry(
        &self,
        bench: &mut BenchLine,
        mut client: TcpStream,
        stop: &dyn Fn() -> bool,
    ) -> Result<Ended, MotorTestError> {
        let identity = match identify(bench) {
            Ok(identity) => identity,
            Err(e) => return Ok(Ended::Ask(e)),
        };
        let mut pass = Passthrough::new(bench.now(), identity);
        let ended = self.pass(bench, &mut client, &mut pass, stop);
        drop(client);
        if pass.in_command_line()
            && let Some(line) = bench.line_mut()
        {
            // As a configurator leaves it: what was not saved is gone.
            let _ = line.write(b"exit\r\n");
        }
        if pass.motors_turn() {
            stop_motors(bench)?;
        }
        Ok(ended)
    }

    fn pass(
        &self,
        bench: &mut BenchLine,
        client: &mut TcpStream,
        pass: &mut Passthrough,
        stop: &dyn Fn() -> bool,
    ) -> Ended {
        let (mut to_controller, mut to_client) = (Vec::new(), Vec::new());
        let mut buffer = [0; READ];
        loop {
            while let Some(step) = pass.poll() {
                match step {
                    Step::ToController(bytes) => to_controller.extend(bytes),
                    Step::ToClient(bytes) => to_client.extend(bytes),
                    Step::Armed => return Ended::Armed,
                }
            }
            if stop() {
                return Ended::Stopped;
            }
            match write_some(client, &mut to_client) {
                Ok(()) if to_client.len() <= UNREAD => {}
                _ => return Ended::ClientLeft,
            }
            let now = bench.now();
            let takes = to_controller.is_empty() && pass.takes(now);
            let wait = pass.deadline(now).since(now).min(LOOK);
            let Some(line) = bench.line_mut() else {
                return Ended::LineLost("closed".to_owned());
            };
            let heard = (|| {
                let written = line.write_stream(&to_controller)?;
                to_controller.drain(..written);
                let client_wants = if takes {
                    PollFlags::IN
                } else {
                    PollFlags::empty()
                } | if to_client.is_empty() {
                    PollFlags::empty()
                } else {
                    PollFlags::OUT
                };
                let line_wants = line.interest()
                    | if to_controller.is_empty() {
                        PollFlags::empty()
                    } else {
                        PollFlags::OUT
                    };
                let mut fds = [
                    PollFd::new(&*client, client_wants),
                    PollFd::from_borrowed_fd(line.as_fd(), line_wants),
                    PollFd::new(&self.listener, PollFlags::IN),
                ];
                let _ = poll(&mut fds, Some(&timespec(wait)));
                match line.read(&mut buffer) {
                    Ok(0) => Err(io::Error::from(ErrorKind::UnexpectedEof)),
                    Err(e) if is_nothing(&e) => Ok(0),
                    other => other,
                }
            })();
            let now = bench.now();
            match heard {
                Ok(0) => pass.tick(now),
                Ok(n) => pass.controller(now, &buffer[..n]),
                Err(e) => {
                    bench.lose();
                    return Ended::LineLost(e.to_string());
                }
            }
            if takes && pass.takes(now) {
                match client.read(&mut buffer) {
                    Ok(0) => return Ended::ClientLeft,
                    Ok(n) => pass.client(now, &buffer[..n]),
                    Err(e) if is_nothing(&e) => {}
                    Err(_) => return Ended::ClientLeft,
                }
            }
            // Two on one line would each take half of the answers.
            if let Ok((second, _)) = self.listener.accept() {
                drop(second);
            }
        }
    }
}

fn write_some(client: &mut TcpStream, bytes: &mut Vec<u8>) -> io::Result<()> {
    if bytes.is_empty() {
        return Ok(());
    }
    match client.write(bytes) {
        Ok(n) => {
            bytes.drain(..n);
            Ok(())
        }
        Err(e) if is_nothing(&e) => Ok(()),
        Err(e) => Err(e),
    }
}

fn is_nothing(e: &io::Error) -> bool {
    matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

fn timespec(time: Duration) -> Timespec {
    Timespec {
        tv_sec: i64::try_from(time.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: i64::from(time.subsec_nanos()),
    }
}
