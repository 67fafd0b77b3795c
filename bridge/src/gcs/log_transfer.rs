//! Flight logs over LOG_REQUEST_*: list, download, erase.
//!
//! | Message | Answer |
//! | --- | --- |
//! | LOG_REQUEST_LIST 117 | LOG_ENTRY 118 for each log from `start` to `end`; one with `num_logs` 0 if there is none |
//! | LOG_REQUEST_DATA 119 | LOG_DATA 120, 90 bytes each, [`PER_PUMP`] each [`PUMP_PERIOD`] (108 kB/s); one with `count` 0 at the end of the log and where there is none |
//! | LOG_REQUEST_END 122 | nothing more is sent |
//! | LOG_ERASE 121 | all logs but the one being written are removed, and a text says so |
//!
//! One download runs at a time; another station is told that it must wait. While armed nothing is listed, sent or erased: the
//! link is for flying. Ids are places in the list, oldest log 0, as it was when the station last asked for it.

use super::disk::{self, Block, DiskJob, DiskReply, FileEntry, Folder, PUMP_PERIOD, Ticket};
use super::{Context, Destination, LinkId, Outbox, Peer};
use crate::autopilot::door::Severity;
use mavlink_dialect::Message;
use mavlink_dialect::standard::{LOG_DATA_DATA, LOG_ENTRY_DATA, MavMessage};
use vehicle::Timestamp;

/// Bytes of one LOG_DATA.
const DATA_LEN: usize = 90;
/// LOG_DATA that go out at once.
pub const PER_PUMP: usize = 6;
/// Bytes read from the disk at once.
const BLOCK_LEN: u32 = (DATA_LEN * 128) as u32;
/// Most logs that are listed; the newest.
const MAX_LISTED: usize = 256;

/// A download under way.
#[derive(Debug)]
struct Download {
    peer: Peer,
    id: u16,
    name: String,
    /// Next byte and the one after the last.
    at: u64,
    end: u64,
    /// What of it came from the disk last.
    block: Block,
    asked: Option<(Ticket, Timestamp)>,
}

/// A list or an erasure under way.
#[derive(Debug)]
struct Task {
    ticket: Ticket,
    peer: Peer,
    since: Timestamp,
    /// First and last id asked for; none for an erasure.
    range: Option<(u16, u16)>,
}

/// The log service.
#[derive(Debug, Default)]
pub struct LogService {
    /// As they were listed last.
    logs: Vec<FileEntry>,
    task: Option<Task>,
    download: Option<Download>,
    next_pump: Timestamp,
}

impl LogService {
    /// Nothing listed yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a message for us; what is no log request is left alone.
    pub fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let Message::Standard(message) = message else {
            return;
        };
        let is_armed = ctx.snapshot.is_armed;
        match message {
            MavMessage::LOG_REQUEST_LIST(_) if is_armed => {
                out.text(Severity::Warning, "Logs are listed when disarmed");
                send(from, MavMessage::LOG_ENTRY(LOG_ENTRY_DATA::default()), out);
            }
            // A repeat while the disk is busy is answered with the first.
            MavMessage::LOG_REQUEST_LIST(m)
                if self.task.as_ref().is_none_or(|t| t.peer != from) =>
            {
                let ticket = out.disk(DiskJob::List(Folder::Logs));
                self.task = Some(Task {
                    ticket,
                    peer: from,
                    since: now,
                    range: Some((m.start, m.end)),
                });
            }
            MavMessage::LOG_REQUEST_DATA(m) => {
                self.request(now, from, (m.id, m.ofs, m.count), is_armed, out)
            }
            MavMessage::LOG_REQUEST_END(_) => {
                let is_it = |d: &Download| d.peer.address == from.address;
                self.download = self.download.take().filter(|d| !is_it(d));
            }
            MavMessage::LOG_ERASE(_) if is_armed => {
                out.text(Severity::Warning, "Logs not erased: disarm first")
            }
            MavMessage::LOG_ERASE(_) if self.download.is_some() => out.text(
                Severity::Warning,
                "Logs not erased: one is being downloaded",
            ),
            MavMessage::LOG_ERASE(_) => {
                let ticket = out.disk(DiskJob::EraseLogs);
                self.task = Some(Task {
                    ticket,
                    peer: from,
                    since: now,
                    range: None,
                });
            }
            _ => {}
        }
    }

    /// Takes what the disk said; true if it was ours.
    pub fn disk(
        &mut self,
        now: Timestamp,
        ticket: Ticket,
        reply: &DiskReply,
        out: &mut Outbox,
    ) -> bool {
        if let Some(task) = self.task.take_if(|t| t.ticket == ticket) {
            match task.range {
                Some(range) => self.list(task.peer, range, reply, out),
                None if *reply == DiskReply::Failed => {
                    out.text(Severity::Error, "Logs not erased: the disk says no")
                }
                None => {
                    self.logs.clear();
                    out.text(Severity::Notice, "Logs erased");
                }
            }
            return true;
        }
        let is_it = |d: &&mut Download| d.asked.is_some_and(|(t, _)| t == ticket);
        let Some(download) = self.download.as_mut().filter(|d| is_it(d)) else {
            return false;
        };
        download.asked = None;
        match reply {
            DiskReply::Bytes(bytes) => {
                download.block = Block::new(download.at, bytes.clone());
                if bytes.len() < BLOCK_LEN as usize {
                    // The end of the file, perhaps before where it was listed.
                    download.end = download.end.min(download.at + bytes.len() as u64);
                }
            }
            _ => download.end = download.at,
        }
        self.next_pump = self.next_pump.min(now);
        true
    }

    /// Sends what is due of a download.
    pub fn tick(&mut self, now: Timestamp, ctx: &Context<'_>, out: &mut Outbox) {
        if now < self.next_pump {
            return;
        }
        self.next_pump = now + PUMP_PERIOD;
        if let Some(task) = self.task.take_if(|t| now.since(t.since) >= disk::TIMEOUT) {
            out.text(Severity::Error, "Logs: the disk does not answer");
            if task.range.is_some() {
                send(
                    task.peer,
                    MavMessage::LOG_ENTRY(LOG_ENTRY_DATA::default()),
                    out,
                );
            }
        }
        let Some(d) = &mut self.download else { return };
        if ctx.snapshot.is_armed {
            out.text(Severity::Notice, "Log download stopped: armed");
            self.download = None;
            return;
        }
        if let Some((_, since)) = d.asked {
            if now.since(since) >= disk::TIMEOUT {
                out.text(Severity::Error, "Logs: the disk does not answer");
                self.download = None;
            }
            return;
        }
        for _ in 0..PER_PUMP {
            if d.at >= d.end {
                // The receiver knows the end by a short message: an empty one where the last was full.
                if d.end == 0 || d.block.is_empty() || d.at % DATA_LEN as u64 == 0 {
                    send_data(d.peer, d.id, d.at, &[], out);
                }
                self.download = None;
                return;
            }
            let left = usize::try_from(d.end - d.at).unwrap_or(usize::MAX);
            let piece = d.block.get(d.at, left.min(DATA_LEN)).unwrap_or_default();
            let len = piece.len();
            // Whole messages only, as long as there is more of the log than of the block.
            if len == 0 || (len < DATA_LEN && len < left) {
                let ticket = out.disk(DiskJob::Read {
                    folder: Folder::Logs,
                    name: d.name.clone(),
                    offset: d.at,
                    len: BLOCK_LEN,
                });
                d.asked = Some((ticket, now));
                return;
            }
            send_data(d.peer, d.id, d.at, piece, out);
            d.at += len as u64;
        }
    }

    /// When [`LogService::tick`] has something to do soon; none if nothing is under way.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        (self.download.is_some() || self.task.is_some()).then_some(self.next_pump)
    }

    /// Forgets a link.
    pub fn link_down(&mut self, link: LinkId) {
        self.download = self.download.take().filter(|d| d.peer.link != link);
        self.task = self.task.take().filter(|t| t.peer.link != link);
    }

    fn list(&mut self, to: Peer, (start, end): (u16, u16), reply: &DiskReply, out: &mut Outbox) {
        self.logs = match reply {
            DiskReply::Files(files) => {
                let skip = files.len().saturating_sub(MAX_LISTED);
                files[skip..].to_vec()
            }
            DiskReply::Failed => {
                out.text(Severity::Error, "Logs: the disk says no");
                Vec::new()
            }
            _ => Vec::new(),
        };
        // At most MAX_LISTED.
        let num_logs = self.logs.len() as u16;
        if num_logs == 0 {
            return send(to, MavMessage::LOG_ENTRY(LOG_ENTRY_DATA::default()), out);
        }
        for (id, log) in (0u16..).zip(&self.logs) {
            if (start..=end).contains(&id) {
                let entry = LOG_ENTRY_DATA {
                    time_utc: log.utc_s,
                    size: u32::try_from(log.len).unwrap_or(u32::MAX),
                    id,
                    num_logs,
                    last_log_num: num_logs - 1,
                };
                send(to, MavMessage::LOG_ENTRY(entry), out);
            }
        }
    }

    fn request(
        &mut self,
        now: Timestamp,
        from: Peer,
        (id, offset, count): (u16, u32, u32),
        is_armed: bool,
        out: &mut Outbox,
    ) {
        let is_taken = self
            .download
            .as_ref()
            .is_some_and(|d| d.peer.address != from.address);
        let offset = u64::from(offset);
        let refusal = if is_armed {
            Some("Logs are sent when disarmed")
        } else if is_taken {
            Some("Another station is downloading a log")
        } else {
            None
        };
        if let Some(why) = refusal {
            out.text(Severity::Warning, why);
        }
        let Some(log) = self.logs.get(usize::from(id)).filter(|_| refusal.is_none()) else {
            return send_data(from, id, offset, &[], out);
        };
        let end = log.len.min(offset.saturating_add(u64::from(count)));
        let block = match self.download.take() {
            // Pieces asked for again are usually in the block that was just sent.
            Some(d) if d.id == id => d.block,
            _ => Block::default(),
        };
        self.download = Some(Download {
            peer: from,
            id,
            name: log.name.clone(),
            at: offset,
            end,
            block,
            asked: None,
        });
        self.next_pump = now;
    }
}

fn send(to: Peer, message: MavMessage, out: &mut Outbox) {
    out.send(Destination::Link(to.link), message);
}

fn send_data(to: Peer, id: u16, at: u64, bytes: &[u8], out: &mut Outbox) {
    let mut data = [0u8; DATA_LEN];
    data[..bytes.len()].copy_from_slice(bytes);
    let message = LOG_DATA_DATA {
        ofs: u32::try_from(at).unwrap_or(u32::MAX),
        id,
        // At most 90.
        count: bytes.len() as u8,
        data,
    };
    send(to, MavMessage::LOG_DATA(message), out);
}

#[cfg(test)]
mod tests {
    use super::super::bench::{Bench, station};
    use super::*;
    use core::time::Duration;
    use mavlink_dialect::standard::{
        LOG_ERASE_DATA, LOG_REQUEST_DATA_DATA, LOG_REQUEST_END_DATA, LOG_REQUEST_LIST_DATA,
    };

    /// A service on a disk that holds these logs.
    struct Rig {
        bench: Bench,
        service: LogService,
        out: Outbox,
        now: Timestamp,
        disk: Vec<(&'static str, Vec<u8>)>,
        got: Vec<LOG_DATA_DATA>,
        entries: Vec<LOG_ENTRY_DATA>,
    }

    impl Rig {
        fn new() -> Self {
            let log = |len: usize| (0..len).map(|i| (i * 7 + i / 251) as u8).collect();
            Self {
                bench: Bench::default(),
                service: LogService::new(),
                out: Outbox::default(),
                now: Timestamp::ZERO,
                disk: vec![
                    ("0001.mcap", log(25_000)),
                    ("0002.mcap", log(180)),
                    ("0003.mcap", log(0)),
                ],
                got: Vec::new(),
                entries: Vec::new(),
            }
        }

        fn say(&mut self, system: u8, message: MavMessage) {
            let ctx = self.bench.ctx();
            self.service.handle(
                self.now,
                station(system),
                &message.into(),
                &ctx,
                &mut self.out,
            );
            self.settle();
        }

        fn list(&mut self) {
            self.say(
                255,
                MavMessage::LOG_REQUEST_LIST(LOG_REQUEST_LIST_DATA {
                    end: 0xFFFF,
                    ..Default::default()
                }),
            );
        }

        fn ask(&mut self, system: u8, id: u16, ofs: u32, count: u32) {
            let m = LOG_REQUEST_DATA_DATA {
                id,
                ofs,
                count,
                ..Default::default()
            };
            self.say(system, MavMessage::LOG_REQUEST_DATA(m));
        }

        fn run(&mut self, ms: u64) {
            for _ in 0..ms {
                self.now += Duration::from_millis(1);
                self.service
                    .tick(self.now, &self.bench.ctx(), &mut self.out);
                self.settle();
            }
        }

        fn settle(&mut self) {
            while let Some((ticket, job)) = self.out.jobs.pop_front() {
                let reply = match job {
                    DiskJob::List(_) => DiskReply::Files(
                        self.disk
                            .iter()
                            .map(|(name, bytes)| FileEntry {
                                name: (*name).to_owned(),
                                len: bytes.len() as u64,
                                utc_s: 7,
                            })
                            .collect(),
                    ),
                    DiskJob::Read {
                        name, offset, len, ..
                    } => {
                        let bytes = &self.disk.iter().find(|(n, _)| *n == name).unwrap().1;
                        let from = (offset as usize).min(bytes.len());
                        let to = (from + len as usize).min(bytes.len());
                        DiskReply::Bytes(bytes[from..to].to_vec())
                    }
                    DiskJob::EraseLogs => {
                        self.disk.clear();
                        DiskReply::Done
                    }
                    other => panic!("{other:?}"),
                };
                assert!(self.service.disk(self.now, ticket, &reply, &mut self.out));
            }
            for message in self.out.sent() {
                match message {
                    Message::Standard(MavMessage::LOG_DATA(d)) => self.got.push(d),
                    Message::Standard(MavMessage::LOG_ENTRY(e)) => self.entries.push(e),
                    other => panic!("{other:?}"),
                }
            }
        }

        fn bytes(&self) -> Vec<u8> {
            let piece = |d: &LOG_DATA_DATA| d.data[..usize::from(d.count)].to_vec();
            self.got.iter().flat_map(piece).collect()
        }
    }

    #[test]
    fn the_list_tells_every_log_and_none_as_none() {
        let mut rig = Rig::new();
        rig.list();
        let told: Vec<_> = rig
            .entries
            .iter()
            .map(|e| (e.id, e.size, e.num_logs, e.last_log_num, e.time_utc))
            .collect();
        assert_eq!(
            told,
            [(0, 25_000, 3, 2, 7), (1, 180, 3, 2, 7), (2, 0, 3, 2, 7)]
        );
        rig.disk.clear();
        rig.entries.clear();
        rig.list();
        assert_eq!(rig.entries, [LOG_ENTRY_DATA::default()]);
    }

    #[test]
    fn a_log_arrives_bit_for_bit_at_its_rate_and_ends_with_a_short_message() {
        let mut rig = Rig::new();
        rig.list();
        rig.ask(255, 0, 0, u32::MAX);
        rig.run(100);
        let sent = rig.bytes().len();
        assert!((9_000..=12_000).contains(&sent), "{sent} bytes in 0.1 s");
        rig.run(300);
        assert_eq!(rig.bytes(), rig.disk[0].1);
        assert!(rig.got.last().unwrap().count < 90);
        assert_eq!(rig.service.deadline(), None);
        // A piece in the middle, asked for again.
        rig.got.clear();
        rig.ask(255, 0, 900, 180);
        rig.run(20);
        assert_eq!(rig.bytes(), rig.disk[0].1[900..1_080]);
    }

    #[test]
    fn a_log_of_whole_messages_an_empty_one_and_one_that_is_not_there_end_with_nothing() {
        for (id, len) in [(1, 180), (2, 0), (9, 0)] {
            let mut rig = Rig::new();
            rig.list();
            rig.ask(255, id, 0, u32::MAX);
            rig.run(50);
            assert_eq!(rig.bytes().len(), len, "log {id}");
            assert_eq!(rig.got.last().map(|d| d.count), Some(0), "log {id}");
        }
    }

    #[test]
    fn end_arming_and_another_station_are_minded() {
        let mut rig = Rig::new();
        rig.list();
        rig.ask(255, 0, 0, u32::MAX);
        rig.run(20);
        rig.ask(254, 1, 0, u32::MAX);
        assert!(rig.out.said()[0].1.contains("Another station"));
        let end = MavMessage::LOG_REQUEST_END(LOG_REQUEST_END_DATA::default());
        rig.say(255, end);
        rig.got.clear();
        rig.run(50);
        assert!(rig.got.is_empty(), "sent after the end");
        rig.ask(255, 0, 0, u32::MAX);
        rig.run(10);
        rig.bench.snapshot.is_armed = true;
        rig.run(5);
        rig.got.clear();
        rig.run(50);
        assert!(rig.got.is_empty(), "sent while armed");
        rig.say(255, MavMessage::LOG_ERASE(LOG_ERASE_DATA::default()));
        assert_eq!(rig.disk.len(), 3, "erased while armed");
        rig.bench.snapshot.is_armed = false;
        rig.say(255, MavMessage::LOG_ERASE(LOG_ERASE_DATA::default()));
        assert!(rig.disk.is_empty());
        assert_eq!(rig.out.said().last().unwrap().1, "Logs erased");
    }

    #[test]
    fn a_disk_that_is_silent_is_given_up() {
        let mut rig = Rig::new();
        let list = MavMessage::LOG_REQUEST_LIST(LOG_REQUEST_LIST_DATA::default());
        let ctx = rig.bench.ctx();
        rig.service
            .handle(rig.now, station(255), &list.into(), &ctx, &mut rig.out);
        rig.out.jobs.clear();
        rig.run(2_100);
        assert_eq!(rig.entries.len(), 1);
        assert_eq!(rig.service.deadline(), None);
    }
}
