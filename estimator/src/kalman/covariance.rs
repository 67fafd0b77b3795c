//! Arithmetic of the covariance: only the blocks that are not zero, and of the symmetric matrix only the upper half.
//!
//! A row is eight pairs of numbers. The three gyro biases lie between the other parts, so that position, velocity, attitude and
//! accelerometer bias begin a pair each:
//!
//! | 0 1 2 | 3 | 4 5 6 | 7 | 8 9 10 | 11 | 12 13 14 | 15 |
//! | --- | --- | --- | --- | --- | --- | --- | --- |
//! | position | gyro bias x | velocity | gyro bias y | attitude | gyro bias z | accelerometer bias | nothing |
//!
//! Pairs are the baseline vectors of 64-bit machines, and nothing is multiplied and added in one rounding, so the
//! bits are the same everywhere. Equal to the dense products `F P F' + Q` and `P - K S K'` up to rounding.

use super::{ACCEL_BIAS, ATTITUDE, Covariance, ErrorVector, GYRO_BIAS, POSITION, STATES, VELOCITY};
use nalgebra::{Matrix3, Vector3};
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

/// Numbers in a pair, and pairs in a row.
const LANES: usize = 2;
const PAIRS: usize = 8;
/// Numbers in a row.
const SIZE: usize = LANES * PAIRS;
const ZERO: f64x2 = f64x2::splat(0.0);

/// Where the parts of the state begin in a row.
const P: usize = 0;
const V: usize = 4;
const A: usize = 8;
const B: usize = 12;
/// Gyro biases are so far apart, and begin here.
const PART: usize = 4;
const G: usize = 3;

/// Where each of the states is in a row.
const PLACES: [usize; STATES] = {
    let mut places = [0; STATES];
    let mut i = 0;
    while i < 3 {
        places[POSITION + i] = P + i;
        places[VELOCITY + i] = V + i;
        places[ATTITUDE + i] = A + i;
        places[ACCEL_BIAS + i] = B + i;
        places[GYRO_BIAS + i] = PART * i + G;
        i += 1;
    }
    places
};

/// A row of the covariance, or an error vector.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row([f64x2; PAIRS]);

impl Row {
    const ZERO: Self = Self([ZERO; PAIRS]);

    #[inline]
    const fn at(&self, place: usize) -> f64 {
        self.0[place / LANES].as_array()[place % LANES]
    }

    #[inline]
    fn set(&mut self, place: usize, value: f64) {
        self.0[place / LANES].as_mut_array()[place % LANES] = value;
    }

    /// A part of the state and what lies behind it.
    #[inline]
    const fn four(&self, first: usize) -> Four {
        [self.0[first / LANES], self.0[first / LANES + 1]]
    }

    #[inline]
    fn set_four(&mut self, first: usize, [low, high]: Four) {
        self.0[first / LANES] = low;
        self.0[first / LANES + 1] = high;
    }

    /// Every number times a factor.
    #[inline]
    pub(super) fn scaled(&self, by: f64) -> Self {
        Self(self.0.map(|v| v * f64x2::splat(by)))
    }

    /// The three numbers of a part of the state that begins at an index.
    #[inline]
    pub(super) fn part(&self, first: usize) -> Vector3<f64> {
        Vector3::new(
            self.at(PLACES[first]),
            self.at(PLACES[first + 1]),
            self.at(PLACES[first + 2]),
        )
    }

    /// The numbers in the order of the states.
    #[cfg(test)]
    fn dense(&self) -> ErrorVector {
        ErrorVector::from_fn(|i, _| self.at(PLACES[i]))
    }
}

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

/// What a step adds to the variances.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Growth {
    /// Position, m2.
    pub(super) position: f64,
    /// Position with velocity, m2/s.
    pub(super) position_velocity: f64,
    /// Velocity, m2/s2.
    pub(super) velocity: f64,
    /// Attitude, rad2.
    pub(super) attitude: f64,
    /// Accelerometer bias, m2/s4.
    pub(super) accel_bias: f64,
    /// Gyro bias, rad2/s2.
    pub(super) gyro_bias: f64,
}

/// Change of velocity and attitude by attitude, accelerometer bias and gyro bias.
struct Change {
    /// Velocity by attitude, by accelerometer bias, by gyro bias.
    velocity: [Matrix3<f64>; 3],
    /// Attitude by attitude; by gyro bias it is `-dt`.
    attitude: Matrix3<f64>,
    dt: f64,
}

impl Change {
    fn new(t: &Transition) -> Self {
        Self {
            velocity: [
                t.force * -t.dt,
                t.rotation * -t.dt,
                t.force * (0.5 * t.dt * t.dt),
            ],
            attitude: t.turn,
            dt: t.dt,
        }
    }

    /// `P <- F P` of a `P` with both halves: the moving rows become sums of rows, two columns at a time.
    #[inline]
    fn of_rows(&self, p: &mut [Row; SIZE]) {
        let splat =
            |m: &Matrix3<f64>| [0, 1, 2].map(|i| [0, 1, 2].map(|k| f64x2::splat(m[(i, k)])));
        let [by_a, by_b, by_g] = self.velocity.each_ref().map(splat);
        let turn = splat(&self.attitude);
        let (dt, half) = (f64x2::splat(self.dt), f64x2::splat(0.5 * self.dt));
        for pair in 0..PAIRS {
            let at = |place: usize| p[place].0[pair];
            let a = [0, 1, 2].map(|k| at(A + k));
            let b = [0, 1, 2].map(|k| at(B + k));
            let g = [0, 1, 2].map(|k| at(PART * k + G));
            let sum = |m: &[f64x2; 3], v: &[f64x2; 3]| m[0] * v[0] + m[1] * v[1] + m[2] * v[2];
            for i in 0..3 {
                let before = p[V + i].0[pair];
                let after = before + (sum(&by_a[i], &a) + sum(&by_b[i], &b) + sum(&by_g[i], &g));
                p[P + i].0[pair] += half * (before + after);
                p[V + i].0[pair] = after;
                // What is only left of the diagonal of attitude is not looked at: neither pair has a gyro bias.
                if pair != P / LANES && pair != V / LANES {
                    p[A + i].0[pair] = sum(&turn[i], &a) - dt * g[i];
                }
            }
        }
    }
}

/// Two pairs: three numbers of a part, and what lies between it and the next.
type Four = [f64x2; 2];

/// One in one place.
const UNITS: [Four; PART] = [
    [f64x2::new([1.0, 0.0]), ZERO],
    [f64x2::new([0.0, 1.0]), ZERO],
    [ZERO, f64x2::new([1.0, 0.0])],
    [ZERO, f64x2::new([0.0, 1.0])],
];

/// [`Change`] by columns.
struct Columns {
    velocity: [[Four; 3]; 3],
    attitude: [Four; 3],
    /// Half a step for position; nothing for what lies behind it.
    half: Four,
    /// Gyro biases turn the attitude; the last of them, which lies behind it, stays what it is.
    by_gyro: Four,
}

/// Element by element.
#[inline]
fn each(a: Four, b: Four, f: impl Fn(f64x2, f64x2) -> f64x2) -> Four {
    [f(a[0], b[0]), f(a[1], b[1])]
}

#[inline]
fn four(v: [f64; 4]) -> Four {
    [f64x2::new([v[0], v[1]]), f64x2::new([v[2], v[3]])]
}

impl Columns {
    fn new(c: &Change) -> Self {
        let of = |m: &Matrix3<f64>| [0, 1, 2].map(|k| four([m[(0, k)], m[(1, k)], m[(2, k)], 0.0]));
        let half = 0.5 * c.dt;
        Self {
            velocity: c.velocity.each_ref().map(of),
            attitude: of(&c.attitude),
            half: four([half, half, half, 0.0]),
            by_gyro: four([-c.dt, -c.dt, -c.dt, 1.0]),
        }
    }

    #[inline]
    fn sum(m: &[Four; 3], v: [f64; 3]) -> Four {
        let [x, y, z] = v.map(f64x2::splat);
        [0, 1].map(|k| m[0][k] * x + m[1][k] * y + m[2][k] * z)
    }

    /// Velocity after the step.
    #[inline]
    fn velocity(&self, row: &Row) -> Four {
        let part = |first: usize| [0, 1, 2].map(|k| row.at(first + k));
        let g = [0, 1, 2].map(|k| row.at(PART * k + G));
        let changes = [
            Self::sum(&self.velocity[0], part(A)),
            Self::sum(&self.velocity[1], part(B)),
            Self::sum(&self.velocity[2], g),
        ];
        let change = changes.into_iter().reduce(|a, b| each(a, b, |a, b| a + b));
        each(row.four(V), change.unwrap_or([ZERO; 2]), |v, c| v + c)
    }

    /// Position after the step, from velocity then.
    #[inline]
    fn position(&self, row: &Row, velocity: Four) -> Four {
        let twice = each(row.four(V), velocity, |before, after| before + after);
        let way = each(self.half, twice, |half, v| half * v);
        each(row.four(P), way, |p, w| p + w)
    }

    /// Attitude after the step.
    #[inline]
    fn attitude(&self, row: &Row) -> Four {
        let a = [0, 1, 2].map(|k| row.at(A + k));
        let [x, y, z] = [0, 1, 2].map(|k| row.at(PART * k + G));
        let gyro = each(self.by_gyro, four([x, y, z, z]), |by, g| by * g);
        each(Self::sum(&self.attitude, a), gyro, |a, g| a + g)
    }
}

/// A symmetric matrix of which rows hold the columns from their own pair on; what is left of that means nothing, nor does the
/// last row.
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
        if i / LANES == j / LANES {
            self.rows[i.max(j)].set(i.min(j), value);
        }
    }

    /// Fills the lower half.
    #[inline]
    fn mirror(&mut self) {
        for above in 0..PAIRS {
            for right in above + 1..PAIRS {
                let [a, b] = self.rows[LANES * above].0[right].to_array();
                let [c, d] = self.rows[LANES * above + 1].0[right].to_array();
                self.rows[LANES * right].0[above] = f64x2::new([a, c]);
                self.rows[LANES * right + 1].0[above] = f64x2::new([b, d]);
            }
        }
    }

    /// `P <- F P F' + Q`.
    pub(super) fn propagate(&mut self, transition: &Transition, growth: &Growth) {
        self.unclean_for += 1;
        if self.unclean_for >= CLEAN_EVERY {
            self.unclean_for = 0;
            self.clean();
        }
        self.mirror();
        let change = Change::new(transition);
        let columns = Columns::new(&change);
        // F P F' = ((F P) F')': rows first, then the same sums within every row. Pairs left of the diagonal are not looked at.
        change.of_rows(&mut self.rows);
        let q = growth;
        let grown = |v: Four, k: usize, by: f64| {
            let by = f64x2::splat(by);
            each(v, UNITS[k], |v, unit| v + unit * by)
        };
        for k in 0..PART {
            let (own, both) = if k == G {
                (q.gyro_bias, 0.0)
            } else {
                (q.position, q.position_velocity)
            };
            let row = &mut self.rows[P + k];
            let velocity = columns.velocity(row);
            let position = columns.position(row, velocity);
            row.set_four(A, columns.attitude(row));
            row.set_four(V, grown(velocity, k, both));
            row.set_four(P, grown(position, k, own));
        }
        for k in 0..PART {
            let own = if k == G { q.gyro_bias } else { q.velocity };
            let row = &mut self.rows[V + k];
            let velocity = columns.velocity(row);
            row.set_four(A, columns.attitude(row));
            row.set_four(V, grown(velocity, k, own));
        }
        for k in 0..PART {
            let own = if k == G { q.gyro_bias } else { q.attitude };
            let row = &mut self.rows[A + k];
            row.set_four(A, grown(columns.attitude(row), k, own));
        }
        for k in 0..3 {
            let own = self.rows[B + k].four(B);
            self.rows[B + k].set_four(B, grown(own, k, q.accel_bias));
        }
        self.keep_sound();
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
        let (mut sum, mut least, mut most) = (0.0, CEILING, FLOOR);
        for place in PLACES {
            let variance = self.rows[place].at(place);
            sum += variance;
            least = if variance < least { variance } else { least };
            most = if variance > most { variance } else { most };
        }
        // What is not a number is in the sum.
        if !(sum.is_finite() && least >= FLOOR && most <= CEILING) {
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

    /// Adds a row of the whole matrix times a weight. One function for each place: nothing is left to decide in it.
    #[inline(never)]
    fn add_row<const PLACE: usize>(&self, weight: f64, sum: &mut Row) {
        let weight = f64x2::splat(weight);
        for pair in 0..PAIRS {
            let two = if pair < PLACE / LANES {
                f64x2::new([0, 1].map(|k| self.rows[LANES * pair + k].at(PLACE)))
            } else {
                self.rows[PLACE].0[pair]
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
    pub(super) fn times(&self, h: &ErrorVector, support: u16) -> (Row, f64) {
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
    pub(super) fn add_outer(&mut self, v: &Row, k: f64) {
        let scaled = v.scaled(k);
        for (own, v) in v.0.iter().enumerate() {
            for (k, v) in v.to_array().into_iter().enumerate() {
                let v = f64x2::splat(v);
                let row = &mut self.rows[LANES * own + k].0;
                for pair in own..PAIRS {
                    row[pair] += v * scaled.0[pair];
                }
            }
        }
    }

    /// `P <- G P G'` with `G = I - [half]x` on the attitude error.
    pub(super) fn turn_attitude(&mut self, half: &Vector3<f64>) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcl::random::Random;
    use nalgebra::UnitQuaternion;

    fn dense_of(t: &Transition) -> Covariance {
        let (dt, half) = (t.dt, 0.5 * t.dt * t.dt);
        let mut phi = Covariance::identity();
        let mut set = |row: usize, column: usize, block: Matrix3<f64>| {
            phi.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        set(POSITION, VELOCITY, Matrix3::identity() * dt);
        set(POSITION, ATTITUDE, t.force * -half);
        set(POSITION, ACCEL_BIAS, t.rotation * -half);
        // Position is the trapezoid of the velocities before and after.
        set(POSITION, GYRO_BIAS, t.force * (0.5 * dt * half));
        set(VELOCITY, ATTITUDE, t.force * -dt);
        set(VELOCITY, ACCEL_BIAS, t.rotation * -dt);
        set(VELOCITY, GYRO_BIAS, t.force * half);
        set(ATTITUDE, ATTITUDE, t.turn);
        set(ATTITUDE, GYRO_BIAS, Matrix3::identity() * -dt);
        phi
    }

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
            let mut p = Symmetric::from_dense(&some_covariance(&mut random));
            let phi = dense_of(&transition);
            let dense = phi * p.dense() * phi.transpose() + Covariance::identity() * 1e-3;
            let growth = Growth {
                position: 1e-3,
                position_velocity: 0.0,
                velocity: 1e-3,
                attitude: 1e-3,
                accel_bias: 1e-3,
                gyro_bias: 1e-3,
            };
            p.propagate(&transition, &growth);
            assert!(is_close(&p.dense(), &dense) && is_symmetric(&p.dense()));

            let row = ErrorVector::from_fn(|i, _| {
                if i % 3 == 0 {
                    f64::from(random.gaussian())
                } else {
                    0.0
                }
            });
            let (ph, hph) = p.times(&row, 0b1_0010_0100_1001);
            let expected = p.dense() * row;
            assert!((ph.dense() - expected).amax() < 1e-12);
            assert!((hph - row.dot(&expected)).abs() < 1e-12);
            let s = hph + 0.1;
            let dense = p.dense() - expected * expected.transpose() / s;
            p.add_outer(&ph, -1.0 / s);
            assert!(is_close(&p.dense(), &dense) && is_symmetric(&p.dense()));

            let g3 = Matrix3::identity() - (turn * 0.5).cross_matrix();
            let mut g = Covariance::identity();
            g.fixed_view_mut::<3, 3>(ATTITUDE, ATTITUDE).copy_from(&g3);
            let dense = g * p.dense() * g.transpose();
            p.turn_attitude(&(turn * 0.5));
            assert!(is_close(&p.dense(), &dense) && is_symmetric(&p.dense()));
        }
    }
}
