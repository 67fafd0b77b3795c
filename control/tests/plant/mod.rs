//! A small quadcopter of its own for closed-loop tests: double integrator, second-order attitude, motor lag, dead time.
//! It shares no formula with the crate under test.

use std::collections::VecDeque;
use vehicle::{Frd, In, NavHealth, NavState, Ned, Rot, Sticks, Timestamp};

const G: f64 = 9.80665;
const STEP_S: f64 = 0.001;
const FLOOR_M: f64 = 0.05;

/// What can be wrong with the vehicle.
#[derive(Clone, Debug)]
pub(crate) struct Plant {
    pub(crate) mass_kg: f64,
    pub(crate) max_thrust_n: f64,
    pub(crate) dead_time_s: f64,
    /// Share of thrust lost per second (battery).
    pub(crate) sag_per_s: f64,
    /// Steady horizontal push, N.
    pub(crate) gust_n: [f64; 2],
    /// Offset of the flight controller's level, rad (roll, pitch).
    pub(crate) trim_rad: [f64; 2],
    pub(crate) position: [f64; 3],
    pub(crate) velocity: [f64; 3],
    pub(crate) yaw: f64,
    tilt: [f64; 2],
    tilt_rate: [f64; 2],
    yaw_rate: f64,
    command: f64,
    battery: f64,
    specific_force: f64,
    queue: VecDeque<Sticks>,
    time_s: f64,
}

impl Plant {
    pub(crate) fn new() -> Self {
        Self {
            mass_kg: 0.6,
            max_thrust_n: 18.0,
            dead_time_s: 0.06,
            sag_per_s: 0.0,
            gust_n: [0.0; 2],
            trim_rad: [0.0; 2],
            position: [0.0, 0.0, -FLOOR_M],
            velocity: [0.0; 3],
            yaw: 0.0,
            tilt: [0.0; 2],
            tilt_rate: [0.0; 2],
            yaw_rate: 0.0,
            command: 0.0,
            battery: 1.0,
            specific_force: G,
            queue: VecDeque::new(),
            time_s: 0.0,
        }
    }

    /// Hovering at a place.
    pub(crate) fn hovering(position: [f64; 3]) -> Self {
        let mut p = Self {
            position,
            ..Self::new()
        };
        p.command = (p.mass_kg * G / p.max_thrust_n).sqrt();
        p
    }

    pub(crate) fn on_floor(&self) -> bool {
        -self.position[2] <= FLOOR_M + 1e-6
    }

    /// Flies with these sticks for a while.
    pub(crate) fn fly(&mut self, sticks: Sticks, seconds: f64) {
        for _ in 0..(seconds / STEP_S).round() as usize {
            self.queue.push_back(sticks);
            let delayed = (self.dead_time_s / STEP_S).round() as usize;
            let acting = if self.queue.len() > delayed {
                self.queue.pop_front()
            } else {
                self.queue.front().copied()
            };
            self.step(acting.unwrap_or(sticks));
        }
    }

    fn step(&mut self, s: Sticks) {
        let angle = |x: f64| 60_f64.to_radians() * (70.0 * x + 600.0 * x * x.abs()) / 670.0;
        let target = [
            angle(s.roll) + self.trim_rad[0],
            angle(s.pitch) + self.trim_rad[1],
        ];
        // Second order, 15 rad/s, damping 0.8: 63 % after about 0.1 s.
        for ((tilt, rate), target) in self.tilt.iter_mut().zip(&mut self.tilt_rate).zip(target) {
            let accel = 225.0 * (target - *tilt) - 2.0 * 0.8 * 15.0 * *rate;
            *rate += accel * STEP_S;
            *tilt += *rate * STEP_S;
        }
        let yaw_target = (70.0 * s.yaw + 600.0 * s.yaw * s.yaw.abs()).to_radians();
        self.yaw_rate += (yaw_target - self.yaw_rate) * STEP_S / 0.08;
        self.yaw += self.yaw_rate * STEP_S;

        self.command += (0.055 + 0.945 * s.throttle - self.command) * STEP_S / 0.04;
        self.battery -= self.sag_per_s * STEP_S;
        let thrust = self.max_thrust_n * self.battery * self.command * self.command;
        let (roll, pitch) = (self.tilt[0], self.tilt[1]);
        let up = [
            -roll.cos() * pitch.sin() * self.yaw.cos() + -roll.sin() * self.yaw.sin(),
            -roll.cos() * pitch.sin() * self.yaw.sin() + roll.sin() * self.yaw.cos(),
            -roll.cos() * pitch.cos(),
        ];
        let mut accel = [
            up[0] * thrust / self.mass_kg + self.gust_n[0] / self.mass_kg - 0.25 * self.velocity[0],
            up[1] * thrust / self.mass_kg + self.gust_n[1] / self.mass_kg - 0.25 * self.velocity[1],
            up[2] * thrust / self.mass_kg + G - 0.25 * self.velocity[2],
        ];
        self.specific_force = thrust / self.mass_kg;
        if self.position[2] >= -FLOOR_M && accel[2] >= 0.0 {
            self.specific_force = G;
            self.position[2] = -FLOOR_M;
            (accel, self.velocity) = ([0.0; 3], [0.0; 3]);
        }
        for ((p, v), a) in self.position.iter_mut().zip(&mut self.velocity).zip(accel) {
            *v += a * STEP_S;
            *p += *v * STEP_S;
        }
        if self.position[2] > -FLOOR_M {
            self.position[2] = -FLOOR_M;
            self.velocity[2] = 0.0;
        }
        self.time_s += STEP_S;
    }

    /// What a perfect estimator says.
    pub(crate) fn nav(&self) -> NavState {
        let level_roll = self.tilt[0] - self.trim_rad[0];
        let level_pitch = self.tilt[1] - self.trim_rad[1];
        NavState {
            at: Timestamp::from_us((self.time_s * 1e6) as u64),
            position: In::<Ned>::from(self.position),
            velocity: In::from(self.velocity),
            attitude: Rot::<Frd, Ned>::from_roll_pitch_yaw(level_roll, level_pitch, self.yaw),
            accel_mps2: In::new(0.0, 0.0, -self.specific_force),
            height_m: -self.position[2],
            position_std_m: In::new(0.02, 0.02, 0.02),
            health: NavHealth {
                attitude: true,
                height: true,
                velocity: true,
                position: true,
            },
            ..NavState::default()
        }
    }

    pub(crate) fn now(&self) -> Timestamp {
        Timestamp::from_us((self.time_s * 1e6) as u64)
    }
}
