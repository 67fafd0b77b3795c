//! The flight log: every input of `Flight` with its time. Fed back, it is the flight again.
//!
//! Records follow a text line that names the format: microseconds since the last record and the record, in `postcard` encoding,
//! preceded by its length (u16, little endian).

use crate::autopilot::io::Input;
use crate::autopilot::latency::LatencySummary;
use serde::Serialize;
use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::path::Path;
use vehicle::Timestamp;

/// First line of a flight log.
pub const MAGIC: &[u8] = b"kestrel flight log 2\n";

/// One record.
#[derive(Debug, Serialize)]
pub enum Record<'a> {
    /// Went into `Flight`.
    Input(&'a Input),
    /// A flight is over: how punctual it was.
    Timing {
        /// Age of the attitude at each RC frame.
        sample_to_command: LatencySummary,
        /// Beats missed.
        missed: u64,
    },
}

/// Writes a flight log.
#[derive(Debug)]
pub struct Recorder {
    out: BufWriter<File>,
    buffer: Vec<u8>,
    last: Timestamp,
}

impl Recorder {
    /// A fresh log; `header` (version, seed, parameters) becomes its second paragraph.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: &Path, header: &str) -> io::Result<Self> {
        let mut out = BufWriter::new(File::create(path)?);
        out.write_all(MAGIC)?;
        out.write_all(header.as_bytes())?;
        out.write_all(b"\n\n")?;
        Ok(Self {
            out,
            buffer: vec![0; 8192],
            last: Timestamp::ZERO,
        })
    }

    /// Appends one record.
    ///
    /// # Errors
    /// The disk says no.
    pub fn write(&mut self, now: Timestamp, record: &Record<'_>) -> io::Result<()> {
        let since_us = now.since(self.last).as_micros() as u64;
        self.last = now;
        let used = postcard::to_slice(&(since_us, record), &mut self.buffer)
            .map_err(io::Error::other)?
            .len();
        self.out.write_all(&(used as u16).to_le_bytes())?;
        self.out.write_all(&self.buffer[..used])
    }

    /// Writes what is buffered.
    ///
    /// # Errors
    /// The disk says no.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
