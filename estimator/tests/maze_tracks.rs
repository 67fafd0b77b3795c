//! Localization on recorded flights.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "test code outside of test functions"
)]

mod support;

use estimator::EstimatorParams;
use estimator::mcl::Field;
use support::maze::{self, Key, Sensors, Start, TRACKS, Track};
use vehicle::LocalizationState;

fn ate(keys: &[Key]) -> f64 {
    (keys.iter().map(|k| k.error_m * k.error_m).sum::<f64>() / keys.len() as f64).sqrt()
}

/// Converged: below 0.20 m and 36 degrees for three keys in a row. Success: converged and never beyond 1 m afterwards.
fn is_success(keys: &[Key]) -> bool {
    let good = |k: &Key| k.error_m < 0.20 && k.error_rad < 36f64.to_radians();
    let first = keys.windows(3).position(|w| w.iter().all(good));
    first.is_some_and(|i| keys[i..].iter().all(|k| k.error_m <= 1.0))
}

#[test]
fn recorded_tof_hits_of_maze1a_at_the_captured_pose_lie_within_0_03_m_median_of_the_loaded_map() {
    let Some(track) = Track::load("maze1a_exp1_2d_d0") else {
        return;
    };
    let field = Field::new(&track.plan);
    let mut distances = Vec::new();
    for frame in track.frames.iter().filter(|f| f.frame == 0) {
        let Some(truth) = track.truth[frame.node] else {
            continue;
        };
        for beam in maze::beams(frame, Sensors::Columns32)
            .iter()
            .filter(|b| b.is_hit())
        {
            let [x, y] = beam.points[0];
            let p = estimator::mcl::Planar::from(truth).point(x, y);
            distances.push(field.distance_m(p[0], p[1]));
        }
    }
    distances.sort_by(f64::total_cmp);
    let median = distances[distances.len() / 2];
    println!(
        "{} hits, median {median:.4} m to the nearest wall",
        distances.len()
    );
    assert!(distances.len() > 300 && median < 0.03, "median {median}");
}

fn table(sensors: Sensors, seeds: u64) -> (f64, usize, usize) {
    let params = EstimatorParams::default();
    let (mut sum, mut runs, mut successes) = (0.0, 0usize, 0usize);
    println!(
        "{:<20} {:>6} {:>6} {:>6} {:>8} success",
        "track", "mean", "min", "max", "yaw deg"
    );
    for name in TRACKS {
        let Some(track) = Track::load(name) else {
            return (0.0, 0, 0);
        };
        let all: Vec<Vec<Key>> = (1..=seeds)
            .map(|seed| maze::fly(&track, &params, sensors, Start::Known, seed))
            .collect();
        let ates: Vec<f64> = all.iter().map(|k| ate(k)).collect();
        let good = all.iter().filter(|k| is_success(k)).count();
        let yaw = all.iter().flatten().map(|k| k.error_rad).sum::<f64>()
            / all.iter().map(Vec::len).sum::<usize>() as f64;
        println!(
            "{name:<20} {:>6.3} {:>6.3} {:>6.3} {:>8.2} {good}/{seeds}",
            ates.iter().sum::<f64>() / ates.len() as f64,
            ates.iter().copied().fold(f64::INFINITY, f64::min),
            ates.iter().copied().fold(0.0, f64::max),
            yaw.to_degrees(),
        );
        sum += ates.iter().sum::<f64>();
        runs += ates.len();
        successes += good;
    }
    println!(
        "{sensors:?}: ATE mean {:.4} m, success {successes}/{runs}",
        sum / runs as f64
    );
    (sum / runs as f64, successes, runs)
}

#[test]
fn with_32_columns_every_maze_flight_is_tracked_below_three_centimetres() {
    let (mean, successes, runs) = table(Sensors::Columns32, 5);
    if runs > 0 {
        assert!(mean <= 0.028, "ATE mean {mean} m");
        assert_eq!(successes, runs);
    }
}

#[test]
fn with_4_sonars_every_maze_flight_is_tracked_and_no_mode_is_jumped_to() {
    let (mean, successes, runs) = table(Sensors::Sonar4, 5);
    if runs > 0 {
        assert!(mean <= 0.08, "ATE mean {mean} m");
        assert_eq!(successes, runs);
    }
}

/// Keys that were published as ours and are not.
fn wrong_claims(keys: &[Key]) -> usize {
    keys.iter()
        .filter(|k| k.state == LocalizationState::Localized && k.error_m > 0.5)
        .count()
}

#[test]
fn a_global_start_in_the_mazes_is_never_claimed_wrongly_and_found_unless_the_maze_is_symmetric() {
    for name in TRACKS {
        let Some(track) = Track::load(name) else {
            return;
        };
        for sensors in [Sensors::Columns32, Sensors::Sonar4] {
            let keys = maze::fly(
                &track,
                &EstimatorParams::default(),
                sensors,
                Start::Unknown,
                1,
            );
            let claimed = keys
                .iter()
                .position(|k| k.state == LocalizationState::Localized);
            println!(
                "{name:<20} {sensors:?}: claimed at stop {claimed:?} of {}",
                keys.len()
            );
            assert_eq!(wrong_claims(&keys), 0, "{name} {sensors:?}");
            // A square ring looks the same from four places: the only honest answer is none.
            assert_eq!(
                claimed.is_some(),
                !name.starts_with("maze4"),
                "{name} {sensors:?}"
            );
        }
    }
}

#[test]
fn a_kidnapped_vehicle_notices_and_finds_itself_again() {
    for name in ["kidnap_maze1b_a", "kidnap_maze2_a"] {
        let Some(track) = Track::load(name) else {
            return;
        };
        for (sensors, limit) in [(Sensors::Columns32, 2), (Sensors::Sonar4, 4)] {
            for seed in 1..=3 {
                let keys = maze::fly(
                    &track,
                    &EstimatorParams::default(),
                    sensors,
                    Start::Known,
                    seed,
                );
                let back = keys[8..]
                    .windows(3)
                    .position(|w| w.iter().all(|k| k.error_m < 0.2));
                let wrong = wrong_claims(&keys);
                println!(
                    "{name} {sensors:?} seed {seed}: back after {back:?} stops, {wrong} wrong"
                );
                assert!(
                    wrong <= limit,
                    "{name} {sensors:?} seed {seed}: {wrong} wrong stops"
                );
                assert!(
                    back.is_some_and(|b| b <= 6),
                    "{name} {sensors:?} seed {seed}"
                );
            }
        }
    }
}

#[test]
fn the_cost_of_a_particle_is_reported() {
    use estimator::mcl::{Locator, ParticleFilter, Planar, search};
    use std::sync::Arc;
    use std::time::Instant;
    let Some(track) = Track::load("maze2_exp2_2d_d0") else {
        return;
    };
    let params = EstimatorParams {
        particles_min: 2000,
        ..EstimatorParams::default()
    };
    let field = Arc::new(Field::new(&track.plan));
    for sensors in [Sensors::Columns32, Sensors::Sonar4] {
        let beams = maze::beams(&track.frames[0], sensors);
        let mut filter = ParticleFilter::new(&params, Arc::clone(&field), 1);
        filter.start_around(&track.truth[0].unwrap(), 0.2, 0.2);
        let mut best = f64::INFINITY;
        for _ in 0..200 {
            let begin = Instant::now();
            filter.update(&Planar::new(0.01, 0.0, 0.01), 1.0, &beams, 1.0);
            best = best.min(begin.elapsed().as_secs_f64());
        }
        println!(
            "{sensors:?}: whole update of 2000 particles x {} readings: {:.1} ns a particle",
            beams.len(),
            best * 1e9 / 2000.0
        );
    }
    // A search over the maze, from one turn.
    let mut locator = Locator::new(&EstimatorParams::default(), &track.plan, 1);
    locator.start_unknown();
    let mut now = vehicle::Timestamp::from_ms(10);
    for frame in &track.frames {
        now += std::time::Duration::from_millis(66);
        locator.add(
            now,
            &frame.odometry,
            &maze::beams(frame, Sensors::Columns32),
        );
        locator.update(now, 1.0);
        if let Some(job) = locator.poll_job() {
            let begin = Instant::now();
            let result = search(&job);
            let again = search(&job);
            assert_eq!(result, again, "same question, same answer");
            println!(
                "search of {:.0} m2 with {} readings: {:.0} ms",
                field.open_area_m2(),
                result.readings,
                begin.elapsed().as_secs_f64() * 500.0
            );
            break;
        }
    }
}
