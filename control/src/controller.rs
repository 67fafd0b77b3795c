//! One control step: set point and state in, sticks out.

use crate::altitude::{AltitudeLoop, Vertical};
use crate::heading::HeadingLoop;
use crate::outer_lqr::OuterLqr;
use crate::params::{ControlParams, Variant};
use crate::position::{PositionLoop, accel_of_tilt, tilt_of_accel, xy};
use crate::snsi::law::{Seen, SnsiLaw};
use crate::stick_curve::StickCurve;
use crate::takeoff_land::{FloorView, SpoolUp, Touchdown};
use crate::thrust::HoverThrust;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::setpoint::Lift;
use vehicle::{Airframe, Heading, In, NavState, Ned, Setpoint, Sticks, Timestamp};

/// Sinking speed when no height is known, m/s.
const BLIND_DESCENT_MPS: f64 = 0.4;
/// How long a climb rate integrated from the accelerometer alone is believed, s.
const BLIND_CLIMB_TAU_S: f64 = 2.0;
/// Lift allowed while descending blind, weights: close to hover whatever the estimate says.
const BLIND_LIFT: (f64, f64) = (0.88, 1.06);
/// A pilot's throttle that holds the climb below this is taken for a hover throttle at hand-over, m/s.
const STEADY_CLIMB_MPS: f64 = 0.15;
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
    params: ControlParams,
    airframe: Airframe,
    curve: StickCurve,
    mass_kg: f64,
    hover: HoverThrust,
    position: PositionLoop,
    altitude: AltitudeLoop,
    heading: HeadingLoop,
    spool_up: SpoolUp,
    touchdown: Touchdown,
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
            params,
            airframe,
            position: PositionLoop::default(),
            altitude: AltitudeLoop::default(),
            heading: HeadingLoop::default(),
            spool_up: SpoolUp::default(),
            touchdown: Touchdown::default(),
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
        let changed = |of: fn(&ControlParams) -> f64| (of(&params) - of(&self.params)).abs() > 1e-9;
        let model_changed = changed(|p| p.hover_throttle)
            || changed(|p| p.thrust_exponent)
            || changed(|p| p.motor_idle);
        let mass_changed =
            (mass_of(&params, &self.airframe) - mass_of(&self.params, &self.airframe)).abs() > 1e-9;
        self.params = params;
        self.curve = StickCurve::new(&self.params);
        if mass_changed {
            self.set_mass(mass_of(&self.params, &self.airframe));
        }
        if model_changed {
            self.hover = HoverThrust::new(&self.params, &self.airframe, self.mass_kg);
        }
    }

    /// The tuning in use.
    #[must_use]
    pub const fn params(&self) -> &ControlParams {
        &self.params
    }

    /// Tells the thrust model another mass, kg (keys i, k and 0): the hover throttle changes at once in proportion.
    pub fn set_mass(&mut self, mass_kg: f64) {
        if mass_kg.is_finite() && mass_kg > 0.0 {
            self.hover
                .scale_weight(&self.params, mass_kg / self.mass_kg);
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
        self.hover.throttle_of_lift(&self.params, 1.0)
    }

    /// Forgets integrals and set-point history and starts from the present motion without a jump: for a jump of the state
    /// estimate (relocalisation). A change of set point needs no reset.
    pub fn reset(&mut self, nav: &NavState) {
        self.position.reset(nav);
        self.altitude.reset(-nav.velocity.z(), 0.0);
        self.heading.reset(nav.yaw_rad());
        self.start_outer(nav);
    }

    /// The LQR continues the acceleration that is flown.
    fn start_outer(&mut self, nav: &NavState) {
        let (roll, pitch, yaw) = nav.attitude.roll_pitch_yaw();
        let accel = accel_of_tilt(roll, pitch, yaw);
        if let Some(outer) = &mut self.outer {
            outer.level[0].reset(accel.x);
            outer.level[1].reset(accel.y);
            outer.height.reset(0.0);
        }
    }

    /// One step. `dt_s` is the time since the last one; 40 to 250 Hz.
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
            thrust_fraction: HoverThrust::fraction_of_throttle(&self.params, sticks.throttle),
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
        let lift = self.spool_up.step(&self.params, dt_s, &view);
        let throttle = self.hover.throttle_of_lift(&self.params, lift);
        if self.spool_up.lifted_off() {
            let ratio = self.spool_up.weight_found();
            self.hover.scale_weight(&self.params, ratio);
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
                    self.hover.throttle_of_lift(&self.params, lift)
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

    /// SNSI's family where it flies: set points with a height, sonar and attitude speaking.
    fn snsi_sticks(
        &mut self,
        nav: &NavState,
        trusted: &Trusted,
        setpoint: &Setpoint,
        horizontal: &Horizontal,
        throttle: f64,
    ) -> Option<Sticks> {
        let (height, heading) = match *setpoint {
            Setpoint::Hover { position, heading } => (Some(-position.z()), heading),
            Setpoint::Velocity {
                down_m, heading, ..
            } => (down_m.map(|d| -d), heading),
            _ => (None, Heading::Rate(0.0)),
        };
        let is_flown = self.params.variant == Variant::Snsi && trusted.attitude;
        let (true, Some(height_m)) = (is_flown, height.filter(|h| h.is_finite())) else {
            self.snsi_ran = false;
            return None;
        };
        if !self.snsi_ran {
            self.snsi.take_over(1000.0 + 1000.0 * throttle);
            self.snsi_ran = true;
        }
        let turn_deg = match heading {
            Heading::Yaw(yaw) if yaw.is_finite() => {
                Some(vehicle::angle::shortest_turn(nav.yaw_rad(), yaw).to_degrees())
            }
            // A rate: what turns so much in half a second.
            Heading::Rate(rate) if rate.is_finite() => Some((0.5 * rate).to_degrees()),
            _ => None,
        };
        let (_, pitch, _) = nav.attitude.roll_pitch_yaw();
        let most = crate::snsi::pid::MAX_INCLINATION_DEG.to_radians();
        let wanted = (-horizontal.pitch).clamp(-most, most);
        let us = self.snsi.cycle(&Seen {
            height_cm: trusted.height.then_some(-100.0 * nav.position.z()),
            target_cm: 100.0 * height_m,
            inclination_deg: Some(-pitch.to_degrees()),
            target_inclination_deg: wanted.to_degrees(),
            turn_deg,
            elevator_us: -500.0 * self.curve.stick_of_angle(-wanted),
            roll_us: 1500.0 + 500.0 * self.curve.stick_of_angle(horizontal.roll),
        });
        let [throttle_us, roll_us, elevator_us, rudder_us, _] = us;
        // A silent sonar leaves the cascade's blind descent.
        let throttle = if trusted.height {
            (throttle_us - 1000.0) / 1000.0
        } else {
            throttle
        };
        Some(Sticks {
            roll: (roll_us - 1500.0) / 500.0,
            // The elevator's plus is nose down.
            pitch: -(elevator_us - 1500.0) / 500.0,
            yaw: (rudder_us - 1500.0) / 500.0,
            throttle,
        })
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
            .step(&self.params, dt_s, nav.yaw_rad(), heading)
    }

    fn horizontal(
        &mut self,
        dt_s: f64,
        nav: &NavState,
        trusted: &Trusted,
        setpoint: &Setpoint,
    ) -> Horizontal {
        let p = &self.params;
        let tilt_max = p.tilt_max_deg.to_radians();
        if let Setpoint::Attitude {
            roll_rad,
            pitch_rad,
            ..
        } = *setpoint
        {
            self.horizontal_ran = false;
            let limit = self.params.angle_limit_deg.to_radians().min(0.6);
            return Horizontal {
                roll: finite_or_zero(roll_rad).clamp(-limit, limit),
                pitch: finite_or_zero(pitch_rad).clamp(-limit, limit),
                hold: Hold::Height,
                ..Horizontal::default()
            };
        }
        let towards = |target: In<Ned>| {
            (trusted.position && target.x().is_finite() && target.y().is_finite())
                .then(|| PositionLoop::velocity_towards(p, nav.position, target))
        };
        let (wanted, hold) = match *setpoint {
            Setpoint::Hover { position, .. } | Setpoint::Land { position, .. } => {
                match towards(position) {
                    Some(v) => (v, Hold::Position),
                    None => (Vector2::zeros(), Hold::Velocity),
                }
            }
            Setpoint::Velocity { velocity, .. } if velocity.is_finite() => {
                (xy(velocity), Hold::Velocity)
            }
            _ => (Vector2::zeros(), Hold::Velocity),
        };
        if !trusted.velocity {
            // Nothing tells where we drift: level is the best there is.
            self.horizontal_ran = false;
            return Horizontal {
                hold: Hold::Height,
                ..Horizontal::default()
            };
        }
        if !self.horizontal_ran {
            self.position.reset(nav);
            self.start_outer(nav);
            self.horizontal_ran = true;
        }
        let mut accel = self.position.step(&self.params, dt_s, nav, wanted);
        if self.params.variant == Variant::Lqr
            && let Some(by_law) = self.outer_accel(dt_s, nav, setpoint, hold)
        {
            accel = by_law;
        }
        let (roll, pitch) = tilt_of_accel(accel, nav.yaw_rad(), tilt_max);
        Horizontal {
            roll,
            pitch,
            accel,
            velocity_sp: self.position.velocity_sp(),
            hold,
        }
    }

    /// Acceleration by LQR, NED, m/s2, for set points that it flies.
    fn outer_accel(
        &mut self,
        dt_s: f64,
        nav: &NavState,
        setpoint: &Setpoint,
        hold: Hold,
    ) -> Option<Vector2<f64>> {
        let (Setpoint::Hover { position, .. } | Setpoint::Land { position, .. }) = *setpoint else {
            self.start_outer(nav);
            return None;
        };
        let outer = self.outer.as_mut().filter(|_| hold == Hold::Position)?;
        let (roll, pitch, yaw) = nav.attitude.roll_pitch_yaw();
        let flown = accel_of_tilt(roll, pitch, yaw);
        let error = xy(nav.position) - xy(position);
        // Far away the limited error is its share of the direction, not of each axis.
        let error = error.cap_magnitude(crate::outer_lqr::REACH_M);
        let velocity = xy(nav.velocity);
        let most = self.params.acc_hor;
        let [north, east] = &mut outer.level;
        Some(Vector2::new(
            north.step(dt_s, Some(error.x), velocity.x, flown.x, most),
            east.step(dt_s, Some(error.y), velocity.y, flown.y, most),
        ))
    }

    fn vertical(
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
                Vertical::Climb(if slow {
                    -speed.min(p.land_crawl_mps)
                } else {
                    -speed
                })
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
    fn follow_climb(&mut self, dt_s: f64, nav: &NavState, trusted: &Trusted) {
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
            thrust_fraction: HoverThrust::fraction_of_throttle(&self.params, sticks.throttle),
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

/// Which parts of the state are healthy and finite.
#[derive(Clone, Copy, Debug)]
struct Trusted {
    attitude: bool,
    height: bool,
    velocity: bool,
    position: bool,
}

impl Trusted {
    fn of(nav: &NavState) -> Self {
        let attitude = nav.health.attitude && nav.yaw_rad().is_finite();
        let velocity_known = nav.velocity.x().is_finite() && nav.velocity.y().is_finite();
        let velocity = attitude && velocity_known && (nav.health.velocity || nav.health.position);
        Self {
            attitude,
            height: nav.health.height
                && nav.position.z().is_finite()
                && nav.velocity.z().is_finite()
                && nav.height_m.is_finite(),
            velocity,
            position: velocity
                && nav.health.position
                && nav.position.x().is_finite()
                && nav.position.y().is_finite(),
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Horizontal {
    roll: f64,
    pitch: f64,
    accel: Vector2<f64>,
    velocity_sp: Vector2<f64>,
    hold: Hold,
}

#[derive(Clone, Copy, Debug)]
enum LiftDemand {
    /// Multiples of the weight.
    Weights(f64),
    /// Throttle stick.
    Throttle(f64),
}

#[derive(Clone, Copy, Debug)]
struct VerticalDemand {
    lift: LiftDemand,
    climb_sp: f64,
    accel_up: f64,
    height_held: bool,
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

fn floor_view(nav: &NavState, trusted: &Trusted, climb_guess_mps: f64) -> FloorView {
    FloorView {
        climb_guess_mps,
        height: trusted.height.then(|| (nav.height_m, -nav.velocity.z())),
        felt_mps2: finite_or_zero(-nav.accel_mps2.z()),
    }
}

fn mass_of(p: &ControlParams, airframe: &Airframe) -> f64 {
    if p.mass_kg > 0.0 {
        p.mass_kg
    } else {
        airframe.mass_kg
    }
}

fn finite_or_zero(v: f64) -> f64 {
    if v.is_finite() { v } else { 0.0 }
}
