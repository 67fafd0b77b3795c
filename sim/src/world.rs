//! The world that sensors look at and vehicles collide with: walls, floor, ceiling, people, other vehicles.

use crate::geometry::{self, Point};
use crate::walker::{PERSON_HEIGHT_M, PERSON_RADIUS_M, Walker};
use crate::walls::Walls;
use vehicle::{In, Map, Segment, Timestamp};

/// Height of the ceiling above the floor, m.
pub const CEILING_M: f64 = 2.5;
/// Vehicles are discs of this half height, m: what a ranger at another height can still see.
pub(crate) const VEHICLE_HALF_HEIGHT_M: f64 = 0.10;

/// Walls plus everything that moves.
#[derive(Clone, Debug)]
pub(crate) struct World {
    walls: Walls,
    /// Without glass, if there is any.
    opaque: Option<Walls>,
    people: Vec<Walker>,
    /// People first, then vehicles.
    discs: Vec<Disc>,
}

/// Something upright and round that moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Disc {
    pub(crate) centre: Point,
    pub(crate) radius_m: f64,
    /// Lower and upper end above the floor, m.
    pub(crate) heights_m: [f64; 2],
}

/// Where a ray ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    /// Along the ray, m.
    pub(crate) distance_m: f64,
    /// Cosine of the angle between the ray and the surface normal, 0 (grazing) ..= 1 (head-on).
    pub(crate) incidence_cos: f64,
}

/// The nearest thing to bump into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Obstacle {
    /// From the point asked for to the surface, m; negative inside.
    pub(crate) distance_m: f64,
    /// Direction from the surface to the point, unit length, on the plan.
    pub(crate) away: Point,
}

impl World {
    pub(crate) fn new(
        walls: Walls,
        opaque: Option<Walls>,
        people: Vec<Walker>,
        vehicles: usize,
    ) -> Self {
        let discs = vec![Disc::default(); people.len() + vehicles];
        let mut world = Self {
            walls,
            opaque,
            people,
            discs,
        };
        world.move_people(Timestamp::ZERO);
        world
    }

    /// Something stands there from now on.
    pub(crate) fn raise(&mut self, obstacles: &[Segment]) {
        self.walls = self.walls.with(obstacles);
        self.opaque = self.opaque.take().map(|walls| walls.with(obstacles));
    }

    /// Puts everybody where they are now.
    pub(crate) fn move_people(&mut self, now: Timestamp) {
        for (disc, person) in self.discs.iter_mut().zip(&self.people) {
            *disc = Disc {
                centre: person.at(now),
                radius_m: PERSON_RADIUS_M,
                heights_m: [0.0, PERSON_HEIGHT_M],
            };
        }
    }

    /// Puts a vehicle where it is now.
    pub(crate) fn move_vehicle(&mut self, vehicle: usize, at: In<Map>, radius_m: f64) {
        let half = VEHICLE_HALF_HEIGHT_M;
        self.discs[self.people.len() + vehicle] = Disc {
            centre: [at.x(), at.y()],
            radius_m,
            heights_m: [at.z() - half, at.z() + half],
        };
    }

    /// What light comes back from.
    pub(crate) fn visible_walls(&self) -> &Walls {
        self.opaque.as_ref().unwrap_or(&self.walls)
    }

    /// Everything that moves but vehicle `observer`, people first; true for people.
    pub(crate) fn seen_movers(&self, observer: usize) -> impl Iterator<Item = (bool, &Disc)> {
        let (people, own) = (self.people.len(), self.people.len() + observer);
        let all = self.discs.iter().enumerate();
        all.filter(move |(i, _)| *i != own)
            .map(move |(i, disc)| (i < people, disc))
    }

    pub(crate) fn people(&self) -> impl Iterator<Item = Point> {
        self.discs[..self.people.len()].iter().map(|d| d.centre)
    }

    /// Everything that moves but vehicle `observer`.
    fn movers(&self, observer: usize) -> impl Iterator<Item = &Disc> {
        let own = self.people.len() + observer;
        let all = self.discs.iter().enumerate();
        all.filter(move |(i, _)| *i != own).map(|(_, d)| d)
    }

    /// First surface along a ray (`direction` of length 1) from a sensor of vehicle `observer`, at most `max_m` away.
    pub(crate) fn cast(
        &self,
        observer: usize,
        origin: In<Map>,
        direction: In<Map>,
        max_m: f64,
    ) -> Option<Hit> {
        self.cast_at(&self.walls, observer, origin, direction, max_m)
    }

    /// The same for light, which passes through glass.
    pub(crate) fn cast_light(
        &self,
        observer: usize,
        origin: In<Map>,
        direction: In<Map>,
        max_m: f64,
    ) -> Option<Hit> {
        let walls = self.opaque.as_ref().unwrap_or(&self.walls);
        self.cast_at(walls, observer, origin, direction, max_m)
    }

    fn cast_at(
        &self,
        walls: &Walls,
        observer: usize,
        origin: In<Map>,
        direction: In<Map>,
        max_m: f64,
    ) -> Option<Hit> {
        let start = [origin.x(), origin.y()];
        let level = direction.norm_xy();
        let mut best = Self::cast_floor_and_ceiling(origin.z(), direction.z());
        if level > 1e-6 {
            let flat = [direction.x() / level, direction.y() / level];
            let reach_m = best.map_or(max_m, |b| b.distance_m.min(max_m)) * level;
            if let Some(wall) = walls.cast(start, flat, reach_m) {
                let s = &walls.segments()[wall.segment as usize];
                let along = [s.b[0] - s.a[0], s.b[1] - s.a[1]];
                let length = geometry::distance(s.a, s.b);
                let across = (flat[0] * along[1] - flat[1] * along[0]).abs() / length;
                best = Some(Hit {
                    distance_m: wall.distance_m / level,
                    incidence_cos: across * level,
                });
            }
            for disc in self.movers(observer) {
                let Some(d) = geometry::ray_disc(start, flat, disc.centre, disc.radius_m) else {
                    continue;
                };
                let distance_m = d / level;
                let z = origin.z() + direction.z() * distance_m;
                if (disc.heights_m[0]..=disc.heights_m[1]).contains(&z)
                    && best.is_none_or(|b| distance_m < b.distance_m)
                {
                    let hit = [start[0] + flat[0] * d, start[1] + flat[1] * d];
                    let out = [hit[0] - disc.centre[0], hit[1] - disc.centre[1]];
                    let cos = -(out[0] * flat[0] + out[1] * flat[1]) / disc.radius_m;
                    best = Some(Hit {
                        distance_m,
                        incidence_cos: (cos * level).clamp(0.0, 1.0),
                    });
                }
            }
        }
        best.filter(|b| b.distance_m <= max_m)
    }

    fn cast_floor_and_ceiling(height_m: f64, up: f64) -> Option<Hit> {
        let gap_m = if up < -1e-9 {
            height_m
        } else if up > 1e-9 {
            CEILING_M - height_m
        } else {
            return None;
        };
        Some(Hit {
            distance_m: (gap_m / up.abs()).max(0.0),
            incidence_cos: up.abs(),
        })
    }

    /// The nearest wall within `reach_m`.
    pub(crate) fn nearest_wall(&self, p: Point, reach_m: f64) -> Option<Obstacle> {
        let (distance_m, q) = self.walls.nearest(p, reach_m)?;
        // Exactly on the wall there is no direction; any will do for one step.
        let away = if distance_m > 0.0 {
            [(p[0] - q[0]) / distance_m, (p[1] - q[1]) / distance_m]
        } else {
            [1.0, 0.0]
        };
        Some(Obstacle { distance_m, away })
    }

    /// The nearest person or other vehicle at this height.
    pub(crate) fn nearest_mover(&self, observer: usize, at: In<Map>) -> Option<Obstacle> {
        let half = VEHICLE_HALF_HEIGHT_M;
        let mut best: Option<Obstacle> = None;
        for disc in self.movers(observer) {
            let [low, high] = disc.heights_m;
            if at.z() + half < low || at.z() - half > high {
                continue;
            }
            let p = [at.x(), at.y()];
            let d = geometry::distance(p, disc.centre);
            let distance_m = d - disc.radius_m;
            if best.is_none_or(|b| distance_m < b.distance_m) {
                let away = if d > 0.0 {
                    [(p[0] - disc.centre[0]) / d, (p[1] - disc.centre[1]) / d]
                } else {
                    [1.0, 0.0]
                };
                best = Some(Obstacle { distance_m, away });
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;
    use core::time::Duration;
    use vehicle::Segment;

    fn world() -> World {
        let wall = Segment {
            a: [3.0, -5.0],
            b: [3.0, 5.0],
        };
        let person = Walker {
            path: vec![[-2.0, 0.0]],
            speed_mps: 0.0,
            start: Duration::ZERO,
            then: crate::Then::Stay,
        };
        let mut world = World::new(Walls::new(vec![wall]), None, vec![person], 2);
        world.move_vehicle(0, In::new(0.0, 0.0, 1.0), 0.16);
        world.move_vehicle(1, In::new(0.0, 2.0, 1.05), 0.16);
        world
    }

    fn cast(direction: [f64; 3]) -> Option<Hit> {
        let d = In::<Map>::from(direction);
        world().cast(0, In::new(0.0, 0.0, 1.0), d / d.norm(), 10.0)
    }

    #[test]
    fn a_ray_ends_at_wall_person_vehicle_floor_or_ceiling() {
        let hit = |d| cast(d).unwrap().distance_m;
        assert_abs_diff_eq!(hit([1.0, 0.0, 0.0]), 3.0, epsilon = 1e-9);
        assert_abs_diff_eq!(hit([-1.0, 0.0, 0.0]), 1.75, epsilon = 1e-9);
        assert_abs_diff_eq!(hit([0.0, 1.0, 0.0]), 1.84, epsilon = 1e-9);
        assert_abs_diff_eq!(hit([0.0, 0.0, -1.0]), 1.0, epsilon = 1e-9);
        assert_abs_diff_eq!(hit([0.0, 0.0, 1.0]), 1.5, epsilon = 1e-9);
        assert_eq!(cast([0.0, -1.0, 0.0]), None);
    }

    #[test]
    fn a_tilted_ray_meets_the_floor_before_the_wall() {
        let steep = cast([1.0, 0.0, -1.0]).unwrap();
        assert_abs_diff_eq!(steep.distance_m, libm::sqrt(2.0), epsilon = 1e-9);
        assert_abs_diff_eq!(steep.incidence_cos, libm::sqrt(0.5), epsilon = 1e-9);
        // The other vehicle lies 0.1 m higher at most: a ray that passes above it goes on.
        assert!(cast([0.0, 1.0, 0.2]).unwrap().distance_m > 2.0);
    }

    #[test]
    fn incidence_is_the_cosine_to_the_normal() {
        let slanted = cast([1.0, 1.0, 0.0]).unwrap();
        assert_abs_diff_eq!(slanted.incidence_cos, libm::sqrt(0.5), epsilon = 1e-9);
        assert_abs_diff_eq!(
            cast([-1.0, 0.0, 0.0]).unwrap().incidence_cos,
            1.0,
            epsilon = 1e-9
        );
    }

    #[test]
    fn nearest_mover_is_measured_to_its_surface_and_only_at_its_height() {
        let near = world().nearest_mover(0, In::new(0.0, 1.0, 1.0)).unwrap();
        assert_abs_diff_eq!(near.distance_m, 0.84, epsilon = 1e-9);
        assert_abs_diff_eq!(near.away[1], -1.0, epsilon = 1e-9);
        assert_eq!(world().nearest_mover(0, In::new(0.0, 1.0, 2.2)), None);
    }
}
