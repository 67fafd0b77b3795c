//! Plans that say nothing: all wall, all open. A place is never claimed on them, and what needs no plan goes on.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "test code outside of test functions"
)]

mod support;

use estimator::{Estimator, EstimatorParams};
use nalgebra::Vector3;
use std::sync::Arc;
use support::world::{Senses, Simulation, World};
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, LocalizationState, Timestamp};

/// Circles of a metre in a real room, for 15 s, with a plan on which every cell is the same.
fn fly_with_a_plan_of(cell: Cell, is_start_known: bool) {
    let world = World::room();
    let cells = vec![cell; world.plan.width() * world.plan.height()];
    let plan = FloorPlan::from_cells(
        world.plan.width(),
        world.plan.resolution_m(),
        world.plan.origin(),
        cells,
    )
    .unwrap();
    let circle = |t: f64| {
        let a = 0.5 * t;
        (Vector3::new(libm::cos(a), libm::sin(a), -1.0), a)
    };
    let mut e = Estimator::new(
        EstimatorParams::default(),
        Some(Arc::new(plan)),
        world.anchor,
        1,
    );
    let mut sim = Simulation::new(&world, &circle, Senses::good("tof32"), 1);
    if is_start_known {
        let start = sim.truth().map_pose(&world.anchor);
        e.start_at(Timestamp::ZERO, start, 0.1, 0.1);
    } else {
        e.start_unknown(Timestamp::ZERO);
    }
    let mut claims = 0;
    sim.fly(&mut e, 15.0, |_, e| {
        let s = e.state();
        // A told start may be believed for a moment, until the ranges speak.
        let is_claim = s.localization.state == LocalizationState::Localized;
        claims += u32::from(is_claim && s.at.s() > 5.0);
        assert!(s.position.is_finite() && s.velocity.is_finite());
        let p = e.navigation().covariance();
        assert!(p == p.transpose() && p.cholesky().is_some());
    });
    let s = e.state();
    assert_eq!(claims, 0, "{cell:?}: a place was claimed");
    assert!(
        !s.health.position && s.health.height && s.health.attitude && s.health.velocity,
        "{cell:?}: {:?}",
        s.health
    );
}

#[test]
fn on_a_plan_that_is_all_wall_no_place_is_claimed_and_height_and_velocity_hold() {
    fly_with_a_plan_of(Cell::Occupied, false);
    fly_with_a_plan_of(Cell::Occupied, true);
}

#[test]
fn on_a_plan_that_is_all_open_no_place_is_claimed_and_height_and_velocity_hold() {
    fly_with_a_plan_of(Cell::Free, false);
    fly_with_a_plan_of(Cell::Free, true);
}
