//! Pictures to H.264: constrained baseline, what every browser and every ground station decodes. Written in C++ (openh264), built
//! by cargo.

use super::annex_b::{AccessUnit, Assembler};
use openh264::encoder::{
    BitRate, Complexity, EncoderConfig, FrameRate, IntraFramePeriod, Profile, RateControlMode,
    UsageType,
};
use openh264::formats::YUVSource;
use openh264::{OpenH264API, Timestamp};
use sim::camera::Picture;
use thiserror::Error;

/// Why there is no coded picture.
#[derive(Debug, Error)]
#[error("the H.264 encoder failed: {0}")]
pub struct EncodeError(#[from] openh264::Error);

/// What an encoder is made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderSettings {
    /// Pictures a second.
    pub fps: f64,
    /// Bits a second.
    pub bits_per_s: u32,
}

impl Default for EncoderSettings {
    fn default() -> Self {
        Self {
            fps: 30.0,
            bits_per_s: 1_500_000,
        }
    }
}

/// Encodes a stream of pictures of one size.
pub struct Encoder {
    encoder: openh264::encoder::Encoder,
    assembler: Assembler,
    bytes: Vec<u8>,
}

struct Planes<'a>(&'a Picture);

impl YUVSource for Planes<'_> {
    fn dimensions(&self) -> (usize, usize) {
        (self.0.width, self.0.height)
    }
    fn strides(&self) -> (usize, usize, usize) {
        (self.0.width, self.0.width / 2, self.0.width / 2)
    }
    fn y(&self) -> &[u8] {
        &self.0.y
    }
    fn u(&self) -> &[u8] {
        &self.0.u
    }
    fn v(&self) -> &[u8] {
        &self.0.v
    }
}

impl Encoder {
    /// A fresh one.
    ///
    /// # Errors
    /// The library refuses.
    pub fn new(settings: EncoderSettings) -> Result<Self, EncodeError> {
        // One thread and the least work a picture: the flight comes first. A key picture comes when somebody needs one. A
        // picture that would burst the rate is left out.
        let config = EncoderConfig::new()
            .usage_type(UsageType::CameraVideoRealTime)
            .profile(Profile::Baseline)
            .complexity(Complexity::Low)
            .num_threads(1)
            .rate_control_mode(RateControlMode::Bitrate)
            .bitrate(BitRate::from_bps(settings.bits_per_s))
            .max_frame_rate(FrameRate::from_hz(settings.fps as f32))
            .skip_frames(true)
            .scene_change_detect(false)
            .background_detection(false)
            .adaptive_quantization(false)
            .intra_frame_period(IntraFramePeriod::auto());
        let api = OpenH264API::from_source();
        Ok(Self {
            encoder: openh264::encoder::Encoder::with_api_config(api, config)?,
            assembler: Assembler::default(),
            bytes: Vec::new(),
        })
    }

    /// Codes a picture taken at a time, ms; `wants_key`: so that decoding can begin with it. None if it was left out for the rate.
    ///
    /// # Errors
    /// The library fails.
    pub fn encode(
        &mut self,
        picture: &Picture,
        at_ms: u64,
        wants_key: bool,
    ) -> Result<Option<AccessUnit>, EncodeError> {
        if wants_key {
            self.encoder.force_intra_frame();
        }
        let at = Timestamp::from_millis(at_ms);
        self.bytes.clear();
        self.encoder
            .encode_at(&Planes(picture), at)?
            .write_vec(&mut self.bytes);
        let mut unit = None;
        self.assembler.push(&self.bytes, &mut |u| unit = Some(u));
        self.assembler.finish(&mut |u| unit = Some(u));
        Ok(unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::video::annex_b::kind;
    use crate::video::sps;

    fn moving(n: usize) -> Picture {
        let mut p = Picture::new(640, 480);
        for (i, y) in p.y.iter_mut().enumerate() {
            let (row, column) = (i / 640, i % 640 + 7 * n);
            *y = if (row / 20 + column / 20) % 2 == 0 {
                90
            } else {
                160
            };
        }
        p
    }

    #[test]
    fn the_first_picture_and_every_one_asked_for_is_a_key_picture_with_its_size() {
        let mut encoder = Encoder::new(EncoderSettings::default()).unwrap();
        let mut keys = Vec::new();
        for n in 0..12 {
            let unit = encoder.encode(&moving(n), n as u64 * 33, n == 8).unwrap();
            let Some(unit) = unit else { continue };
            if unit.is_key {
                keys.push(n);
                let set = unit.nals().find(|n| kind(n) == 7).unwrap();
                let facts = sps::read(set).unwrap();
                assert_eq!((facts.width, facts.height), (640, 480));
                assert_eq!(facts.profile_level[0], 66, "baseline");
            }
        }
        assert_eq!(keys, [0, 8]);
    }

    #[test]
    fn the_clock_in_the_picture_survives_coding() {
        let mut encoder = Encoder::new(EncoderSettings::default()).unwrap();
        let mut decoder = openh264::decoder::Decoder::new().unwrap();
        let mut read = 0;
        for n in 0..20_u64 {
            let mut picture = moving(n as usize);
            sim::camera::stamp(&mut picture, 1_790_000_000_000 + 33 * n);
            let unit = encoder.encode(&picture, n * 33, false).unwrap();
            let Some(unit) = unit else { continue };
            let decoded = decoder.decode(&unit.annex_b).unwrap().unwrap();
            // Rows of the decoder are longer than the picture.
            let (stride, _, _) = decoded.strides();
            let rows: Vec<u8> = decoded
                .y()
                .chunks(stride)
                .flat_map(|row| &row[..640])
                .copied()
                .collect();
            let at = sim::camera::read_stamp(640, &rows);
            assert_eq!(at, Some((1_790_000_000_000 + 33 * n) as u32), "{n}");
            read += 1;
        }
        assert!(read > 15);
    }

    #[test]
    fn the_rate_is_held() {
        let mut encoder = Encoder::new(EncoderSettings::default()).unwrap();
        let (mut bytes, mut pictures) = (0, 0);
        for n in 0..90 {
            if let Some(unit) = encoder
                .encode(&moving(n), n as u64 * 1000 / 30, false)
                .unwrap()
            {
                bytes += unit.annex_b.len();
                pictures += 1;
            }
        }
        let kbit_s = bytes as f64 * 8.0 / 3.0 / 1e3;
        println!("FIGURES\nencoder: {kbit_s:.0} kbit/s, {pictures} of 90 pictures\nEND");
        assert!(kbit_s < 1.25 * 1500.0, "{kbit_s}");
        assert!(pictures > 80, "{pictures}");
    }
}
