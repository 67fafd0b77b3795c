//! What the estimator does by itself: standing on the ground, lingering there with motors running, borrowing velocity, aiding navigation with the plan pose.

use super::{Estimator, MAX_AGE_S};
use crate::kalman::aid::{self, heading_increment, height};
use crate::kalman::{ATTITUDE, Aid, Quality};
use crate::mcl::{Fix, Planar};
use nalgebra::{UnitQuaternion, Vector3};
use vehicle::angle::wrap_pi;
use vehicle::{AttitudeSample, In, MapPose, Timestamp};

/// Deviation of a borrowed velocity, m/s.
const BORROWED_STD_MPS: f64 = 0.15;
/// A vehicle whose centre is at most this much above its landed height touches the floor or nearly so, m.
const ON_FLOOR_M: f64 = 0.05;
/// How fast it may slide there, m/s, and for how long.
const SLIDING_STD_MPS: f64 = 0.2;
const SLIDING_S: f64 = 0.2;

impl Estimator {
    /// Puts navigation at a plan pose.
    pub(super) fn go_to(&mut self, pose: &MapPose, std_m: f64, std_rad: f64) {
        let p = self.anchor.to_ned(In::new(pose.x_m, pose.y_m, 0.0));
        let yaw = self.anchor.yaw_to_ned(pose.yaw_rad);
        self.navigation.relocate(p.x(), p.y(), yaw, std_m, std_rad);
    }

    /// The raw gyro at a stamp, from the last two samples.
    pub(super) fn gyro_at(&self, at: Timestamp) -> Option<Vector3<f64>> {
        let (newest, g1) = self.gyro[0]?;
        let Some((older, g0)) = self.gyro[1] else {
            return Some(g1);
        };
        let span = newest.seconds_since(older);
        let age = newest.seconds_since(at);
        if age.abs() > MAX_AGE_S || span <= 0.0 {
            return None;
        }
        Some(g1 + (g0 - g1) * (age / span).clamp(0.0, 1.0))
    }

    /// The heading's change over a window corrects the gyro bias, not the yaw.
    pub(super) fn heading_increment(&mut self, a: &AttitudeSample) {
        // The window is counted at the filter's time, a few milliseconds from the heading's.
        let x = self.navigation.state();
        let to_yaw = aid::yaw::observe(x);
        let yaw_rate = to_yaw
            .row()
            .fixed_rows::<3>(ATTITUDE)
            .dot(&self.navigation.rates());
        let now = self.navigation.at();
        let heading_rad = a.heading_rad + yaw_rate * now.seconds_since(a.at);
        let Some(window) = self.heading_window else {
            self.heading_window = Some(heading_increment::Window::new(now, heading_rad));
            return;
        };
        let age_s = window.age_s(now);
        if age_s < heading_increment::WINDOW_S {
            return;
        }
        if age_s < 1.5 * heading_increment::WINDOW_S {
            let (o, measured) = window.observe(self.navigation.state(), heading_rad);
            // Two quantised headings (0.29 deg each), and the gyro's own noise over the window.
            let gyro = self.params.gyro_noise * heading_increment::WINDOW_S.sqrt();
            let std = libm::hypot(0.41_f64.to_radians(), gyro);
            self.navigation.fuse(
                Aid::HeadingIncrement,
                a.at,
                &o,
                measured,
                Quality::white(std),
            );
        }
        self.heading_window = Some(heading_increment::Window::new(now, heading_rad));
    }

    /// On the ground nothing moves, nothing turns, and the floor is a landing leg away.
    pub(super) fn stand(&mut self, at: Timestamp) {
        let landed_m = self.params.landed_height_m;
        let Some((_, gyro)) = self.gyro[0] else {
            return;
        };
        for filter in [&mut self.navigation, &mut self.odometry] {
            if !self.has_flown {
                filter.ground.reset();
            }
            let aids = [Aid::VelocityNorth, Aid::VelocityEast, Aid::VelocityDown];
            for (i, a) in aids.into_iter().enumerate() {
                let o = aid::velocity::observe(filter.state())[i];
                filter.fuse(a, at, &o, 0.0, Quality::white(0.05));
                // Motors spin up before anyone says "flying": a bias learned from that would be wrong for long.
                if gyro.norm() < 0.1 {
                    let o = aid::rate::observe(filter.state())[i];
                    filter.fuse(Aid::Rate, at, &o, gyro[i], Quality::white(0.03));
                }
            }
            let o = height::observe(filter.state(), filter.ground.height_m());
            filter.fuse(Aid::Height, at, &o, landed_m, Quality::white(0.05));
        }
    }

    /// On the floor, or a hand's breadth above it, with motors running: before lift-off and after touch-down.
    pub(super) fn is_on_floor(&self, now: Timestamp) -> bool {
        let limit_m = self.params.landed_height_m + ON_FLOOR_M;
        self.fresh.has_range(now) && self.odometry.height_m() < limit_m
    }

    /// Flow cannot see so close to the floor, and what is left, two integrals of a shaking and tilted accelerometer, runs
    /// away within seconds. Whatever touches the floor moves slowly.
    pub(super) fn linger(&mut self, at: Timestamp) {
        let q = Quality {
            std: SLIDING_STD_MPS,
            correlation_s: SLIDING_S,
            least_variance: 0.0,
        };
        for filter in [&mut self.navigation, &mut self.odometry] {
            for (i, a) in [Aid::VelocityNorth, Aid::VelocityEast]
                .into_iter()
                .enumerate()
            {
                let o = aid::velocity::observe(filter.state())[i];
                filter.fuse(a, at, &o, 0.0, q);
            }
        }
    }

    /// Without flow odometry takes navigation's velocity, if that is worth anything.
    pub(super) fn borrow_velocity(&mut self, at: Timestamp) {
        if !self.state.health.velocity && !self.state.health.position {
            return;
        }
        let turn = wrap_pi(self.odometry.state().yaw() - self.navigation.state().yaw());
        let v = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn)
            * self.navigation.state().velocity;
        for (i, a) in [Aid::VelocityNorth, Aid::VelocityEast]
            .into_iter()
            .enumerate()
        {
            let o = aid::velocity::observe(self.odometry.state())[i];
            self.odometry
                .fuse(a, at, &o, v[i], Quality::white(BORROWED_STD_MPS));
        }
    }

    /// Corrects navigation with a plan pose, carried from the scan's stamp to now with what odometry did since.
    pub(super) fn aid_with(&mut self, fix: &Fix) {
        let x = self.odometry.state();
        let odometry = Planar::from_odom(In::from_vector(x.position), x.yaw());
        let since = fix.odometry.step_to(&odometry);
        let pose = MapPose::from(Planar::from(fix.pose).then(&since));
        let at = self.navigation.at();
        self.fresh.fix = Some(fix.at);
        let floor = self.params.pose_std_m;
        let floor_yaw = self.params.pose_std_yaw_deg.to_radians();
        let std_yaw = libm::hypot(floor_yaw, fix.covariance[2][2].max(0.0).sqrt());
        let [[xx, xy, _], [_, yy, _], _] = fix.covariance;
        // The particles have gathered all that the ranges say, standing still too: the state follows them within some tenths of a
        // second, or what is wrong with flow would hold it beside them. But nothing here is surer of the place than they are.
        let correlation_s = self.params.pose_correlation_s;
        if fix.is_jump {
            let std = libm::hypot(floor, xx.max(yy).max(0.0).sqrt());
            self.go_to(&pose, std, std_yaw);
            return;
        }
        // Axes of the covariance on the plan: along what is known worst, and across.
        let long = 0.5 * libm::atan2(2.0 * xy, xx - yy);
        let mean = 0.5 * (xx + yy);
        let half = libm::hypot(0.5 * (xx - yy), xy);
        let p = self.anchor.to_ned(In::new(pose.x_m, pose.y_m, 0.0));
        for (a, angle, variance) in [
            (Aid::PoseLong, long, mean + half),
            (
                Aid::PoseCross,
                long + core::f64::consts::FRAC_PI_2,
                mean - half,
            ),
        ] {
            let heading = self.anchor.yaw_to_ned(angle);
            let d = [libm::cos(heading), libm::sin(heading)];
            let q = Quality {
                std: libm::hypot(floor, variance.max(0.0).sqrt()),
                correlation_s,
                least_variance: variance.max(0.0),
            };
            let o = aid::position::observe_along(self.navigation.state(), d);
            self.navigation
                .fuse(a, at, &o, d[0] * p.x() + d[1] * p.y(), q);
        }
        let q = Quality {
            std: std_yaw,
            correlation_s,
            least_variance: fix.covariance[2][2].max(0.0),
        };
        let o = aid::yaw::observe(self.navigation.state());
        let yaw = self.anchor.yaw_to_ned(pose.yaw_rad);
        self.navigation.fuse(Aid::PoseYaw, at, &o, yaw, q);
    }
}
