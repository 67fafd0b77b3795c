//! Frames recorded from running Betaflight 4.6, Betaflight 2026.12 and INAV 9, and constructed
//! streams.
//!
//! The corpus is not part of the repository: `KESTREL_DATA` names the folder that holds
//! `msp/frames.jsonl` and `msp/streams.jsonl`; without it the tests say that they are skipped.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![expect(clippy::unwrap_used, reason = "tests")]

use msp::frame::{Accept, Decoder, Direction, Framing, Resync};
use msp::message::{FcVariant, Order, Reply};
use msp::{Firmware, Message, Server, command};
use serde_json::Value;
use std::path::PathBuf;

/// The lines of a corpus file, or `None` and a note.
fn corpus(name: &str) -> Option<Vec<Value>> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let folder =
        std::env::var_os("KESTREL_DATA").map_or_else(|| PathBuf::from(default), PathBuf::from);
    let Ok(text) = std::fs::read_to_string(folder.join("msp").join(name)) else {
        eprintln!("SKIPPED: no msp/{name} in KESTREL_DATA");
        return None;
    };
    Some(
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect(),
    )
}

fn bytes(hex: &Value) -> Vec<u8> {
    let hex = hex.as_str().unwrap();
    (0..hex.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap())
        .collect()
}

fn hex(bytes: impl AsRef<[u8]>) -> String {
    bytes
        .as_ref()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

fn framing(name: &str) -> Framing {
    match name {
        "v1" | "v1-jumbo" => Framing::V1,
        "v2" => Framing::V2,
        "v2-over-v1" => Framing::V2OverV1,
        _ => panic!("unknown framing {name}"),
    }
}

#[test]
fn recorded_frames_decode_as_recorded_and_encode_to_the_same_bytes() {
    let Some(records) = corpus("frames.jsonl") else {
        return;
    };
    let mut checked = 0;
    for record in records.iter().filter(|record| record["dir"] != "stream") {
        let wire = bytes(&record["hex"]);
        let mut decoder = Decoder::new(Accept::Any);
        let frame = decoder
            .decode(&mut wire.as_slice())
            .unwrap_or_else(|| panic!("no frame in {record}"));
        assert_eq!(
            u64::from(frame.command),
            record["cmd"].as_u64().unwrap(),
            "{record}"
        );
        assert_eq!(
            frame.framing,
            framing(record["framing"].as_str().unwrap()),
            "{record}"
        );
        let expected = match (record["dir"].as_str().unwrap(), &record["decoded"]["error"]) {
            ("request", _) => Direction::Request,
            (_, Value::Bool(true)) => Direction::Error,
            _ => Direction::Reply,
        };
        assert_eq!(frame.direction, expected, "{record}");
        let mut again = Vec::new();
        frame.encode(&mut again).unwrap();
        assert_eq!(again, wire, "{record}");
        checked += 1;
    }
    assert!(checked > 350, "only {checked} frames in the corpus");
}

#[test]
fn recorded_replies_carry_the_recorded_values_and_emit_the_same_payload() {
    let Some(records) = corpus("frames.jsonl") else {
        return;
    };
    let (mut compared, mut same) = (0, 0);
    for record in records
        .iter()
        .filter(|record| record["dir"] == "response" && record["decoded"]["error"].is_null())
    {
        let wire = bytes(&record["hex"]);
        let mut decoder = Decoder::new(Accept::Replies);
        let frame = decoder.decode(&mut wire.as_slice()).unwrap();
        let reply = Reply::parse(frame.command, frame.payload)
            .unwrap_or_else(|error| panic!("{error}: {record}"));
        compared += compare(&reply, &record["decoded"], record);
        let mut again = Vec::new();
        reply.emit(&mut again);
        // Firmware may append what this crate does not know; what it knows comes out as it went in.
        assert!(frame.payload.starts_with(&again), "{record}\n{again:02x?}");
        same += usize::from(frame.payload == again);
    }
    eprintln!("{compared} values compared, {same} payloads the same to the last byte");
    assert!(
        compared > 550 && same > 140,
        "{compared} values, {same} payloads"
    );
}

/// Compares every decoded field of the record that the message has; the number of values compared.
fn compare(reply: &Reply, decoded: &Value, record: &Value) -> usize {
    let text = |text: &[u8]| Value::from(String::from_utf8_lossy(text).into_owned());
    let list = |values: &[u16]| Value::from(values.to_vec());
    let axes = |name: &str, values: [i16; 3]| {
        ["x", "y", "z"]
            .into_iter()
            .zip(values)
            .map(|(axis, value)| (format!("{name}_{axis}"), value.into()))
            .collect::<Vec<_>>()
    };
    let head = |head: &msp::message::StatusHead| -> Vec<(String, Value)> {
        vec![
            ("cycle_time_us".into(), head.cycle_time_us.into()),
            ("i2c_errors".into(), head.i2c_errors.into()),
            ("sensors".into(), head.sensors.into()),
            ("mode_flags".into(), head.mode_flags.into()),
            ("profile".into(), head.profile.into()),
        ]
    };
    let tail = |tail: &msp::message::StatusTail| -> Vec<(String, Value)> {
        vec![
            (
                "extra_mode_flag_bytes".into(),
                tail.more_mode_flags.len().into(),
            ),
            (
                "extra_mode_flags_hex".into(),
                hex(&tail.more_mode_flags).into(),
            ),
            (
                "arming_disable_flag_count".into(),
                tail.arming_disable_count.into(),
            ),
            ("arming_disable_flags".into(), tail.arming_disable.into()),
            ("config_state_flags".into(), tail.config_state.into()),
            ("cpu_temp_c".into(), tail.cpu_temperature_c.into()),
            ("rate_profile_count".into(), tail.rate_profile_count.into()),
            (
                "battery_profile_count".into(),
                tail.battery_profiles.map(|profiles| profiles.count).into(),
            ),
            (
                "battery_profile".into(),
                tail.battery_profiles
                    .map(|profiles| profiles.current)
                    .into(),
            ),
        ]
    };
    macro_rules! fields {
        ($message:expr; $($key:literal = $field:ident),* $(,)?) => { vec![$(($key.to_string(), Value::from($message.$field))),*] };
    }
    let values: Vec<(String, Value)> = match reply {
        Reply::ApiVersion(m) => {
            fields![m; "protocol" = protocol, "api_major" = major, "api_minor" = minor]
        }
        Reply::FcVariant(m) => vec![("variant".into(), text(&m.variant))],
        Reply::FcVersion(m) => {
            let mut values = fields![m; "major" = major, "minor" = minor, "patch" = patch];
            values.push((
                "text".into(),
                m.text.as_ref().map(|text| text.as_str()).into(),
            ));
            values
        }
        Reply::BoardInfo(m) => {
            let short = |text: &Option<msp::ShortText>| {
                Value::from(text.as_ref().map(|text| text.as_str()))
            };
            let mut values = fields![m; "hw_rev" = hardware_revision, "osd_type" = osd_type, "capabilities" = capabilities, "mcu_type" = mcu_type,
                "config_state" = config_state, "gyro_rate_hz" = gyro_rate_hz, "config_problems" = config_problems,
                "spi_devices" = spi_devices, "i2c_devices" = i2c_devices];
            values.extend([
                ("board".into(), text(&m.board)),
                ("target".into(), short(&m.target)),
                ("board_name".into(), short(&m.board_name)),
                ("manufacturer".into(), short(&m.manufacturer)),
                ("signature".into(), m.signature.map(hex).into()),
            ]);
            values
        }
        Reply::BuildInfo(m) => vec![
            ("date".into(), text(&m.date)),
            ("time".into(), text(&m.time)),
            ("revision".into(), text(&m.revision)),
        ],
        Reply::Name(m) => vec![("name".into(), m.name.as_str().into())],
        Reply::Uid(m) => vec![
            ("uid0".into(), m.uid[0].into()),
            ("uid1".into(), m.uid[1].into()),
            ("uid2".into(), m.uid[2].into()),
        ],
        Reply::ModeRanges(m) => {
            let used: Vec<Value> = m.slots.iter().filter(|slot| slot.is_used()).map(|slot| serde_json::json!({
                "permanent_id": slot.permanent_id, "aux": slot.aux, "start_us": slot.start_us(), "end_us": slot.end_us(),
            })).collect();
            vec![
                ("ranges".into(), used.into()),
                ("slots".into(), m.slots.len().into()),
            ]
        }
        Reply::FeatureConfig(m) => fields![m; "features" = features],
        Reply::MixerConfig(m) => fields![m; "mixer_mode" = mixer_mode],
        Reply::MotorConfig(m) => {
            fields![m; "min_throttle" = min_throttle_us, "max_throttle" = max_throttle_us, "min_command" = min_command_us]
        }
        Reply::RxConfig(m) => {
            fields![m; "serialrx_provider" = serial_provider, "maxcheck" = max_check_us, "midrc" = mid_rc_us,
            "mincheck" = min_check_us, "spektrum_sat_bind" = spektrum_sat_bind, "rx_min_usec" = rx_min_us, "rx_max_usec" = rx_max_us]
        }
        Reply::RxMap(m) => vec![("map".into(), m.map.to_vec().into())],
        Reply::FailsafeConfig(m) => {
            fields![m; "delay_ds" = delay_ds, "off_delay_or_landing_s" = landing_time, "throttle_us" = throttle_us,
            "switch_mode" = switch_mode, "throttle_low_delay_ds" = throttle_low_delay_ds, "procedure" = procedure]
        }
        Reply::Status(m) => {
            let mut values = head(&m.head);
            values.extend(fields![m; "load_pct" = load_pct, "gyro_cycle_time" = gyro_cycle_us]);
            values.extend(m.tail.as_ref().map(tail).unwrap_or_default());
            values
        }
        Reply::StatusEx(m) => {
            let mut values = head(&m.head);
            values.push(("load_pct".into(), m.load_pct.into()));
            match &m.tail {
                msp::message::StatusExTail::Betaflight {
                    pid_profile_count,
                    rate_profile,
                    tail: rest,
                } => {
                    values.extend([
                        ("pid_profile_count".into(), (*pid_profile_count).into()),
                        ("rate_profile".into(), (*rate_profile).into()),
                    ]);
                    values.extend(tail(rest));
                }
                msp::message::StatusExTail::Inav {
                    arming_flags_low,
                    acc_calibration,
                } => {
                    values.extend([
                        ("arming_flags_low16".into(), (*arming_flags_low).into()),
                        ("acc_calib_axis_flags".into(), (*acc_calibration).into()),
                    ]);
                }
                msp::message::StatusExTail::Cleanflight => panic!("not in the corpus: {record}"),
            }
            values
        }
        Reply::InavStatus(m) => {
            let mut values = fields![m; "cycle_time_us" = cycle_time_us, "i2c_errors" = i2c_errors, "sensors" = sensors, "load_pct" = load_pct,
                "arming_flags" = arming_flags, "mode_flags" = mode_flags, "mixer_profile" = mixer_profile];
            values.extend([
                ("profile".into(), m.profile().into()),
                ("battery_profile".into(), m.battery_profile().into()),
            ]);
            values
        }
        Reply::RawImu(m) => [axes("acc", m.acc), axes("gyro", m.gyro), axes("mag", m.mag)].concat(),
        Reply::Attitude(m) => {
            fields![m; "roll_ddeg" = roll_ddeg, "pitch_ddeg" = pitch_ddeg, "yaw_deg" = yaw_deg]
        }
        Reply::AttitudeQuaternion(m) => {
            fields![m; "w_q15" = w_q15, "x_q15" = x_q15, "y_q15" = y_q15, "z_q15" = z_q15]
        }
        Reply::Altitude(m) => fields![m; "altitude_cm" = altitude_cm, "vario_cms" = vario_cms],
        Reply::SonarAltitude(m) => fields![m; "altitude_cm" = altitude_cm],
        Reply::RawGps(m) => {
            fields![m; "fix" = fix, "num_sat" = satellites, "lat_e7" = lat_e7, "lon_e7" = lon_e7, "alt_m" = altitude_m,
            "ground_speed_cms" = ground_speed_cms, "ground_course_ddeg" = course_ddeg]
        }
        Reply::InavOpticalFlow(m) => {
            fields![m; "quality" = quality, "flow_x_dps" = flow_x_dps, "flow_y_dps" = flow_y_dps,
            "body_x_dps" = body_x_dps, "body_y_dps" = body_y_dps]
        }
        Reply::Analog(m) => {
            fields![m; "vbat_dv" = vbat_dv, "mah_drawn" = drawn_mah, "rssi" = rssi, "amperage_ca" = current_ca]
        }
        Reply::BatteryState(m) => {
            fields![m; "cells" = cells, "capacity_mah" = capacity_mah, "vbat_dv" = vbat_dv, "mah_drawn" = drawn_mah,
            "amperage_ca" = current_ca, "state" = state, "vbat_cv" = vbat_cv]
        }
        Reply::InavAnalog(m) => fields![m; "vbat_cv" = vbat_cv, "amperage_ca" = current_ca],
        Reply::Motor(m) => vec![("motors".into(), list(&m.motors_us))],
        Reply::Rc(m) => vec![("channels".into(), list(&m.channels_us))],
        Reply::BoxNames(m) => vec![("names".into(), m.names().collect::<Vec<_>>().into())],
        Reply::BoxIds(m) => vec![("permanent_ids".into(), m.ids.to_vec().into())],
        Reply::CompGps(m) => {
            fields![m; "distance_home_m" = distance_home_m, "direction_home_deg" = direction_home_deg, "update" = update]
        }
        Reply::NavStatus(m) => {
            fields![m; "mode" = mode, "state" = state, "active_wp_action" = active_wp_action, "active_wp_number" = active_wp_number,
            "error" = error, "heading_hold_target" = heading_hold_target_deg]
        }
        Reply::SensorConfig(m) => vec![("hardware".into(), m.hardware.to_vec().into())],
        Reply::Servo(m) => vec![("servos".into(), list(&m.servos_us))],
        Reply::Debug(m) => vec![("debug".into(), m.debug.to_vec().into())],
        Reply::InavAirSpeed(m) => fields![m; "airspeed_cms" = airspeed_cms],
        Reply::Ack { .. } => vec![("payload_hex".into(), "".into())],
        Reply::Ident(_) | Reply::Reboot(_) | Reply::SimulatorReply(_) => {
            panic!("not in the corpus: {record}")
        }
        Reply::Other(_) => panic!("a reply without a struct: {record}"),
    };
    // What the recorder wrote beside the values.
    let notes = [
        "acc_unit",
        "gyro_unit",
        "active_permanent_ids",
        "extra_trailing_bytes",
    ];
    for key in decoded.as_object().unwrap().keys() {
        let is_read = values.iter().any(|(name, _)| name == key);
        assert!(
            is_read || notes.contains(&key.as_str()),
            "{key} is not compared in {record}"
        );
    }
    let mut compared = 0;
    for (key, value) in values.iter().filter(|(key, _)| !decoded[key].is_null()) {
        assert_eq!(value, &decoded[key], "{key} in {record}");
        compared += 1;
    }
    compared
}

#[test]
fn recorded_requests_are_typed_and_emit_the_same_payload() {
    let Some(records) = corpus("frames.jsonl") else {
        return;
    };
    let mut checked = 0;
    for record in records.iter().filter(|record| record["dir"] == "request") {
        let wire = bytes(&record["hex"]);
        let mut decoder = Decoder::new(Accept::Requests);
        let frame = decoder.decode(&mut wire.as_slice()).unwrap();
        assert_eq!(
            hex(frame.payload),
            record["decoded"]["payload_hex"],
            "{record}"
        );
        // Some were recorded because they are wrong: the firmware refused those as well.
        let Ok(order) = Order::parse(frame.command, frame.payload) else {
            let is_short =
                frame.command == command::SET_MOTOR || frame.command == command::SET_MODE_RANGE;
            assert!(is_short, "{record}");
            continue;
        };
        assert_eq!(order.command(), frame.command, "{record}");
        let mut again = Vec::new();
        order.emit(&mut again);
        assert_eq!(hex(&again), record["decoded"]["payload_hex"], "{record}");
        checked += 1;
    }
    assert!(checked > 130, "only {checked} requests in the corpus");
}

#[test]
fn recorded_mode_flags_mean_the_boxes_the_recorder_saw() {
    let Some(records) = corpus("frames.jsonl") else {
        return;
    };
    let replies = || {
        records
            .iter()
            .filter(|record| record["dir"] == "response" && record["decoded"]["error"].is_null())
    };
    let parse = |record: &Value| {
        let wire = bytes(&record["hex"]);
        let mut decoder = Decoder::new(Accept::Replies);
        let frame = decoder.decode(&mut wire.as_slice()).unwrap();
        Reply::parse(frame.command, frame.payload).unwrap()
    };
    let mut checked = 0;
    for record in replies().filter(|record| record["decoded"]["active_permanent_ids"].is_array()) {
        let is_box_list = |other: &&Value| {
            other["cmd"] == command::BOXIDS && other["version"] == record["version"]
        };
        let Some(Reply::BoxIds(list)) = replies().find(is_box_list).map(parse) else {
            continue;
        };
        let status = parse(record);
        let is_on = |index: usize| match &status {
            Reply::Status(status) => status.mode_flag(index),
            Reply::StatusEx(status) => status.mode_flag(index),
            Reply::InavStatus(status) => status.mode_flag(index),
            _ => panic!("no status: {record}"),
        };
        let on: Vec<u8> = list
            .ids
            .iter()
            .enumerate()
            .filter(|(index, _)| is_on(*index))
            .map(|(_, id)| *id)
            .collect();
        assert_eq!(
            Value::from(on),
            record["decoded"]["active_permanent_ids"],
            "{record}"
        );
        checked += 1;
    }
    assert!(checked > 15, "only {checked} states in the corpus");
}

#[test]
fn recorded_units_are_those_of_the_firmware_table() {
    let Some(records) = corpus("frames.jsonl") else {
        return;
    };
    let mut checked = 0;
    for record in records
        .iter()
        .filter(|record| record["decoded"]["gyro_unit"].is_string())
    {
        let letters: [u8; 4] = record["firmware"]
            .as_str()
            .unwrap()
            .as_bytes()
            .try_into()
            .unwrap();
        let firmware = Firmware::from(FcVariant { variant: letters });
        let expected = if firmware == Firmware::Inav {
            "deg/s".to_owned()
        } else {
            format!("1/{} deg/s", firmware.gyro_counts_per_dps())
        };
        assert!(
            record["decoded"]["gyro_unit"]
                .as_str()
                .unwrap()
                .starts_with(&expected),
            "{record}"
        );
        if let Some(counts) = firmware.acc_counts_per_g() {
            assert_eq!(
                record["decoded"]["acc_unit"],
                format!("1/{counts} g"),
                "{record}"
            );
        }
        checked += 1;
    }
    assert!(checked > 10, "only {checked} IMU samples in the corpus");
}

#[test]
fn stick_order_of_rc_is_not_that_of_set_raw_rc() {
    let Some(records) = corpus("frames.jsonl") else {
        return;
    };
    // Sent: 1501 1502 1003 1504 in the order of the map. Seen: Roll, Pitch, Yaw, Throttle.
    let record = records
        .iter()
        .find(|record| record["id"] == "inav-137")
        .unwrap();
    let wire = bytes(&record["hex"]);
    let mut decoder = Decoder::new(Accept::Replies);
    let frame = decoder.decode(&mut wire.as_slice()).unwrap();
    let seen = msp::message::Rc::parse(frame.payload).unwrap().channels_us;
    let sent =
        msp::message::RxMap::aetr().arrange([seen[0], seen[1], seen[2], seen[3]], &seen[4..8]);
    assert_eq!(
        sent.as_slice(),
        [1501, 1502, 1003, 1504, 1005, 1006, 1007, 1008]
    );
}

#[test]
fn server_hears_what_the_firmware_heard() {
    let Some(records) = corpus("frames.jsonl") else {
        return;
    };
    let mut checked = 0;
    for record in records.iter().filter(|record| record["dir"] == "stream") {
        // Recorded replies, one frame each, in order: as many requests and the same commands.
        let reply = bytes(&record["decoded"]["reply_hex"]);
        let mut replied = Vec::new();
        let (mut decoder, mut input) = (Decoder::new(Accept::Replies), reply.as_slice());
        while let Some(frame) = decoder.decode(&mut input) {
            replied.push(frame.command);
        }
        let mut server = Server::new();
        server.handle(&bytes(&record["hex"]));
        let heard: Vec<u16> = std::iter::from_fn(|| server.pop())
            .map(|request| request.command)
            .collect();
        assert_eq!(heard, replied, "{record}");
        checked += 1;
    }
    assert!(checked > 10, "only {checked} streams in the corpus");
}

#[test]
fn constructed_streams_yield_the_expected_frames_and_errors() {
    let Some(records) = corpus("streams.jsonl") else {
        return;
    };
    for (record, resync) in records
        .iter()
        .flat_map(|record| [(record, Resync::Rescan), (record, Resync::Skip)])
    {
        let wire = bytes(&record["hex"]);
        for piece in [1, 7, wire.len()] {
            let mut decoder = Decoder::with_limits(Accept::Any, resync, 4096);
            let mut frames = Vec::new();
            for mut input in wire.chunks(piece) {
                while let Some(frame) = decoder.decode(&mut input) {
                    let direction = match frame.direction {
                        Direction::Error => "error",
                        Direction::Reply => "response",
                        Direction::Request => "request",
                    };
                    frames.push((
                        frame.command,
                        frame.payload.to_vec(),
                        frame.framing,
                        direction,
                    ));
                }
            }
            let expected: Vec<_> = record["expect_frames"]
                .as_array()
                .unwrap()
                .iter()
                .map(|frame| {
                    let command = u16::try_from(frame["cmd"].as_u64().unwrap()).unwrap();
                    (
                        command,
                        bytes(&frame["payload_hex"]),
                        framing(frame["version"].as_str().unwrap()),
                        frame["dir"].as_str().unwrap(),
                    )
                })
                .collect();
            assert_eq!(frames, expected, "{record}");
            if let Some(errors) = record["expect_errors"].as_u64() {
                assert_eq!(decoder.counters().bad_frames(), errors, "{record}");
            }
        }
    }
}

#[test]
fn names_of_commands_are_those_of_the_corpus() {
    let Some(records) = corpus("frames.jsonl") else {
        return;
    };
    for record in records.iter().filter(|record| record["dir"] != "stream") {
        let name = command::name(u16::try_from(record["cmd"].as_u64().unwrap()).unwrap());
        let recorded = record["name"].as_str().unwrap();
        if recorded.starts_with("unknown") {
            assert_eq!(name, "MSP command", "{record}");
        } else {
            // The recorder added which text was asked to MSP2_GET_TEXT.
            assert!(recorded.starts_with(name), "{name}: {record}");
        }
    }
}
