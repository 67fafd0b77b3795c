//! The driver's units, and what a motor may be asked for.
//!
//! **The pair of limits.** The thesis allows 387 rad/s, its driver 220 units; the conversion makes 241 of 387, so the driver refused what the
//! control was told it may ask. The pair is one here: 220 units are 368.16 rad/s, and nothing above is sent.

use std::fmt;
use vehicle::uquad::{DRIVER_SPEED_RADPS, MAX_SPEED_RADPS};

/// Largest value the driver accepts.
pub const MAX_UNITS: u8 = 220;
/// All four motors must be asked for more than this to be started.
pub const START_ABOVE_UNITS: u8 = 45;
/// Turning without lifting, about 105 rad/s.
pub const IDLE_UNITS: u8 = 50;

/// Cubic, square and linear factor of the conversion, measured by the thesis on its motors.
const CUBIC: [f64; 3] = [
    3.250_387_423_510_62e-6,
    -0.001_073_450_943_483_45,
    0.552_199_572_510_559,
];

/// One motor's speed (rad/s) in the driver's units, rounded, limited to 0..=[`MAX_UNITS`]. What is no number is 0.
#[must_use]
pub fn units(speed_radps: f64) -> u8 {
    let exact = unlimited_units(speed_radps.clamp(0.0, MAX_SPEED_RADPS));
    // Casting saturates and makes 0 of NaN.
    (libm::round(exact) as u8).min(MAX_UNITS)
}

/// The conversion itself: 387 rad/s are 241.
fn unlimited_units(w: f64) -> f64 {
    ((CUBIC[0] * w + CUBIC[1]) * w + CUBIC[2]) * w
}

/// What a turning motor may be asked for, rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedRange {
    /// Slowest.
    pub slowest_radps: f64,
    /// Fastest.
    pub fastest_radps: f64,
}

/// A speed that was asked for out of range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limited {
    /// Motor, from 0.
    pub motor: usize,
    /// As asked for, rad/s.
    pub asked_radps: f64,
    /// As given, rad/s.
    pub given_radps: f64,
}

impl fmt::Display for Limited {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "motor {} was asked for {:.1} rad/s and gets {:.1}",
            self.motor, self.asked_radps, self.given_radps
        )
    }
}

impl SpeedRange {
    /// From idle to what the driver accepts.
    #[must_use]
    pub const fn turning() -> Self {
        Self {
            slowest_radps: 105.0,
            fastest_radps: DRIVER_SPEED_RADPS,
        }
    }

    /// Around a hover speed: as far below it as the fastest motor (387 rad/s) is above, never beyond what the driver accepts.
    #[must_use]
    pub fn around(hover_radps: f64) -> Self {
        let slowest = (2.0 * hover_radps - MAX_SPEED_RADPS).clamp(0.0, DRIVER_SPEED_RADPS);
        Self {
            slowest_radps: slowest,
            fastest_radps: DRIVER_SPEED_RADPS,
        }
    }

    /// The nearest speed in range, and a report when it is another one. What is no number becomes the slowest.
    #[must_use]
    pub fn limit(&self, motor: usize, asked_radps: f64) -> (f64, Option<Limited>) {
        let given_radps = if asked_radps.is_nan() {
            self.slowest_radps
        } else {
            asked_radps.clamp(self.slowest_radps, self.fastest_radps)
        };
        let is_same = (given_radps - asked_radps).abs() <= 0.0;
        let limited = Limited {
            motor,
            asked_radps,
            given_radps,
        };
        (given_radps, (!is_same).then_some(limited))
    }
}

/// A line of four numbers for the bench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// The driver's units, 0 to [`MAX_UNITS`], motors in the order of the craft.
    Units([u8; 4]),
    /// rad/s; 0 stops.
    Speeds([f64; 4]),
}

/// Why a line is no order.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OrderError {
    /// Not four words.
    #[error("{0} numbers: four are needed, one a motor (front left rear right)")]
    Count(usize),
    /// Not a number, or not one that a motor can do.
    #[error("motor {motor}: `{word}` is no number from 0 to {most}")]
    Value {
        /// From 0.
        motor: usize,
        /// As typed.
        word: String,
        /// Largest.
        most: String,
    },
}

impl Order {
    /// Reads a line: four numbers in the driver's units, or in rad/s.
    ///
    /// # Errors
    /// What is wrong with the line.
    pub fn parse(line: &str, is_radps: bool) -> Result<Self, OrderError> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let words: [&str; 4] = words
            .as_slice()
            .try_into()
            .map_err(|_| OrderError::Count(words.len()))?;
        let most = if is_radps {
            DRIVER_SPEED_RADPS
        } else {
            f64::from(MAX_UNITS)
        };
        let mut values = [0.0; 4];
        for (motor, word) in words.into_iter().enumerate() {
            let is_whole = is_radps || word.parse::<u8>().is_ok();
            values[motor] = word
                .parse()
                .ok()
                .filter(|v| is_whole && (0.0..=most).contains(v))
                .ok_or_else(|| OrderError::Value {
                    motor,
                    word: word.chars().take(40).collect(),
                    most: most.to_string(),
                })?;
        }
        Ok(if is_radps {
            Self::Speeds(values)
        } else {
            Self::Units(values.map(|v| v as u8))
        })
    }

    /// In rad/s; of units what the motors about turn at.
    #[must_use]
    pub fn speeds_radps(&self) -> [f64; 4] {
        match self {
            Self::Units(given) => given.map(|u| {
                // The cubic grows steadily: by halves.
                let (mut low, mut high) = (0.0, 400.0);
                for _ in 0..40 {
                    let middle = 0.5 * (low + high);
                    if units(middle) < u {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                high
            }),
            Self::Speeds(speeds) => *speeds,
        }
    }

    /// In the driver's units.
    #[must_use]
    pub fn units(&self) -> [u8; 4] {
        match self {
            Self::Units(units) => *units,
            Self::Speeds(speeds) => speeds.map(units),
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "limits are given back bit by bit")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn conversion_table_of_the_thesis() {
        let table = [
            (109.0, 52),
            (200.0, 94),
            (250.0, 122),
            (300.0, 157),
            (312.498, 167),
            (316.104, 170),
            (350.0, 201),
            (368.0, 220),
        ];
        for (speed, golden) in table {
            assert_eq!(units(speed), golden, "{speed} rad/s");
        }
        assert_eq!(libm::round(unlimited_units(387.0)) as u8, 241);
        assert_eq!(units(105.0), IDLE_UNITS);
    }

    #[test]
    fn limit_pair_is_368_16_and_not_387() {
        assert_eq!(units(387.0), 220);
        assert_eq!(units(DRIVER_SPEED_RADPS), 220);
        assert!((unlimited_units(DRIVER_SPEED_RADPS) - 220.0).abs() < 0.01);
        let range = SpeedRange::around(312.498);
        assert!((range.slowest_radps - 238.0).abs() < 0.01);
        let (given, limited) = range.limit(2, 387.0);
        assert_eq!(given, 368.16);
        let said = limited.unwrap().to_string();
        assert_eq!(said, "motor 2 was asked for 387.0 rad/s and gets 368.2");
        assert_eq!(range.limit(0, 368.16), (368.16, None));
        assert_eq!(range.limit(0, 1000.0).0, 368.16);
        assert_eq!(range.limit(0, -5.0).0, range.slowest_radps);
        assert_eq!(range.limit(0, f64::NAN).0, range.slowest_radps);
        assert!(range.limit(0, f64::NAN).1.is_some());
    }

    #[test]
    fn four_numbers_on_a_line_are_an_order_and_nothing_else_is() {
        assert_eq!(
            Order::parse("50 60\t70 0", false),
            Ok(Order::Units([50, 60, 70, 0]))
        );
        let radps = Order::parse("312.498 300 250 0", true).unwrap();
        assert_eq!(radps.units(), [167, 157, 122, 0]);
        let said = |line: &str, is_radps| Order::parse(line, is_radps).unwrap_err().to_string();
        assert_eq!(
            said("1 2 3", false),
            "3 numbers: four are needed, one a motor (front left rear right)"
        );
        assert_eq!(
            said("1 221 3 4", false),
            "motor 1: `221` is no number from 0 to 220"
        );
        assert_eq!(
            said("1 2 3 4.5", false),
            "motor 3: `4.5` is no number from 0 to 220"
        );
        assert_eq!(
            said("-1 2 3 4", false),
            "motor 0: `-1` is no number from 0 to 220"
        );
        assert_eq!(
            said("1 2 nan 4", true),
            "motor 2: `nan` is no number from 0 to 368.16"
        );
        assert_eq!(
            said("387 2 3 4", true),
            "motor 0: `387` is no number from 0 to 368.16"
        );
    }

    proptest! {
        #[test]
        fn no_speed_makes_an_illegal_value(speed in proptest::num::f64::ANY) {
            prop_assert!(units(speed) <= MAX_UNITS);
            let range = SpeedRange::around(312.5);
            let (given, _) = range.limit(0, speed);
            prop_assert!(given >= range.slowest_radps && given <= range.fastest_radps);
        }

        #[test]
        fn no_line_panics_and_none_makes_an_illegal_value(line in ".{0,60}", is_radps: bool) {
            if let Ok(order) = Order::parse(&line, is_radps) {
                prop_assert!(order.units().iter().all(|&u| u <= MAX_UNITS));
            }
        }
    }
}
