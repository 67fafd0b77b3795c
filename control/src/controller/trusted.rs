//! Which parts of the state may be flown on.

use crate::takeoff_land::FloorView;
use vehicle::NavState;

/// Which parts of the state are healthy and finite.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trusted {
    pub(super) attitude: bool,
    pub(super) height: bool,
    pub(super) velocity: bool,
    pub(super) position: bool,
}

impl Trusted {
    pub(super) fn of(nav: &NavState) -> Self {
        let attitude = nav.health.attitude && nav.yaw_rad().is_finite();
        let velocity_known = nav.velocity.x().is_finite() && nav.velocity.y().is_finite();
        let velocity = attitude && velocity_known && (nav.health.velocity || nav.health.position);
        Self {
            attitude,
            height: nav.health.height
                && nav.position.z().is_finite()
                && nav.velocity.z().is_finite()
                && nav.height_m.is_finite(),
            velocity,
            position: velocity
                && nav.health.position
                && nav.position.x().is_finite()
                && nav.position.y().is_finite(),
        }
    }
}

pub(super) fn floor_view(nav: &NavState, trusted: &Trusted, climb_guess_mps: f64) -> FloorView {
    FloorView {
        climb_guess_mps,
        height_std_m: finite_or_zero(nav.position_std_m.z()),
        height: trusted.height.then(|| (nav.height_m, -nav.velocity.z())),
        felt_mps2: finite_or_zero(-nav.accel_mps2.z()),
    }
}

pub(super) fn finite_or_zero(v: f64) -> f64 {
    if v.is_finite() { v } else { 0.0 }
}
