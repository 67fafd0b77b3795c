//! Links: greeting, numbering, floods, garbage, bounds.

use super::*;
use mavlink::MavlinkVersion;
use proptest::prelude::*;

#[test]
fn the_first_frame_on_a_new_link_is_the_heartbeat() {
    let mut bench = Bench::with_link();
    bench.run_for(500);
    let first = bench.on(A).next().unwrap();
    assert!(
        matches!(&first.message, Message::Raw(Raw::HEARTBEAT(h)) if h.autopilot == 12 && h.mavtype == 2)
    );
    assert_eq!(first.from, US);
    assert!(bench.texts(A)[0].starts_with("Kestrel "));
}

#[test]
fn sequence_numbers_run_without_a_gap_on_each_link() {
    let mut bench = Bench::with_link();
    bench.show(localized);
    bench.run_for(1_300);
    bench.link_up(B);
    bench.say(set("SYS_HITL", 1.0, 9));
    bench.run_for(3_000);
    for link in [A, B] {
        let numbers: Vec<u8> = bench.on(link).map(|f| f.sequence).collect();
        assert!(numbers.len() > 100 && numbers[0] == 0, "{}", numbers.len());
        assert!(numbers.windows(2).all(|w| w[1] == w[0].wrapping_add(1)));
    }
}

#[test]
fn garbage_makes_no_output_and_leaves_the_link_alive() {
    let mut bench = Bench::with_link();
    bench.heard.clear();
    let mut state = 1u32;
    for _ in 0..2_000 {
        let bytes: Vec<u8> = (0..300)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            })
            .collect();
        bench.ground.receive(bench.now, A, &bytes, true);
        assert!(bench.ground.poll().is_none());
    }
    bench.say(set("SYS_HITL", 1.0, 9));
    assert_eq!(bench.values(A).len(), 1);
    let stats = bench.ground.link_stats().next().unwrap();
    assert!(
        stats.received.noise_bytes > 100_000 && stats.received.frames == 1,
        "{stats:?}"
    );
}

#[test]
fn an_unknown_message_is_counted() {
    let mut bench = Bench::with_link();
    // A well-formed v2 frame of id 52000, which neither dialect knows.
    let frame = [0xFD, 2, 0, 0, 0, 255, 190, 0x20, 0xCB, 0, 1, 2, 0, 0];
    bench.ground.receive(bench.now, A, &frame, true);
    let stats = bench.ground.link_stats().next().unwrap();
    assert_eq!((stats.received.unknown_id, stats.received.frames), (1, 0));
}

#[test]
fn a_flood_of_requests_is_bounded_in_memory() {
    let mut bench = Bench::with_link();
    let mut bytes = Vec::new();
    for i in 0..20_000 {
        bytes.extend(bench.station.encode_message(&Message::Raw(set(
            "SYS_HITL",
            (i % 3) as f32 - 1.0,
            9,
        ))));
    }
    bench.ground.receive(bench.now, A, &bytes, false);
    assert!(bench.ground.queue.len() <= 4_096);
    assert!(bench.ground.requests.len() <= MAX_REQUESTS);
    assert_eq!(
        bench.ground.documents.len(),
        1,
        "one file, its newest state"
    );
    let counters = bench.ground.counters();
    assert_eq!(counters.router.for_us + counters.router.flooded, 20_000);
    assert!(counters.router.flooded >= 18_000);
}

#[test]
fn a_shell_that_does_not_poll_loses_the_oldest_telemetry_and_no_answer() {
    let mut bench = Bench::with_link();
    bench.show(localized);
    for ms in 0..60_000 {
        bench.ground.tick(Timestamp::from_ms(ms));
    }
    bench.now = Timestamp::from_ms(60_000);
    assert!(bench.ground.queue.len() <= 4_096);
    assert!(bench.ground.counters().dropped_telemetry > 1_000);
    assert_eq!(bench.ground.counters().dropped_answers, 0);
    bench.heard.clear();
    bench.collect();
    assert_eq!(
        bench.count_of(A, 0),
        59,
        "every heartbeat but the one at zero, which was taken"
    );
    let newest = bench.on(A).filter_map(|f| match &f.message {
        Message::Standard(Std::SYSTEM_TIME(t)) => Some(t.time_boot_ms),
        _ => None,
    });
    assert!(newest.max().is_some_and(|ms| ms > 58_000));
}

#[test]
fn own_echoes_and_messages_for_others_do_nothing() {
    let mut bench = Bench::with_link();
    let mut loop_back = Encoder::new(US);
    let bytes = loop_back.encode_message(&set("SYS_HITL", 1.0, 9).into());
    bench.ground.receive(bench.now, A, &bytes, true);
    let elsewhere = raw::PARAM_SET_DATA {
        target_system: 2,
        param_id: "SYS_HITL".into(),
        param_type: 9,
        ..Default::default()
    };
    bench.say(Raw::PARAM_SET(elsewhere));
    assert_eq!(bench.values(A).len(), 0);
    let counters = bench.ground.counters().router;
    assert_eq!((counters.echoes, counters.not_for_us), (1, 1));
}

#[test]
fn the_presence_of_ground_stations_is_passed_on_twice_a_second_at_most() {
    let mut bench = Bench::with_link();
    for _ in 0..100 {
        bench.say(Raw::HEARTBEAT(raw::HEARTBEAT_DATA {
            mavtype: 6,
            ..Default::default()
        }));
        bench.say(Raw::HEARTBEAT(raw::HEARTBEAT_DATA {
            mavtype: 18,
            ..Default::default()
        }));
        bench.run_for(100);
    }
    let beats = bench
        .requests
        .iter()
        .filter(|a| a.request == Request::GroundHeartbeat)
        .count();
    assert_eq!(beats, 20);
    assert!(bench.ground.link_stats().next().unwrap().peers[0].is_ground_station);
}

#[test]
fn links_are_bounded_and_a_closed_one_is_silent() {
    let mut bench = Bench::new();
    for i in 0..32 {
        assert!(bench.ground.link_up(bench.now, LinkId(i)));
    }
    assert!(!bench.ground.link_up(bench.now, LinkId(99)));
    bench.ground.link_down(LinkId(5));
    assert!(bench.ground.link_up(bench.now, LinkId(99)));
    bench.run_for(1_000);
    assert_eq!(bench.on(LinkId(5)).count(), 0);
    assert!(bench.on(LinkId(99)).count() > 10);
    bench.ground.receive(bench.now, LinkId(5), &[0xFD; 9], true);
    assert_eq!(
        bench.ground.counters().stray_bytes,
        9,
        "there is no room for it again"
    );
}

#[test]
fn bytes_on_a_link_that_was_not_announced_bring_it_up() {
    let mut bench = Bench::new();
    bench.say(set("SYS_HITL", 1.0, 9));
    assert_eq!(bench.on(A).next().map(|f| f.message.id()), Some(0));
    assert_eq!(bench.values(A).len(), 1);
}

fn any_message() -> impl Strategy<Value = Option<Message>> {
    let mut ids: Vec<u32> = Std::all_ids().to_vec();
    // What services serve comes as raw twins: half of the messages are of those.
    for _ in 0..ids.len() / Raw::all_ids().len() {
        ids.extend_from_slice(Raw::all_ids());
    }
    (
        prop::sample::select(ids),
        prop::collection::vec(any::<u8>(), 0..255),
    )
        .prop_map(|(id, payload)| Message::parse(MavlinkVersion::V2, id, &payload).ok())
}

proptest! {
    #[test]
    fn no_well_formed_message_does_harm(messages in prop::collection::vec(any_message(), 1..100)) {
        let mut bench = Bench::with_link();
        bench.show(localized);
        for message in messages.into_iter().flatten() {
            bench.say(message);
            bench.run_for(7);
            prop_assert!(bench.ground.deadline() > bench.now);
        }
        bench.heard.clear();
        bench.run_for(1_000);
        prop_assert_eq!(bench.count_of(A, 0), 1, "the heart beats on");
    }
}

#[test]
fn a_signed_link_hears_only_who_knows_its_key_and_signs_what_it_says() {
    use crate::gcs::signing;
    use mavlink_dialect::signing::{SigningKey, SigningState};
    let key = SigningKey::from_passphrase("hangar");
    let (signed, open) = (LinkId::of(1, 1), LinkId::of(0, 1));
    let mut bench = Bench::new();
    let signed_policy = LinkPolicy {
        key: Some(key.clone()),
        ..LinkPolicy::default()
    };
    bench
        .ground
        .set_policies(vec![LinkPolicy::default(), signed_policy]);
    bench.link_up(signed);
    bench.link_up(open);
    let asks = |bench: &mut Bench, link, bytes: &[u8]| {
        bench.requests.clear();
        bench.ground.receive(bench.now, link, bytes, true);
        bench.collect();
        bench.requests.len()
    };
    let arm: Message = Raw::COMMAND_LONG(raw::COMMAND_LONG_DATA {
        command: 400,
        param1: 1.0,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    })
    .into();
    let mut state = SigningState::new(0);
    state.set_utc(1_800_000_000_000_000);
    let mut encoder = Encoder::new(GCS);
    let plain = encoder.encode_message(&arm);
    assert_eq!(asks(&mut bench, signed, &plain), 0, "unsigned");
    let foreign = encoder.encode_signed(&arm, &SigningKey::from_passphrase("x"), 1, state.stamp());
    assert_eq!(asks(&mut bench, signed, &foreign), 0, "wrong key");
    let good = encoder.encode_signed(&arm, &key, 1, state.stamp());
    assert_eq!(asks(&mut bench, signed, &good), 1, "signed");
    assert_eq!(asks(&mut bench, signed, &good), 0, "replayed");
    assert_eq!(
        asks(&mut bench, LinkId::of(1, 2), &good),
        0,
        "replayed on another link of the endpoint"
    );
    bench.ground.link_down(LinkId::of(1, 2));
    assert_eq!(bench.ground.counters().rejected_signatures, 4);
    assert_eq!(
        asks(&mut bench, open, &plain),
        0,
        "a repeat while the first one runs"
    );
    bench.run_for(2_000);
    let unsigned = bench.on(signed).find(|f| !f.is_signed);
    assert_eq!(unsigned, None);
    assert!(bench.on(signed).count() > 5);
    assert!(bench.on(open).all(|f| !f.is_signed));
    assert!(bench.documents.iter().any(|d| d.name == signing::DOCUMENT));
    // SETUP_SIGNING gives a key to links without one of their own.
    let setup: Message = Std::SETUP_SIGNING(standard::SETUP_SIGNING_DATA {
        target_system: 1,
        target_component: 1,
        secret_key: [9; 32],
        ..Default::default()
    })
    .into();
    let setup = encoder.encode_signed(&setup, &key, 1, state.stamp());
    bench.ground.receive(bench.now, signed, &setup, true);
    bench.collect();
    let good = encoder.encode_signed(&arm, &key, 1, state.stamp());
    bench.run_for(12_000);
    assert_eq!(
        asks(&mut bench, signed, &good),
        1,
        "the old key still holds"
    );
}
