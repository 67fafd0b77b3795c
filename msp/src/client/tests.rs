//! Client against a scripted controller on virtual time.

use super::*;
use crate::firmware::{Firmware, box_id};
use crate::message::multiple::{MultipleRequest, push_reply};
use crate::message::{
    Altitude, ApiVersion, Attitude, BatteryState, BoardInfo, BoxIds, FcVariant, FcVersion, Ident,
    InavAnalog, InavStatus, RawImu, Reboot, RxMap, SetRawRc, StatusEx,
};
use crate::server::{Request, Server};
use std::collections::BTreeMap;

const STEP_US: u64 = 1_000;

/// A client, a controller that serves one request every `service_us`, and the line between them.
struct Bench {
    client: Client,
    server: Server,
    now_us: u64,
    kind: Kind,
    service_us: u64,
    /// The controller neither hears nor speaks.
    is_dead: bool,
    /// The controller hears, its answers are lost.
    is_mute: bool,
    rc_period_us: Option<u64>,
    seen: Vec<Request>,
    events: Vec<Event>,
    max_pending: usize,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Betaflight,
    /// Knows API 1.47 but refuses batches.
    BetaflightWithoutBatch,
    /// Puts roll and throttle on the same channel.
    BetaflightWithGarbledMap,
    Inav,
    MultiWii,
}

impl Bench {
    fn new(kind: Kind) -> Self {
        Self::with_config(kind, Config::default())
    }

    fn with_config(kind: Kind, config: Config) -> Self {
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

    fn online(kind: Kind) -> Self {
        let mut bench = Self::new(kind);
        bench.run(500_000);
        assert!(bench.client.is_online(), "{:?}", bench.events);
        bench.seen.clear();
        bench.events.clear();
        bench
    }

    fn run(&mut self, duration_us: u64) {
        let end_us = self.now_us + duration_us;
        while self.now_us < end_us {
            self.now_us += STEP_US;
            self.step();
        }
    }

    fn step(&mut self) {
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

    fn transmit(&mut self) {
        while let Some(bytes) = self.client.poll_transmit(self.now_us) {
            if !self.is_dead {
                self.server.handle(bytes);
            }
        }
    }

    /// How many requests of each command were served.
    fn served(&self) -> BTreeMap<u16, usize> {
        let mut served = BTreeMap::new();
        for request in &self.seen {
            *served.entry(request.command).or_default() += 1;
        }
        served
    }

    fn replies(&self) -> BTreeMap<u16, usize> {
        let mut replies = BTreeMap::new();
        for event in &self.events {
            if let Event::Reply { reply, .. } = event {
                *replies.entry(reply.command()).or_default() += 1;
            }
        }
        replies
    }
}

fn answer(kind: Kind, server: &mut Server, request: &Request) {
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

fn reply(kind: Kind, command: u16) -> Option<Reply> {
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

// ---- identification ----

#[test]
fn betaflight_is_identified_after_the_line_has_been_drained() {
    let mut bench = Bench::new(Kind::Betaflight);
    bench.run(99_000);
    assert_eq!(bench.client.statistics().sent, 0);
    bench.run(300_000);
    let Some(Event::Identified(identity)) = bench.events.first() else {
        panic!("{:?}", bench.events);
    };
    assert_eq!(identity.firmware, Firmware::Betaflight);
    assert_eq!(identity.to_string(), "Betaflight 4.6.0 (MSP 1.47) on TEST");
    assert_eq!(identity.box_ids.index_of(box_id::FAILSAFE), Some(3));
    assert_eq!(
        identity.rx_map.arrange([1, 2, 3, 4], &[5]).as_slice(),
        [4, 1, 2, 3, 5]
    );
    let asked: Vec<u16> = bench
        .seen
        .iter()
        .map(|request| request.command)
        .take(6)
        .collect();
    let expected = [
        command::API_VERSION,
        command::FC_VARIANT,
        command::FC_VERSION,
        command::BOARD_INFO,
        command::BOXIDS,
        command::RX_MAP,
    ];
    assert_eq!(asked, expected);
}

#[test]
fn stale_bytes_of_an_earlier_connection_are_thrown_away_and_late_answers_discarded() {
    let mut bench = Bench::new(Kind::Betaflight);
    bench
        .client
        .handle(bench.now_us, b"$M>\x03\x01\x00\x02\x05\x05 garbage $M>");
    bench.run(100_000);
    // After draining: an answer nobody asked for, then the true ones.
    bench
        .client
        .handle(bench.now_us, b"$M>\x06\x6c\x00\x00\x00\x00\x00\x00\x6a");
    bench.run(400_000);
    assert_eq!(
        bench.client.identity().unwrap().firmware,
        Firmware::Betaflight
    );
    assert_eq!(bench.client.statistics().stale_replies, 1);
}

#[test]
fn multiwii_that_knows_no_api_version_is_asked_for_its_ident() {
    let mut bench = Bench::new(Kind::MultiWii);
    bench.run(500_000);
    let identity = bench.client.identity().unwrap();
    assert_eq!(identity.firmware, Firmware::MultiWii);
    assert_eq!(identity.version.to_string(), "2.40.0");
    assert_eq!(identity.rx_map, RxMap::identity());
}

#[test]
fn inav_is_asked_for_its_own_status_over_v2() {
    let mut bench = Bench::online(Kind::Inav);
    bench.run(2_000_000);
    let replies = bench.replies();
    assert_eq!(replies[&command::INAV_STATUS], 10, "{replies:?}");
    // 25 Hz and what is left of 100 slots a second.
    assert!(replies[&command::ATTITUDE] >= 50, "{replies:?}");
    assert!(!bench.served().contains_key(&command::MULTIPLE_MSP));
}

#[test]
fn a_receiver_map_that_is_none_is_asked_for_again_rather_than_guessed() {
    let mut bench = Bench::new(Kind::BetaflightWithGarbledMap);
    bench.run(2_000_000);
    assert!(!bench.client.is_online());
    assert!(bench.served()[&command::RX_MAP] > 3);
    bench.kind = Kind::Betaflight;
    bench.run(1_000_000);
    assert!(bench.client.is_online());
}

// ---- silence ----

#[test]
fn silent_flight_controller_is_reported_lost_after_600_ms_and_asked_for_ever() {
    let mut bench = Bench::new(Kind::Betaflight);
    bench.is_dead = true;
    bench.run(10_000_000);
    let [Event::Lost { silent_us, .. }] = bench.events.as_slice() else {
        panic!("{:?}", bench.events);
    };
    assert!((600_000..602_000).contains(silent_us), "{silent_us}");
    assert!(
        bench.events[0]
            .to_string()
            .contains("for 600 ms: check cable and power, the baud rate")
    );
    assert!(
        (30..=40).contains(&bench.client.statistics().sent),
        "{:?}",
        bench.client.statistics()
    );
    bench.is_dead = false;
    bench.run(1_000_000);
    assert!(
        matches!(
            bench.events[1],
            Event::Recovered {
                silent_us: 9_000_000..
            }
        ),
        "{:?}",
        bench.events
    );
    assert!(matches!(bench.events[2], Event::Identified(_)));
}

#[test]
fn bytes_that_are_no_frames_hint_at_the_baud_rate() {
    let mut bench = Bench::new(Kind::Betaflight);
    bench.is_dead = true;
    for _ in 0..800 {
        bench.run(1_000);
        bench.client.handle(bench.now_us, &[0xe0, 0x1c]);
    }
    assert!(
        bench.events[0]
            .to_string()
            .contains("bytes came that are not MSP"),
        "{}",
        bench.events[0]
    );
}

#[test]
fn after_a_loss_polling_resumes_at_once_and_the_controller_is_identified_again() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.is_dead = true;
    bench.run(2_000_000);
    assert!(!bench.client.is_online());
    assert!(bench.client.identity().is_some());
    bench.is_dead = false;
    bench.events.clear();
    bench.run(600_000);
    let position = |wanted: fn(&Event) -> bool| bench.events.iter().position(wanted).unwrap();
    let recovered = position(|event| matches!(event, Event::Recovered { .. }));
    let first_reply = position(|event| matches!(event, Event::Reply { .. }));
    let identified = position(|event| matches!(event, Event::Identified(_)));
    assert!(
        recovered < first_reply && first_reply < identified,
        "{recovered} {first_reply} {identified}"
    );
}

#[test]
fn a_link_without_a_schedule_is_probed_and_not_taken_for_lost() {
    let config = Config {
        schedule: Some(Schedule::new()),
        ..Config::default()
    };
    let mut bench = Bench::with_config(Kind::Betaflight, config);
    bench.run(5_000_000);
    assert!(
        matches!(
            bench.events.as_slice(),
            [Event::Identified(_), Event::Slow { .. }]
        ),
        "{:?}",
        bench.events
    );
    bench.is_dead = true;
    bench.run(700_000);
    assert!(matches!(bench.events.last(), Some(Event::Lost { .. })));
}

#[test]
fn a_reader_that_was_held_up_finds_the_answers_that_waited_and_no_loss() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.run(7_000);
    let bytes = bench.client.poll_transmit(bench.now_us).map(<[u8]>::to_vec);
    bench.server.handle(&bytes.unwrap_or_default());
    while let Some(request) = bench.server.pop() {
        answer(bench.kind, &mut bench.server, &request);
    }
    bench.now_us += 3_000_000;
    bench.client.handle(bench.now_us, bench.server.output());
    bench.server.clear_output();
    bench.run(500_000);
    assert!(
        !bench
            .events
            .iter()
            .any(|event| matches!(event, Event::Lost { .. })),
        "{:?}",
        bench.events
    );
}

#[test]
fn answers_to_rc_that_somebody_sends_in_our_name_do_not_stop_the_polls() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.rc_period_us = Some(25_000);
    let mut frame = Vec::new();
    let rc = [0xDC, 0x05].repeat(5);
    let request = crate::Direction::Request;
    crate::encode(Framing::V1, request, command::SET_RAW_RC, &rc, &mut frame).unwrap();
    for _ in 0..30 {
        bench.run(130_000);
        bench.server.handle(&frame);
    }
    let served = bench.served();
    let in_step = served.get(&command::DEBUG).copied().unwrap_or(0);
    assert!(in_step <= 1, "put in step {in_step} times in 4 s");
}

// ---- rates ----

#[test]
fn at_100_requests_a_second_rc_runs_at_40_hz_and_sensors_have_the_rest() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.rc_period_us = Some(25_000);
    bench.run(10_000_000);
    let (served, replies) = (bench.served(), bench.replies());
    assert!(
        (395..=401).contains(&served[&command::SET_RAW_RC]),
        "{served:?}"
    );
    // 1000 slots, 400 of them RC, 50 status, 20 battery, 2 lists.
    assert!(
        (520..=530).contains(&replies[&command::ATTITUDE]),
        "{replies:?}"
    );
    assert_eq!(replies[&command::ATTITUDE], replies[&command::RAW_IMU]);
    assert!(
        (48..=51).contains(&replies[&command::STATUS_EX]),
        "{replies:?}"
    );
    assert!(
        (19..=21).contains(&replies[&command::BATTERY_STATE]),
        "{replies:?}"
    );
    assert!(
        bench.max_pending <= 3,
        "backlog of {} at the controller",
        bench.max_pending
    );
    let statistics = bench.client.statistics();
    assert!(
        (statistics.service_rate_hz - 100.0).abs() < 5.0,
        "{statistics:?}"
    );
    assert_eq!((statistics.timeouts, statistics.bad_frames), (0, 0));
}

#[test]
fn a_slow_controller_gets_fewer_of_everything_and_no_backlog() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.rc_period_us = Some(25_000);
    // Betaflight 4.6 in its simulator: 35 requests a second.
    bench.service_us = 29_000;
    bench.run(10_000_000);
    let (served, replies) = (bench.served(), bench.replies());
    assert!(served[&command::SET_RAW_RC] >= 180, "{served:?}");
    assert!(replies[&command::ATTITUDE] >= 70, "{replies:?}");
    assert!(replies[&command::STATUS_EX] >= 10, "{replies:?}");
    assert!(replies[&command::BATTERY_STATE] >= 3, "{replies:?}");
    assert!(
        bench.max_pending <= 3,
        "backlog of {} at the controller",
        bench.max_pending
    );
}

#[test]
fn rc_waits_for_at_most_two_requests_and_only_the_newest_goes() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.client.set_rc(bench.now_us, &[1100]);
    bench.client.set_rc(bench.now_us, &[1200]);
    let bytes = bench.client.poll_transmit(bench.now_us).unwrap();
    assert_eq!(bytes, b"$M<\x02\xc8\xb0\x04\x7e");
    assert_eq!(bench.client.statistics().rc_replaced, 1);
    // Sent once, not repeated.
    bench.run(300_000);
    assert_eq!(bench.client.statistics().rc_sent, 1);
}

#[test]
fn rc_goes_ahead_of_waiting_requests_but_not_on_top_of_more_than_the_limit() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.service_us = u64::MAX;
    bench.run(60_000);
    let waiting = bench.server.pending();
    assert_eq!(waiting, 2, "two requests fill the limit");
    bench.client.set_rc(bench.now_us, &[1500]);
    bench.run(1_000);
    bench.client.set_rc(bench.now_us, &[1501]);
    bench.run(20_000);
    assert_eq!(
        bench.server.pending(),
        3,
        "one RC frame above it, no second one"
    );
}

#[test]
fn rc_is_not_sent_to_an_unknown_controller_nor_when_it_is_too_old() {
    let mut bench = Bench::new(Kind::Betaflight);
    bench.service_us = 50_000;
    bench.client.set_rc(bench.now_us, &[1500]);
    bench.run(1_000_000);
    assert_eq!(bench.client.statistics().rc_sent, 0);
    assert_eq!(bench.client.statistics().rc_expired, 1);
}

#[test]
fn rc_goes_on_at_10_hz_to_a_controller_that_cannot_be_heard() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.rc_period_us = Some(25_000);
    bench.is_mute = true;
    bench.run(1_000_000);
    bench.seen.clear();
    bench.run(5_000_000);
    assert!(matches!(bench.events.last(), Some(Event::Lost { .. })));
    let channels = bench
        .seen
        .iter()
        .filter(|request| request.command == command::SET_RAW_RC);
    assert!(channels.clone().count() >= 49, "{:?}", bench.served());
    assert!(
        channels
            .into_iter()
            .all(|request| request.parse::<SetRawRc>().unwrap().channels_us.len() == 5)
    );
    assert!(bench.max_pending <= 3);
}

#[test]
fn the_clock_of_the_caller_may_be_the_deadline() {
    let config = Config {
        fill_hz: 0,
        ..Config::default()
    };
    let mut bench = Bench::with_config(Kind::Betaflight, config);
    bench.run(500_000);
    bench.events.clear();
    let mut wakes = 0;
    let end_us = bench.now_us + 10_000_000;
    while bench.now_us < end_us {
        let deadline_us = bench.client.deadline_us().unwrap();
        assert!(
            deadline_us > bench.now_us,
            "nothing is left to do at {} but it says {deadline_us}",
            bench.now_us
        );
        // An immediate controller.
        bench.now_us = deadline_us;
        bench.service_us = 1;
        bench.step();
        while bench.server.pending() > 0 {
            bench.step();
        }
        wakes += 1;
    }
    // 40 batches, 5 status, 2 battery a second, most of them together.
    assert!((400..=700).contains(&wakes), "{wakes}");
    let replies = bench.replies();
    assert!(
        (399..=401).contains(&replies[&command::ATTITUDE]),
        "{replies:?}"
    );
}

#[test]
fn deadlines_lie_ahead_whatever_state_the_link_is_in() {
    for (is_dead, is_mute) in [(true, false), (false, true), (false, false)] {
        let mut bench = Bench::new(Kind::Inav);
        bench.is_dead = is_dead;
        bench.is_mute = is_mute;
        bench.client.request(command::RX_MAP, &[]).unwrap();
        for wake in 0..200 {
            if wake % 3 == 0 {
                bench.client.set_rc(bench.now_us, &[1500; 4]);
            }
            bench.step();
            let deadline_us = bench.client.deadline_us().unwrap();
            assert!(deadline_us > bench.now_us, "wake {wake}: {deadline_us}");
            assert!(
                deadline_us <= bench.now_us + 600_000,
                "wake {wake}: {deadline_us}"
            );
            bench.now_us = deadline_us.div_ceil(STEP_US) * STEP_US;
        }
    }
}

// ---- refusals, losses, one-off requests ----

#[test]
fn refused_batches_are_asked_one_by_one() {
    let mut bench = Bench::online(Kind::BetaflightWithoutBatch);
    bench.run(1_000_000);
    let replies = bench.replies();
    assert!(
        replies[&command::ATTITUDE] > 20 && replies[&command::RAW_IMU] > 20,
        "{replies:?}"
    );
    assert_eq!(bench.served().get(&command::MULTIPLE_MSP), None);
}

#[test]
fn a_refused_poll_is_reported_once_and_dropped() {
    let mut bench = Bench::online(Kind::Betaflight);
    let gps = Poll {
        command: command::RAW_GPS,
        interval_us: 100_000,
        priority: Priority::Slow,
    };
    bench
        .client
        .set_schedule(bench.now_us, &Schedule::from_iter([gps]));
    bench.run(2_000_000);
    let refusals = bench.events.iter().filter(|event| {
        **event
            == Event::Refused {
                command: command::RAW_GPS,
            }
    });
    assert_eq!(refusals.count(), 1);
}

#[test]
fn one_off_requests_go_in_order_and_survive_a_lost_answer() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.client.request(command::RX_MAP, &[]).unwrap();
    bench.client.request(command::EEPROM_WRITE, &[]).unwrap();
    bench.client.request(199, &[1, 2]).unwrap();
    bench.is_mute = true;
    bench.run(150_000);
    bench.is_mute = false;
    bench.run(1_500_000);
    let answers: Vec<String> = bench
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Reply {
                reply: Reply::RxMap(_),
                ..
            } => Some("map".into()),
            Event::Reply {
                reply: Reply::Ack { command },
                ..
            } => Some(command.to_string()),
            Event::Refused { command } => Some(format!("no {command}")),
            _ => None,
        })
        .collect();
    assert_eq!(answers, ["map", "250", "no 199"]);
    assert!(
        !bench
            .events
            .iter()
            .any(|event| matches!(event, Event::Lost { .. }))
    );
}

#[test]
fn a_one_off_request_is_sent_four_times_then_reported_unanswered() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.client.request(command::UID, &[]).unwrap();
    // Answers everything but this.
    for _ in 0..2000 {
        bench.run(STEP_US);
        let pending = std::iter::from_fn(|| bench.server.pop()).collect::<Vec<_>>();
        for request in pending {
            if request.command == command::UID {
                bench.seen.push(request);
            } else {
                answer(Kind::Betaflight, &mut bench.server, &request);
            }
        }
    }
    assert_eq!(bench.served()[&command::UID], 4);
    assert!(bench.events.contains(&Event::Unanswered {
        command: command::UID
    }));
}

#[test]
fn saving_may_take_seconds_without_a_loss() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.client.request(command::EEPROM_WRITE, &[]).unwrap();
    bench.run(13_000);
    bench.is_dead = true;
    bench.run(3_000_000);
    bench.is_dead = false;
    bench.run(1_000_000);
    assert!(
        !bench
            .events
            .iter()
            .any(|event| matches!(event, Event::Lost { .. })),
        "{:?}",
        bench.events
    );
    assert!(bench.client.is_online());
}

#[test]
fn a_restart_is_waited_for_and_ends_with_a_new_identification() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.client.request(command::REBOOT, &[]).unwrap();
    bench.run(40_000);
    assert!(bench.client.identity().is_none());
    bench.is_dead = true;
    bench.run(3_000_000);
    bench.is_dead = false;
    bench.run(2_000_000);
    assert!(
        !bench
            .events
            .iter()
            .any(|event| matches!(event, Event::Lost { .. })),
        "{:?}",
        bench.events
    );
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, Event::Identified(_)))
    );
}

#[test]
fn a_frame_cut_on_the_line_costs_one_answer() {
    let mut bench = Bench::online(Kind::Betaflight);
    bench.client.handle(bench.now_us, b"$M>\xf0\x6c"); // announces 240 bytes that never come
    bench.run(2_000_000);
    let statistics = bench.client.statistics();
    assert_eq!(statistics.bad_frames, 1, "{statistics:?}");
    assert!(statistics.timeouts <= 2, "{statistics:?}");
    assert!(bench.replies()[&command::ATTITUDE] >= 60);
}

#[test]
fn too_much_is_refused_at_the_door() {
    let mut client = Client::new(Config::default());
    let error = client.request(command::SET_NAME, &[0; 193]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "193 bytes for MSP_SET_NAME (11): flight controllers take 192"
    );
    for _ in 0..32 {
        client.request(command::UID, &[]).unwrap();
    }
    assert_eq!(
        client.request(command::UID, &[]),
        Err(RequestError::QueueFull {
            command: command::UID
        })
    );
}
