//! Vertical control: height P to climb, climb PI to acceleration. Up is positive here.

use crate::params::ControlParams;
use crate::thrust::HoverThrust;
use vehicle::airframe::GRAVITY_MPS2;

/// Largest acceleration the integral may stand for: 40 % of the weight, for a mass or battery the model does not know.
const INTEGRAL_MAX_MPS2: f64 = 4.0;
/// The hover throttle is only learnt when climb and tilt are below these.
const LEARN_CLIMB_MPS: f64 = 0.2;
const LEARN_TILT_RAD: f64 = 0.17;

/// What is wanted vertically.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Vertical {
    /// Be at this height, m up.
    Height(f64),
    /// Climb at this speed, m/s up.
    Climb(f64),
}

/// The vertical loops.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AltitudeLoop {
    climb_sp: f64,
    integral: f64,
}

impl AltitudeLoop {
    /// Starts from the present climb, m/s up, with `carried_mps2` already known to be needed beyond the hover throttle:
    /// what the pilot's throttle made in a steady flight before.
    pub fn reset(&mut self, climb_mps: f64, carried_mps2: f64) {
        *self = Self {
            climb_sp: if climb_mps.is_finite() {
                climb_mps
            } else {
                0.0
            },
            integral: carried_mps2.clamp(-INTEGRAL_MAX_MPS2, INTEGRAL_MAX_MPS2),
        };
    }

    /// Upward acceleration to ask for beyond carrying the weight, m/s2.
    pub fn step(
        &mut self,
        p: &ControlParams,
        dt_s: f64,
        height_m: f64,
        climb_mps: f64,
        wanted: Vertical,
    ) -> f64 {
        let wanted = match wanted {
            Vertical::Height(h) => p.z_p * (h - height_m),
            Vertical::Climb(c) => c,
        };
        let wanted =
            if wanted.is_finite() { wanted } else { 0.0 }.clamp(-p.z_vel_max_dn, p.z_vel_max_up);
        let before = self.climb_sp;
        let step = p.acc_vert * dt_s;
        self.climb_sp += (wanted - before).clamp(-step, step);
        let slope = (self.climb_sp - before) / dt_s;

        let error = self.climb_sp - climb_mps;
        let raw = p.z_vel_p * error + self.integral + 0.5 * slope;
        let (low, high) = (-(1.0 - p.thrust_min) * GRAVITY_MPS2, 0.6 * GRAVITY_MPS2);
        let demand = raw.clamp(low, high);
        let saturated_outward = (raw > high && error > 0.0) || (raw < low && error < 0.0);
        if !saturated_outward {
            self.integral = (self.integral + p.z_vel_i * error * dt_s)
                .clamp(-INTEGRAL_MAX_MPS2, INTEGRAL_MAX_MPS2);
        }
        demand
    }

    /// Moves what the integral has found out slowly into the hover throttle; the sum of both does not change, so nothing
    /// is felt. A sagging battery and a wrong mass end up there.
    pub fn teach(
        &mut self,
        p: &ControlParams,
        dt_s: f64,
        climb_mps: f64,
        tilt_rad: f64,
        hover: &mut HoverThrust,
    ) {
        if climb_mps.abs() < LEARN_CLIMB_MPS && tilt_rad < LEARN_TILT_RAD {
            let part = self.integral * (dt_s / p.hover_learn_s).min(1.0);
            let taken = hover.scale_weight(p, 1.0 + part / GRAVITY_MPS2);
            self.integral -= (taken - 1.0) * GRAVITY_MPS2;
        }
    }

    /// Climb asked for after shaping, m/s up.
    #[must_use]
    pub const fn climb_sp(&self) -> f64 {
        self.climb_sp
    }
}
