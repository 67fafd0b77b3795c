//! The tick on one page: sense, estimate, arbitrate, plan, control, supervise, emit.
//!
//! [`Flight`] is a pure machine: [`handle`](Flight::handle) takes an input with its time, [`poll`](Flight::poll) hands
//! out what is to be done, [`deadline`](Flight::deadline) says when to wake it. After construction it allocates nothing
//! that grows, formats no text, opens no file.
//!
//! After each `handle`, poll until `None`.

use super::arbiter::{Arbiter, Order};
use super::arming::{Arming, Change, FcArmState};
use super::door::{
    Answer, Asked, Event, FcBlock, FcStatus, Notice, Outcome, Refusal, Request, RequestId,
    Snapshot, Station,
};
use super::health::{self, Checks};
use super::io::{FcBytes, Input, Output};
use super::mode::{Because, Mode};
use super::modes::{Air, Cockpit};
use super::supervisor::{Facts, Supervisor, Verdict};
use crate::fc::convert::{Convert, REPLY_WIRE_TIME, four_letters};
use crate::fc::{poll, rc_out, stock_curves};
use crate::sensor::ring::{Measured, Ring};
use crate::settings::{Origin, Settings};
use arrayvec::ArrayVec;
use control::{ControlOutput, ControlParams, Controller, Phase};
use core::time::Duration;
use estimator::Estimator;
use msp::client::Client;
use msp::firmware::{Firmware, box_id};
use msp::message::Reply;
use planner::mission::Mission;
use planner::navigator::Navigator;
use std::collections::VecDeque;
use std::sync::Arc;
use vehicle::{
    Airframe, DownRange, FloorPlan, FlowSample, In, MapAnchor, MapPose, NavState, Ned, Pace,
    RingConfig, Setpoint, Sticks, Timestamp,
};

/// Outputs that wait to be polled at most; a tick makes about ten.
const OUTPUTS: usize = 256;

/// Where the vehicle stands at start.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    arming: Arming,
    fc_arm: FcArmState,
    fc: FcStatus,
    air: Air,
    home: In<Ned>,
    home_yaw_rad: f64,
    pace: Pace,
    last_tick: Timestamp,
    localized_at: Option<Timestamp>,
    reset_counter: u8,
    ground_heard: Option<Timestamp>,
    shutting_down: bool,
    control: ControlOutput,
    snapshot: Snapshot,
    outputs: VecDeque<Output>,
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
        let pace = Pace::starting_at(
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
            arming: Arming::Disarmed,
            fc_arm: FcArmState::default(),
            fc: FcStatus::default(),
            air: Air::Ground,
            home: In::zero(),
            home_yaw_rad,
            pace,
            last_tick: now,
            localized_at: None,
            reset_counter: 0,
            ground_heard: None,
            shutting_down: false,
            control: ControlOutput::default(),
            snapshot: Snapshot {
                home_yaw_rad,
                ..Snapshot::default()
            },
            outputs: VecDeque::with_capacity(OUTPUTS),
            settings,
        }
    }

    /// Takes an input; ticks when a tick is due.
    pub fn handle(&mut self, now: Timestamp, input: Input) {
        match input {
            Input::Fc(bytes) => self.client.handle(now.us(), &bytes),
            Input::FcOpened => self.client.connect(now.us()),
            Input::Ranger(reading) => self.range(&reading),
            Input::DownRange(sample) => self.down_range(&sample),
            Input::Flow(sample) => self.flow(&sample),
            Input::Asked(asked) => self.asked(now, &asked),
            Input::JobDone(result) => self.estimator.search_done(&result),
            Input::Wake => {}
        }
        self.listen();
        if self.pace.is_due(now) {
            self.tick(now);
        }
        self.transmit(now);
    }

    /// The next thing to do, if any.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When to call [`handle`](Self::handle) with [`Input::Wake`] if nothing else happens.
    #[must_use]
    pub fn deadline(&self) -> Timestamp {
        let client = self
            .client
            .deadline_us()
            .map_or(self.pace.next(), Timestamp::from_us);
        self.pace.next().min(client)
    }

    /// Everything the ground may want to know, as of the last tick.
    #[must_use]
    pub const fn snapshot(&self) -> &Snapshot {
        &self.snapshot
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
        let periods = since_last.as_micros() / self.pace.period().as_micros().max(1);
        self.snapshot.flight_loop.missed += periods.saturating_sub(1) as u64;

        // Estimate.
        self.estimator.update(now);
        if let Some(job) = self.estimator.poll_job() {
            self.emit(Output::Job(job));
        }
        let nav = *self.estimator.state();
        self.notice_localization(now, &nav);
        self.confirm_arming(now);

        // Arbitrate and plan.
        self.supervise(now, &nav);
        let touched_down = self.control.landed;
        let order = self.with_cockpit(now, dt_s, &nav, |arbiter, cockpit| {
            arbiter.step(cockpit, touched_down)
        });
        self.follow(now, &nav, &order);

        // Control.
        let setpoint = if self.arming.is_armed() {
            order.setpoint
        } else {
            Setpoint::Idle
        };
        let phase = match self.air {
            Air::Ground => Phase::Idle,
            Air::SpoolUp => Phase::SpoolUp,
            Air::Flying => Phase::Flying,
        };
        self.controller
            .set_mass(self.arbiter.key_mass_kg().unwrap_or(self.airframe.mass_kg));
        self.control = self.controller.step(now, dt_s, &nav, &setpoint, phase);
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
        let sticks =
            self.supervisor
                .clear(self.control.sticks, may_spin, nav.health.attitude, hover);
        self.send_rc(now, &sticks);
        self.take_snapshot(now, &nav, &setpoint, *sticks.get());
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

    fn supervise(&mut self, now: Timestamp, nav: &NavState) {
        let since =
            |at: Option<Timestamp>| at.map_or(f64::INFINITY, |at| now.since(at).as_secs_f64());
        let mode = self.arbiter.mode().mode;
        let facts = Facts {
            mode,
            is_flying: self.air == Air::Flying,
            is_armed: self.arming.is_armed(),
            has_attitude_and_height: nav.health.attitude && nav.health.height,
            not_localized_s: since(self.localized_at),
            search_s: self.arbiter.search_s(),
            rangers_silent_s: since(self.ring.horizontal_at()),
            ground_silent_s: self.ground_heard.map(|at| now.since(at).as_secs_f64()),
            offboard_silent_s: self.arbiter.offboard_silent_s(now),
            manual_silent_s: self.arbiter.manual_silent_s(now),
            battery: self.snapshot.battery.and_then(|b| b.remaining),
            params: &self.settings.autopilot,
        };
        let mut verdicts = ArrayVec::<Verdict, 16>::new();
        self.supervisor.watch(&facts, |v| {
            let _ = verdicts.try_push(v);
        });
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
                Verdict::Clear(because) => self.emit(Output::Event(Event::Notice(
                    Notice::FailsafeCleared(because),
                ))),
            }
        }
    }

    /// Leaves the floor or stops the motors as the arbiter ordered.
    fn follow(&mut self, now: Timestamp, nav: &NavState, order: &Order) {
        if order.disarm {
            self.disarm(now);
        } else if order.lift_off && self.air == Air::Ground && self.arming.is_armed() {
            self.air = Air::SpoolUp;
            self.controller.reset(nav);
            self.emit(Output::Event(Event::Landed(
                self.arbiter.landed_state(self.air),
            )));
        } else if let Arming::Armed { since } = self.arming
            && self.air == Air::Ground
        {
            let limit_s = self.settings.autopilot.disarm_preflight_s;
            if limit_s > 0.0 && now.since(since).as_secs_f64() > limit_s {
                self.disarm(now);
            }
        }
    }

    // ---- flight controller -------------------------------------------------------------------------------------

    /// Takes in what the flight controller said.
    fn listen(&mut self) {
        use msp::client::Event as Said;
        while let Some(said) = self.client.poll_event() {
            match said {
                Said::Identified(identity) => {
                    self.convert = Some(Convert::new(identity.firmware));
                    let params = control_params(&self.settings, Some(identity.firmware));
                    self.controller.set_params(params);
                    let version = [
                        identity.version.major,
                        identity.version.minor,
                        identity.version.patch,
                    ];
                    let variant = four_letters(identity.firmware);
                    self.fc.is_connected = true;
                    self.fc.variant = variant;
                    self.fc.version = version;
                    self.fc.api = [identity.api.major, identity.api.minor];
                    self.emit(Output::Event(Event::Notice(Notice::FcFound {
                        variant,
                        version,
                    })));
                }
                Said::Reply {
                    reply, received_us, ..
                } => self.reply(Timestamp::from_us(received_us), &reply),
                Said::Lost { .. } => {
                    if self.fc.is_connected {
                        self.emit(Output::Event(Event::Notice(Notice::FcLost)));
                    }
                    self.fc.is_connected = false;
                    self.snapshot.imu = None;
                }
                Said::Slow {
                    service_rate_hz,
                    cli_line,
                    ..
                } => self.emit(Output::Event(Event::Notice(Notice::FcSlow {
                    service_hz: service_rate_hz.round() as u16,
                    has_cli_line: cli_line.is_some(),
                }))),
                Said::Restarted => {
                    self.emit(Output::Event(Event::Notice(Notice::FcRestarted)));
                }
                Said::Stalled => self.emit(Output::Event(Event::Notice(Notice::FcStalled))),
                Said::Changed(_)
                | Said::Recovered { .. }
                | Said::Refused { .. }
                | Said::Unanswered { .. }
                | Said::Malformed(_) => {}
            }
        }
    }

    fn reply(&mut self, received: Timestamp, reply: &Reply) {
        let sampled = received - REPLY_WIRE_TIME;
        let Some(convert) = &mut self.convert else {
            return;
        };
        match reply {
            Reply::Attitude(a) => {
                let sample = convert.attitude(sampled, a);
                self.estimator.attitude(&sample);
                let age = self.last_tick.seconds_since(sampled).max(0.0);
                self.snapshot.flight_loop.sample_to_command_us = age * 1e6;
            }
            Reply::RawImu(raw) => {
                let at_rest = !self.arming.switch_is_high();
                if let Some(sample) = convert.imu(sampled, raw, at_rest) {
                    self.estimator.imu(&sample);
                    self.snapshot.imu = Some(sample);
                }
            }
            Reply::Altitude(a) => {
                let sample = convert.baro(sampled, a);
                self.estimator.baro(&sample);
                self.snapshot.baro = Some(sample);
            }
            Reply::BatteryState(b) => self.snapshot.battery = Some(convert.battery(sampled, b)),
            Reply::Analog(a) => {
                self.fc.rssi = Some(convert.rssi(a.rssi));
                // A message of its own that tells the cells says more.
                if self.snapshot.battery.is_none_or(|b| b.cells == 0) {
                    self.snapshot.battery = Some(convert.battery_of_analog(sampled, a));
                }
            }
            Reply::InavAnalog(a) => {
                self.fc.rssi = Some(convert.rssi(a.rssi));
                self.snapshot.battery = Some(convert.battery_of_inav(sampled, a));
            }
            Reply::Status(_) | Reply::StatusEx(_) | Reply::InavStatus(_) => {
                self.status(received, reply)
            }
            _ => {}
        }
    }

    fn status(&mut self, received: Timestamp, reply: &Reply) {
        let Some(identity) = self.client.identity() else {
            return;
        };
        let block = identity.arming_blockers(reply).next().map(|blocker| {
            let mut name = arrayvec::ArrayString::new();
            for c in blocker.name.chars() {
                let _ = name.try_push(c);
            }
            FcBlock(name)
        });
        let is_armed = identity.is_box_active(box_id::ARM, reply).unwrap_or(false);
        self.fc_arm = FcArmState {
            is_armed,
            block,
            at: Some(received),
        };
        self.fc.block = block;
        if let Reply::StatusEx(s) = reply {
            self.fc.load_percent = f64::from(s.load_pct);
        }
    }

    fn send_rc(&mut self, now: Timestamp, sticks: &super::supervisor::Cleared<Sticks>) {
        let Some(identity) = self.client.identity() else {
            return;
        };
        let (wire, telemetry) =
            rc_out::channels(sticks, self.arming.switch_is_high(), &identity.rx_map);
        self.client.set_rc(now.us(), &wire);
        self.snapshot.rc_us = telemetry;
    }

    fn transmit(&mut self, now: Timestamp) {
        while let Some(bytes) = self.client.poll_transmit(now.us()) {
            for chunk in bytes.chunks(FcBytes::new_const().capacity()) {
                let mut out = FcBytes::new();
                let _ = out.try_extend_from_slice(chunk);
                if self.outputs.len() < OUTPUTS {
                    self.outputs.push_back(Output::Fc(out));
                }
            }
        }
    }

    // ---- sensors of the companion computer ---------------------------------------------------------------------

    fn range(&mut self, reading: &vehicle::RangerReading) {
        let mut measured = ArrayVec::<Measured, 2>::new();
        self.ring.read(reading, |m| {
            let _ = measured.try_push(m);
        });
        for m in measured {
            match m {
                Measured::Scan(scan) => {
                    self.estimator.scan(&scan);
                    self.navigator.observe(&scan, self.estimator.state());
                }
                Measured::Down(sample) => self.down_range(&sample),
            }
        }
    }

    fn down_range(&mut self, sample: &DownRange) {
        self.estimator.down_range(sample);
        self.snapshot.down_range = Some(*sample);
    }

    fn flow(&mut self, sample: &FlowSample) {
        self.estimator.flow(sample);
        self.snapshot.flow = Some(*sample);
    }

    fn notice_localization(&mut self, now: Timestamp, nav: &NavState) {
        let was_lost = self
            .localized_at
            .is_none_or(|at| now.since(at) > Duration::from_millis(500));
        if nav.localization.reset_counter != self.reset_counter {
            self.reset_counter = nav.localization.reset_counter;
            self.controller.reset(nav);
            self.arbiter.relocalized(was_lost);
        }
        if nav.health.position {
            if self.localized_at.is_none() || was_lost {
                let place = self.anchor.to_map(nav.position);
                let notice = Notice::Localized {
                    x_m: place.x(),
                    y_m: place.y(),
                };
                self.emit(Output::Event(Event::Notice(notice)));
            }
            self.localized_at = Some(now);
        } else if self.snapshot.nav.health.position {
            self.emit(Output::Event(Event::Notice(Notice::LocalizationLost)));
        }
    }

    // ---- arming ------------------------------------------------------------------------------------------------

    fn confirm_arming(&mut self, now: Timestamp) {
        match self.arming.step(now, &self.fc_arm) {
            Some(Change::Armed(asked)) => {
                self.emit(Output::Event(Event::Armed(true)));
                self.answer_arming(asked, Outcome::Accepted);
            }
            Some(Change::Failed(asked)) => {
                let why = self
                    .fc_arm
                    .block
                    .map_or(Refusal::FcDidNotArm, |flag| Refusal::FcBlocks { flag });
                self.answer_arming(asked, Outcome::Refused(why));
            }
            Some(Change::DisarmedByController) => {
                self.emit(Output::Event(Event::Notice(Notice::FcDisarmed)));
                self.disarm(now);
            }
            None => {}
        }
    }

    fn answer_arming(&mut self, asked: Option<(RequestId, Station)>, outcome: Outcome) {
        if let Some((id, station)) = asked {
            self.emit(Output::Answer(Answer {
                id,
                station,
                outcome,
            }));
        }
    }

    fn disarm(&mut self, now: Timestamp) {
        self.arming.lower();
        self.air = Air::Ground;
        let nav = *self.estimator.state();
        self.controller.reset(&nav);
        self.emit(Output::Event(Event::Armed(false)));
        self.with_cockpit(now, 0.0, &nav, |arbiter, c| arbiter.disarmed(c));
        self.emit(Output::Event(Event::Landed(
            self.arbiter.landed_state(self.air),
        )));
    }

    // ---- requests ----------------------------------------------------------------------------------------------

    fn asked(&mut self, now: Timestamp, asked: &Asked) {
        let nav = *self.estimator.state();
        let outcome = match &asked.request {
            Request::Arm { force } => match self.arm(now, asked, *force) {
                Ok(Some(outcome)) => Ok(outcome),
                Ok(None) => return, // Answered when the controller confirms.
                Err(why) => Err(why),
            },
            Request::Disarm { force } => self.ask_disarm(now, *force),
            Request::Key(super::door::Key::Escape) if self.air == Air::Ground => {
                self.ask_disarm(now, false)
            }
            Request::SetParam { index, value } => {
                let changed = self
                    .settings
                    .set(usize::from(*index), *value, Origin::Mavlink);
                self.apply_settings();
                changed
                    .map(|_| Outcome::Accepted)
                    .map_err(|_| Refusal::BadNumber)
            }
            Request::SetHome(place) => self.set_home(&nav, *place),
            Request::GroundHeartbeat => {
                self.ground_heard = Some(now);
                Ok(Outcome::Accepted)
            }
            Request::ShutDown => {
                self.shutting_down = true;
                if self.air == Air::Ground {
                    self.ask_disarm(now, true)
                } else {
                    let because = Because::ShuttingDown;
                    self.with_cockpit(now, 0.0, &nav, |arbiter, c| {
                        arbiter.enter(c, Mode::Land, because)
                    });
                    Ok(Outcome::Accepted)
                }
            }
            _ => {
                let is_armed = self.arming.is_armed();
                self.with_cockpit(now, 0.0, &nav, |arbiter, c| {
                    arbiter.request(c, asked, is_armed)
                })
            }
        };
        let outcome = outcome.unwrap_or_else(Outcome::Refused);
        self.emit(Output::Answer(Answer {
            id: asked.id,
            station: asked.station,
            outcome,
        }));
    }

    fn arm(
        &mut self,
        now: Timestamp,
        asked: &Asked,
        force: bool,
    ) -> Result<Option<Outcome>, Refusal> {
        if self.arming.is_armed() {
            return Ok(Some(Outcome::Accepted));
        }
        let checks = self.checks();
        let failure = if force {
            health::controller_failure(&checks)
        } else {
            health::first_failure(&checks)
        };
        if let Some(why) = failure {
            return Err(why);
        }
        self.arming.raise(now, Some((asked.id, asked.station)));
        Ok(None)
    }

    fn ask_disarm(&mut self, now: Timestamp, force: bool) -> Result<Outcome, Refusal> {
        if self.air != Air::Ground && !force {
            return Err(Refusal::Flying);
        }
        if self.arming.switch_is_high() {
            self.disarm(now);
        }
        Ok(Outcome::Accepted)
    }

    fn set_home(&mut self, nav: &NavState, place: Option<In<Ned>>) -> Result<Outcome, Refusal> {
        let home = match place {
            Some(p) if p.is_finite() => p,
            Some(_) => return Err(Refusal::BadNumber),
            None if nav.health.position => nav.position.with_z(0.0),
            None => return Err(Refusal::NotLocalized),
        };
        self.home = home;
        self.home_yaw_rad = nav.yaw_rad();
        self.emit(Output::Event(Event::HomeSet));
        Ok(Outcome::Accepted)
    }

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

    fn checks(&self) -> Checks<'_> {
        Checks {
            fc_is_connected: self.fc.is_connected,
            fc: &self.fc_arm,
            nav: self.estimator.state(),
            rangers_alive: self.snapshot.rangers_alive,
            battery: self.snapshot.battery.and_then(|b| b.remaining),
            is_shutting_down: self.shutting_down,
            params: &self.settings.autopilot,
        }
    }

    // ---- out ---------------------------------------------------------------------------------------------------

    fn emit(&mut self, output: Output) {
        // The shell drains after every input; a full queue means it does not, and then nothing it misses matters more
        // than staying within bounds.
        if self.outputs.len() < OUTPUTS {
            self.outputs.push_back(output);
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
        self.snapshot.rangers_alive = self
            .ring
            .horizontal_at()
            .is_some_and(|at| now.since(at) < Duration::from_secs(1));
        let blocked = if self.arming.is_armed() {
            None
        } else {
            health::first_failure(&self.checks())
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
        s.sticks = sticks;
        s.fc = self.fc;
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
