//! What is done to the flight controller on the ground: calibration, a motor test, a restart. One at a time, disarmed only.
//!
//! ```text
//!          asked            the order is acknowledged          settled again
//!  Idle ---------> Ordered ---------------------------> Settling -------------> Idle      calibration, restart
//!    |                                                        | 20 s: told as failed
//!    +-----------> Turning --- time is over, stop, armed ---> Stopping -------> Idle      motor test
//!                                                            | again until it is acknowledged
//! ```
//!
//! | Asked for | Order | Why |
//! | --- | --- | --- |
//! | accelerometer, level | MSP_ACC_CALIBRATION | one measurement at rest gives both |
//! | gyroscope | MSP_REBOOT | these firmwares measure the gyro's offset at each start and at no other time |
//! | motor | MSP_SET_MOTOR | it **holds for ever**: the last order is 1000 for every motor, repeated until acknowledged |

use super::arming::{Asker, FcArmState};
use super::door::{Outcome, Refusal};
use arrayvec::ArrayVec;
use core::time::Duration;
use msp::Message as _;
use msp::command;
use msp::message::SetMotor;
use serde::{Deserialize, Serialize};
use vehicle::Timestamp;

/// Strongest motor test, share of full throttle, percent.
pub const STRONGEST_PERCENT: u8 = 30;
/// Longest motor test.
pub const LONGEST_TEST: Duration = Duration::from_secs(30);
/// An order without an answer is given up.
const ANSWER: Duration = Duration::from_secs(4);
/// Sooner a controller is not believed to be done: its status may be from before.
const LEAST: Duration = Duration::from_millis(1_500);
/// Later it has failed.
const MOST: Duration = Duration::from_secs(20);
/// Time between two orders to stop.
const STOP_AGAIN: Duration = Duration::from_millis(250);
/// Motors of MSP_SET_MOTOR.
const MOTORS: usize = 8;
/// A motor at rest, us.
const REST_US: u16 = 1000;

/// What is calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Sensor {
    /// Offsets of the accelerometer.
    Accelerometer,
    /// Offset of the gyroscope.
    Gyroscope,
    /// Which attitude is level.
    Level,
}

impl Sensor {
    /// As PX4 names it, and with it MAVSDK and QGroundControl.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Accelerometer => "accel",
            Self::Gyroscope => "gyro",
            Self::Level => "level",
        }
    }
}

/// One turn of one motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorTurn {
    /// From 1, as the flight controller counts; none = all at once.
    pub motor: Option<u8>,
    /// Share of full throttle.
    pub percent: f64,
    /// For how long, s.
    pub time_s: f64,
}

impl MotorTurn {
    /// # Errors
    /// A number is out of range.
    fn check(&self) -> Result<(), Refusal> {
        let is_good = self.motor.is_none_or(|m| (1..=MOTORS as u8).contains(&m))
            && (0.0..=f64::from(STRONGEST_PERCENT)).contains(&self.percent)
            && (0.0..=LONGEST_TEST.as_secs_f64()).contains(&self.time_s);
        if is_good {
            Ok(())
        } else {
            Err(Refusal::BadNumber)
        }
    }
}

/// How a calibration stands, in the words that PX4 uses and clients read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Progress {
    /// The controller has begun.
    Started,
    /// Half of the time has gone.
    Half,
    /// It is done.
    Done,
    /// It never said so.
    Failed,
    /// Nobody waits for it any more.
    Cancelled,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum State {
    #[default]
    Idle,
    Ordered {
        what: Order,
        asker: Asker,
        since: Timestamp,
    },
    Settling {
        what: Order,
        since: Timestamp,
        is_half_told: bool,
    },
    Turning {
        until: Timestamp,
    },
    Stopping {
        next: Timestamp,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    Calibrate(Sensor),
    Restart,
}

impl Order {
    const fn command(self) -> u16 {
        match self {
            Self::Calibrate(Sensor::Accelerometer | Sensor::Level) => command::ACC_CALIBRATION,
            Self::Calibrate(Sensor::Gyroscope) | Self::Restart => command::REBOOT,
        }
    }
}

/// What follows from a step.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Answer the one who asked.
    Answer(Asker, Outcome),
    /// Send a request to the controller.
    Msp(u16, ArrayVec<u8, 16>),
    /// Tell how a calibration stands.
    Tell(Sensor, Progress),
}

/// Effects of one step.
pub type Effects = ArrayVec<Effect, 4>;

/// What is being done to the flight controller.
#[derive(Clone, Debug, Default)]
pub struct BenchWork {
    state: State,
}

impl BenchWork {
    /// True while something is done that must not meet an arm.
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        !matches!(self.state, State::Idle)
    }

    /// Begins a calibration; the answer follows the controller's.
    ///
    /// # Errors
    /// Something else is being done.
    pub fn calibrate(
        &mut self,
        now: Timestamp,
        sensor: Sensor,
        asker: Asker,
    ) -> Result<Effects, Refusal> {
        self.order(now, Order::Calibrate(sensor), asker)
    }

    /// Restarts the controller; the answer follows the controller's.
    ///
    /// # Errors
    /// Something else is being done.
    pub fn restart(&mut self, now: Timestamp, asker: Asker) -> Result<Effects, Refusal> {
        self.order(now, Order::Restart, asker)
    }

    fn order(&mut self, now: Timestamp, what: Order, asker: Asker) -> Result<Effects, Refusal> {
        if self.is_busy() {
            return Err(Refusal::BenchBusy);
        }
        self.state = State::Ordered {
            what,
            asker,
            since: now,
        };
        Ok(one(Effect::Msp(what.command(), ArrayVec::new())))
    }

    /// Turns a motor, or another than before, or stops (zero percent or no time).
    ///
    /// # Errors
    /// Something else is being done, or a number is out of range.
    pub fn turn(&mut self, now: Timestamp, turn: &MotorTurn) -> Result<Effects, Refusal> {
        turn.check()?;
        if !matches!(
            self.state,
            State::Idle | State::Turning { .. } | State::Stopping { .. }
        ) {
            return Err(Refusal::BenchBusy);
        }
        let time = Duration::from_secs_f64(turn.time_s);
        if turn.percent <= 0.0 || time.is_zero() {
            return Ok(self.stop(now));
        }
        let mut motors_us = [REST_US; MOTORS];
        let us = REST_US + (10.0 * turn.percent) as u16;
        match turn.motor {
            Some(motor) => motors_us[usize::from(motor) - 1] = us,
            None => motors_us = [us; MOTORS],
        }
        self.state = State::Turning { until: now + time };
        Ok(one(set_motors(motors_us)))
    }

    /// Ends a motor test now; a calibration is no longer waited for.
    pub fn stop(&mut self, now: Timestamp) -> Effects {
        match self.state {
            State::Turning { .. } | State::Stopping { .. } => {
                self.state = State::Stopping {
                    next: now + STOP_AGAIN,
                };
                one(set_motors([REST_US; MOTORS]))
            }
            State::Ordered { what, asker, .. } => {
                self.state = State::Idle;
                let mut effects = one(Effect::Answer(
                    asker,
                    Outcome::Refused(Refusal::DisarmedMeanwhile),
                ));
                effects.extend(tell(what, Progress::Cancelled));
                effects
            }
            State::Settling { what, .. } => {
                self.state = State::Idle;
                tell(what, Progress::Cancelled).into_iter().collect()
            }
            State::Idle => Effects::new(),
        }
    }

    /// The controller answered a request that is nobody's poll: acknowledged, or refused.
    pub fn answered(&mut self, now: Timestamp, number: u16, is_done: bool) -> Effects {
        match self.state {
            State::Ordered { what, asker, .. } if what.command() == number => {
                if is_done {
                    self.state = State::Settling {
                        what,
                        since: now,
                        is_half_told: false,
                    };
                    let mut effects = one(Effect::Answer(asker, Outcome::Accepted));
                    effects.extend(tell(what, Progress::Started));
                    effects
                } else {
                    self.state = State::Idle;
                    one(Effect::Answer(asker, Outcome::Refused(Refusal::FcRefused)))
                }
            }
            State::Stopping { .. } if number == command::SET_MOTOR && is_done => {
                self.state = State::Idle;
                Effects::new()
            }
            _ => Effects::new(),
        }
    }

    /// Takes the time and what the controller says; `is_armed` ends everything.
    pub fn step(
        &mut self,
        now: Timestamp,
        fc: &FcArmState,
        is_connected: bool,
        is_armed: bool,
    ) -> Effects {
        match self.state {
            State::Idle => Effects::new(),
            State::Turning { until } if is_armed || now >= until => self.stop(now),
            State::Turning { .. } => Effects::new(),
            // Requests wait while the controller is away, so this one reaches it when it is back.
            State::Stopping { next } if now >= next => self.stop(now),
            State::Stopping { .. } => Effects::new(),
            State::Ordered { asker, since, .. } if now.since(since) >= ANSWER => {
                self.state = State::Idle;
                one(Effect::Answer(asker, Outcome::Refused(Refusal::FcSilent)))
            }
            State::Ordered { .. } => Effects::new(),
            State::Settling {
                what,
                since,
                is_half_told,
            } => {
                let gone = now.since(since);
                let said_since = fc.at.is_some_and(|at| at > since + LEAST);
                let is_settled = ["CALIBRATING", "SENSORS_CALIBRATING", "BOOT_GRACE_TIME"]
                    .iter()
                    .all(|name| !fc.blocks.has(name));
                let progress = if gone >= MOST {
                    Progress::Failed
                } else if is_connected && said_since && is_settled {
                    Progress::Done
                } else if !is_half_told && gone >= LEAST / 2 {
                    self.state = State::Settling {
                        what,
                        since,
                        is_half_told: true,
                    };
                    return tell(what, Progress::Half).into_iter().collect();
                } else {
                    return Effects::new();
                };
                self.state = State::Idle;
                tell(what, progress).into_iter().collect()
            }
        }
    }
}

fn one(effect: Effect) -> Effects {
    let mut effects = Effects::new();
    effects.push(effect);
    effects
}

/// A restart is told by the notices of the link.
const fn tell(what: Order, progress: Progress) -> Option<Effect> {
    match what {
        Order::Calibrate(sensor) => Some(Effect::Tell(sensor, progress)),
        Order::Restart => None,
    }
}

fn set_motors(motors_us: [u16; MOTORS]) -> Effect {
    let mut payload = Vec::with_capacity(2 * MOTORS);
    SetMotor { motors_us }.emit(&mut payload);
    Effect::Msp(command::SET_MOTOR, payload.into_iter().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::door::{FcBlocks, RequestId, Station};

    const ASKER: Asker = Some((
        RequestId(1),
        Station {
            system: 255,
            component: 190,
        },
    ));

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_ms(10_000 + ms)
    }

    fn says(ms: u64, flags: u32) -> FcArmState {
        FcArmState {
            at: Some(at(ms)),
            blocks: FcBlocks {
                variant: *b"BTFL",
                count: 29,
                flags,
            },
            ..FcArmState::default()
        }
    }

    fn motors(effects: &Effects) -> Option<Vec<u16>> {
        effects.iter().find_map(|e| match e {
            Effect::Msp(command::SET_MOTOR, bytes) => Some(
                bytes
                    .chunks(2)
                    .map(|b| u16::from_le_bytes([b[0], b[1]]))
                    .collect(),
            ),
            _ => None,
        })
    }

    #[test]
    fn a_calibration_is_acknowledged_told_and_done_when_the_controller_has_settled() {
        let mut work = BenchWork::default();
        let effects = work.calibrate(at(0), Sensor::Level, ASKER).unwrap();
        assert_eq!(
            effects.as_slice(),
            [Effect::Msp(command::ACC_CALIBRATION, ArrayVec::new())]
        );
        assert_eq!(
            work.calibrate(at(1), Sensor::Gyroscope, ASKER),
            Err(Refusal::BenchBusy)
        );
        let effects = work.answered(at(20), command::ACC_CALIBRATION, true);
        assert_eq!(
            effects.as_slice(),
            [
                Effect::Answer(ASKER, Outcome::Accepted),
                Effect::Tell(Sensor::Level, Progress::Started)
            ]
        );
        let half = work.step(at(800), &says(750, 1 << 12), true, false);
        assert_eq!(
            half.as_slice(),
            [Effect::Tell(Sensor::Level, Progress::Half)]
        );
        assert!(
            work.step(at(2_000), &says(1_900, 1 << 12), true, false)
                .is_empty(),
            "CALIBRATING"
        );
        let done = work.step(at(2_100), &says(2_050, 0), true, false);
        assert_eq!(
            done.as_slice(),
            [Effect::Tell(Sensor::Level, Progress::Done)]
        );
        assert!(!work.is_busy());
    }

    #[test]
    fn a_controller_that_refuses_or_says_nothing_is_answered_for() {
        let mut work = BenchWork::default();
        work.calibrate(at(0), Sensor::Accelerometer, ASKER).unwrap();
        let refused = work.answered(at(20), command::ACC_CALIBRATION, false);
        assert_eq!(
            refused.as_slice(),
            [Effect::Answer(ASKER, Outcome::Refused(Refusal::FcRefused))]
        );
        work.restart(at(100), ASKER).unwrap();
        let silent = work.step(at(4_200), &says(0, 0), true, false);
        assert_eq!(
            silent.as_slice(),
            [Effect::Answer(ASKER, Outcome::Refused(Refusal::FcSilent))]
        );
        work.calibrate(at(5_000), Sensor::Gyroscope, ASKER).unwrap();
        work.answered(at(5_010), command::REBOOT, true);
        work.step(at(6_000), &says(0, 0), false, false);
        let failed = work.step(at(26_000), &says(0, 0), false, false);
        assert_eq!(
            failed.as_slice(),
            [Effect::Tell(Sensor::Gyroscope, Progress::Failed)]
        );
    }

    #[test]
    fn a_motor_turns_for_its_time_and_is_stopped_until_the_controller_says_so() {
        let mut work = BenchWork::default();
        let turn = MotorTurn {
            motor: Some(2),
            percent: 8.0,
            time_s: 1.0,
        };
        let effects = work.turn(at(0), &turn).unwrap();
        assert_eq!(
            motors(&effects),
            Some(vec![1000, 1080, 1000, 1000, 1000, 1000, 1000, 1000])
        );
        work.answered(at(10), command::SET_MOTOR, true);
        assert!(work.step(at(900), &says(0, 0), true, false).is_empty());
        for ms in [1_000, 1_250, 1_500] {
            let stop = work.step(at(ms), &says(0, 0), true, false);
            assert_eq!(motors(&stop), Some(vec![1000; 8]), "{ms}");
        }
        work.answered(at(1_600), command::SET_MOTOR, true);
        assert!(!work.is_busy());
    }

    #[test]
    fn arming_by_anybody_ends_a_motor_test() {
        let mut work = BenchWork::default();
        let turn = MotorTurn {
            motor: None,
            percent: 10.0,
            time_s: 5.0,
        };
        work.turn(at(0), &turn).unwrap();
        assert_eq!(
            motors(&work.step(at(50), &says(0, 0), true, true)),
            Some(vec![1000; 8])
        );
        for wrong in [
            MotorTurn {
                percent: 31.0,
                ..turn
            },
            MotorTurn {
                percent: f64::NAN,
                ..turn
            },
            MotorTurn {
                time_s: f64::INFINITY,
                ..turn
            },
            MotorTurn {
                motor: Some(9),
                ..turn
            },
            MotorTurn {
                motor: Some(0),
                ..turn
            },
        ] {
            assert_eq!(
                BenchWork::default().turn(at(0), &wrong),
                Err(Refusal::BadNumber)
            );
        }
    }
}
