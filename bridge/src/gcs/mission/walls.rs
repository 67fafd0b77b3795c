//! The walls that the places of a plan are checked against.

use planner::{PlannerParams, Router};
use std::sync::Arc;
use vehicle::FloorPlan;

/// A floor plan whose router is made when the first list comes: it takes as much memory as all the rest of the ground services, and
/// many flights are flown without a plan.
#[derive(Debug)]
pub struct Walls {
    plan: Arc<FloorPlan>,
    radius_m: f64,
    router: Option<Router>,
}

impl Walls {
    /// The walls of a floor plan for a vehicle of this radius, m.
    #[must_use]
    pub const fn new(plan: Arc<FloorPlan>, radius_m: f64) -> Self {
        Self {
            plan,
            radius_m,
            router: None,
        }
    }

    /// The router, by the parameters as they stand now.
    pub(super) fn router(&mut self, params: &PlannerParams) -> &mut Router {
        let router = self
            .router
            .get_or_insert_with(|| Router::new(Arc::clone(&self.plan), self.radius_m, params));
        router.set_params(params);
        router
    }
}
