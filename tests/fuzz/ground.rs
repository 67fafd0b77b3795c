//! All MAVLink services at once, behind the links that stations speak on.

use crate::fuzz;
use crate::mavlink::healed;
use bridge::autopilot::door::{Answer, Event, Outcome, Refusal, Request, Snapshot};
use bridge::autopilot::ground::{Ground, GroundConfig, GroundOutput};
use bridge::gcs::access::{LinkPolicy, Role};
use bridge::gcs::camera::VideoStream;
use bridge::gcs::disk::{DiskJob, DiskReply, FileEntry};
use bridge::gcs::{DOCUMENTS, Document, LinkId};
use bridge::settings::Settings;
use core::time::Duration;
use mavlink_dialect::signing::SigningKey;
use mavlink_dialect::{Address, Decoder};
use std::sync::Arc;
use vehicle::floor_plan::Cell;
use vehicle::{Airframe, FloorPlan, MapAnchor, Timestamp};

/// Frames for one link that a single datagram may cause at most, telemetry aside: a list of parameters is paced.
const MOST_ANSWERS: usize = 4_096;

fn ground_of(documents: Vec<Document>) -> Ground {
    let plan = FloorPlan::from_cells(12, 0.5, [0.0, 0.0], vec![Cell::Free; 144]).unwrap();
    let mut ground = Ground::new(GroundConfig {
        us: Address {
            system: 1,
            component: 1,
        },
        settings: Settings::default(),
        anchor: MapAnchor::new(3.0, 3.0, 0.0),
        plan: Arc::new(plan),
        airframe: Airframe::default(),
        boot_utc_us: 1_700_000_000_000_000,
        documents,
    });
    let policy = |url: &str| LinkPolicy {
        url: url.to_owned(),
        ..LinkPolicy::default()
    };
    ground.set_policies(vec![
        policy("udpserver://127.0.0.1:14550"),
        LinkPolicy {
            role: Some(Role::Viewer),
            rate_bytes_per_s: Some(2_000.0),
            ..policy("serial:///dev/ttyUSB0?baudrate=57600")
        },
        LinkPolicy {
            key: Some(SigningKey::from_passphrase("fuzz")),
            ..policy("udpserver://0.0.0.0:14551")
        },
        LinkPolicy {
            is_routed: true,
            ..policy("udpserver://127.0.0.1:14552")
        },
    ]);
    ground.set_video(VideoStream::parse("udp://:5600").ok());
    ground
}

/// The vehicle and the disk, of few words and not always willing.
fn carry_out(ground: &mut Ground, now: Timestamp) {
    let mut frames = 0;
    // Answers may ask again, though never without end.
    for _ in 0..100_000 {
        let Some(output) = ground.poll() else {
            assert!(frames <= 4 * MOST_ANSWERS, "{frames} frames at once");
            return;
        };
        match output {
            GroundOutput::Send { bytes, .. } => {
                frames += 1;
                let mut seen = 0;
                Decoder::new().push(&bytes, |_| seen += 1);
                assert_eq!(seen, 1, "what we send can be read: {bytes:02x?}");
            }
            GroundOutput::Request(asked) => {
                if let Request::Manual(m) = &asked.request {
                    let axes = [m.forward, m.right, m.yaw, m.throttle];
                    assert!(
                        axes.into_iter()
                            .flatten()
                            .all(|v| (-1.0..=1.0).contains(&v))
                    );
                }
                let outcome = match asked.id.0 % 5 {
                    0 => continue,
                    1 => Outcome::Refused(Refusal::NotFlying),
                    _ => Outcome::Accepted,
                };
                let answer = Answer {
                    id: asked.id,
                    station: asked.station,
                    outcome,
                };
                ground.answer(now, &answer);
            }
            GroundOutput::Disk(ticket, job) => {
                let reply = match job {
                    DiskJob::List(_) => DiskReply::Files(vec![FileEntry {
                        name: "0001.mcap".to_owned(),
                        len: 1_000,
                        utc_s: 7,
                    }]),
                    DiskJob::Read { offset, len, .. } => {
                        let rest = 1_000u64.saturating_sub(offset).min(u64::from(len));
                        DiskReply::Bytes(vec![7; rest as usize])
                    }
                    DiskJob::Create(_) | DiskJob::Write { .. } => DiskReply::Done,
                    DiskJob::Remove(_) | DiskJob::EraseLogs => DiskReply::NotFound,
                };
                ground.disk(now, ticket, &reply);
            }
            GroundOutput::Keep(document) => assert!(document.bytes.len() < 1 << 20),
        }
    }
    panic!("its outputs have no end");
}

fn converse(ground: &mut Ground, bytes: &[u8]) {
    let mut now = Timestamp::ZERO;
    let mut rest = bytes;
    while !rest.is_empty() {
        // A frame, or what is no frame, at a time; its sequence number says on which link and after which pause.
        let is_frame = rest[0] == 0xFD && rest.len() >= 12;
        let len = if is_frame {
            (usize::from(rest[1]) + 12).min(rest.len())
        } else {
            let next = rest[1..].iter().position(|b| *b == 0xFD);
            next.map_or(rest.len(), |at| at + 1)
        };
        let (piece, more) = rest.split_at(len);
        rest = more;
        let word = piece.get(4).copied().unwrap_or(0);
        let link = LinkId::of(word % 4, u32::from(word / 64));
        let link = if word & 8 != 0 { link.remote() } else { link };
        now += Duration::from_millis(u64::from(word) * 3);
        ground.receive(now, link, piece, word & 4 == 0);
        carry_out(ground, now);
        for _ in 0..4 {
            if ground.deadline() <= now {
                ground.tick(now);
                carry_out(ground, now);
            }
        }
        let snapshot = Snapshot {
            is_armed: word & 0x10 != 0,
            is_key_mode: word & 0x20 != 0,
            ..Snapshot::default()
        };
        ground.snapshot(now, &snapshot);
        ground.event(now, &Event::ItemReached(u16::from(word)));
        carry_out(ground, now);
    }
}

fuzz!(
    /// Stations and companions of all roles say whatever they like: every service answers within bounds.
    ground,
    |bytes: &[u8]| converse(&mut ground_of(Vec::new()), &healed(bytes))
);

fuzz!(
    /// Documents of an earlier run, whoever wrote them.
    stored_documents,
    |bytes: &[u8]| {
        for name in DOCUMENTS {
            let document = Document {
                name,
                bytes: bytes.to_vec(),
            };
            carry_out(&mut ground_of(vec![document]), Timestamp::ZERO);
        }
    }
);
