//! Arithmetic of the covariance: only the blocks that are not zero, and of the symmetric matrix only the upper half.
//!
//! A row is eight pairs of numbers. What drives the rest comes first; velocity and position follow axis by axis, so that a pair is
//! what one axis' motion is made of:
//!
//! | 0 1 2 | 3 4 5 | 6 7 8 | 9 | 10 11 | 12 13 | 14 15 |
//! | --- | --- | --- | --- | --- | --- | --- |
//! | attitude | accelerometer bias | gyro bias | nothing | velocity, position x | y | z |
//!
//! Pairs are the baseline vectors of 64-bit machines, and nothing is multiplied and added in one rounding, so the
//! bits are the same everywhere. Equal to the dense products `F P F' + Q` and `P - K S K'` up to rounding.
//!
//! | Module | Holds |
//! | --- | --- |
//! | `row` | a row, and where the states are in it |
//! | `propagate` | `F P F' + Q` |
//! | `correct` | `P h`, `P + k v v'`, turning the attitude error |

mod correct;
mod propagate;
mod row;

pub(super) use propagate::{Growth, Transition};

use super::{Covariance, ErrorVector, STATES};
use row::{LANES, PLACES, Row, SIZE};
use wide::f64x2;

/// Smaller than this a covariance is nothing (no variance is below 1e-12), and its subnormal products would cost a hundred
/// cycles each.
const NOTHING: f64 = 1e-40;
/// It takes many steps to get from there to subnormal numbers: one in so many looks for them.
const CLEAN_EVERY: u8 = 16;
/// No variance falls below this: the next gain would blow up.
const FLOOR: f64 = 1e-12;
/// No variance rises above this: ten kilometres, and no product of two overflows.
const CEILING: f64 = 1e8;

/// A symmetric matrix of which rows hold the columns from their own on; what is left of that means nothing. The row that is
/// no state's is zero for ever.
#[derive(Clone, Debug)]
pub(super) struct Symmetric {
    rows: [Row; SIZE],
    /// Steps since small numbers were looked for.
    unclean_for: u8,
}

impl Symmetric {
    /// No correlation.
    pub(super) fn diagonal(variances: &ErrorVector) -> Self {
        let mut rows = [Row::ZERO; SIZE];
        for (variance, place) in variances.iter().zip(PLACES) {
            rows[place].set(place, *variance);
        }
        Self {
            rows,
            unclean_for: 0,
        }
    }

    /// Takes the mean of both halves, within the bounds.
    pub(super) fn from_dense(dense: &Covariance) -> Self {
        let mut out = Self::diagonal(&dense.diagonal());
        for i in 0..STATES {
            for j in i + 1..STATES {
                out.set(PLACES[i], PLACES[j], 0.5 * (dense[(i, j)] + dense[(j, i)]));
            }
        }
        out.keep_sound();
        out
    }

    /// The whole matrix.
    pub(super) fn dense(&self) -> Covariance {
        Covariance::from_fn(|i, j| self.at(PLACES[i], PLACES[j]))
    }

    /// A variance.
    #[inline]
    pub(super) fn variance(&self, i: usize) -> f64 {
        self.rows[PLACES[i]].at(PLACES[i])
    }

    #[inline]
    fn at(&self, i: usize, j: usize) -> f64 {
        self.rows[i.min(j)].at(i.max(j))
    }

    #[inline]
    fn set(&mut self, i: usize, j: usize, value: f64) {
        self.rows[i.min(j)].set(i.max(j), value);
    }

    /// Looks for numbers too small to mean anything, now and then.
    #[inline]
    fn tidy(&mut self) {
        self.unclean_for += 1;
        if self.unclean_for >= CLEAN_EVERY {
            self.unclean_for = 0;
            self.clean();
        }
    }

    #[cold]
    fn clean(&mut self) {
        for row in &mut self.rows {
            for place in 0..SIZE {
                if row.at(place).abs() < NOTHING {
                    row.set(place, 0.0);
                }
            }
        }
    }

    /// Where rounding has eaten a variance, or broken sensors have driven it beyond all sense, what it was correlated with is
    /// nonsense too: the state begins anew, knowing no other.
    #[inline]
    pub(super) fn keep_sound(&mut self) {
        // Pairs of variances; the place that is no state's counts as its neighbour.
        let (mut sum, mut least, mut most) =
            (row::ZERO, f64x2::splat(CEILING), f64x2::splat(FLOOR));
        for pair in 0..row::PAIRS {
            let first = LANES * pair;
            let second = if first + 1 == row::DRIVING {
                first
            } else {
                first + 1
            };
            let variances = f64x2::new([self.rows[first].at(first), self.rows[second].at(second)]);
            sum += variances;
            least = least.fast_min(variances);
            most = most.fast_max(variances);
        }
        let is_within = |v: f64x2| v.to_array().iter().all(|v| (FLOOR..=CEILING).contains(v));
        // What is not a number is in the sum.
        let is_finite = sum.to_array().iter().all(|v| v.is_finite());
        if !(is_finite && is_within(least) && is_within(most)) {
            self.mend();
        }
    }

    #[cold]
    fn mend(&mut self) {
        for place in PLACES {
            let variance = self.rows[place].at(place);
            // What is not a number is in no range.
            if !(FLOOR..=CEILING).contains(&variance) {
                for other in PLACES {
                    self.set(place, other, 0.0);
                }
                let bound = if variance < FLOOR { FLOOR } else { CEILING };
                self.set(place, place, bound);
            }
        }
    }
}

#[cfg(test)]
mod tests;
