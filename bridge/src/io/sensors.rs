//! The devices of `kestrel fly`: one thread each, which does nothing but wait for bytes or edges, stamps them, and gives what
//! its driver makes of them to the flight thread.
//!
//! A device that is absent, or goes, is opened again every half second for as long as the program runs: what the vehicle does
//! meanwhile is the failsafe's business, which sees silence. Samples go through one bounded ring; when it is full the newest
//! are dropped, because then the flight thread is held up and old ones are all it can use.

use super::clock::{self, Clock};
use super::flight_thread::Inlet;
use super::line::open_serial;
use crate::sensor::Sample;
use crate::sensor::gps::fake::Fake;
use crate::sensor::gps::gpsd::{Gpsd, WATCH};
use crate::sensor::gps::log::Log;
use crate::sensor::gps::{PATIENCE, Start};
use crate::sensor::hc_sr04;
use crate::sensor::suite::{Device, Named, SerialDriver};
use estimator::utm::SouthernOffset;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;
use vehicle::{RangerReading, Timestamp};

/// Pause before an absent device is opened again.
const REOPEN: Duration = Duration::from_millis(500);
/// Longest wait for bytes: how often a driver is asked whether it has something to say.
const ROUND: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 20_000_000,
};
/// A device that is open and gives nothing for this long is complained about.
const QUIET: Duration = Duration::from_secs(3);
/// Longest wait for a connection.
const CONNECT: Duration = Duration::from_secs(2);

/// Starts a thread for each device. What they have to tell a person comes out of the channel.
///
/// # Errors
/// The system has no threads left, or a log cannot be read.
pub fn start(devices: Vec<Named>, inlet: &Inlet, clock: Clock) -> io::Result<Receiver<String>> {
    let (tell, told) = sync_channel(64);
    for (i, Named { name, device }) in devices.into_iter().enumerate() {
        let shell = Shell {
            name,
            inlet: inlet.clone(),
            clock,
            tell: tell.clone(),
            heard: clock.now(),
            bytes: 0,
            is_quiet: false,
            complained: false,
        };
        let run: Box<dyn FnOnce() + Send> = match device {
            Device::Serial { path, baud, driver } => {
                Box::new(move || shell.serial(&path, baud, driver))
            }
            Device::Gpio { chip, pins, ring } => Box::new(move || shell.gpio(&chip, &pins, ring)),
            Device::Gpsd { address, south } => Box::new(move || shell.gpsd(&address, south)),
            Device::GpsLog { path } => {
                let text = std::fs::read_to_string(&path)?;
                let log = Log::from_text(&text)
                    .map_err(|e| io::Error::new(ErrorKind::InvalidData, e.to_string()))?;
                Box::new(move || shell.replay(log))
            }
            Device::GpsFake(fake) => Box::new(move || shell.fake(fake)),
        };
        thread::Builder::new()
            .name(format!("sensor{i}"))
            .spawn(run)?;
    }
    Ok(told)
}

/// What every thread has.
struct Shell {
    name: String,
    inlet: Inlet,
    clock: Clock,
    tell: SyncSender<String>,
    /// When a sample came last.
    heard: Timestamp,
    /// Bytes since then.
    bytes: u64,
    is_quiet: bool,
    /// Of being absent.
    complained: bool,
}

impl Shell {
    fn say(&self, what: &str) {
        drop(self.tell.try_send(format!("{}: {what}", self.name)));
    }

    /// Opens for as long as it takes; none when nobody wants samples any more.
    fn open<T>(&mut self, mut open: impl FnMut() -> io::Result<T>) -> Option<T> {
        loop {
            match open() {
                Ok(device) => {
                    self.say("open");
                    self.complained = false;
                    self.heard = self.clock.now();
                    (self.is_quiet, self.bytes) = (false, 0);
                    return Some(device);
                }
                Err(e) if !self.complained => {
                    self.complained = true;
                    self.say(&format!("{e}; trying again until it is there"));
                }
                Err(_) => {}
            }
            if self.inlet.is_closed() {
                return None;
            }
            clock::sleep(REOPEN);
        }
    }

    /// Gives a sample to the flight thread.
    fn give(&mut self, sample: Sample) {
        self.heard = self.clock.now();
        self.bytes = 0;
        if core::mem::take(&mut self.is_quiet) {
            self.say("delivers again");
        }
        self.inlet.give(sample);
    }

    /// Says once when an open device gives nothing.
    fn watch(&mut self) {
        if !self.is_quiet && self.clock.now().since(self.heard) > QUIET {
            self.is_quiet = true;
            self.say(&format!(
                "open, but nothing to use in {} bytes: check wiring, power and baud rate",
                self.bytes
            ));
        }
    }

    fn serial(mut self, path: &str, baud: u32, mut driver: SerialDriver) {
        loop {
            let needs_dtr_low = driver.needs_dtr_low();
            let opened = self.open(|| {
                let dtr = needs_dtr_low.then(|| lower_dtr(path, baud));
                Ok((open_serial(path, baud)?, dtr))
            });
            let Some((file, _dtr)) = opened else { return };
            driver.opened(self.clock.now());
            if let Err(e) = self.talk(file, &mut driver) {
                self.say(&format!("lost: {e}"));
            }
            if self.inlet.is_closed() {
                return;
            }
            clock::sleep(REOPEN);
        }
    }

    /// Until the line goes.
    fn talk(&mut self, mut line: File, driver: &mut SerialDriver) -> io::Result<()> {
        let mut buffer = [0u8; 1024];
        let mut samples = Vec::new();
        while !self.inlet.is_closed() {
            if let Some(word) = driver.poll(self.clock.now()) {
                let _ = line.write(&word);
            }
            let mut news = [PollFd::new(&line, PollFlags::IN)];
            let _ = poll(&mut news, Some(&ROUND));
            match line.read(&mut buffer) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(n) => {
                    let at = self.clock.now();
                    self.bytes += n as u64;
                    let answer = driver.bytes(at, &buffer[..n], &mut |s| samples.push(s));
                    if let Some(word) = answer {
                        let _ = line.write(&word);
                    }
                }
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(e) => return Err(e),
            }
            for sample in samples.drain(..) {
                self.give(sample);
            }
            self.watch();
        }
        Ok(())
    }

    fn gpio(mut self, chip: &str, pins: &[[u32; 2]], mut ring: hc_sr04::Ring) {
        loop {
            let Some(lines) = self.open(|| super::gpio::Lines::open(chip, pins)) else {
                return;
            };
            if let Err(e) = self.fire(&lines, pins, &mut ring) {
                self.say(&format!("lost: {e}"));
            }
            if self.inlet.is_closed() {
                return;
            }
            clock::sleep(REOPEN);
        }
    }

    /// Fires slot after slot, and takes edges between.
    fn fire(
        &mut self,
        lines: &super::gpio::Lines,
        pins: &[[u32; 2]],
        ring: &mut hc_sr04::Ring,
    ) -> io::Result<()> {
        let mut readings: Vec<RangerReading> = Vec::new();
        while !self.inlet.is_closed() {
            let firing: arrayvec::ArrayVec<u8, { hc_sr04::MAX_SENSORS }> = ring
                .poll(self.clock.now(), &mut |r| readings.push(r))
                .map(|sensors| sensors.iter().copied().collect())
                .unwrap_or_default();
            if !firing.is_empty() {
                // Stamped before the pulse: no line rises sooner than that, however long this thread is held up.
                let at = self.clock.now();
                lines.pulse(firing.iter().map(|i| pins[usize::from(*i)][0]))?;
                for sensor in firing {
                    ring.fired(sensor, at);
                }
            }
            let wait = self.clock.until(ring.deadline());
            while let Some(edge) = lines.edge(wait.min(Duration::from_millis(20)))? {
                if let Some(sensor) = pins.iter().position(|p| p[1] == edge.line) {
                    let at = self.clock.at_monotonic_ns(edge.at_ns);
                    ring.edge(at, sensor as u8, edge.is_rising, &mut |r| readings.push(r));
                }
                if ring.deadline() <= self.clock.now() || !readings.is_empty() {
                    break;
                }
            }
            for reading in readings.drain(..) {
                self.give(Sample::Ranger(reading));
            }
            self.watch();
        }
        Ok(())
    }

    fn gpsd(mut self, address: &str, south: SouthernOffset) {
        let began = self.clock.now();
        let mut start = Start::new(south);
        let mut is_late = false;
        loop {
            let Some(mut stream) = self.open(|| connect(address)) else {
                return;
            };
            let mut gpsd = Gpsd::default();
            let mut buffer = [0u8; 4096];
            if stream.write_all(WATCH).is_ok() {
                while let Ok(n) = stream.read(&mut buffer).or_else(|e| match e.kind() {
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {
                        Ok(usize::MAX)
                    }
                    _ => Err(e),
                }) {
                    let now = self.clock.now();
                    if n == 0 || self.inlet.is_closed() {
                        break;
                    }
                    if n != usize::MAX {
                        self.bytes += n as u64;
                        let mut fixes = Vec::new();
                        gpsd.bytes(now, &buffer[..n], &mut |at, raw| {
                            if let Ok(fix) = start.relative(at, &raw) {
                                fixes.push(fix);
                            }
                        });
                        for fix in fixes {
                            self.give(Sample::Gnss(fix));
                        }
                    }
                    if !is_late && !start.is_set() && now.since(began) > PATIENCE {
                        is_late = true;
                        self.say("no 3D fix within 60 s: flying without");
                    }
                }
            }
            if self.inlet.is_closed() {
                return;
            }
            self.say("lost");
            clock::sleep(REOPEN);
        }
    }

    fn replay(mut self, mut log: Log) {
        self.say(&format!("{} fixes to replay", log.len()));
        while !self.inlet.is_closed() {
            while let Some(fix) = log.poll(self.clock.now()) {
                self.give(Sample::Gnss(fix));
            }
            clock::sleep(Duration::from_millis(20));
        }
    }

    fn fake(mut self, mut fake: Fake) {
        while !self.inlet.is_closed() {
            if let Some(fix) = fake.poll(self.clock.now()) {
                self.give(Sample::Gnss(fix));
            }
            clock::sleep(Duration::from_millis(20));
        }
    }
}

fn connect(address: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(ErrorKind::NotFound, "no such host");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(stream) => {
                stream.set_read_timeout(Some(Duration::from_millis(200)))?;
                return Ok(stream);
            }
            Err(e) => last = e,
        }
    }
    Err(last)
}

/// Lowers DTR: the line that holds it must stay open. What has no such line (a pseudo terminal, a bare UART) does not
/// need it.
fn lower_dtr(path: &str, baud: u32) -> Option<serialport::TTYPort> {
    use serialport::SerialPort as _;
    let mut port = serialport::TTYPort::open(&serialport::new(path, baud)).ok()?;
    let _ = port.set_exclusive(false);
    let _ = port.write_data_terminal_ready(false);
    Some(port)
}
