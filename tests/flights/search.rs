//! `--start unknown`: take off, turn once, find the place; claim nothing that is not true.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

use flight_tests::{Scenario, modes};
use vehicle::LocalizationState;
use vehicle::MapPose;

#[test]
fn finds_its_place_or_says_that_it_does_not_know() {
    let facts = sim::Room::named("office").unwrap().facts();
    let mut right = 0;
    let mut wrong = Vec::new();
    println!("FIGURES unknown start, office, 20 seeds\n seed  outcome  error m  after s");
    for seed in 1..=20_u64 {
        // Another room and heading for each seed.
        let room = &facts.rooms[seed as usize % facts.rooms.len()];
        let pose = MapPose::new(room.map_m[0], room.map_m[1], seed as f64 * 0.9 - 3.0);
        let mut f = Scenario::office().seed(seed).at(pose).unknown().start();
        f.arm();
        let result = f.command(22, [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, 1.0]);
        f.assert(
            result == 0,
            &format!("the search take-off was refused: {result}"),
        );
        let refused = f.set_mode(modes::MISSION);
        f.assert(
            refused != 0,
            "a mission was accepted before the place is known",
        );
        let claimed = f.try_until(90.0, |f| {
            f.snapshot().nav.localization.state == LocalizationState::Localized
                || (f.now().s() > 30.0 && !f.snapshot().is_armed)
        });
        f.wait_s(1.0);
        let is_localized = f.snapshot().nav.localization.state == LocalizationState::Localized;
        let error = (f.truth().position - f.snapshot().nav.position).norm_xy();
        let outcome = match (claimed.is_ok() && is_localized, error < 0.3) {
            (true, true) => {
                right += 1;
                "right"
            }
            (true, false) => {
                wrong.push(seed);
                "WRONG"
            }
            (false, _) => "unknown",
        };
        println!(" {seed:4}  {outcome:7}  {error:7.2}  {:7.1}", f.now().s());
        f.assert(f.truth().contacts == 0, "touched something while searching");
    }
    println!("END");
    assert!(
        wrong.is_empty(),
        "a wrong place was claimed with seeds {wrong:?}"
    );
    assert!(right >= 18, "{right} of 20");
}

#[test]
fn a_search_that_fails_lands_and_says_so() {
    // No ranger reaches a wall in one second: the search cannot end well within LOC_SEARCH_T.
    let mut f = Scenario::room("maze")
        .unknown()
        .param("LOC_SEARCH_T", "5")
        .param("MCL_PARTICLES", "300")
        .start();
    f.arm();
    let result = f.command(22, [0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, 1.0]);
    f.assert(result == 0, "the search take-off was refused");
    let _ = f.try_until(60.0, |f| !f.snapshot().is_armed && f.now().s() > 15.0);
    let is_localized = f.snapshot().nav.localization.state == LocalizationState::Localized;
    if !is_localized {
        let texts = f.station.heard().texts.join("; ");
        f.assert(
            texts.contains("search gave up"),
            &format!("it did not say so: {texts}"),
        );
        f.assert(f.truth().on_floor, "it did not land");
    }
}

#[test]
fn without_permission_to_search_take_off_is_refused() {
    let mut f = Scenario::office()
        .unknown()
        .param("LOC_SEARCH", "0")
        .start();
    f.wait_s(8.0);
    let result = f.command(400, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    f.assert(result == 1, &format!("got {result}"));
}
