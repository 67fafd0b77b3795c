//! One question at a time to a controller on the bench: for setting it up, not for flying it.
//!
//! Raw payloads, so that settings can be written back byte for byte. [`msp::Client`] is for flight: it paces, batches and
//! types.

use msp::{Accept, Decoder, Direction, Framing, command};
use std::time::Duration;
use thiserror::Error;
use vehicle::Timestamp;

/// Time for an answer before the question is sent again.
const ANSWER: Duration = Duration::from_millis(500);
/// How often a question is sent.
const TRIES: u8 = 4;
/// Saving and restarting stop a controller for seconds; asking again would do it twice.
const BLOCKING: Duration = Duration::from_secs(6);

/// Why a question has no answer.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AskError {
    /// The line is gone.
    #[error("the line to the flight controller: {0}")]
    Line(String),
    /// The answer does not fit the question.
    #[error("the flight controller sent a malformed answer: {0}")]
    Malformed(#[from] msp::ParseError),
    /// The controller says no: it does not know the command, or not these values, or not while armed.
    #[error("the flight controller refused {name} ({0})", name = command::name(*.0))]
    Refused(u16),
    /// No answer.
    #[error(
        "the flight controller did not answer {name} ({0}): check the baud rate and that MSP is enabled on that port",
        name = command::name(*.0)
    )]
    Silent(u16),
    /// The question does not fit a frame.
    #[error("{name} ({0}) cannot be sent", name = command::name(*.0))]
    TooLong(u16),
}

/// Something that answers MSP, one question at a time.
pub trait Controller {
    /// Asks or orders, and waits for the answer.
    ///
    /// # Errors
    /// [`AskError`].
    fn ask(&mut self, command: u16, payload: &[u8]) -> Result<Vec<u8>, AskError>;

    /// After an order to restart: waits until it answers again.
    ///
    /// # Errors
    /// [`AskError`]: it did not come back.
    fn come_back(&mut self) -> Result<(), AskError>;
}

/// Asks for a message by its type.
///
/// # Errors
/// [`AskError`].
pub fn read<M: msp::Message>(controller: &mut dyn Controller) -> Result<M, AskError> {
    Ok(M::parse(&controller.ask(M::COMMAND, &[])?)?)
}

/// What became of a question.
pub type Outcome = Result<Vec<u8>, AskError>;

/// The protocol of one question: after each [`ask`](Self::ask), [`handle`](Self::handle) or [`tick`](Self::tick) write what
/// [`poll_transmit`](Self::poll_transmit) has.
#[derive(Debug)]
pub struct Conversation {
    decoder: Decoder,
    waiting: Option<Waiting>,
    is_due: bool,
}

#[derive(Debug)]
struct Waiting {
    command: u16,
    frame: Vec<u8>,
    tries: u8,
    patience: Duration,
    until: Timestamp,
}

impl Default for Conversation {
    fn default() -> Self {
        Self {
            decoder: Decoder::new(Accept::Replies),
            waiting: None,
            is_due: false,
        }
    }
}

impl Conversation {
    /// Asks. A question that still waits is dropped.
    ///
    /// # Errors
    /// [`AskError::TooLong`].
    pub fn ask(&mut self, now: Timestamp, command: u16, payload: &[u8]) -> Result<(), AskError> {
        let framing = if command < 255 {
            Framing::V1
        } else {
            Framing::V2
        };
        let mut frame = Vec::new();
        msp::encode(framing, Direction::Request, command, payload, &mut frame)
            .map_err(|_| AskError::TooLong(command))?;
        let is_blocking = matches!(command, command::EEPROM_WRITE | command::REBOOT);
        let (patience, tries) = if is_blocking {
            (BLOCKING, 1)
        } else {
            (ANSWER, TRIES)
        };
        self.waiting = Some(Waiting {
            command,
            frame,
            tries: tries - 1,
            patience,
            until: now + patience,
        });
        self.is_due = true;
        Ok(())
    }

    /// Takes bytes from the line. Answers to older questions are dropped.
    pub fn handle(&mut self, mut bytes: &[u8]) -> Option<Outcome> {
        let mut outcome = None;
        while let Some(frame) = self.decoder.decode(&mut bytes) {
            let command = frame.command;
            if outcome.is_some() || self.waiting.as_ref().is_none_or(|w| w.command != command) {
                continue;
            }
            outcome = Some(if frame.direction == Direction::Error {
                Err(AskError::Refused(command))
            } else {
                Ok(frame.payload.to_vec())
            });
            self.waiting = None;
        }
        outcome
    }

    /// Time passes: asks again, or gives up.
    pub fn tick(&mut self, now: Timestamp) -> Option<Outcome> {
        let waiting = self.waiting.as_mut()?;
        if now < waiting.until {
            return None;
        }
        // The rest of a cut frame must not swallow the next answer.
        self.decoder.clear();
        if waiting.tries == 0 {
            let command = waiting.command;
            self.waiting = None;
            return Some(Err(AskError::Silent(command)));
        }
        waiting.tries -= 1;
        waiting.until = now + waiting.patience;
        self.is_due = true;
        None
    }

    /// The frame to write now, once.
    pub fn poll_transmit(&mut self) -> Option<&[u8]> {
        let is_due = core::mem::take(&mut self.is_due);
        self.waiting
            .as_ref()
            .filter(|_| is_due)
            .map(|w| w.frame.as_slice())
    }

    /// When [`tick`](Self::tick) has something to do.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp> {
        self.waiting.as_ref().map(|w| w.until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn reply(direction: Direction, command: u16, payload: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        msp::encode(Framing::V1, direction, command, payload, &mut out).unwrap();
        out
    }

    #[test]
    fn a_silent_controller_is_asked_four_times_and_given_up_after_two_seconds() {
        let mut talk = Conversation::default();
        talk.ask(Timestamp::ZERO, command::STATUS, &[]).unwrap();
        let mut sent = 0;
        let (outcome, now) = loop {
            sent += u32::from(talk.poll_transmit().is_some());
            let now = talk.deadline().unwrap();
            if let Some(outcome) = talk.tick(now) {
                break (outcome, now);
            }
        };
        assert_eq!(outcome, Err(AskError::Silent(command::STATUS)));
        assert_eq!((sent, now), (4, Timestamp::from_ms(2000)));
    }

    #[test]
    fn saving_is_ordered_once_and_waited_for() {
        let mut talk = Conversation::default();
        talk.ask(Timestamp::ZERO, command::EEPROM_WRITE, &[])
            .unwrap();
        assert!(talk.poll_transmit().is_some());
        assert_eq!(talk.tick(Timestamp::from_ms(5999)), None);
        assert!(talk.poll_transmit().is_none());
        let done = talk.handle(&reply(Direction::Reply, command::EEPROM_WRITE, &[]));
        assert_eq!(done, Some(Ok(vec![])));
    }

    #[test]
    fn an_answer_to_an_older_question_is_not_taken_for_this_one() {
        let mut talk = Conversation::default();
        talk.ask(Timestamp::ZERO, command::RX_MAP, &[]).unwrap();
        let late = reply(Direction::Reply, command::STATUS, &[1; 11]);
        assert_eq!(talk.handle(&late), None);
        let refused = reply(Direction::Error, command::RX_MAP, &[]);
        assert_eq!(
            talk.handle(&refused),
            Some(Err(AskError::Refused(command::RX_MAP)))
        );
        assert_eq!(talk.handle(&refused), None);
    }

    proptest! {
        #[test]
        fn whatever_comes_only_the_asked_command_is_an_answer(noise in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut talk = Conversation::default();
            talk.ask(Timestamp::ZERO, command::RX_MAP, &[]).unwrap();
            let heard = talk.handle(&noise);
            prop_assert!(heard.is_none() || noise.windows(2).any(|w| w == b"$M" || w == b"$X"));
        }
    }
}
