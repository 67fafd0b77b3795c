//! The firmware as a child process that is never left behind.
//!
//! It keeps its settings in `eeprom.bin` of its working directory and "reboots" by ending, so it gets a folder of its own and
//! is started again when it ends. Its words go to `firmware.log` there.
//!
//! Its main loop sleeps 50 us a turn and serves its UART only in what is left of a gyro period of 125 us. The kernel's usual
//! timer slack of 50 us eats that remainder: 30 MSP messages a second on a busy machine, answers after up to 0.3 s. With a
//! slack of 1 ns the same machine gave 92, all within 20 ms. The child inherits the slack of the thread that starts it.
//!
//! A shell stands between: it holds a pipe from this program, and when that pipe closes, for whatever reason, even a kill of
//! this program, it kills the firmware. The child has its own process group, so Ctrl-C reaches Kestrel alone, which lands
//! first.

use super::super::clock;
use rustix::process::{Pid, Signal, kill_process_group};
use sim::firmware::betaflight::{MOTOR_PORT, STATE_PORT, UART1_PORT};
use std::fs::{self, File, OpenOptions};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket};
use std::num::NonZeroU64;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use thiserror::Error;

/// File of the settings in the folder.
pub const EEPROM: &str = "eeprom.bin";
/// File of its words in the folder.
pub const LOG: &str = "firmware.log";
/// So many restarts in a row without a sign of life, and it is given up.
const TRIES: u32 = 5;
/// Longest time until its UART listens after a start.
const START: Duration = Duration::from_secs(8);
/// Pause between two looks at the UART.
const LOOK: Duration = Duration::from_millis(20);

/// Runs "$0" until it ends or the pipe on our standard input closes.
const KEEPER: &str = r#"
exec 3<&0
"$0" </dev/null 3<&- &
firmware=$!
(cat <&3 >/dev/null; kill -9 $firmware) 2>/dev/null &
keeper=$!
exec 3<&-
wait $firmware
code=$?
kill $keeper 2>/dev/null
exit $code
"#;

/// Why the firmware does not run.
#[derive(Debug, Error)]
pub enum StartError {
    /// Another copy has the ports, which cannot be moved.
    #[error(
        "port {0} is taken: the ports of Betaflight's simulator build are fixed, so only one can run on a machine; end the other one"
    )]
    PortTaken(u16),
    /// The folder cannot be made or written.
    #[error("cannot use the firmware's folder {folder}: {source}")]
    Folder {
        /// Which.
        folder: PathBuf,
        /// Reason.
        source: io::Error,
    },
    /// The program does not start.
    #[error("cannot start {program}: {source}")]
    Spawn {
        /// Which.
        program: PathBuf,
        /// Reason.
        source: io::Error,
    },
    /// It runs and does not listen.
    #[error("the firmware does not listen on port {UART1_PORT}; see {0}")]
    Silent(PathBuf),
    /// A socket of ours.
    #[error("socket for the firmware: {0}")]
    Socket(#[from] io::Error),
}

/// The running firmware. Dropping it ends it.
#[derive(Debug)]
pub struct Firmware {
    program: PathBuf,
    folder: PathBuf,
    /// Removed with this.
    is_own_folder: bool,
    child: Child,
    restarts: u32,
    fails: u32,
}

impl Firmware {
    /// Starts it in a folder, or in a fresh one with an empty eeprom that goes with it, and waits until its UART listens.
    ///
    /// # Errors
    /// [`StartError`] says what to do.
    pub fn start(program: &Path, folder: Option<&Path>) -> Result<Self, StartError> {
        ports_are_free()?;
        let is_own_folder = folder.is_none();
        let folder = folder.map_or_else(
            || std::env::temp_dir().join(format!("kestrel-firmware-{}", std::process::id())),
            Path::to_owned,
        );
        let failed = |source| StartError::Folder {
            folder: folder.clone(),
            source,
        };
        fs::create_dir_all(&folder).map_err(failed)?;
        let folder = folder.canonicalize().map_err(failed)?;
        if is_own_folder {
            // A folder left over from a process of the same number.
            let _ = fs::remove_file(folder.join(EEPROM));
        }
        let child = spawn(program, &folder)?;
        let mut firmware = Self {
            program: program.to_owned(),
            folder,
            is_own_folder,
            child,
            restarts: 0,
            fails: 0,
        };
        firmware.wait_until_it_listens()?;
        Ok(firmware)
    }

    /// Starts it again if it has ended; true if so. A reboot by MSP looks like that.
    ///
    /// # Errors
    /// It ended at once several times in a row.
    pub fn restart_if_ended(&mut self) -> Result<bool, StartError> {
        if !matches!(self.child.try_wait(), Ok(Some(_))) {
            return Ok(false);
        }
        if self.fails >= TRIES {
            return Err(StartError::Silent(self.log()));
        }
        self.fails += 1;
        self.restarts += 1;
        self.child = spawn(&self.program, &self.folder)?;
        Ok(true)
    }

    /// It has given a sign of life.
    pub const fn is_alive(&mut self) {
        self.fails = 0;
    }

    /// Its process group.
    #[must_use]
    pub fn group(&self) -> i32 {
        i32::try_from(self.child.id()).unwrap_or(0)
    }

    /// How often it was started again.
    #[must_use]
    pub const fn restarts(&self) -> u32 {
        self.restarts
    }

    /// File of its words.
    #[must_use]
    pub fn log(&self) -> PathBuf {
        self.folder.join(LOG)
    }

    /// Ends it and starts it again: the cure for one whose scheduler does not run.
    ///
    /// # Errors
    /// It cannot be started, or that has not helped several times in a row.
    pub fn restart(&mut self) -> Result<(), StartError> {
        if self.fails >= TRIES {
            return Err(StartError::Silent(self.log()));
        }
        self.end();
        self.fails += 1;
        self.restarts += 1;
        self.child = spawn(&self.program, &self.folder)?;
        Ok(())
    }

    /// Waits until its UART takes connections, starting it again should it end meanwhile.
    ///
    /// # Errors
    /// [`StartError::Silent`].
    pub fn wait_until_it_listens(&mut self) -> Result<(), StartError> {
        for _ in 0..START.as_millis() / LOOK.as_millis() {
            self.restart_if_ended()?;
            // The kernel's table instead of a connection: the firmware has one place for a client on each UART, and is slow
            // to see that one has gone.
            if is_listening(UART1_PORT) {
                self.fails = 0;
                return Ok(());
            }
            clock::sleep(LOOK);
        }
        Err(StartError::Silent(self.log()))
    }

    fn end(&mut self) {
        // The whole group at once, stopped or not; waiting for the shell to do it would hang on a stopped one.
        if let Some(group) = Pid::from_raw(self.group()) {
            let _ = kill_process_group(group, Signal::KILL);
        }
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}

impl Drop for Firmware {
    fn drop(&mut self) {
        self.end();
        if self.is_own_folder {
            let _ = fs::remove_dir_all(&self.folder);
        }
    }
}

fn spawn(program: &Path, folder: &Path) -> Result<Child, StartError> {
    let failed = |source| StartError::Folder {
        folder: folder.to_owned(),
        source,
    };
    let log = OpenOptions::new()
        .create(true)
        .append(true)
        .open(folder.join(LOG))
        .map_err(failed)?;
    let log_too: File = log.try_clone().map_err(failed)?;
    let slack = rustix::thread::current_timer_slack().ok();
    let _ = rustix::thread::set_current_timer_slack(NonZeroU64::new(1));
    let child = Command::new("/bin/sh")
        .arg("-c")
        .arg(KEEPER)
        .arg(program)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(log)
        .stderr(log_too)
        .process_group(0)
        .spawn()
        .map_err(|source| StartError::Spawn {
            program: program.to_owned(),
            source,
        });
    let _ = rustix::thread::set_current_timer_slack(slack.and_then(NonZeroU64::new));
    child
}

/// The firmware shares its ports silently with another copy, so they are looked at before.
fn ports_are_free() -> Result<(), StartError> {
    for port in [STATE_PORT, MOTOR_PORT] {
        UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port)).map_err(|_| StartError::PortTaken(port))?;
    }
    if is_listening(UART1_PORT) {
        return Err(StartError::PortTaken(UART1_PORT));
    }
    Ok(())
}

/// Whether somebody listens on a TCP port of this machine.
fn is_listening(port: u16) -> bool {
    const LISTEN: &str = "0A";
    let wanted = format!(":{port:04X}");
    for table in ["/proc/net/tcp", "/proc/net/tcp6"] {
        let Ok(text) = fs::read_to_string(table) else {
            continue;
        };
        let found = text.lines().skip(1).any(|line| {
            let mut columns = line.split_whitespace().skip(1);
            let local = columns.next().unwrap_or_default();
            local.ends_with(&wanted) && columns.nth(1) == Some(LISTEN)
        });
        if found {
            return true;
        }
    }
    false
}

/// Connects to its UART 1.
pub(super) fn connect_uart() -> io::Result<TcpStream> {
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, UART1_PORT));
    let stream = TcpStream::connect_timeout(&address, Duration::from_millis(100))?;
    stream.set_nodelay(true)?;
    stream.set_nonblocking(true)?;
    Ok(stream)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn a_listener_is_seen_and_a_closed_one_is_not() {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        assert!(is_listening(port));
        drop(listener);
        assert!(!is_listening(port));
    }
}
