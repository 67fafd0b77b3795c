//! Go-to, off-board, sticks and keys, judged by truth.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use flight_tests::{Flight, Scenario, modes};
use mavlink_dialect::raw;

fn airborne() -> Flight {
    let mut f = Scenario::office().seed(4).start();
    f.take_off(1.0);
    f.wait_s(2.0);
    f
}

/// Speed along the vehicle's own axes, m/s.
fn body_velocity(f: &Flight) -> [f64; 2] {
    let (t, yaw) = (f.truth(), f.truth().attitude.yaw());
    let v = t.velocity;
    [
        v.x() * yaw.cos() + v.y() * yaw.sin(),
        -v.x() * yaw.sin() + v.y() * yaw.cos(),
    ]
}

#[test]
fn goes_where_it_is_sent_and_stays() {
    let mut f = airborne();
    let start = f.truth().position;
    // DO_REPOSITION in local terms is not in the standard: fly by an off-board position target instead.
    stream(&mut f, 3.0, |_| position_target(1.0, 0.5, -1.2));
    assert_eq!(f.set_mode(modes::OFFBOARD), 0);
    stream(&mut f, 8.0, |_| position_target(1.0, 0.5, -1.2));
    let at = f.truth().position;
    let off = (at.x() - 1.0).hypot(at.y() - 0.5);
    f.assert(
        off < 0.25 && (at.z() + 1.2).abs() < 0.15,
        &format!("{off:.2} m off, from {start:?}"),
    );
}

fn position_target(x: f32, y: f32, z: f32) -> raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
    raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
        target_system: 1,
        target_component: 1,
        coordinate_frame: 1,
        // Position only; yaw ignored too.
        type_mask: 0b1111_1111_1000 & !0x200 | 0x400 | 0x800,
        x,
        y,
        z,
        ..Default::default()
    }
}

fn velocity_target(frame: u8, vx: f32, vy: f32) -> raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
    raw::SET_POSITION_TARGET_LOCAL_NED_DATA {
        target_system: 1,
        target_component: 1,
        coordinate_frame: frame,
        type_mask: 0b0000_0111 | 0b1_1100_0000 | 0x400 | 0x800,
        vx,
        vy,
        ..Default::default()
    }
}

fn stream(
    f: &mut Flight,
    seconds: f64,
    target: impl Fn(&Flight) -> raw::SET_POSITION_TARGET_LOCAL_NED_DATA,
) {
    let until = f.now().s() + seconds;
    while f.now().s() < until {
        let t = target(f);
        f.station.send(&t);
        f.wait_s(0.05);
    }
}

#[test]
fn off_board_velocity_follows_its_frame_and_holds_when_the_stream_stops() {
    let mut f = airborne();
    stream(&mut f, 0.5, |_| velocity_target(1, 0.0, 0.0));
    assert_eq!(f.set_mode(modes::OFFBOARD), 0);
    stream(&mut f, 2.0, |_| velocity_target(1, 0.3, 0.0));
    let v = f.truth().velocity;
    f.assert(
        v.x() > 0.15 && v.y().abs() < 0.15,
        &format!("local north: {v:?}"),
    );
    stream(&mut f, 2.0, |_| velocity_target(8, -0.3, 0.0));
    let [forward, right] = body_velocity(&f);
    f.assert(
        forward < -0.15 && right.abs() < 0.15,
        &format!("body back: {forward:.2} {right:.2}"),
    );
    f.wait_s(1.0);
    f.assert(
        f.snapshot().mode.mode == bridge::autopilot::mode::Mode::Hold,
        "it did not hold after the stream",
    );
    f.wait_s(2.0);
    f.assert(f.truth().velocity.norm_xy() < 0.15, "it still moves");
}

#[test]
fn off_board_without_a_stream_is_refused() {
    let mut f = airborne();
    assert_eq!(f.set_mode(modes::OFFBOARD), 1);
}

fn sticks(x: i16, y: i16, z: i16, r: i16) -> raw::MANUAL_CONTROL_DATA {
    raw::MANUAL_CONTROL_DATA {
        target: 1,
        x,
        y,
        z,
        r,
        ..Default::default()
    }
}

fn push(f: &mut Flight, seconds: f64, s: &raw::MANUAL_CONTROL_DATA) {
    let until = f.now().s() + seconds;
    while f.now().s() < until {
        f.station.send(s);
        f.wait_s(0.04);
    }
}

#[test]
fn every_stick_moves_the_vehicle_its_way_and_released_sticks_stop_it() {
    let mut f = airborne();
    push(&mut f, 0.3, &sticks(0, 0, 500, 0));
    assert_eq!(f.set_mode(modes::POSITION), 0);
    for (s, axis, sign) in [
        (sticks(500, 0, 500, 0), 0, 1.0),
        (sticks(-500, 0, 500, 0), 0, -1.0),
        (sticks(0, 500, 500, 0), 1, 1.0),
        (sticks(0, -500, 500, 0), 1, -1.0),
    ] {
        push(&mut f, 1.5, &s);
        let v = body_velocity(&f)[axis] * sign;
        f.assert(v > 0.1, &format!("stick {s:?}: {v:.2} m/s"));
        push(&mut f, 2.5, &sticks(0, 0, 500, 0));
        f.assert(
            f.truth().velocity.norm_xy() < 0.15,
            "released sticks did not stop it",
        );
    }
    let yaw = f.truth().attitude.yaw();
    push(&mut f, 1.0, &sticks(0, 0, 500, 500));
    let turned = vehicle::angle::shortest_turn(yaw, f.truth().attitude.yaw());
    f.assert(
        turned > 0.2,
        &format!("clockwise stick turned {turned:.2} rad"),
    );
    let down = f.truth().position.z();
    push(&mut f, 1.5, &sticks(0, 0, 800, 0));
    f.assert(
        f.truth().position.z() < down - 0.15,
        "throttle up did not climb",
    );
}

#[test]
fn sticks_cannot_push_it_into_a_wall() {
    for (seed, x, y) in [(1, 1000, 0), (2, -1000, 0), (3, 0, 1000), (4, 0, -1000)] {
        let mut f = Scenario::office().seed(seed).start();
        f.take_off(1.0);
        push(&mut f, 0.3, &sticks(0, 0, 500, 0));
        assert_eq!(f.set_mode(modes::POSITION), 0);
        push(&mut f, 12.0, &sticks(x, y, 500, 0));
        f.assert(f.truth().contacts == 0, "pushed into something");
    }
}
