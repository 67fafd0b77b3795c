use super::super::bench::{Bench, station};
use super::super::disk::FileEntry;
use super::super::disk::is_plain_name;
use super::super::metadata::FILES;
use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

/// A service, a disk in memory, and what came out.
struct Rig {
    bench: Bench,
    service: FtpService,
    out: Outbox,
    now: Timestamp,
    disk: BTreeMap<(u8, String), Vec<u8>>,
    got: Vec<Payload>,
    seq: u16,
}

impl Rig {
    fn new() -> Self {
        let mut rig = Self {
            bench: Bench::default(),
            service: FtpService::new(),
            out: Outbox::default(),
            now: Timestamp::ZERO,
            disk: BTreeMap::new(),
            got: Vec::new(),
            seq: 0,
        };
        let log = (0..40_000usize).map(|i| (i / 3) as u8).collect();
        rig.disk.insert((0, "0001.mcap".to_owned()), log);
        rig
    }

    fn request(&mut self, opcode: u8, session: u8, offset: u32, data: &[u8]) -> Payload {
        let mut bytes = [0u8; 251];
        bytes[..2].copy_from_slice(&self.seq.to_le_bytes());
        self.seq = self.seq.wrapping_add(1);
        bytes[2] = session;
        bytes[3] = opcode;
        bytes[4] = data.len() as u8;
        bytes[8..12].copy_from_slice(&offset.to_le_bytes());
        let len = data.len().min(DATA_LEN);
        bytes[12..12 + len].copy_from_slice(&data[..len]);
        Payload::read(&bytes)
    }

    fn send(&mut self, system: u8, request: &Payload) {
        let message = MavMessage::FILE_TRANSFER_PROTOCOL(FILE_TRANSFER_PROTOCOL_DATA {
            target_network: 0,
            target_system: 1,
            target_component: 1,
            payload: request.write(),
        });
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

    /// A request of the usual station and its answer.
    fn ask(&mut self, opcode: u8, session: u8, offset: u32, data: &[u8]) -> Payload {
        let request = self.request(opcode, session, offset, data);
        self.got.clear();
        self.send(255, &request);
        self.run(30);
        let answer = self.got.first().cloned().expect("an answer");
        assert_eq!(answer.seq, request.seq.wrapping_add(1));
        assert_eq!(answer.request, opcode);
        answer
    }

    fn refusal(&mut self, opcode: u8, session: u8, offset: u32, data: &[u8]) -> u8 {
        let answer = self.ask(opcode, session, offset, data);
        assert_eq!(answer.opcode, op::NAK, "opcode {opcode} {data:?}");
        answer.data().unwrap()[0]
    }

    fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now += Duration::from_millis(1);
            self.service.tick(self.now, &mut self.out);
            self.settle();
        }
    }

    fn settle(&mut self) {
        while let Some((ticket, job)) = self.out.jobs.pop_front() {
            let reply = self.carry_out(job);
            self.service.disk(self.now, ticket, &reply, &mut self.out);
        }
        for message in self.out.sent() {
            let Message::Standard(MavMessage::FILE_TRANSFER_PROTOCOL(m)) = message else {
                panic!("{message:?}")
            };
            self.got.push(Payload::read(&m.payload));
        }
    }

    fn carry_out(&mut self, job: DiskJob) -> DiskReply {
        let key = |folder: Folder, name: String| {
            assert!(is_plain_name(&name), "{name:?} reached the disk");
            (u8::from(folder == Folder::Upload), name)
        };
        match job {
            // As on a disk where nothing was uploaded yet.
            DiskJob::List(Folder::Upload) if self.disk.keys().all(|(f, _)| *f == 0) => {
                DiskReply::NotFound
            }
            DiskJob::List(folder) => DiskReply::Files(
                self.disk
                    .iter()
                    .filter(|((f, _), _)| *f == u8::from(folder == Folder::Upload))
                    .map(|((_, name), bytes)| FileEntry {
                        name: name.clone(),
                        len: bytes.len() as u64,
                        utc_s: 0,
                    })
                    .collect(),
            ),
            DiskJob::Read {
                folder,
                name,
                offset,
                len,
            } => match self.disk.get(&key(folder, name)) {
                None => DiskReply::NotFound,
                Some(bytes) => {
                    let from = (offset as usize).min(bytes.len());
                    let to = (from + len as usize).min(bytes.len());
                    DiskReply::Bytes(bytes[from..to].to_vec())
                }
            },
            DiskJob::Create(name) => {
                self.disk.insert(key(Folder::Upload, name), Vec::new());
                DiskReply::Done
            }
            DiskJob::Write {
                name,
                offset,
                bytes,
            } => {
                let file = self.disk.get_mut(&key(Folder::Upload, name)).unwrap();
                let end = offset as usize + bytes.len();
                file.resize(file.len().max(end), 0);
                file[offset as usize..end].copy_from_slice(&bytes);
                DiskReply::Done
            }
            DiskJob::Remove(name) => match self.disk.remove(&key(Folder::Upload, name)) {
                Some(_) => DiskReply::Done,
                None => DiskReply::NotFound,
            },
            DiskJob::EraseLogs => panic!("FTP erases no logs"),
        }
    }

    /// A whole file by single reads.
    fn read_file(&mut self, path: &[u8]) -> Vec<u8> {
        let open = self.ask(op::OPEN_READ, 0, 0, path);
        assert_eq!((open.opcode, open.size), (op::ACK, 4), "{path:?}");
        let len = u32::from_le_bytes(open.data().unwrap().try_into().unwrap()) as usize;
        let mut got = Vec::new();
        while got.len() < len {
            let piece = self.ask(op::READ, open.session, got.len() as u32, &[]);
            assert_eq!(piece.opcode, op::ACK);
            got.extend(piece.data().unwrap());
        }
        assert_eq!(self.refusal(op::READ, open.session, len as u32, &[]), 6);
        assert_eq!(
            self.ask(op::TERMINATE_SESSION, open.session, 0, &[]).opcode,
            op::ACK
        );
        assert_eq!(self.refusal(op::READ, open.session, 0, &[]), 4);
        got
    }
}

#[test]
fn metadata_and_logs_are_read_and_their_checksums_match() {
    let mut rig = Rig::new();
    for file in FILES.iter() {
        let path = format!("/{}", file.name);
        assert_eq!(rig.read_file(path.as_bytes()), file.bytes);
        let crc = rig.ask(op::CALC_CRC, 0, 0, path.as_bytes());
        assert_eq!(crc.data().unwrap(), crc32(0, &file.bytes).to_le_bytes());
    }
    let log = rig.disk[&(0, "0001.mcap".to_owned())].clone();
    assert_eq!(rig.read_file(b"/logs/0001.mcap"), log);
    let crc = rig.ask(op::CALC_CRC, 0, 0, b"/logs/0001.mcap");
    assert_eq!(crc.data().unwrap(), crc32(0, &log).to_le_bytes());
    rig.bench.snapshot.is_armed = true;
    assert_eq!(rig.refusal(op::OPEN_READ, 0, 0, b"/logs/0001.mcap"), 9);
}

#[test]
fn a_burst_brings_the_rest_of_the_file_in_order_and_says_where_it_ends() {
    let mut rig = Rig::new();
    let log = rig.disk[&(0, "0001.mcap".to_owned())].clone();
    let open = rig.ask(op::OPEN_READ, 0, 0, b"/logs/0001.mcap");
    let request = rig.request(op::BURST_READ, open.session, 1_000, &[0; 200]);
    rig.got.clear();
    rig.send(255, &request);
    rig.run(400);
    let mut at = 1_000;
    for (i, piece) in (1u16..).zip(&rig.got) {
        assert_eq!((piece.opcode, piece.request), (op::ACK, op::BURST_READ));
        assert_eq!(piece.seq, request.seq.wrapping_add(i));
        assert_eq!(piece.offset as usize, at);
        let data = piece.data().unwrap();
        assert_eq!(data, &log[at..at + data.len()]);
        at += data.len();
        assert_eq!(piece.is_burst_complete, at == log.len());
    }
    assert_eq!(at, log.len());
    assert_eq!(rig.refusal(op::BURST_READ, open.session, 40_000, &[]), 6);
}

#[test]
fn folders_list_what_is_in_them_entry_by_entry() {
    let mut rig = Rig::new();
    for i in 0..40 {
        rig.disk
            .insert((1, format!("file-number-{i:02}")), vec![0; i]);
    }
    let mut names = Vec::new();
    loop {
        let answer = rig.ask(op::LIST_DIRECTORY, 0, names.len() as u32, b"/upload");
        let data = answer.data().unwrap().to_vec();
        if answer.opcode == op::NAK {
            assert_eq!(data, [6]);
            break;
        }
        let entries = data.split(|b| *b == 0).filter(|e| !e.is_empty());
        names.extend(entries.map(|e| String::from_utf8(e.to_vec()).unwrap()));
    }
    assert_eq!(names.len(), 40);
    assert_eq!(names[7], "Ffile-number-07\t7");
    let root = rig.ask(op::LIST_DIRECTORY, 0, 0, b"/");
    let text = String::from_utf8(root.data().unwrap().to_vec()).unwrap();
    assert!(
        text.starts_with("Dlogs\0Dupload\0Fgeneral.json.xz\t"),
        "{text:?}"
    );
}

#[test]
fn a_file_is_uploaded_read_back_and_removed() {
    let mut rig = Rig::new();
    let content: Vec<u8> = (0..1_000u32).map(|i| ((i * 31) >> 3) as u8).collect();
    let open = rig.ask(op::CREATE, 0, 0, b"/upload/plan.pgm");
    assert_eq!(open.opcode, op::ACK);
    for (i, piece) in content.chunks(200).enumerate() {
        let wrote = rig.ask(op::WRITE, open.session, i as u32 * 200, piece);
        assert_eq!(wrote.opcode, op::ACK);
    }
    // A hole, and a file larger than any plan.
    assert_eq!(rig.refusal(op::WRITE, open.session, 5_000, b"x"), 9);
    rig.ask(op::TERMINATE_SESSION, open.session, 0, &[]);
    assert_eq!(rig.read_file(b"/upload/plan.pgm"), content);
    let append = rig.ask(op::OPEN_WRITE, 0, 0, b"/upload/plan.pgm");
    assert_eq!(
        rig.ask(op::WRITE, append.session, 1_000, b"more").opcode,
        op::ACK
    );
    assert_eq!(rig.disk[&(1, "plan.pgm".to_owned())].len(), 1_004);
    assert_eq!(
        rig.ask(op::REMOVE, 0, 0, b"/upload/plan.pgm").opcode,
        op::ACK
    );
    assert_eq!(rig.refusal(op::REMOVE, 0, 0, b"/upload/plan.pgm"), 10);
}

#[test]
fn nothing_outside_the_upload_folder_is_written() {
    let mut rig = Rig::new();
    let before = rig.disk.clone();
    for path in [
        &b"/logs/0001.mcap"[..],
        b"/general.json",
        b"/etc/passwd",
        b"/upload/../mission.json",
        b"/upload/a\0b",
        b"/upload",
        b"",
    ] {
        for opcode in [op::CREATE, op::OPEN_WRITE, op::REMOVE] {
            assert_eq!(rig.refusal(opcode, 0, 0, path), 9, "{path:?}");
        }
    }
    let log = rig.ask(op::OPEN_READ, 0, 0, b"/logs/0001.mcap");
    assert_eq!(rig.refusal(op::WRITE, log.session, 0, b"x"), 9);
    assert_eq!(rig.disk, before);
    for i in 0..MAX_UPLOADS {
        rig.disk.insert((1, format!("f{i}")), Vec::new());
    }
    assert_eq!(rig.refusal(op::CREATE, 0, 0, b"/upload/one-more"), 1);
}

#[test]
fn sessions_are_few_belong_to_their_peer_and_close_by_themselves() {
    let mut rig = Rig::new();
    for _ in 0..MAX_SESSIONS {
        assert_eq!(
            rig.ask(op::OPEN_READ, 0, 0, b"/general.json").opcode,
            op::ACK
        );
    }
    assert_eq!(rig.refusal(op::OPEN_READ, 0, 0, b"/general.json"), 5);
    let foreign = rig.request(op::READ, 0, 0, &[]);
    rig.got.clear();
    rig.send(254, &foreign);
    assert_eq!(rig.got[0].data().unwrap(), [4]);
    rig.run(10_100);
    assert_eq!(
        rig.ask(op::OPEN_READ, 0, 0, b"/general.json").opcode,
        op::ACK
    );
    assert_eq!(rig.ask(op::RESET_SESSIONS, 0, 0, &[]).opcode, op::ACK);
    assert_eq!(rig.refusal(op::READ, 0, 0, &[]), 4);
    assert_eq!(rig.service.deadline(), None);
}

#[test]
fn a_repeated_request_gets_the_same_answer_and_is_done_once() {
    let mut rig = Rig::new();
    let request = rig.request(op::OPEN_READ, 0, 0, b"/general.json");
    rig.send(255, &request);
    rig.send(255, &request);
    assert_eq!(rig.got.len(), 2);
    assert_eq!(rig.got[0], rig.got[1]);
    assert_eq!(rig.service.sessions.len(), 1);
}

#[test]
fn sizes_beyond_the_payload_unknown_opcodes_and_a_silent_disk_are_refused() {
    let mut rig = Rig::new();
    assert_eq!(rig.refusal(op::OPEN_READ, 0, 0, &[b'a'; 250]), 3);
    assert_eq!(rig.refusal(77, 0, 0, &[]), 7);
    assert_eq!(rig.refusal(13, 0, 0, b"/a"), 7);
    assert_eq!(rig.refusal(op::OPEN_READ, 0, 0, b"@PARAM/param.pck"), 10);
    let request = rig.request(op::OPEN_READ, 0, 0, b"/logs/0001.mcap");
    rig.got.clear();
    let message = MavMessage::FILE_TRANSFER_PROTOCOL(FILE_TRANSFER_PROTOCOL_DATA {
        target_network: 0,
        target_system: 1,
        target_component: 1,
        payload: request.write(),
    });
    let ctx = rig.bench.ctx();
    rig.service
        .handle(rig.now, station(255), &message.into(), &ctx, &mut rig.out);
    rig.out.jobs.clear();
    rig.run(2_100);
    assert_eq!(rig.got[0].data().unwrap(), [1]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn no_sequence_of_requests_panics_grows_or_reaches_past_the_folders(
        script in proptest::collection::vec((0u8..2, 0u8..18, 0u8..10, any::<u32>(), 0usize..8, any::<u8>(), 0u64..40), 0..60)
    ) {
        let paths: [&[u8]; 8] = [b"/", b"/upload/a", b"/upload/../x", b"/logs/0001.mcap", b"/general.json", b"/upload/b\0c", b"/logs", b"\xFF\xFE"];
        let mut rig = Rig::new();
        for (sender, opcode, session, offset, path, size, ms) in script {
            let mut request = rig.request(opcode, session, offset % 50_000, paths[path]);
            if size % 3 == 0 {
                request.size = size;
            }
            rig.send(250 + sender, &request);
            rig.run(ms);
            prop_assert!(rig.got.len() < 20_000);
        }
        let size: usize = rig.disk.values().map(Vec::len).sum();
        prop_assert!(size < 200_000, "{size}");
        prop_assert!(rig.disk.keys().all(|(f, name)| *f == 1 || name == "0001.mcap"));
    }
}
