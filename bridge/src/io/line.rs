//! The flight controller's line: a serial port or a TCP connection, never blocking.

use super::endpoint::Endpoint;
use arrayvec::ArrayVec;
use rustix::event::PollFlags;
use rustix::fd::{AsFd, BorrowedFd};
use rustix::termios::{OptionalActions, QueueSelector};
use std::fs::File;
use std::io::{self, Read as _, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::time::Duration;
use thiserror::Error;

/// A connection that is not there after this is tried again later.
const CONNECT: Duration = Duration::from_secs(2);

/// Why the flight controller's line could not be opened.
#[derive(Debug, Error)]
pub enum LineError {
    /// No such device, or not allowed.
    #[error("flight controller {endpoint}: {reason}: {}", what_to_check(.endpoint))]
    Open {
        /// Where.
        endpoint: Endpoint,
        /// Reason.
        reason: io::Error,
    },
    /// Not a kind of line a flight controller is on.
    #[error("flight controller {0}: use serial:///dev/...?baudrate=N or tcpclient://host:port")]
    Kind(Endpoint),
    /// The thread could not be started.
    #[error("cannot start the flight thread: {0}")]
    Thread(io::Error),
}

const fn what_to_check(endpoint: &Endpoint) -> &'static str {
    match endpoint {
        Endpoint::Serial { .. } => {
            "check the cable, the name and that you may open it (group dialout)"
        }
        _ => "check the address and that something listens there",
    }
}

/// An open line.
#[derive(Debug)]
pub struct Line {
    port: Port,
    /// The rest of a frame that the kernel had no room for.
    rest: ArrayVec<u8, 256>,
    /// Frames dropped because an earlier one was still waiting for room.
    dropped: u64,
}

#[derive(Debug)]
enum Port {
    Serial(File),
    Tcp(TcpStream),
}

impl Line {
    /// Opens the line; may take seconds.
    ///
    /// # Errors
    /// [`LineError`] says what to check.
    pub fn open(endpoint: &Endpoint) -> Result<Self, LineError> {
        let failed = |reason| LineError::Open {
            endpoint: endpoint.clone(),
            reason,
        };
        let port = match endpoint {
            Endpoint::Serial { device, baud } => {
                open_serial(device, *baud).map(Port::Serial).map_err(failed)
            }
            Endpoint::TcpClient(address) => connect(address).map(Port::Tcp).map_err(failed),
            other => Err(LineError::Kind(other.clone())),
        }?;
        Ok(Self {
            port,
            rest: ArrayVec::new(),
            dropped: 0,
        })
    }

    /// Bytes that are there; `WouldBlock` if none are, 0 at the end of the connection.
    ///
    /// # Errors
    /// The line is gone.
    pub fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match &mut self.port {
            Port::Serial(file) => file.read(into),
            Port::Tcp(stream) => stream.read(into),
        }
    }

    /// Writes whole frames. What the kernel has no room for is kept to its end, so that the controller never sees half a
    /// frame; later frames are dropped meanwhile, because they would come too late.
    ///
    /// # Errors
    /// The line is gone.
    pub fn write(&mut self, frame: &[u8]) -> io::Result<()> {
        self.flush()?;
        if !self.rest.is_empty() {
            self.dropped += 1;
            return Ok(());
        }
        let written = self.write_some(frame)?;
        // A frame the kernel took nothing of is dropped; one it took a part of must be completed.
        if written > 0 {
            let _ = self.rest.try_extend_from_slice(&frame[written..]);
        } else {
            self.dropped += 1;
        }
        Ok(())
    }

    /// Writes as much as the kernel has room for, and tells how much: for a stream of which nothing may be dropped.
    ///
    /// # Errors
    /// The line is gone.
    pub fn write_stream(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.flush()?;
        if self.rest.is_empty() {
            self.write_some(bytes)
        } else {
            Ok(0)
        }
    }

    /// Writes what is left of a frame.
    ///
    /// # Errors
    /// The line is gone.
    pub fn flush(&mut self) -> io::Result<()> {
        if self.rest.is_empty() {
            return Ok(());
        }
        let rest = self.rest.clone();
        let written = self.write_some(&rest)?;
        self.rest.drain(..written);
        Ok(())
    }

    fn write_some(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = match &mut self.port {
            Port::Serial(file) => file.write(bytes),
            Port::Tcp(stream) => stream.write(bytes),
        };
        match written {
            Err(e)
                if matches!(
                    e.kind(),
                    io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
                ) =>
            {
                Ok(0)
            }
            other => other,
        }
    }

    /// What to wait for.
    #[must_use]
    pub fn interest(&self) -> PollFlags {
        if self.rest.is_empty() {
            PollFlags::IN
        } else {
            PollFlags::IN | PollFlags::OUT
        }
    }

    /// Frames dropped because the controller did not read.
    #[must_use]
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }
}

impl AsFd for Line {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match &self.port {
            Port::Serial(file) => file.as_fd(),
            Port::Tcp(stream) => stream.as_fd(),
        }
    }
}

fn connect(address: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "no such host");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_nonblocking(true)?;
                return Ok(stream);
            }
            Err(e) => last = e,
        }
    }
    Err(last)
}

/// Opens a serial port: raw, no flow control, ours alone.
///
/// # Errors
/// What the system says when the device is none, busy, or does not know the speed.
pub fn open_serial(device: &str, baud: u32) -> io::Result<File> {
    use rustix::fs::{Mode, OFlags};
    let fd = rustix::fs::open(
        device,
        OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC,
        Mode::empty(),
    )?;
    // Two programs on one port would each take half of the replies.
    rustix::termios::ioctl_tiocexcl(&fd)?;
    let mut settings = rustix::termios::tcgetattr(&fd)?;
    settings.make_raw();
    settings.set_speed(baud)?;
    rustix::termios::tcsetattr(&fd, OptionalActions::Now, &settings)?;
    rustix::termios::tcflush(&fd, QueueSelector::IOFlush)?;
    Ok(File::from(fd))
}
