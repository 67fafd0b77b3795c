//! What the rangers say: free cells, returns that the plan explains, returns it does not.

use super::Navigator;
use crate::tracks::{Ray, Rays, WIDE_RAD};
use arrayvec::ArrayVec;
use nalgebra::Vector2;
use vehicle::sample::{Beam, MAX_BEAMS};
use vehicle::{In, Map, NavState, Ned, RangeScan, Rot, Timestamp};

/// Beams steeper than this (horizontal share of their length) tell nothing about the level plan.
const LEVEL_MIN: f64 = 0.9;
/// Returns nearer to the floor than this are the floor, m.
const FLOOR_M: f64 = 0.1;
/// A beam without a return proves this much free space: many things do not echo.
const SILENT_FREE_M: f64 = 1.5;
/// Scans older than this are not projected, s.
const AGE_MAX_S: f64 = 0.3;
/// Returns this old no longer stop manual flight, s.
pub(super) const RECENT_S: f64 = 0.5;
/// A return counts as the plan's wall within this distance of it, plus a share of the range, m.
const EXPLAINED_M: f64 = 0.12;
const EXPLAINED_SHARE: f64 = 0.03;
/// Error of the heading that is allowed for besides its own deviation, rad: mounting, latency.
const BEARING_RAD: f64 = 0.02;
/// A ray that comes so close to a wall of the plan and goes on has gone through it: a long reading, m.
const THROUGH_M: f64 = 0.02;
/// Rays are followed on the plan this far, m.
const OPEN_MAX_M: f64 = 6.0;
/// A return is believed when others lie this close to it, m, in the same scan or shortly before: single readings are
/// often short.
const SUPPORT_M: f64 = 0.2;
/// So many returns, itself among them, are a wall's face.
const FACE: usize = 3;
/// How many others, and for how long they speak, s: columns of a multizone ranger; slow wide cones, which never lie.
const SUPPORT: (usize, f64) = (2, 0.25);
const SUPPORT_WIDE: (usize, f64) = (0, 0.6);
/// An echo of a wide cone counts so often: it comes seldom, and from something.
const HITS_WIDE: usize = 2;
/// How much of a wide cone is taken for empty before its echo: share of its half angle, share of the range.
const CONE_SHARE: f64 = 0.7;
const BEFORE_SHARE: f64 = 0.93;

/// The last returns. While the place on the plan is not known they are all there is to brake for; while it is known, what
/// the plan does not explain is braked for at once, before the grid is sure and whatever it is taken for.
#[derive(Clone, Debug, Default)]
pub(super) struct RecentReturns {
    returns: ArrayVec<Return, { 2 * MAX_BEAMS }>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Return {
    pub(super) at: Timestamp,
    /// From the vehicle when it was measured, world axes, m.
    pub(super) offset: In<Ned>,
    /// Where it is on the plan, if the place was known and the plan does not explain it.
    pub(super) unexplained: Option<In<Map>>,
    /// Others say the same.
    pub(super) is_supported: bool,
    /// By a wide cone: where on its front is not known.
    is_wide: bool,
}

impl RecentReturns {
    pub(super) fn clear(&mut self) {
        self.returns.clear();
    }

    /// Returns that still count.
    pub(super) fn fresh(&self, now: Timestamp) -> impl Iterator<Item = &Return> {
        self.returns
            .iter()
            .filter(move |r| now.seconds_since(r.at) < RECENT_S)
    }

    /// True if a return is one of a near wall's face: of narrow beams two more of the same scan beside it say so (one alone is often
    /// short), of a wide cone itself does.
    pub(super) fn is_near_wall(&self, r: &Return, within_m: f64) -> bool {
        let beside = |o: &&Return| o.at == r.at && (o.offset - r.offset).norm_xy() < SUPPORT_M;
        r.offset.norm_xy() < within_m
            && (r.is_wide || self.returns.iter().filter(beside).take(FACE).count() == FACE)
    }

    /// How many unexplained returns of the last `within_s` lie beside a point.
    fn beside(&self, p: Vector2<f64>, at: Timestamp, within_s: f64) -> usize {
        self.returns
            .iter()
            .filter(|r| at.seconds_since(r.at) < within_s)
            .filter_map(|r| r.unexplained)
            .filter(|u| (Vector2::new(u.x(), u.y()) - p).norm() < SUPPORT_M)
            .count()
    }

    /// Marks the returns of a scan that others support.
    fn mark_supported(&mut self, at: Timestamp, rays: &Rays) {
        for i in 0..self.returns.len() {
            let Some(p) = self.returns[i].unexplained else {
                continue;
            };
            if self.returns[i].at == at {
                let p = Vector2::new(p.x(), p.y());
                self.returns[i].is_supported = rays
                    .iter()
                    .find(|r| r.unexplained && r.to == p)
                    .is_some_and(|r| self.supports(r, at));
            }
        }
    }

    /// True if enough other returns lie beside the end of a ray of the newest scan.
    fn supports(&self, ray: &Ray, at: Timestamp) -> bool {
        let (others, within_s) = if ray.is_wide() { SUPPORT_WIDE } else { SUPPORT };
        // Itself is among them.
        self.beside(ray.to, at, within_s) > others
    }

    fn extend(&mut self, r: Option<Return>) {
        let Some(r) = r else { return };
        if self.returns.is_full() {
            self.returns.remove(0);
        }
        self.returns.push(r);
    }
}

impl Navigator {
    /// Takes in a scan (or a part of one). `nav` is the present state; the scan is projected from where the vehicle was
    /// when it was measured.
    pub fn observe(&mut self, scan: &RangeScan, nav: &NavState) {
        let attitude_known = nav.health.attitude && nav.yaw_rad().is_finite();
        if !attitude_known {
            return;
        }
        let age_s = nav.at.seconds_since(scan.at).clamp(0.0, AGE_MAX_S);
        let place_known = nav.health.position
            && nav.position.is_finite()
            && nav.velocity.is_finite()
            && nav.position_std_m.is_finite();
        let position = if place_known {
            nav.position + nav.velocity * -age_s
        } else {
            In::zero()
        };
        let (roll, pitch, yaw) = nav.attitude.roll_pitch_yaw();
        let turned = if nav.rates_radps.is_finite() {
            nav.rates_radps.z() * age_s
        } else {
            0.0
        };
        let frd_to_ned = Rot::from_roll_pitch_yaw(roll, pitch, yaw - turned);
        let height_m = if nav.health.height { nav.height_m } else { 1.0 };
        let doubt = Doubt::of(nav);

        let mut rays = Rays::new();
        for beam in &scan.beams {
            let Some(look) = Look::along(beam, &frd_to_ned, height_m) else {
                continue;
            };
            self.coverage
                .mark(scan.at, beam.bearing_rad, beam.half_cone_rad, yaw - turned);
            let mut echo = look.is_return.then_some(Return {
                at: scan.at,
                offset: look.to,
                unexplained: None,
                is_supported: false,
                is_wide: beam.half_cone_rad > WIDE_RAD,
            });
            if !place_known {
                self.recent.extend(echo);
                continue;
            }
            let from = self.anchor.to_map(position + look.from);
            let to = self.anchor.to_map(position + look.to);
            if look.is_return
                && let Some(counts) = &mut self.counts
            {
                let centre = self.anchor.to_map(position);
                counts.add(
                    Vector2::new(centre.x(), centre.y()),
                    Vector2::new(to.x(), to.y()),
                );
            }
            let explained = look.is_return && self.is_wall(from, to, beam.half_cone_rad, doubt);
            if let Some(echo) = &mut echo {
                echo.unexplained = (!explained).then_some(to);
            }
            self.recent.extend(echo);
            self.grid.add_free(from, to, scan.at);
            if beam.half_cone_rad > WIDE_RAD {
                // Nothing echoed on the cone's whole front.
                for side in [-1.0, 0.0, 1.0, -1.0, 0.0, 1.0] {
                    let (s, c) = libm::sincos(side * CONE_SHARE * beam.half_cone_rad);
                    let (dx, dy) = (to.x() - from.x(), to.y() - from.y());
                    let aside = In::new(dx * c - dy * s, dx * s + dy * c, 0.0) * BEFORE_SHARE;
                    self.grid
                        .add_free(from, (from + aside).with_z(0.0), scan.at);
                }
            }
            rays.push(Ray {
                from: Vector2::new(from.x(), from.y()),
                to: Vector2::new(to.x(), to.y()),
                unexplained: look.is_return && !explained,
                open_m: self.surely_open_m(from, to, doubt.bearing_rad + beam.half_cone_rad),
                half_cone_rad: beam.half_cone_rad,
            });
        }
        if !place_known {
            return;
        }
        self.recent.mark_supported(scan.at, &rays);
        let here = self.anchor.to_map(position);
        let eye = Vector2::new(here.x(), here.y());
        self.tracker
            .observe(scan.at, eye, &rays, self.params.person_radius_m);
        for ray in rays.iter().filter(|r| r.unexplained) {
            // Somebody walking is followed, not drawn: a trail would block the way behind them. A wide cone cannot tell
            // them from a wall flown along, so what it sees is drawn in any case.
            let believed = self.recent.supports(ray, scan.at);
            if believed && (ray.is_wide() || !self.is_walking(scan.at, ray.to)) {
                let times = if ray.is_wide() { HITS_WIDE } else { 1 };
                for _ in 0..times {
                    self.grid.add_hit(In::new(ray.to.x, ray.to.y, 0.0), scan.at);
                }
            }
        }
    }

    fn is_walking(&self, at: Timestamp, p: Vector2<f64>) -> bool {
        let reach = self.params.person_radius_m + 0.2;
        self.tracker
            .tracks()
            .iter()
            .any(|t| t.is_moving() && (t.position_at(at) - p).norm() < reach)
    }

    /// True if the plan explains a return: a wall is near its end, within the errors of place and heading (for a wide cone,
    /// anywhere on its front), or the ray has gone through one.
    fn is_wall(&self, from: In<Map>, to: In<Map>, half_cone_rad: f64, doubt: Doubt) -> bool {
        let (dx, dy) = (to.x() - from.x(), to.y() - from.y());
        let range_m = libm::hypot(dx, dy);
        let near = EXPLAINED_M + doubt.place_m + EXPLAINED_SHARE * range_m;
        let is_wide = half_cone_rad > WIDE_RAD;
        let reach_rad = doubt.bearing_rad + if is_wide { half_cone_rad } else { 0.0 };
        let at_angle = |a: f64| {
            let (s, c) = (libm::sin(a), libm::cos(a));
            let p = In::new(from.x() + dx * c - dy * s, from.y() + dx * s + dy * c, 0.0);
            self.wall_distance.at(p) < near
        };
        [0.0, -1.0, 1.0, -0.5, 0.5]
            .iter()
            .any(|k| at_angle(k * reach_rad))
            || self.open_m(from, to) < range_m
    }

    /// The least that [`open_m`](Self::open_m) tells within an angle (rad) to each side: beside a corner the wall that was hit
    /// may be the near one.
    fn surely_open_m(&self, from: In<Map>, towards: In<Map>, reach_rad: f64) -> f64 {
        let (dx, dy) = (towards.x() - from.x(), towards.y() - from.y());
        [-1.0, 0.0, 1.0]
            .iter()
            .map(|k| {
                let (s, c) = (libm::sin(k * reach_rad), libm::cos(k * reach_rad));
                let p = In::new(from.x() + dx * c - dy * s, from.y() + dx * s + dy * c, 0.0);
                self.open_m(from, p)
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// How far the plan leaves the way open from a point in the direction of another, m.
    fn open_m(&self, from: In<Map>, towards: In<Map>) -> f64 {
        let way = towards - from;
        let unit = way * (1.0 / way.norm_xy().max(1e-6));
        let mut along_m = 0.0;
        while along_m < OPEN_MAX_M {
            let clear_m = self.wall_distance.at((from + unit * along_m).with_z(0.0));
            if clear_m < THROUGH_M {
                return along_m;
            }
            along_m += clear_m;
        }
        OPEN_MAX_M
    }
}

/// How wrong the pose may be.
#[derive(Clone, Copy, Debug)]
struct Doubt {
    place_m: f64,
    bearing_rad: f64,
}

impl Doubt {
    /// Two deviations, within limits: who doubts everything sees nobody.
    fn of(nav: &NavState) -> Self {
        let yaw_std = if nav.yaw_std_rad.is_finite() {
            nav.yaw_std_rad
        } else {
            0.0
        };
        Self {
            place_m: 2.0 * nav.position_std_m.norm_xy().min(0.08),
            bearing_rad: BEARING_RAD + 2.0 * yaw_std.min(0.02),
        }
    }
}

/// A beam seen from above.
struct Look {
    /// Where it starts and where it ends (at the return, or where free space is no longer proven), m from the vehicle's
    /// centre in world axes.
    from: In<Ned>,
    to: In<Ned>,
    is_return: bool,
}

impl Look {
    fn along(beam: &Beam, frd_to_ned: &Rot<vehicle::Frd, Ned>, height_m: f64) -> Option<Self> {
        let (se, ce) = (libm::sin(beam.elevation_rad), libm::cos(beam.elevation_rad));
        let (sb, cb) = (libm::sin(beam.bearing_rad), libm::cos(beam.bearing_rad));
        let ray = *frd_to_ned * In::new(ce * cb, ce * sb, -se);
        if !ray.is_finite() || ray.norm_xy() < LEVEL_MIN {
            return None;
        }
        let from = *frd_to_ned * beam.origin;
        let (length, is_return) = match beam.distance_m {
            Some(d) if d.is_finite() && d > 0.0 => (d, true),
            _ => (beam.max_m.min(SILENT_FREE_M), false),
        };
        let to = from + ray * length;
        let hits_floor = to.z() > height_m - FLOOR_M;
        if is_return && hits_floor {
            return None;
        }
        Some(Self {
            from,
            to,
            is_return,
        })
    }
}
