//! Roles, control, a component behind us, a radio that is full: over real bytes.

use super::*;
use crate::gcs::access::{LinkPolicy, Role};
use crate::gcs::camera::VideoStream;

const CAMERA: Address = Address {
    system: 1,
    component: 154,
};

fn guarded() -> Bench {
    let mut bench = Bench::new();
    let policy = |url: &str| LinkPolicy {
        url: url.to_owned(),
        ..LinkPolicy::default()
    };
    bench.ground.set_policies(vec![
        policy("udpserver://0.0.0.0:14555"),
        LinkPolicy {
            is_routed: true,
            ..policy("udpserver://127.0.0.1:14600")
        },
        LinkPolicy {
            role: Some(Role::Pilot),
            ..policy("tcpserver://0.0.0.0:5760")
        },
    ]);
    bench
}

fn arm() -> Raw {
    Raw::COMMAND_LONG(raw::COMMAND_LONG_DATA {
        command: 400,
        param1: 1.0,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    })
}

#[test]
fn a_peer_on_another_machine_watches_reads_and_may_press_stop() {
    let mut bench = guarded();
    let remote = LinkId::of(0, 1).remote();
    bench.link_up(remote);
    bench.say_on(remote, arm());
    bench.say_on(remote, set("MIS_TAKEOFF_ALT", 2.0, 9));
    bench.say_on(remote, request_list());
    bench.run_for(1_500);
    assert!(bench.requests.is_empty(), "{:?}", bench.requests);
    let acks = |bench: &Bench| -> Vec<(u16, u8)> {
        bench
            .on(remote)
            .filter_map(|f| match &f.message {
                Message::Raw(Raw::COMMAND_ACK(a)) => Some((a.command, a.result)),
                _ => None,
            })
            .collect()
    };
    assert_eq!(acks(&bench), [(400, result::DENIED)]);
    assert!(bench.values(remote).len() > 80, "it may read");
    let told = bench.texts(remote).concat();
    assert!(
        told.contains("--mavlink 'udpserver://0.0.0.0:14555?role=pilot'"),
        "{told}"
    );
    assert!(
        told.contains("'udpserver://0.0.0.0:14555?role=engineer'"),
        "{told}"
    );
    let stop = raw::COMMAND_LONG_DATA {
        command: 193,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    };
    bench.say_on(remote, Raw::COMMAND_LONG(stop));
    assert_eq!(bench.requests.pop().map(|a| a.request), Some(Request::Stop));
    // Mode Hold of a viewer is STOP too, in the old form as well.
    let hold = raw::SET_MODE_DATA {
        target_system: 1,
        base_mode: 1,
        custom_mode: 4 << 16 | 3 << 24,
    };
    bench.say_on(remote, Raw::SET_MODE(hold));
    assert_eq!(bench.requests.pop().map(|a| a.request), Some(Request::Stop));
}

#[test]
fn a_pilot_flies_and_does_not_change_parameters() {
    let mut bench = guarded();
    let remote = LinkId::of(2, 1).remote();
    bench.link_up(remote);
    bench.say_on(remote, arm());
    assert!(matches!(
        bench.requests.pop().map(|a| a.request),
        Some(Request::Arm { .. })
    ));
    let before = bench.ground.settings().autopilot.takeoff_height_m;
    bench.say_on(remote, set("MIS_TAKEOFF_ALT", 2.0, 9));
    assert!(bench.requests.is_empty());
    assert!((bench.ground.settings().autopilot.takeoff_height_m - before).abs() < 1e-9);
    assert_eq!(bench.values(remote).len(), 1, "the old value comes back");
    let local = LinkId::of(0, 2);
    bench.link_up(local);
    bench.say_on(local, set("MIS_TAKEOFF_ALT", 2.0, 9));
    assert!((bench.ground.settings().autopilot.takeoff_height_m - 2.0).abs() < 1e-9);
}

#[test]
fn in_exclusive_control_only_the_owner_commands_and_anybody_stops() {
    let mut bench = guarded();
    let (a, b) = (LinkId::of(0, 1), LinkId::of(0, 2));
    bench.link_up(a);
    bench.link_up(b);
    bench.say_on(a, set("CTRL_POLICY", 1.0, 9));
    bench.requests.clear();
    bench.say_on(a, arm());
    assert!(bench.requests.is_empty(), "nobody is in control");
    let ask = raw::COMMAND_LONG_DATA {
        command: 32_100,
        param1: 1.0,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    };
    bench.say_on(a, Raw::COMMAND_LONG(ask));
    bench.say_on(a, arm());
    assert_eq!(bench.requests.len(), 1);
    bench.requests.clear();
    bench.heard.clear();
    let mut other = Encoder::new(Address {
        system: 254,
        component: 190,
    });
    let bytes = other.encode_message(&arm().into());
    bench.ground.receive(bench.now, b, &bytes, true);
    bench.collect();
    assert!(bench.requests.is_empty());
    let refused = bench.on(b).any(|f| {
        matches!(&f.message, Message::Raw(Raw::COMMAND_ACK(k)) if k.result == result::NOT_IN_CONTROL && k.target_system == 254)
    });
    assert!(refused);
    let stop = raw::COMMAND_LONG_DATA {
        command: 17,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    };
    let bytes = other.encode_message(&Raw::COMMAND_LONG(stop).into());
    bench.ground.receive(bench.now, b, &bytes, true);
    bench.collect();
    assert_eq!(bench.requests.pop().map(|a| a.request), Some(Request::Stop));
    bench.heard.clear();
    bench.run_for(2_500);
    let says: Vec<u8> = bench
        .on(b)
        .filter_map(|f| match &f.message {
            Message::Standard(Std::CONTROL_STATUS(s)) => Some(s.gcs_main),
            _ => None,
        })
        .collect();
    assert!(
        says.len() >= 2 && says.iter().all(|m| *m == 255),
        "{says:?}"
    );
}

#[test]
fn a_component_behind_us_is_seen_from_the_ground_and_commanded() {
    let mut bench = guarded();
    let (ground, behind, watcher) = (
        LinkId::of(0, 1),
        LinkId::of(1, 1),
        LinkId::of(0, 2).remote(),
    );
    for link in [ground, behind, watcher] {
        bench.link_up(link);
    }
    let mut camera = Encoder::new(CAMERA);
    let beat = Message::Raw(Raw::HEARTBEAT(raw::HEARTBEAT_DATA {
        mavtype: 26,
        ..Default::default()
    }));
    bench.heard.clear();
    let bytes = camera.encode_message(&beat);
    bench.ground.receive(bench.now, behind, &bytes, true);
    bench.collect();
    for link in [ground, watcher] {
        assert_eq!(bench.on(link).filter(|f| f.from == CAMERA).count(), 1);
    }
    assert_eq!(bench.on(behind).filter(|f| f.from == CAMERA).count(), 0);
    // A command by name goes there and nowhere else; the answer comes back; a viewer's does not pass.
    let zoom = raw::COMMAND_LONG_DATA {
        command: 531,
        target_system: 1,
        target_component: CAMERA.component,
        ..Default::default()
    };
    let commands = |bench: &Bench, link| {
        bench
            .on(link)
            .filter(|f| matches!(&f.message, Message::Raw(Raw::COMMAND_LONG(c)) if c.target_component == 154))
            .count()
    };
    bench.say_on(ground, Raw::COMMAND_LONG(zoom.clone()));
    assert_eq!(
        (commands(&bench, behind), commands(&bench, watcher)),
        (1, 0)
    );
    let snap = raw::COMMAND_LONG_DATA {
        command: 2000,
        ..zoom
    };
    bench.say_on(watcher, Raw::COMMAND_LONG(snap));
    assert_eq!(commands(&bench, behind), 1, "a viewer takes no pictures");
    let ack = Raw::COMMAND_ACK(raw::COMMAND_ACK_DATA {
        command: 531,
        target_system: 255,
        target_component: 190,
        ..Default::default()
    });
    bench.heard.clear();
    let bytes = camera.encode_message(&ack.into());
    bench.ground.receive(bench.now, behind, &bytes, true);
    bench.collect();
    assert_eq!(bench.on(ground).filter(|f| f.from == CAMERA).count(), 1);
    // Stations do not hear each other: only routed links join in.
    bench.heard.clear();
    bench.say_on(ground, beat.clone());
    assert_eq!(bench.on(watcher).filter(|f| f.from == GCS).count(), 0);
    assert_eq!(bench.on(behind).filter(|f| f.from == GCS).count(), 1);
}

#[test]
fn a_full_radio_halves_telemetry_and_leaves_commands_alone() {
    let mut bench = Bench::with_link();
    bench.link_up(B);
    bench.show(localized);
    let rate = |bench: &mut Bench, link| {
        bench.heard.clear();
        bench.run_for(4_000);
        bench.count_of(link, 30) as f64 / 4.0
    };
    let before = rate(&mut bench, A);
    let radio = standard::RADIO_STATUS_DATA {
        txbuf: 10,
        ..Default::default()
    };
    bench.say(Std::RADIO_STATUS(radio));
    let after = rate(&mut bench, A);
    let (alone, beats) = (bench.count_of(B, 30), bench.count_of(A, 0));
    assert!(
        (before - 20.0).abs() < 0.6 && (after - 10.0).abs() < 0.6,
        "{before} {after}"
    );
    assert!((75..=81).contains(&alone), "{alone}");
    assert!((4..=5).contains(&beats), "{beats}");
    bench.command(512, 148.0, 0.0);
    assert_eq!(bench.acks(), [(512, result::ACCEPTED)]);
}

#[test]
fn a_budget_in_the_url_is_kept() {
    let mut bench = Bench::new();
    bench.ground.set_policies(vec![LinkPolicy {
        rate_bytes_per_s: Some(1_500.0),
        ..LinkPolicy::default()
    }]);
    let link = LinkId::of(0, 1);
    bench.link_up(link);
    bench.show(localized);
    bench.run_for(8_000);
    let bytes = |bench: &Bench| -> usize {
        let mut payload = [0u8; 255];
        bench
            .on(link)
            .map(|f| 12 + f.message.write_payload(&mut payload))
            .sum()
    };
    bench.heard.clear();
    bench.run_for(10_000);
    let rate = bytes(&bench) as f64 / 10.0;
    assert!((900.0..=1_650.0).contains(&rate), "{rate} B/s");
}

#[test]
fn the_camera_beats_every_two_seconds_just_before_the_autopilot() {
    let mut bench = Bench::new();
    let stream = VideoStream::parse("rtsp://10.0.0.5/front").unwrap();
    bench.ground.set_video(Some(stream));
    bench.link_up(A);
    bench.run_for(10_050);
    let beats: Vec<(Timestamp, u8)> = bench
        .heard
        .iter()
        .filter(|(_, _, f)| f.message.id() == 0)
        .map(|(at, _, f)| (*at, f.from.component))
        .collect();
    let cameras: Vec<usize> = (0..beats.len()).filter(|i| beats[*i].1 == 100).collect();
    assert!((3..=4).contains(&cameras.len()), "{beats:?}");
    for i in cameras {
        assert!(beats[i].0 >= Timestamp::from_ms(3_000));
        assert_eq!(
            beats[i + 1],
            (beats[i].0, 1),
            "the autopilot's follows at once"
        );
    }
}

#[test]
fn data_streams_are_set_by_group_and_stopped() {
    let mut bench = Bench::with_link();
    bench.show(localized);
    let ask = |group: u8, hz: u16, start: u8| {
        Raw::REQUEST_DATA_STREAM(raw::REQUEST_DATA_STREAM_DATA {
            req_message_rate: hz,
            target_system: 1,
            target_component: 1,
            req_stream_id: group,
            start_stop: start,
        })
    };
    bench.say(ask(10, 5, 1));
    bench.heard.clear();
    bench.run_for(4_000);
    assert!(
        (19..=21).contains(&bench.count_of(A, 30)),
        "{}",
        bench.count_of(A, 30)
    );
    assert!(
        (79..=81).contains(&bench.count_of(A, 32)),
        "another group stays"
    );
    bench.say(ask(0, 4, 0));
    bench.heard.clear();
    bench.run_for(2_000);
    assert_eq!((bench.count_of(A, 30), bench.count_of(A, 32)), (0, 0));
    assert_eq!(bench.count_of(A, 0), 2, "the heart beats on");
    bench.say(ask(255, 1000, 1));
    bench.say(ask(6, u16::MAX, 1));
    bench.heard.clear();
    bench.run_for(1_000);
    assert!(bench.count_of(A, 32) <= 51, "nothing faster than 50 Hz");
}
