//! The turn of modes and planner, and what the law shall track until the next.

use super::UquadFlight;
use super::io::UquadOutput;
use super::list::goal_of_entry;
use crate::autopilot::arbiter::{Arbiter, Order};
use crate::autopilot::door::{Event, Notice};
use crate::autopilot::failsafes::{Facts, TABLE};
use crate::autopilot::mode::Mode;
use crate::autopilot::modes::{Air, Cockpit};
use crate::autopilot::supervisor::Verdict;
use crate::autopilot::watch::Look;
use crate::uquad::Step;
use crate::uquad::aircraft::Phase;
use crate::uquad::laws::DesignRequest;
use crate::uquad::reference::{Goal, Reference, Turn};
use arrayvec::ArrayVec;
use control::lqr::Trim;
use control::state_feedback::StateSetpoint;
use nalgebra::Vector3;
use vehicle::angle::wrap_pi;
use vehicle::setpoint::Lift;
use vehicle::{Heading, In, NavState, Ned, Setpoint, Timestamp, UquadAirframe};

/// A heading that the gains were not made for, rad.
const STALE_RAD: f64 = 0.1;
/// Landed: the reference is this far below the craft, m, whose height has not changed by more than this, m, for so long, s.
const TOUCHDOWN: (f64, f64, f64) = (0.20, 0.06, 0.6);
/// Off the floor from here on, m.
const LIFTED_M: f64 = 0.08;

pub(super) fn stay(state: &[f64; 12]) -> Goal {
    Goal::Place {
        position_m: Vector3::new(state[0], state[1], state[2]),
        speed_mps: None,
    }
}

/// uQuad's keys had no limit; the same 0.35 rad as key mode.
pub(super) fn lean(psi_rad: f64, phi_rad: f64, height_m: f64) -> Goal {
    let most = 0.35;
    Goal::Lean {
        psi_rad: psi_rad.clamp(-most, most),
        phi_rad: phi_rad.clamp(-most, most),
        height_m,
    }
}

impl UquadFlight {
    /// Modes, planner, supervisor.
    pub(super) fn turn(&mut self, now: Timestamp) {
        let dt_s = now.since(self.last_plan).as_secs_f64().clamp(1e-3, 0.2);
        self.last_plan = now;
        self.snapshot.flight_loop.ticks += 1;
        self.keep_watch(now, dt_s);
        self.supervise(now);
        let touched = self.touched_down;
        let order = self.with_cockpit(now, dt_s, |arbiter, c| arbiter.step(c, touched));
        self.follow(now, &order);
        self.weigh();
        self.take_snapshot(now, &order.setpoint);
    }

    /// What the modes may see: without a position source they fly over the place of the start.
    pub(super) fn seen(&self) -> NavState {
        let mut nav = self.nav;
        if self.ring.is_none() {
            nav.health.position = true;
            nav.health.velocity = true;
            nav.velocity = In::new(0.0, 0.0, nav.velocity.z());
        }
        nav
    }

    pub(super) fn with_cockpit<R>(
        &mut self,
        now: Timestamp,
        dt_s: f64,
        run: impl FnOnce(&mut Arbiter, &mut Cockpit<'_>) -> R,
    ) -> R {
        let mut events = ArrayVec::new();
        let nav = self.seen();
        let mut cockpit = Cockpit {
            now,
            dt_s,
            nav: &nav,
            air: self.air,
            navigator: &mut self.navigator,
            params: &self.settings.autopilot,
            airframe: &self.airframe,
            home: self.home,
            home_yaw_rad: self.home_yaw_rad,
            events: &mut events,
        };
        let result = run(&mut self.arbiter, &mut cockpit);
        for event in events {
            self.emit(UquadOutput::Event(event));
        }
        result
    }

    fn keep_watch(&mut self, now: Timestamp, dt_s: f64) {
        let nav = self.seen();
        self.watch.look(&Look {
            now,
            dt_s,
            nav: &nav,
            is_flying: self.air == Air::Flying,
            // Its own filter is its attitude: nothing can be refused.
            tilt_refused_s: 0.0,
            setpoint: self.snapshot.setpoint,
            goal: None,
            battery: None,
            fc_rate_hz: None,
            beats: (self.snapshot.flight_loop.ticks, 0),
            params: &self.settings.autopilot,
        });
    }

    pub(super) fn supervise(&mut self, now: Timestamp) {
        let since =
            |at: Option<Timestamp>| at.map_or(f64::INFINITY, |at| now.since(at).as_secs_f64());
        let has_ring = self.ring.is_some();
        let watched = self
            .watch
            .facts(now, self.nav.position, &self.settings.autopilot);
        let facts = Facts {
            mode: self.arbiter.mode().mode,
            is_flying: self.air == Air::Flying,
            is_armed: self.is_armed(),
            has_attitude_and_height: self.nav.health.attitude && self.nav.health.height,
            not_localized_s: if has_ring {
                since(self.localized_at)
            } else {
                0.0
            },
            search_s: self.arbiter.search_s().filter(|_| has_ring),
            rangers_silent_s: match &self.ring {
                Some(ring) => since(ring.horizontal_at()),
                None => 0.0,
            },
            ground_silent_s: self.ground_heard.map(|at| now.since(at).as_secs_f64()),
            offboard_silent_s: self.arbiter.offboard_silent_s(now),
            manual_silent_s: self.arbiter.manual_silent_s(now),
            // No battery is measured. For a silent inertial unit the aircraft has its own rules: they stop the motors.
            ..watched
        };
        let mut verdicts = ArrayVec::<Verdict, { 2 * TABLE.len() }>::new();
        self.supervisor.watch(&facts, |v| {
            let _ = verdicts.try_push(v);
        });
        for verdict in verdicts {
            match verdict {
                Verdict::Act(because, mode) => {
                    let notice = Notice::Failsafe { because, mode };
                    self.emit(UquadOutput::Event(Event::Notice(notice)));
                    self.with_cockpit(now, 0.0, |arbiter, c| arbiter.enter(c, mode, because));
                }
                Verdict::Stop(because) => {
                    let mode = self.arbiter.mode().mode;
                    let notice = Notice::Failsafe { because, mode };
                    self.emit(UquadOutput::Event(Event::Notice(notice)));
                    self.with_cockpit(now, 0.0, |arbiter, c| arbiter.enter(c, Mode::Land, because));
                    self.disarm(now);
                }
                Verdict::Tell(because) => {
                    let notice = Notice::Trouble(because);
                    self.emit(UquadOutput::Event(Event::Notice(notice)));
                }
                Verdict::Clear(because) => {
                    let notice = Notice::FailsafeCleared(because);
                    self.emit(UquadOutput::Event(Event::Notice(notice)));
                }
            }
        }
    }

    pub(super) fn follow(&mut self, now: Timestamp, order: &Order) {
        if order.disarm {
            self.disarm(now);
            return;
        }
        if order.lift_off && self.air == Air::Ground && self.phase() == Phase::Idling {
            self.reference = Reference::at(&self.aircraft.filter().twelve());
            self.aircraft.lift_off();
            self.set_air(Air::SpoolUp);
        } else if self.air == Air::Ground
            && let Some(at) = self.armed_at
        {
            let limit_s = self.settings.autopilot.disarm_preflight_s;
            // The ramp of the motor driver comes on top.
            if limit_s > 0.0 && now.since(at).as_secs_f64() > limit_s + 2.6 && !order.lift_off {
                self.disarm(now);
                return;
            }
        }
        let is_up = self.aircraft.filter().state()[2] > LIFTED_M;
        if self.air == Air::SpoolUp && is_up && self.phase() == Phase::Running {
            self.set_air(Air::Flying);
        }
        self.goal = self.goal_of(&order.setpoint);
    }

    /// The set point of the modes in the law's axes.
    pub(super) fn goal_of(&self, setpoint: &Setpoint) -> (Goal, Turn) {
        let state = self.aircraft.filter().twelve();
        let place =
            |p: In<Ned>| Vector3::new(p.x(), -p.y(), -p.z() - self.airframe.landed_height_m);
        let height = |down_m: f64| -down_m - self.airframe.landed_height_m;
        // Headings are the navigation's; the compass may stand elsewhere.
        let turn = |heading: Heading| match heading {
            Heading::Yaw(yaw) => Turn::To(state[5] - wrap_pi(yaw - self.nav.yaw_rad())),
            Heading::Rate(rate) => Turn::Rate(-rate),
        };
        match *setpoint {
            Setpoint::Hover { position, heading } => {
                let position_m = place(position);
                let goal = Goal::Place {
                    position_m,
                    speed_mps: None,
                };
                (goal, turn(heading))
            }
            Setpoint::Velocity {
                velocity: v,
                down_m,
                heading,
            } => {
                let goal = Goal::Move {
                    velocity_mps: Vector3::new(v.x(), -v.y(), -v.z()),
                    height_m: down_m.map(height),
                };
                (goal, turn(heading))
            }
            Setpoint::Attitude {
                roll_rad,
                pitch_rad,
                heading,
                lift,
            } => {
                let ahead = self.reference.position_m().z;
                let height_m = match lift {
                    Lift::Height(down_m) => height(down_m),
                    Lift::Climb(down_mps) => ahead - down_mps * 0.5,
                    // Half of the largest thrust climbs neither nor sinks; the law keeps the height.
                    Lift::Thrust(share) => ahead + (share - 0.5).clamp(-0.5, 0.5),
                };
                (lean(roll_rad, -pitch_rad, height_m), turn(heading))
            }
            Setpoint::Sticks(sticks) => {
                let height_m = self.reference.position_m().z + (sticks.throttle - 0.5);
                let most = 0.35;
                let goal = lean(sticks.roll * most, -sticks.pitch * most, height_m);
                (goal, Turn::Rate(-sticks.yaw * 0.7))
            }
            Setpoint::Land {
                position,
                heading,
                descent_mps,
            } => {
                let goal = Goal::Sink {
                    position_m: place(position),
                    speed_mps: descent_mps.min(0.35),
                };
                (goal, turn(heading))
            }
            Setpoint::Idle => (stay(&state), Turn::Rate(0.0)),
        }
    }

    /// One sample of the reference, into the law.
    pub(super) fn guide(&mut self, step: &Step) {
        if self.air == Air::Ground {
            return;
        }
        let state = self.aircraft.filter().twelve();
        let dt_s = (step.elapsed_us as f64 * 1e-6).clamp(0.008, 0.012);
        let hover = self.hover_radps();
        let listed = self.follow_list(dt_s, &state);
        let (goal, turn) = listed.map_or(self.goal, |l| goal_of_entry(&l));
        let mut setpoint = self.reference.step(dt_s, &goal, turn, &state, hover);
        if let Some(listed) = listed {
            setpoint.speeds_radps = listed.speeds_radps;
        }
        self.aircraft.guide(setpoint);
        self.feel_floor(dt_s, &goal, &state);
        self.keep_gains(&setpoint);
    }

    /// Nobody tells that it stands: it no longer sinks although it is told to.
    pub(super) fn feel_floor(&mut self, dt_s: f64, goal: &Goal, state: &[f64; 12]) {
        let (below_m, moved_m, for_s) = TOUCHDOWN;
        let is_told =
            matches!(goal, Goal::Sink { .. }) && self.reference.position_m().z < state[2] - below_m;
        // The filter's climb rate believes the motors, which are slow now, and not the floor: the height itself tells.
        if !is_told || (state[2] - self.touched_m).abs() > moved_m {
            (self.touched_m, self.touched_s) = (state[2], 0.0);
        }
        self.touched_s += dt_s;
        self.touched_down |= self.touched_s > for_s;
    }

    pub(super) fn keep_gains(&mut self, setpoint: &StateSetpoint) {
        let Some(weights) = self.weights else { return };
        let theta_rad = setpoint.state[5];
        let is_stale = wrap_pi(theta_rad - self.designed_for_rad).abs() > STALE_RAD;
        if (is_stale || self.list_trim.is_some()) && !self.is_designing {
            self.is_designing = true;
            let craft = self.weighed();
            let listed = self.list_trim.take();
            self.is_for_list = listed.is_some();
            // On a path of the list around what it flies now, elsewhere around hover.
            let trim = listed.unwrap_or_else(|| match &self.follower {
                Some(_) => Trim {
                    state: setpoint.state.into(),
                    inputs: setpoint.speeds_radps.into(),
                },
                None => Trim::hover(&craft, theta_rad),
            });
            self.emit(UquadOutput::Design(DesignRequest {
                trim,
                craft,
                is_reduced: self.is_reduced,
                weights,
            }));
        }
    }

    pub(super) const fn weighed(&self) -> UquadAirframe {
        UquadAirframe {
            mass_kg: self.mass_kg,
            ..self.craft
        }
    }

    /// Keys i, k and 0: the weight, and with it hover speed and range.
    pub(super) fn weigh(&mut self) {
        let mass_kg = self.arbiter.key_mass_kg().unwrap_or(self.craft.mass_kg);
        if (mass_kg - self.mass_kg).abs() > 1e-9 {
            self.mass_kg = mass_kg;
            self.aircraft.set_hover(self.hover_radps());
        }
    }
}
