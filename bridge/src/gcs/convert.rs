//! Every scale factor, sign and sentinel between our types and MAVLink: geography, modes, codes, quaternions.
//!
//! | Here | On the wire |
//! | --- | --- |
//! | NED about home, m | latitude and longitude in 1e-7 degrees, altitude in mm or m above mean sea level |
//! | [`Mode`] | PX4 `custom_mode`, `base_mode`, MAV_STANDARD_MODE |
//! | none | NaN, `u16::MAX`, `i16::MAX` or -1, as the field says |
//! | heading in (-pi, pi] | centidegrees or degrees in 0..360 |
//!
//! Geography: `lat = lat0 + x/R`, `lon = lon0 + y/(R cos lat0)`, `alt = alt0 - z`, R = 6378137 m (WGS 84 equator). On the
//! scale of a building the sphere and the ellipsoid differ by millimetres; 1e-7 degree is 1.1 cm.

use super::params::GroundParams;
use crate::autopilot::door::{LandedState, MissionState, Refusal, RefusalClass, Severity};
use crate::autopilot::mode::Mode;
use core::f64::consts::TAU;
use mavlink_dialect::command::result;
use mavlink_dialect::mode::{
    FLAG_ARMED, FLAG_AUTO, FLAG_CUSTOM, FLAG_GUIDED, FLAG_MANUAL, FLAG_STABILIZE, Px4Mode,
};
use vehicle::{In, Ned, Rot};

/// Radius of the sphere that carries the plan, m (WGS 84 equator).
pub const EARTH_RADIUS_M: f64 = 6_378_137.0;

/// A place on the globe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeoPoint {
    /// Latitude, 1e-7 degrees.
    pub lat_e7: i32,
    /// Longitude, 1e-7 degrees.
    pub lon_e7: i32,
    /// Above mean sea level, m.
    pub alt_m: f64,
}

/// Where home lies on the globe: what makes a vehicle without satellites readable to map displays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeoAnchor {
    lat0_e7: i32,
    lon0_e7: i32,
    alt0_m: f64,
    cos_lat0: f64,
}

/// Metres of one 1e-7 degree of latitude.
const METRES_PER_E7: f64 = EARTH_RADIUS_M * TAU / 360.0 * 1e-7;

impl GeoAnchor {
    /// Home's latitude and longitude (1e-7 degrees) and altitude above mean sea level (m).
    #[must_use]
    pub fn new(lat0_e7: i32, lon0_e7: i32, alt0_m: f64) -> Self {
        let cos_lat0 = libm::cos((f64::from(lat0_e7) * 1e-7).to_radians());
        Self {
            lat0_e7,
            lon0_e7,
            alt0_m,
            cos_lat0,
        }
    }

    /// The anchor of the parameters KST_LAT0, KST_LON0, KST_ALT0.
    #[must_use]
    pub fn from_params(params: &GroundParams) -> Self {
        Self::new(params.lat0_e7, params.lon0_e7, params.alt0_m)
    }

    /// The globe point of home's zero (MAVLink GPS_GLOBAL_ORIGIN).
    #[must_use]
    pub const fn origin(&self) -> GeoPoint {
        GeoPoint {
            lat_e7: self.lat0_e7,
            lon_e7: self.lon0_e7,
            alt_m: self.alt0_m,
        }
    }

    /// A point of the world on the globe, rounded to 1e-7 degrees.
    #[must_use]
    pub fn to_global(&self, p: In<Ned>) -> GeoPoint {
        GeoPoint {
            lat_e7: to_i32(f64::from(self.lat0_e7) + p.x() / METRES_PER_E7),
            lon_e7: to_i32(f64::from(self.lon0_e7) + p.y() / (METRES_PER_E7 * self.cos_lat0)),
            alt_m: self.alt0_m - p.z(),
        }
    }

    /// Latitude and longitude of a point of the world, degrees, not rounded.
    #[must_use]
    pub fn to_degrees(&self, p: In<Ned>) -> [f64; 2] {
        [
            (f64::from(self.lat0_e7) + p.x() / METRES_PER_E7) * 1e-7,
            (f64::from(self.lon0_e7) + p.y() / (METRES_PER_E7 * self.cos_lat0)) * 1e-7,
        ]
    }

    /// A point of the globe (1e-7 degrees, m above mean sea level) in the world. Longitudes are taken the short way
    /// round.
    #[must_use]
    pub fn to_ned(&self, lat_e7: i32, lon_e7: i32, alt_amsl_m: f64) -> In<Ned> {
        In::new(
            self.north_of(lat_e7),
            self.east_of(lon_e7),
            self.down_of_amsl(alt_amsl_m),
        )
    }

    /// NED x of a latitude (1e-7 degrees), m.
    #[must_use]
    pub fn north_of(&self, lat_e7: i32) -> f64 {
        (f64::from(lat_e7) - f64::from(self.lat0_e7)) * METRES_PER_E7
    }

    /// NED y of a longitude (1e-7 degrees), m.
    #[must_use]
    pub fn east_of(&self, lon_e7: i32) -> f64 {
        const FULL_TURN_E7: f64 = 3.6e9;
        let turn = f64::from(lon_e7) - f64::from(self.lon0_e7);
        let short = turn - FULL_TURN_E7 * libm::round(turn / FULL_TURN_E7);
        short * METRES_PER_E7 * self.cos_lat0
    }

    /// NED z of an altitude above mean sea level, m.
    #[must_use]
    pub fn down_of_amsl(&self, alt_amsl_m: f64) -> f64 {
        self.alt0_m - alt_amsl_m
    }

    /// NED z of an altitude above home, m. `home` is the snapshot's, NED.
    #[must_use]
    pub fn down_of_relative(&self, alt_relative_m: f64, home: &In<Ned>) -> f64 {
        home.z() - alt_relative_m
    }
}

/// PX4's number of a mode (`px4_custom_mode.h`).
#[must_use]
pub const fn mode_to_px4(mode: Mode) -> Px4Mode {
    let (main, sub) = match mode {
        Mode::Altitude => (2, 0),
        Mode::Position => (3, 0),
        Mode::Takeoff => (4, 2),
        Mode::Hold => (4, 3),
        Mode::Mission => (4, 4),
        Mode::Return => (4, 5),
        Mode::Land => (4, 6),
        Mode::Offboard => (6, 0),
        Mode::Stabilized => (7, 0),
    };
    Px4Mode { main, sub }
}

/// The mode of PX4's number; none for modes we do not fly (acro, follow me ...).
#[must_use]
pub const fn mode_from_px4(px4: Px4Mode) -> Option<Mode> {
    Some(match (px4.main, px4.sub) {
        // PX4's Manual of a multicopter is Stabilized.
        (1 | 7, 0) => Mode::Stabilized,
        (2, 0) => Mode::Altitude,
        (3, 0) => Mode::Position,
        (4, 2) => Mode::Takeoff,
        (4, 3) => Mode::Hold,
        (4, 4) => Mode::Mission,
        (4, 5) => Mode::Return,
        (4, 6) => Mode::Land,
        (6, 0) => Mode::Offboard,
        _ => return None,
    })
}

/// MAV_STANDARD_MODE of a mode, 0 where MAVLink has none.
#[must_use]
pub const fn standard_mode(mode: Mode) -> u8 {
    match mode {
        Mode::Hold | Mode::Offboard | Mode::Stabilized => 0,
        Mode::Position => 1,
        Mode::Altitude => 4,
        Mode::Return => 5,
        Mode::Mission => 6,
        Mode::Land => 7,
        Mode::Takeoff => 8,
    }
}

/// The mode of a MAV_STANDARD_MODE (MAV_CMD_DO_SET_STANDARD_MODE).
#[must_use]
pub const fn mode_from_standard(standard: u8) -> Option<Mode> {
    Some(match standard {
        1 => Mode::Position,
        4 => Mode::Altitude,
        5 => Mode::Return,
        6 => Mode::Mission,
        7 => Mode::Land,
        8 => Mode::Takeoff,
        _ => return None,
    })
}

/// HEARTBEAT.base_mode.
#[must_use]
pub const fn base_mode(mode: Mode, is_armed: bool) -> u8 {
    let how = match mode {
        Mode::Altitude | Mode::Position | Mode::Stabilized => FLAG_MANUAL | FLAG_STABILIZE,
        Mode::Offboard => FLAG_STABILIZE | FLAG_GUIDED,
        Mode::Hold | Mode::Land | Mode::Mission | Mode::Return | Mode::Takeoff => {
            FLAG_STABILIZE | FLAG_GUIDED | FLAG_AUTO
        }
    };
    FLAG_CUSTOM | how | if is_armed { FLAG_ARMED } else { 0 }
}

/// MAV_RESULT of a refusal.
#[must_use]
pub const fn result_of_refusal(refusal: &Refusal) -> u8 {
    match refusal.class() {
        RefusalClass::NotNow => result::TEMPORARILY_REJECTED,
        RefusalClass::Denied => result::DENIED,
        RefusalClass::Unsupported => result::UNSUPPORTED,
    }
}

/// MISSION_STATE.
#[must_use]
pub const fn mission_state_code(state: MissionState) -> u8 {
    match state {
        MissionState::None => 1,
        MissionState::NotStarted => 2,
        MissionState::Active => 3,
        MissionState::Paused => 4,
        MissionState::Complete => 5,
    }
}

/// MAV_LANDED_STATE.
#[must_use]
pub const fn landed_state_code(state: LandedState) -> u8 {
    match state {
        LandedState::OnGround => 1,
        LandedState::InAir => 2,
        LandedState::TakingOff => 3,
        LandedState::Landing => 4,
    }
}

/// MAV_SEVERITY.
#[must_use]
pub const fn severity_code(severity: Severity) -> u8 {
    match severity {
        Severity::Critical => 2,
        Severity::Error => 3,
        Severity::Warning => 4,
        Severity::Notice => 5,
        Severity::Info => 6,
    }
}

/// A rotation as MAVLink writes quaternions: w, x, y, z, with w not negative.
#[must_use]
pub fn quaternion<A, B>(rotation: &Rot<A, B>) -> [f32; 4] {
    let [w, x, y, z]: [f64; 4] = (*rotation).into();
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    [w, x, y, z].map(|c| (sign * c) as f32)
}

/// What a client gave: none for NaN and infinities, which mean "not given".
#[must_use]
pub fn finite(value: f32) -> Option<f64> {
    value.is_finite().then(|| f64::from(value))
}

/// Heading as centidegrees in 0..36000.
#[must_use]
pub fn heading_cdeg(yaw_rad: f64) -> u16 {
    (libm::round(turn_fraction(yaw_rad) * 36_000.0) as u16) % 36_000
}

/// Heading as whole degrees in 0..360.
#[must_use]
pub fn heading_deg(yaw_rad: f64) -> i16 {
    (libm::round(turn_fraction(yaw_rad) * 360.0) as i16) % 360
}

/// Share of a full turn, 0..1.
fn turn_fraction(yaw_rad: f64) -> f64 {
    let turns = yaw_rad / TAU;
    if turns.is_finite() {
        turns - libm::floor(turns)
    } else {
        0.0
    }
}

/// Rounded into an i32; NaN gives 0, what does not fit the nearest that does.
#[must_use]
pub fn to_i32(value: f64) -> i32 {
    libm::round(value) as i32
}

/// Rounded into an i16; NaN gives 0, what does not fit the nearest that does.
#[must_use]
pub fn to_i16(value: f64) -> i16 {
    libm::round(value) as i16
}

/// Rounded into a u16; NaN gives 0, what does not fit the nearest that does. `u16::MAX` is kept free: it means unknown.
#[must_use]
pub fn to_u16(value: f64) -> u16 {
    (libm::round(value) as u16).min(u16::MAX - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HOME: (i32, i32) = (473_977_420, 85_455_940);

    #[test]
    fn one_kilometre_north_is_8983_microdegrees() {
        let geo = GeoAnchor::new(HOME.0, HOME.1, 400.0);
        let p = geo.to_global(In::new(1000.0, 0.0, -2.5));
        assert_eq!((p.lat_e7 - HOME.0, p.lon_e7 - HOME.1), (89_832, 0));
        assert!((p.alt_m - 402.5).abs() < 1e-12);
        assert_eq!(geo.origin().lat_e7, HOME.0);
    }

    #[test]
    fn the_date_line_is_crossed_the_short_way() {
        let geo = GeoAnchor::new(0, 1_799_999_990, 0.0);
        let p = geo.to_ned(0, -1_799_999_990, 0.0);
        assert!((p.y() - 20.0 * METRES_PER_E7).abs() < 1e-6, "{p:?}");
    }

    #[test]
    fn every_mode_comes_back_from_its_number() {
        for mode in Mode::ALL {
            assert_eq!(mode_from_px4(mode_to_px4(mode)), Some(mode));
            let standard = standard_mode(mode);
            assert!(standard == 0 || mode_from_standard(standard) == Some(mode));
        }
        assert_eq!(mode_to_px4(Mode::Hold).custom_mode(), 50_593_792);
        assert_eq!(mode_from_px4(Px4Mode { main: 5, sub: 0 }), None, "acro");
    }

    #[test]
    fn base_mode_says_who_steers() {
        assert_eq!(base_mode(Mode::Hold, true), 128 | 16 | 8 | 4 | 1);
        assert_eq!(base_mode(Mode::Position, false), 64 | 16 | 1);
        assert_eq!(base_mode(Mode::Offboard, false), 16 | 8 | 1);
    }

    #[test]
    fn headings_are_never_a_full_turn() {
        assert_eq!(heading_cdeg(-1e-9), 0);
        assert_eq!(heading_cdeg(-core::f64::consts::FRAC_PI_2), 27_000);
        assert_eq!(heading_deg(-1e-9), 0);
        assert_eq!(heading_cdeg(f64::NAN), 0);
    }

    #[test]
    fn a_number_that_does_not_fit_becomes_the_nearest() {
        assert_eq!(to_u16(70_000.0), u16::MAX - 1);
        assert_eq!(to_u16(-3.0), 0);
        assert_eq!(to_i16(-1e9), i16::MIN);
        assert_eq!(to_i32(f64::NAN), 0);
    }

    proptest! {
        #[test]
        fn global_and_local_agree_to_the_centimetre(x in -500.0..500.0f64, y in -500.0..500.0f64, z in -50.0..50.0f64) {
            let geo = GeoAnchor::new(HOME.0, HOME.1, 31.0);
            let p = geo.to_global(In::new(x, y, z));
            let back = geo.to_ned(p.lat_e7, p.lon_e7, p.alt_m);
            prop_assert!((back.x() - x).abs() <= 0.0057 && (back.y() - y).abs() <= 0.0057 && (back.z() - z).abs() < 1e-9);
        }
    }
}
