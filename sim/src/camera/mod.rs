//! A forward-looking camera on a vehicle: what a person would see from there.
//!
//! ```text
//! Simulator::shot --> Shot (pose, who else is there) --> Camera::render --> Picture (I420) --> stamp
//! ```
//!
//! All walls reach from floor to ceiling and stand upright, so that one ray per direction on the plan tells the nearest wall for every
//! pixel of that direction, whatever the tilt: [`Camera`] casts a fan of rays and then only looks up. Surfaces have patterns, so that
//! motion is seen: tiles on the floor, panels and skirting on walls, boards on furniture, lamps on the ceiling.
//!
//! | File | Holds |
//! | --- | --- |
//! | `scenery` | what does not move, with its colours |
//! | `fan` | the nearest wall and the nearest mover by direction |
//! | `render` | pixels |
//! | `picture` | a picture in I420, as encoders take it |
//! | `stamp` | the clock in the picture, for people and for machines |
//!
//! ```
//! use sim::camera::{Camera, Picture};
//! use sim::{Room, SimConfig, Simulator};
//! use vehicle::RingConfig;
//!
//! let sim = Simulator::new(SimConfig::new(Room::named("office")?, RingConfig::built_in("tof32")?, 1))?;
//! let mut picture = Picture::new(640, 480);
//! Camera::new(sim.scenery()).render(&sim.shot(0), &mut picture);
//! assert!(picture.y.iter().any(|y| *y > 100));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod fan;
mod picture;
mod render;
mod scenery;
mod stamp;
#[cfg(test)]
mod tests;

pub use picture::Picture;
pub use render::Camera;
pub use scenery::Scenery;
pub use stamp::{BLOCKS, read_stamp, stamp};

use arrayvec::ArrayVec;
use vehicle::{In, Map, Timestamp};

/// People and other vehicles in a shot at most.
pub const MOVERS: usize = 16;
/// Half of the horizontal angle of view, as its tangent: 80 degrees in all.
pub const HALF_VIEW: f64 = 0.84;
/// How far ahead of the body's centre the lens sits, m.
pub const LENS_AHEAD_M: f64 = 0.08;

/// Where a camera is, and who else is in the room.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// When, virtual time.
    pub at: Timestamp,
    /// The lens; z is the height above the floor, m.
    pub eye: In<Map>,
    /// Forward, right and down of the body, as plan directions of length 1.
    pub axes: [In<Map>; 3],
    /// Who else is there.
    pub movers: ArrayVec<Mover, MOVERS>,
}

/// Somebody or something upright and round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mover {
    /// Plan metres.
    pub centre: [f64; 2],
    /// m.
    pub radius_m: f64,
    /// Lower and upper end above the floor, m.
    pub heights_m: [f64; 2],
    /// A person; else a vehicle.
    pub is_person: bool,
}
