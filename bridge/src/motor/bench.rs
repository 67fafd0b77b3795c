//! The driver by hand: lines of four numbers move the motors. `kestrel motors` runs it on standard input.
//!
//! A line stands until the next one: it is sent again each 10 ms, for silence stops motors. A line with a 0, and the end of the input, stop them.

use super::commander::{Commander, StopReason};
use super::driver::{Driver, DriverConfig, DriverEvent, DriverState};
use super::units::{Order, OrderError, SpeedRange};
use embedded_hal::i2c::I2c;
use std::time::Duration;
use vehicle::Timestamp;

/// Between two messages of the same order.
const AGAIN: Duration = Duration::from_millis(10);

/// Commander and driver in one hand. After each call poll; then [`event`](Self::event) until none.
#[derive(Clone, Debug)]
pub struct Bench {
    commander: Commander,
    driver: Driver,
    is_radps: bool,
    order: Option<[u8; 4]>,
    again_at: Timestamp,
}

impl Bench {
    /// Lines are in the driver's units, or in rad/s.
    #[must_use]
    pub const fn new(config: DriverConfig, is_radps: bool) -> Self {
        Self {
            commander: Commander::new(SpeedRange::turning()),
            driver: Driver::new(config),
            is_radps,
            order: None,
            again_at: Timestamp::ZERO,
        }
    }

    /// Takes a line; an empty one says nothing.
    ///
    /// # Errors
    /// What is wrong with it; the order before stands.
    pub fn line(&mut self, now: Timestamp, line: &str) -> Result<(), OrderError> {
        if !line.trim().is_empty() {
            self.order = Some(Order::parse(line, self.is_radps)?.units());
            self.again_at = now;
        }
        Ok(())
    }

    /// The input is over, or the user wants it to end.
    pub fn end(&mut self, now: Timestamp) {
        self.commander.stop(now);
    }

    /// Does what is due.
    pub fn poll<B: I2c>(&mut self, now: Timestamp, bus: &mut B) {
        let again = self.order.filter(|_| now >= self.again_at);
        let message = again.and_then(|order| {
            self.again_at = now + AGAIN;
            self.commander.units(now, order)
        });
        for message in [message, self.commander.poll(now)].into_iter().flatten() {
            if let Some(ack) = self.driver.handle(now, &message) {
                self.commander.acknowledged(&ack);
            }
        }
        self.driver.poll(now, bus);
    }

    /// When to poll next.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        let again = self.order.map(|_| self.again_at);
        let all = [again, self.commander.deadline(), self.driver.deadline()];
        all.into_iter().flatten().min()
    }

    /// What the driver has to say.
    pub fn event(&mut self) -> Option<DriverEvent> {
        self.driver.event()
    }

    /// True when nothing more will happen: stopped as asked, or given up.
    #[must_use]
    pub fn is_over(&self) -> bool {
        let is_stopped =
            self.commander.is_stop_acknowledged() && self.driver.state() == DriverState::Stopped;
        is_stopped || self.driver.state() == DriverState::Aborted
    }

    /// True when it ended otherwise than by the end of the input.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.driver.state() == DriverState::Aborted
            || self.commander.stopped() == Some(StopReason::DriverSilent)
    }

    /// True once the ramp is over.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.driver.state() == DriverState::Running
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim::EscBus;

    /// Polls at every deadline for some seconds.
    fn pass(bench: &mut Bench, bus: &mut EscBus, now: &mut Timestamp, seconds: f64) {
        let end = *now + Duration::from_secs_f64(seconds);
        while *now < end && !bench.is_over() {
            bus.advance(now.us());
            bench.poll(*now, bus);
            let next = bench.deadline().unwrap_or(end);
            *now = next.max(*now + Duration::from_micros(50));
        }
    }

    #[test]
    fn four_numbers_on_a_line_turn_the_motors_and_the_end_of_input_stops_them() {
        let (mut bus, mut now) = (EscBus::default(), Timestamp::from_ms(5));
        let mut bench = Bench::new(DriverConfig::default(), false);
        bench.line(now, "167 157 170 201\n").unwrap();
        pass(&mut bench, &mut bus, &mut now, 3.0);
        assert!(bench.is_running());
        assert_eq!(bus.values(), [167, 157, 170, 201]);
        pass(&mut bench, &mut bus, &mut now, 5.0);
        assert_eq!(bus.values(), [167, 157, 170, 201], "a line stands");
        assert!(bench.line(now, "300 1 1 1").is_err());
        bench.line(now, "\n").unwrap();
        pass(&mut bench, &mut bus, &mut now, 1.0);
        assert_eq!(
            bus.values(),
            [167, 157, 170, 201],
            "a bad line changes nothing"
        );
        bench.end(now);
        pass(&mut bench, &mut bus, &mut now, 1.0);
        assert_eq!(bus.values(), [0; 4]);
        assert!(bench.is_over() && !bench.has_failed());
    }

    #[test]
    fn lines_in_radps_turn_the_motors_at_that_speed_and_a_zero_stops_them() {
        let (mut bus, mut now) = (EscBus::default(), Timestamp::ZERO);
        let mut bench = Bench::new(DriverConfig::default(), true);
        bench.line(now, "300 312.498 320 330").unwrap();
        pass(&mut bench, &mut bus, &mut now, 3.0);
        for (turned, asked) in bus
            .speeds_radps()
            .iter()
            .zip([300.0, 312.498, 320.0, 330.0])
        {
            assert!((turned - asked).abs() < 1.0, "{turned} {asked}");
        }
        bench.line(now, "0 0 0 0").unwrap();
        pass(&mut bench, &mut bus, &mut now, 0.1);
        assert_eq!(bus.values(), [0; 4]);
        assert!(!bench.is_over(), "the next line may start them again");
    }

    #[test]
    fn without_a_line_the_end_of_input_ends_at_once() {
        let (mut bus, mut now) = (EscBus::default(), Timestamp::ZERO);
        let mut bench = Bench::new(DriverConfig::default(), false);
        bench.end(now);
        pass(&mut bench, &mut bus, &mut now, 1.0);
        assert!(bench.is_over() && now.s() < 0.1);
    }
}
