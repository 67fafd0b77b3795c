//! Our codec beside the crate `mavlink`, and pymavlink where it is installed, over one stream: 100 cycles of 64 messages as a vehicle
//! sends them, fixed seed. `cargo bench -p mavlink-dialect --bench codec`; `KESTREL_PYTHON` names a Python with pymavlink.
//!
//! One JSON line each: parse and serialise in ns a message, allocations, what is recovered from a noisy stream.

#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]
#![expect(clippy::disallowed_methods, reason = "a bench reads the clock")]

use mavlink_dialect::standard::{self, MavMessage as Std};
use mavlink_dialect::{Address, Decoder, Encoder, Message, raw};
use std::hint::black_box;
use std::time::Instant;

struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
    fn f(&mut self) -> f32 {
        (self.next() >> 40) as f32 / 16_777_216.0 - 0.5
    }
}

type Make = fn(&mut Dice) -> Message;

/// 64 slots: how many of each message, spread evenly.
fn mix() -> Vec<Message> {
    let kinds: [(usize, Make); 13] = [
        (1, |_| {
            Message::Raw(raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA {
                mavtype: 2,
                autopilot: 12,
                base_mode: 157,
                custom_mode: 50_593_792,
                system_status: 4,
                mavlink_version: 3,
            }))
        }),
        (1, |d| {
            Std::SYS_STATUS(standard::SYS_STATUS_DATA {
                voltage_battery: 15_400,
                load: d.next() as u16 % 900,
                ..Default::default()
            })
            .into()
        }),
        (12, |d| {
            Std::ATTITUDE(standard::ATTITUDE_DATA {
                time_boot_ms: d.next() as u32,
                roll: d.f(),
                pitch: d.f(),
                yaw: d.f(),
                rollspeed: d.f(),
                pitchspeed: d.f(),
                yawspeed: d.f(),
            })
            .into()
        }),
        (6, |d| {
            Std::ATTITUDE_QUATERNION(standard::ATTITUDE_QUATERNION_DATA {
                time_boot_ms: d.next() as u32,
                q1: d.f(),
                q2: d.f(),
                q3: d.f(),
                q4: d.f(),
                ..Default::default()
            })
            .into()
        }),
        (12, |d| {
            Std::LOCAL_POSITION_NED(standard::LOCAL_POSITION_NED_DATA {
                time_boot_ms: d.next() as u32,
                x: d.f(),
                y: d.f(),
                z: d.f(),
                vx: d.f(),
                vy: d.f(),
                vz: d.f(),
            })
            .into()
        }),
        (12, |d| {
            Std::HIGHRES_IMU(standard::HIGHRES_IMU_DATA {
                time_usec: d.next(),
                xacc: d.f(),
                yacc: d.f(),
                zacc: d.f(),
                xgyro: d.f(),
                ygyro: d.f(),
                zgyro: d.f(),
                ..Default::default()
            })
            .into()
        }),
        (8, |d| {
            Std::DISTANCE_SENSOR(standard::DISTANCE_SENSOR_DATA {
                time_boot_ms: d.next() as u32,
                current_distance: d.next() as u16 % 400,
                max_distance: 400,
                ..Default::default()
            })
            .into()
        }),
        (4, |d| {
            let mut m = standard::OBSTACLE_DISTANCE_DATA {
                time_usec: d.next(),
                ..Default::default()
            };
            m.distances
                .iter_mut()
                .for_each(|v| *v = d.next() as u16 % 800);
            Std::OBSTACLE_DISTANCE(m).into()
        }),
        (4, |d| {
            let mut m = standard::ODOMETRY_DATA {
                time_usec: d.next(),
                x: d.f(),
                y: d.f(),
                z: d.f(),
                ..Default::default()
            };
            m.pose_covariance.iter_mut().for_each(|v| *v = d.f());
            Std::ODOMETRY(m).into()
        }),
        (1, |d| {
            Std::BATTERY_STATUS(standard::BATTERY_STATUS_DATA {
                current_battery: d.next() as i16,
                ..Default::default()
            })
            .into()
        }),
        (1, |d| {
            Std::VFR_HUD(standard::VFR_HUD_DATA {
                groundspeed: d.f(),
                climb: d.f(),
                ..Default::default()
            })
            .into()
        }),
        (1, |d| {
            Std::RC_CHANNELS(standard::RC_CHANNELS_DATA {
                time_boot_ms: d.next() as u32,
                chan1_raw: 1500,
                ..Default::default()
            })
            .into()
        }),
        (1, |d| {
            Std::ESTIMATOR_STATUS(standard::ESTIMATOR_STATUS_DATA {
                time_usec: d.next(),
                vel_ratio: d.f(),
                ..Default::default()
            })
            .into()
        }),
    ];
    let mut dice = Dice(12_345);
    let mut slots: Vec<(f64, usize)> = Vec::new();
    for (k, (n, _)) in kinds.iter().enumerate() {
        slots.extend((0..*n).map(|i| ((i as f64 + 0.5) / *n as f64, k)));
    }
    slots.sort_by(|a, b| a.partial_cmp(b).unwrap());
    (0..100)
        .flat_map(|_| slots.clone())
        .map(|(_, k)| (kinds[k].1)(&mut dice))
        .collect()
}

/// Best of 60 runs, ns a message.
fn best(messages: usize, mut run: impl FnMut()) -> f64 {
    (0..60)
        .map(|_| {
            let begin = Instant::now();
            run();
            begin.elapsed().as_nanos() as f64 / messages as f64
        })
        .fold(f64::INFINITY, f64::min)
}

fn main() {
    // `cargo test --benches` passes this.
    let is_test = std::env::args().any(|a| a == "--test");
    let us = Address {
        system: 1,
        component: 1,
    };
    let messages = mix();
    let n = messages.len();
    let mut encoder = Encoder::new(us);
    let stream: Vec<u8> = messages
        .iter()
        .flat_map(|m| encoder.encode_message(m))
        .collect();
    if is_test {
        return;
    }
    let mut decoder = Decoder::new();
    let parse = best(n, || {
        let mut seen = 0usize;
        // As a socket hands it over: 1,400 bytes at a time.
        for chunk in stream.chunks(1_400) {
            decoder.push_wire(chunk, |frame, message| {
                black_box(message);
                seen += usize::from(black_box(frame).sequence) + 1
            });
        }
        assert!(black_box(seen) >= n);
    });
    let pass = best(n, || {
        let mut seen = 0usize;
        for chunk in stream.chunks(1_400) {
            decoder.push_views(chunk, |view| {
                seen += usize::from(black_box(view).sequence) + 1
            });
        }
        assert!(black_box(seen) >= n);
    });
    let serialize = best(n, || {
        for m in &messages {
            black_box(encoder.encode_message(black_box(m)));
        }
    });
    let mut count = || {
        for chunk in stream.chunks(1_400) {
            decoder.push(chunk, |frame| {
                black_box(frame);
            });
        }
        for m in &messages {
            black_box(encoder.encode_message(m));
        }
    };
    let allocations = allocation_counter::measure(&mut count).count_total;
    let header = mavlink::MavHeader {
        system_id: 1,
        component_id: 1,
        sequence: 0,
    };
    let theirs_parse = best(n, || {
        let mut reader = mavlink::MavlinkReader::new(stream.as_slice());
        let mut seen = 0;
        while let Ok((_, m)) = reader.read_any_message::<Std>() {
            black_box(&m);
            seen += 1;
        }
        assert_eq!(seen, n);
    });
    let standard_only: Vec<&Std> = messages
        .iter()
        .filter_map(|m| match m {
            Message::Standard(m) => Some(m),
            Message::Raw(_) => None,
        })
        .collect();
    let mut out = Vec::with_capacity(512);
    let theirs_serialize = best(standard_only.len(), || {
        for m in &standard_only {
            out.clear();
            mavlink::write_v2_msg(&mut out, header, black_box(*m)).unwrap();
            black_box(&out);
        }
    });
    println!(
        "{{\"bench\":\"codec\",\"messages\":{n},\"bytes\":{},\"parse_ns\":{parse:.1},\"frame_only_ns\":{pass:.1},\"serialize_ns\":{serialize:.1},\"allocations\":{allocations},\"mavlink_parse_ns\":{theirs_parse:.1},\"mavlink_serialize_ns\":{theirs_serialize:.1}}}",
        stream.len()
    );
    garbage(&messages, us);
    python(&stream, n);
}

/// 1 % of the frames with a flipped bit, 5 % noise bytes between frames: every other frame is found.
fn garbage(messages: &[Message], us: Address) {
    let mut dice = Dice(7);
    let mut encoder = Encoder::new(us);
    let (mut stream, mut good) = (Vec::new(), Vec::new());
    for m in messages {
        let mut frame = encoder.encode_message(m);
        if dice.next().is_multiple_of(100) {
            let at = dice.next() as usize % (frame.len() - 10) + 10;
            frame[at] ^= 1 << (dice.next() % 8);
        } else {
            good.push(frame[4]);
        }
        for _ in 0..frame.len() {
            if dice.next().is_multiple_of(20) {
                // No start byte: what begins like a frame may swallow the next one on a stream, by the protocol.
                let byte = dice.next() as u8;
                stream.push(if byte >= 0xFD { 0 } else { byte });
            }
        }
        stream.extend(frame);
    }
    let mut got = Vec::new();
    let begin = Instant::now();
    let mut decoder = Decoder::new();
    decoder.push(&stream, |f| got.push(f.sequence));
    decoder.end_of_datagram(|f| got.push(f.sequence));
    let ns = begin.elapsed().as_nanos() as f64 / stream.len() as f64;
    println!(
        "{{\"bench\":\"codec/garbage\",\"good\":{},\"recovered\":{},\"all\":{},\"ns_per_byte\":{ns:.2}}}",
        good.len(),
        got.len(),
        got == good
    );
}

const PYTHON: &str = r#"
import os, sys, time
os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as m
data = open(sys.argv[1], "rb").read()
best_parse = best_pack = 1e9
for _ in range(3):
    link = m.MAVLink(None, 1, 1)
    t = time.perf_counter()
    messages = link.parse_buffer(data)
    best_parse = min(best_parse, time.perf_counter() - t)
    t = time.perf_counter()
    for x in messages:
        x.pack(link)
    best_pack = min(best_pack, time.perf_counter() - t)
n = len(messages)
print('{"bench":"codec/pymavlink","messages":%d,"parse_ns":%.0f,"serialize_ns":%.0f}' % (n, best_parse / n * 1e9, best_pack / n * 1e9))
"#;

fn python(stream: &[u8], n: usize) {
    let python = std::env::var("KESTREL_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let path = std::env::temp_dir().join(format!("kestrel-codec-{}.bin", std::process::id()));
    std::fs::write(&path, stream).unwrap();
    let done = std::process::Command::new(python)
        .args(["-c", PYTHON])
        .arg(&path)
        .output();
    let _ = std::fs::remove_file(&path);
    match done {
        Ok(done) if done.status.success() => print!("{}", String::from_utf8_lossy(&done.stdout)),
        _ => println!("SKIPPED: no Python with pymavlink for {n} messages (KESTREL_PYTHON)"),
    }
}
