//! `kestrel msp decode` on the recorded frames: decoded as recorded, encoded again to the same bytes.

#![expect(clippy::unwrap_used, reason = "tests")]

use msp::frame::{Direction, Frame, Framing};
use serde_json::Value;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// The lines of a corpus file, or `None` and a note.
fn corpus(name: &str) -> Option<Vec<Value>> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let folder =
        std::env::var_os("KESTREL_DATA").map_or_else(|| PathBuf::from(default), PathBuf::from);
    let Ok(text) = std::fs::read_to_string(folder.join("msp").join(name)) else {
        eprintln!("SKIPPED: no msp/{name} in KESTREL_DATA");
        return None;
    };
    let lines = text.lines().map(|line| serde_json::from_str(line).unwrap());
    Some(lines.collect())
}

/// What the program prints for these lines: objects, and the last line of its standard error.
fn decode(arguments: &[&str], input: &[u8]) -> (Vec<Value>, String) {
    let mut program = Command::new(env!("CARGO_BIN_EXE_kestrel"))
        .args(["msp", "decode"])
        .args(arguments)
        .arg("-")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = program.stdin.take().unwrap();
    let input = input.to_vec();
    let writer = std::thread::spawn(move || stdin.write_all(&input));
    let output = program.wait_with_output().unwrap();
    writer.join().unwrap().unwrap();
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    let objects = text.lines().map(|line| serde_json::from_str(line).unwrap());
    (objects.collect(), String::from_utf8(output.stderr).unwrap())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(hex: &Value) -> Vec<u8> {
    let (pairs, _) = hex.as_str().unwrap().as_bytes().as_chunks::<2>();
    pairs
        .iter()
        .map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

/// The frame of an object, encoded again.
fn encode(object: &Value) -> Vec<u8> {
    let payload = unhex(&object["payload_hex"]);
    let frame = Frame {
        framing: match object["version"].as_str().unwrap() {
            "v1" => Framing::V1,
            "v2" => Framing::V2,
            _ => Framing::V2OverV1,
        },
        direction: match object["dir"].as_str().unwrap() {
            "request" => Direction::Request,
            "response" => Direction::Reply,
            _ => Direction::Error,
        },
        flag: u8::try_from(object["flag"].as_u64().unwrap_or(0)).unwrap(),
        command: u16::try_from(object["cmd"].as_u64().unwrap()).unwrap(),
        payload: &payload,
    };
    let mut wire = Vec::new();
    frame.encode(&mut wire).unwrap();
    wire
}

#[test]
fn every_recorded_frame_is_printed_as_recorded_and_encodes_to_the_same_bytes() {
    let Some(mut records) = corpus("frames.jsonl") else {
        return;
    };
    records.retain(|record| record["dir"] != "stream");
    let lines: Vec<&str> = records
        .iter()
        .map(|record| record["hex"].as_str().unwrap())
        .collect();
    let (objects, errors) = decode(&["--hex"], lines.join("\n").as_bytes());
    assert_eq!(objects.len(), records.len());
    assert!(
        errors.contains("bad: 0 checksum, 0 oversize, 0 malformed, 0 truncated; 0 bytes of noise"),
        "{errors}"
    );
    let mut values = 0;
    for (object, record) in objects.iter().zip(&records) {
        assert_eq!(object["cmd"], record["cmd"], "{record}");
        assert_eq!(object["framing"], record["framing"], "{record}");
        let is_error = record["decoded"]["error"] == true;
        assert_eq!(
            object["dir"],
            if is_error {
                "error".into()
            } else {
                record["dir"].clone()
            },
            "{record}"
        );
        assert_eq!(hex(&encode(object)), record["hex"], "{record}");
        // Fields that have the recorder's name must have its value; other names are the golden test's.
        for (key, value) in record["decoded"].as_object().unwrap() {
            // The recorder counts the slots, we list them.
            if let Some(ours) = object["fields"].get(key).filter(|_| key != "slots") {
                assert_eq!(ours, value, "{key}: {object}\n{record}");
                values += 1;
            }
        }
    }
    assert!(
        values > 300,
        "only {values} values have the recorder's name"
    );
}

#[test]
fn streams_yield_the_expected_frames_by_line_and_as_one_raw_stream() {
    let Some(records) = corpus("streams.jsonl") else {
        return;
    };
    let mut raw = Vec::new();
    let mut expected_of_all = Vec::new();
    for record in &records {
        let (objects, errors) = decode(&["--hex"], record["hex"].as_str().unwrap().as_bytes());
        let expected = record["expect_frames"].as_array().unwrap();
        assert_eq!(objects.len(), expected.len(), "{record}\n{objects:?}");
        for (object, frame) in objects.iter().zip(expected) {
            for key in ["cmd", "payload_hex", "version", "dir"] {
                assert_eq!(object[key], frame[key], "{record}");
            }
        }
        if let Some(count) = record["expect_errors"].as_u64() {
            assert!(
                errors.contains(&format!(
                    "bad: {count} checksum, 0 oversize, 0 malformed, 0 truncated"
                )),
                "{record}\n{errors}"
            );
        }
        // Those without errors are the bytes of their frames and nothing else.
        if record["expect_errors"] == 0 {
            let again: Vec<u8> = objects.iter().flat_map(encode).collect();
            assert_eq!(hex(&again), record["hex"], "{record}");
        }
        raw.extend(unhex(&record["hex"]));
        expected_of_all.extend(expected.iter().map(|frame| frame["payload_hex"].clone()));
    }
    let (objects, _) = decode(&[], &raw);
    let payloads: Vec<Value> = objects
        .iter()
        .map(|object| object["payload_hex"].clone())
        .collect();
    assert_eq!(payloads, expected_of_all);
}
