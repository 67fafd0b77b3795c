//! Latitude and longitude to metres: Universal Transverse Mercator on WGS84, for a GPS in the position slot of a filter.
//!
//! The series is that of Coticchia and Surace (Bollettino di Geodesia e Scienze Affini, 1978), good to centimetres within a zone; uQuad uses it.
//!
//! **uQuad's quirk**: south of the equator its program adds 9 999 999 m to the northing, the standard adds 10 000 000. Nobody noticed, because positions are
//! taken relative to the start; [`SouthernOffset`] keeps both so that recorded northings can be compared.
//!
//! ```
//! use estimator::utm::{SouthernOffset, Utm};
//! let montevideo = Utm::from_degrees(-34.919363, -56.167382, SouthernOffset::Standard).unwrap();
//! assert_eq!((montevideo.zone, montevideo.band), (21, 'H'));
//! assert!((montevideo.easting_m - 576_053.161_1).abs() < 1e-3);
//! ```

use core::fmt;

/// Polar radius of curvature of WGS84, m.
const C: f64 = 6_399_593.625_758_67;
/// Second eccentricity of WGS84, squared.
const E2: f64 = 0.006_739_496_742_333_46;
/// Scale on the central meridian.
const K0: f64 = 0.9996;
/// Easting of the central meridian, m.
const FALSE_EASTING_M: f64 = 500_000.0;
/// Bands of 8 degrees from 80 south on; the last one has 12.
const BANDS: [char; 20] = [
    'C', 'D', 'E', 'F', 'G', 'H', 'J', 'K', 'L', 'M', 'N', 'P', 'Q', 'R', 'S', 'T', 'U', 'V', 'W',
    'X',
];

/// What is added to northings south of the equator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SouthernOffset {
    /// 10 000 000 m.
    #[default]
    Standard,
    /// 9 999 999 m, as in uQuad's program.
    Uquad,
}

/// A place in UTM.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Utm {
    /// Easting, m.
    pub easting_m: f64,
    /// Northing, m.
    pub northing_m: f64,
    /// Zone, 1..=60.
    pub zone: u8,
    /// Band, C..=X.
    pub band: char,
}

/// A place that UTM does not cover, or that is no number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotInUtm {
    /// Latitude, degrees.
    pub latitude_deg: f64,
    /// Longitude, degrees.
    pub longitude_deg: f64,
}

impl fmt::Display for NotInUtm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "latitude {}, longitude {}: UTM covers 80 S - 84 N, 180 W - 180 E",
            self.latitude_deg, self.longitude_deg
        )
    }
}

impl core::error::Error for NotInUtm {}

impl Utm {
    /// From degrees, north and east positive.
    ///
    /// # Errors
    ///
    /// When the place is not covered.
    pub fn from_degrees(
        latitude_deg: f64,
        longitude_deg: f64,
        south: SouthernOffset,
    ) -> Result<Self, NotInUtm> {
        if !((-80.0..=84.0).contains(&latitude_deg) && (-180.0..=180.0).contains(&longitude_deg)) {
            return Err(NotInUtm {
                latitude_deg,
                longitude_deg,
            });
        }
        // 180 E is 180 W.
        let zone = (libm::floor(longitude_deg / 6.0 + 31.0) as u8 - 1) % 60 + 1;
        let mut from_meridian_deg = longitude_deg - (f64::from(zone) * 6.0 - 183.0);
        if from_meridian_deg > 180.0 {
            from_meridian_deg -= 360.0;
        }
        let band = BANDS[(libm::floor((latitude_deg + 80.0) / 8.0) as usize).min(BANDS.len() - 1)];
        let (easting_m, mut northing_m) =
            transverse_mercator(latitude_deg.to_radians(), from_meridian_deg.to_radians());
        if latitude_deg < 0.0 {
            northing_m += match south {
                SouthernOffset::Standard => 10_000_000.0,
                SouthernOffset::Uquad => 9_999_999.0,
            };
        }
        Ok(Self {
            easting_m,
            northing_m,
            zone,
            band,
        })
    }

    /// East and north of another place of the same zone, m; none across zones.
    #[must_use]
    pub fn relative_to(&self, start: &Self) -> Option<[f64; 2]> {
        (self.zone == start.zone).then_some([
            self.easting_m - start.easting_m,
            self.northing_m - start.northing_m,
        ])
    }
}

/// Easting and northing (without southern offset) of a latitude and a longitude from the central meridian, rad.
fn transverse_mercator(phi: f64, lambda: f64) -> (f64, f64) {
    let (cos_phi, sin_2phi) = (libm::cos(phi), libm::sin(2.0 * phi));
    let cos2 = cos_phi * cos_phi;
    let a = cos_phi * libm::sin(lambda);
    let xi = 0.5 * libm::log((1.0 + a) / (1.0 - a));
    let eta = libm::atan(libm::tan(phi) / libm::cos(lambda)) - phi;
    let nu = C * K0 / libm::sqrt(1.0 + E2 * cos2);
    let zeta = E2 / 2.0 * xi * xi * cos2;

    // Length of the meridian.
    let a2 = sin_2phi * cos2;
    let j2 = phi + sin_2phi / 2.0;
    let j4 = (3.0 * j2 + a2) / 4.0;
    let j6 = (5.0 * j4 + a2 * cos2) / 3.0;
    let alpha = 0.75 * E2;
    let beta = 5.0 / 3.0 * alpha * alpha;
    let gamma = 35.0 / 27.0 * alpha * alpha * alpha;
    let meridian = K0 * C * (phi - alpha * j2 + beta * j4 - gamma * j6);

    (
        xi * nu * (1.0 + zeta / 3.0) + FALSE_EASTING_M,
        eta * nu * (1.0 + zeta) + meridian,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_point_in_montevideo_with_both_southern_offsets() {
        let at = |south| Utm::from_degrees(-34.919363, -56.167382, south).unwrap();
        let seed = at(SouthernOffset::Uquad);
        assert!(
            (seed.easting_m - 576_053.161_1).abs() < 1e-4,
            "{}",
            seed.easting_m
        );
        assert!(
            (seed.northing_m - 6_135_581.891_9).abs() < 1e-4,
            "{}",
            seed.northing_m
        );
        let standard = at(SouthernOffset::Standard);
        assert!((standard.northing_m - 6_135_582.891_9).abs() < 1e-4);
        assert_eq!((seed.zone, seed.band), (21, 'H'));
    }

    #[test]
    fn the_central_meridian_at_the_equator_is_500_km_east() {
        let u = Utm::from_degrees(0.0, 3.0, SouthernOffset::Standard).unwrap();
        assert!((u.easting_m - 500_000.0).abs() < 1e-6 && u.northing_m.abs() < 1e-6);
        assert_eq!((u.zone, u.band), (31, 'N'));
    }

    #[test]
    fn a_thousandth_of_a_degree_north_is_111_m() {
        let at = |lat| Utm::from_degrees(lat, 9.0, SouthernOffset::Standard).unwrap();
        let [east, north] = at(48.001).relative_to(&at(48.0)).unwrap();
        assert!(
            east.abs() < 1e-6 && (north - 111.2 * K0).abs() < 0.1,
            "{north}"
        );
    }

    #[test]
    fn the_date_line_and_the_ends_of_the_bands_have_zones() {
        let at = |lat, lon| Utm::from_degrees(lat, lon, SouthernOffset::Standard).unwrap();
        assert_eq!(at(0.0, -180.0).zone, 1);
        assert_eq!(at(0.0, 180.0).zone, 1);
        assert!((at(10.0, 180.0).easting_m - at(10.0, -180.0).easting_m).abs() < 1e-6);
        assert_eq!(at(0.0, 179.999).zone, 60);
        assert_eq!((at(-80.0, 0.0).band, at(84.0, 0.0).band), ('C', 'X'));
        assert_eq!(at(0.0, 5.0).relative_to(&at(0.0, 7.0)), None);
    }

    #[test]
    fn poles_and_what_is_no_number_are_refused() {
        for (lat, lon) in [
            (85.0, 0.0),
            (-81.0, 0.0),
            (0.0, 181.0),
            (f64::NAN, 0.0),
            (0.0, f64::INFINITY),
        ] {
            assert!(Utm::from_degrees(lat, lon, SouthernOffset::Standard).is_err());
        }
    }
}
