//! uQuad's airframe as a rigid body that is commanded in motor speeds: no flight controller in between.
//!
//! World: x y level, z up; body: x forward, y left, z up (uQuad's axes). Motors: 0 front, 1 left, 2 rear, 3 right; 0 and 2 turn
//! counter-clockwise. What the thesis's model leaves out is here: motors follow with a lag, air resists, a push, the floor.

use crate::imu_board::Environment;
use crate::quad::Quad;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vehicle::UquadAirframe;
use vehicle::uquad::GRAVITY_MPS2;

/// Integration step, s.
pub const STEP_S: f64 = 0.001;
/// First-order lag of motor and speed controller, s (chosen: 10-inch propellers under a sensorless controller).
const MOTOR_LAG_S: f64 = 0.040;
/// Drag of rotors and frame, N s/m.
const LINEAR_DRAG: f64 = 0.15;
/// Rotors resist turning, N m s.
const ROTATION_DRAG: f64 = 0.006;
/// The Earth's field in the simulated room, gauss: x is north.
const FIELD_GAUSS: [f64; 3] = [0.19, 0.0, -0.14];
/// Pressure on the floor, Pa, and what a metre takes off it.
const PRESSURE_PA: (f64, f64) = (101_205.0, 12.0);
/// The landed craft comes to rest within about this, s.
const STAND_UP_S: f64 = 0.04;

/// Where it is and how it moves: the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// World, m.
    pub position_m: Vector3<f64>,
    /// World, m/s.
    pub velocity_mps: Vector3<f64>,
    /// Body to world.
    pub attitude: UnitQuaternion<f64>,
    /// Body, rad/s.
    pub rates_radps: Vector3<f64>,
}

impl Motion {
    /// uQuad's twelve states: position, psi phi theta, velocity in the body, rates.
    #[must_use]
    pub fn states(&self) -> [f64; 12] {
        let (psi, phi, theta) = self.attitude.euler_angles();
        let p = self.position_m;
        let v = self.attitude.inverse() * self.velocity_mps;
        let w = self.rates_radps;
        [p.x, p.y, p.z, psi, phi, theta, v.x, v.y, v.z, w.x, w.y, w.z]
    }
}

/// From north, west, up (forward, left, up) to north, east, down (forward, right, down), and back.
pub(crate) fn flipped(v: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x, -v.y, -v.z)
}

/// The craft.
#[derive(Clone, Debug)]
pub struct MotorCraft {
    airframe: UquadAirframe,
    motion: Motion,
    speeds_radps: [f64; 4],
    specific_force: Vector3<f64>,
    push_n: Vector3<f64>,
}

impl MotorCraft {
    /// On the floor at the origin, motors standing, nose at theta.
    #[must_use]
    pub fn landed(airframe: UquadAirframe, theta_rad: f64) -> Self {
        Self {
            airframe,
            motion: Motion {
                position_m: Vector3::zeros(),
                velocity_mps: Vector3::zeros(),
                attitude: UnitQuaternion::from_euler_angles(0.0, 0.0, theta_rad),
                rates_radps: Vector3::zeros(),
            },
            speeds_radps: [0.0; 4],
            specific_force: Vector3::new(0.0, 0.0, GRAVITY_MPS2),
            push_n: Vector3::zeros(),
        }
    }

    /// In the air, motors at hover speed.
    #[must_use]
    pub fn hovering(airframe: UquadAirframe, at_m: Vector3<f64>, theta_rad: f64) -> Self {
        let mut craft = Self::landed(airframe, theta_rad);
        craft.motion.position_m = at_m;
        craft.speeds_radps = [airframe.hover_speed_radps(); 4];
        craft
    }

    /// A steady force from now on, world, N.
    pub const fn push(&mut self, force_n: Vector3<f64>) {
        self.push_n = force_n;
    }

    /// One millisecond with motors told to turn at these speeds, rad/s.
    pub fn step(&mut self, commanded_radps: [f64; 4]) {
        for (speed, target) in self.speeds_radps.iter_mut().zip(commanded_radps) {
            *speed += (target.max(0.0) - *speed) * (STEP_S / MOTOR_LAG_S);
        }
        let c = &self.airframe;
        // Below 23 rad/s the fitted parabola pulls: a propeller does not.
        let thrust = self.speeds_radps.map(|w| c.thrust_n(w).max(0.0));
        let drag = self.speeds_radps.map(|w| c.drag_nm(w).max(0.0));
        let m = &mut self.motion;
        let before = m.velocity_mps;

        let weight = Vector3::new(0.0, 0.0, -c.mass_kg * GRAVITY_MPS2);
        let lift = m.attitude * Vector3::new(0.0, 0.0, thrust.iter().sum());
        let force = lift + weight + self.push_n - m.velocity_mps * LINEAR_DRAG;
        m.velocity_mps += force * (STEP_S / c.mass_kg);
        m.position_m += m.velocity_mps * STEP_S;

        let inertia = Vector3::new(c.inertia_xy, c.inertia_xy, c.inertia_z);
        let [w0, w1, w2, w3] = self.speeds_radps;
        let spin = Vector3::new(0.0, 0.0, c.rotor_inertia * (w0 - w1 + w2 - w3));
        let torque = Vector3::new(
            c.arm_m * (thrust[1] - thrust[3]),
            c.arm_m * (thrust[2] - thrust[0]),
            drag[1] + drag[3] - drag[0] - drag[2],
        ) - m.rates_radps * ROTATION_DRAG;
        let momentum = inertia.component_mul(&m.rates_radps) + spin;
        let turning = (torque - m.rates_radps.cross(&momentum)).component_div(&inertia);
        m.rates_radps += turning * STEP_S;
        let q = m.attitude.into_inner();
        let turned = q + q * Quaternion::from_parts(0.0, m.rates_radps * (0.5 * STEP_S));
        m.attitude = UnitQuaternion::from_quaternion(turned);

        if m.position_m.z <= 0.0 && m.velocity_mps.z <= 0.0 {
            m.position_m.z = 0.0;
            m.velocity_mps = Vector3::zeros();
            let (_, _, theta) = m.attitude.euler_angles();
            let level = UnitQuaternion::from_euler_angles(0.0, 0.0, theta);
            m.attitude = m.attitude.slerp(&level, STEP_S / STAND_UP_S);
            m.rates_radps *= 1.0 - STEP_S / STAND_UP_S;
        }
        let acceleration = (m.velocity_mps - before) / STEP_S;
        let felt = acceleration + Vector3::new(0.0, 0.0, GRAVITY_MPS2);
        self.specific_force = m.attitude.inverse() * felt;
    }

    /// Where a body of the simulator's world is: this one is there and moves so.
    pub(crate) fn put(&mut self, quad: &Quad) {
        let m = &mut self.motion;
        m.position_m = flipped(*quad.position().vector());
        m.position_m.z = quad.height_m() - quad.airframe().landed_height_m;
        m.velocity_mps = flipped(*quad.velocity().vector());
        let attitude = quad.attitude();
        let q = attitude.quaternion().quaternion();
        m.attitude = UnitQuaternion::new_unchecked(Quaternion::new(q.w, q.i, -q.j, -q.k));
        m.rates_radps = flipped(*quad.rates().vector());
    }

    /// Specific force in the body, forward left up, m/s2.
    pub(crate) const fn specific_force(&self) -> Vector3<f64> {
        self.specific_force
    }

    /// The truth.
    #[must_use]
    pub const fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Speeds the motors turn at, rad/s.
    #[must_use]
    pub const fn speeds_radps(&self) -> [f64; 4] {
        self.speeds_radps
    }

    /// What the chips of the inertial unit feel.
    #[must_use]
    pub fn environment(&self) -> Environment {
        let m = &self.motion;
        let (floor_pa, per_metre) = PRESSURE_PA;
        Environment {
            accel_mps2: self.specific_force.into(),
            gyro_radps: m.rates_radps.into(),
            field_gauss: (m.attitude.inverse() * Vector3::from(FIELD_GAUSS)).into(),
            pressure_pa: floor_pa - per_metre * m.position_m.z,
            ..Environment::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hovering() -> MotorCraft {
        let craft = UquadAirframe::default();
        MotorCraft::hovering(craft, Vector3::new(0.0, 0.0, 1.0), 0.0)
    }

    fn run(craft: &mut MotorCraft, speeds: [f64; 4], ms: u32) {
        (0..ms).for_each(|_| craft.step(speeds));
    }

    #[test]
    fn hover_speed_hovers_and_feels_gravity_from_below() {
        let mut craft = hovering();
        run(&mut craft, [312.498_005; 4], 2000);
        assert!((craft.motion().position_m.z - 1.0).abs() < 1e-4);
        assert!((craft.environment().accel_mps2[2] - GRAVITY_MPS2).abs() < 1e-3);
    }

    #[test]
    fn stands_on_the_floor_until_it_lifts() {
        let mut craft = MotorCraft::landed(UquadAirframe::default(), 0.4);
        run(&mut craft, [105.0; 4], 1000);
        assert!(craft.motion().position_m.norm() < 1e-12);
        assert!((craft.motion().states()[5] - 0.4).abs() < 1e-6);
        run(&mut craft, [350.0; 4], 1000);
        assert!(craft.motion().position_m.z > 0.3);
    }

    #[test]
    fn each_motor_turns_it_the_way_its_place_says() {
        let after = |speeds| {
            let mut craft = hovering();
            run(&mut craft, speeds, 100);
            craft.motion().rates_radps
        };
        assert!(
            after([312.0, 330.0, 312.0, 300.0]).x > 0.1,
            "left up: right side down"
        );
        assert!(
            after([300.0, 312.0, 330.0, 312.0]).y > 0.1,
            "rear up: nose down"
        );
        assert!(
            after([300.0, 330.0, 300.0, 330.0]).z > 0.01,
            "clockwise rotors turn it left"
        );
    }

    #[test]
    fn nose_down_flies_forward_and_right_side_down_flies_right() {
        let mut craft = hovering();
        craft.motion.attitude = UnitQuaternion::from_euler_angles(0.05, 0.1, 0.0);
        run(&mut craft, [312.498; 4], 200);
        let v = craft.motion().velocity_mps;
        assert!(v.x > 0.1 && v.y < -0.05, "{v}");
    }
}
