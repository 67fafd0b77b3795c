//! Aids from outside: a pose from a camera or a tracking system, and satellite fixes.
//!
//! A pose in our own local frame is believed like a place on the plan. A pose in a frame of its own drifts, and where its zero
//! lies nobody knows: of it only velocity counts, told or from two poses, along the body's axes, to which its heading is the same.

use super::{Estimator, MAX_AGE_S};
use crate::kalman::aid;
use crate::kalman::{Aid, Filter, Nominal, Observation, Quality, VELOCITY};
use nalgebra::Vector3;
use vehicle::angle::wrap_pi;
use vehicle::{ExternalFrame, ExternalPose, GnssFix, Timestamp};

/// Doubt of a pose that tells none.
const POSITION_STD_M: f64 = 0.05;
const YAW_STD_RAD: f64 = 0.05;
/// A source that claims more certainty than this is not believed.
const LEAST_STD_M: f64 = 0.01;
const LEAST_STD_RAD: f64 = 0.01;
/// Doubt of a velocity from outside, m/s.
const VELOCITY_STD_MPS: f64 = 0.08;
/// Two poses between these tell a velocity, s.
const STEP_S: core::ops::RangeInclusive<f64> = 0.01..=0.3;
/// Faster than this is a jump of the source, m/s.
const FASTEST_MPS: f64 = 6.0;
/// Errors of cameras last.
const CORRELATION_S: f64 = 0.2;
/// No satellite fix indoors is better than this, m, and its error lasts for minutes.
const GNSS_LEAST_STD_M: f64 = 0.5;
const GNSS_CORRELATION_S: f64 = 10.0;

/// The pose before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Last {
    pose: Option<ExternalPose>,
    /// Where the receiver's zero lies, north and east of home, m.
    gnss_zero: Option<[f64; 2]>,
}

impl Estimator {
    /// A pose from a camera, a tracking system or another localizer.
    pub fn external_pose(&mut self, pose: &ExternalPose) {
        let finite = pose.position.is_finite()
            && pose.yaw_rad.is_finite()
            && pose.velocity.is_none_or(|v| v.is_finite());
        let age_s = self.navigation.at().seconds_since(pose.at);
        if !finite || !self.navigation.is_running() || age_s.abs() > 2.0 * MAX_AGE_S {
            self.diagnostics.refused_samples += 1;
            return;
        }
        let before = self.external.pose.replace(*pose);
        let before =
            before.filter(|b| b.reset_counter == pose.reset_counter && b.frame == pose.frame);
        if pose.frame == ExternalFrame::Local {
            self.external_place(pose);
        }
        if let Some([forward, right]) = body_velocity(pose, before.as_ref()) {
            let q = Quality {
                std: VELOCITY_STD_MPS,
                correlation_s: 0.05,
                least_variance: 0.0,
            };
            let mut is_used = false;
            for filter in [&mut self.navigation, &mut self.odometry] {
                is_used |= fuse_body(filter, Aid::ExternalForward, pose.at, 0.0, forward, q);
                is_used |= fuse_body(
                    filter,
                    Aid::ExternalRight,
                    pose.at,
                    core::f64::consts::FRAC_PI_2,
                    right,
                    q,
                );
            }
            if is_used {
                self.fresh.external_velocity = Some(pose.at);
            }
        }
    }

    fn external_place(&mut self, pose: &ExternalPose) {
        let std_m = pose.position_std_m.unwrap_or(POSITION_STD_M);
        let std_rad = pose.yaw_std_rad.unwrap_or(YAW_STD_RAD);
        if !(std_m.is_finite() && std_rad.is_finite()) {
            return;
        }
        let (std_m, std_rad) = (std_m.max(LEAST_STD_M), std_rad.max(LEAST_STD_RAD));
        let x = *self.navigation.state();
        let age_s = self.navigation.at().seconds_since(pose.at);
        // The place was true then: carried to now with the velocity we have.
        let (north, east) = (
            pose.position.x() + x.velocity.x * age_s,
            pose.position.y() + x.velocity.y * age_s,
        );
        let at = self.navigation.at();
        if !self.fresh.has_external(at) && !self.state.health.position {
            self.navigation
                .relocate(north, east, pose.yaw_rad, std_m, std_rad);
            self.fresh.external = Some(pose.at);
            return;
        }
        let q = Quality {
            std: std_m,
            correlation_s: CORRELATION_S,
            least_variance: 0.0,
        };
        let o = aid::position::observe_along(self.navigation.state(), [1.0, 0.0]);
        let mut is_used = self.navigation.fuse(Aid::ExternalNorth, at, &o, north, q);
        let o = aid::position::observe_along(self.navigation.state(), [0.0, 1.0]);
        is_used &= self.navigation.fuse(Aid::ExternalEast, at, &o, east, q);
        let o = aid::yaw::observe(self.navigation.state());
        let q = Quality {
            std: std_rad,
            correlation_s: CORRELATION_S,
            least_variance: 0.0,
        };
        self.navigation
            .fuse(Aid::ExternalYaw, at, &o, pose.yaw_rad, q);
        if is_used {
            self.fresh.external = Some(pose.at);
        }
    }

    /// A satellite fix: keeps the position from drifting away where nothing else knows it. It never counts as knowing
    /// the place: what a receiver says indoors may be a room away. The first fix is where the
    /// vehicle stands then.
    pub fn gnss(&mut self, fix: &GnssFix) {
        let finite = fix.position.is_finite() && fix.std_m[0].is_finite();
        let age_s = self.navigation.at().seconds_since(fix.at);
        if !finite || !self.navigation.is_running() || age_s.abs() > 1.0 {
            self.diagnostics.refused_samples += 1;
            return;
        }
        let q = Quality {
            std: fix.std_m[0].max(GNSS_LEAST_STD_M),
            correlation_s: GNSS_CORRELATION_S,
            least_variance: 0.0,
        };
        let at = self.navigation.at();
        let here = self.navigation.state().position;
        let told = [fix.position.x(), fix.position.y()];
        let zero = *self
            .external
            .gnss_zero
            .get_or_insert([here.x - told[0], here.y - told[1]]);
        let place = [told[0] + zero[0], told[1] + zero[1]];
        for (i, a) in [Aid::GnssNorth, Aid::GnssEast].into_iter().enumerate() {
            let d = [[1.0, 0.0], [0.0, 1.0]][i];
            let o = aid::position::observe_along(self.navigation.state(), d);
            self.navigation.fuse(a, at, &o, place[i], q);
        }
    }
}

/// Level velocity forward and right, m/s.
fn body_velocity(pose: &ExternalPose, before: Option<&ExternalPose>) -> Option<[f64; 2]> {
    let v = match (pose.velocity, before) {
        (Some(v), _) => [v.x(), v.y()],
        (None, Some(before)) => {
            let dt_s = pose.at.seconds_since(before.at);
            if !STEP_S.contains(&dt_s) {
                return None;
            }
            let moved = (pose.position - before.position) / dt_s;
            let yaw = before.yaw_rad + 0.5 * wrap_pi(pose.yaw_rad - before.yaw_rad);
            let (s, c) = libm::sincos(yaw);
            [
                c * moved.x() + s * moved.y(),
                -s * moved.x() + c * moved.y(),
            ]
        }
        (None, None) => return None,
    };
    (libm::hypot(v[0], v[1]) < FASTEST_MPS).then_some(v)
}

/// Velocity along a level direction that is turned from the heading by an angle, as an aid.
fn fuse_body(
    filter: &mut Filter,
    a: Aid,
    at: Timestamp,
    angle_rad: f64,
    measured_mps: f64,
    q: Quality,
) -> bool {
    let x: Nominal = *filter.state();
    let (s, c) = libm::sincos(x.yaw() + angle_rad);
    let direction = Vector3::new(c, s, 0.0);
    let mut row = crate::kalman::ErrorVector::zeros();
    row.fixed_rows_mut::<3>(VELOCITY).copy_from(&direction);
    let o = Observation::new(direction.dot(&x.velocity), row);
    filter.fuse(a, at, &o, measured_mps, q)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::EstimatorParams;
    use vehicle::{AttitudeSample, FloorPlan, Frd, ImuSample, In, Ned, floor_plan::Cell};

    /// A vehicle that flies at a constant velocity (m/s north, east) with a heading, and an estimator that is told of it.
    struct Flyer {
        estimator: Estimator,
        ms: u64,
        velocity: [f64; 2],
        heading_rad: f64,
    }

    impl Flyer {
        fn new(velocity: [f64; 2], heading_rad: f64) -> Self {
            let plan = FloorPlan::from_cells(40, 0.1, [0.0, 0.0], vec![Cell::Free; 1600]).unwrap();
            let anchor = plan.anchor();
            let plan = std::sync::Arc::new(plan);
            let mut estimator = Estimator::new(EstimatorParams::default(), Some(plan), anchor, 1);
            estimator.start_unknown(Timestamp::ZERO);
            Self {
                estimator,
                ms: 0,
                velocity,
                heading_rad,
            }
        }

        fn truth(&self) -> In<Ned> {
            let t = self.ms as f64 * 1e-3;
            In::new(self.velocity[0] * t, self.velocity[1] * t, -1.0)
        }

        fn run(&mut self, ms: u64, mut each_50ms: impl FnMut(&Self) -> Option<ExternalPose>) {
            for _ in 0..ms / 25 {
                self.ms += 25;
                let at = Timestamp::from_ms(self.ms);
                self.estimator.attitude(&AttitudeSample {
                    at,
                    roll_rad: 0.0,
                    pitch_rad: 0.0,
                    heading_rad: 0.0,
                });
                self.estimator.imu(&ImuSample {
                    at,
                    accel_mps2: In::<Frd>::new(0.0, 0.0, -9.80665),
                    gyro_radps: In::zero(),
                    mag: None,
                });
                if self.ms.is_multiple_of(50)
                    && let Some(pose) = each_50ms(self)
                {
                    self.estimator.external_pose(&pose);
                }
                self.estimator.update(at);
            }
        }

        fn pose(&self, frame: ExternalFrame) -> ExternalPose {
            ExternalPose {
                at: Timestamp::from_ms(self.ms),
                frame,
                position: self.truth(),
                yaw_rad: self.heading_rad,
                velocity: None,
                position_std_m: None,
                yaw_std_rad: None,
                reset_counter: 0,
            }
        }
    }

    #[test]
    fn a_pose_in_our_frame_is_the_place_until_it_stops() {
        let mut flyer = Flyer::new([0.3, -0.2], 1.0);
        flyer.run(4000, |f| Some(f.pose(ExternalFrame::Local)));
        let state = flyer.estimator.state();
        assert!(state.health.position && state.health.velocity);
        let error = state.position - flyer.truth();
        assert!(error.norm_xy() < 0.05, "{error:?}");
        assert!((state.yaw_rad() - 1.0).abs() < 0.03, "{}", state.yaw_rad());
        flyer.run(1000, |_| None);
        assert!(
            !flyer.estimator.state().health.position,
            "half a second without"
        );
    }

    #[test]
    fn a_frame_of_its_own_gives_velocity_along_the_body_and_no_place() {
        // The camera's zero lies elsewhere and is turned: its yaw is 1 where ours is 0, and so is its velocity.
        let (s, c) = libm::sincos(1.0);
        let mut flyer = Flyer::new([0.4 * c, 0.4 * s], 1.0);
        flyer.run(4000, |f| Some(f.pose(ExternalFrame::Own)));
        let state = *flyer.estimator.state();
        assert!(!state.health.position && state.health.velocity);
        let v = flyer.estimator.odometry().velocity;
        assert!((v.x() - 0.4).abs() < 0.05 && v.y().abs() < 0.05, "{v:?}");
    }

    #[test]
    fn a_jump_with_another_reset_counter_is_no_velocity_and_nonsense_is_refused() {
        let mut flyer = Flyer::new([0.0, 0.0], 0.0);
        flyer.run(1000, |f| Some(f.pose(ExternalFrame::Own)));
        let before = flyer.estimator.odometry().velocity;
        flyer.run(50, |f| {
            let jumped = f.pose(ExternalFrame::Own);
            Some(ExternalPose {
                position: jumped.position + In::new(0.2, 0.0, 0.0),
                reset_counter: 1,
                ..jumped
            })
        });
        let after = flyer.estimator.odometry().velocity;
        assert!((after - before).norm() < 0.02, "{before:?} {after:?}");
        let refused = flyer.estimator.diagnostics().refused_samples;
        let mut nan = flyer.pose(ExternalFrame::Local);
        nan.yaw_rad = f64::NAN;
        flyer.estimator.external_pose(&nan);
        let old = ExternalPose {
            at: Timestamp::ZERO,
            ..flyer.pose(ExternalFrame::Local)
        };
        flyer.estimator.external_pose(&old);
        assert_eq!(flyer.estimator.diagnostics().refused_samples, refused + 2);
        assert!(!flyer.estimator.state().health.position);
    }

    #[test]
    fn satellites_hold_the_position_and_never_claim_the_place() {
        let mut flyer = Flyer::new([0.0, 0.0], 0.0);
        flyer.run(500, |_| None);
        for _ in 0..60 {
            flyer.run(500, |_| None);
            let at = Timestamp::from_ms(flyer.ms);
            flyer.estimator.gnss(&GnssFix {
                at,
                position: In::new(100.0, -50.0, 0.0),
                velocity: None,
                std_m: [1.0, 2.0],
                place_deg: [0.0; 2],
                altitude_m: 0.0,
                satellites: 8,
            });
        }
        let state = flyer.estimator.state();
        assert!(!state.health.position);
        assert!(state.position.norm_xy() < 5.0, "{:?}", state.position);
    }
}
