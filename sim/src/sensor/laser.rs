//! Turning laser (LD06, RPLIDAR A1 class): lengths along rays.
//!
//! | | Value | Source |
//! | --- | --- | --- |
//! | noise | 1 cm, and 0.5 % of the length beyond 2 m | LD06 manual: 10 mm below 2 m; RPLIDAR A1: 1 % |
//! | grazing walls | nothing beyond 85 degrees off the normal | the beam's spot gets too long |
//! | specks | 0.1 % of rays end anywhere before the wall | dust, glints |
//! | delivered | 10 ms after the part was swept | packets |

use super::View;
use super::ranger::{frame, millimetres};
use crate::noise::Noise;
use arrayvec::ArrayVec;
use core::time::Duration;
use vehicle::sample::MAX_COLUMNS;
use vehicle::{Frd, In, Map, RangerConfig};

/// From the sweep of a part to its reading in our hands.
pub const LASER_LATENCY: Duration = Duration::from_millis(10);
const NOISE_M: f64 = 0.01;
const NOISE_PER_M: f64 = 0.005;
const CLEAN_UP_TO_M: f64 = 2.0;
/// Cosine of 85 degrees.
const LEAST_INCIDENCE_COS: f64 = 0.087;
const SPECKS: f64 = 0.001;

/// One ray: what the laser reads, m.
pub(crate) fn read_ray(
    noise: &mut Noise,
    view: &View<'_>,
    origin: In<Map>,
    ray: In<Frd>,
    max_m: f64,
) -> Option<f64> {
    // Drawn always, so that what one ray meets does not shift the numbers of the next.
    let (fate, share, error) = (noise.unit(), noise.unit(), noise.gauss(1.0));
    let hit = view.cast(origin, ray, max_m)?;
    if fate < SPECKS {
        return Some(share * hit.distance_m);
    }
    let sigma_m = NOISE_M + NOISE_PER_M * (hit.distance_m - CLEAN_UP_TO_M).max(0.0);
    (hit.incidence_cos >= LEAST_INCIDENCE_COS).then_some(hit.distance_m + sigma_m * error)
}

/// A part of the circle, one ray in the middle of each column.
#[derive(Clone, Debug)]
pub(super) struct Laser {
    config: RangerConfig,
    noise: Noise,
    rays: ArrayVec<In<Frd>, MAX_COLUMNS>,
}

impl Laser {
    pub(super) fn new(config: &RangerConfig, index: u8, seed: u64, vehicle: usize) -> Self {
        let [axis, right, _] = frame(config);
        let columns = usize::from(config.columns).min(MAX_COLUMNS);
        let rays = (0..columns)
            .map(|column| {
                let (s, c) = libm::sincos(config.column_angle_rad(column));
                axis * c + right * s
            })
            .collect();
        Self {
            config: config.clone(),
            noise: Noise::new(seed, vehicle, &format!("laser {index}")),
            rays,
        }
    }

    pub(super) fn measure(
        &mut self,
        view: &View<'_>,
        origin: In<Map>,
    ) -> (ArrayVec<Option<u16>, MAX_COLUMNS>, Duration) {
        let columns = self
            .rays
            .iter()
            .map(|ray| {
                read_ray(&mut self.noise, view, origin, *ray, self.config.max_m)
                    .and_then(|m| millimetres(m, &self.config))
            })
            .collect();
        (columns, LASER_LATENCY)
    }
}
