//! Return: fly home by a route the plan allows, then land there.

use super::descent::Descent;
use super::{Cockpit, Wish};
use vehicle::In;

/// A way home in progress.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Homeward {
    descent: Option<Descent>,
}

impl Homeward {
    /// One tick.
    pub fn step(&mut self, c: &mut Cockpit<'_>, touched_down: bool) -> Wish {
        let (home, yaw) = (c.home, c.home_yaw_rad);
        let descent = self
            .descent
            .get_or_insert_with(|| Descent::at(In::new(home.x(), home.y(), home.z()), Some(yaw)));
        descent.step(c, touched_down)
    }
}
