//! Cost of parsing one frame, beside the crate `multiwii_serial_protocol_v2` on the same bytes in the same run.
//!
//! `cargo bench -p msp` prints one JSON line per row: best and median of the repetitions in ns per frame, and allocations
//! per frame. The streams are 4096 frames of 11 bytes of payload (v1: 17 bytes, v2: 20 bytes on the wire), read in pieces
//! of 512 bytes as a serial port hands them over.

#![allow(clippy::disallowed_methods, reason = "a bench reads the clock")]
#![expect(clippy::print_stdout, reason = "a bench prints")]

use msp::frame::{Accept, Decoder, Direction, Framing, encode};
use multiwii_serial_protocol_v2::MspParser;
use std::hint::black_box;
use std::time::Instant;

const FRAMES: usize = 4096;
const REPETITIONS: usize = 60;
const PIECE: usize = 512;
/// Bars of the reference host.
const V1_BAR_NS: f64 = 8.0;
const V2_BAR_NS: f64 = 30.0;

fn main() {
    for (name, framing, bar_ns) in [
        ("v1", Framing::V1, V1_BAR_NS),
        ("v2", Framing::V2, V2_BAR_NS),
    ] {
        let wire = stream(framing);
        let mut decoder = Decoder::new(Accept::Any);
        let ours = measure(&format!("parse/{name}"), || {
            let mut sum = 0;
            for mut piece in wire.chunks(PIECE) {
                while let Some(frame) = decoder.decode(&mut piece) {
                    sum += usize::from(frame.payload[0]) + 1;
                }
            }
            sum
        });
        let mut parser = MspParser::new();
        let theirs = measure(&format!("parse/{name}/multiwii_serial_protocol_v2"), || {
            let mut sum = 0;
            for byte in &wire {
                if let Ok(Some(packet)) = parser.parse(*byte) {
                    sum += usize::from(packet.data[0]) + 1;
                }
            }
            sum
        });
        let verdict = if ours.best_ns <= bar_ns {
            "ok"
        } else {
            "above"
        };
        println!(
            "{{\"bench\":\"parse/{name}/bar\",\"bar_ns\":{bar_ns},\"verdict\":\"{verdict}\",\"times_faster\":{:.1}}}",
            theirs.best_ns / ours.best_ns
        );
    }
    let payload: Vec<u8> = (0..11).collect();
    let mut out = Vec::with_capacity(FRAMES * 32);
    for (name, framing) in [("v1", Framing::V1), ("v2", Framing::V2)] {
        measure(&format!("encode/{name}"), || {
            out.clear();
            for _ in 0..FRAMES {
                let encoded = encode(
                    framing,
                    Direction::Reply,
                    108,
                    black_box(&payload),
                    &mut out,
                );
                assert!(encoded.is_ok());
            }
            out.len()
        });
    }
}

/// Frames one after the other.
fn stream(framing: Framing) -> Vec<u8> {
    let mut wire = Vec::new();
    for number in 0..FRAMES {
        let byte = number.to_le_bytes()[0];
        let payload =
            std::array::from_fn::<u8, 11, _>(|at| byte.wrapping_mul(31).wrapping_add(at as u8));
        let encoded = encode(framing, Direction::Reply, 108, &payload, &mut wire);
        assert!(encoded.is_ok());
    }
    wire
}

struct Cost {
    best_ns: f64,
}

fn measure(name: &str, mut pass: impl FnMut() -> usize) -> Cost {
    let expected = black_box(pass());
    let mut times_ns: Vec<f64> = (0..REPETITIONS)
        .map(|_| {
            let start = Instant::now();
            assert_eq!(black_box(pass()), expected, "every pass finds the same");
            start.elapsed().as_secs_f64() * 1e9 / FRAMES as f64
        })
        .collect();
    times_ns.sort_by(f64::total_cmp);
    let counted = allocation_counter::measure(|| {
        black_box(pass());
    });
    let (best_ns, median_ns) = (times_ns[0], times_ns[REPETITIONS / 2]);
    println!(
        "{{\"bench\":\"{name}\",\"best_ns\":{best_ns:.1},\"median_ns\":{median_ns:.1},\"allocations_per_frame\":{:.3}}}",
        counted.count_total as f64 / FRAMES as f64
    );
    Cost { best_ns }
}
