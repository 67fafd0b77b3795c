//! Range beams as level points: what of a scan can be compared with a floor plan.
//!
//! A plan is a horizontal slice. Beams are turned with roll and pitch into the level plane; those that meet the floor,
//! pass over the walls or were taken in a steep attitude are dropped.

use super::planar::Axes;
use arrayvec::ArrayVec;
use vehicle::sample::MAX_BEAMS;
use vehicle::{Beam, RangeScan};

/// Beams taken at more tilt than this are dropped, rad (15 deg; algorithms note 2).
pub const MAX_TILT_RAD: f64 = 0.262;
/// A hit lower than this above the floor may be the floor itself, m.
const MIN_HIT_HEIGHT_M: f64 = 0.06;
/// Cones narrower than this are treated as rays, rad ...
const RAY_HALF_CONE_RAD: f64 = 0.06;
/// ... and rays narrower than this (half a degree) come from a laser, whose error does not grow with the range.
const LASER_HALF_CONE_RAD: f64 = 0.009;
/// Where along a beam without return a wall would have been noticed, m.
const PROBES_M: [f64; 3] = [0.35, 0.6, 0.85];

/// How much a reading says; index of the sensor model's tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Evidence {
    /// Ray, return within 1 m.
    RayNear = 0,
    /// Ray, return within 2 m: one in ten is short.
    RayMiddle = 1,
    /// Ray, farther.
    RayFar = 2,
    /// Cone, return within 1.5 m.
    ConeNear = 3,
    /// Cone, farther.
    ConeFar = 4,
    /// No return.
    Nothing = 5,
    /// Laser beam, return at any distance.
    Laser = 6,
}

impl Evidence {
    /// Number of kinds.
    pub const COUNT: usize = 7;
}

/// One reading in the level plane. A ray has one candidate point; a cone three along its arc; a beam without return
/// three places where no wall can be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelBeam {
    /// Candidate points: x forward, y left of the body (or of whatever pose the reading is attached to), m. Rays repeat theirs.
    pub points: [[f64; 2]; 3],
    /// Where the beam starts, m.
    pub origin: [f64; 2],
    /// What it is worth.
    pub evidence: Evidence,
}

impl LevelBeam {
    /// The same reading, given in a pose's axes, in the frame the pose is given in.
    #[must_use]
    pub fn outward(&self, axes: &Axes) -> Self {
        Self {
            points: self.points.map(|p| axes.outward(p)),
            origin: axes.outward(self.origin),
            evidence: self.evidence,
        }
    }

    /// The same reading, given in the frame of a pose, in the pose's axes.
    #[must_use]
    pub fn inward(&self, axes: &Axes) -> Self {
        Self {
            points: self.points.map(|p| axes.inward(p)),
            origin: axes.inward(self.origin),
            evidence: self.evidence,
        }
    }

    /// The candidate points, each once.
    #[must_use]
    pub fn candidates(&self) -> &[[f64; 2]] {
        if self.is_ray() {
            &self.points[..1]
        } else {
            &self.points
        }
    }

    /// True if it has a return.
    #[must_use]
    pub const fn is_hit(&self) -> bool {
        !matches!(self.evidence, Evidence::Nothing)
    }

    /// True if its three points are one.
    #[must_use]
    pub const fn is_ray(&self) -> bool {
        matches!(
            self.evidence,
            Evidence::RayNear | Evidence::RayMiddle | Evidence::RayFar | Evidence::Laser
        )
    }
}

/// Attitude and height a scan was taken with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stance {
    /// Roll, right side down +, rad.
    pub roll_rad: f64,
    /// Pitch, nose up +, rad.
    pub pitch_rad: f64,
    /// Height of the body centre above the floor, m.
    pub height_m: f64,
    /// Height of the walls, m.
    pub wall_height_m: f64,
}

/// A scan as level points about the body. Empty when the vehicle is tilted too far.
#[must_use]
pub fn level(scan: &RangeScan, stance: &Stance) -> ArrayVec<LevelBeam, MAX_BEAMS> {
    let turn = Turn::new(stance);
    let tilt = libm::acos((turn.cos_roll * turn.cos_pitch).min(1.0));
    if tilt.is_nan() || tilt > MAX_TILT_RAD || !stance.height_m.is_finite() {
        return ArrayVec::new();
    }
    scan.beams
        .iter()
        .filter_map(|beam| level_beam(beam, stance, &turn))
        .collect()
}

/// Roll and pitch as sines and cosines.
struct Turn {
    sin_roll: f64,
    cos_roll: f64,
    sin_pitch: f64,
    cos_pitch: f64,
}

impl Turn {
    fn new(stance: &Stance) -> Self {
        Self {
            sin_roll: libm::sin(stance.roll_rad),
            cos_roll: libm::cos(stance.roll_rad),
            sin_pitch: libm::sin(stance.pitch_rad),
            cos_pitch: libm::cos(stance.pitch_rad),
        }
    }

    /// Body FRD to level axes, forward right down.
    fn to_level(&self, v: [f64; 3]) -> [f64; 3] {
        let y = self.cos_roll * v[1] - self.sin_roll * v[2];
        let z = self.sin_roll * v[1] + self.cos_roll * v[2];
        [
            self.cos_pitch * v[0] + self.sin_pitch * z,
            y,
            -self.sin_pitch * v[0] + self.cos_pitch * z,
        ]
    }
}

fn level_beam(beam: &Beam, stance: &Stance, turn: &Turn) -> Option<LevelBeam> {
    let finite = beam.origin.is_finite()
        && beam.bearing_rad.is_finite()
        && beam.elevation_rad.is_finite()
        && beam.half_cone_rad.is_finite()
        && beam.max_m.is_finite();
    if !finite
        || beam
            .distance_m
            .is_some_and(|d| !(d > 0.0 && d <= beam.max_m + 1e-6))
    {
        return None;
    }
    let origin = turn.to_level([beam.origin.x(), beam.origin.y(), beam.origin.z()]);
    let ce = libm::cos(beam.elevation_rad);
    let direction = |bearing: f64| {
        turn.to_level([
            ce * libm::cos(bearing),
            ce * libm::sin(bearing),
            -libm::sin(beam.elevation_rad),
        ])
    };
    let ahead = direction(beam.bearing_rad);
    // Forward-right-down becomes forward-left here, once.
    let point = |direction: &[f64; 3], distance: f64| {
        [
            origin[0] + direction[0] * distance,
            -(origin[1] + direction[1] * distance),
        ]
    };
    let hit_height = |distance: f64| stance.height_m - origin[2] - ahead[2] * distance;
    let origin_left = [origin[0], -origin[1]];
    let is_cone = beam.half_cone_rad > RAY_HALF_CONE_RAD;
    let Some(distance) = beam.distance_m else {
        let reach = PROBES_M[2] + 0.15;
        let lowest = hit_height(reach);
        if beam.max_m < reach || lowest < MIN_HIT_HEIGHT_M || lowest > stance.wall_height_m {
            return None;
        }
        return Some(LevelBeam {
            points: PROBES_M.map(|d| point(&ahead, d)),
            origin: origin_left,
            evidence: Evidence::Nothing,
        });
    };
    let height = hit_height(distance);
    if height < MIN_HIT_HEIGHT_M.min(0.8 * stance.height_m) || height > stance.wall_height_m {
        return None;
    }
    if !is_cone {
        let p = point(&ahead, distance);
        let evidence = match distance {
            _ if beam.half_cone_rad < LASER_HALF_CONE_RAD => Evidence::Laser,
            d if d < 1.0 => Evidence::RayNear,
            d if d < 2.0 => Evidence::RayMiddle,
            _ => Evidence::RayFar,
        };
        return Some(LevelBeam {
            points: [p; 3],
            origin: origin_left,
            evidence,
        });
    }
    // The nearest return came from somewhere on the arc: three candidates, 2/3 of the half cone apart.
    let side = beam.half_cone_rad * (2.0 / 3.0);
    Some(LevelBeam {
        points: [-side, 0.0, side].map(|a| point(&direction(beam.bearing_rad + a), distance)),
        origin: origin_left,
        evidence: if distance < 1.5 {
            Evidence::ConeNear
        } else {
            Evidence::ConeFar
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_PI_2;
    use vehicle::{In, Timestamp};

    fn beam(bearing_rad: f64, distance_m: Option<f64>) -> Beam {
        Beam {
            origin: In::zero(),
            bearing_rad,
            elevation_rad: 0.0,
            half_cone_rad: 0.05,
            distance_m,
            min_m: 0.02,
            max_m: 4.0,
        }
    }

    fn scan(beams: &[Beam]) -> RangeScan {
        RangeScan {
            at: Timestamp::ZERO,
            beams: beams.iter().copied().collect(),
        }
    }

    const LEVEL: Stance = Stance {
        roll_rad: 0.0,
        pitch_rad: 0.0,
        height_m: 1.0,
        wall_height_m: 2.4,
    };

    #[test]
    fn a_beam_to_the_right_hits_at_negative_y_on_the_plan() {
        let out = level(&scan(&[beam(FRAC_PI_2, Some(2.5))]), &LEVEL);
        let [x, y] = out[0].points[0];
        assert!(x.abs() < 1e-12 && (y + 2.5).abs() < 1e-12);
        assert_eq!(out[0].evidence, Evidence::RayFar);
    }

    #[test]
    fn nose_down_the_front_beam_meets_the_floor_and_is_dropped_but_a_short_one_is_kept() {
        let nose_down = Stance {
            pitch_rad: -0.2,
            height_m: 0.5,
            ..LEVEL
        };
        let out = level(
            &scan(&[beam(0.0, Some(2.4)), beam(0.0, Some(1.0))]),
            &nose_down,
        );
        assert_eq!(out.len(), 1);
        assert!((out[0].points[0][0] - libm::cos(0.2)).abs() < 1e-9);
    }

    #[test]
    fn nothing_is_believed_beyond_fifteen_degrees_of_tilt() {
        let steep = Stance {
            roll_rad: 0.3,
            ..LEVEL
        };
        assert!(level(&scan(&[beam(0.0, Some(1.0))]), &steep).is_empty());
    }

    #[test]
    fn broken_beams_are_dropped() {
        let nan = beam(0.0, Some(f64::NAN));
        let turned = beam(f64::NAN, Some(1.0));
        let endless = beam(0.0, Some(f64::INFINITY));
        assert!(level(&scan(&[nan, turned, endless]), &LEVEL).is_empty());
    }
}
