//! Reading a log, whole or torn.

use super::header::{Header, HeaderError};
use super::record::FlightRecord;
use super::writer::{HEADER_NAME, STREAM};
use mcap::read::{ChunkReader, LinearReader, Options};
use mcap::records::Record;
use std::collections::BTreeMap;

/// One message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// UTC, ns.
    pub ns: u64,
    /// On which topic.
    pub topic: String,
    /// As written.
    pub data: Vec<u8>,
}

/// A log in memory.
#[derive(Clone, Debug)]
pub struct LogFile {
    /// What the flight was made from.
    pub header: Result<Header, HeaderError>,
    /// Metadata records by name.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Messages in the order they were written.
    pub messages: Vec<Message>,
    /// The end is missing: power was cut, or it is being written.
    pub is_torn: bool,
}

/// Why a file is no log.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ReadError(String);

impl LogFile {
    /// Reads what can be read: up to the first chunk that is not complete.
    ///
    /// # Errors
    /// It does not begin like an MCAP file.
    pub fn read(bytes: &[u8]) -> Result<Self, ReadError> {
        let mut log = Self {
            header: Err(HeaderError::Unreadable("no header".to_owned())),
            metadata: BTreeMap::new(),
            messages: Vec::new(),
            is_torn: true,
        };
        let mut topics = BTreeMap::new();
        let reader = LinearReader::new_with_options(bytes, Options::IgnoreEndMagic.into())
            .map_err(|e| ReadError(e.to_string()))?;
        let mut seen = false;
        for record in reader {
            let Ok(record) = record else { break };
            seen = true;
            match record {
                Record::Chunk { header, data } => {
                    let Ok(inside) = ChunkReader::new(header, &data) else {
                        return Ok(log);
                    };
                    for record in inside {
                        let Ok(record) = record else { return Ok(log) };
                        log.take(&mut topics, record);
                    }
                }
                Record::Footer(_) => log.is_torn = false,
                other => log.take(&mut topics, other),
            }
        }
        if !seen {
            return Err(ReadError(
                "this is no flight log (an MCAP file is wanted)".to_owned(),
            ));
        }
        Ok(log)
    }

    fn take(&mut self, topics: &mut BTreeMap<u16, String>, record: Record<'_>) {
        match record {
            Record::Channel(channel) => {
                topics.insert(channel.id, channel.topic);
            }
            Record::Message { header, data } => {
                if let Some(topic) = topics.get(&header.channel_id) {
                    self.messages.push(Message {
                        ns: header.log_time,
                        topic: topic.clone(),
                        data: data.into_owned(),
                    });
                }
            }
            Record::Metadata(m) => {
                self.metadata.insert(m.name, m.metadata);
            }
            Record::Attachment { header, data, .. } if header.name == HEADER_NAME => {
                self.header = Header::from_bytes(&data);
            }
            _ => {}
        }
    }

    /// Messages of a topic.
    pub fn messages(&self, topic: &str) -> impl Iterator<Item = &Message> {
        self.messages.iter().filter(move |m| m.topic == topic)
    }

    /// Messages of a JSON topic; what is no JSON is left out.
    pub fn values(&self, topic: &str) -> impl Iterator<Item = (u64, serde_json::Value)> {
        self.messages(topic)
            .filter_map(|m| Some((m.ns, serde_json::from_slice(&m.data).ok()?)))
    }

    /// The stream of the flight thread.
    ///
    /// # Errors
    /// A message is broken.
    pub fn stream(&self) -> Result<Vec<FlightRecord>, ReadError> {
        let mut records = Vec::new();
        for message in self.messages(STREAM) {
            let mut rest = message.data.as_slice();
            while !rest.is_empty() {
                let (record, after) = postcard::take_from_bytes(rest)
                    .map_err(|e| ReadError(format!("a record of the flight is broken: {e}")))?;
                records.push(record);
                rest = after;
            }
        }
        Ok(records)
    }

    /// Records that are missing.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.values("/lost")
            .filter_map(|(_, v)| v["records"].as_u64())
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_no_log_is_refused_in_words() {
        for bytes in [&b""[..], b"kestrel flight log 2\n", &[0; 64]] {
            let e = LogFile::read(bytes).unwrap_err();
            assert!(!e.to_string().is_empty());
        }
    }

    proptest! {
        #[test]
        fn a_damaged_log_never_panics(
            at in 0usize..4096,
            with in any::<u8>(),
            cut in 0usize..4096,
        ) {
            use super::super::header::tests::office;
            use super::super::LogWriter;
            use crate::autopilot::io::Input;
            use vehicle::Timestamp;
            let mut header = Header::new(Timestamp::ZERO, &office(), "sim", 0);
            // Small, so that the damage falls everywhere.
            header.plan = vehicle::FloorPlan::from_cells(2, 0.5, [0.0, 0.0], vec![vehicle::floor_plan::Cell::Free; 4]).unwrap();
            header.parameters.truncate(2);
            let mut w = LogWriter::new(std::sync::Arc::new(header)).unwrap();
            for ms in 0..20 {
                w.flight(&FlightRecord::Input { at: Timestamp::from_ms(ms), input: Input::Wake });
            }
            w.finish();
            let mut bytes = w.take_mcap();
            let n = bytes.len();
            bytes[at % n] = with;
            bytes.truncate(n - cut % n);
            if let Ok(log) = LogFile::read(&bytes) {
                let _ = log.stream();
                let _ = log.lost();
            }
        }
    }
}
