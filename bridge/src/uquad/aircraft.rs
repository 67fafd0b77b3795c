//! uQuad as one aircraft: bytes of the inertial unit in, messages for the motor driver out, and its supervisor between.
//!
//! | Phase | Motors | Leaves |
//! | --- | --- | --- |
//! | calibrating | stand | 512 frames at rest: ready |
//! | ready | stand | [`Aircraft::arm`], [`Aircraft::take_off`]: starting |
//! | starting | idle; the driver's ramp | 2.6 s: idling |
//! | idling | idle | a take-off was asked for: ramping up |
//! | ramping up | control less (100 - n) % of hover above slowest; the filter believes hover | 100 samples: running |
//! | running | control; the filter believes what was commanded | - |
//! | off | stop, again until acknowledged; the estimate goes on | - |
//!
//! Off when: asked; tilt above 1 rad or above 55 degC for more than 20 samples (each good one takes one back); ten timing errors; no frame for 1 s; the
//! driver does not acknowledge for 0.5 s. The wanted place moves at 0.5 m/s, height at 0.4 m/s: a take-off is no jump, and no step asks motors for more than they have.

use super::{Said, Step, Uquad, UquadConfig, UquadError};
use crate::motor::commander::StopReason;
use crate::motor::{Commander, SpeedRange};
use arrayvec::ArrayVec;
use control::state_feedback::StateSetpoint;
use estimator::imu::Calibration;
use estimator::thesis::ThesisFilter;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use vehicle::Timestamp;

/// The driver's enabling, waiting and ramp take 2.4 s.
const START: Duration = Duration::from_millis(2600);
/// Samples of ramping up.
const RAMP_SAMPLES: u32 = 100;
/// Largest psi and phi, rad, and temperature, degC.
const SANE: (f64, f64) = (1.0, 55.0);
/// Insane samples that are borne.
const MAX_INSANE: u32 = 20;
/// Without a frame for so long the flight ends.
const IMU_SILENCE: Duration = Duration::from_secs(1);
/// Change of the wanted height and of the wanted place, m/s.
const MOVE_MPS: (f64, f64) = (0.4, 0.5);

/// What it is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Phase {
    /// On the floor, at rest, learning its zeros.
    Calibrating,
    /// Waits for a take-off.
    Ready,
    /// The driver's ramp.
    Starting {
        /// Since.
        since: Timestamp,
    },
    /// Motors idle on the floor.
    Idling,
    /// From slow to hover.
    RampingUp {
        /// Samples done.
        sample: u32,
    },
    /// Flies.
    Running,
    /// Motors are off; the estimate goes on.
    Off(Off),
}

/// Why motors are off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Off {
    /// As asked.
    Asked,
    /// No acknowledgement of the motor driver.
    DriverSilent,
    /// No frame for a second.
    ImuSilent,
    /// Tilt or temperature.
    Insane,
    /// Ten timing errors.
    Timing,
}

impl Off {
    /// In words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Asked => "as asked",
            Self::DriverSilent => "motor driver silent",
            Self::ImuSilent => "no IMU frame for 1 s",
            Self::Insane => "tilt above 1 rad or above 55 degC",
            Self::Timing => "ten timing errors",
        }
    }
}

/// The aircraft. After [`bytes`](Self::bytes), [`acknowledged`](Self::acknowledged), and at least each 10 ms, call [`poll`](Self::poll) until none.
#[derive(Clone, Debug)]
pub struct Aircraft {
    uquad: Uquad,
    commander: Commander,
    hover_radps: f64,
    range: SpeedRange,
    phase: Phase,
    insane: u32,
    heard_at: Option<Timestamp>,
    goal_m: Vector3<f64>,
    /// A take-off was asked for.
    lifts: bool,
    /// Speeds the motors turn at whatever is commanded: on the bench.
    typed: Option<[f64; 4]>,
    /// The set point comes from outside, sample by sample.
    is_guided: bool,
    messages: ArrayVec<[u8; 4], 4>,
}

impl Aircraft {
    /// On the floor, motors standing.
    ///
    /// # Errors
    /// The setting that cannot be.
    pub fn new(calibration: Calibration, config: UquadConfig) -> Result<Self, UquadError> {
        let hover_radps = config.hover_radps;
        let range = SpeedRange::around(hover_radps);
        Ok(Self {
            uquad: Uquad::new(calibration, config)?,
            commander: Commander::new(range),
            hover_radps,
            range,
            phase: Phase::Calibrating,
            insane: 0,
            heard_at: None,
            goal_m: Vector3::zeros(),
            lifts: false,
            is_guided: false,
            typed: None,
            messages: ArrayVec::new(),
        })
    }

    /// Starts the motors and climbs. False unless ready.
    pub fn take_off(&mut self, now: Timestamp, height_m: f64) -> bool {
        let is_ready = matches!(self.phase, Phase::Ready | Phase::Idling) && height_m.is_finite();
        if is_ready {
            self.goal_m.z = height_m;
            self.lifts = true;
            self.arm(now);
        }
        is_ready
    }

    /// Starts the motors and leaves them idling. False unless ready.
    pub fn arm(&mut self, now: Timestamp) -> bool {
        let is_ready = self.phase == Phase::Ready;
        if is_ready {
            self.phase = Phase::Starting { since: now };
        }
        is_ready
    }

    /// Leaves the floor as soon as the motors idle, guided by [`guide`](Self::guide).
    pub const fn lift_off(&mut self) {
        self.lifts = true;
        self.is_guided = true;
    }

    /// The set point of the next step, from outside; [`go_to`](Self::go_to) ends that.
    pub const fn guide(&mut self, setpoint: StateSetpoint) {
        self.is_guided = true;
        self.uquad.aim(setpoint);
    }

    /// After a stop that was asked for, once the driver has taken it: ready again.
    pub fn rest(&mut self) -> bool {
        let is_over = self.phase == Phase::Off(Off::Asked) && self.commander.is_stop_acknowledged();
        if is_over {
            self.commander.rearm();
            (self.phase, self.lifts, self.is_guided) = (Phase::Ready, false, false);
        }
        is_over
    }

    /// On the bench the motors turn at these speeds, rad/s, whatever the law says; the filter shall know.
    pub const fn believe_instead(&mut self, speeds_radps: [f64; 4]) {
        self.typed = Some(speeds_radps);
    }

    /// Another weight: hover speed and range follow.
    pub fn set_hover(&mut self, hover_radps: f64) {
        self.hover_radps = hover_radps;
        self.range = SpeedRange::around(hover_radps);
        self.commander.set_range(self.range);
        self.uquad
            .set_speed_range((self.range.slowest_radps, self.range.fastest_radps));
    }

    /// The loop, for gains and estimate.
    pub const fn uquad(&mut self) -> &mut Uquad {
        &mut self.uquad
    }

    /// The estimate.
    #[must_use]
    pub const fn filter(&self) -> &ThesisFilter {
        self.uquad.filter()
    }

    /// Another place in the air: x y z, m, and theta, rad. What is no number is refused with false.
    pub fn go_to(&mut self, position_m: Vector3<f64>, theta_rad: f64) -> bool {
        if !(position_m.iter().all(|v| v.is_finite()) && theta_rad.is_finite()) {
            return false;
        }
        let mut setpoint = *self.uquad.setpoint();
        setpoint.state[5] = theta_rad;
        self.uquad.aim(setpoint);
        self.goal_m = position_m;
        self.is_guided = false;
        true
    }

    /// Motors off, at once.
    pub fn stop(&mut self, now: Timestamp) {
        self.switch_off(now, Off::Asked);
    }

    /// A position from outside: GPS, or localization on the floor plan.
    pub const fn fix(&mut self, position_m: Vector3<f64>) {
        self.uquad.fix(position_m);
    }

    /// Takes bytes of the inertial unit; answers what they made of the estimate.
    pub fn bytes(
        &mut self,
        now: Timestamp,
        bytes: &[u8],
        say: &mut dyn FnMut(Said),
    ) -> Option<Step> {
        let step = self.uquad.bytes(now, bytes, say);
        if self.uquad.is_stopped() {
            self.switch_off(now, Off::Timing);
        }
        let step = step?;
        self.heard_at = Some(now);
        self.judge(now, &step);
        let speeds = self.act(now, &step);
        self.uquad.believe(self.typed.unwrap_or(speeds));
        self.approach();
        Some(Step {
            speeds_radps: speeds,
            ..step
        })
    }

    /// Commands what the phase asks for; answers the speeds the filter shall believe.
    fn act(&mut self, now: Timestamp, step: &Step) -> [f64; 4] {
        let hover = [self.hover_radps; 4];
        match self.phase {
            Phase::Calibrating => {
                self.phase = Phase::Ready;
                hover
            }
            // The floor carries what the motors do not.
            Phase::Ready | Phase::Off(_) => hover,
            Phase::Starting { since } => {
                let message = self.commander.idle(now);
                self.messages.extend(message);
                if now >= since + START {
                    self.phase = Phase::Idling;
                }
                hover
            }
            Phase::Idling => {
                let message = self.commander.idle(now);
                self.messages.extend(message);
                if self.lifts {
                    self.uquad.reset_integrals();
                    self.phase = Phase::RampingUp { sample: 0 };
                }
                hover
            }
            Phase::RampingUp { sample } => {
                let left = f64::from(RAMP_SAMPLES - sample) / f64::from(RAMP_SAMPLES);
                let less = left * (self.hover_radps - self.range.slowest_radps);
                let given = step.speeds_radps.map(|w| w - less);
                self.command(now, given);
                self.phase = if sample + 1 < RAMP_SAMPLES {
                    Phase::RampingUp { sample: sample + 1 }
                } else {
                    Phase::Running
                };
                hover
            }
            Phase::Running => self.command(now, step.speeds_radps),
        }
    }

    fn command(&mut self, now: Timestamp, speeds: [f64; 4]) -> [f64; 4] {
        let commanded = self.commander.command(now, speeds);
        self.messages.extend(commanded.message);
        commanded.speeds_radps
    }

    /// Moves the set point towards its goal.
    fn approach(&mut self) {
        if self.is_guided || !matches!(self.phase, Phase::RampingUp { .. } | Phase::Running) {
            return;
        }
        let mut setpoint = *self.uquad.setpoint();
        let (climb_mps, level_mps) = MOVE_MPS;
        for (i, mps) in [level_mps, level_mps, climb_mps].into_iter().enumerate() {
            let most = mps * estimator::imu::period::NOMINAL_S;
            setpoint.state[i] += (self.goal_m[i] - setpoint.state[i]).clamp(-most, most);
        }
        self.uquad.aim(setpoint);
    }

    fn judge(&mut self, now: Timestamp, step: &Step) {
        let (tilt, temperature) = SANE;
        let measured = step.reading.measured.temperature_degc;
        let is_insane =
            step.state[3].abs() > tilt || step.state[4].abs() > tilt || measured > temperature;
        self.insane = if is_insane {
            self.insane + 1
        } else {
            self.insane.saturating_sub(1)
        };
        if self.insane > MAX_INSANE {
            self.switch_off(now, Off::Insane);
        }
    }

    fn switch_off(&mut self, now: Timestamp, why: Off) {
        if !matches!(self.phase, Phase::Off(_)) {
            self.phase = Phase::Off(why);
            self.messages.clear();
            self.commander.stop(now);
        }
    }

    /// Takes what the motor driver sent back.
    pub fn acknowledged(&mut self, reply: &[u8]) {
        self.commander.acknowledged(reply);
    }

    /// The next message for the motor driver.
    pub fn poll(&mut self, now: Timestamp) -> Option<[u8; 4]> {
        let is_silent = self.heard_at.is_some_and(|t| now >= t + IMU_SILENCE);
        let has_motors = matches!(
            self.phase,
            Phase::Starting { .. } | Phase::Idling | Phase::RampingUp { .. } | Phase::Running
        );
        if is_silent && has_motors {
            self.switch_off(now, Off::ImuSilent);
        }
        let message = self.messages.pop_at(0).or_else(|| self.commander.poll(now));
        if self.commander.stopped() == Some(StopReason::DriverSilent) {
            self.switch_off(now, Off::DriverSilent);
        }
        message
    }

    /// What it is doing.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }
}

#[cfg(test)]
mod tests;
