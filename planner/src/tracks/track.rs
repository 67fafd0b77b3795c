//! Somebody: a disc that moves steadily, corrected by what is seen of its outline.

use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};
use vehicle::Timestamp;

/// A track that is not seen is kept this long, s.
const COAST_S: f64 = 2.0;
/// Seen well so lately, somebody is where they are believed to be, s.
const IN_SIGHT_S: f64 = 0.5;
/// Rays through its place that often prove that nobody is there.
const SEEN_THROUGH_MAX: u8 = 3;
/// Random acceleration of people, m/s2 per sqrt(Hz).
const WALK_MPS2: f64 = 0.6;
/// Uncertainty of a new track: place (m) and walking speed (m/s).
const NEW_STD: (f64, f64) = (0.15, 0.7);
/// The last five scans.
const RECENT: u8 = 0b1_1111;
/// Faster than this is no person but noise, m/s.
const FASTEST_MPS: f64 = 2.0;
/// A track that does not count yet is dropped when it was not seen for this long, s: two scans; two firings of a slow cone.
const TENTATIVE_S: f64 = 0.25;
const TENTATIVE_WIDE_S: f64 = 0.7;
/// Slower than this is furniture, m/s.
const MOVING_MPS: f64 = 0.25;

/// Somebody.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// Centre at `at`, m on the plan.
    pub position: Vector2<f64>,
    /// m/s on the plan.
    pub velocity: Vector2<f64>,
    /// When position and velocity are true.
    pub(super) at: Timestamp,
    pub(super) first_seen: Timestamp,
    pub(super) first_place: Vector2<f64>,
    pub(super) last_seen: Timestamp,
    /// When enough of the outline was seen to be a person.
    pub(super) last_seen_well: Timestamp,
    /// The last scans that looked there, newest in the lowest bit: seen well or not.
    pub(super) history: u8,
    pub(super) needed: u32,
    pub(super) is_wide: bool,
    pub(super) is_confirmed: bool,
    pub(super) seen_through: u8,
    pub(super) has_walked: bool,
    /// Covariance of position and velocity.
    pub(super) p: Matrix4<f64>,
}

impl Track {
    pub(super) fn new(at: Timestamp, centre: Vector2<f64>, is_wide: bool, needed: u32) -> Self {
        let (place, speed) = NEW_STD;
        Self {
            position: centre,
            velocity: Vector2::zeros(),
            at,
            first_seen: at,
            first_place: centre,
            last_seen: at,
            last_seen_well: at,
            history: 0,
            needed,
            is_wide,
            is_confirmed: false,
            seen_through: 0,
            has_walked: false,
            p: Matrix4::from_diagonal(&Vector4::new(
                place * place,
                place * place,
                speed * speed,
                speed * speed,
            )),
        }
    }

    /// Seen often enough to be somebody.
    #[must_use]
    pub const fn is_confirmed(&self) -> bool {
        self.is_confirmed
    }

    /// Somebody walking: moving significantly.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        let speed = self.velocity.norm();
        self.is_confirmed() && speed > MOVING_MPS && speed > 2.0 * self.speed_std_mps()
    }

    /// First seen less than this many seconds ago.
    #[must_use]
    pub fn is_newer_than(&self, now: Timestamp, seconds: f64) -> bool {
        now.seconds_since(self.first_seen) < seconds
    }

    /// Seen well not long ago: worth looking at. Where somebody is believed to be but is not seen, nobody may be.
    #[must_use]
    pub fn is_in_sight(&self, now: Timestamp) -> bool {
        now.seconds_since(self.last_seen_well) < IN_SIGHT_S
    }

    /// Has been moving at some time: a person, even while standing.
    #[must_use]
    pub const fn has_walked(&self) -> bool {
        self.has_walked
    }

    /// The velocity, less the more of it could be noise, m/s.
    #[must_use]
    pub fn significant_velocity(&self) -> Vector2<f64> {
        let ratio = self.velocity.norm() / self.speed_std_mps().max(1e-6);
        self.velocity * (ratio - 0.5).clamp(0.0, 1.0)
    }

    /// Centre at a later time, m on the plan.
    #[must_use]
    pub fn position_at(&self, t: Timestamp) -> Vector2<f64> {
        self.position + self.velocity * t.seconds_since(self.at).clamp(0.0, 5.0)
    }

    /// A scan has looked there.
    pub(super) fn note(&mut self, at: Timestamp, seen_well: bool) {
        if seen_well {
            self.last_seen_well = at;
        }
        self.history = self.history << 1 | u8::from(seen_well);
        let often = (self.history & RECENT).count_ones() >= self.needed;
        self.is_confirmed |= often && self.velocity.norm() <= FASTEST_MPS;
    }

    pub(super) fn lasts(&self, at: Timestamp) -> bool {
        let unseen_s = at.seconds_since(if self.is_confirmed {
            self.last_seen_well
        } else {
            self.last_seen
        });
        let for_s = if self.is_confirmed {
            COAST_S
        } else if self.is_wide {
            TENTATIVE_WIDE_S
        } else {
            TENTATIVE_S
        };
        let through_max = if self.is_confirmed {
            SEEN_THROUGH_MAX
        } else {
            SEEN_THROUGH_MAX - 1
        };
        self.seen_through < through_max && unseen_s < for_s
    }

    pub(super) fn predict(&mut self, t: Timestamp) {
        let dt = t.seconds_since(self.at).clamp(0.0, 1.0);
        self.position += self.velocity * dt;
        let mut f = Matrix4::identity();
        (f[(0, 2)], f[(1, 3)]) = (dt, dt);
        let q = WALK_MPS2 * WALK_MPS2 * dt;
        self.p = f * self.p * f.transpose();
        for axis in 0..2 {
            self.p[(axis, axis)] += q * dt * dt / 3.0;
            self.p[(axis, axis + 2)] += 0.5 * q * dt;
            self.p[(axis + 2, axis)] += 0.5 * q * dt;
            self.p[(axis + 2, axis + 2)] += q;
        }
        self.at = t;
    }

    /// Moves the centre by a measured length along a direction.
    pub(super) fn correct(&mut self, unit: Vector2<f64>, by_m: f64, sigma_m: f64) {
        let h = Vector4::new(unit.x, unit.y, 0.0, 0.0);
        let ph = self.p * h;
        let s = h.dot(&ph) + sigma_m * sigma_m;
        let k = ph / s;
        self.position += Vector2::new(k.x, k.y) * by_m;
        self.velocity += Vector2::new(k.z, k.w) * by_m;
        self.p -= k * ph.transpose();
        self.p = (self.p + self.p.transpose()) * 0.5;
    }

    /// A return lies on the outline.
    pub(super) fn touch(
        &mut self,
        p: Vector2<f64>,
        eye: Vector2<f64>,
        radius_m: f64,
        sigma_m: f64,
    ) {
        let from_centre = p - self.position;
        let d = from_centre.norm();
        // The near side is what is seen: a centre in front of its own outline would be pulled the wrong way.
        let seen_from = (eye - p).normalize();
        let unit = if d > 0.05 && from_centre.dot(&seen_from) > 0.0 {
            from_centre / d
        } else {
            seen_from
        };
        let along = from_centre.dot(&unit);
        self.correct(unit, along - radius_m, sigma_m);
    }

    pub(super) fn speed_std_mps(&self) -> f64 {
        libm::sqrt(0.5 * (self.p[(2, 2)] + self.p[(3, 3)]))
    }

    pub(super) fn place_std_m(&self) -> f64 {
        let place: Matrix2<f64> = self.p.fixed_view::<2, 2>(0, 0).into();
        libm::sqrt(0.5 * place.trace())
    }
}
