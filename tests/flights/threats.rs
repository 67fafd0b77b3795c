//! Threats on the MAVLink side that only a flight can show: what an attacker says must not move the vehicle.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::autopilot::mode::Mode;
use bridge::gcs::LinkId;
use flight_tests::Scenario;
use mavlink_dialect::standard::{GPS_INPUT_DATA, ODOMETRY_DATA, VISION_POSITION_ESTIMATE_DATA};
use mavlink_dialect::{Address, Encoder};

/// An attacker's link.
const STRANGER: LinkId = LinkId(7);

#[test]
fn a_spoofed_pose_moves_nothing() {
    let mut f = Scenario::office().seed(3).start();
    f.take_off(1.0);
    f.world.link_up(STRANGER);
    let mut encoder = Encoder::new(Address {
        system: 1,
        component: 197,
    });
    let place = f.truth().position;
    for i in 0..200 {
        let offset = [0.1, 0.5, 2.0, 5.0][i % 4];
        let frames = [
            encoder.encode(&VISION_POSITION_ESTIMATE_DATA {
                usec: f.now().us(),
                x: offset,
                y: -offset,
                z: -1.0,
                ..Default::default()
            }),
            encoder.encode(&ODOMETRY_DATA {
                time_usec: f.now().us(),
                x: offset,
                q: [1.0, 0.0, 0.0, 0.0],
                ..Default::default()
            }),
            encoder.encode(&GPS_INPUT_DATA {
                lat: 473_980_000,
                lon: 85_460_000,
                ..Default::default()
            }),
        ];
        for frame in frames {
            f.world.receive(STRANGER, &frame, true);
        }
        f.wait_s(0.05);
    }
    let moved = (f.truth().position - place).norm();
    let off = (f.snapshot().nav.position - f.truth().position).norm_xy();
    println!("10 s of spoofed poses: moved {moved:.3} m, estimate off by {off:.3} m");
    f.assert(moved < 0.25 && off < 0.2, "it believes strangers");
    f.assert(f.snapshot().mode.mode == Mode::Hold, "it left Hold");
}

#[test]
fn a_flood_of_50000_messages_a_second_leaves_the_flight_alone() {
    let mut f = Scenario::office().seed(4).start();
    f.take_off(1.0);
    f.world.link_up(STRANGER);
    let mut encoder = Encoder::new(Address {
        system: 66,
        component: 66,
    });
    let place = f.truth().position;
    let missed = f.snapshot().flight_loop.missed;
    // 250 frames each 5 ms of virtual time: requests, and noise between them.
    let ask = encoder.encode(&mavlink_dialect::raw::COMMAND_LONG_DATA {
        target_system: 1,
        target_component: 1,
        command: 512,
        param1: 33.0,
        ..Default::default()
    });
    let mut datagram = Vec::new();
    for _ in 0..50 {
        datagram.extend_from_slice(&ask);
        datagram.extend_from_slice(&[0xFD, 9, 9, 0xFE, 1]);
    }
    for _ in 0..600 {
        for _ in 0..5 {
            f.world.receive(STRANGER, &datagram, true);
        }
        f.step();
    }
    let moved = (f.truth().position - place).norm();
    let missed = f.snapshot().flight_loop.missed - missed;
    println!("3 s of 50,000 messages a second: moved {moved:.3} m, {missed} beats missed");
    f.assert(moved < 0.25 && missed == 0, "the flood reaches the loop");
    f.assert(f.snapshot().mode.mode == Mode::Hold, "it left Hold");
}
