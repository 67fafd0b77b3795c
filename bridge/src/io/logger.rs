//! Flight logs on disk, by a thread of their own.
//!
//! The flight thread and the ground side drop records into bounded rings and never wait: a full ring loses the record, which is
//! counted, told (`/lost`) and never made up for. The thread empties the rings a hundred times a second.
//!
//! | What | When |
//! | --- | --- |
//! | chunk ended, written and `fdatasync`ed, `.mcap` and `.tlog` alike | every 0.5 s |
//! | next part (`0007-2.mcap`), which opens with the same header | `LOG_PART_MB` |
//! | oldest runs removed | more than 20, more than `LOG_TOTAL_MB`, or the disk is full |
//! | disk full and nothing to remove, or broken | records are counted as lost; a new part is tried every 5 s |
//!
//! So `kill -9` and a power cut cost at most the last second, and a log without its end is read up to its last chunk.
//!
//! The thread ends by [`LogThread::finish`], which writes what waits; a program that is killed leaves the end out.

use super::clock::{self, monotonic_ns};
use crate::log::{FlightRecord, GroundRecord, Header, LogWriter, record::LogSink};
use crate::settings::Settings;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Records of the flight thread that wait at most: six seconds of flight.
const FLIGHT_RING: usize = 4_096;
/// Records of the ground side that wait at most.
const GROUND_RING: usize = 1_024;
/// Pause between two looks into the rings.
const LOOK: Duration = Duration::from_millis(10);
/// What was recorded is on the disk after this.
const FLUSH: Duration = Duration::from_millis(500);
/// Pause before a broken disk is tried again.
const RETRY: Duration = Duration::from_secs(5);
/// Longest wait for the thread at the end.
const END: Duration = Duration::from_secs(10);
/// Runs kept; older ones make room.
const MAX_RUNS: usize = 20;

/// What a loop does when the ring is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// Real time: the record is lost and counted.
    Lose,
    /// Virtual time has time to wait.
    Wait,
}

/// Sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of a part.
    pub part: u64,
    /// Bytes of all logs.
    pub total: u64,
}

impl Limits {
    /// As the parameters say.
    #[must_use]
    pub const fn of(settings: &Settings) -> Self {
        Self {
            part: (settings.ground.log_part_mb as u64) << 20,
            total: (settings.ground.log_total_mb as u64) << 20,
        }
    }
}

/// How logging goes; written by the threads, read by anybody.
#[derive(Debug, Default)]
pub struct LogStatus {
    lost: AtomicU64,
    written: AtomicU64,
    failing: AtomicBool,
}

impl LogStatus {
    /// Records that found no room or no disk.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    /// Bytes on the disk.
    #[must_use]
    pub fn written(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// The disk is full or broken: nothing is being logged.
    #[must_use]
    pub fn is_failing(&self) -> bool {
        self.failing.load(Ordering::Relaxed)
    }
}

/// One end of a ring.
#[derive(Debug)]
pub struct Tap<T> {
    ring: SyncSender<T>,
    missing: u64,
    when_full: WhenFull,
    status: Arc<LogStatus>,
    lost: fn(u64) -> T,
}

/// For the flight thread.
pub type FlightTap = Tap<FlightRecord>;
/// For the ground side.
pub type GroundTap = Tap<GroundRecord>;

impl<T> Tap<T> {
    /// Hands a record over, or counts it.
    pub fn put(&mut self, record: T) {
        if self.when_full == WhenFull::Wait {
            // A thread that has ended has said why.
            let _ = self.ring.send(record);
            return;
        }
        if self.missing > 0 {
            match self.ring.try_send((self.lost)(self.missing)) {
                Ok(()) => self.missing = 0,
                Err(TrySendError::Full(_)) => return self.lose(),
                Err(TrySendError::Disconnected(_)) => return,
            }
        }
        // What comes after the log was ended is not missing in it.
        if let Err(TrySendError::Full(_)) = self.ring.try_send(record) {
            self.lose();
        }
    }

    fn lose(&mut self) {
        self.missing += 1;
        self.status.lost.fetch_add(1, Ordering::Relaxed);
    }
}

/// Both ends, for a loop that is flight and ground at once.
#[derive(Debug)]
pub struct Taps {
    /// For the flight thread.
    pub flight: FlightTap,
    /// For the ground side.
    pub ground: GroundTap,
}

impl LogSink for Taps {
    fn flight(&mut self, record: FlightRecord) {
        self.flight.put(record);
    }

    fn ground(&mut self, record: GroundRecord) {
        self.ground.put(record);
    }
}

/// Where bytes go.
pub trait LogFiles: Send {
    /// Begins a part.
    ///
    /// # Errors
    /// The disk says no.
    fn begin(&mut self, part: u32) -> io::Result<()>;
    /// Appends to both files and makes it safe.
    ///
    /// # Errors
    /// The disk says no.
    fn append(&mut self, mcap: &[u8], tlog: &[u8]) -> io::Result<()>;
    /// Removes the oldest run; false if there is none to remove.
    fn make_room(&mut self) -> bool;
}

/// Files in a folder: `STEM.mcap`, `STEM.tlog`, then `STEM-2.mcap` ...
#[derive(Debug)]
pub struct DiskFiles {
    folder: PathBuf,
    stem: String,
    /// Other logs in the folder may be removed.
    owns_folder: bool,
    total: u64,
    open: Option<(File, File)>,
}

impl DiskFiles {
    /// A run of a folder of logs, in which older ones make room.
    #[must_use]
    pub fn of_run(folder: &Path, stem: &str, limits: Limits) -> Self {
        Self {
            folder: folder.to_owned(),
            stem: stem.to_owned(),
            owns_folder: true,
            total: limits.total,
            open: None,
        }
    }

    /// A file somebody named.
    #[must_use]
    pub fn named(path: &Path) -> Self {
        let stem = path
            .file_stem()
            .map_or_else(|| "flight".into(), |s| s.to_string_lossy().into_owned());
        Self {
            folder: path.parent().unwrap_or_else(|| Path::new("")).to_owned(),
            stem,
            owns_folder: false,
            total: u64::MAX,
            open: None,
        }
    }

    /// Path of a part.
    #[must_use]
    pub fn path(&self, part: u32, ending: &str) -> PathBuf {
        let name = match part {
            1 => format!("{}.{ending}", self.stem),
            n => format!("{}-{n}.{ending}", self.stem),
        };
        self.folder.join(name)
    }
}

impl LogFiles for DiskFiles {
    fn begin(&mut self, part: u32) -> io::Result<()> {
        self.open = None;
        if self.owns_folder {
            let runs = runs(&self.folder)?;
            let mut size: u64 = runs.iter().map(|r| r.bytes).sum();
            let others = runs.iter().filter(|r| r.stem != self.stem);
            let mut left = others.clone().count();
            for run in others {
                if left < MAX_RUNS && size <= self.total {
                    break;
                }
                run.remove(&self.folder);
                left -= 1;
                size -= run.bytes;
            }
        }
        let mcap = File::create(self.path(part, "mcap"))?;
        let tlog = File::create(self.path(part, "tlog"))?;
        self.open = Some((mcap, tlog));
        // The names must reach the disk too.
        let folder = match self.folder.as_os_str().is_empty() {
            true => Path::new("."),
            false => &self.folder,
        };
        File::open(folder)?.sync_all()
    }

    fn append(&mut self, mcap: &[u8], tlog: &[u8]) -> io::Result<()> {
        let (m, t) = self
            .open
            .as_mut()
            .ok_or_else(|| io::Error::from(io::ErrorKind::NotConnected))?;
        for (file, bytes) in [(m, mcap), (t, tlog)] {
            if !bytes.is_empty() {
                file.write_all(bytes)?;
                file.sync_data()?;
            }
        }
        Ok(())
    }

    fn make_room(&mut self) -> bool {
        if !self.owns_folder {
            return false;
        }
        let runs = runs(&self.folder).unwrap_or_default();
        runs.iter()
            .find(|r| r.stem != self.stem)
            .is_some_and(|oldest| oldest.remove(&self.folder))
    }
}

/// A run in a folder of logs: all files of one number.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Run {
    stem: String,
    files: Vec<String>,
    bytes: u64,
}

impl Run {
    fn remove(&self, folder: &Path) -> bool {
        self.files
            .iter()
            .all(|name| fs::remove_file(folder.join(name)).is_ok())
    }
}

/// Number of the run a log belongs to: `0007-2.mcap` to `0007`.
#[must_use]
pub fn run_of(name: &str) -> &str {
    name.split(['.', '-']).next().unwrap_or(name)
}

/// Runs of a folder, oldest first.
fn runs(folder: &Path) -> io::Result<Vec<Run>> {
    let mut runs: Vec<Run> = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let Ok(name) = entry.file_name().into_string() else {
            continue;
        };
        let stem = run_of(&name).to_owned();
        let is_log = name.ends_with(".mcap") || name.ends_with(".tlog");
        if !is_log || stem.parse::<u32>().is_err() {
            continue;
        }
        let bytes = entry.metadata().map_or(0, |m| m.len());
        match runs.iter_mut().find(|r| r.stem == stem) {
            Some(run) => {
                run.files.push(name);
                run.bytes += bytes;
            }
            None => runs.push(Run {
                stem,
                files: vec![name],
                bytes,
            }),
        }
    }
    runs.sort_by_key(|r| r.stem.parse::<u32>().unwrap_or(u32::MAX));
    Ok(runs)
}

/// A fresh number in a folder of logs.
///
/// # Errors
/// The folder cannot be read.
pub fn fresh_stem(folder: &Path) -> io::Result<String> {
    let last = runs(folder)?
        .last()
        .and_then(|r| r.stem.parse::<u32>().ok())
        .unwrap_or(0);
    Ok(format!("{:04}", last.saturating_add(1)))
}

/// The thread.
#[derive(Debug)]
pub struct LogThread {
    thread: JoinHandle<()>,
    stop: Arc<AtomicBool>,
    status: Arc<LogStatus>,
}

impl LogThread {
    /// How it goes.
    #[must_use]
    pub fn status(&self) -> Arc<LogStatus> {
        Arc::clone(&self.status)
    }

    /// The disk is full or broken: nothing is being logged.
    #[must_use]
    pub fn is_failing(&self) -> bool {
        self.status.is_failing()
    }

    /// Writes what waits and the index; gives up on a disk that takes too long. False if records are missing.
    #[must_use]
    pub fn finish(self) -> bool {
        self.stop.store(true, Ordering::Relaxed);
        let until = monotonic_ns() + END.as_nanos() as u64;
        while !self.thread.is_finished() && monotonic_ns() < until {
            clock::sleep(LOOK);
        }
        self.thread.is_finished() && self.status.lost() == 0 && !self.status.is_failing()
    }
}

/// Starts the thread. The first part is begun here, so that a folder that cannot be written is an error of the start.
///
/// # Errors
/// The disk says no, or the system has no threads left.
pub fn start(
    header: Header,
    mut files: impl LogFiles + 'static,
    limits: Limits,
    when_full: WhenFull,
) -> io::Result<(Taps, LogThread)> {
    let (flight_ring, flight) = sync_channel(FLIGHT_RING);
    let (ground_ring, ground) = sync_channel(GROUND_RING);
    let status = Arc::new(LogStatus::default());
    let stop = Arc::new(AtomicBool::new(false));
    let writer = LogWriter::new(Arc::new(header)).map_err(io::Error::other)?;
    files.begin(writer.part())?;
    let scribe = Scribe {
        writer,
        files,
        flight,
        ground,
        stop: Arc::clone(&stop),
        status: Arc::clone(&status),
        part_limit: limits.part,
        part_bytes: 0,
        failed_ns: None,
    };
    let thread = thread::Builder::new()
        .name("log".to_owned())
        .spawn(move || scribe.run())?;
    let taps = Taps {
        flight: Tap {
            ring: flight_ring,
            missing: 0,
            when_full,
            status: Arc::clone(&status),
            lost: |records| FlightRecord::Lost { records },
        },
        ground: Tap {
            ring: ground_ring,
            missing: 0,
            when_full,
            status: Arc::clone(&status),
            lost: |records| GroundRecord::Lost { records },
        },
    };
    Ok((
        taps,
        LogThread {
            thread,
            stop,
            status,
        },
    ))
}

struct Scribe<F> {
    writer: LogWriter,
    files: F,
    flight: Receiver<FlightRecord>,
    ground: Receiver<GroundRecord>,
    stop: Arc<AtomicBool>,
    status: Arc<LogStatus>,
    part_limit: u64,
    part_bytes: u64,
    /// Since when the disk fails.
    failed_ns: Option<u64>,
}

impl<F: LogFiles> Scribe<F> {
    fn run(mut self) {
        let mut flushed_ns = monotonic_ns();
        loop {
            // Asked before the rings are emptied: what came before is written.
            let stopping = self.stop.load(Ordering::Relaxed);
            self.empty_rings();
            let now_ns = monotonic_ns();
            let is_due = now_ns - flushed_ns >= FLUSH.as_nanos() as u64;
            if is_due && !stopping {
                flushed_ns = now_ns;
                self.flush(now_ns);
            }
            if stopping {
                self.end(now_ns);
                return;
            }
            clock::sleep(LOOK);
        }
    }

    /// What waits now, no more: a flood must not keep it from writing.
    fn empty_rings(&mut self) {
        let is_failing = self.failed_ns.is_some();
        for record in self.flight.try_iter().take(FLIGHT_RING) {
            if is_failing {
                self.status.lost.fetch_add(1, Ordering::Relaxed);
                continue;
            }
            self.writer.flight(&record);
        }
        for record in self.ground.try_iter().take(GROUND_RING) {
            if is_failing {
                self.status.lost.fetch_add(1, Ordering::Relaxed);
            } else {
                self.writer.ground(&record);
            }
        }
    }

    fn flush(&mut self, now_ns: u64) {
        if let Some(since) = self.failed_ns {
            if now_ns - since < RETRY.as_nanos() as u64 {
                return;
            }
            if self.next_part().is_err() {
                self.failed_ns = Some(now_ns);
                return;
            }
            self.failed_ns = None;
            self.status.failing.store(false, Ordering::Relaxed);
            let lost = self.status.lost().saturating_sub(self.writer.lost());
            self.writer.ground(&GroundRecord::Lost { records: lost });
        }
        self.writer.flush();
        let mcap = self.writer.take_mcap();
        let tlog = self.writer.take_tlog();
        self.write(&mcap, &tlog, now_ns);
        if self.part_bytes >= self.part_limit
            && self.failed_ns.is_none()
            && self.next_part().is_err()
        {
            self.fail(now_ns);
        }
    }

    fn write(&mut self, mcap: &[u8], tlog: &[u8], now_ns: u64) {
        let n = (mcap.len() + tlog.len()) as u64;
        match self.files.append(mcap, tlog) {
            Ok(()) => {
                self.part_bytes += n;
                self.status.written.fetch_add(n, Ordering::Relaxed);
            }
            // What is torn now stays torn; the next part is tried with more room at once.
            Err(_) => {
                let has_room = self.files.make_room();
                if !has_room || self.next_part().is_err() {
                    self.fail(now_ns);
                }
            }
        }
    }

    fn fail(&mut self, now_ns: u64) {
        self.failed_ns = Some(now_ns);
        self.status.failing.store(true, Ordering::Relaxed);
    }

    /// Ends this part and begins the next one.
    fn next_part(&mut self) -> io::Result<()> {
        let last = self.writer.next_part().map_err(io::Error::other)?;
        // A part that cannot be ended is read without its end.
        let _ = self.files.append(&last, &[]);
        self.files.begin(self.writer.part())?;
        let head = self.writer.take_mcap();
        self.files.append(&head, &[])?;
        self.part_bytes = head.len() as u64;
        Ok(())
    }

    fn end(&mut self, now_ns: u64) {
        let lost = self.status.lost().saturating_sub(self.writer.lost());
        if lost > 0 {
            self.writer.ground(&GroundRecord::Lost { records: lost });
        }
        self.writer.finish();
        let mcap = self.writer.take_mcap();
        let tlog = self.writer.take_tlog();
        if self.failed_ns.is_none() {
            self.write(&mcap, &tlog, now_ns);
        }
    }
}

#[cfg(test)]
mod tests;
