//! Recordings of a 9-axis sensor with optical truth (data/attitude, a part of the BROAD benchmark).

use estimator::attitude::score::{AttitudeError, AttitudeScore};
use estimator::attitude::{AttitudeEstimator, AttitudeParams, MargSample};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::path::{Path, PathBuf};
use vehicle::Timestamp;

/// Rows are this far apart, us.
const PERIOD_US: u64 = 3500;

/// The folder of the recordings, or none with a word why.
pub fn folder() -> Option<PathBuf> {
    super::recorded("attitude")
}

/// One recording.
pub struct Trial {
    pub name: String,
    pub samples: Vec<MargSample>,
    /// Row of the samples, sensor to ENU, moving.
    pub reference: Vec<(usize, UnitQuaternion<f64>, bool)>,
}

impl Trial {
    /// Every recording of the folder, in the order of their names.
    pub fn all(folder: &Path) -> Vec<Self> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .filter_map(|e| e.unwrap().file_name().into_string().ok())
            .filter_map(|name| name.strip_suffix(".imu.f32").map(str::to_owned))
            .collect();
        names.sort();
        names.iter().map(|name| Self::load(folder, name)).collect()
    }

    fn load(folder: &Path, name: &str) -> Self {
        let bytes = std::fs::read(folder.join(format!("{name}.imu.f32"))).unwrap();
        let (values, _) = bytes.as_chunks::<4>();
        let values: Vec<f64> = values
            .iter()
            .map(|b| f64::from(f32::from_le_bytes(*b)))
            .collect();
        let samples = values.as_chunks::<9>().0.iter().zip(0u64..).map(
            |([gx, gy, gz, ax, ay, az, mx, my, mz], row)| MargSample {
                at: Timestamp::from_us(PERIOD_US * (row + 1)),
                gyro_radps: Vector3::new(*gx, *gy, *gz),
                accel_mps2: Vector3::new(*ax, *ay, *az),
                mag: Some(Vector3::new(*mx, *my, *mz)),
            },
        );
        let text = std::fs::read_to_string(folder.join(format!("{name}.ref.csv"))).unwrap();
        let reference = text.lines().skip(1).map(|line| {
            let f: Vec<f64> = line.split(',').map(|f| f.parse().unwrap()).collect();
            let q = UnitQuaternion::from_quaternion(Quaternion::new(f[1], f[2], f[3], f[4]));
            (f[0] as usize, q, f[5] > 0.5)
        });
        Self {
            name: name.to_owned(),
            samples: samples.collect(),
            reference: reference.collect(),
        }
    }

    /// Runs the estimator over the samples and scores the moving part; `broken` may change samples, or drop them.
    pub fn score(
        &self,
        params: AttitudeParams,
        broken: impl Fn(usize, &MargSample) -> Option<MargSample>,
    ) -> AttitudeError {
        let mut estimator = AttitudeEstimator::new(params);
        let mut score = AttitudeScore::default();
        let mut reference = self.reference.iter().peekable();
        for (row, sample) in self.samples.iter().enumerate() {
            if let Some(sample) = broken(row, sample) {
                estimator.update(&sample);
            }
            let q = estimator.imu_to_enu();
            assert!(q.coords.iter().all(|c| c.is_finite()), "row {row}");
            if let Some((_, truth, moving)) = reference.next_if(|r| r.0 == row)
                && *moving
            {
                score.add(&AttitudeError::between(&q, truth));
            }
        }
        assert!(score.rows() > 1000, "{}: too few reference rows", self.name);
        score.rms().unwrap()
    }
}
