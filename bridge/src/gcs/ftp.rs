//! FILE_TRANSFER_PROTOCOL: metadata files, flight logs to read, a folder for uploads.
//!
//! | Opcode | Done |
//! | --- | --- |
//! | ListDirectory 3 | `D` folders and `F` files of the tree in `ftp/path.rs`, from the entry `offset` on |
//! | OpenFileRO 4, ReadFile 5, BurstReadFile 15 | any file; a burst goes out at [`BURST_PER_PUMP`] packets each [`PUMP_PERIOD`] |
//! | CreateFile 6, OpenFileWO 11, WriteFile 7, RemoveFile 8 | in `/upload` only |
//! | CalcFileCRC32 14 | any file |
//! | TerminateSession 1, ResetSessions 2, None 0 | acknowledged |
//! | CreateDirectory 9, RemoveDirectory 10 | FileProtected: the tree is fixed |
//! | anything else | UnknownCommand |
//!
//! At most [`MAX_SESSIONS`] files are open, each belongs to the peer that opened it and closes after [`SESSION_TIMEOUT`]
//! of silence. A repeat of the last request (same seq) gets the last answer again. While armed no logs are read: the link is for
//! flying. What is on disk is asked of the shell ([`super::disk`]); a request waits for it at most [`disk::TIMEOUT`].

mod listing;
mod path;
mod payload;
mod session;
#[cfg(test)]
mod tests;

use self::listing::{line, listing, root};
use self::path::Path;
use self::payload::{DATA_LEN, Payload, Refusal, op};
use self::session::{BLOCK_LEN, Session, Source};
use super::disk::{self, Block, DiskJob, DiskReply, Folder, PUMP_PERIOD, Ticket};
use super::metadata::crc32;
use super::{Context, Destination, LinkId, Outbox, Peer};
use arrayvec::ArrayVec;
use core::time::Duration;
use mavlink_dialect::Message;
use mavlink_dialect::standard::{FILE_TRANSFER_PROTOCOL_DATA, MavMessage};
use vehicle::Timestamp;

/// Most open files.
pub const MAX_SESSIONS: usize = 8;
/// A file nobody reads is closed.
pub const SESSION_TIMEOUT: Duration = Duration::from_secs(10);
/// Largest uploaded file, bytes.
pub const MAX_UPLOAD_LEN: u64 = 8 << 20;
/// Most uploaded files.
pub const MAX_UPLOADS: usize = 32;
/// Packets of a burst that go out at once.
pub const BURST_PER_PUMP: usize = 4;
/// Requests that wait for the disk, and peers whose last answer is remembered.
const MAX_WAITING: usize = 16;

/// A request that waits for the disk.
#[derive(Debug)]
struct Waiting {
    /// None until the next pump: a checksum of a long file must not hold up everything else.
    ticket: Option<Ticket>,
    peer: Peer,
    request: Payload,
    since: Timestamp,
    what: Wait,
}

/// What it waits for.
#[derive(Clone, Debug)]
enum Wait {
    /// Entries of a folder, to list them.
    List,
    /// The same, to find a file and open it.
    Open(Folder, String, bool),
    /// The same, to count the files before one is made.
    Room(String),
    /// A file made empty.
    Create(String),
    /// A block of an open file.
    Read,
    /// The same, for the burst of that session.
    Burst(u8),
    /// A file changed; the session and where it ends then.
    Write(u8, u64),
    /// A file removed.
    Remove,
    /// The next block of a checksum: where it begins and what it is so far.
    Crc(Folder, String, u64, u32),
}

/// The FTP service.
#[derive(Debug, Default)]
pub struct FtpService {
    sessions: ArrayVec<Session, MAX_SESSIONS>,
    waiting: ArrayVec<Waiting, MAX_WAITING>,
    /// Last answer to each peer.
    answered: ArrayVec<(Peer, Payload), MAX_WAITING>,
    next_pump: Timestamp,
}

impl FtpService {
    /// No file open.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a message for us; what is no file request is left alone.
    pub fn handle(
        &mut self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let Message::Standard(MavMessage::FILE_TRANSFER_PROTOCOL(m)) = message else {
            return;
        };
        let request = Payload::read(&m.payload);
        if matches!(request.opcode, op::ACK | op::NAK) {
            // An answer is never answered.
            return;
        }
        let is_waiting = |w: &Waiting| w.peer == from && w.request.seq == request.seq;
        if self.waiting.iter().any(is_waiting) {
            return;
        }
        let repeat = self.answered.iter().find(|(peer, a)| {
            *peer == from
                && a.seq == request.seq.wrapping_add(1)
                && a.request == request.opcode
                && !matches!(request.opcode, op::NONE | op::BURST_READ)
        });
        if let Some((_, answer)) = repeat {
            return send(from, answer, out);
        }
        match self.serve(now, from, &request, ctx, out) {
            Ok(Some(data)) => self.ack(from, &request, &data, out),
            Ok(None) => {}
            Err(why) => self.nak(from, &request, why, out),
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
        let Some(at) = self.waiting.iter().position(|w| w.ticket == Some(ticket)) else {
            return false;
        };
        let waiting = self.waiting.remove(at);
        let (peer, request) = (waiting.peer, waiting.request.clone());
        match self.resume(now, waiting, reply, out) {
            Ok(Some(data)) => self.ack(peer, &request, &data, out),
            Ok(None) => {}
            Err(why) => self.nak(peer, &request, why, out),
        }
        true
    }

    /// Sends what is due of bursts, closes what nobody reads, gives up on a silent disk.
    pub fn tick(&mut self, now: Timestamp, out: &mut Outbox) {
        if now < self.next_pump {
            return;
        }
        self.next_pump = now + PUMP_PERIOD;
        while let Some(at) = self
            .waiting
            .iter()
            .position(|w| now.since(w.since) >= disk::TIMEOUT)
        {
            let w = self.waiting.remove(at);
            self.nak(w.peer, &w.request, Refusal::Fail, out);
        }
        for w in self.waiting.iter_mut().filter(|w| w.ticket.is_none()) {
            if let Wait::Crc(folder, name, at, _) = &w.what {
                w.ticket = Some(out.disk(DiskJob::Read {
                    folder: *folder,
                    name: name.clone(),
                    offset: *at,
                    len: 4 * BLOCK_LEN,
                }));
            }
        }
        for at in 0..self.sessions.len() {
            self.pump(now, at, out);
        }
        self.sessions
            .retain(|s| now.since(s.heard_at) < SESSION_TIMEOUT);
    }

    /// When [`FtpService::tick`] has something to do soon; none if nothing is under way.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        let is_busy = !self.sessions.is_empty() || !self.waiting.is_empty();
        is_busy.then_some(self.next_pump)
    }

    /// Forgets a link.
    pub fn link_down(&mut self, link: LinkId) {
        self.sessions.retain(|s| s.peer.link != link);
        self.waiting.retain(|w| w.peer.link != link);
        self.answered.retain(|(peer, _)| peer.link != link);
    }

    /// Does a request: the data of its ACK, nothing if it waits or was answered, or why not.
    fn serve(
        &mut self,
        now: Timestamp,
        from: Peer,
        request: &Payload,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) -> Result<Option<Vec<u8>>, Refusal> {
        let data = request.data().ok_or(Refusal::InvalidDataSize)?;
        let named = || path::parse(data).ok_or(Refusal::NotFound);
        let is_open_to_read = |folder| folder == Folder::Upload || !ctx.snapshot.is_armed;
        let readable = |path: Path| match path {
            Path::Root | Path::Folder(_) => Err(Refusal::NotFound),
            Path::File(folder, _) if !is_open_to_read(folder) => Err(Refusal::Protected),
            path @ (Path::Metadata(_) | Path::File(..)) => Ok(path),
        };
        let upload = || match path::parse(data) {
            Some(Path::File(Folder::Upload, name)) => Ok(name),
            _ => Err(Refusal::Protected),
        };
        match request.opcode {
            op::NONE => Ok(Some(Vec::new())),
            op::TERMINATE_SESSION => {
                let is_it =
                    |s: &Session| s.peer.address == from.address && s.number == request.session;
                self.sessions.retain(|s| !is_it(s));
                Ok(Some(Vec::new()))
            }
            op::RESET_SESSIONS => {
                self.sessions.retain(|s| s.peer.address != from.address);
                self.waiting.retain(|w| w.peer.address != from.address);
                Ok(Some(Vec::new()))
            }
            op::LIST_DIRECTORY => match named()? {
                Path::Root => listing(&root(), request.offset).map(Some),
                Path::Folder(folder) => {
                    self.wait(now, from, request, DiskJob::List(folder), Wait::List, out)
                }
                Path::Metadata(_) | Path::File(..) => Err(Refusal::NotFound),
            },
            op::OPEN_READ => match readable(named()?)? {
                Path::Metadata(file) => {
                    let len = file.bytes.len() as u64;
                    self.open(
                        now,
                        from,
                        request,
                        Source::Memory(&file.bytes),
                        len,
                        false,
                        out,
                    )
                }
                Path::File(folder, name) => {
                    let what = Wait::Open(folder, name, false);
                    self.wait(now, from, request, DiskJob::List(folder), what, out)
                }
                Path::Root | Path::Folder(_) => Err(Refusal::NotFound),
            },
            op::OPEN_WRITE => {
                let what = Wait::Open(Folder::Upload, upload()?, true);
                self.wait(now, from, request, DiskJob::List(Folder::Upload), what, out)
            }
            op::CREATE => {
                let what = Wait::Room(upload()?);
                self.wait(now, from, request, DiskJob::List(Folder::Upload), what, out)
            }
            op::REMOVE => self.wait(
                now,
                from,
                request,
                DiskJob::Remove(upload()?),
                Wait::Remove,
                out,
            ),
            op::CREATE_DIRECTORY => match named() {
                Ok(Path::Root | Path::Folder(_)) => Err(Refusal::Exists),
                _ => Err(Refusal::Protected),
            },
            op::REMOVE_DIRECTORY => Err(Refusal::Protected),
            op::READ => self.read(now, from, request, out),
            op::BURST_READ => {
                let session = self.session(now, from, request.session)?;
                if u64::from(request.offset) >= session.len {
                    return Err(Refusal::EndOfFile);
                }
                session.burst = Some((
                    request.clone(),
                    u64::from(request.offset),
                    request.seq.wrapping_add(1),
                ));
                self.next_pump = now;
                Ok(None)
            }
            op::WRITE => {
                let bytes = data.to_vec();
                let offset = u64::from(request.offset);
                let session = self.session(now, from, request.session)?;
                let Source::Disk(_, name) = &session.source else {
                    return Err(Refusal::Protected);
                };
                // A hole would be filled with nothing anybody sent.
                if !session.is_for_writing || offset > session.len {
                    return Err(Refusal::Protected);
                }
                let end = offset + bytes.len() as u64;
                if end > MAX_UPLOAD_LEN {
                    return Err(Refusal::Fail);
                }
                let (name, number) = (name.clone(), session.number);
                let job = DiskJob::Write {
                    name,
                    offset,
                    bytes,
                };
                self.wait(now, from, request, job, Wait::Write(number, end), out)
            }
            op::CALC_CRC => match readable(named()?)? {
                Path::Metadata(file) => Ok(Some(crc32(0, &file.bytes).to_le_bytes().to_vec())),
                Path::File(folder, name) => self.crc(now, from, request, (folder, name, 0, 0)),
                Path::Root | Path::Folder(_) => Err(Refusal::NotFound),
            },
            _ => Err(Refusal::UnknownCommand),
        }
    }

    /// Goes on with a request whose job is done.
    fn resume(
        &mut self,
        now: Timestamp,
        waiting: Waiting,
        reply: &DiskReply,
        out: &mut Outbox,
    ) -> Result<Option<Vec<u8>>, Refusal> {
        let Waiting {
            peer,
            request,
            what,
            ..
        } = waiting;
        match reply {
            DiskReply::NotFound => match what {
                // No folder yet is an empty one.
                Wait::List => return listing(&[], request.offset).map(Some),
                Wait::Room(name) => {
                    let job = DiskJob::Create(name.clone());
                    return self.wait(now, peer, &request, job, Wait::Create(name), out);
                }
                // Nowhere to keep files.
                Wait::Create(_) => return Err(Refusal::Protected),
                _ => return Err(Refusal::NotFound),
            },
            DiskReply::Failed => return Err(Refusal::Fail),
            DiskReply::Files(_) | DiskReply::Bytes(_) | DiskReply::Done => {}
        }
        match (what, reply) {
            (Wait::List, DiskReply::Files(files)) => {
                let entries: Vec<String> = files.iter().map(line).collect();
                listing(&entries, request.offset).map(Some)
            }
            (Wait::Open(folder, name, is_for_writing), DiskReply::Files(files)) => {
                let file = files.iter().find(|f| f.name == name);
                let len = file.ok_or(Refusal::NotFound)?.len;
                let source = Source::Disk(folder, name);
                self.open(now, peer, &request, source, len, is_for_writing, out)
            }
            (Wait::Room(name), DiskReply::Files(files)) => {
                let is_there = files.iter().any(|f| f.name == name);
                if !is_there && files.len() >= MAX_UPLOADS {
                    return Err(Refusal::Fail);
                }
                let job = DiskJob::Create(name.clone());
                self.wait(now, peer, &request, job, Wait::Create(name), out)
            }
            (Wait::Create(name), DiskReply::Done) => {
                let source = Source::Disk(Folder::Upload, name);
                self.open(now, peer, &request, source, 0, true, out)
            }
            // Shorter than it was: its end is here.
            (Wait::Read, DiskReply::Bytes(bytes)) if bytes.is_empty() => Err(Refusal::EndOfFile),
            (Wait::Read, DiskReply::Bytes(bytes)) => {
                let session = self.session(now, peer, request.session)?;
                session.block = Block::new(u64::from(request.offset), bytes.clone());
                self.read(now, peer, &request, out)
            }
            (Wait::Burst(number), DiskReply::Bytes(bytes)) => {
                let is_it = |s: &&mut Session| s.peer == peer && s.number == number;
                if let Some(session) = self.sessions.iter_mut().find(is_it)
                    && let Some((_, at, _)) = session.burst
                {
                    session.block = Block::new(at, bytes.clone());
                    if bytes.is_empty() {
                        // Shorter than it was: its end is here.
                        session.len = at;
                    }
                }
                Ok(None)
            }
            (Wait::Write(number, end), DiskReply::Done) => {
                let is_it = |s: &&mut Session| s.peer.address == peer.address && s.number == number;
                if let Some(session) = self.sessions.iter_mut().find(is_it) {
                    session.len = session.len.max(end);
                    session.block = Block::default();
                }
                Ok(Some(u32::from(request.size).to_le_bytes().to_vec()))
            }
            (Wait::Remove, DiskReply::Done) => Ok(Some(Vec::new())),
            (Wait::Crc(folder, name, at, crc), DiskReply::Bytes(bytes)) => {
                let crc = crc32(crc, bytes);
                if bytes.is_empty() {
                    return Ok(Some(crc.to_le_bytes().to_vec()));
                }
                let at = at + bytes.len() as u64;
                self.crc(now, peer, &request, (folder, name, at, crc))
            }
            _ => Err(Refusal::Fail),
        }
    }

    /// Lets the next block of a checksum be read at the next pump.
    fn crc(
        &mut self,
        now: Timestamp,
        peer: Peer,
        request: &Payload,
        (folder, name, at, crc): (Folder, String, u64, u32),
    ) -> Result<Option<Vec<u8>>, Refusal> {
        if self.waiting.is_full() {
            return Err(Refusal::Fail);
        }
        self.waiting.push(Waiting {
            ticket: None,
            peer,
            request: request.clone(),
            since: now,
            what: Wait::Crc(folder, name, at, crc),
        });
        Ok(None)
    }

    /// Hands a job to the disk.
    fn wait(
        &mut self,
        now: Timestamp,
        peer: Peer,
        request: &Payload,
        job: DiskJob,
        what: Wait,
        out: &mut Outbox,
    ) -> Result<Option<Vec<u8>>, Refusal> {
        if self.waiting.is_full() {
            return Err(Refusal::Fail);
        }
        self.waiting.push(Waiting {
            ticket: Some(out.disk(job)),
            peer,
            request: request.clone(),
            since: now,
            what,
        });
        Ok(None)
    }

    /// Opens a file: the session's number in the header, its length in the data.
    #[expect(
        clippy::too_many_arguments,
        reason = "one call site per way to open a file"
    )]
    fn open(
        &mut self,
        now: Timestamp,
        peer: Peer,
        request: &Payload,
        source: Source,
        len: u64,
        is_for_writing: bool,
        out: &mut Outbox,
    ) -> Result<Option<Vec<u8>>, Refusal> {
        // MAVProxy names the session itself and knows its answers by that number; others send 0 and take ours.
        let named = request.session;
        self.sessions
            .retain(|s| named == 0 || s.number != named || s.peer.address != peer.address);
        if self.sessions.is_full() {
            return Err(Refusal::NoSessions);
        }
        let is_free = |n: &u8| self.sessions.iter().all(|s| s.number != *n);
        let number = if named != 0 && is_free(&named) {
            named
        } else {
            (0..=u8::MAX).find(is_free).ok_or(Refusal::NoSessions)?
        };
        self.sessions.push(Session {
            number,
            peer,
            source,
            len,
            is_for_writing,
            heard_at: now,
            block: Block::default(),
            burst: None,
        });
        let len = u32::try_from(len).unwrap_or(u32::MAX);
        let mut answer = request.ack(&len.to_le_bytes());
        answer.session = number;
        self.remember(peer, answer.clone());
        send(peer, &answer, out);
        Ok(None)
    }

    /// A session of this peer, which was heard now.
    fn session(&mut self, now: Timestamp, from: Peer, number: u8) -> Result<&mut Session, Refusal> {
        let is_it = |s: &&mut Session| s.peer.address == from.address && s.number == number;
        let session = self
            .sessions
            .iter_mut()
            .find(is_it)
            .ok_or(Refusal::InvalidSession)?;
        session.heard_at = now;
        session.peer = from;
        Ok(session)
    }

    fn read(
        &mut self,
        now: Timestamp,
        from: Peer,
        request: &Payload,
        out: &mut Outbox,
    ) -> Result<Option<Vec<u8>>, Refusal> {
        let session = self.session(now, from, request.session)?;
        session.burst = None;
        let at = u64::from(request.offset);
        if at >= session.len {
            return Err(Refusal::EndOfFile);
        }
        let wanted = match usize::from(request.size) {
            0 => DATA_LEN,
            n => n.min(DATA_LEN),
        };
        if let Some(bytes) = session.bytes(at, wanted) {
            return Ok(Some(bytes.to_vec()));
        }
        match session.job(at) {
            Some(job) => self.wait(now, from, request, job, Wait::Read, out),
            None => Err(Refusal::EndOfFile),
        }
    }

    /// Sends some packets of a session's burst, or asks the disk for them.
    fn pump(&mut self, now: Timestamp, at: usize, out: &mut Outbox) {
        for _ in 0..BURST_PER_PUMP {
            let session = &mut self.sessions[at];
            let Some((request, offset, seq)) = session.burst.clone() else {
                return;
            };
            if offset >= session.len {
                // It became shorter while it was read.
                session.burst = None;
                let mut answer = request.nak(Refusal::EndOfFile);
                answer.seq = seq;
                return send(session.peer, &answer, out);
            }
            let wanted = match usize::from(request.size) {
                0 => DATA_LEN,
                n => n.min(DATA_LEN),
            };
            let Some(bytes) = session.bytes(offset, wanted) else {
                let (peer, number, job) = (session.peer, session.number, session.job(offset));
                let is_asked =
                    |w: &Waiting| w.peer == peer && matches!(w.what, Wait::Burst(n) if n == number);
                if let Some(job) = job
                    && !self.waiting.iter().any(is_asked)
                {
                    // A full disk queue is asked again at the next pump.
                    let _ = self.wait(now, peer, &request, job, Wait::Burst(number), out);
                }
                return;
            };
            let end = offset + bytes.len() as u64;
            let mut answer = request.ack(bytes);
            answer.seq = seq;
            // A burst reaches at most 4 GiB: offsets come from a u32 and files are shorter.
            answer.offset = u32::try_from(offset).unwrap_or(u32::MAX);
            answer.is_burst_complete = end >= session.len;
            session.burst = (end < session.len).then(|| (request, end, seq.wrapping_add(1)));
            session.heard_at = now;
            send(session.peer, &answer, out);
        }
    }

    fn ack(&mut self, peer: Peer, request: &Payload, data: &[u8], out: &mut Outbox) {
        let answer = request.ack(data);
        send(peer, &answer, out);
        self.remember(peer, answer);
    }

    fn nak(&mut self, peer: Peer, request: &Payload, why: Refusal, out: &mut Outbox) {
        let answer = request.nak(why);
        send(peer, &answer, out);
        self.remember(peer, answer);
    }

    fn remember(&mut self, peer: Peer, answer: Payload) {
        self.answered.retain(|(p, _)| *p != peer);
        if self.answered.is_full() {
            self.answered.remove(0);
        }
        self.answered.push((peer, answer));
    }
}

fn send(to: Peer, answer: &Payload, out: &mut Outbox) {
    out.send(
        Destination::Link(to.link),
        MavMessage::FILE_TRANSFER_PROTOCOL(FILE_TRANSFER_PROTOCOL_DATA {
            target_network: 0,
            target_system: to.address.system,
            target_component: to.address.component,
            payload: answer.write(),
        }),
    );
}
