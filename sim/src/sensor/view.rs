//! How the vehicle's sensors see the world at one instant.

use crate::quad::Quad;
use crate::world::{Hit, World};
use vehicle::{Frd, In, Map, MapAnchor};

/// Pose of one vehicle on the plan, ready to cast rays from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View<'a> {
    world: &'a World,
    observer: usize,
    position: In<Map>,
    /// Body forward, right, down as plan directions.
    axes: [In<Map>; 3],
}

impl<'a> View<'a> {
    pub(crate) fn new(world: &'a World, observer: usize, quad: &Quad, anchor: &MapAnchor) -> Self {
        let frd_to_ned = quad.attitude();
        let axis = |x, y, z| anchor.vector_to_map(frd_to_ned * In::<Frd>::new(x, y, z));
        Self {
            world,
            observer,
            position: anchor.to_map(quad.position()),
            axes: [
                axis(1.0, 0.0, 0.0),
                axis(0.0, 1.0, 0.0),
                axis(0.0, 0.0, 1.0),
            ],
        }
    }

    /// A point of the body.
    pub(crate) fn point(&self, offset: In<Frd>) -> In<Map> {
        self.position + self.direction(offset)
    }

    /// A direction of the body.
    pub(crate) fn direction(&self, v: In<Frd>) -> In<Map> {
        self.axes[0] * v.x() + self.axes[1] * v.y() + self.axes[2] * v.z()
    }

    /// What a ray of the body meets first.
    pub(crate) fn cast(&self, origin: In<Map>, direction: In<Frd>, max_m: f64) -> Option<Hit> {
        let direction = self.direction(direction);
        self.world.cast(self.observer, origin, direction, max_m)
    }

    /// The same for light, which passes through glass.
    pub(crate) fn cast_light(
        &self,
        origin: In<Map>,
        direction: In<Frd>,
        max_m: f64,
    ) -> Option<Hit> {
        let direction = self.direction(direction);
        self.world
            .cast_light(self.observer, origin, direction, max_m)
    }
}
