//! Times of obstacle avoidance, one JSON line each: `cargo bench -p planner --profile ci --bench vfh`.
//!
//! | Line | What |
//! | --- | --- |
//! | `vfh/full` | a step after the vehicle has moved on: the window's cells into the polar histogram, direction, speed |
//! | `vfh/incremental` | a step in which eight cells have changed, but not the place: histogram, direction, speed |
//! | `vfh/gather` | obstacle points of the window, for the free way ahead and the look-ahead |
//! | `vfh/scan` | 32 columns into the grid, free space before them too |

#![allow(
    clippy::disallowed_methods,
    clippy::print_stdout,
    reason = "a bench reads the clock and prints"
)]

use planner::VfhParams;
use planner::vfh::grid::CertaintyGrid;
use planner::vfh::histogram::{Histogram, Window};
use planner::vfh::steering::{Pull, direction, stopping_speed};
use planner::vfh::surroundings::Surroundings;
use std::hint::black_box;
use std::time::Instant;
use vehicle::{In, Timestamp};

/// Short runs, many of them: the best is one that nothing interrupted, also on a busy machine.
const ROUNDS: u32 = 250;
const RUNS: u32 = 800;
const NOW: Timestamp = Timestamp::from_ms(1_000);

/// Best mean of a run, microseconds, and allocations of one call.
fn report(name: &str, mut call: impl FnMut()) {
    let mut best_us = f64::INFINITY;
    for _ in 0..RUNS {
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
        let mut window = Window::new(params.window_m);
        let pull = Pull {
            target_rad: 0.3,
            motion_rad: Some(0.1),
            previous_rad: Some(0.2),
        };
        let mut step = |grid: &mut CertaintyGrid, here| {
            histogram.update_over(&mut window, grid, here, NOW, &[], 1.5);
            let chosen = direction(&params, histogram.blocked(), &pull);
            black_box(stopping_speed(params.brake_mps2, params.latency_s, 1.0));
            black_box(chosen);
        };
        let mut is_odd = false;
        report(&format!("vfh/full {share}"), || {
            is_odd = !is_odd;
            let moved_m = if is_odd { 0.06 } else { 0.0 };
            step(&mut grid, here + In::new(moved_m, 0.0, 0.0));
        });
        let changing: Vec<_> = (0..8)
            .map(|k| In::new(4.05 + 0.2 * f64::from(k), 5.55, 0.0))
            .collect();
        report(&format!("vfh/incremental {share}"), || {
            for p in &changing {
                grid.add_hit(*p, NOW);
            }
            step(&mut grid, here);
        });
    }
    let mut grid = CertaintyGrid::new([0.0, 0.0], [10.0, 10.0], &params);
    let ends: Vec<_> = (0..32)
        .map(|k| {
            let (s, c) = libm::sincos(f64::from(k) * 0.19);
            In::new(5.0 + 1.5 * c, 5.0 + 1.5 * s, 0.0)
        })
        .collect();
    report("vfh/scan 32 rays", || {
        for end in &ends {
            grid.add_free(here, *end, NOW);
            grid.add_hit(*end, NOW);
        }
    });
}
