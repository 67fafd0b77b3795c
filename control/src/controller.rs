//! One control step: set point and state in, sticks out.

mod family;
mod horizontal;
mod trusted;
mod vertical;

use crate::altitude::AltitudeLoop;
use crate::heading::HeadingLoop;
use crate::lateness::Lateness;
use crate::outer_lqr::OuterLqr;
use crate::params::ControlParams;
use crate::position::PositionLoop;
use crate::snsi::law::SnsiLaw;
use crate::stick_curve::StickCurve;
use crate::takeoff_land::{Schedule, SpoolUp, Touchdown};
use crate::thrust::HoverThrust;
use serde::{Deserialize, Serialize};
use trusted::{Trusted, finite_or_zero, floor_view};
use vehicle::{Airframe, Heading, In, NavState, Ned, Setpoint, Sticks, Timestamp};
use vertical::LiftDemand;

/// Steps longer than this are taken as this: after a stall the loops continue, they do not leap.
const DT_MAX_S: f64 = 0.1;
const DT_MIN_S: f64 = 1e-4;

/// Where in a flight the vehicle is; the supervisor says so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// Disarmed or armed at idle: sticks idle, every loop reset.
    #[default]
    Idle,
    /// Armed on the floor and told to take off: the throttle grows until the floor is left, then the set point is flown.
    SpoolUp,
    /// In the air, or coming down with [`Setpoint::Land`].
    Flying,
}

/// What is really held: less than the set point asks for when the state has lost a part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Hold {
    /// Nothing: motors off or idle.
    #[default]
    Idle,
    /// Sticks passed through.
    Sticks,
    /// Level (or given) attitude, height unknown: a slow descent near the learnt hover throttle.
    Attitude,
    /// Attitude and height.
    Height,
    /// Horizontal velocity and height.
    Velocity,
    /// Position and height.
    Position,
}

/// What a step gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ControlOutput {
    /// For the supervisor, then the flight controller. Always finite and in range.
    pub sticks: Sticks,
    /// Share of the largest thrust this throttle should make, 0..=1.
    pub thrust_fraction: f64,
    /// Roll asked for, right side down +, rad.
    pub roll_sp_rad: f64,
    /// Pitch asked for, nose up +, rad.
    pub pitch_sp_rad: f64,
    /// Heading asked for, clockwise from north, rad.
    pub yaw_sp_rad: f64,
    /// Yaw rate asked for, clockwise, rad/s.
    pub yaw_rate_sp_radps: f64,
    /// Velocity asked for after shaping, NED, m/s.
    pub velocity_sp: In<Ned>,
    /// Acceleration asked for, NED, m/s2.
    pub accel_sp: In<Ned>,
    /// What is really held.
    pub hold: Hold,
    /// In [`Phase::SpoolUp`]: the floor has been left.
    pub lifted_off: bool,
    /// With [`Setpoint::Land`]: the vehicle stands on the floor, thrust is zero, the motors may stop.
    pub landed: bool,
}

/// The outer loops of one vehicle.
#[derive(Clone, Debug)]
pub struct Controller {
    /// As they are set.
    params: ControlParams,
    /// As they are flown with: less gain in a loop that runs late.
    in_force: ControlParams,
    lateness: Lateness,
    airframe: Airframe,
    curve: StickCurve,
    mass_kg: f64,
    hover: HoverThrust,
    position: PositionLoop,
    altitude: AltitudeLoop,
    heading: HeadingLoop,
    spool_up: SpoolUp,
    touchdown: Touchdown,
    schedule: Schedule,
    phase: Phase,
    /// Which loops ran last step: those that start now start from the present motion.
    horizontal_ran: bool,
    vertical_ran: bool,
    heading_ran: bool,
    /// Last throttle, and whether it was somebody's stick: for handing over.
    throttle: f64,
    sticks_flew: bool,
    /// Climb rate, up, m/s: the estimate's, or integrated from the accelerometer since it was lost.
    climb_mps: f64,
    /// LQR on the outer loop; none if its gains cannot be made.
    outer: Option<OuterLqr>,
    /// SNSI's family.
    snsi: SnsiLaw,
    /// SNSI's family flew last step.
    snsi_ran: bool,
}

impl Controller {
    /// A controller on the floor, everything at rest.
    #[must_use]
    pub fn new(params: ControlParams, airframe: Airframe) -> Self {
        let mass_kg = mass_of(&params, &airframe);
        Self {
            curve: StickCurve::new(&params),
            hover: HoverThrust::new(&params, &airframe, mass_kg),
            mass_kg,
            in_force: params.clone(),
            params,
            lateness: Lateness::default(),
            airframe,
            position: PositionLoop::default(),
            altitude: AltitudeLoop::default(),
            heading: HeadingLoop::default(),
            spool_up: SpoolUp::default(),
            touchdown: Touchdown::default(),
            schedule: Schedule::default(),
            phase: Phase::Idle,
            horizontal_ran: false,
            vertical_ran: false,
            heading_ran: false,
            throttle: 0.0,
            sticks_flew: false,
            climb_mps: 0.0,
            outer: OuterLqr::new().ok(),
            snsi: SnsiLaw::default(),
            snsi_ran: false,
        }
    }

    /// New tuning, in flight too: loops keep their state, what was learnt is kept; a changed `VEH_MASS` scales the hover
    /// throttle, a changed `MPC_THR_HOVER` or thrust model restarts its learning.
    pub fn set_params(&mut self, params: ControlParams) {
        let changed =
            |of: fn(&ControlParams) -> f64| (of(&params) - of(&self.in_force)).abs() > 1e-9;
        let model_changed = changed(|p| p.hover_throttle)
            || changed(|p| p.thrust_exponent)
            || changed(|p| p.motor_idle);
        let mass_changed =
            (mass_of(&params, &self.airframe) - mass_of(&self.in_force, &self.airframe)).abs()
                > 1e-9;
        self.in_force = params.clone();
        self.params = params;
        self.curve = StickCurve::new(&self.in_force);
        if mass_changed {
            self.set_mass(mass_of(&self.in_force, &self.airframe));
        }
        if model_changed {
            self.hover = HoverThrust::new(&self.in_force, &self.airframe, self.mass_kg);
        }
    }

    /// The tuning as it is set.
    #[must_use]
    pub const fn params(&self) -> &ControlParams {
        &self.params
    }

    /// Tells the thrust model another mass, kg (keys i, k and 0): the hover throttle changes at once in proportion.
    pub fn set_mass(&mut self, mass_kg: f64) {
        if mass_kg.is_finite() && mass_kg > 0.0 {
            self.hover
                .scale_weight(&self.in_force, mass_kg / self.mass_kg);
            self.mass_kg = mass_kg;
        }
    }

    /// Mass the thrust model believes, kg.
    #[must_use]
    pub const fn mass_kg(&self) -> f64 {
        self.mass_kg
    }

    /// Throttle stick that hovers, as learnt so far, 0..=1.
    #[must_use]
    pub fn hover_throttle(&self) -> f64 {
        self.hover.throttle_of_lift(&self.in_force, 1.0)
    }

    /// Forgets integrals and set-point history and starts from the present motion without a jump: for a jump of the state
    /// estimate (relocalisation). A change of set point needs no reset.
    pub fn reset(&mut self, nav: &NavState) {
        self.position.reset(nav);
        self.altitude.reset(-nav.velocity.z(), 0.0);
        self.heading.reset(nav.yaw_rad());
        self.start_outer_level();
        if let Some(outer) = &mut self.outer {
            outer.height.reset(0.0);
        }
    }

    /// One step. `dt_s` is the time since the last one; 40 to 250 Hz. In a loop that is late again and again the gains shrink
    /// ([`crate::lateness`]).
    ///
    /// What the state has lost (see [`vehicle::NavHealth`]) is not flown on: without position the velocity is held,
    /// without velocity a level attitude, without height a slow descent. Whatever the inputs, the sticks are finite and in
    /// range.
    pub fn step(
        &mut self,
        now: Timestamp,
        dt_s: f64,
        nav: &NavState,
        setpoint: &Setpoint,
        phase: Phase,
    ) -> ControlOutput {
        if dt_s.is_finite() && dt_s > 0.0 {
            self.in_force = self.params.taken_back(self.lateness.step(dt_s));
        }
        let dt_s = if dt_s.is_finite() {
            dt_s.clamp(DT_MIN_S, DT_MAX_S)
        } else {
            DT_MIN_S
        };
        if phase != self.phase {
            tracing::debug!(?phase, from = ?self.phase, at_s = now.s(), "control phase");
            if phase != Phase::Flying || self.phase == Phase::Idle {
                self.spool_up = SpoolUp::default();
                self.touchdown = Touchdown::default();
            }
            self.phase = phase;
        }
        let trusted = Trusted::of(nav);
        self.follow_climb(dt_s, nav, &trusted);
        match (phase, setpoint) {
            (Phase::Idle, _) | (_, Setpoint::Idle) => self.idle(nav),
            (_, Setpoint::Sticks(sticks)) => self.pass_sticks(*sticks),
            (Phase::SpoolUp, _) if !self.spool_up.lifted_off() => self.spool(dt_s, nav, &trusted),
            _ => self.fly(dt_s, nav, &trusted, setpoint),
        }
    }

    fn idle(&mut self, nav: &NavState) -> ControlOutput {
        (
            self.horizontal_ran,
            self.vertical_ran,
            self.heading_ran,
            self.sticks_flew,
        ) = (false, false, false, false);
        ControlOutput {
            yaw_sp_rad: finite_or_zero(nav.yaw_rad()),
            ..ControlOutput::default()
        }
    }

    fn pass_sticks(&mut self, sticks: Sticks) -> ControlOutput {
        (self.horizontal_ran, self.vertical_ran, self.heading_ran) = (false, false, false);
        let sticks = sticks.clamped();
        (self.throttle, self.sticks_flew) = (sticks.throttle, true);
        ControlOutput {
            sticks,
            thrust_fraction: HoverThrust::fraction_of_throttle(&self.in_force, sticks.throttle),
            roll_sp_rad: self.curve.angle_of_stick(sticks.roll),
            pitch_sp_rad: self.curve.angle_of_stick(sticks.pitch),
            yaw_rate_sp_radps: self.curve.yaw_rate_of_stick(sticks.yaw),
            hold: Hold::Sticks,
            ..ControlOutput::default()
        }
    }

    /// On the floor with the throttle growing: level, no turn.
    fn spool(&mut self, dt_s: f64, nav: &NavState, trusted: &Trusted) -> ControlOutput {
        let view = floor_view(nav, trusted, self.climb_mps);
        let lift = self.spool_up.step(&self.in_force, dt_s, &view);
        let throttle = self.hover.throttle_of_lift(&self.in_force, lift);
        if self.spool_up.lifted_off() {
            let ratio = self.spool_up.weight_found();
            self.hover.scale_weight(&self.in_force, ratio);
        }
        (self.horizontal_ran, self.vertical_ran, self.heading_ran) = (false, false, false);
        self.emit(Wanted {
            throttle,
            hold: Hold::Attitude,
            yaw_sp_rad: finite_or_zero(nav.yaw_rad()),
            ..Wanted::default()
        })
    }

    fn fly(
        &mut self,
        dt_s: f64,
        nav: &NavState,
        trusted: &Trusted,
        setpoint: &Setpoint,
    ) -> ControlOutput {
        let landing = matches!(setpoint, Setpoint::Land { .. });
        if !landing {
            self.touchdown = Touchdown::default();
            self.schedule = Schedule::default();
        }
        let heading = match setpoint {
            Setpoint::Hover { heading, .. }
            | Setpoint::Velocity { heading, .. }
            | Setpoint::Attitude { heading, .. }
            | Setpoint::Land { heading, .. } => *heading,
            Setpoint::Idle | Setpoint::Sticks(_) => Heading::Rate(0.0),
        };
        let yaw_rate = self.turn(dt_s, nav, trusted, heading);
        let horizontal = self.horizontal(dt_s, nav, trusted, setpoint);
        let vertical = self.vertical(dt_s, nav, trusted, setpoint);
        let throttle = match vertical.lift {
            LiftDemand::Throttle(throttle) => throttle,
            LiftDemand::Weights(lift) => {
                let lift = if landing {
                    let view = floor_view(nav, trusted, self.climb_mps);
                    self.touchdown
                        .step(dt_s, &view, self.airframe.landed_height_m, lift)
                } else {
                    lift
                };
                if self.touchdown.landed() {
                    0.0
                } else {
                    self.hover.throttle_of_lift(&self.in_force, lift)
                }
            }
        };
        let on_floor = self.touchdown.landed();
        let snsi = self.snsi_sticks(nav, trusted, setpoint, &horizontal, throttle);
        let (roll, pitch) = if on_floor {
            (0.0, 0.0)
        } else {
            (horizontal.roll, horizontal.pitch)
        };
        let mut out = self.emit(Wanted {
            roll,
            pitch,
            yaw_rate: if on_floor { 0.0 } else { yaw_rate },
            throttle,
            yaw_sp_rad: self.heading.target_rad(),
            velocity_sp: In::new(
                horizontal.velocity_sp.x,
                horizontal.velocity_sp.y,
                -vertical.climb_sp,
            ),
            accel_sp: In::new(horizontal.accel.x, horizontal.accel.y, -vertical.accel_up),
            hold: if on_floor {
                Hold::Idle
            } else if vertical.height_held {
                horizontal.hold
            } else {
                Hold::Attitude
            },
        });
        if let (Some(sticks), false) = (snsi, on_floor) {
            out.sticks = sticks.clamped();
            self.throttle = out.sticks.throttle;
        }
        out
    }

    fn turn(&mut self, dt_s: f64, nav: &NavState, trusted: &Trusted, heading: Heading) -> f64 {
        if !self.heading_ran {
            self.heading.reset(finite_or_zero(nav.yaw_rad()));
            self.heading_ran = true;
        }
        let heading = if trusted.attitude {
            heading
        } else {
            Heading::Rate(0.0)
        };
        self.heading
            .step(&self.in_force, dt_s, nav.yaw_rad(), heading)
    }

    /// From angles, rate and throttle to an output; the last place where a number could be wrong.
    fn emit(&mut self, w: Wanted) -> ControlOutput {
        let sticks = Sticks {
            roll: self.curve.stick_of_angle(w.roll),
            pitch: self.curve.stick_of_angle(w.pitch),
            yaw: self.curve.stick_of_yaw_rate(w.yaw_rate),
            throttle: w.throttle,
        }
        .clamped();
        (self.throttle, self.sticks_flew) = (sticks.throttle, false);
        ControlOutput {
            sticks,
            thrust_fraction: HoverThrust::fraction_of_throttle(&self.in_force, sticks.throttle),
            roll_sp_rad: w.roll,
            pitch_sp_rad: w.pitch,
            yaw_sp_rad: w.yaw_sp_rad,
            yaw_rate_sp_radps: w.yaw_rate,
            velocity_sp: w.velocity_sp,
            accel_sp: w.accel_sp,
            hold: w.hold,
            lifted_off: self.spool_up.lifted_off(),
            landed: self.touchdown.landed(),
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Wanted {
    roll: f64,
    pitch: f64,
    yaw_rate: f64,
    throttle: f64,
    yaw_sp_rad: f64,
    velocity_sp: In<Ned>,
    accel_sp: In<Ned>,
    hold: Hold,
}

fn mass_of(p: &ControlParams, airframe: &Airframe) -> f64 {
    if p.mass_kg > 0.0 {
        p.mass_kg
    } else {
        airframe.mass_kg
    }
}
