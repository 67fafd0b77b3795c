//! Times of obstacle avoidance, one JSON line each: `cargo bench -p planner --profile ci --bench vfh`.
//!
//! | Line | What |
//! | --- | --- |
//! | `vfh/full` | obstacles already gathered: polar histogram from all of them, direction, stopping speed |
//! | `vfh/gather` | obstacles from the certainty grid's window |
//! | `vfh/incremental` | eight changed cells |
//! | `vfh/scan` | 32 columns into the grid, free space before them too |

#![allow(
    clippy::disallowed_methods,
    clippy::print_stdout,
    reason = "a bench reads the clock and prints"
)]

use planner::VfhParams;
use planner::vfh::grid::CertaintyGrid;
use planner::vfh::histogram::Histogram;
use planner::vfh::steering::{Pull, direction, stopping_speed};
use planner::vfh::surroundings::Surroundings;
use std::hint::black_box;
use std::time::Instant;
use vehicle::{In, Timestamp};

const ROUNDS: u32 = 20_000;
const NOW: Timestamp = Timestamp::from_ms(1_000);

/// Best mean of five runs, microseconds, and allocations of one call.
fn report(name: &str, mut call: impl FnMut()) {
    let mut best_us = f64::INFINITY;
    for _ in 0..5 {
        let start = Instant::now();
        for _ in 0..ROUNDS {
            call();
        }
        best_us = best_us.min(start.elapsed().as_secs_f64() * 1e6 / f64::from(ROUNDS));
    }
    let allocations = allocation_counter::measure(&mut call).count_total;
    println!(r#"{{"bench":"{name}","us":{best_us:.3},"allocations":{allocations}}}"#);
}

fn main() {
    let params = VfhParams::default();
    let here = In::new(5.0, 5.0, 0.0);
    for (share, every) in [("3 %", 33), ("30 %", 3)] {
        let mut grid = CertaintyGrid::new([0.0, 0.0], [10.0, 10.0], &params);
        for k in (0..33 * 33).step_by(every) {
            let (column, row) = (k % 33, k / 33);
            let p = In::new(
                3.45 + 0.1 * f64::from(column),
                3.45 + 0.1 * f64::from(row),
                0.0,
            );
            for _ in 0..5 {
                grid.add_hit(p, NOW);
            }
        }
        let mut around = Surroundings::default();
        report(&format!("vfh/gather {share}"), || {
            around.begin(here, params.window_m);
            around.add_cells(&grid, NOW);
            black_box(around.points().len());
        });
        let mut histogram = Histogram::new(&params, 0.2);
        let pull = Pull {
            target_rad: 0.3,
            motion_rad: Some(0.1),
            previous_rad: Some(0.2),
        };
        report(&format!("vfh/full {share}"), || {
            histogram.update(around.points(), 2.0);
            let chosen = direction(&params, histogram.blocked(), &pull);
            black_box(stopping_speed(params.brake_mps2, params.latency_s, 1.0));
            black_box(chosen);
        });
    }
    let mut grid = CertaintyGrid::new([0.0, 0.0], [10.0, 10.0], &params);
    let ends: Vec<_> = (0..32)
        .map(|k| {
            let (s, c) = libm::sincos(f64::from(k) * 0.19);
            In::new(5.0 + 1.5 * c, 5.0 + 1.5 * s, 0.0)
        })
        .collect();
    report("vfh/incremental", || {
        for end in ends.iter().step_by(4) {
            grid.add_hit(*end, NOW);
        }
    });
    report("vfh/scan 32 rays", || {
        for end in &ends {
            grid.add_free(here, *end, NOW);
            grid.add_hit(*end, NOW);
        }
    });
}
