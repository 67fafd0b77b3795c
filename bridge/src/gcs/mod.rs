//! Towards the ground: one MAVLink service per file, each a pure state machine.
//!
//! A service is a struct with `handle(now, from, &message, &Context, &mut Outbox)` for messages addressed to us, and
//! where it has timers `tick(now, &Context, &mut Outbox)`. It sends by [`Outbox::send`], asks the vehicle by
//! [`Outbox::ask`], and keeps what it must remember to answer.
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`router`] | which message is for us, from whom, how many were lost; floods and echoes |
//! | [`convert`] | every scale factor, sign and sentinel between our types and MAVLink |
//! | [`command`], [`mission`], [`manual`], [`setpoint`], [`keys`] | what stations ask of the vehicle |
//! | [`intent`] | what a message wants of the vehicle |
//! | [`sensor_feed`] | sensors whose messages come over a link |
//! | [`signing`] | which links demand signatures |
//! | [`access`], [`operator`] | what a link may do; which station is in control |
//! | [`fence`] | where the vehicle may be, and what is done before it leaves |
//! | [`heartbeat`], [`telemetry`], [`text`] | what we say unasked |
//! | [`camera`] | where the picture is to be had |
//! | [`params`], [`origin`], [`time_sync`], [`ftp`], [`log_transfer`] | small services |
//! | [`metadata`], [`disk`] | files made here; jobs for the disk |
//! | [`patrol`] | a report per round |
//! | [`plan_file`] | QGroundControl's plan files |
//! | [`out_queue`] | what waits to be sent, bounded |

pub mod access;
#[cfg(test)]
mod any_message;
#[cfg(test)]
mod bench;
pub mod camera;
pub mod command;
pub mod convert;
pub mod disk;
pub mod fence;
pub mod ftp;
pub mod heartbeat;
pub mod intent;
pub mod keys;
pub mod log_transfer;
pub mod manual;
pub mod metadata;
pub mod mission;
pub mod operator;
pub mod origin;
pub mod out_queue;
pub mod params;
pub mod patrol;
mod place;
pub mod plan_file;
pub mod router;
pub mod sensor_feed;
pub mod setpoint;
pub mod signing;
pub mod telemetry;
pub mod text;
pub mod time_sync;

use crate::autopilot::door::{Asked, Request, RequestId, Severity, Snapshot, Station};
use crate::settings::Settings;
use mavlink_dialect::{Address, Message, raw, standard};
use std::collections::VecDeque;
use vehicle::MapAnchor;

/// Most links at once.
pub const MAX_LINKS: usize = 32;

/// A link of the shell: a socket peer, a TCP client, a serial port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct LinkId(pub u32);

impl LinkId {
    const REMOTE: u32 = 1 << 23;

    /// A link of an endpoint, the n-th that came up there: the number itself says what is demanded of who speaks on it, so that
    /// no order of events can make a link of a signed endpoint an open one.
    #[must_use]
    pub const fn of(endpoint: u8, n: u32) -> Self {
        Self((endpoint as u32) << 24 | (n & 0x007F_FFFF))
    }

    /// The same, with a peer on another machine: what it may do differs ([`access`]).
    #[must_use]
    pub const fn remote(self) -> Self {
        Self(self.0 | Self::REMOTE)
    }

    /// True if the peer is on another machine.
    #[must_use]
    pub const fn is_remote(self) -> bool {
        self.0 & Self::REMOTE != 0
    }

    /// Number of the endpoint.
    #[must_use]
    pub const fn endpoint(self) -> u8 {
        (self.0 >> 24) as u8
    }
}

/// Where a message came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer {
    /// On which link it came.
    pub link: LinkId,
    /// Who sent it.
    pub address: Address,
}

impl Peer {
    /// The sender as the door knows it.
    #[must_use]
    pub const fn station(&self) -> Station {
        Station {
            system: self.address.system,
            component: self.address.component,
        }
    }
}

/// What services may look at.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// The vehicle now.
    pub snapshot: &'a Snapshot,
    /// All parameters.
    pub settings: &'a Settings,
    /// How the plan lies in the world.
    pub anchor: MapAnchor,
    /// Our own address (autopilot component).
    pub us: Address,
    /// What the sender may do; in calls without a sender, everything.
    pub role: access::Role,
    /// UTC microseconds at boot, for messages that carry wall time (virtual flights start at a fixed date).
    pub boot_utc_us: u64,
}

/// Where a message goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Destination {
    /// Every link: telemetry, and replies too (stations filter by target).
    All,
    /// One link.
    Link(LinkId),
}

/// Which of our components says something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Speaker {
    /// The autopilot.
    #[default]
    Autopilot,
    /// The camera.
    Camera,
}

/// A message on its way out.
#[derive(Clone, Debug, PartialEq)]
pub struct Outgoing {
    /// Where to.
    pub to: Destination,
    /// Who says it.
    pub from: Speaker,
    /// What.
    pub message: Message,
}

/// A document to keep on disk, by file name; the shell writes it atomically.
#[derive(Clone, Debug, PartialEq)]
pub struct Document {
    /// File name in the state folder.
    pub name: &'static str,
    /// Content.
    pub bytes: Vec<u8>,
}

/// Documents that an earlier run may have kept beside its parameters; the shell reads them before the start.
pub const DOCUMENTS: [&str; 5] = [
    mission::DOCUMENT,
    mission::FENCE_DOCUMENT,
    mission::RALLY_DOCUMENT,
    signing::DOCUMENT,
    signing::KEY_DOCUMENT,
];

/// What services produce; drained by `Ground` after each call.
#[derive(Debug, Default)]
pub struct Outbox {
    /// Messages to send.
    pub messages: VecDeque<Outgoing>,
    /// Requests to the vehicle.
    pub requests: VecDeque<Asked>,
    /// Texts to show to every pilot.
    pub texts: VecDeque<(Severity, String)>,
    /// Documents to keep.
    pub documents: VecDeque<Document>,
    /// Jobs for the disk.
    pub jobs: VecDeque<(disk::Ticket, disk::DiskJob)>,
    next_request: u32,
    next_ticket: u32,
}

impl Outbox {
    /// Sends a standard message.
    pub fn send(&mut self, to: Destination, message: standard::MavMessage) {
        self.send_as(Speaker::Autopilot, to, Message::Standard(message));
    }

    /// Sends a raw twin.
    pub fn send_raw(&mut self, to: Destination, message: raw::MavMessage) {
        self.send_as(Speaker::Autopilot, to, Message::Raw(message));
    }

    /// Sends a message of one of our components.
    pub fn send_as(&mut self, from: Speaker, to: Destination, message: Message) {
        self.messages.push_back(Outgoing { to, from, message });
    }

    /// Asks the vehicle; the answer comes back with this id.
    pub fn ask(&mut self, from: Peer, request: Request) -> RequestId {
        self.next_request = self.next_request.wrapping_add(1);
        let id = RequestId(self.next_request);
        self.requests.push_back(Asked {
            id,
            station: from.station(),
            request,
        });
        id
    }

    /// Asks the disk; the answer comes back with this ticket.
    pub fn disk(&mut self, job: disk::DiskJob) -> disk::Ticket {
        self.next_ticket = self.next_ticket.wrapping_add(1);
        let ticket = disk::Ticket(self.next_ticket);
        self.jobs.push_back((ticket, job));
        ticket
    }

    /// Tells every pilot (STATUSTEXT).
    pub fn text(&mut self, severity: Severity, text: impl Into<String>) {
        self.texts.push_back((severity, text.into()));
    }
}
