//! Writes down what the page of a socket asked of a vehicle, and what it may not.

use super::console::Server;
use super::gate::{Arrival, Caller};
use crate::gcs::intent::{self, Intent};
use mavlink_dialect::{Message, command, raw};
use std::sync::Arc;
use std::time::Duration;
use vehicle::Timestamp;

/// Sticks silent for this long: manual control is over, for the log.
const MANUAL_ENDS: Duration = Duration::from_secs(2);

/// The log's eye on one socket.
pub(super) struct Witness {
    server: Arc<Server>,
    arrival: Arrival,
    pub(super) caller: Caller,
    /// What the log calls the vehicle.
    vehicle: String,
    /// When sticks came last, while manual control lasts.
    manual: Option<Timestamp>,
    /// One row a socket is enough for a page that keeps trying.
    has_intruded: bool,
}

impl Witness {
    pub(super) const fn new(
        server: Arc<Server>,
        arrival: Arrival,
        caller: Caller,
        vehicle: String,
    ) -> Self {
        Self {
            server,
            arrival,
            caller,
            vehicle,
            manual: None,
            has_intruded: false,
        }
    }

    /// A message was passed on.
    pub(super) fn passed(&mut self, now: Timestamp, message: &Message) {
        if matches!(message, Message::Raw(raw::MavMessage::MANUAL_CONTROL(_))) {
            if self.manual.replace(now).is_none() {
                self.action("manual control begins".to_owned());
            }
            return;
        }
        let is_one_of_many = matches!(
            message,
            Message::Raw(raw::MavMessage::MISSION_ITEM_INT(_) | raw::MavMessage::MISSION_ITEM(_))
        );
        if intent::of(message) != Intent::Watch && !is_one_of_many {
            self.server.touch(self.caller.id);
            self.action(words(message));
        }
    }

    /// Time passes.
    pub(super) fn look(&mut self, now: Timestamp) {
        if self.manual.is_some_and(|at| now.since(at) >= MANUAL_ENDS) {
            self.manual_ends();
        }
    }

    /// Sticks are let go of, or the socket is closed.
    pub(super) fn manual_ends(&mut self) {
        if self.manual.take().is_some() {
            self.action("manual control ends".to_owned());
        }
    }

    fn action(&self, what: String) {
        self.server
            .action(&self.caller.session.user, &self.vehicle, what);
    }

    /// Something was tried that this user may not.
    pub(super) fn intrusion(&mut self, what: &str) {
        if !std::mem::replace(&mut self.has_intruded, true) {
            self.server
                .intrusion(&self.caller.session.user, self.arrival, what);
        }
    }
}

/// A message in words, for the logs.
pub(super) fn words(message: &Message) -> String {
    let named = |number: u16, p1: f32| {
        let name = command::name(number).map_or_else(|| format!("command {number}"), str::to_owned);
        format!("{name} {p1}")
    };
    match message {
        Message::Raw(raw::MavMessage::COMMAND_LONG(m)) => named(m.command, m.param1),
        Message::Raw(raw::MavMessage::COMMAND_INT(m)) => {
            format!("{} at {} {}", named(m.command, m.param1), m.x, m.y)
        }
        Message::Raw(raw::MavMessage::PARAM_SET(m)) => {
            let id = m.param_id.to_str().unwrap_or_default();
            format!("PARAM_SET {id}")
        }
        Message::Raw(raw::MavMessage::MISSION_COUNT(m)) => {
            format!("mission of {} items", m.count)
        }
        other => other.name().to_owned(),
    }
}
