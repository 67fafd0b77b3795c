//! What `Flight` thinks, for people who watch: particles, histogram, the way ahead. Too coarse to fly by, too much for a
//! [`Snapshot`](super::door::Snapshot) of every tick.

use super::flight::Flight;
use arrayvec::ArrayVec;
use planner::route::MAX_CORNERS;
use planner::vfh::SECTORS;
use vehicle::{In, Map, Ned};

/// Most particles shown.
pub const MAX_SHOWN: usize = 500;
/// Most people shown.
pub const MAX_PEOPLE: usize = 8;

/// A look into the estimator and the planner.
#[derive(Clone, Debug, PartialEq)]
pub struct Insight {
    /// Particles, thinned out to [`MAX_SHOWN`]: plan x m, plan y m, plan yaw rad.
    pub particles: Vec<[f32; 3]>,
    /// Polar obstacle density, sectors of 5 degrees counter-clockwise from plan x.
    pub density: [f32; SECTORS],
    /// Sectors that count as blocked.
    pub blocked: [bool; SECTORS],
    /// Density above which a sector becomes blocked.
    pub threshold: f32,
    /// Direction chosen, rad counter-clockwise from plan x.
    pub chosen_rad: Option<f64>,
    /// Corners of the way.
    pub route: ArrayVec<In<Ned>, MAX_CORNERS>,
    /// Where it flies to.
    pub goal: Option<In<Ned>>,
    /// People seen: plan x, y m, velocity m/s.
    pub people: ArrayVec<[f32; 4], MAX_PEOPLE>,
}

impl Default for Insight {
    fn default() -> Self {
        Self {
            particles: Vec::with_capacity(MAX_SHOWN),
            density: [0.0; SECTORS],
            blocked: [false; SECTORS],
            threshold: 0.0,
            chosen_rad: None,
            route: ArrayVec::new(),
            goal: None,
            people: ArrayVec::new(),
        }
    }
}

impl Insight {
    /// A copy into the room that is there already.
    pub fn copy_from(&mut self, other: &Self) {
        self.particles.clone_from(&other.particles);
        self.route.clear();
        self.route.extend(other.route.iter().copied());
        self.people.clear();
        self.people.extend(other.people.iter().copied());
        (self.density, self.blocked) = (other.density, other.blocked);
        (self.threshold, self.chosen_rad, self.goal) =
            (other.threshold, other.chosen_rad, other.goal);
    }

    /// Looks. Allocates nothing.
    pub fn look(&mut self, flight: &Flight) {
        self.particles.clear();
        if let Some(particles) = flight.estimator().particles() {
            let stride = particles.len().div_ceil(MAX_SHOWN).max(1);
            let shown = particles.iter().step_by(stride).take(MAX_SHOWN);
            self.particles
                .extend(shown.map(|(p, _)| [p.x_m as f32, p.y_m as f32, p.yaw_rad as f32]));
        }
        let navigator = flight.navigator();
        (self.density, self.blocked) = (
            *navigator.histogram().density(),
            *navigator.histogram().blocked(),
        );
        self.threshold = flight.settings().vfh.threshold as f32;
        self.chosen_rad = navigator.chosen_rad();
        self.route.clear();
        self.route.extend(navigator.route().iter().copied());
        self.goal = navigator.goal().map(|g| g.position);
        self.people.clear();
        for track in navigator.tracker().tracks() {
            if track.is_confirmed() && !self.people.is_full() {
                let p = In::<Map>::new(track.position.x, track.position.y, 0.0);
                self.people.push([
                    p.x() as f32,
                    p.y() as f32,
                    track.velocity.x as f32,
                    track.velocity.y as f32,
                ]);
            }
        }
    }
}
