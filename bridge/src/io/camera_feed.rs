//! Threads that fetch coded pictures: from a recording, standard input, a program's output, an RTSP camera.
//!
//! They run while somebody watches; standard input is read on and thrown away meanwhile, so that who writes is never held up.

use super::camera::{Inbox, Slip};
use super::clock;
use crate::video::CameraSource;
use crate::video::annex_b::{AccessUnit, Assembler, kind};
use crate::video::rtsp::{Address, Client};
use crate::video::sps;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::AsFd;
use rustix::process::{Pid, Signal, kill_process_group};
use std::fs::File;
use std::io::{self, Read, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;
use std::sync::mpsc::SyncSender;
use std::thread::Thread;
use std::time::Duration;

/// How often it is looked whether somebody watches.
const LOOK: Duration = Duration::from_millis(200);
/// A source that failed is tried again after this.
const RETRY: Duration = Duration::from_secs(2);
/// Nobody watches for this long: the program is ended.
const LINGER: Duration = Duration::from_secs(5);
/// An RTSP camera that has not answered by then does not.
const CONNECT: Duration = Duration::from_secs(3);
/// One that says nothing for this long is lost.
const SILENT: Duration = Duration::from_secs(8);
/// Pictures a second of a recording that does not say.
const FPS: f64 = 30.0;
/// Bytes read at once.
const CHUNK: usize = 64 * 1024;

/// Starts the thread of a source; none for the simulator's.
///
/// # Errors
/// No thread is left, no such file.
pub(super) fn start(
    source: &CameraSource,
    slip: Slip,
    tell: SyncSender<String>,
) -> io::Result<Option<Thread>> {
    let mut feeder = Feeder {
        slip,
        tell,
        told: String::new(),
    };
    let work: Box<dyn FnOnce() + Send> = match source.clone() {
        CameraSource::Simulator => return Ok(None),
        CameraSource::File { path, fps } => {
            // Whoever mistyped it wants to know it now.
            File::open(&path).map_err(|e| named(&e, &path))?;
            Box::new(move || feeder.play(&path, fps))
        }
        CameraSource::Stdin { fps } => Box::new(move || feeder.stdin(fps)),
        CameraSource::Command(command) => Box::new(move || feeder.command(&command)),
        CameraSource::Rtsp(url) => {
            let address = Address::parse(&url).map_err(io::Error::other)?;
            Box::new(move || feeder.rtsp(&address))
        }
    };
    let thread = std::thread::Builder::new()
        .name("camera feed".to_owned())
        .spawn(work)?;
    Ok(Some(thread.thread().clone()))
}

fn named(e: &io::Error, path: &Path) -> io::Error {
    io::Error::new(e.kind(), format!("{}: {e}", path.display()))
}

struct Feeder {
    slip: Slip,
    tell: SyncSender<String>,
    /// Said last: not said twice.
    told: String,
}

/// Puts pictures where the camera takes them; after a loss only from the next key picture on.
struct Chute<'a> {
    slip: &'a Slip,
    skips: bool,
}

impl Chute<'_> {
    fn put(&mut self, unit: AccessUnit) {
        if self.skips && !unit.is_key {
            return;
        }
        self.skips = !self
            .slip
            .put(Inbox::Unit(unit, clock::monotonic_ns() / 1000));
    }
}

impl Feeder {
    fn is_over(&self) -> bool {
        self.slip.shared.is_over.load(Ordering::Relaxed)
    }

    fn is_wanted(&self) -> bool {
        !self.is_over() && self.slip.shared.is_watched()
    }

    /// Waits until somebody watches; false at the end of the program.
    fn wait(&self) -> bool {
        while !self.is_over() {
            if self.is_wanted() {
                return true;
            }
            std::thread::park_timeout(LOOK);
        }
        false
    }

    fn say(&mut self, text: String) {
        if text != self.told {
            let _ = self.tell.try_send(text.clone());
            self.told = text;
        }
    }

    /// A recording, again and again.
    fn play(&mut self, path: &Path, fps: Option<f64>) {
        while self.wait() {
            let result = File::open(path).and_then(|file| self.paced(file, fps));
            match result {
                Ok(0) => self.say(format!("{}: no H.264 picture in it", path.display())),
                Ok(_) => continue,
                Err(e) => self.say(named(&e, path).to_string()),
            }
            std::thread::park_timeout(RETRY);
        }
    }

    /// Pictures at their pace; how many there were.
    fn paced(&self, mut from: impl Read, fps: Option<f64>) -> io::Result<u64> {
        let mut assembler = Assembler::default();
        let mut chunk = vec![0; CHUNK];
        let mut out = Chute {
            slip: &self.slip,
            skips: false,
        };
        let (mut count, mut units) = (0, Vec::new());
        let mut rate = fps.unwrap_or(FPS);
        let mut due_us = clock::monotonic_ns() / 1000;
        loop {
            let n = from.read(&mut chunk)?;
            if n == 0 {
                assembler.finish(&mut |u| units.push(u));
            } else {
                assembler.push(&chunk[..n], &mut |u| units.push(u));
            }
            for unit in units.drain(..) {
                if !self.is_wanted() {
                    return Ok(count.max(1));
                }
                let said = unit.nals().find(|n| kind(n) == 7).and_then(sps::read);
                if let (None, Some(said)) = (fps, said.and_then(|f| f.fps)) {
                    rate = said;
                }
                let now_us = clock::monotonic_ns() / 1000;
                if due_us > now_us {
                    std::thread::park_timeout(Duration::from_micros(due_us - now_us));
                }
                out.put(unit);
                count += 1;
                // Held up for long: go on from here instead of racing.
                due_us = due_us.max(now_us.saturating_sub(200_000)) + (1e6 / rate) as u64;
            }
            if n == 0 {
                return Ok(count);
            }
        }
    }

    fn stdin(&mut self, fps: Option<f64>) {
        let stdin = io::stdin();
        if fps.is_some() {
            if self.wait() {
                let _ = self.paced(stdin.lock(), fps);
            }
        } else {
            let result = self.live(&stdin, || true);
            if let Err(e) = result {
                self.say(format!("standard input: {e}"));
            }
        }
        self.say("the picture on standard input is over".to_owned());
    }

    /// Pictures as they come, while `goes_on`.
    fn live(&self, fd: &impl AsFd, mut goes_on: impl FnMut() -> bool) -> io::Result<u64> {
        let mut assembler = Assembler::default();
        let mut chunk = vec![0; CHUNK];
        let mut out = Chute {
            slip: &self.slip,
            skips: false,
        };
        let mut count = 0;
        while !self.is_over() && goes_on() {
            let timeout = Timespec {
                tv_sec: 0,
                tv_nsec: LOOK.as_nanos() as i64,
            };
            let mut fds = [PollFd::new(fd, PollFlags::IN)];
            if poll(&mut fds, Some(&timeout)).unwrap_or(0) == 0 {
                continue;
            }
            let n = rustix::io::read(fd, &mut chunk[..])?;
            let mut take = |unit| {
                count += 1;
                if self.slip.shared.is_watched() {
                    out.put(unit);
                }
            };
            if n == 0 {
                assembler.finish(&mut take);
                break;
            }
            assembler.push(&chunk[..n], &mut take);
        }
        Ok(count)
    }

    fn command(&mut self, command: &str) {
        while self.wait() {
            match spawn(command) {
                Ok(mut child) => {
                    let result = self.run(&mut child);
                    end(&mut child);
                    let is_wanted = self.is_wanted();
                    match (result, child.wait()) {
                        (Err(e), _) => self.say(format!("camera program: {e}")),
                        (Ok(count), Ok(status)) if is_wanted => {
                            self.say(format!("the camera program ended after {count} pictures ({status}): started again every 2 s"));
                        }
                        _ => continue,
                    }
                }
                Err(e) => self.say(format!("the camera program cannot be started: {e}")),
            }
            std::thread::park_timeout(RETRY);
        }
    }

    /// A camera of its own, while somebody watches.
    fn rtsp(&mut self, address: &Address) {
        while self.wait() {
            if let Err(e) = self.converse(address) {
                self.say(format!("{}: {e}; tried again every 2 s", address.url));
                std::thread::park_timeout(RETRY);
            } else {
                self.told.clear();
            }
        }
    }

    fn converse(&self, address: &Address) -> io::Result<()> {
        let place = (address.host.as_str(), address.port)
            .to_socket_addrs()?
            .next()
            .ok_or_else(|| io::Error::other("no such host"))?;
        let mut stream = TcpStream::connect_timeout(&place, CONNECT)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(LOOK))?;
        stream.set_write_timeout(Some(CONNECT))?;
        let mut client = Client::new(address.clone());
        let mut chunk = vec![0; CHUNK];
        let mut out = Chute {
            slip: &self.slip,
            skips: false,
        };
        let clock = clock::Clock::start(1.0);
        let (mut heard, mut wanted, mut alive) = (clock.now(), clock.now(), clock.now());
        loop {
            while let Some(request) = client.poll_transmit() {
                stream.write_all(&request)?;
            }
            match stream.read(&mut chunk) {
                Ok(0) => return Err(io::Error::other("the camera has closed the connection")),
                Ok(n) => {
                    heard = clock.now();
                    client
                        .push(&chunk[..n], &mut |unit| out.put(unit))
                        .map_err(io::Error::other)?;
                }
                Err(e)
                    if matches!(
                        e.kind(),
                        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
                    ) => {}
                Err(e) => return Err(e),
            }
            let now = clock.now();
            if self.is_wanted() {
                wanted = now;
            }
            if self.is_over() || now.since(wanted) >= LINGER {
                client.tear_down();
                while let Some(request) = client.poll_transmit() {
                    let _ = stream.write_all(&request);
                }
                return Ok(());
            }
            if now.since(heard) >= SILENT {
                return Err(io::Error::other("the camera has fallen silent"));
            }
            if now.since(alive).as_secs() * 3 >= client.timeout_s {
                alive = now;
                client.keep_alive();
            }
        }
    }

    fn run(&self, child: &mut Child) -> io::Result<u64> {
        let Some(stdout) = child.stdout.take() else {
            return Ok(0);
        };
        let clock = clock::Clock::start(1.0);
        let mut wanted_at = clock.now();
        let goes_on = || {
            if self.slip.shared.is_watched() {
                wanted_at = clock.now();
            }
            clock.now().since(wanted_at) < LINGER
        };
        self.live(&stdout, goes_on)
    }
}

/// A shell in a process group of its own, so that what it starts ends with it.
fn spawn(command: &str) -> io::Result<Child> {
    Command::new("sh")
        .args(["-c", command])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .process_group(0)
        .spawn()
}

fn end(child: &mut Child) {
    if let Some(group) = Pid::from_raw(child.id() as i32) {
        let _ = kill_process_group(group, Signal::TERM);
    }
    clock::sleep(Duration::from_millis(50));
    let _ = child.kill();
}
