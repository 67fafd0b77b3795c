//! From what the autopilot wants to the set point that the law tracks, sample by sample.
//!
//! The law follows what moves as it can: places are approached with a limited speed and acceleration and the velocity is given along, so that no
//! step asks motors for more than they have (uQuad's turn 40 % faster than at hover, no more).

use control::state_feedback::StateSetpoint;
use nalgebra::Vector3;
use vehicle::angle::wrap_pi;

/// Largest level speed, m/s, and acceleration, m/s2, of a reference.
const LEVEL: (f64, f64) = (1.0, 0.8);
/// The same for height.
const HEIGHT: (f64, f64) = (0.5, 0.5);
/// Rate of turn, rad/s.
const TURN_RADPS: f64 = 0.7;
/// The reference is never farther from the estimate than this, m: what holds the craft back must not let it run away.
const LEASH_M: f64 = 0.6;

/// What is wanted: x forward at the start (north), y left (west), z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// Be there.
    Place {
        /// m.
        position_m: Vector3<f64>,
        /// Largest level speed, m/s; none = its own.
        speed_mps: Option<f64>,
    },
    /// Move so, m/s; at a height, m, if one is given.
    Move {
        /// World, m/s.
        velocity_mps: Vector3<f64>,
        /// m.
        height_m: Option<f64>,
    },
    /// Lean so, whatever it does to the place; at a height, m.
    Lean {
        /// Right side down, rad.
        psi_rad: f64,
        /// Nose down, rad.
        phi_rad: f64,
        /// m.
        height_m: f64,
    },
    /// Sink from where it is, m/s.
    Sink {
        /// Over this place, m.
        position_m: Vector3<f64>,
        /// m/s, positive.
        speed_mps: f64,
    },
    /// Follow a set point that moves by itself.
    Exactly(StateSetpoint),
}

/// Which way to point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Turn {
    /// There, rad, counter-clockwise from x.
    To(f64),
    /// With a rate, rad/s, counter-clockwise.
    Rate(f64),
}

/// The moving set point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    position_m: Vector3<f64>,
    velocity_mps: Vector3<f64>,
    theta_rad: f64,
    rate_radps: f64,
}

impl Reference {
    /// At rest where the craft is.
    #[must_use]
    pub fn at(state: &[f64; 12]) -> Self {
        Self {
            position_m: Vector3::new(state[0], state[1], state[2]),
            theta_rad: state[5],
            ..Self::default()
        }
    }

    /// Where it is, m.
    #[must_use]
    pub const fn position_m(&self) -> Vector3<f64> {
        self.position_m
    }

    /// Moves for one sample and answers what the law shall track. `hover_radps` goes into the speeds.
    pub fn step(
        &mut self,
        dt_s: f64,
        goal: &Goal,
        turn: Turn,
        state: &[f64; 12],
        hover_radps: f64,
    ) -> StateSetpoint {
        self.turn(dt_s, turn, state[5]);
        let here = Vector3::new(state[0], state[1], state[2]);
        let mut lean = None;
        match *goal {
            Goal::Exactly(setpoint) => {
                self.position_m.copy_from_slice(&setpoint.state[..3]);
                (self.theta_rad, self.rate_radps) = (setpoint.state[5], 0.0);
                self.velocity_mps = Vector3::zeros();
                return setpoint;
            }
            Goal::Place {
                position_m,
                speed_mps,
            } => {
                let off = position_m - self.position_m;
                let level = speed_mps.map_or(LEVEL, |v| (v.clamp(0.05, LEVEL.0), LEVEL.1));
                let wanted = approach(Vector3::new(off.x, off.y, 0.0), level)
                    + approach(Vector3::new(0.0, 0.0, off.z), HEIGHT);
                self.accelerate(dt_s, wanted);
            }
            Goal::Move {
                velocity_mps: v,
                height_m,
            } => {
                let level = Vector3::new(v.x, v.y, 0.0).cap_magnitude(LEVEL.0);
                let climb = match height_m {
                    Some(h) => approach(Vector3::new(0.0, 0.0, h - self.position_m.z), HEIGHT),
                    None => Vector3::new(0.0, 0.0, v.z.clamp(-HEIGHT.0, HEIGHT.0)),
                };
                self.accelerate(dt_s, level + climb);
            }
            Goal::Lean {
                psi_rad,
                phi_rad,
                height_m,
            } => {
                lean = Some((psi_rad, phi_rad));
                let off = Vector3::new(0.0, 0.0, height_m - self.position_m.z);
                self.accelerate(dt_s, approach(off, HEIGHT));
                self.position_m.x = here.x;
                self.position_m.y = here.y;
            }
            Goal::Sink {
                position_m,
                speed_mps,
            } => {
                let off = position_m - self.position_m;
                let level = approach(Vector3::new(off.x, off.y, 0.0), LEVEL);
                let down = Vector3::new(0.0, 0.0, -speed_mps.clamp(0.05, HEIGHT.0));
                self.accelerate(dt_s, level + down);
            }
        }
        self.position_m = here + (self.position_m - here).cap_magnitude(LEASH_M);
        self.setpoint(lean, state, hover_radps)
    }

    fn turn(&mut self, dt_s: f64, turn: Turn, theta_rad: f64) {
        self.rate_radps = match turn {
            Turn::To(to) => {
                let off = wrap_pi(to - self.theta_rad);
                (off / dt_s.max(1e-3)).clamp(-TURN_RADPS, TURN_RADPS)
            }
            Turn::Rate(rate) => rate.clamp(-TURN_RADPS, TURN_RADPS),
        };
        self.theta_rad += self.rate_radps * dt_s;
        let ahead = wrap_pi(self.theta_rad - theta_rad);
        self.theta_rad = theta_rad + ahead.clamp(-LEASH_M, LEASH_M);
    }

    fn accelerate(&mut self, dt_s: f64, wanted: Vector3<f64>) {
        let change = wanted - self.velocity_mps;
        let level = Vector3::new(change.x, change.y, 0.0).cap_magnitude(LEVEL.1 * dt_s);
        let most = HEIGHT.1 * dt_s;
        self.velocity_mps += level + Vector3::new(0.0, 0.0, change.z.clamp(-most, most));
        self.position_m += self.velocity_mps * dt_s;
    }

    fn setpoint(
        &self,
        lean: Option<(f64, f64)>,
        state: &[f64; 12],
        hover_radps: f64,
    ) -> StateSetpoint {
        let mut out = [0.0; 12];
        out[..3].copy_from_slice(self.position_m.as_slice());
        out[5] = self.theta_rad;
        out[8] = self.velocity_mps.z;
        out[11] = self.rate_radps;
        if let Some((psi, phi)) = lean {
            (out[3], out[4]) = (psi, phi);
            // The place and its velocities are what they are: no error, no action.
            (out[6], out[7]) = (state[6], state[7]);
        } else {
            let (s, c) = (libm::sin(state[5]), libm::cos(state[5]));
            let v = self.velocity_mps;
            out[6] = c * v.x + s * v.y;
            out[7] = c * v.y - s * v.x;
        }
        StateSetpoint {
            state: out,
            speeds_radps: [hover_radps; 4],
        }
    }
}

/// Velocity towards a place that is `off` away, with speed and braking limited.
fn approach(off: Vector3<f64>, (speed_mps, accel_mps2): (f64, f64)) -> Vector3<f64> {
    let far_m = off.norm();
    if far_m < 1e-9 {
        return Vector3::zeros();
    }
    // Braking with 0.7 of the acceleration leaves some for what the sample missed; near by, in proportion.
    let braked = libm::sqrt(2.0 * 0.7 * accel_mps2 * far_m).min(2.5 * far_m);
    off * (braked.min(speed_mps) / far_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(goal: Goal, seconds: f64) -> (Reference, Vec<StateSetpoint>) {
        let mut r = Reference::default();
        let mut state = [0.0; 12];
        let mut all = Vec::new();
        for _ in 0..(seconds * 100.0) as u32 {
            let s = r.step(0.01, &goal, Turn::To(0.0), &state, 312.0);
            // A craft that follows perfectly.
            state[..3].copy_from_slice(&s.state[..3]);
            all.push(s);
        }
        (r, all)
    }

    #[test]
    fn a_place_is_reached_without_passing_it() {
        let goal = Goal::Place {
            position_m: Vector3::new(2.0, -1.0, 1.0),
            speed_mps: None,
        };
        let (r, all) = run(goal, 8.0);
        assert!((r.position_m() - Vector3::new(2.0, -1.0, 1.0)).norm() < 0.01);
        for s in &all {
            assert!(s.state[0] < 2.01 && s.state[2] < 1.01);
            assert!(libm::hypot(s.state[6], s.state[7]) <= LEVEL.0 + 1e-9);
        }
    }

    #[test]
    fn velocities_are_the_bodys() {
        let mut r = Reference::default();
        let mut state = [0.0; 12];
        state[5] = core::f64::consts::FRAC_PI_2;
        let goal = Goal::Move {
            velocity_mps: Vector3::new(0.0, 0.5, 0.0),
            height_m: Some(0.0),
        };
        let mut s = r.step(0.01, &goal, Turn::Rate(0.0), &state, 312.0);
        for _ in 0..200 {
            s = r.step(0.01, &goal, Turn::Rate(0.0), &state, 312.0);
        }
        // Nose to the left: what moves left moves forward.
        assert!((s.state[6] - 0.5).abs() < 1e-9 && s.state[7].abs() < 1e-9);
    }

    #[test]
    fn a_craft_that_is_held_back_is_not_left_behind() {
        let mut r = Reference::default();
        let goal = Goal::Place {
            position_m: Vector3::new(50.0, 0.0, 0.0),
            speed_mps: None,
        };
        for _ in 0..3000 {
            let s = r.step(0.01, &goal, Turn::To(3.0), &[0.0; 12], 312.0);
            assert!(s.state[0] <= LEASH_M + 1e-9 && s.state[5].abs() <= LEASH_M + 1e-9);
        }
    }
}
