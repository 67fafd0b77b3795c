//! Client against a scripted controller on virtual time.

mod bench;
mod rates;
mod requests;

use super::*;
use crate::firmware::{Firmware, box_id};
use crate::message::multiple::{MultipleRequest, push_reply};
use crate::message::{
    Altitude, ApiVersion, Attitude, BatteryState, BoardInfo, BoxIds, FcVariant, FcVersion, Ident,
    InavAnalog, InavStatus, RawImu, Reboot, RxMap, SetRawRc, StatusEx,
};
use crate::server::{Request, Server};
use bench::*;
use std::collections::BTreeMap;

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
