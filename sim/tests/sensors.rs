//! What the simulated sensors do beside the table each follows: noise, drop-outs, delay. Run with `--nocapture` to read it.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "a test may panic, and figures here are exact by construction"
)]

mod pilot;

use core::time::Duration;
use msp::message::{Altitude, Attitude, RawImu};
use pilot::{Pilot, office};
use sim::sensor::{DOWN_LATENCY, FLOW_LATENCY, SONAR_SILENCE, TOF_LATENCY};
use sim::{SimConfig, SimOutput, Simulator, Then, Walker};
use vehicle::{FloorPlan, In, MapPose, Ned, RingConfig, Timestamp};

fn mean_sigma(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n;
    (mean, variance.sqrt())
}

fn sent_at(output: &SimOutput) -> Timestamp {
    match output {
        SimOutput::DownRange(s) => s.at,
        SimOutput::FcBytes { at, .. } => *at,
        SimOutput::Flow(s) => s.at,
        SimOutput::Ranger(s) => s.at,
        SimOutput::Laser { .. } => unreachable!("no lidar is mounted"),
    }
}

/// One line of the comparison.
#[allow(clippy::print_stdout, reason = "the table is there to be read")]
fn row(what: &str, measured: f64, table: f64, unit: &str) {
    println!("{what:<46} {measured:>9.4}   table {table:>7.4} {unit}");
}

#[test]
fn delays_and_rates_are_those_of_the_table() {
    let mut sim = Simulator::new(office("sonar8", 1)).unwrap();
    let mut tof = Simulator::new(office("tof32", 1)).unwrap();
    let mut seen: Vec<(u8, Duration)> = Vec::new();
    for ms in 1..=10_000 {
        let now = Timestamp::from_ms(ms);
        let mut note = |kind: u8, output: &SimOutput| seen.push((kind, now.since(sent_at(output))));
        sim.advance(now, &mut |_, output| match &output {
            SimOutput::Flow(_) => note(0, &output),
            SimOutput::DownRange(_) => note(1, &output),
            SimOutput::Ranger(r) if r.columns_mm[0].is_none() => note(2, &output),
            SimOutput::Ranger(_) => note(3, &output),
            SimOutput::FcBytes { .. } | SimOutput::Laser { .. } => {}
        });
        tof.advance(now, &mut |_, output| {
            if matches!(output, SimOutput::Ranger(_)) {
                note(4, &output);
            }
        });
    }
    let of = |kind: u8| {
        seen.iter()
            .filter(move |(k, _)| *k == kind)
            .map(|(_, d)| *d)
    };
    for (kind, name, latency) in [
        (0, "flow delay", FLOW_LATENCY),
        (1, "down-ranger delay", DOWN_LATENCY),
        (2, "sonar delay without echo", SONAR_SILENCE),
        (4, "tof delay", TOF_LATENCY),
    ] {
        let worst = of(kind).max().unwrap_or(latency);
        row(name, worst.as_secs_f64(), latency.as_secs_f64(), "s");
        assert!(of(kind).all(|d| d == latency), "{name}");
    }
    // An echo from 4 m takes 23.3 ms; delivery falls on the next millisecond.
    assert!(of(3).all(|d| d <= Duration::from_millis(24)) && of(3).count() > 100);
    let rate = |kind: u8| of(kind).count() as f64 / 10.0;
    for (kind, name, hz) in [
        (0, "flow rate", 50.0),
        (1, "down-ranger rate", 40.0),
        (4, "tof readings", 60.0),
    ] {
        row(name, rate(kind), hz, "Hz");
        assert!((rate(kind) - hz).abs() < 0.5);
    }
    let sonar_hz = rate(2) + rate(3);
    row("sonar readings", sonar_hz, 8.0 / 0.24, "Hz");
    assert!((sonar_hz - 8.0 / 0.24).abs() < 0.5);
}

#[test]
fn down_ranger_flow_and_flight_controller_noise() {
    let mut p = Pilot::new(office("tof32", 17));
    p.fly(3000, |_| {});
    let rest: Vec<RawImu> = (0..200).map(|_| p.ask()).collect();
    p.take_off(1.2);
    p.fly(4000, |p| p.steer_to(In::new(0.0, 0.0, -1.2), 0.0));
    p.outputs.clear();
    let mut down = Vec::new();
    let mut flow = Vec::new();
    let (mut accel, mut gyro, mut baro, mut tilt) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for _ in 0..600 {
        let imu: RawImu = p.ask();
        let truth = p.sim.truth(0);
        accel.push(f64::from(imu.acc[2]) / 2048.0 * 9.80665);
        gyro.push((f64::from(imu.gyro[0]) / 16.4).to_radians() - truth.rates_radps.x());
        let attitude: Attitude = p.ask();
        let (roll, pitch, _) = p.sim.truth(0).attitude.roll_pitch_yaw();
        tilt.push(f64::from(attitude.roll_ddeg) * 0.1 - roll.to_degrees());
        tilt.push(-f64::from(attitude.pitch_ddeg) * 0.1 - pitch.to_degrees());
        let altitude: Altitude = p.ask();
        baro.push(f64::from(altitude.altitude_cm) * 0.01 - p.sim.truth(0).position.z().abs());
        p.fly(60, |p| p.steer_to(In::new(0.0, 0.0, -1.2), 0.0));
        let truth = p.sim.truth(0);
        let body = truth.attitude.inverse() * truth.velocity;
        for output in p.outputs.drain(..) {
            match output {
                SimOutput::DownRange(d) => down.push(d.distance_m.unwrap() + truth.position.z()),
                SimOutput::Flow(f) => flow.push(f.y_radps - truth.rates_radps.y() - body.x() / 1.2),
                _ => {}
            }
        }
    }
    let axis =
        |i: usize, k: f64| -> Vec<f64> { rest.iter().map(|s| f64::from(s.acc[i]) * k).collect() };
    let accel_rest = mean_sigma(&axis(0, 9.80665 / 2048.0)).1;
    row("accelerometer noise at rest", accel_rest, 0.03, "m/s2");
    assert!((0.025..0.035).contains(&accel_rest));
    let accel_hover = mean_sigma(&accel).1;
    row("accelerometer noise in hover", accel_hover, 0.45, "m/s2");
    assert!((0.35..0.60).contains(&accel_hover));
    let gyro_hover = mean_sigma(&gyro).1;
    row("gyro noise in hover", gyro_hover, 0.015, "rad/s");
    assert!((0.010..0.05).contains(&gyro_hover));
    let (_, tilt_error) = mean_sigma(&tilt);
    row(
        "flight controller tilt error per axis",
        tilt_error,
        0.212,
        "deg",
    );
    assert!((0.08..0.5).contains(&tilt_error));
    let (_, baro_noise) = mean_sigma(&baro);
    row("barometric altitude noise", baro_noise, 0.12, "m");
    assert!((0.07..0.25).contains(&baro_noise));
    let (down_mean, down_noise) = mean_sigma(&down);
    row("down-ranger noise at 1.2 m", down_noise, 0.03 + 0.012, "m");
    assert!((0.036..0.048).contains(&down_noise) && down_mean.abs() < 0.02);
    let (_, flow_noise) = mean_sigma(&flow);
    row(
        "optical flow noise (white and wander)",
        flow_noise,
        0.102,
        "rad/s",
    );
    assert!((0.09..0.16).contains(&flow_noise));
}

#[test]
fn the_barometer_lags_and_reads_low_near_the_floor() {
    let mut p = Pilot::new(office("tof32", 8));
    p.arm();
    // Motors on, standing: the air under the propellers is pressed.
    p.sticks_us[2] = 1400;
    let mut low = Vec::new();
    for _ in 0..200 {
        let altitude: Altitude = p.ask();
        low.push(f64::from(altitude.altitude_cm) * 0.01);
        p.fly(20, |_| {});
    }
    assert!(p.sim.truth(0).on_floor);
    let (mean, _) = mean_sigma(&low);
    row("barometer on the floor, motors at 40 %", mean, -0.10, "m");
    assert!((-0.3..-0.02).contains(&mean));
}

/// Where the field of a level reading points in the body, clockwise from forward, rad.
fn course(imu: &RawImu) -> f64 {
    // Forward, left, up: the field to the right is minus y.
    (-f64::from(imu.mag[1])).atan2(f64::from(imu.mag[0]))
}

#[test]
fn the_magnetometer_is_noisy_biased_and_pulled_by_steel() {
    let (mut pulls, mut norms) = (Vec::new(), Vec::new());
    let facts = sim::Room::named("office").unwrap().facts();
    for seed in 1..=6 {
        for place in &facts.rooms {
            let mut config = office("tof32", seed);
            let [x, y] = place.map_m;
            config.vehicles[0].start = MapPose::new(x, y, 0.7);
            let mut p = Pilot::new(config);
            p.fly(100, |_| {});
            let imu: RawImu = p.ask();
            let heading = p.sim.truth(0).attitude.yaw();
            // The course against magnetic north 3 degrees east of north.
            let pull = vehicle::angle::wrap_pi(course(&imu) - (3f64.to_radians() - heading));
            pulls.push(pull.to_degrees());
            let squares: f64 = imu.mag.iter().map(|c| f64::from(*c) * f64::from(*c)).sum();
            norms.push(squares.sqrt() / sim::sensor::MAG_COUNTS_PER_GAUSS);
        }
    }
    let rms = (pulls.iter().map(|d| d * d).sum::<f64>() / pulls.len() as f64).sqrt();
    row(
        "magnetic heading pulled on the floor, rms",
        rms,
        30.0,
        "deg",
    );
    assert!((10.0..60.0).contains(&rms), "{rms}");
    let (mean, spread) = mean_sigma(&norms);
    row("magnetic field, mean of places", mean, 0.47, "G");
    row("magnetic field, spread between places", spread, 0.06, "G");
    assert!((0.40..0.56).contains(&mean) && (0.03..0.2).contains(&spread));

    let mut p = Pilot::new(office("tof32", 17));
    p.fly(1000, |_| {});
    let rest: Vec<f64> = (0..300)
        .map(|_| f64::from(p.ask::<RawImu>().mag[0]) / sim::sensor::MAG_COUNTS_PER_GAUSS)
        .collect();
    let (_, noise) = mean_sigma(&rest);
    row("magnetometer noise at rest", noise, 0.002, "G");
    assert!((0.0015..0.0026).contains(&noise));
}

#[test]
fn without_a_magnetometer_its_counts_are_zero_and_nothing_else_changes() {
    let read = |mag: bool| {
        let mut config = office("tof32", 5);
        config.vehicles[0].fc.mag = mag;
        let mut p = Pilot::new(config);
        p.fly(500, |_| {});
        let status: msp::message::Status = p.ask();
        (p.ask::<RawImu>(), status.head.sensors)
    };
    let ((with, sensors_with), (without, sensors_without)) = (read(true), read(false));
    assert_eq!((with.acc, with.gyro), (without.acc, without.gyro));
    assert_ne!(with.mag, [0; 3]);
    assert_eq!(without.mag, [0; 3]);
    assert_eq!(sensors_with & !sensors_without, 1 << 2);
}

/// A wall 2 m ahead, seen at a growing angle.
#[test]
fn sonars_lose_a_wall_that_is_turned_away() {
    let echoes = |off_deg: f64| {
        let mut config = SimConfig::new(
            wall_room(),
            RingConfig::built_in("sonar8").unwrap(),
            off_deg as u64,
        );
        config.vehicles[0].start = MapPose::new(3.0, 2.0, off_deg.to_radians());
        let mut sim = Simulator::new(config).unwrap();
        let mut readings = Vec::new();
        sim.advance(Timestamp::from_ms(60_000), &mut |_, output| {
            if let SimOutput::Ranger(r) = output
                && r.ranger == 0
            {
                readings.push(r.columns_mm[0]);
            }
        });
        let got: Vec<f64> = readings
            .iter()
            .flatten()
            .map(|mm| f64::from(*mm) * 1e-3)
            .collect();
        (got.len() as f64 / readings.len() as f64, got)
    };
    let (share, head_on) = echoes(0.0);
    let (mean, sigma) = mean_sigma(&head_on);
    row("sonar echoes, wall head-on", share, 1.0, "");
    row("sonar distance, wall at 1.95 m", mean, 1.95, "m");
    row("sonar noise (with 1 cm steps)", sigma, 0.0105, "m");
    assert!(share > 0.999 && (mean - 1.95).abs() < 0.005 && (0.008..0.014).contains(&sigma));
    assert!(
        head_on
            .iter()
            .all(|m| ((m * 100.0).round() - m * 100.0).abs() < 1e-6)
    );
    // The cone takes 7.5 degrees off the angle: full up to 32.5, gone from 72.5.
    for (off_deg, table) in [
        (30.0, 1.0),
        (42.5, 0.75),
        (52.5, 0.5),
        (62.5, 0.25),
        (75.0, 0.0),
    ] {
        let (share, _) = echoes(off_deg);
        row(
            &format!("sonar echoes, wall {off_deg} deg off"),
            share,
            table,
            "",
        );
        assert!((share - table).abs() < 0.12, "{off_deg}: {share}");
    }
}

#[test]
fn a_person_in_front_shortens_the_reading_for_as_long_as_they_stand_there() {
    let mut config = SimConfig::new(wall_room(), RingConfig::built_in("tof32").unwrap(), 3);
    config.vehicles[0].start = MapPose::new(3.0, 2.0, 0.0);
    config.people.push(Walker {
        path: vec![[4.0, 6.0], [4.0, 2.0], [4.0, -3.0]],
        speed_mps: 1.0,
        start: Duration::ZERO,
        then: Then::Stay,
    });
    let mut sim = Simulator::new(config).unwrap();
    let mut front = Vec::new();
    sim.advance(Timestamp::from_ms(8000), &mut |_, output| {
        if let SimOutput::Ranger(r) = output
            && r.ranger == 0
        {
            front.push((r.at.s(), r.columns_mm[3]));
        }
    });
    let near = front
        .iter()
        .filter(|(_, mm)| mm.is_some_and(|mm| mm < 1050));
    let times: Vec<f64> = near.map(|(s, _)| *s).collect();
    // 0.5 m wide at 1 m/s past x = 4.0: half a second around t = 4 s.
    // Now and then a reading is short without anybody: the range model says so.
    let (during, at_other_times): (Vec<f64>, Vec<f64>) =
        times.iter().partition(|s| (3.65..4.4).contains(*s));
    assert!(
        (7..=10).contains(&during.len()) && at_other_times.len() < 12,
        "{times:?}"
    );
}

#[test]
fn the_down_sonar_of_snsi_reads_the_height_in_centimetres() {
    let mut p = Pilot::new(office("snsi6", 5));
    p.take_off(1.0);
    p.outputs.clear();
    p.fly(5000, |p| p.steer_to(In::new(0.0, 0.0, -1.0), 0.0));
    let read: Vec<f64> = p
        .outputs
        .iter()
        .filter_map(|o| match o {
            SimOutput::Ranger(r) if r.ranger == 5 => r.columns_mm[0],
            _ => None,
        })
        .map(|mm| f64::from(mm) * 1e-3)
        .collect();
    let (mean, _) = mean_sigma(&read);
    row("down sonar at 1 m", mean, 1.0, "m");
    assert!((13..=16).contains(&read.len()) && (mean - 1.0).abs() < 0.06);
}

/// Integrated flow over a tour of the office, against the recordings' 0.2 - 1.0 m over 7 - 16 m.
#[test]
fn integrated_flow_drifts_like_the_recorded_flights() {
    let mut drifts = Vec::new();
    for seed in 0..8 {
        let mut p = Pilot::new(office("tof32", seed));
        p.take_off(0.6);
        let start = p.sim.truth(0).position;
        let (mut odometry, mut worst, mut path) = (In::<Ned>::zero(), 0.0_f64, 0.0);
        // North to the door, along the corridor, and on to the west.
        let legs = [(1.2, 1.5), (2.9, 1.5), (2.9, 4.5), (2.9, 0.5), (2.9, -1.5)];
        for (north, east) in legs {
            p.fly(6500, |p| {
                for output in p.outputs.drain(..) {
                    let SimOutput::Flow(f) = output else { continue };
                    let truth = p.sim.truth(0);
                    let d = -truth.position.z() / truth.attitude.tilt().cos();
                    let forward = (f.y_radps - truth.rates_radps.y()) * d;
                    let right = -(f.x_radps - truth.rates_radps.x()) * d;
                    let level = truth.attitude * In::new(forward, right, 0.0);
                    if f.quality > 40 {
                        odometry += level * 0.02;
                        path += truth.velocity.norm_xy() * 0.02;
                    }
                }
                p.steer_to(In::new(north, east, -0.6), 0.0);
                let off = odometry - (p.sim.truth(0).position - start);
                worst = worst.max(off.norm_xy());
            });
        }
        assert_eq!(p.sim.truth(0).contacts, 0, "seed {seed}");
        println!("flow odometry, seed {seed}: path {path:.1} m, largest drift {worst:.2} m");
        drifts.push(worst);
    }
    let (mean, _) = mean_sigma(&drifts);
    row("largest drift, mean of 8 flights", mean, 0.4, "m");
    assert!((0.15..1.0).contains(&mean));
}

/// 8 x 12 m of free floor with one wall at x = 5.
fn wall_room() -> sim::Room {
    use vehicle::floor_plan::Cell;
    let (width, height) = (160, 240);
    let cell = |i: usize| {
        if (i % width) == 120 {
            Cell::Occupied
        } else {
            Cell::Free
        }
    };
    let cells = (0..width * height).map(cell).collect();
    let mut plan = FloorPlan::from_cells(width, 0.05, [-1.0, -4.0], cells).unwrap();
    plan.home = Some(MapPose::new(3.0, 2.0, 0.0));
    sim::Room::from_plan("wall", plan)
}
