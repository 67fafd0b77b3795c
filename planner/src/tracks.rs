//! People: clusters of returns that the plan does not explain, followed with their velocity.
//!
//! Each scan's unexplained returns are grouped; a group updates the track it falls near or begins a new one. A track is a
//! disc of a person's radius moving steadily (Kalman filter of position and velocity); every return says that its outline
//! passes there, every ray that goes past says that it does not reach so far. Seeing only one shoulder between two gaps of
//! the ring therefore does not move the person sideways. A track that is not seen coasts for two seconds.

use arrayvec::ArrayVec;
use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};
use vehicle::Timestamp;
use vehicle::sample::MAX_BEAMS;

/// Most people followed at once.
pub const TRACKS_MAX: usize = 8;
/// Returns nearer to each other than this belong together, m.
const GROUP_GAP_M: f64 = 0.35;
/// Groups wider than this are walls or furniture, m.
const GROUP_WIDTH_M: f64 = 0.8;
/// A group belongs to a track within this distance of its prediction, m.
const GATE_M: f64 = 0.6;
/// A track that is not seen is kept this long, s.
const COAST_S: f64 = 2.0;
/// Rays through its place that often prove that nobody is there.
const SEEN_THROUGH_MAX: u8 = 3;
/// Random acceleration of people, m/s2 per sqrt(Hz).
const WALK_MPS2: f64 = 0.6;
/// How well a return lies on the outline: ranging noise, a body that is not round, m.
const OUTLINE_STD_M: f64 = 0.07;
/// How well a ray that goes past bounds the body, m.
const PAST_STD_M: f64 = 0.2;
/// How far a ray may cut into the believed outline without proving anything, m.
const PAST_SLACK_M: f64 = 0.08;
/// Somebody who has come this far has walked, m: more than furniture seems to move when it is seen from another side.
const WALKED_M: f64 = 0.6;
/// Uncertainty of a new track: place (m) and walking speed (m/s).
const NEW_STD: (f64, f64) = (0.15, 0.7);
/// A track counts once it was seen so often and for so long.
const CONFIRM_HITS: u32 = 4;
const CONFIRM_S: f64 = 0.2;
/// Slower than this is furniture, m/s.
const MOVING_MPS: f64 = 0.25;

/// One ray of a scan on the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts, m on the plan.
    pub from: Vector2<f64>,
    /// Where it ends: at the return or where sight ends.
    pub to: Vector2<f64>,
    /// It ends at something that the plan does not explain.
    pub unexplained: bool,
    /// A wide cone: where on its front the return came from is not known.
    pub is_wide: bool,
}

/// The rays of one scan.
pub type Rays = ArrayVec<Ray, MAX_BEAMS>;

/// Somebody.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// Centre at `at`, m on the plan.
    pub position: Vector2<f64>,
    /// m/s on the plan.
    pub velocity: Vector2<f64>,
    /// When position and velocity are true.
    at: Timestamp,
    first_seen: Timestamp,
    first_place: Vector2<f64>,
    last_seen: Timestamp,
    hits: u32,
    seen_through: u8,
    has_walked: bool,
    /// Covariance of position and velocity.
    p: Matrix4<f64>,
}

impl Track {
    fn new(at: Timestamp, centre: Vector2<f64>) -> Self {
        let (place, speed) = NEW_STD;
        Self {
            position: centre,
            velocity: Vector2::zeros(),
            at,
            first_seen: at,
            first_place: centre,
            last_seen: at,
            hits: 0,
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
    pub fn is_confirmed(&self) -> bool {
        self.hits >= CONFIRM_HITS && self.last_seen.seconds_since(self.first_seen) >= CONFIRM_S
    }

    /// Somebody walking: moving significantly.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        let speed = self.velocity.norm();
        self.is_confirmed() && speed > MOVING_MPS && speed > 1.5 * self.speed_std_mps()
    }

    /// First seen less than this many seconds ago.
    #[must_use]
    pub fn is_newer_than(&self, now: Timestamp, seconds: f64) -> bool {
        now.seconds_since(self.first_seen) < seconds
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

    fn predict(&mut self, t: Timestamp) {
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
    fn correct(&mut self, unit: Vector2<f64>, by_m: f64, sigma_m: f64) {
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
    fn touch(&mut self, p: Vector2<f64>, eye: Vector2<f64>, radius_m: f64, sigma_m: f64) {
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

    fn speed_std_mps(&self) -> f64 {
        libm::sqrt(0.5 * (self.p[(2, 2)] + self.p[(3, 3)]))
    }

    fn place_std_m(&self) -> f64 {
        let place: Matrix2<f64> = self.p.fixed_view::<2, 2>(0, 0).into();
        libm::sqrt(0.5 * place.trace())
    }
}

/// Follows people.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    tracks: ArrayVec<Track, TRACKS_MAX>,
}

impl Tracker {
    /// Everybody followed, confirmed or not.
    #[must_use]
    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// Forgets everybody (the pose has jumped).
    pub fn clear(&mut self) {
        self.tracks.clear();
    }

    /// Takes in the rays of one scan, seen from `eye`.
    pub fn observe(&mut self, at: Timestamp, eye: Vector2<f64>, rays: &Rays, person_radius_m: f64) {
        for t in &mut self.tracks {
            t.predict(at);
        }
        let mut updated = [false; TRACKS_MAX];
        for group in groups(rays) {
            if group.width_m() > GROUP_WIDTH_M {
                continue;
            }
            let face = group.mean();
            let outward = (face - eye) / (face - eye).norm().max(1e-6);
            // Only the near side of a round body is seen; its centre is most of a radius farther.
            let centre = face + outward * (0.8 * person_radius_m);
            let nearest = self
                .tracks
                .iter()
                .enumerate()
                .map(|(i, t)| (i, (t.position - centre).norm() - t.place_std_m()))
                .filter(|(_, d)| *d < GATE_M)
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let i = match nearest {
                Some((i, _)) => i,
                None if self.tracks.is_full() => continue,
                None => {
                    self.tracks.push(Track::new(at, centre));
                    self.tracks.len() - 1
                }
            };
            let track = &mut self.tracks[i];
            // The returns of one group share most of their error.
            let sigma_m = OUTLINE_STD_M * libm::sqrt(group.count);
            for ray in rays.iter().filter(|r| r.unexplained && group.holds(r.to)) {
                track.touch(ray.to, eye, person_radius_m, sigma_m);
            }
            if !updated[i] {
                updated[i] = true;
                (track.hits, track.last_seen, track.seen_through) = (track.hits + 1, at, 0);
                track.has_walked |=
                    track.is_moving() || (track.position - track.first_place).norm() > WALKED_M;
            }
        }
        for (t, updated) in self.tracks.iter_mut().zip(updated) {
            if !updated && rays.iter().any(|r| passes_through(r, t.position)) {
                t.seen_through += 1;
                continue;
            }
            // The rays of a scan share their error: the clearest one speaks for all.
            let past = rays
                .iter()
                .filter_map(|r| goes_past(r, t.position, person_radius_m - PAST_SLACK_M))
                .max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((away, lacking_m)) = past {
                t.correct(away, lacking_m, PAST_STD_M);
            }
        }
        self.tracks.retain(|t| {
            t.seen_through < SEEN_THROUGH_MAX && at.seconds_since(t.last_seen) < COAST_S
        });
    }
}

/// The way out (unit) and the length by which a disc must move so that a ray can go past it; none if it does already.
fn goes_past(ray: &Ray, place: Vector2<f64>, radius_m: f64) -> Option<(Vector2<f64>, f64)> {
    let along = ray.to - ray.from;
    let length = along.norm();
    if length < 1e-6 {
        return None;
    }
    let unit = along / length;
    let to = place - ray.from;
    let (forward, aside) = (to.dot(&unit), unit.perp(&to));
    let past = forward > 0.0 && forward + radius_m < length && aside.abs() < radius_m;
    let left = Vector2::new(-unit.y, unit.x);
    past.then(|| (left * libm::copysign(1.0, aside), radius_m - aside.abs()))
}

fn passes_through(ray: &Ray, place: Vector2<f64>) -> bool {
    let along = ray.to - ray.from;
    let length = along.norm();
    if length < 1e-6 {
        return false;
    }
    let unit = along / length;
    let to = place - ray.from;
    to.perp(&unit).abs() < 0.12 && to.dot(&unit) > 0.0 && to.dot(&unit) + 0.3 < length
}

#[derive(Clone, Copy, Debug)]
struct Group {
    sum: Vector2<f64>,
    low: Vector2<f64>,
    high: Vector2<f64>,
    count: f64,
    last: Vector2<f64>,
}

impl Group {
    const fn of(p: Vector2<f64>) -> Self {
        Self {
            sum: p,
            low: p,
            high: p,
            count: 1.0,
            last: p,
        }
    }

    fn add(&mut self, p: Vector2<f64>) {
        self.sum += p;
        self.low = self.low.inf(&p);
        self.high = self.high.sup(&p);
        self.count += 1.0;
        self.last = p;
    }

    /// True if a return is part of the group (groups do not overlap).
    fn holds(&self, p: Vector2<f64>) -> bool {
        let inside = |v: f64, low: f64, high: f64| v >= low - 1e-9 && v <= high + 1e-9;
        inside(p.x, self.low.x, self.high.x) && inside(p.y, self.low.y, self.high.y)
    }

    fn mean(&self) -> Vector2<f64> {
        self.sum / self.count
    }

    fn width_m(&self) -> f64 {
        (self.high - self.low).norm()
    }
}

fn groups(rays: &Rays) -> ArrayVec<Group, MAX_BEAMS> {
    let mut out: ArrayVec<Group, MAX_BEAMS> = ArrayVec::new();
    for ray in rays.iter().filter(|r| r.unexplained) {
        match out
            .iter_mut()
            .find(|g| (g.last - ray.to).norm() < GROUP_GAP_M)
        {
            Some(g) => g.add(ray.to),
            None => out.push(Group::of(ray.to)),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(x: f64, y: f64) -> Ray {
        Ray {
            from: Vector2::zeros(),
            to: Vector2::new(x, y),
            unexplained: true,
            is_wide: false,
        }
    }

    #[test]
    fn somebody_walking_is_followed_with_their_velocity() {
        let mut tracker = Tracker::default();
        let mut t = Timestamp::ZERO;
        for i in 0..15 {
            t = Timestamp::from_ms(67 * i);
            let x = 3.0 - 0.8 * t.s();
            // Three columns on the near side of a person.
            let rays: Rays = [ray(x, -0.15), ray(x - 0.05, 0.0), ray(x, 0.15)]
                .into_iter()
                .collect();
            tracker.observe(t, Vector2::zeros(), &rays, 0.25);
        }
        let [somebody] = tracker.tracks() else {
            panic!("{:?}", tracker.tracks())
        };
        assert!(somebody.is_moving());
        assert!(
            (somebody.velocity - Vector2::new(-0.8, 0.0)).norm() < 0.15,
            "{somebody:?}"
        );
        let later = Timestamp::from_us(t.us() + 500_000);
        let true_x = 3.2 - 0.8 * later.s();
        assert!((somebody.position_at(later) - Vector2::new(true_x, 0.0)).norm() < 0.15);
    }

    #[test]
    fn a_chair_is_not_moving_and_a_wall_is_nobody() {
        let mut tracker = Tracker::default();
        for i in 0..30u64 {
            let wobble = if i % 2 == 0 { 0.03 } else { -0.03 };
            let mut rays: Rays = [ray(2.0 + wobble, 0.0), ray(2.0 - wobble, 0.2)]
                .into_iter()
                .collect();
            for k in 0..8 {
                rays.push(ray(-2.0, -1.0 + 0.25 * f64::from(k)));
            }
            tracker.observe(Timestamp::from_ms(67 * i), Vector2::zeros(), &rays, 0.25);
        }
        let [chair] = tracker.tracks() else {
            panic!("{:?}", tracker.tracks())
        };
        assert!(chair.is_confirmed() && !chair.is_moving());
    }

    #[test]
    fn nobody_is_kept_where_a_ray_passes() {
        let mut tracker = Tracker::default();
        let near: Rays = [ray(1.0, 0.0)].into_iter().collect();
        let through: Rays = [Ray {
            unexplained: false,
            ..ray(3.0, 0.0)
        }]
        .into_iter()
        .collect();
        for i in 0..6 {
            tracker.observe(Timestamp::from_ms(67 * i), Vector2::zeros(), &near, 0.25);
        }
        assert_eq!(tracker.tracks().len(), 1);
        for i in 6..10 {
            tracker.observe(Timestamp::from_ms(67 * i), Vector2::zeros(), &through, 0.25);
        }
        assert!(tracker.tracks().is_empty());
    }
}
