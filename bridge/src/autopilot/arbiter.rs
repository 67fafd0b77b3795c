//! Who steers: modes, requests of stations, and the one active set point.
//!
//! Every request that moves the vehicle passes here, and only here is the active [`Setpoint`] built. Streams (manual,
//! off-board) belong to the station that began them until it is silent for a second.

use super::door::{
    Asked, Event, FigureRequest, GoTo, Key, LandedState, ManualInput, MissionState, MissionStatus,
    Notice, Outcome, Refusal, Request, Station,
};
use super::mode::{Because, Mode, ModeState};
use super::modes::climb::Climb;
use super::modes::descent::Descent;
use super::modes::figure::{FigureFlight, Progress};
use super::modes::hold::{Hold, Target};
use super::modes::homeward::Homeward;
use super::modes::mission::MissionMode;
use super::modes::offboard::{Offboard, Streamed};
use super::modes::sticks::SticksMode;
use super::modes::{Air, Cockpit, Wish};
use core::time::Duration;
use planner::mission::{Mission, Plan};
use std::sync::Arc;
use vehicle::{Heading, Setpoint, Timestamp};

/// A stream's owner silent for longer may be followed by another station.
const OWNER_SILENT: Duration = Duration::from_secs(1);
/// A second STOP within this lands.
const STOP_AGAIN: Duration = Duration::from_secs(3);

/// Station that a stream belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Owner(Option<(Station, Timestamp)>);

impl Owner {
    fn claim(&mut self, now: Timestamp, station: Station) -> Result<(), Refusal> {
        match self.0 {
            Some((owner, last)) if owner != station && now.since(last) < OWNER_SILENT => {
                Err(Refusal::OtherStation {
                    system: owner.system,
                })
            }
            _ => {
                self.0 = Some((station, now));
                Ok(())
            }
        }
    }
}

/// What control is to do this tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// The active set point.
    pub setpoint: Setpoint,
    /// True if the vehicle shall leave the floor now.
    pub lift_off: bool,
    /// True if the motors shall stop.
    pub disarm: bool,
}

/// Modes and requests.
#[derive(Clone, Debug)]
pub struct Arbiter {
    mode: ModeState,
    hold: Hold,
    /// Flown in Hold until something else is asked for.
    figure: Option<FigureFlight>,
    climb: Climb,
    descent: Descent,
    homeward: Homeward,
    mission_mode: MissionMode,
    offboard_mode: Offboard,
    sticks_mode: SticksMode,
    mission: Mission,
    plan_items: u16,
    manual: Option<(ManualInput, Timestamp)>,
    manual_owner: Owner,
    offboard: Option<Streamed>,
    offboard_owner: Owner,
    mode_since: Timestamp,
    last_stop: Option<Timestamp>,
    cruise_mps: Option<f64>,
}

impl Arbiter {
    /// In Hold, with no plan.
    #[must_use]
    pub fn new(mission: Mission, takeoff_height_m: f64) -> Self {
        Self {
            mode: ModeState::default(),
            hold: Hold::default(),
            figure: None,
            climb: Climb::to(takeoff_height_m),
            descent: Descent::here(),
            homeward: Homeward::default(),
            mission_mode: MissionMode::default(),
            offboard_mode: Offboard::default(),
            sticks_mode: SticksMode::default(),
            mission,
            plan_items: 0,
            manual: None,
            manual_owner: Owner::default(),
            offboard: None,
            offboard_owner: Owner::default(),
            mode_since: Timestamp::ZERO,
            last_stop: None,
            cruise_mps: None,
        }
    }

    /// Mode and why.
    #[must_use]
    pub const fn mode(&self) -> ModeState {
        self.mode
    }

    /// Manual mode of the key console.
    #[must_use]
    pub const fn is_key_mode(&self) -> bool {
        self.hold.keys.is_on()
    }

    /// Mass set by keys, kg.
    #[must_use]
    pub const fn key_mass_kg(&self) -> Option<f64> {
        self.hold.keys.mass_kg()
    }

    /// The mission executor, for its parameters.
    pub const fn mission_mut(&mut self) -> &mut Mission {
        &mut self.mission
    }

    /// Duration of the search so far, s; none outside of a take-off. A place lost while climbing is searched for too.
    #[must_use]
    pub fn search_s(&self) -> Option<f64> {
        (self.mode.mode == Mode::Takeoff).then(|| self.climb.search_s().unwrap_or(0.0))
    }

    /// Time since the last manual input or since its mode began, s.
    #[must_use]
    pub fn manual_silent_s(&self, now: Timestamp) -> f64 {
        let heard = self.manual.map_or(Timestamp::ZERO, |(_, at)| at);
        now.since(heard.max(self.mode_since)).as_secs_f64()
    }

    /// Time since the last off-board set point, s.
    #[must_use]
    pub fn offboard_silent_s(&self, now: Timestamp) -> f64 {
        self.offboard
            .map_or(f64::INFINITY, |s| now.since(s.at).as_secs_f64())
    }

    /// On the ground or not, for the ground.
    #[must_use]
    pub const fn landed_state(&self, air: Air) -> LandedState {
        match (air, self.mode.mode) {
            (Air::Ground, _) => LandedState::OnGround,
            (Air::SpoolUp, _) | (Air::Flying, Mode::Takeoff) => LandedState::TakingOff,
            (Air::Flying, Mode::Land) => LandedState::Landing,
            (Air::Flying, _) => LandedState::InAir,
        }
    }

    /// Where the plan stands.
    #[must_use]
    pub fn mission_status(&self) -> MissionStatus {
        use planner::mission::MissionState as M;
        let state = match self.mission.state() {
            M::Empty => MissionState::None,
            M::Ready => MissionState::NotStarted,
            M::Active if self.mode.mode == Mode::Mission => MissionState::Active,
            M::Active | M::Paused => MissionState::Paused,
            M::Complete => MissionState::Complete,
        };
        MissionStatus {
            seq: self.mission.seq(),
            total: self.plan_items,
            state,
        }
    }

    /// The estimate jumped (relocalisation): targets that meant "here" are taken anew.
    pub fn relocalized(&mut self, was_lost: bool) {
        self.climb.relocalized();
        self.descent.relocalized();
        self.sticks_mode.relocalized();
        if was_lost {
            self.figure = None;
            self.hold.forget_target();
            self.mission_mode.relocalized();
        }
    }

    /// Somebody else steers: what meant "here" will mean where he leaves the vehicle.
    pub fn carried(&mut self) {
        self.hold.forget_target();
        self.sticks_mode.relocalized();
    }

    /// The motors stopped: back to a fresh Hold, unless a mode is waiting for the next arm.
    pub fn disarmed(&mut self, c: &mut Cockpit<'_>) {
        self.hold.keys.switch_off();
        if self.mode.mode != Mode::Mission
            || self.mission.state() == planner::mission::MissionState::Active
        {
            self.enter(c, Mode::Hold, Because::Finished);
        }
    }

    /// Changes the mode without asking whether it is allowed; the supervisor's way.
    pub fn enter(&mut self, c: &mut Cockpit<'_>, mode: Mode, because: Because) {
        let next = ModeState { mode, because };
        self.figure = None;
        if self.mode == next && mode != Mode::Takeoff {
            return;
        }
        if self.mode.mode == Mode::Mission && mode != Mode::Mission {
            self.mission.pause();
        }
        self.hold.keys.switch_off();
        self.mode = next;
        self.mode_since = c.now;
        let _ = c.events.try_push(Event::Mode(next));
        match mode {
            Mode::Hold => {
                self.hold.forget_target();
            }
            Mode::Mission => {
                self.mission_mode = MissionMode::default();
                // Without a plan there is nothing to resume; `may_fly_mission` was asked before.
                let _ = self.mission.resume();
            }
            Mode::Return => self.homeward = Homeward::default(),
            Mode::Land => self.descent = Descent::here(),
            Mode::Takeoff => {}
            Mode::Offboard => self.offboard_mode = Offboard::default(),
            Mode::Position | Mode::Altitude | Mode::Stabilized => {
                self.sticks_mode = SticksMode::default()
            }
        }
    }

    /// A request that concerns modes, goals or streams; arming is `Flight`'s.
    ///
    /// # Errors
    /// The reason why not; nothing has changed then.
    pub fn request(
        &mut self,
        c: &mut Cockpit<'_>,
        asked: &Asked,
        is_armed: bool,
    ) -> Result<Outcome, Refusal> {
        let accepted = |()| Outcome::Accepted;
        match &asked.request {
            Request::SetMode(mode) => self.set_mode(c, *mode, is_armed).map(accepted),
            Request::Takeoff { height_m } => self.take_off(c, *height_m).map(accepted),
            Request::GoTo(to) => {
                self.need_place(c)?;
                if c.air != Air::Flying {
                    return Err(Refusal::NotFlying);
                }
                // Checked before the mode changes, so that a refused goal interrupts nothing.
                let mut hold = if self.mode.mode == Mode::Hold {
                    self.hold
                } else {
                    Hold::default()
                };
                hold.keys.switch_off();
                hold.go_to(
                    c,
                    &GoTo {
                        speed_mps: to.speed_mps.or(self.cruise_mps),
                        ..*to
                    },
                )?;
                if self.mode.mode != Mode::Hold {
                    self.enter(c, Mode::Hold, Because::Asked);
                }
                self.figure = None;
                self.hold = hold;
                Ok(Outcome::Accepted)
            }
            Request::Figure(asked) => {
                self.need_place(c)?;
                if c.air != Air::Flying {
                    return Err(Refusal::NotFlying);
                }
                let speed_mps = asked.speed_mps.or(self.cruise_mps);
                let figure = FigureFlight::begin(
                    c,
                    &FigureRequest {
                        speed_mps,
                        ..*asked
                    },
                )?;
                if self.mode.mode != Mode::Hold {
                    self.enter(c, Mode::Hold, Because::Asked);
                }
                self.hold.keys.switch_off();
                self.figure = Some(figure);
                Ok(Outcome::Accepted)
            }
            Request::SetPlan(plan) => {
                self.load(c, plan);
                Ok(Outcome::Accepted)
            }
            Request::SetSite(site) => {
                let old = c.navigator.set_site(Arc::clone(site));
                // Freeing it is not the flight loop's work.
                let _ = c.events.try_push(Event::SiteRetired(old));
                self.keep_inside(c);
                Ok(Outcome::Accepted)
            }
            Request::SetMissionItem(seq) => self.set_item(*seq).map(accepted),
            Request::StartMission { first } => {
                if !is_armed {
                    return Err(Refusal::NotArmed);
                }
                self.may_fly_mission(c)?;
                self.set_item(*first)?;
                self.enter(c, Mode::Mission, Because::Asked);
                Ok(Outcome::Accepted)
            }
            Request::ChangeSpeed(mps) => {
                if !(mps.is_finite() && *mps > 0.0) {
                    return Err(Refusal::BadNumber);
                }
                self.cruise_mps = Some(*mps);
                Ok(Outcome::Accepted)
            }
            Request::Manual(input) => {
                self.manual_owner.claim(c.now, asked.station)?;
                self.manual = Some((*input, c.now));
                if self.mode.mode.is_stick_mode() {
                    Ok(Outcome::Accepted)
                } else {
                    Err(Refusal::NotStickMode)
                }
            }
            Request::RcOverride(channels) => {
                self.manual_owner.claim(c.now, asked.station)?;
                let [roll, pitch, throttle, yaw] = *channels;
                let axis = |us: Option<u16>| us.map(|us| (f64::from(us) - 1500.0) / 500.0);
                let input = ManualInput {
                    // An RC pitch channel above centre is nose down, which flies forward.
                    forward: axis(pitch),
                    right: axis(roll),
                    yaw: axis(yaw),
                    throttle: throttle
                        .map(|us| ((f64::from(us) - 1000.0) / 1000.0).clamp(0.0, 1.0)),
                };
                self.manual = Some((input, c.now));
                if self.mode.mode.is_stick_mode() {
                    Ok(Outcome::Accepted)
                } else {
                    Err(Refusal::NotStickMode)
                }
            }
            Request::Offboard(setpoint) => {
                setpoint.check()?;
                self.offboard_owner.claim(c.now, asked.station)?;
                self.offboard = Some(Streamed {
                    setpoint: *setpoint,
                    at: c.now,
                });
                Ok(Outcome::Accepted)
            }
            Request::Key(key) => self.key(c, *key),
            Request::Stop => {
                let again = self
                    .last_stop
                    .is_some_and(|at| c.now.since(at) < STOP_AGAIN);
                self.last_stop = Some(c.now);
                self.figure = None;
                if c.air == Air::Flying {
                    let mode = if again { Mode::Land } else { Mode::Hold };
                    self.enter(c, mode, Because::Asked);
                    if mode == Mode::Hold {
                        self.hold.stop(c);
                    }
                }
                Ok(Outcome::Accepted)
            }
            Request::Arm { .. }
            | Request::Disarm { .. }
            | Request::SetHome(_)
            | Request::SetParam { .. }
            | Request::GroundHeartbeat
            | Request::Calibrate(_)
            | Request::EndBenchWork
            | Request::TurnMotor(_)
            | Request::RestartFc
            | Request::Sensed(_)
            | Request::ShutDown => Err(Refusal::Unsupported),
            Request::Inject(_) => Err(Refusal::NotSimulated),
        }
    }

    fn set_mode(&mut self, c: &mut Cockpit<'_>, mode: Mode, is_armed: bool) -> Result<(), Refusal> {
        let flying = c.air == Air::Flying;
        match mode {
            Mode::Hold | Mode::Stabilized | Mode::Altitude => {}
            Mode::Position => {
                if flying {
                    self.need_place(c)?;
                }
            }
            Mode::Land => {
                if !is_armed {
                    return Err(Refusal::NotFlying);
                }
            }
            Mode::Return => {
                self.need_place(c)?;
                if !flying {
                    return Err(Refusal::NotFlying);
                }
            }
            Mode::Mission => self.may_fly_mission(c)?,
            Mode::Takeoff => return self.take_off(c, None),
            Mode::Offboard => {
                if self.offboard_silent_s(c.now) > c.params.offboard_loss_s {
                    return Err(Refusal::NoOffboardStream);
                }
                self.need_place(c)?;
            }
        }
        let was = self.mode.mode;
        self.enter(c, mode, Because::Asked);
        if mode == Mode::Hold && was != Mode::Hold && flying && c.nav.health.position {
            self.hold.stop(c);
        }
        Ok(())
    }

    fn may_fly_mission(&self, c: &Cockpit<'_>) -> Result<(), Refusal> {
        if self.plan_items == 0 {
            return Err(Refusal::NoPlan);
        }
        self.need_place(c)
    }

    fn need_place(&self, c: &Cockpit<'_>) -> Result<(), Refusal> {
        if c.nav.health.position {
            Ok(())
        } else {
            Err(Refusal::NotLocalized)
        }
    }

    fn take_off(&mut self, c: &mut Cockpit<'_>, height_m: Option<f64>) -> Result<(), Refusal> {
        let height_m = height_m.unwrap_or(c.params.takeoff_height_m);
        if !height_m.is_finite() {
            return Err(Refusal::BadNumber);
        }
        let height_m = height_m.clamp(super::modes::MIN_HEIGHT_M, c.params.ceiling_m);
        if c.air == Air::Flying {
            // Already up: only the height changes.
            self.need_place(c)?;
            let to = GoTo {
                down_m: Some(c.home.z() - height_m),
                ..Default::default()
            };
            self.enter(c, Mode::Hold, Because::Asked);
            return self.hold.go_to(c, &to);
        }
        if !c.nav.health.position && !c.params.search {
            return Err(Refusal::SearchDisabled);
        }
        self.climb = Climb::to(height_m);
        self.enter(c, Mode::Takeoff, Because::Asked);
        Ok(())
    }

    fn load(&mut self, c: &mut Cockpit<'_>, plan: &Arc<Plan>) {
        self.plan_items = u16::try_from(plan.items.len()).unwrap_or(u16::MAX);
        if let Some(old) = self.mission.load(Some(Arc::clone(plan))) {
            // The old plan goes back through the door: freeing it is not the flight loop's work.
            let _ = c.events.try_push(Event::PlanRetired(old));
        }
        if self.mode.mode == Mode::Mission {
            self.enter(c, Mode::Hold, Because::Asked);
        }
    }

    /// The fence is another one: a goal beyond it is dropped, an item looked at anew.
    fn keep_inside(&mut self, c: &mut Cockpit<'_>) {
        if c.air != Air::Flying || !c.nav.health.position {
            return;
        }
        match self.mode.mode {
            Mode::Hold if !self.hold.keys.is_on() && c.navigator.is_goal_fenced_off() => {
                c.notice(Notice::Refused(Refusal::OutsideFence));
                self.hold.stop(c);
            }
            Mode::Mission => self.mission_mode.relocalized(),
            _ => {}
        }
    }

    fn set_item(&mut self, seq: u16) -> Result<(), Refusal> {
        if self.plan_items == 0 {
            return Err(Refusal::NoPlan);
        }
        let refused = Refusal::NoSuchItem {
            seq,
            total: self.plan_items,
        };
        if seq >= self.plan_items {
            return Err(refused);
        }
        if self.mode.mode == Mode::Mission {
            return self.mission.start(seq).map_err(|_| refused);
        }
        self.mission.set_current(seq).map_err(|_| refused)
    }

    fn key(&mut self, c: &mut Cockpit<'_>, key: Key) -> Result<Outcome, Refusal> {
        match key {
            Key::Marker => {
                let _ = c.events.try_push(Event::Marker(c.now));
                return Ok(Outcome::Accepted);
            }
            Key::Escape => {
                // On the ground `Flight` disarms; in the air a lone ESC lands.
                if c.air != Air::Ground {
                    self.enter(c, Mode::Land, Because::Asked);
                }
                return Ok(Outcome::Accepted);
            }
            _ => {}
        }
        if self.mode.mode != Mode::Hold {
            return Err(Refusal::KeyModeOff);
        }
        if self.figure.take().is_some() {
            // A key ends it: the keys begin where the vehicle comes to rest.
            self.hold.stop(c);
        }
        let report = self.hold.press(c, key)?;
        Ok(Outcome::KeyTaken(report))
    }

    /// Hold, or the figure that is flown in it.
    fn step_hold(&mut self, c: &mut Cockpit<'_>) -> Wish {
        if !c.nav.health.position || c.air != Air::Flying {
            self.figure = None;
        }
        let Some(figure) = &mut self.figure else {
            return self.hold.step(c);
        };
        match figure.step(c) {
            Progress::Fly(setpoint) => Wish::Fly(setpoint),
            Progress::Done { position, yaw_rad } => {
                self.figure = None;
                self.hold.hold_at(c, Target { position, yaw_rad }, true);
                self.hold.step(c)
            }
        }
    }

    /// The active set point of this tick. `touched_down` is control's latch of a landing.
    pub fn step(&mut self, c: &mut Cockpit<'_>, touched_down: bool) -> Order {
        // A mode may hand over to another; two hand-overs in one tick are enough for any chain there is.
        for _ in 0..3 {
            let wish = match self.mode.mode {
                Mode::Hold => self.step_hold(c),
                Mode::Takeoff => self.climb.step(c),
                Mode::Land => self.descent.step(c, touched_down),
                Mode::Return => self.homeward.step(c, touched_down),
                Mode::Mission => {
                    self.mission_mode
                        .step(c, &mut self.mission, self.cruise_mps, touched_down)
                }
                Mode::Offboard => match self.offboard {
                    Some(streamed) => self.offboard_mode.step(c, &streamed),
                    None => Wish::Switch(Mode::Hold, Because::OffboardSilent),
                },
                mode @ (Mode::Position | Mode::Altitude | Mode::Stabilized) => {
                    let fresh = |(_, at): &(ManualInput, Timestamp)| {
                        c.now.since(*at).as_secs_f64() <= c.params.manual_loss_s
                    };
                    let input = self
                        .manual
                        .filter(fresh)
                        .map_or_else(ManualInput::default, |(input, _)| input);
                    self.sticks_mode.step(c, mode, &input)
                }
            };
            match wish {
                Wish::Switch(mode, because) => {
                    let climbed_to = if self.mode.mode == Mode::Takeoff {
                        self.climb.end()
                    } else {
                        None
                    };
                    self.enter(c, mode, because);
                    if let (Some(end), Mode::Hold, true) = (climbed_to, mode, c.nav.health.position)
                    {
                        self.hold.hold_at(c, end, false);
                    }
                }
                Wish::Fly(setpoint) => {
                    return Order {
                        setpoint,
                        lift_off: false,
                        disarm: false,
                    };
                }
                Wish::LiftOff(setpoint) => {
                    return Order {
                        setpoint,
                        lift_off: true,
                        disarm: false,
                    };
                }
                Wish::Rest => {
                    return Order {
                        setpoint: Setpoint::Idle,
                        lift_off: false,
                        disarm: false,
                    };
                }
                Wish::Disarm => {
                    return Order {
                        setpoint: Setpoint::Idle,
                        lift_off: false,
                        disarm: true,
                    };
                }
            }
        }
        let down_m = c.clamped_down_m(c.nav.position.z());
        let setpoint = c.stand_still(down_m, Heading::Rate(0.0));
        Order {
            setpoint,
            lift_off: false,
            disarm: false,
        }
    }
}
