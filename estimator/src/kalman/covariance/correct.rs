//! What a scalar measurement does: `P h`, `P - K S K'`, and the attitude error moved to the new attitude.

use super::super::ErrorVector;
use super::Symmetric;
use super::row::{A, DRIVING, LANES, PAIRS, PLACES, Row};
use nalgebra::Vector3;
use wide::f64x2;

impl Symmetric {
    /// Adds a row of the whole matrix times a weight. One function for each place: nothing is left to decide in it.
    #[inline(never)]
    fn add_row<const PLACE: usize>(&self, weight: f64, sum: &mut Row) {
        let weight = f64x2::splat(weight);
        for pair in 0..PAIRS {
            let first = LANES * pair;
            let two = if first >= PLACE {
                self.rows[PLACE].0[pair]
            } else {
                f64x2::new([self.rows[first].at(PLACE), self.rows[first + 1].at(PLACE)])
            };
            sum.0[pair] += weight * two;
        }
    }

    /// Adds the row of a state times a weight.
    #[inline]
    fn add_row_of(&self, i: usize, weight: f64, sum: &mut Row) {
        match i {
            0 => self.add_row::<{ PLACES[0] }>(weight, sum),
            1 => self.add_row::<{ PLACES[1] }>(weight, sum),
            2 => self.add_row::<{ PLACES[2] }>(weight, sum),
            3 => self.add_row::<{ PLACES[3] }>(weight, sum),
            4 => self.add_row::<{ PLACES[4] }>(weight, sum),
            5 => self.add_row::<{ PLACES[5] }>(weight, sum),
            6 => self.add_row::<{ PLACES[6] }>(weight, sum),
            7 => self.add_row::<{ PLACES[7] }>(weight, sum),
            8 => self.add_row::<{ PLACES[8] }>(weight, sum),
            9 => self.add_row::<{ PLACES[9] }>(weight, sum),
            10 => self.add_row::<{ PLACES[10] }>(weight, sum),
            11 => self.add_row::<{ PLACES[11] }>(weight, sum),
            12 => self.add_row::<{ PLACES[12] }>(weight, sum),
            13 => self.add_row::<{ PLACES[13] }>(weight, sum),
            _ => self.add_row::<{ PLACES[14] }>(weight, sum),
        }
    }

    /// `P h` and `h' P h` of a row of which only the numbers in `support` (one bit each) are not zero.
    #[inline]
    pub(in crate::kalman) fn times(&self, h: &ErrorVector, support: u16) -> (Row, f64) {
        let mut ph = Row::ZERO;
        let mut rest = support;
        while rest != 0 {
            let i = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            self.add_row_of(i, h[i], &mut ph);
        }
        let mut hph = 0.0;
        let mut rest = support;
        while rest != 0 {
            let i = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            hph += h[i] * ph.at(PLACES[i]);
        }
        (ph, hph)
    }

    /// `P <- P + k v v'`; a negative `k` takes away what was learned.
    #[inline]
    #[expect(
        clippy::needless_range_loop,
        reason = "written so, the compiler makes one straight line of it; through iterators it takes twice the time"
    )]
    pub(in crate::kalman) fn add_outer(&mut self, v: &Row, k: f64) {
        let scaled = v.scaled(k);
        for (own, v) in v.0.iter().enumerate() {
            for (k, v) in v.to_array().into_iter().enumerate() {
                if LANES * own + k == DRIVING {
                    continue;
                }
                let v = f64x2::splat(v);
                let row = &mut self.rows[LANES * own + k].0;
                for pair in own..PAIRS {
                    row[pair] += v * scaled.0[pair];
                }
            }
        }
    }

    /// `P <- G P G'` with `G = I - [half]x` on the attitude error.
    pub(in crate::kalman) fn turn_attitude(&mut self, half: &Vector3<f64>) {
        const PLACE: usize = A;
        let turned = |[x, y, z]: [f64; 3]| {
            [
                x + half.z * y - half.y * z,
                y + half.x * z - half.z * x,
                z + half.y * x - half.x * y,
            ]
        };
        for other in PLACES.iter().filter(|p| !(PLACE..PLACE + 3).contains(p)) {
            let part = turned([0, 1, 2].map(|k| self.at(PLACE + k, *other)));
            for (k, value) in part.into_iter().enumerate() {
                self.set(PLACE + k, *other, value);
            }
        }
        // The attitude's own block is turned from both sides.
        let half_turned =
            [0, 1, 2].map(|i| turned([0, 1, 2].map(|j| self.at(PLACE + i, PLACE + j))));
        let [x, y, z] = half_turned;
        for (j, ((x, y), z)) in x.into_iter().zip(y).zip(z).enumerate() {
            for (i, value) in turned([x, y, z]).into_iter().enumerate().take(j + 1) {
                self.set(PLACE + i, PLACE + j, value);
            }
        }
    }
}
