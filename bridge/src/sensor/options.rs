//! How a sensor is written, on the command line or in the configuration file.
//!
//! ```text
//! ld06:///dev/ttyUSB0?yaw_deg=90&x_m=0.05        [[sensor]]
//!                                                driver = "ld06"
//!                                                device = "/dev/ttyUSB0"
//!                                                yaw_deg = 90
//!                                                x_m = 0.05
//! ```
//!
//! Both become the same [`SensorSpec`]; every key a driver does not know is refused with the nearest it knows.

use core::fmt;
use core::ops::RangeInclusive;
use core::str::FromStr;
use thiserror::Error;

/// Why a sensor cannot be used as written.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OptionError {
    /// Not `driver:...`.
    #[error(
        "`{0}` names no sensor: write it like ld06:///dev/ttyUSB0?yaw_deg=90 (docs/sensors.md)"
    )]
    NoDriver(String),
    /// An option without a value.
    #[error("{sensor}: `{part}` is no option: write it like yaw_deg=90")]
    NoValue {
        /// Which sensor.
        sensor: String,
        /// What was written.
        part: String,
    },
    /// An option that the driver does not have.
    #[error("{sensor}: no option `{key}`{}; there are {known}", nearest.as_ref().map(|n| format!("; did you mean `{n}`?")).unwrap_or_default())]
    Unknown {
        /// Which sensor.
        sensor: String,
        /// What was written.
        key: String,
        /// Nearest known.
        nearest: Option<String>,
        /// All known.
        known: String,
    },
    /// A value that is none or lies outside its range.
    #[error("{sensor}: {key} = `{value}` must be {must}")]
    Value {
        /// Which sensor.
        sensor: String,
        /// Which option.
        key: String,
        /// What was written.
        value: String,
        /// What is allowed.
        must: String,
    },
    /// TOML of another shape.
    #[error("[[sensor]] number {number}: {what}")]
    Table {
        /// Which, from 1.
        number: usize,
        /// What is wrong.
        what: String,
    },
}

/// A sensor as written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SensorSpec {
    /// Name of the driver.
    pub driver: String,
    /// Device file, address or nothing.
    pub place: String,
    /// Options in the order they were written.
    pub options: Vec<(String, String)>,
}

impl fmt::Display for SensorSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.driver)?;
        if self.place.is_empty() {
            return Ok(());
        }
        write!(f, "://{}", self.place)
    }
}

impl FromStr for SensorSpec {
    type Err = OptionError;

    fn from_str(text: &str) -> Result<Self, OptionError> {
        let wrong = || OptionError::NoDriver(text.to_owned());
        let (base, query) = text.split_once('?').unwrap_or((text, ""));
        let (driver, place) = base.split_once(':').unwrap_or((base, ""));
        if driver.is_empty()
            || !driver
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || c == '_')
        {
            return Err(wrong());
        }
        let options = query
            .split('&')
            .filter(|part| !part.is_empty())
            .map(|part| {
                part.split_once('=')
                    .map(|(key, value)| (key.to_owned(), value.to_owned()))
                    .ok_or_else(|| OptionError::NoValue {
                        sensor: driver.to_owned(),
                        part: part.to_owned(),
                    })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            driver: driver.to_owned(),
            place: place.strip_prefix("//").unwrap_or(place).to_owned(),
            options,
        })
    }
}

impl SensorSpec {
    /// From a table of `[[sensor]]`.
    ///
    /// # Errors
    /// [`OptionError::Table`] names it.
    pub fn from_toml(number: usize, table: &toml::Table) -> Result<Self, OptionError> {
        let wrong = |what: &str| OptionError::Table {
            number,
            what: what.to_owned(),
        };
        let mut spec = Self {
            driver: String::new(),
            place: String::new(),
            options: Vec::new(),
        };
        for (key, value) in table {
            let text = match value {
                toml::Value::String(s) => s.clone(),
                toml::Value::Integer(_) | toml::Value::Float(_) | toml::Value::Boolean(_) => {
                    value.to_string()
                }
                _ => {
                    return Err(wrong(&format!(
                        "{key} must be a number, a text or true or false"
                    )));
                }
            };
            match key.as_str() {
                "driver" => spec.driver = text,
                "device" => spec.place = text,
                _ => spec.options.push((key.clone(), text)),
            }
        }
        if spec.driver.is_empty() {
            return Err(wrong("driver is missing, like driver = \"ld06\""));
        }
        Ok(spec)
    }
}

/// Takes the options of a sensor one by one; what is left over is unknown.
#[derive(Debug)]
pub struct Options<'a> {
    sensor: String,
    left: Vec<&'a (String, String)>,
    known: Vec<&'static str>,
}

impl<'a> Options<'a> {
    /// Of a sensor.
    #[must_use]
    pub fn of(spec: &'a SensorSpec) -> Self {
        Self {
            sensor: spec.to_string(),
            left: spec.options.iter().collect(),
            known: Vec::new(),
        }
    }

    /// An error about an option.
    #[must_use]
    pub fn wrong(&self, key: &str, value: &str, must: &str) -> OptionError {
        OptionError::Value {
            sensor: self.sensor.clone(),
            key: key.to_owned(),
            value: value.to_owned(),
            must: must.to_owned(),
        }
    }

    /// A text; the last one counts.
    pub fn text(&mut self, key: &'static str) -> Option<&'a str> {
        self.known.push(key);
        let found = self
            .left
            .iter()
            .rev()
            .find(|(k, _)| k == key)
            .map(|(_, v)| v.as_str());
        self.left.retain(|(k, _)| k != key);
        found
    }

    /// A number within a range.
    ///
    /// # Errors
    /// Not one.
    pub fn number(
        &mut self,
        key: &'static str,
        default: f64,
        range: RangeInclusive<f64>,
    ) -> Result<f64, OptionError> {
        let Some(text) = self.text(key) else {
            return Ok(default);
        };
        text.parse()
            .ok()
            .filter(|v| range.contains(v))
            .ok_or_else(|| {
                self.wrong(
                    key,
                    text,
                    &format!("a number from {} to {}", range.start(), range.end()),
                )
            })
    }

    /// Yes or no.
    ///
    /// # Errors
    /// Neither.
    pub fn flag(&mut self, key: &'static str, default: bool) -> Result<bool, OptionError> {
        match self.text(key) {
            None => Ok(default),
            Some("true" | "on" | "1") => Ok(true),
            Some("false" | "off" | "0") => Ok(false),
            Some(other) => Err(self.wrong(key, other, "true or false")),
        }
    }

    /// One of some words.
    ///
    /// # Errors
    /// None of them.
    pub fn choice<T: Copy>(
        &mut self,
        key: &'static str,
        default: T,
        words: &[(&str, T)],
    ) -> Result<T, OptionError> {
        let Some(text) = self.text(key) else {
            return Ok(default);
        };
        words
            .iter()
            .find(|(w, _)| *w == text)
            .map(|(_, t)| *t)
            .ok_or_else(|| {
                let all: Vec<&str> = words.iter().map(|(w, _)| *w).collect();
                self.wrong(key, text, &all.join(" or "))
            })
    }

    /// Pairs of numbers: `13/19,9/10` or `150/-150`.
    ///
    /// # Errors
    /// Not such.
    pub fn pairs(&mut self, key: &'static str) -> Result<Vec<[f64; 2]>, OptionError> {
        let Some(text) = self.text(key) else {
            return Ok(Vec::new());
        };
        text.split(',')
            .map(|pair| {
                let (a, b) = pair.split_once('/')?;
                let number = |t: &str| t.trim().parse().ok().filter(|v: &f64| v.is_finite());
                Some([number(a)?, number(b)?])
            })
            .collect::<Option<_>>()
            .ok_or_else(|| self.wrong(key, text, "pairs of numbers like 13/19,9/10"))
    }

    /// Ends: whatever was not taken is unknown.
    ///
    /// # Errors
    /// Names it, and the nearest known.
    pub fn finish(self) -> Result<(), OptionError> {
        let Some((key, _)) = self.left.first() else {
            return Ok(());
        };
        Err(OptionError::Unknown {
            sensor: self.sensor,
            key: key.clone(),
            nearest: crate::settings::nearest(key, self.known.iter().copied()).map(str::to_owned),
            known: self.known.join(", "),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_and_a_table_say_the_same() {
        let url: SensorSpec = "ld06:///dev/ttyUSB0?yaw_deg=90&upside_down=true"
            .parse()
            .unwrap();
        let table: toml::Table =
            "driver = \"ld06\"\ndevice = \"/dev/ttyUSB0\"\nyaw_deg = 90\nupside_down = true"
                .parse()
                .unwrap();
        let mut from_table = SensorSpec::from_toml(1, &table).unwrap();
        from_table.options.sort();
        let mut from_url = url.clone();
        from_url.options.sort();
        assert_eq!(from_url, from_table);
        assert_eq!(url.to_string(), "ld06:///dev/ttyUSB0");
        assert_eq!(
            "mavlink:?obstacle=on".parse::<SensorSpec>().unwrap().place,
            ""
        );
        assert_eq!(
            "gpsd://localhost:2947".parse::<SensorSpec>().unwrap().place,
            "localhost:2947"
        );
    }

    #[test]
    fn wrong_ones_say_what_to_write() {
        let said = |text: &str| text.parse::<SensorSpec>().unwrap_err().to_string();
        assert!(said("/dev/ttyUSB0").contains("ld06:///dev"));
        assert!(said("ld06:///dev/x?yaw").contains("yaw_deg=90"));
        let spec: SensorSpec = "ld06:///dev/x?yaw_dge=9&y_m=far".parse().unwrap();
        let mut options = Options::of(&spec);
        let e = options
            .number("y_m", 0.0, -1.0..=1.0)
            .unwrap_err()
            .to_string();
        assert_eq!(
            e,
            "ld06:///dev/x: y_m = `far` must be a number from -1 to 1"
        );
        options.number("yaw_deg", 0.0, -180.0..=180.0).unwrap();
        let e = options.finish().unwrap_err().to_string();
        assert!(
            e.contains("no option `yaw_dge`; did you mean `yaw_deg`?"),
            "{e}"
        );
        let none: toml::Table = "device = \"/dev/x\"".parse().unwrap();
        assert!(
            SensorSpec::from_toml(2, &none)
                .unwrap_err()
                .to_string()
                .contains("number 2: driver is missing")
        );
    }
}
