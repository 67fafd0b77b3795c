//! The fence: where the vehicle may be, and what is done before it leaves.
//!
//! Before, not after: whenever the place where it would come to rest by braking now (`BRAKE_MPS2` after `REACTION`) lies
//! outside, the action of `GF_ACTION` is asked of the vehicle, as a station would ask it. Whoever then steers at the fence again
//! is stopped again; a vehicle that is outside (it was armed there, or pushed) is told once and may fly back.
//!
//! The vehicle knows the fence too ([`planner::fence::Site`]): goals beyond it are refused and ways keep inside, so what the
//! watch stops is sticks, streams, and a goal that was flown to before the fence was drawn. A fence that only warns, or does
//! nothing, the vehicle is not told of.
//!
//! Zones have no height: the ceiling is `KST_CEILING`. Source: MAVLink guide, "Geofencing"; MAV_CMD 5001 to 5004.

use super::place::Place;
use super::{Context, LinkId, Outbox, Peer};
use crate::autopilot::door::{GoTo, LandedState, Request, Severity};
use crate::autopilot::mode::Mode;
use core::time::Duration;
use mavlink_dialect::mission_item::{MissionItem, Point};
use planner::fence::{Fence, Shape, Site, Zone};
use std::sync::Arc;
use vehicle::{In, MapAnchor, Setpoint, Timestamp};

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

/// The fence of items that passed [`check`], in NED about home.
#[must_use]
pub fn fence_of(items: &[MissionItem], ctx: &Context<'_>) -> Fence {
    let mut zones = Vec::new();
    let mut rest = items;
    while let Some(first) = rest.first() {
        let n = vertices(first).unwrap_or(1).clamp(1, rest.len());
        let (zone, later) = rest.split_at(n);
        rest = later;
        let is_inclusion = [FENCE_VERTICES[0], FENCE_CIRCLES[0]].contains(&first.command);
        let shape = if FENCE_CIRCLES.contains(&first.command) {
            Shape::Circle(place(first, ctx), f64::from(first.params[0]))
        } else {
            Shape::Polygon(zone.iter().map(|i| place(i, ctx)).collect())
        };
        zones.push(Zone {
            is_inclusion,
            shape,
        });
    }
    Fence::new(zones)
}

/// North and east of an item, m.
fn place(i: &MissionItem, ctx: &Context<'_>) -> [f64; 2] {
    let point = Point::from_wire(i.frame, i.x, i.y, i.z);
    let place = Place::from_point(&point, ctx).unwrap_or_default();
    [place.north_m.unwrap_or(0.0), place.east_m.unwrap_or(0.0)]
}

/// Checks a whole fence: every polygon has its vertices, and home is inside.
///
/// # Errors
/// The item where it goes wrong, and why.
pub fn check_with_home(items: &[MissionItem], ctx: &Context<'_>) -> Result<(), (u16, String)> {
    check(items)?;
    let home = [ctx.snapshot.home.x(), ctx.snapshot.home.y()];
    if fence_of(items, ctx).contains(home) {
        return Ok(());
    }
    // The zone that keeps home out; where none does, home is in no zone to stay in.
    let mut seq = 0;
    let mut first_inclusion = 0;
    while let Some(first) = items.get(seq) {
        let n = vertices(first).unwrap_or(1).clamp(1, items.len() - seq);
        let zone = fence_of(&items[seq..seq + n], ctx);
        let is_inclusion = zone.zones().iter().any(|z| z.is_inclusion);
        if !is_inclusion && !zone.contains(home) {
            return Err((
                seq as u16,
                "home would be in this zone to stay out of".to_owned(),
            ));
        }
        if is_inclusion && first_inclusion == 0 {
            first_inclusion = seq;
        }
        seq += n;
    }
    Err((
        first_inclusion as u16,
        "home would be outside: it lies in no zone to stay in".to_owned(),
    ))
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
type Made = (u32, u32, [i32; 2], MapAnchor, FenceAction);

/// Where the vehicle is to the fence, for FENCE_STATUS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FenceState {
    /// There is one.
    pub is_set: bool,
    /// It is outside.
    pub is_outside: bool,
    /// Times it was outside, or would have been without us.
    pub breaches: u16,
    /// When that was last.
    pub breached_at: Option<Timestamp>,
    /// The action under way.
    pub mitigation: Mitigation,
}

/// What is done against leaving: FENCE_MITIGATE.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mitigation {
    /// 1: nothing.
    #[default]
    None,
    /// 2: the velocity is taken back.
    Stopping,
}

/// Watches the vehicle.
#[derive(Debug, Default)]
pub struct FenceWatch {
    made: Option<Made>,
    fence: Fence,
    /// It is outside, and this was said.
    is_told_outside: bool,
    asked_at: Option<Timestamp>,
    state: FenceState,
}

impl FenceWatch {
    /// No fence yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Where the vehicle is to the fence.
    #[must_use]
    pub const fn state(&self) -> FenceState {
        self.state
    }

    /// Tells the vehicle of a fence or of rally points that are new, or lie elsewhere now.
    pub fn tell(
        &mut self,
        (fence, fence_id): (&[MissionItem], u32),
        (rally, rally_id): (&[MissionItem], u32),
        ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let ground = &ctx.settings.ground;
        let origin = [ground.lat0_e7, ground.lon0_e7];
        let made = (fence_id, rally_id, origin, ctx.anchor, ground.fence_action);
        if self.made == Some(made) {
            return;
        }
        let was_told = self.made.replace(made).is_some();
        self.fence = fence_of(fence, ctx);
        if !was_told && fence.is_empty() && rally.is_empty() {
            return;
        }
        let is_kept = !matches!(
            ground.fence_action,
            FenceAction::Disabled | FenceAction::Warn
        );
        let site = Site {
            fence: if is_kept {
                self.fence.clone()
            } else {
                Fence::default()
            },
            rally: rally
                .iter()
                .map(|i| {
                    let [north, east] = place(i, ctx);
                    In::new(north, east, 0.0)
                })
                .collect(),
        };
        out.ask(us(ctx), Request::SetSite(Arc::new(site)));
    }

    /// Looks where the vehicle is going.
    pub fn look(&mut self, now: Timestamp, ctx: &Context<'_>, out: &mut Outbox) {
        let s = ctx.snapshot;
        let action = ctx.settings.ground.fence_action;
        let is_flying = s.is_armed && s.landed != LandedState::OnGround;
        self.state.is_set = !self.fence.is_empty() && action != FenceAction::Disabled;
        let here = [s.nav.position.x(), s.nav.position.y()];
        let was_outside = self.state.is_outside;
        self.state.is_outside =
            self.state.is_set && s.nav.health.position && !self.fence.contains(here);
        if self.state.is_outside && !was_outside {
            self.breached(now);
        }
        if !self.state.is_set || !is_flying || !s.nav.health.position {
            self.is_told_outside = false;
            self.asked_at = None;
            self.state.mitigation = Mitigation::None;
            return;
        }
        if self.state.is_outside {
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
        if self.fence.contains(rest) {
            // A new approach is a new warning.
            if now.since(self.asked_at.unwrap_or(now)) >= ASK_AGAIN {
                self.asked_at = None;
                self.state.mitigation = Mitigation::None;
            }
            return;
        }
        let is_obeying = match action {
            FenceAction::Disabled | FenceAction::Warn => self.asked_at.is_some(),
            FenceAction::Hold => {
                s.mode.mode == Mode::Land || (s.mode.mode == Mode::Hold && self.hovers_inside(ctx))
            }
            FenceAction::Return => matches!(s.mode.mode, Mode::Return | Mode::Land),
            FenceAction::Land => s.mode.mode == Mode::Land,
        };
        let was_just_asked = self.asked_at.is_some_and(|at| now.since(at) < ASK_AGAIN);
        if is_obeying || was_just_asked {
            return;
        }
        if self.asked_at.is_none() {
            self.breached(now);
        }
        self.asked_at = Some(now);
        let (mode, word) = match action {
            FenceAction::Disabled | FenceAction::Warn => {
                return out.text(Severity::Critical, "Fence ahead");
            }
            FenceAction::Hold => (Mode::Hold, "Hold"),
            FenceAction::Return => (Mode::Return, "Return"),
            FenceAction::Land => (Mode::Land, "Land"),
        };
        self.state.mitigation = Mitigation::Stopping;
        out.text(Severity::Critical, format!("Fence ahead: {word}"));
        let request = if mode == s.mode.mode {
            // It is in Hold already, on its way to a goal beyond: the goal is dropped.
            Request::GoTo(GoTo::default())
        } else {
            Request::SetMode(mode)
        };
        out.ask(us(ctx), request);
    }

    fn breached(&mut self, now: Timestamp) {
        self.state.breaches = self.state.breaches.saturating_add(1);
        self.state.breached_at = Some(now);
    }

    /// The vehicle is to hover at a place inside, or stands still: braking, not flying on.
    fn hovers_inside(&self, ctx: &Context<'_>) -> bool {
        match ctx.snapshot.setpoint {
            Some(Setpoint::Hover { position, .. }) => {
                self.fence.contains([position.x(), position.y()])
            }
            Some(Setpoint::Velocity { velocity, .. }) => velocity.norm_xy() < 0.05,
            _ => true,
        }
    }
}

/// Requests of our own.
fn us(ctx: &Context<'_>) -> Peer {
    Peer {
        link: LinkId(0),
        address: ctx.us,
    }
}

#[cfg(test)]
mod tests {
    use super::super::bench::Bench;
    use super::*;
    use crate::autopilot::door::Asked;
    use vehicle::Ned;

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
        let fence = fence_of(&square(), &bench.ctx());
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
        let only_out = fence_of(&square()[4..], &bench.ctx());
        assert!(only_out.contains([50.0, 0.0]) && !only_out.contains([1.2, 1.2]));
        assert!(Fence::default().contains([9.0, 9.0]));
        // A concave one: an L without its upper right quarter.
        let l: Vec<_> = [(0., 0.), (4., 0.), (4., 2.), (2., 2.), (2., 4.), (0., 4.)]
            .map(|(n, e)| item(5001, 6.0, n, e))
            .to_vec();
        let l = fence_of(&l, &bench.ctx());
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
            watch.tell((&items, 7), (&[], 0), &bench.ctx(), out);
            watch.look(now, &bench.ctx(), out);
            out.asked()
                .into_iter()
                .map(|a| a.request)
                .filter(|r| !matches!(r, Request::SetSite(_)))
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
    fn a_goal_beyond_a_fence_that_was_drawn_later_is_dropped() {
        let (mut bench, mut out, mut watch) =
            (Bench::default(), Outbox::default(), FenceWatch::new());
        watch.tell((&square(), 7), (&[], 0), &bench.ctx(), &mut out);
        let _ = out.asked();
        flying(&mut bench, 1.3, 1.0);
        bench.snapshot.mode.mode = Mode::Hold;
        bench.snapshot.setpoint = Some(Setpoint::Velocity {
            velocity: In::new(1.0, 0.0, 0.0),
            down_m: None,
            heading: vehicle::Heading::Rate(0.0),
        });
        watch.look(Timestamp::from_ms(25), &bench.ctx(), &mut out);
        let asked = out.asked();
        assert_eq!(asked[0].request, Request::GoTo(GoTo::default()));
        assert_eq!(watch.state().mitigation, Mitigation::Stopping);
    }

    #[test]
    fn a_fence_that_excludes_home_is_refused_with_the_zone() {
        let mut bench = Bench::default();
        assert_eq!(check_with_home(&square(), &bench.ctx()), Ok(()));
        let mut items = square();
        items.push(item(5004, 0.6, -0.3, 0.2));
        assert_eq!(check_with_home(&items, &bench.ctx()).unwrap_err().0, 5);
        bench.snapshot.home = In::new(9.0, 0.0, 0.0);
        let (seq, why) = check_with_home(&square(), &bench.ctx()).unwrap_err();
        assert_eq!((seq, why.contains("no zone to stay in")), (0, true));
    }

    #[test]
    fn the_vehicle_is_told_of_a_fence_once_and_of_none_that_only_warns() {
        let (mut bench, mut out, mut watch) =
            (Bench::default(), Outbox::default(), FenceWatch::new());
        let mut told = |bench: &Bench, items: &[MissionItem], id| {
            watch.tell((items, id), (&[], 0), &bench.ctx(), &mut out);
            let zones = |a: &Asked| match &a.request {
                Request::SetSite(site) => site.fence.zones().len(),
                _ => 99,
            };
            out.asked().iter().map(zones).collect::<Vec<_>>()
        };
        assert!(told(&bench, &[], 0).is_empty());
        assert_eq!(told(&bench, &square(), 7), [2]);
        assert!(told(&bench, &square(), 7).is_empty());
        bench.settings.ground.fence_action = FenceAction::Warn;
        assert_eq!(told(&bench, &square(), 7), [0]);
    }

    #[test]
    fn outside_it_is_told_once_and_may_fly_back() {
        let (mut bench, mut out, mut watch) =
            (Bench::default(), Outbox::default(), FenceWatch::new());
        flying(&mut bench, 3.0, 0.5);
        for ms in [25, 50, 5_000] {
            watch.tell((&square(), 7), (&[], 0), &bench.ctx(), &mut out);
            watch.look(Timestamp::from_ms(ms), &bench.ctx(), &mut out);
        }
        assert_eq!(out.said().len(), 1);
        assert!(matches!(
            out.asked()[..],
            [Asked {
                request: Request::SetSite(_),
                ..
            }]
        ));
        assert!(watch.state().is_outside && watch.state().breaches == 1);
    }

    #[test]
    fn on_the_ground_without_a_place_or_switched_off_it_does_nothing() {
        let now = Timestamp::from_ms(100);
        let quiet = |bench: &Bench| {
            let (mut out, mut watch) = (Outbox::default(), FenceWatch::new());
            watch.tell((&square(), 7), (&[], 0), &bench.ctx(), &mut out);
            out.asked();
            watch.look(now, &bench.ctx(), &mut out);
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
