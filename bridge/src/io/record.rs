//! The flight log: every input of `Flight` with its time. Fed back, it is the flight again.
//!
//! Records follow a text line that names the format: microseconds since the last record and the input, each in
//! `postcard` encoding, preceded by its length (u16, little endian).

use crate::autopilot::io::Input;
use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::path::Path;
use vehicle::Timestamp;

/// First line of a flight log.
pub const MAGIC: &[u8] = b"kestrel flight log 1\n";

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

    /// Appends one input.
    ///
    /// # Errors
    /// The disk says no.
    pub fn write(&mut self, now: Timestamp, input: &Input) -> io::Result<()> {
        let since_us = now.since(self.last).as_micros() as u64;
        self.last = now;
        let used = postcard::to_slice(&(since_us, input), &mut self.buffer)
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
