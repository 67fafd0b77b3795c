//! A flight controller at the end of a line, in virtual time: what the tests of scheduler and faults share.

use msp::client::{Client, Event};
use msp::message::multiple::{MultipleRequest, push_reply};
use msp::message::{
    Altitude, ApiVersion, Attitude, BatteryState, BoardInfo, BoxIds, Debug, FcVariant, FcVersion,
    InavAnalog, InavStatus, RawImu, Reboot, RxMap, StatusEx, StatusExTail, StatusHead, StatusTail,
};
use msp::server::Request;
use msp::{Reply, Server, command};
use std::collections::VecDeque;

/// Which firmware answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Betaflight 4.6.
    Betaflight,
    /// INAV 9.
    Inav,
}

/// The controller: one request per run of its serial task.
pub struct Controller {
    pub kind: Kind,
    pub server: Server,
    /// Time between two runs of the serial task.
    pub slot_us: u64,
    /// Next run.
    pub run_us: u64,
    /// Runs, and runs that found a request.
    pub slots: u64,
    pub used: u64,
    /// When SET_RAW_RC was served.
    pub rc_us: Vec<u64>,
    pub boxes: Vec<u8>,
    pub map: [u8; 4],
    /// The control loop's time, 0 = it stands still.
    pub cycle_us: u16,
    /// Boot grace lasts until then.
    pub grace_until_us: u64,
}

impl Controller {
    pub fn new(kind: Kind, slot_us: u64) -> Self {
        Self {
            kind,
            server: Server::new(),
            slot_us,
            run_us: 0,
            slots: 0,
            used: 0,
            rc_us: Vec::new(),
            boxes: vec![0, 1, 2, 27],
            map: [0, 1, 3, 2],
            cycle_us: 125,
            grace_until_us: 0,
        }
    }

    /// One run of the serial task; the bytes that it sends.
    pub fn run(&mut self) -> Vec<u8> {
        let now_us = self.run_us;
        self.run_us += self.slot_us;
        self.slots += 1;
        let Some(request) = self.server.pop() else {
            return Vec::new();
        };
        self.used += 1;
        if request.command == command::SET_RAW_RC {
            self.rc_us.push(now_us);
        }
        self.answer(now_us, &request);
        let bytes = self.server.output().to_vec();
        self.server.clear_output();
        bytes
    }

    fn answer(&mut self, now_us: u64, request: &Request) {
        let payload_of = |reply: Option<Reply>| {
            reply.map(|reply| {
                let mut payload = Vec::new();
                reply.emit(&mut payload);
                payload
            })
        };
        let payload = if request.command == command::MULTIPLE_MSP && self.kind == Kind::Betaflight {
            let asked = request.parse::<MultipleRequest>().unwrap_or_default();
            let mut batch = Vec::new();
            asked
                .commands
                .iter()
                .try_for_each(|&number| {
                    let payload = payload_of(self.reply(now_us, number.into()))?;
                    push_reply(&payload, &mut batch);
                    Some(())
                })
                .map(|()| batch)
        } else {
            payload_of(self.reply(now_us, request.command))
        };
        match payload {
            Some(payload) => self.server.reply(request, &payload),
            None => self.server.refuse(request),
        }
    }

    fn reply(&self, now_us: u64, number: u16) -> Option<Reply> {
        let is_betaflight = self.kind == Kind::Betaflight;
        let starting = u32::from(now_us < self.grace_until_us) << 9;
        Some(match number {
            command::API_VERSION => Reply::ApiVersion(ApiVersion {
                protocol: 0,
                major: if is_betaflight { 1 } else { 2 },
                minor: if is_betaflight { 47 } else { 5 },
            }),
            command::FC_VARIANT => Reply::FcVariant(FcVariant {
                variant: if is_betaflight { *b"BTFL" } else { *b"INAV" },
            }),
            command::FC_VERSION => Reply::FcVersion(FcVersion {
                major: 4,
                minor: 6,
                ..FcVersion::default()
            }),
            command::BOARD_INFO => Reply::BoardInfo(BoardInfo {
                board: *b"TEST",
                ..BoardInfo::default()
            }),
            command::BOXIDS => Reply::BoxIds(BoxIds {
                ids: self.boxes.iter().copied().collect(),
            }),
            command::RX_MAP => Reply::RxMap(RxMap {
                map: self.map.into_iter().collect(),
            }),
            command::ATTITUDE => Reply::Attitude(Attitude::default()),
            command::ALTITUDE => Reply::Altitude(Altitude::default()),
            command::RAW_IMU => Reply::RawImu(RawImu::default()),
            command::REBOOT => Reply::Reboot(Reboot { mode: Some(0) }),
            command::DEBUG => Reply::Debug(Debug::default()),
            command::SET_RAW_RC | command::EEPROM_WRITE => Reply::Ack { command: number },
            command::STATUS_EX if is_betaflight => Reply::StatusEx(StatusEx {
                head: StatusHead {
                    cycle_time_us: self.cycle_us,
                    ..StatusHead::default()
                },
                tail: StatusExTail::Betaflight {
                    pid_profile_count: 4,
                    rate_profile: 0,
                    tail: StatusTail {
                        arming_disable_count: 29,
                        arming_disable: starting,
                        ..StatusTail::default()
                    },
                },
                ..StatusEx::default()
            }),
            command::BATTERY_STATE if is_betaflight => Reply::BatteryState(BatteryState::default()),
            command::INAV_STATUS if !is_betaflight => Reply::InavStatus(InavStatus {
                cycle_time_us: self.cycle_us,
                arming_flags: starting,
                ..InavStatus::default()
            }),
            command::INAV_ANALOG if !is_betaflight => Reply::InavAnalog(InavAnalog::default()),
            _ => return None,
        })
    }
}

/// Bytes under way, each with the time it arrives.
#[derive(Default)]
pub struct Wire {
    bytes: VecDeque<(u64, u8)>,
    busy_ns: u64,
    /// Time of one byte; 0 = none.
    pub byte_ns: u64,
    /// Time before the first byte arrives (USB, scheduler of the host).
    pub delay_us: u64,
}

impl Wire {
    pub fn new(byte_ns: u64, delay_us: u64) -> Self {
        Self {
            byte_ns,
            delay_us,
            ..Self::default()
        }
    }

    pub fn send(&mut self, now_us: u64, bytes: &[u8]) {
        self.busy_ns = self.busy_ns.max(now_us * 1000);
        for byte in bytes {
            self.busy_ns += self.byte_ns;
            let at_us = self.busy_ns.div_ceil(1000) + self.delay_us;
            self.bytes.push_back((at_us, *byte));
        }
    }

    pub fn next_us(&self) -> Option<u64> {
        self.bytes.front().map(|(at_us, _)| *at_us)
    }

    /// What has arrived.
    pub fn receive(&mut self, now_us: u64) -> Vec<u8> {
        let count = self.bytes.partition_point(|(at_us, _)| *at_us <= now_us);
        self.bytes.drain(..count).map(|(_, byte)| byte).collect()
    }

    pub fn clear(&mut self) {
        self.bytes.clear();
    }
}

/// Events of a client, oldest first.
pub fn events(client: &mut Client) -> Vec<Event> {
    std::iter::from_fn(|| client.poll_event()).collect()
}
