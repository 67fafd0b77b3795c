//! What a command line or configuration names, checked, as drivers and one ring.
//!
//! Each sensor brings its own rangers; together they are the ring that the flight is made with. What cannot be together
//! is refused here with both names and the rule, before anything is opened.
//!
//! | Module | Holds |
//! | --- | --- |
//! | `device` | what the shell opens, and who understands its bytes |
//! | `builder` | one sensor after the other, and what cannot be together |
//! | `sonars` | ultrasonic rangers on GPIO lines |
//! | `feed` | what may come by MAVLink |

mod builder;
mod device;
mod feed;
mod sonars;

pub use device::{Device, Named, SerialDriver};
pub use feed::{MavlinkFeed, Vision};

use super::options::{OptionError, SensorSpec};
use builder::Builder;
use thiserror::Error;
use vehicle::{RingConfig, RingError};

/// Names of the drivers.
pub const DRIVERS: [&str; 9] = [
    "ld06", "rplidar", "tof_ring", "hc_sr04", "msp", "mavlink", "gpsd", "gps_log", "gps_fake",
];

/// Why a set of sensors is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SuiteError {
    /// No such driver.
    #[error("no sensor `{name}`{}; there are {}", nearest.as_ref().map(|n| format!("; did you mean `{n}`?")).unwrap_or_default(), DRIVERS.join(", "))]
    Driver {
        /// Asked for.
        name: String,
        /// Nearest known.
        nearest: Option<String>,
    },
    /// An option is wrong.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// The table of rangers is wrong.
    #[error("{sensor}: {error}")]
    Ring {
        /// Which sensor.
        sensor: String,
        /// Why.
        error: RingError,
    },
    /// A sensor misses something.
    #[error("{sensor}: {what}")]
    Sensor {
        /// Which.
        sensor: String,
        /// What is missing.
        what: String,
    },
    /// Two that cannot be together.
    #[error("{one} and {other}: {rule}")]
    Together {
        /// First.
        one: String,
        /// Second.
        other: String,
        /// Why not.
        rule: String,
    },
}

/// Everything the vehicle senses with.
#[derive(Clone, Debug)]
pub struct Suite {
    /// All rangers.
    pub ring: RingConfig,
    /// What to open.
    pub devices: Vec<Named>,
    /// What may come by MAVLink.
    pub mavlink: Option<MavlinkFeed>,
}

impl Suite {
    /// A suite of sensors. `read_ring` reads the tables that `rangers=` names: built-in rings and files.
    ///
    /// # Errors
    /// The first sensor that cannot be, or the first two that cannot be together.
    pub fn new(
        specs: &[SensorSpec],
        read_ring: &dyn Fn(&str) -> Result<RingConfig, RingError>,
    ) -> Result<Self, SuiteError> {
        let mut builder = Builder {
            read_ring,
            rangers: Vec::new(),
            columns: Vec::new(),
            lines: Vec::new(),
            roles: Vec::new(),
            devices: Vec::new(),
            mavlink: None,
        };
        for spec in specs {
            builder.sensor(spec)?;
        }
        let ring = RingConfig {
            name: "sensors".to_owned(),
            rangers: builder.rangers,
        };
        ring.check().map_err(|error| SuiteError::Ring {
            sensor: "all sensors".to_owned(),
            error,
        })?;
        Ok(Self {
            ring,
            devices: builder.devices,
            mavlink: builder.mavlink,
        })
    }
}

#[cfg(test)]
mod tests;
