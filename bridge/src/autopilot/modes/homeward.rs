//! Return: fly to home or to the nearest rally point, whichever way is shorter, by a route the plan allows; then land there.

use super::descent::Descent;
use super::{Cockpit, Wish};
use crate::autopilot::door::Notice;
use vehicle::{In, Ned};

/// Rally points whose ways are searched at most: the nearest by air.
const SEARCHED: usize = 4;

/// A way home in progress.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Homeward {
    descent: Option<Descent>,
}

impl Homeward {
    /// One tick.
    pub fn step(&mut self, c: &mut Cockpit<'_>, touched_down: bool) -> Wish {
        let descent = match &mut self.descent {
            Some(descent) => descent,
            None => self.descent.insert(Self::begin(c)),
        };
        descent.step(c, touched_down)
    }

    /// Chooses where to.
    fn begin(c: &mut Cockpit<'_>) -> Descent {
        let home = In::new(c.home.x(), c.home.y(), c.home.z());
        let at_home = Descent::at(home, Some(c.home_yaw_rad));
        if !c.nav.health.position || c.navigator.site().rally.is_empty() {
            return at_home;
        }
        let height_m = c.clamped_down_m(c.nav.position.z());
        let mut best_m = c.navigator.way_m(home.with_z(height_m), c.nav);
        let mut best: Option<(u16, In<Ned>)> = None;
        let mut tried_m = 0.0;
        for _ in 0..SEARCHED {
            // The next nearest; the list is short and nothing is allocated.
            let rally = &c.navigator.site().rally;
            let by_air = |p: &In<Ned>| (*p - c.nav.position).norm_xy();
            let next = rally
                .iter()
                .zip(1..)
                .filter(|(p, _)| by_air(p) > tried_m)
                .min_by(|(a, _), (b, _)| by_air(a).total_cmp(&by_air(b)));
            let Some((place, number)) = next.map(|(p, number)| (*p, number)) else {
                break;
            };
            tried_m = by_air(&place);
            let way_m = c.navigator.way_m(place.with_z(height_m), c.nav);
            if let Some(m) = way_m
                && best_m.is_none_or(|b| m < b)
            {
                (best_m, best) = (Some(m), Some((number, place)));
            }
        }
        match best {
            Some((number, place)) => {
                let way_m = best_m.unwrap_or(0.0);
                c.notice(Notice::ToRallyPoint { number, way_m });
                Descent::at(place.with_z(home.z()), None)
            }
            None => at_home,
        }
    }
}
