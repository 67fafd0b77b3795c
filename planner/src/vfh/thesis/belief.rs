//! Probabilistic cells of a sonar's cone (Moravec and Elfes 1985), the thesis' alternative to counting.

/// Opening angle of the cone, degrees (omega).
pub const CONE_DEG: f64 = 30.0;

/// How sure one reading is about a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Belief {
    /// That it is empty, 0..=1.
    pub empty: f64,
    /// That it is occupied, 0..=1.
    pub occupied: f64,
}

/// What a reading `range_m` with the error `eps_m` of a sonar that sees from `min_m` on says about a place `distance_m` away
/// and `off_deg` off the axis.
#[must_use]
pub fn of_reading(range_m: f64, eps_m: f64, min_m: f64, distance_m: f64, off_deg: f64) -> Belief {
    let aside = 2.0 * off_deg / CONE_DEG;
    if aside.abs() > 1.0 {
        return Belief::default();
    }
    let angular = 1.0 - aside * aside;
    let parabola = |share: f64| angular * (1.0 - share * share);
    let before_m = range_m - eps_m;
    let mut belief = Belief::default();
    if distance_m >= min_m && distance_m <= before_m && before_m > min_m {
        belief.empty = parabola((distance_m - min_m) / (before_m - min_m));
    }
    if (distance_m - range_m).abs() <= eps_m && eps_m > 0.0 {
        belief.occupied = parabola((distance_m - range_m) / eps_m);
    }
    belief
}

impl Belief {
    /// Both, `e + e' - e e'`; a reading is less sure of an obstacle where emptiness is known.
    #[must_use]
    pub fn fused(self, reading: Self) -> Self {
        let either = |a: f64, b: f64| a + b - a * b;
        let empty = either(self.empty, reading.empty);
        Self {
            empty,
            occupied: either(self.occupied, reading.occupied * (1.0 - empty)),
        }
    }

    /// The map's value: occupancy where it prevails, else minus emptiness.
    #[must_use]
    pub fn value(self) -> f64 {
        if self.occupied >= self.empty {
            self.occupied
        } else {
            -self.empty
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reading_empties_before_it_and_fills_at_it() {
        let at = |d: f64, off: f64| of_reading(2.0, 0.1, 0.0, d, off);
        assert!((at(0.95, 0.0).empty - 0.75).abs() < 1e-12);
        assert!((at(2.0, 0.0).occupied - 1.0).abs() < 1e-12);
        assert!((at(2.05, 0.0).occupied - 0.75).abs() < 1e-12);
        assert!((at(2.0, 7.5).occupied - 0.75).abs() < 1e-12);
        assert_eq!(at(2.0, 15.1), Belief::default());
        assert_eq!(at(2.5, 0.0), Belief::default());
    }

    #[test]
    fn readings_add_up_and_emptiness_holds_against_one_echo() {
        let half = Belief {
            empty: 0.5,
            occupied: 0.0,
        };
        let empty = half.fused(half);
        assert!((empty.empty - 0.75).abs() < 1e-12 && empty.value() < 0.0);
        let echo = Belief {
            empty: 0.0,
            occupied: 1.0,
        };
        assert!((empty.fused(echo).occupied - 0.25).abs() < 1e-12);
        assert!(Belief::default().fused(echo).value() > 0.99);
    }
}
