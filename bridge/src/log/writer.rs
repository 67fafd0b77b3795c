//! Records to the bytes of an MCAP file and a `.tlog`. Bytes gather in memory and are taken from there: nothing here can be held up.

use super::header::Header;
use super::reader::Message;
use super::record::{FlightRecord, GroundRecord, LogSink};
use super::schema::{self, Schema};
use super::summary::FlightBook;
use super::tlog::TlogEncoder;
use super::topic;
use crate::autopilot::door::Snapshot;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, WriteOptions, Writer};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use vehicle::{MapAnchor, Pace, Timestamp};

/// Name of the attachment a replay starts from.
pub const HEADER_NAME: &str = "flight.postcard";
/// Topic of the stream a replay reads.
pub const STREAM: &str = "/flight";
/// `/state` a second.
const STATE_HZ: f64 = 20.0;
/// `/pose` and `/tf` a second.
const POSE_HZ: f64 = 10.0;
/// `/scan` a second.
const SCAN_HZ: f64 = 5.0;
/// Bytes of the stream that make one message.
const BATCH: usize = 8_192;

/// An MCAP file in the making.
pub struct Container {
    writer: Writer<NoSeek<Shared>>,
    out: Shared,
    sequence: u32,
    /// The first thing that went wrong; in memory nothing should.
    fault: Option<String>,
}

#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl io::Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Container {
    /// With its head.
    ///
    /// # Errors
    /// The library refuses; in memory it has no reason to.
    pub fn new() -> mcap::McapResult<Self> {
        let out = Shared::default();
        let writer = WriteOptions::new()
            .compression(None)
            .disable_seeking(true)
            .chunk_size(Some(1 << 20))
            .profile("kestrel")
            .library(concat!("kestrel ", env!("CARGO_PKG_VERSION")))
            .create(NoSeek::new(out.clone()))?;
        Ok(Self {
            writer,
            out,
            sequence: 0,
            fault: None,
        })
    }

    /// A topic; none if the library refuses it.
    pub fn channel(
        &mut self,
        topic: &str,
        encoding: &str,
        schema: Option<(&str, &str, &str)>,
    ) -> Option<u16> {
        let made = schema
            .map_or(Ok(0), |(name, kind, text)| {
                self.writer.add_schema(name, kind, text.as_bytes())
            })
            .and_then(|id| {
                self.writer
                    .add_channel(id, topic, encoding, &BTreeMap::new())
            });
        self.keep(made)
    }

    /// One message.
    pub fn message(&mut self, channel: Option<u16>, ns: u64, data: &[u8]) {
        let Some(channel_id) = channel else { return };
        self.sequence = self.sequence.wrapping_add(1);
        let header = MessageHeader {
            channel_id,
            sequence: self.sequence,
            log_time: ns,
            publish_time: ns,
        };
        let done = self.writer.write_to_known_channel(&header, data);
        self.keep(done);
    }

    /// A metadata record.
    pub fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) {
        let done = self.writer.write_metadata(&Metadata {
            name: name.to_owned(),
            metadata,
        });
        self.keep(done);
    }

    /// An attachment.
    pub fn attach(&mut self, ns: u64, name: &str, media_type: &str, data: &[u8]) {
        let done = self.writer.attach(&Attachment {
            log_time: ns,
            create_time: ns,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(data),
        });
        self.keep(done);
    }

    /// Ends the chunk: what was written so far can be read even if nothing more comes.
    pub fn flush(&mut self) {
        let done = self.writer.flush();
        self.keep(done);
    }

    /// Writes the index.
    pub fn finish(&mut self) {
        let done = self.writer.finish().map(drop);
        self.keep(done);
    }

    /// Bytes since the last time.
    pub fn take(&mut self) -> Vec<u8> {
        core::mem::take(&mut *self.out.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// What went wrong, if anything did.
    #[must_use]
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    fn keep<T>(&mut self, done: mcap::McapResult<T>) -> Option<T> {
        done.map_err(|e| self.fault.get_or_insert_with(|| e.to_string()).clone())
            .ok()
    }
}

impl std::fmt::Debug for Container {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Container")
            .field("sequence", &self.sequence)
            .field("fault", &self.fault)
            .finish_non_exhaustive()
    }
}

/// Topics of one file.
#[derive(Clone, Copy, Debug)]
struct Topics {
    stream: Option<u16>,
    state: Option<u16>,
    pose: Option<u16>,
    transform: Option<u16>,
    scan: Option<u16>,
    text: Option<u16>,
    summary: Option<u16>,
    lost: Option<u16>,
}

/// Writes a flight.
#[derive(Debug)]
pub struct LogWriter {
    header: Arc<Header>,
    anchor: MapAnchor,
    part: u32,
    container: Container,
    topics: Topics,
    batch: Vec<u8>,
    batch_at: Timestamp,
    state_pace: Pace,
    pose_pace: Pace,
    scan_pace: Pace,
    book: FlightBook,
    tlog: TlogEncoder,
    tlog_out: Vec<u8>,
    lost: u64,
    now: Timestamp,
}

impl LogWriter {
    /// A log that begins with its header.
    ///
    /// # Errors
    /// The library refuses; in memory it has no reason to.
    pub fn new(header: Arc<Header>) -> mcap::McapResult<Self> {
        let (container, topics) = open(&header, 1)?;
        Ok(Self {
            anchor: header.plan.anchor(),
            now: header.at,
            header,
            part: 1,
            container,
            topics,
            batch: Vec::with_capacity(2 * BATCH),
            batch_at: Timestamp::ZERO,
            state_pace: Pace::hz(STATE_HZ),
            pose_pace: Pace::hz(POSE_HZ),
            scan_pace: Pace::hz(SCAN_HZ),
            book: FlightBook::default(),
            tlog: TlogEncoder::default(),
            tlog_out: Vec::new(),
            lost: 0,
        })
    }

    /// Number of this file, from 1.
    #[must_use]
    pub const fn part(&self) -> u32 {
        self.part
    }

    /// Records that are missing so far.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// Takes a record of the flight thread.
    pub fn flight(&mut self, record: &FlightRecord) {
        match record {
            FlightRecord::Input { at, .. }
            | FlightRecord::Output { at, .. }
            | FlightRecord::Tick { at, .. } => self.now = self.now.max(*at),
            FlightRecord::Lost { records } => self.note_lost(*records),
        }
        if self.batch.is_empty() {
            self.batch_at = self.now;
        }
        // Our types cannot fail to be written; a record that did would show as a gap in the replay.
        if let Ok(bytes) = postcard::to_allocvec(record) {
            self.batch.extend_from_slice(&bytes);
        }
        if self.batch.len() >= BATCH {
            self.end_batch();
        }
    }

    /// Takes a record of the ground side.
    pub fn ground(&mut self, record: &GroundRecord) {
        let utc_us = |at: Timestamp| self.header.boot_utc_us + at.us();
        match record {
            GroundRecord::Snapshot(snapshot) => self.snapshot(snapshot),
            GroundRecord::Text { at, severity, text } => {
                let ns = self.ns(*at);
                self.json(self.topics.text, ns, &topic::text(ns, *severity, text));
            }
            GroundRecord::Received {
                at,
                link,
                bytes,
                is_datagram,
            } => {
                let (at, out) = (utc_us(*at), &mut self.tlog_out);
                self.tlog.received(at, *link, bytes, *is_datagram, out);
            }
            GroundRecord::Sent { at, link, frame } => {
                let at = utc_us(*at);
                self.tlog.sent(at, *link, frame, &mut self.tlog_out);
            }
            GroundRecord::Lost { records } => self.note_lost(*records),
        }
    }

    fn snapshot(&mut self, s: &Snapshot) {
        let ns = self.ns(s.at);
        if self.state_pace.is_due(s.at) {
            self.json(self.topics.state, ns, &topic::state(ns, s));
        }
        if self.pose_pace.is_due(s.at) {
            let anchor = self.anchor;
            self.json(self.topics.pose, ns, &topic::pose(ns, s, &anchor));
            self.json(self.topics.transform, ns, &topic::transform(ns, s, &anchor));
        }
        if self.scan_pace.is_due(s.at)
            && let Some(scan) = topic::scan(ns, s)
        {
            self.json(self.topics.scan, ns, &scan);
        }
        if let Some(flight) = self.book.look(s) {
            self.json(self.topics.summary, ns, &topic::summary(ns, &flight));
        }
    }

    fn note_lost(&mut self, records: u64) {
        self.lost += records;
        let ns = self.ns(self.now);
        let value = json!({ "records": records, "total": self.lost });
        self.json(self.topics.lost, ns, &value);
    }

    /// Ends batch and chunk: what was written so far can be read even if nothing more comes.
    pub fn flush(&mut self) {
        self.end_batch();
        self.container.flush();
    }

    /// Ends this file and begins the next part, which opens with the same header; take the bytes before and after.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn next_part(&mut self) -> mcap::McapResult<Vec<u8>> {
        self.end_batch();
        self.container.finish();
        let last = self.container.take();
        self.part += 1;
        (self.container, self.topics) = open(&self.header, self.part)?;
        Ok(last)
    }

    /// UTC at time zero, ns.
    #[must_use]
    pub fn boot_ns(&self) -> u64 {
        self.ns(Timestamp::ZERO)
    }

    /// Takes over messages of the JSON topics from another log of this flight.
    pub fn copy<'a>(&mut self, messages: impl Iterator<Item = &'a Message>) {
        let t = self.topics;
        for m in messages {
            let channel = match m.topic.as_str() {
                "/state" => t.state,
                "/pose" => t.pose,
                "/tf" => t.transform,
                "/scan" => t.scan,
                "/log" => t.text,
                "/summary" => t.summary,
                "/lost" => t.lost,
                _ => None,
            };
            self.container.message(channel, m.ns, &m.data);
        }
    }

    /// Writes the index; nothing may follow.
    pub fn finish(&mut self) {
        self.end_batch();
        self.container.finish();
    }

    /// Bytes of the `.mcap` since the last time.
    pub fn take_mcap(&mut self) -> Vec<u8> {
        self.container.take()
    }

    /// Bytes of the `.tlog` since the last time.
    pub fn take_tlog(&mut self) -> Vec<u8> {
        core::mem::take(&mut self.tlog_out)
    }

    /// What went wrong, if anything did.
    #[must_use]
    pub fn fault(&self) -> Option<&str> {
        self.container.fault()
    }

    fn end_batch(&mut self) {
        if !self.batch.is_empty() {
            let ns = self.ns(self.batch_at);
            self.container.message(self.topics.stream, ns, &self.batch);
            self.batch.clear();
        }
    }

    fn json(&mut self, channel: Option<u16>, ns: u64, value: &Value) {
        self.container
            .message(channel, ns, value.to_string().as_bytes());
    }

    fn ns(&self, at: Timestamp) -> u64 {
        topic::utc_ns(self.header.boot_utc_us, at)
    }
}

/// A file with its head.
fn open(header: &Header, part: u32) -> mcap::McapResult<(Container, Topics)> {
    let mut c = Container::new()?;
    let ns = topic::utc_ns(header.boot_utc_us, header.at);
    let mut facts = header.facts();
    facts.insert("part".to_owned(), part.to_string());
    c.metadata("kestrel", facts);
    c.metadata("parameters", header.parameter_texts());
    c.attach(
        ns,
        HEADER_NAME,
        "application/octet-stream",
        &header.to_bytes(),
    );
    let mut json = |topic: &str, (name, text): Schema| {
        c.channel(topic, "json", Some((name, "jsonschema", &text)))
    };
    let map = json("/map", schema::grid());
    let topics = Topics {
        state: json("/state", schema::own("kestrel.State")),
        pose: json("/pose", schema::pose_in_frame()),
        transform: json("/tf", schema::frame_transform()),
        scan: json("/scan", schema::point_cloud()),
        text: json("/log", schema::log()),
        summary: json("/summary", schema::own("kestrel.Summary")),
        lost: json("/lost", schema::own("kestrel.Lost")),
        stream: c.channel(STREAM, "postcard", None),
    };
    c.message(
        map,
        ns,
        topic::grid(ns, &header.plan).to_string().as_bytes(),
    );
    c.flush();
    Ok((c, topics))
}

/// A log in memory, for tests and campaigns.
#[derive(Clone, Debug)]
pub struct MemoryLog(Arc<Mutex<LogWriter>>);

impl MemoryLog {
    /// Empty but for its header.
    ///
    /// # Errors
    /// As [`LogWriter::new`].
    pub fn new(header: Header) -> mcap::McapResult<Self> {
        let writer = LogWriter::new(Arc::new(header))?;
        Ok(Self(Arc::new(Mutex::new(writer))))
    }

    /// What was recorded so far can be read even if the end is missing.
    pub fn flush(&self) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .flush();
    }

    /// Ends it and gives the bytes of the `.mcap` and the `.tlog`.
    #[must_use]
    pub fn finish(&self) -> (Vec<u8>, Vec<u8>) {
        let mut writer = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        writer.finish();
        (writer.take_mcap(), writer.take_tlog())
    }
}

impl LogSink for MemoryLog {
    fn flight(&mut self, record: FlightRecord) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .flight(&record);
    }

    fn ground(&mut self, record: GroundRecord) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .ground(&record);
    }
}

#[cfg(test)]
mod tests {
    use super::super::header::tests::office;
    use super::super::reader::LogFile;
    use super::*;
    use crate::autopilot::io::Input;

    fn writer() -> LogWriter {
        LogWriter::new(Arc::new(Header::new(
            Timestamp::ZERO,
            &office(),
            "sim office",
            1_000_000,
        )))
        .unwrap()
    }

    fn input(ms: u64) -> FlightRecord {
        FlightRecord::Input {
            at: Timestamp::from_ms(ms),
            input: Input::Wake,
        }
    }

    #[test]
    fn what_was_flushed_can_be_read_though_the_end_is_missing() {
        let mut w = writer();
        let mut bytes = Vec::new();
        for ms in 0..100 {
            w.flight(&input(ms));
        }
        w.flush();
        bytes.extend(w.take_mcap());
        let safe = bytes.len();
        for ms in 100..200 {
            w.flight(&input(ms));
        }
        w.flush();
        bytes.extend(w.take_mcap());
        for cut in [safe, safe + 1, safe + 40] {
            let log = LogFile::read(&bytes[..cut]).unwrap();
            assert!(log.is_torn);
            assert_eq!(log.stream().unwrap().len(), 100, "cut at {cut}");
        }
        let log = LogFile::read(&bytes).unwrap();
        assert_eq!(log.stream().unwrap().len(), 200);
        w.finish();
        bytes.extend(w.take_mcap());
        let log = LogFile::read(&bytes).unwrap();
        assert!(!log.is_torn && w.fault().is_none());
        assert_eq!(log.header.as_ref().unwrap().seed, 7);
        assert_eq!(log.metadata["kestrel"]["source"], "sim office");
    }

    #[test]
    fn power_cuts_at_200_instants_leave_a_log_that_is_read_to_the_last_sync() {
        let mut w = writer();
        let mut bytes = w.take_mcap();
        // After each of these lengths the disk had everything; half a second of flight in each step.
        let mut synced = vec![(bytes.len(), 0)];
        for step in 1..=20u64 {
            for i in 0..300 {
                w.flight(&input(500 * (step - 1) + i));
            }
            w.flush();
            bytes.extend(w.take_mcap());
            synced.push((bytes.len(), 300 * step as usize));
        }
        let first = synced[0].0;
        for cut in 0..200 {
            let at = first + (bytes.len() - first) * cut / 199;
            let safe = synced.iter().rev().find(|(len, _)| *len <= at).unwrap().1;
            let log = LogFile::read(&bytes[..at]).unwrap();
            let read = log.stream().unwrap().len();
            assert!(read >= safe, "cut at {at}: {read} of {safe} records");
        }
    }

    #[test]
    fn each_part_opens_with_the_header_and_the_stream_goes_on() {
        let mut w = writer();
        w.flight(&input(1));
        let mut first = w.take_mcap();
        first.extend(w.next_part().unwrap());
        w.flight(&input(2));
        w.finish();
        let second = w.take_mcap();
        for (bytes, part) in [(&first, "1"), (&second, "2")] {
            let log = LogFile::read(bytes).unwrap();
            assert!(!log.is_torn);
            assert_eq!(log.metadata["kestrel"]["part"], part);
            assert_eq!(log.stream().unwrap().len(), 1);
        }
    }

    #[test]
    fn what_is_lost_is_counted_in_the_log() {
        let mut w = writer();
        w.flight(&FlightRecord::Lost { records: 5 });
        w.ground(&GroundRecord::Lost { records: 2 });
        w.finish();
        let log = LogFile::read(&w.take_mcap()).unwrap();
        assert_eq!(w.lost(), 7);
        let told: Vec<&str> = log
            .messages("/lost")
            .map(|m| core::str::from_utf8(&m.data).unwrap())
            .collect();
        assert_eq!(told[1], r#"{"records":2,"total":7}"#);
    }
}
