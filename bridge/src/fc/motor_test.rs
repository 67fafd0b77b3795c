//! One motor after the other, on the bench, propellers off.
//!
//! MSP_SET_MOTOR acts only while disarmed and **holds for ever**: whatever happens, the last order is 1000 for every motor.

use super::conversation::{AskError, Controller, read};
use super::setup::survey::identify;
use msp::firmware::box_id;
use msp::message::{Motor, Reply, SetMotor};
use msp::{Message as _, command};
use std::time::Duration;
use thiserror::Error;

/// Strongest test, share of full throttle.
pub const STRONGEST_PERCENT: u8 = 30;
/// Between two looks at stop and arming.
const LOOK: Duration = Duration::from_millis(100);
/// So often is the end ordered until it is acknowledged.
const END_TRIES: u32 = 5;

/// What to turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotorTest {
    /// Which motor, from 1; none = one after the other.
    pub motor: Option<u8>,
    /// Share of full throttle, 1..=[`STRONGEST_PERCENT`].
    pub percent: u8,
    /// Time for each motor.
    pub time: Duration,
}

/// Why a test did not run, or not to its end.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum MotorTestError {
    /// The controller is armed, or was armed meanwhile.
    #[error("the flight controller is armed: no motor test")]
    Armed,
    /// The controller.
    #[error("{0}")]
    Ask(#[from] AskError),
    /// No such motor.
    #[error("there is no motor {motor}: this controller drives {count}")]
    NoMotor {
        /// Asked for.
        motor: u8,
        /// There are.
        count: u8,
    },
    /// The end was not acknowledged.
    #[error(
        "THE CONTROLLER DID NOT ACKNOWLEDGE THE STOP ({0}): MOTORS MAY STILL TURN, TAKE THE BATTERY OFF"
    )]
    NotStopped(AskError),
    /// Too strong, or nothing.
    #[error("{0} %: a motor test takes 1 to {STRONGEST_PERCENT}")]
    Percent(u8),
}

/// Surroundings of a test.
pub trait Bench {
    /// The user wants it to end.
    fn stop(&self) -> bool;
    /// Time passes.
    fn pause(&mut self, time: Duration);
    /// Something to tell.
    fn tell(&mut self, text: &str);
}

impl MotorTest {
    /// Runs it. True if it ran to its end, false if the user stopped it; motors stand still either way.
    ///
    /// # Errors
    /// [`MotorTestError`]; motors stand still unless it is [`MotorTestError::NotStopped`].
    pub fn run(
        &self,
        controller: &mut dyn Controller,
        bench: &mut dyn Bench,
    ) -> Result<bool, MotorTestError> {
        if !(1..=STRONGEST_PERCENT).contains(&self.percent) {
            return Err(MotorTestError::Percent(self.percent));
        }
        let motors: Motor = read(controller)?;
        let count = motors.motors_us.iter().filter(|us| **us > 0).count();
        let count = u8::try_from(count).unwrap_or(0);
        let chosen = match self.motor {
            Some(motor) if motor == 0 || motor > count => {
                return Err(MotorTestError::NoMotor { motor, count });
            }
            Some(motor) => motor..=motor,
            None => 1..=count,
        };
        let identity = identify(controller)?;
        let status_command = identity.status_command();
        let is_armed = |controller: &mut dyn Controller| -> Result<bool, AskError> {
            let status = Reply::parse(status_command, &controller.ask(status_command, &[])?)?;
            Ok(identity
                .is_box_active(box_id::ARM, &status)
                .unwrap_or(false))
        };
        if is_armed(controller)? {
            return Err(MotorTestError::Armed);
        }
        let turned = (|| {
            for motor in chosen {
                bench.tell(&format!("motor {motor} at {} %", self.percent));
                order(controller, Some(motor), self.percent)?;
                let mut left = self.time;
                while !left.is_zero() {
                    if bench.stop() {
                        return Ok(false);
                    }
                    if is_armed(controller)? {
                        return Err(MotorTestError::Armed);
                    }
                    let step = left.min(LOOK);
                    bench.pause(step);
                    left -= step;
                }
                order(controller, None, 0)?;
            }
            Ok(true)
        })();
        stop_motors(controller)?;
        bench.tell("motors stopped");
        turned
    }
}

/// All motors at 1000, again until it is acknowledged.
///
/// # Errors
/// [`MotorTestError::NotStopped`].
pub fn stop_motors(controller: &mut dyn Controller) -> Result<(), MotorTestError> {
    let mut last = AskError::Silent(command::SET_MOTOR);
    for _ in 0..END_TRIES {
        match order(controller, None, 0) {
            Ok(()) => return Ok(()),
            Err(e) => last = e,
        }
        if matches!(last, AskError::Line(_)) {
            // Unplugged: perhaps it comes back.
            let _ = controller.come_back();
        }
    }
    Err(MotorTestError::NotStopped(last))
}

fn order(controller: &mut dyn Controller, motor: Option<u8>, percent: u8) -> Result<(), AskError> {
    let mut motors_us = [1000; 8];
    if let Some(us) = motor.and_then(|m| motors_us.get_mut(usize::from(m.saturating_sub(1)))) {
        *us += 10 * u16::from(percent.min(STRONGEST_PERCENT));
    }
    let mut payload = Vec::new();
    SetMotor { motors_us }.emit(&mut payload);
    controller.ask(command::SET_MOTOR, &payload).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fc::conversation::Outcome;
    use crate::fc::setup::test_controller::TestController;

    struct Clock {
        stop_after: u32,
        passed: Duration,
        looks: std::cell::Cell<u32>,
    }

    impl Bench for Clock {
        fn stop(&self) -> bool {
            self.looks.set(self.looks.get() + 1);
            self.looks.get() > self.stop_after
        }
        fn pause(&mut self, time: Duration) {
            self.passed += time;
        }
        fn tell(&mut self, _: &str) {}
    }

    fn bench(stop_after: u32) -> Clock {
        Clock {
            stop_after,
            passed: Duration::ZERO,
            looks: std::cell::Cell::new(0),
        }
    }

    const TEST: MotorTest = MotorTest {
        motor: None,
        percent: 8,
        time: Duration::from_millis(500),
    };

    fn orders(controller: &TestController) -> Vec<Vec<u16>> {
        controller
            .heard
            .iter()
            .filter(|(command, _)| *command == command::SET_MOTOR)
            .map(|(_, payload)| {
                let words = payload.as_chunks::<2>().0;
                words.iter().map(|b| u16::from_le_bytes(*b)).collect()
            })
            .collect()
    }

    #[test]
    fn every_motor_turns_alone_and_the_last_order_is_1000_for_all() {
        let mut controller = TestController::betaflight();
        let mut bench = bench(u32::MAX);
        assert_eq!(TEST.run(&mut controller, &mut bench), Ok(true));
        let orders = orders(&controller);
        for order in &orders {
            assert!(
                order.iter().filter(|us| **us > 1000).count() <= 1,
                "{order:?}"
            );
            assert!(order.iter().all(|us| (1000..=1300).contains(us)));
        }
        let turned: Vec<usize> = orders
            .iter()
            .filter_map(|order| order.iter().position(|us| *us == 1080))
            .collect();
        assert_eq!(turned, [0, 1, 2, 3]);
        assert_eq!(orders.last().unwrap(), &vec![1000; 8]);
        assert_eq!(bench.passed, Duration::from_secs(2));
    }

    #[test]
    fn a_stop_in_the_middle_ends_with_1000() {
        let mut controller = TestController::betaflight();
        assert_eq!(TEST.run(&mut controller, &mut bench(3)), Ok(false));
        let orders = orders(&controller);
        assert!(orders.len() > 1);
        assert_eq!(orders.last().unwrap(), &vec![1000; 8]);
    }

    #[test]
    fn an_armed_controller_turns_no_motor() {
        let mut controller = TestController::betaflight();
        controller.is_armed = true;
        let result = TEST.run(&mut controller, &mut bench(u32::MAX));
        assert_eq!(result, Err(MotorTestError::Armed));
        assert!(orders(&controller).is_empty());
    }

    #[test]
    fn a_fifth_motor_and_full_throttle_are_refused() {
        let mut controller = TestController::betaflight();
        let fifth = MotorTest {
            motor: Some(5),
            ..TEST
        };
        let refused = fifth.run(&mut controller, &mut bench(u32::MAX));
        assert_eq!(refused, Err(MotorTestError::NoMotor { motor: 5, count: 4 }));
        let strong = MotorTest {
            percent: 100,
            ..TEST
        };
        let refused = strong.run(&mut controller, &mut bench(u32::MAX));
        assert_eq!(refused, Err(MotorTestError::Percent(100)));
        assert!(orders(&controller).is_empty());
    }

    #[test]
    fn a_controller_that_falls_silent_in_the_middle_is_ordered_to_stop_again_and_again() {
        struct Flaky(TestController, u32);
        impl Controller for Flaky {
            fn ask(&mut self, command: u16, payload: &[u8]) -> Outcome {
                // Silent for the whole test after its first motor, then back.
                if self.0.heard.iter().any(|(c, _)| *c == command::SET_MOTOR) && self.1 > 0 {
                    self.1 -= 1;
                    return Err(AskError::Silent(command));
                }
                self.0.ask(command, payload)
            }
            fn come_back(&mut self) -> Result<(), AskError> {
                Ok(())
            }
        }
        let mut flaky = Flaky(TestController::betaflight(), 3);
        let result = TEST.run(&mut flaky, &mut bench(u32::MAX));
        assert!(matches!(result, Err(MotorTestError::Ask(_))), "{result:?}");
        assert_eq!(orders(&flaky.0).last().unwrap(), &vec![1000; 8]);

        let mut dead = Flaky(TestController::betaflight(), u32::MAX);
        let result = TEST.run(&mut dead, &mut bench(u32::MAX));
        assert!(
            matches!(result, Err(MotorTestError::NotStopped(_))),
            "{result:?}"
        );
    }
}
