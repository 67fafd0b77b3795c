//! How well the client fills the slots of a controller, in virtual time: slots used, evenness of RC, RC frames that
//! were displaced by others.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    dead_code,
    unreachable_pub,
    missing_docs,
    reason = "shared with other tests"
)]
#![expect(clippy::unwrap_used, reason = "tests")]

mod line;

use line::{Controller, Kind, Wire, events};
use msp::Client;
use msp::client::{Config, Event, Statistics};

struct Flown {
    slots: u64,
    used: u64,
    rc_sent: u64,
    /// RC set by the caller.
    rc_set: u64,
    /// Deviation of the served RC interval from the period: p50, p99, max.
    jitter_us: [u64; 3],
    /// From setting RC until it is served, p99.
    latency_us: u64,
    events: Vec<Event>,
    statistics: Statistics,
    /// RC values that never went out because a newer one came first, or became too old.
    displaced: u64,
}

/// Flies `seconds` with RC every `rc_period_us` after 10 s of settling.
fn fly(kind: Kind, slot_us: u64, wire: [u64; 2], rc_period_us: u64, seconds: u64) -> Flown {
    let [byte_ns, delay_us] = wire;
    let (mut up, mut down) = (Wire::new(byte_ns, delay_us), Wire::new(byte_ns, delay_us));
    let mut client = Client::new(Config::default());
    let mut controller = Controller::new(kind, slot_us);
    let (mut now_us, mut rc_at_us) = (0_u64, 0_u64);
    client.connect(now_us);
    let settled_us = 10_000_000;
    let end_us = settled_us + seconds * 1_000_000;
    let (mut said, mut rc_set) = (Vec::new(), Vec::new());
    let mut before = (0, 0, *client.statistics());
    while now_us < end_us {
        client.handle(now_us, &down.receive(now_us));
        if now_us >= rc_at_us {
            client.set_rc(now_us, &[1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000]);
            rc_set.push(now_us);
            // Not a multiple of the slot: the phase between both drifts through all values.
            rc_at_us += rc_period_us + 7;
        }
        while let Some(bytes) = client.poll_transmit(now_us) {
            up.send(now_us, bytes);
        }
        said.extend(
            events(&mut client)
                .into_iter()
                .filter(|event| !matches!(event, Event::Reply { .. })),
        );
        controller.server.handle(&up.receive(now_us));
        if now_us >= controller.run_us {
            controller.run_us = now_us;
            down.send(now_us, &controller.run());
        }
        if now_us < settled_us {
            before = (controller.slots, controller.used, *client.statistics());
            controller.rc_us.clear();
            rc_set.clear();
        }
        let next = [
            Some(controller.run_us),
            Some(rc_at_us),
            up.next_us(),
            down.next_us(),
            client.deadline_us(),
        ];
        now_us = next.into_iter().flatten().min().unwrap().max(now_us + 1);
    }
    let statistics = *client.statistics();
    let mut jitter_us: Vec<u64> = controller
        .rc_us
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).abs_diff(rc_period_us + 7))
        .collect();
    jitter_us.sort_unstable();
    let at = |part: f64| jitter_us[((jitter_us.len() - 1) as f64 * part) as usize];
    let mut latency_us: Vec<u64> = rc_set
        .iter()
        .zip(&controller.rc_us)
        .map(|(set, served)| served.saturating_sub(*set))
        .collect();
    latency_us.sort_unstable();
    Flown {
        slots: controller.slots - before.0,
        used: controller.used - before.1,
        rc_sent: statistics.rc_sent - before.2.rc_sent,
        rc_set: rc_set.len() as u64,
        jitter_us: [at(0.5), at(0.99), at(1.0)],
        latency_us: latency_us[(latency_us.len() - 1) * 99 / 100],
        events: said,
        displaced: statistics.rc_replaced + statistics.rc_expired
            - before.2.rc_replaced
            - before.2.rc_expired,
        statistics,
    }
}

/// Direct, USB, and 1 Mbaud with USB: time of a byte in ns and delay in us.
const WIRES: [(&str, [u64; 2]); 3] = [
    ("local", [0, 10]),
    ("USB", [0, 250]),
    ("1 Mbaud", [10_000, 100]),
];

#[test]
fn every_slot_is_used_and_rc_is_even_and_never_displaced() {
    println!("FIGURES msp scheduler");
    println!(
        "firmware   line     slots/s   used %  depth  RC jitter p50/p99/max us  RC wait p99 us  displaced"
    );
    let mut wrong = Vec::new();
    for kind in [Kind::Betaflight, Kind::Inav] {
        for slots in [100_u64, 500, 2_000] {
            for (name, wire) in WIRES {
                let slot_us = 1_000_000 / slots;
                let flown = fly(kind, slot_us, wire, 25_000, 30);
                let used = 100.0 * flown.used as f64 / flown.slots as f64;
                let [p50, p99, max] = flown.jitter_us;
                let displaced = flown.displaced;
                let row = format!(
                    "{:<10} {name:<8} {slots:>7}  {used:>6.2}  {:>5}  {p50:>9} {p99:>6} {max:>6}  {:>14}  {displaced:>9}",
                    format!("{kind:?}"),
                    flown.statistics.depth,
                    flown.latency_us
                );
                println!("{row}");
                // A frame set in the last moment is still under way.
                let is_whole = flown.rc_set - flown.rc_sent <= 1 && displaced == 0;
                // At 1 Mbaud a batch takes longer than a slot of 0.5 ms: the line is full, not the slots.
                let is_line_full = name == "1 Mbaud" && slots == 2_000 && kind == Kind::Betaflight;
                if (used < 98.0 && !is_line_full) || p99 > slot_us || !is_whole {
                    wrong.push(row);
                }
            }
        }
    }
    println!("END");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_slow_betaflight_is_told_once_with_the_line_that_makes_it_faster() {
    let flown = fly(Kind::Betaflight, 10_000, [86_800, 0], 25_000, 60);
    let slow: Vec<&Event> = flown
        .events
        .iter()
        .filter(|event| matches!(event, Event::Slow { .. }))
        .collect();
    let [
        Event::Slow {
            service_rate_hz,
            wanted_hz,
            cli_line,
        },
    ] = slow.as_slice()
    else {
        panic!("{slow:?}");
    };
    assert!((service_rate_hz - 100.0).abs() < 5.0, "{service_rate_hz}");
    assert!((80.0..95.0).contains(wanted_hz), "{wanted_hz}");
    assert_eq!(*cli_line, Some("set serial_update_rate_hz = 1000"));
    assert!(
        slow[0]
            .to_string()
            .contains("requests/s; its CLI: set serial_update_rate_hz"),
        "{}",
        slow[0]
    );
}

#[test]
fn a_fast_betaflight_and_an_inav_that_serves_what_is_wanted_are_not_called_slow() {
    for (kind, slot_us) in [(Kind::Betaflight, 1_000), (Kind::Inav, 10_000)] {
        let flown = fly(kind, slot_us, [10_000, 0], 25_000, 30);
        assert!(
            !flown
                .events
                .iter()
                .any(|event| matches!(event, Event::Slow { .. })),
            "{:?}",
            flown.events
        );
    }
}

#[test]
fn an_inav_too_slow_for_its_schedule_is_told_without_a_line_it_does_not_have() {
    let flown = fly(Kind::Inav, 20_000, [10_000, 0], 25_000, 30);
    let slow = flown
        .events
        .iter()
        .find(|event| matches!(event, Event::Slow { .. }));
    assert!(
        matches!(slow, Some(Event::Slow { cli_line: None, .. })),
        "{:?}",
        flown.events
    );
}
