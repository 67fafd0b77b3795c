//! Height and climb: from a set point to lift, with what holds when the height is lost.

use super::Controller;
use super::trusted::{Trusted, finite_or_zero};
use crate::altitude::Vertical;
use crate::params::Variant;
use crate::thrust::HoverThrust;
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::setpoint::Lift;
use vehicle::{NavState, Setpoint};

/// Sinking speed when no height is known, m/s.
const BLIND_DESCENT_MPS: f64 = 0.4;
/// How long a climb rate integrated from the accelerometer alone is believed, s.
const BLIND_CLIMB_TAU_S: f64 = 2.0;
/// Lift allowed while descending blind, weights: close to hover whatever the estimate says.
const BLIND_LIFT: (f64, f64) = (0.88, 1.06);
/// A pilot's throttle that holds the climb below this is taken for a hover throttle at hand-over, m/s.
const STEADY_CLIMB_MPS: f64 = 0.15;

#[derive(Clone, Copy, Debug)]
pub(super) enum LiftDemand {
    /// Multiples of the weight.
    Weights(f64),
    /// Throttle stick.
    Throttle(f64),
}

#[derive(Clone, Copy, Debug)]
pub(super) struct VerticalDemand {
    pub(super) lift: LiftDemand,
    pub(super) climb_sp: f64,
    pub(super) accel_up: f64,
    pub(super) height_held: bool,
}

impl Controller {
    pub(super) fn vertical(
        &mut self,
        dt_s: f64,
        nav: &NavState,
        trusted: &Trusted,
        setpoint: &Setpoint,
    ) -> VerticalDemand {
        let p = &self.params;
        let wanted = match *setpoint {
            Setpoint::Attitude {
                lift: Lift::Thrust(fraction),
                ..
            } => {
                self.vertical_ran = false;
                return VerticalDemand {
                    lift: LiftDemand::Throttle(HoverThrust::throttle_of_fraction(
                        p,
                        finite_or_zero(fraction),
                    )),
                    climb_sp: 0.0,
                    accel_up: 0.0,
                    height_held: true,
                };
            }
            Setpoint::Hover { position, .. } => Vertical::Height(-position.z()),
            Setpoint::Velocity {
                down_m: Some(d), ..
            }
            | Setpoint::Attitude {
                lift: Lift::Height(d),
                ..
            } => Vertical::Height(-d),
            Setpoint::Velocity { velocity, .. } => Vertical::Climb(-velocity.z()),
            Setpoint::Attitude {
                lift: Lift::Climb(v),
                ..
            } => Vertical::Climb(-v),
            Setpoint::Land { descent_mps, .. } => {
                let slow = nav.height_m < p.land_slow_m + self.airframe.landed_height_m;
                let speed = finite_or_zero(descent_mps).clamp(0.05, p.z_vel_max_dn);
                let speed = if slow {
                    speed.min(p.land_crawl_mps)
                } else {
                    speed
                };
                let behind_m = if trusted.height {
                    self.schedule.step(dt_s, speed, nav.height_m)
                } else {
                    0.0
                };
                Vertical::Climb(-speed - p.z_p * behind_m)
            }
            Setpoint::Idle | Setpoint::Sticks(_) => Vertical::Climb(0.0),
        };
        if !trusted.height {
            self.vertical_ran = false;
            let correction = 0.15 * (-BLIND_DESCENT_MPS - self.climb_mps);
            return VerticalDemand {
                lift: LiftDemand::Weights((1.0 + correction).clamp(BLIND_LIFT.0, BLIND_LIFT.1)),
                climb_sp: -BLIND_DESCENT_MPS,
                accel_up: 0.0,
                height_held: false,
            };
        }
        if !self.vertical_ran {
            self.altitude.reset(self.climb_mps, self.handed_over_mps2());
            self.vertical_ran = true;
        }
        let height_m = -nav.position.z();
        let accel_up = self
            .altitude
            .step(p, dt_s, height_m, self.climb_mps, wanted);
        let tilt_rad = if trusted.attitude {
            nav.attitude.tilt()
        } else {
            0.0
        };
        if !matches!(setpoint, Setpoint::Land { .. }) {
            self.altitude
                .teach(p, dt_s, self.climb_mps, tilt_rad, &mut self.hover);
        }
        let mut accel_up = accel_up;
        if self.params.variant == Variant::Lqr
            && let (Vertical::Height(goal_m), Some(outer)) = (wanted, &mut self.outer)
            && goal_m.is_finite()
        {
            let felt_up = -(nav.attitude * nav.accel_mps2).z() - GRAVITY_MPS2;
            let error = height_m - goal_m;
            let most = self.params.acc_vert;
            accel_up = outer.height.step(
                dt_s,
                Some(error),
                self.climb_mps,
                finite_or_zero(felt_up),
                most,
            );
            if self.climb_mps.abs() < STEADY_CLIMB_MPS && tilt_rad < 0.17 {
                let share = (dt_s / self.params.hover_learn_s).min(1.0);
                let given = outer.height.give(share);
                self.hover
                    .scale_weight(&self.params, 1.0 + given / GRAVITY_MPS2);
            }
        }
        let weights = 1.0 + accel_up / GRAVITY_MPS2;
        VerticalDemand {
            lift: LiftDemand::Weights(weights / libm::cos(tilt_rad).max(0.7)),
            climb_sp: self.altitude.climb_sp(),
            accel_up,
            height_held: true,
        }
    }

    /// Lift beyond the hover throttle that the last throttle made, if it held the vehicle steady: then it is right and the
    /// learnt hover throttle is not.
    fn handed_over_mps2(&self) -> f64 {
        let steady = self.climb_mps.abs() < STEADY_CLIMB_MPS;
        if self.sticks_flew && steady {
            let lift = self.hover.lift_of_throttle(&self.params, self.throttle);
            (lift - 1.0) * GRAVITY_MPS2
        } else {
            0.0
        }
    }

    /// The climb rate: the estimate's while it has one, afterwards integrated from the accelerometer and forgotten.
    pub(super) fn follow_climb(&mut self, dt_s: f64, nav: &NavState, trusted: &Trusted) {
        if trusted.height {
            self.climb_mps = -nav.velocity.z();
        } else {
            let accel_up = if nav.accel_mps2.is_finite() && trusted.attitude {
                -(nav.attitude * nav.accel_mps2).z() - GRAVITY_MPS2
            } else {
                0.0
            };
            self.climb_mps += (accel_up - self.climb_mps / BLIND_CLIMB_TAU_S) * dt_s;
            self.climb_mps = self.climb_mps.clamp(-3.0, 3.0);
        }
    }
}
