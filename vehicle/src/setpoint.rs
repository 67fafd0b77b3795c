//! What the vehicle shall do next: the one active set point, made only by the arbiter, consumed by control.

use crate::{In, Ned, Sticks};
use serde::{Deserialize, Serialize};

/// Which way to point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Heading {
    /// Clockwise from north, rad.
    Yaw(f64),
    /// Clockwise, rad/s.
    Rate(f64),
}

/// The active set point. Altitudes are NED: up is negative.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Setpoint {
    /// Motors off or idle.
    Idle,
    /// Be at a position (m) with a heading.
    Hover {
        /// Where, m.
        position: In<Ned>,
        /// Which way.
        heading: Heading,
    },
    /// Move with a velocity; the planner's output on the way.
    Velocity {
        /// m/s. The vertical part is used when `down_m` is none.
        velocity: In<Ned>,
        /// Height to hold meanwhile, NED down, m.
        down_m: Option<f64>,
        /// Which way.
        heading: Heading,
    },
    /// Tilt directly, rad; thrust directly or height held.
    Attitude {
        /// Right side down +, rad.
        roll_rad: f64,
        /// Nose up +, rad.
        pitch_rad: f64,
        /// Which way.
        heading: Heading,
        /// What lifts.
        lift: Lift,
    },
    /// Sticks as given (mode Stabilized, RC override of the throttle).
    Sticks(Sticks),
    /// Come down where you are, then stop the motors.
    Land {
        /// Where to come down, m; only x and y matter.
        position: In<Ned>,
        /// Which way.
        heading: Heading,
        /// Speed of descent, m/s, positive.
        descent_mps: f64,
    },
}

/// Vertical part of [`Setpoint::Attitude`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Lift {
    /// Hold this height, NED down, m.
    Height(f64),
    /// Climb (negative) or sink (positive), m/s, NED down.
    Climb(f64),
    /// Thrust as a fraction of the largest, 0..=1.
    Thrust(f64),
}
