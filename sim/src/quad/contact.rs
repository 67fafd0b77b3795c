//! Touching: keeps the vehicle out of walls, people and other vehicles, and counts how often it touched.

use super::{Bump, Quad};
use crate::geometry::{Point, distance};
use crate::world::{Obstacle, World};
use vehicle::{In, MapAnchor, Ned};

/// Meeting the floor faster than this counts as a contact, m/s.
const HARD_LANDING_MPS: f64 = 1.0;
/// An episode of contact ends after this long without touching, s.
const EPISODE_S: f64 = 0.3;
/// Walls farther than this are not looked for, m.
const LOOK_M: f64 = 1.0;
/// Rounds of pushing out, for corners.
const ROUNDS: usize = 4;

/// What the vehicle touches and has touched.
#[derive(Clone, Debug)]
pub(crate) struct Contact {
    in_contact: bool,
    episodes: u32,
    since_touch_s: f64,
    /// Where walls were last looked for, and how far it may move from there before it can reach one.
    looked_at: Point,
    free_m: f64,
    /// Last place known to be outside every wall.
    clear: In<Ned>,
}

impl Contact {
    pub(crate) fn new(quad: &Quad) -> Self {
        Self {
            in_contact: false,
            episodes: 0,
            since_touch_s: f64::INFINITY,
            looked_at: [0.0, 0.0],
            free_m: -1.0,
            clear: quad.position(),
        }
    }

    /// The walls have changed: what was looked at before does not hold.
    pub(crate) const fn look_again(&mut self) {
        self.free_m = -1.0;
    }

    /// After each step of the vehicle.
    pub(crate) fn resolve(
        &mut self,
        quad: &mut Quad,
        bump: Bump,
        world: &World,
        observer: usize,
        anchor: &MapAnchor,
    ) {
        let mut touched = bump.ceiling || bump.floor_mps.is_some_and(|v| v > HARD_LANDING_MPS);
        touched |= self.leave_walls(quad, world, anchor);
        let at = anchor.to_map(quad.position());
        let radius_m = quad.airframe().radius_m;
        if let Some(mover) = world.nearest_mover(observer, at)
            && mover.distance_m < radius_m
        {
            push(quad, &mover, radius_m, anchor);
            // Being shoved must not put it through a wall.
            self.free_m = -1.0;
            self.leave_walls(quad, world, anchor);
            touched = true;
        }
        self.count(touched);
    }

    fn leave_walls(&mut self, quad: &mut Quad, world: &World, anchor: &MapAnchor) -> bool {
        let radius_m = quad.airframe().radius_m;
        let mut touched = false;
        for _ in 0..ROUNDS {
            let at = anchor.to_map(quad.position());
            let p = [at.x(), at.y()];
            if distance(p, self.looked_at) < self.free_m {
                break;
            }
            let wall = world.nearest_wall(p, LOOK_M);
            let wall_m = wall.map_or(LOOK_M, |w| w.distance_m);
            self.looked_at = p;
            self.free_m = wall_m - radius_m;
            match wall {
                Some(wall) if wall_m < radius_m => {
                    touched = true;
                    push(quad, &wall, radius_m, anchor);
                }
                _ => break,
            }
        }
        if !touched {
            self.clear = quad.position();
        } else if self.free_m < -0.5 * radius_m {
            // Squeezed from two sides: stay where there was room.
            quad.stop_at(self.clear);
        }
        touched
    }

    fn count(&mut self, touched: bool) {
        if touched {
            if !self.in_contact {
                self.episodes += 1;
            }
            self.in_contact = true;
            self.since_touch_s = 0.0;
        } else {
            self.since_touch_s += super::STEP_S;
            self.in_contact &= self.since_touch_s < EPISODE_S;
        }
    }

    /// Forgets where walls were looked for, after the vehicle was put elsewhere.
    pub(crate) fn moved(&mut self, quad: &Quad) {
        self.free_m = -1.0;
        self.clear = quad.position();
    }

    pub(crate) const fn in_contact(&self) -> bool {
        self.in_contact
    }

    pub(crate) const fn episodes(&self) -> u32 {
        self.episodes
    }
}

fn push(quad: &mut Quad, obstacle: &Obstacle, radius_m: f64, anchor: &MapAnchor) {
    let [x, y] = obstacle.away;
    let origin = anchor.to_ned(In::zero());
    let away = anchor.to_ned(In::new(x, y, 0.0)) - origin;
    quad.push_out(*away.vector(), radius_m - obstacle.distance_m);
}
