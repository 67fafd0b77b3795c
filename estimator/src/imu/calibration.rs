//! The calibration file: 45 numbers in free layout, or the 36 of the older format without the temperature terms.
//!
//! | Numbers | Meaning |
//! | --- | --- |
//! | 9 + 3 | accelerometer `TKinv` by rows, bias `b` in counts |
//! | 9 + 3 | gyro `TKinv`, `b` |
//! | 9 + 3 | magnetometer `TKinv`, `b` |
//! | 1 + 1 | accelerometer temperature coefficient (z only, counts/degC), its reference, degC |
//! | 3 + 3 + 1 | gyro temperature coefficients (counts/degC), constant offset added to `b` (counts), reference, degC |
//!
//! `T K^-1` joins cross-axis terms and gains (equation 1.1). The thesis prints the temperature term as `+b_t (t - t0)` inside the bracket; with the
//! file's values the program subtracts, and so is done here.

use core::fmt;
use nalgebra::{Matrix3, Vector3};

/// Numbers of the whole format.
const FULL: usize = 45;
/// Numbers of the older format, which ends after the magnetometer.
const WITHOUT_TEMPERATURE: usize = 36;

/// Linear model of one three-axis sensor: `TKinv (raw - bias)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linear {
    /// Unit per count.
    pub tk_inv: Matrix3<f64>,
    /// Counts at zero.
    pub bias: Vector3<f64>,
}

impl Linear {
    /// Applies the model.
    #[must_use]
    pub fn apply(&self, counts: Vector3<f64>) -> Vector3<f64> {
        self.tk_inv * (counts - self.bias)
    }
}

/// What the file says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Accelerometer, m/s2.
    pub accel: Linear,
    /// Gyro, rad/s (deg/s in files of the older build). The constant offset is already in the bias.
    pub gyro: Linear,
    /// Magnetometer, normalised field.
    pub mag: Linear,
    /// Accelerometer z drift, counts/degC.
    pub accel_z_per_degc: f64,
    /// Temperature at which the accelerometer was calibrated, degC.
    pub accel_reference_degc: f64,
    /// Gyro drift, counts/degC.
    pub gyro_per_degc: Vector3<f64>,
    /// Temperature at which the gyro was calibrated, degC.
    pub gyro_reference_degc: f64,
}

/// Why a calibration file is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CalibrationError {
    /// A number is missing.
    Missing {
        /// How many there are.
        got: usize,
        /// What the first missing one means.
        name: String,
    },
    /// There are more than the format has.
    TooMany {
        /// How many there are.
        got: usize,
    },
    /// A word that is no finite number.
    NotANumber {
        /// What was expected there.
        name: String,
        /// The word.
        word: String,
    },
    /// A matrix that cannot be right: no sensor maps two directions onto one.
    Singular {
        /// Which sensor.
        sensor: &'static str,
    },
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing { got, name } => write!(
                f,
                "{got} numbers, a calibration has {FULL} ({WITHOUT_TEMPERATURE} without temperature terms): {name} is missing"
            ),
            Self::TooMany { got } => write!(f, "{got} numbers, a calibration has {FULL}"),
            Self::NotANumber { name, word } => write!(f, "{name}: `{word}` is not a number"),
            Self::Singular { sensor } => {
                write!(
                    f,
                    "the matrix of the {sensor} is singular: two axes are the same"
                )
            }
        }
    }
}

impl core::error::Error for CalibrationError {}

/// What the number at a place means.
fn name(index: usize) -> String {
    const AXES: [char; 3] = ['x', 'y', 'z'];
    let sensor = ["accelerometer", "gyro", "magnetometer"];
    match index {
        0..WITHOUT_TEMPERATURE => {
            let (which, at) = (sensor[index / 12], index % 12);
            if at < 9 {
                format!("{which} TKinv row {} column {}", at / 3 + 1, at % 3 + 1)
            } else {
                format!("{which} b {}", AXES[at - 9])
            }
        }
        36 => "accelerometer temperature coefficient".to_owned(),
        37 => "accelerometer reference temperature".to_owned(),
        38..=40 => format!("gyro temperature coefficient {}", AXES[index - 38]),
        41..=43 => format!("gyro constant offset {}", AXES[index - 41]),
        _ => "gyro reference temperature".to_owned(),
    }
}

impl Calibration {
    /// Reads the text of a file.
    ///
    /// # Errors
    ///
    /// The first number that is missing or wrong, by name.
    pub fn parse(text: &str) -> Result<Self, CalibrationError> {
        let mut numbers = Vec::with_capacity(FULL);
        for word in text.split_ascii_whitespace() {
            let value: f64 = word
                .parse()
                .ok()
                .filter(|v: &f64| v.is_finite())
                .ok_or_else(|| CalibrationError::NotANumber {
                    name: name(numbers.len()),
                    word: word.chars().take(40).collect(),
                })?;
            numbers.push(value);
        }
        match numbers.len() {
            FULL => {}
            WITHOUT_TEMPERATURE => numbers.resize(FULL, 0.0),
            got if got > FULL => return Err(CalibrationError::TooMany { got }),
            got => {
                return Err(CalibrationError::Missing {
                    got,
                    name: name(got),
                });
            }
        }
        let vector = |at: usize| Vector3::new(numbers[at], numbers[at + 1], numbers[at + 2]);
        let linear = |at: usize| Linear {
            tk_inv: Matrix3::from_row_slice(&numbers[at..at + 9]),
            bias: vector(at + 9),
        };
        let mut gyro = linear(12);
        gyro.bias += vector(41);
        let calibration = Self {
            accel: linear(0),
            gyro,
            mag: linear(24),
            accel_z_per_degc: numbers[36],
            accel_reference_degc: numbers[37],
            gyro_per_degc: vector(38),
            gyro_reference_degc: numbers[44],
        };
        for (sensor, linear) in [
            ("accelerometer", calibration.accel),
            ("gyro", calibration.gyro),
            ("magnetometer", calibration.mag),
        ] {
            // Relative to its size: the smallest good matrix has elements of 1e-3.
            let size = linear.tk_inv.norm();
            if linear.tk_inv.determinant().abs() <= 1e-6 * size * size * size {
                return Err(CalibrationError::Singular { sensor });
            }
        }
        Ok(calibration)
    }

    /// Temperature part of the accelerometer, to be subtracted, m/s2.
    #[must_use]
    pub fn accel_drift(&self, temperature_degc: f64) -> Vector3<f64> {
        let dt = temperature_degc - self.accel_reference_degc;
        self.accel.tk_inv * Vector3::new(0.0, 0.0, self.accel_z_per_degc * dt)
    }

    /// Temperature part of the gyro, to be subtracted, in the unit of its matrix.
    #[must_use]
    pub fn gyro_drift(&self, temperature_degc: f64) -> Vector3<f64> {
        self.gyro.tk_inv * self.gyro_per_degc * (temperature_degc - self.gyro_reference_degc)
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
pub(crate) mod tests {
    use super::*;

    /// A made-up board: 0.04 m/s2, 0.00125 rad/s and 0.004 field per count, axes square.
    pub(crate) const SQUARE: &str = "
        0.04 0 0  0 0.04 0  0 0 0.04   0 0 0
        0.00125 0 0  0 0.00125 0  0 0 0.00125   0 0 0
        0.004 0 0  0 0.004 0  0 0 0.004   0 0 0
        -0.6 23.5   -0.4 2.8 -1.9   1 2 3   28.0";

    #[test]
    fn the_offset_joins_the_bias_of_the_gyro() {
        let c = Calibration::parse(SQUARE).unwrap();
        assert_eq!(c.gyro.bias, Vector3::new(1.0, 2.0, 3.0));
        assert!((c.accel_drift(24.5).z - 0.04 * -0.6).abs() < 1e-15);
    }

    #[test]
    fn a_missing_number_is_named() {
        let all: Vec<&str> = SQUARE.split_ascii_whitespace().collect();
        for n in (0..FULL).filter(|&n| n != WITHOUT_TEMPERATURE) {
            let error = Calibration::parse(&all[..n].join(" ")).unwrap_err();
            let CalibrationError::Missing { got, name } = &error else {
                panic!("{n}: {error}");
            };
            assert_eq!((*got, name.is_empty()), (n, false));
        }
        let error = Calibration::parse(&all[..44].join("\n")).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("gyro reference temperature is missing")
        );
        let error = Calibration::parse(&all[..23].join("\n")).unwrap_err();
        assert!(error.to_string().contains("gyro b z is missing"));
    }

    #[test]
    fn words_surplus_numbers_and_singular_matrices_are_refused() {
        let nan = SQUARE.replacen("0.04", "nan", 1);
        let error = Calibration::parse(&nan).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("accelerometer TKinv row 1 column 1: `nan`")
        );
        assert_eq!(
            Calibration::parse(&format!("{SQUARE} 1")),
            Err(CalibrationError::TooMany { got: 46 })
        );
        let flat = SQUARE.replacen("0.00125", "0", 1);
        assert_eq!(
            Calibration::parse(&flat),
            Err(CalibrationError::Singular { sensor: "gyro" })
        );
    }

    #[test]
    fn the_older_format_has_no_temperature_terms() {
        let all: Vec<&str> = SQUARE.split_ascii_whitespace().collect();
        let c = Calibration::parse(&all[..WITHOUT_TEMPERATURE].join(" ")).unwrap();
        assert_eq!(c.accel_drift(99.0), Vector3::zeros());
        assert_eq!(c.gyro_drift(99.0), Vector3::zeros());
    }
}
