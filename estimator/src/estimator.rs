//! The estimator: sensor samples in, [`NavState`] out.

mod aiding;
mod external;
mod lifecycle;

use crate::diagnostics::Diagnostics;
use crate::freshness::Freshness;
use crate::kalman::aid::{self, baro, heading_increment, height};
use crate::kalman::{Aid, Filter, Nominal, POSITION, ProcessNoise, Quality};
use crate::mcl::beams::{Stance, level};
use crate::mcl::particles::Particles;
use crate::mcl::{Localizer, Planar, SearchRequest, SearchResult};
use crate::params::EstimatorParams;
use crate::trail::{Footprint, Trail};
use nalgebra::{UnitQuaternion, Vector3};
use std::sync::Arc;
use vehicle::{
    AttitudeSample, BaroSample, DownRange, FloorPlan, FlowSample, Frd, ImuSample, In, MapAnchor,
    MapPose, NavState, Odom, RangeScan, Rot, Timestamp,
};

/// An attitude this much older or newer than the filter is turned with the rates, s; beyond, it is refused.
const MAX_AGE_S: f64 = 0.15;
/// Roll and pitch samples share their error for this long, s: the controller's filter is smooth.
const ATTITUDE_CORRELATION_S: f64 = 0.1;
/// The controller's heading likewise: its quantisation stays while the vehicle does not turn.
const HEADING_CORRELATION_S: f64 = 0.1;
/// Doubt of the position when the place on the plan is not known, m.
const UNKNOWN_POSITION_M: f64 = 10.0;
/// Pseudo-measurements (standing, borrowed velocity) come at this spacing, s.
const PSEUDO_S: f64 = 0.05;
/// Particles trust borrowed odometry less (algorithms note 2: 0.08 -> 0.2 per metre).
const BORROWED_NOISE: f64 = 2.0;
/// Below this height propellers blow under the barometer, m.
const GROUND_EFFECT_M: f64 = 0.5;

/// Odometry that no map ever corrected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryPose {
    /// When it is true.
    pub at: Timestamp,
    /// m from where odometry began.
    pub position: In<Odom>,
    /// m/s.
    pub velocity: In<Odom>,
    /// Attitude against odometry's own heading.
    pub attitude: Rot<Frd, Odom>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum StartPlace {
    Unknown,
    At {
        pose: MapPose,
        std_m: f64,
        std_rad: f64,
    },
}

/// Fuses everything the vehicle senses into one state.
///
/// Two filters of the same kind run side by side. *Odometry* sees the flight controller's attitude and heading, height
/// and flow, never the map; its steps move the particles, so localization never moves on what it corrects. *Navigation*
/// sees all of that except the heading's value, and the plan pose that the particles find.
///
/// Feed samples as they come, in any order; call [`Estimator::update`] once per tick, then run what
/// [`Estimator::poll_job`] hands out, outside the loop, and bring the answer to [`Estimator::search_done`]. When inputs
/// stop, the state stays finite and [`NavState::health`] says what can no longer be flown on.
#[derive(Clone, Debug)]
pub struct Estimator {
    params: EstimatorParams,
    anchor: MapAnchor,
    navigation: Filter,
    odometry: Filter,
    locator: Option<Localizer>,
    trail: Trail,
    baro_offsets: [baro::Offset; 2],
    heading_window: Option<heading_increment::Window>,
    gyro: [Option<(Timestamp, Vector3<f64>)>; 2],
    first_imu: Option<Timestamp>,
    pseudo_at: Timestamp,
    external: external::Last,
    fresh: Freshness,
    start: StartPlace,
    is_landed: bool,
    has_flown: bool,
    state: NavState,
    diagnostics: Diagnostics,
}

impl Estimator {
    /// An estimator for one flight. Without a plan there is no localization; everything is allocated here.
    #[must_use]
    pub fn new(
        params: EstimatorParams,
        plan: Option<Arc<FloorPlan>>,
        anchor: MapAnchor,
        seed: u64,
    ) -> Self {
        let noise = ProcessNoise {
            accel: params.accel_noise,
            gyro: params.gyro_noise,
            accel_bias: params.accel_bias_walk,
            gyro_bias: params.gyro_bias_walk,
        };
        let locator = plan.map(|plan| Localizer::new(&params, &plan, seed));
        Self {
            params,
            anchor,
            navigation: Filter::new(noise),
            odometry: Filter::new(noise),
            locator,
            trail: Trail::default(),
            baro_offsets: [baro::Offset::default(); 2],
            heading_window: None,
            gyro: [None; 2],
            first_imu: None,
            pseudo_at: Timestamp::ZERO,
            external: external::Last::default(),
            fresh: Freshness::default(),
            start: StartPlace::Unknown,
            is_landed: false,
            has_flown: false,
            state: NavState::default(),
            diagnostics: Diagnostics::default(),
        }
    }

    /// The vehicle is at this pose of the plan, to within these standard deviations. Navigation goes there at once;
    /// localization confirms it with the ranges.
    pub fn start_at(&mut self, now: Timestamp, pose: MapPose, std_xy_m: f64, std_yaw_rad: f64) {
        let std_m = std_xy_m.max(0.01);
        let std_rad = std_yaw_rad.max(0.01);
        self.start = StartPlace::At {
            pose,
            std_m,
            std_rad,
        };
        if let Some(locator) = &mut self.locator {
            locator.start_at(pose, std_m, std_rad);
        }
        if self.navigation.is_running() {
            self.go_to(&pose, std_m, std_rad);
        }
        self.publish(now);
    }

    /// The vehicle may be anywhere on the plan.
    pub fn start_unknown(&mut self, now: Timestamp) {
        self.start = StartPlace::Unknown;
        if let Some(locator) = &mut self.locator {
            locator.start_unknown();
            let here = *self.navigation.state();
            let yaw_std = self.navigation.yaw_std_rad();
            if self.navigation.is_running() {
                let (north, east) = (here.position.x, here.position.y);
                self.navigation
                    .relocate(north, east, here.yaw(), UNKNOWN_POSITION_M, yaw_std);
            }
        }
        self.publish(now);
    }

    /// An inertial sample: moves both filters.
    pub fn imu(&mut self, imu: &ImuSample) {
        if !self.navigation.is_running() {
            self.wait_for_attitude(imu);
            return;
        }
        let before = self.navigation.at();
        if !self.navigation.predict(imu) {
            self.diagnostics.refused_samples += 1;
            return;
        }
        self.odometry.predict(imu);
        self.fresh.imu = Some(imu.at);
        let dt = imu.at.seconds_since(before);
        let gyro = *imu.gyro_radps.vector();
        let mean = self.gyro[0].map_or(gyro, |(_, last)| (last + gyro) * 0.5);
        self.gyro = [Some((imu.at, gyro)), self.gyro[0]];
        if let Some(window) = &mut self.heading_window {
            window.integrate(self.navigation.state(), &mean, dt);
        }
        if imu.at.seconds_since(self.pseudo_at) >= PSEUDO_S {
            self.pseudo_at = imu.at;
            if self.is_landed {
                self.stand(imu.at);
            } else if !self.fresh.has_flow(imu.at) {
                if self.is_on_floor(imu.at) {
                    self.linger(imu.at);
                } else {
                    self.borrow_velocity(imu.at);
                }
            }
        }
        let x = self.odometry.state();
        let (roll_rad, pitch_rad, yaw) = x.roll_pitch_yaw();
        self.trail.push(Footprint {
            at: imu.at,
            pose: Planar::from_odom(In::from_vector(x.position), yaw),
            roll_rad,
            pitch_rad,
            height_m: self.odometry.height_m(),
        });
        self.publish(imu.at);
    }

    /// Attitude as the flight controller has it.
    pub fn attitude(&mut self, attitude: &AttitudeSample) {
        let a = attitude;
        if ![a.roll_rad, a.pitch_rad, a.heading_rad]
            .iter()
            .all(|v| v.is_finite())
        {
            self.diagnostics.refused_samples += 1;
            return;
        }
        self.fresh.attitude = Some(a.at);
        if !self.navigation.is_running() {
            self.start_filters(a.at, a.roll_rad, a.pitch_rad, a.heading_rad);
            return;
        }
        let q = Quality {
            std: self.params.attitude_std_deg.to_radians(),
            correlation_s: ATTITUDE_CORRELATION_S,
            least_variance: 0.0,
        };
        for filter in [&mut self.navigation, &mut self.odometry] {
            let Some(x) = turned_to(filter, a.at) else {
                self.diagnostics.refused_samples += 1;
                return;
            };
            if let Some(o) = aid::attitude::roll(&x) {
                filter.fuse(Aid::Roll, a.at, &o, a.roll_rad, q);
            }
            if let Some(x) = turned_to(filter, a.at)
                && let Some(o) = aid::attitude::pitch(&x)
            {
                filter.fuse(Aid::Pitch, a.at, &o, a.pitch_rad, q);
            }
        }
        let heading = Quality {
            std: self.params.heading_std_deg.to_radians(),
            correlation_s: HEADING_CORRELATION_S,
            least_variance: 0.0,
        };
        if let Some(x) = turned_to(&self.odometry, a.at) {
            let o = aid::yaw::observe(&x);
            self.odometry
                .fuse(Aid::Heading, a.at, &o, a.heading_rad, heading);
        }
        self.heading_increment(a);
    }

    /// Barometric altitude: holds the height when the down-range is silent.
    pub fn baro(&mut self, baro: &BaroSample) {
        if !baro.altitude_m.is_finite() || !self.navigation.is_running() {
            self.diagnostics.refused_samples += u32::from(!baro.altitude_m.is_finite());
            return;
        }
        self.fresh.baro = Some(baro.at);
        if self.navigation.is_elsewhere(baro.at) {
            return;
        }
        let has_better = self.fresh.has_range(baro.at) || self.is_landed;
        for (filter, offset) in [&mut self.navigation, &mut self.odometry]
            .into_iter()
            .zip(&mut self.baro_offsets)
        {
            let height_m = -filter.state().position.z;
            let Some(offset_m) = offset.value_m().filter(|_| !has_better) else {
                offset.follow(baro.at, baro.altitude_m, height_m);
                continue;
            };
            let near_ground = if filter.height_m() < GROUND_EFFECT_M {
                4.0
            } else {
                1.0
            };
            let std = libm::hypot(
                self.params.baro_std_m * near_ground,
                offset.doubt_m(baro.at),
            );
            let o = baro::observe(filter.state(), offset_m);
            // Pressure noise of a room (doors, propellers) lasts for some tenths of a second.
            let q = Quality {
                std,
                correlation_s: 0.2,
                least_variance: 0.0,
            };
            filter.fuse(Aid::Baro, baro.at, &o, baro.altitude_m, q);
        }
    }

    /// Distance to the floor along body down.
    pub fn down_range(&mut self, range: &DownRange) {
        let Some(d) = range.distance_m else {
            return;
        };
        if !(d.is_finite() && d > 0.0 && self.navigation.is_running()) {
            self.diagnostics.refused_samples += 1;
            return;
        }
        if self.navigation.is_elsewhere(range.at) {
            self.fresh.down_range = Some(range.at);
            return;
        }
        let std = libm::hypot(self.params.range_std_m, self.params.range_std_per_m * d);
        for filter in [&mut self.navigation, &mut self.odometry] {
            let cos_tilt = filter.state().cos_tilt();
            if cos_tilt < height::MIN_COS_TILT {
                return;
            }
            let doubt = libm::hypot(filter.std_of(POSITION).z(), std);
            let above_home_m = -filter.state().position.z;
            if filter
                .ground
                .is_same_surface(range.at, above_home_m, d * cos_tilt, doubt)
            {
                let o = height::observe(filter.state(), filter.ground.height_m());
                filter.fuse(Aid::Height, range.at, &o, d, Quality::white(std));
            }
        }
        self.fresh.down_range = Some(range.at);
    }

    /// Optical flow.
    pub fn flow(&mut self, flow: &FlowSample) {
        if !(flow.x_radps.is_finite() && flow.y_radps.is_finite()) {
            self.diagnostics.refused_samples += 1;
            return;
        }
        let is_poor = i32::from(flow.quality) < self.params.flow_quality_min.max(1);
        if is_poor || self.is_landed || !self.navigation.is_running() {
            return;
        }
        let Some(gyro) = self.gyro_at(flow.at) else {
            return;
        };
        let std = self.params.flow_std_radps * (1.0 + f64::from(255 - flow.quality) / 128.0);
        let q = Quality::white(std);
        let mut is_used = false;
        for filter in [&mut self.navigation, &mut self.odometry] {
            let ground_m = filter.ground.height_m();
            if let Some([x, _]) = aid::flow::observe(filter.state(), &gyro, ground_m) {
                is_used |= filter.fuse(Aid::FlowX, flow.at, &x, flow.x_radps, q);
            }
            if let Some([_, y]) = aid::flow::observe(filter.state(), &gyro, ground_m) {
                is_used |= filter.fuse(Aid::FlowY, flow.at, &y, flow.y_radps, q);
            }
        }
        if is_used {
            self.fresh.flow = Some(flow.at);
        }
    }

    /// A scan, or a single reading of a ring that fires in turn. It may be late by up to a second.
    pub fn scan(&mut self, scan: &RangeScan) {
        let Some(locator) = &mut self.locator else {
            return;
        };
        self.diagnostics.scans += 1;
        let Some(then) = self.trail.at(scan.at) else {
            self.diagnostics.unused_scans += 1;
            return;
        };
        let beams = level(
            scan,
            &Stance {
                roll_rad: then.roll_rad,
                pitch_rad: then.pitch_rad,
                height_m: then.height_m,
                wall_height_m: self.params.wall_height_m,
            },
        );
        self.diagnostics.unused_scans += u32::from(beams.is_empty());
        self.diagnostics.beams += beams.len() as u32;
        locator.add(scan.at, &then.pose, &beams);
    }

    /// Tells that the vehicle stands on the ground with its motors off (true), or may fly (false).
    pub fn set_landed(&mut self, is_landed: bool) {
        self.is_landed = is_landed;
        self.has_flown |= !is_landed;
    }

    /// Time passes: particles, localization, health. Call once per tick after the samples.
    pub fn update(&mut self, now: Timestamp) {
        let noise_scale = if self.fresh.has_flow(now) || self.is_landed {
            1.0
        } else {
            BORROWED_NOISE
        };
        let fix = self
            .locator
            .as_mut()
            .and_then(|l| l.update(now, noise_scale));
        if let Some(fix) = fix {
            self.aid_with(&fix);
        }
        self.publish(now);
    }

    /// The state, true at the last inertial sample.
    #[must_use]
    pub const fn state(&self) -> &NavState {
        &self.state
    }

    /// Odometry that no map ever corrected.
    #[must_use]
    pub fn odometry(&self) -> OdometryPose {
        let x = self.odometry.state();
        OdometryPose {
            at: self.odometry.at(),
            position: In::from_vector(x.position),
            velocity: In::from_vector(x.velocity),
            attitude: Rot::from_quaternion(x.attitude),
        }
    }

    /// The particles, for drawing; none without a plan.
    #[must_use]
    pub fn particles(&self) -> Option<&Particles> {
        self.locator.as_ref().map(Localizer::particles)
    }

    /// A search to run outside the loop with [`search`](crate::mcl::search()), if one is wanted.
    pub fn poll_job(&mut self) -> Option<SearchRequest> {
        self.locator.as_mut()?.poll_job()
    }

    /// The answer of a search.
    pub fn search_done(&mut self, result: &SearchResult) {
        if let Some(locator) = &mut self.locator {
            self.diagnostics.searches += 1;
            locator.search_done(result);
        }
    }

    /// What was seen and refused.
    #[must_use]
    pub fn diagnostics(&self) -> Diagnostics {
        let mut d = self.diagnostics;
        d.read(&self.navigation, &self.odometry);
        d
    }

    /// The navigation filter, for tests of consistency.
    #[must_use]
    pub const fn navigation(&self) -> &Filter {
        &self.navigation
    }

    /// How the plan lies in the world.
    #[must_use]
    pub const fn anchor(&self) -> &MapAnchor {
        &self.anchor
    }
}

/// The filter's state with the attitude turned to a stamp near its own time; none if the stamp is too far off.
fn turned_to(filter: &Filter, at: Timestamp) -> Option<Nominal> {
    let dt = at.seconds_since(filter.at());
    if dt.abs() > MAX_AGE_S {
        return None;
    }
    let mut x = *filter.state();
    x.attitude *= UnitQuaternion::from_scaled_axis(filter.rates() * dt);
    Some(x)
}
