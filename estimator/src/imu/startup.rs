//! Start-up calibration: the craft stands still for 512 frames, then the gyro null, the reference pressure, the attitude and the accelerometer
//! bias are known. A craft that is moved starts again from nothing, with the reason.
//!
//! The means are taken over raw counts and converted once, with no gyro null in force. (uQuad cut its means to integers and would have converted
//! a second calibration with the null of the first.) A tilted floor does no harm: attitude is measured, and the accelerometer bias adapts in
//! seconds.

use super::barometer;
use super::convert::Converter;
use super::frame::{Counts, RawFrame};
use super::watch::Sensor;
use super::{Angles, GRAVITY_MPS2};
use core::fmt;
use nalgebra::Vector3;

/// Frames of uQuad's calibration.
pub const UQUAD_FRAMES: u32 = 512;
/// Frames that are judged together: a third of a second.
const BLOCK: u32 = 32;
/// Shaking, rad/s and m/s2 of one standard deviation (the recording at rest: at most 0.011 and 0.088).
const GYRO_STD: f64 = 0.05;
const ACCEL_STD: f64 = 0.4;
/// Turning, rad/s between the means of the first block and of another one (the recording: 0.005).
const GYRO_SHIFT: f64 = 0.03;
/// Leaning, m/s2 between the means of the first block and of another one: 2 degrees (the recording: 0.031).
const ACCEL_SHIFT: f64 = 0.35;

/// Why a calibration starts again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbed {
    /// The accelerometer shook.
    Shaken {
        /// Standard deviation within a third of a second, m/s2.
        std_mps2: f64,
    },
    /// The gyro shook.
    Wobbled {
        /// Standard deviation within a third of a second, rad/s.
        std_radps: f64,
    },
    /// The craft leans otherwise than at the beginning.
    Leaned {
        /// Change of the mean, m/s2.
        by_mps2: f64,
    },
    /// The craft turns.
    Turned {
        /// Change of the mean, rad/s.
        by_radps: f64,
    },
    /// A sensor is stuck or saturated.
    Sensor(Sensor),
}

impl fmt::Display for Disturbed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("IMU calibration starts again: ")?;
        match self {
            Self::Shaken { std_mps2 } => write!(f, "shaken ({std_mps2:.2} m/s2)"),
            Self::Wobbled { std_radps } => write!(f, "shaken ({std_radps:.3} rad/s)"),
            Self::Leaned { by_mps2 } => write!(f, "moved (gravity changed by {by_mps2:.2} m/s2)"),
            Self::Turned { by_radps } => write!(f, "turned at {by_radps:.3} rad/s"),
            Self::Sensor(sensor) => write!(f, "the {sensor} does not measure"),
        }
    }
}

/// What a calibration finds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// Rate at rest, rad/s.
    pub gyro_null_radps: Vector3<f64>,
    /// Pressure of height zero, Pa.
    pub reference_pa: f64,
    /// Attitude at rest.
    pub angles: Angles,
    /// Specific force at rest less (0, 0, g), m/s2.
    pub accel_bias_mps2: Vector3<f64>,
    /// Norm of the field at rest.
    pub mag_norm: f64,
}

/// Mean and scatter of one vector over a block.
#[derive(Clone, Copy, Debug, Default)]
struct Scatter {
    n: f64,
    mean: Vector3<f64>,
    squares: Vector3<f64>,
}

impl Scatter {
    /// Welford's update.
    fn add(&mut self, v: Vector3<f64>) {
        self.n += 1.0;
        let before = v - self.mean;
        self.mean += before / self.n;
        self.squares += before.component_mul(&(v - self.mean));
    }

    /// Largest standard deviation of the three axes.
    fn std(&self) -> f64 {
        (self.squares.max() / self.n).max(0.0).sqrt()
    }
}

/// A calibration under way.
#[derive(Clone, Debug)]
pub struct StartUp {
    wanted: u32,
    start_altitude_m: f64,
    taken: u32,
    /// Frames with a pressure.
    with_pressure: u32,
    sum: Counts,
    gyro: Scatter,
    accel: Scatter,
    first: Option<(Vector3<f64>, Vector3<f64>)>,
    restarts: u32,
}

impl StartUp {
    /// Over `frames` frames (at least one), on a floor `start_altitude_m` high.
    #[must_use]
    pub fn new(frames: u32, start_altitude_m: f64) -> Self {
        Self {
            wanted: frames.max(1),
            start_altitude_m,
            taken: 0,
            with_pressure: 0,
            sum: Counts::default(),
            gyro: Scatter::default(),
            accel: Scatter::default(),
            first: None,
            restarts: 0,
        }
    }

    /// Share done, 0..=1.
    #[must_use]
    pub fn progress(&self) -> f64 {
        f64::from(self.taken) / f64::from(self.wanted)
    }

    /// How often it began again.
    #[must_use]
    pub const fn restarts(&self) -> u32 {
        self.restarts
    }

    /// Takes one frame; answers when the last one is in.
    ///
    /// # Errors
    ///
    /// The reason, when the craft moved: everything begins again with the next frame.
    pub fn push(
        &mut self,
        frame: &RawFrame,
        converter: &Converter,
    ) -> Result<Option<Reference>, Disturbed> {
        let counts = Counts::from(frame);
        let c = &converter.calibration;
        self.sum.add_scaled(&counts, 1.0);
        self.gyro.add(c.gyro.apply(counts.gyro));
        self.accel.add(c.accel.apply(counts.accel));
        self.taken += 1;
        self.with_pressure += u32::from(frame.pressure_pa != 0);
        let is_done = self.taken >= self.wanted;
        if self.taken.is_multiple_of(BLOCK) || is_done {
            if let Some(disturbed) = self.judge_block() {
                self.restart();
                return Err(disturbed);
            }
            self.gyro = Scatter::default();
            self.accel = Scatter::default();
        }
        Ok(is_done.then(|| self.finish(converter)))
    }

    /// Begins again.
    pub fn restart(&mut self) {
        *self = Self {
            restarts: self.restarts.saturating_add(1),
            ..Self::new(self.wanted, self.start_altitude_m)
        };
    }

    fn judge_block(&mut self) -> Option<Disturbed> {
        let (accel, gyro) = (self.accel.mean, self.gyro.mean);
        let (first_accel, first_gyro) = *self.first.get_or_insert((accel, gyro));
        // A short last block says less about its mean.
        let slack = (f64::from(BLOCK) / self.gyro.n).sqrt();
        let by_radps = (gyro - first_gyro).amax();
        let by_mps2 = (accel - first_accel).amax();
        if self.gyro.std() > GYRO_STD {
            return Some(Disturbed::Wobbled {
                std_radps: self.gyro.std(),
            });
        }
        if self.accel.std() > ACCEL_STD {
            return Some(Disturbed::Shaken {
                std_mps2: self.accel.std(),
            });
        }
        if by_radps > GYRO_SHIFT * slack {
            return Some(Disturbed::Turned { by_radps });
        }
        (by_mps2 > ACCEL_SHIFT * slack).then_some(Disturbed::Leaned { by_mps2 })
    }

    fn finish(&self, converter: &Converter) -> Reference {
        let mean = self.sum.divided(f64::from(self.taken));
        // A barometer that began late, or never: its zeros are no pressure.
        let pressure_pa = if self.with_pressure > 0 {
            self.sum.pressure_pa / f64::from(self.with_pressure)
        } else {
            barometer::SEA_LEVEL_PA
        };
        let mut bare = converter.clone();
        bare.gyro_null_radps = Vector3::zeros();
        let measured = bare.convert(&mean);
        Reference {
            gyro_null_radps: measured.gyro_radps,
            reference_pa: barometer::reference_pa(pressure_pa, self.start_altitude_m),
            angles: measured.angles,
            accel_bias_mps2: measured.accel_mps2 - Vector3::new(0.0, 0.0, GRAVITY_MPS2),
            mag_norm: measured.mag.norm(),
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;
    use crate::imu::calibration::tests::SQUARE;
    use crate::imu::{Build, Calibration};

    fn converter() -> Converter {
        Converter::new(Calibration::parse(SQUARE).unwrap(), 0.0, Build::Final)
    }

    fn still(k: u32) -> RawFrame {
        let flicker = (k % 3) as i16 - 1;
        RawFrame {
            since_previous_us: 10_000,
            accel: [flicker, 2, 245 - flicker],
            gyro: [5 + 3 * flicker, -7, 4 * flicker],
            mag: [100, 20, -150],
            temperature_ddeg: 280,
            pressure_pa: (101_000 + 3 * i64::from(flicker)) as u32,
        }
    }

    /// Frames taken, what disturbed, and the result.
    fn run(shape: impl Fn(u32, &mut RawFrame)) -> (u32, Vec<Disturbed>, Reference) {
        let (mut calibration, mut disturbed) = (StartUp::new(UQUAD_FRAMES, 0.0), Vec::new());
        for k in 0..5000 {
            let mut frame = still(k);
            shape(k, &mut frame);
            match calibration.push(&frame, &converter()) {
                Ok(Some(reference)) => return (k + 1, disturbed, reference),
                Ok(None) => {}
                Err(reason) => disturbed.push(reason),
            }
        }
        panic!("never calibrated: {disturbed:?}");
    }

    #[test]
    fn five_hundred_and_twelve_still_frames_are_enough() {
        let (taken, disturbed, reference) = run(|_, _| {});
        assert_eq!((taken, disturbed.len()), (512, 0));
        let [x, y, z] = reference.gyro_null_radps.into();
        // (5 - 1, -7 - 2, 0 - 3) * 0.00125 at the reference temperature.
        assert!(
            (x - 0.005).abs() < 1e-4 && (y + 0.01125).abs() < 1e-9 && (z + 0.00375).abs() < 1e-4
        );
        assert!((reference.reference_pa - 101_000.0).abs() < 0.1);
    }

    #[test]
    fn a_shaken_calibration_starts_again_and_says_why() {
        let (taken, disturbed, calm) = run(|k, f| {
            if (300..340).contains(&k) {
                f.gyro[0] += if k % 2 == 0 { 150 } else { -150 };
            }
        });
        assert!(matches!(disturbed[0], Disturbed::Wobbled { .. }));
        assert!(taken >= 340 + 512 - 32, "{taken}");
        let (_, _, undisturbed) = run(|_, _| {});
        assert!((calm.gyro_null_radps - undisturbed.gyro_null_radps).norm() < 1e-4);
        assert!(disturbed[0].to_string().contains("shaken"));

        let (_, disturbed, _) = run(|k, f| {
            if (100..130).contains(&k) {
                f.accel[1] += if k % 2 == 0 { 20 } else { -20 };
            }
        });
        assert!(matches!(disturbed[0], Disturbed::Shaken { .. }));
    }

    #[test]
    fn a_craft_put_down_elsewhere_or_turned_slowly_starts_again() {
        let (_, disturbed, _) = run(|k, f| {
            if k > 200 {
                f.accel[0] += 15;
            }
        });
        assert!(matches!(
            disturbed[0],
            Disturbed::Leaned { .. } | Disturbed::Shaken { .. }
        ));
        let (_, disturbed, _) = run(|k, f| {
            if (200..400).contains(&k) {
                f.gyro[2] += 40;
            }
        });
        assert!(matches!(disturbed[0], Disturbed::Turned { .. }));
    }

    #[test]
    fn a_barometer_that_begins_late_gives_the_pressure_it_measures() {
        let (_, _, reference) = run(|k, f| {
            if k < 30 {
                f.pressure_pa = 0;
            }
        });
        assert!((reference.reference_pa - 101_000.0).abs() < 0.5);
        let (_, _, reference) = run(|_, f| f.pressure_pa = 0);
        assert!((reference.reference_pa - barometer::SEA_LEVEL_PA).abs() < 1e-6);
    }

    #[test]
    fn a_floor_at_100_m_reads_100_m() {
        let mut calibration = StartUp::new(100, 100.0);
        let reference = (0..100)
            .find_map(|k| calibration.push(&still(k), &converter()).unwrap())
            .unwrap();
        let height = barometer::altitude_m(101_000.0, reference.reference_pa);
        assert!((height - 100.0).abs() < 0.01, "{height}");
    }
}
