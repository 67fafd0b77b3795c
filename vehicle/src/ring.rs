//! The ring of range finders as a table: what is mounted where and how a reading of it becomes beams.
//!
//! Simulator and bridge read the same table, so a user's own ring (a TOML file) works in both:
//!
//! ```
//! let ring = vehicle::RingConfig::from_toml(r#"
//!     name = "two sonars"
//!     [[ranger]]
//!     name = "front"
//!     kind = "sonar"
//!     bearing_deg = 0.0        # clockwise from forward
//!     half_cone_deg = 7.5
//!     min_m = 0.02
//!     max_m = 4.0
//!     rate_hz = 8.0
//!     [[ranger]]
//!     name = "back"
//!     kind = "sonar"
//!     bearing_deg = 180.0
//!     phase = 0.5              # fired half a period after the first: no cross-talk
//!     half_cone_deg = 7.5
//!     min_m = 0.02
//!     max_m = 4.0
//!     rate_hz = 8.0
//! "#).unwrap();
//! assert_eq!(ring.rangers.len(), 2);
//! ```

use crate::angle::wrap_pi;
use crate::sample::{Beam, MAX_BEAMS, MAX_COLUMNS, RangerReading};
use crate::{Frd, In};
use arrayvec::ArrayVec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A named ring of rangers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RingConfig {
    /// Name for people.
    pub name: String,
    /// The rangers, in firing order.
    #[serde(rename = "ranger")]
    pub rangers: Vec<RangerConfig>,
}

/// What a ranger's reading means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RangerKind {
    /// Multizone time of flight (VL53L5CX class): one depth ALONG THE SENSOR AXIS per column, not along the ray.
    Tof,
    /// Ultrasonic (HC-SR04 class): the nearest echo inside a cone.
    Sonar,
    /// A part of a turning laser's circle: one length along the ray per column.
    Laser,
}

/// One ranger of the ring.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangerConfig {
    /// Name for people.
    pub name: String,
    /// What a reading means.
    pub kind: RangerKind,
    /// Direction of the sensor axis in the body's horizontal plane, clockwise from forward, degrees.
    pub bearing_deg: f64,
    /// Direction of the sensor axis above that plane, degrees; -90 looks at the floor.
    #[serde(default)]
    pub elevation_deg: f64,
    /// Where the sensor sits, m from the body centre, forward right down.
    #[serde(default)]
    pub offset_m: [f64; 3],
    /// Number of columns across the field of view (`tof`, `laser`), 1 for `sonar`.
    #[serde(default = "one")]
    pub columns: u8,
    /// Horizontal field of view that the columns divide evenly, degrees (`tof`, `laser`).
    #[serde(default)]
    pub field_of_view_deg: f64,
    /// Half the opening angle of the cone (`sonar`) or of one column (`tof`), degrees.
    pub half_cone_deg: f64,
    /// Shortest distance it measures, m.
    pub min_m: f64,
    /// Longest distance it measures, m (`tof`: along the axis).
    pub max_m: f64,
    /// Firings a second.
    pub rate_hz: f64,
    /// When in its period it fires, 0..1; rangers that would hear each other get different phases.
    #[serde(default)]
    pub phase: f64,
    /// Who delivers it: `sim`, or the name of a sensor of `kestrel fly`. For people; nothing depends on it.
    #[serde(default = "sim")]
    pub source: String,
}

fn one() -> u8 {
    1
}

fn sim() -> String {
    "sim".to_owned()
}

/// Why a ring cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RingError {
    /// Not TOML, or a key is missing or unknown.
    #[error("ring file: {0}")]
    Toml(String),
    /// A value makes no sense.
    #[error("ranger `{ranger}`: {what}")]
    Ranger {
        /// Name of the ranger.
        ranger: String,
        /// What is wrong and what is allowed.
        what: String,
    },
    /// Too many beams in all.
    #[error("ring `{name}` has {beams} columns in all, at most {MAX_BEAMS} fit a scan")]
    TooManyBeams {
        /// Name of the ring.
        name: String,
        /// Columns in all.
        beams: usize,
    },
    /// No built-in ring of this name.
    #[error("no ring named `{0}`; built in are {list}", list = RingConfig::BUILT_IN.join(", "))]
    Unknown(String),
}

impl RingConfig {
    /// Names of the built-in rings.
    pub const BUILT_IN: [&'static str; 4] = ["tof32", "sonar8", "snsi6", "lidar60"];

    /// A built-in ring.
    ///
    /// | Name | What it is |
    /// | --- | --- |
    /// | `tof32` | four multizone time-of-flight sensors of 8 columns, as on the recorded nano quadcopter (15 Hz) |
    /// | `sonar8` | eight HC-SR04 every 45 degrees, opposite ones together, four slots of 60 ms |
    /// | `snsi6` | SNSI's six HC-SR04: right, 37 degrees right, front, 37 left, left, and down, in turn, 3 Hz; blind behind |
    /// | `lidar60` | a turning laser (LD06, RPLIDAR A1): ten parts of six columns, one turn in 0.1 s |
    ///
    /// # Errors
    /// [`RingError::Unknown`] names the built-in rings.
    pub fn built_in(name: &str) -> Result<Self, RingError> {
        match name {
            "tof32" => Ok(Self::tof32()),
            "sonar8" => Ok(Self::sonar8()),
            "snsi6" => Ok(Self::snsi6()),
            "lidar60" => Ok(Self::lidar60()),
            other => Err(RingError::Unknown(other.to_owned())),
        }
    }

    /// A ring from its TOML table, checked.
    ///
    /// # Errors
    /// Names the key or the ranger that is wrong.
    pub fn from_toml(text: &str) -> Result<Self, RingError> {
        let ring: Self = toml::from_str(text).map_err(|e| RingError::Toml(e.to_string()))?;
        ring.check()?;
        Ok(ring)
    }

    fn tof32() -> Self {
        // Geometry: crazyflie deck of the recorded maze flights; lever arms 20 mm (front, back) and 25 mm (sides).
        let side = |name: &str, bearing_deg: f64, offset_m: [f64; 3]| RangerConfig {
            name: name.to_owned(),
            kind: RangerKind::Tof,
            bearing_deg,
            elevation_deg: 0.0,
            offset_m,
            columns: 8,
            field_of_view_deg: 45.0,
            half_cone_deg: 2.8125,
            min_m: 0.02,
            max_m: 4.0,
            rate_hz: 15.0,
            phase: 0.0,
            source: sim(),
        };
        Self {
            name: "tof32".to_owned(),
            rangers: vec![
                side("front", 0.0, [0.02, 0.0, 0.0]),
                side("back", 180.0, [-0.02, 0.0, 0.0]),
                side("left", -90.0, [0.0, -0.025, 0.0]),
                side("right", 90.0, [0.0, 0.025, 0.0]),
            ],
        }
    }

    /// HC-SR04: 2 cm to 4 m, 60 ms a reading, 15 degrees of usable cone.
    fn hc_sr04(
        name: &str,
        bearing_deg: f64,
        elevation_deg: f64,
        rate_hz: f64,
        phase: f64,
    ) -> RangerConfig {
        let bearing_rad = bearing_deg.to_radians();
        let level = if elevation_deg == 0.0 { 0.05 } else { 0.0 };
        RangerConfig {
            name: name.to_owned(),
            kind: RangerKind::Sonar,
            bearing_deg,
            elevation_deg,
            offset_m: [
                level * libm::cos(bearing_rad),
                level * libm::sin(bearing_rad),
                0.0,
            ],
            columns: 1,
            field_of_view_deg: 0.0,
            half_cone_deg: 7.5,
            min_m: 0.02,
            max_m: 4.0,
            rate_hz,
            phase,
            source: sim(),
        }
    }

    fn sonar8() -> Self {
        let rate_hz = 1.0 / (4.0 * 0.06);
        let rangers = (0..8u8)
            .map(|i| {
                let bearing_deg = f64::from(i) * 45.0;
                Self::hc_sr04(
                    &format!("{bearing_deg}deg"),
                    bearing_deg,
                    0.0,
                    rate_hz,
                    f64::from(i % 4) / 4.0,
                )
            })
            .collect();
        Self {
            name: "sonar8".to_owned(),
            rangers,
        }
    }

    fn snsi6() -> Self {
        // The thesis counts its angles from the right-hand side counter-clockwise: 90 is straight ahead.
        let mut rangers: Vec<_> = [0.0, 53.0, 90.0, 127.0, 180.0]
            .iter()
            .zip(0u8..)
            .map(|(angle_deg, i)| {
                Self::hc_sr04(
                    &format!("{angle_deg}deg"),
                    90.0 - angle_deg,
                    0.0,
                    3.0,
                    f64::from(i) / 6.0,
                )
            })
            .collect();
        rangers.push(Self::hc_sr04("down", 0.0, -90.0, 3.0, 5.0 / 6.0));
        Self {
            name: "snsi6".to_owned(),
            rangers,
        }
    }

    fn lidar60() -> Self {
        let part_deg = 36.0;
        let rangers = (0..10u8)
            .map(|i| RangerConfig {
                name: format!("laser{i}"),
                kind: RangerKind::Laser,
                bearing_deg: -162.0 + part_deg * f64::from(i),
                elevation_deg: 0.0,
                offset_m: [0.0; 3],
                columns: 6,
                field_of_view_deg: part_deg,
                // Of the ray, not of the column: what lies between two rays is not seen.
                half_cone_deg: 0.4,
                min_m: 0.15,
                max_m: 12.0,
                rate_hz: 10.0,
                phase: f64::from(i) / 10.0,
                source: sim(),
            })
            .collect();
        Self {
            name: "lidar60".to_owned(),
            rangers,
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// Names the ranger and the allowed range.
    pub fn check(&self) -> Result<(), RingError> {
        for r in &self.rangers {
            let bad = |what: String| {
                Err(RingError::Ranger {
                    ranger: r.name.clone(),
                    what,
                })
            };
            let finite = [
                r.bearing_deg,
                r.elevation_deg,
                r.field_of_view_deg,
                r.half_cone_deg,
                r.min_m,
                r.max_m,
            ]
            .iter()
            .chain(&r.offset_m)
            .all(|v| v.is_finite());
            if !finite {
                return bad("every number must be finite".to_owned());
            }
            if r.columns == 0 || usize::from(r.columns) > MAX_COLUMNS {
                return bad(format!(
                    "columns = {} is outside 1..={MAX_COLUMNS}",
                    r.columns
                ));
            }
            if r.kind == RangerKind::Sonar && r.columns != 1 {
                return bad("a sonar has one column".to_owned());
            }
            if !(0.0..=60.0).contains(&r.half_cone_deg) {
                return bad(format!(
                    "half_cone_deg = {} is outside 0..=60",
                    r.half_cone_deg
                ));
            }
            if !(0.0..=90.0).contains(&r.field_of_view_deg) {
                return bad(format!(
                    "field_of_view_deg = {} is outside 0..=90",
                    r.field_of_view_deg
                ));
            }
            if !(r.min_m >= 0.0 && r.max_m > r.min_m && r.max_m <= 60.0) {
                return bad(format!(
                    "need 0 <= min_m < max_m <= 60, got {} and {}",
                    r.min_m, r.max_m
                ));
            }
            if !(0.1..=200.0).contains(&r.rate_hz) {
                return bad(format!("rate_hz = {} is outside 0.1..=200", r.rate_hz));
            }
            if !(0.0..1.0).contains(&r.phase) {
                return bad(format!("phase = {} is outside 0..1", r.phase));
            }
        }
        let beams = self
            .rangers
            .iter()
            .filter(|r| !r.looks_down())
            .map(|r| usize::from(r.columns))
            .sum();
        if beams > MAX_BEAMS {
            return Err(RingError::TooManyBeams {
                name: self.name.clone(),
                beams,
            });
        }
        Ok(())
    }
}

impl RangerConfig {
    /// True if it looks at the floor: its reading is a height, not a beam of the scan.
    #[must_use]
    pub fn looks_down(&self) -> bool {
        self.elevation_deg <= -80.0
    }

    /// Bearing of a column's ray, clockwise from body forward, rad; column 0 is the left-most seen from the sensor.
    #[must_use]
    pub fn column_bearing_rad(&self, column: usize) -> f64 {
        wrap_pi(self.bearing_deg.to_radians() + self.column_angle_rad(column))
    }

    /// Angle of a column's ray to the sensor axis, clockwise +, rad.
    #[must_use]
    pub fn column_angle_rad(&self, column: usize) -> f64 {
        let n = f64::from(self.columns);
        ((column as f64 + 0.5) / n - 0.5) * self.field_of_view_deg.to_radians()
    }

    /// A reading as beams: metres along each ray.
    #[must_use]
    pub fn beams(&self, reading: &RangerReading) -> ArrayVec<Beam, MAX_COLUMNS> {
        let origin = In::<Frd>::from(self.offset_m);
        let elevation_rad = self.elevation_deg.to_radians();
        reading
            .columns_mm
            .iter()
            .take(usize::from(self.columns))
            .enumerate()
            .map(|(column, depth_mm)| {
                let along_ray = match self.kind {
                    RangerKind::Tof => 1.0 / libm::cos(self.column_angle_rad(column)),
                    RangerKind::Sonar | RangerKind::Laser => 1.0,
                };
                let distance_m = depth_mm.map(|mm| f64::from(mm) * 1e-3 * along_ray);
                Beam {
                    origin,
                    bearing_rad: self.column_bearing_rad(column),
                    elevation_rad,
                    half_cone_rad: self.half_cone_deg.to_radians(),
                    distance_m: distance_m
                        .filter(|d| (self.min_m..=self.max_m * along_ray).contains(d)),
                    min_m: self.min_m,
                    max_m: self.max_m * along_ray,
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Timestamp;
    use approx::assert_abs_diff_eq;

    #[test]
    fn every_built_in_ring_is_valid() {
        for name in RingConfig::BUILT_IN {
            RingConfig::built_in(name).unwrap().check().unwrap();
        }
    }

    #[test]
    fn a_flat_wall_gives_equal_depths_and_longer_rays_at_the_edge() {
        let ring = RingConfig::built_in("tof32").unwrap();
        let reading = RangerReading {
            at: Timestamp::ZERO,
            ranger: 0,
            columns_mm: [Some(1000); 8].into_iter().collect(),
        };
        let beams = ring.rangers[0].beams(&reading);
        assert_abs_diff_eq!(beams[0].bearing_rad.to_degrees(), -19.6875, epsilon = 1e-9);
        assert_abs_diff_eq!(
            beams[0].distance_m.unwrap(),
            1.0 / libm::cos(19.6875_f64.to_radians()),
            epsilon = 1e-12
        );
        assert_abs_diff_eq!(
            beams[0].distance_m.unwrap(),
            beams[7].distance_m.unwrap(),
            epsilon = 1e-12
        );
    }

    #[test]
    fn a_wrong_value_names_ranger_and_range() {
        let mut ring = RingConfig::built_in("sonar8").unwrap();
        ring.rangers[2].rate_hz = 1000.0;
        assert_eq!(
            ring.check().unwrap_err().to_string(),
            "ranger `90deg`: rate_hz = 1000 is outside 0.1..=200"
        );
        assert!(
            RingConfig::built_in("tof64")
                .unwrap_err()
                .to_string()
                .contains("tof32, sonar8, snsi6, lidar60")
        );
    }
}
