//! The aircraft as control and simulation need it.

use serde::{Deserialize, Serialize};

/// Standard gravity, m/s2.
pub const GRAVITY_MPS2: f64 = 9.80665;

/// Mass, size and power of a quadcopter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Airframe {
    /// Take-off mass, kg.
    pub mass_kg: f64,
    /// Largest thrust of all motors together at full battery, N.
    pub max_thrust_n: f64,
    /// Radius that must stay clear of walls, propellers included, m.
    pub radius_m: f64,
    /// Centre to motor axis, m.
    pub arm_m: f64,
    /// Height of the body centre above the floor when landed, m.
    pub landed_height_m: f64,
}

impl Default for Airframe {
    /// A 3-inch indoor quadcopter with a companion computer: 0.6 kg, 4 x 4.5 N (the craft flown against the real
    /// firmware when the protocol facts were measured).
    fn default() -> Self {
        Self {
            mass_kg: 0.6,
            max_thrust_n: 18.0,
            radius_m: 0.16,
            arm_m: 0.11,
            landed_height_m: 0.05,
        }
    }
}
