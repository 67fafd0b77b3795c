//! `P <- F P F' + Q`, block by block.
//!
//! Attitude error and biases drive the rest: with `x` for these nine, `v' = v + A x` and `p' = p + dt (v + v') / 2`, where the
//! blocks of `A` are `-dt R [f]x`, `-dt R` and `dt^2 / 2 R [f]x`: the first times `attitude - dt / 2 gyro bias` is the
//! first and the last of them at once. The attitude error turns by `Exp(-turn)` and loses `dt` times the gyro bias.
//!
//! All products have the blocks of `F` on the left, two columns of `P` at a time. What is symmetric is computed once, as
//! `Y + Y'` of a half: `v' v'' = v v' + Y + Y'` with `Y = A (x v' + x x' A' / 2)`.

use super::Symmetric;
use super::row::{A, B, DRIVING, DRIVING_PAIRS, G, LANES, M, Row, SIZE, ZERO};
use nalgebra::Matrix3;
use wide::f64x2;

/// The blocks of the transition matrix that are neither zero nor one.
#[derive(Clone, Copy, Debug)]
pub(in crate::kalman) struct Transition {
    /// Length of the step, s.
    pub(in crate::kalman) dt: f64,
    /// Body to world in the middle of the step.
    pub(in crate::kalman) rotation: Matrix3<f64>,
    /// `rotation * [specific force]x`.
    pub(in crate::kalman) force: Matrix3<f64>,
    /// Attitude error carried over the step: `Exp(-turn)`.
    pub(in crate::kalman) turn: Matrix3<f64>,
}

/// What a step adds to the variances.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::kalman) struct Growth {
    /// Position, m2.
    pub(in crate::kalman) position: f64,
    /// Position with velocity, m2/s.
    pub(in crate::kalman) position_velocity: f64,
    /// Velocity, m2/s2.
    pub(in crate::kalman) velocity: f64,
    /// Attitude, rad2.
    pub(in crate::kalman) attitude: f64,
    /// Accelerometer bias, m2/s4.
    pub(in crate::kalman) accel_bias: f64,
    /// Gyro bias, rad2/s2.
    pub(in crate::kalman) gyro_bias: f64,
}

/// A block, each of its numbers in both lanes.
struct Block([[f64x2; 3]; 3]);

impl Block {
    #[inline(always)]
    fn new(m: &Matrix3<f64>, by: f64) -> Self {
        Self(three(|i| three(|k| f64x2::splat(m[(i, k)] * by))))
    }

    /// Row `i` times a column of three, two columns at once.
    #[inline(always)]
    fn row(&self, i: usize, v: &[f64x2; 3]) -> f64x2 {
        let m = &self.0[i];
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2]
    }
}

/// Three things by their index. Unlike `array::map` it leaves nothing to call.
#[inline(always)]
fn three<T>(mut of: impl FnMut(usize) -> T) -> [T; 3] {
    [of(0), of(1), of(2)]
}

/// First of two in both lanes.
#[inline(always)]
fn low(v: f64x2) -> f64x2 {
    f64x2::transpose([v, v])[0]
}

/// Second of two in both lanes.
#[inline(always)]
fn high(v: f64x2) -> f64x2 {
    f64x2::transpose([v, v])[1]
}

/// A step's blocks.
struct Step {
    /// Velocity by attitude.
    lean: Block,
    /// Velocity by accelerometer bias.
    push: Block,
    /// Attitude by attitude.
    turn: Block,
    dt: f64,
    dt2: f64x2,
    half_dt2: f64x2,
}

/// Velocity's change (rows) with each of the driving states (columns).
type Driven = [[f64x2; DRIVING_PAIRS]; 3];
/// Velocity's change (rows) with velocity and position of each axis (pairs of columns).
type Moved = [[f64x2; 3]; 3];

impl Step {
    #[inline(always)]
    fn new(t: &Transition) -> Self {
        Self {
            lean: Block::new(&t.force, -t.dt),
            push: Block::new(&t.rotation, -t.dt),
            turn: Block::new(&t.turn, 1.0),
            dt: t.dt,
            dt2: f64x2::splat(t.dt),
            half_dt2: f64x2::splat(0.5 * t.dt),
        }
    }

    /// `A` times two columns of the driving states.
    #[inline(always)]
    fn drive(&self, a: &[f64x2; 3], b: &[f64x2; 3], g: &[f64x2; 3]) -> [f64x2; 3] {
        let leaning = three(|k| a[k] - self.half_dt2 * g[k]);
        three(|i| self.lean.row(i, &leaning) + self.push.row(i, b))
    }

    /// The attitude rows of two columns.
    #[inline(always)]
    fn turned(&self, a: &[f64x2; 3], g: &[f64x2; 3]) -> [f64x2; 3] {
        three(|i| self.turn.row(i, a) - self.dt2 * g[i])
    }

    /// Columns of the driving states: turns the attitude's rows, tells how velocity changes with each state.
    #[inline(always)]
    fn driving_columns(&self, rows: &mut [Row; SIZE]) -> Driven {
        let mut driven = [[ZERO; DRIVING_PAIRS]; 3];
        for pair in 0..DRIVING_PAIRS {
            let part = |first: usize| three(|k| rows[first + k].0[pair]);
            let (a, b, g) = (part(A), part(B), part(G));
            for (i, change) in self.drive(&a, &b, &g).into_iter().enumerate() {
                driven[i][pair] = change;
            }
            for (i, turned) in self.turned(&a, &g).into_iter().enumerate() {
                rows[A + i].0[pair] = turned;
            }
        }
        driven
    }

    /// Turns the attitude's own block from the other side too.
    #[inline(always)]
    fn turn_across(&self, rows: &mut [Row; SIZE]) {
        let m = |j: usize, k: usize| self.turn.0[j][k].as_array()[0];
        let first = three(|k| f64x2::new([m(0, k), m(1, k)]));
        let last = three(|k| f64x2::new([m(2, k), 0.0]));
        let rest = f64x2::new([0.0, 1.0]);
        let bias = f64x2::new([self.dt, 0.0]);
        for row in &mut rows[A..A + 3] {
            let r = &mut row.0;
            let (x, y, z) = (low(r[0]), high(r[0]), low(r[1]));
            r[0] = x * first[0] + y * first[1] + z * first[2] - self.dt2 * r[G / LANES];
            r[1] = x * last[0] + y * last[1] + z * last[2] + rest * r[1] - bias * r[G / LANES + 1];
        }
    }

    /// Columns of velocity and position of one axis in the driving states' rows; how velocity changes with them.
    #[inline(always)]
    fn moving_columns(&self, rows: &mut [Row; SIZE], axis: usize, driven: &Driven) -> [f64x2; 3] {
        let pair = M / LANES + axis;
        let carry = f64x2::new([0.0, self.dt]);
        let both = f64x2::new([0.5, 0.25 * self.dt]);
        let (mut half, mut after) = ([ZERO; DRIVING], [ZERO; DRIVING]);
        for x in 0..DRIVING {
            let before = rows[x].0[pair];
            let change = driven[axis][x / LANES];
            let change = if x % LANES == 0 {
                low(change)
            } else {
                high(change)
            } * both;
            half[x] = before + carry * low(before) + change;
            after[x] = half[x] + change;
        }
        let part = |of: &[f64x2; DRIVING], first: usize| three(|k| of[first + k]);
        let turned = self.turned(&part(&after, A), &part(&after, G));
        after[A..A + 3].copy_from_slice(&turned);
        for (row, after) in rows.iter_mut().zip(after) {
            row.0[pair] = after;
        }
        self.drive(&part(&half, A), &part(&half, B), &part(&half, G))
    }

    /// Velocity and position among themselves.
    #[inline(always)]
    fn motion(&self, rows: &mut [Row; SIZE], moved: &Moved) {
        let carry = f64x2::new([0.0, self.dt]);
        let and_half = f64x2::new([1.0, 0.5 * self.dt]);
        for i in 0..3 {
            for j in i..3 {
                let (v, p) = (M + LANES * i, M + LANES * i + 1);
                let pair = M / LANES + j;
                // moved[i][j]: row i; velocity and position of axis j.
                let (there, back) = (moved[i][j], moved[j][i]);
                let velocity = rows[v].0[pair];
                let position = if i == j {
                    f64x2::transpose([velocity, rows[p].0[pair]])[1]
                } else {
                    rows[p].0[pair]
                } + self.dt2 * velocity;
                rows[v].0[pair] = velocity + carry * low(velocity) + there + and_half * low(back);
                rows[p].0[pair] = position
                    + carry * low(position)
                    + self.half_dt2 * there
                    + and_half * high(back);
            }
        }
    }
}

impl Symmetric {
    /// `P <- F P F' + Q`.
    pub(in crate::kalman) fn propagate(&mut self, transition: &Transition, growth: &Growth) {
        self.tidy();
        self.mirror();
        let step = Step::new(transition);
        let rows = &mut self.rows;
        let driven = step.driving_columns(rows);
        step.turn_across(rows);
        let columns = three(|axis| step.moving_columns(rows, axis, &driven));
        let moved = three(|i| three(|j| columns[j][i]));
        step.motion(rows, &moved);
        self.grow(growth);
        self.keep_sound();
    }

    /// Fills the lower half of the driving states' block.
    #[inline(always)]
    fn mirror(&mut self) {
        for above in 0..DRIVING_PAIRS {
            for right in above..DRIVING_PAIRS {
                let block = [
                    self.rows[LANES * above].0[right],
                    self.rows[LANES * above + 1].0[right],
                ];
                let [first, second] = f64x2::transpose(block);
                if right > above {
                    self.rows[LANES * right].0[above] = first;
                }
                // The last row of this block is nothing, and stays so.
                if LANES * right + 1 < DRIVING {
                    self.rows[LANES * right + 1].0[above] = second;
                }
            }
        }
    }

    #[inline(always)]
    fn grow(&mut self, q: &Growth) {
        let mut add = |place: usize, lanes: [f64; 2]| {
            self.rows[place].0[place / LANES] += f64x2::new(lanes);
        };
        for (first, by) in [(A, q.attitude), (B, q.accel_bias), (G, q.gyro_bias)] {
            for place in first..first + 3 {
                add(
                    place,
                    if place % LANES == 0 {
                        [by, 0.0]
                    } else {
                        [0.0, by]
                    },
                );
            }
        }
        for axis in 0..3 {
            let v = M + LANES * axis;
            add(v, [q.velocity, q.position_velocity]);
            add(v + 1, [0.0, q.position]);
        }
    }
}
