//! Our conversions against recordings of real firmware.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use bridge::fc::convert::Convert;
use msp::firmware::Firmware;
use msp::message::{Attitude, Message as _, RawImu};
use std::path::{Path, PathBuf};
use vehicle::Timestamp;

fn data(file: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("KESTREL_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let path = folder.join(file);
    if path.exists() {
        return Some(path);
    }
    println!("SKIPPED: {} is not there", path.display());
    None
}

/// Pose and angular rates that were fed to the firmware's simulator, by the note of the recording: roll right, nose down
/// (degrees), then roll right, nose down, counter-clockwise (degrees a second).
const FED: [(&str, [f64; 2], [f64; 3]); 5] = [
    ("level", [0.0, 0.0], [0.0, 0.0, 0.0]),
    ("roll right 20 deg", [20.0, 0.0], [0.0, 0.0, 0.0]),
    ("nose down 15 deg", [0.0, 15.0], [0.0, 0.0, 0.0]),
    (
        "roll left 12.3, nose up 8.7",
        [-12.3, -8.7],
        [30.0, 0.0, 0.0],
    ),
    (
        "heading 270, gyro pitch(nose down) +20 dps",
        [3.0, 4.0],
        [0.0, 20.0, -45.0],
    ),
];

#[test]
fn recorded_attitudes_come_out_with_the_signs_of_the_pose_that_was_fed() {
    let Some(path) = data("msp/frames.jsonl") else {
        return;
    };
    let text = std::fs::read_to_string(path).unwrap();
    let (mut attitudes, mut imus, mut mags) = (0, 0, 0);
    for line in text.lines() {
        let frame: serde_json::Value = serde_json::from_str(line).unwrap();
        let (cmd, note) = (
            frame["cmd"].as_i64().unwrap(),
            frame["note"].as_str().unwrap_or_default(),
        );
        if frame["dir"] != "response" || frame["framing"] != "v1" || !(cmd == 102 || cmd == 108) {
            continue;
        }
        let Some((_, [roll_deg, nose_down_deg], fed_dps)) =
            FED.iter().find(|(words, ..)| note.contains(words))
        else {
            continue;
        };
        let is_turning = fed_dps.iter().any(|r| *r != 0.0);
        // The newest firmware runs its own estimator on the fed rates, so its attitude leaves the fed pose.
        let estimates_itself = frame["version"]
            .as_str()
            .unwrap_or_default()
            .starts_with("2026");
        let hex = frame["hex"].as_str().unwrap();
        let bytes: Vec<u8> = (0..hex.len())
            .step_by(2)
            .map(|i| u8::from_str_radix(&hex[i..i + 2], 16).unwrap())
            .collect();
        let payload = &bytes[5..bytes.len() - 1];
        let firmware = if frame["firmware"] == "INAV" {
            Firmware::Inav
        } else {
            Firmware::Betaflight
        };
        let mut convert = Convert::new(firmware);
        if cmd == 108 {
            if is_turning && estimates_itself {
                continue;
            }
            let s = convert.attitude(Timestamp::ZERO, &Attitude::parse(payload).unwrap());
            assert!(
                (s.roll_rad.to_degrees() - roll_deg).abs() < 3.0,
                "{note}: roll {}",
                s.roll_rad.to_degrees()
            );
            assert!(
                (s.pitch_rad.to_degrees() + nose_down_deg).abs() < 3.0,
                "{note}: pitch {}",
                s.pitch_rad.to_degrees()
            );
            attitudes += 1;
        } else {
            let raw = RawImu::parse(payload).unwrap();
            let Some(s) = (0..40)
                .filter_map(|_| convert.imu(Timestamp::ZERO, &raw, true))
                .last()
            else {
                continue;
            };
            // At rest the specific force points up through the tilted body.
            let (r, p) = (roll_deg.to_radians(), -nose_down_deg.to_radians());
            let expected = [
                9.80665 * p.sin(),
                -9.80665 * r.sin() * p.cos(),
                -9.80665 * r.cos() * p.cos(),
            ];
            let got: [f64; 3] = s.accel_mps2.into();
            for axis in 0..3 {
                assert!(
                    (got[axis] - expected[axis]).abs() < 0.2,
                    "{note}: axis {axis} {got:?} for {expected:?}"
                );
            }
            let rates: [f64; 3] = s.gyro_radps.into();
            let expected = [fed_dps[0], -fed_dps[1], -fed_dps[2]];
            for axis in 0..3 {
                assert!(
                    (rates[axis].to_degrees() - expected[axis]).abs() < 0.5,
                    "{note}: rates {rates:?}"
                );
            }
            // The simulator of the newest firmware makes a field of 4096 counts, 60 degrees below the horizon to the north.
            if let Some(mag) = s.mag {
                let level =
                    vehicle::Rot::<vehicle::Frd, vehicle::Ned>::from_roll_pitch_yaw(r, p, 0.0)
                        * mag;
                assert!((level.norm() - 4096.0).abs() < 10.0, "{note}: {mag:?}");
                assert!((level.z() - 3547.0).abs() < 60.0, "{note}: down {level:?}");
                let heading_deg = if note.contains("heading 270") {
                    270.0
                } else {
                    0.0
                };
                let course = level.y().atan2(level.x());
                let off = vehicle::angle::wrap_pi(course + f64::to_radians(heading_deg));
                assert!(off.to_degrees().abs() < 8.0, "{note}: {course} off {off}");
                mags += 1;
            }
            imus += 1;
        }
    }
    println!(
        "{attitudes} attitudes, {imus} inertial samples, {mags} of them with a magnetic field"
    );
    assert!(mags >= 3, "{mags} magnetic fields");
    assert!(
        attitudes >= 5 && imus >= 5,
        "{attitudes} attitudes, {imus} inertial samples"
    );
}
