//! The text command line that `#` opens on the port (Betaflight, INAV, Cleanflight): MSP stops there until `save` or `exit`,
//! and both restart the controller.
//!
//! | Command | Does |
//! | --- | --- |
//! | `get NAME` | every setting whose name contains it |
//! | `set NAME = VALUE` | changes what runs |
//! | `diff`, `dump` | all settings as `set` lines |
//! | `version` | firmware |
//! | `save` | keeps and restarts |
//! | `exit` | restarts without keeping |

use super::FlightController;
use super::manner::{ReceiverChoice, StatusKind};
use super::settings::Settings;
use std::fmt::Write as _;
use vehicle::Timestamp;

/// Longest line that is read; what is longer is cut.
const LINE: usize = 96;

/// The command line of one port.
#[derive(Clone, Debug, Default)]
pub(super) struct Cli {
    pub(super) is_open: bool,
    line: String,
    /// What goes out with the next run of the serial task.
    pub(super) out: String,
}

/// One setting: name, smallest and largest value, how to read and write it.
struct Variable {
    name: &'static str,
    range: (u32, u32),
    read: fn(&Settings) -> u32,
    write: fn(&mut Settings, u32),
}

const FAILSAFE_DELAY: Variable = Variable {
    name: "failsafe_delay",
    range: (0, 200),
    read: |s| s.failsafe.delay_ds.into(),
    write: |s, v| s.failsafe.delay_ds = v as u8,
};
const FAILSAFE_PROCEDURE: Variable = Variable {
    name: "failsafe_procedure",
    range: (0, 3),
    read: |s| s.failsafe.procedure.into(),
    write: |s, v| s.failsafe.procedure = v as u8,
};
const FAILSAFE_THROTTLE: Variable = Variable {
    name: "failsafe_throttle",
    range: (750, 2250),
    read: |s| s.failsafe.throttle_us.into(),
    write: |s, v| s.failsafe.throttle_us = v as u16,
};
const MIN_CHECK: Variable = Variable {
    name: "min_check",
    range: (750, 2250),
    read: |s| s.rx.min_check_us.into(),
    write: |s, v| s.rx.min_check_us = v as u16,
};
const SERIAL_RATE: Variable = Variable {
    name: "serial_update_rate_hz",
    range: (100, 2000),
    read: |s| s.serial_rate_hz,
    write: |s, v| s.serial_rate_hz = v,
};
const OVERRIDE_MASK: Variable = Variable {
    name: "msp_override_channels_mask",
    range: (0, (1 << 18) - 1),
    read: |s| s.override_mask,
    write: |s, v| s.override_mask = v,
};
const OVERRIDE_CHANNELS: Variable = Variable {
    name: "msp_override_channels",
    range: (0, 65535),
    ..OVERRIDE_MASK
};
const RECEIVER_TYPE: Variable = Variable {
    name: "receiver_type",
    range: (0, 2),
    read: |s| s.rx.receiver_type().unwrap_or(0).into(),
    write: |s, v| s.rx.set_receiver_type(v as u8),
};

const BETAFLIGHT: &[Variable] = &[
    SERIAL_RATE,
    OVERRIDE_MASK,
    MIN_CHECK,
    FAILSAFE_DELAY,
    FAILSAFE_PROCEDURE,
    FAILSAFE_THROTTLE,
];
const INAV: &[Variable] = &[
    RECEIVER_TYPE,
    OVERRIDE_CHANNELS,
    MIN_CHECK,
    FAILSAFE_DELAY,
    FAILSAFE_PROCEDURE,
    FAILSAFE_THROTTLE,
];
const CLEANFLIGHT: &[Variable] = &[
    MIN_CHECK,
    FAILSAFE_DELAY,
    FAILSAFE_PROCEDURE,
    FAILSAFE_THROTTLE,
];

/// Values that have names.
fn words(name: &str, is_inav: bool) -> &'static [&'static str] {
    match name {
        "receiver_type" => &["NONE", "SERIAL", "MSP"],
        "failsafe_procedure" if is_inav => &["LAND", "DROP", "RTH", "NONE"],
        "failsafe_procedure" => &["AUTO-LAND", "DROP", "GPS-RESCUE"],
        _ => &[],
    }
}

impl FlightController {
    /// Opens the command line, if this firmware has one and is disarmed.
    pub(super) fn open_cli(&mut self) {
        if self.table.status == StatusKind::MultiWii || self.arming.is_armed() {
            return;
        }
        self.cli.is_open = true;
        self.cli.line.clear();
        self.cli
            .out
            .push_str("\r\nEntering CLI Mode, type 'exit' to return, or 'help'\r\n\r\n# ");
    }

    /// A byte of the person or program at the other end. It is echoed.
    pub(super) fn type_cli(&mut self, now: Timestamp, byte: u8) {
        match byte {
            b'\r' | b'\n' => {
                let line = core::mem::take(&mut self.cli.line);
                let mut out = String::from("\r\n");
                let closes = self.command(now, line.trim(), &mut out);
                if !closes {
                    out.push_str("# ");
                }
                self.cli.out.push_str(&out);
            }
            b' '..=b'~' if self.cli.line.len() < LINE => {
                self.cli.line.push(char::from(byte));
                self.cli.out.push(char::from(byte));
            }
            _ => {}
        }
    }

    const fn variables(&self) -> &'static [Variable] {
        match self.table.receiver.chosen_by {
            ReceiverChoice::ReceiverType => INAV,
            _ => match self.table.status {
                StatusKind::Betaflight { .. } => BETAFLIGHT,
                _ => CLEANFLIGHT,
            },
        }
    }

    /// Carries out a line; true if the command line is closed by it.
    fn command(&mut self, now: Timestamp, line: &str, out: &mut String) -> bool {
        let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
        let is_inav = self.table.status == StatusKind::Inav;
        let value = |v: &Variable, settings: &Settings| {
            let number = (v.read)(settings);
            let named = words(v.name, is_inav).get(number as usize);
            named.map_or_else(|| number.to_string(), |word| (*word).to_owned())
        };
        match word {
            "" => {}
            "get" => {
                for v in self.variables().iter().filter(|v| v.name.contains(rest)) {
                    let _ = write!(out, "{} = {}\r\n", v.name, value(v, &self.settings));
                }
            }
            "diff" | "dump" => {
                for v in self.variables() {
                    let _ = write!(out, "set {} = {}\r\n", v.name, value(v, &self.settings));
                }
            }
            "set" => match self.set(rest, is_inav) {
                Some(v) => {
                    let _ = write!(out, "{} set to {}\r\n", v.name, value(v, &self.settings));
                }
                None => out.push_str("###ERROR IN set: INVALID NAME OR VALUE###\r\n"),
            },
            "version" => {
                let (major, minor, patch) = self.table.identity.version;
                let _ = write!(out, "# {} {major}.{minor}.{patch}\r\n", self.config.manner);
            }
            "save" => {
                out.push_str("Saving\r\n");
                self.save(now);
                self.close_cli(now);
                return true;
            }
            "exit" => {
                out.push_str("Leaving CLI mode, unsaved changes lost.\r\n");
                self.close_cli(now);
                return true;
            }
            _ => out.push_str("###ERROR: UNKNOWN COMMAND###\r\n"),
        }
        false
    }

    fn set(&mut self, assignment: &str, is_inav: bool) -> Option<&'static Variable> {
        let (name, text) = assignment.split_once('=')?;
        let (name, text) = (name.trim(), text.trim());
        let variable = self.variables().iter().find(|v| v.name == name)?;
        let named = words(name, is_inav).iter().position(|word| *word == text);
        let number = named.map_or_else(|| text.parse().ok(), |i| u32::try_from(i).ok())?;
        let (least, most) = variable.range;
        if !(least..=most).contains(&number) {
            return None;
        }
        (variable.write)(&mut self.settings, number);
        Some(variable)
    }

    fn close_cli(&mut self, now: Timestamp) {
        let out = core::mem::take(&mut self.cli.out);
        self.reboot(now);
        self.cli.out = out;
    }
}
