//! Constants of uQuad, a craft flown by motor speeds. Motors: 0 front, 1 left, 2 rear, 3 right; 0 and 2 turn counter-clockwise,
//! 1 and 3 clockwise. Filter, control and simulator take them from here.

/// Gravity as the thesis counts it, m/s2.
pub const GRAVITY_MPS2: f64 = 9.81;
/// Faster than this no motor is asked to turn by the thesis, rad/s; its driver refuses it earlier, at [`DRIVER_SPEED_RADPS`].
pub const MAX_SPEED_RADPS: f64 = 387.0;
/// Fastest the motor driver accepts (220 of its units), rad/s: the real limit.
pub const DRIVER_SPEED_RADPS: f64 = 368.16;

/// Mass, inertia, thrust and drag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UquadAirframe {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Moment of inertia about x and about y, kg m2.
    pub inertia_xy: f64,
    /// Moment of inertia about z, kg m2.
    pub inertia_z: f64,
    /// Moment of inertia of one rotor, kg m2.
    pub rotor_inertia: f64,
    /// Centre to motor, m.
    pub arm_m: f64,
    /// Thrust of one motor at speed w: `thrust.0 * w^2 + thrust.1 * w`, N.
    pub thrust: (f64, f64),
    /// Drag torque of one motor at speed w: `drag.0 * w^2 + drag.1 * w`, N m.
    pub drag: (f64, f64),
}

impl Default for UquadAirframe {
    /// The final program.
    fn default() -> Self {
        Self {
            mass_kg: 1.7,
            inertia_xy: 0.0232,
            inertia_z: 0.0437,
            rotor_inertia: 1.54e-5,
            arm_m: 0.29,
            thrust: (4.601_601_350_724_35e-5, -0.001_038_227_262_737_26),
            drag: (3.4734e-6, -1.3205e-4),
        }
    }
}

impl UquadAirframe {
    /// The craft of the recorded run of March 2012.
    #[must_use]
    pub fn march_2012() -> Self {
        Self {
            mass_kg: 1.541,
            thrust: (3.5296e-5, -4.9293e-4),
            ..Self::default()
        }
    }

    /// Thrust of one motor, N, at a speed in rad/s.
    #[must_use]
    pub fn thrust_n(&self, speed_radps: f64) -> f64 {
        (self.thrust.0 * speed_radps + self.thrust.1) * speed_radps
    }

    /// Drag torque of one motor, N m, at a speed in rad/s.
    #[must_use]
    pub fn drag_nm(&self, speed_radps: f64) -> f64 {
        (self.drag.0 * speed_radps + self.drag.1) * speed_radps
    }

    /// Speed at which four motors carry the weight, rad/s.
    #[must_use]
    pub fn hover_speed_radps(&self) -> f64 {
        let (b1, b2) = self.thrust;
        let quarter = self.mass_kg * GRAVITY_MPS2 / 4.0;
        (-b2 + libm::sqrt(b2 * b2 + 4.0 * b1 * quarter)) / (2.0 * b1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hover_speeds_are_those_of_the_program() {
        let golden = [
            (1.700, 312.49801),
            (1.741, 316.10365),
            (1.65, 308.04159),
            (1.75, 316.88944),
        ];
        for (mass_kg, speed) in golden {
            let craft = UquadAirframe {
                mass_kg,
                ..UquadAirframe::default()
            };
            assert!(
                (craft.hover_speed_radps() - speed).abs() < 1e-5,
                "{mass_kg}"
            );
            let lift = 4.0 * craft.thrust_n(craft.hover_speed_radps());
            assert!((lift - mass_kg * GRAVITY_MPS2).abs() < 1e-9);
        }
        let original = UquadAirframe {
            mass_kg: 1.741,
            ..UquadAirframe::default()
        };
        assert!((original.hover_speed_radps() - 316.103_650_939).abs() < 1e-6);
        let quarter = UquadAirframe::default().thrust_n(312.49801);
        assert!((quarter - 4.169).abs() < 1e-3);
    }
}
