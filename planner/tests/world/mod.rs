//! A flat world of its own for closed-loop tests: rooms drawn in letters, people as discs, rangers by exact intersection
//! with squares and circles, a vehicle that follows velocities with a lag. It shares no code with the crate under test.

use planner::{Navigator, PlannerParams, Steering, VfhParams};
use std::collections::VecDeque;
use std::sync::Arc;
use vehicle::floor_plan::Cell;
use vehicle::{
    Beam, FloorPlan, Frd, Heading, In, MapAnchor, NavHealth, NavState, Ned, RangeScan, RingConfig,
    Rot, Setpoint, Timestamp,
};

/// Side of a letter, m.
pub(crate) const LETTER_M: f64 = 0.3;
const RADIUS_M: f64 = 0.16;
const STEP_S: f64 = 0.02;

/// A disc that walks (or stands).
#[derive(Clone, Debug)]
pub(crate) struct Person {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) vx: f64,
    pub(crate) vy: f64,
    pub(crate) r: f64,
}

pub(crate) struct World {
    /// Squares of real walls, lower-left corners.
    walls: Vec<(f64, f64)>,
    pub(crate) people: Vec<Person>,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) vx: f64,
    pub(crate) vy: f64,
    pub(crate) yaw: f64,
    yaw_rate: f64,
    pub(crate) time_s: f64,
    pub(crate) navigator: Navigator,
    pub(crate) anchor: MapAnchor,
    ring: RingConfig,
    scans: VecDeque<(f64, RangeScan)>,
    next_scan_s: f64,
    commands: VecDeque<Setpoint>,
    /// State of the noise; the seed, until the first scan.
    pub(crate) noise: u64,
    /// Smallest distance from hull to wall and to a person so far, m.
    pub(crate) wall_clearance: f64,
    pub(crate) person_clearance: f64,
}

impl World {
    /// `plan` is what the vehicle knows, `truth` what is there: `#` wall, `S` start, anything else free. Row 0 is at the top.
    pub(crate) fn new(plan: &str, truth: &str, ring: &str) -> Self {
        let rows: Vec<&str> = plan
            .lines()
            .map(str::trim)
            .filter(|l| !l.is_empty())
            .collect();
        let (w, h) = (rows[0].len(), rows.len());
        let fine = 6;
        let mut cells = vec![Cell::Free; w * fine * h * fine];
        let mut start = (0.0, 0.0);
        for (r, row) in rows.iter().rev().enumerate() {
            for (c, letter) in row.bytes().enumerate() {
                if letter == b'#' {
                    for i in 0..fine {
                        for j in 0..fine {
                            cells[(r * fine + i) * w * fine + c * fine + j] = Cell::Occupied;
                        }
                    }
                }
                if letter == b'S' {
                    start = ((c as f64 + 0.5) * LETTER_M, (r as f64 + 0.5) * LETTER_M);
                }
            }
        }
        let mut walls = Vec::new();
        let rows: Vec<&str> = truth
            .lines()
            .map(str::trim)
            .filter(|l| !l.is_empty())
            .collect();
        for (r, row) in rows.iter().rev().enumerate() {
            for (c, letter) in row.bytes().enumerate() {
                if letter == b'#' {
                    walls.push((c as f64 * LETTER_M, r as f64 * LETTER_M));
                }
            }
        }
        let plan = Arc::new(
            FloorPlan::from_cells(w * fine, LETTER_M / fine as f64, [0.0, 0.0], cells)
                .expect("a drawn plan"),
        );
        // Home is not the plan's origin and north is not up, so that a mixed-up frame shows.
        let anchor = MapAnchor::new(1.0, 2.0, 0.7);
        Self {
            walls,
            people: Vec::new(),
            x: start.0,
            y: start.1,
            vx: 0.0,
            vy: 0.0,
            yaw: 0.0,
            yaw_rate: 0.0,
            time_s: 1.0,
            navigator: Navigator::new(
                plan,
                anchor,
                RADIUS_M,
                PlannerParams::default(),
                VfhParams::default(),
            ),
            anchor,
            ring: RingConfig::built_in(ring).expect("a built-in ring"),
            scans: VecDeque::new(),
            next_scan_s: 0.0,
            commands: VecDeque::new(),
            noise: 0x9e37_79b9_7f4a_7c15,
            wall_clearance: f64::INFINITY,
            person_clearance: f64::INFINITY,
        }
    }

    /// A letter of the picture (column from the left, row from the top) as a place.
    pub(crate) fn place(&self, column: f64, row: f64, rows: usize) -> In<Ned> {
        self.anchor.to_ned(In::new(
            (column + 0.5) * LETTER_M,
            (rows as f64 - row - 0.5) * LETTER_M,
            1.0,
        ))
    }

    pub(crate) fn now(&self) -> Timestamp {
        Timestamp::from_us((self.time_s * 1e6) as u64)
    }

    /// The state as a good estimator has it: the truth, 20 ms old attitude apart.
    pub(crate) fn nav(&self) -> NavState {
        let at = self.now();
        let p = self.anchor.to_ned(In::new(self.x, self.y, 1.0));
        let zero = self.anchor.to_ned(In::zero());
        let v = (self.anchor.to_ned(In::new(self.vx, self.vy, 0.0)) - zero).with_z(0.0);
        NavState {
            at,
            position: p,
            velocity: v,
            attitude: Rot::<Frd, Ned>::from_roll_pitch_yaw(
                0.0,
                0.0,
                self.anchor.yaw_to_ned(self.yaw),
            ),
            position_std_m: In::new(0.03, 0.03, 0.03),
            height_m: 1.0,
            rates_radps: In::new(0.0, 0.0, -self.yaw_rate),
            health: NavHealth {
                attitude: true,
                height: true,
                velocity: true,
                position: true,
            },
            ..NavState::default()
        }
    }

    /// One tick: scan, step, fly.
    pub(crate) fn tick(&mut self) -> Steering {
        self.sense();
        let (now, nav) = (self.now(), self.nav());
        let s = self.navigator.step(now, &nav);
        self.fly(s.setpoint);
        s
    }

    /// One tick of manual flight through the limiter.
    pub(crate) fn tick_manual(&mut self, desired: In<Ned>) {
        self.sense();
        let (now, nav) = (self.now(), self.nav());
        let velocity = self.navigator.protect(now, &nav, desired);
        self.fly(Setpoint::Velocity {
            velocity,
            down_m: Some(-1.0),
            heading: Heading::Rate(0.0),
        });
    }

    fn gauss(&mut self) -> f64 {
        let mut sum = 0.0;
        for _ in 0..4 {
            self.noise ^= self.noise << 13;
            self.noise ^= self.noise >> 7;
            self.noise ^= self.noise << 17;
            sum += (self.noise >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
        }
        sum * 1.732
    }

    /// Scans at the ring's rate; they arrive 30 ms later.
    fn sense(&mut self) {
        if self.time_s >= self.next_scan_s {
            self.next_scan_s = self.time_s + 1.0 / self.ring.rangers[0].rate_hz.max(8.0);
            let mut beams = arrayvec::ArrayVec::new();
            for ranger in self.ring.rangers.clone().iter().filter(|r| !r.looks_down()) {
                for column in 0..usize::from(ranger.columns) {
                    let bearing = ranger.column_bearing_rad(column);
                    let cone = if ranger.columns == 1 {
                        ranger.half_cone_deg.to_radians()
                    } else {
                        0.0
                    };
                    let mut nearest = f64::INFINITY;
                    for k in -3..=3 {
                        let a = self.yaw - bearing + cone * f64::from(k) / 3.0;
                        nearest = nearest.min(self.cast(a));
                    }
                    let measured = nearest + 0.02 * self.gauss();
                    beams.push(Beam {
                        origin: In::zero(),
                        bearing_rad: bearing,
                        elevation_rad: 0.0,
                        half_cone_rad: ranger.half_cone_deg.to_radians(),
                        distance_m: (measured < 4.0).then_some(measured.max(0.02)),
                        min_m: 0.02,
                        max_m: 4.0,
                    });
                }
            }
            self.scans.push_back((
                self.time_s + 0.03,
                RangeScan {
                    at: self.now(),
                    beams,
                },
            ));
        }
        while self.scans.front().is_some_and(|(t, _)| *t <= self.time_s) {
            let (_, scan) = self.scans.pop_front().expect("looked at");
            let nav = self.nav();
            self.navigator.observe(&scan, &nav);
        }
    }

    /// Distance along a ray to the nearest wall or person.
    fn cast(&self, angle: f64) -> f64 {
        let (dx, dy) = (angle.cos(), angle.sin());
        let mut nearest = f64::INFINITY;
        for (wx, wy) in &self.walls {
            // Slabs.
            let tx = [(wx - self.x) / dx, (wx + LETTER_M - self.x) / dx];
            let ty = [(wy - self.y) / dy, (wy + LETTER_M - self.y) / dy];
            let enter = tx[0].min(tx[1]).max(ty[0].min(ty[1]));
            let leave = tx[0].max(tx[1]).min(ty[0].max(ty[1]));
            if enter <= leave && enter > 0.0 {
                nearest = nearest.min(enter);
            }
        }
        for p in &self.people {
            let (ox, oy) = (p.x - self.x, p.y - self.y);
            let along = ox * dx + oy * dy;
            let aside2 = ox * ox + oy * oy - along * along;
            if along > 0.0 && aside2 < p.r * p.r {
                nearest = nearest.min(along - (p.r * p.r - aside2).sqrt());
            }
        }
        nearest
    }

    /// The vehicle's answer: 60 ms of dead time, 0.3 s of lag, 2.2 m/s2.
    fn fly(&mut self, setpoint: Setpoint) {
        self.commands.push_back(setpoint);
        let acting = if self.commands.len() > 3 {
            self.commands.pop_front().unwrap_or(Setpoint::Idle)
        } else {
            Setpoint::Idle
        };
        let (wanted, heading) = match acting {
            Setpoint::Hover { position, heading } => {
                let to = self.anchor.to_map(position);
                let (ex, ey) = (to.x() - self.x, to.y() - self.y);
                let k = 1.3 * (1.0f64).min(1.2 / (1.3 * ex.hypot(ey)).max(1e-9));
                ((ex * k, ey * k), heading)
            }
            Setpoint::Velocity {
                velocity, heading, ..
            } => {
                let v = self.anchor.vector_to_map(velocity);
                ((v.x(), v.y()), heading)
            }
            _ => ((0.0, 0.0), Heading::Rate(0.0)),
        };
        let (mut ax, mut ay) = ((wanted.0 - self.vx) / 0.3, (wanted.1 - self.vy) / 0.3);
        let n = ax.hypot(ay);
        if n > 2.2 {
            (ax, ay) = (ax * 2.2 / n, ay * 2.2 / n);
        }
        self.vx += ax * STEP_S;
        self.vy += ay * STEP_S;
        self.x += self.vx * STEP_S;
        self.y += self.vy * STEP_S;
        let rate = match heading {
            Heading::Yaw(ned) => {
                let mut turn = self.anchor.yaw_to_map(ned) - self.yaw;
                turn -= std::f64::consts::TAU * (turn / std::f64::consts::TAU).round();
                (1.8 * turn).clamp(-1.2, 1.2)
            }
            Heading::Rate(r) => -r,
        };
        self.yaw_rate += (rate - self.yaw_rate) * STEP_S / 0.1;
        self.yaw += self.yaw_rate * STEP_S;
        for p in &mut self.people {
            p.x += p.vx * STEP_S;
            p.y += p.vy * STEP_S;
        }
        self.time_s += STEP_S;
        for (wx, wy) in &self.walls {
            let dx = (wx - self.x).max(self.x - wx - LETTER_M).max(0.0);
            let dy = (wy - self.y).max(self.y - wy - LETTER_M).max(0.0);
            self.wall_clearance = self.wall_clearance.min(dx.hypot(dy) - RADIUS_M);
        }
        for p in &self.people {
            let d = (p.x - self.x).hypot(p.y - self.y);
            self.person_clearance = self.person_clearance.min(d - p.r - RADIUS_M);
        }
    }
}
