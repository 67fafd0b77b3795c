//! Openings of the histogram and the directions worth trying.

use super::{SECTOR_RAD, SECTORS, sector_of};
use arrayvec::ArrayVec;

/// Most candidate directions: at most 36 openings fit 72 sectors, with up to three candidates each.
pub const CANDIDATES_MAX: usize = 108;

/// A run of free sectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Opening {
    /// First free sector.
    pub first: usize,
    /// Number of free sectors, 72 when nothing is blocked.
    pub count: usize,
}

impl Opening {
    /// True if the opening holds a sector.
    #[must_use]
    pub const fn holds(&self, sector: usize) -> bool {
        (sector + SECTORS - self.first) % SECTORS < self.count
    }
}

/// All openings, counter-clockwise.
#[must_use]
pub fn openings(blocked: &[bool; SECTORS]) -> ArrayVec<Opening, { SECTORS / 2 }> {
    let mut out = ArrayVec::new();
    let Some(wall) = blocked.iter().position(|b| *b) else {
        out.push(Opening {
            first: 0,
            count: SECTORS,
        });
        return out;
    };
    // Beginning behind a blocked sector no opening is cut in two.
    let mut run = 0;
    for i in 1..=SECTORS {
        let k = (wall + i) % SECTORS;
        if blocked[k] {
            if run > 0 {
                out.push(Opening {
                    first: (k + SECTORS - run) % SECTORS,
                    count: run,
                });
            }
            run = 0;
        } else {
            run += 1;
        }
    }
    out
}

/// Directions worth trying, rad counter-clockwise from plan x: the middle of a narrow opening; half of `wide` away from
/// both borders of a wide one, and the target itself if it lies between these (Ulrich and Borenstein 1998, section 3.4).
#[must_use]
pub fn candidates(
    blocked: &[bool; SECTORS],
    target_rad: f64,
    wide: usize,
) -> ArrayVec<f64, CANDIDATES_MAX> {
    let mut out = ArrayVec::new();
    let target = sector_of(target_rad);
    for opening in openings(blocked) {
        if opening.count == SECTORS {
            out.push(target_rad);
            continue;
        }
        let border = |sectors: f64| (opening.first as f64 + sectors) * SECTOR_RAD;
        let count = opening.count as f64;
        if opening.count < wide {
            out.push(border(0.5 * count));
        } else {
            let inset = 0.5 * wide as f64;
            out.push(border(inset));
            out.push(border(count - inset));
        }
        // The enlargement already keeps the vehicle clear, so the target may be taken wherever its sector is free.
        if opening.holds(target) {
            out.push(target_rad);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Sectors from a picture of twelve letters, six sectors each: `#` blocked, `.` free.
    fn picture(letters: &str) -> [bool; SECTORS] {
        let mut out = [false; SECTORS];
        for (i, letter) in letters.bytes().enumerate() {
            out[6 * i..6 * (i + 1)].fill(letter == b'#');
        }
        out
    }

    #[test]
    fn an_opening_across_zero_degrees_is_one_opening() {
        let found = openings(&picture("..####..##.."));
        assert_eq!(
            found.as_slice(),
            &[
                Opening {
                    first: 36,
                    count: 12
                },
                Opening {
                    first: 60,
                    count: 24
                }
            ]
        );
    }

    #[test]
    fn nothing_blocked_leads_straight_to_the_target() {
        assert_eq!(
            candidates(&picture("............"), 1.0, 16).as_slice(),
            &[1.0]
        );
    }

    #[test]
    fn everything_blocked_leads_nowhere() {
        assert!(candidates(&picture("############"), 1.0, 16).is_empty());
    }

    #[test]
    fn a_narrow_opening_is_passed_in_the_middle() {
        // Sectors 36..48, 180 to 240 degrees.
        let found = candidates(&picture("######..####"), 0.0, 16);
        assert_eq!(found.len(), 1);
        assert!((found[0].to_degrees() - 210.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn every_candidate_is_free(bits in proptest::collection::vec(any::<bool>(), SECTORS), target in -7.0..7.0f64) {
            let mut blocked = [false; SECTORS];
            blocked.copy_from_slice(&bits);
            for c in candidates(&blocked, target, 16) {
                // The middle of an even opening lies on a border between two free sectors.
                prop_assert!(!blocked[sector_of(c + 1e-9)]);
            }
        }
    }
}
