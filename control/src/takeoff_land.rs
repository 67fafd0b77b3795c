//! The two moments near the floor: leaving it and touching it.

use crate::params::ControlParams;
use vehicle::airframe::GRAVITY_MPS2;

/// After the ramp the lift keeps growing this fast until something moves, weights per second.
const SEARCH_RATE: f64 = 0.3;
/// Lift is never searched beyond this many weights.
const SEARCH_MAX: f64 = 1.8;
/// Lift-off is seen late: by then the lift is this much above the weight (0.4 s of search and the dead time).
const SEEN_LATE: f64 = 1.12;
/// Less lift than this does not leave the floor even with a vehicle much lighter than believed, weights.
const LEAVE_MIN: f64 = 0.65;
/// Signs of leaving must last this long, s: height and climb are noisy on the floor, and whoever flies set points while
/// still standing slides off to one side.
const LEAVING_S: f64 = 0.08;
/// A landed vehicle is at most this far above its landed height (estimate error), m.
const NEAR_M: f64 = 0.1;
/// A vehicle moving less than this stands, m/s.
const STILL_MPS: f64 = 0.12;
/// Standing this long with thrust going down is landed, s.
const LANDED_S: f64 = 0.7;
/// A descent passes this last bit in a fraction of a second; who stays in it stands, whatever lift and climb pretend (a
/// sagging battery lifts less than is asked for, and on the floor the climb is noise), m, s, m/s.
const LAST_BIT_M: f64 = 0.06;
const LAST_BIT_S: f64 = 0.8;
const LAST_BIT_MPS: f64 = 0.25;
/// A height known worse than this is a barometer's: blown upon by the propellers it sinks below the floor and never stands still, m.
const SURE_M: f64 = 0.08;
/// Thrust is taken back this fast once on the floor, weights per second.
const RELEASE_RATE: f64 = 1.2;
/// The floor carries at least this share of the weight when contact is inferred from the accelerometer alone.
const CARRIED: f64 = 0.2;

/// What both machines look at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloorView {
    /// Height above what is below and climb rate (m, m/s up), if known.
    pub height: Option<(f64, f64)>,
    /// One standard deviation of the height, m.
    pub height_std_m: f64,
    /// Climb integrated from the accelerometer and forgotten within seconds, m/s up: all there is without a height.
    pub climb_guess_mps: f64,
    /// Upward specific force, m/s2: what a level accelerometer feels.
    pub felt_mps2: f64,
}

/// Spool-up: the throttle grows until the vehicle leaves the floor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpoolUp {
    lift: f64,
    started_height_m: Option<f64>,
    leaving_s: f64,
    lifted_off: bool,
}

impl SpoolUp {
    /// Lift in weights for the next step. `lifted_off` is latched when the floor is left.
    pub fn step(&mut self, p: &ControlParams, dt_s: f64, view: &FloorView) -> f64 {
        if self.lifted_off {
            return self.lift;
        }
        let rate = if self.lift < 0.85 {
            0.85 / p.takeoff_ramp_s
        } else {
            SEARCH_RATE
        };
        self.lift = (self.lift + rate * dt_s).min(SEARCH_MAX);
        let leaving = self.lift > LEAVE_MIN
            && match view.height {
                Some((height_m, climb_mps)) => {
                    let start = *self.started_height_m.get_or_insert(height_m);
                    height_m > start + 0.06 || (climb_mps > 0.15 && height_m > start + 0.03)
                }
                None => view.felt_mps2 > 1.08 * GRAVITY_MPS2,
            };
        self.leaving_s = if leaving { self.leaving_s + dt_s } else { 0.0 };
        self.lifted_off = self.leaving_s >= LEAVING_S;
        self.lift
    }

    /// True once the vehicle has left the floor.
    #[must_use]
    pub const fn lifted_off(&self) -> bool {
        self.lifted_off
    }

    /// The weight found at lift-off, as a multiple of the believed one.
    #[must_use]
    pub fn weight_found(&self) -> f64 {
        (self.lift / SEEN_LATE).clamp(0.7, 1.4)
    }
}

/// A descent may be this far behind the speed that was asked for, m: the start takes its time.
const SLACK_M: f64 = 0.3;
/// What it is behind is made up for from at most this far, m.
const BEHIND_M: f64 = 0.5;
/// A height that grows by more in a step is the floor beside a table, m.
const EDGE_M: f64 = 0.05;

/// Where a descent should be by now. A climb rate that is wrong (a leaning, pushed vehicle) holds it up; the height tells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Schedule {
    planned_m: Option<f64>,
    height_m: f64,
}

impl Schedule {
    /// How far the descent is behind beyond what is usual, m, 0..=0.5.
    pub fn step(&mut self, dt_s: f64, descent_mps: f64, height_m: f64) -> f64 {
        let mut planned_m = self.planned_m.unwrap_or(height_m) - descent_mps * dt_s;
        let edge_m = height_m - self.height_m;
        if self.planned_m.is_some() && edge_m > EDGE_M {
            planned_m += edge_m;
        }
        planned_m = planned_m.clamp(height_m - SLACK_M - BEHIND_M, height_m);
        (self.planned_m, self.height_m) = (Some(planned_m), height_m);
        (height_m - planned_m - SLACK_M).max(0.0)
    }
}

/// Touch-down: notices the floor, takes the thrust back, says when the motors may stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touchdown {
    cap: f64,
    standing_s: f64,
    low_s: f64,
    landed: bool,
}

impl Default for Touchdown {
    fn default() -> Self {
        Self {
            cap: f64::INFINITY,
            standing_s: 0.0,
            low_s: 0.0,
            landed: false,
        }
    }
}

impl Touchdown {
    /// The lift that may be asked for, weights: `lift` in the air, less and less on the floor, zero when landed.
    pub fn step(&mut self, dt_s: f64, view: &FloorView, landed_height_m: f64, lift: f64) -> f64 {
        if self.landed {
            return 0.0;
        }
        let allowed = lift.min(self.cap);
        let carried = view.felt_mps2 / GRAVITY_MPS2 - allowed;
        // Taking thrust back proves a suspicion: the floor carries the difference, while in the air the felt force goes down with it.
        let proof = self.cap > 0.85 || carried > 0.5 * (1.0 - self.cap);
        let standing = match view.height {
            Some((height_m, climb_mps)) if view.height_std_m > SURE_M => {
                let near = height_m < landed_height_m + 2.0 * view.height_std_m;
                (near || climb_mps.abs() < STILL_MPS && lift < 1.0) && proof
            }
            Some((height_m, climb_mps)) => {
                let low = height_m < landed_height_m + LAST_BIT_M && climb_mps.abs() < LAST_BIT_MPS;
                self.low_s = if low { self.low_s + dt_s } else { 0.0 };
                let still = climb_mps.abs() < STILL_MPS;
                // Low and still; or not where the floor was expected, yet something carries us.
                self.low_s > LAST_BIT_S
                    || still
                        && lift < 1.0
                        && (height_m < landed_height_m + NEAR_M || carried > CARRIED)
            }
            // Blind: no longer sinking is a suspicion.
            None => view.climb_guess_mps > -STILL_MPS && lift < 1.0 && proof,
        };
        if standing {
            self.standing_s += dt_s;
            self.cap = (allowed - RELEASE_RATE * dt_s).max(0.2);
            self.landed = self.standing_s >= LANDED_S;
        } else {
            self.standing_s = (self.standing_s - 2.0 * dt_s).max(0.0);
            self.cap = if self.cap < 1.0 {
                self.cap + 2.0 * RELEASE_RATE * dt_s
            } else {
                f64::INFINITY
            };
        }
        if self.landed { 0.0 } else { allowed }
    }

    /// True once the vehicle stands on the floor with its thrust taken back.
    #[must_use]
    pub const fn landed(&self) -> bool {
        self.landed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.02;

    fn view(height_m: f64, climb_mps: f64) -> FloorView {
        FloorView {
            height: Some((height_m, climb_mps)),
            height_std_m: 0.02,
            climb_guess_mps: 0.0,
            felt_mps2: GRAVITY_MPS2,
        }
    }

    #[test]
    fn the_throttle_grows_until_the_floor_is_left_and_then_the_weight_is_known() {
        let p = ControlParams::default();
        let mut s = SpoolUp::default();
        let mut lift = 0.0;
        for _ in 0..120 {
            lift = s.step(&p, DT, &view(0.05, 0.0));
        }
        assert!(!s.lifted_off() && lift > 1.0);
        s.step(&p, DT, &view(0.12, 0.3));
        assert!(!s.lifted_off(), "a single noisy height is no lift-off");
        for _ in 0..10 {
            s.step(&p, DT, &view(0.12, 0.3));
        }
        assert!(s.lifted_off());
        assert!((s.weight_found() - s.lift / SEEN_LATE).abs() < 1e-9);
    }

    #[test]
    fn low_and_still_for_0_7_s_is_landed_but_sinking_past_is_not() {
        let mut t = Touchdown::default();
        for _ in 0..100 {
            t.step(DT, &view(0.1, -0.3), 0.05, 0.95);
        }
        assert!(!t.landed());
        let mut steps = 0;
        while !t.landed() {
            t.step(DT, &view(0.06, 0.0), 0.05, 0.9);
            steps += 1;
            assert!(steps < 100);
        }
        assert!((f64::from(steps) * DT - LANDED_S).abs() < 0.05);
        assert!(t.step(DT, &view(0.06, 0.0), 0.05, 0.9).abs() < 1e-12);
    }

    #[test]
    fn low_for_long_is_landed_though_lift_and_climb_say_otherwise() {
        let mut t = Touchdown::default();
        for i in 0..120 {
            let climb_mps = if i % 2 == 0 { 0.2 } else { -0.2 };
            t.step(DT, &view(0.07, climb_mps), 0.05, 1.1);
        }
        assert!(t.landed());
    }

    #[test]
    fn a_guessed_height_below_the_floor_is_a_landing_once_the_floor_carries_and_none_in_the_air() {
        // On the floor, by a barometer that reads 0.2 m too low and sinks on.
        let guess = |felt_mps2: f64| FloorView {
            height_std_m: 0.2,
            felt_mps2,
            ..view(-0.15, -0.2)
        };
        let mut t = Touchdown::default();
        let mut steps = 0;
        while !t.landed() {
            t.step(DT, &guess(GRAVITY_MPS2), 0.05, 1.0);
            steps += 1;
            assert!(steps < 100);
        }
        // The same in the air: less thrust is less that is felt.
        let mut t = Touchdown::default();
        let mut lift = 1.0;
        let mut least: f64 = 1.0;
        for _ in 0..500 {
            lift = t.step(DT, &guess(lift * GRAVITY_MPS2), 0.05, 1.0);
            least = least.min(lift);
        }
        assert!(!t.landed() && least > 0.75, "{least}");
    }

    #[test]
    fn a_descent_in_time_is_let_alone_and_one_that_hangs_is_behind() {
        let mut s = Schedule::default();
        for k in 0..200 {
            // A tenth of a metre behind, as every start is; then a table's edge.
            let floor_m = if k > 100 { 0.5 } else { 0.0 };
            let height_m = 1.6 + floor_m - 0.4 * DT * f64::from(k);
            assert!(s.step(DT, 0.4, height_m) == 0.0);
        }
        let mut s = Schedule::default();
        let behind: Vec<f64> = (0..200).map(|_| s.step(DT, 0.25, 0.4)).collect();
        assert!(behind[50] == 0.0 && (behind[199] - BEHIND_M).abs() < 1e-9);
    }

    #[test]
    fn a_hover_just_above_the_floor_is_not_a_landing() {
        let mut t = Touchdown::default();
        for _ in 0..500 {
            t.step(DT, &view(0.14, 0.01), 0.05, 1.01);
        }
        assert!(!t.landed());
    }

    #[test]
    fn a_table_higher_than_the_floor_is_noticed_by_the_accelerometer() {
        let mut t = Touchdown::default();
        for _ in 0..100 {
            t.step(DT, &view(0.7, 0.0), 0.05, 0.7);
        }
        assert!(t.landed());
    }
}
