//! What optimal gains cost: `cargo bench -p control --bench lqr`. One line of JSON a figure, best and median of many rounds.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a measuring program prints its figures and fails where it stands"
)]

use control::lqr::{Motion, Trim, Weights, dare, design, zero_order_hold};
use core::hint::black_box;
use nalgebra::SMatrix;
use std::time::Instant;

const ROUNDS: usize = 200;
const CALLS: u32 = 10;

fn measure<T>(name: &str, mut work: impl FnMut() -> T) {
    let mut us: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            for _ in 0..CALLS {
                black_box(work());
            }
            start.elapsed().as_secs_f64() * 1e6 / f64::from(CALLS)
        })
        .collect();
    us.sort_by(f64::total_cmp);
    println!(
        "{{\"bench\":\"{name}\",\"best_us\":{:.1},\"median_us\":{:.1}}}",
        us[0],
        us[ROUNDS / 2]
    );
}

fn main() {
    let motion = Motion::uquad();
    let hover = Trim::hover(&motion.craft, 0.0);
    let (a, b) = motion.jacobians(&hover.state, &hover.inputs);
    let (phi, gamma) = zero_order_hold(&a, &b, 0.01);
    let weights = Weights::uquad();
    let q: SMatrix<f64, 12, 12> = weights.q.fixed_view::<12, 12>(0, 0).into_owned();
    measure("jacobians", || {
        motion.jacobians(black_box(&hover.state), &hover.inputs)
    });
    measure("zero_order_hold_12x4", || {
        zero_order_hold(black_box(&a), &b, 0.01)
    });
    measure("dare_12x4", || {
        dare(black_box(&phi), &gamma, &q, &weights.r).unwrap()
    });
    measure("lqi_16x4_whole", || {
        design::twelve_and_integrals(&motion, black_box(&hover), &weights).unwrap()
    });
}
