//! People: clusters of returns that the plan does not explain, followed with their velocity.
//!
//! Each scan's unexplained returns are grouped; a group updates the track it falls near or begins a new one. A track is a
//! disc of a person's radius moving steadily (Kalman filter of position and velocity); every return says that its outline
//! passes there, every ray that goes past says that it does not reach so far. Seeing only one shoulder between two gaps of
//! the ring therefore does not move the person sideways. A track that is not seen coasts for two seconds.
//!
//! Multizone rangers read short in one of ten columns beyond a metre, so one return is no evidence. A group counts when
//! it fills most of the columns that a person would fill at that range; a track counts when such groups were there in
//! three of the last five scans that looked, at places a walking person can connect.

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
/// Seen well so lately, somebody is where they are believed to be, s.
const IN_SIGHT_S: f64 = 0.5;
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
/// A track counts once it was seen well in so many of the last five scans that looked there: by three columns or more,
/// and by fewer or by wide cones, which say less.
const CONFIRM_HITS: u32 = 3;
const CONFIRM_HITS_THIN: u32 = 4;
/// The same for returns so near that no short reading of the wall behind explains them: those lose up to half of the way
/// and a little more.
const CONFIRM_HITS_NEAR: u32 = 2;
const SHORT_SHARE: f64 = 0.5;
const SHORT_M: f64 = 0.2;
const RECENT: u8 = 0b1_1111;
/// Faster than this is no person but noise, m/s.
const FASTEST_MPS: f64 = 2.0;
/// A track that does not count yet is dropped when it was not seen for this long, s: two scans; two firings of a slow cone.
const TENTATIVE_S: f64 = 0.25;
const TENTATIVE_WIDE_S: f64 = 0.7;
/// A track that does not count yet is only continued this near, m: a walker's way between two scans and the noise. A
/// group too thin for a person continues any track only this near.
const TENTATIVE_GATE_M: f64 = 0.3;
/// Columns on somebody's near side differ by less than this in range, m; two short readings seldom agree so well.
const FACE_DEPTH_M: f64 = 0.15;
/// Share of the columns a person fills that must see them.
const FILLED: f64 = 0.6;
/// Columns of one sensor lie at most this many spacings apart.
const NEIGHBOUR: f64 = 1.6;
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
    /// How far the plan leaves the way open in its direction, m.
    pub open_m: f64,
    /// Half the opening angle of its cone, rad; columns of a multizone ranger lie two of these apart.
    pub half_cone_rad: f64,
}

/// Cones wider than this (half, rad) do not tell where on their front a return came from.
pub(crate) const WIDE_RAD: f64 = 0.06;

impl Ray {
    /// A wide cone: where on its front the return came from is not known.
    #[must_use]
    pub fn is_wide(&self) -> bool {
        self.half_cone_rad > WIDE_RAD
    }

    fn length_m(&self) -> f64 {
        (self.to - self.from).norm()
    }

    /// A return so near that no short reading of the wall behind explains it.
    fn is_beyond_doubt(&self) -> bool {
        self.length_m() < SHORT_SHARE * self.open_m - SHORT_M
    }

    /// True if another ray is the next column of the same sensor (or the one after a column that failed).
    fn is_beside(&self, other: &Self) -> bool {
        let (a, b) = (self.to - self.from, other.to - other.from);
        let (cross, dot) = (a.perp(&b), a.dot(&b));
        libm::atan2(cross.abs(), dot) < NEIGHBOUR * 2.0 * self.half_cone_rad
    }
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
    /// When enough of the outline was seen to be a person.
    last_seen_well: Timestamp,
    /// The last scans that looked there, newest in the lowest bit: seen well or not.
    history: u8,
    needed: u32,
    is_wide: bool,
    is_confirmed: bool,
    seen_through: u8,
    has_walked: bool,
    /// Covariance of position and velocity.
    p: Matrix4<f64>,
}

impl Track {
    fn new(at: Timestamp, centre: Vector2<f64>, is_wide: bool, needed: u32) -> Self {
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
    fn note(&mut self, at: Timestamp, seen_well: bool) {
        if seen_well {
            self.last_seen_well = at;
        }
        self.history = self.history << 1 | u8::from(seen_well);
        let often = (self.history & RECENT).count_ones() >= self.needed;
        self.is_confirmed |= often && self.velocity.norm() <= FASTEST_MPS;
    }

    fn lasts(&self, at: Timestamp) -> bool {
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
    last_alarm: Option<Timestamp>,
}

impl Tracker {
    /// Everybody followed, confirmed or not.
    #[must_use]
    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// When somebody was last found or seen walking.
    #[must_use]
    pub const fn last_alarm(&self) -> Option<Timestamp> {
        self.last_alarm
    }

    /// Forgets everybody (the pose has jumped).
    pub fn clear(&mut self) {
        self.last_alarm = None;
        self.tracks.clear();
    }

    /// Takes in the rays of one scan, seen from `eye`.
    pub fn observe(&mut self, at: Timestamp, eye: Vector2<f64>, rays: &Rays, person_radius_m: f64) {
        for t in &mut self.tracks {
            t.predict(at);
        }
        let mut updated = [false; TRACKS_MAX];
        let mut found = groups(rays);
        // Who is seen best speaks first.
        found.sort_unstable_by(|a, b| b.count.total_cmp(&a.count));
        for group in found {
            if group.width_m() > GROUP_WIDTH_M {
                continue;
            }
            let is_wide = rays[group.first].is_wide();
            let face = group.face(rays);
            let centre = group.centre(eye, rays, person_radius_m);
            let is_strong =
                group.fills_a_person(rays, &face, (centre - eye).norm(), person_radius_m);
            let needed = match (face.is_beyond_doubt, is_wide || face.columns < 3) {
                (true, _) => CONFIRM_HITS_NEAR,
                (false, true) => CONFIRM_HITS_THIN,
                (false, false) => CONFIRM_HITS,
            };
            let gate_m = |t: &Track| {
                if is_strong && t.is_confirmed {
                    GATE_M + t.place_std_m().min(0.2)
                } else {
                    TENTATIVE_GATE_M
                }
            };
            let nearest = self
                .tracks
                .iter()
                .enumerate()
                .map(|(i, t)| (i, (t.position - centre).norm(), gate_m(t)))
                .filter(|(_, d, gate_m)| d < gate_m)
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let i = match nearest {
                // Thin evidence follows somebody already known; it makes nobody.
                Some((i, ..)) if is_strong || self.tracks[i].is_confirmed => i,
                Some(_) => continue,
                None if self.tracks.is_full() || !is_strong => continue,
                None => {
                    self.tracks.push(Track::new(at, centre, is_wide, needed));
                    self.tracks.len() - 1
                }
            };
            let track = &mut self.tracks[i];
            if is_strong {
                track.needed = track.needed.min(needed);
            }
            // The returns of one group share most of their error.
            let sigma_m = OUTLINE_STD_M * libm::sqrt(face.columns as f64);
            for ray in group.members(rays).filter(|r| face.holds(r)) {
                track.touch(ray.to, eye, person_radius_m, sigma_m);
            }
            if !updated[i] {
                updated[i] = true;
                let was_confirmed = track.is_confirmed;
                (track.last_seen, track.seen_through) = (at, 0);
                track.note(at, is_strong);
                track.has_walked |= track.is_confirmed
                    && is_strong
                    && (track.is_moving()
                        || (track.position - track.first_place).norm() > WALKED_M);
                if track.is_moving() || track.is_confirmed != was_confirmed {
                    self.last_alarm = Some(at);
                }
            }
        }
        for (t, updated) in self.tracks.iter_mut().zip(updated) {
            if !updated && rays.iter().any(|r| passes_through(r, t.position)) {
                t.seen_through += 1;
                t.note(at, false);
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
        self.tracks.retain(|t| t.lasts(at));
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

/// Returns of a group that agree in range.
#[derive(Clone, Copy, Debug)]
struct Face {
    near_m: f64,
    columns: usize,
    is_beyond_doubt: bool,
}

impl Face {
    fn holds(&self, ray: &Ray) -> bool {
        (self.near_m..self.near_m + FACE_DEPTH_M).contains(&ray.length_m())
    }
}

#[derive(Clone, Copy, Debug)]
struct Group {
    sum: Vector2<f64>,
    low: Vector2<f64>,
    high: Vector2<f64>,
    count: f64,
    last: Vector2<f64>,
    /// First and last ray, by number in the scan.
    first: usize,
    end: usize,
}

impl Group {
    const fn of(i: usize, p: Vector2<f64>) -> Self {
        Self {
            first: i,
            end: i,
            sum: p,
            low: p,
            high: p,
            count: 1.0,
            last: p,
        }
    }

    /// The group's returns.
    fn members<'a>(&'a self, rays: &'a Rays) -> impl Iterator<Item = &'a Ray> {
        rays[self.first..=self.end]
            .iter()
            .filter(|r| r.unexplained && self.holds(r.to))
    }

    /// The most of the group's returns that agree in range: they could lie on one near side.
    fn face(&self, rays: &Rays) -> Face {
        let from = |near_m: f64| {
            let empty = Face {
                near_m,
                columns: 0,
                is_beyond_doubt: true,
            };
            let inside = self.members(rays).filter(|r| empty.holds(r));
            inside.fold(empty, |face, ray| Face {
                columns: face.columns + 1,
                is_beyond_doubt: face.is_beyond_doubt && ray.is_beyond_doubt(),
                ..face
            })
        };
        self.members(rays)
            .map(|r| from(r.length_m()))
            .max_by_key(|f| f.columns)
            .unwrap_or_else(|| from(0.0))
    }

    /// Whether the columns next to the group, before and after it, exist.
    fn neighbours(&self, rays: &Rays) -> (bool, bool) {
        let (first, end) = (&rays[self.first], &rays[self.end]);
        let before = self.first > 0 && first.is_beside(&rays[self.first - 1]);
        let after = rays.get(self.end + 1).is_some_and(|r| end.is_beside(r));
        (before, after)
    }

    /// Centre of the person whose near side this is. At the edge of a sensor's field only a shoulder is seen: the ray that
    /// goes past it on the one side touches the body there, and the rest is in the gap on the other.
    fn centre(&self, eye: Vector2<f64>, rays: &Rays, radius_m: f64) -> Vector2<f64> {
        let face = self.mean();
        // Only the near side of a round body is seen; its centre is most of a radius farther.
        let outward = (face - eye) / (face - eye).norm().max(1e-6);
        let middle = face + outward * (0.8 * radius_m);
        let (past, shoulder, inner) = match self.neighbours(rays) {
            (true, false) => (self.first - 1, self.first, self.end),
            (false, true) => (self.end + 1, self.end, self.first),
            _ => return middle,
        };
        let direction = |r: &Ray| (r.to - r.from) / r.length_m().max(1e-6);
        let tangent = (direction(&rays[past]) + direction(&rays[shoulder])).normalize();
        let hit = rays[inner].to - eye;
        let side = libm::copysign(1.0, tangent.perp(&direction(&rays[shoulder])));
        let normal = Vector2::new(-tangent.y, tangent.x) * side;
        let (along, aside) = (hit.dot(&tangent), hit.dot(&normal));
        if !(0.0..radius_m).contains(&aside) {
            return middle;
        }
        // The circle touches the tangent and passes through the innermost return.
        let behind = libm::sqrt(radius_m * radius_m - (radius_m - aside) * (radius_m - aside));
        eye + tangent * (along + behind) + normal * radius_m
    }

    /// True if the group fills most of the columns that a person would fill there. At the edge of a sensor's field, where
    /// only a part can be seen, two columns do, or one beyond doubt; a ranger with a single beam has nothing better.
    fn fills_a_person(&self, rays: &Rays, face: &Face, distance_m: f64, radius_m: f64) -> bool {
        let first = &rays[self.first];
        let least = match (self.neighbours(rays), self.first == self.end) {
            _ if first.is_wide() => 1.0,
            ((false, false), true) => 1.0,
            ((true, true), _) => {
                let half_fan = libm::asin((radius_m / distance_m.max(0.3)).min(0.8));
                let filled = half_fan / first.half_cone_rad.max(1e-3);
                libm::floor(FILLED * filled).clamp(2.0, 4.0)
            }
            _ if face.is_beyond_doubt => 1.0,
            _ => 2.0,
        };
        face.columns as f64 >= least
    }

    fn add(&mut self, i: usize, p: Vector2<f64>) {
        self.end = i;
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
    for (i, ray) in rays.iter().enumerate().filter(|(_, r)| r.unexplained) {
        match out
            .iter_mut()
            .find(|g| (g.last - ray.to).norm() < GROUP_GAP_M)
        {
            Some(g) => g.add(i, ray.to),
            None => out.push(Group::of(i, ray.to)),
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
            open_m: 4.0,
            half_cone_rad: 0.049,
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
