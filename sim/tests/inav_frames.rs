//! What we would tell INAV about a pose, beside what the running INAV said of itself in that pose.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use msp::message::{Attitude, RawImu};
use msp::{Accept, Decoder, Message as _};
use sim::firmware::{Felt, inav};
use std::path::{Path, PathBuf};
use vehicle::{In, Rot};

const G: f64 = 9.806_65;

fn recordings() -> Option<PathBuf> {
    let folder = std::env::var_os("KESTREL_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let path = folder.join("msp/frames.jsonl");
    if path.exists() {
        return Some(path);
    }
    println!("SKIPPED: {} is not there", path.display());
    None
}

/// Poses that the recording names, as roll, pitch (nose up +), heading and the rates roll, nose up, clockwise, all in degrees.
const POSES: [(&str, [f64; 3], [f64; 3]); 4] = [
    ("level", [0.0, 0.0, 0.0], [0.0; 3]),
    ("roll right 20 deg", [20.0, 0.0, 0.0], [0.0; 3]),
    ("nose down 15 deg", [0.0, -15.0, 0.0], [0.0; 3]),
    (
        "roll left 12.3, nose up 8.7, heading 90, gyro roll +30 dps",
        [-12.3, 8.7, 90.0],
        [30.0, 0.0, 0.0],
    ),
];

fn felt(angles: [f64; 3], rates: [f64; 3]) -> Felt {
    let [roll, pitch, yaw] = angles.map(f64::to_radians);
    let [p, q, r] = rates.map(f64::to_radians);
    // At rest a body feels what holds it: one g upwards, seen from the body.
    let up = [
        libm::sin(pitch),
        -libm::sin(roll) * libm::cos(pitch),
        -libm::cos(roll) * libm::cos(pitch),
    ];
    Felt {
        rates_radps: In::new(p, q, r),
        specific_force_mps2: In::new(up[0] * G, up[1] * G, up[2] * G),
        attitude: Rot::from_roll_pitch_yaw(roll, pitch, yaw),
        altitude_m: 0.0,
    }
}

#[test]
fn a_pose_told_to_inav_is_the_pose_that_inav_told() {
    let Some(path) = recordings() else {
        return;
    };
    let text = std::fs::read_to_string(path).unwrap();
    let mut compared = 0;
    for line in text.lines() {
        let record: serde_json::Value = serde_json::from_str(line).unwrap();
        let note = record["note"].as_str().unwrap_or_default();
        let Some(pose) = note.strip_prefix("true pose fed to the simulator: ") else {
            continue;
        };
        let Some((_, angles, rates)) = POSES.into_iter().find(|(name, ..)| *name == pose) else {
            continue;
        };
        if record["firmware"] != "INAV" || record["dir"] != "response" {
            continue;
        }
        let hex = record["hex"].as_str().unwrap();
        let wire: Vec<u8> = (0..hex.len())
            .step_by(2)
            .map(|i| u8::from_str_radix(&hex[i..i + 2], 16).unwrap())
            .collect();
        let mut decoder = Decoder::new(Accept::Replies);
        let mut input = wire.as_slice();
        let Some(reply) = decoder.decode(&mut input) else {
            continue;
        };
        let told = inav::state(&felt(angles, rates));
        if reply.command == Attitude::COMMAND {
            let is = Attitude::parse(reply.payload).unwrap();
            let near = |a: i16, b: i16| (i32::from(a) - i32::from(b)).abs() <= 2;
            assert!(
                near(told.roll_ddeg, is.roll_ddeg),
                "{pose}: {told:?} {is:?}"
            );
            assert!(
                near(told.pitch_ddeg, is.pitch_ddeg),
                "{pose}: {told:?} {is:?}"
            );
            assert!(
                near(told.yaw_ddeg, 10 * is.yaw_deg),
                "{pose}: {told:?} {is:?}"
            );
            compared += 1;
        } else if reply.command == RawImu::COMMAND {
            let is = RawImu::parse(reply.payload).unwrap();
            // INAV says 1/512 g and whole degrees per second.
            for axis in 0..3 {
                let acc = f64::from(told.acc_mg[axis]) * 0.512;
                let gyro = f64::from(told.gyro_16th_dps[axis]) / 16.0;
                assert!(
                    (acc - f64::from(is.acc[axis])).abs() <= 2.0,
                    "{pose}: {told:?} {is:?}"
                );
                assert!(
                    (gyro - f64::from(is.gyro[axis])).abs() <= 1.0,
                    "{pose}: {told:?} {is:?}"
                );
            }
            compared += 1;
        }
    }
    println!("{compared} answers compared");
    assert!(compared >= 5, "{compared}");
}
