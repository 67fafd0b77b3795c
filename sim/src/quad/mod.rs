//! The quadcopter as a rigid body in six degrees of freedom, 1 kHz.
//!
//! ```text
//!        front            motor  place        turns (seen from above)
//!      4       2            1    rear right   clockwise
//!        \   /              2    front right  counter-clockwise
//!          x                3    rear left    counter-clockwise
//!        /   \              4    front left   clockwise
//!      3       1          Betaflight's numbers, "props in"
//! ```

pub(crate) mod battery;
pub(crate) mod contact;

use crate::motor_craft::{MotorCraft, flipped};
use crate::noise::{Noise, Wander};
use crate::world::CEILING_M;
use battery::Battery;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vehicle::airframe::GRAVITY_MPS2;
use vehicle::{Airframe, Frd, In, Ned, Rot};

/// Integration step, s.
pub(crate) const STEP_S: f64 = 0.001;
/// First-order lag of a motor (the craft flown against real firmware), s.
const MOTOR_LAG_S: f64 = 0.030;
/// Reaction torque of a propeller per thrust, m (3-inch class; a usual ratio of torque to thrust coefficient).
const TORQUE_PER_THRUST_M: f64 = 0.012;
/// Radius of gyration about roll and pitch, as a share of the arm (frame, battery and companion computer close to the centre).
const GYRATION_PER_ARM: f64 = 0.55;
/// Inertia about yaw over that about roll: nearly flat.
const YAW_INERTIA_RATIO: f64 = 1.8;
/// Drag that grows with speed through the air, rotors mostly, N s/m.
const LINEAR_DRAG: f64 = 0.15;
/// Drag that grows with its square: half of air density times drag area of 0.03 m2, N s2/m2.
const QUADRATIC_DRAG: f64 = 0.018;
/// Rotors resist turning, N m s.
const ROTATION_DRAG: f64 = 0.003;
/// Largest gain of thrust on the floor and the height where it ends.
const GROUND_EFFECT: (f64, f64) = (0.20, 0.30);
/// Friction of the landed vehicle.
const FLOOR_FRICTION: f64 = 0.7;
/// Time constant with which the landed vehicle comes to stand on its feet, s.
const STAND_UP_S: f64 = 0.04;
/// Gusts change within about this time, s; new values every 10 ms.
const GUST: (f64, f64) = (0.8, 0.010);
/// Gust torque per gust force, m.
const GUST_ARM_M: f64 = 0.01;
/// Motors differ in thrust by this, one standard deviation.
const MOTOR_SPREAD: f64 = 0.015;
/// Body centre to its highest point, m.
const TOP_M: f64 = 0.05;

/// Mass, motors and motion.
#[derive(Clone, Debug)]
pub(crate) struct Quad {
    airframe: Airframe,
    inertia: Vector3<f64>,
    /// Full thrust of each motor, N.
    full_thrust_n: [f64; 4],
    /// Speed of each motor, 1 = full speed on a full battery.
    speed: [f64; 4],
    battery: Battery,
    gust: Gust,
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    attitude: UnitQuaternion<f64>,
    rates: Vector3<f64>,
    specific_force: Vector3<f64>,
    on_floor: bool,
}

/// What a step ran into above and below.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Bump {
    /// Vertical speed at which it met the floor or the ceiling in this step, m/s.
    pub(crate) floor_mps: Option<f64>,
    pub(crate) ceiling: bool,
}

impl Quad {
    pub(crate) fn new(
        airframe: Airframe,
        at: In<Ned>,
        yaw_rad: f64,
        charge: f64,
        turbulence_n: f64,
        seed: u64,
        index: usize,
    ) -> Self {
        let mut noise = Noise::new(seed, index, "motor spread");
        let gyration = GYRATION_PER_ARM * airframe.arm_m;
        let roll_inertia = airframe.mass_kg * gyration * gyration;
        let full_thrust_n =
            [(); 4].map(|()| 0.25 * airframe.max_thrust_n * (1.0 + noise.gauss(MOTOR_SPREAD)));
        Self {
            airframe,
            inertia: Vector3::new(roll_inertia, roll_inertia, YAW_INERTIA_RATIO * roll_inertia),
            full_thrust_n,
            speed: [0.0; 4],
            battery: Battery::new(charge),
            gust: Gust::new(turbulence_n, seed, index),
            position: Vector3::new(at.x(), at.y(), -airframe.landed_height_m),
            velocity: Vector3::zeros(),
            attitude: *Rot::<Frd, Ned>::from_roll_pitch_yaw(0.0, 0.0, yaw_rad).quaternion(),
            rates: Vector3::zeros(),
            specific_force: Vector3::new(0.0, 0.0, -GRAVITY_MPS2),
            on_floor: true,
        }
    }

    /// One millisecond with these motor commands (0..=1, motors 1 to 4).
    pub(crate) fn step(&mut self, commands: [f64; 4]) -> Bump {
        let before = self.velocity;
        let thrust_n = self.spin_motors(commands);
        let total_n: f64 = thrust_n.iter().sum();
        self.gust.step();

        let air = self.attitude.inverse() * self.velocity;
        let drag = -air * (LINEAR_DRAG + QUADRATIC_DRAG * air.norm());
        let lift = total_n * self.ground_effect();
        let force = self.attitude * (drag + Vector3::new(0.0, 0.0, -lift)) + self.gust.force;
        let acceleration = force / self.airframe.mass_kg + Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        self.velocity += acceleration * STEP_S;
        self.position += self.velocity * STEP_S;

        self.turn(thrust_n);
        let bump = self.meet_floor_and_ceiling(lift);
        self.feel(before);
        self.battery.step(self.speed);
        bump
    }

    /// One millisecond in which another body flies: its motion becomes this one's. Air and floor are this world's.
    pub(crate) fn follow(&mut self, body: &mut MotorCraft, speeds_radps: [f64; 4]) -> Bump {
        self.gust.step();
        body.push(flipped(self.gust.force));
        let sinking = self.velocity.z;
        body.step(speeds_radps);
        let m = *body.motion();
        let landed = Vector3::new(0.0, 0.0, -self.airframe.landed_height_m);
        self.position = flipped(m.position_m) + landed;
        self.velocity = flipped(m.velocity_mps);
        let q = m.attitude.quaternion();
        // Half a turn about x on both sides: forward, left, up become forward, right, down.
        self.attitude = UnitQuaternion::new_unchecked(Quaternion::new(q.w, q.i, -q.j, -q.k));
        self.rates = flipped(m.rates_radps);
        self.specific_force = flipped(body.specific_force());
        self.on_floor = m.position_m.z <= 0.0;
        let mut bump = Bump {
            floor_mps: self.on_floor.then(|| sinking.max(0.0)),
            ceiling: false,
        };
        let ceiling = TOP_M - CEILING_M;
        if self.position.z < ceiling {
            bump.ceiling = true;
            self.position.z = ceiling;
            self.velocity.z = self.velocity.z.max(0.0);
        }
        bump
    }

    fn spin_motors(&mut self, commands: [f64; 4]) -> [f64; 4] {
        let top_speed = self.battery.top_speed();
        let mut thrust_n = [0.0; 4];
        for (i, thrust) in thrust_n.iter_mut().enumerate() {
            let target = commands[i].clamp(0.0, 1.0) * top_speed;
            self.speed[i] += (target - self.speed[i]) * (STEP_S / MOTOR_LAG_S);
            *thrust = self.full_thrust_n[i] * self.speed[i] * self.speed[i];
        }
        thrust_n
    }

    fn ground_effect(&self) -> f64 {
        let (gain, ends_m) = GROUND_EFFECT;
        let share = (1.0 - self.height_m() / ends_m).clamp(0.0, 1.0);
        1.0 + gain * share * share
    }

    fn turn(&mut self, [t1, t2, t3, t4]: [f64; 4]) {
        let lever_m = self.airframe.arm_m * core::f64::consts::FRAC_1_SQRT_2;
        let torque = Vector3::new(
            lever_m * (t3 + t4 - t1 - t2),
            lever_m * (t2 + t4 - t1 - t3),
            TORQUE_PER_THRUST_M * (t2 + t3 - t1 - t4),
        ) - self.rates * ROTATION_DRAG
            + self.gust.force * GUST_ARM_M;
        let momentum = self.inertia.component_mul(&self.rates);
        let angular = (torque - self.rates.cross(&momentum)).component_div(&self.inertia);
        self.rates += angular * STEP_S;
        let w = self.rates * (0.5 * STEP_S);
        let q = self.attitude.into_inner();
        let turned = q + q * Quaternion::from_parts(0.0, w);
        self.attitude = UnitQuaternion::from_quaternion(turned);
    }

    fn meet_floor_and_ceiling(&mut self, lift_n: f64) -> Bump {
        let mut bump = Bump::default();
        let floor = -self.airframe.landed_height_m;
        self.on_floor = self.position.z >= floor;
        if self.on_floor {
            let impact = self.velocity.z.max(0.0);
            bump.floor_mps = Some(impact);
            self.position.z = floor;
            // Springs back a little from a hard landing.
            self.velocity.z = if impact > 0.3 { -0.15 * impact } else { 0.0 };
            let weight_n = self.airframe.mass_kg * GRAVITY_MPS2;
            let load = (1.0 - lift_n / weight_n).max(0.0);
            let level = self.velocity.xy().norm();
            let brake = FLOOR_FRICTION * load * GRAVITY_MPS2 * STEP_S;
            let keep = if level > brake {
                1.0 - brake / level
            } else {
                0.0
            };
            self.velocity.x *= keep;
            self.velocity.y *= keep;
            let (roll, pitch, yaw) = self.attitude.euler_angles();
            let stand = 1.0 - STEP_S / STAND_UP_S;
            self.attitude = UnitQuaternion::from_euler_angles(roll * stand, pitch * stand, yaw);
            self.rates *= 1.0 - load * STEP_S / STAND_UP_S;
        }
        let ceiling = TOP_M - CEILING_M;
        if self.position.z < ceiling {
            bump.ceiling = true;
            self.position.z = ceiling;
            self.velocity.z = self.velocity.z.max(0.0);
        }
        bump
    }

    /// What an accelerometer at the centre feels.
    fn feel(&mut self, before: Vector3<f64>) {
        let acceleration = (self.velocity - before) / STEP_S;
        let force = acceleration - Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        self.specific_force = self.attitude.inverse() * force;
    }

    /// Moves and bounces it off an obstacle: `away` points out of the obstacle (NED, level), `depth_m` is how far in it is.
    pub(crate) fn push_out(&mut self, away: Vector3<f64>, depth_m: f64) {
        self.position += away * depth_m;
        let into = self.velocity.dot(&away);
        if into < 0.0 {
            let along = self.velocity - away * into;
            self.velocity = along * 0.8 - away * (0.3 * into);
            // A propeller guard that scrapes along turns the vehicle a little.
            self.rates.z += 0.5 * (away.x * along.y - away.y * along.x);
        }
    }

    pub(crate) fn stop_at(&mut self, position: In<Ned>) {
        self.position = *position.vector();
        self.velocity = Vector3::zeros();
    }

    pub(crate) fn set_yaw(&mut self, yaw_rad: f64) {
        let (roll, pitch, _) = self.attitude.euler_angles();
        self.attitude = UnitQuaternion::from_euler_angles(roll, pitch, yaw_rad);
    }

    pub(crate) const fn position(&self) -> In<Ned> {
        In::from_vector(self.position)
    }

    pub(crate) const fn velocity(&self) -> In<Ned> {
        In::from_vector(self.velocity)
    }

    pub(crate) const fn attitude(&self) -> Rot<Frd, Ned> {
        Rot::from_quaternion(self.attitude)
    }

    pub(crate) const fn rates(&self) -> In<Frd> {
        In::from_vector(self.rates)
    }

    pub(crate) const fn specific_force(&self) -> In<Frd> {
        In::from_vector(self.specific_force)
    }

    /// Body centre above the floor, m.
    pub(crate) fn height_m(&self) -> f64 {
        -self.position.z
    }

    pub(crate) const fn is_on_floor(&self) -> bool {
        self.on_floor
    }

    /// Mean motor speed, 0..=1.
    pub(crate) fn mean_speed(&self) -> f64 {
        0.25 * self.speed.iter().sum::<f64>()
    }

    pub(crate) const fn airframe(&self) -> &Airframe {
        &self.airframe
    }

    pub(crate) const fn battery(&self) -> &Battery {
        &self.battery
    }

    pub(crate) fn set_charge(&mut self, charge: f64) {
        self.battery.set_charge(charge);
    }

    /// Cosine of the tilt.
    pub(crate) fn tilt_cos(&self) -> f64 {
        let q = self.attitude.quaternion();
        1.0 - 2.0 * (q.i * q.i + q.j * q.j)
    }
}

/// Air that moves: a force that wanders.
#[derive(Clone, Debug)]
struct Gust {
    noise: Noise,
    axes: [Wander; 3],
    force: Vector3<f64>,
    left_s: f64,
}

impl Gust {
    fn new(turbulence_n: f64, seed: u64, index: usize) -> Self {
        let mut noise = Noise::new(seed, index, "gust");
        let (time_constant_s, step_s) = GUST;
        let axes = [1.0, 1.0, 0.7]
            .map(|k| Wander::new(&mut noise, k * turbulence_n, time_constant_s, step_s));
        Self {
            noise,
            axes,
            force: Vector3::zeros(),
            left_s: 0.0,
        }
    }

    fn step(&mut self) {
        self.left_s -= STEP_S;
        if self.left_s <= 0.0 {
            self.left_s += GUST.1;
            for (axis, force) in self.axes.iter_mut().zip(self.force.iter_mut()) {
                *force = axis.step(&mut self.noise);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn still() -> Quad {
        let mut quad = Quad::new(Airframe::default(), In::zero(), 0.0, 1.0, 0.0, 1, 0);
        quad.full_thrust_n = [4.5; 4];
        quad
    }

    fn run(quad: &mut Quad, commands: [f64; 4], ms: u32) {
        for _ in 0..ms {
            quad.step(commands);
        }
    }

    #[test]
    fn stands_still_and_feels_gravity_from_below() {
        let mut quad = still();
        run(&mut quad, [0.0; 4], 1000);
        assert!(quad.is_on_floor() && quad.velocity().norm() < 1e-12);
        assert!((quad.specific_force() - In::new(0.0, 0.0, -GRAVITY_MPS2)).norm() < 1e-9);
    }

    #[test]
    fn hovers_at_57_percent() {
        // sqrt(0.6 kg x 9.81 / 18 N) = 0.572, out of ground effect.
        let climbs = |command: f64| {
            let mut quad = still();
            quad.position.z = -1.0;
            quad.speed = [command; 4];
            run(&mut quad, [command; 4], 300);
            quad.velocity().z() < 0.0
        };
        assert!(climbs(0.58) && !climbs(0.565));
    }

    #[test]
    fn each_motor_pair_turns_the_way_the_drawing_says() {
        let rates_after = |commands: [f64; 4]| {
            let mut quad = still();
            quad.position.z = -1.0;
            run(&mut quad, commands, 50);
            quad.rates()
        };
        assert!(
            rates_after([0.5, 0.5, 0.6, 0.6]).x() > 0.1,
            "left motors roll right"
        );
        assert!(
            rates_after([0.5, 0.6, 0.5, 0.6]).y() > 0.1,
            "front motors pitch up"
        );
        assert!(
            rates_after([0.5, 0.6, 0.6, 0.5]).z() > 0.01,
            "counter-clockwise propellers yaw clockwise"
        );
    }

    #[test]
    fn a_fall_from_one_metre_takes_the_time_physics_says() {
        let mut quad = still();
        quad.position.z = -1.05;
        let mut ms = 0;
        while quad.step([0.0; 4]).floor_mps.is_none() {
            ms += 1;
        }
        // sqrt(2 h / g) = 0.452 s, a little more with drag.
        assert!((445..475).contains(&ms), "{ms} ms");
    }

    #[test]
    fn the_ceiling_holds() {
        let mut quad = still();
        run(&mut quad, [1.0; 4], 3000);
        assert!(quad.height_m() <= CEILING_M);
    }

    #[test]
    fn attitude_stays_a_unit_quaternion_while_it_tumbles() {
        let mut quad = still();
        quad.position.z = -2.0;
        quad.rates = Vector3::new(8.0, -5.0, 3.0);
        run(&mut quad, [0.3, 0.5, 0.4, 0.6], 500);
        assert!((quad.attitude.quaternion().norm() - 1.0).abs() < 1e-12);
    }
}
