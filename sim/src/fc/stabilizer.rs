//! Angle mode, rate loops and mixer.
//!
//! ```text
//! sticks -> angle -> (angle P) -> rate -> (rate PID) -> mixer -> motors
//!           yaw and acro sticks ---^
//! ```
//!
//! Body FRD inside: roll right, pitch **nose up**, yaw clockwise are positive.

use super::manner::{AngleCurve, StickRules, YawCurve};
use core::f64::consts::PI;
use vehicle::{Frd, In};

/// ACTUAL rates: sensitivity at the centre and at full stick, rad/s.
const CENTRE_RATE: f64 = 70.0 * PI / 180.0;
const FULL_RATE: f64 = 670.0 * PI / 180.0;
/// Betaflight's motor output when armed with the throttle at the bottom.
pub(super) const IDLE: f64 = 0.055;
/// Angle error to rate, 1/s: with the rate loop below about 100 ms to a commanded angle.
const ANGLE_GAIN: f64 = 10.0;
/// Fastest rate the angle loop asks for, rad/s.
const ANGLE_RATE_LIMIT: f64 = 8.0;
/// Rate PID, motor command per rad/s (roll, pitch, yaw), per rad, and per rad/s2.
const P: [f64; 3] = [0.040, 0.040, 0.25];
const I: [f64; 3] = [0.20, 0.20, 0.50];
const D: [f64; 3] = [0.0006, 0.0006, 0.0];
/// Integral part at most, motor command.
const I_LIMIT: f64 = 0.10;
/// Low-pass of the D part, s.
const D_LAG_S: f64 = 0.002;
/// Mixer rows (roll, pitch nose up, yaw) of motors 1 to 4.
const MIXER: [[f64; 3]; 4] = [
    [-1.0, -1.0, -1.0],
    [-1.0, 1.0, 1.0],
    [1.0, -1.0, 1.0],
    [1.0, 1.0, -1.0],
];
const STEP_S: f64 = crate::quad::STEP_S;

/// What the loops steer towards.
#[derive(Clone, Copy, Debug)]
pub(super) struct Command {
    /// Receiver sticks: roll right, pitch nose **down**, yaw clockwise -1..=1, throttle 0..=1.
    pub(super) sticks: [f64; 4],
    /// ANGLE mode; otherwise sticks are rates.
    pub(super) angle_mode: bool,
    /// What the sticks mean.
    pub(super) rules: &'static StickRules,
}

/// State of the rate loops.
#[derive(Clone, Debug, Default)]
pub(super) struct Stabilizer {
    integral: [f64; 3],
    last_rates: [f64; 3],
    derivative: [f64; 3],
}

/// Betaflight's ACTUAL curve without expo: share of the largest deflection for a stick in -1..=1.
pub(super) fn stick_curve(x: f64) -> f64 {
    (CENTRE_RATE * x + (FULL_RATE - CENTRE_RATE) * x * x.abs()) / FULL_RATE
}

impl AngleCurve {
    /// Angle of a stick in -1..=1, rad.
    fn angle(self, x: f64) -> f64 {
        match self {
            Self::Actual { limit_deg } => limit_deg * PI / 180.0 * stick_curve(x),
            Self::Expo {
                gain_deg,
                expo,
                limit_deg,
            } => (gain_deg * expo_curve(x, expo))
                .clamp(-limit_deg, limit_deg)
                .to_radians(),
        }
    }
}

impl YawCurve {
    /// Rate of a stick in -1..=1, rad/s.
    fn rate(self, x: f64) -> f64 {
        match self {
            Self::Actual => FULL_RATE * stick_curve(x),
            Self::Expo { full_dps, expo } => (full_dps * expo_curve(x, expo)).to_radians(),
        }
    }
}

/// The expo of Cleanflight and its kin.
fn expo_curve(x: f64, expo: f64) -> f64 {
    x * (1.0 - expo + expo * x * x)
}

impl Stabilizer {
    /// One millisecond. `roll` and `pitch` as the controller's own estimate has them, rad.
    pub(super) fn step(
        &mut self,
        command: &Command,
        roll: f64,
        pitch: f64,
        rates: &In<Frd>,
    ) -> [f64; 4] {
        let [x_roll, x_pitch, x_yaw, throttle] = command.sticks;
        let rules = command.rules;
        let mut wanted = [x_roll, -x_pitch, x_yaw].map(|x| rules.yaw.rate(x));
        if command.angle_mode {
            let angle_to_rate = |x: f64, is: f64| {
                let error = rules.angle.angle(x) - is;
                (ANGLE_GAIN * error).clamp(-ANGLE_RATE_LIMIT, ANGLE_RATE_LIMIT)
            };
            wanted[0] = angle_to_rate(x_roll, roll);
            wanted[1] = angle_to_rate(-x_pitch, pitch);
        }
        if throttle <= 0.0 {
            // Without airmode the loops rest at the bottom of the throttle.
            *self = Self {
                last_rates: [rates.x(), rates.y(), rates.z()],
                ..Self::default()
            };
            return [rules.motors[0]; 4];
        }
        let effort = self.rate_loops(wanted, rates);
        mix(throttle, effort, rules.motors)
    }

    fn rate_loops(&mut self, wanted: [f64; 3], rates: &In<Frd>) -> [f64; 3] {
        let is = [rates.x(), rates.y(), rates.z()];
        let mut effort = [0.0; 3];
        for axis in 0..3 {
            let error = wanted[axis] - is[axis];
            let integral = self.integral[axis] + I[axis] * error * STEP_S;
            self.integral[axis] = integral.clamp(-I_LIMIT, I_LIMIT);
            let slope = (is[axis] - self.last_rates[axis]) / STEP_S;
            self.derivative[axis] += (slope - self.derivative[axis]) * (STEP_S / D_LAG_S);
            self.last_rates[axis] = is[axis];
            effort[axis] = P[axis] * error + self.integral[axis] - D[axis] * self.derivative[axis];
        }
        effort[2] = effort[2].clamp(-0.2, 0.2);
        effort
    }
}

/// Throttle plus effort per axis as four motor outputs between `idle` and `full`; torque is kept before thrust.
fn mix(throttle: f64, effort: [f64; 3], [idle, full]: [f64; 2]) -> [f64; 4] {
    let mut parts = MIXER.map(|row| row[0] * effort[0] + row[1] * effort[1] + row[2] * effort[2]);
    let span = full - idle;
    let spread = |p: &[f64; 4]| {
        let low = p.iter().copied().fold(f64::INFINITY, f64::min);
        let high = p.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        (low, high)
    };
    let (mut low, mut high) = spread(&parts);
    if high - low > span {
        let k = span / (high - low);
        parts = parts.map(|p| p * k);
        (low, high) = (low * k, high * k);
    }
    // Not `clamp`: with the spread at its limit the two bounds may cross by a rounding error.
    let lift = (idle + span * throttle).max(idle - low).min(full - high);
    parts.map(|p| lift + p)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stick_1600_is_3_4_degrees_of_tilt_and_38_degrees_per_second_of_yaw() {
        // x = 0.2: 70 * 0.2 + 600 * 0.04 = 38 deg/s; 38 / 670 * 60 = 3.40 deg.
        assert!((60.0 * stick_curve(0.2) - 3.403).abs() < 1e-3);
        assert!(((FULL_RATE * stick_curve(0.2)).to_degrees() - 38.0).abs() < 1e-9);
        assert!((stick_curve(-1.0) + 1.0).abs() < 1e-12);
    }

    #[test]
    fn stick_1600_is_2_3_degrees_and_30_degrees_per_second_for_inav() {
        let sticks = &crate::fc::manner::Manner::Inav.table().sticks;
        assert!((sticks.angle.angle(0.2).to_degrees() - 2.3).abs() < 0.05);
        assert!((sticks.yaw.rate(0.2).to_degrees() - 30.0).abs() < 0.5);
        assert!((sticks.angle.angle(1.0).to_degrees() - 30.0).abs() < 1e-9);
    }

    #[test]
    fn forward_stick_speeds_up_the_rear_motors() {
        let mut stabilizer = Stabilizer::default();
        let command = Command {
            sticks: [0.0, 0.5, 0.0, 0.5],
            angle_mode: true,
            rules: &crate::fc::manner::Manner::Betaflight46.table().sticks,
        };
        let [m1, m2, m3, m4] = stabilizer.step(&command, 0.0, 0.0, &In::zero());
        assert!(m1 > m2 && m3 > m4 && (m1 - m3).abs() < 1e-12);
    }

    #[test]
    fn outputs_stay_between_idle_and_full_whatever_is_asked() {
        for k in 0..1000 {
            let k = f64::from(k) * 1e-3;
            for out in mix(k, [1.7 * k, -0.9 * k, 0.2 * k], [IDLE, 1.0]) {
                assert!((IDLE - 1e-9..=1.0 + 1e-9).contains(&out), "{out}");
            }
        }
    }
}
