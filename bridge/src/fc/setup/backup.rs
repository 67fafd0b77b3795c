//! A survey as a file, and the writes that bring it back.

use super::apply::{Write, differing};
use super::survey::{RXFAIL_CONFIG, SET_RXFAIL_CONFIG, Survey};
use msp::command;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use thiserror::Error;

/// Version of the file.
const FORMAT: u32 = 1;

/// Settings as they were.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Backup {
    kestrel_fc_backup: u32,
    /// The controller in words.
    pub controller: String,
    /// MSP API version.
    pub api: String,
    /// Serial number of its processor, hex.
    pub uid: Option<String>,
    /// Payloads by name of the message, hex.
    messages: BTreeMap<String, String>,
}

/// Why a file cannot be brought back.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BackupError {
    /// Not such a file.
    #[error("no settings of a flight controller in there: {0}")]
    Format(String),
    /// From another firmware, or another version of it: payloads may mean something else there.
    #[error("saved from {saved}, this is {here}")]
    OtherFirmware {
        /// In the file.
        saved: String,
        /// On the line.
        here: String,
    },
    /// From another board.
    #[error(
        "saved from another board (serial number {saved}, this one has {here}): --other-board writes it all the same"
    )]
    OtherBoard {
        /// In the file.
        saved: String,
        /// On the line.
        here: String,
    },
    /// A payload does not fit the message.
    #[error("{0} cannot be written back: it has another length here")]
    Length(&'static str),
}

/// Name of a message in files and words.
#[must_use]
pub const fn name(message: u16) -> &'static str {
    match message {
        RXFAIL_CONFIG => "MSP_RXFAIL_CONFIG",
        SET_RXFAIL_CONFIG => "MSP_SET_RXFAIL_CONFIG",
        other => command::name(other),
    }
}

const KNOWN: [u16; 4] = [
    command::FEATURE_CONFIG,
    command::MODE_RANGES,
    command::RX_CONFIG,
    RXFAIL_CONFIG,
];

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn unhex(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = text
        .chars()
        .map(|c| c.to_digit(16).and_then(|d| u8::try_from(d).ok()))
        .collect();
    let digits = digits?;
    digits.len().is_multiple_of(2).then(|| {
        digits
            .as_chunks::<2>()
            .0
            .iter()
            .map(|[h, l]| h << 4 | l)
            .collect()
    })
}

impl Backup {
    /// The settings of a survey.
    #[must_use]
    pub fn of(survey: &Survey) -> Self {
        Self {
            kestrel_fc_backup: FORMAT,
            controller: survey.identity.to_string(),
            api: survey.identity.api.to_string(),
            uid: survey.uid.as_deref().map(hex),
            messages: survey
                .settings
                .iter()
                .map(|(message, payload)| (name(*message).to_owned(), hex(payload)))
                .collect(),
        }
    }

    /// The file.
    #[must_use]
    pub fn to_json(&self) -> String {
        // A struct of strings always serializes.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// From a file.
    ///
    /// # Errors
    /// [`BackupError::Format`].
    pub fn from_json(text: &str) -> Result<Self, BackupError> {
        let backup: Self =
            serde_json::from_str(text).map_err(|e| BackupError::Format(e.to_string()))?;
        if backup.kestrel_fc_backup != FORMAT {
            let format = backup.kestrel_fc_backup;
            return Err(BackupError::Format(format!(
                "format {format}, not {FORMAT}"
            )));
        }
        backup.settings()?;
        Ok(backup)
    }

    /// Payloads by message.
    ///
    /// # Errors
    /// [`BackupError::Format`]: an unknown message, or no hex.
    pub fn settings(&self) -> Result<BTreeMap<u16, Vec<u8>>, BackupError> {
        self.messages
            .iter()
            .map(|(text, payload)| {
                let message = KNOWN.into_iter().find(|m| name(*m) == text);
                message
                    .zip(unhex(payload))
                    .ok_or_else(|| BackupError::Format(text.clone()))
            })
            .collect()
    }

    /// What must be written so that a controller is set as it was.
    ///
    /// # Errors
    /// [`BackupError`]: not that controller.
    pub fn writes(&self, here: &Survey, any_board: bool) -> Result<Vec<Write>, BackupError> {
        let now = Self::of(here);
        let firmware = |text: &str| text.split(" on ").next().unwrap_or_default().to_owned();
        if firmware(&self.controller) != firmware(&now.controller) {
            return Err(BackupError::OtherFirmware {
                saved: self.controller.clone(),
                here: now.controller,
            });
        }
        if self.uid != now.uid && !any_board {
            let text = |uid: &Option<String>| uid.clone().unwrap_or_else(|| "none".to_owned());
            return Err(BackupError::OtherBoard {
                saved: text(&self.uid),
                here: text(&now.uid),
            });
        }
        let wanted = self.settings()?;
        let mut writes = Vec::new();
        for message in differing(&wanted, &here.settings) {
            let to = &wanted[&message];
            let from = here.settings.get(&message).map_or(&[][..], Vec::as_slice);
            writes.extend(bring_back(message, from, to)?);
        }
        Ok(writes)
    }
}

/// The orders that turn one payload into another.
fn bring_back(message: u16, from: &[u8], to: &[u8]) -> Result<Vec<Write>, BackupError> {
    if from.len() != to.len() {
        return Err(BackupError::Length(name(message)));
    }
    let whole = |command| {
        vec![Write {
            text: format!("{} as saved", name(message)),
            command,
            payload: to.to_vec(),
        }]
    };
    let entries = |size: usize, command: u16, what: &str| {
        let pairs = from.chunks(size).zip(to.chunks(size)).enumerate();
        pairs
            .filter(|(_, (from, to))| from != to)
            .map(|(i, (_, to))| {
                let mut payload = vec![u8::try_from(i).unwrap_or(u8::MAX)];
                payload.extend_from_slice(to);
                Write {
                    text: format!("{what} {i} as saved"),
                    command,
                    payload,
                }
            })
            .collect()
    };
    Ok(match message {
        command::FEATURE_CONFIG => whole(command::SET_FEATURE_CONFIG),
        command::RX_CONFIG => whole(command::SET_RX_CONFIG),
        command::MODE_RANGES => entries(4, command::SET_MODE_RANGE, "mode slot"),
        _ => entries(3, SET_RXFAIL_CONFIG, "channel without receiver"),
    })
}
