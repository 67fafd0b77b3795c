//! What localization costs: `cargo bench -p estimator --bench mcl`. One line of JSON a figure, best and median of many
//! rounds. Inputs are those of the performance note: map `floor20` (20 x 20 m, 5 cm cells, nine rooms with boxes), ranges
//! to 8 m, K beams evenly around, particles around the true pose (0.2 m, 0.2 rad) or anywhere.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a measuring program prints its figures and fails where it stands"
)]

use core::f64::consts::TAU;
use core::hint::black_box;
use estimator::EstimatorParams;
use estimator::mcl::beam_model::{BeamModel, Beams, Mixture};
use estimator::mcl::beams::{LevelBeam, Stance, level};
use estimator::mcl::particles::Particles;
use estimator::mcl::random::Random;
use estimator::mcl::range_table::{RangeTable, cast};
use estimator::mcl::{Field, ParticleFilter, Planar};
use std::sync::Arc;
use std::time::Instant;
use vehicle::floor_plan::Cell;
use vehicle::{Beam, FloorPlan, In, MapPose, RangeScan, Timestamp};

const SIDE: usize = 400;
const MAX_M: f64 = 8.0;
const POSE: MapPose = MapPose {
    x_m: 3.4,
    y_m: 3.4,
    yaw_rad: 0.3,
};

/// Nine rooms, doors, four boxes in each.
fn floor20() -> FloorPlan {
    let mut cells = vec![Cell::Free; SIDE * SIDE];
    let mut fill = |x: usize, y: usize, w: usize, h: usize, cell: Cell| {
        for row in y..(y + h).min(SIDE) {
            cells[row * SIDE + x..row * SIDE + (x + w).min(SIDE)].fill(cell);
        }
    };
    for wall in [133, 266] {
        fill(wall, 0, 3, SIDE, Cell::Occupied);
        fill(0, wall, SIDE, 3, Cell::Occupied);
    }
    for wall in [133, 266] {
        for door in [56, 190, 322] {
            fill(wall, door, 3, 20, Cell::Free);
            fill(door, wall, 20, 3, Cell::Free);
        }
    }
    for (x, y, w, h) in [
        (0, 0, SIDE, 2),
        (0, SIDE - 2, SIDE, 2),
        (0, 0, 2, SIDE),
        (SIDE - 2, 0, 2, SIDE),
    ] {
        fill(x, y, w, h, Cell::Occupied);
    }
    let mut state = 12_345u32;
    let mut next = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 16) as usize % below
    };
    for room in 0..9 {
        for _ in 0..4 {
            let (x, y) = (
                133 * (room % 3) + 12 + next(90),
                133 * (room / 3) + 12 + next(90),
            );
            let (w, h) = (4 + next(14), 4 + next(14));
            let is_here = (x..x + w).contains(&68) && (y..y + h).contains(&68);
            if !is_here {
                fill(x, y, w, h, Cell::Occupied);
            }
        }
    }
    FloorPlan::from_cells(SIDE, 0.05, [0.0, 0.0], cells).unwrap()
}

fn readings(plan: &FloorPlan, count: usize) -> Vec<(f64, Option<f64>)> {
    (0..count)
        .map(|k| {
            let bearing = k as f64 * TAU / count as f64;
            let range = cast(plan, [POSE.x_m, POSE.y_m], POSE.yaw_rad + bearing, MAX_M);
            (vehicle::angle::wrap_pi(bearing), range)
        })
        .collect()
}

fn level_beams(readings: &[(f64, Option<f64>)]) -> Vec<LevelBeam> {
    let beams = readings.iter().map(|(bearing, range)| Beam {
        origin: In::zero(),
        bearing_rad: -bearing,
        elevation_rad: 0.0,
        half_cone_rad: 0.05,
        distance_m: *range,
        min_m: 0.02,
        max_m: MAX_M,
    });
    let scan = RangeScan {
        at: Timestamp::ZERO,
        beams: beams.collect(),
    };
    let stance = Stance {
        roll_rad: 0.0,
        pitch_rad: 0.0,
        height_m: 0.6,
        wall_height_m: 2.2,
    };
    level(&scan, &stance).into_iter().collect()
}

/// Seconds of each round.
fn time(rounds: usize, mut work: impl FnMut()) -> Vec<f64> {
    work();
    let mut seconds: Vec<f64> = (0..rounds)
        .map(|_| {
            let begin = Instant::now();
            work();
            begin.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds
}

/// One line: nanoseconds per unit, best and median, and the bar if there is one.
fn report(name: &str, unit: &str, per_round: usize, seconds: &[f64], bar: Option<f64>) {
    let ns = |s: f64| s * 1e9 / per_round as f64;
    let (best, median) = (ns(seconds[0]), ns(seconds[seconds.len() / 2]));
    let bar = bar.map_or_else(String::new, |b| {
        format!(",\"bar\":{b},\"met\":{}", best <= b)
    });
    println!(
        "{{\"bench\":\"{name}\",\"unit\":\"ns/{unit}\",\"best\":{best:.2},\"median\":{median:.2}{bar}}}"
    );
}

fn updates(plan: &FloorPlan) {
    let field = Arc::new(Field::new(plan));
    for (n, k, bar) in [
        (500, 8, None),
        (2_000, 8, Some(40.0)),
        (2_000, 32, None),
        (2_000, 60, Some(110.0)),
        (8_000, 8, None),
        (8_000, 60, None),
    ] {
        let params = EstimatorParams {
            particles_min: n,
            particles_max: n,
            ..EstimatorParams::default()
        };
        let beams = level_beams(&readings(plan, k));
        let mut filter = ParticleFilter::new(&params, Arc::clone(&field), 1);
        filter.start_around(&POSE, 0.2, 0.2);
        let mut turn = 0.02;
        let mut go = |filter: &mut ParticleFilter| {
            turn = -turn;
            black_box(filter.update(&Planar::new(turn, 0.0, turn), 1.0, &beams, 1.0));
        };
        for _ in 0..20 {
            go(&mut filter);
        }
        let seconds = time(1000, || go(&mut filter));
        report(
            &format!("mcl/update/likelihood/track/N{n}/K{k}"),
            "particle",
            n as usize,
            &seconds,
            bar,
        );
        let allocated = allocation_counter::measure(|| go(&mut filter)).count_total;
        println!(
            "{{\"bench\":\"mcl/update/N{n}/K{k}/allocations\",\"count\":{allocated},\"bar\":0}}"
        );
        assert_eq!(allocated, 0, "the update allocates");
        // The first update after a start: far wider than the scan, so evidence is taken in stages.
        let seconds = time(50, || {
            filter.start_around(&POSE, 0.2, 0.2);
            go(&mut filter);
        });
        report(
            &format!("mcl/first update/likelihood/N{n}/K{k}"),
            "particle",
            n as usize,
            &seconds,
            None,
        );
    }
}

fn scattered(n: usize, is_global: bool) -> Particles {
    let mut random = Random::new(7);
    let mut p = Particles::with_capacity(n);
    if is_global {
        for _ in 0..n {
            let (x, y) = (20.0 * random.uniform(), 20.0 * random.uniform());
            p.push(x, y, (random.uniform() - 0.5) * core::f32::consts::TAU, 1.0);
        }
    } else {
        p.push_around(&POSE, 0.2, 0.2, n, 1.0, &mut random);
    }
    p
}

fn beam_models(plan: &FloorPlan, table: &RangeTable) {
    let model = BeamModel::new(&Mixture::default(), table);
    for (n, k, is_global, bar) in [
        (2_000, 8, false, Some(20.0)),
        (2_000, 60, false, None),
        (100_000, 8, true, None),
        (100_000, 60, true, None),
    ] {
        let mut beams = Beams::default();
        beams.set(table, readings(plan, k).into_iter());
        let mut p = scattered(n, is_global);
        let kind = if is_global { "global" } else { "track" };
        let seconds = time(if is_global { 40 } else { 1000 }, || {
            model.weigh(table, &beams, &mut p);
            black_box(&p);
        });
        report(
            &format!("mcl/weigh/beam/{kind}/N{n}/K{k}"),
            "particle",
            n,
            &seconds,
            bar,
        );
    }
}

fn casts(plan: &FloorPlan, table: &RangeTable) {
    const POSES: usize = 200_000;
    let mut random = Random::new(3);
    let poses: Vec<[f32; 3]> = (0..POSES)
        .map(|_| {
            let (x, y) = (20.0 * random.uniform(), 20.0 * random.uniform());
            [x, y, (random.uniform() - 0.5) * core::f32::consts::TAU]
        })
        .collect();
    let seconds = time(3, || {
        for [x, y, yaw] in &poses {
            black_box(cast(
                plan,
                [f64::from(*x), f64::from(*y)],
                f64::from(*yaw),
                MAX_M,
            ));
        }
    });
    report("mcl/raycast/traversal", "cast", POSES, &seconds, None);
    let mut sum = 0u32;
    let seconds = time(300, || {
        for [x, y, yaw] in &poses {
            sum = sum.wrapping_add(u32::from(table.code(*x, *y, *yaw)));
        }
        black_box(sum);
    });
    report(
        "mcl/raycast/table/single random",
        "cast",
        POSES,
        &seconds,
        Some(25.0),
    );
    let mut codes = [0u8; 60];
    for k in [8usize, 60] {
        let steps: Vec<f32> = (0..k).map(|i| (i as f32 / k as f32 - 0.5) * 72.0).collect();
        let seconds = time(1000, || {
            for [x, y, yaw] in &poses[..2_000] {
                table.codes(*x, *y, *yaw, &steps, &mut codes[..k]);
                black_box(&codes);
            }
        });
        report(
            &format!("mcl/raycast/table/{k} beams of one pose"),
            "cast",
            2_000 * k,
            &seconds,
            Some(2.5),
        );
    }
    // How far the table is from a cast of the very pose, where both see a wall.
    let (mut errors, mut worst) = (Vec::new(), 0.0f64);
    for [x, y, yaw] in poses.iter().step_by(10) {
        let (x, y, yaw) = (f64::from(*x), f64::from(*y), f64::from(*yaw));
        if let (Some(a), Some(b)) = (cast(plan, [x, y], yaw, MAX_M), table.range_m(x, y, yaw)) {
            errors.push((a - b).abs());
            worst = worst.max((a - b).abs());
        }
    }
    errors.sort_by(f64::total_cmp);
    println!(
        "{{\"bench\":\"mcl/raycast/table/error\",\"unit\":\"m\",\"median\":{:.3},\"p95\":{:.3},\"worst\":{worst:.3}}}",
        errors[errors.len() / 2],
        errors[errors.len() * 95 / 100]
    );
}

fn main() {
    let read = |path| std::fs::read_to_string(path).unwrap_or_default();
    let info = read("/proc/cpuinfo");
    let model = info.lines().find(|l| l.starts_with("model name"));
    println!(
        "{{\"host\":\"{}\",\"load\":\"{}\"}}",
        model
            .and_then(|l| l.split(": ").nth(1))
            .unwrap_or("unknown"),
        read("/proc/loadavg").trim()
    );
    let plan = floor20();
    updates(&plan);
    let begin = Instant::now();
    let table = RangeTable::new(&plan, MAX_M);
    println!(
        "{{\"bench\":\"mcl/range table/build\",\"unit\":\"s\",\"once\":{:.2}}}",
        begin.elapsed().as_secs_f64()
    );
    beam_models(&plan, &table);
    casts(&plan, &table);
}
