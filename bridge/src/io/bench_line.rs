//! A controller on the bench: one question at a time over its line, waiting for each answer.

use super::clock::{self, Clock};
use super::endpoint::Endpoint;
use super::line::{Line, LineError};
use crate::fc::conversation::{AskError, Controller, Conversation, Outcome};
use msp::{Message as _, message::ApiVersion};
use rustix::event::{PollFd, Timespec, poll};
use rustix::fd::AsFd as _;
use std::io;
use std::time::Duration;
use vehicle::Timestamp;

/// A controller may still be sending to an earlier client: such bytes are thrown away first.
const DRAIN: Duration = Duration::from_millis(120);
/// A restart is under way within this time after the order.
const GOING_DOWN: Duration = Duration::from_millis(1500);
/// Longest restart.
const COMING_UP: Duration = Duration::from_secs(20);
/// Pause between two tries to open the line.
const REOPEN: Duration = Duration::from_millis(250);

/// A line to a controller.
pub struct BenchLine {
    endpoint: Endpoint,
    line: Option<Line>,
    clock: Clock,
    talk: Conversation,
}

impl BenchLine {
    /// Opens the line.
    ///
    /// # Errors
    /// [`LineError`] says what to check.
    pub fn open(endpoint: Endpoint) -> Result<Self, LineError> {
        let line = Line::open(&endpoint)?;
        Ok(Self::on(endpoint, line))
    }

    /// On a line that is open already.
    #[must_use]
    pub fn on(endpoint: Endpoint, line: Line) -> Self {
        let mut this = Self {
            line: Some(line),
            endpoint,
            clock: Clock::start(1.0),
            talk: Conversation::default(),
        };
        this.drain();
        this
    }

    /// The line, unless it was lost.
    #[must_use]
    pub fn into_line(self) -> Option<Line> {
        self.line
    }

    /// The line for as long as bytes pass it as they are; none if it was lost.
    pub(super) const fn line_mut(&mut self) -> Option<&mut Line> {
        self.line.as_mut()
    }

    /// The line is gone.
    pub(super) fn lose(&mut self) {
        self.line = None;
    }

    /// Seconds since the line was opened first.
    #[must_use]
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    fn drain(&mut self) {
        let until = self.clock.now() + DRAIN;
        let mut buffer = [0; 256];
        while self.clock.now() < until {
            self.wait(until);
            let _ = self.line.as_mut().map(|line| line.read(&mut buffer));
        }
    }

    /// Sleeps until bytes come or the time has come.
    fn wait(&self, until: Timestamp) {
        let left = self.clock.until(until);
        let timeout = Timespec {
            tv_sec: i64::try_from(left.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: i64::from(left.subsec_nanos()),
        };
        let Some(line) = &self.line else {
            clock::sleep(left);
            return;
        };
        let _ = poll(
            &mut [PollFd::from_borrowed_fd(line.as_fd(), line.interest())],
            Some(&timeout),
        );
    }

    fn lost(&mut self, why: &str) -> AskError {
        self.line = None;
        AskError::Line(why.to_owned())
    }

    fn exchange(&mut self) -> Outcome {
        loop {
            while let Some(frame) = self.talk.poll_transmit() {
                // A frame there is no room for is dropped; the conversation asks again.
                let Some(line) = &mut self.line else {
                    return Err(AskError::Line("closed".to_owned()));
                };
                if let Err(e) = line.write(frame) {
                    self.line = None;
                    return Err(AskError::Line(e.to_string()));
                }
            }
            if let Some(until) = self.talk.deadline() {
                self.wait(until);
            }
            let mut buffer = [0; 512];
            let Some(line) = &mut self.line else {
                return Err(AskError::Line("closed".to_owned()));
            };
            if let Err(e) = line.flush() {
                return Err(self.lost(&e.to_string()));
            }
            match line.read(&mut buffer) {
                Ok(0) => return Err(self.lost("closed by the other end")),
                Ok(n) => {
                    if let Some(outcome) = self.talk.handle(&buffer[..n]) {
                        return outcome;
                    }
                }
                Err(e)
                    if matches!(
                        e.kind(),
                        io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
                    ) => {}
                Err(e) => return Err(self.lost(&e.to_string())),
            }
            if let Some(outcome) = self.talk.tick(self.clock.now()) {
                return outcome;
            }
        }
    }
}

impl Controller for BenchLine {
    fn ask(&mut self, command: u16, payload: &[u8]) -> Outcome {
        self.talk.ask(self.clock.now(), command, payload)?;
        self.exchange()
    }

    fn come_back(&mut self) -> Result<(), AskError> {
        // Bytes of the old life are no answer: the line is opened afresh even if it stays up, as a UART does.
        let down = self.clock.now() + GOING_DOWN;
        let mut buffer = [0; 256];
        while self.clock.now() < down {
            self.wait(down);
            if self
                .line
                .as_mut()
                .is_none_or(|line| matches!(line.read(&mut buffer), Ok(0)))
            {
                break;
            }
        }
        self.line = None;
        let give_up = self.clock.now() + COMING_UP;
        while self.clock.now() < give_up {
            self.wait(self.clock.now() + REOPEN);
            let Ok(line) = Line::open(&self.endpoint) else {
                continue;
            };
            self.line = Some(line);
            self.talk = Conversation::default();
            self.drain();
            if self.ask(ApiVersion::COMMAND, &[]).is_ok() {
                return Ok(());
            }
        }
        Err(AskError::Silent(ApiVersion::COMMAND))
    }
}
