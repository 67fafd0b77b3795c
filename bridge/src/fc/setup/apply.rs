//! Writing settings so that either all of them hold or the reason is said.

use super::survey::Survey;
use crate::fc::conversation::{AskError, Controller, read};
use msp::command;
use msp::message::ApiVersion;
use std::collections::BTreeMap;
use thiserror::Error;

/// One order that changes a setting.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Write {
    /// What it changes, from what to what.
    pub text: String,
    /// Command number.
    pub command: u16,
    /// Payload.
    pub payload: Vec<u8>,
}

/// Why settings were not (all) written.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ApplyError {
    /// Nothing is written to a controller whose motors are under way.
    #[error("the flight controller is armed: disarm it first; nothing was written")]
    Armed,
    /// The controller.
    #[error("{0}")]
    Ask(#[from] AskError),
    /// An order was refused; those before it were obeyed, nothing was saved: a restart brings the old settings back.
    #[error("refused: {text}; nothing was saved, a restart brings the old settings back")]
    Refused {
        /// The order.
        text: String,
    },
    /// It says that it still waits for a restart.
    #[error("saved, but the flight controller did not restart: take its power off and on")]
    NotRestarted,
    /// Read back, the settings are not as written.
    #[error("{} is not as written after {when}", names(.messages))]
    Differs {
        /// Messages that differ.
        messages: Vec<u16>,
        /// After writing, or after the restart.
        when: &'static str,
    },
}

fn names(messages: &[u16]) -> String {
    let names: Vec<&str> = messages.iter().map(|m| super::backup::name(*m)).collect();
    names.join(", ")
}

/// Writes, verifies, saves, restarts, verifies again. `expected` judges a survey taken after: messages that are not as they
/// must be. `tell` hears of each step.
///
/// # Errors
/// [`ApplyError`].
pub fn apply(
    controller: &mut dyn Controller,
    writes: &[Write],
    expected: &dyn Fn(&Survey) -> Vec<u16>,
    tell: &mut dyn FnMut(&str),
) -> Result<Survey, ApplyError> {
    if Survey::take(controller)?.is_armed {
        return Err(ApplyError::Armed);
    }
    for write in writes {
        match controller.ask(write.command, &write.payload) {
            Ok(_) => tell(&write.text),
            Err(AskError::Refused(_)) => {
                return Err(ApplyError::Refused {
                    text: write.text.clone(),
                });
            }
            Err(e) => return Err(e.into()),
        }
    }
    let check = |survey: &Survey, when| match expected(survey) {
        messages if messages.is_empty() => Ok(()),
        messages => Err(ApplyError::Differs { messages, when }),
    };
    check(&Survey::take(controller)?, "writing")?;
    match controller.ask(command::EEPROM_WRITE, &[]) {
        // It refuses only when it was armed meanwhile.
        Err(AskError::Refused(_)) => return Err(ApplyError::Armed),
        other => other?,
    };
    // Saving leaves it deaf for a moment: an order to restart would be lost, and a lost one looks like a restart.
    read::<ApiVersion>(controller)?;
    tell("saved; restarting");
    // The answer may be lost in the restart.
    match controller.ask(command::REBOOT, &[]) {
        Ok(_) | Err(AskError::Silent(_) | AskError::Line(_)) => {}
        Err(e) => return Err(e.into()),
    }
    controller.come_back()?;
    let survey = Survey::take(controller)?;
    if survey.blockers.iter().any(|b| b.name == "REBOOT_REQUIRED") {
        return Err(ApplyError::NotRestarted);
    }
    check(&survey, "the restart")?;
    tell("verified after the restart");
    Ok(survey)
}

/// Messages whose payload differs from a wanted one; a wanted one that is missing differs too.
#[must_use]
pub fn differing(wanted: &BTreeMap<u16, Vec<u8>>, is: &BTreeMap<u16, Vec<u8>>) -> Vec<u16> {
    wanted
        .iter()
        .filter(|(message, payload)| is.get(message) != Some(payload))
        .map(|(message, _)| *message)
        .collect()
}
