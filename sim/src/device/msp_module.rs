//! A range finder and flow module that speaks MSP (MTF-01 class): MSPv2 requests `$X<`, unasked.

use msp::command;
use msp::frame::{Direction, Framing, encode};
use msp::message::{Message, SensorOpticFlow, SensorRangefinder};
use vehicle::{DownRange, FlowSample};

/// Counts of flow per degree, what INAV calls `opflow_scale`.
pub const COUNTS_PER_DEG: f64 = 10.5;

fn send(number: u16, message: &impl Message, out: &mut Vec<u8>) {
    let mut payload = Vec::new();
    message.emit(&mut payload);
    // Both payloads are a few bytes.
    let _ = encode(Framing::V2, Direction::Request, number, &payload, out);
}

/// A distance.
pub fn range(sample: &DownRange, out: &mut Vec<u8>) {
    let message = SensorRangefinder {
        quality: if sample.distance_m.is_some() { 255 } else { 0 },
        distance_mm: sample
            .distance_m
            .map_or(-1, |m| libm::round(m * 1e3) as i32),
    };
    send(command::SENSOR_RANGEFINDER, &message, out);
}

/// Counts since the message before, which was `dt_s` ago. Its y counts nose down.
pub fn flow(sample: &FlowSample, dt_s: f64, out: &mut Vec<u8>) {
    let counts = |radps: f64| libm::round(radps.to_degrees() * COUNTS_PER_DEG * dt_s) as i32;
    let message = SensorOpticFlow {
        quality: sample.quality,
        motion_x: counts(sample.x_radps),
        motion_y: counts(-sample.y_radps),
    };
    send(command::SENSOR_OPTIC_FLOW, &message, out);
}
