//! What the rangers say: free cells, returns that the plan explains, returns it does not.

use super::Navigator;
use crate::tracks::{Ray, Rays};
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

/// Cones wider than this (half, rad) do not tell where on their front a return came from.
const WIDE_RAD: f64 = 0.06;

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
        let slack_m = 2.0 * nav.position_std_m.norm_xy().min(0.08);

        let mut rays = Rays::new();
        for beam in &scan.beams {
            let Some(look) = Look::along(beam, &frd_to_ned, height_m) else {
                continue;
            };
            self.coverage
                .mark(scan.at, beam.bearing_rad, beam.half_cone_rad);
            let mut echo = look.is_return.then_some(Return {
                at: scan.at,
                offset: look.to,
                unexplained: None,
            });
            if !place_known {
                self.recent.extend(echo);
                continue;
            }
            let from = self.anchor.to_map(position + look.from);
            let to = self.anchor.to_map(position + look.to);
            let explained = look.is_return && self.is_wall(from, to, beam.half_cone_rad, slack_m);
            if let Some(echo) = &mut echo {
                echo.unexplained = (!explained).then_some(to);
            }
            self.recent.extend(echo);
            self.grid.add_free(from, to, scan.at);
            rays.push(Ray {
                from: Vector2::new(from.x(), from.y()),
                to: Vector2::new(to.x(), to.y()),
                unexplained: look.is_return && !explained,
                is_wide: beam.half_cone_rad > WIDE_RAD,
            });
        }
        if !place_known {
            return;
        }
        let here = self.anchor.to_map(position);
        let eye = Vector2::new(here.x(), here.y());
        self.tracker
            .observe(scan.at, eye, &rays, self.params.person_radius_m);
        for ray in rays.iter().filter(|r| r.unexplained) {
            // Somebody walking is followed, not drawn: a trail would block the way behind them. A wide cone cannot tell
            // them from a wall flown along, so what it sees is drawn in any case.
            if ray.is_wide || !self.is_walking(scan.at, ray.to) {
                self.grid.add_hit(In::new(ray.to.x, ray.to.y, 0.0), scan.at);
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

    /// True if the plan's wall explains a return: near its end, or, for a wide cone, anywhere on its front.
    fn is_wall(&self, from: In<Map>, to: In<Map>, half_cone_rad: f64, slack_m: f64) -> bool {
        let (dx, dy) = (to.x() - from.x(), to.y() - from.y());
        let range_m = libm::hypot(dx, dy);
        let near = EXPLAINED_M + slack_m + EXPLAINED_SHARE * range_m;
        let at_angle = |a: f64| {
            let (s, c) = (libm::sin(a), libm::cos(a));
            let p = In::new(from.x() + dx * c - dy * s, from.y() + dx * s + dy * c, 0.0);
            self.wall_distance.at(p) < near
        };
        if at_angle(0.0) {
            return true;
        }
        half_cone_rad > WIDE_RAD
            && [-1.0, -0.5, 0.5, 1.0]
                .iter()
                .any(|k| at_angle(k * half_cone_rad))
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
