//! What waits to be sent: bounded, so that a stalled shell costs telemetry and not memory.
//!
//! Two classes: answers (with heartbeats and texts) go first; of telemetry the oldest is dropped when its queue is full.
//! Messages are kept unencoded and get their sequence number when they leave, so a drop is no gap for the receiver.

use super::{Destination, Outgoing};
use std::collections::VecDeque;

/// How much a message matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Somebody waits for it.
    Answer,
    /// The next one will say it too.
    Telemetry,
}

/// Most answers that wait.
pub const MAX_ANSWERS: usize = 2048;
/// Most telemetry messages that wait.
pub const MAX_TELEMETRY: usize = 2048;

/// Messages on their way out.
#[derive(Debug, Default)]
pub struct OutQueue {
    answers: VecDeque<Outgoing>,
    telemetry: VecDeque<Outgoing>,
    dropped_answers: u64,
    dropped_telemetry: u64,
}

impl OutQueue {
    /// Nothing waits.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Puts a message in its queue.
    pub fn push(&mut self, class: Class, outgoing: Outgoing) {
        match class {
            Class::Answer if self.answers.len() >= MAX_ANSWERS => self.dropped_answers += 1,
            Class::Answer => self.answers.push_back(outgoing),
            Class::Telemetry => {
                if self.telemetry.len() >= MAX_TELEMETRY {
                    self.telemetry.pop_front();
                    self.dropped_telemetry += 1;
                }
                self.telemetry.push_back(outgoing);
            }
        }
    }

    /// The next message to send.
    pub fn pop(&mut self) -> Option<Outgoing> {
        self.answers
            .pop_front()
            .or_else(|| self.telemetry.pop_front())
    }

    /// Forgets what waits for one link only.
    pub fn forget(&mut self, link: super::LinkId) {
        let keep = |o: &Outgoing| o.to != Destination::Link(link);
        self.answers.retain(keep);
        self.telemetry.retain(keep);
    }

    /// Messages that wait.
    #[must_use]
    pub fn len(&self) -> usize {
        self.answers.len() + self.telemetry.len()
    }

    /// True if nothing waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// (answers, telemetry messages) dropped so far.
    #[must_use]
    pub const fn dropped(&self) -> (u64, u64) {
        (self.dropped_answers, self.dropped_telemetry)
    }
}
