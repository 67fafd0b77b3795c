//! The mission protocol against scripted stations on links that lose, repeat and reorder.

mod items;
mod points;
mod stations;

use super::super::bench::{Bench, Dice, answer, station};
use super::*;
use crate::autopilot::door::{Asked, MissionState, MissionStatus, Refusal};
use proptest::prelude::*;
use raw::MavMessage as M;
use stations::*;
use vehicle::FloorPlan;
use vehicle::floor_plan::Cell;

#[test]
fn plans_go_up_and_come_back_bit_for_bit_whatever_the_link_loses() {
    for (loss, seeds, n) in [(0.0, 5, 60), (0.1, 30, 40), (0.3, 60, 25)] {
        for seed in 0..seeds {
            let weather = Weather {
                loss,
                repeat: 0.1,
                jitter_ms: 80.0,
            };
            let mut vehicle = Vehicle::new(None);
            let mut up = PatientUploader::new(route(n));
            let (result, _) = converse(&mut vehicle, &mut up, weather, seed);
            assert_eq!(result, Ok(()), "upload, loss {loss}, seed {seed}");
            assert_eq!(
                bytes(vehicle.service.items()),
                bytes(&up.items),
                "loss {loss}, seed {seed}"
            );
            assert_eq!(
                vehicle.plans.last().map(|p| p.items.len()),
                Some(usize::from(n))
            );
            let mut down = Downloader::default();
            let (result, _) = converse(&mut vehicle, &mut down, weather, seed + 1000);
            assert_eq!(result, Ok(()), "download, loss {loss}, seed {seed}");
            assert_eq!(
                bytes(&down.got),
                bytes(&up.items),
                "loss {loss}, seed {seed}"
            );
        }
    }
}

#[test]
fn plans_of_every_size_survive_every_weather() {
    const RUNS: u64 = 20;
    println!(
        "FIGURES missions up and down, {RUNS} runs a cell, reordered and repeated: identical, longest s"
    );
    for n in [2u16, 50, 500] {
        for loss in [0.0, 0.1, 0.3] {
            let weather = Weather {
                loss,
                repeat: 0.1,
                jitter_ms: 60.0,
            };
            let (mut same, mut longest) = (0, 0f64);
            for seed in 0..RUNS {
                let mut vehicle = Vehicle::new(None);
                let mut up = PatientUploader::new(route(n));
                let (sent, up_s) = converse(&mut vehicle, &mut up, weather, 31 * seed + 7);
                let mut down = Downloader::default();
                let (got, down_s) = converse(&mut vehicle, &mut down, weather, 57 * seed + 3);
                let is_same = bytes(&down.got) == bytes(&up.items);
                same += u64::from(sent.is_ok() && got.is_ok() && is_same);
                longest = longest.max(up_s).max(down_s);
            }
            println!(
                "{n} items, loss {:.0} %: {same} of {RUNS}, {longest:.1}",
                100.0 * loss
            );
            let least = if loss < 0.2 { RUNS } else { RUNS - RUNS / 20 };
            assert!(same >= least, "{n} items, loss {loss}: {same} of {RUNS}");
        }
    }
    println!("END");
}

#[test]
fn five_hundred_items_go_up_quickly_over_a_good_link() {
    let mut vehicle = Vehicle::new(None);
    let weather = Weather {
        loss: 0.0,
        repeat: 0.0,
        jitter_ms: 2.0,
    };
    let (result, seconds) = converse(
        &mut vehicle,
        &mut PatientUploader::new(route(500)),
        weather,
        1,
    );
    assert_eq!(result, Ok(()));
    assert!(
        seconds < 8.0,
        "{seconds} s for 500 items at 5 ms a step each way"
    );
}

#[test]
fn a_station_that_steps_back_on_late_requests_is_followed() {
    for (loss, repeat, seeds) in [(0.0, 0.3, 40), (0.1, 0.1, 60)] {
        for seed in 0..seeds {
            let weather = Weather {
                loss,
                repeat,
                jitter_ms: 60.0,
            };
            let mut vehicle = Vehicle::new(None);
            let mut up = StepBackUploader::new(route(20));
            let (result, seconds) = converse(&mut vehicle, &mut up, weather, seed);
            assert_eq!(
                result,
                Ok(()),
                "loss {loss}, repeat {repeat}, seed {seed}, {seconds} s"
            );
            assert_eq!(bytes(vehicle.service.items()), bytes(&up.items));
        }
    }
}

#[test]
fn while_one_station_uploads_another_is_denied_and_reads_the_old_plan() {
    let mut v = Vehicle::new(None);
    assert_eq!(v.upload(A, &route(3)), 0);
    let old = v.service.items().to_vec();
    v.take(A, count(5));
    v.said();
    for m in [count(2), count(0), clear(0), clear(255)] {
        v.take(B, m);
        assert_eq!(v.acks(), [(250, mission_result::DENIED)]);
    }
    v.take(A, int(&waypoint(0, 9.0, 9.0)));
    v.said();
    v.take(B, int(&waypoint(1, 7.0, 7.0)));
    assert!(
        v.said().is_empty(),
        "items of a station that does not upload are nothing"
    );
    v.take(B, list(0));
    v.take(B, request(0));
    match &v.said()[..] {
        [M::MISSION_COUNT(c), M::MISSION_ITEM_INT(i)] => {
            assert_eq!((c.count, c.target_system), (3, 250));
            assert_eq!(MissionItem::from_int(i).bytes(), old[0].bytes());
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_plan_that_changes_while_it_is_read_is_read_to_its_end_as_it_was() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    v.take(B, list(0));
    let replacement: Vec<_> = (0..2).map(|seq| waypoint(seq, 5.0, 5.0)).collect();
    assert_eq!(v.upload(A, &replacement), 0);
    v.said();
    v.take(B, request(2));
    assert!(matches!(&v.said()[..], [M::MISSION_ITEM_INT(i)] if i.x == 10_200));
    v.take(B, list(0));
    assert!(matches!(&v.said()[..], [M::MISSION_COUNT(c)] if c.count == 2));
    v.take(B, request(2));
    assert_eq!(v.acks(), [(250, mission_result::INVALID_SEQUENCE)]);
}

#[test]
fn an_abandoned_upload_keeps_the_old_plan() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    let id = v.service.plan_ids().mission;
    v.take(A, count(4));
    v.take(A, int(&waypoint(0, 4.0, 4.0)));
    for _ in 0..501 {
        v.tick(10);
    }
    assert!(
        v.out
            .said()
            .iter()
            .any(|(_, t)| t == "Mission upload abandoned at item 1 of 4")
    );
    assert_eq!(
        (v.service.plan_ids().mission, v.service.items().len()),
        (id, 3)
    );
    assert_eq!(v.plans.len(), 1, "the vehicle was told nothing");
    assert_eq!(v.upload(B, &route(2)), 0, "and the next station is served");
}

#[test]
fn a_cancelled_upload_keeps_the_old_plan() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    v.take(A, count(4));
    v.take(
        A,
        M::MISSION_ACK(raw::MISSION_ACK_DATA {
            mavtype: 15,
            ..Default::default()
        }),
    );
    v.said();
    v.tick(300);
    assert!(v.said().is_empty(), "nothing more is asked for");
    assert_eq!(v.service.items().len(), 3);
}

#[test]
fn the_final_ack_is_said_three_times_unless_the_station_goes_on() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(1));
    let mut at = Vec::new();
    for i in 1..=200u64 {
        v.tick(10);
        if !v.acks().is_empty() {
            at.push(i * 10);
        }
    }
    assert_eq!(at, [300, 900]);
    v.take(A, int(&route(1)[0]));
    assert_eq!(v.acks(), [(245, 0)], "the last item again: its ACK again");

    v.upload(A, &route(1));
    v.take(A, list(0));
    v.said();
    v.tick(1000);
    assert!(v.acks().is_empty(), "the station went on");
}

#[test]
fn a_refused_item_names_its_fault_and_keeps_the_old_plan() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    let wrong = |change: fn(&mut MissionItem)| {
        let mut items = route(2);
        change(&mut items[1]);
        items
    };
    for (items, result) in [
        (wrong(|i| i.command = 209), mission_result::UNSUPPORTED),
        (wrong(|i| i.frame = 10), mission_result::UNSUPPORTED_FRAME),
        (wrong(|i| i.z = f32::NAN), mission_result::INVALID_PARAM7),
        (
            wrong(|i| i.params[3] = f32::INFINITY),
            mission_result::INVALID_PARAM1 + 3,
        ),
        (
            wrong(|i| (i.command, i.params) = (177, [7.0, 1.0, 0.0, 0.0])),
            mission_result::INVALID_PARAM1,
        ),
        (wrong(|i| i.seq = 2), mission_result::INVALID_SEQUENCE),
    ] {
        assert_eq!(v.upload(A, &items), result);
        assert_eq!(v.service.items().len(), 3);
        let said = v.out.said();
        assert!(
            said.last()
                .is_some_and(|(_, t)| t.starts_with("Mission refused: item ")),
            "{said:?}"
        );
    }
}

#[test]
fn a_plan_the_vehicle_refuses_is_not_stored() {
    let mut v = Vehicle::new(None);
    v.outcome = Outcome::Refused(Refusal::ShuttingDown);
    assert_eq!(v.upload(A, &route(2)), mission_result::DENIED);
    assert!(v.service.items().is_empty());
}

#[test]
fn a_vehicle_that_does_not_answer_is_an_error_not_a_wait_for_ever() {
    let mut v = Vehicle::new(None);
    v.take(A, count(1));
    v.take(A, int(&waypoint(0, 1.0, 1.0)));
    let late = v.out.asked().remove(0);
    v.said();
    v.tick(2000);
    assert_eq!(v.acks(), [(245, mission_result::ERROR)]);
    v.tick(2000);
    assert!(v.acks().is_empty());
    let yes = answer(&late, Outcome::Accepted);
    assert!(v.service.answer(v.now, &yes, &v.bench.ctx(), &mut v.out));
    assert_eq!(
        v.service.items().len(),
        1,
        "what the vehicle flies is what is stored"
    );
}

#[test]
fn a_full_store_takes_512_items_and_no_more() {
    let mut v = Vehicle::new(None);
    assert_eq!(v.upload(A, &route(512)), 0);
    v.take(A, count(513));
    assert_eq!(v.acks(), [(245, mission_result::NO_SPACE)]);
    assert_eq!(v.service.items().len(), 512);
}

#[test]
fn clearing_is_acknowledged_in_the_words_it_was_asked_in() {
    let mut v = Vehicle::new(None);
    for (message, mission_type) in [(clear(255), 255), (clear(0), 0), (count(0), 0)] {
        v.upload(A, &route(2));
        v.said();
        v.take(A, message);
        v.tick(10);
        let acks = v.said();
        assert!(
            matches!(&acks[..], [M::MISSION_ACK(a)] if (a.mavtype, a.mission_type, a.opaque_id) == (0, mission_type, 0)),
            "{acks:?}"
        );
        assert!(v.service.items().is_empty());
        assert_eq!(v.plans.last().map(|p| p.items.len()), Some(0));
    }
}

#[test]
fn an_old_station_is_answered_in_floats_and_partial_lists_are_refused() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(2));
    v.said();
    v.take(
        A,
        M::MISSION_REQUEST(raw::MISSION_REQUEST_DATA {
            seq: 1,
            ..Default::default()
        }),
    );
    assert!(
        matches!(&v.said()[..], [M::MISSION_ITEM(i)] if (i.x - 1.01).abs() < 1e-6 && i.seq == 1)
    );
    v.take(
        A,
        M::MISSION_WRITE_PARTIAL_LIST(raw::MISSION_WRITE_PARTIAL_LIST_DATA::default()),
    );
    assert_eq!(v.acks(), [(245, mission_result::UNSUPPORTED)]);
}

#[test]
fn an_old_station_may_answer_in_floats() {
    let mut v = Vehicle::new(None);
    v.take(A, count(1));
    v.take(A, M::MISSION_ITEM(waypoint(0, 1.5, -2.5).to_float(1, 1)));
    v.tick(10);
    assert_eq!(
        (v.service.items()[0].x, v.service.items()[0].y),
        (15_000, -25_000)
    );
}

#[test]
fn the_plans_id_changes_with_the_plan_and_is_the_same_everywhere() {
    let mut v = Vehicle::new(None);
    v.take(A, count(1));
    v.take(A, int(&waypoint(0, 1.0, 1.0)));
    v.tick(10);
    let id = v.service.plan_ids().mission;
    let sent = v.said();
    assert!(
        sent.iter()
            .any(|m| matches!(m, M::MISSION_ACK(a) if a.opaque_id == id && id != 0)),
        "{sent:?}"
    );
    v.take(B, list(0));
    assert!(matches!(&v.said()[..], [M::MISSION_COUNT(c)] if c.opaque_id == id));
    v.upload(A, &[waypoint(0, 1.0, 1.1)]);
    assert_ne!(v.service.plan_ids().mission, id);
}

#[test]
fn a_stored_plan_is_restored_by_the_next_run_and_a_broken_one_is_dropped_with_a_reason() {
    let mut v = Vehicle::new(None);
    let items = [
        waypoint(0, 1.0, 1.0),
        MissionItem {
            command: 20,
            frame: 2,
            ..waypoint(1, 0.0, 0.0)
        },
    ];
    v.upload(A, &items);
    let document = v.out.documents.pop_back().unwrap();
    assert_eq!(document.name, "mission.json");

    let mut next = Vehicle::new(Some(room()));
    next.service
        .restore(next.now, &document.bytes, &next.bench.ctx(), &mut next.out);
    next.tick(10);
    assert_eq!(bytes(next.service.items()), bytes(&items));
    assert_eq!(
        next.service.plan_ids().mission,
        v.service.plan_ids().mission
    );
    assert_eq!(next.plans[0].items.len(), 2);
    assert!(next.acks().is_empty(), "nobody waits for it");

    let mut outside = Vehicle::new(Some(room()));
    for (broken, reason) in [
        (&b"{"[..], "cannot be read"),
        (
            &document::write(&[waypoint(0, 60.0, 0.0)])[..],
            "item 0: the place is outside",
        ),
    ] {
        outside
            .service
            .restore(outside.now, broken, &outside.bench.ctx(), &mut outside.out);
        outside.tick(10);
        let said = outside.out.said();
        assert!(said[0].1.contains(reason), "{said:?}");
        assert!(outside.plans.is_empty());
    }
}

#[test]
#[expect(deprecated, reason = "stations still send MISSION_SET_CURRENT")]
fn set_current_asks_the_vehicle_and_says_what_came_of_it() {
    let mut v = Vehicle::new(None);
    v.upload(A, &route(3));
    let m = standard::MavMessage::MISSION_SET_CURRENT(standard::MISSION_SET_CURRENT_DATA {
        seq: 2,
        target_system: 1,
        target_component: 1,
    });
    v.service.handle(
        v.now,
        A,
        &Message::Standard(m.clone()),
        &v.bench.ctx(),
        &mut v.out,
    );
    assert!(matches!(
        v.out.requests.front(),
        Some(Asked {
            request: Request::SetMissionItem(2),
            ..
        })
    ));
    v.tick(10);
    v.outcome = Outcome::Refused(Refusal::NoSuchItem { seq: 2, total: 1 });
    v.service
        .handle(v.now, A, &Message::Standard(m), &v.bench.ctx(), &mut v.out);
    v.out.said();
    v.tick(10);
    assert_eq!(
        v.out.said()[0].1,
        "Mission item refused: no mission item 2 (there are 1)"
    );
}

#[test]
fn reached_items_are_reported() {
    let mut out = Outbox::default();
    MissionService::new(None).event(&Event::ItemReached(7), &mut out);
    assert_eq!(
        out.sent(),
        [Message::Standard(
            standard::MavMessage::MISSION_ITEM_REACHED(standard::MISSION_ITEM_REACHED_DATA {
                seq: 7
            })
        )]
    );
}

fn any_message() -> impl Strategy<Value = M> {
    let seq = || prop_oneof![0u16..5, any::<u16>()];
    let kind = || prop_oneof![4 => Just(0u8), 1 => any::<u8>()];
    let item = (
        seq(),
        prop_oneof![Just(16u16), Just(22), Just(177), any::<u16>()],
        any::<[u32; 5]>(),
        any::<[i32; 2]>(),
        0u8..12,
    )
        .prop_map(|(seq, command, words, [x, y], frame)| {
            let [a, b, c, d, z] = words.map(f32::from_bits);
            MissionItem {
                seq,
                frame,
                command,
                current: 0,
                autocontinue: 1,
                params: [a, b, c, d],
                x,
                y,
                z,
            }
        });
    prop_oneof![
        (seq(), kind()).prop_map(|(n, kind)| count_of(n, kind)),
        item.prop_map(|i| int(&i)),
        (0u16..5).prop_map(|seq| int(&waypoint(seq, 1.0, 1.0))),
        kind().prop_map(list),
        seq().prop_map(request),
        kind().prop_map(clear),
        any::<u8>().prop_map(|mavtype| M::MISSION_ACK(raw::MISSION_ACK_DATA {
            mavtype,
            ..Default::default()
        })),
    ]
}

proptest! {
    #[test]
    fn no_order_of_messages_panics_or_leaves_half_a_plan(
        script in proptest::collection::vec((any::<bool>(), any_message(), 0u64..400), 0..60)
    ) {
        let mut v = Vehicle::new(Some(room()));
        for (is_a, m, ms) in script {
            v.take(if is_a { A } else { B }, m);
            v.tick(ms);
            let planned = v.plans.last().map_or(0, |p| p.items.len());
            prop_assert_eq!(v.service.items().len(), planned);
            prop_assert_eq!(v.service.plan_ids().mission, fingerprint(v.service.items()));
        }
    }
}
