//! How the vehicle answers a set point: 60 ms of dead time, 0.3 s of lag, at most 3 m/s2.

use std::collections::VecDeque;
use vehicle::{Heading, MapAnchor, Setpoint};

/// Largest acceleration, m/s2.
pub const ACCEL_MAX_MPS2: f64 = 3.0;
/// From a set point to the first change of tilt, s.
pub const DEAD_TIME_S: f64 = 0.06;
/// Time constant of the velocity loop, s.
pub const LAG_S: f64 = 0.3;
/// Position loop, 1/s, and the speed it may ask for, m/s.
const HOVER_GAIN: f64 = 1.3;
const HOVER_MPS: f64 = 1.2;
/// Heading loop, 1/s, its largest rate, rad/s, and lag, s.
const YAW_GAIN: f64 = 1.8;
const YAW_MAX_RADPS: f64 = 1.2;
const YAW_LAG_S: f64 = 0.1;

/// A point with inertia.
#[derive(Clone, Debug)]
pub struct Craft {
    place: [f64; 2],
    velocity: [f64; 2],
    yaw_rad: f64,
    yaw_rate_radps: f64,
    under_way: VecDeque<Setpoint>,
}

impl Craft {
    /// At rest at a place (x, y, yaw).
    #[must_use]
    pub fn at([x, y, yaw_rad]: [f64; 3]) -> Self {
        Self {
            place: [x, y],
            velocity: [0.0; 2],
            yaw_rad,
            yaw_rate_radps: 0.0,
            under_way: VecDeque::with_capacity(8),
        }
    }

    /// m.
    #[must_use]
    pub const fn place(&self) -> [f64; 2] {
        self.place
    }

    /// m/s.
    #[must_use]
    pub const fn velocity(&self) -> [f64; 2] {
        self.velocity
    }

    /// Counter-clockwise from x, rad.
    #[must_use]
    pub const fn yaw_rad(&self) -> f64 {
        self.yaw_rad
    }

    /// Counter-clockwise, rad/s.
    #[must_use]
    pub const fn yaw_rate_radps(&self) -> f64 {
        self.yaw_rate_radps
    }

    /// One step towards a set point.
    pub fn step(&mut self, setpoint: &Setpoint, anchor: &MapAnchor, dt_s: f64) {
        self.under_way.push_back(*setpoint);
        let delay = libm::round(DEAD_TIME_S / dt_s) as usize;
        let acting = if self.under_way.len() > delay {
            self.under_way.pop_front().unwrap_or(Setpoint::Idle)
        } else {
            Setpoint::Idle
        };
        let (wanted, heading) = self.wanted(&acting, anchor);
        let mut a = [0, 1].map(|i| (wanted[i] - self.velocity[i]) / LAG_S);
        let size = libm::hypot(a[0], a[1]);
        if size > ACCEL_MAX_MPS2 {
            a = a.map(|v| v * ACCEL_MAX_MPS2 / size);
        }
        for ((place, velocity), a) in self.place.iter_mut().zip(&mut self.velocity).zip(a) {
            *velocity += a * dt_s;
            *place += *velocity * dt_s;
        }
        let rate = match heading {
            Heading::Yaw(ned) => {
                let turn = vehicle::angle::wrap_pi(anchor.yaw_to_map(ned) - self.yaw_rad);
                (YAW_GAIN * turn).clamp(-YAW_MAX_RADPS, YAW_MAX_RADPS)
            }
            Heading::Rate(r) => -r,
        };
        self.yaw_rate_radps += (rate - self.yaw_rate_radps) * dt_s / YAW_LAG_S;
        self.yaw_rad += self.yaw_rate_radps * dt_s;
    }

    /// The velocity a set point asks for, m/s.
    fn wanted(&self, setpoint: &Setpoint, anchor: &MapAnchor) -> ([f64; 2], Heading) {
        match *setpoint {
            Setpoint::Hover { position, heading } => {
                let to = anchor.to_map(position);
                let v = [to.x() - self.place[0], to.y() - self.place[1]].map(|d| HOVER_GAIN * d);
                let share = (HOVER_MPS / libm::hypot(v[0], v[1]).max(1e-9)).min(1.0);
                (v.map(|v| v * share), heading)
            }
            Setpoint::Velocity {
                velocity, heading, ..
            } => {
                let v = anchor.vector_to_map(velocity);
                ([v.x(), v.y()], heading)
            }
            _ => ([0.0; 2], Heading::Rate(0.0)),
        }
    }
}
