//! SNSI's family over an angle-mode controller: height to throttle, inclination to the elevator, heading to the rudder, each a PID in the velocity
//! form, and the table of priorities that puts them together.
//!
//! What SNSI's avoidance gave as targets (turn, inclination) comes from this project's planner. SNSI left the roll channel to the pilot; here the cascade
//! keeps the vehicle from drifting sideways. The elevator and the rudder begin at the inverse of the firmware's stick curve, and the PID adds what
//! is missing: alone it would need eight seconds for eight degrees.

use super::pid::{Form, MAX_INCLINATION_DEG, Pid, PidConfig};
use super::priorities::{CHANNELS, Claim, Priorities};

/// Height, us per cm, flown at 40 Hz: natural frequency 1.9 rad/s, damping 0.9 for a craft of thrust-to-weight 3 (chosen; SNSI's 0.01 integrates).
const ALTITUDE: PidConfig = PidConfig {
    kp: 1.1,
    ki: 0.012,
    kd: 42.0,
    limits_us: (1000.0, 1800.0),
    start_us: 1000.0,
    form: Form::Velocity,
};
/// Inclination, us per degree beyond the curve's inverse.
const INCLINATION: PidConfig = PidConfig {
    kp: 0.5,
    ki: 0.04,
    kd: 0.0,
    limits_us: (1400.0, 1600.0),
    start_us: 1500.0,
    form: Form::Velocity,
};
/// Heading, us per degree.
const YAW: PidConfig = PidConfig {
    kp: 1.6,
    ki: 0.0,
    kd: 0.0,
    limits_us: (1400.0, 1600.0),
    start_us: 1500.0,
    form: Form::Velocity,
};

/// What the family sees in a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Height above the floor, cm; none while the down sonar is silent.
    pub height_cm: Option<f64>,
    /// Wanted, cm.
    pub target_cm: f64,
    /// Nose down, degrees; none while the attitude is not known.
    pub inclination_deg: Option<f64>,
    /// Wanted, degrees.
    pub target_inclination_deg: f64,
    /// Turn that is missing, clockwise, the short way, degrees; none without a heading.
    pub turn_deg: Option<f64>,
    /// Stick that the curve gives for the wanted inclination, us from 1500.
    pub elevator_us: f64,
    /// Roll channel from elsewhere, us.
    pub roll_us: f64,
}

/// The family.
#[derive(Clone, Debug)]
pub struct SnsiLaw {
    altitude: Pid,
    inclination: Pid,
    yaw: Pid,
    table: Priorities,
}

impl Default for SnsiLaw {
    fn default() -> Self {
        let mut table = Priorities::default();
        let only = |i: usize| core::array::from_fn(|c| c == i);
        let claims = [
            ("side", 8, only(1)),
            ("height", 9, [true, false, false, false, true]),
            ("yaw", 10, only(3)),
            ("inclination", 11, only(2)),
        ];
        for (name, priority, channels) in claims {
            // Four different priorities.
            let _ = table.add(Claim {
                name,
                priority,
                channels,
            });
        }
        Self {
            altitude: Pid::new(ALTITUDE),
            inclination: Pid::new(INCLINATION),
            yaw: Pid::new(YAW),
            table,
        }
    }
}

impl SnsiLaw {
    /// From a throttle that hovers, us: no jump.
    pub const fn take_over(&mut self, throttle_us: f64) {
        self.altitude.take_over(throttle_us);
        self.inclination.take_over(1500.0);
        self.yaw.take_over(1500.0);
    }

    /// One cycle: five channels, us. Who sees nothing writes nothing.
    pub fn cycle(&mut self, s: &Seen) -> [f64; CHANNELS] {
        let height = s.height_cm.map(|cm| self.altitude.step(s.target_cm - cm));
        let most = MAX_INCLINATION_DEG;
        let wanted = s.target_inclination_deg.clamp(-most, most);
        let inclination = s
            .inclination_deg
            .map(|deg| self.inclination.step(wanted - deg) + s.elevator_us);
        // A turn is a rate: the missing turn itself is the error of each cycle.
        let yaw = s.turn_deg.map(|deg| {
            self.yaw.take_over(1500.0 + YAW.kp * deg);
            libm::round(self.yaw.out_us())
        });
        self.table.cycle(|name| match name {
            "side" => Some([0.0, s.roll_us, 0.0, 0.0, 0.0]),
            "height" => height.map(|us| [us, 0.0, 0.0, 0.0, 2000.0]),
            "inclination" => inclination.map(|us| [0.0, 0.0, us, 0.0, 0.0]),
            "yaw" => yaw.map(|us| [0.0, 0.0, 0.0, us, 0.0]),
            _ => None,
        })
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "exact by construction")]
mod tests {
    use super::*;

    const HOVERS: Seen = Seen {
        height_cm: Some(80.0),
        target_cm: 80.0,
        inclination_deg: Some(0.0),
        target_inclination_deg: 0.0,
        turn_deg: Some(0.0),
        elevator_us: 0.0,
        roll_us: 1500.0,
    };

    #[test]
    fn a_silent_sonar_leaves_the_throttle_and_the_rest_flies_on() {
        let mut law = SnsiLaw::default();
        law.take_over(1550.0);
        assert_eq!(law.cycle(&HOVERS), [1550.0, 1500.0, 1500.0, 1500.0, 2000.0]);
        let blind = Seen {
            height_cm: None,
            turn_deg: Some(90.0),
            ..HOVERS
        };
        assert_eq!(law.cycle(&blind), [1000.0, 1500.0, 1500.0, 1600.0, 1000.0]);
    }

    #[test]
    fn inclination_is_at_most_eight_degrees() {
        let mut law = SnsiLaw::default();
        let asked = |target| Seen {
            target_inclination_deg: target,
            ..HOVERS
        };
        let eight = law.clone().cycle(&asked(8.0))[2];
        assert_eq!(law.cycle(&asked(30.0))[2], eight);
    }

    #[test]
    fn eighty_centimetres_are_held_on_the_model_that_the_published_form_loses() {
        let mut law = SnsiLaw::default();
        law.take_over(1450.0);
        let (mut z, mut v, mut thrust) = (0.0_f64, 0.0_f64, 1450.0_f64);
        let mut worst = 0.0_f64;
        for cycle in 0..40 * 70 {
            let us = law.cycle(&Seen {
                height_cm: Some(100.0 * z),
                ..HOVERS
            })[0];
            for _ in 0..25 {
                // Motors follow within 50 ms.
                thrust += (us - thrust) * 0.001 / 0.05;
                v += (thrust - 1500.0) * 0.03 * 0.001;
                z = (z + v * 0.001).max(0.0);
                if z <= 0.0 {
                    v = v.max(0.0);
                }
            }
            if cycle > 40 * 10 {
                worst = worst.max((z - 0.8).abs());
            }
        }
        assert!(worst < 0.10, "{worst}");
    }
}
