//! What the rangers make of a course: rates, latencies and faults of the simulator's sensors (measured tables there), and a
//! planar laser for comparison with the benchmark's own vehicle.

use super::course::{Course, Cylinder, cast};
use super::craft::Craft;
use super::noise::Noise;
use arrayvec::ArrayVec;
use core::time::Duration;
use std::collections::VecDeque;
use vehicle::sample::MAX_BEAMS;
use vehicle::{Beam, In, RangeScan, RangerConfig, RangerKind, RingConfig, Timestamp};

/// Beams of the laser (one a degree; the real one has four), its rate, range, noise and latency (UST-10 class).
const LASER_BEAMS: usize = 271;
const LASER_HZ: f64 = 40.0;
const LASER_MAX_M: f64 = 10.0;
const LASER_SIGMA_M: f64 = 0.01;
const LASER_LATENCY_S: f64 = 0.025;
/// Beams the laser delivers at once.
const LASER_PART: usize = 55;

/// Time of flight: from the exposure to the reading, s; share of outliers and their size as the simulator has them.
const TOF_LATENCY_S: f64 = 0.03;
const TOF_LOOK_M: f64 = 8.0;
const OUTLIER_M: f64 = 0.15;
const EDGE_UP_TO_M: f64 = 1.5;
const EDGE: [f64; 4] = [3.30, 0.62, 0.04, 0.04];
/// Up to a true depth: median, sigma, shares of short, long and no readings.
const TOF: [(f64, f64, f64, [f64; 3]); 7] = [
    (0.5, 0.006, 0.010, [0.000, 0.000, 0.004]),
    (1.0, 0.004, 0.014, [0.003, 0.002, 0.004]),
    (1.5, -0.001, 0.032, [0.073, 0.010, 0.019]),
    (2.0, 0.000, 0.023, [0.134, 0.025, 0.105]),
    (3.0, 0.007, 0.026, [0.085, 0.045, 0.119]),
    (5.0, -0.008, 0.043, [0.164, 0.007, 0.650]),
    (f64::INFINITY, 0.0, 0.05, [0.020, 0.0, 0.970]),
];
/// Sonar: noise, whole centimetres, incidence up to which there always and beyond which there never is an echo (degrees),
/// what is waited without one, sound.
const SONAR_SIGMA_M: f64 = 0.01;
const SONAR_STEP_M: f64 = 0.01;
const SONAR_INCIDENCE_DEG: (f64, f64) = (25.0, 65.0);
const SONAR_SILENCE_S: f64 = 0.038;
const SOUND_MPS: f64 = 343.0;
/// Rays that stand for a cone, each side.
const ACROSS: i32 = 6;

/// Which rangers the vehicle carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// A planar laser of 270 degrees, 10 m, 40 Hz.
    Laser270,
    /// Eight sonars of 15 degrees, 4 m, about 4 Hz each.
    Sonar8,
    /// Four time-of-flight sensors of eight columns, 45 degrees and 4 m each, 15 Hz.
    Tof32,
}

impl Sensor {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Laser270, Self::Sonar8, Self::Tof32];

    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Laser270 => "laser270",
            Self::Sonar8 => "sonar8",
            Self::Tof32 => "tof32",
        }
    }

    fn config(self) -> Vec<RangerConfig> {
        let built_in = |name| RingConfig::built_in(name).map_or_else(|_| Vec::new(), |r| r.rangers);
        match self {
            Self::Laser270 => Vec::new(),
            Self::Sonar8 => built_in("sonar8"),
            Self::Tof32 => built_in("tof32"),
        }
    }
}

/// The rangers with their schedules and what is on its way from them.
#[derive(Clone, Debug)]
pub(super) struct Ring {
    rangers: Vec<(RangerConfig, u64)>,
    laser_firings: u64,
    is_laser: bool,
    noise: Noise,
    start: Option<Timestamp>,
    under_way: VecDeque<(Timestamp, RangeScan)>,
    delivered: Vec<RangeScan>,
    near: Vec<Cylinder>,
}

impl Ring {
    pub(super) fn new(sensor: Sensor, seed: u64) -> Self {
        Self {
            rangers: sensor.config().into_iter().map(|c| (c, 0)).collect(),
            laser_firings: 0,
            is_laser: sensor == Sensor::Laser270,
            noise: Noise::new(seed),
            start: None,
            under_way: VecDeque::new(),
            delivered: Vec::new(),
            near: Vec::new(),
        }
    }

    /// Fires what is due and hands over what has arrived.
    pub(super) fn scans(&mut self, course: &Course, craft: &Craft, now: Timestamp) -> &[RangeScan] {
        let start = *self.start.get_or_insert(now);
        let elapsed_s = now.seconds_since(start) + 1e-9;
        if self.is_laser && elapsed_s * LASER_HZ >= self.laser_firings as f64 {
            self.laser_firings += 1;
            self.fire_laser(course, craft, now);
        }
        let mut rangers = core::mem::take(&mut self.rangers);
        for (config, firings) in &mut rangers {
            if elapsed_s * config.rate_hz >= *firings as f64 + config.phase {
                *firings += 1;
                self.fire(config, course, craft, now);
            }
        }
        self.rangers = rangers;
        self.delivered.clear();
        while let Some(i) = self.under_way.iter().position(|(due, _)| *due <= now) {
            self.delivered
                .extend(self.under_way.remove(i).map(|(_, scan)| scan));
        }
        &self.delivered
    }

    fn deliver(&mut self, now: Timestamp, latency_s: f64, beams: ArrayVec<Beam, MAX_BEAMS>) {
        let due = now + Duration::from_secs_f64(latency_s);
        self.under_way
            .push_back((due, RangeScan { at: now, beams }));
    }

    fn fire_laser(&mut self, course: &Course, craft: &Craft, now: Timestamp) {
        course.near(craft.place(), LASER_MAX_M, &mut self.near);
        let mut beams = ArrayVec::new();
        for k in 0..LASER_BEAMS {
            let bearing_rad = (k as f64 - 0.5 * (LASER_BEAMS - 1) as f64).to_radians();
            let hit = cast(&self.near, craft.place(), craft.yaw_rad() - bearing_rad);
            let error_m = self.noise.gauss(LASER_SIGMA_M);
            let read_m = hit.map(|h| (h.distance_m + error_m).max(0.02));
            beams.push(Beam {
                origin: In::zero(),
                bearing_rad,
                elevation_rad: 0.0,
                half_cone_rad: 0.5_f64.to_radians(),
                distance_m: read_m.filter(|d| *d <= LASER_MAX_M),
                min_m: 0.02,
                max_m: LASER_MAX_M,
            });
            if beams.len() == LASER_PART || k + 1 == LASER_BEAMS {
                self.deliver(now, LASER_LATENCY_S, core::mem::take(&mut beams));
            }
        }
    }

    fn fire(&mut self, config: &RangerConfig, course: &Course, craft: &Craft, now: Timestamp) {
        let (s, c) = libm::sincos(craft.yaw_rad());
        let [forward, right, _] = config.offset_m;
        let [x, y] = craft.place();
        let eye = [x + c * forward + s * right, y + s * forward - c * right];
        course.near(eye, TOF_LOOK_M, &mut self.near);
        let mut readings = ArrayVec::<Option<f64>, MAX_BEAMS>::new();
        let latency_s = match config.kind {
            RangerKind::Tof => {
                for column in 0..usize::from(config.columns) {
                    readings.push(self.tof_column(config, column, eye, craft.yaw_rad()));
                }
                TOF_LATENCY_S
            }
            RangerKind::Laser => {
                for column in 0..usize::from(config.columns) {
                    readings.push(self.laser_column(config, column, eye, craft.yaw_rad()));
                }
                LASER_LATENCY_S
            }
            RangerKind::Sonar => {
                let (reading, latency_s) = self.sonar(config, eye, craft.yaw_rad());
                readings.push(reading);
                latency_s
            }
        };
        // As drivers deliver it: millimetres.
        let reading = vehicle::RangerReading {
            at: now,
            ranger: 0,
            columns_mm: readings
                .iter()
                .map(|m| {
                    m.filter(|m| (config.min_m..=config.max_m).contains(m))
                        .map(|m| libm::round(m * 1e3) as u16)
                })
                .collect(),
        };
        let beams = config.beams(&reading).into_iter().collect();
        self.deliver(now, latency_s, beams);
    }

    /// Depth along the sensor's axis that one column reads, m.
    fn tof_column(
        &mut self,
        config: &RangerConfig,
        column: usize,
        eye: [f64; 2],
        yaw_rad: f64,
    ) -> Option<f64> {
        let hit = cast(&self.near, eye, yaw_rad - config.column_bearing_rad(column));
        let along = libm::cos(config.column_angle_rad(column));
        let depth_m = hit
            .filter(|h| h.distance_m <= TOF_LOOK_M)
            .map_or(f64::INFINITY, |h| h.distance_m * along);
        let row = TOF.iter().find(|row| depth_m <= row.0)?;
        let (median_m, sigma_m, [short, long, none]) = (row.1, row.2, row.3);
        let from_edge = column.min(usize::from(config.columns) - 1 - column).min(3);
        let edge = if depth_m < EDGE_UP_TO_M {
            EDGE[from_edge]
        } else {
            1.0
        };
        let (fate, size) = (self.noise.unit(), self.noise.unit());
        let error_m = median_m + self.noise.gauss(sigma_m);
        if fate < none {
            None
        } else if fate < none + short * edge {
            let reach_m = depth_m.min(5.0);
            Some((reach_m - OUTLIER_M - size * 0.5 * reach_m).max(0.03))
        } else if fate < none + short * edge + long {
            Some(depth_m + OUTLIER_M + size * 0.8)
        } else {
            Some(depth_m + error_m).filter(|d| d.is_finite())
        }
    }

    /// Length along one ray of a turning laser, m.
    fn laser_column(
        &mut self,
        config: &RangerConfig,
        column: usize,
        eye: [f64; 2],
        yaw_rad: f64,
    ) -> Option<f64> {
        let hit = cast(&self.near, eye, yaw_rad - config.column_bearing_rad(column))?;
        let read_m = hit.distance_m + self.noise.gauss(LASER_SIGMA_M);
        (config.min_m..=config.max_m)
            .contains(&read_m)
            .then_some(read_m)
    }

    /// The nearest echo of a cone, m, and when it is told.
    fn sonar(&mut self, config: &RangerConfig, eye: [f64; 2], yaw_rad: f64) -> (Option<f64>, f64) {
        let (always, never) = SONAR_INCIDENCE_DEG;
        let least_cos = libm::cos(self.noise.between(always, never).to_radians());
        let error_m = self.noise.gauss(SONAR_SIGMA_M);
        let half_rad = config.half_cone_deg.to_radians();
        let echo_m = (-ACROSS..=ACROSS)
            .filter_map(|k| {
                let aside = half_rad * f64::from(k) / f64::from(ACROSS);
                cast(
                    &self.near,
                    eye,
                    yaw_rad - config.bearing_deg.to_radians() - aside,
                )
            })
            .filter(|h| h.incidence_cos >= least_cos && h.distance_m <= config.max_m)
            .map(|h| h.distance_m)
            .min_by(f64::total_cmp);
        let reading_m = echo_m.map(|m| libm::round((m + error_m) / SONAR_STEP_M) * SONAR_STEP_M);
        (
            reading_m,
            echo_m.map_or(SONAR_SILENCE_S, |m| 2.0 * m / SOUND_MPS),
        )
    }
}
