//! Arithmetic of the covariance: only the blocks that are not zero, symmetric to the last bit by construction.
//!
//! Columns of the matrix are contiguous, so everything is written as sums of columns, which the compiler turns into vector
//! instructions. Equal to the dense products `F P F'` and `P - K S K'` up to rounding.

use super::{ACCEL_BIAS, ATTITUDE, Covariance, ErrorVector, GYRO_BIAS, POSITION, STATES, VELOCITY};
use nalgebra::{Matrix3, Vector3};

/// Smaller than this a covariance is nothing (no variance is below 1e-12), and its subnormal products would cost a hundred
/// cycles each.
const NOTHING: f64 = 1e-40;
/// No variance falls below this: the next gain would blow up.
const FLOOR: f64 = 1e-12;
/// No variance rises above this: ten kilometres, and no product of two overflows.
const CEILING: f64 = 1e8;

/// Columns are padded to an even sixteen while they are worked on: compilers leave loops of fifteen scalar.
const PADDED: usize = 16;
/// What moves with a sample: position, velocity, attitude; padded likewise.
const MOVING: usize = 10;
type Columns = [[f64; PADDED]; STATES];

/// The blocks of the transition matrix that are neither zero nor one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Transition {
    /// Length of the step, s.
    pub(super) dt: f64,
    /// Body to world in the middle of the step.
    pub(super) rotation: Matrix3<f64>,
    /// `rotation * [specific force]x`.
    pub(super) force: Matrix3<f64>,
    /// Attitude error carried over the step: `Exp(-turn)`.
    pub(super) turn: Matrix3<f64>,
}

impl Transition {
    /// The dense matrix, for tests.
    #[cfg(test)]
    pub(super) fn dense(&self) -> Covariance {
        let (dt, half) = (self.dt, 0.5 * self.dt * self.dt);
        let mut phi = Covariance::identity();
        let mut set = |row: usize, column: usize, block: Matrix3<f64>| {
            phi.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        set(POSITION, VELOCITY, Matrix3::identity() * dt);
        set(POSITION, ATTITUDE, self.force * -half);
        set(POSITION, ACCEL_BIAS, self.rotation * -half);
        set(VELOCITY, ATTITUDE, self.force * -dt);
        set(VELOCITY, ACCEL_BIAS, self.rotation * -dt);
        set(VELOCITY, GYRO_BIAS, self.force * half);
        set(ATTITUDE, ATTITUDE, self.turn);
        set(ATTITUDE, GYRO_BIAS, Matrix3::identity() * -dt);
        phi
    }

    /// The first `ROWS` rows of `P F'`: each column of the result is a sum of columns of `P`. One loop over the rows with everything in registers, so
    /// that neighbouring rows share vector instructions.
    #[inline]
    fn right<const ROWS: usize>(&self, p: &Columns) -> Columns {
        let (dt, half) = (self.dt, 0.5 * self.dt * self.dt);
        let dot = |m: &Matrix3<f64>, i: usize, x: f64, y: f64, z: f64| {
            m[(i, 0)] * x + m[(i, 1)] * y + m[(i, 2)] * z
        };
        let mut out = *p;
        for i in 0..3 {
            for row in 0..ROWS {
                let (position, velocity) = (p[POSITION + i][row], p[VELOCITY + i][row]);
                let [x, y, z] = [p[ATTITUDE][row], p[ATTITUDE + 1][row], p[ATTITUDE + 2][row]];
                let accel = [
                    p[ACCEL_BIAS][row],
                    p[ACCEL_BIAS + 1][row],
                    p[ACCEL_BIAS + 2][row],
                ];
                let gyro = [
                    p[GYRO_BIAS][row],
                    p[GYRO_BIAS + 1][row],
                    p[GYRO_BIAS + 2][row],
                ];
                // What attitude error and accelerometer bias do to acceleration, and what gyro bias will do.
                let pushed = dot(&self.force, i, x, y, z)
                    + dot(&self.rotation, i, accel[0], accel[1], accel[2]);
                let later = dot(&self.force, i, gyro[0], gyro[1], gyro[2]);
                let turned = dot(&self.turn, i, x, y, z);
                out[POSITION + i][row] = position + dt * velocity - half * pushed;
                out[VELOCITY + i][row] = velocity - dt * pushed + half * later;
                out[ATTITUDE + i][row] = turned - dt * gyro[i];
            }
        }
        out
    }
}

/// `P <- F P F'`.
pub(super) fn propagate(covariance: &mut Covariance, transition: &Transition) {
    let mut columns = [[0.0; PADDED]; STATES];
    for (column, p) in columns.iter_mut().zip(&covariance.data.0) {
        for (value, p) in column.iter_mut().zip(p) {
            *value = if p.abs() < NOTHING { 0.0 } else { *p };
        }
    }
    // F P F' = (P F')' F' because P is symmetric: the same sums twice, with a transposition between. The rows of the biases are
    // done after the first time.
    let once = transition.right::<PADDED>(&columns);
    for (i, column) in columns.iter_mut().enumerate() {
        for j in 0..MOVING {
            column[j] = once[j][i];
        }
    }
    let twice = transition.right::<MOVING>(&columns);
    let p = &mut covariance.data.0;
    for (i, own) in p.iter_mut().enumerate() {
        if i < ACCEL_BIAS {
            // Both halves agree to rounding only, so one is mirrored.
            for j in 0..i {
                own[j] = twice[j][i];
            }
            own[i..ACCEL_BIAS].copy_from_slice(&twice[i][i..ACCEL_BIAS]);
            own[ACCEL_BIAS..].copy_from_slice(&once[i][ACCEL_BIAS..STATES]);
        } else {
            for j in 0..ACCEL_BIAS {
                own[j] = once[j][i];
            }
        }
    }
    keep_sound(covariance);
}

/// Where rounding has eaten a variance, or broken sensors have driven it beyond all sense, what it was correlated with is
/// nonsense too: the state begins anew, knowing no other.
#[inline]
fn keep_sound(covariance: &mut Covariance) {
    for i in 0..STATES {
        let variance = covariance[(i, i)];
        // What is not a number is in no range.
        if !(FLOOR..=CEILING).contains(&variance) {
            covariance.fill_row(i, 0.0);
            covariance.fill_column(i, 0.0);
            covariance[(i, i)] = if variance < FLOOR { FLOOR } else { CEILING };
        }
    }
}

/// `P h`, skipping the zeros of which a row is mostly made.
#[inline]
pub(super) fn times(covariance: &Covariance, row: &ErrorVector) -> ErrorVector {
    let p = &covariance.data.0;
    let mut out = [0.0; STATES];
    for i in 0..STATES {
        let h = row[i];
        if h != 0.0 {
            for k in 0..STATES {
                out[k] += p[i][k] * h;
            }
        }
    }
    ErrorVector::from(out)
}

/// `P <- P + k v v'`; a negative `k` takes away what was learned, and no variance falls below a floor.
#[inline]
pub(super) fn add_outer(covariance: &mut Covariance, v: &ErrorVector, k: f64) {
    let sign = if k < 0.0 { -1.0 } else { 1.0 };
    // The same factor on both sides makes the products equal to the last bit.
    let scaled: [f64; STATES] = (v * k.abs().sqrt()).into();
    for (i, column) in covariance.data.0.iter_mut().enumerate() {
        let own = scaled[i] * sign;
        for (p, s) in column.iter_mut().zip(&scaled) {
            *p += own * s;
        }
    }
    for i in 0..STATES {
        covariance[(i, i)] = covariance[(i, i)].max(FLOOR);
    }
    if k > 0.0 {
        keep_sound(covariance);
    }
}

/// `P <- G P G'` with `G = I - [half]x` on the attitude error.
#[inline]
pub(super) fn turn_attitude(covariance: &mut Covariance, half: &Vector3<f64>) {
    let p = &mut covariance.data.0;
    let [x, y, z] = [p[ATTITUDE], p[ATTITUDE + 1], p[ATTITUDE + 2]];
    let mut turned = [[0.0; STATES]; 3];
    for row in 0..STATES {
        turned[0][row] = x[row] + half.z * y[row] - half.y * z[row];
        turned[1][row] = y[row] + half.x * z[row] - half.z * x[row];
        turned[2][row] = z[row] + half.y * x[row] - half.x * y[row];
    }
    // The attitude's own block is turned from the left too.
    let block = |i: usize, j: usize| turned[j][ATTITUDE + i];
    let own = Matrix3::from_fn(|i, j| {
        let (next, last) = ((i + 1) % 3, (i + 2) % 3);
        block(i, j) + half[last] * block(next, j) - half[next] * block(last, j)
    });
    for (i, column) in turned.iter_mut().enumerate() {
        for j in 0..3 {
            column[ATTITUDE + j] = own[(i.max(j), i.min(j))];
        }
        p[ATTITUDE + i] = *column;
    }
    for (row, column) in p.iter_mut().enumerate() {
        if !(ATTITUDE..ATTITUDE + 3).contains(&row) {
            for (i, turned) in turned.iter().enumerate() {
                column[ATTITUDE + i] = turned[row];
            }
        }
    }
    keep_sound(covariance);
}

/// Mean of both halves, within the bounds.
pub(super) fn symmetrise(p: &mut Covariance) {
    for i in 0..STATES {
        for j in 0..i {
            let mean = 0.5 * (p[(i, j)] + p[(j, i)]);
            p[(i, j)] = mean;
            p[(j, i)] = mean;
        }
    }
    keep_sound(p);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcl::random::Random;
    use nalgebra::UnitQuaternion;

    fn some_covariance(random: &mut Random) -> Covariance {
        let a = Covariance::from_fn(|_, _| f64::from(random.gaussian()));
        a * a.transpose() * 0.01
    }

    fn is_close(a: &Covariance, b: &Covariance) -> bool {
        (a - b).amax() <= 1e-13 * b.amax()
    }

    fn is_symmetric(p: &Covariance) -> bool {
        *p == p.transpose()
    }

    #[test]
    fn the_sparse_arithmetic_equals_the_dense_products_to_rounding_and_is_symmetric_to_the_last_bit()
     {
        let mut random = Random::new(3);
        for _ in 0..100 {
            let mut v = || Vector3::from_fn(|_, _| f64::from(random.gaussian()));
            let (turn, force, attitude) = (v() * 0.02, v() * 10.0, v());
            let rotation = UnitQuaternion::from_scaled_axis(attitude)
                .to_rotation_matrix()
                .into_inner();
            let transition = Transition {
                dt: 0.025,
                rotation,
                force: rotation * force.cross_matrix(),
                turn: UnitQuaternion::from_scaled_axis(-turn)
                    .to_rotation_matrix()
                    .into_inner(),
            };
            let mut p = some_covariance(&mut random);
            symmetrise(&mut p);
            let phi = transition.dense();
            let dense = phi * p * phi.transpose();
            propagate(&mut p, &transition);
            assert!(is_close(&p, &dense) && is_symmetric(&p));

            let row = ErrorVector::from_fn(|i, _| {
                if i % 3 == 0 {
                    f64::from(random.gaussian())
                } else {
                    0.0
                }
            });
            let ph = times(&p, &row);
            assert!((ph - p * row).amax() < 1e-12);
            let s = row.dot(&ph) + 0.1;
            let dense = p - ph * ph.transpose() / s;
            add_outer(&mut p, &ph, -1.0 / s);
            assert!(is_close(&p, &dense) && is_symmetric(&p));

            let g3 = Matrix3::identity() - (turn * 0.5).cross_matrix();
            let mut g = Covariance::identity();
            g.fixed_view_mut::<3, 3>(ATTITUDE, ATTITUDE).copy_from(&g3);
            let dense = g * p * g.transpose();
            turn_attitude(&mut p, &(turn * 0.5));
            assert!(is_close(&p, &dense) && is_symmetric(&p));
        }
    }
}
