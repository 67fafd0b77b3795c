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

use super::aircraft::{Aircraft, Off, Phase};
use super::laws::DesignRequest;
use super::reference::{Goal, Reference, Turn};
use super::{Said, Step, UquadConfig, UquadError};
use crate::autopilot::arbiter::{Arbiter, Order};
use crate::autopilot::door::{
    Answer, Asked, Event, FcStatus, ImuFlags, Key, Notice, Outcome, Refusal, Request, Snapshot,
};
use crate::autopilot::flight::Start;
use crate::autopilot::io::FcBytes;
use crate::autopilot::latency::Histogram;
use crate::autopilot::mode::{Because, Mode};
use crate::autopilot::modes::{Air, Cockpit};
use crate::autopilot::supervisor::{Facts, Supervisor, Verdict};
use crate::sensor::ring::{Measured, Ring};
use crate::settings::{Origin, Settings};
use arrayvec::ArrayVec;
use control::lqr::{Design, LqrError, Trim, Weights};
use control::setpoint_list::{ListFollower, Reach, SetpointList, Wants};
use control::state_feedback::StateSetpoint;
use core::time::Duration;
use estimator::imu::{Calibration, ImuEvent};
use estimator::thesis::StateSet;
use estimator::{Estimator, SearchRequest, SearchResult};
use nalgebra::Vector3;
use planner::mission::Mission;
use planner::navigator::Navigator;
use std::collections::VecDeque;
use std::sync::Arc;
use vehicle::angle::wrap_pi;
use vehicle::setpoint::Lift;
use vehicle::{
    Airframe, AttitudeSample, BaroSample, DownRange, FloorPlan, FlowSample, Heading, ImuSample, In,
    NavHealth, NavState, Ned, RangerReading, RingConfig, Rot, Setpoint, Timestamp, UquadAirframe,
};

/// Outputs that wait to be polled at most.
const OUTPUTS: usize = 256;
/// Frames between two turns of modes and planner.
const PLAN_EVERY: u32 = 2;
/// Frames between two positions from localization to the filter.
const FIX_EVERY: u32 = 10;
/// A heading that the gains were not made for, rad.
const STALE_RAD: f64 = 0.1;
/// Landed: the reference is this far below the craft, m, whose height has not changed by more than this, m, for so long, s.
const TOUCHDOWN: (f64, f64, f64) = (0.20, 0.06, 0.6);
/// Off the floor from here on, m.
const LIFTED_M: f64 = 0.08;
/// Without a frame for so long the ground is told how it stands all the same.
const QUIET: Duration = Duration::from_millis(50);
/// Without anything to do, the line is looked at again after this.
const LOOK: Duration = Duration::from_millis(5);

/// What goes in.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a box would allocate in flight")]
pub enum UquadInput {
    /// Bytes of the inertial unit.
    Imu(FcBytes),
    /// What the motor driver sent back.
    Ack([u8; 4]),
    /// A range finder of the ring.
    Ranger(RangerReading),
    /// The down-ranger.
    DownRange(DownRange),
    /// Optical flow.
    Flow(FlowSample),
    /// A request through the door.
    Asked(Asked),
    /// A search is done.
    JobDone(SearchResult),
    /// Gains are made.
    Designed(Result<Design, LqrError>),
    /// Speeds that the motors turn at whatever the law says, rad/s: typed on the bench.
    Speeds([f64; 4]),
    /// Only time has passed.
    Wake,
}

/// What comes out.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a box would allocate in flight")]
pub enum UquadOutput {
    /// A message for the motor driver.
    Motors([u8; 4]),
    /// What became of a request.
    Answer(Answer),
    /// Something happened.
    Event(Event),
    /// A search to be done outside the loop.
    Job(SearchRequest),
    /// Gains to be made outside the loop.
    Design(DesignRequest),
}

/// Everything it is made from.
#[derive(Clone, Debug)]
pub struct UquadFlightConfig {
    /// Walls.
    pub plan: Arc<FloorPlan>,
    /// The ring of range finders; none = no position source, 8 states.
    pub ring: Option<RingConfig>,
    /// Where it stands.
    pub start: Start,
    /// Parameters.
    pub settings: Settings,
    /// Of the particles.
    pub seed: u64,
    /// Of the inertial unit.
    pub calibration: Calibration,
    /// Law and filter, from [`laws::config`](super::laws::config).
    pub uquad: UquadConfig,
    /// Gains are made again for headings they were not made for; none = they are from a file and stay.
    pub weights: Option<Weights>,
    /// Set points that are flown in place of a MAVLink mission while none is stored.
    pub list: Option<SetpointList>,
}

/// uQuad as the modes and the navigator see it: 10-inch propellers at the ends of its arms, and legs.
#[must_use]
pub fn airframe(craft: &UquadAirframe) -> Airframe {
    Airframe {
        mass_kg: craft.mass_kg,
        max_thrust_n: 4.0 * craft.thrust_n(vehicle::uquad::DRIVER_SPEED_RADPS),
        radius_m: craft.arm_m + 0.127,
        arm_m: craft.arm_m,
        landed_height_m: 0.10,
    }
}

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

    fn imu(&mut self, now: Timestamp, bytes: &[u8]) {
        let mut said = ArrayVec::<Said, 8>::new();
        let step = self.aircraft.bytes(now, bytes, &mut |s| {
            let _ = said.try_push(s);
        });
        for s in said {
            if let Some(notice) = notice_of(&s) {
                self.emit(UquadOutput::Event(Event::Notice(notice)));
            }
        }
        let Some(step) = step else { return };
        self.heard_at = Some(now);
        self.step = Some(step);
        self.frames = self.frames.wrapping_add(1);
        self.feed_estimator(&step);
        self.estimate(now, &step);
        if self.frames.is_multiple_of(PLAN_EVERY) {
            self.turn(now);
        }
        self.guide(&step);
    }

    /// The thesis's filter in place of a flight controller's: attitude, inertial sample, height.
    fn feed_estimator(&mut self, step: &Step) {
        let filter = self.aircraft.filter();
        let [roll_rad, pitch_rad, yaw_rad] = filter.roll_pitch_yaw();
        let at = step.reading.at;
        let attitude = AttitudeSample {
            at,
            roll_rad,
            pitch_rad,
            heading_rad: yaw_rad,
        };
        let frd = |v: Vector3<f64>| In::new(v.x, -v.y, -v.z);
        let velocity: In<Ned> =
            Rot::from_roll_pitch_yaw(roll_rad, pitch_rad, yaw_rad) * filter.velocity_frd();
        let measured = &step.reading.measured;
        let imu = ImuSample {
            at,
            accel_mps2: frd(measured.accel_mps2),
            gyro_radps: frd(measured.gyro_radps),
            mag: Some(frd(measured.mag)),
        };
        let baro = BaroSample {
            at,
            altitude_m: measured.altitude_m,
            climb_mps: -velocity.z(),
        };
        self.estimator.attitude(&attitude);
        self.estimator.imu(&imu);
        if step.reading.baro_is_good {
            self.estimator.baro(&baro);
            self.snapshot.baro = Some(baro);
        }
        self.snapshot.imu = Some(imu);
        self.snapshot.imu_flags = Some(ImuFlags {
            accel_is_gravity: step.reading.accel_is_good,
            mag_is_earth: step.reading.mag_is_good,
        });
    }

    /// Navigation for modes and planner, and the position for the filter.
    fn estimate(&mut self, now: Timestamp, step: &Step) {
        if self.ring.is_none() {
            self.nav = self.own_state(now, step);
            return;
        }
        self.estimator.set_landed(self.air == Air::Ground);
        self.estimator.update(now);
        if let Some(job) = self.estimator.poll_job() {
            self.emit(UquadOutput::Job(job));
        }
        let nav = *self.estimator.state();
        let here = Vector3::new(nav.position.x(), -nav.position.y(), self.up_m(&nav));
        if nav.localization.reset_counter != self.reset_counter {
            self.reset_counter = nav.localization.reset_counter;
            let was_lost = !self.nav.health.position;
            self.aircraft.uquad().relocate(here);
            self.reference = Reference::at(&self.aircraft.filter().twelve());
            self.arbiter.relocalized(was_lost);
        }
        if nav.health.position {
            if self.frames.is_multiple_of(FIX_EVERY) {
                self.aircraft.fix(here);
            }
            self.localized_at = Some(now);
        }
        self.nav = nav;
    }

    /// Height of the craft over where it stood, m: the law's z.
    fn up_m(&self, nav: &NavState) -> f64 {
        -nav.position.z() - self.airframe.landed_height_m
    }

    /// The thesis's estimate alone: no place.
    fn own_state(&self, now: Timestamp, step: &Step) -> NavState {
        let filter = self.aircraft.filter();
        let [roll, pitch, yaw] = filter.roll_pitch_yaw();
        let attitude = Rot::from_roll_pitch_yaw(roll, pitch, yaw);
        let p = filter.position_ned();
        let frd = |v: Vector3<f64>| In::new(v.x, -v.y, -v.z);
        let down_m = p.z() - self.airframe.landed_height_m;
        NavState {
            at: now,
            position: p.with_z(down_m),
            velocity: attitude * filter.velocity_frd(),
            attitude,
            rates_radps: frd(step.reading.measured.gyro_radps),
            accel_mps2: frd(step.reading.measured.accel_mps2),
            height_m: -down_m,
            health: NavHealth {
                attitude: true,
                height: true,
                velocity: false,
                position: false,
            },
            ..NavState::default()
        }
    }

    fn range(&mut self, reading: &RangerReading) {
        let Some(ring) = &mut self.ring else { return };
        let mut measured = ArrayVec::<Measured, 2>::new();
        ring.read(reading, |m| {
            let _ = measured.try_push(m);
        });
        for m in measured {
            match m {
                Measured::Scan(scan) => {
                    self.estimator.scan(&scan);
                    self.navigator.observe(&scan, &self.nav);
                }
                Measured::Down(sample) => self.down_range(&sample),
            }
        }
    }

    fn down_range(&mut self, sample: &DownRange) {
        self.estimator.down_range(sample);
        self.snapshot.down_range = Some(*sample);
    }

    // ---- the turn ----------------------------------------------------------------------------------------------

    /// Modes, planner, supervisor.
    fn turn(&mut self, now: Timestamp) {
        let dt_s = now.since(self.last_plan).as_secs_f64().clamp(1e-3, 0.2);
        self.last_plan = now;
        self.snapshot.flight_loop.ticks += 1;
        self.supervise(now);
        let touched = self.touched_down;
        let order = self.with_cockpit(now, dt_s, |arbiter, c| arbiter.step(c, touched));
        self.follow(now, &order);
        self.weigh();
        self.take_snapshot(now, &order.setpoint);
    }

    /// What the modes may see: without a position source they fly over the place of the start.
    fn seen(&self) -> NavState {
        let mut nav = self.nav;
        if self.ring.is_none() {
            nav.health.position = true;
            nav.health.velocity = true;
            nav.velocity = In::new(0.0, 0.0, nav.velocity.z());
        }
        nav
    }

    fn with_cockpit<R>(
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

    fn supervise(&mut self, now: Timestamp) {
        let since =
            |at: Option<Timestamp>| at.map_or(f64::INFINITY, |at| now.since(at).as_secs_f64());
        let has_ring = self.ring.is_some();
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
            battery: None,
            spare_s: None,
            // The aircraft has its own rules for a silent inertial unit: they stop the motors.
            fc_silent_s: 0.0,
            loop_gap_s: 0.0,
            params: &self.settings.autopilot,
        };
        let mut verdicts = ArrayVec::<Verdict, 16>::new();
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
                Verdict::Clear(because) => {
                    let notice = Notice::FailsafeCleared(because);
                    self.emit(UquadOutput::Event(Event::Notice(notice)));
                }
            }
        }
    }

    fn follow(&mut self, now: Timestamp, order: &Order) {
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
    fn goal_of(&self, setpoint: &Setpoint) -> (Goal, Turn) {
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
    fn guide(&mut self, step: &Step) {
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

    /// The set point of the list, if one is flown.
    fn follow_list(&mut self, dt_s: f64, state: &[f64; 12]) -> Option<StateSetpoint> {
        if self.arbiter.mode().mode != Mode::Hold || self.air != Air::Flying {
            self.follower = None;
        }
        let wants = self.follower.as_mut()?.step(dt_s, state);
        Some(match wants {
            Wants::Fly(setpoint) => setpoint,
            Wants::Gains(setpoint, trim) => {
                match self.weights {
                    Some(_) => self.list_trim = Some(trim),
                    // Gains from files are those of every entry.
                    None => self.entry_reached(),
                }
                setpoint
            }
        })
    }

    fn entry_reached(&mut self) {
        if let Some(follower) = &mut self.follower {
            let reached = follower.index() as u16;
            follower.gains_made();
            self.emit(UquadOutput::Event(Event::ItemReached(reached)));
        }
    }

    /// Flies the list instead of a mission that is not there.
    fn start_list(&mut self) -> Result<Outcome, Refusal> {
        let Some(list) = &self.list else {
            return Err(Refusal::NoPlan);
        };
        if self.air != Air::Flying {
            return Err(Refusal::NotFlying);
        }
        let landed_m = self.airframe.landed_height_m;
        let places = list
            .entries()
            .iter()
            .flat_map(control::setpoint_list::Entry::outline)
            .map(|[x, y, z]| In::new(x, -y, -z - landed_m));
        self.navigator
            .check_places(places)
            .map_err(|e| crate::autopilot::modes::refusal_of(&e))?;
        let mut home = self.aircraft.filter().twelve();
        home[..3].copy_from_slice(self.reference.position_m().as_slice());
        let reach = Reach::default();
        self.follower = Some(ListFollower::new(list.clone(), self.craft, reach, home));
        Ok(Outcome::Accepted)
    }

    /// A list is meant: there is one, and no MAVLink mission.
    fn means_list(&self, request: &Request) -> bool {
        let asks = matches!(
            request,
            Request::StartMission { .. } | Request::SetMode(Mode::Mission)
        );
        asks && self.list.is_some() && self.arbiter.mission_status().total == 0
    }

    /// Nobody tells that it stands: it no longer sinks although it is told to.
    fn feel_floor(&mut self, dt_s: f64, goal: &Goal, state: &[f64; 12]) {
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

    fn keep_gains(&mut self, setpoint: &StateSetpoint) {
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

    const fn weighed(&self) -> UquadAirframe {
        UquadAirframe {
            mass_kg: self.mass_kg,
            ..self.craft
        }
    }

    /// Keys i, k and 0: the weight, and with it hover speed and range.
    fn weigh(&mut self) {
        let mass_kg = self.arbiter.key_mass_kg().unwrap_or(self.craft.mass_kg);
        if (mass_kg - self.mass_kg).abs() > 1e-9 {
            self.mass_kg = mass_kg;
            self.aircraft.set_hover(self.hover_radps());
        }
    }

    // ---- motors ------------------------------------------------------------------------------------------------

    fn is_armed(&self) -> bool {
        matches!(
            self.phase(),
            Phase::Starting { .. } | Phase::Idling | Phase::RampingUp { .. } | Phase::Running
        )
    }

    /// Told once when the aircraft has stopped its motors by itself.
    fn watch_phase(&mut self, now: Timestamp) {
        self.aircraft.rest();
        if let (Phase::Off(why), Some(_)) = (self.phase(), self.armed_at) {
            if why != Off::Asked {
                self.emit(UquadOutput::Event(Event::Notice(Notice::MotorsOff(why))));
            }
            self.grounded(now);
        }
    }

    fn disarm(&mut self, now: Timestamp) {
        if self.is_armed() {
            self.aircraft.stop(now);
            self.grounded(now);
        }
    }

    fn grounded(&mut self, now: Timestamp) {
        self.armed_at = None;
        (self.touched_down, self.touched_s) = (false, 0.0);
        self.emit(UquadOutput::Event(Event::Armed(false)));
        self.set_air(Air::Ground);
        self.with_cockpit(now, 0.0, |arbiter, c| arbiter.disarmed(c));
    }

    fn set_air(&mut self, air: Air) {
        self.air = air;
        let landed = self.arbiter.landed_state(air);
        self.emit(UquadOutput::Event(Event::Landed(landed)));
    }

    /// Why an arm would be refused now.
    fn objection(&self) -> Option<Refusal> {
        if self.shutting_down {
            return Some(Refusal::ShuttingDown);
        }
        match self.phase() {
            Phase::Calibrating => return Some(Refusal::NoAttitude),
            Phase::Off(Off::Asked) => return Some(Refusal::ArmingUnderWay),
            Phase::Off(why) => return Some(Refusal::MotorsOff(why)),
            _ => {}
        }
        let has_ring = self.ring.is_some();
        if has_ring && !self.snapshot.rangers_alive {
            return Some(Refusal::NoRangers);
        }
        (has_ring && !self.nav.health.position).then_some(Refusal::NotLocalized)
    }

    fn arm(&mut self, now: Timestamp) -> Result<Outcome, Refusal> {
        if self.is_armed() {
            return Ok(Outcome::Accepted);
        }
        if let Some(why) = self.objection() {
            return Err(why);
        }
        self.aircraft.arm(now);
        self.armed_at = Some(now);
        self.latency.clear();
        self.emit(UquadOutput::Event(Event::Armed(true)));
        Ok(Outcome::Accepted)
    }

    // ---- requests ----------------------------------------------------------------------------------------------

    fn asked(&mut self, now: Timestamp, asked: &Asked) {
        let outcome = match &asked.request {
            Request::Arm { .. } => self.arm(now),
            Request::Disarm { force } => self.ask_disarm(now, *force),
            Request::Key(Key::Escape) if self.air == Air::Ground => self.ask_disarm(now, false),
            Request::SetParam { index, value } => {
                let changed = self
                    .settings
                    .set(usize::from(*index), *value, Origin::Mavlink);
                self.navigator
                    .set_params(self.settings.planner.clone(), self.settings.vfh.clone());
                self.arbiter
                    .mission_mut()
                    .set_params(self.settings.planner.clone());
                changed
                    .map(|_| Outcome::Accepted)
                    .map_err(|_| Refusal::BadNumber)
            }
            Request::SetHome(place) => self.set_home(*place),
            Request::GroundHeartbeat => {
                self.ground_heard = Some(now);
                Ok(Outcome::Accepted)
            }
            Request::ShutDown => {
                self.shutting_down = true;
                if self.air == Air::Ground {
                    self.ask_disarm(now, true)
                } else {
                    self.with_cockpit(now, 0.0, |arbiter, c| {
                        arbiter.enter(c, Mode::Land, Because::ShuttingDown)
                    });
                    Ok(Outcome::Accepted)
                }
            }
            request if self.needs_a_place(request) => Err(Refusal::NotLocalized),
            request if self.means_list(request) => self.start_list(),
            request => {
                if ends_list(request) {
                    self.follower = None;
                }
                let is_armed = self.is_armed();
                self.with_cockpit(now, 0.0, |arbiter, c| arbiter.request(c, asked, is_armed))
            }
        };
        let outcome = outcome.unwrap_or_else(Outcome::Refused);
        self.emit(UquadOutput::Answer(Answer {
            id: asked.id,
            station: asked.station,
            outcome,
        }));
    }

    /// Without a position source nothing flies anywhere.
    fn needs_a_place(&self, request: &Request) -> bool {
        self.ring.is_none()
            && match request {
                Request::GoTo(to) => to.north_m.is_some() || to.east_m.is_some(),
                Request::StartMission { .. } | Request::Offboard(_) | Request::Figure(_) => true,
                Request::SetMode(mode) => matches!(
                    mode,
                    Mode::Mission | Mode::Return | Mode::Offboard | Mode::Position
                ),
                Request::Key(key) => matches!(key, Key::NudgeForward(_) | Key::NudgeRight(_)),
                _ => false,
            }
    }

    fn ask_disarm(&mut self, now: Timestamp, force: bool) -> Result<Outcome, Refusal> {
        if self.air == Air::Flying && !force {
            return Err(Refusal::Flying);
        }
        self.disarm(now);
        Ok(Outcome::Accepted)
    }

    fn set_home(&mut self, place: Option<In<Ned>>) -> Result<Outcome, Refusal> {
        self.home = match place {
            Some(p) if p.is_finite() => p,
            Some(_) => return Err(Refusal::BadNumber),
            None if self.nav.health.position => self.nav.position.with_z(0.0),
            None => return Err(Refusal::NotLocalized),
        };
        self.home_yaw_rad = self.nav.yaw_rad();
        self.emit(UquadOutput::Event(Event::HomeSet));
        Ok(Outcome::Accepted)
    }

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

/// Whoever asks for something else ends the list.
const fn ends_list(request: &Request) -> bool {
    matches!(
        request,
        Request::SetMode(_)
            | Request::GoTo(_)
            | Request::Figure(_)
            | Request::Stop
            | Request::Key(_)
            | Request::Takeoff { .. }
            | Request::StartMission { .. }
    )
}

/// A place is approached; what moves is followed exactly.
fn goal_of_entry(setpoint: &StateSetpoint) -> (Goal, Turn) {
    let s = &setpoint.state;
    if s[6..].iter().all(|v| v.abs() < 1e-9) {
        let goal = Goal::Place {
            position_m: Vector3::new(s[0], s[1], s[2]),
            speed_mps: None,
        };
        return (goal, Turn::To(s[5]));
    }
    (Goal::Exactly(*setpoint), Turn::To(s[5]))
}

fn stay(state: &[f64; 12]) -> Goal {
    Goal::Place {
        position_m: Vector3::new(state[0], state[1], state[2]),
        speed_mps: None,
    }
}

/// uQuad's keys had no limit; the same 0.35 rad as key mode.
fn lean(psi_rad: f64, phi_rad: f64, height_m: f64) -> Goal {
    let most = 0.35;
    Goal::Lean {
        psi_rad: psi_rad.clamp(-most, most),
        phi_rad: phi_rad.clamp(-most, most),
        height_m,
    }
}

fn notice_of(said: &Said) -> Option<Notice> {
    match said {
        Said::Imu(ImuEvent::Calibrated(_)) => Some(Notice::ImuCalibrated),
        Said::Imu(ImuEvent::Disturbed(_)) => Some(Notice::ImuDisturbed),
        Said::Period(fault) => {
            use estimator::imu::period::PeriodFault;
            let (PeriodFault::OutOfRange { measured_s, errors }
            | PeriodFault::Gap { measured_s, errors }) = *fault;
            Some(Notice::ImuPeriod {
                ms: measured_s * 1e3,
                errors,
            })
        }
        _ => None,
    }
}
