//! Handshakes and small services.

use super::*;
use crate::gcs::disk::DiskReply;
use crate::gcs::metadata;

#[test]
fn qgroundcontrol_connects() {
    let mut bench = Bench::with_link();
    bench.show(localized);
    let beat = raw::HEARTBEAT_DATA {
        mavtype: 6,
        autopilot: 8,
        ..Default::default()
    };
    bench.say(Raw::HEARTBEAT(beat));
    assert!(
        bench
            .requests
            .iter()
            .any(|a| a.request == Request::GroundHeartbeat)
    );
    bench.command(512, 148.0, 0.0);
    assert!(bench.on(A).any(
        |f| matches!(&f.message, Message::Raw(Raw::AUTOPILOT_VERSION(v))
        if v.capabilities == CAPABILITIES && v.flight_sw_version == 0x010F_0000 && v.uid != 0)
    ));
    bench.command(512, 435.0, 0.0);
    let modes: Vec<_> = bench
        .on(A)
        .filter_map(|f| match &f.message {
            Message::Standard(Std::AVAILABLE_MODES(m)) => Some((m.mode_index, m.number_modes)),
            _ => None,
        })
        .collect();
    assert_eq!(modes, (1..=9).map(|i| (i, 9)).collect::<Vec<_>>());
    bench.command(512, 397.0, 0.0);
    let metadata = bench.on(A).find_map(|f| match &f.message {
        Message::Standard(Std::COMPONENT_METADATA(m)) => {
            Some((m.file_crc, m.uri.to_str().unwrap().to_owned()))
        }
        _ => None,
    });
    let (crc, uri) = metadata.expect("COMPONENT_METADATA");
    assert_eq!(
        (crc, uri.as_str()),
        (metadata::general_crc(), "mftp:///general.json.xz")
    );
    bench.command(512, 395.0, 0.0);
    assert_eq!(bench.acks(), [(512, 0), (512, 0), (512, 0), (512, 3)]);
    let hash_check = standard::PARAM_REQUEST_READ_DATA {
        param_index: -1,
        target_system: 1,
        target_component: 1,
        param_id: "_HASH_CHECK".into(),
    };
    bench.say(Std::PARAM_REQUEST_READ(hash_check));
    bench.say(request_list());
    bench.run_for(2_000);
    assert_eq!(bench.values(A).len(), bench.ground.settings().count());
    for mission_type in 0..3 {
        let list = raw::MISSION_REQUEST_LIST_DATA {
            target_system: 1,
            target_component: 1,
            mission_type,
        };
        bench.say(Raw::MISSION_REQUEST_LIST(list));
    }
    assert_eq!(bench.count_of(A, 44), 3, "MISSION_COUNT even for nothing");
    bench.command(512, 242.0, 0.0);
    assert_eq!(bench.acks().last(), Some(&(512, 0)));
    bench.command(512, 435.0, 3.0);
    bench.command(512, 435.0, 10.0);
    assert_eq!(bench.acks().last(), Some(&(512, 2)));
    bench.command(65_000, 0.0, 0.0);
    assert_eq!(bench.acks().last(), Some(&(65_000, 3)));
}

#[test]
fn clocks_files_and_logs_are_answered_on_the_link_that_asked() {
    let mut bench = Bench::with_link();
    bench.link_up(B);
    bench.run_for(1_000);
    bench.heard.clear();
    bench.say(Std::TIMESYNC(standard::TIMESYNC_DATA {
        tc1: 0,
        ts1: 77,
        ..Default::default()
    }));
    bench.say(Std::TIMESYNC(standard::TIMESYNC_DATA {
        tc1: 5,
        ts1: 78,
        ..Default::default()
    }));
    let mut payload = [0u8; 251];
    payload[..4].copy_from_slice(&[0xFF, 0xFF, 3, 4]);
    bench.say(Std::FILE_TRANSFER_PROTOCOL(
        standard::FILE_TRANSFER_PROTOCOL_DATA {
            target_network: 0,
            target_system: 1,
            target_component: 1,
            payload,
        },
    ));
    bench.say(Std::LOG_REQUEST_LIST(standard::LOG_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 1,
        start: 0,
        end: 0xFFFF,
    }));
    let (ticket, _) = bench
        .jobs
        .pop()
        .expect("the list of logs is asked of the disk");
    bench.ground.disk(bench.now, ticket, &DiskReply::NotFound);
    bench.collect();
    let said: Vec<_> = bench.on(A).map(|f| f.message.clone()).collect();
    assert_eq!(bench.on(B).count(), 0);
    assert_eq!(said.len(), 3, "{said:?}");
    assert!(
        matches!(&said[0], Message::Standard(Std::TIMESYNC(t)) if t.tc1 == 1_000_000_000 && t.ts1 == 77)
    );
    assert!(
        matches!(&said[1], Message::Standard(Std::FILE_TRANSFER_PROTOCOL(m))
        if m.payload[..6] == [0, 0, 3, 129, 1, 4] && m.payload[12] == 10 && m.target_system == 255)
    );
    assert!(matches!(&said[2], Message::Standard(Std::LOG_ENTRY(e)) if e.num_logs == 0));
}

#[test]
#[expect(
    deprecated,
    reason = "stations still send PING and SET_GPS_GLOBAL_ORIGIN"
)]
fn the_origin_moves_while_disarmed_and_is_echoed_exactly() {
    let mut bench = Bench::with_link();
    bench.say(Std::PING(standard::PING_DATA {
        time_usec: 9,
        seq: 4,
        ..Default::default()
    }));
    assert!(bench.on(A).any(|f| matches!(&f.message, Message::Standard(Std::PING(p)) if p.seq == 4 && p.target_system == 255)));
    let to = |latitude| {
        Std::SET_GPS_GLOBAL_ORIGIN(standard::SET_GPS_GLOBAL_ORIGIN_DATA {
            latitude,
            longitude: 85_000_001,
            altitude: 123_456,
            target_system: 1,
            ..Default::default()
        })
    };
    let last = |bench: &Bench| {
        let origin = |f: &Frame| match &f.message {
            Message::Standard(Std::GPS_GLOBAL_ORIGIN(o)) => {
                Some((o.latitude, o.longitude, o.altitude))
            }
            _ => None,
        };
        bench.on(A).filter_map(origin).last().unwrap()
    };
    bench.say(to(470_000_003));
    assert_eq!(last(&bench), (470_000_003, 85_000_001, 123_456));
    assert_eq!(bench.ground.settings().ground.lat0_e7, 470_000_003);
    bench.show(|s| s.is_armed = true);
    bench.say(to(1));
    assert_eq!(last(&bench), (470_000_003, 85_000_001, 123_456));
    assert_eq!(
        bench.texts(A).last().map(String::as_str),
        Some("origin not moved: disarm first")
    );
}

#[test]
fn long_notices_are_joined_from_their_chunks() {
    let mut bench = Bench::with_link();
    let long =
        "the quick brown fox jumps over the lazy dog while the kestrel hovers above them both";
    bench.ground.say(bench.now, Severity::Warning, long);
    bench
        .ground
        .event(bench.now, &Event::Notice(Notice::WayBlocked));
    bench.collect();
    let texts = bench.texts(A);
    assert_eq!(format!("{}{}", texts[1], texts[2]), long);
    assert_eq!(texts[3], "Way blocked: looking for another");
    let kept: Vec<_> = bench.ground.texts().map(|t| t.text.clone()).collect();
    assert_eq!(kept, [long, "Way blocked: looking for another"]);
}

#[test]
fn an_answer_that_nobody_waits_for_is_dropped() {
    let mut bench = Bench::with_link();
    bench.heard.clear();
    let answer = Answer {
        id: RequestId(999),
        station: Station::default(),
        outcome: Outcome::Accepted,
    };
    bench.ground.answer(bench.now, &answer);
    bench.collect();
    assert_eq!(bench.heard.len(), 0);
}
