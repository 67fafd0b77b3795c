//! Arithmetic of the covariance: only the blocks that are not zero, symmetric to the last bit by construction.
//!
//! Columns of the matrix are contiguous, so everything is written as sums of columns, which the compiler turns into vector
//! instructions. Equal to the dense products `F P F'` and `P - K S K'` up to rounding.

use super::{ACCEL_BIAS, ATTITUDE, Covariance, ErrorVector, GYRO_BIAS, POSITION, STATES, VELOCITY};
use nalgebra::Matrix3;

/// No variance falls below this: the next gain would blow up.
const FLOOR: f64 = 1e-12;

type Column = [f64; STATES];
type Columns = [Column; STATES];

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

    /// `P F'`: each column of the result is a sum of columns of `P`.
    #[inline]
    fn right(&self, p: &Columns) -> Columns {
        let (dt, half) = (self.dt, 0.5 * self.dt * self.dt);
        let mut out = *p;
        for i in 0..3 {
            // What attitude error and accelerometer bias do to acceleration, and what gyro bias will do.
            let mut pushed = [0.0; STATES];
            let mut later = [0.0; STATES];
            let mut turned = [0.0; STATES];
            for k in 0..3 {
                let (f, r, t) = (self.force[(i, k)], self.rotation[(i, k)], self.turn[(i, k)]);
                let (attitude, accel) = (&p[ATTITUDE + k], &p[ACCEL_BIAS + k]);
                let gyro = &p[GYRO_BIAS + k];
                for row in 0..STATES {
                    pushed[row] += f * attitude[row] + r * accel[row];
                    later[row] += f * gyro[row];
                    turned[row] += t * attitude[row];
                }
            }
            let (position, velocity) = (&p[POSITION + i], &p[VELOCITY + i]);
            let gyro = &p[GYRO_BIAS + i];
            for row in 0..STATES {
                out[POSITION + i][row] = position[row] + dt * velocity[row] - half * pushed[row];
                out[VELOCITY + i][row] = velocity[row] - dt * pushed[row] + half * later[row];
                out[ATTITUDE + i][row] = turned[row] - dt * gyro[row];
            }
        }
        out
    }
}

/// `P <- F P F'`.
pub(super) fn propagate(covariance: &mut Covariance, transition: &Transition) {
    // F P F' = (P F')' F' because P is symmetric: the same sums twice, with a transposition between.
    let once = transition.right(&covariance.data.0);
    let mut transposed = [[0.0; STATES]; STATES];
    for (i, column) in transposed.iter_mut().enumerate() {
        for (j, value) in column.iter_mut().enumerate() {
            *value = once[j][i];
        }
    }
    let p = &mut covariance.data.0;
    *p = transition.right(&transposed);
    // The biases' columns are the same sums on both sides; the rest agrees to rounding only.
    for i in 0..ACCEL_BIAS {
        for j in 0..i {
            p[i][j] = p[j][i];
        }
    }
}

/// `P h`, skipping the zeros of which a row is mostly made.
#[inline]
pub(super) fn times(covariance: &Covariance, row: &ErrorVector) -> ErrorVector {
    let mut out = [0.0; STATES];
    for (column, h) in covariance.data.0.iter().zip(row.iter()) {
        if *h != 0.0 {
            for (o, c) in out.iter_mut().zip(column) {
                *o += c * h;
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
    let scaled: Column = (v * k.abs().sqrt()).into();
    for (i, column) in covariance.data.0.iter_mut().enumerate() {
        let own = scaled[i] * sign;
        for (p, s) in column.iter_mut().zip(&scaled) {
            *p += own * s;
        }
        column[i] = column[i].max(FLOOR);
    }
}

/// `P <- G P G'` with `G` on the attitude error.
#[inline]
pub(super) fn turn_attitude(covariance: &mut Covariance, g: &Matrix3<f64>) {
    let columns = covariance.fixed_columns::<3>(ATTITUDE) * g.transpose();
    let block = g * columns.fixed_rows::<3>(ATTITUDE);
    for i in 0..3 {
        for row in 0..STATES {
            let value = columns[(row, i)];
            covariance[(row, ATTITUDE + i)] = value;
            covariance[(ATTITUDE + i, row)] = value;
        }
    }
    for i in 0..3 {
        for j in 0..=i {
            covariance[(ATTITUDE + i, ATTITUDE + j)] = block[(i, j)];
            covariance[(ATTITUDE + j, ATTITUDE + i)] = block[(i, j)];
        }
    }
}

/// Mean of both halves, and the floor.
pub(super) fn symmetrise(p: &mut Covariance) {
    for i in 0..STATES {
        for j in 0..i {
            let mean = 0.5 * (p[(i, j)] + p[(j, i)]);
            p[(i, j)] = mean;
            p[(j, i)] = mean;
        }
        p[(i, i)] = p[(i, i)].max(FLOOR);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcl::random::Random;
    use nalgebra::{UnitQuaternion, Vector3};

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
            turn_attitude(&mut p, &g3);
            assert!(is_close(&p, &dense) && is_symmetric(&p));
        }
    }
}
