//! Ultrasonic ranger (HC-SR04 class): the nearest echo inside a cone.
//!
//! | | Value | Source |
//! | --- | --- | --- |
//! | cone | half angle of the ring table (7.5 degrees) | usable beam |
//! | range | of the ring table (0.02 - 4 m) | data sheet |
//! | noise | 1 cm, and whole centimetres | SNSI's driver reads centimetres |
//! | smooth surfaces | up to 25 degrees off the normal always an echo, beyond 65 never, evenly between | specular reflection |
//! | delivered | after the echo, 343 m/s; after 38 ms when there is none | data sheet |

use super::View;
use super::ranger::{frame, millimetres};
use crate::noise::Noise;
use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::sample::MAX_COLUMNS;
use vehicle::{Frd, In, Map, RangerConfig};

/// How long the sensor waits for an echo that does not come.
pub const SONAR_SILENCE: Duration = Duration::from_millis(38);
const SOUND_MPS: f64 = 343.0;
const NOISE_M: f64 = 0.01;
const RESOLUTION_M: f64 = 0.01;
/// Incidence up to which there is always, and beyond which there is never an echo, degrees.
const INCIDENCE_DEG: (f64, f64) = (25.0, 65.0);
/// Rays across the cone, and above and below its axis.
const ACROSS: i32 = 3;
const RAYS: usize = 2 * ACROSS as usize + 3;

/// A sensor with the rays that stand for its cone.
#[derive(Clone, Debug)]
pub(super) struct Sonar {
    config: RangerConfig,
    noise: Noise,
    rays: [In<Frd>; RAYS],
}

impl Sonar {
    pub(super) fn new(config: &RangerConfig, index: u8, seed: u64, vehicle: usize) -> Self {
        let [axis, right, up] = frame(config);
        let half_rad = config.half_cone_deg.to_radians();
        let (s, c) = libm::sincos(half_rad);
        let mut rays = [axis; RAYS];
        for (ray, k) in rays.iter_mut().zip(-ACROSS..=ACROSS) {
            let (s, c) = libm::sincos(half_rad * f64::from(k) / f64::from(ACROSS));
            *ray = axis * c + right * s;
        }
        rays[RAYS - 2] = axis * c + up * s;
        rays[RAYS - 1] = axis * c - up * s;
        Self {
            config: config.clone(),
            noise: Noise::new(seed, vehicle, &format!("sonar {index}")),
            rays,
        }
    }

    pub(super) fn measure(
        &mut self,
        view: &View<'_>,
        origin: In<Map>,
    ) -> (ArrayVec<Option<u16>, MAX_COLUMNS>, Duration) {
        let (always, never) = INCIDENCE_DEG;
        let steepest = self.noise.between(always, never).to_radians();
        let least_cos = libm::cos(steepest);
        let error_m = self.noise.gauss(NOISE_M);
        let echo_m = self
            .rays
            .iter()
            .filter_map(|ray| view.cast(origin, *ray, self.config.max_m))
            .filter(|hit| hit.incidence_cos >= least_cos)
            .map(|hit| hit.distance_m)
            .min_by(f64::total_cmp);
        let reading_m = echo_m.map(|m| libm::round((m + error_m) / RESOLUTION_M) * RESOLUTION_M);
        let latency = echo_m.map_or(SONAR_SILENCE, |m| {
            Duration::from_secs_f64(2.0 * m / SOUND_MPS)
        });
        let column = reading_m.and_then(|m| millimetres(m, &self.config));
        (core::iter::once(column).collect(), latency)
    }
}
