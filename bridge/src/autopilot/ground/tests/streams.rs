//! Heartbeats and telemetry.

use super::*;

#[test]
fn heartbeats_come_once_a_second_and_at_once_when_arming() {
    let mut bench = Bench::with_link();
    bench.run_for(100_500);
    // One greets the link, then one at each full second from 0 to 100.
    assert_eq!(bench.count_of(A, 0), 102);
    bench.show(|s| s.is_armed = true);
    assert_eq!(bench.count_of(A, 0), 103);
    bench.show(|s| {
        s.mode = ModeState {
            mode: Mode::Land,
            because: Because::GroundLost,
        }
    });
    let Some((at, _, frame)) = bench
        .heard
        .iter()
        .rev()
        .find(|(_, _, f)| f.message.id() == 0)
    else {
        panic!("none")
    };
    assert_eq!(*at, Timestamp::from_ms(100_500));
    assert!(matches!(&frame.message, Message::Raw(Raw::HEARTBEAT(h))
        if h.base_mode & 128 != 0 && h.custom_mode == (4 << 16 | 6 << 24) && h.system_status == 5));
}

#[test]
fn fifty_hertz_are_fifty_hertz_and_only_on_the_link_that_asked() {
    let mut bench = Bench::with_link();
    bench.link_up(B);
    bench.show(localized);
    bench.command(511, 30.0, 20_000.0);
    assert_eq!(bench.acks(), [(511, 0)]);
    bench.heard.clear();
    bench.run_for(10_000);
    let beats: Vec<u64> = bench
        .heard
        .iter()
        .filter(|(_, l, f)| *l == A && f.message.id() == 30)
        .map(|(t, _, _)| t.us())
        .collect();
    assert!((500..=501).contains(&beats.len()), "{}", beats.len());
    assert!(
        beats.windows(2).all(|w| w[1] - w[0] == 20_000),
        "no jitter on a clock that is met"
    );
    assert!(
        (199..=201).contains(&bench.count_of(B, 30)),
        "{}",
        bench.count_of(B, 30)
    );
}

#[test]
fn intervals_that_would_hurt_are_refused() {
    let mut bench = Bench::with_link();
    for (id, us, result) in [
        (30.0, 1_999.0, 2),
        (30.0, f32::NAN, 2),
        (0.0, -1.0, 2),
        (0.0, 4_000.0, 2),
        (0.0, 0.0, 0),
        (60_000.0, 100_000.0, 3),
        (30.0, -1.0, 0),
        (30.0, 0.0, 0),
    ] {
        bench.command(511, id, us);
        assert_eq!(bench.acks().last(), Some(&(511, result)), "{id} {us}");
    }
    bench.command(511, 30.0, -1.0);
    assert_eq!(bench.ground.telemetry.interval(A, 30), -1);
    bench.command(510, 30.0, 0.0);
    assert!(bench.on(A).any(
        |f| matches!(&f.message, Message::Standard(Std::MESSAGE_INTERVAL(m)) if m.interval_us == -1)
    ));
}

#[test]
fn what_changes_is_told_at_once() {
    let mut bench = Bench::with_link();
    bench.show(localized);
    bench.run_for(10_000);
    assert_eq!(
        bench.count_of(A, 436),
        0,
        "not to those who may not know it"
    );
    bench.command(512, 435.0, 0.0);
    bench.run_for(10_300);
    assert_eq!(bench.count_of(A, 436), 6);
    bench.heard.clear();
    bench.show(|s| s.landed = crate::autopilot::door::LandedState::InAir);
    bench.show(|s| s.mission.seq = 4);
    bench.show(|s| s.mode.mode = Mode::Mission);
    bench.show(|s| s.home = In::new(1.0, 0.0, 0.0));
    let ids: Vec<u32> = bench
        .on(A)
        .map(|f| f.message.id())
        .filter(|id| [0, 42, 242, 245, 436].contains(id))
        .collect();
    assert_eq!(ids, [245, 42, 0, 436, 242]);
}

#[test]
fn a_localized_vehicle_is_healthy_to_mavsdk_and_an_unlocalized_one_is_not() {
    let mut bench = Bench::with_link();
    let health = |bench: &mut Bench| {
        bench.heard.clear();
        bench.run_for(1_500);
        let status = |f: &Frame| match &f.message {
            Message::Standard(Std::SYS_STATUS(s)) => Some(
                s.onboard_control_sensors_present.bits() & s.onboard_control_sensors_health.bits(),
            ),
            _ => None,
        };
        bench.on(A).find_map(status).unwrap()
    };
    bench.show(|s| s.arm_blocked_by = Some(Refusal::NotLocalized));
    let needed = 0x1 | 0x2 | 0x4 | 0x20 | 0x80 | 0x1000_0000;
    assert_eq!(health(&mut bench) & needed, 0);
    assert_eq!(
        bench.count_of(A, 32) + bench.count_of(A, 33),
        0,
        "no position before it is known"
    );
    bench.show(localized);
    bench.show(|s| s.arm_blocked_by = None);
    assert_eq!(health(&mut bench) & needed, needed);
    assert!(
        (29..=31).contains(&bench.count_of(A, 32)),
        "{}",
        bench.count_of(A, 32)
    );
}

#[test]
fn walls_stand_where_the_rangers_saw_them() {
    let mut bench = Bench::with_link();
    let beam = |bearing_deg: f64, distance_m| Beam {
        origin: In::new(0.0, 0.0, 0.0),
        bearing_rad: bearing_deg.to_radians(),
        elevation_rad: 0.0,
        half_cone_rad: 0.0,
        distance_m,
        min_m: 0.02,
        max_m: 4.0,
    };
    let beams = [
        beam(0.0, Some(1.5)),
        beam(-90.0, Some(0.8)),
        beam(180.0, None),
    ]
    .into_iter()
    .collect();
    bench.show(|s| {
        s.scan = Some(RangeScan {
            at: Timestamp::from_ms(5),
            beams,
        });
        s.rangers_alive = true;
    });
    bench.run_for(400);
    let picture = |f: &Frame| match &f.message {
        Message::Standard(Std::OBSTACLE_DISTANCE(o)) => Some(o.clone()),
        _ => None,
    };
    let o = bench.on(A).find_map(picture).unwrap();
    assert_eq!(
        [
            o.distances[0],
            o.distances[54],
            o.distances[36],
            o.distances[18]
        ],
        [150, 80, 401, u16::MAX]
    );
    assert_eq!((o.frame as u32, o.max_distance), (12, 400));
    let sides: Vec<_> = bench
        .on(A)
        .filter_map(|f| match &f.message {
            Message::Standard(Std::DISTANCE_SENSOR(d)) => {
                Some((d.orientation as u32, d.current_distance, d.id))
            }
            _ => None,
        })
        .take(3)
        .collect();
    assert_eq!(sides, [(0, 150, 0), (4, 401, 4), (6, 80, 6)]);
}

#[test]
fn ids_of_the_messages_here_are_the_dialects() {
    assert_eq!(standard::OBSTACLE_DISTANCE_DATA::ID, 330);
    assert_eq!(standard::MISSION_CURRENT_DATA::ID, 42);
}

/// What the flight controller says of its battery and receiver, through converter, snapshot and telemetry, in its own units.
#[test]
fn battery_current_charge_and_signal_of_the_controller_reach_the_ground_unchanged() {
    use crate::fc::convert::Convert;
    use msp::firmware::Firmware;
    use msp::message::BatteryState;
    let convert = Convert::new(Firmware::Betaflight);
    let mut bench = Bench::with_link();
    let cases = (0..400u16).map(|i| (300 + i * 7, i * 81, i * 163, i * 13));
    for (vbat_cv, current_ca, drawn_mah, rssi) in cases {
        let current_ca = current_ca.cast_signed().max(0);
        let reply = BatteryState {
            cells: 4,
            capacity_mah: 0,
            vbat_dv: 0,
            drawn_mah,
            current_ca,
            state: Some(0),
            vbat_cv: Some(vbat_cv),
        };
        bench.heard.clear();
        bench.show(|s| {
            s.battery = Some(convert.battery(Timestamp::ZERO, &reply));
            s.fc.rssi = Some(convert.rssi(rssi));
            s.rc_us = [1500; 8].into_iter().collect();
        });
        for id in [1.0, 65.0, 147.0] {
            bench.command(512, id, 0.0);
        }
        let mut seen = 0;
        for frame in bench.on(A) {
            match &frame.message {
                Message::Standard(Std::SYS_STATUS(m)) => {
                    seen |= 1;
                    assert_eq!(m.voltage_battery, vbat_cv * 10);
                    assert_eq!(m.current_battery, current_ca);
                }
                Message::Standard(Std::BATTERY_STATUS(m)) => {
                    seen |= 2;
                    let sum: u32 = m.voltages[..4].iter().map(|v| u32::from(*v)).sum();
                    assert!(
                        sum.abs_diff(u32::from(vbat_cv) * 10) <= 2,
                        "{sum} {vbat_cv}"
                    );
                    assert_eq!(m.current_battery, current_ca);
                    assert_eq!(m.current_consumed, i32::from(drawn_mah));
                }
                Message::Standard(Std::RC_CHANNELS(m)) => {
                    seen |= 4;
                    // 0..=1023 of MSP on MAVLink's 0..=254.
                    let expected = u32::from(rssi).min(1023) * 254 / 1023;
                    assert_eq!(u32::from(m.rssi), expected);
                }
                _ => {}
            }
        }
        assert_eq!(seen, 7);
    }
}

#[test]
fn a_blocked_arm_says_why_in_words_and_bits() {
    use crate::autopilot::door::FcBlocks;
    let mut bench = Bench::with_link();
    bench.command(400, 1.0, 0.0);
    let asked = bench.requests.pop().expect("asked of the vehicle");
    let blocks = FcBlocks {
        variant: *b"INAV",
        count: 32,
        flags: 1 << 19 | 1 << 8,
    };
    let now = bench.now;
    bench.ground.answer(
        now,
        &Answer {
            id: asked.id,
            station: asked.station,
            outcome: Outcome::Refused(Refusal::FcBlocks(blocks)),
        },
    );
    bench.collect();
    let acks: Vec<(u8, i32)> = bench
        .on(A)
        .filter_map(|f| match &f.message {
            Message::Raw(Raw::COMMAND_ACK(a)) if a.command == 400 => {
                Some((a.result, a.result_param2))
            }
            _ => None,
        })
        .collect();
    assert_eq!(acks.last(), Some(&(1, 1 << 19 | 1 << 8)));
    let told: Vec<&str> = bench.ground.texts().map(|t| t.text.as_str()).collect();
    assert!(
        told.iter()
            .any(|t| t.contains("NOT_LEVEL") && t.contains("THROTTLE")),
        "{told:?}"
    );
}
