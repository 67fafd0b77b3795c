//! Magnetometer of the flight controller, and the steel of the building that bends what it measures.
//!
//! | | Value | Source |
//! | --- | --- | --- |
//! | field of the earth | 0.20 G to the north, 0.43 G down, declination 3 degrees east | central Europe, world magnetic model |
//! | scale | 1090 counts per gauss | HMC5883L data sheet, gain 1.3 G |
//! | noise per sample | 0.002 G at rest, 0.006 G in hover | HMC5883L data sheet; motor wires |
//! | hard iron after calibration | 0.015 G per axis, constant in the body | screws, buzzer |
//! | motor current | 0.02 G in hover, one direction in the body, by the square of motor speed | wires of the battery |
//! | steel | a dipole every 1.5 m of wall and furniture and one under every 4 m2 of floor | reinforcement, frames, desks |
//!
//! Together they pull the magnetic heading by 30 degrees (rms over the places of the office) on the floor, by about 8 at a
//! height of 1 m, and the norm of the field differs by 0.06 G between places: what surveys of offices find, and the reason
//! why Kestrel takes no heading from a magnetometer indoors.

use crate::noise::Noise;
use std::sync::Arc;
use vehicle::{Frd, In, MapAnchor, Ned, Rot, Segment};

/// Counts per gauss.
pub const MAG_COUNTS_PER_GAUSS: f64 = 1090.0;
/// Horizontal and vertical part of the earth's field, G.
const EARTH_GAUSS: [f64; 2] = [0.20, 0.43];
/// Magnetic north lies east of north, rad.
const DECLINATION_RAD: f64 = 3.0 * core::f64::consts::PI / 180.0;
const NOISE_REST_GAUSS: f64 = 0.002;
const NOISE_HOVER_GAUSS: f64 = 0.006;
const HARD_IRON_GAUSS: f64 = 0.015;
const CURRENT_GAUSS: f64 = 0.02;
/// Mean motor speed in hover, where the figures above hold.
const HOVER_SPEED: f64 = 0.57;
/// Length of wall per dipole, m.
const WALL_PER_DIPOLE_M: f64 = 1.5;
/// Side of the square of floor per dipole, m.
const FLOOR_PER_DIPOLE_M: f64 = 2.0;
/// Reinforcement lies this deep under the floor, m.
const FLOOR_STEEL_DEPTH_M: f64 = 0.15;
/// Magnetic moment per axis, one standard deviation, A m2.
const MOMENT: f64 = 12.0;
/// Field of a moment of 1 A m2 at 1 m, G: mu0 / 4 pi.
const GAUSS_PER_MOMENT: f64 = 1e-3;
/// Steel is no point: nearer than this the field grows no more, m.
const CORE_M: f64 = 0.40;
/// Dipoles of a building at most.
const MOST_DIPOLES: usize = 400;

/// The field in a building: the earth's, bent by steel. The same for every vehicle in it.
#[derive(Clone, Debug)]
pub(crate) struct MagneticField {
    earth: In<Ned>,
    steel: Vec<Dipole>,
}

#[derive(Clone, Copy, Debug)]
struct Dipole {
    at: In<Ned>,
    moment: In<Ned>,
}

impl MagneticField {
    pub(crate) fn new(walls: &[Segment], anchor: &MapAnchor, seed: u64) -> Arc<Self> {
        let mut noise = Noise::new(seed, 0, "steel of the building");
        let mut steel = Vec::new();
        let mut add = |noise: &mut Noise, [x, y]: [f64; 2], height_m: f64| {
            let moment = [(); 3].map(|()| noise.gauss(MOMENT));
            if steel.len() < MOST_DIPOLES {
                let at = anchor.to_ned(In::new(x, y, height_m));
                let moment = moment.into();
                steel.push(Dipole { at, moment });
            }
        };
        let mut since_last_m = 0.0;
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for wall in walls {
            for p in [wall.a, wall.b] {
                low = [low[0].min(p[0]), low[1].min(p[1])];
                high = [high[0].max(p[0]), high[1].max(p[1])];
            }
            let along = [wall.b[0] - wall.a[0], wall.b[1] - wall.a[1]];
            let length_m = libm::hypot(along[0], along[1]);
            since_last_m += length_m;
            while since_last_m >= WALL_PER_DIPOLE_M && length_m > 0.0 {
                since_last_m -= WALL_PER_DIPOLE_M;
                let u = (1.0 - since_last_m / length_m).max(0.0);
                let place = [wall.a[0] + u * along[0], wall.a[1] + u * along[1]];
                let height_m = noise.between(0.0, 2.0);
                add(&mut noise, place, height_m);
            }
        }
        let steps = |axis: usize| {
            let n = (high[axis] - low[axis]) / FLOOR_PER_DIPOLE_M;
            // An unbounded or empty plan has no floor to speak of.
            if n.is_finite() {
                n.min(100.0) as u32
            } else {
                0
            }
        };
        for i in 0..steps(0) {
            for j in 0..steps(1) {
                let x = low[0] + (f64::from(i) + noise.unit()) * FLOOR_PER_DIPOLE_M;
                let y = low[1] + (f64::from(j) + noise.unit()) * FLOOR_PER_DIPOLE_M;
                add(&mut noise, [x, y], -FLOOR_STEEL_DEPTH_M);
            }
        }
        let [level, down] = EARTH_GAUSS;
        let (s, c) = libm::sincos(DECLINATION_RAD);
        Arc::new(Self {
            earth: In::new(level * c, level * s, down),
            steel,
        })
    }

    /// The field at a place, G.
    pub(crate) fn at(&self, place: In<Ned>) -> In<Ned> {
        self.steel.iter().fold(self.earth, |sum, dipole| {
            let r = place - dipole.at;
            let d = r.norm().max(CORE_M);
            let u = r / d;
            let m = dipole.moment;
            sum + (u * (3.0 * m.dot(&u)) - m) * (GAUSS_PER_MOMENT / (d * d * d))
        })
    }
}

/// Three-axis magnetometer on the flight controller.
#[derive(Clone, Debug)]
pub(crate) struct Mag {
    noise: Noise,
    hard_iron: In<Frd>,
    current: In<Frd>,
    field: Arc<MagneticField>,
}

impl Mag {
    pub(crate) fn new(seed: u64, vehicle: usize, field: Arc<MagneticField>) -> Self {
        let mut noise = Noise::new(seed, vehicle, "mag");
        Self {
            hard_iron: triple(&mut noise, HARD_IRON_GAUSS),
            current: triple(&mut noise, CURRENT_GAUSS / libm::sqrt(3.0)),
            noise,
            field,
        }
    }

    /// A reading, G. `motor_speed` is the mean of the motors, 0..=1.
    pub(crate) fn read(
        &mut self,
        place: In<Ned>,
        attitude: &Rot<Frd, Ned>,
        motor_speed: f64,
    ) -> In<Frd> {
        let load = (motor_speed / HOVER_SPEED) * (motor_speed / HOVER_SPEED);
        let sigma = NOISE_REST_GAUSS + (NOISE_HOVER_GAUSS - NOISE_REST_GAUSS) * load;
        let bent = attitude.inverse() * self.field.at(place);
        bent + self.hard_iron + self.current * load + triple(&mut self.noise, sigma)
    }
}

fn triple(noise: &mut Noise, sigma: f64) -> In<Frd> {
    In::new(noise.gauss(sigma), noise.gauss(sigma), noise.gauss(sigma))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Room;
    use approx::assert_abs_diff_eq;

    #[test]
    fn without_steel_there_is_only_the_earth() {
        let anchor = MapAnchor::new(0.0, 0.0, core::f64::consts::FRAC_PI_2);
        let field = MagneticField::new(&[], &anchor, 1).at(In::new(3.0, 4.0, -1.0));
        assert_abs_diff_eq!(field.norm_xy(), 0.20, epsilon = 1e-12);
        assert_abs_diff_eq!(field.z(), 0.43, epsilon = 1e-12);
    }

    #[test]
    fn steel_bends_the_office_by_some_degrees_and_more_beside_walls() {
        let room = Room::named("office").unwrap();
        let mut errors = Vec::new();
        for seed in 0..20 {
            let field = MagneticField::new(room.segments(), &room.anchor(), seed);
            for (place, [north, east]) in room.facts().rooms.iter().map(|p| (&p.name, p.ned_m)) {
                let b = field.at(In::new(north, east, -1.0));
                assert!(b.norm() < 1.5, "{place}: {b:?}");
                errors.push((libm::atan2(b.y(), b.x()) - DECLINATION_RAD).to_degrees());
            }
        }
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!((4.0..20.0).contains(&rms), "{rms} degrees");
    }

    #[test]
    fn a_building_is_the_same_for_everybody_and_another_one_by_seed() {
        let room = Room::named("office").unwrap();
        let at = |seed| MagneticField::new(room.segments(), &room.anchor(), seed).at(In::zero());
        assert_eq!(at(3), at(3));
        assert_ne!(at(3), at(4));
    }
}
