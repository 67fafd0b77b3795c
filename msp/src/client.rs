//! The asking side of a link as a state machine driven from outside.
//!
//! [`Client`] identifies the controller, repeats a schedule of requests, sends RC channels ahead of
//! everything else and tells when the controller falls silent. It never has more than a few
//! requests outstanding, because firmware handles one per run of its serial task (100 a second by
//! default) and queues the rest: at 115 requests a second the effect of a stick was measured to
//! come 0.3 to 0.8 s late and growing.
//!
//! ```text
//!           connect                 100 ms quiet                last answer
//!   idle ----------> draining ------------------> identifying -------------> online
//!                                                  ^       ^                   |
//!                     asks API_VERSION for ever    |       +-------------------+
//!                     (Lost, then Recovered) ------+         600 ms of silence, REBOOT
//! ```
//!
//! **Slots.** A controller that runs its serial task 100 times a second has 100 slots a second. The client
//! measures that rate and fills it: RC first and at once, then what is due by age and priority, and with
//! the slots nobody asked for the fast polls, in a batch where the firmware knows batches. It answers the
//! arrival of a reply with the next request, keeps the fewest requests outstanding that still leave no
//! slot empty (one on an ordinary line: RC then waits for one request at most), and says when the
//! controller is slow and which line of its command line makes it faster ([`Event::Slow`]).
//!
//! The loop around it (`now_us` is any monotonic microsecond count):
//!
//! ```
//! use msp::client::{Client, Config, Event};
//! # let (mut now_us, mut line): (u64, Vec<u8>) = (0, Vec::new());
//! let mut client = Client::new(Config::default());
//! client.connect(now_us);
//! for _ in 0..10 {
//!     client.handle(now_us, &[]); // bytes that came
//!     while let Some(bytes) = client.poll_transmit(now_us) {
//!         line.extend_from_slice(bytes); // write
//!     }
//!     while let Some(event) = client.poll_event() {
//!         assert!(matches!(event, Event::Lost { .. }), "nobody answers here: {event}");
//!     }
//!     now_us = client.deadline_us().unwrap_or(now_us + 10_000); // or when bytes come
//! }
//! assert!(line.starts_with(b"$M<\x00\x01\x01")); // MSP_API_VERSION
//! ```

mod answer;
mod depth;
mod identify;
mod link;
mod schedule;
mod statistics;
mod turn;

pub use schedule::{MAX_POLLS, Poll, Priority, Schedule, default_schedule};
pub use statistics::Statistics;

use crate::command;
use crate::firmware::Identity;
use crate::frame::{Accept, Decoder, Framing, Resync};
use crate::message::Reply;
use crate::wire::ParseError;
use link::{Link, State};
use std::fmt;

/// Payload of a one-off request at most: what firmware takes.
pub const MAX_REQUEST: usize = crate::server::MAX_REQUEST;

/// Limits and times of a link. The defaults suit 115200 baud and a serial task of 100 Hz.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// Framing of commands below 255; the others always go as v2.
    pub framing: Framing,
    /// Requests waiting at the controller at most, 1..=4. RC may exceed it by one. More than that
    /// is latency, not rate.
    pub max_outstanding: usize,
    /// After this time a request counts as lost.
    pub timeout_us: u64,
    /// How often a one-off request or a question of the identification is sent before it is given
    /// up.
    pub tries: u8,
    /// Silence of the controller after which the link is lost.
    pub silence_us: u64,
    /// How long bytes are thrown away at connect: the controller may still be sending to an earlier
    /// client.
    pub drain_us: u64,
    /// After this time an RC frame stops counting as outstanding. It bounds the RC rate towards a
    /// controller that cannot be heard: 100 ms keeps the receiver of Betaflight alive (gaps up to
    /// 150 ms) without piling up a backlog.
    pub rc_timeout_us: u64,
    /// RC channels older than this are dropped instead of sent.
    pub rc_max_age_us: u64,
    /// How long a controller that saves or restarts may be silent.
    pub blocking_us: u64,
    /// A frame whose end does not come for this long is given up.
    pub stall_us: u64,
    /// Longest reply payload.
    pub max_payload: usize,
    /// How often a fast poll may be repeated with slots nobody asked for, per second; 0 = never more
    /// often than its interval says. A bound for lines without a speed of their own (a local socket
    /// manages tens of thousands).
    pub fill_hz: u32,
    /// How often the lists that change with the configuration (boxes, receiver map) are read again;
    /// 0 = never.
    pub refresh_us: u64,
    /// What is asked how often; `None` = [`default_schedule`].
    pub schedule: Option<Schedule>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            framing: Framing::V1,
            max_outstanding: 2,
            timeout_us: 250_000,
            tries: 4,
            silence_us: 600_000,
            drain_us: 100_000,
            rc_timeout_us: 100_000,
            rc_max_age_us: 150_000,
            blocking_us: 5_000_000,
            stall_us: 50_000,
            max_payload: 1024,
            fill_hz: 2_000,
            refresh_us: 10_000_000,
            schedule: None,
        }
    }
}

/// What happened on the link. `Display` is for a pilot.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Boxes or receiver map are not what they were: the configuration was changed meanwhile.
    Changed(Identity),
    /// The controller has told who it is: after connect, after a loss and after a restart.
    Identified(Identity),
    /// The controller does not answer. It goes on being asked; RC set meanwhile still goes out, at
    /// 10 Hz.
    Lost {
        /// Microseconds since the last answer, or since the link was opened.
        silent_us: u64,
        /// Bytes that came meanwhile and were no frames: a wrong baud rate, or a text console at
        /// the other end.
        noise_bytes: u64,
    },
    /// A reply does not fit its command.
    Malformed(ParseError),
    /// The controller answers again after a loss; it is being identified again.
    Recovered {
        /// How long it was silent, in microseconds.
        silent_us: u64,
    },
    /// The controller has started anew without having been silent for long; it is being identified
    /// again.
    Restarted,
    /// The controller said no: unknown command, bad argument, not now. A scheduled request that is
    /// refused is tried again after a second, then ever more rarely.
    Refused {
        /// Command number.
        command: u16,
    },
    /// The answer to a scheduled or one-off request.
    Reply {
        /// The answer.
        reply: Reply,
        /// When the request was handed out for sending.
        sent_us: u64,
        /// When the reply was complete.
        received_us: u64,
    },
    /// The controller serves fewer requests than flight wants. Told once per identification.
    Slow {
        /// Requests per second it serves.
        service_rate_hz: f64,
        /// Requests per second wanted, RC among them.
        wanted_hz: f64,
        /// The line of its command line that makes it faster, if the firmware has one.
        cli_line: Option<&'static str>,
    },
    /// The control loop of the controller has stood still for 3 s (cycle time 0) although it answers:
    /// it will never arm. Only a restart helps.
    Stalled,
    /// A one-off request was given up.
    Unanswered {
        /// Command number.
        command: u16,
    },
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |us: &u64| us / 1000;
        match self {
            Self::Changed(_) => f.write_str("flight controller: its configuration was changed"),
            Self::Identified(identity) => write!(f, "flight controller: {identity}"),
            Self::Restarted => f.write_str("flight controller has started anew"),
            Self::Slow {
                service_rate_hz,
                cli_line: Some(line),
                ..
            } => write!(
                f,
                "flight controller serves only {service_rate_hz:.0} requests/s; its CLI: {line}"
            ),
            Self::Slow {
                service_rate_hz,
                wanted_hz,
                cli_line: None,
            } => write!(
                f,
                "flight controller serves only {service_rate_hz:.0} requests/s of {wanted_hz:.0}: raise the baud rate"
            ),
            Self::Stalled => f.write_str(
                "flight controller's control loop stands still (cycle time 0): restart it",
            ),
            Self::Lost {
                silent_us,
                noise_bytes: 0,
            } => write!(
                f,
                "flight controller has not answered for {} ms: check cable and power, the baud rate, and that MSP is enabled on that UART",
                ms(silent_us)
            ),
            Self::Lost {
                silent_us,
                noise_bytes,
            } => write!(
                f,
                "flight controller has not answered for {} ms but {noise_bytes} bytes came that are not MSP: check the baud rate; \
                 if its command line is open, leave it with `exit`",
                ms(silent_us)
            ),
            Self::Malformed(error) => {
                write!(f, "flight controller sent a malformed reply: {error}")
            }
            Self::Recovered { silent_us } => {
                write!(
                    f,
                    "flight controller answers again after {} ms",
                    ms(silent_us)
                )
            }
            Self::Refused { command } => write!(
                f,
                "flight controller refused {} ({command})",
                command::name(*command)
            ),
            Self::Reply { reply, .. } => {
                write!(
                    f,
                    "flight controller answered {}",
                    command::name(reply.command())
                )
            }
            Self::Unanswered { command } => write!(
                f,
                "flight controller did not answer {} ({command})",
                command::name(*command)
            ),
        }
    }
}

/// Why a one-off request was not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// Flight controllers do not take such a payload.
    #[error("{length} bytes for {name} ({command}): flight controllers take {MAX_REQUEST}", name = command::name(*.command))]
    PayloadTooLong {
        /// Command number.
        command: u16,
        /// Bytes of payload.
        length: usize,
    },
    /// Too many are waiting already.
    #[error("{MAX_ONE_OFFS} requests are waiting already: {name} ({command}) was not queued", name = command::name(*.command))]
    QueueFull {
        /// Command number.
        command: u16,
    },
}

/// One-off requests that wait at most.
const MAX_ONE_OFFS: usize = 32;

/// A client of one flight controller. After each input or command call [`Self::poll_transmit`]
/// until `None`, then [`Self::poll_event`] until `None`; call them again at [`Self::deadline_us`]
/// at the latest. Nothing allocates after construction.
#[derive(Clone, Debug)]
pub struct Client {
    decoder: Decoder,
    /// When bytes last came, for frames that stop in the middle.
    bytes_us: u64,
    link: Link,
    output: Vec<u8>,
}

impl Client {
    /// A client that does nothing before [`Self::connect`].
    #[must_use]
    pub fn new(config: Config) -> Self {
        let max_outstanding = config.max_outstanding.clamp(1, 4);
        let config = Config {
            max_outstanding,
            ..config
        };
        Self {
            decoder: Decoder::with_limits(Accept::Replies, Resync::Rescan, config.max_payload),
            bytes_us: 0,
            link: Link::new(config),
            output: Vec::with_capacity(MAX_REQUEST + 16),
        }
    }

    /// Starts afresh on a line that was just opened: throws stale bytes away, then identifies the
    /// controller.
    pub fn connect(&mut self, now_us: u64) {
        self.decoder.clear();
        self.link.connect(now_us);
    }

    /// Takes bytes from the line, with the time at which they came. Hand over what is there before
    /// [`Self::poll_transmit`]: time-outs are judged in that one, so answers that waited for a
    /// program that was held up are not late.
    pub fn handle(&mut self, now_us: u64, mut bytes: &[u8]) {
        if self.link.state != State::Running || bytes.is_empty() {
            return;
        }
        self.bytes_us = now_us;
        while let Some(frame) = self.decoder.decode(&mut bytes) {
            self.link.on_frame(now_us, &frame);
        }
        self.link.count(self.decoder.counters());
    }

    /// Sets the RC channels, in microseconds and in the order of [`Identity::rx_map`]
    /// ([`arrange`](crate::message::RxMap::arrange)). They go out before anything else, once; newer
    /// ones replace those not yet sent. To keep the vehicle flying call it at 40 to 50 Hz; to let
    /// the controller fail safe stop calling it.
    ///
    /// Channels before the first identification are not sent, an empty list never is, and more than
    /// 34 are cut.
    pub fn set_rc(&mut self, now_us: u64, channels_us: &[u16]) {
        self.link.set_rc(now_us, channels_us);
    }

    /// Takes back RC channels that were not sent yet.
    pub fn clear_rc(&mut self) {
        self.link.rc = None;
    }

    /// Queues a request that is sent once, and again when it is not answered. Such requests go one
    /// at a time and in order, so a change may be followed by `EEPROM_WRITE`. The answer comes as
    /// [`Event::Reply`], [`Event::Refused`] or [`Event::Unanswered`]; it waits while the controller
    /// is not identified or lost. Around `EEPROM_WRITE` and `REBOOT` the controller may be silent
    /// for seconds; the link waits, and after a restart identifies it again.
    ///
    /// # Errors
    /// [`RequestError`] when the payload is longer than 192 bytes or 32 requests are waiting.
    pub fn request(&mut self, command: u16, payload: &[u8]) -> Result<(), RequestError> {
        self.link.request(command, payload)
    }

    /// Replaces the schedule, until the next identification and beyond.
    pub fn set_schedule(&mut self, now_us: u64, schedule: &Schedule) {
        self.link.set_schedule(now_us, schedule);
    }

    /// The next frame to write, if it is time for one.
    pub fn poll_transmit(&mut self, now_us: u64) -> Option<&[u8]> {
        self.tick(now_us);
        let Some(choice) = self.link.choose(now_us) else {
            self.link.rest();
            return None;
        };
        self.output.clear();
        let encoded = self.link.send(now_us, choice, &mut self.output);
        debug_assert!(encoded.is_ok(), "{encoded:?}");
        encoded.is_ok().then_some(self.output.as_slice())
    }

    /// The oldest event.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.link.events.pop_front()
    }

    /// When something is to be done even if no byte comes; `None` before [`Self::connect`].
    #[must_use]
    pub fn deadline_us(&self) -> Option<u64> {
        let stalled_us = (self.decoder.has_partial() && self.link.state == State::Running)
            .then_some(self.bytes_us + self.link.config.stall_us);
        self.link.deadline_us().into_iter().chain(stalled_us).min()
    }

    /// Who answers; kept through a loss until the controller has been identified again.
    #[must_use]
    pub const fn identity(&self) -> Option<&Identity> {
        self.link.identity.as_ref()
    }

    /// Whether the controller is identified and not lost.
    #[must_use]
    pub const fn is_online(&self) -> bool {
        self.link.is_online()
    }

    /// Counters and averages since construction.
    #[must_use]
    pub const fn statistics(&self) -> &Statistics {
        &self.link.statistics
    }

    /// Requests per second the schedule asks for, without RC and without what fills spare slots. When
    /// this and the RC rate together exceed [`Statistics::service_rate_hz`], every rate falls in
    /// proportion, and [`Event::Slow`] says so.
    #[must_use]
    pub fn demand_hz(&self) -> f64 {
        self.link.turns.demand_hz(self.link.batches())
    }

    fn tick(&mut self, now_us: u64) {
        if self.decoder.has_partial() && now_us >= self.bytes_us + self.link.config.stall_us {
            // The rest of that frame was lost; good frames may have been taken for its payload.
            self.decoder.resync();
            self.bytes_us = now_us;
            while let Some(frame) = self.decoder.decode(&mut [].as_slice()) {
                self.link.on_frame(now_us, &frame);
            }
            self.link.count(self.decoder.counters());
        }
        self.link.tick(now_us);
    }
}

#[cfg(test)]
mod tests;
