//! Lines over time of a log, for pictures and tables.

use super::reader::LogFile;
use serde_json::Value;

/// One panel: a title with unit, and lines of the same unit.
#[derive(Clone, Copy, Debug)]
pub struct Panel {
    /// Title with unit.
    pub title: &'static str,
    /// Name and JSON pointer into `/state`.
    pub lines: &'static [(&'static str, &'static str)],
}

/// What is drawn of every flight.
pub const PANELS: [Panel; 8] = [
    Panel {
        title: "position, m (NED about home)",
        lines: &[
            ("north", "/position_m/0"),
            ("east", "/position_m/1"),
            ("down", "/position_m/2"),
        ],
    },
    Panel {
        title: "velocity, m/s",
        lines: &[
            ("north", "/velocity_mps/0"),
            ("east", "/velocity_mps/1"),
            ("down", "/velocity_mps/2"),
        ],
    },
    Panel {
        title: "attitude, rad",
        lines: &[
            ("roll", "/roll_rad"),
            ("pitch", "/pitch_rad"),
            ("yaw", "/yaw_rad"),
        ],
    },
    Panel {
        title: "sticks",
        lines: &[
            ("roll", "/sticks/0"),
            ("pitch", "/sticks/1"),
            ("yaw", "/sticks/2"),
            ("throttle", "/sticks/3"),
        ],
    },
    Panel {
        title: "standard deviation of the place, m",
        lines: &[
            ("north", "/position_std_m/0"),
            ("east", "/position_std_m/1"),
        ],
    },
    Panel {
        title: "localization, 0..1",
        lines: &[("fit", "/localization/fit"), ("mass", "/localization/mass")],
    },
    Panel {
        title: "battery, V",
        lines: &[("voltage", "/battery/voltage_v")],
    },
    Panel {
        title: "attitude to command, 99 %, us",
        lines: &[("p99", "/loop/p99_us")],
    },
];

/// Columns over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// s since the start.
    pub t_s: Vec<f64>,
    /// A column for each pointer; NaN where there is no number.
    pub columns: Vec<Vec<f64>>,
}

/// Columns of `/state` at JSON pointers.
#[must_use]
pub fn series<'a>(log: &LogFile, pointers: impl Iterator<Item = &'a str> + Clone) -> Series {
    let mut series = Series {
        t_s: Vec::new(),
        columns: vec![Vec::new(); pointers.clone().count()],
    };
    for (_, state) in log.values("/state") {
        series.t_s.push(state["t_s"].as_f64().unwrap_or(f64::NAN));
        for (column, pointer) in series.columns.iter_mut().zip(pointers.clone()) {
            column.push(
                state
                    .pointer(pointer)
                    .and_then(Value::as_f64)
                    .unwrap_or(f64::NAN),
            );
        }
    }
    series
}

/// Names of the columns a value makes, and their numbers or texts: objects and arrays are laid out flat.
pub fn flatten(prefix: &str, value: &Value, out: &mut Vec<(String, String)>) {
    let join = |key: &str| {
        if prefix.is_empty() {
            key.to_owned()
        } else {
            format!("{prefix}.{key}")
        }
    };
    match value {
        Value::Object(map) => map
            .iter()
            .for_each(|(key, value)| flatten(&join(key), value, out)),
        Value::Array(items) => items
            .iter()
            .enumerate()
            .for_each(|(i, value)| flatten(&join(&i.to_string()), value, out)),
        Value::Null => out.push((prefix.to_owned(), String::new())),
        Value::String(text) => out.push((prefix.to_owned(), quoted(text))),
        other => out.push((prefix.to_owned(), other.to_string())),
    }
}

/// As a field of CSV (RFC 4180).
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_value_becomes_columns() {
        let mut out = Vec::new();
        flatten(
            "",
            &json!({ "a": [1, { "b": "x,\"y\"" }], "c": null, "d": true }),
            &mut out,
        );
        let out: Vec<(&str, &str)> = out.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
        assert_eq!(
            out,
            [
                ("a.0", "1"),
                ("a.1.b", "\"x,\"\"y\"\"\""),
                ("c", ""),
                ("d", "true")
            ]
        );
    }
}
