//! The sparse arithmetic beside the dense products it stands for.

use super::super::{ACCEL_BIAS, ATTITUDE, Covariance, ErrorVector, GYRO_BIAS, POSITION, VELOCITY};
use super::propagate::{Growth, Transition};
use super::*;
use crate::mcl::random::Random;
use nalgebra::UnitQuaternion;
use nalgebra::{Matrix3, Vector3};

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
fn the_sparse_arithmetic_equals_the_dense_products_to_rounding_and_is_symmetric_to_the_last_bit() {
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
