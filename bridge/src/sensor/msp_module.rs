//! Range finder and optical flow modules that speak MSP (Matek 3901-L0X, MicoAir MTF-01 ...): wired to the companion computer
//! instead of the flight controller, they send what INAV and Betaflight would take.
//!
//! | Message | Here |
//! | --- | --- |
//! | MSP2_SENSOR_RANGEFINDER 0x1F01: quality, distance in mm, negative = out of range | height along body down |
//! | MSP2_SENSOR_OPTIC_FLOW 0x1F02: quality, motion x and y in counts since the last | rad/s with the signs of [`FlowSample`] |
//!
//! Counts are not told in degrees: like INAV's `opflow_scale` (10.5 counts per degree) the scale is the user's. INAV's x is
//! roll to the right, its y nose **down**; ours is nose up.

use super::{Sample, WireTime};
use msp::command;
use msp::frame::{Accept, Decoder};
use msp::message::{Message, SensorOpticFlow, SensorRangefinder};
use vehicle::{DownRange, FlowSample, Timestamp};

/// Baud of its line.
pub const BAUD: u32 = 115_200;
/// INAV's scale, counts per degree.
pub const COUNTS_PER_DEG: f64 = 10.5;
/// Further apart than this, two flow messages say nothing about the time between them, s.
const LONGEST_STEP_S: f64 = 0.2;
/// A distance within this is worth something, mm.
const RANGE_MM: core::ops::RangeInclusive<i32> = 20..=12_000;

/// How the module is mounted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// Where its x looks, clockwise from body forward, degrees.
    pub yaw_deg: f64,
    /// Counts of flow per degree.
    pub counts_per_deg: f64,
}

impl Default for Mount {
    fn default() -> Self {
        Self {
            yaw_deg: 0.0,
            counts_per_deg: COUNTS_PER_DEG,
        }
    }
}

/// The driver.
#[derive(Clone, Debug)]
pub struct MspModule {
    mount: Mount,
    wire: WireTime,
    decoder: Decoder,
    flow_at: Option<Timestamp>,
    messages: u64,
}

impl MspModule {
    /// For a module mounted like this.
    #[must_use]
    pub fn new(mount: Mount, baud: u32) -> Self {
        Self {
            mount,
            wire: WireTime::of_baud(baud),
            decoder: Decoder::new(Accept::Any),
            flow_at: None,
            messages: 0,
        }
    }

    /// Messages taken so far.
    #[must_use]
    pub const fn messages(&self) -> u64 {
        self.messages
    }

    /// Takes bytes that were read at a time.
    pub fn bytes(&mut self, at: Timestamp, bytes: &[u8], out: &mut impl FnMut(Sample)) {
        let mut input = bytes;
        while let Some(frame) = self.decoder.decode(&mut input) {
            let complete = self.wire.complete(at, input.len());
            match frame.command {
                command::SENSOR_RANGEFINDER => {
                    let Ok(m) = SensorRangefinder::parse(frame.payload) else {
                        continue;
                    };
                    self.messages += 1;
                    let is_valid = m.quality > 0 && RANGE_MM.contains(&m.distance_mm);
                    out(Sample::DownRange(DownRange {
                        at: complete,
                        distance_m: is_valid.then(|| f64::from(m.distance_mm) * 1e-3),
                    }));
                }
                command::SENSOR_OPTIC_FLOW => {
                    let Ok(m) = SensorOpticFlow::parse(frame.payload) else {
                        continue;
                    };
                    self.messages += 1;
                    let since = self.flow_at.replace(complete);
                    if let Some(since) = since
                        && let Some(flow) = rate(&self.mount, since, complete, &m)
                    {
                        out(Sample::Flow(flow));
                    }
                }
                _ => {}
            }
        }
    }
}

/// Counts between two messages as rates, at the middle of the time between them.
fn rate(mount: &Mount, since: Timestamp, at: Timestamp, m: &SensorOpticFlow) -> Option<FlowSample> {
    let dt_s = at.seconds_since(since);
    if !(1e-3..=LONGEST_STEP_S).contains(&dt_s) {
        return None;
    }
    let radps = |counts: i32| (f64::from(counts) / (mount.counts_per_deg * dt_s)).to_radians();
    // To forward and right: rates about the module's axes, then turned by where its x looks.
    let (x, y) = (radps(m.motion_x), -radps(m.motion_y));
    let (s, c) = libm::sincos(mount.yaw_deg.to_radians());
    Some(FlowSample {
        at: since + at.since(since) / 2,
        x_radps: c * x - s * y,
        y_radps: s * x + c * y,
        quality: m.quality,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use msp::frame::{Direction, Framing, encode};
    use proptest::prelude::*;

    fn frame(command: u16, message: &impl Message) -> Vec<u8> {
        let (mut payload, mut wire) = (Vec::new(), Vec::new());
        message.emit(&mut payload);
        encode(
            Framing::V2,
            Direction::Request,
            command,
            &payload,
            &mut wire,
        )
        .unwrap();
        wire
    }

    fn range(quality: u8, distance_mm: i32) -> Vec<u8> {
        frame(
            command::SENSOR_RANGEFINDER,
            &SensorRangefinder {
                quality,
                distance_mm,
            },
        )
    }

    fn flow(motion_x: i32, motion_y: i32) -> Vec<u8> {
        frame(
            command::SENSOR_OPTIC_FLOW,
            &SensorOpticFlow {
                quality: 200,
                motion_x,
                motion_y,
            },
        )
    }

    fn read(module: &mut MspModule, ms: u64, bytes: &[u8]) -> Vec<Sample> {
        let mut out = Vec::new();
        module.bytes(Timestamp::from_ms(ms), bytes, &mut |s| out.push(s));
        out
    }

    #[test]
    fn a_golden_frame_is_a_height() {
        // $X<, flag 0, 0x1F01, 5 bytes: quality 255, 1234 mm.
        let golden = [
            0x24, 0x58, 0x3C, 0, 0x01, 0x1F, 5, 0, 0xFF, 0xD2, 0x04, 0, 0,
        ];
        let wire = range(255, 1234);
        assert_eq!(wire[..13], golden);
        let out = read(&mut MspModule::new(Mount::default(), BAUD), 100, &wire);
        assert_eq!(
            out,
            [Sample::DownRange(DownRange {
                at: Timestamp::from_ms(100),
                distance_m: Some(1.234)
            })]
        );
    }

    #[test]
    fn out_of_range_and_no_quality_are_no_height() {
        let mut module = MspModule::new(Mount::default(), BAUD);
        for wire in [
            range(255, -1),
            range(0, 1000),
            range(200, 20_000),
            range(200, 5),
        ] {
            let out = read(&mut module, 100, &wire);
            assert!(
                matches!(
                    out[..],
                    [Sample::DownRange(DownRange {
                        distance_m: None,
                        ..
                    })]
                ),
                "{out:?}"
            );
        }
    }

    #[test]
    fn flow_counts_are_rates_in_our_axes() {
        // 105 counts in 20 ms are 10 degrees: 500 deg/s; the module's nose-down is our minus.
        let mut module = MspModule::new(Mount::default(), BAUD);
        assert!(read(&mut module, 100, &flow(1, 1)).is_empty());
        let out = read(&mut module, 120, &flow(105, 21));
        let [Sample::Flow(f)] = out[..] else {
            panic!("{out:?}")
        };
        assert!(
            (f.x_radps.to_degrees() - 500.0).abs() < 1e-6
                && (f.y_radps.to_degrees() + 100.0).abs() < 1e-6
        );
        assert_eq!((f.at, f.quality), (Timestamp::from_ms(110), 200));
        // Turned by a quarter clockwise: its x is our right, about which we count y.
        let mut turned = MspModule::new(
            Mount {
                yaw_deg: 90.0,
                ..Mount::default()
            },
            BAUD,
        );
        read(&mut turned, 100, &flow(0, 0));
        let out = read(&mut turned, 120, &flow(105, 0));
        let [Sample::Flow(f)] = out[..] else {
            panic!("{out:?}")
        };
        assert!(f.x_radps.abs() < 1e-9 && (f.y_radps.to_degrees() - 500.0).abs() < 1e-6);
        // After a pause there is no rate.
        assert!(read(&mut turned, 1000, &flow(105, 0)).is_empty());
    }

    proptest! {
        #[test]
        fn no_bytes_panic_and_every_number_is_finite(
            bytes in proptest::collection::vec(prop_oneof![Just(b'$'), Just(b'X'), Just(b'<'), Just(0x1Fu8), any::<u8>()], 0..200),
            motion in any::<[i32; 2]>(), ms in 1u64..300,
        ) {
            let mut module = MspModule::new(Mount::default(), BAUD);
            read(&mut module, 10, &bytes);
            read(&mut module, 1000, &flow(0, 0));
            for sample in read(&mut module, 1000 + ms, &flow(motion[0], motion[1])) {
                if let Sample::Flow(f) = sample {
                    prop_assert!(f.x_radps.is_finite() && f.y_radps.is_finite());
                }
            }
        }
    }
}
