//! What comes over the lines of flight controllers and sensors.

use crate::fuzz;
use bridge::sensor::circle::Mount;
use bridge::sensor::gps::gpsd::Gpsd;
use bridge::sensor::ld06::{self, Ld06};
use bridge::sensor::msp_module::{self, MspModule};
use bridge::sensor::rplidar::Rplidar;
use bridge::sensor::tof_ring::TofRing;
use estimator::imu::ascii::{self, AsciiDecoder};
use estimator::imu::binary::BinaryDecoder;
use msp::client::{Client, Config};
use msp::frame::{Accept, Decoder};
use msp::{Order, Reply, Server};
use vehicle::Timestamp;

const AT: Timestamp = Timestamp::from_ms(1_000);

/// Puts the right checksum under whatever looks like an MSP frame of version 1.
fn healed(bytes: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let mut at = 0;
    while at + 6 <= out.len() {
        let end = at + 5 + usize::from(out[at + 3]);
        if out[at..at + 2] == *b"$M" && end < out.len() {
            out[end] = out[at + 3..end].iter().fold(0, |sum, b| sum ^ b);
            at = end + 1;
        } else {
            at += 1;
        }
    }
    out
}

fuzz!(
    /// A flight controller says whatever it likes, to whoever listens on the line.
    msp_line,
    |bytes: &[u8]| {
        for bytes in [bytes.to_vec(), healed(bytes)] {
            let mut input = bytes.as_slice();
            let mut decoder = Decoder::new(Accept::Any);
            while let Some(frame) = decoder.decode(&mut input) {
                for command in [frame.command, frame.command ^ 1] {
                    let _ = Reply::parse(command, frame.payload);
                    let _ = Order::parse(command, frame.payload);
                }
            }
            Server::new().handle(&bytes);
            let mut client = Client::new(Config::default());
            client.connect(0);
            for (i, chunk) in bytes.chunks(17).enumerate() {
                let now_us = 200_000 + i as u64 * 10_000;
                while client.poll_transmit(now_us).is_some() {}
                client.handle(now_us, chunk);
                while client.poll_event().is_some() {}
            }
        }
    }
);

fuzz!(
    /// Laser scanners, rings of depths, flow modules, satellite receivers: no more readings than bytes.
    sensor_lines,
    |bytes: &[u8]| {
        let mount = Mount::new("laser", [0.15, 12.0], 10.0);
        let mut count = 0usize;
        let mut take = |_: vehicle::RangerReading| count += 1;
        Ld06::new(mount.clone(), 0, ld06::BAUD, 10).bytes(AT, bytes, &mut take);
        let mut scanner = Rplidar::new(mount, 0, 115_200);
        for chunk in bytes.chunks(29) {
            let _ = scanner.bytes(AT, chunk, &mut take);
            let _ = scanner.poll(AT);
        }
        TofRing::new(0, &[8; 4], 921_600).bytes(AT, bytes, &mut |_| ());
        MspModule::new(msp_module::Mount::default(), 115_200).bytes(AT, bytes, &mut |_| ());
        Gpsd::default().bytes(AT, bytes, &mut |_, _| ());
        assert!(count <= bytes.len());
    }
);

fuzz!(
    /// uQuad's inertial unit, in both its forms.
    imu_line,
    |bytes: &[u8]| {
        for alternation in [false, true] {
            let mut decoder = BinaryDecoder::new(alternation);
            let frames = bytes.iter().filter_map(|b| decoder.push(*b)).count();
            assert!(frames <= bytes.len() / 10);
        }
        let mut decoder = AsciiDecoder::default();
        for byte in bytes {
            if let Some(Ok(frame)) = decoder.push(*byte) {
                let line = ascii::format_line(&frame);
                assert_eq!(ascii::parse_line(line.trim_end()), Ok(frame));
            }
        }
    }
);

fuzz!(
    /// The packets of the real firmware's simulator builds.
    firmware_packets,
    |bytes: &[u8]| {
        use sim::firmware::betaflight::{Dialect, motors};
        for dialect in [Dialect::Betaflight46, Dialect::Betaflight2026] {
            if let Ok(motors) = motors(dialect, bytes) {
                assert!(motors.iter().all(|m| (0.0..=1.0).contains(m)), "{motors:?}");
            }
        }
        let mut inav = sim::firmware::inav::Link::new(AT);
        for chunk in bytes.chunks(31) {
            let _ = inav.handle(chunk);
            while inav.poll_transmit().is_some() {}
        }
    }
);
