//! Gains from a relay test: what swings tells how much the loop bears (Astrom and Hagglund 1984).
//!
//! A relay in place of the controller pushes with `+d` while the measured value is below its goal and with `-d` above; behind dead time and lag it swings by
//! itself with the period at which the loop's phase is -180 degrees. A proportional gain of `4 d / (pi a)`, `a` the amplitude of what swings, would
//! keep that up: the ultimate gain. Half of it leaves 6 dB.

use core::f64::consts::{PI, TAU};

/// Swings that are thrown away at the start, and those that are needed then.
const FIRST: usize = 2;
const NEEDED: usize = 4;
/// Periods and amplitudes of one test may differ by this share.
const STEADY: f64 = 0.35;

/// Decides for the relay, with hysteresis against noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relay {
    /// Push.
    pub push: f64,
    /// The value must pass the goal by this before the push turns.
    pub hysteresis: f64,
    is_up: bool,
}

impl Relay {
    /// Begins with a push up.
    #[must_use]
    pub const fn new(push: f64, hysteresis: f64) -> Self {
        Self {
            push,
            hysteresis,
            is_up: true,
        }
    }

    /// The push for an error (value less goal).
    pub fn step(&mut self, error: f64) -> f64 {
        if error > self.hysteresis {
            self.is_up = false;
        } else if error < -self.hysteresis {
            self.is_up = true;
        }
        if self.is_up { self.push } else { -self.push }
    }
}

/// What a relay test has found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ultimate {
    /// Gain at which the loop would swing by itself, unit of the push over unit of the value.
    pub gain: f64,
    /// Period, s.
    pub period_s: f64,
    /// Half of the swing.
    pub amplitude: f64,
    /// Swings that were used.
    pub swings: usize,
}

/// Why there is no answer.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TuningError {
    /// Too few swings.
    #[error("{swings} swings, {NEEDED} are needed: a longer test, or a stronger push")]
    TooFew {
        /// Seen.
        swings: usize,
    },
    /// They differ.
    #[error("the swings differ by {percent:.0} %: something else moved it")]
    Unsteady {
        /// Largest difference from their mean.
        percent: f64,
    },
    /// Not more than noise.
    #[error("it swings by {amplitude:.4}, which is no more than the hysteresis: a stronger push")]
    Noise {
        /// Half of the swing.
        amplitude: f64,
    },
}

/// Evaluates a relay test: times, values less their goal; the relay's push and hysteresis.
///
/// # Errors
/// [`TuningError`].
pub fn ultimate(
    samples: &[(f64, f64)],
    push: f64,
    hysteresis: f64,
) -> Result<Ultimate, TuningError> {
    // Upward passes of the goal.
    let passes: Vec<f64> = samples
        .windows(2)
        .filter(|w| w[0].1 < 0.0 && w[1].1 >= 0.0)
        .map(|w| w[1].0)
        .collect();
    let swings = passes.len().saturating_sub(FIRST + 1);
    if swings < NEEDED {
        return Err(TuningError::TooFew { swings });
    }
    let mut periods = Vec::new();
    let mut amplitudes = Vec::new();
    for pair in passes[FIRST..].windows(2) {
        let within = samples
            .iter()
            .filter(|(t, _)| (pair[0]..pair[1]).contains(t));
        let (low, high) = within.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), (_, v)| {
            (l.min(*v), h.max(*v))
        });
        periods.push(pair[1] - pair[0]);
        amplitudes.push(0.5 * (high - low));
    }
    let period_s = mean(&periods);
    let amplitude = mean(&amplitudes);
    if amplitude <= 1.5 * hysteresis {
        return Err(TuningError::Noise { amplitude });
    }
    let spread = |all: &[f64], mean: f64| {
        all.iter()
            .map(|v| (v / mean - 1.0).abs())
            .fold(0.0, f64::max)
    };
    let worst = spread(&periods, period_s).max(spread(&amplitudes, amplitude));
    if worst > STEADY {
        return Err(TuningError::Unsteady {
            percent: 100.0 * worst,
        });
    }
    // The describing function of a relay with hysteresis.
    let real = libm::sqrt((amplitude * amplitude - hysteresis * hysteresis).max(1e-12));
    Ok(Ultimate {
        gain: 4.0 * push / (PI * real),
        period_s,
        amplitude,
        swings: periods.len(),
    })
}

fn mean(all: &[f64]) -> f64 {
    all.iter().sum::<f64>() / all.len().max(1) as f64
}

/// Gains of a cascade: place P, velocity P and I.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CascadeGains {
    /// Error of place to velocity, 1/s.
    pub place_p: f64,
    /// Error of velocity to acceleration, 1/s.
    pub velocity_p: f64,
    /// Its integral, 1/s2.
    pub velocity_i: f64,
}

impl CascadeGains {
    /// From a relay test of acceleration against velocity. The velocity loop crosses near its P (velocity is the integral of acceleration): at a
    /// 3.5th of the frequency of the ultimate swing at most, and half of the ultimate gain (6 dB); its integral turns five degrees there; the place
    /// loop is 0.38 times as fast.
    #[must_use]
    pub fn from_relay(u: &Ultimate) -> Self {
        let swing_radps = TAU / u.period_s;
        let velocity_p = (0.5 * u.gain).min(swing_radps / 3.5);
        Self {
            place_p: 0.38 * velocity_p,
            velocity_p,
            velocity_i: velocity_p * velocity_p * libm::tan(5_f64.to_radians()),
        }
    }

    /// Gain margin of the velocity loop, as a factor.
    #[must_use]
    pub fn margin(&self, u: &Ultimate) -> f64 {
        u.gain / self.velocity_p
    }
}

/// What a step response was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepFigures {
    /// Beyond the goal, as a share of the step.
    pub overshoot: f64,
    /// Time from 10 to 90 % of the step, s.
    pub rise_s: f64,
    /// Time after which it stays within the band, s.
    pub settled_s: f64,
}

/// Judges a step response: times since the step, way done as a share of the step (1 = there), the band as a share.
#[must_use]
pub fn step_figures(samples: &[(f64, f64)], band: f64) -> StepFigures {
    let first = |share: f64| {
        samples
            .iter()
            .find(|(_, v)| *v >= share)
            .map_or(f64::NAN, |(t, _)| *t)
    };
    StepFigures {
        overshoot: samples.iter().map(|(_, v)| v - 1.0).fold(0.0, f64::max),
        rise_s: first(0.9) - first(0.1),
        settled_s: samples
            .iter()
            .filter(|(_, v)| (v - 1.0).abs() > band)
            .map(|(t, _)| *t)
            .fold(0.0, f64::max),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    /// Velocity behind a first-order lag and dead time.
    fn swing(lag_s: f64, dead_s: f64, push: f64, hysteresis: f64, seconds: f64) -> Vec<(f64, f64)> {
        let h = 1e-3;
        let mut relay = Relay::new(push, hysteresis);
        let mut on_way = VecDeque::from(vec![0.0; (dead_s / h) as usize]);
        let (mut a, mut v) = (0.0, -0.05);
        (0..(seconds / h) as u32)
            .map(|i| {
                on_way.push_back(relay.step(v));
                let u = on_way.pop_front().unwrap_or(0.0);
                a += (u - a) * h / lag_s;
                v += a * h;
                (f64::from(i) * h, v)
            })
            .collect()
    }

    #[test]
    fn the_ultimate_swing_of_a_known_loop_is_found() {
        // Phase of 1/(s (1 + 0.1 s)) e^(-0.06 s) is -180 degrees where atan(0.1 w) + 0.06 w = 90 degrees.
        let (lag, dead) = (0.1, 0.06);
        let mut w = 1.0;
        while libm::atan(lag * w) + dead * w < PI / 2.0 {
            w += 1e-4;
        }
        let gain = w * libm::sqrt(1.0 + lag * lag * w * w);
        let u = ultimate(&swing(lag, dead, 1.0, 0.0, 20.0), 1.0, 0.0).unwrap();
        // The describing function sees the first harmonic only.
        assert!((u.period_s / (TAU / w) - 1.0).abs() < 0.06, "{u:?} {w}");
        assert!((u.gain / gain - 1.0).abs() < 0.20, "{u:?} {gain}");
    }

    #[test]
    fn proposed_gains_leave_six_decibels_and_settle() {
        let (lag, dead) = (0.1, 0.06);
        let u = ultimate(&swing(lag, dead, 1.0, 0.02, 20.0), 1.0, 0.02).unwrap();
        let g = CascadeGains::from_relay(&u);
        assert!(g.margin(&u) >= 1.99, "{g:?}");
        // Flown on the model.
        let h = 1e-3;
        let mut on_way = VecDeque::from(vec![0.0; (dead / h) as usize]);
        let (mut a, mut v, mut p, mut i) = (0.0, 0.0, 0.0, 0.0);
        let mut path = Vec::new();
        for n in 0..8000 {
            let wanted: f64 = g.place_p * (1.0 - p);
            let error = wanted.clamp(-1.5, 1.5) - v;
            i += g.velocity_i * error * h;
            on_way.push_back((g.velocity_p * error + i).clamp(-2.2, 2.2));
            a += (on_way.pop_front().unwrap_or(0.0) - a) * h / lag;
            v += a * h;
            p += v * h;
            path.push((f64::from(n) * h, p));
        }
        let s = step_figures(&path, 0.05);
        assert!(s.overshoot < 0.15 && s.settled_s < 4.0, "{g:?} {s:?}");
    }

    #[test]
    fn tests_that_say_nothing_are_refused() {
        let short = swing(0.1, 0.06, 1.0, 0.0, 1.0);
        assert!(matches!(
            ultimate(&short, 1.0, 0.0),
            Err(TuningError::TooFew { .. })
        ));
        let noise: Vec<(f64, f64)> = (0..2000)
            .map(|i| (f64::from(i) * 0.01, 0.001 * libm::sin(f64::from(i) * 0.1)))
            .collect();
        assert!(matches!(
            ultimate(&noise, 1.0, 0.01),
            Err(TuningError::Noise { .. })
        ));
        let wild: Vec<(f64, f64)> = (0..2000)
            .map(|i| {
                let t = f64::from(i) * 0.01;
                (t, libm::sin(t * t))
            })
            .collect();
        assert!(matches!(
            ultimate(&wild, 1.0, 0.0),
            Err(TuningError::Unsteady { .. })
        ));
    }
}
