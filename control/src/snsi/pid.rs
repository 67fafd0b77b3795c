//! SNSI's PID: adds to its last output, clamped to channel limits in microseconds.

/// Which arithmetic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// As its program has it: `out += kP err + kI sum + kD prev`.
    Published,
    /// The velocity form of a PID: `out += kP (err - prev) + kI err + kD (err - 2 prev + prev2)`.
    Velocity,
}

/// One controller of the family.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PidConfig {
    /// Proportional.
    pub kp: f64,
    /// Integral, per cycle.
    pub ki: f64,
    /// Derivative, in cycles.
    pub kd: f64,
    /// Limits, us.
    pub limits_us: (f64, f64),
    /// Where it begins, us.
    pub start_us: f64,
    /// Which arithmetic.
    pub form: Form,
}

impl PidConfig {
    const fn published(kp: f64, kd: f64, limits_us: (f64, f64), start_us: f64) -> Self {
        Self {
            kp,
            ki: 0.0,
            kd,
            limits_us,
            start_us,
            form: Form::Published,
        }
    }

    /// Height: cm of the down sonar to throttle.
    pub const ALTITUDE: Self = Self::published(0.01, 0.01, (1000.0, 1800.0), 1000.0);
    /// The same inside take-off and landing.
    pub const ALTITUDE_TAKEOFF: Self = Self::published(0.002, 0.000_85, (1000.0, 1800.0), 1000.0);
    /// Inclination ("speed"): degrees of pitch to the elevator.
    pub const INCLINATION: Self = Self::published(0.04, 0.01, (1400.0, 1600.0), 1500.0);
    /// Heading: degrees to the rudder.
    pub const YAW: Self = Self::published(0.02, 0.01, (1400.0, 1600.0), 1500.0);
}

/// Highest height that is asked for, cm.
pub const MAX_ALTITUDE_CM: f64 = 80.0;
/// Largest inclination that is asked for, degrees.
pub const MAX_INCLINATION_DEG: f64 = 8.0;

/// The controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pid {
    config: PidConfig,
    out_us: f64,
    sum: f64,
    previous: [f64; 2],
    is_fresh: bool,
}

impl Pid {
    /// At its start.
    #[must_use]
    pub const fn new(config: PidConfig) -> Self {
        Self {
            config,
            out_us: config.start_us,
            sum: 0.0,
            previous: [0.0; 2],
            is_fresh: true,
        }
    }

    /// From an output that somebody else has flown, us: no jump.
    pub const fn take_over(&mut self, out_us: f64) {
        let config = self.config;
        *self = Self::new(config);
        self.out_us = out_us.clamp(config.limits_us.0, config.limits_us.1);
    }

    /// One cycle with the error (target less measured; of angles the short way); answers whole microseconds.
    pub fn step(&mut self, error: f64) -> f64 {
        let c = &self.config;
        let (low, high) = c.limits_us;
        if !error.is_finite() {
            return libm::round(self.out_us);
        }
        // Anti-windup: at a limit, what pushes outward is no error.
        let pushes_out =
            (self.out_us >= high && error > 0.0) || (self.out_us <= low && error < 0.0);
        let err = if pushes_out { 0.0 } else { error };
        let [prev, prev2] = if self.is_fresh && c.form == Form::Velocity {
            [error; 2]
        } else {
            self.previous
        };
        self.is_fresh = false;
        let change = match c.form {
            Form::Published => {
                let change = c.kp * err + c.ki * self.sum + c.kd * prev;
                self.sum += err;
                self.previous = [err, prev];
                change
            }
            Form::Velocity => {
                self.previous = [error, prev];
                c.kp * (error - prev) + c.ki * err + c.kd * (error - 2.0 * prev + prev2)
            }
        };
        self.out_us = (self.out_us + change).clamp(low, high);
        libm::round(self.out_us)
    }

    /// The last output, not rounded, us.
    #[must_use]
    pub const fn out_us(&self) -> f64 {
        self.out_us
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    #[test]
    fn published_constants_and_first_cycles() {
        // Height 0, target 80 cm: 1000 + 0.01 * 80 = 1000.8, then + 0.8 + 0.01 * 80.
        let mut pid = Pid::new(PidConfig::ALTITUDE);
        assert_eq!(pid.step(MAX_ALTITUDE_CM), 1001.0);
        assert!((pid.out_us() - 1000.8).abs() < 1e-12);
        pid.step(MAX_ALTITUDE_CM);
        assert!((pid.out_us() - 1002.4).abs() < 1e-12);
        let mut pid = Pid::new(PidConfig::INCLINATION);
        pid.step(MAX_INCLINATION_DEG);
        assert!((pid.out_us() - 1500.32).abs() < 1e-12);
        let mut pid = Pid::new(PidConfig::YAW);
        pid.step(-90.0);
        assert!((pid.out_us() - 1498.2).abs() < 1e-12);
    }

    #[test]
    fn rounds_to_the_nearest_and_not_down() {
        let mut pid = Pid::new(PidConfig::ALTITUDE);
        assert_eq!(pid.step(60.0), 1001.0, "1000.6");
    }

    #[test]
    fn at_a_limit_what_pushes_outward_is_no_error_and_what_pulls_back_is() {
        for form in [Form::Published, Form::Velocity] {
            let config = PidConfig {
                // As published the sum itself winds up: none of its controllers has one.
                ki: if form == Form::Velocity { 0.01 } else { 0.0 },
                form,
                ..PidConfig::YAW
            };
            let mut pid = Pid::new(config);
            for _ in 0..5000 {
                assert!((1400.0..=1600.0).contains(&pid.step(90.0)));
            }
            assert_eq!(pid.out_us(), 1600.0);
            for _ in 0..3 {
                pid.step(-20.0);
            }
            assert!(pid.out_us() < 1600.0, "{form:?} comes back at once");
        }
    }

    #[test]
    fn no_number_changes_nothing() {
        let mut pid = Pid::new(PidConfig::ALTITUDE);
        pid.step(50.0);
        let before = pid;
        pid.step(f64::NAN);
        assert_eq!(pid, before);
    }

    #[test]
    fn as_published_height_is_reached_and_not_held() {
        // A vehicle that hovers at 1500 us and accelerates 0.03 m/s2 a us, 25 Hz, from the floor.
        let fly = |config: PidConfig| {
            let (mut pid, mut z, mut v) = (Pid::new(config), 0.0_f64, 0.0_f64);
            let (mut reached, mut worst) = (false, 0.0_f64);
            for cycle in 0..25 * 120 {
                let us = pid.step(MAX_ALTITUDE_CM - 100.0 * z);
                v += (us - 1500.0) * 0.03 * 0.04;
                z += v * 0.04;
                if z <= 0.0 {
                    (z, v) = (0.0, v.max(0.0));
                }
                reached |= z > 0.8;
                if cycle > 25 * 60 {
                    worst = worst.max((z - 0.8).abs());
                }
            }
            (reached, worst)
        };
        let (reached, worst) = fly(PidConfig::ALTITUDE);
        assert!(reached && worst > 0.5, "what its author saw: {worst}");
    }
}
