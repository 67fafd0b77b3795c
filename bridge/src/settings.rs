//! Every parameter of every component in one flat table, with where each value came from.
//!
//! Precedence: default < file < stored parameters < command line < set over MAVLink in this run. The order of sections
//! and of rows inside them is the order of MAVLink parameter indices and never changes while the program runs.

use crate::autopilot::params::AutopilotParams;
use crate::gcs::params::GroundParams;
use control::ControlParams;
use estimator::EstimatorParams;
use planner::{PlannerParams, VfhParams};
use serde::{Deserialize, Serialize};
use std::fmt;
use vehicle::{ParamError, ParamKind, ParamMeta, ParamSet, ParamValue};

/// Where a value came from; later ones win.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Origin {
    /// The code.
    #[default]
    Default,
    /// The configuration file.
    File,
    /// Parameters stored by an earlier run.
    Stored,
    /// The command line.
    CommandLine,
    /// Set over MAVLink in this run.
    Mavlink,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Default => "default",
            Self::File => "file",
            Self::Stored => "stored",
            Self::CommandLine => "command line",
            Self::Mavlink => "MAVLink",
        })
    }
}

/// All parameters.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Modes, failsafes, take-off and landing.
    pub autopilot: AutopilotParams,
    /// Loops from set point to sticks.
    pub control: ControlParams,
    /// Kalman filter and localization.
    pub estimator: EstimatorParams,
    /// Identity and behaviour towards the ground.
    pub ground: GroundParams,
    /// Routes, missions, evasion.
    pub planner: PlannerParams,
    /// Vector field histogram.
    pub vfh: VfhParams,
    origins: Vec<Origin>,
}

impl Default for Settings {
    fn default() -> Self {
        let mut settings = Self {
            autopilot: AutopilotParams::default(),
            control: ControlParams::default(),
            estimator: EstimatorParams::default(),
            ground: GroundParams::default(),
            planner: PlannerParams::default(),
            vfh: VfhParams::default(),
            origins: Vec::new(),
        };
        settings.origins = vec![Origin::Default; settings.count()];
        settings
    }
}

/// One parameter with its place.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// Flat index, the MAVLink parameter index.
    pub index: usize,
    /// TOML table.
    pub section: &'static str,
    /// Name, range, doc.
    pub meta: &'static ParamMeta,
    /// Value now.
    pub value: ParamValue,
    /// Where the value came from.
    pub origin: &'a Origin,
}

/// Why settings could not be taken.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingsError {
    /// Not TOML.
    #[error("{0}")]
    Toml(String),
    /// Unknown name, with the nearest known one.
    #[error("no parameter `{name}`{}", nearest.as_ref().map(|n| format!("; did you mean `{n}`?")).unwrap_or_default())]
    Unknown {
        /// Asked for.
        name: String,
        /// Nearest known.
        nearest: Option<String>,
    },
    /// Wrong type or range.
    #[error("{0}")]
    Value(String),
}

impl From<ParamError> for SettingsError {
    fn from(e: ParamError) -> Self {
        Self::Value(e.to_string())
    }
}

impl Settings {
    fn sections(&self) -> [(&'static str, &dyn ParamSet); 6] {
        [
            ("autopilot", &self.autopilot),
            ("control", &self.control),
            ("estimator", &self.estimator),
            ("ground", &self.ground),
            ("planner", &self.planner),
            ("vfh", &self.vfh),
        ]
    }

    fn sections_mut(&mut self) -> [&mut dyn ParamSet; 6] {
        [
            &mut self.autopilot,
            &mut self.control,
            &mut self.estimator,
            &mut self.ground,
            &mut self.planner,
            &mut self.vfh,
        ]
    }

    /// Number of parameters.
    #[must_use]
    pub fn count(&self) -> usize {
        self.sections().iter().map(|(_, s)| s.meta().len()).sum()
    }

    /// The parameter at a flat index.
    #[must_use]
    pub fn row(&self, index: usize) -> Option<Row<'_>> {
        let mut first = 0;
        for (section, set) in self.sections() {
            let n = set.meta().len();
            if let Some(meta) = index.checked_sub(first).and_then(|at| set.meta().get(at)) {
                let value = set.get(index - first)?;
                return Some(Row {
                    index,
                    section,
                    meta,
                    value,
                    origin: self.origins.get(index)?,
                });
            }
            first += n;
        }
        None
    }

    /// All parameters in order.
    pub fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        (0..self.count()).filter_map(|index| self.row(index))
    }

    /// Flat index of a MAVLink name.
    #[must_use]
    pub fn index_of(&self, id: &str) -> Option<usize> {
        self.rows().find(|r| r.meta.id == id).map(|r| r.index)
    }

    /// Value and range of a number by its MAVLink name.
    #[must_use]
    pub fn number(&self, id: &str) -> Option<(f64, core::ops::RangeInclusive<f64>)> {
        let row = self.rows().find(|r| r.meta.id == id)?;
        match (row.value, row.meta.kind) {
            (ParamValue::Float(v), ParamKind::Float { min, max, .. }) => {
                // By its decimals: 1.3 as a 32-bit number is no 1.3.
                let decimal = |v: f32| v.to_string().parse().unwrap_or(f64::from(v));
                Some((decimal(v), decimal(min)..=decimal(max)))
            }
            (ParamValue::Int(v), ParamKind::Int { min, max, .. }) => {
                Some((f64::from(v), f64::from(min)..=f64::from(max)))
            }
            _ => None,
        }
    }

    /// Sets by flat index, checked; returns the value in the parameter's own type.
    ///
    /// # Errors
    /// [`ParamError`]; the old value stays.
    pub fn set(
        &mut self,
        index: usize,
        value: ParamValue,
        origin: Origin,
    ) -> Result<ParamValue, ParamError> {
        let mut first = 0;
        let mut now = None;
        for set in self.sections_mut() {
            let n = set.meta().len();
            if index < first + n {
                set.set(index - first, value)?;
                now = set.get(index - first);
                break;
            }
            first += n;
        }
        if let (Some(now), Some(o)) = (now, self.origins.get_mut(index)) {
            *o = origin;
            return Ok(now);
        }
        Err(ParamError::Unknown(index.to_string()))
    }

    /// Sets `NAME=VALUE` as written by people: a MAVLink name or `section.key`; choices by name or number.
    ///
    /// # Errors
    /// [`SettingsError`] with the nearest name or the allowed range.
    pub fn set_text(
        &mut self,
        name: &str,
        text: &str,
        origin: Origin,
    ) -> Result<(), SettingsError> {
        let Some((index, meta)) = self
            .rows()
            .find(|r| {
                r.meta.id.eq_ignore_ascii_case(name)
                    || format!("{}.{}", r.section, r.meta.key) == name
            })
            .map(|r| (r.index, r.meta))
        else {
            return Err(SettingsError::Unknown {
                name: name.to_owned(),
                nearest: self.nearest(name),
            });
        };
        let value = match meta.kind {
            ParamKind::Float { .. } => text.trim().parse().map(ParamValue::Float).ok(),
            ParamKind::Bool { .. } => match text.trim() {
                "true" | "on" | "1" => Some(ParamValue::Int(1)),
                "false" | "off" | "0" => Some(ParamValue::Int(0)),
                _ => None,
            },
            ParamKind::Int { .. } => text.trim().parse().map(ParamValue::Int).ok(),
            ParamKind::Choice { names, .. } => names
                .iter()
                .find(|(n, _)| n.eq_ignore_ascii_case(text.trim()))
                .map(|(_, code)| ParamValue::Int(*code))
                .or_else(|| text.trim().parse().map(ParamValue::Int).ok()),
        };
        let value = value.ok_or_else(|| {
            SettingsError::Value(format!("{}: `{text}` is not a value of it", meta.id))
        })?;
        self.set(index, value, origin)?;
        Ok(())
    }

    /// The known name nearest to a mistyped one.
    #[must_use]
    pub fn nearest(&self, name: &str) -> Option<String> {
        nearest(name, self.rows().map(|r| r.meta.id)).map(str::to_owned)
    }

    /// Takes a TOML document: one table per section (`[planner]`), keys as the parameter tables name them.
    ///
    /// # Errors
    /// Names the key; nothing is taken from a document with an error.
    pub fn set_toml(&mut self, text: &str, origin: Origin) -> Result<(), SettingsError> {
        let document: toml::Table = text
            .parse()
            .map_err(|e: toml::de::Error| SettingsError::Toml(e.to_string()))?;
        let mut next = self.clone();
        for (section, table) in &document {
            // Sensors are things, not parameters: `kestrel fly` reads them (docs/sensors.md).
            if section == "sensor" && table.is_array() {
                continue;
            }
            let toml::Value::Table(table) = table else {
                return Err(SettingsError::Toml(format!(
                    "`{section}` must be a table like [planner]"
                )));
            };
            for (key, value) in table {
                let text = match value {
                    toml::Value::String(s) => s.clone(),
                    other => other.to_string(),
                };
                next.set_text(&format!("{section}.{key}"), &text, origin)?;
            }
        }
        *self = next;
        Ok(())
    }

    /// What the next run shall know: set over MAVLink in this run or stored by an earlier one.
    #[must_use]
    pub fn stored_toml(&self) -> String {
        self.toml_of(|r| matches!(r.origin, Origin::Stored | Origin::Mavlink))
    }

    /// What differs from the defaults, wherever it came from: the head of a log.
    #[must_use]
    pub fn changed_toml(&self) -> String {
        self.toml_of(|r| r.value != r.meta.default_value())
    }

    fn toml_of(&self, keep: impl Fn(&Row<'_>) -> bool) -> String {
        let mut out = String::new();
        let mut section = "";
        for row in self.rows().filter(keep) {
            if row.section != section {
                section = row.section;
                out.push_str(&format!("[{section}]\n"));
            }
            out.push_str(&format!("{} = {}\n", row.meta.key, row.value));
        }
        out
    }
}

/// The candidate with the smallest edit distance, if it is near enough to be meant.
#[must_use]
pub fn nearest<'a>(name: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let wanted = name.to_ascii_lowercase();
    candidates
        .map(|c| (edit_distance(&wanted, &c.to_ascii_lowercase()), c))
        .filter(|(d, c)| *d <= 2 + c.len() / 4)
        .min_by_key(|(d, _)| *d)
        .map(|(_, c)| c)
}

/// Levenshtein distance.
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let change = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = change.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_unique() {
        let s = Settings::default();
        let mut ids: Vec<_> = s.rows().map(|r| r.meta.id).collect();
        ids.sort_unstable();
        let before = ids.len();
        ids.dedup();
        assert_eq!(ids.len(), before);
        assert_eq!(before, s.count());
    }

    #[test]
    fn a_mistyped_name_gets_the_nearest() {
        let mut s = Settings::default();
        let e = s
            .set_text("MIS_TAKEOF_ALT", "1", Origin::CommandLine)
            .unwrap_err();
        assert_eq!(
            e.to_string(),
            "no parameter `MIS_TAKEOF_ALT`; did you mean `MIS_TAKEOFF_ALT`?"
        );
    }

    #[test]
    fn a_document_survives_and_a_wrong_one_changes_nothing() {
        let mut s = Settings::default();
        s.set_toml("[autopilot]\ntakeoff_height_m = 1.5\n", Origin::File)
            .unwrap();
        let index = s.index_of("MIS_TAKEOFF_ALT").unwrap();
        assert_eq!(
            s.row(index).map(|r| (r.value, *r.origin)),
            Some((ParamValue::Float(1.5), Origin::File))
        );
        assert_eq!(s.changed_toml(), "[autopilot]\ntakeoff_height_m = 1.5\n");
        let e = s
            .set_toml(
                "[autopilot]\ntakeoff_height_m = 2\nno_such = 1\n",
                Origin::File,
            )
            .unwrap_err();
        assert!(e.to_string().contains("autopilot.no_such"));
        assert_eq!(s.row(index).map(|r| r.value), Some(ParamValue::Float(1.5)));
    }
}
