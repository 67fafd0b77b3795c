//! The fence: where the vehicle may be, and what is done before it leaves.
//!
//! Before, not after: whenever the place where it would come to rest by braking now (`BRAKE_MPS2` after `REACTION`) lies
//! outside, the action of `GF_ACTION` is asked of the vehicle, as a station would ask it. Whoever then steers at the fence again
//! is stopped again; a vehicle that is outside (it was armed there, or pushed) is told once and may fly back.
//!
//! Not covered yet: a go-to, which is flown in Hold, is not stopped by the action Hold.
//!
//! A place is inside if it lies in at least one inclusion zone (or there is none) and in no exclusion zone. Zones have no
//! height: the ceiling is `KST_CEILING`. Source: MAVLink guide, "Geofencing"; MAV_CMD 5001 to 5004.

use super::place::Place;
use super::{Context, LinkId, Outbox, Peer};
use crate::autopilot::door::{LandedState, Request, Severity};
use crate::autopilot::mode::Mode;
use core::time::Duration;
use mavlink_dialect::mission_item::{MissionItem, Point};
use vehicle::{MapAnchor, Timestamp};

/// MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION and _EXCLUSION; parameter 1 is the number of vertices.
pub const FENCE_VERTICES: [u16; 2] = [5001, 5002];
/// MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION and _EXCLUSION; parameter 1 is the radius, m.
pub const FENCE_CIRCLES: [u16; 2] = [5003, 5004];
/// Deceleration counted on, m/s2: half of what Hold brakes with, as the wind of a fan may come from behind.
const BRAKE_MPS2: f64 = 0.8;
/// Time until the braking begins: snapshot, door, tick and the controller's dead time.
const REACTION: Duration = Duration::from_millis(250);
/// The vehicle has this long to change its mode before it is asked again.
const ASK_AGAIN: Duration = Duration::from_millis(500);

vehicle::param_choice! {
    /// What to do before the vehicle leaves the fence (PX4's codes).
    pub enum FenceAction {
        /// Nothing.
        Disabled = 0, "disabled";
        /// Say so.
        Warn = 1, "warn";
        /// Hover.
        Hold = 2, "hold";
        /// Fly home and land.
        Return = 3, "return";
        /// Come down here.
        Land = 5, "land";
    }
}

/// One zone, metres north and east of home.
#[derive(Clone, Debug, PartialEq)]
enum Shape {
    Polygon(Vec<[f64; 2]>),
    Circle([f64; 2], f64),
}

/// A fence in the local frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fence {
    zones: Vec<(bool, Shape)>,
}

impl Fence {
    /// The fence of items that passed [`check`].
    #[must_use]
    pub fn new(items: &[MissionItem], ctx: &Context<'_>) -> Self {
        let place = |i: &MissionItem| {
            let point = Point::from_wire(i.frame, i.x, i.y, i.z);
            let place = Place::from_point(&point, ctx).unwrap_or_default();
            [place.north_m.unwrap_or(0.0), place.east_m.unwrap_or(0.0)]
        };
        let mut zones = Vec::new();
        let mut rest = items;
        while let Some(first) = rest.first() {
            let n = vertices(first).unwrap_or(1).clamp(1, rest.len());
            let (zone, later) = rest.split_at(n);
            rest = later;
            let is_inclusion = [FENCE_VERTICES[0], FENCE_CIRCLES[0]].contains(&first.command);
            let shape = if FENCE_CIRCLES.contains(&first.command) {
                Shape::Circle(place(first), f64::from(first.params[0]))
            } else {
                Shape::Polygon(zone.iter().map(place).collect())
            };
            zones.push((is_inclusion, shape));
        }
        Self { zones }
    }

    /// True if a place, metres north and east of home, is inside.
    #[must_use]
    pub fn contains(&self, at: [f64; 2]) -> bool {
        let mut inclusions = self.zones.iter().filter(|(is_in, _)| *is_in).peekable();
        let is_included = inclusions.peek().is_none() || inclusions.any(|(_, s)| s.covers(at));
        let mut exclusions = self.zones.iter().filter(|(is_in, _)| !*is_in);
        is_included && !exclusions.any(|(_, s)| s.covers(at))
    }
}

impl Shape {
    fn covers(&self, [n, e]: [f64; 2]) -> bool {
        match self {
            Self::Circle([cn, ce], radius) => {
                let (dn, de) = (n - cn, e - ce);
                dn * dn + de * de <= radius * radius
            }
            // Even-odd rule: a ray to the east crosses the border an odd number of times.
            Self::Polygon(corners) => {
                let mut is_inside = false;
                let mut last = corners.len().wrapping_sub(1);
                for i in 0..corners.len() {
                    let ([n0, e0], [n1, e1]) = (corners[last], corners[i]);
                    if (n0 > n) != (n1 > n) && e < (e1 - e0) * (n - n0) / (n1 - n0) + e0 {
                        is_inside = !is_inside;
                    }
                    last = i;
                }
                is_inside
            }
        }
    }
}

/// Vertices of the polygon an item belongs to; none for a circle or for a number that is none.
fn vertices(item: &MissionItem) -> Option<usize> {
    let n = item.params[0];
    let is_vertex = FENCE_VERTICES.contains(&item.command);
    (is_vertex && (3.0..=10_000.0).contains(&n)).then(|| n.round() as usize)
}

/// Checks that every polygon has its vertices, one after the other.
///
/// # Errors
/// The item where it goes wrong, and why.
pub fn check(items: &[MissionItem]) -> Result<(), (u16, String)> {
    let mut at = 0;
    while let Some(first) = items.get(at) {
        // Lists are shorter than 65,536.
        let seq = at as u16;
        if FENCE_CIRCLES.contains(&first.command) {
            at += 1;
            continue;
        }
        let n = vertices(first).ok_or((seq, "a polygon has at least 3 vertices".to_owned()))?;
        let zone = items
            .get(at..at + n)
            .ok_or((seq, format!("the polygon has fewer than its {n} vertices")))?;
        let is_same = |i: &MissionItem| i.command == first.command && vertices(i) == Some(n);
        if !zone.iter().all(is_same) {
            return Err((
                seq,
                format!("the polygon's {n} vertices do not follow each other"),
            ));
        }
        at += n;
    }
    Ok(())
}

/// What a fence in metres was made from: it is made anew when one of them changes.
type Made = (u32, [i32; 2], MapAnchor);

/// Watches the vehicle.
#[derive(Debug, Default)]
pub struct FenceWatch {
    fence: Option<(Made, Fence)>,
    /// It is outside, and this was said.
    is_told_outside: bool,
    asked_at: Option<Timestamp>,
}

impl FenceWatch {
    /// No fence yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Looks where the vehicle is going; `items` and `id` are the stored fence.
    pub fn look(
        &mut self,
        now: Timestamp,
        items: &[MissionItem],
        id: u32,
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let s = ctx.snapshot;
        let action = ctx.settings.ground.fence_action;
        let is_flying = s.is_armed && s.landed != LandedState::OnGround;
        if items.is_empty()
            || action == FenceAction::Disabled
            || !is_flying
            || !s.nav.health.position
        {
            self.is_told_outside = false;
            self.asked_at = None;
            return;
        }
        let ground = &ctx.settings.ground;
        let made = (id, [ground.lat0_e7, ground.lon0_e7], ctx.anchor);
        if self.fence.as_ref().is_none_or(|(m, _)| *m != made) {
            self.fence = Some((made, Fence::new(items, ctx)));
        }
        let Some((_, fence)) = &self.fence else {
            return;
        };
        let here = [s.nav.position.x(), s.nav.position.y()];
        if !fence.contains(here) {
            if !self.is_told_outside {
                self.is_told_outside = true;
                out.text(Severity::Critical, "Outside the fence: fly back");
            }
            return;
        }
        self.is_told_outside = false;
        let (vn, ve) = (s.nav.velocity.x(), s.nav.velocity.y());
        let speed = libm::hypot(vn, ve);
        let seconds = REACTION.as_secs_f64() + speed / (2.0 * BRAKE_MPS2);
        let rest = [here[0] + vn * seconds, here[1] + ve * seconds];
        let is_obeying = match action {
            FenceAction::Disabled | FenceAction::Warn => self.asked_at.is_some(),
            FenceAction::Hold => matches!(s.mode.mode, Mode::Hold | Mode::Land),
            FenceAction::Return => matches!(s.mode.mode, Mode::Return | Mode::Land),
            FenceAction::Land => s.mode.mode == Mode::Land,
        };
        if fence.contains(rest) {
            // A new approach is a new warning.
            if now.since(self.asked_at.unwrap_or(now)) >= ASK_AGAIN {
                self.asked_at = None;
            }
            return;
        }
        let was_just_asked = self.asked_at.is_some_and(|at| now.since(at) < ASK_AGAIN);
        if is_obeying || was_just_asked {
            return;
        }
        self.asked_at = Some(now);
        let us = Peer {
            link: LinkId(0),
            address: ctx.us,
        };
        let (mode, word) = match action {
            FenceAction::Disabled | FenceAction::Warn => {
                return out.text(Severity::Critical, "Fence ahead");
            }
            FenceAction::Hold => (Mode::Hold, "Hold"),
            FenceAction::Return => (Mode::Return, "Return"),
            FenceAction::Land => (Mode::Land, "Land"),
        };
        out.text(Severity::Critical, format!("Fence ahead: {word}"));
        out.ask(us, Request::SetMode(mode));
    }
}

#[cfg(test)]
mod tests {
    use super::super::bench::Bench;
    use super::*;
    use vehicle::{In, Ned};

    /// An item of frame LOCAL_NED.
    fn item(command: u16, param1: f32, north_m: f64, east_m: f64) -> MissionItem {
        MissionItem {
            frame: 1,
            command,
            params: [param1, 0.0, 0.0, 0.0],
            x: (north_m * 1e4) as i32,
            y: (east_m * 1e4) as i32,
            ..Default::default()
        }
    }

    /// A square of 4 m about home with a pillar in it.
    fn square() -> Vec<MissionItem> {
        let corner = |n, e| item(5001, 4.0, n, e);
        vec![
            corner(-2.0, -2.0),
            corner(2.0, -2.0),
            corner(2.0, 2.0),
            corner(-2.0, 2.0),
            item(5004, 0.5, 1.0, 1.0),
        ]
    }

    #[test]
    fn inside_is_in_an_inclusion_and_in_no_exclusion() {
        let bench = Bench::default();
        let fence = Fence::new(&square(), &bench.ctx());
        for (at, is_in) in [
            ([0.0, 0.0], true),
            ([1.9, -1.9], true),
            ([2.1, 0.0], false),
            ([0.0, -2.1], false),
            ([1.0, 1.0], false),
            ([1.0, 1.6], true),
        ] {
            assert_eq!(fence.contains(at), is_in, "{at:?}");
        }
        let only_out = Fence::new(&square()[4..], &bench.ctx());
        assert!(only_out.contains([50.0, 0.0]) && !only_out.contains([1.2, 1.2]));
        assert!(Fence::default().contains([9.0, 9.0]));
        // A concave one: an L without its upper right quarter.
        let l: Vec<_> = [(0., 0.), (4., 0.), (4., 2.), (2., 2.), (2., 4.), (0., 4.)]
            .map(|(n, e)| item(5001, 6.0, n, e))
            .to_vec();
        let l = Fence::new(&l, &bench.ctx());
        assert!(l.contains([3.0, 1.0]) && l.contains([1.0, 3.0]) && !l.contains([3.0, 3.0]));
    }

    #[test]
    fn a_polygon_without_all_its_vertices_is_refused() {
        assert_eq!(check(&square()), Ok(()));
        assert_eq!(check(&square()[1..]).unwrap_err().0, 0);
        assert!(check(&square()[..3]).unwrap_err().1.contains("fewer"));
        for n in [0.0, 2.0, f32::NAN, f32::INFINITY, -4.0] {
            assert!(check(&[item(5001, n, 0.0, 0.0)]).is_err(), "{n}");
        }
    }

    fn flying(bench: &mut Bench, north_m: f64, speed_mps: f64) {
        let s = &mut bench.snapshot;
        s.is_armed = true;
        s.landed = LandedState::InAir;
        s.nav.health.position = true;
        s.mode.mode = Mode::Position;
        s.nav.position = In::<Ned>::new(north_m, 0.0, -1.0);
        s.nav.velocity = In::<Ned>::new(speed_mps, 0.0, 0.0);
    }

    #[test]
    fn the_vehicle_is_stopped_while_it_can_still_come_to_rest_inside() {
        let (mut bench, mut out, mut watch) =
            (Bench::default(), Outbox::default(), FenceWatch::new());
        let items = square();
        let mut now = Timestamp::ZERO;
        let mut look = |bench: &Bench, out: &mut Outbox, ms: u64| {
            now += Duration::from_millis(ms);
            watch.look(now, &items, 7, &bench.ctx(), out);
            out.asked()
                .into_iter()
                .map(|a| a.request)
                .collect::<Vec<_>>()
        };
        // 1 m/s needs 0.25 + 0.625 m.
        flying(&mut bench, 1.0, 1.0);
        assert_eq!(look(&bench, &mut out, 25), []);
        flying(&mut bench, 1.2, 1.0);
        assert_eq!(look(&bench, &mut out, 25), [Request::SetMode(Mode::Hold)]);
        assert_eq!(out.said()[0].1, "Fence ahead: Hold");
        assert_eq!(look(&bench, &mut out, 25), [], "asked again at once");
        bench.snapshot.mode.mode = Mode::Hold;
        assert_eq!(look(&bench, &mut out, 600), []);
        // The pilot steers at it again.
        flying(&mut bench, 1.5, 0.8);
        assert_eq!(look(&bench, &mut out, 600), [Request::SetMode(Mode::Hold)]);
        // Away from it he may fly as he likes.
        flying(&mut bench, 1.9, -1.0);
        assert_eq!(look(&bench, &mut out, 600), []);
    }

    #[test]
    fn outside_it_is_told_once_and_may_fly_back() {
        let (mut bench, mut out, mut watch) =
            (Bench::default(), Outbox::default(), FenceWatch::new());
        flying(&mut bench, 3.0, 0.5);
        for ms in [25, 50, 5_000] {
            watch.look(Timestamp::from_ms(ms), &square(), 7, &bench.ctx(), &mut out);
        }
        assert_eq!(out.said().len(), 1);
        assert!(out.asked().is_empty());
    }

    #[test]
    fn on_the_ground_without_a_place_or_switched_off_it_does_nothing() {
        let now = Timestamp::from_ms(100);
        let quiet = |bench: &Bench| {
            let mut out = Outbox::default();
            FenceWatch::new().look(now, &square(), 7, &bench.ctx(), &mut out);
            assert!(out.asked().is_empty() && out.said().is_empty());
        };
        let mut bench = Bench::default();
        flying(&mut bench, 1.9, 1.0);
        bench.snapshot.landed = LandedState::OnGround;
        quiet(&bench);
        flying(&mut bench, 1.9, 1.0);
        bench.snapshot.nav.health.position = false;
        quiet(&bench);
        flying(&mut bench, 1.9, 1.0);
        bench.settings.ground.fence_action = FenceAction::Disabled;
        quiet(&bench);
    }
}
