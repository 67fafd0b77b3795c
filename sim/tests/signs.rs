//! Every axis against the truth, in numbers a human can check. North is up on the plan, home faces north in the office.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "a test may panic, and figures here are exact by construction"
)]

mod pilot;

use msp::message::{Altitude, Attitude, RawImu};
use pilot::{Pilot, office};
use sim::SimOutput;
use vehicle::In;

fn hovering() -> Pilot {
    let mut p = Pilot::new(office("tof32", 3));
    p.take_off(1.2);
    p
}

/// Holds height and one stick deflection for a while from a hover.
fn with_stick(p: &mut Pilot, channel: usize, us: u16, ms: u64) {
    let hover = p.sim.truth(0).position;
    let heading = p.sim.truth(0).attitude.yaw();
    p.fly(ms, |p| {
        p.steer_to(hover, heading);
        for stick in [0, 1, 3] {
            p.sticks_us[stick] = 1500;
        }
        p.sticks_us[channel] = us;
    });
}

#[test]
fn roll_stick_1600_rolls_right_3_4_degrees_and_flies_east() {
    let mut p = hovering();
    with_stick(&mut p, 0, 1600, 800);
    let truth = p.sim.truth(0);
    let (roll, pitch, _) = truth.attitude.roll_pitch_yaw();
    println!("1600: {:.2} degrees", roll.to_degrees());
    assert!((2.6..4.4).contains(&roll.to_degrees()) && pitch.abs() < 0.02);
    assert!(truth.velocity.y() > 0.2, "{:?}", truth.velocity);
    let attitude: Attitude = p.ask();
    assert!(attitude.roll_ddeg > 20);
}

#[test]
fn a_commanded_tilt_is_reached_with_a_time_constant_of_about_100_ms() {
    let mut p = hovering();
    with_stick(&mut p, 0, 1500, 500);
    let start = p.sim.truth(0).attitude.roll_pitch_yaw().0;
    let mut rolls = Vec::new();
    for _ in 0..700 {
        with_stick(&mut p, 0, 1700, 1);
        rolls.push(p.sim.truth(0).attitude.roll_pitch_yaw().0 - start);
    }
    let end = rolls.iter().rev().take(200).sum::<f64>() / 200.0;
    let at = |share: f64| rolls.iter().position(|r| *r >= share * end).unwrap();
    println!(
        "angle step: 63 % after {} ms (RC frame and serial task included), overshoot {:.1} %",
        at(0.632),
        100.0 * (rolls.iter().copied().fold(0.0, f64::max) / end - 1.0)
    );
    assert!((80..190).contains(&at(0.632)), "{}", at(0.632));
    assert!(rolls.iter().all(|r| *r < 1.15 * end));
}

#[test]
fn pitch_stick_up_is_nose_down_is_north_and_positive_pitch_on_the_wire() {
    let mut p = hovering();
    with_stick(&mut p, 1, 1600, 800);
    let truth = p.sim.truth(0);
    let (_, pitch, _) = truth.attitude.roll_pitch_yaw();
    assert!((-4.4..-2.6).contains(&pitch.to_degrees()));
    assert!(truth.velocity.x() > 0.2);
    let attitude: Attitude = p.ask();
    assert!(attitude.pitch_ddeg > 20);
}

#[test]
fn yaw_stick_1600_turns_clockwise_38_degrees_a_second_and_the_gyro_z_falls() {
    let mut p = hovering();
    let before: Attitude = p.ask();
    let yaw_before = p.sim.truth(0).attitude.yaw();
    with_stick(&mut p, 3, 1600, 1000);
    let turned = vehicle::angle::shortest_turn(yaw_before, p.sim.truth(0).attitude.yaw());
    println!("1600 yaw for 1 s: {:.1} degrees", turned.to_degrees());
    assert!((33.0..43.0).contains(&turned.to_degrees()));
    let imu: RawImu = p.ask();
    // 38 deg/s x 16.4 = 623 counts.
    assert!((-780..-470).contains(&imu.gyro[2]), "{}", imu.gyro[2]);
    let after: Attitude = p.ask();
    let heading_turned = (after.yaw_deg - before.yaw_deg).rem_euclid(360);
    assert!((33..60).contains(&heading_turned), "{heading_turned}");
}

#[test]
fn at_rest_the_accelerometer_reads_one_g_up_in_flu() {
    let mut p = Pilot::new(office("tof32", 3));
    p.fly(500, |_| {});
    let imu: RawImu = p.ask();
    assert!((2000..2100).contains(&imu.acc[2]), "{:?}", imu.acc);
    assert!(imu.acc[0].abs() < 60 && imu.acc[1].abs() < 60);
    assert!(imu.gyro.iter().all(|g| g.abs() < 15));
}

#[test]
fn altitude_is_up_positive_above_the_place_of_arming() {
    let mut p = hovering();
    let hover = p.sim.truth(0).position;
    p.fly(3000, |p| p.steer_to(hover, 0.0));
    let altitude: Altitude = p.ask();
    assert!(
        (60..170).contains(&altitude.altitude_cm),
        "{}",
        altitude.altitude_cm
    );
}

#[test]
fn moving_forward_flows_about_plus_y_and_moving_right_about_minus_x() {
    let mean_flow = |channel: usize| {
        let mut p = hovering();
        with_stick(&mut p, channel, 1650, 600);
        p.outputs.clear();
        with_stick(&mut p, channel, 1650, 600);
        let flows = p.outputs.iter().filter_map(|o| match o {
            SimOutput::Flow(f) => Some((f.x_radps, f.y_radps)),
            _ => None,
        });
        let n = flows.clone().count() as f64;
        flows.fold((0.0, 0.0), |s, f| (s.0 + f.0 / n, s.1 + f.1 / n))
    };
    let (x, y) = mean_flow(1);
    assert!(y > 0.3 && x.abs() < 0.15, "forward: {x} {y}");
    let (x, y) = mean_flow(0);
    assert!(x < -0.3 && y.abs() < 0.15, "right: {x} {y}");
}

#[test]
fn rangers_read_the_walls_where_the_plan_has_them() {
    // Lab of the office: home (2.6, 2.05) facing north (plan up). Ring order front, back, left, right.
    let mut p = Pilot::new(office("tof32", 3));
    p.fly(1500, |_| {});
    let centre = |ranger: u8| {
        let mut readings: Vec<u16> = p
            .outputs
            .iter()
            .filter_map(|o| match o {
                SimOutput::Ranger(r) if r.ranger == ranger => r.columns_mm[3],
                _ => None,
            })
            .collect();
        readings.sort_unstable();
        f64::from(readings[readings.len() / 2]) * 1e-3
    };
    // North wall y = 4.2, south wall 0, west wall 0, east wall 5.4; the sensors sit 0.02 and 0.025 m out.
    for (ranger, metres) in [(0, 2.13), (1, 2.03), (2, 2.575), (3, 2.775)] {
        let read = centre(ranger);
        assert!(
            (read - metres).abs() < 0.06,
            "ranger {ranger}: {read}, plan says {metres}"
        );
    }
}

#[test]
fn height_is_read_along_body_down() {
    let mut p = hovering();
    let hover = In::new(0.0, 0.0, -1.2);
    p.outputs.clear();
    p.fly(3000, |p| p.steer_to(hover, 0.0));
    let read: Vec<f64> = p
        .outputs
        .iter()
        .filter_map(|o| match o {
            SimOutput::DownRange(d) => d.distance_m,
            _ => None,
        })
        .collect();
    let mean = read.iter().sum::<f64>() / read.len() as f64;
    assert!((mean - 1.2).abs() < 0.1 && read.len() > 110, "{mean}");
}
