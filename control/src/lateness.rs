//! What is left of the gains when the loop runs late.
//!
//! A step that comes late flies by an old state, and its command holds for longer: both are dead time. The gains are made for the
//! dead time of a usual loop and keep their margins when they shrink as the whole lag grows.

use crate::params::ControlParams;

/// Lag that the gains are made for: dead time of the RC stream, attitude's response, a usual step, s.
const LAG_S: f64 = 0.18;
/// A step this long is usual: one beat waited for, s.
const USUAL_S: f64 = 0.05;
/// Lateness becomes this much dead time: half of it by the command that holds, the rest by the state that is old.
const SHARE: f64 = 2.0;
/// Longer than this is a stall, not a slow loop, s.
const LONGEST_S: f64 = 0.2;
/// Late steps are averaged over this time, s: one alone is soon forgotten.
const MEMORY_S: f64 = 0.5;

/// How late the steps of a loop have been.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lateness {
    mean_s: f64,
}

impl Lateness {
    /// Takes the time since the last step, s; gives the share of the gains that keeps their margins, 1 in a loop that is never late.
    pub fn step(&mut self, dt_s: f64) -> f64 {
        let dt_s = dt_s.min(LONGEST_S);
        let late_s = (dt_s - USUAL_S).max(0.0);
        self.mean_s += (late_s - self.mean_s) * (1.0 - libm::exp(-dt_s / MEMORY_S));
        LAG_S / (LAG_S + SHARE * self.mean_s)
    }
}

impl ControlParams {
    /// These, with the gains of place, velocity and height taken back to a share; integrals by its square, for they are slower by as
    /// much again.
    pub(crate) fn taken_back(&self, share: f64) -> Self {
        Self {
            xy_p: self.xy_p * share,
            xy_vel_p: self.xy_vel_p * share,
            xy_vel_i: self.xy_vel_i * share * share,
            z_p: self.z_p * share,
            z_vel_p: self.z_vel_p * share,
            z_vel_i: self.z_vel_i * share * share,
            yaw_p: self.yaw_p * share,
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_in_time_has_all_its_gains_and_a_late_one_less_until_it_is_in_time_again() {
        let mut lateness = Lateness::default();
        for k in 0..400 {
            // 40 Hz, and now and then a beat that was waited for.
            let dt_s = if k % 20 == 0 { 0.05 } else { 0.025 };
            assert!((lateness.step(dt_s) - 1.0).abs() < 1e-12);
        }
        let mut share = 1.0;
        for _ in 0..40 {
            lateness.step(0.105);
            share = lateness.step(0.025);
        }
        assert!((0.6..0.75).contains(&share), "{share}");
        for _ in 0..80 {
            share = lateness.step(0.025);
        }
        assert!(share > 0.98, "{share}");
    }

    #[test]
    fn what_is_taken_back_is_gains_and_nothing_else() {
        let p = ControlParams::default();
        let half = p.taken_back(0.5);
        assert!((half.xy_vel_p - 0.5 * p.xy_vel_p).abs() < 1e-12);
        assert!((half.z_vel_i - 0.25 * p.z_vel_i).abs() < 1e-12);
        assert!((half.acc_hor - p.acc_hor).abs() < 1e-12);
        assert_eq!(p.taken_back(1.0), p);
    }
}
