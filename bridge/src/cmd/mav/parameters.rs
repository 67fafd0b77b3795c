//! `mav params`: get, set, diff, save, load.

use super::super::Usage;
use super::File;
use super::client::{Client, Silent, TRIES};
use super::console::print;
use anyhow::{Context as _, Result, bail};
use bridge::settings::Settings;
use clap::Subcommand;
use mavlink_dialect::standard::{
    MavMessage as Std, MavParamType, PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA,
    PARAM_VALUE_DATA,
};
use mavlink_dialect::{Message, raw};
use std::collections::BTreeMap;
use std::fmt::Write as _;

#[derive(Debug, Subcommand)]
pub(super) enum What {
    /// Show parameters; none named = all.
    Get {
        /// Names.
        names: Vec<String>,
    },
    /// Set a parameter.
    #[command(allow_negative_numbers = true)]
    Set {
        /// Name.
        name: String,
        /// Value.
        value: f64,
    },
    /// Show what differs from a file, or from the defaults of this program.
    Diff {
        /// Made by `save`.
        file: Option<File>,
    },
    /// Write all parameters to a file (`NAME VALUE` lines).
    Save {
        /// Where to.
        file: File,
    },
    /// Set what a file says, where it differs; all or nothing is not promised: what was refused is told.
    Load {
        /// Made by `save`.
        file: File,
    },
}

/// A value as the vehicle has it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Value {
    Int(i32),
    Float(f32),
}

impl Value {
    fn of(m: &PARAM_VALUE_DATA) -> Self {
        match m.param_type {
            MavParamType::MAV_PARAM_TYPE_REAL32 => Self::Float(m.param_value),
            _ => Self::Int(m.param_value.to_bits().cast_signed()),
        }
    }

    fn text(self) -> String {
        match self {
            Self::Int(v) => v.to_string(),
            Self::Float(v) => v.to_string(),
        }
    }

    /// The same kind, another number.
    fn with(self, v: f64) -> Option<Self> {
        match self {
            Self::Float(_) => Some(Self::Float(v as f32)),
            Self::Int(_) => {
                let is_whole = (v - v.round()).abs() < 1e-9 && v.abs() < 2.2e9;
                is_whole.then_some(Self::Int(v as i32))
            }
        }
    }
}

type Values = BTreeMap<String, Value>;

pub(super) fn run(client: &mut Client, what: &What) -> Result<()> {
    match what {
        What::Get { names } if names.is_empty() => {
            let all = list(client)?;
            print(&lines(&all))
        }
        What::Get { names } => {
            let mut out = String::new();
            for name in names {
                // Writing into a String cannot fail.
                let _ = writeln!(out, "{name} {}", read(client, name)?.text());
            }
            print(&out)
        }
        What::Set { name, value } => {
            let set = set(client, name, *value)?;
            print(&format!("{name} {}\n", set.text()))
        }
        What::Diff { file } => {
            let wanted = match file {
                Some(file) => parse(&read_file(file)?)?,
                None => defaults(),
            };
            let now = list(client)?;
            let mut out = String::new();
            for (name, value) in differing(&wanted, &now) {
                let is = now.get(&name).map_or("absent".to_owned(), |v| v.text());
                let _ = writeln!(out, "{name} {is} (there {value})");
            }
            print(&out)
        }
        What::Save { file } => {
            let all = list(client)?;
            std::fs::write(file, lines(&all))
                .with_context(|| format!("cannot write {}", file.display()))?;
            print(&format!("{} parameters in {}\n", all.len(), file.display()))
        }
        What::Load { file } => load(client, &parse(&read_file(file)?)?),
    }
}

fn load(client: &mut Client, wanted: &BTreeMap<String, f64>) -> Result<()> {
    let now = list(client)?;
    let (mut count, mut failed) = (0, Vec::new());
    for (name, value) in differing(wanted, &now) {
        match set(client, &name, value) {
            Ok(_) => count += 1,
            Err(e) if e.downcast_ref::<Silent>().is_some() => return Err(e),
            Err(e) => failed.push(format!("{e:#}")),
        }
    }
    print(&format!("{count} parameters set\n"))?;
    if failed.is_empty() {
        Ok(())
    } else {
        bail!("{}", failed.join("; "))
    }
}

/// Wanted values that are not there.
fn differing(wanted: &BTreeMap<String, f64>, now: &Values) -> Vec<(String, f64)> {
    let is_same = |name: &str, value: f64| {
        now.get(name)
            .is_some_and(|is| is.with(value).is_some_and(|w| w == *is))
    };
    wanted
        .iter()
        .filter(|(name, value)| !is_same(name, **value))
        .map(|(name, value)| (name.clone(), *value))
        .collect()
}

fn defaults() -> BTreeMap<String, f64> {
    let settings = Settings::default();
    let number = |v: vehicle::ParamValue| match v {
        vehicle::ParamValue::Float(v) => f64::from(v),
        vehicle::ParamValue::Int(v) => f64::from(v),
    };
    settings
        .rows()
        .map(|r| (r.meta.id.to_owned(), number(r.value)))
        .collect()
}

fn lines(values: &Values) -> String {
    let line = |(name, value): (&String, &Value)| format!("{name} {}\n", value.text());
    values.iter().map(line).collect()
}

fn read_file(file: &File) -> Result<String> {
    std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))
}

/// `NAME VALUE` lines; `#` begins a comment. Files of MAVProxy and of QGroundControl (five columns) are read too.
fn parse(text: &str) -> Result<BTreeMap<String, f64>> {
    let mut values = BTreeMap::new();
    for (n, line) in (1..).zip(text.lines()) {
        let words: Vec<&str> = line
            .split('#')
            .next()
            .unwrap_or("")
            .split_whitespace()
            .collect();
        let (name, value) = match words.as_slice() {
            [] => continue,
            [name, value] | [_, _, name, value, _] => (name, value),
            _ => return Err(Usage(format!("line {n}: not `NAME VALUE`")).into()),
        };
        let value = value
            .parse()
            .ok()
            .filter(|v: &f64| v.is_finite())
            .ok_or_else(|| Usage(format!("line {n}: `{value}` is no number")))?;
        values.insert((*name).to_owned(), value);
    }
    Ok(values)
}

fn target(client: &Client) -> (u8, u8) {
    (client.vehicle.system, client.vehicle.component)
}

fn read(client: &mut Client, name: &str) -> Result<Value> {
    let (target_system, target_component) = target(client);
    let question = Std::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
        param_index: -1,
        target_system,
        target_component,
        param_id: checked_name(name)?.into(),
    });
    let answer = client.ask(name, question, |m| answer_about(name, m))?;
    answer.ok_or_else(|| anyhow::anyhow!("no parameter `{name}`"))
}

/// The value, or none if the vehicle says that there is no such parameter.
fn answer_about(name: &str, message: &Message) -> Option<Option<Value>> {
    match message {
        Message::Standard(Std::PARAM_VALUE(m)) if m.param_id.to_str() == Ok(name) => {
            Some(Some(Value::of(m)))
        }
        Message::Standard(Std::PARAM_ERROR(m)) if m.param_id.to_str() == Ok(name) => Some(None),
        _ => None,
    }
}

fn checked_name(name: &str) -> Result<&str> {
    if name.len() <= 16 && !name.is_empty() && name.is_ascii() {
        Ok(name)
    } else {
        Err(Usage(format!(
            "`{name}` is no name of a parameter: at most 16 letters"
        ))
        .into())
    }
}

fn set(client: &mut Client, name: &str, value: f64) -> Result<Value> {
    let old = read(client, name)?;
    let Some(wanted) = old.with(value) else {
        bail!("{name}: {value} is no whole number");
    };
    let (target_system, target_component) = target(client);
    let (param_value, param_type) = match wanted {
        Value::Int(v) => (f32::from_bits(v.cast_unsigned()), 6),
        Value::Float(v) => (v, 9),
    };
    let question = raw::MavMessage::PARAM_SET(raw::PARAM_SET_DATA {
        param_value,
        target_system,
        target_component,
        param_id: name.into(),
        param_type,
    });
    let mut is_refused = false;
    let now = client.ask(name, question, |m| match answer_about(name, m) {
        Some(None) => {
            is_refused = true;
            Some(old)
        }
        Some(now) => now,
        None => None,
    })?;
    if is_refused || now != wanted {
        // The reason comes as a text.
        let until = client.within(0.3);
        while client.next(until).is_some() {}
        bail!("{name}: {value} was refused, it stays {}", old.text());
    }
    Ok(now)
}

/// All parameters; gaps are asked for one by one.
fn list(client: &mut Client) -> Result<Values> {
    let (target_system, target_component) = target(client);
    client.send(Std::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
        target_system,
        target_component,
    }));
    let mut found: BTreeMap<u16, (String, Value)> = BTreeMap::new();
    let mut count = None;
    let mut tries = 0;
    while count.is_none_or(|n| found.len() < usize::from(n)) {
        let until = client.within(0.5);
        let mut came = false;
        while let Some(frame) = client.next(until) {
            if let Message::Standard(Std::PARAM_VALUE(m)) = &frame.message
                && frame.from == client.vehicle
            {
                came = true;
                if m.param_index != u16::MAX {
                    count = Some(m.param_count);
                    let name = m.param_id.to_str().unwrap_or("").to_owned();
                    found.insert(m.param_index, (name, Value::of(m)));
                }
                if count.is_some_and(|n| found.len() >= usize::from(n)) {
                    break;
                }
            }
        }
        if came {
            tries = 0;
            continue;
        }
        tries += 1;
        if tries > TRIES {
            return Err(Silent("parameters: the vehicle does not answer".to_owned()).into());
        }
        match count {
            None => client.send(Std::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
                target_system,
                target_component,
            })),
            Some(count) => {
                let missing: Vec<u16> = (0..count).filter(|i| !found.contains_key(i)).collect();
                for index in missing.into_iter().take(20) {
                    client.send(Std::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
                        param_index: index.cast_signed(),
                        target_system,
                        target_component,
                        param_id: "".into(),
                    }));
                }
            }
        }
    }
    Ok(found.into_values().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_three_programs_are_read_and_wrong_lines_named() {
        let ours = parse("# comment\nA 1.5\nB -3 # why\n").unwrap();
        assert_eq!(
            ours.into_iter().collect::<Vec<_>>(),
            [("A".to_owned(), 1.5), ("B".to_owned(), -3.0)]
        );
        let theirs = parse("1\t1\tA\t2.5\t9\n").unwrap();
        assert_eq!(theirs.get("A"), Some(&2.5));
        for (wrong, says) in [
            ("A\n", "line 1"),
            ("A 1\nB x\n", "line 2: `x`"),
            ("A NaN", "no number"),
        ] {
            let e = parse(wrong).unwrap_err().to_string();
            assert!(e.contains(says), "{e}");
        }
    }

    #[test]
    fn what_differs_is_what_would_be_set() {
        let now = Values::from([
            ("A".to_owned(), Value::Float(0.1)),
            ("B".to_owned(), Value::Int(3)),
        ]);
        let wanted = BTreeMap::from([
            ("A".to_owned(), 0.1),
            ("B".to_owned(), 4.0),
            ("C".to_owned(), 1.0),
        ]);
        let names: Vec<String> = differing(&wanted, &now)
            .into_iter()
            .map(|(n, _)| n)
            .collect();
        assert_eq!(names, ["B", "C"]);
        assert_eq!(Value::Int(1).with(2.5), None);
    }
}
