//! The fake flight controller against recordings of the firmwares it pretends to be: the same questions are answered, the
//! same are refused, and answers are as long.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use msp::{Accept, Decoder, Direction, Framing, encode};
use sim::{Manner, Room, SimConfig, SimOutput, Simulator};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use vehicle::{RingConfig, Timestamp};

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

/// Length of the answer, none if refused.
type Answered = Option<usize>;

/// Questions of the recordings and how each was answered first, by the beginning of the record's name.
fn recorded(text: &str) -> BTreeMap<(String, u16), Answered> {
    let mut found = BTreeMap::new();
    for line in text.lines() {
        let frame: serde_json::Value = serde_json::from_str(line).unwrap();
        let Ok(cmd) = u16::try_from(frame["cmd"].as_i64().unwrap()) else {
            continue;
        };
        if frame["dir"] != "response"
            || frame["note"]
                .as_str()
                .is_some_and(|n| n.contains("without"))
        {
            continue;
        }
        let hex = frame["hex"].as_str().unwrap();
        let wire: Vec<u8> = (0..hex.len())
            .step_by(2)
            .map(|i| u8::from_str_radix(&hex[i..i + 2], 16).unwrap())
            .collect();
        let mut decoder = Decoder::new(Accept::Replies);
        let Some(reply) = decoder.decode(&mut wire.as_slice()) else {
            continue;
        };
        let from = frame["id"].as_str().unwrap().split('-').next().unwrap();
        let answered = (reply.direction == Direction::Reply).then_some(reply.payload.len());
        found.entry((from.to_owned(), cmd)).or_insert(answered);
    }
    found
}

fn ask(manner: Manner, cmd: u16) -> Answered {
    let ring = RingConfig::built_in("tof32").unwrap();
    let mut config = SimConfig::new(Room::named("office").unwrap(), ring, 1);
    config.vehicles[0].fc.manner = manner;
    let mut sim = Simulator::new(config).unwrap();
    let mut wire = Vec::new();
    let framing = if cmd < 255 { Framing::V1 } else { Framing::V2 };
    encode(framing, Direction::Request, cmd, &[], &mut wire).unwrap();
    sim.write_fc(0, &wire);
    let mut decoder = Decoder::new(Accept::Replies);
    let mut answered = None;
    sim.advance(Timestamp::from_ms(200), &mut |_, output| {
        if let SimOutput::FcBytes { bytes, .. } = output {
            let mut input = bytes.as_slice();
            while let Some(frame) = decoder.decode(&mut input) {
                let length = frame.payload.len();
                answered = Some((frame.direction == Direction::Reply).then_some(length));
            }
        }
    });
    answered.unwrap_or_else(|| panic!("{manner} does not answer {cmd} at all"))
}

/// Orders, and questions that take an argument.
const NOT_ASKED: [u16; 14] = [
    11, 35, 61, 99, 200, 205, 214, 230, 246, 247, 250, 12294, 68, 37,
];
/// Answers whose length is a matter of the configuration: names, box lists, build revision, servos.
const OWN_LENGTH: [u16; 8] = [3, 4, 5, 10, 34, 36, 116, 119];
/// What the fake does not have on board: servos, GPS (106, 107), sensor hardware (96), debug words, optical flow, air speed.
const NOT_ON_BOARD: [u16; 8] = [96, 103, 106, 107, 254, 0x2001, 0x2009, 121];

#[test]
fn the_fake_answers_as_the_recorded_firmware_did() {
    let Some(path) = data("msp/frames.jsonl") else {
        return;
    };
    let text = std::fs::read_to_string(path).unwrap();
    let mut wrong = Vec::new();
    let mut compared = 0;
    for ((from, cmd), wanted) in recorded(&text) {
        let manner = match from.as_str() {
            "46" => Manner::Betaflight46,
            "26" => Manner::BetaflightNew,
            "inav" => Manner::Inav,
            _ => continue,
        };
        if NOT_ASKED.contains(&cmd) || NOT_ON_BOARD.contains(&cmd) {
            continue;
        }
        let got = ask(manner, cmd);
        compared += 1;
        let same = if OWN_LENGTH.contains(&cmd) {
            got.is_some() == wanted.is_some()
        } else {
            got == wanted
        };
        if !same {
            wrong.push(format!(
                "{manner} {} ({cmd}): recorded {wanted:?}, fake {got:?}",
                msp::command::name(cmd)
            ));
        }
    }
    println!("{compared} questions compared");
    assert!(compared > 50, "{compared}");
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}
