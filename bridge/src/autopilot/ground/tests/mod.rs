//! Whole conversations over real bytes and virtual time.

mod access;
mod links;
mod parameters;
mod services;
mod signing;
mod streams;

use super::*;
use crate::autopilot::door::{Notice, Outcome, Refusal, RequestId, Station};
use crate::autopilot::mode::{Because, Mode, ModeState};
use crate::gcs::telemetry::CAPABILITIES;
use mavlink_dialect::standard::{self, MavMessage as Std};
use mavlink_dialect::{Decoder, Encoder, Frame, MessageData, raw};
use raw::MavMessage as Raw;
use std::collections::BTreeMap;
use vehicle::floor_plan::Cell;
use vehicle::{Beam, In, NavHealth, ParamValue, RangeScan};

const A: LinkId = LinkId(1);
const B: LinkId = LinkId(2);
const US: Address = Address {
    system: 1,
    component: 1,
};
const GCS: Address = Address {
    system: 255,
    component: 190,
};

/// A ground side, and what came out of it.
struct Bench {
    ground: Ground,
    now: Timestamp,
    station: Encoder,
    decoders: BTreeMap<LinkId, Decoder>,
    heard: Vec<(Timestamp, LinkId, Frame)>,
    requests: Vec<Asked>,
    documents: Vec<Document>,
    jobs: Vec<(Ticket, DiskJob)>,
}

impl Bench {
    fn new() -> Self {
        let plan = FloorPlan::from_cells(40, 0.1, [0.0, 0.0], vec![Cell::Free; 1_600]).unwrap();
        let ground = Ground::new(GroundConfig {
            us: US,
            settings: Settings::default(),
            anchor: MapAnchor::new(2.0, 2.0, 1.0),
            plan: Arc::new(plan),
            airframe: Airframe::default(),
            boot_utc_us: 1_000_000_000_000_000,
            documents: Vec::new(),
        });
        Self {
            ground,
            now: Timestamp::ZERO,
            station: Encoder::new(GCS),
            decoders: BTreeMap::new(),
            heard: Vec::new(),
            requests: Vec::new(),
            documents: Vec::new(),
            jobs: Vec::new(),
        }
    }

    fn with_link() -> Self {
        let mut bench = Self::new();
        bench.link_up(A);
        bench
    }

    fn link_up(&mut self, link: LinkId) {
        assert!(self.ground.link_up(self.now, link));
        self.collect();
    }

    fn collect(&mut self) {
        while let Some(output) = self.ground.poll() {
            match output {
                GroundOutput::Keep(document) => self.documents.push(document),
                GroundOutput::Disk(ticket, job) => self.jobs.push((ticket, job)),
                GroundOutput::Request(asked) => self.requests.push(asked),
                GroundOutput::Send { link, bytes } => {
                    let (heard, now) = (&mut self.heard, self.now);
                    self.decoders
                        .entry(link)
                        .or_default()
                        .push(&bytes, |frame| heard.push((now, link, frame)));
                }
            }
        }
    }

    fn run_for(&mut self, ms: u64) {
        let end = self.now + Duration::from_millis(ms);
        while self.ground.deadline() <= end {
            let deadline = self.ground.deadline().max(self.now);
            self.now = deadline;
            self.ground.tick(self.now);
            assert!(
                self.ground.deadline() > deadline,
                "a tick makes its deadline pass"
            );
            self.collect();
        }
        self.now = end;
    }

    fn say_on(&mut self, link: LinkId, message: impl Into<Message>) {
        let bytes = self.station.encode_message(&message.into());
        self.ground.receive(self.now, link, &bytes, true);
        self.collect();
    }

    fn say(&mut self, message: impl Into<Message>) {
        self.say_on(A, message);
    }

    fn command(&mut self, command: u16, param1: f32, param2: f32) {
        let command = raw::COMMAND_LONG_DATA {
            command,
            param1,
            param2,
            target_system: 1,
            target_component: 1,
            ..Default::default()
        };
        self.say(Raw::COMMAND_LONG(command));
    }

    fn show(&mut self, change: impl FnOnce(&mut Snapshot)) {
        let mut snapshot = self.ground.snapshot.clone();
        change(&mut snapshot);
        self.ground.snapshot(self.now, &snapshot);
        self.collect();
    }

    fn on(&self, link: LinkId) -> impl Iterator<Item = &Frame> {
        self.heard
            .iter()
            .filter(move |(_, l, _)| *l == link)
            .map(|(_, _, f)| f)
    }

    fn count_of(&self, link: LinkId, id: u32) -> usize {
        self.on(link).filter(|f| f.message.id() == id).count()
    }

    fn values(&self, link: LinkId) -> Vec<standard::PARAM_VALUE_DATA> {
        let value = |f: &Frame| match &f.message {
            Message::Standard(Std::PARAM_VALUE(v)) => Some(v.clone()),
            _ => None,
        };
        self.on(link).filter_map(value).collect()
    }

    fn texts(&self, link: LinkId) -> Vec<String> {
        let text = |f: &Frame| match &f.message {
            Message::Raw(Raw::STATUSTEXT(t)) => Some(t.text.to_str().unwrap().to_owned()),
            _ => None,
        };
        self.on(link).filter_map(text).collect()
    }

    fn acks(&self) -> Vec<(u16, u8)> {
        let ack = |f: &Frame| match &f.message {
            Message::Raw(Raw::COMMAND_ACK(a)) => Some((a.command, a.result)),
            _ => None,
        };
        self.on(A).filter_map(ack).collect()
    }
}

fn set(name: &str, value: f32, param_type: u8) -> Raw {
    Raw::PARAM_SET(raw::PARAM_SET_DATA {
        param_value: value,
        target_system: 1,
        target_component: 1,
        param_id: name.into(),
        param_type,
    })
}

fn request_list() -> Std {
    Std::PARAM_REQUEST_LIST(standard::PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 0,
    })
}

fn localized(s: &mut Snapshot) {
    s.nav.health = NavHealth {
        attitude: true,
        height: true,
        velocity: true,
        position: true,
    };
    s.fc.is_connected = true;
}
