//! What stations ask of `Flight`: arming, parameters, home; the rest goes to the arbiter.

use super::{Air, Arming, Event, Flight, Notice, Output};
use crate::autopilot::arming::{Asker, Change};
use crate::autopilot::bench_work::{Effect, Effects};
use crate::autopilot::door::{Answer, Asked, Key, Outcome, Refusal, Request};
use crate::autopilot::handover::Steering;
use crate::autopilot::health::{self, Checks};
use crate::autopilot::mode::{Because, Mode};
use crate::settings::Origin;
use core::time::Duration;
use vehicle::{In, NavState, Ned, Timestamp};

impl Flight {
    // ---- arming ------------------------------------------------------------------------------------------------

    pub(super) fn confirm_arming(&mut self, now: Timestamp) {
        if self.handover.has_radio()
            && self.arming == Arming::Neutral
            && self.fc_arm.is_armed
            && self.client.is_online()
        {
            self.arming.follow_radio(now);
            self.armed(None);
            return;
        }
        let wanted_s = self.settings.autopilot.arm_neutral_s;
        self.fc_arm.neutral_beyond = Duration::from_secs_f64((wanted_s - 1.0).max(0.0));
        match self.arming.step(now, &self.fc_arm) {
            Some(Change::Armed(asker)) => self.armed(asker),
            Some(Change::Failed(asker)) => {
                let blocks = self.fc_arm.blocks;
                let why = if blocks.is_clear() {
                    Refusal::FcDidNotArm
                } else {
                    Refusal::FcBlocks(blocks)
                };
                self.answer_arming(asker, Outcome::Refused(why));
            }
            Some(Change::DisarmedByController) => {
                let notice = if self.handover.has_radio() {
                    Notice::PilotDisarmed
                } else {
                    Notice::FcDisarmed
                };
                self.emit(Output::Event(Event::Notice(notice)));
                self.tell_timing();
                self.disarm(now);
            }
            None => {}
        }
    }

    fn armed(&mut self, asker: Asker) {
        self.latency.clear();
        self.missed_before = self.snapshot.flight_loop.missed;
        self.emit(Output::Event(Event::Armed(true)));
        self.answer_arming(asker, Outcome::Accepted);
    }

    fn answer_arming(&mut self, asker: Asker, outcome: Outcome) {
        if let Some((id, station)) = asker {
            self.emit(Output::Answer(Answer {
                id,
                station,
                outcome,
            }));
        }
    }

    fn tell_timing(&mut self) {
        let notice = Notice::FlightTiming {
            sample_to_command: self.latency.summary(),
            missed: self.snapshot.flight_loop.missed - self.missed_before,
        };
        self.emit(Output::Event(Event::Notice(notice)));
    }

    /// Lowers the switch; everything that belongs to a flight is over.
    pub(super) fn disarm(&mut self, now: Timestamp) {
        if self.arming.is_armed() {
            self.tell_timing();
        }
        let waiting = self.arming.lower();
        self.answer_arming(waiting, Outcome::Refused(Refusal::DisarmedMeanwhile));
        self.fc_arm.neutral_since = None;
        self.air = Air::Ground;
        let nav = *self.estimator.state();
        self.controller.reset(&nav);
        self.emit(Output::Event(Event::Armed(false)));
        self.with_cockpit(now, 0.0, &nav, |arbiter, c| arbiter.disarmed(c));
        self.emit(Output::Event(Event::Landed(
            self.arbiter.landed_state(self.air),
        )));
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
        if self.handover.has_radio() {
            return Err(Refusal::PilotArms);
        }
        if self.arming.is_under_way() {
            return Err(Refusal::ArmingUnderWay);
        }
        if self.bench_work.is_busy() {
            return Err(Refusal::BenchBusy);
        }
        let checks = Checks {
            may_wait: true,
            ..self.checks(now)
        };
        let failure = if force {
            health::controller_failure(&checks)
        } else {
            health::first_failure(&checks)
        };
        if let Some(why) = failure {
            return Err(why);
        }
        self.arming.ask(now, Some((asked.id, asked.station)));
        Ok(None)
    }

    /// Works in every state; only a flying vehicle asks for force.
    fn ask_disarm(&mut self, now: Timestamp, force: bool) -> Result<Outcome, Refusal> {
        if self.air == Air::Flying && !force {
            return Err(Refusal::Flying);
        }
        if self.handover.has_radio() && self.arming.is_armed() {
            return Err(Refusal::PilotArms);
        }
        if self.arming != Arming::Neutral {
            self.disarm(now);
        }
        Ok(Outcome::Accepted)
    }

    pub(super) fn checks(&self, now: Timestamp) -> Checks<'_> {
        let nav = self.estimator.state();
        Checks {
            fc_is_connected: self.fc.is_connected,
            unknown_firmware: self.link.unknown_firmware,
            is_stalled: self.link.is_stalled,
            may_wait: false,
            fc: &self.fc_arm,
            nav,
            facts: self.facts(now, 0.0, None, nav),
            is_shutting_down: self.shutting_down,
        }
    }

    // ---- requests ----------------------------------------------------------------------------------------------

    pub(super) fn asked(&mut self, now: Timestamp, asked: &Asked) {
        let nav = *self.estimator.state();
        let outcome = match &asked.request {
            Request::Arm { force } => match self.arm(now, asked, *force) {
                Ok(Some(outcome)) => Ok(outcome),
                Ok(None) => return, // Answered when the controller confirms.
                Err(why) => Err(why),
            },
            Request::Disarm { force } => self.ask_disarm(now, *force),
            Request::Key(Key::Escape) if self.air == Air::Ground => self.ask_disarm(now, false),
            Request::SetParam { index, value } => {
                let changed = self
                    .settings
                    .set(usize::from(*index), *value, Origin::Mavlink);
                self.apply_settings();
                changed
                    .map(|_| Outcome::Accepted)
                    .map_err(|_| Refusal::BadNumber)
            }
            Request::Calibrate(_)
            | Request::EndBenchWork
            | Request::TurnMotor(_)
            | Request::RestartFc => match self.ask_bench(now, asked) {
                Ok(Some(outcome)) => Ok(outcome),
                Ok(None) => return, // Answered when the controller has answered.
                Err(why) => Err(why),
            },
            Request::SetHome(place) => self.set_home(&nav, *place),
            Request::Sensed(sample) => return self.sensed(sample),
            Request::Inject(_) => Err(Refusal::NotSimulated),
            Request::GroundHeartbeat => {
                self.ground_heard = Some(now);
                Ok(Outcome::Accepted)
            }
            Request::ShutDown => {
                self.shutting_down = true;
                self.shut_down(now, &nav)
            }
            request => self.takes_sticks(request).and_then(|takes_sticks| {
                let is_armed = self.arming.is_armed();
                let outcome = self.with_cockpit(now, 0.0, &nav, |arbiter, c| {
                    arbiter.request(c, asked, is_armed)
                })?;
                // Only what is accepted takes them: a refused request leaves the pilot alone.
                if takes_sticks && self.handover.ask(now)? {
                    self.emit(Output::Event(Event::Notice(Notice::PilotHandedBack)));
                }
                Ok(outcome)
            }),
        };
        let outcome = outcome.unwrap_or_else(Outcome::Refused);
        self.emit(Output::Answer(Answer {
            id: asked.id,
            station: asked.station,
            outcome,
        }));
    }

    // ---- bench -------------------------------------------------------------------------------------------------

    /// None if the answer follows the controller's.
    fn ask_bench(&mut self, now: Timestamp, asked: &Asked) -> Result<Option<Outcome>, Refusal> {
        if asked.request == Request::EndBenchWork {
            let effects = self.bench_work.stop(now);
            self.carry_out(effects);
            return Ok(Some(Outcome::Accepted));
        }
        if self.air != Air::Ground {
            return Err(Refusal::Flying);
        }
        if self.arming != Arming::Neutral || self.fc_arm.is_armed {
            return Err(Refusal::Armed);
        }
        if !self.fc.is_connected {
            return Err(Refusal::FcSilent);
        }
        if let Some(variant) = self.link.unknown_firmware {
            return Err(Refusal::FcUnknown { variant });
        }
        let asker = Some((asked.id, asked.station));
        let (effects, outcome) = match &asked.request {
            Request::Calibrate(sensor) => (self.bench_work.calibrate(now, *sensor, asker)?, None),
            Request::RestartFc => (self.bench_work.restart(now, asker)?, None),
            Request::TurnMotor(_) if !self.settings.autopilot.motor_test => {
                return Err(Refusal::MotorTestOff);
            }
            Request::TurnMotor(turn) => (self.bench_work.turn(now, turn)?, Some(Outcome::Accepted)),
            _ => return Err(Refusal::Unsupported),
        };
        self.carry_out(effects);
        Ok(outcome)
    }

    pub(super) fn bench_answered(&mut self, now: Timestamp, number: u16, is_done: bool) {
        if self.bench_work.is_busy() {
            let effects = self.bench_work.answered(now, number, is_done);
            self.carry_out(effects);
        }
    }

    pub(super) fn bench_step(&mut self, now: Timestamp) {
        if self.bench_work.is_busy() {
            let is_armed = self.arming.is_armed() || self.fc_arm.is_armed;
            let effects = self
                .bench_work
                .step(now, &self.fc_arm, self.fc.is_connected, is_armed);
            self.carry_out(effects);
        }
    }

    fn carry_out(&mut self, effects: Effects) {
        for effect in effects {
            match effect {
                Effect::Answer(asker, outcome) => self.answer_arming(asker, outcome),
                // A full queue is no loss: an order without an answer is given up, a stop is ordered again.
                Effect::Msp(number, payload) => drop(self.client.request(number, &payload)),
                Effect::Tell(sensor, progress) => {
                    let notice = Notice::Calibration { sensor, progress };
                    self.emit(Output::Event(Event::Notice(notice)));
                }
            }
        }
    }

    fn shut_down(&mut self, now: Timestamp, nav: &NavState) -> Result<Outcome, Refusal> {
        if self.handover.pilot_steers() {
            return Ok(Outcome::Accepted);
        }
        if self.air == Air::Ground {
            return self.ask_disarm(now, true);
        }
        self.with_cockpit(now, 0.0, nav, |arbiter, c| {
            arbiter.enter(c, Mode::Land, Because::ShuttingDown)
        });
        Ok(Outcome::Accepted)
    }

    /// While the pilot steers, a mode or a goal asks him for the sticks; streams and keys do not.
    fn takes_sticks(&self, request: &Request) -> Result<bool, Refusal> {
        if !self.handover.pilot_steers() {
            return Ok(false);
        }
        match request {
            Request::SetMode(_)
            | Request::Takeoff { .. }
            | Request::GoTo(_)
            | Request::Figure(_)
            | Request::StartMission { .. }
                if self.handover.steering() == Steering::Offered =>
            {
                Ok(true)
            }
            Request::SetPlan(_)
            | Request::SetSite(_)
            | Request::SetMissionItem(_)
            | Request::ChangeSpeed(_) => Ok(false),
            _ => Err(Refusal::PilotSteers),
        }
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
        self.navigator.set_home(home);
        self.emit(Output::Event(Event::HomeSet));
        Ok(Outcome::Accepted)
    }
}
