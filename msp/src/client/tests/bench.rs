//! A scripted controller on virtual time.

use super::*;

pub(super) const STEP_US: u64 = 1_000;

/// A client, a controller that serves one request every `service_us`, and the line between them.
pub(super) struct Bench {
    pub(super) client: Client,
    pub(super) server: Server,
    pub(super) now_us: u64,
    pub(super) kind: Kind,
    pub(super) service_us: u64,
    /// The controller neither hears nor speaks.
    pub(super) is_dead: bool,
    /// The controller hears, its answers are lost.
    pub(super) is_mute: bool,
    pub(super) rc_period_us: Option<u64>,
    pub(super) seen: Vec<Request>,
    pub(super) events: Vec<Event>,
    pub(super) max_pending: usize,
}

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Kind {
    Betaflight,
    /// Knows API 1.47 but refuses batches.
    BetaflightWithoutBatch,
    /// Puts roll and throttle on the same channel.
    BetaflightWithGarbledMap,
    Inav,
    MultiWii,
}

impl Bench {
    pub(super) fn new(kind: Kind) -> Self {
        Self::with_config(kind, Config::default())
    }

    pub(super) fn with_config(kind: Kind, config: Config) -> Self {
        let mut bench = Self {
            client: Client::new(config),
            server: Server::new(),
            now_us: 5_000_000,
            kind,
            service_us: 10_000,
            is_dead: false,
            is_mute: false,
            rc_period_us: None,
            seen: Vec::new(),
            events: Vec::new(),
            max_pending: 0,
        };
        bench.client.connect(bench.now_us);
        bench
    }

    pub(super) fn online(kind: Kind) -> Self {
        let mut bench = Self::new(kind);
        bench.run(500_000);
        assert!(bench.client.is_online(), "{:?}", bench.events);
        bench.seen.clear();
        bench.events.clear();
        bench
    }

    pub(super) fn run(&mut self, duration_us: u64) {
        let end_us = self.now_us + duration_us;
        while self.now_us < end_us {
            self.now_us += STEP_US;
            self.step();
        }
    }

    pub(super) fn step(&mut self) {
        if self
            .rc_period_us
            .is_some_and(|period_us| self.now_us.is_multiple_of(period_us))
        {
            self.client
                .set_rc(self.now_us, &[1500, 1500, 1000, 1500, 1000]);
        }
        self.transmit();
        self.max_pending = self.max_pending.max(self.server.pending());
        if self.now_us.is_multiple_of(self.service_us)
            && let Some(request) = self.server.pop()
        {
            answer(self.kind, &mut self.server, &request);
            self.seen.push(request);
        }
        if !self.is_dead && !self.is_mute {
            self.client.handle(self.now_us, self.server.output());
        }
        self.server.clear_output();
        self.transmit();
        while let Some(event) = self.client.poll_event() {
            self.events.push(event);
        }
    }

    pub(super) fn transmit(&mut self) {
        while let Some(bytes) = self.client.poll_transmit(self.now_us) {
            if !self.is_dead {
                self.server.handle(bytes);
            }
        }
    }

    /// How many requests of each command were served.
    pub(super) fn served(&self) -> BTreeMap<u16, usize> {
        let mut served = BTreeMap::new();
        for request in &self.seen {
            *served.entry(request.command).or_default() += 1;
        }
        served
    }

    pub(super) fn replies(&self) -> BTreeMap<u16, usize> {
        let mut replies = BTreeMap::new();
        for event in &self.events {
            if let Event::Reply { reply, .. } = event {
                *replies.entry(reply.command()).or_default() += 1;
            }
        }
        replies
    }
}

pub(super) fn answer(kind: Kind, server: &mut Server, request: &Request) {
    if request.command == command::MULTIPLE_MSP && kind == Kind::Betaflight {
        let commands = request.parse::<MultipleRequest>().unwrap().commands;
        let mut batch = Vec::new();
        for command in commands {
            let mut payload = Vec::new();
            let Some(reply) = reply(kind, command.into()) else {
                return server.refuse(request);
            };
            reply.emit(&mut payload);
            push_reply(&payload, &mut batch);
        }
        return server.reply(request, &batch);
    }
    match reply(kind, request.command) {
        Some(reply) => {
            let mut payload = Vec::new();
            reply.emit(&mut payload);
            server.reply(request, &payload);
        }
        None => server.refuse(request),
    }
}

pub(super) fn reply(kind: Kind, command: u16) -> Option<Reply> {
    let is_betaflight = !matches!(kind, Kind::Inav | Kind::MultiWii);
    Some(match command {
        command::IDENT if kind == Kind::MultiWii => Reply::Ident(Ident {
            version: 240,
            multitype: 3,
            ..Ident::default()
        }),
        command::BOXIDS => Reply::BoxIds(BoxIds {
            ids: [0, 1, 2, 27].into_iter().collect(),
        }),
        command::ATTITUDE => Reply::Attitude(Attitude::default()),
        command::ALTITUDE => Reply::Altitude(Altitude::default()),
        command::RAW_IMU => Reply::RawImu(RawImu::default()),
        command::SET_RAW_RC | command::EEPROM_WRITE => Reply::Ack { command },
        _ if kind == Kind::MultiWii => return None,
        command::API_VERSION if is_betaflight => Reply::ApiVersion(ApiVersion {
            protocol: 0,
            major: 1,
            minor: 47,
        }),
        command::API_VERSION => Reply::ApiVersion(ApiVersion {
            protocol: 0,
            major: 2,
            minor: 5,
        }),
        command::FC_VARIANT if is_betaflight => Reply::FcVariant(FcVariant { variant: *b"BTFL" }),
        command::FC_VARIANT => Reply::FcVariant(FcVariant { variant: *b"INAV" }),
        command::FC_VERSION => Reply::FcVersion(FcVersion {
            major: 4,
            minor: 6,
            patch: 0,
            text: None,
        }),
        command::BOARD_INFO => Reply::BoardInfo(BoardInfo {
            board: *b"TEST",
            ..BoardInfo::default()
        }),
        command::RX_MAP if kind == Kind::BetaflightWithGarbledMap => Reply::RxMap(RxMap {
            map: [0, 1, 2, 0].into_iter().collect(),
        }),
        command::RX_MAP => Reply::RxMap(RxMap {
            map: [1, 2, 3, 0].into_iter().collect(),
        }),
        command::REBOOT => Reply::Reboot(Reboot { mode: Some(0) }),
        command::STATUS_EX if is_betaflight => Reply::StatusEx(StatusEx::default()),
        command::BATTERY_STATE if is_betaflight => Reply::BatteryState(BatteryState::default()),
        command::INAV_STATUS if kind == Kind::Inav => Reply::InavStatus(InavStatus::default()),
        command::INAV_ANALOG if kind == Kind::Inav => Reply::InavAnalog(InavAnalog::default()),
        _ => return None,
    })
}
