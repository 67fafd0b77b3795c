//! Integral action with three thresholds, uQuad's equation 1.5.
//!
//! | Threshold | Meaning |
//! | --- | --- |
//! | distance | beyond this error nothing is integrated: the craft is under way, not off balance |
//! | per sample | most that one sample may add |
//! | accumulated | most that is kept |
//!
//! The thesis prints the second one as a limit of the error and explains it as that times the period; the program's meaning is taken. Four variables are
//! integrated. **The columns of the recorded gain files are not in one order**: `K_int_full_pptz` is z, psi, phi, theta in spite of its name,
//! the program indexes psi, phi, z, theta; so the order is said when a file is read.

use crate::proportional::{GainError, STATES, parse_matrix};
use nalgebra::{SMatrix, SVector};

/// A variable that can be integrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integrated {
    /// Angle about y, nose down.
    Phi,
    /// Angle about x, right side down.
    Psi,
    /// Angle about z, counter-clockwise.
    Theta,
    /// Forward at the start.
    X,
    /// Left at the start.
    Y,
    /// Up.
    Z,
}

impl Integrated {
    /// Index in the 12 states.
    #[must_use]
    pub const fn state(self) -> usize {
        match self {
            Self::X => 0,
            Self::Y => 1,
            Self::Z => 2,
            Self::Psi => 3,
            Self::Phi => 4,
            Self::Theta => 5,
        }
    }

    /// The program's thresholds.
    #[must_use]
    pub const fn thresholds(self) -> Thresholds {
        let (distance, per_sample, accumulated) = match self {
            Self::Psi | Self::Phi => (0.26, 1.0e-3, 1.0),
            Self::Theta => (0.78, 7.0e-3, 2.0),
            Self::Z => (2.0, 0.25e-2, 2.0),
            Self::X | Self::Y => (1.0, 1.0, 5.0),
        };
        Thresholds {
            distance,
            per_sample,
            accumulated,
        }
    }
}

/// The three thresholds of one variable, in its unit (m or rad), and that times seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// Beyond this error nothing is integrated.
    pub distance: f64,
    /// Most that one sample adds, unit times s.
    pub per_sample: f64,
    /// Most that is kept, unit times s.
    pub accumulated: f64,
}

impl Thresholds {
    /// x and y in a room: a craft a quarter of a metre away is under way. (The program's metre is one for GPS; a step of a metre would overshoot by
    /// what it integrates on the way.)
    pub const INDOOR_HORIZONTAL: Self = Self {
        distance: 0.25,
        per_sample: 2.5e-3,
        accumulated: 2.0,
    };
}

/// The integral of one error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Integral {
    value: f64,
}

impl Integral {
    /// Adds an error that lasted `dt_s`; answers the integral.
    pub fn add(&mut self, error: f64, dt_s: f64, t: &Thresholds) -> f64 {
        // False for NaN: it is kept out like an error that is too large.
        if error.abs() <= t.distance {
            let step = (error * dt_s).clamp(-t.per_sample, t.per_sample);
            self.value = (self.value + step).clamp(-t.accumulated, t.accumulated);
        }
        self.value
    }

    /// What is kept, unit times s.
    #[must_use]
    pub const fn value(&self) -> f64 {
        self.value
    }
}

/// Which variable each of the four columns of a gain file belongs to.
pub type Columns = [Integrated; 4];

/// Columns of `K_int_full_pptz`.
pub const COLUMNS_OF_PPTZ: Columns = [
    Integrated::Z,
    Integrated::Psi,
    Integrated::Phi,
    Integrated::Theta,
];
/// Columns of `K_int_full_ppzt`, and of the program.
pub const COLUMNS_OF_PPZT: Columns = [
    Integrated::Psi,
    Integrated::Phi,
    Integrated::Z,
    Integrated::Theta,
];
/// Columns of the older gains with position integrals.
pub const COLUMNS_OF_XYZT: Columns = [
    Integrated::X,
    Integrated::Y,
    Integrated::Z,
    Integrated::Theta,
];

/// Gains and states of the four integrals.
#[derive(Clone, Debug, PartialEq)]
pub struct IntegralAction {
    gains: SMatrix<f64, 4, 4>,
    columns: Columns,
    thresholds: [Thresholds; 4],
    integrals: [Integral; 4],
}

impl IntegralAction {
    /// Motors by columns, (rad/s) per unit and second.
    #[must_use]
    pub fn new(gains: SMatrix<f64, 4, 4>, columns: Columns) -> Self {
        Self {
            gains,
            columns,
            thresholds: columns.map(Integrated::thresholds),
            integrals: [Integral::default(); 4],
        }
    }

    /// Other thresholds for one variable than the program's; nothing happens when it is not integrated.
    #[must_use]
    pub fn with_thresholds(mut self, variable: Integrated, thresholds: Thresholds) -> Self {
        for (column, of) in self.columns.iter().zip(&mut self.thresholds) {
            if *column == variable {
                *of = thresholds;
            }
        }
        self
    }

    /// Other gains, for the same columns; what is integrated stays.
    pub const fn set_gains(&mut self, gains: SMatrix<f64, 4, 4>) {
        self.gains = gains;
    }

    /// Reads a file of 4 x 4 numbers whose columns are in the order `columns`.
    ///
    /// # Errors
    ///
    /// When it is not that.
    pub fn parse(text: &str, columns: Columns) -> Result<Self, GainError> {
        Ok(Self::new(parse_matrix(text)?, columns))
    }

    /// Takes the (limited) errors of the 12 states; answers the change of the motor speeds, rad/s.
    pub fn act(&mut self, error: &SVector<f64, STATES>, dt_s: f64) -> [f64; 4] {
        let mut xi = SVector::<f64, 4>::zeros();
        for (i, variable) in self.columns.into_iter().enumerate() {
            let error = error[variable.state()];
            xi[i] = self.integrals[i].add(error, dt_s, &self.thresholds[i]);
        }
        (self.gains * xi).into()
    }

    /// The integrals, in the order of the columns.
    #[must_use]
    pub fn values(&self) -> [f64; 4] {
        self.integrals.map(|i| i.value())
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.integrals = [Integral::default(); 4];
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    const TS: f64 = 0.01;

    #[test]
    fn the_three_thresholds_work_on_both_sides() {
        for variable in [
            Integrated::Psi,
            Integrated::Theta,
            Integrated::Z,
            Integrated::X,
        ] {
            let t = variable.thresholds();
            for sign in [1.0, -1.0] {
                let mut i = Integral::default();
                assert_eq!(
                    i.add(sign * t.distance * 1.01, TS, &t),
                    0.0,
                    "too far: kept"
                );
                let small = t.per_sample.min(t.distance * TS) / TS * 0.5;
                assert!((i.add(sign * small, TS, &t) - sign * small * TS).abs() < 1e-15);
                let before = i.value();
                let step = (t.distance * TS).min(t.per_sample);
                let large = i.add(sign * t.distance, TS, &t) - before;
                assert!((large - sign * step).abs() < 1e-15, "{variable:?}: {large}");
                for _ in 0..200_000 {
                    i.add(sign * t.distance, TS, &t);
                }
                assert_eq!(i.value(), sign * t.accumulated);
                i.add(f64::NAN, TS, &t);
                assert_eq!(i.value(), sign * t.accumulated);
            }
        }
    }

    #[test]
    fn the_two_gain_files_need_their_own_column_order() {
        let pptz = "1.57 0 -2.17 -3.43\n1.57 2.17 0 3.43\n1.57 0 2.17 -3.43\n1.57 -2.17 0 3.43";
        let ppzt = "0 -2.17 1.57 -3.43\n2.17 0 1.57 3.43\n0 2.17 1.57 -3.43\n-2.17 0 1.57 3.43";
        let mut error = SVector::<f64, STATES>::zeros();
        error[2] = 0.1;
        error[3] = 0.02;
        error[4] = -0.03;
        error[5] = 0.04;
        let mut a = IntegralAction::parse(pptz, COLUMNS_OF_PPTZ).unwrap();
        let mut b = IntegralAction::parse(ppzt, COLUMNS_OF_PPZT).unwrap();
        let (wa, wb) = (a.act(&error, TS), b.act(&error, TS));
        assert!(wa.iter().zip(wb).all(|(a, b)| (a - b).abs() < 1e-15));
        let mut trap = IntegralAction::parse(pptz, COLUMNS_OF_PPZT).unwrap();
        assert!(
            (trap.act(&error, TS)[1] - wa[1]).abs() > 1e-4,
            "the trap is one"
        );
    }

    #[test]
    fn a_file_of_the_wrong_size_is_refused() {
        let error = IntegralAction::parse("1 2 3", COLUMNS_OF_PPTZ).unwrap_err();
        assert_eq!(error.to_string(), "3 numbers, 4 x 4 = 16 are needed");
    }
}
