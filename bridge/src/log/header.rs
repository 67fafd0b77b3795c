//! What a flight was made from: the first record of its log, and the start of its replay.

use crate::autopilot::flight::{FlightConfig, Start};
use crate::settings::{Origin, Settings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use vehicle::{Airframe, FloorPlan, ParamValue, RingConfig, Timestamp};

/// Format of the stream and of this header; a replay of another one is refused.
pub const FORMAT: u16 = 3;

/// Everything `Flight` was made from, and where it came from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// [`FORMAT`].
    pub format: u16,
    /// Version of the program.
    pub version: String,
    /// `sim office`, `fly serial:///dev/ttyAMA0` ...
    pub source: String,
    /// UTC at time zero, us.
    pub boot_utc_us: u64,
    /// When `Flight` was made.
    pub at: Timestamp,
    /// Seed of the particles.
    pub seed: u64,
    /// Where it stood.
    pub start: Start,
    /// Mass, size, thrust.
    pub airframe: Airframe,
    /// The ring of range finders.
    pub ring: RingConfig,
    /// Walls.
    pub plan: FloorPlan,
    /// Every parameter: name, value, where it came from.
    pub parameters: Vec<(String, ParamValue, Origin)>,
}

/// Why a log cannot be flown again.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HeaderError {
    /// It is not there, or torn.
    #[error("the log does not say what the flight was made from: {0}")]
    Unreadable(String),
    /// Written by a program with other formats.
    #[error(
        "the log was written by Kestrel {version} (format {got}); this program reads format {FORMAT}: replay it with the program that wrote it"
    )]
    OtherFormat {
        /// Its format.
        got: u16,
        /// Its program.
        version: String,
    },
    /// A parameter this program does not have.
    #[error("the log has a parameter {0} that this program does not have")]
    Parameter(String),
}

impl Header {
    /// Of a flight about to begin.
    #[must_use]
    pub fn new(at: Timestamp, config: &FlightConfig, source: &str, boot_utc_us: u64) -> Self {
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            source: source.to_owned(),
            boot_utc_us,
            at,
            seed: config.seed,
            start: config.start,
            airframe: config.airframe,
            ring: config.ring.clone(),
            plan: FloorPlan::clone(&config.plan),
            parameters: config
                .settings
                .rows()
                .map(|r| (r.meta.id.to_owned(), r.value, *r.origin))
                .collect(),
        }
    }

    /// What `Flight` is to be made from again.
    ///
    /// # Errors
    /// A parameter is not known here.
    pub fn config(&self) -> Result<FlightConfig, HeaderError> {
        let mut settings = Settings::default();
        for (id, value, origin) in &self.parameters {
            let index = settings
                .index_of(id)
                .ok_or_else(|| HeaderError::Parameter(id.clone()))?;
            settings
                .set(index, *value, *origin)
                .map_err(|e| HeaderError::Parameter(e.to_string()))?;
        }
        Ok(FlightConfig {
            plan: Arc::new(self.plan.clone()),
            ring: self.ring.clone(),
            airframe: self.airframe,
            start: self.start,
            settings,
            seed: self.seed,
        })
    }

    /// As an attachment.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        // Our types cannot fail to be written; an empty header is refused by the reader.
        postcard::to_allocvec(self).unwrap_or_default()
    }

    /// From an attachment.
    ///
    /// # Errors
    /// Torn, or of another format.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, HeaderError> {
        let torn = |e: postcard::Error| HeaderError::Unreadable(e.to_string());
        let (format, rest) = postcard::take_from_bytes::<u16>(bytes).map_err(torn)?;
        if format != FORMAT {
            let version = postcard::take_from_bytes::<String>(rest)
                .map_or_else(|_| "unknown".to_owned(), |(version, _)| version);
            return Err(HeaderError::OtherFormat {
                got: format,
                version,
            });
        }
        postcard::from_bytes(bytes).map_err(torn)
    }

    /// The metadata record `kestrel`.
    #[must_use]
    pub fn facts(&self) -> BTreeMap<String, String> {
        let start = match self.start {
            Start::Known(p) => format!("{},{},{}", p.x_m, p.y_m, p.yaw_rad),
            Start::Unknown => "unknown".to_owned(),
        };
        [
            ("version", self.version.clone()),
            ("format", self.format.to_string()),
            ("source", self.source.clone()),
            ("seed", self.seed.to_string()),
            ("start", start),
            ("ring", self.ring.name.clone()),
            ("boot_utc_us", self.boot_utc_us.to_string()),
            ("airframe", format!("{:?}", self.airframe)),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
    }

    /// The metadata record `parameters`: `value (origin)` by name.
    #[must_use]
    pub fn parameter_texts(&self) -> BTreeMap<String, String> {
        self.parameters
            .iter()
            .map(|(id, value, origin)| (id.clone(), format!("{value} ({origin})")))
            .collect()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use sim::Room;

    /// A flight in the office.
    pub(in crate::log) fn office() -> FlightConfig {
        let room = Room::named("office").unwrap();
        let mut settings = Settings::default();
        settings
            .set_text("MIS_TAKEOFF_ALT", "1.3", Origin::File)
            .unwrap();
        FlightConfig {
            plan: Arc::clone(room.floor_plan()),
            ring: RingConfig::built_in("tof32").unwrap(),
            airframe: Airframe::default(),
            start: Start::Known(room.home()),
            settings,
            seed: 7,
        }
    }

    #[test]
    fn a_header_comes_back_to_the_bit_and_makes_the_same_flight() {
        let config = office();
        let header = Header::new(Timestamp::from_us(5), &config, "sim office", 9);
        let back = Header::from_bytes(&header.to_bytes()).unwrap();
        assert_eq!(back, header);
        let again = back.config().unwrap();
        assert_eq!(*again.plan, *config.plan);
        assert_eq!(
            again.settings.changed_toml(),
            config.settings.changed_toml()
        );
        assert_eq!(header.parameter_texts()["MIS_TAKEOFF_ALT"], "1.3 (file)");
        assert_eq!(header.parameter_texts()["COM_DL_LOSS_T"], "3 (default)");
    }

    #[test]
    fn another_format_is_refused_with_the_version_that_wrote_it() {
        let mut header = Header::new(Timestamp::ZERO, &office(), "sim", 0);
        header.format = 2;
        header.version = "0.0.9".to_owned();
        let e = Header::from_bytes(&header.to_bytes()).unwrap_err();
        assert!(e.to_string().contains("Kestrel 0.0.9"), "{e}");
        assert!(Header::from_bytes(&[]).is_err());
    }
}
