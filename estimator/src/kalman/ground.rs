//! What is below the vehicle: the floor, or something on it.
//!
//! A step of the down-range that the motion does not explain is a table or a stair, not a jump of the vehicle: the height
//! of the surface is estimated beside the filter and the position is left alone.

use vehicle::Timestamp;

/// Smallest step that is believed to be furniture, m (algorithms note 1.2).
const STEP_M: f64 = 0.15;
/// A step must be seen by this many samples in a row, so that one wild reading is not furniture.
const CONFIRMATIONS: u8 = 3;
/// Back on the floor when the surface is estimated this close to it, m.
const FLOOR_M: f64 = 0.10;

/// Readings farther apart than this tell nothing about an edge between them, s.
const EDGE_S: f64 = 0.3;

/// Surface under the vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ground {
    height_m: f64,
    /// Where a step seems to lead, and how many readings said so.
    candidate_m: f64,
    confirmations: u8,
    last: Option<(Timestamp, f64)>,
}

impl Ground {
    /// Height of the surface above home's floor, m.
    #[must_use]
    pub const fn height_m(&self) -> f64 {
        self.height_m
    }

    /// Forgets every step: the vehicle stands or starts on the floor.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Judges a reading of the height above the surface against the filter's height above home's floor: true if it may
    /// correct the filter, false while a step is being confirmed.
    ///
    /// Furniture has edges: only a reading that jumps against the one before begins a step. A disagreement that grew
    /// slowly is the filter's own error, and is left to the filter.
    pub fn is_same_surface(
        &mut self,
        at: Timestamp,
        above_home_m: f64,
        above_surface_m: f64,
        std_m: f64,
    ) -> bool {
        let surface = above_home_m - above_surface_m;
        let has_edge = self.last.is_none_or(|(then, last)| {
            (surface - last).abs() > STEP_M || at.seconds_since(then) > EDGE_S
        });
        self.last = Some((at, surface));
        // Not a step while the motion itself is that uncertain.
        let threshold = STEP_M.max(4.0 * std_m);
        if (surface - self.height_m).abs() <= threshold {
            self.confirmations = 0;
            return true;
        }
        if has_edge {
            self.confirmations = 0;
        } else if self.confirmations == 0 {
            return true;
        }
        self.candidate_m = surface;
        self.confirmations += 1;
        if self.confirmations >= CONFIRMATIONS {
            let is_floor = self.candidate_m.abs() < FLOOR_M;
            self.height_m = if is_floor { 0.0 } else { self.candidate_m };
            self.confirmations = 0;
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn readings(ground: &mut Ground, from_ms: u64, above_surface: &[f64]) -> Vec<bool> {
        above_surface
            .iter()
            .zip(0u64..)
            .map(|(d, k)| {
                ground.is_same_surface(Timestamp::from_ms(from_ms + 40 * k), 1.0, *d, 0.02)
            })
            .collect()
    }

    #[test]
    fn a_table_is_believed_after_three_readings_and_the_floor_comes_back() {
        let mut g = Ground::default();
        assert_eq!(
            readings(&mut g, 0, &[1.02, 1.0, 0.3, 0.29]),
            [true, true, false, false]
        );
        assert!(g.height_m() == 0.0);
        assert_eq!(readings(&mut g, 160, &[0.3, 0.31]), [false, true]);
        assert!((g.height_m() - 0.7).abs() < 1e-9);
        assert_eq!(
            readings(&mut g, 240, &[1.03; 4]),
            [false, false, false, true]
        );
        assert!(g.height_m() == 0.0);
    }

    #[test]
    fn one_wild_reading_is_no_furniture() {
        let mut g = Ground::default();
        assert_eq!(
            readings(&mut g, 0, &[1.0, 0.3, 1.0, 1.0, 1.0]),
            [true, false, true, true, true]
        );
        assert!(g.height_m() == 0.0);
    }

    #[test]
    fn a_slow_disagreement_is_the_filters_own_error() {
        let mut g = Ground::default();
        let slowly: Vec<f64> = (0..20).map(|k| 1.0 - 0.04 * f64::from(k)).collect();
        assert!(readings(&mut g, 0, &slowly).iter().all(|same| *same));
    }

    #[test]
    fn an_uncertain_height_is_corrected_instead_of_inventing_furniture() {
        let mut g = Ground::default();
        assert!(g.is_same_surface(Timestamp::ZERO, 1.0, 0.5, 0.5));
    }
}
