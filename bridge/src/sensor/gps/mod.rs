//! Satellite receivers: where fixes come from, and metres from where the first one was.
//!
//! | Source | Driver |
//! | --- | --- |
//! | gpsd's JSON over TCP | [`gpsd`] |
//! | a log in uQuad's columns, in its own time | [`log`] |
//! | invented: zeros, or anywhere near | [`fake`] |
//! | the flight controller (MSP_RAW_GPS) | `autopilot/flight/controller.rs`, parameter KST_FC_GPS |
//!
//! As in uQuad the position is UTM on WGS84 relative to the first 3D fix ([`Start`]), which must come within
//! [`PATIENCE`]; a fix without its uncertainties is not news. uQuad adds 9 999 999 m to southern northings where the
//! standard adds 10 000 000; relative to a start on the same side of the equator both are the same, across it they are not, so
//! the standard is the default and the quirk can be had ([`estimator::utm::SouthernOffset`]).
//!
//! uQuad's velocity north is `-speed cos(track)`, marked there as not verified. With y to the north it must be
//! `+speed cos(track)`, which is used here.

pub mod fake;
pub mod gpsd;
pub mod log;

use core::time::Duration;
use estimator::utm::{SouthernOffset, Utm};
use vehicle::{GnssFix, In, Ned, Timestamp};

/// The first 3D fix must come within this (uQuad's rule).
pub const PATIENCE: Duration = Duration::from_secs(60);

/// What a receiver says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RawFix {
    /// 0 and 1 none, 2 two-dimensional, 3 three-dimensional.
    pub mode: u8,
    /// Latitude and longitude, degrees, north and east positive.
    pub place_deg: [f64; 2],
    /// Above mean sea level, m.
    pub altitude_m: f64,
    /// Over ground, m/s.
    pub speed_mps: Option<f64>,
    /// Course over ground, clockwise from north, degrees.
    pub track_deg: Option<f64>,
    /// Up, m/s.
    pub climb_mps: Option<f64>,
    /// Doubt east, north, up, m.
    pub doubt_m: Option<[f64; 3]>,
    /// Satellites in use, 0 if not told.
    pub satellites: u8,
}

/// Why a fix was not news.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoNews {
    /// Not three-dimensional.
    NoFix,
    /// Without uncertainties.
    NoDoubt,
    /// Outside UTM, or in another zone than the start.
    Place,
}

/// Takes fixes relative to the first.
#[derive(Clone, Copy, Debug, Default)]
pub struct Start {
    south: SouthernOffset,
    zero: Option<(Utm, f64)>,
}

impl Start {
    /// Nothing known yet.
    #[must_use]
    pub const fn new(south: SouthernOffset) -> Self {
        Self { south, zero: None }
    }

    /// The first fix has come.
    #[must_use]
    pub const fn is_set(&self) -> bool {
        self.zero.is_some()
    }

    /// A fix in metres from the first.
    ///
    /// # Errors
    /// Why it is no news.
    pub fn relative(&mut self, at: Timestamp, raw: &RawFix) -> Result<GnssFix, NoNews> {
        if raw.mode < 3 {
            return Err(NoNews::NoFix);
        }
        let Some([east_m, north_m, up_m]) = raw
            .doubt_m
            .filter(|d| d.iter().all(|v| *v > 0.0 && v.is_finite()))
        else {
            return Err(NoNews::NoDoubt);
        };
        let [lat, lon] = raw.place_deg;
        let here = Utm::from_degrees(lat, lon, self.south).map_err(|_| NoNews::Place)?;
        if !raw.altitude_m.is_finite() {
            return Err(NoNews::Place);
        }
        let (zero, zero_m) = *self.zero.get_or_insert((here, raw.altitude_m));
        let [east, north] = here.relative_to(&zero).ok_or(NoNews::Place)?;
        Ok(GnssFix {
            at,
            position: In::new(north, east, zero_m - raw.altitude_m),
            velocity: velocity(raw),
            std_m: [
                libm::hypot(east_m, north_m) * core::f64::consts::FRAC_1_SQRT_2,
                up_m,
            ],
            place_deg: raw.place_deg,
            altitude_m: raw.altitude_m,
            satellites: raw.satellites,
        })
    }
}

fn velocity(raw: &RawFix) -> Option<In<Ned>> {
    let (speed, track) = (raw.speed_mps?, raw.track_deg?);
    let (s, c) = libm::sincos(track.to_radians());
    let v = In::new(speed * c, speed * s, -raw.climb_mps.unwrap_or(0.0));
    v.is_finite().then_some(v)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(lat: f64, lon: f64) -> RawFix {
        RawFix {
            mode: 3,
            place_deg: [lat, lon],
            altitude_m: 40.0,
            doubt_m: Some([2.0, 2.0, 5.0]),
            ..RawFix::default()
        }
    }

    #[test]
    fn the_first_fix_is_zero_and_the_next_is_metres_from_it() {
        let mut start = Start::new(SouthernOffset::Standard);
        let at = Timestamp::from_ms(5);
        let first = start.relative(at, &raw(-34.919363, -56.167382)).unwrap();
        assert_eq!(first.position, In::zero());
        let north = RawFix {
            altitude_m: 43.0,
            speed_mps: Some(2.0),
            track_deg: Some(90.0),
            climb_mps: Some(0.5),
            ..raw(-34.918363, -56.167382)
        };
        let fix = start.relative(at, &north).unwrap();
        assert!(
            (fix.position.x() - 110.9).abs() < 0.2 && fix.position.y().abs() < 2.0,
            "{:?}",
            fix.position
        );
        assert!((fix.position.z() + 3.0).abs() < 1e-9);
        let v = fix.velocity.unwrap();
        assert!(v.x().abs() < 1e-9 && (v.y() - 2.0).abs() < 1e-9 && (v.z() + 0.5).abs() < 1e-9);
        assert!((fix.std_m[0] - 2.0).abs() < 1e-9);
    }

    #[test]
    fn north_of_course_zero_is_positive_unlike_the_seed() {
        let v = velocity(&RawFix {
            speed_mps: Some(1.0),
            track_deg: Some(0.0),
            ..raw(0.0, 0.0)
        })
        .unwrap();
        assert!((v.x() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn without_a_3d_fix_or_its_doubt_there_is_no_news() {
        let mut start = Start::default();
        let at = Timestamp::ZERO;
        assert_eq!(
            start.relative(
                at,
                &RawFix {
                    mode: 2,
                    ..raw(1.0, 1.0)
                }
            ),
            Err(NoNews::NoFix)
        );
        assert_eq!(
            start.relative(
                at,
                &RawFix {
                    doubt_m: None,
                    ..raw(1.0, 1.0)
                }
            ),
            Err(NoNews::NoDoubt)
        );
        assert_eq!(start.relative(at, &raw(89.0, 1.0)), Err(NoNews::Place));
        assert!(!start.is_set());
        start.relative(at, &raw(1.0, 1.0)).unwrap();
        assert_eq!(
            start.relative(at, &raw(1.0, 9.0)),
            Err(NoNews::Place),
            "another zone"
        );
    }

    #[test]
    fn the_quirk_shows_only_across_the_equator() {
        let across = |south| {
            let mut start = Start::new(south);
            start.relative(Timestamp::ZERO, &raw(0.0001, 9.0)).unwrap();
            start
                .relative(Timestamp::ZERO, &raw(-0.0001, 9.0))
                .unwrap()
                .position
                .x()
        };
        let (standard, seed) = (
            across(SouthernOffset::Standard),
            across(SouthernOffset::Uquad),
        );
        assert!((standard - seed - 1.0).abs() < 1e-6, "{standard} {seed}");
    }
}
