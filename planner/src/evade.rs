//! Where to step aside when somebody comes: a search over places near the vehicle.
//!
//! For every candidate place the vehicle's motion towards it and the people's motion are predicted for a few seconds; the
//! place that keeps the clearance, stays nearest to where the vehicle wants to be, and changes the last decision least is
//! flown to. The place it wants to be is itself a candidate, so going back is the same decision.

use crate::tracks::Track;
use arrayvec::ArrayVec;
use nalgebra::Vector2;
use vehicle::Timestamp;

/// Prediction horizon and step, s.
const HORIZON_S: f64 = 3.0;
const STEP_S: f64 = 0.1;
/// The vehicle's answer to a velocity set point: dead time and lag, s; largest acceleration, m/s2.
const DEAD_TIME_S: f64 = 0.2;
const LAG_S: f64 = 0.3;
const ACCEL_MPS2: f64 = 2.0;
/// Whoever came into sight less than this long ago may be walking, s.
const NEW_S: f64 = 1.0;
/// Candidate places: on circles around the vehicle.
const DIRECTIONS: usize = 16;
const DISTANCES_M: [f64; 5] = [0.25, 0.5, 0.8, 1.1, 1.5];
/// Slower approach than this is no meeting, m/s.
const MEETING_MPS: f64 = 0.1;
/// People farther away than this are not looked at, m.
const CARE_M: f64 = 5.0;

/// Velocity that leads to a place, m/s: what both the prediction and the flight use.
#[must_use]
pub fn velocity_to(place: Vector2<f64>, from: Vector2<f64>, max_mps: f64) -> Vector2<f64> {
    let v = (place - from) * 1.8;
    let n = v.norm();
    if n > max_mps { v * (max_mps / n) } else { v }
}

/// What an evasion has to look at.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Now.
    pub now: Timestamp,
    /// Where the vehicle is, m on the plan.
    pub position: Vector2<f64>,
    /// Its velocity, m/s.
    pub velocity: Vector2<f64>,
    /// Where it wants to be, m on the plan.
    pub home: Vector2<f64>,
    /// Everybody.
    pub tracks: &'a [Track],
    /// Furniture counts too (hovering); on the way VFH+ sees to what stands.
    pub mind_standing: bool,
    /// Distance to keep between centres, m.
    pub keep_m: f64,
    /// Distance between centres that is never given up, m.
    pub least_m: f64,
    /// Largest speed of evasion, m/s.
    pub speed_mps: f64,
}

/// Chooses places to step aside to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evader {
    place: Option<Vector2<f64>>,
}

impl Evader {
    /// Where to go to keep clear; none if staying with what was wanted is clear enough. `is_open(from, to)` tells whether
    /// walls allow a straight move.
    pub fn choose(
        &mut self,
        scene: &Scene<'_>,
        is_open: impl Fn(Vector2<f64>, Vector2<f64>) -> bool,
    ) -> Option<Vector2<f64>> {
        let people = People::of(scene);
        if people.is_empty() {
            self.place = None;
            return None;
        }
        let last = self.place.unwrap_or(scene.home);
        let cost = |place: Vector2<f64>| {
            scene.danger(&people, place) + (place - scene.home).norm() + 0.4 * (place - last).norm()
        };
        let mut best = (scene.home, cost(scene.home));
        if best.1 < 0.05 {
            self.place = None;
            return None;
        }
        let mut consider = |place: Vector2<f64>| {
            // A cheap bound first: walls are only asked about places that would win.
            if (place - scene.home).norm() >= best.1 {
                return;
            }
            let c = cost(place);
            if c < best.1 && is_open(scene.position, place) {
                best = (place, c);
            }
        };
        consider(scene.position);
        if let Some(place) = self.place {
            consider(place);
        }
        for i in 0..DIRECTIONS {
            let a = core::f64::consts::TAU * i as f64 / DIRECTIONS as f64;
            let unit = Vector2::new(libm::cos(a), libm::sin(a));
            for d in DISTANCES_M {
                consider(scene.position + unit * d);
            }
        }
        self.place = ((best.0 - scene.home).norm() > 0.02).then_some(best.0);
        self.place
    }
}

/// Somebody's place and velocity now, and the distance to keep from them.
#[derive(Clone, Copy, Debug)]
struct Person {
    place: Vector2<f64>,
    velocity: Vector2<f64>,
    keep_m: f64,
}

/// Everybody who matters.
struct People {
    all: ArrayVec<Person, { crate::tracks::TRACKS_MAX }>,
}

impl People {
    fn of(scene: &Scene<'_>) -> Self {
        let all = scene
            .tracks
            .iter()
            .filter(|t| t.is_confirmed() && (scene.mind_standing || scene.is_met_by(t)))
            .map(|t| Person {
                place: t.position_at(scene.now),
                velocity: t.significant_velocity(),
                // What has never walked is furniture: it will not take a step. What has just come into sight may.
                keep_m: if t.has_walked() || t.is_newer_than(scene.now, NEW_S) {
                    scene.keep_m
                } else {
                    scene.least_m
                },
            })
            .filter(|p| (p.place - scene.position).norm() < CARE_M)
            .collect();
        Self { all }
    }

    fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// What is lacking to the distances to keep at a place at a time, m.
    fn lacking_m(&self, place: Vector2<f64>, after_s: f64) -> f64 {
        self.all.iter().fold(0.0, |worst, p| {
            let distance = (p.place + p.velocity * after_s - place).norm();
            worst.max(p.keep_m - distance)
        })
    }
}

impl Scene<'_> {
    /// True if somebody walks towards the vehicle and comes closer. A wall beside which the vehicle flies looks to a single
    /// beam like somebody walking along, but it never does both.
    fn is_met_by(&self, t: &Track) -> bool {
        let to = t.position_at(self.now) - self.position;
        let unit = to / to.norm().max(1e-6);
        let approaching = -t.velocity.dot(&unit);
        let closing = approaching + self.velocity.dot(&unit);
        t.is_moving() && approaching > MEETING_MPS && closing > MEETING_MPS
    }

    /// How much too close the vehicle comes to anybody on its way to a place, as a cost.
    fn danger(&self, people: &People, place: Vector2<f64>) -> f64 {
        let (mut p, mut v) = (self.position, self.velocity);
        let slack = self.keep_m - self.least_m;
        let (mut sum, mut worst) = (0.0, 0.0f64);
        let mut t = 0.0;
        while t < HORIZON_S {
            let lacking = people.lacking_m(p, t);
            worst = worst.max(lacking);
            sum += lacking * lacking;
            let wanted = if t < DEAD_TIME_S {
                v
            } else {
                velocity_to(place, p, self.speed_mps)
            };
            let mut a = (wanted - v) / LAG_S;
            let n = a.norm();
            if n > ACCEL_MPS2 {
                a *= ACCEL_MPS2 / n;
            }
            v += a * STEP_S;
            p += v * STEP_S;
            t += STEP_S;
        }
        // The worst moment decides; once close already, how long it lasts.
        let forbidden = (worst - slack).max(0.0);
        40.0 * worst * worst + 2.0 * worst + 100.0 * forbidden + 40.0 * sum * STEP_S
    }
}
