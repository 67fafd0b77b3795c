//! A row of the covariance: eight pairs of numbers.

use super::super::{ACCEL_BIAS, ATTITUDE, GYRO_BIAS, POSITION, STATES, VELOCITY};
use nalgebra::Vector3;
use wide::f64x2;

/// Numbers in a pair.
pub(super) const LANES: usize = 2;
/// Pairs in a row.
pub(super) const PAIRS: usize = 8;
/// Numbers in a row.
pub(super) const SIZE: usize = LANES * PAIRS;
/// Two zeros.
pub(super) const ZERO: f64x2 = f64x2::splat(0.0);

/// Where the attitude error begins in a row.
pub(super) const A: usize = 0;
/// Where the accelerometer bias begins.
pub(super) const B: usize = 3;
/// Where the gyro bias begins.
pub(super) const G: usize = 6;
/// Number of states that drive the others: attitude error and both biases.
pub(super) const DRIVING: usize = 9;
/// Pairs that hold them; the last number of these is nothing.
pub(super) const DRIVING_PAIRS: usize = 5;
/// Where velocity and position begin, axis by axis: `v p v p v p`.
pub(super) const M: usize = LANES * DRIVING_PAIRS;

/// Where each of the states is in a row.
pub(super) const PLACES: [usize; STATES] = {
    let mut places = [0; STATES];
    let mut i = 0;
    while i < 3 {
        places[ATTITUDE + i] = A + i;
        places[ACCEL_BIAS + i] = B + i;
        places[GYRO_BIAS + i] = G + i;
        places[VELOCITY + i] = M + LANES * i;
        places[POSITION + i] = M + LANES * i + 1;
        i += 1;
    }
    places
};

/// A row of the covariance, or an error vector.
#[derive(Clone, Copy, Debug)]
pub(in crate::kalman) struct Row(pub(super) [f64x2; PAIRS]);

impl Row {
    /// Nothing.
    pub(super) const ZERO: Self = Self([ZERO; PAIRS]);

    /// The number in a place.
    #[inline]
    pub(super) const fn at(&self, place: usize) -> f64 {
        self.0[place / LANES].as_array()[place % LANES]
    }

    /// Changes the number in a place.
    #[inline]
    pub(super) fn set(&mut self, place: usize, value: f64) {
        self.0[place / LANES].as_mut_array()[place % LANES] = value;
    }

    /// Every number times a factor.
    #[inline]
    pub(in crate::kalman) fn scaled(&self, by: f64) -> Self {
        let (mut out, by) = (*self, f64x2::splat(by));
        for pair in &mut out.0 {
            *pair *= by;
        }
        out
    }

    /// The three numbers of a part of the state that begins at an index.
    #[inline]
    pub(in crate::kalman) fn part(&self, first: usize) -> Vector3<f64> {
        Vector3::new(
            self.at(PLACES[first]),
            self.at(PLACES[first + 1]),
            self.at(PLACES[first + 2]),
        )
    }

    /// The numbers in the order of the states.
    #[cfg(test)]
    pub(super) fn dense(&self) -> super::ErrorVector {
        super::ErrorVector::from_fn(|i, _| self.at(PLACES[i]))
    }
}
