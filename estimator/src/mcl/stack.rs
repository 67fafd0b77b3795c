//! Scans of the last seconds as one: what a global search looks at.
//!
//! Readings are kept in odometry axes, thinned so that a wall seen a hundred times counts once.

use super::beams::LevelBeam;
use super::planar::Planar;
use arrayvec::ArrayVec;
use vehicle::Timestamp;

/// Most readings a search looks at.
pub const MAX_STACK: usize = 384;
/// Readings closer together than this are one, m.
const THIN_M: f64 = 0.07;
/// Odometry drifts: readings taken this far back along the way are dropped, m.
const MAX_WAY_M: f64 = 4.0;

#[derive(Clone, Copy, Debug)]
struct Kept {
    beam: LevelBeam,
    way_m: f64,
}

/// The readings, in odometry axes.
#[derive(Clone, Debug, Default)]
pub struct Stack {
    kept: ArrayVec<Kept, MAX_STACK>,
    oldest: usize,
    scans: u32,
    way_m: f64,
    swept_rad: f64,
    last: Option<(Timestamp, Planar)>,
    searched_at: Option<(Timestamp, f64, f64, u32)>,
}

impl Stack {
    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Adds the readings of one update, given in odometry axes, taken at an odometry pose.
    pub fn add(&mut self, at: Timestamp, pose: &Planar, beams: &[LevelBeam]) {
        if let Some((_, last)) = self.last {
            let step = last.step_to(pose);
            self.way_m += step.length();
            self.swept_rad += step.yaw.abs();
        }
        self.last = Some((at, *pose));
        self.scans = self.scans.saturating_add(1);
        for beam in beams.iter().filter(|b| b.is_hit()) {
            let [x, y] = beam.points[1];
            let kept = Kept {
                beam: *beam,
                way_m: self.way_m,
            };
            let same = self.kept.iter_mut().find(|k| {
                let [kx, ky] = k.beam.points[1];
                (kx - x).abs() < THIN_M && (ky - y).abs() < THIN_M
            });
            if let Some(same) = same {
                // The newer one drifted less, seen from now.
                *same = kept;
            } else if self.kept.try_push(kept).is_err() {
                self.kept[self.oldest] = kept;
                self.oldest = (self.oldest + 1) % MAX_STACK;
            }
        }
        let way = self.way_m;
        self.kept.retain(|k| way - k.way_m <= MAX_WAY_M);
        if self.kept.len() < MAX_STACK {
            self.oldest = 0;
        }
    }

    /// Number of readings.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.kept.len()
    }

    /// True without readings.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.kept.len() == 0
    }

    /// How far the vehicle has turned since the stack was cleared, rad.
    #[must_use]
    pub const fn swept_rad(&self) -> f64 {
        self.swept_rad
    }

    /// True when the stack holds enough that was not there at the last search.
    #[must_use]
    pub fn is_ripe(&self) -> bool {
        let Some((at, _)) = self.last else {
            return false;
        };
        if self.kept.len() < 12 || self.scans < 10 {
            return false;
        }
        match self.searched_at {
            // Wait for half a turn of a quadrant at least, or for three seconds if nobody turns.
            None => self.swept_rad > 1.6 || self.way_m > 0.5 || self.scans >= 45,
            Some((then, way, swept, scans)) => {
                let (moved, turned) = (self.way_m - way, self.swept_rad - swept);
                let seconds = at.seconds_since(then);
                self.scans >= scans + 5
                    && (turned > 1.6
                        || moved > 0.5
                        || (seconds > 3.0 && (turned > 0.5 || moved > 0.3)))
            }
        }
    }

    /// The readings in the axes of the last pose, that pose, and a mark that they have been searched.
    pub fn take(&mut self) -> Option<(ArrayVec<LevelBeam, MAX_STACK>, Planar)> {
        let (at, pose) = self.last?;
        self.searched_at = Some((at, self.way_m, self.swept_rad, self.scans));
        let axes = pose.axes();
        let beams = self.kept.iter().map(|k| k.beam.inward(&axes)).collect();
        Some((beams, pose))
    }
}
