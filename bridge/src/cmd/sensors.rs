//! `--sensor` and `[[sensor]]`: what the real vehicle senses with.

use super::Usage;
use anyhow::{Context as _, Result};
use bridge::sensor::options::{OptionError, SensorSpec};
use bridge::sensor::suite::{Device, Suite};
use std::path::Path;
use vehicle::{RingConfig, RingError};

/// Sensors of the configuration file, then those of the command line.
pub(crate) fn specs(config: Option<&Path>, urls: &[String]) -> Result<Vec<SensorSpec>> {
    let wrong = |e: OptionError| Usage(e.to_string());
    let mut specs = Vec::new();
    if let Some(path) = config {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let document: toml::Table = text
            .parse()
            .map_err(|e: toml::de::Error| Usage(format!("{}: {e}", path.display())))?;
        let tables = match document.get("sensor") {
            None => &Vec::new(),
            Some(toml::Value::Array(tables)) => tables,
            Some(_) => {
                return Err(Usage(format!(
                    "{}: write sensors as [[sensor]], each with a driver",
                    path.display()
                ))
                .into());
            }
        };
        for (i, table) in tables.iter().enumerate() {
            let toml::Value::Table(table) = table else {
                return Err(
                    Usage(format!("{}: write sensors as [[sensor]]", path.display())).into(),
                );
            };
            specs.push(SensorSpec::from_toml(i + 1, table).map_err(wrong)?);
        }
    }
    for url in urls {
        specs.push(url.parse().map_err(wrong)?);
    }
    Ok(specs)
}

/// Checks sensors against each other and against the line of the flight controller.
pub(crate) fn suite(specs: &[SensorSpec], fc: &str) -> Result<Suite> {
    let suite = Suite::new(specs, &ring).map_err(|e| Usage(e.to_string()))?;
    let same = suite.devices.iter().find(|d| {
        matches!(&d.device, Device::Serial { path, .. } if fc.starts_with(&format!("serial://{path}")))
    });
    if let Some(sensor) = same {
        return Err(Usage(format!(
            "--fc {fc} and {}: a serial line has one reader",
            sensor.name
        ))
        .into());
    }
    Ok(suite)
}

/// A ring by the name of a built-in one, or from a file.
pub(crate) fn ring(name: &str) -> Result<RingConfig, RingError> {
    if !name.ends_with(".toml") && !name.contains('/') {
        return RingConfig::built_in(name);
    }
    let text = std::fs::read_to_string(name)
        .map_err(|e| RingError::Toml(format!("cannot read {name}: {e}")))?;
    RingConfig::from_toml(&text)
}
