//! Hold: hover at a set point, go where asked, give way to what comes near.

use super::keys::KeyMode;
use super::{Air, Cockpit, Wish, refusal_of};
use crate::autopilot::door::{GoTo, Key, KeySetpoint, Refusal};
use planner::navigator::Goal;
use vehicle::{Heading, In, Ned};

/// Mode Hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hold {
    target: Option<Target>,
    down_m: Option<f64>,
    /// Somebody asked for the heading; else the nose may look around.
    is_heading_asked: bool,
    /// Manual mode of the key console.
    pub keys: KeyMode,
}

/// Where to hover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// m about home.
    pub position: In<Ned>,
    /// Clockwise from north, rad.
    pub yaw_rad: f64,
}

impl Hold {
    /// Where it hovers, once it does.
    #[must_use]
    pub const fn target(&self) -> Option<Target> {
        self.target
    }

    /// Hover wherever it is at the next tick: on entry, and when the estimate jumped.
    pub const fn forget_target(&mut self) {
        (self.target, self.down_m, self.is_heading_asked) = (None, None, false);
    }

    /// Hover here from now on; the nose may look around.
    pub fn stop(&mut self, c: &mut Cockpit<'_>) {
        let target = Target {
            position: c.stopping_point(),
            yaw_rad: c.nav.yaw_rad(),
        };
        self.hold_at(c, target, false);
    }

    /// Hover there, without a route. A heading that nobody asked for leaves the nose free to look around.
    pub fn hold_at(&mut self, c: &mut Cockpit<'_>, target: Target, is_heading_asked: bool) {
        c.navigator.hold(
            target.position,
            is_heading_asked.then_some(target.yaw_rad),
            c.nav,
        );
        self.target = Some(target);
        self.is_heading_asked = is_heading_asked;
    }

    /// Takes a key of the key console.
    ///
    /// # Errors
    /// Manual mode is off, or the vehicle is not where it counts.
    pub fn press(&mut self, c: &mut Cockpit<'_>, key: Key) -> Result<KeySetpoint, Refusal> {
        let mut target = match self.target {
            Some(target) if self.is_heading_asked => target,
            // The nose looked around until now: manual mode begins with where it points.
            Some(target) => Target {
                yaw_rad: c.nav.yaw_rad(),
                ..target
            },
            None => Target {
                position: c.stopping_point(),
                yaw_rad: c.nav.yaw_rad(),
            },
        };
        let report = self.keys.press(c, key, &mut target)?;
        if self.keys.is_on() && self.target != Some(target) || !self.is_heading_asked {
            self.hold_at(c, target, self.keys.is_on());
        }
        Ok(report)
    }

    /// Fly to a place.
    ///
    /// # Errors
    /// The reason why not; the old target stays.
    pub fn go_to(&mut self, c: &mut Cockpit<'_>, to: &GoTo) -> Result<(), Refusal> {
        let finite = [to.north_m, to.east_m, to.down_m, to.yaw_rad, to.speed_mps]
            .iter()
            .flatten()
            .all(|v| v.is_finite());
        if !finite {
            return Err(Refusal::BadNumber);
        }
        if to.north_m.is_none()
            && to.east_m.is_none()
            && to.down_m.is_none()
            && to.yaw_rad.is_none()
        {
            self.stop(c);
            return Ok(());
        }
        let now = self.target.unwrap_or_else(|| Target {
            position: c.stopping_point(),
            yaw_rad: c.nav.yaw_rad(),
        });
        let down_m = c.clamped_down_m(to.down_m.unwrap_or_else(|| now.position.z()));
        let position = In::new(
            to.north_m.unwrap_or_else(|| now.position.x()),
            to.east_m.unwrap_or_else(|| now.position.y()),
            down_m,
        );
        if to.north_m.is_none() && to.east_m.is_none() {
            // Only height or heading: no route is needed.
            let target = Target {
                position,
                yaw_rad: to.yaw_rad.unwrap_or(now.yaw_rad),
            };
            self.hold_at(c, target, self.is_heading_asked || to.yaw_rad.is_some());
            return Ok(());
        }
        let goal = Goal {
            position,
            heading: to.yaw_rad,
            speed_mps: to.speed_mps,
        };
        c.navigator
            .set_goal(goal, c.nav)
            .map_err(|e| refusal_of(&e))?;
        self.target = Some(Target {
            position,
            yaw_rad: to.yaw_rad.unwrap_or_else(|| c.nav.yaw_rad()),
        });
        self.is_heading_asked = to.yaw_rad.is_some();
        Ok(())
    }

    /// One tick.
    pub fn step(&mut self, c: &mut Cockpit<'_>) -> Wish {
        if c.air != Air::Flying {
            return Wish::Rest;
        }
        if !c.nav.health.position {
            // The place is not known: stand still by flow and rangers until it is, or until the supervisor lands.
            self.target = None;
            let down_m = *self.down_m.get_or_insert_with(|| c.nav.position.z());
            let down_m = c.clamped_down_m(down_m);
            return Wish::Fly(c.stand_still(down_m, Heading::Rate(0.0)));
        }
        self.down_m = None;
        if self.target.is_none() {
            self.stop(c);
        }
        if let (true, Some(target)) = (self.keys.is_on(), self.target.as_mut())
            && let Some(setpoint) = self.keys.fly(c, target)
        {
            return Wish::Fly(setpoint);
        }
        Wish::Fly(c.navigator.step(c.now, c.nav).setpoint)
    }
}
