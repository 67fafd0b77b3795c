//! uQuad behind the same door as a vehicle with a flight controller: the same modes, keys, missions and MAVLink.
//!
//! Sense, estimate, arbitrate, plan as in [`Flight`](crate::autopilot::flight::Flight); then the law of [`Aircraft`] in place of sticks. One turn per frame of the
//! inertial unit, its order that of the thesis: drain the frames, filter, planner, control, motors.
//!
//! | Position source | From | Law |
//! | --- | --- | --- |
//! | localization | rangers and flow beside the inertial unit, [`Estimator`] | 12 states |
//! | none | - | 8 states: height, heading and tilt are held, the place is not; what needs a place is refused |
//!
//! Pure: inputs with their time in, [`poll`](UquadFlight::poll) until none.

mod io;
mod list;
mod motors;
mod requests;
mod sense;
mod turn;

pub use io::{UquadFlightConfig, UquadInput, UquadOutput, airframe};

use super::aircraft::{Aircraft, Phase};
use super::reference::{Goal, Reference, Turn};
use super::{Step, UquadError};
use crate::autopilot::arbiter::Arbiter;
use crate::autopilot::door::{FcStatus, Refusal, Snapshot};
use crate::autopilot::flight::Start;
use crate::autopilot::latency::Histogram;
use crate::autopilot::modes::Air;
use crate::autopilot::supervisor::Supervisor;
use crate::autopilot::watch::Watch;
use crate::sensor::ring::Ring;
use crate::settings::Settings;
use control::lqr::{Trim, Weights};
use control::setpoint_list::{ListFollower, SetpointList};
use core::time::Duration;
use estimator::Estimator;
use estimator::thesis::StateSet;
use nalgebra::Vector3;
use planner::mission::Mission;
use planner::navigator::Navigator;
use std::collections::VecDeque;
use std::sync::Arc;
use turn::stay;
use vehicle::{Airframe, In, NavState, Ned, Setpoint, Timestamp, UquadAirframe};

/// Outputs that wait to be polled at most.
const OUTPUTS: usize = 256;
/// Without a frame for so long the ground is told how it stands all the same.
const QUIET: Duration = Duration::from_millis(50);
/// Without anything to do, the line is looked at again after this.
const LOOK: Duration = Duration::from_millis(5);

/// The aircraft with its autopilot.
pub struct UquadFlight {
    settings: Settings,
    craft: UquadAirframe,
    airframe: Airframe,
    aircraft: Aircraft,
    is_reduced: bool,
    ring: Option<Ring>,
    estimator: Estimator,
    navigator: Navigator,
    arbiter: Arbiter,
    supervisor: Supervisor,
    watch: Watch,
    air: Air,
    home: In<Ned>,
    home_yaw_rad: f64,
    nav: NavState,
    reference: Reference,
    goal: (Goal, Turn),
    touched_s: f64,
    touched_m: f64,
    frames: u32,
    last_plan: Timestamp,
    armed_at: Option<Timestamp>,
    weights: Option<Weights>,
    designed_for_rad: f64,
    is_designing: bool,
    list: Option<SetpointList>,
    follower: Option<ListFollower>,
    /// Gains for the next entry of the list: wanted, and being made.
    list_trim: Option<Trim>,
    is_for_list: bool,
    mass_kg: f64,
    reset_counter: u8,
    localized_at: Option<Timestamp>,
    ground_heard: Option<Timestamp>,
    shutting_down: bool,
    heard_at: Option<Timestamp>,
    latency: Histogram,
    touched_down: bool,
    step: Option<Step>,
    snapshot: Snapshot,
    outputs: VecDeque<UquadOutput>,
}

impl UquadFlight {
    /// On the floor, motors standing.
    ///
    /// # Errors
    /// The setting that cannot be.
    pub fn new(now: Timestamp, config: UquadFlightConfig) -> Result<Self, UquadError> {
        let UquadFlightConfig {
            plan,
            ring,
            start,
            settings,
            seed,
            calibration,
            uquad,
            weights,
            list,
        } = config;
        let craft = uquad.filter.craft;
        let airframe = airframe(&craft);
        let is_reduced = uquad.filter.states == StateSet::Reduced;
        let anchor = plan.anchor();
        let home_yaw_rad = plan
            .home
            .map_or(0.0, |home| anchor.yaw_to_ned(home.yaw_rad));
        let mut aircraft = Aircraft::new(calibration, uquad)?;
        let mut estimator = Estimator::new(
            settings.estimator.clone(),
            ring.is_some().then(|| Arc::clone(&plan)),
            anchor,
            seed,
        );
        match start {
            Start::Known(pose) => {
                estimator.start_at(now, pose, 0.05, 0.05);
                let at = anchor.to_ned(In::new(pose.x_m, pose.y_m, 0.0));
                aircraft
                    .uquad()
                    .start_from(Vector3::new(at.x(), -at.y(), 0.0));
            }
            Start::Unknown => estimator.start_unknown(now),
        }
        let navigator = Navigator::new(
            plan,
            anchor,
            airframe.radius_m,
            settings.planner.clone(),
            settings.vfh.clone(),
        );
        let mission = Mission::new(settings.planner.clone());
        let arbiter = Arbiter::new(mission, settings.autopilot.takeoff_height_m);
        let standing = [0.0; 12];
        Ok(Self {
            mass_kg: craft.mass_kg,
            craft,
            airframe,
            aircraft,
            is_reduced,
            ring: ring.map(Ring::new),
            estimator,
            navigator,
            arbiter,
            supervisor: Supervisor::default(),
            watch: Watch::default(),
            air: Air::Ground,
            home: In::zero(),
            home_yaw_rad,
            nav: NavState::default(),
            reference: Reference::at(&standing),
            goal: (stay(&standing), Turn::Rate(0.0)),
            touched_s: 0.0,
            touched_m: 0.0,
            frames: 0,
            last_plan: now,
            armed_at: None,
            weights,
            designed_for_rad: 0.0,
            is_designing: false,
            list,
            follower: None,
            list_trim: None,
            is_for_list: false,
            reset_counter: 0,
            localized_at: None,
            ground_heard: None,
            shutting_down: false,
            heard_at: None,
            latency: Histogram::default(),
            touched_down: false,
            step: None,
            snapshot: Snapshot {
                home_yaw_rad,
                arm_blocked_by: Some(Refusal::NoAttitude),
                fc: FcStatus {
                    variant: *b"UQAD",
                    ..FcStatus::default()
                },
                ..Snapshot::default()
            },
            outputs: VecDeque::with_capacity(OUTPUTS),
            settings,
        })
    }

    /// Takes an input.
    pub fn handle(&mut self, now: Timestamp, input: UquadInput) {
        match input {
            UquadInput::Imu(bytes) => self.imu(now, &bytes),
            UquadInput::Ack(reply) => self.aircraft.acknowledged(&reply),
            UquadInput::Ranger(reading) => self.range(&reading),
            UquadInput::DownRange(sample) => self.down_range(&sample),
            UquadInput::Flow(sample) => {
                self.estimator.flow(&sample);
                self.snapshot.flow = Some(sample);
            }
            UquadInput::Asked(asked) => self.asked(now, &asked),
            UquadInput::JobDone(result) => self.estimator.search_done(&result),
            UquadInput::Designed(made) => {
                self.is_designing = false;
                if core::mem::take(&mut self.is_for_list) {
                    self.entry_reached();
                }
                // Gains that could not be made leave the old ones, which hold.
                if let Ok(design) = made {
                    self.designed_for_rad = design.trim.state[5];
                    self.aircraft.uquad().set_gains(&design);
                }
            }
            UquadInput::Speeds(speeds) => self.aircraft.believe_instead(speeds),
            UquadInput::Host(report) => self.watch.host = report,
            UquadInput::Wake => {}
        }
        self.watch_phase(now);
        if now.since(self.last_plan) > QUIET {
            // Calibrating, or nothing comes from the inertial unit: the ground shall know.
            self.last_plan = now;
            self.snapshot.flight_loop.ticks += 1;
            self.take_snapshot(now, &Setpoint::Idle);
        }
        while let Some(message) = self.aircraft.poll(now) {
            self.emit(UquadOutput::Motors(message));
        }
    }

    /// The next thing to do, if any.
    pub fn poll(&mut self) -> Option<UquadOutput> {
        self.outputs.pop_front()
    }

    /// When to wake it with [`UquadInput::Wake`] if nothing else happens.
    #[must_use]
    pub fn deadline(&self, now: Timestamp) -> Timestamp {
        now + LOOK
    }

    /// Everything the ground may want to know.
    #[must_use]
    pub const fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// Entry and rounds of the list, while it is flown.
    #[must_use]
    pub fn list_progress(&self) -> Option<(usize, u32)> {
        self.follower.as_ref().map(|f| (f.index(), f.rounds()))
    }

    /// The newest estimate and command, once: for the logs.
    pub const fn take_step(&mut self) -> Option<Step> {
        self.step.take()
    }

    /// Speed that hovers with the mass the law believes (keys i, k and 0), rad/s; never above what a motor may turn at.
    #[must_use]
    pub fn hover_radps(&self) -> f64 {
        super::laws_hover(&self.craft, self.mass_kg)
    }

    /// What the aircraft is doing.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.aircraft.phase()
    }

    // ---- sensors -----------------------------------------------------------------------------------------------

    // ---- the turn ----------------------------------------------------------------------------------------------

    // ---- motors ------------------------------------------------------------------------------------------------

    // ---- requests ----------------------------------------------------------------------------------------------

    // ---- out ---------------------------------------------------------------------------------------------------

    fn emit(&mut self, output: UquadOutput) {
        // The shell drains after every input: see `Flight`.
        if self.outputs.len() < OUTPUTS {
            self.outputs.push_back(output);
        }
    }

    fn take_snapshot(&mut self, now: Timestamp, setpoint: &Setpoint) {
        let rangers_alive = self.ring.as_ref().is_some_and(|ring| {
            ring.horizontal_at()
                .is_some_and(|at| now.since(at) < Duration::from_secs(1))
        });
        self.snapshot.rangers_alive = rangers_alive;
        let blocked = if self.is_armed() {
            None
        } else {
            self.objection()
        };
        let scan = self.ring.as_ref().and_then(|ring| ring.picture(now));
        let s = &mut self.snapshot;
        s.at = now;
        s.nav = self.nav;
        s.mode = self.arbiter.mode();
        s.is_armed = self.armed_at.is_some();
        s.landed = self.arbiter.landed_state(self.air);
        s.is_key_mode = self.arbiter.is_key_mode();
        s.arm_blocked_by = blocked;
        s.setpoint = Some(*setpoint);
        s.attitude_target = self.nav.attitude;
        s.fc.is_connected = self
            .heard_at
            .is_some_and(|at| now.since(at) < Duration::from_secs(1));
        s.flight_loop.sample_to_command = self.latency.summary();
        s.scan = scan;
        s.mission = self.arbiter.mission_status();
        s.home = self.home;
        s.home_yaw_rad = self.home_yaw_rad;
    }
}
