//! What is wrong with odometry, learned while the place is known: a bias per metre, and how far to trust the rest.
//!
//! Optical flow has a scale error, wheels have unequal radii: such errors repeat on every metre. Between two places that
//! the ranges have confirmed, at least half a metre apart, odometry's error is seen; its part that is proportional to the
//! step (longer, askew, and curved per metre ahead) is taken off later steps, the rest widens the motion noise. The
//! correction is linear in the step, so that the jitter of hovering adds up to nothing.

use super::cluster::Cluster;
use super::motion::MotionNoise;
use super::planar::Planar;

/// Distance between the two ends of a segment, m.
const SEGMENT_M: f64 = 0.5;
/// After so long a way to and fro without getting there the segment begins again, m.
const WANDERED_M: f64 = 2.0;
/// A segment with more turns than this says little about the way, rad.
const SEGMENT_RAD: f64 = 3.0;
/// Segments remembered, about.
const MEMORY: f64 = 20.0;
/// Weight of "no bias" before anything is seen, m2 of way.
const PRIOR_M2: f64 = 4.0;
/// Largest bias believed: 25 % of the way, and 0.25 rad/m.
const LARGEST: f64 = 0.25;
/// Weight of "noise as modelled" before anything is seen, in segments.
const PRIOR_SEGMENTS: f64 = 5.0;
/// Largest factor on the noise.
const LARGEST_FACTOR: f64 = 3.0;

/// One end of a segment.
#[derive(Clone, Copy, Debug)]
struct End {
    pose: Planar,
    odometry: Planar,
    variance: [f64; 2],
}

/// Learned bias and noise of odometry.
#[derive(Clone, Debug, Default)]
pub struct Drift {
    from: Option<End>,
    way_m: f64,
    turn_rad: f64,
    /// Noise of the model over the segment: position m2, yaw rad2.
    expected: [f64; 2],
    /// Forgetting sums of errors times steps: along, aside, turn by ahead.
    products: [f64; 3],
    /// Forgetting sums of steps squared: whole, and ahead only.
    ways: [f64; 2],
    /// Forgetting sums of the squared errors over what was expected, and their number.
    excess: [f64; 2],
    segments: f64,
}

impl Drift {
    /// The step with its learned bias taken off.
    #[must_use]
    pub fn corrected(&self, step: &Planar) -> Planar {
        let [scale, skew, curve] = self.bias();
        Planar::new(
            step.x + scale * step.x - skew * step.y,
            step.y + scale * step.y + skew * step.x,
            step.yaw + curve * step.x,
        )
    }

    /// Motion noise widened by what was seen.
    #[must_use]
    pub fn widened(&self, noise: &MotionNoise) -> MotionNoise {
        let [position, yaw] = self.factors();
        MotionNoise {
            position_per_m: noise.position_per_m * position,
            yaw_per_rad: noise.yaw_per_rad * yaw,
            yaw_per_m: noise.yaw_per_m * yaw,
            ..*noise
        }
    }

    /// Error of odometry per metre: longer along the step, to the left of it, m/m; counter-clockwise per metre ahead, rad/m.
    #[must_use]
    pub fn bias(&self) -> [f64; 3] {
        let [along, aside, curve] = self.products;
        let [ways, ahead] = self.ways.map(|w| w + PRIOR_M2);
        [along / ways, aside / ways, curve / ahead].map(|b| b.clamp(-LARGEST, LARGEST))
    }

    /// Factors on the noise of position and yaw, 1 or more.
    #[must_use]
    pub fn factors(&self) -> [f64; 2] {
        self.excess.map(|e| {
            let square = (e + PRIOR_SEGMENTS) / (self.segments + PRIOR_SEGMENTS);
            libm::sqrt(square).clamp(1.0, LARGEST_FACTOR)
        })
    }

    /// Odometry went this step, with this noise expected.
    pub fn moved(&mut self, step: &Planar, std: (f64, f64)) {
        self.way_m += step.length();
        self.turn_rad += step.yaw.abs();
        self.expected[0] += std.0 * std.0;
        self.expected[1] += std.1 * std.1;
    }

    /// The ranges confirm this place, with odometry there.
    pub fn confirmed(&mut self, cluster: &Cluster, odometry: &Planar) {
        let end = End {
            pose: cluster.pose,
            odometry: *odometry,
            variance: [
                0.5 * (cluster.covariance[0][0] + cluster.covariance[1][1]),
                cluster.covariance[2][2],
            ],
        };
        let Some(from) = self.from else {
            self.begin(Some(end));
            return;
        };
        if from.odometry.distance(odometry) >= SEGMENT_M {
            if self.turn_rad < SEGMENT_RAD {
                self.learn(&from, &end);
            }
            self.begin(Some(end));
        } else if self.way_m > WANDERED_M {
            self.begin(Some(end));
        }
    }

    /// The place is not known, or jumped: the segment ends without a lesson.
    pub fn interrupt(&mut self) {
        self.begin(None);
    }

    fn begin(&mut self, from: Option<End>) {
        self.from = from;
        self.way_m = 0.0;
        self.turn_rad = 0.0;
        self.expected = [0.0; 2];
    }

    fn learn(&mut self, from: &End, to: &End) {
        let told = from.odometry.step_to(&to.odometry);
        let true_step = from.pose.step_to(&to.pose);
        let error = [
            true_step.x - told.x,
            true_step.y - told.y,
            vehicle::angle::wrap_pi(true_step.yaw - told.yaw),
        ];
        let corrected = self.corrected(&told);
        let rest = [
            true_step.x - corrected.x,
            true_step.y - corrected.y,
            vehicle::angle::wrap_pi(true_step.yaw - corrected.yaw),
        ];
        let keep = 1.0 - 1.0 / MEMORY;
        let lessons = [
            error[0] * told.x + error[1] * told.y,
            error[1] * told.x - error[0] * told.y,
            error[2] * told.x,
        ];
        for (product, lesson) in self.products.iter_mut().zip(lessons) {
            *product = keep * *product + lesson;
        }
        let ahead = told.x * told.x;
        self.ways[0] = keep * self.ways[0] + ahead + told.y * told.y;
        self.ways[1] = keep * self.ways[1] + ahead;
        let seen = [
            0.5 * (rest[0] * rest[0] + rest[1] * rest[1]),
            rest[2] * rest[2],
        ];
        for (i, seen) in seen.into_iter().enumerate() {
            let ends = from.variance[i] + to.variance[i];
            // One wild segment is an outlier, not a lesson.
            let ratio = ((seen - ends) / self.expected[i].max(1e-9)).clamp(0.0, 16.0);
            self.excess[i] = keep * self.excess[i] + ratio;
        }
        self.segments = keep * self.segments + 1.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcl::random::Random;

    fn at(pose: Planar) -> Cluster {
        Cluster {
            pose,
            mass: 1.0,
            covariance: [[1e-4, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-4]],
        }
    }

    /// Learns from segments of one metre whose true steps are given.
    fn taught(mut step: impl FnMut() -> Planar) -> Drift {
        let mut drift = Drift::default();
        let (mut pose, mut odometry) = (Planar::default(), Planar::default());
        let told = Planar::new(1.0, 0.0, 0.1);
        for _ in 0..100 {
            drift.confirmed(&at(pose), &odometry);
            drift.moved(&told, MotionNoise::default().std_of(&told));
            odometry = odometry.then(&told);
            pose = pose.then(&step());
        }
        drift
    }

    #[test]
    fn a_curve_in_every_metre_is_taken_off_and_exact_steps_teach_nothing() {
        let drift = taught(|| Planar::new(0.95, 0.0, 0.16));
        let corrected = drift.corrected(&Planar::new(2.0, 0.0, 0.0));
        assert!(
            corrected.is_near(&Planar::new(1.9, 0.0, 0.12), 0.03, 0.03),
            "{corrected:?}"
        );
        let drift = taught(|| Planar::new(1.0, 0.0, 0.1));
        assert!(drift.bias().iter().all(|b| b.abs() < 1e-9));
        assert!(drift.factors().iter().all(|f| (f - 1.0).abs() < 1e-9));
    }

    #[test]
    fn jitter_on_the_spot_is_not_turned_into_a_way() {
        let drift = taught(|| Planar::new(0.9, 0.1, 0.2));
        let mut pose = Planar::default();
        for k in 0..1000 {
            let to_and_fro = if k % 2 == 0 { 0.02 } else { -0.02 };
            let step = drift.corrected(&Planar::new(to_and_fro, -to_and_fro, 0.0));
            pose = Planar::new(pose.x + step.x, pose.y + step.y, pose.yaw + step.yaw);
        }
        assert!(pose.is_near(&Planar::default(), 1e-9, 1e-9), "{pose:?}");
    }

    #[test]
    fn odometry_worse_than_modelled_widens_the_noise() {
        let mut random = Random::new(5);
        let drift = taught(|| Planar::new(1.0, 0.0, 0.1 + 0.12 * f64::from(random.gaussian())));
        let [position, yaw] = drift.factors();
        assert!(position < 1.1 && yaw > 2.0, "{position} {yaw}");
    }
}
