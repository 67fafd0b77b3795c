//! The service with a desk of its own.

use super::*;

pub(super) const A: Peer = station(255);
pub(super) const B: Peer = station(250);
pub(super) const NAN: f32 = f32::NAN;

/// Streams that know HEARTBEAT, HOME_POSITION and the versions, and note what was asked.
#[derive(Default)]
pub(super) struct FakeStreams {
    pub(super) intervals: Vec<(LinkId, u32, i32)>,
    pub(super) requested: Vec<(u32, u32)>,
}

impl Streams for FakeStreams {
    fn set_interval(&mut self, _: Timestamp, link: LinkId, id: u32, interval_us: i32) -> u8 {
        self.intervals.push((link, id, interval_us));
        result::ACCEPTED
    }

    fn interval_us(&self, _: LinkId, id: u32) -> i32 {
        if id == 30 { 50_000 } else { 0 }
    }

    fn request(
        &mut self,
        _: Timestamp,
        _: Peer,
        id: u32,
        param2: f32,
        _: &Context<'_>,
        _: &mut Outbox,
    ) -> u8 {
        self.requested.push((id, param2.to_bits()));
        if matches!(id, 0 | 148 | 242 | 300 | 435) {
            result::ACCEPTED
        } else {
            result::UNSUPPORTED
        }
    }
}

pub(super) struct Desk {
    pub(super) service: CommandService,
    pub(super) bench: Bench,
    pub(super) streams: FakeStreams,
    pub(super) out: Outbox,
    pub(super) now: Timestamp,
}

/// What a command came to: an ACK, or a request made of the vehicle.
#[derive(Debug, PartialEq)]
pub(super) enum Came {
    Acked(u8),
    Asked(Request),
}

pub(super) fn long(command: u16, params: [f32; 7]) -> Message {
    let [param1, param2, param3, param4, param5, param6, param7] = params;
    let m = raw::COMMAND_LONG_DATA {
        command,
        param1,
        param2,
        param3,
        param4,
        param5,
        param6,
        param7,
        target_system: 1,
        target_component: 1,
        confirmation: 0,
    };
    Message::Raw(M::COMMAND_LONG(m))
}

pub(super) fn first(command: u16, params: &[f32]) -> Message {
    let mut all = [0.0; 7];
    all[..params.len()].copy_from_slice(params);
    long(command, all)
}

pub(super) fn repeat(message: &Message, confirmation: u8) -> Message {
    let Message::Raw(M::COMMAND_LONG(m)) = message else {
        panic!("COMMAND_LONG")
    };
    Message::Raw(M::COMMAND_LONG(raw::COMMAND_LONG_DATA {
        confirmation,
        ..m.clone()
    }))
}

pub(super) fn int(command: u16, frame: u8, params: [f32; 4], x: i32, y: i32, z: f32) -> Message {
    let [param1, param2, param3, param4] = params;
    let m = raw::COMMAND_INT_DATA {
        command,
        frame,
        param1,
        param2,
        param3,
        param4,
        x,
        y,
        z,
        ..Default::default()
    };
    Message::Raw(M::COMMAND_INT(m))
}

impl Desk {
    pub(super) fn new() -> Self {
        Self {
            service: CommandService::new(),
            bench: Bench::default(),
            streams: FakeStreams::default(),
            out: Outbox::default(),
            now: Timestamp::from_ms(1000),
        }
    }

    pub(super) fn send(&mut self, from: Peer, message: &Message) {
        self.service.handle(
            self.now,
            from,
            message,
            &self.bench.ctx(),
            &mut self.streams,
            &mut self.out,
        );
    }

    /// (target system, command, result) of each ACK since the last call.
    pub(super) fn acks(&mut self) -> Vec<(u8, u16, u8)> {
        let ack = |m| match m {
            M::COMMAND_ACK(a) => Some((a.target_system, a.command, a.result)),
            _ => None,
        };
        self.out.sent_raw().into_iter().filter_map(ack).collect()
    }

    pub(super) fn came(&mut self, message: &Message) -> Came {
        self.send(A, message);
        match (&self.acks()[..], self.out.asked().pop()) {
            ([(255, _, result)], None) => Came::Acked(*result),
            ([], Some(asked)) => Came::Asked(asked.request),
            other => panic!("{other:?}"),
        }
    }

    pub(super) fn tick(&mut self, ms: u64) {
        self.now += Duration::from_millis(ms);
        self.service
            .tick(self.now, &self.bench.ctx(), &mut self.out);
    }
}

pub(super) fn came(message: &Message) -> Came {
    Desk::new().came(message)
}

pub(super) fn refused(desk: &mut Desk, message: &Message, reason: &str) -> u8 {
    let Came::Acked(result) = desk.came(message) else {
        panic!("refused")
    };
    let said = desk.out.said();
    assert!(
        said.iter().any(|(_, t)| t.contains(reason)),
        "{said:?} says {reason}"
    );
    result
}
