//! A synthetic flight: analytic motion, sensors with the faults of the real ones, ranges cast against wall segments.
//!
//! Nothing here uses the code under test: ranges come from segments while the estimator reads a raster.

use estimator::Estimator;
use estimator::mcl::random::Random;
use estimator::mcl::search;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::time::Duration;
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::floor_plan::Cell;
use vehicle::{
    AttitudeSample, BaroSample, DownRange, FloorPlan, FlowSample, ImuSample, In, Map, MapAnchor,
    MapPose, RangeScan, RangerKind, RangerReading, RingConfig, Segment, Timestamp,
};

/// Walls, and the raster the estimator gets.
pub struct World {
    pub walls: Vec<Segment>,
    pub plan: FloorPlan,
    pub anchor: MapAnchor,
}

impl World {
    pub fn new(
        width_m: f64,
        height_m: f64,
        mut walls: Vec<Segment>,
        inside: [f64; 2],
        anchor: MapAnchor,
    ) -> Self {
        let w = |x0: f64, y0: f64, x1: f64, y1: f64| Segment {
            a: [x0, y0],
            b: [x1, y1],
        };
        walls.extend([
            w(0.0, 0.0, width_m, 0.0),
            w(width_m, 0.0, width_m, height_m),
            w(width_m, height_m, 0.0, height_m),
            w(0.0, height_m, 0.0, 0.0),
        ]);
        let cell = 0.05;
        let margin = 0.2;
        let columns = ((width_m + 2.0 * margin) / cell).round() as usize;
        let rows = ((height_m + 2.0 * margin) / cell).round() as usize;
        let origin = [-margin - 0.025, -margin - 0.025];
        let mut cells = vec![Cell::Unknown; columns * rows];
        for (i, c) in cells.iter_mut().enumerate() {
            let x = origin[0] + ((i % columns) as f64 + 0.5) * cell;
            let y = origin[1] + ((i / columns) as f64 + 0.5) * cell;
            if x > 0.0 && x < width_m && y > 0.0 && y < height_m {
                *c = Cell::Free;
            }
        }
        for s in &walls {
            let n = ((s.b[0] - s.a[0]).hypot(s.b[1] - s.a[1]) / 0.01)
                .ceil()
                .max(1.0);
            for k in 0..=n as usize {
                let f = k as f64 / n;
                let x = s.a[0] + f * (s.b[0] - s.a[0]);
                let y = s.a[1] + f * (s.b[1] - s.a[1]);
                let (c, r) = ((x - origin[0]) / cell, (y - origin[1]) / cell);
                if c >= 0.0 && r >= 0.0 && (c as usize) < columns && (r as usize) < rows {
                    cells[r as usize * columns + c as usize] = Cell::Occupied;
                }
            }
        }
        // Only what can be reached from inside is floor: nobody flies inside a shelf.
        let mut reached = vec![false; cells.len()];
        let first = ((inside[1] - origin[1]) / cell) as usize * columns
            + ((inside[0] - origin[0]) / cell) as usize;
        let mut open = vec![first];
        while let Some(i) = open.pop() {
            if cells[i] == Cell::Free && !reached[i] {
                reached[i] = true;
                open.extend([i - 1, i + 1, i - columns, i + columns]);
            }
        }
        for (c, r) in cells.iter_mut().zip(reached) {
            if *c == Cell::Free && !r {
                *c = Cell::Unknown;
            }
        }
        let plan = FloorPlan::from_cells(columns, cell, origin, cells).unwrap();
        Self {
            walls,
            plan,
            anchor,
        }
    }

    /// 12 x 9 m: six distinct rooms around a corridor, doors, furniture.
    pub fn office() -> Self {
        let mut walls = Vec::new();
        let mut line = |x0: f64, y0: f64, x1: f64, y1: f64| {
            walls.push(Segment {
                a: [x0, y0],
                b: [x1, y1],
            });
        };
        // Corridor between y = 4 and y = 5.6 with doors of 0.9 m.
        for (y, doors) in [(4.0, [1.2, 5.4, 9.8]), (5.6, [2.6, 6.9, 10.4])] {
            let mut x = 0.0;
            for d in doors {
                line(x, y, d, y);
                x = d + 0.9;
            }
            line(x, y, 12.0, y);
        }
        // Rooms of different widths.
        line(3.6, 0.0, 3.6, 4.0);
        line(7.9, 0.0, 7.9, 4.0);
        line(4.4, 5.6, 4.4, 9.0);
        line(9.2, 5.6, 9.2, 7.9);
        let mut block = |x: f64, y: f64, w: f64, h: f64| {
            line(x, y, x + w, y);
            line(x + w, y, x + w, y + h);
            line(x + w, y + h, x, y + h);
            line(x, y + h, x, y);
        };
        // Desks, shelves, a pillar.
        block(0.0, 0.0, 0.6, 1.8);
        block(2.2, 2.6, 0.8, 0.5);
        block(5.0, 1.0, 1.4, 0.8);
        block(8.4, 0.0, 2.0, 0.5);
        block(11.2, 2.2, 0.8, 1.8);
        block(0.9, 7.4, 1.2, 1.2);
        block(5.6, 8.4, 2.4, 0.6);
        block(7.2, 6.4, 0.3, 0.3);
        block(10.2, 8.0, 1.8, 1.0);
        Self::new(12.0, 9.0, walls, [6.0, 4.8], MapAnchor::new(2.0, 3.0, 1.1))
    }

    /// 6 x 5 m room with a bay, for tracking tests.
    pub fn room() -> Self {
        let line = |x0: f64, y0: f64, x1: f64, y1: f64| Segment {
            a: [x0, y0],
            b: [x1, y1],
        };
        Self::new(
            6.0,
            5.0,
            vec![
                line(4.5, 0.0, 4.5, 1.2),
                line(4.5, 1.2, 6.0, 1.2),
                line(0.0, 4.2, 1.5, 4.2),
                line(1.5, 4.2, 1.5, 5.0),
            ],
            [3.0, 2.5],
            MapAnchor::new(3.0, 2.5, 0.4),
        )
    }

    /// Distance along a ray on the plan, m.
    pub fn cast(&self, from: [f64; 2], direction: [f64; 2]) -> Option<f64> {
        self.walls
            .iter()
            .filter_map(|s| {
                let e = [s.b[0] - s.a[0], s.b[1] - s.a[1]];
                let det = direction[0] * -e[1] + direction[1] * e[0];
                if det.abs() < 1e-12 {
                    return None;
                }
                let r = [s.a[0] - from[0], s.a[1] - from[1]];
                let t = (r[0] * -e[1] + r[1] * e[0]) / det;
                let k = (direction[0] * r[1] - direction[1] * r[0]) / det;
                (t > 0.0 && (0.0..=1.0).contains(&k)).then_some(t)
            })
            .min_by(f64::total_cmp)
    }

    /// Distance to the nearest wall, m.
    pub fn clearance(&self, p: [f64; 2]) -> f64 {
        (0..72)
            .filter_map(|k| {
                let a = f64::from(k) * 5f64.to_radians();
                self.cast(p, [a.cos(), a.sin()])
            })
            .fold(f64::INFINITY, f64::min)
    }
}

/// Position (NED, m) and heading (rad) at a time (s).
pub type Path<'a> = &'a dyn Fn(f64) -> (Vector3<f64>, f64);

/// True state at a time.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    pub acceleration: Vector3<f64>,
    /// FRD to NED.
    pub rotation: Matrix3<f64>,
    pub rates: Vector3<f64>,
}

impl Truth {
    /// A multirotor flying a path: thrust along body up, attitude by differential flatness, derivatives by differences.
    pub fn of(path: Path<'_>, t: f64) -> Self {
        let h = 1e-3;
        let p = |t: f64| path(t).0;
        let rotation = |t: f64| {
            let a = (p(t + h) - p(t) * 2.0 + p(t - h)) / (h * h);
            let down = -(a - Vector3::new(0.0, 0.0, GRAVITY_MPS2)).normalize();
            let yaw = path(t).1;
            let ahead = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
            let right = down.cross(&ahead).normalize();
            Matrix3::from_columns(&[right.cross(&down), right, down])
        };
        let r = rotation(t);
        let (r0, r1) = (rotation(t - h), rotation(t + h));
        let turn = Rotation3::from_matrix_unchecked(r0.transpose() * r1).scaled_axis();
        Self {
            position: p(t),
            velocity: (p(t + h) - p(t - h)) / (2.0 * h),
            acceleration: (p(t + h) - p(t) * 2.0 + p(t - h)) / (h * h),
            rotation: r,
            rates: turn / (2.0 * h),
        }
    }

    pub fn roll_pitch_yaw(&self) -> (f64, f64, f64) {
        Rotation3::from_matrix_unchecked(self.rotation).euler_angles()
    }

    pub fn map_pose(&self, anchor: &MapAnchor) -> MapPose {
        anchor.pose_to_map(In::from_vector(self.position), self.roll_pitch_yaw().2)
    }
}

/// Which sensors work, and how badly.
#[derive(Clone, Debug)]
pub struct Senses {
    pub ring: RingConfig,
    pub has_flow: bool,
    pub has_range: bool,
    pub has_scan: bool,
    /// Share of returns that come from nowhere: half of the way short, or up to a metre long one time in four.
    pub false_returns: f64,
    /// Scans come this late, ms.
    pub scan_delay_ms: u64,
    /// Inertial samples are this many ms apart, plus up to as many us of jitter as given.
    pub imu_ms: u64,
    pub imu_jitter_us: u64,
    /// Nothing at all comes between these times, s.
    pub gap_s: Option<(f64, f64)>,
    /// The distances to the floor measured in the gap have waited, and come right after it.
    pub has_backlog: bool,
    /// Height of what stands under the vehicle at a plan point, m.
    pub floor_m: fn([f64; 2]) -> f64,
}

impl Senses {
    pub fn good(ring: &str) -> Self {
        Self {
            ring: RingConfig::built_in(ring).unwrap(),
            has_flow: true,
            has_range: true,
            has_scan: true,
            false_returns: 0.0,
            scan_delay_ms: 40,
            imu_ms: 25,
            imu_jitter_us: 2_000,
            gap_s: None,
            has_backlog: false,
            floor_m: |_| 0.0,
        }
    }
}

/// One word of one sensor.
#[derive(Clone, Debug)]
pub enum Sample {
    Imu(ImuSample),
    Attitude(AttitudeSample),
    Baro(BaroSample),
    DownRange(DownRange),
    Flow(FlowSample),
    Scan(Box<RangeScan>),
}

impl Sample {
    pub fn feed(&self, estimator: &mut Estimator) {
        match self {
            Self::Imu(s) => estimator.imu(s),
            Self::Attitude(s) => estimator.attitude(s),
            Self::Baro(s) => estimator.baro(s),
            Self::DownRange(s) => estimator.down_range(s),
            Self::Flow(s) => estimator.flow(s),
            Self::Scan(s) => estimator.scan(s),
        }
    }
}

/// Flies an estimator along a path. `each` sees every tick after the update.
pub struct Simulation<'a> {
    pub world: &'a World,
    pub path: Path<'a>,
    pub senses: Senses,
    pub random: Random,
    pub now: Timestamp,
    late: Vec<(Timestamp, RangeScan)>,
    fired: Vec<Timestamp>,
    heading_zero: f64,
    gyro_bias: Vector3<f64>,
    accel_bias: Vector3<f64>,
    next_imu: Timestamp,
}

impl<'a> Simulation<'a> {
    pub fn new(world: &'a World, path: Path<'a>, senses: Senses, seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0xABCD);
        let mut g = |s: f64| f64::from(random.gaussian()) * s;
        let gyro_bias = Vector3::new(g(0.005), g(0.005), g(0.005));
        let accel_bias = Vector3::new(g(0.1), g(0.1), g(0.1));
        let heading_zero = g(1.0);
        let rangers = senses.ring.rangers.len();
        Self {
            world,
            path,
            senses,
            random,
            now: Timestamp::ZERO,
            late: Vec::new(),
            fired: vec![Timestamp::ZERO; rangers],
            heading_zero,
            gyro_bias,
            accel_bias,
            next_imu: Timestamp::ZERO,
        }
    }

    fn gauss(&mut self, std: f64) -> f64 {
        f64::from(self.random.gaussian()) * std
    }

    fn gauss3(&mut self, std: f64) -> Vector3<f64> {
        Vector3::new(self.gauss(std), self.gauss(std), self.gauss(std))
    }

    /// Truth now.
    pub fn truth(&self) -> Truth {
        Truth::of(self.path, self.now.s())
    }

    /// Flies on for some seconds in ticks of 5 ms.
    pub fn fly(
        &mut self,
        estimator: &mut Estimator,
        seconds: f64,
        mut each: impl FnMut(&Truth, &mut Estimator),
    ) {
        let end = self.now + Duration::from_secs_f64(seconds);
        let mut waited = Vec::new();
        while self.now < end {
            self.now += Duration::from_millis(5);
            let t = self.now.s();
            let truth = self.truth();
            if self.senses.gap_s.is_some_and(|(a, b)| t > a && t < b) {
                if self.senses.has_backlog {
                    let samples = self.sense(&truth).into_iter();
                    waited.extend(samples.filter(|s| matches!(s, Sample::DownRange(_))));
                }
                continue;
            }
            let samples = self.sense(&truth);
            let is_moved = samples.iter().any(|s| matches!(s, Sample::Imu(_)));
            for sample in samples {
                sample.feed(estimator);
            }
            if is_moved {
                for sample in waited.drain(..) {
                    sample.feed(estimator);
                }
            }
            estimator.update(self.now);
            if let Some(job) = estimator.poll_job() {
                estimator.search_done(&search(&job));
            }
            each(&truth, estimator);
        }
    }

    /// What the sensors say in the next seconds, tick by tick, for feeding it again and again.
    pub fn record(&mut self, seconds: f64) -> Vec<(Timestamp, Vec<Sample>)> {
        let end = self.now + Duration::from_secs_f64(seconds);
        let mut out = Vec::new();
        while self.now < end {
            self.now += Duration::from_millis(5);
            let truth = self.truth();
            out.push((self.now, self.sense(&truth)));
        }
        out
    }

    fn sense(&mut self, truth: &Truth) -> Vec<Sample> {
        let mut samples = Vec::new();
        let now = self.now;
        let tick = now.us() / 5_000;
        if now >= self.next_imu {
            let jitter =
                (f64::from(self.random.uniform()) * self.senses.imu_jitter_us as f64) as u64;
            self.next_imu =
                now + Duration::from_millis(self.senses.imu_ms) + Duration::from_micros(jitter);
            let force = truth.rotation.transpose()
                * (truth.acceleration - Vector3::new(0.0, 0.0, GRAVITY_MPS2));
            let accel = force + self.accel_bias + self.gauss3(0.4);
            let gyro = truth.rates + self.gyro_bias + self.gauss3(0.03);
            samples.push(Sample::Imu(ImuSample {
                at: now,
                accel_mps2: In::from_vector(accel),
                gyro_radps: In::from_vector(gyro),
                mag: None,
            }));
        }
        if tick.is_multiple_of(4) {
            // The attitude is 10 ms old and quantised; its heading has its own zero and drifts.
            let then = Truth::of(self.path, now.s() - 0.01);
            let (roll, pitch, yaw) = then.roll_pitch_yaw();
            let quantise =
                |v: f64, step_deg: f64| (v.to_degrees() / step_deg).round() * step_deg.to_radians();
            let drift = 0.05f64.to_radians() * now.s();
            let (a, b) = (self.gauss(0.003), self.gauss(0.003));
            samples.push(Sample::Attitude(AttitudeSample {
                at: now - Duration::from_millis(10),
                roll_rad: quantise(roll + a, 0.1),
                pitch_rad: quantise(pitch + b, 0.1),
                heading_rad: quantise(yaw + self.heading_zero + drift, 1.0),
            }));
        }
        let cos_tilt = truth.rotation[(2, 2)];
        let on_plan = self.world.anchor.to_map(In::from_vector(truth.position));
        let below = (self.senses.floor_m)([on_plan.x(), on_plan.y()]);
        let distance = (-truth.position.z - below) / cos_tilt;
        if tick.is_multiple_of(8) && self.senses.has_range {
            let d = distance + self.gauss(0.01);
            samples.push(Sample::DownRange(DownRange {
                at: now,
                distance_m: (d > 0.02).then_some(d),
            }));
        }
        if tick.is_multiple_of(10) {
            let altitude_m = -truth.position.z + 0.4 + self.gauss(0.15);
            samples.push(Sample::Baro(BaroSample {
                at: now,
                altitude_m,
                climb_mps: 0.0,
            }));
        }
        if tick.is_multiple_of(8) && self.senses.has_flow && distance > 0.08 {
            let v = truth.rotation.transpose() * truth.velocity;
            samples.push(Sample::Flow(FlowSample {
                at: now,
                x_radps: truth.rates.x - v.y / distance + self.gauss(0.06),
                y_radps: truth.rates.y + v.x / distance + self.gauss(0.06),
                quality: 200,
            }));
        }
        if self.senses.has_scan {
            self.fire(truth);
        }
        let ready: Vec<RangeScan> = self
            .late
            .iter()
            .filter(|(when, _)| *when <= now)
            .map(|(_, s)| s.clone())
            .collect();
        self.late.retain(|(when, _)| *when > now);
        samples.extend(ready.into_iter().map(|s| Sample::Scan(Box::new(s))));
        samples
    }

    /// Fires the rangers that are due; those that fire together make one scan.
    fn fire(&mut self, truth: &Truth) {
        let now = self.now;
        let mut scan = RangeScan {
            at: now,
            beams: Default::default(),
        };
        for i in 0..self.senses.ring.rangers.len() {
            let ranger = self.senses.ring.rangers[i].clone();
            let period = Duration::from_secs_f64(1.0 / ranger.rate_hz);
            if ranger.looks_down() || now < self.fired[i] {
                continue;
            }
            let first = self.fired[i] == Timestamp::ZERO;
            self.fired[i] = now
                + if first {
                    period + period.mul_f64(ranger.phase)
                } else {
                    period
                };
            let here = truth.map_pose(&self.world.anchor);
            let columns_mm = (0..usize::from(ranger.columns))
                .map(|c| {
                    let axis = ranger.column_angle_rad(c);
                    let bearing = ranger.column_bearing_rad(c);
                    let half = ranger.half_cone_deg.to_radians();
                    let rays = if ranger.kind == RangerKind::Sonar {
                        7
                    } else {
                        1
                    };
                    let d = (0..rays)
                        .filter_map(|k| {
                            let b = if rays == 1 {
                                bearing
                            } else {
                                bearing + half * (f64::from(k) / 3.0 - 1.0)
                            };
                            self.ray(&here, truth, ranger.offset_m, b)
                        })
                        .fold(f64::INFINITY, f64::min);
                    let depth = if ranger.kind == RangerKind::Tof {
                        d * axis.cos()
                    } else {
                        d
                    };
                    let mut noisy = depth + self.gauss(0.01 + 0.01 * depth.min(4.0));
                    // No draw without need: the other tests keep their numbers.
                    if self.senses.false_returns > 0.0 {
                        let (fate, size) =
                            (self.random.uniform(), f64::from(self.random.uniform()));
                        let fate = f64::from(fate) / self.senses.false_returns;
                        if fate < 0.75 {
                            noisy *= 1.0 - 0.5 * size;
                        } else if fate < 1.0 {
                            noisy += 0.15 + 0.8 * size;
                        }
                    }
                    let lost = f64::from(self.random.uniform()) < 0.02;
                    (noisy > ranger.min_m && noisy < ranger.max_m && !lost)
                        .then_some((noisy * 1000.0) as u16)
                })
                .collect();
            let reading = RangerReading {
                at: now,
                ranger: i as u8,
                columns_mm,
            };
            for beam in ranger.beams(&reading) {
                let _ = scan.beams.try_push(beam);
            }
        }
        if !scan.beams.is_empty() {
            let delay = Duration::from_millis(self.senses.scan_delay_ms);
            self.late.push((now + delay, scan));
        }
    }

    /// Length of a ray in the tilted body plane against vertical walls.
    fn ray(&self, here: &MapPose, truth: &Truth, offset: [f64; 3], bearing: f64) -> Option<f64> {
        let d_body = Vector3::new(bearing.cos(), bearing.sin(), 0.0);
        let d = truth.rotation * d_body;
        let o = truth.rotation * Vector3::from(offset);
        let anchor = &self.world.anchor;
        let dm: In<Map> = anchor.vector_to_map(In::from_vector(d));
        let om: In<Map> = anchor.vector_to_map(In::from_vector(o));
        let flat = dm.norm_xy();
        let from = [here.x_m + om.x(), here.y_m + om.y()];
        let t = self.world.cast(from, [dm.x() / flat, dm.y() / flat])? / flat;
        // The floor is nearer?
        let height = -truth.position.z - o.z;
        let floor = if d.z > 1e-6 {
            height / d.z
        } else {
            f64::INFINITY
        };
        Some(t.min(floor))
    }
}
