//! uQuad's inertial unit end to end: simulated chips, firmware, serial line, decoder, calibration, readings.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use estimator::imu::ascii::AsciiDecoder;
use estimator::imu::binary::BinaryDecoder;
use estimator::imu::command::ImuCommand;
use estimator::imu::{Calibration, ChainConfig, FrameFault, ImuChain, ImuEvent, Reading, Sensor};
use sim::imu_board::{Bench, Environment, Received};
use vehicle::Timestamp;

/// The scales of the simulated chips: 256 per g, 14.375 per deg/s, 1300 per gauss.
fn calibration() -> Calibration {
    let rows = |k: f64| format!("{k} 0 0 0 {k} 0 0 0 {k} 0 0 0 ");
    let text = [
        9.80665 / 256.0,
        (1.0 / 14.375_f64).to_radians(),
        1.0 / 1300.0,
    ]
    .map(rows)
    .concat();
    Calibration::parse(&text).unwrap()
}

/// Bytes of some seconds, handed over each 2 ms as a serial port does.
fn feed(bench: &mut Bench, chain: &mut ImuChain, from_ms: u64, to_ms: u64) -> Vec<Reading> {
    let mut out: Vec<Received> = Vec::new();
    let mut readings = Vec::new();
    for ms in (from_ms..to_ms).step_by(2) {
        out.clear();
        bench.advance((ms + 2) * 1000, &mut out);
        let bytes: Vec<u8> = out.iter().map(|r| r.byte).collect();
        chain.bytes(Timestamp::from_ms(ms + 2), &bytes);
        readings.extend(chain.take());
    }
    readings
}

#[test]
fn the_board_is_decoded_calibrated_and_measures_what_its_chips_feel() {
    for seed in 1..=5 {
        let config = ChainConfig {
            expects_alternation: true,
            ..ChainConfig::default()
        };
        let mut chain = ImuChain::new(calibration(), config).unwrap();
        let mut bench = Bench::new(seed, true);
        assert!(feed(&mut bench, &mut chain, 0, 5_000).is_empty());
        let readings = feed(&mut bench, &mut chain, 5_000, 8_000);
        let events: Vec<ImuEvent> = std::iter::from_fn(|| chain.poll()).collect();
        assert!(
            matches!(events[..], [ImuEvent::Calibrated(_)]),
            "seed {seed}: {events:?}"
        );
        assert!(readings.len() > 280, "seed {seed}: {}", readings.len());
        let worst_us = readings.iter().map(|r| r.elapsed_us.abs_diff(10_000)).max();
        println!("seed {seed}: board's periods at most {worst_us:?} us from 10 ms");
        assert!(worst_us <= Some(100), "seed {seed}: {worst_us:?}");
        for r in &readings {
            assert!(
                r.accel_is_good && r.mag_is_good && r.gyro_is_good,
                "seed {seed}"
            );
            assert!(
                r.measured.gyro_radps.norm() < 0.02,
                "seed {seed}: the null is taken off"
            );
            assert!(
                r.measured.altitude_m.abs() < 1.0,
                "seed {seed}: {}",
                r.measured.altitude_m
            );
            assert!(
                (r.measured.temperature_degc - 24.9).abs() < 0.2,
                "seed {seed}"
            );
        }

        // A turn to the left at 1 rad/s, ten metres higher.
        bench.feel(Environment {
            gyro_radps: [0.0, 0.0, 1.0],
            pressure_pa: 101_085.0,
            ..Environment::default()
        });
        let last = *feed(&mut bench, &mut chain, 8_000, 9_000).last().unwrap();
        assert!(
            (last.measured.gyro_radps.z - 1.0).abs() < 0.02,
            "seed {seed}"
        );
        assert!(
            (last.measured.altitude_m - 10.0).abs() < 1.0,
            "seed {seed}: {}",
            last.measured.altitude_m
        );
        assert_eq!(chain.decoder_stats().skipped, 0);
    }
}

#[test]
fn a_board_in_the_hand_is_not_calibrated_until_it_is_put_down() {
    let mut chain = ImuChain::new(calibration(), ChainConfig::default()).unwrap();
    let mut bench = Bench::new(1, false);
    let mut events = Vec::new();
    for second in 0..12 {
        let in_hand = second < 4;
        for tenth in 0..10 {
            let swing = if (second * 10 + tenth) % 2 == 0 {
                0.6
            } else {
                -0.6
            };
            bench.feel(Environment {
                gyro_radps: if in_hand { [swing, 0.2, 0.0] } else { [0.0; 3] },
                ..Environment::default()
            });
            let at = (second * 10 + tenth) * 100;
            feed(&mut bench, &mut chain, at, at + 100);
            events.extend(std::iter::from_fn(|| chain.poll()).map(|e| (at, e)));
        }
    }
    let disturbed = events
        .iter()
        .filter(|(_, e)| matches!(e, ImuEvent::Disturbed(_)))
        .count();
    assert!(disturbed >= 5, "{events:?}");
    let (at, ImuEvent::Calibrated(reference)) = events.last().unwrap() else {
        panic!("{events:?}");
    };
    assert!(*at >= 9_000, "512 frames after it was put down: {at} ms");
    assert!(
        reference.gyro_null_radps.norm() < 0.07,
        "at most the chips' own bias"
    );
}

#[test]
fn a_board_without_barometer_runs_and_its_height_is_not_believed() {
    let mut chain = ImuChain::new(calibration(), ChainConfig::default()).unwrap();
    let mut bench = Bench::new(2, false);
    bench.break_chip(Some(0x77));
    let readings = feed(&mut bench, &mut chain, 0, 6_000);
    assert!(!readings.is_empty() && readings.iter().all(|r| !r.baro_is_good));
    let events: Vec<ImuEvent> = std::iter::from_fn(|| chain.poll()).collect();
    let silent = ImuEvent::Fault(FrameFault::Silent(Sensor::Barometer));
    assert!(events.contains(&silent), "{events:?}");
    assert_eq!(chain.lost_events(), 0, "said once");
}

#[test]
fn both_formats_and_the_menu_work_over_the_line() {
    let mut bench = Bench::new(3, false);
    let mut out = Vec::new();
    bench.advance(500_000, &mut out);
    let mut binary = BinaryDecoder::default();
    let frames = out.iter().filter_map(|r| binary.push(r.byte)).count();
    // Two frames wait for the barometer's first temperature and pressure.
    assert!((45..=48).contains(&frames), "{frames}");

    bench.say(&ImuCommand::Stop.bytes());
    out.clear();
    bench.advance(700_000, &mut out);
    let shown = out.iter().filter_map(|r| binary.push(r.byte)).count();
    assert!(shown <= 1, "at most the frame that was on its way: {shown}");
    bench.say(b"1\n");
    bench.advance(900_000, &mut out);
    bench.say(&ImuCommand::LeaveMenu.bytes());
    out.clear();
    bench.advance(1_400_000, &mut out);
    let mut text = AsciiDecoder::default();
    let lines = out
        .iter()
        .filter_map(|r| text.push(r.byte))
        .map(|line| line.unwrap().since_previous_us)
        .filter(|us| us.abs_diff(10_000) <= 100)
        .count();
    assert!((48..=50).contains(&lines), "{lines}");
}
