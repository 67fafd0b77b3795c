//! Orbit and figure eight, as MAV_CMD_DO_ORBIT and MAV_CMD_DO_FIGURE_EIGHT ask for them.
//!
//! A figure is a closed curve over an angle `phase` that grows by 2 pi a round. The orbit is a circle; the eight is a lemniscate of Gerono,
//! `along = a sin(phase)`, `across = b sin(2 phase)`, whose curvature is zero where it crosses itself.

use core::f64::consts::TAU;
use thiserror::Error;
use vehicle::{In, Ned};

/// Smallest radius, m: below it hovering and turning is meant.
const MIN_RADIUS_M: f64 = 0.2;
/// Largest, m.
const MAX_RADIUS_M: f64 = 200.0;

/// Where the nose points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Nose {
    /// To the centre.
    #[default]
    Centre,
    /// As it did at the start.
    Initial,
    /// Along the way.
    Tangent,
}

/// What is flown around.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Figure {
    /// A circle.
    Orbit {
        /// m.
        radius_m: f64,
        /// Seen from above.
        is_clockwise: bool,
    },
    /// A lying eight.
    Eight {
        /// Centre to its far ends, m.
        major_m: f64,
        /// Half its width, m.
        minor_m: f64,
        /// Direction of the long axis, clockwise from north, rad.
        axis_rad: f64,
        /// The end in that direction is rounded clockwise.
        is_clockwise: bool,
    },
}

/// Why it is not flown.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FigureError {
    /// A number is none, or there is no such figure.
    #[error("radius {radius_m} m: 0.2 to 200 m are flown")]
    Radius {
        /// As asked for.
        radius_m: f64,
    },
    /// A number is none.
    #[error("a value is not a number")]
    NotFinite,
}

impl Figure {
    /// Checks the numbers.
    ///
    /// # Errors
    /// Which is wrong.
    pub fn check(&self) -> Result<(), FigureError> {
        let radii = match *self {
            Self::Orbit { radius_m, .. } => [radius_m, radius_m],
            Self::Eight {
                major_m,
                minor_m,
                axis_rad,
                ..
            } => {
                if !axis_rad.is_finite() {
                    return Err(FigureError::NotFinite);
                }
                [major_m, minor_m]
            }
        };
        match radii
            .into_iter()
            .find(|r| !(MIN_RADIUS_M..=MAX_RADIUS_M).contains(r))
        {
            Some(radius_m) => Err(FigureError::Radius { radius_m }),
            None => Ok(()),
        }
    }

    /// Place about the centre, m, and its derivative by the phase, m/rad: north, east.
    #[must_use]
    pub fn at(&self, phase: f64) -> ([f64; 2], [f64; 2]) {
        match *self {
            Self::Orbit {
                radius_m,
                is_clockwise,
            } => {
                // Clockwise from above is with north towards east.
                let sign = if is_clockwise { 1.0 } else { -1.0 };
                let (s, c) = (libm::sin(phase), libm::cos(phase));
                (
                    [radius_m * c, sign * radius_m * s],
                    [-radius_m * s, sign * radius_m * c],
                )
            }
            Self::Eight {
                major_m,
                minor_m,
                axis_rad,
                is_clockwise,
            } => {
                let sign = if is_clockwise { 1.0 } else { -1.0 };
                let along = major_m * libm::sin(phase);
                let across = -sign * minor_m * libm::sin(2.0 * phase);
                let by = (
                    major_m * libm::cos(phase),
                    -2.0 * sign * minor_m * libm::cos(2.0 * phase),
                );
                let (s, c) = (libm::sin(axis_rad), libm::cos(axis_rad));
                (
                    [along * c - across * s, along * s + across * c],
                    [by.0 * c - by.1 * s, by.0 * s + by.1 * c],
                )
            }
        }
    }

    /// The phase of the place on the figure that is nearest to one, north and east about the centre, m.
    #[must_use]
    pub fn nearest(&self, north_m: f64, east_m: f64) -> f64 {
        let far = |phase: f64| {
            let ([n, e], _) = self.at(phase);
            libm::hypot(n - north_m, e - east_m)
        };
        let (mut best, mut least) = (0.0, f64::INFINITY);
        for i in 0..144 {
            let phase = TAU * f64::from(i) / 144.0;
            if far(phase) < least {
                (best, least) = (phase, far(phase));
            }
        }
        best
    }

    /// Largest speed at which no part of it asks for more than `accel_mps2` sideways, m/s.
    #[must_use]
    pub fn fastest_mps(&self, accel_mps2: f64) -> f64 {
        let step = TAU / 720.0;
        let mut most_curved = 1e-6_f64;
        for i in 0..720 {
            let phase = step * f64::from(i);
            let (_, [n1, e1]) = self.at(phase);
            let (_, [n2, e2]) = self.at(phase + step);
            let turned = libm::atan2(n1 * e2 - e1 * n2, n1 * n2 + e1 * e2).abs();
            let way_m = 0.5 * (libm::hypot(n1, e1) + libm::hypot(n2, e2)) * step;
            most_curved = most_curved.max(turned / way_m.max(1e-9));
        }
        libm::sqrt(accel_mps2 / most_curved)
    }

    /// Places all along it about a centre, for checks.
    pub fn outline(&self, centre: In<Ned>) -> impl Iterator<Item = In<Ned>> + use<> {
        let figure = *self;
        (0..144).map(move |i| {
            let ([n, e], _) = figure.at(TAU * f64::from(i) / 144.0);
            centre + In::new(n, e, 0.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_PI_2;

    const ORBIT: Figure = Figure::Orbit {
        radius_m: 2.0,
        is_clockwise: true,
    };
    const EIGHT: Figure = Figure::Eight {
        major_m: 2.0,
        minor_m: 0.8,
        axis_rad: 0.7,
        is_clockwise: true,
    };

    #[test]
    fn a_clockwise_orbit_goes_from_north_to_east() {
        let ([n, e], [dn, de]) = ORBIT.at(0.0);
        assert!((n - 2.0).abs() < 1e-12 && e.abs() < 1e-12 && dn.abs() < 1e-12 && de > 0.0);
        let ([n, e], _) = ORBIT.at(FRAC_PI_2);
        assert!(n.abs() < 1e-12 && (e - 2.0).abs() < 1e-12);
    }

    #[test]
    fn the_northern_end_of_a_clockwise_eight_is_rounded_clockwise() {
        let eight = Figure::Eight {
            major_m: 2.0,
            minor_m: 0.8,
            axis_rad: 0.0,
            is_clockwise: true,
        };
        // At the northern end it goes east.
        let ([n, e], [_, de]) = eight.at(FRAC_PI_2);
        assert!((n - 2.0).abs() < 1e-12 && e.abs() < 1e-9 && de > 0.0);
    }

    #[test]
    fn slopes_are_those_of_the_places() {
        for figure in [ORBIT, EIGHT] {
            for i in 0..50 {
                let phase = 0.13 * f64::from(i);
                let (a, slope) = figure.at(phase);
                let (b, _) = figure.at(phase + 1e-6);
                for k in 0..2 {
                    assert!(((b[k] - a[k]) / 1e-6 - slope[k]).abs() < 1e-4);
                }
            }
        }
    }

    #[test]
    fn speed_on_a_circle_follows_from_the_radius() {
        assert!((ORBIT.fastest_mps(1.0) - libm::sqrt(2.0)).abs() < 1e-3);
        assert!(EIGHT.fastest_mps(1.0) < ORBIT.fastest_mps(1.0));
    }

    #[test]
    fn figures_that_are_none_are_refused() {
        for radius_m in [0.0, -1.0, f64::NAN, 1e6, 0.1] {
            let orbit = Figure::Orbit {
                radius_m,
                is_clockwise: true,
            };
            assert!(orbit.check().is_err(), "{radius_m}");
        }
        assert!(EIGHT.check().is_ok());
    }

    #[test]
    fn the_nearest_phase_is_on_the_near_side() {
        let phase = ORBIT.nearest(0.0, 5.0);
        assert!((phase - FRAC_PI_2).abs() < 0.03);
    }
}
