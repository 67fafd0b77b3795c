//! The whole chain: bytes or frames in, readings out.

use super::binary::{BinaryDecoder, DecoderStats};
use super::calibration::Calibration;
use super::convert::{Converter, Measured};
use super::fir::{Fir, FirError};
use super::frame::{Counts, RawFrame};
use super::norm::NormBands;
use super::ring::{FrameRing, RING_LEN};
use super::startup::{Disturbed, Reference, StartUp, UQUAD_FRAMES};
use super::watch::{FrameFault, FrameWatch, Sensor, Watched};
use super::{Angles, Build};
use arrayvec::ArrayVec;
use core::fmt;
use vehicle::Timestamp;

/// Events kept until somebody asks.
const EVENTS: usize = 16;

/// How neighbouring frames are smoothed.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one per chain, and a box would have to be opened at every reading"
)]
pub enum Smoothing {
    /// Raw counts are filtered, the result is converted.
    Fir(Fir),
    /// The last frames are converted one by one and averaged, angles too (build of March 2012: 8 frames).
    MeanOfConverted(usize),
}

/// How a chain works.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainConfig {
    /// Smoothing.
    pub smoothing: Smoothing,
    /// Frames kept: more than the smoothing takes, [`RING_LEN`] at most.
    pub ring_frames: usize,
    /// Frames of the start-up calibration.
    pub calibration_frames: u32,
    /// Height of the floor at the start, m.
    pub start_altitude_m: f64,
    /// Added to the magnetic heading, rad, counter-clockwise.
    pub declination_rad: f64,
    /// When norms are believed.
    pub bands: NormBands,
    /// The board alternates its start bytes.
    pub expects_alternation: bool,
    /// Whose arithmetic.
    pub build: Build,
}

impl Default for ChainConfig {
    fn default() -> Self {
        Self {
            smoothing: Smoothing::Fir(Fir::default()),
            ring_frames: RING_LEN,
            calibration_frames: UQUAD_FRAMES,
            start_altitude_m: 0.0,
            declination_rad: 0.0,
            bands: NormBands::default(),
            expects_alternation: false,
            build: Build::Final,
        }
    }
}

/// Why a configuration is refused.
#[derive(Clone, Debug, PartialEq)]
pub enum ConfigError {
    /// The filter.
    Fir(FirError),
    /// The mean of no frames, or of as many as the ring holds.
    Mean {
        /// Frames asked for.
        got: usize,
    },
    /// A ring that is not longer than what is smoothed over, or longer than there is room for.
    Ring {
        /// Frames of the ring.
        ring: usize,
        /// Frames that are smoothed over.
        smoothed: usize,
    },
    /// A calibration of no frames.
    CalibrationFrames,
    /// A number that is not finite, or beyond its range.
    Range {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fir(e) => e.fmt(f),
            Self::Mean { got } => write!(
                f,
                "mean length is {got}, ring length is {RING_LEN}: the ring must be longer, the mean not empty"
            ),
            Self::Ring { ring, smoothed } => write!(
                f,
                "ring length is {ring}, filter length is {smoothed}: the ring must be longer than the filter, {RING_LEN} at most"
            ),
            Self::CalibrationFrames => f.write_str("calibration frames is 0: at least 1 is needed"),
            Self::Range { name, value } => write!(f, "{name} = {value} is out of range"),
        }
    }
}

impl core::error::Error for ConfigError {}

impl From<FirError> for ConfigError {
    fn from(e: FirError) -> Self {
        Self::Fir(e)
    }
}

/// What a pilot should hear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ImuEvent {
    /// The start-up calibration is done.
    Calibrated(Reference),
    /// It begins again.
    Disturbed(Disturbed),
    /// A frame or a sensor is not believed.
    Fault(FrameFault),
    /// The start bytes did not alternate.
    SkippedFrame,
}

impl fmt::Display for ImuEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Calibrated(r) => {
                let n = r.gyro_null_radps;
                write!(
                    f,
                    "IMU calibrated: gyro null {:.4} {:.4} {:.4} rad/s, p0 {:.1} Pa",
                    n.x, n.y, n.z, r.reference_pa
                )
            }
            Self::Disturbed(d) => d.fmt(f),
            Self::Fault(fault) => fault.fmt(f),
            Self::SkippedFrame => f.write_str("IMU skipped a frame"),
        }
    }
}

/// The newest frames, smoothed, in SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// When the newest frame arrived.
    pub at: Timestamp,
    /// Time since the reading before, by the board's clock, us.
    pub elapsed_us: u64,
    /// Frames since the reading before that were not the newest when somebody looked; they are in the filter.
    pub passed_over: u32,
    /// What was measured.
    pub measured: Measured,
    /// The norm is that of gravity, and the sensor measures.
    pub accel_is_good: bool,
    /// The norm is that of the Earth's field at calibration, and the sensor measures.
    pub mag_is_good: bool,
    /// The gyro measures.
    pub gyro_is_good: bool,
    /// The barometer measures; without it the height means nothing.
    pub baro_is_good: bool,
}

/// The chain. Hand in bytes or frames, then take the reading, if any, and poll the events until `None`.
///
/// It cannot fall behind: everything handed in goes through the filter, only the newest state is read.
#[derive(Clone, Debug)]
pub struct ImuChain {
    config: ChainConfig,
    decoder: BinaryDecoder,
    watch: FrameWatch,
    ring: FrameRing,
    converter: Converter,
    calibrating: Option<StartUp>,
    reference: Option<Reference>,
    newest_at: Timestamp,
    newest: Option<Watched>,
    events: ArrayVec<ImuEvent, EVENTS>,
    lost_events: u32,
}

impl ImuChain {
    /// A chain that calibrates first.
    ///
    /// # Errors
    ///
    /// The setting that cannot be, with its value and the rule.
    pub fn new(calibration: Calibration, config: ChainConfig) -> Result<Self, ConfigError> {
        if let Smoothing::MeanOfConverted(got) = config.smoothing
            && (got == 0 || got >= RING_LEN)
        {
            return Err(ConfigError::Mean { got });
        }
        let smoothed = match &config.smoothing {
            Smoothing::Fir(fir) => fir.len(),
            Smoothing::MeanOfConverted(n) => *n,
        };
        if config.ring_frames <= smoothed || config.ring_frames > RING_LEN {
            return Err(ConfigError::Ring {
                ring: config.ring_frames,
                smoothed,
            });
        }
        if config.calibration_frames == 0 {
            return Err(ConfigError::CalibrationFrames);
        }
        let finite = |name, value: f64, low, high| {
            // NaN is in no range.
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                Err(ConfigError::Range { name, value })
            }
        };
        finite(
            "start altitude (m)",
            config.start_altitude_m,
            -500.0,
            9000.0,
        )?;
        finite("declination (rad)", config.declination_rad, -3.2, 3.2)?;
        finite("acceleration norm band", config.bands.accel, 0.0, 1.0)?;
        finite("field norm band", config.bands.mag, 0.0, 1.0)?;
        let calibrating = StartUp::new(config.calibration_frames, config.start_altitude_m);
        Ok(Self {
            decoder: BinaryDecoder::new(config.expects_alternation),
            watch: FrameWatch::default(),
            ring: FrameRing::of(config.ring_frames),
            converter: Converter::new(calibration, config.declination_rad, config.build),
            calibrating: Some(calibrating),
            reference: None,
            newest_at: Timestamp::ZERO,
            newest: None,
            events: ArrayVec::new(),
            lost_events: 0,
            config,
        })
    }

    /// Takes bytes of the serial line.
    pub fn bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        for &byte in bytes {
            if let Some(received) = self.decoder.push(byte) {
                if received.is_after_skipped {
                    self.tell(ImuEvent::SkippedFrame);
                }
                self.frame(now, received.frame);
            }
        }
    }

    /// Takes one frame, from a log or a text line.
    pub fn frame(&mut self, now: Timestamp, frame: RawFrame) {
        let watched = self.watch.judge(now, frame);
        if let Some(fault) = watched.fault {
            self.tell(ImuEvent::Fault(fault));
        }
        let Some(frame) = watched.frame else {
            return;
        };
        self.ring.push(frame);
        self.newest_at = now;
        self.newest = Some(watched);
        self.calibrate_with(&frame, &watched);
    }

    fn calibrate_with(&mut self, frame: &RawFrame, watched: &Watched) {
        let Some(calibrating) = &mut self.calibrating else {
            return;
        };
        let broken = match (watched.gyro_is_good, watched.accel_is_good) {
            (false, _) => Some(Sensor::Gyro),
            (_, false) => Some(Sensor::Accelerometer),
            _ => None,
        };
        let answer = if let Some(sensor) = broken {
            // Said once, not with every frame of a dead sensor.
            let is_new = calibrating.progress() > 0.0;
            calibrating.restart();
            if !is_new {
                return;
            }
            Err(Disturbed::Sensor(sensor))
        } else {
            calibrating.push(frame, &self.converter)
        };
        match answer {
            Ok(None) => {}
            Ok(Some(reference)) => {
                self.calibrating = None;
                self.set_reference(reference);
                self.tell(ImuEvent::Calibrated(reference));
            }
            Err(disturbed) => self.tell(ImuEvent::Disturbed(disturbed)),
        }
    }

    /// The newest reading, once; none during the first calibration and before the filter is full.
    pub fn take(&mut self) -> Option<Reading> {
        let taken = self.ring.take_newest()?;
        let reference = self.reference?;
        let watched = self.newest?;
        let measured = match &self.config.smoothing {
            Smoothing::Fir(fir) => self.converter.convert(&fir.output(&self.ring)?),
            Smoothing::MeanOfConverted(n) => self.mean_of_converted(*n)?,
        };
        let bands = &self.config.bands;
        Some(Reading {
            at: self.newest_at,
            elapsed_us: taken.elapsed_us,
            passed_over: taken.passed_over,
            measured,
            accel_is_good: watched.accel_is_good && bands.accel_is_gravity(measured.accel_mps2),
            mag_is_good: watched.mag_is_good
                && bands.mag_is_earth(measured.mag, reference.mag_norm),
            gyro_is_good: watched.gyro_is_good,
            baro_is_good: watched.baro_is_good,
        })
    }

    fn mean_of_converted(&self, n: usize) -> Option<Measured> {
        if self.ring.len() < n {
            return None;
        }
        let mut sum = Measured::default();
        for frame in self.ring.newest_first().take(n) {
            let m = self.converter.convert(&Counts::from(frame));
            sum.accel_mps2 += m.accel_mps2;
            sum.gyro_radps += m.gyro_radps;
            sum.mag += m.mag;
            sum.angles = Angles {
                psi_rad: sum.angles.psi_rad + m.angles.psi_rad,
                phi_rad: sum.angles.phi_rad + m.angles.phi_rad,
                theta_rad: sum.angles.theta_rad + m.angles.theta_rad,
            };
            sum.temperature_degc += m.temperature_degc;
            sum.altitude_m += m.altitude_m;
        }
        let n = n as f64;
        Some(Measured {
            accel_mps2: sum.accel_mps2 / n,
            gyro_radps: sum.gyro_radps / n,
            mag: sum.mag / n,
            angles: Angles {
                psi_rad: sum.angles.psi_rad / n,
                phi_rad: sum.angles.phi_rad / n,
                theta_rad: sum.angles.theta_rad / n,
            },
            temperature_degc: sum.temperature_degc / n,
            altitude_m: sum.altitude_m / n,
        })
    }

    /// The next event.
    pub fn poll(&mut self) -> Option<ImuEvent> {
        self.events.pop_at(0)
    }

    fn tell(&mut self, event: ImuEvent) {
        if self.events.try_push(event).is_err() {
            self.lost_events = self.lost_events.saturating_add(1);
        }
    }

    /// Starts a calibration; the reference in force stays until it is done. False if one is running.
    pub fn calibrate(&mut self) -> bool {
        if self.calibrating.is_some() {
            return false;
        }
        self.calibrating = Some(StartUp::new(
            self.config.calibration_frames,
            self.config.start_altitude_m,
        ));
        true
    }

    /// Ends a calibration; the reference in force stays.
    pub fn abort_calibration(&mut self) {
        self.calibrating = None;
    }

    /// Puts a known reference in force and ends a calibration under way.
    pub fn set_reference(&mut self, reference: Reference) {
        self.calibrating = None;
        self.converter.gyro_null_radps = reference.gyro_null_radps;
        self.converter.reference_pa = reference.reference_pa;
        self.reference = Some(reference);
    }

    /// The calibration under way.
    #[must_use]
    pub const fn calibrating(&self) -> Option<&StartUp> {
        self.calibrating.as_ref()
    }

    /// The reference in force.
    #[must_use]
    pub const fn reference(&self) -> Option<&Reference> {
        self.reference.as_ref()
    }

    /// What the decoder has seen.
    #[must_use]
    pub const fn decoder_stats(&self) -> &DecoderStats {
        self.decoder.stats()
    }

    /// Events that nobody asked for in time.
    #[must_use]
    pub const fn lost_events(&self) -> u32 {
        self.lost_events
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use crate::imu::calibration::tests::SQUARE;

    fn frame(k: u64) -> RawFrame {
        let flicker = (k % 3) as i16 - 1;
        RawFrame {
            since_previous_us: 10_000,
            accel: [flicker, 2, 245 - flicker],
            gyro: [5 + 3 * flicker, -7, 4 * flicker],
            mag: [150 + flicker, 20, -150],
            temperature_ddeg: 280,
            pressure_pa: 101_000,
        }
    }

    /// A chain after its calibration of 60 frames, and the number of the next frame.
    fn calibrated() -> (ImuChain, u64) {
        let config = ChainConfig {
            calibration_frames: 60,
            ..ChainConfig::default()
        };
        let mut chain = ImuChain::new(Calibration::parse(SQUARE).unwrap(), config).unwrap();
        for k in 0..60 {
            chain.frame(Timestamp::from_ms(10 * k), frame(k));
            assert_eq!(chain.take().is_some(), k == 59);
        }
        assert!(matches!(chain.poll(), Some(ImuEvent::Calibrated(_))));
        (chain, 60)
    }

    #[test]
    fn after_a_stall_of_200_ms_the_newest_sample_is_used_and_the_missed_ones_are_in_the_filter() {
        let (mut stalled, next) = calibrated();
        let (mut prompt, _) = calibrated();
        let moved = |k: u64| RawFrame {
            accel: [k as i16, 2, 245],
            ..frame(k)
        };
        let now = Timestamp::from_ms(10 * (next + 19));
        let mut bytes = Vec::new();
        let mut last = None;
        for k in next..next + 20 {
            bytes.extend(moved(k).emit(b'A'));
            prompt.frame(Timestamp::from_ms(10 * k), moved(k));
            last = prompt.take();
        }
        stalled.bytes(now, &bytes);
        let late = stalled.take().unwrap();
        assert_eq!(late.measured, last.unwrap().measured);
        assert_eq!((late.passed_over, late.elapsed_us), (19, 200_000));
        assert_eq!(stalled.take(), None);
    }

    #[test]
    fn norms_thirty_percent_too_large_are_flagged() {
        let (mut chain, next) = calibrated();
        for k in next..next + 6 {
            let mut f = frame(k);
            f.accel[2] = 318;
            chain.frame(Timestamp::from_ms(10 * k), f);
        }
        let reading = chain.take().unwrap();
        assert!(!reading.accel_is_good && reading.mag_is_good);
        for k in next + 6..next + 12 {
            let mut f = frame(k);
            f.mag = f.mag.map(|v| v * 13 / 10);
            chain.frame(Timestamp::from_ms(10 * k), f);
        }
        let reading = chain.take().unwrap();
        assert!(reading.accel_is_good && !reading.mag_is_good);
    }

    #[test]
    fn one_calibration_at_a_time_and_an_aborted_one_changes_nothing() {
        let (mut chain, next) = calibrated();
        let before = *chain.reference().unwrap();
        assert!(chain.calibrate() && !chain.calibrate());
        let shifted = |k: u64| RawFrame {
            gyro: [25, -7, (k % 2) as i16],
            ..frame(k)
        };
        for k in next..next + 30 {
            chain.frame(Timestamp::from_ms(10 * k), shifted(k));
        }
        chain.abort_calibration();
        assert_eq!(chain.reference(), Some(&before));
        assert!(chain.calibrate());
        for k in next + 30..next + 90 {
            chain.frame(Timestamp::from_ms(10 * k), shifted(k));
        }
        // 20 counts more than at first: the old null plays no part.
        let now = chain.reference().unwrap().gyro_null_radps;
        assert!((now.x - before.gyro_null_radps.x - 20.0 * 0.00125).abs() < 1e-3);
    }

    #[test]
    fn a_stuck_gyro_is_never_calibrated() {
        let config = ChainConfig::default();
        let mut chain = ImuChain::new(Calibration::parse(SQUARE).unwrap(), config).unwrap();
        for k in 0..2000 {
            let f = RawFrame {
                gyro: [5, -7, 4],
                ..frame(k)
            };
            chain.frame(Timestamp::from_ms(10 * k), f);
            assert_eq!(chain.take(), None);
        }
        let events: Vec<ImuEvent> = core::iter::from_fn(|| chain.poll()).collect();
        assert_eq!(
            events,
            [
                ImuEvent::Fault(FrameFault::Stuck(Sensor::Gyro)),
                ImuEvent::Disturbed(Disturbed::Sensor(Sensor::Gyro))
            ]
        );
    }

    #[test]
    fn settings_that_cannot_be_are_refused_with_the_rule() {
        let refused = |change: fn(&mut ChainConfig)| {
            let mut config = ChainConfig::default();
            change(&mut config);
            ImuChain::new(Calibration::parse(SQUARE).unwrap(), config)
                .unwrap_err()
                .to_string()
        };
        assert!(
            refused(|c| c.smoothing = Smoothing::MeanOfConverted(32)).contains("ring length is 32")
        );
        assert!(refused(|c| c.calibration_frames = 0).contains("calibration frames"));
        assert!(refused(|c| c.ring_frames = 6).contains("ring length is 6, filter length is 6"));
        assert!(refused(|c| c.ring_frames = 33).contains("32 at most"));
        assert!(refused(|c| c.start_altitude_m = f64::NAN).contains("start altitude"));
        assert!(refused(|c| c.declination_rad = 10.0).contains("declination"));
    }
}
