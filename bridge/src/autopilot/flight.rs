//! The tick on one page: sense, estimate, arbitrate, plan, control, supervise, emit.
//!
//! [`Flight`] is a pure machine: [`handle`](Flight::handle) takes an input with its time, [`poll`](Flight::poll) hands
//! out what is to be done, [`deadline`](Flight::deadline) says when to wake it. After construction it allocates nothing
//! that grows, formats no text, opens no file.
//!
//! After each `handle`, poll until `None`.

mod controller;
mod facts;
mod requests;
mod sensing;
#[cfg(test)]
mod tests;

use super::arbiter::{Arbiter, Order};
use super::arming::{Arming, FcArmState};
use super::beat::Beat;
use super::bench_work::BenchWork;
use super::door::{Answer, Event, FcStatus, Notice, Snapshot};
use super::endurance::Endurance;
use super::failsafes::{FC_SILENT_S, TABLE};
use super::handover::Handover;
use super::health;
use super::io::{FcBytes, Input, Output};
use super::latency::Histogram;
use super::mode::{Because, Mode};
use super::modes::{Air, Cockpit};
use super::supervisor::{Supervisor, Verdict};
use super::watch::Watch;
use crate::fc::convert::Convert;
use crate::fc::{poll, stock_curves};
use crate::sensor::ring::Ring;
use crate::settings::Settings;
use arrayvec::ArrayVec;
use control::{ControlOutput, ControlParams, Controller, Phase};
use core::time::Duration;
use estimator::{Estimator, SearchRequest};
use msp::client::Client;
use msp::firmware::Firmware;
use planner::mission::Mission;
use planner::navigator::Navigator;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::Arc;
use vehicle::{
    Airframe, FloorPlan, In, MapAnchor, MapPose, NavState, Ned, RingConfig, Setpoint, Sticks,
    Timestamp,
};

/// Longer between two inputs and we were held up ourselves.
const OWN_STALL: Duration = Duration::from_millis(60);
/// Outputs that wait to be polled at most; a tick makes about ten.
const OUTPUTS: usize = 256;

/// An [`Output`] that waits, without the one that is a hundred times as large as the others.
#[allow(
    clippy::large_enum_variant,
    reason = "kept in a preallocated queue; a box would allocate in flight"
)]
enum Queued {
    Fc(FcBytes),
    Answer(Answer),
    Event(Event),
}

impl From<Queued> for Output {
    fn from(queued: Queued) -> Self {
        match queued {
            Queued::Fc(bytes) => Self::Fc(bytes),
            Queued::Answer(answer) => Self::Answer(answer),
            Queued::Event(event) => Self::Event(event),
        }
    }
}

/// Where the vehicle stands at start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Start {
    /// Known: on the plan, within a hand's breadth.
    Known(MapPose),
    /// To be found.
    Unknown,
}

/// Everything a `Flight` is made from.
#[derive(Clone, Debug)]
pub struct FlightConfig {
    /// Walls.
    pub plan: Arc<FloorPlan>,
    /// The ring of range finders.
    pub ring: RingConfig,
    /// Mass, size, thrust.
    pub airframe: Airframe,
    /// Where it stands.
    pub start: Start,
    /// Parameters.
    pub settings: Settings,
    /// Of the particles.
    pub seed: u64,
}

/// The vehicle's brain up to the flight controller's bytes.
pub struct Flight {
    settings: Settings,
    airframe: Airframe,
    anchor: MapAnchor,
    client: Client,
    convert: Option<Convert>,
    ring: Ring,
    estimator: Estimator,
    navigator: Navigator,
    controller: Controller,
    arbiter: Arbiter,
    supervisor: Supervisor,
    watch: Watch,
    arming: Arming,
    fc_arm: FcArmState,
    link: controller::Link,
    handover: Handover,
    bench_work: BenchWork,
    fc: FcStatus,
    air: Air,
    home: In<Ned>,
    home_yaw_rad: f64,
    beat: Beat,
    last_tick: Timestamp,
    last_handle: Timestamp,
    /// When the controller sampled the newest attitude.
    sampled: Option<Timestamp>,
    sample_came: bool,
    latency: Histogram,
    standby: Option<FcBytes>,
    /// Where frames are encoded.
    encoded: Vec<u8>,
    /// Missed beats up to the last arming.
    missed_before: u64,
    /// How long the pilot has had the vehicle on the floor, s.
    pilot_down_s: f64,
    localized_at: Option<Timestamp>,
    /// Zero of the flight controller's satellite fixes.
    gnss_start: crate::sensor::gps::Start,
    reset_counter: u8,
    ground_heard: Option<Timestamp>,
    shutting_down: bool,
    endurance: Endurance,
    control: ControlOutput,
    snapshot: Snapshot,
    outputs: VecDeque<Queued>,
    /// A job to be handed out: thirty kilobytes, so it has a place of its own.
    job: Option<SearchRequest>,
}

impl Flight {
    /// At rest, with the line to the flight controller closed.
    #[must_use]
    pub fn new(now: Timestamp, config: FlightConfig) -> Self {
        let FlightConfig {
            plan,
            ring,
            airframe,
            start,
            settings,
            seed,
        } = config;
        let anchor = plan.anchor();
        let home_yaw_rad = plan
            .home
            .map_or(0.0, |home| anchor.yaw_to_ned(home.yaw_rad));
        let mut estimator = Estimator::new(
            settings.estimator.clone(),
            Some(Arc::clone(&plan)),
            anchor,
            seed,
        );
        match start {
            Start::Known(pose) => estimator.start_at(now, pose, START_STD_M, START_STD_RAD),
            Start::Unknown => estimator.start_unknown(now),
        }
        let navigator = Navigator::new(
            plan,
            anchor,
            airframe.radius_m,
            settings.planner.clone(),
            settings.vfh.clone(),
        );
        let controller = Controller::new(settings.control.clone(), airframe);
        let mission = Mission::new(settings.planner.clone());
        let arbiter = Arbiter::new(mission, settings.autopilot.takeoff_height_m);
        let beat = Beat::new(
            now,
            Duration::from_micros(1_000_000 / settings.autopilot.rc_hz.max(1) as u64),
        );
        Self {
            airframe,
            anchor,
            client: Client::new(poll::config()),
            convert: None,
            ring: Ring::new(ring),
            estimator,
            navigator,
            controller,
            arbiter,
            supervisor: Supervisor::default(),
            watch: Watch::default(),
            arming: Arming::Neutral,
            fc_arm: FcArmState::default(),
            link: controller::Link::default(),
            handover: Handover::new(settings.autopilot.radio),
            bench_work: BenchWork::default(),
            fc: FcStatus::default(),
            air: Air::Ground,
            home: In::zero(),
            home_yaw_rad,
            beat,
            last_tick: now,
            last_handle: now,
            sampled: None,
            sample_came: false,
            latency: Histogram::default(),
            standby: None,
            encoded: Vec::with_capacity(256),
            missed_before: 0,
            pilot_down_s: 0.0,
            localized_at: None,
            gnss_start: crate::sensor::gps::Start::default(),
            reset_counter: 0,
            ground_heard: None,
            shutting_down: false,
            endurance: Endurance::default(),
            control: ControlOutput::default(),
            snapshot: Snapshot {
                home_yaw_rad,
                ..Snapshot::default()
            },
            outputs: VecDeque::with_capacity(OUTPUTS),
            job: None,
            settings,
        }
    }

    /// Takes an input; ticks when a tick is due.
    pub fn handle(&mut self, now: Timestamp, input: Input) {
        if now.since(self.last_handle) > OWN_STALL {
            // Who was held up himself has no right to complain of silence.
            self.link.listening_since = now;
        }
        self.last_handle = now;
        match input {
            Input::Fc(bytes) => self.client.handle(now.us(), &bytes),
            Input::FcOpened => self.client.connect(now.us()),
            Input::Ranger(reading) => self.range(&reading),
            Input::DownRange(sample) => self.down_range(&sample),
            Input::Flow(sample) => self.flow(&sample),
            Input::Asked(asked) => self.asked(now, &asked),
            Input::JobDone(result) => self.estimator.search_done(&result),
            Input::FcClosed => self.lose_controller(false),
            Input::Gnss(fix) => self.gnss(&fix),
            Input::Pose(pose) => self.estimator.external_pose(&pose),
            Input::Host(report) => self.watch.host = report,
            Input::Wake => {}
        }
        self.listen(now);
        let sample_came = core::mem::take(&mut self.sample_came);
        if self.beat.is_due(now, sample_came) {
            self.tick(now);
        }
        self.transmit(now);
    }

    /// The next thing to do, if any.
    pub fn poll(&mut self) -> Option<Output> {
        if let Some(queued) = self.outputs.pop_front() {
            return Some(queued.into());
        }
        self.job.take().map(Output::Job)
    }

    /// When to call [`handle`](Self::handle) with [`Input::Wake`] if nothing else happens.
    #[must_use]
    pub fn deadline(&self) -> Timestamp {
        let client = self
            .client
            .deadline_us()
            .map_or(self.beat.deadline(), Timestamp::from_us);
        self.beat.deadline().min(client)
    }

    /// Everything the ground may want to know, as of the last tick.
    #[must_use]
    pub const fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// RC frames handed out so far.
    #[must_use]
    pub const fn rc_frames_sent(&self) -> u64 {
        self.client.statistics().rc_sent
    }

    /// What keeps the vehicle level if we are held up: see [`Keeper`](super::keeper::Keeper). None on the floor, and beside a radio,
    /// which takes over by itself.
    #[must_use]
    pub const fn standby(&self) -> Option<&FcBytes> {
        self.standby.as_ref()
    }

    /// Parameters as they are flown with.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The estimator, for pictures and logs.
    #[must_use]
    pub const fn estimator(&self) -> &Estimator {
        &self.estimator
    }

    /// The planner, for pictures and logs.
    #[must_use]
    pub const fn navigator(&self) -> &Navigator {
        &self.navigator
    }

    // ---- the tick ----------------------------------------------------------------------------------------------

    fn tick(&mut self, now: Timestamp) {
        let since_last = now.since(self.last_tick);
        let dt_s = since_last.as_secs_f64().clamp(1e-3, 0.2);
        self.last_tick = now;
        self.snapshot.flight_loop.ticks += 1;
        let periods = since_last.as_micros() / self.beat.period().as_micros().max(1);
        self.snapshot.flight_loop.missed += periods.saturating_sub(1) as u64;

        // Estimate.
        self.estimator.update(now);
        if let Some(job) = self.estimator.poll_job() {
            self.emit(Output::Job(job));
        }
        let nav = *self.estimator.state();
        self.notice_localization(now, &nav);
        self.confirm_arming(now);
        self.bench_step(now);

        // Arbitrate and plan.
        self.keep_watch(now, dt_s, &nav);
        self.supervise(now, dt_s, since_last.as_secs_f64(), &nav);
        if self.handover.pilot_steers() {
            self.arbiter.carried();
        }
        let touched_down = self.control.landed;
        let order = self.with_cockpit(now, dt_s, &nav, |arbiter, cockpit| {
            arbiter.step(cockpit, touched_down)
        });
        self.follow(now, &nav, &order);

        // Control. While a pilot steers his sticks pass through: the loops rest, and start from the motion he leaves.
        let pilot_steers = self.handover.pilot_steers();
        let setpoint = match self.arming.is_armed() {
            true if pilot_steers => Setpoint::Sticks(self.handover.pilot()),
            true => order.setpoint,
            false => Setpoint::Idle,
        };
        self.watch_pilot(dt_s, &nav);
        let phase = match self.air {
            Air::Ground => Phase::Idle,
            Air::SpoolUp => Phase::SpoolUp,
            Air::Flying => Phase::Flying,
        };
        self.controller
            .set_mass(self.arbiter.key_mass_kg().unwrap_or(self.airframe.mass_kg));
        // An estimate that contradicts itself is not steered by: the controller keeps level by its own attitude, the height brings down.
        let mut flown = nav;
        if self.arbiter.mode().because == Because::Inconsistent {
            (flown.health.velocity, flown.health.position) = (false, false);
        }
        self.control = self.controller.step(now, dt_s, &flown, &setpoint, phase);
        if self.air == Air::SpoolUp && self.control.lifted_off {
            self.air = Air::Flying;
            self.emit(Output::Event(Event::Landed(
                self.arbiter.landed_state(self.air),
            )));
        }
        self.estimator.set_landed(self.air == Air::Ground);

        // Supervise and emit.
        let may_spin = self.arming.is_armed() && self.air != Air::Ground;
        let hover = self.controller.hover_throttle();
        let has_attitude = nav.health.attitude && self.fc_silent_s(now) <= FC_SILENT_S;
        let own = self
            .supervisor
            .clear(self.control.sticks, may_spin, has_attitude, hover);
        // What leaves the pilot's sticks slowly, and his own, pass the supervisor once more: the last word is its.
        let is_his = self.handover.has_radio();
        let sticks = self.handover.sticks(now, *own.get()).map(|sticks| {
            self.supervisor
                .clear(sticks, may_spin || is_his, has_attitude || is_his, hover)
        });
        self.send_rc(now, sticks.as_ref());
        self.prepare_standby(hover);
        let sent = sticks.map_or(Sticks::IDLE, |s| *s.get());
        self.take_snapshot(now, &nav, &setpoint, sent);
    }

    /// Time that the flight controller has kept us waiting, s.
    fn fc_silent_s(&self, now: Timestamp) -> f64 {
        self.link.heard.map_or(f64::INFINITY, |at| {
            now.since(at.max(self.link.listening_since)).as_secs_f64()
        })
    }

    /// On the floor or not while a pilot flies: nobody tells, so height and throttle do.
    fn watch_pilot(&mut self, dt_s: f64, nav: &NavState) {
        if !self.handover.pilot_steers() || !self.arming.is_armed() || !nav.health.height {
            self.pilot_down_s = 0.0;
            return;
        }
        let above_m = nav.height_m - self.airframe.landed_height_m;
        let is_down = above_m < 0.05 && self.handover.pilot().throttle < 0.1;
        self.pilot_down_s = if is_down {
            self.pilot_down_s + dt_s
        } else {
            0.0
        };
        let air = match self.air {
            Air::Flying if self.pilot_down_s > 1.0 => Air::Ground,
            Air::Ground | Air::SpoolUp if above_m > 0.15 => Air::Flying,
            air => air,
        };
        if air != self.air {
            self.air = air;
            self.emit(Output::Event(Event::Landed(
                self.arbiter.landed_state(self.air),
            )));
        }
    }

    /// Runs a mode or a request with everything it may use.
    fn with_cockpit<R>(
        &mut self,
        now: Timestamp,
        dt_s: f64,
        nav: &NavState,
        run: impl FnOnce(&mut Arbiter, &mut Cockpit<'_>) -> R,
    ) -> R {
        let mut events = ArrayVec::new();
        let mut cockpit = Cockpit {
            now,
            dt_s,
            nav,
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
            self.emit(Output::Event(event));
        }
        result
    }

    fn supervise(&mut self, now: Timestamp, dt_s: f64, loop_gap_s: f64, nav: &NavState) {
        if self.handover.pilot_steers() {
            // A human is in command; nothing here knows better.
            return;
        }
        let has_attitude = nav.health.attitude && self.fc_silent_s(now) <= FC_SILENT_S;
        let is_flying = self.air != Air::Ground;
        if self
            .supervisor
            .is_blind_too_long(dt_s, is_flying, has_attitude)
            && !self.handover.has_radio()
        {
            self.disarm(now);
        }
        let spare_s = self.spare_s(nav);
        let mut supervisor = core::mem::take(&mut self.supervisor);
        let mut verdicts = ArrayVec::<Verdict, { 2 * TABLE.len() }>::new();
        supervisor.watch(&self.facts(now, loop_gap_s, spare_s, nav), |v| {
            let _ = verdicts.try_push(v);
        });
        self.supervisor = supervisor;
        for verdict in verdicts {
            match verdict {
                Verdict::Act(because, mode) => {
                    let notice = match because {
                        Because::NotLocalized if self.arbiter.search_s().is_some() => {
                            Notice::SearchFailed
                        }
                        _ => Notice::Failsafe { because, mode },
                    };
                    self.emit(Output::Event(Event::Notice(notice)));
                    self.with_cockpit(now, 0.0, nav, |arbiter, c| arbiter.enter(c, mode, because));
                }
                Verdict::Stop(because) => {
                    let mode = self.arbiter.mode().mode;
                    let notice = Notice::Failsafe { because, mode };
                    self.emit(Output::Event(Event::Notice(notice)));
                    // The reason stays to be read when the motors are long still.
                    self.with_cockpit(now, 0.0, nav, |arbiter, c| {
                        arbiter.enter(c, Mode::Land, because)
                    });
                    self.disarm(now);
                }
                Verdict::Tell(because) => {
                    self.emit(Output::Event(Event::Notice(Notice::Trouble(because))));
                }
                Verdict::Clear(because) => self.emit(Output::Event(Event::Notice(
                    Notice::FailsafeCleared(because),
                ))),
            }
        }
    }

    /// Leaves the floor or stops the motors as the arbiter ordered.
    fn follow(&mut self, now: Timestamp, nav: &NavState, order: &Order) {
        if order.disarm && self.handover.has_radio() {
            self.rest(now, nav);
        } else if order.disarm {
            self.disarm(now);
        } else if order.lift_off && self.air == Air::Ground && self.arming.is_armed() {
            self.air = Air::SpoolUp;
            self.controller.reset(nav);
            self.emit(Output::Event(Event::Landed(
                self.arbiter.landed_state(self.air),
            )));
        } else if let Arming::Armed { since } = self.arming
            && self.air == Air::Ground
            && !self.handover.has_radio()
        {
            let limit_s = self.settings.autopilot.disarm_preflight_s;
            if limit_s > 0.0 && now.since(since).as_secs_f64() > limit_s {
                self.disarm(now);
            }
        }
    }

    /// Landed beside a radio: throttle at the bottom until the pilot disarms.
    fn rest(&mut self, now: Timestamp, nav: &NavState) {
        if self.air == Air::Ground {
            return;
        }
        self.air = Air::Ground;
        self.controller.reset(nav);
        self.with_cockpit(now, 0.0, nav, |arbiter, c| arbiter.disarmed(c));
        self.emit(Output::Event(Event::Landed(
            self.arbiter.landed_state(self.air),
        )));
    }

    // ---- settings ---------------------------------------------------------------------------------------------

    fn apply_settings(&mut self) {
        let firmware = self.client.identity().map(|identity| identity.firmware);
        self.controller
            .set_params(control_params(&self.settings, firmware));
        self.navigator
            .set_params(self.settings.planner.clone(), self.settings.vfh.clone());
        self.arbiter
            .mission_mut()
            .set_params(self.settings.planner.clone());
    }

    // ---- out ---------------------------------------------------------------------------------------------------

    fn emit(&mut self, output: Output) {
        // The shell drains after every input; a full queue means it does not, and then nothing it misses matters more
        // than staying within bounds.
        let queued = match output {
            Output::Fc(bytes) => Queued::Fc(bytes),
            Output::Answer(answer) => Queued::Answer(answer),
            Output::Event(event) => Queued::Event(event),
            Output::Job(job) => {
                self.job = Some(job);
                return;
            }
        };
        if self.outputs.len() < OUTPUTS {
            self.outputs.push_back(queued);
        }
    }

    fn take_snapshot(
        &mut self,
        now: Timestamp,
        nav: &NavState,
        setpoint: &Setpoint,
        sticks: Sticks,
    ) {
        let statistics = self.client.statistics();
        self.fc.service_rate_hz = statistics.service_rate_hz;
        self.fc.round_trip_us = statistics.rtt_us;
        self.fc.bad_frames = statistics.bad_frames;
        self.fc.timeouts = statistics.timeouts;
        self.fc.steering = self.handover.steering();
        self.snapshot.rangers_alive = self
            .ring
            .horizontal_at()
            .is_some_and(|at| now.since(at) < Duration::from_secs(1));
        let blocked = if self.arming.is_armed() {
            None
        } else {
            health::first_failure(&self.checks(now))
        };
        let s = &mut self.snapshot;
        s.at = now;
        s.nav = *nav;
        s.mode = self.arbiter.mode();
        s.is_armed = self.arming.is_armed();
        s.landed = self.arbiter.landed_state(self.air);
        s.is_key_mode = self.arbiter.is_key_mode();
        s.arm_blocked_by = blocked;
        s.setpoint = Some(*setpoint);
        s.attitude_target = vehicle::Rot::from_roll_pitch_yaw(
            self.control.roll_sp_rad,
            self.control.pitch_sp_rad,
            self.control.yaw_sp_rad,
        );
        s.velocity_target = self.control.velocity_sp;
        s.thrust_target = self.control.thrust_fraction;
        s.accel_target = self.control.accel_sp;
        s.yaw_rate_target_radps = self.control.yaw_rate_sp_radps;
        s.avoidance = self.navigator.avoidance();
        s.sticks = sticks;
        s.fc = self.fc;
        s.flight_loop.sample_to_command = self.latency.summary();
        s.scan = self.ring.picture(now);
        s.mission = self.arbiter.mission_status();
        s.home = self.home;
        s.home_yaw_rad = self.home_yaw_rad;
    }
}

/// Tuning, with the stick curves of the firmware where they are left to it.
fn control_params(settings: &Settings, firmware: Option<Firmware>) -> ControlParams {
    let mut params = settings.control.clone();
    if let Some(firmware) = firmware {
        stock_curves::apply(firmware, &mut params);
    }
    params
}

/// A known start is known this well, m.
const START_STD_M: f64 = 0.05;
/// A known start is known this well, rad.
const START_STD_RAD: f64 = 0.05;
