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
/// Thrust is taken back this fast once on the floor, weights per second.
const RELEASE_RATE: f64 = 1.2;
/// The floor carries at least this share of the weight when contact is inferred from the accelerometer alone.
const CARRIED: f64 = 0.2;

/// What both machines look at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloorView {
    /// Height above what is below and climb rate (m, m/s up), if known.
    pub height: Option<(f64, f64)>,
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
        let standing = match view.height {
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
            // Blind: no longer sinking is a suspicion; taking thrust back proves it, because the floor then carries the
            // difference, while in the air the felt force would go down with the thrust.
            None => {
                let suspected = view.climb_guess_mps > -STILL_MPS && lift < 1.0;
                suspected && (self.cap > 0.85 || carried > 0.5 * (1.0 - self.cap))
            }
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
