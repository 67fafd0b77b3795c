//! Refusals, losses, requests made once.

use super::*;

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
