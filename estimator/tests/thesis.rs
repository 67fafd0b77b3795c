//! The thesis filter beside the production filter on recorded flights.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "test code outside of test functions"
)]

mod support;

use estimator::mcl::Localizer;
use estimator::mcl::replay::score::{Judged, ate_m, is_success, judge};
use estimator::mcl::replay::{Begin, Replay, Sensors};
use estimator::mcl::thesis::{ThesisLocator, ThesisNoise};
use estimator::{EstimatorParams, MclVariant};
use support::recordings::{TRACKS, Track, seeds};

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Production,
    /// `MCL_VARIANT = 1`.
    Thesis,
    /// With the noise of 0.02 of its own tests.
    AsWritten,
}

fn localizer(kind: Kind, track: &Track, seed: u64) -> Localizer {
    let params = EstimatorParams {
        mcl_variant: if kind == Kind::Production {
            MclVariant::Production
        } else {
            MclVariant::Thesis
        },
        ..EstimatorParams::default()
    };
    if kind == Kind::AsWritten {
        let thesis = ThesisLocator::new(ThesisNoise::AS_WRITTEN, &track.plan, seed);
        return Localizer::Thesis(Box::new(thesis));
    }
    Localizer::new(&params, &track.plan, seed)
}

fn fly(kind: Kind, track: &Track, is_known: bool, seed: u64) -> Vec<Judged> {
    let begin = if is_known {
        Begin::At(track.start_near_truth(seed))
    } else {
        Begin::Anywhere
    };
    let mut replay = Replay::with(localizer(kind, track, seed), begin);
    judge(&replay.run(&track.log.rows), &track.truth)
}

#[test]
fn the_production_filter_tracks_the_maze_flights_closer_than_the_thesis_filter() {
    let seeds = seeds(2, 20);
    for sensors in [Sensors::Tof32, Sensors::Sonar4] {
        println!(
            "FIGURES production and thesis, tracking, {sensors:?}, {seeds} seeds: ATE m (successes)\n {:<20} {:>14} {:>14} {:>14}",
            "track", "production", "thesis", "noise 0.02"
        );
        let mut sums = [(0.0, 0u64); 3];
        for name in TRACKS {
            let Some(track) = Track::load(name, sensors) else {
                return;
            };
            print!(" {name:<20}");
            for (kind, sum) in [Kind::Production, Kind::Thesis, Kind::AsWritten]
                .into_iter()
                .zip(&mut sums)
            {
                let runs: Vec<_> = (1..=seeds).map(|s| fly(kind, &track, true, s)).collect();
                let ate = runs.iter().map(|k| ate_m(k)).sum::<f64>() / seeds as f64;
                let good = runs.iter().filter(|k| is_success(k)).count() as u64;
                print!(" {ate:>9.3} ({good:>2})");
                sum.0 += ate / TRACKS.len() as f64;
                sum.1 += good;
            }
            println!();
        }
        let [
            (production, good),
            (thesis, thesis_good),
            (written, written_good),
        ] = sums;
        println!(
            " {:<20} {production:>9.3} ({good:>2}) {thesis:>9.3} ({thesis_good:>2}) {written:>9.3} ({written_good:>2})\nEND",
            "all"
        );
        assert!(production < 0.7 * thesis, "{production} {thesis}");
        assert!(good >= thesis_good);
    }
}

#[test]
fn from_a_uniform_start_the_thesis_filter_finds_some_places_too() {
    let seeds = seeds(1, 5);
    println!(
        "FIGURES production and thesis, uniform start, sonar4, {seeds} seeds: successes\n {:<20} production  thesis",
        "track"
    );
    let mut sums = [0, 0];
    for name in TRACKS.iter().filter(|n| !n.starts_with("maze4")) {
        let Some(track) = Track::load(name, Sensors::Sonar4) else {
            return;
        };
        let count = |kind| {
            (1..=seeds)
                .filter(|s| is_success(&fly(kind, &track, false, *s)))
                .count()
        };
        let (production, thesis) = (count(Kind::Production), count(Kind::Thesis));
        println!(" {name:<20} {production:>10}  {thesis:>6}");
        sums[0] += production;
        sums[1] += thesis;
    }
    println!(" all {:>27}  {:>6}\nEND", sums[0], sums[1]);
    assert!(sums[0] >= sums[1]);
}
