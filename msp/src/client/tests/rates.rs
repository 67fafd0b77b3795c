//! What is asked how often.

use super::*;

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
